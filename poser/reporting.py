"""A comparison's report in a folder: pictures, the page, and words for its facts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files

if TYPE_CHECKING:
    from mocap.recording import Recording
    from poser.results import Compared, Lost


def write_report(
    folder: Path,
    title: str,
    found: Sequence[Compared | Lost],
    mean: dict[str, Any],
    facts: dict[str, str],
    extra: tuple[tuple[Path, str], ...] = (),
) -> None:
    """Pictures and report.html in `folder`; `extra` pictures come first."""
    from poser import comparison, pictures, report, results

    failures, found = results.failures(found), results.measured(found)
    shown = list(extra)
    worst = comparison.worst(found)
    if worst:
        pictures.save(pictures.pairs(worst), folder / "worst.png")
        caption = "The worst frames of each method: its skeleton, and the reference in grey."
        shown.append((folder / "worst.png", caption))
    bars = comparison.joint_means(found)
    if bars:
        pictures.save(pictures.joints(bars), folder / "joints.png")
        shown.append((folder / "joints.png", "Mean global angle of each joint, nothing masked."))
    if len(found) == 1:
        curves = {n: m.metrics for n, m in found[0].methods.items()}
        pictures.save(pictures.errors(curves), folder / "errors.png")
        shown.append((folder / "errors.png", "Error over time; in brackets the mean."))
    facts = facts | {"Computed with": report.environment()}
    files.write_text(
        folder / "report.html", report.page(title, found, mean, shown, facts, failures)
    )


def noise_words(recording: Recording) -> str:
    """The sizes of the noise that a recording was synthesised with, as far as its notes are readable."""
    sigma = (recording.noise or {}).get("sigma")
    if not isinstance(sigma, Mapping):
        return "of sizes that its notes do not tell"
    sizes = {str(k): _size(v) for k, v in sigma.items()}
    known = [f"{k} {v:g}" for k, v in sizes.items() if v is not None]
    odd = [k for k, v in sizes.items() if v is None]
    if odd:
        known.append(f"{', '.join(odd)} not a number in its notes")
    return ", ".join(known)


def _size(value: Any) -> float | None:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return None
