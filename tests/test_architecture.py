"""Rules of the house that a reader could break without noticing: imports, paths, speed of import."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("mocap", "sip", "learned", "hybrid", "poser")
MAY_IMPORT = {
    "mocap": set(),
    "sip": {"mocap"},
    "learned": {"mocap"},
    "hybrid": {"mocap", "sip"},
    "poser": {"mocap", "sip", "learned", "hybrid"},
}
ONLY_IN = {"casadi": "sip", "torch": "learned", "osqp": "hybrid"}


def modules() -> list[Path]:
    return [p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path) -> Iterator[str]:
    """Top-level names of everything a file imports, wherever in the file."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (a.name.split(".")[0] for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield (node.module or "").split(".")[0]


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_run_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    for name in imported(path):
        if name in PACKAGES and name != package:
            assert name in MAY_IMPORT[package], f"{package} imports {name}"
        assert ONLY_IN.get(name, package) == package, f"{name} belongs in {ONLY_IN[name]}"


def name_of(path: Path) -> str:
    """`mocap/formats/csv.py` -> `mocap.formats.csv`, `mocap/__init__.py` -> `mocap`."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def arrows() -> dict[str, set[str]]:
    """The files of the project that each file imports anywhere, also in functions and for types alone."""
    known = {name_of(p) for p in modules()}
    found: dict[str, set[str]] = {name: set() for name in known}
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                named = {a.name for a in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                whole = {f"{node.module}.{a.name}" for a in node.names}
                # `from mocap import sensors` takes the file, not what the package's own file names.
                named = {n if n in known else node.module for n in whole}
            else:
                continue
            found[name_of(path)] |= (named & known) - {name_of(path)}
    return found


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Files that import each other in a circle, in order; empty where there is none."""
    done: set[str] = set()

    def visit(name: str, trail: list[str]) -> list[str]:
        if name in trail:
            return [*trail[trail.index(name) :], name]
        if name in done:
            return []
        for other in sorted(graph[name]):
            found = visit(other, [*trail, name])
            if found:
                return found
        done.add(name)
        return []

    return next((found for name in sorted(graph) if (found := visit(name, []))), [])


def test_no_file_imports_in_a_circle() -> None:
    assert circle(arrows()) == []


ROOMS = ("formats", "synthesis", "evaluation", "calibration")
BETWEEN_ROOMS = {("formats", "calibration"), ("calibration", "synthesis")}
# Skeleton.from_smpl_file is the door to the user's body file.
DOORS = {("mocap.skeleton", "mocap.formats.smpl")}


def room(name: str) -> str:
    """The room of a file of mocap; the core types are in none. The data set stands above all."""
    parts = name.split(".")
    known = len(parts) > 1 and parts[0] == "mocap" and parts[1] in (*ROOMS, "dataset")
    return parts[1] if known else "core"


def test_rooms_of_mocap_know_the_core_and_hardly_each_other() -> None:
    for file, others in arrows().items():
        # A package's own file names what its files hold, for users to import.
        if not file.startswith("mocap.") or room(file) == "dataset":
            continue
        for other in others:
            here, there = room(file), room(other)
            known = here == there or there == "core" or (here, there) in BETWEEN_ROOMS
            assert known or (file, other) in DOORS, f"{file} imports {other}"


def test_a_circle_is_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]


def test_examples_show_the_library() -> None:
    """Two show parts of the command line: comparing, and the live loop."""
    users = {p.stem for p in (ROOT / "examples").glob("*.py") if "poser" in imported(p)}
    assert users == {"compare_methods", "live_loop"}


@pytest.mark.parametrize("module", ["mocap", "mocap.formats", "poser.__main__"])
def test_import_is_light(module: str) -> None:
    heavy = ("casadi", "torch", "osqp", "matplotlib", "pinocchio", "vqf")
    code = f"import sys, {module}; print([m for m in {heavy!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_no_path_of_a_machine_and_no_registry_host() -> None:
    tracked = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    bad = re.compile(r"(/work/|/root/|/home/\w|files\.pythonhosted|pypi\.org/simple)")
    for name in tracked:
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".txt", ".sh", ".yml"} or name == "Makefile":
            if path == Path(__file__).resolve():
                continue
            found = bad.search(path.read_text(errors="replace"))
            assert found is None, f"{name}: {found and found.group()}"


# Names that stand in several rooms and mean the same in each, or what the folder says they are.
SAME_THING = {
    "Contact": "feet that stand: a term of sip, the root of the hybrid",
    "Orientation": "what a sensor says of a bone: a term of sip, a task of the hybrid",
    "Model": "of the cost, of a network",
    "Evidence": "all that is known: of a recording for its checks, of frames for their cost",
}
SAME_MODULE = {
    "__init__": "a package",
    "settings": "of that package",
    "errors": "of that package",
    "estimator": "the protocol, and networks behind it",
    "tree": "of the joints, in numpy and in torch",
    "prior": "over poses, and the task that is about it",
    "orientation": "rotations; what a sensor says of a bone, as a term and as a task",
    "contact": "feet that stand, as a term and for the root",
    "model": "of the cost, of a network",
    "references": "reference motions, and the words about them",
}
# A network's folder has the same files; a check, a command and a page are named after what they are about.
MIRRORS = (*(f"learned/{p.parent.name}/" for p in (ROOT / "learned").glob("*/specification.py")),
           "learned/training/deviations", "mocap/calibration/checks/", "poser/commands/",
           "poser/live/sources/", "poser/viewer/live")  # fmt: skip


def repeated(names: dict[str, list[str]], allowed: dict[str, str]) -> dict[str, list[str]]:
    return {k: v for k, v in names.items() if len(v) > 1 and k not in allowed}


def test_a_name_means_one_thing() -> None:
    """Public classes, and files. A new repeat is renamed, or said to be the same thing."""
    classes: dict[str, list[str]] = {}
    stems: dict[str, list[str]] = {}
    for path in modules():
        where = str(path.relative_to(ROOT))
        if not where.startswith(MIRRORS):
            stems.setdefault(path.stem, []).append(where)
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                classes.setdefault(node.name, []).append(where)
    assert repeated(classes, SAME_THING) == {}
    assert repeated(stems, SAME_MODULE) == {}
    # What is allowed and repeated nowhere is no longer needed here.
    assert [k for k in SAME_THING if len(classes.get(k, ())) < 2] == []
    assert [k for k in SAME_MODULE if len(stems.get(k, ())) < 2] == []
