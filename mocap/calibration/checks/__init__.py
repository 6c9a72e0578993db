"""What may be wrong with sensors and pose: one file a check, findings out, asked in the order of `CHECKS`.

A check is a function from the `Evidence` to findings. A new one is a file here and a line of the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from mocap.calibration.checks import (
    axes,
    clipping,
    copied,
    facing,
    frozen,
    gaps,
    gravity,
    lags,
    leaning,
    levels,
    movement,
    no_data,
    orientations,
    pairs,
    pose_name,
    posture,
    rates,
    sides,
    slips,
    spikes,
)
from mocap.calibration.evidence import Evidence, gather
from mocap.findings import ORDER, Finding
from mocap.recording import RawRecording

Needs = Literal["sensors", "body", "pose"]
ANY = "any"  # any code at all


@dataclass(frozen=True)
class Errors:
    """Errors with one of these codes; `ANY`: all of them."""

    codes: tuple[str, ...]

    def __contains__(self, f: object) -> bool:
        if not isinstance(f, Finding) or f.severity != "error":
            return False
        return ANY in self.codes or f.code in self.codes


@dataclass(frozen=True)
class Codes:
    """Findings of any severity with one of these codes."""

    codes: tuple[str, ...]

    def __contains__(self, f: object) -> bool:
        return isinstance(f, Finding) and f.code in self.codes


NOTHING = Codes(())


@dataclass(frozen=True)
class Check:
    """One row. needs: the sensors' own data alone; the body that they are on, with sound data; the pose.

    unless: not asked where such a finding was made before. spares: sensors of which such a finding was made
    before are not judged.
    """

    find: Callable[[Evidence], list[Finding]]
    needs: Needs
    unless: Errors | Codes = NOTHING
    spares: Errors | Codes = NOTHING


# What a sensor must have for its turning to be looked at: samples, gravity in m/s^2, a channel that lives.
DUMB = Errors(("no-data",))
UNSOUND = Errors(("no-data", "acc-without-gravity", "acc-in-g", "acc-unit", "frozen"))
SEATED = Codes(("pose-posture", "pose-leaning"))  # arms on the thighs seem to go to the wrong side

CHECKS: tuple[Check, ...] = (
    Check(spikes.check, "sensors"),
    Check(no_data.check, "sensors"),
    Check(gravity.check, "sensors", spares=DUMB),
    Check(clipping.check, "sensors", spares=DUMB),
    Check(frozen.check, "sensors"),
    Check(copied.check, "sensors"),
    Check(rates.check, "sensors", spares=UNSOUND),
    Check(orientations.check, "sensors", spares=UNSOUND),
    Check(axes.check, "sensors", spares=UNSOUND),
    Check(gaps.check, "sensors"),
    Check(lags.check, "sensors", unless=Errors((ANY,))),
    Check(movement.check, "pose"),
    Check(levels.check, "body"),
    Check(slips.check, "pose"),
    Check(leaning.check, "pose"),
    Check(posture.check, "pose"),
    Check(sides.check, "pose", unless=SEATED),
    Check(pairs.check, "pose", unless=SEATED, spares=Codes(("swapped",))),
    Check(pose_name.check, "pose"),
    Check(facing.check, "pose"),
)


@dataclass(frozen=True)
class Explains:
    """A finding `code` explains those with the codes `away`: of the same sensor, or (`all_`) of every one."""

    code: tuple[str, ...]
    away: tuple[str, ...]
    all_: bool = False


EXPLAINS: tuple[Explains, ...] = (
    # A wrong orientation makes right axes seem wrong.
    Explains(
        ("orientation-transposed", "quaternion-order", "orientation-world"),
        ("gyr-axes", "acc-axes", "gyr-in-deg", "gyr-unit"),
    ),
    # Arms that start from another pose than said seem to go to the wrong side.
    Explains(("other-pose",), ("swapped",), all_=True),
    # A sensor on the wrong side is out of step with its supposed neighbours, but its clock is not.
    Explains(("swapped",), ("lag",)),
    # The heading cue of a sensor that slipped is wrong since then.
    Explains(("slipped",), ("heading-off",)),
)


def run(evidence: Evidence, *needs: Needs) -> list[Finding]:
    """What the checks with one of these needs find, in the order of the table; not yet `settled`."""
    found: list[Finding] = []
    about = {evidence.judged: evidence}
    for check in CHECKS:
        if check.needs not in needs or any(f in check.unless for f in found):
            continue
        spared = {f.sensor for f in found if f in check.spares}
        judged = tuple(n for n in evidence.judged if n not in spared)
        if judged:
            found += check.find(about.setdefault(judged, evidence.judging(judged)))
    return found


def settled(findings: Iterable[Finding]) -> list[Finding]:
    """Errors first, without what others explain, and one of each sensor and code: the first."""
    left = list(findings)
    for rule in EXPLAINS:
        whose = {f.sensor for f in left if f.code in rule.code}
        left = [
            f
            for f in left
            if f.code not in rule.away or not whose or not (rule.all_ or f.sensor in whose)
        ]
    once: dict[tuple[str | None, str], Finding] = {}
    for f in left:
        once.setdefault((f.sensor, f.code), f)
    return sorted(once.values(), key=lambda f: ORDER[f.severity])


def failed(findings: Sequence[Finding]) -> bool:
    """Is one of them an error?"""
    return any(f.severity == "error" for f in findings)


def check_sensors(raw: RawRecording) -> list[Finding]:
    """What the sensors' own data say that is wrong with them, `settled`: no pose is needed."""
    return settled(run(gather(raw), "sensors"))
