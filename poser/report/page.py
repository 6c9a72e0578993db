"""One HTML page about a comparison: tables, pictures, skeletons that play. Nothing is fetched."""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from poser.report import skeletons
from poser.report.results import Compared, rows
from poser.report.templating import fill


def page(
    title: str,
    recordings: Sequence[Compared],
    mean: Mapping[str, Mapping[str, Any]],
    pictures: Sequence[tuple[Path, str]],
    facts: Mapping[str, str],
    failures: Sequence[str] = (),
) -> str:
    """The page. mean: of `results.json`. pictures: PNG files and their captions, embedded.

    facts: what was run, on what, with which numbers. failures: sentences about what could not be measured.
    Raises OSError where a picture cannot be read.
    """
    header, body = rows(mean)
    return fill(
        "page.html",
        title=title,
        header=header,
        body=body,
        failures=failures,
        player=skeletons.section(recordings),
        pictures=[_picture(path, caption) for path, caption in pictures],
        each=[_one(r) for r in recordings] if len(recordings) > 1 else [],
        facts=facts,
    )


def _picture(path: Path, caption: str) -> dict[str, str]:
    return {"caption": caption, "data": base64.b64encode(path.read_bytes()).decode("ascii")}


def _one(recording: Compared) -> dict[str, Any]:
    """The table of one recording."""
    header, body = rows({name: m.to_json() for name, m in recording.methods.items()})
    return {
        "name": recording.name, "reference": recording.reference, "header": header, "body": body,
    }  # fmt: skip


def environment(
    packages: Sequence[str] = ("poser-imu", "numpy", "scipy", "casadi", "pin", "torch", "osqp"),
) -> str:
    """Versions of what computed, and the kind of machine."""
    found = [f"Python {platform.python_version()}"]
    for name in packages:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return f"{', '.join(found)}; {platform.system()} {platform.machine()}"
