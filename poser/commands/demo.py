"""The whole way on the built-in motion, without any data: noisy virtual sensors, every method, a report.

Writes the recording, one motion file a method, results.json, pictures and report.html.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files, options
from poser.console import DONE, Progress, emit, json_text, note, part, progress, say, table

if TYPE_CHECKING:
    from mocap.motion import Motion
    from mocap.recording import Recording
    from poser.report.results import Compared

HELP = "all of it on the built-in motion, with a report"
NAME = "builtin"
SEED = 0
SHORTEST_S = 0.5
PICTURED_S = (1.0, 4.3, 9.5, 12.0, 14.0, 16.1, 19.6)
DEVICES = ("left_wrist", "right_pocket", "head")
"""What IMUPoser sees: a watch, a phone in a pocket, earphones."""


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("poser-demo"), metavar="DIR",
        help="default: poser-demo",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=_seconds, metavar="S", help="only so much of the motion (22.6 s)"
    )
    options.add_json(parser)


def _seconds(text: str) -> float:
    value = options.positive(text)
    if value < SHORTEST_S:
        raise ArgumentTypeError(f"{text!r} is less than {SHORTEST_S:g} s")
    return value


def run(args: Namespace) -> int:
    with files.folder(args.output, single=True):
        return _demo(args)


def _demo(args: Namespace) -> int:
    from mocap import sensors, synthesis
    from mocap.synthesis import motions
    from poser import comparison
    from poser.commands.synthesize import noise_generator
    from poser.report import results
    from poser.report.folder import write_report

    with progress("demo") as tell:
        tell(0.0, "virtual sensors")
        motion = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
        rng = noise_generator(SEED, NAME)
        worn = (*sensors.SIX, *(d for d in DEVICES if d not in sensors.SIX))
        recording = synthesis.recording(motion, worn, synthesis.NOISES["realistic"], rng)
        files.write(args.output / f"{NAME}.npz", recording)
        job = comparison.Job(NAME, recording, comparison.METHODS, sensors.SIX, DEVICES)
        compared = comparison.run(job, _told(part(tell, 0.02, 0.9)))
        tell(0.9, "pictures and report")
        files.write(args.output / "reference.npz", compared.truth)
        for name, result in compared.methods.items():
            files.write(args.output / f"{name}.npz", result.motion)
        found = results.to_json([compared])
        files.write_text(args.output / "results.json", json_text(found) + "\n")
        poses = args.output / "poses.png"
        _picture(poses, compared.truth, compared)
        write_report(
            args.output, "Every method on the built-in motion", [compared], found["mean"],
            _facts(recording, compared), ((poses, "Every method at several times."),),
        )  # fmt: skip
    for sentence in results.failures([compared]):
        note(sentence)
    if args.json:
        emit(found)
        return DONE
    table(*results.rows(found["mean"]))
    say(
        f"{args.output / 'report.html'} has the pictures, {args.output / 'results.json'} all figures"
    )
    return DONE


def _told(tell: Progress) -> Progress:
    """Where there is no terminal for a bar: a line on stderr for each method as it begins."""
    import sys

    begun: set[str] = set()

    def report(fraction: float, text: str) -> None:
        method = text.split(":")[0]
        if method not in begun and not sys.stderr.isatty():
            begun.add(method)
            print(f"poser demo: {method}", file=sys.stderr, flush=True)
        tell(fraction, text)

    return report


def _picture(path: Path, truth: Motion, compared: Compared) -> None:
    from poser.report import pictures
    from poser.report.results import NO_SKILL

    times = [t for t in PICTURED_S if t < truth.seconds] or [truth.seconds / 2]
    shown: dict[str, Any] = {"reference": truth}
    shown |= {n: m.motion for n, m in compared.methods.items() if n not in NO_SKILL}
    pictures.save(pictures.skeletons(shown, times), path)


def _facts(recording: Recording, compared: Compared) -> dict[str, str]:
    from mocap import sensors
    from poser.report.folder import noise_words

    facts = {
        "Motion": f"built-in (standing, walking, squat, arms, jumping jacks, leg raises), "
        f"{recording.seconds:.1f} s at {recording.rate_hz:g} Hz, low-passed at 8 Hz",
        "Sensors": f"{', '.join(sensors.SIX)}; IMUPoser: {', '.join(DEVICES)}",
        "Noise, 1 sigma": f"{noise_words(recording)}; seed {SEED}",
    }
    for name in (m for m in ("sop", "sip") if m in compared.methods):
        f = compared.methods[name].figures
        facts[name.upper()] = f"{f['seconds']:.1f} s, {f['iterations']} iterations: {f['status']}"
    facts["Mean pose, nearest pose"] = "from the poses that the prior was made of"
    return facts
