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
