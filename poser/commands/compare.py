"""Several methods on the same recordings with the same reference: tables, pictures and a report.

Writes results.json, report.html and one motion file a method into the output folder (a folder a recording
where there are several). Methods: sop, sip, dip, imuposer, imuposer-adam, hybrid-dip (or hybrid),
hybrid-imuposer. The reference is the recording's own, a motion file, or sip-all: SIP on every sensor that
the recording has.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.errors import PoserError
from poser import files, options
from poser.console import DONE, UsageError, emit, json_text, note, part, progress, say, table

if TYPE_CHECKING:
    from mocap.motion import Motion
    from mocap.recording import Recording
    from poser.comparison import Job
    from poser.results import Compared

HELP = "several methods on the same recordings, with a report"


def _methods(text: str) -> tuple[str, ...]:
    from poser import comparison

    try:
        return comparison.canonical(text.split(","))
    except PoserError as e:
        raise ArgumentTypeError(str(e)) from e


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r} is not a number of processes")
    return int(text)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "recordings", type=Path, nargs="+", metavar="REC", help="calibrated recordings"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="made where it is missing"
    )
    parser.add_argument("--methods", type=_methods, metavar="M,M", help="default: all")
    parser.add_argument(
        "--reference", metavar="MOTION|sip-all", help="default: the recording's own reference"
    )
    parser.add_argument(
        "--sensors", metavar="S",
        help=f"those the methods see: {options.SENSORS_HELP} (default: six where there are)",
    )  # fmt: skip
    parser.add_argument(
        "--devices", metavar="S", help="one to three sensors that IMUPoser sees (default: told)"
    )
    parser.add_argument(
        "--solver", choices=("ipopt", "ipopt-cold", "banded"), default="ipopt",
        help="of SOP, SIP and sip-all (default: ipopt)",
    )  # fmt: skip
    parser.add_argument("--height", type=options.stature, metavar="M", help="stature in m, for SIP")
    parser.add_argument(
        "--from", dest="begin", type=options.number, metavar="S", help="begin at this time in s"
    )
    parser.add_argument(
        "--to", dest="end", type=options.number, metavar="S", help="end before this time in s"
    )
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="recordings at a time")
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="run on the workers of this Dask scheduler"
    )
    options.add_json(parser)


def run(args: Namespace) -> int:
    from poser import comparison, results

    if args.cluster and args.jobs > 1:
        raise UsageError("argument --cluster: not with --jobs, the scheduler decides")
    files.make_folder(args.output)
    jobs = _jobs(args)
    where = comparison.check_paths(args.output, [j.name for j in jobs])
    written = (*comparison.METHODS, *results.NO_SKILL, "reference")
    _check_inputs(args, [folder / f"{name}.npz" for folder in where.values() for name in written])

    def keep(compared: Compared) -> None:
        folder = where[compared.name]
        files.make_folder(folder)
        for name, result in compared.methods.items():
            files.write(folder / f"{name}.npz", result.motion)
        files.write(folder / "reference.npz", compared.truth)

    with progress("comparing") as tell:
        found = comparison.run_many(jobs, args.jobs, part(tell, 0.0, 0.95), args.cluster, keep)
        tell(0.95, "report")
        record = results.to_json(found)
        record["motions"] = {n: str(p.relative_to(args.output)) for n, p in where.items()}
        files.write_text(args.output / "results.json", json_text(record) + "\n")
        write_report(args.output, _title(found), found, record["mean"], _facts(args, jobs))
    if args.json:
        emit(record)
        return DONE
    table(*results.rows(record["mean"]))
    say(f"{args.output / 'report.html'}: the report; results.json has all figures")
    return DONE


def _check_inputs(args: Namespace, outputs: list[Path]) -> None:
    """None of the files to be written may be one that is read."""
    inputs = [*args.recordings]
    if args.reference not in (None, "sip-all"):
        inputs.append(Path(args.reference))
    for path in outputs:
        for source in inputs:
            if path.exists() and path.samefile(source):
                raise UsageError(f"{path}: is an input and would be overwritten; choose another -o")


def _jobs(args: Namespace) -> list[Job]:
    from mocap.skeleton import Skeleton
    from poser import comparison

    reference: Any = args.reference
    if reference is not None and reference != "sip-all":
        if len(args.recordings) > 1:
            raise UsageError(
                "argument --reference: one motion file cannot serve several recordings"
            )
        reference = files.motion(Path(reference))
    jobs = []
    names = _names(args.recordings)
    for path, name in zip(args.recordings, names, strict=True):
        recording = files.recording(path)
        with files.about(path):
            sensors = options.sensors(args.sensors, recording.sensors) if args.sensors else None
            devices = options.sensors(args.devices, recording.sensors) if args.devices else None
            window, truth = recording, reference
            if args.begin is not None or args.end is not None:
                from poser.commands.solve import cut_window

                window, first = cut_window(recording, args.begin, args.end)
                if not isinstance(truth, str | None):
                    truth = _cut(truth, recording.rate_hz, len(recording), first, len(window))
        if truth is None and recording.reference is None:
            raise PoserError(
                f"{path}: holds no reference motion; give --reference MOTION, or sip-all for SIP on all "
                f"its sensors"
            )
        methods = args.methods or _possible(path, window, sensors)
        jobs.append(
            comparison.Job(
                name,
                window,
                methods,
                sensors,
                devices,
                truth,
                args.solver,
                Skeleton.default(args.height) if args.height else None,
            )
        )
    return jobs


def _possible(path: Path, recording: Recording, sensors: tuple[str, ...] | None) -> tuple[str, ...]:
    """The methods that can read this recording's sensors; the others are named in a note."""
    from poser import comparison

    able = comparison.possible(recording, sensors)
    missing = [m for m in comparison.METHODS if m not in able]
    if missing:
        note(f"{path}: its sensors do not serve {', '.join(missing)}; left out")
    return able


