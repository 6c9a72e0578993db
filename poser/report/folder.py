"""A comparison's report in a folder: pictures, the page, and words for its facts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files
from poser.report.results import NAMES, NO_SKILL

if TYPE_CHECKING:
    from mocap.orientation import Array
    from mocap.recording import Recording
    from poser.report.results import Compared, Lost

WORST = 4  # frames shown of a method, over all recordings
PEAKS = 3  # of one recording, at most
CANDIDATES = 12  # among so many of its worst frames


def write_report(
    folder: Path,
    title: str,
    found: Sequence[Compared | Lost],
    mean: dict[str, Any],
    facts: dict[str, str],
    extra: tuple[tuple[Path, str], ...] = (),
) -> None:
    """Pictures and report.html in `folder`; `extra` pictures come first."""
    from poser import comparison
    from poser.report import page as report
    from poser.report import pictures, results

    failures, found = results.failures(found), results.measured(found)
    shown = list(extra)
    worst = worst_rows(found)
    if worst:
        pictures.save(pictures.pairs(worst), folder / "worst.png")
        caption = (
            "The worst frames of each method, its skeleton and the reference in grey: peaks of its error, "
            "at least 1 s apart."
        )
        shown.append((folder / "worst.png", caption))
    bars = comparison.joint_means(found)
    if bars:
        pictures.save(pictures.joints(bars), folder / "joints.png")
        shown.append((folder / "joints.png", "Mean global angle of each joint, nothing masked."))
    if len(found) == 1:
        pictures.save(pictures.errors(found[0]), folder / "errors.png")
        shown.append((folder / "errors.png", "Error over time; in brackets the mean."))
    facts = facts | {"Computed with": report.environment()}
    files.write_text(
        folder / "report.html", report.page(title, found, mean, shown, facts, failures)
    )


def worst_rows(found: Sequence[Compared]) -> list[tuple[str, list[tuple[str, Array, Array]]]]:
    """Per method the four worst peaks over all recordings, by position error: rows of `pictures.pairs`."""
    rows = []
    for name in dict.fromkeys(n for c in found for n in c.methods if n not in NO_SKILL):
        cells = [cell for c in found if name in c.methods for cell in _worst_cells(c, name)]
        cells.sort(key=lambda cell: -cell[0])
        if cells:
            rows.append((NAMES.get(name, name), [c for _, c in cells[:WORST]]))
    return rows


def _worst_cells(compared: Compared, name: str) -> list[tuple[float, tuple[str, Array, Array]]]:
    """The error, cm, and the cell of each worst frame of a method that is a peak.

    A frame on the slope of a worse one shows the same pose again, however far apart they are.
    """
    from poser import comparison

    result, truth = compared.methods[name], compared.truth
    error = result.metrics.frame_position_cm
    if error is None:
        return []
    rate = truth.rate_hz
    around = max(1, round(rate / 2))
    motion = result.motion.resampled(rate)
    cells: list[tuple[float, tuple[str, Array, Array]]] = []
    for t in comparison.worst_frames(compared, name, CANDIDATES):
        if error[t] < error[max(0, t - around) : t + around + 1].max():
            continue
        k = min(t, len(motion) - 1)
        title = f"{compared.name} {compared.start_s + t / rate:.1f} s\n{error[t]:.1f} cm"
        cells.append((float(error[t]), (title, truth.p_world_joint[k], motion.p_world_joint[k])))
        if len(cells) == PEAKS:
            break
    return cells


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
