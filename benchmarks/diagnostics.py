"""What the diagnostics of raw recordings find: `python benchmarks/diagnostics.py`.

Reversed axes: of 18 axes of six sensors on 22 s of the built-in motion, how many are named, for acc and gyr,
by file orientation and from gyr and acc alone. Exchanged sides of six sensors with the realistic noise: how
often `calibrate` names exchanged shanks, exchanged forearms, and right pairs, on the built-in motion over
SEEDS seeds of the noise, as it is and after 3 s in the N-pose, and (needs the data) on clips of 8 to 20 s
of validation and test subjects after an N-pose of 2 s, but those with a fault of the capture. Arms exchanged
with legs: the same of suits, hand with foot and forearm with shank of one side.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

from common import machine, row, seed_of

from mocap import Motion, RawRecording, dataset, sensors
from mocap.calibration import calibrate, fusion
from mocap.calibration.checks.single import check_sensors
from mocap.synthesis import NOISES, raw_recording
from mocap.synthesis.motions import builtin
from mocap.synthesis.staging import with_static_pose

SEEDS = 10
WIDTHS = (18, 6, 8, 8, 8, 10)


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
            if motion.trusted is None or motion.trusted.all():
                yield name, with_static_pose(motion, "n", 2.0)
    for name, motion in dataset.clips("validation", ("bandai",), 60.0, 8.0, 20.0):
        yield name, with_static_pose(motion, "n", 2.0)


def exchanged(a: str, b: str) -> dict[str, str]:
    return {a: b, b: a}


def sides(kind: str) -> dict[str, str]:
    return exchanged(f"left_{kind}", f"right_{kind}")


MISTAKES: dict[str, dict[str, str]] = {
    "none": {},
    "shank": sides("shank"),
    "forearm": sides("forearm"),
}
MISPLACED: dict[str, dict[str, str]] = {
    "none": {},
    "hand with foot": exchanged("left_hand", "left_foot"),
    "forearm with shank": exchanged("left_forearm", "left_shank"),
}


def named(raw: RawRecording) -> set[str | None]:
    """Sensors that the calibration says are exchanged."""
    at = raw.start_s + 1.0
    return {
        f.sensor for f in calibrate(raw, at=at, strict=False)[1].diagnostics if f.code == "swapped"
    }


def count(recordings: Iterable[RawRecording], mistakes: dict[str, dict[str, str]]) -> Counter[str]:
    """How often each mistake is named as it is; "none": right ones that are accused."""
    found: Counter[str] = Counter()
    for raw in recordings:
        found["recordings"] += 1
        for mistake, pairs in mistakes.items():
            who = named(raw.renamed(pairs))
            found[mistake] += bool(who) if mistake == "none" else set(pairs) <= who
    return found


def both_ways(
    motions: Iterable[tuple[int, Motion]], places: tuple[str, ...]
) -> tuple[list[RawRecording], list[RawRecording]]:
    """What sensors read with the orientation of the file, and with that of VQF without a magnetometer."""
    file = [
        replace(raw_recording(m, places, NOISES["realistic"], seed), mag=None)
        for seed, m in motions
    ]
    return file, [fusion.with_orientation(replace(raw, R_world_sensor=None)) for raw in file]


def report(what: str, motions: Iterable[tuple[int, Motion]]) -> None:
    for way, recordings in zip(("file", "vqf"), both_ways(motions, sensors.SIX), strict=True):
        found = count(recordings, MISTAKES)
        print(
            row(
                (what, way, *(found[x] for x in ("recordings", "shank", "forearm", "none"))), WIDTHS
            )
        )


def main() -> None:
    print(machine())
    motion = builtin(60.0, 22.6).turned(0.7)
    for noise, settings in NOISES.items():
        raw = replace(raw_recording(motion, sensors.SIX, settings, 0), mag=None)
        for way, seen in (("file", raw), ("gyr+acc", replace(raw, R_world_sensor=None))):
            for what in ("acc", "gyr"):
                reversed_, all_ = reversed_axes(seen, what)
                print(f"noise {noise}, {way}: {reversed_} of {all_} reversed axes of {what} named")
    print(row(("exchanged sides of", "way", "number", "shanks", "forearms", "right ones"), WIDTHS))
    report("built-in", ((seed, motion) for seed in range(SEEDS)))
    posed = with_static_pose(motion, "n", 3.0)
    report("N-pose, built-in", ((seed, posed) for seed in range(SEEDS)))
    people = [(seed_of(name), motion) for name, motion in clips()]
    report("other people", people)
    suits = both_ways(people, sensors.SUIT)[0]
    for mistake, number in count(suits, MISPLACED).items():
        print(f"suits of other people, exchanged: {mistake}: {number}")


if __name__ == "__main__":
    main()
