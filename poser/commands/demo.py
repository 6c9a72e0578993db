"""The whole way on the built-in motion, without any data: six noisy virtual sensors, SOP and SIP.

Writes the recording, one motion file a method, results.json, pictures and report.html.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files, options
from poser.console import DONE, Progress, emit, json_text, part, progress, say, table

if TYPE_CHECKING:
    from mocap.motion import Motion
    from mocap.recording import Recording
    from poser.results import Compared, Result

HELP = "all of it on the built-in motion, with a report"
NAME = "builtin"
SEED = 0
PICTURED_S = (1.0, 4.3, 9.5, 12.0, 14.0, 16.1, 19.6)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("poser-demo"), metavar="DIR",
        help="default: poser-demo",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=options.positive, metavar="S", help="only so much of the motion (22.6 s)"
    )
    options.add_json(parser)


def run(args: Namespace) -> int:
    from mocap import sensors, synthesis
    from poser import motions, results
    from poser.commands.synthesize import noise_generator

    files.make_folder(args.output)
    with progress("demo") as tell:
        tell(0.0, "virtual sensors")
        motion = synthesis.prepare(motions.builtin(seconds=args.seconds), 60.0, 8.0)
        rng = noise_generator(SEED, NAME)
        recording = synthesis.recording(motion, sensors.SIX, synthesis.NOISES["realistic"], rng)
        methods = {}
        for name, start, stop in (("sop", 0.02, 0.25), ("sip", 0.25, 0.85)):
            methods[name] = _solved(recording, name, part(tell, start, stop, name.upper()))
        tell(0.85, "mean and nearest pose")
        methods |= _no_skill(recording)
        compared = results.Compared(NAME, "the built-in motion", methods)
        tell(0.9, "pictures and report")
        found = results.to_json([compared])
        _write(args.output, recording, compared, found)
    if args.json:
        emit(found)
        return DONE
    table(*results.rows(found["mean"]))
    say(
        f"{args.output / 'report.html'} has the pictures, {args.output / 'results.json'} all figures"
    )
    return DONE


def _solved(recording: Recording, terms: Any, tell: Progress) -> Result:
    import sip
    from poser.commands.solve import record

    solution = sip.solve(recording, settings=sip.Settings(terms=terms), progress=tell)
    return _result(recording, solution.motion, record(solution))


def _no_skill(recording: Recording) -> dict[str, Result]:
    """The two rows that need no skill, from the prior's mean and its bank of poses."""
    from mocap import noskill
    from sip.prior import shipped

    prior = shipped()
    return {
        "mean-pose": _result(recording, noskill.mean_pose(recording, prior.mean)),
        "nearest-pose": _result(recording, noskill.nearest_pose(recording, prior.poses)),
    }


def _result(recording: Recording, motion: Motion, figures: dict[str, Any] | None = None) -> Result:
    from mocap import metrics
    from poser.results import Result
    from poser.staging import on_the_floor

    found = metrics.evaluate(
        motion, recording.reference, recording=recording, seen=recording.sensors
    )
    return Result(on_the_floor(motion), found, figures or {})


def _write(folder: Path, recording: Recording, compared: Compared, found: dict[str, Any]) -> None:
    from poser import report

    assert recording.reference is not None
    files.write(folder / f"{NAME}.npz", recording)
    files.write(folder / "reference.npz", recording.reference)
    for name, result in compared.methods.items():
        files.write(folder / f"{name}.npz", result.motion)
    files.write_text(folder / "results.json", json_text(found) + "\n")
    text = report.page(
        "Six virtual sensors on the built-in motion",
        found["mean"],
        _pictures(folder, recording.reference, compared),
        _facts(recording, compared),
    )
    files.write_text(folder / "report.html", text)


def _pictures(folder: Path, truth: Motion, compared: Compared) -> list[tuple[Path, str]]:
    from poser import pictures

    times = [t for t in PICTURED_S if t < truth.seconds] or [truth.seconds / 2]
    shown = {"reference": truth, **{n: compared.methods[n].motion for n in ("sop", "sip")}}
    metrics = {n: m.metrics for n, m in compared.methods.items()}
    solved = {n: metrics[n] for n in ("sop", "sip")}
    figures = (
        (
            "poses.png",
            pictures.skeletons(shown, times),
            "The reference, SOP and SIP at several times.",
        ),
        ("errors.png", pictures.errors(metrics), "Error over time; in brackets the mean."),
        ("joints.png", pictures.joints(solved), "Mean global angle of each joint, nothing masked."),
    )
    out = []
    for name, figure, caption in figures:
        pictures.save(figure, folder / name)
        out.append((folder / name, caption))
    return out


def _facts(recording: Recording, compared: Compared) -> dict[str, str]:
    from poser import report

    sigma = (recording.noise or {}).get("sigma", {})
    facts = {
        "Motion": f"built-in (standing, walking, squat, arms, jumping jacks, leg raises), "
        f"{recording.seconds:.1f} s at {recording.rate_hz:g} Hz, low-passed at 8 Hz",
        "Sensors": ", ".join(recording.sensors),
        "Noise, 1 sigma": ", ".join(f"{k} {v:g}" for k, v in sigma.items()) + f"; seed {SEED}",
    }
    for name in ("sop", "sip"):
        f = compared.methods[name].figures
        facts[name.upper()] = f"{f['seconds']:.1f} s, {f['iterations']} iterations: {f['status']}"
    facts["Mean pose, nearest pose"] = "from the poses that the prior was made of"
    facts["Computed with"] = report.environment()
    return facts
