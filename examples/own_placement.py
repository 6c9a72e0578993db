"""Sensors at seats of one's own, and what it is worth to tell the solver where they sit.

A sensor turns with one joint j and sits at a seat s, in m, in that bone's rest frame. It measures

    R_j(t)    and    a(t) = d^2/dt^2 (p_j(t) + R_j(t) s)

so a wrong seat leaves the orientation right and the acceleration wrong: SIP believes it, SOP does not ask.
Here straps at the ankles, 24 cm below the table's shank sensors, and a sensor on the middle of the back,
whose joint has no place in the table at all.
Run: python examples/own_placement.py [--seconds 5]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import sip
from mocap import orientation as ori
from mocap import synthesis
from mocap.evaluation import metrics
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.seats import second_difference, sensor_positions
from mocap.sensors import PLACES
from mocap.skeleton import JOINTS
from mocap.synthesis import motions
from poser.console import table

Seat = tuple[
    int, tuple[float, float, float]
]  # joint, position on its bone in m: docs/conventions.md


def of_table(name: str) -> Seat:
    return PLACES[name].joint, PLACES[name].position


OWN: dict[str, Seat] = {
    "pelvis": of_table("pelvis"),
    "left_forearm": of_table("left_forearm"),
    "right_forearm": of_table("right_forearm"),
    "left_ankle_strap": (JOINTS.index("left_knee"), (0.04, -0.36, 0.0)),
    "right_ankle_strap": (JOINTS.index("right_knee"), (-0.04, -0.36, 0.0)),
    "mid_back": (JOINTS.index("spine2"), (0.0, 0.05, -0.12)),
}
# What one would say who knows the table's places only.
NEAREST = OWN | {
    "left_ankle_strap": of_table("left_shank"),
    "right_ankle_strap": of_table("right_shank"),
    "mid_back": of_table("upper_back"),
}


def arrays(seats: dict[str, Seat]) -> tuple[np.ndarray, np.ndarray]:
    """joint (S,) and placement (S,3) m, as a Recording carries them."""
    joint, placement = zip(*seats.values(), strict=True)
    return np.array(joint), np.array(placement, float)


def worn(motion: Motion, seats: dict[str, Seat], noise: synthesis.Noise, seed: int) -> Recording:
    """Virtual sensors at any seats; `synthesis.recording` does the same for the table's names."""
    joint, placement = arrays(seats)
    rng = np.random.default_rng(seed)
    d = synthesis.draw(noise, rng, len(motion), len(seats), motion.rate_hz, motion.skeleton)
    body = motion.on(d.skeleton)
    R = body.R_world_joint[:, joint] @ d.tissue @ d.R_bone_sensor
    p = sensor_positions(body, joint, placement + d.seat)
    acc = second_difference(p, motion.rate_hz) + d.white  # NaN, unknown, at both ends
    acc += np.einsum("tsij,sj->tsi", R, d.bias)
    turn = ori.rot_y(d.heading)
    return Recording(
        motion.rate_hz, tuple(seats), turn @ R, np.einsum("tsij,tsj->tsi", turn, acc),
        valid=~d.lost, joint=joint, placement=placement, reference=motion,
    )  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=5.0, help="of the built-in motion")
    args = parser.parse_args(argv)

    motion = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
    recording = worn(motion, OWN, synthesis.Noise(), seed=0)
    joint, placement = arrays(NEAREST)
    misplaced = replace(recording, joint=joint, placement=placement)  # same numbers, other seats

    rows, error = [], {}
    for name, terms, told in (
        ("SIP, own seats", "sip", recording),
        ("SOP, own seats", "sop", recording),
        ("SIP, the table's nearest", "sip", misplaced),
    ):
        solution = sip.solve(told, settings=sip.Settings(terms=terms, solver="banded"))
        m = metrics.evaluate(solution.motion, recording.reference, recording=recording)
        error[name] = m.position_cm
        rows.append((name, f"{m.sip_deg:.1f}", f"{m.position_cm:.1f}", f"{m.jitter:.1f}"))
    table(("solved with", "SIP deg", "position cm", "jitter 100 m/s^3"), rows)
    worth = error["SIP, the table's nearest"] - error["SIP, own seats"]
    print(f"telling the seats is worth {worth:.1f} cm")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
