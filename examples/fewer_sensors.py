"""What each sensor is worth: the same motion from seventeen, six and fewer sensors.

Bones whose sensors were left out are compared with what those sensors measured, so that this works on
real recordings too, where no truth is known.
Run: python examples/fewer_sensors.py [--seconds 8]
"""

from __future__ import annotations

import argparse

import sip
from mocap import sensors, synthesis
from mocap.evaluation import metrics
from mocap.synthesis import motions
from poser.console import table

SETS: dict[str, tuple[str, ...]] = {
    "a full suit": sensors.SUIT,
    "six": sensors.SIX,
    "without head": tuple(n for n in sensors.SIX if n != "head"),
    "pelvis and shanks": ("pelvis", "left_shank", "right_shank"),
    "pelvis alone": ("pelvis",),
}


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=8.0, help="of the built-in motion")
    args = parser.parse_args(argv)

    motion = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
    everything = synthesis.recording(motion, sensors.SUIT, synthesis.Noise(), rng=0)

    rows = []
    for name, seen in SETS.items():
        solution = sip.solve(everything.select(seen), settings=sip.Settings(solver="banded"))
        m = metrics.evaluate(solution.motion, everything.reference, recording=everything, seen=seen)
        # What was left out: no solver stands between these sensors and the figure.
        left_out = "-" if m.left_out_deg is None else f"{m.left_out_deg:.1f}"
        rows.append((name, str(len(seen)), f"{m.sip_deg:.1f}", f"{m.position_cm:.1f}", left_out))
    table(("sensors", "number", "SIP deg", "position cm", "left out deg"), rows)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
