"""SOP, SIP, DIP and the hybrid on one recording, as `poser compare` does it, from Python.

Every method sees the same six sensors and is measured against the same motion, with the mean angle of the
hips and shoulders, and the mean distance of the joints with the roots aligned:

    sip_deg = mean |Log(R_true^T R)|        position_cm = mean |p - p_true|

Two rows need no skill: the mean pose of the training motion, and its pose whose sensors fit best. A method
that does not beat both has not worked.
Run: python examples/compare_methods.py [--seconds 8] [-o FOLDER]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mocap import sensors, synthesis
from mocap.synthesis import motions
from poser import comparison, files
from poser.console import table
from poser.report import folder as reporting
from poser.report import results

COLUMNS = (
    ("sip_deg", "SIP deg", 1),
    ("position_cm", "position cm", 1),
    ("jitter", "jitter 100 m/s^3", 1),
    ("frame_ms_mean", "ms/frame", 1),
)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=8.0, help="of the built-in motion")
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="write a report to it")
    args = parser.parse_args(argv)
    if args.output and args.output.exists():
        parser.error(f"-o {args.output} exists; name a new folder")

    # Any recording with a reference serves: `poser.files.recording(Path("walk.npz"))` reads one.
    motion = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
    recording = synthesis.recording(motion, sensors.SIX, synthesis.Noise(), rng=0)

    methods = comparison.canonical(("sop", "sip", "dip", "hybrid"))
    job = comparison.Job("builtin", recording, methods, sensors=sensors.SIX, solver="banded")
    compared = comparison.run(job)  # PoserError where no method could be measured

    rows = []
    for name, result in compared.methods.items():
        values = result.to_json()  # every figure: `sorted(values)` names them
        cells = [
            f"{v:.{digits}f}" if (v := values.get(key)) is not None else "-"
            for key, _, digits in COLUMNS
        ]
        rows.append((results.NAMES[name], *cells))
    table(("method", *(heading for _, heading, _ in COLUMNS)), rows)
    for sentence in results.failures([compared]):
        raise SystemExit(sentence)

    # The worst frame of a method, to look at first.
    errors = compared.methods["hybrid-dip"].metrics.frame_position_cm
    assert errors is not None
    worst = comparison.worst_frames(compared, "hybrid-dip", count=1)[0]
    print(f"the hybrid is worst at {worst / recording.rate_hz:.1f} s: {errors[worst]:.1f} cm")

    if args.output:
        files.make_folder(args.output)
        facts = {"Noise, 1 sigma": reporting.noise_words(recording)}
        mean = results.to_json([compared])["mean"]
        reporting.write_report(args.output, "Comparison on builtin", [compared], mean, facts)
        print(f"{args.output / 'report.html'}: the report")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
