"""Virtual sensors on a motion, and the motion back from them: SIP beside SOP.

SIP minimises, over the poses of all frames at once,

    sum |Log(R_measured^T R_bone(x))|^2 / sigma_R^2  +  sum |a_measured - a(x)|^2 / sigma_a^2  +  prior(x)

SOP is the same without the second sum. Run: python examples/synthesize_and_solve.py [--seconds 8]
"""

from __future__ import annotations

import argparse

import sip
from mocap import sensors, synthesis
from mocap.evaluation import metrics
from mocap.synthesis import motions


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=8.0, help="of the built-in motion")
    args = parser.parse_args(argv)

    # A motion made by formula: 60 Hz, the floor is y = 0. Any file works too:
    # `mocap.formats.read("walk.bvh").content` is a Motion.
    motion = motions.builtin(seconds=args.seconds)

    # Sensors are differentiated twice, so the motion is low-passed first.
    prepared = synthesis.prepare(motion, rate_hz=60.0, lowpass_hz=8.0)
    recording = synthesis.recording(prepared, sensors.SIX, synthesis.Noise(), rng=0)
    print(f"{len(recording)} frames of {', '.join(recording.sensors)}")
    print(f"lost samples: {(~recording.valid).mean():.1%}")

    for terms in ("sop", "sip"):
        settings = sip.Settings(terms=terms, solver="banded")
        solution = sip.solve(recording, settings=settings)
        m = metrics.evaluate(solution.motion, recording.reference, recording=recording)
        print(
            f"{terms.upper()}: {solution.status}, {solution.seconds:.1f} s; "
            f"hips and shoulders {m.sip_deg:.1f} deg, joints {m.position_cm:.1f} cm"
        )
        # How well each term's assumption fits: 1 means as its sigma says.
        print(
            "     rms in sigmas: " + ", ".join(f"{k} {v:.2f}" for k, v in solution.sigmas.items())
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
