"""Sensors strapped on anyhow, calibrated from one still pose, and held against the truth.

    R_world_bone(t) = R_y(heading) R_world_sensor(t) R_bone_sensor^T

The pose shows gravity only, so where the wearer faces has to come from somewhere else: from the
motion, from a known axis of a sensor, or from the user.
Run: python examples/calibrate_raw.py [--seconds 12]
"""

from __future__ import annotations

import argparse

import numpy as np

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.calibration import Calibration, calibrate
from mocap.recording import RawRecording, Recording
from mocap.synthesis import motions

SHORTEST_S = 8.0  # the static pose, 2 s, and the walk after it, 6 s


def bone_error_deg(recording: Recording) -> float:
    """Mean angle between the calibrated bones and the true ones."""
    assert recording.reference is not None
    true = recording.reference.R_world_joint[:, recording.joint]
    use = recording.ori_valid
    angle = ori.angle_between(true[use], recording.R_world_bone[use])
    return float(np.rad2deg(angle.mean()))


def report(name: str, raw: RawRecording, recording: Recording, found: Calibration) -> None:
    start, stop = found.time
    sigma = np.rad2deg(found.heading_sigma.max())
    print(f"{name}: {found.pose.upper()}-pose at {start:.1f} to {stop:.1f} s")
    print(f"  facing: {found.method}, to {sigma:.0f} deg")
    for finding in found.diagnostics:
        print(f"  {finding.severity}: {finding.sentence}")
    print(f"  bones are {bone_error_deg(recording):.1f} deg from the truth")


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=12.0, help="of the built-in motion")
    args = parser.parse_args(argv)
    if args.seconds < SHORTEST_S:
        parser.error(
            f"--seconds {args.seconds:g} is too short: the pose and the walk take {SHORTEST_S:g} s"
        )

    # The built-in motion begins with two seconds of standing in the N-pose. Each raw sensor sits at a
    # random rotation on its bone.
    motion = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
    raw = synthesis.raw_recording(motion, sensors.SIX, synthesis.Noise(), rng=1)

    # The wearer's facing from how the legs swing.
    report("from the motion", raw, *calibrate(raw, pose="n"))

    # The wearer is known to face the sensors' north (+z).
    recording, known = calibrate(raw, pose="n", facing=0.0)
    report("facing given", raw, recording, known)

    # A calibration is text, and applies to other recordings of the same session.
    again = Calibration.from_json(known.to_json()).apply(raw)
    same = np.allclose(again.R_world_bone, recording.R_world_bone, equal_nan=True)
    print(f"saved, read and applied again: {'the same' if same else 'different'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
