"""What the diagnostics of raw recordings find: `python benchmarks/diagnostics.py`.

Reversed axes: of 18 axes of six sensors on 22 s of the built-in motion, how many are named, for acc and gyr,
by file orientation and from gyr and acc alone. Exchanged sides (needs the data): the score of shanks and
forearms (`mocap.side_checks`) on clips of 8 to 20 s of validation and test subjects after an N-pose of 2 s,
sensors with the realistic noise; that of the exchanged pair is its negative. Clips whose rig flips are left
out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from common import machine, row, seed_of

from learned.corpus import FLIP_RAD
from mocap import Motion, RawRecording, dataset, fusion, sensors, side_checks, static_pose
from mocap import orientation as ori
from mocap.calibration import calibrate
from mocap.sensor_checks import check_sensors
from mocap.synthesis import NOISES, raw_recording
from poser.motions import builtin
from poser.staging import with_static_pose

END_JOINTS = [7, 8, 12, 15, 20, 21]


def reversed_axes(raw: RawRecording, what: str) -> tuple[int, int]:
    """Axes of `what` (acc or gyr) of all sensors that are named when reversed, and all."""
    named = 0
    for s, name in enumerate(raw.sensors):
        for k in range(3):
            values = getattr(raw, what).copy()
            values[:, s, k] *= -1
            wrong = check_sensors(replace(raw, **{what: values}))
            named += any(f.sensor == name and f.code.endswith("axes") for f in wrong)
    return named, 3 * len(raw.sensors)


def clips() -> Iterator[tuple[str, Motion]]:
    for split in ("validation", "test"):
        for name, motion in dataset.clips(split, ("cmu",), 60.0, 8.0, 20.0):  # type: ignore[arg-type]
            if (ori.angle(motion.R_parent_joint[:, END_JOINTS]) < FLIP_RAD).all():
                yield name, motion


def scores(raw: RawRecording) -> dict[str, float]:
    """Score of either kind, facing as the calibration finds it."""
    _, found = calibrate(raw, pose="n", at=1.0, strict=False)
    fused = raw if raw.R_world_sensor is not None else fusion.with_orientation(raw)
    pose = static_pose.average(fused, static_pose.find_static(fused, 1.0))
    return {
        kind: side_checks.side_score(fused, pose, -found.heading, kind)
        for kind in side_checks.WEIGHTS
    }


def main() -> None:
    print(machine())
    motion = builtin(60.0, 22.6).turned(0.7)
    for noise, settings in NOISES.items():
        raw = replace(raw_recording(motion, sensors.SIX, settings, 0), mag=None)
        for way, seen in (("file", raw), ("gyr+acc", replace(raw, R_world_sensor=None))):
            for what in ("acc", "gyr"):
                named, count = reversed_axes(seen, what)
                print(f"noise {noise}, {way}: {named} of {count} reversed axes of {what} named")
    widths = (10, 8, 8, 8, 14, 14)
    print(row(("pair", "way", "clips", "least", "named swapped", "named right"), widths))
    found: dict[tuple[str, str], list[float]] = {}
    for name, motion in clips():
        raw = raw_recording(
            with_static_pose(motion, "n", 2.0), sensors.SIX, NOISES["realistic"], seed_of(name)
        )
        for way, seen in (("file", raw), ("vqf", replace(raw, R_world_sensor=None, mag=None))):
            for kind, score in scores(seen).items():
                found.setdefault((kind, way), []).append(score)
    for (kind, way), values in found.items():
        limit, v = side_checks.EXCHANGED[kind], np.array(values)
        cells = (f"{v.min():.2f}", int((-v < limit).sum()), int((v < limit).sum()))
        print(row((kind, way, len(v), *cells), widths))


if __name__ == "__main__":
    main()
