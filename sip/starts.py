"""Several starts, judged by the cost that they end with.

The cost is not convex: from a far start an arm can stay in another valley (the design's boxing clip, and
modern dance on the test split). The valleys cannot be told apart by residuals of the sensors alone, but their
costs can be compared, because the problem is the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from mocap import orientation as ori
from mocap.errors import SolveError
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from mocap.solution import Solution
from sip.belief import PoseBelief
from sip.settings import Settings
from sip.solve import Progress, share, solve

Start = Literal["prior"] | Motion


def cheapest(
    recording: Recording,
    starts: Mapping[str, Start],
    skeleton: Skeleton | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    belief: PoseBelief | None = None,
) -> Solution:
    """The solution of least cost among those from each of the named starts.

    Its report has "starts": cost, iterations and seconds by name; "start": the name of the one kept; and with
    two starts or more "starts_apart_deg": the largest mean angle over frames and joints, of another solution
    to the kept one, between 0 where all found the same and tens of degrees where valleys differ. seconds
    are those of all solves. Self-calibration keeps what it counts as evidence per solve, so costs are
    compared without it only: SolveError. Raises what `sip.solve` raises.
    """
    settings = settings or Settings()
    if not starts:
        raise SolveError("no start is given")
    if len(starts) > 1 and settings.self_calibration:
        raise SolveError("with self-calibration the costs of several starts cannot be compared")
    found: dict[str, Solution] = {}
    for k, (name, start) in enumerate(starts.items()):
        tell = share(progress, k, len(starts), f"from {name}: " if len(starts) > 1 else "")
        found[name] = solve(recording, skeleton, replace(settings, start=start), tell, belief)
    best = min(found, key=lambda name: found[name].total_cost)
    kept = found[best]
    report = kept.report | {
        "start": best,
        "starts": {
            name: {"cost": s.total_cost, "iterations": s.iterations, "seconds": s.seconds}
            for name, s in found.items()
        },
    }
    if len(found) > 1:
        report["starts_apart_deg"] = max(
            float(np.rad2deg(_apart(s.motion, kept.motion))) for n, s in found.items() if n != best
        )
    return replace(kept, report=report, seconds=sum(s.seconds for s in found.values()))


def _apart(a: Motion, b: Motion) -> float:
    """Mean angle in rad over frames and joints."""
    return float(ori.angle_between(a.R_world_joint, b.R_world_joint).mean())