def _cut(reference: Motion, rate_hz: float, frames: int, first: int, count: int) -> Motion:
    """The window of a reference of the whole recording; one of the window's own length is left."""
    reference = reference.resampled(rate_hz)
    if abs(len(reference) - frames) <= 1:
        return reference.slice(first, first + count)
    return reference


def _names(paths: list[Path]) -> list[str]:
    """Stems, with the folder before them where two are the same."""
    stems = [p.stem for p in paths]
    names = [
        s if stems.count(s) == 1 else f"{p.parent.name}-{s}"
        for p, s in zip(paths, stems, strict=True)
    ]
    if len(set(names)) < len(names):
        again = next(n for n in names if names.count(n) > 1)
        raise UsageError(f"two recordings are called {again!r}; give each once, or rename one")
    return names


def _title(found: list[Compared]) -> str:
    if len(found) == 1:
        return f"Comparison on {found[0].name}"
    return f"Comparison on {len(found)} recordings"


def write_report(
    folder: Path,
    title: str,
    found: list[Compared],
    mean: dict[str, Any],
    facts: dict[str, str],
    extra: tuple[tuple[Path, str], ...] = (),
) -> None:
    """Pictures and report.html in `folder`; `extra` pictures come first."""
    from poser import pictures, report

    shown = list(extra)
    worst = _worst(found)
    if worst:
        pictures.save(pictures.pairs(worst), folder / "worst.png")
        caption = "The worst frames of each method: its skeleton, and the reference in grey."
        shown.append((folder / "worst.png", caption))
    bars = _joint_means(found)
    if bars:
        pictures.save(pictures.joints(bars), folder / "joints.png")
        shown.append((folder / "joints.png", "Mean global angle of each joint, nothing masked."))
    if len(found) == 1:
        curves = {n: m.metrics for n, m in found[0].methods.items()}
        pictures.save(pictures.errors(curves), folder / "errors.png")
        shown.append((folder / "errors.png", "Error over time; in brackets the mean."))
    facts = facts | {"Computed with": report.environment()}
    files.write_text(folder / "report.html", report.page(title, found, mean, shown, facts))


def _worst(found: list[Compared]) -> list[tuple[str, list[tuple[str, Any, Any]]]]:
    """Per method the three worst frames over all recordings, by position error."""
    from poser import comparison
    from poser.results import NAMES, NO_SKILL

    rows = []
    for name in dict.fromkeys(n for c in found for n in c.methods if n not in NO_SKILL):
        cells = []
        for compared in found:
            if name not in compared.methods:
                continue
            error = compared.methods[name].metrics.frame_position_cm
            for t in comparison.worst_frames(compared, name):
                assert error is not None
                motion = compared.methods[name].motion.resampled(compared.truth.rate_hz)
                t = min(t, len(motion) - 1)
                at = f"{compared.name} {t / compared.truth.rate_hz:.1f} s\n{error[t]:.1f} cm"
                joints = (compared.truth.p_world_joint[t], motion.p_world_joint[t])
                cells.append((float(error[t]), (at, *joints)))
        cells.sort(key=lambda cell: -cell[0])
        if cells:
            rows.append((NAMES.get(name, name), [c for _, c in cells[:4]]))
    return rows


def _joint_means(found: list[Compared]) -> dict[str, Any]:
    import numpy as np

    from poser.results import NO_SKILL

    out = {}
    for name in dict.fromkeys(n for c in found for n in c.methods if n not in NO_SKILL):
        each = [c.methods[name].metrics.joint_deg for c in found if name in c.methods]
        known = [k for k in each if k is not None]
        if known:
            out[name] = np.mean(known, axis=0)
    return out


def noise_words(recording: Recording) -> str:
    """The sizes of the noise that a recording was synthesised with."""
    sigma = (recording.noise or {}).get("sigma", {})
    return ", ".join(f"{k} {v:g}" for k, v in sigma.items())


def _facts(args: Namespace, jobs: list[Job]) -> dict[str, str]:
    from poser import comparison

    first = jobs[0]
    seconds = sum(j.recording.seconds for j in jobs)
    facts = {
        "Recordings": f"{len(jobs)}, {seconds:.1f} s in all: {', '.join(j.name for j in jobs[:12])}"
        + (", ..." if len(jobs) > 12 else ""),
        "Reference": {None: "the recordings' own", "sip-all": "SIP on all sensors of each"}.get(
            args.reference, str(args.reference)
        ),
        "Sensors": ", ".join(first.sensors or comparison.six_of(first.recording)),
    }
    if any(comparison.NETWORK.get(m) == "imuposer" for m in first.methods):
        devices = ", ".join(first.devices or comparison.devices_of(first.recording))
        facts["IMUPoser's devices"] = devices
        if args.devices is None:
            note(f"IMUPoser sees {devices}; --devices chooses others")
    facts["SOP and SIP"] = f"solver {args.solver}, default settings"
    if first.recording.noise:
        facts["Noise of the first, 1 sigma"] = noise_words(first.recording)
    return facts
