"""Offline poses for a calibrated recording: SIP, or SOP (SIP without accelerations)."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.errors import PoserError
from poser import files, named_starts, options
from poser.console import DONE, UsageError, emit, note, progress, say, table
from poser.exports import SUFFIXES

if TYPE_CHECKING:
    import numpy as np

    import sip
    from mocap.motion import Motion
    from mocap.recording import Recording
    from mocap.skeleton import Skeleton
    from mocap.solution import Solution

HELP = "offline poses from a recording: SIP or SOP"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="REC", help="a calibrated recording")
    options.add_motion_output(parser)
    parser.add_argument("--terms", choices=("sip", "sop"), default="sip", help="default: sip")
    parser.add_argument("--sensors", metavar="S", help=f"{options.SENSORS_HELP} (default: all)")
    parser.add_argument(
        "--solver",
        choices=("ipopt", "ipopt-cold", "banded"),
        default="ipopt",
        help="banded start and IPOPT finish (default), IPOPT alone, or no finish: banded takes about 0.4 of "
        "the default's time with the sensors of a suit, 0.6 with six",
    )
    parser.add_argument(
        "--start",
        metavar="prior|horizon|dip|imuposer|MOTION",
        help="where the solver starts: the prior (default), a window that follows the recording forward and "
        "backward (horizon; beside the prior, for poses far from everyday ones), a network's poses, or a "
        "motion file; of several, separated by commas, the cheapest solution is kept",
    )
    parser.add_argument(
        "--prior",
        choices=("static", "network"),
        default="static",
        help="what is known of poses beforehand: training motion's mean and spread (default), or also what "
        "a network says of each frame: dip with all six sensors, else imuposer. The solver then starts from "
        "both, where --start does not say otherwise and nothing is calibrated",
    )
    body = parser.add_argument_group("the body (default: the neutral mean shape)")
    body.add_argument("--height", type=options.stature, metavar="M", help="stature in m")
    body.add_argument(
        "--betas",
        type=options.numbers,
        metavar="B,B,...",
        help="SMPL shape, with --smpl; --betas=-1,2 where the first is negative",
    )
    body.add_argument("--smpl", type=Path, metavar="FILE", help="your SMPL body file")
    parser.add_argument(
        "--self-calibrate",
        action="store_true",
        help="estimate each sensor's mounting, heading and bias too",
    )
    parser.add_argument(
        "--uncertainty", action="store_true", help="store std_rad (T,24,3) with the motion"
    )
    parser.add_argument(
        "--plot", type=Path, metavar="PNG", help="residuals of each sensor over time, as a picture"
    )
    options.add_window(parser)
    options.add_solving_rate(parser)
    options.add_json(parser)


def run(args: Namespace) -> int:
    if args.betas and not args.smpl:
        raise UsageError("argument --betas: needs the body file they shape: --smpl FILE")
    if args.smpl and args.height:
        raise UsageError("argument --height: not with --smpl, whose betas give the size")
    names = named_starts.names(args.start or "prior")
    if (len(names) > 1 or "horizon" in names) and args.self_calibrate:
        raise UsageError(
            "argument --start: one only with --self-calibrate, where costs do not compare"
        )
    given = [Path(name) for name in names if name not in named_starts.KNOWN]
    for path in given:
        files.check_there(path, "--start", named_starts.KNOWN)
    inputs = [args.recording, *given, *([args.smpl] if args.smpl else [])]
    files.check_output(args.output, inputs, SUFFIXES)
    if args.plot:
        files.check_output(args.plot, [args.recording, args.output], (".png",))
    options.check_uncertainty(args)
    whole = files.recording(args.recording, gaps=False)
    with files.about(args.recording):
        chosen = whole.select(options.sensors(args.sensors, whole.sensors))
        asked, _ = cut_window(chosen, args.begin, args.end)
    files.note_gaps(args.recording, asked, whole)
    whole = files.thinned(args.recording, whole, args.rate)
    with files.about(args.recording):
        recording, first = cut_window(whole.select(chosen.sensors), args.begin, args.end)
    body = _body(args)
    settings = _settings(args)
    begin = named_starts.motions(names, args.recording, whole, recording, first, body, settings)
    belief = None
    if args.prior == "network":
        network = named_starts.network(recording.sensors)
        belief = named_starts.belief(network, args.recording, recording)
        if args.start is None and not args.self_calibrate:
            begin[network] = belief.motion(recording.rate_hz, body, recording.start_s)
    solution = _solve(args, recording, body, begin, belief, settings)
    files.write(args.output, *_given_back(solution, asked, args.uncertainty), timed=True)
    if args.plot:
        from poser.report import pictures

        pictures.save(pictures.residuals(solution, recording.sensors), args.plot)
    report(args, recording, solution, asked)
    return DONE


def _settings(args: Namespace) -> sip.Settings:
    import sip

    return sip.Settings(
        terms=args.terms,
        solver=args.solver,
        self_calibration=args.self_calibrate,
        uncertainty=args.uncertainty,
    )


def _solve(
    args: Namespace,
    recording: Recording,
    body: Skeleton,
    begin: dict[str, sip.Start],
    belief: sip.PoseBelief | None,
    settings: sip.Settings,
) -> Solution:
    from dataclasses import replace

    import sip
    from mocap.synthesis.staging import on_the_floor

    with progress(f"solving {args.recording.name}") as tell, files.about(args.recording):
        solution = sip.cheapest(recording, begin, body, settings, tell, belief)
    return replace(solution, motion=on_the_floor(solution.motion))


def _given_back(
    solution: Solution, recording: Recording, uncertainty: bool
) -> tuple[Motion, dict[str, np.ndarray] | None]:
    """The motion at every frame of `recording`, and its deviations where they were asked for."""
    from mocap import thinning

    motion = thinning.given_back(solution.motion, recording)
    if solution.std_rad is None or not uncertainty:
        return motion, None
    std = thinning.deviations_given_back(solution.std_rad, solution.motion, recording)
    return motion, {"std_rad": std}


def _body(args: Namespace) -> Skeleton:
    from mocap.skeleton import Skeleton

    if args.smpl:
        return Skeleton.from_smpl_file(args.smpl, args.betas)
    return Skeleton.default(args.height)


def cut_window(
    recording: Recording, begin: float | None, end: float | None
) -> tuple[Recording, int]:
    """The frames from `begin` to before `end`, s on the recording's clock, and the first one's number."""
    if begin is None and end is None:
        return recording, 0
    rate, origin = recording.rate_hz, recording.start_s
    # A number that is too large for a frame's is one before or behind all of them.
    a = 0 if begin is None else round(min(max((begin - origin) * rate, 0), len(recording)))
    b = len(recording) if end is None else round(min(max((end - origin) * rate, 0), len(recording)))
    if b - a < 1:
        since = "" if begin is None else f" from {begin:g} s"
        until = "" if end is None else f" to {end:g} s"
        last = round(origin + recording.seconds, 3)
        raise PoserError(
            f"no frame{since}{until or ' on'}: it runs from {round(origin, 3):g} s to {last:g} s"
        )
    return recording.slice(a, b), a


def record(solution: Solution) -> dict[str, Any]:
    """What `results.json` and `--json` say of a solution; cost in sigma^2, seconds of solving alone."""
    out: dict[str, Any] = {
        "status": solution.status,
        "converged": solution.converged,
        "seconds": solution.seconds,
        "iterations": solution.iterations,
        "frames": len(solution.motion),
        "cost": solution.cost,
        "total_cost": solution.total_cost,
        "sigmas": solution.sigmas,
        "gradient_norm": solution.gradient_norm,
        "report": solution.report,
    }
    if solution.sensors is not None:
        out["sensors"] = solution.sensors
    return out


def report(args: Namespace, recording: Recording, solution: Solution, asked: Recording) -> None:
    """The answer: JSON, or a table of the terms and a sentence. asked: whose frames were written."""
    if args.json:
        extra = {
            "terms": args.terms,
            "solver": args.solver,
            "start": args.start,
            "used_sensors": list(recording.sensors),
            "frames": len(asked),
            "rate_hz": asked.rate_hz,
            "estimated_hz": recording.rate_hz,
            "motion": str(args.output),
        }
        emit(record(solution) | extra)
        return
    table(
        ("term", "cost", "rms in sigmas"),
        [
            (
                name,
                f"{cost:.1f}",
                f"{solution.sigmas[name]:.2f}" if name in solution.sigmas else "-",
            )
            for name, cost in solution.cost.items()
        ],
    )
    for name, found in (solution.sensors or {}).items():
        say(_constants(name, found))
    measured = recording.ori_valid
    seen = measured.any(axis=0).sum()
    blind = 1 - measured.any(axis=1).mean()
    if blind > 0.5:
        note(f"{100 * blind:.0f} % of the frames have no sensor at all: the prior alone makes them")
    say(
        f"{args.output}: {len(asked)} frames from {seen} sensors in "
        f"{solution.seconds:.1f} s, {solution.iterations} iterations: {solution.status}"
    )
    tried = solution.report["starts"]
    if len(tried) > 1:
        costs = ", ".join(f"{name} {x['cost']:.1f}" for name, x in tried.items())
        say(
            f"kept: the solution from {solution.report['start']}; costs from {costs}; joints apart by up to "
            f"{solution.report['starts_apart_deg']:.1f} deg in the mean"
        )
    if not solution.converged:
        note(f"{args.recording}: the solver stopped before it converged")


def _constants(name: str, found: dict[str, Any]) -> str:
    """A self-calibrated sensor in one line."""
    import numpy as np

    mounting = np.rad2deg(np.linalg.norm(found["mounting_rad"]))
    heading = np.rad2deg(found["heading_rad"])
    bias = np.linalg.norm(found["bias_mps2"])
    return f"{name}: mounting {mounting:.1f} deg, heading {heading:+.1f} deg, bias {bias:.2f} m/s^2"
