"""Several methods on the same recordings with the same reference: tables, pictures and a report.

Writes results.json, report.html and one motion file a method into the output folder (a folder a recording
where there are several). An earlier comparison is replaced once the new one is whole; what an interrupted one
has measured by then stays in the folder `unfinished-comparison`. Methods: sop, sip, dip, imuposer,
imuposer-adam, hybrid-dip (or hybrid), hybrid-imuposer, frame-dip, frame-imuposer. The reference is the
recording's own, a motion file, or sip-all: SIP on every sensor that the recording has. A method that a
recording does not serve is named with the reason, and the others go on.
"""

from __future__ import annotations

import itertools
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.errors import PoserError
from poser import estimators, files, options
from poser.console import (
    DONE,
    UsageError,
    emit,
    json_text,
    milestone,
    note,
    part,
    progress,
    say,
    table,
)

if TYPE_CHECKING:
    from poser.comparison import Job
    from poser.report.results import Compared, Lost

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
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="DIR",
        help="a new or empty folder, or that of an earlier comparison, which is replaced",
    )
    parser.add_argument(
        "--methods", type=_methods, metavar="M,M",
        help="default: all but frame-dip and frame-imuposer, the hybrid without its window",
    )  # fmt: skip
    parser.add_argument(
        "--reference", metavar="MOTION|sip-all", help="default: the recording's own reference"
    )
    parser.add_argument(
        "--sensors", metavar="S",
        help=f"those the methods see: {options.SENSORS_HELP} (default: six where there are)",
    )  # fmt: skip
    parser.add_argument(
        "--devices", metavar="S",
        help="sensors that IMUPoser sees, one to three at a time (default: told)",
    )  # fmt: skip
    parser.add_argument(
        "--weights", type=options.weights, nargs="+", default=[], metavar="FILE",
        help="weights of your own (.safetensors) in place of the shipped, at most one FILE a network",
    )  # fmt: skip
    parser.add_argument(
        "--solver", choices=("ipopt", "ipopt-cold", "banded"), default="ipopt",
        help="of SOP, SIP and sip-all (default: ipopt)",
    )  # fmt: skip
    parser.add_argument(
        "--height", type=options.stature, metavar="M", help="stature in m, of the wearer"
    )
    options.add_window(parser)
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="recordings at a time")
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="run on the workers of this Dask scheduler"
    )
    options.add_json(parser)


def run(args: Namespace) -> int:
    if args.cluster and args.jobs > 1:
        raise UsageError("argument --cluster: not with --jobs, the scheduler decides")
    with files.folder(args.output, single=True):
        return _compare(args)


def _compare(args: Namespace) -> int:
    from poser import batch, comparison, earlier
    from poser.report import folder as reporting
    from poser.report import results

    earlier.complete(args.output)
    jobs = _jobs(args)
    where = comparison.check_paths(args.output, [j.name for j in jobs])
    old = earlier.files_in(args.output, where.values())
    written = [folder / f"{n}.npz" for folder in where.values() for n in earlier.MOTIONS]
    _check_inputs(args, [*written, *old])
    earlier.check_own(args.output, old)
    # Beside an earlier comparison until the new one is whole; without one, where it belongs at once.
    into = earlier.fresh(args.output) if old else args.output
    places = comparison.check_paths(into, [j.name for j in jobs])

    def keep(compared: Compared) -> None:
        folder = places[compared.name]
        files.make_folder(folder)
        for name, result in compared.methods.items():
            files.write(folder / f"{name}.npz", result.motion, timed=True)
        files.write(folder / "reference.npz", compared.truth, timed=True)

    count, every = itertools.count(1), sum(len(job.methods) for job in jobs)

    def done(recording: str, method: str) -> None:
        milestone(f"{recording}, {method}: done, {next(count)} of {every}", "poser compare")

    with progress("comparing") as tell:
        found = batch.run_many(jobs, args.jobs, part(tell, 0.0, 0.95), args.cluster, keep, done)
        tell(0.95, "report")
        measured = results.measured(found)
        if not measured:
            raise PoserError(_nothing(found))
        record = results.to_json(found)
        record["weights"] = comparison.weights_used(jobs, record["mean"])
        record["motions"] = {c.name: str(where[c.name].relative_to(args.output)) for c in measured}
        files.write_text(into / "results.json", json_text(record) + "\n")
        facts = _facts(args, jobs, found)
        reporting.write_report(into, _title(found), found, record["mean"], facts)
        if into != args.output:
            earlier.replace(old, into, args.output)
    for sentence in results.failures(found):
        note(sentence)
    if args.json:
        emit(record)
        return DONE
    table(*results.rows(record["mean"]))
    say(f"{args.output / 'report.html'}: the report; results.json has all figures")
    return DONE


def _check_inputs(args: Namespace, outputs: list[Path]) -> None:
    """None of the files to be written or removed may be one that is read."""
    inputs = [*args.recordings, *args.weights]
    if args.reference not in (None, "sip-all"):
        inputs.append(Path(args.reference))
    for path in outputs:
        for source in inputs:
            if path.exists() and path.samefile(source):
                raise UsageError(f"{path}: is an input and would be overwritten; choose another -o")


def _jobs(args: Namespace) -> list[Job]:
    from mocap import timeline
    from mocap.formats import native
    from mocap.skeleton import Skeleton
    from poser import comparison
    from poser.commands.solve import cut_window

    methods = args.methods or comparison.METHODS
    weights = comparison.weights_of(args.weights, methods)
    reference: Any = args.reference
    if reference is not None and reference != "sip-all":
        if len(args.recordings) > 1:
            raise UsageError(
                "argument --reference: one motion file cannot serve several recordings"
            )
        files.check_there(Path(reference), "--reference", ("sip-all",))
        reference = files.motion(Path(reference))
    jobs: list[Job] = []
    names = _names(args.recordings)
    for path, name in zip(args.recordings, names, strict=True):
        recording = files.thinned(path, files.recording(path, gaps=False), then="")
        with files.about(path):
            sensors = options.sensors(args.sensors, recording.sensors) if args.sensors else None
            devices = _named_devices(path, args.devices, recording.sensors)
            window, first = cut_window(recording, args.begin, args.end)
        truth = reference
        if not isinstance(truth, str | None):
            source = Path(args.reference)
            with files.about(source):
                timed = native.states_start(source)
                truth = timeline.placed(truth, timed, recording, window, first)
        if truth is None and recording.reference is None:
            raise PoserError(
                f"{path}: holds no reference motion; give --reference MOTION, or sip-all for SIP on all "
                f"its sensors"
            )
        job = comparison.Job(
            name,
            window,
            methods,
            sensors,
            devices,
            truth,
            args.solver,
            Skeleton.default(args.height) if args.height else None,
            weights=weights,
        )
        read = comparison.read_by_any(job)
        if read:
            files.note_gaps(path, window.select(read), recording)
        network_read = comparison.read_by_networks(job)
        if network_read:
            files.note_no_acc(path, window.select(network_read))
        jobs.append(job)
    return jobs


def _named_devices(path: Path, spec: str | None, there: tuple[str, ...]) -> tuple[str, ...] | None:
    """The sensors that serve for those of --devices; a note tells where that is another one."""
    if spec is None:
        return None
    found = options.served(spec, there, "--devices")
    for text in estimators.served_words(found):
        note(f"{path}: {text}")
    return tuple(dict.fromkeys(found.values()))


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


def _nothing(found: Sequence[Lost | Compared]) -> str:
    """Why nothing could be measured, by the first recording's reasons."""
    from poser.report import results

    more = f" (and {len(found) - 1} more recordings)" if len(found) > 1 else ""
    return f"nothing could be measured: {results.failures(found[:1])[0]}{more}"


def _title(found: Sequence[Lost | Compared]) -> str:
    if len(found) == 1:
        return f"Comparison on {found[0].name}"
    return f"Comparison on {len(found)} recordings"


def _facts(args: Namespace, jobs: list[Job], found: Sequence[Compared | Lost]) -> dict[str, str]:
    from poser import comparison
    from poser.report import folder as reporting

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
    if args.begin is not None or args.end is not None:
        ends = sorted(
            {(j.recording.start_s, j.recording.start_s + j.recording.seconds) for j in jobs}
        )
        facts["Part"] = ", ".join(f"{a:.2f} to {b:.2f} s" for a, b in ends[:6]) + (
            ", ..." if len(ends) > 6 else ""
        )
    if args.weights:
        facts["Weights of the user"] = ", ".join(
            f"{path.name} ({network})" for network, path in first.weights.items()
        )
    devices = _devices(jobs, found)
    if devices:
        facts["IMUPoser's devices"] = "; ".join(devices)
    facts["SOP and SIP"] = f"solver {args.solver}, default settings"
    if first.recording.noise:
        facts["Noise of the first, 1 sigma"] = reporting.noise_words(first.recording)
    return facts


def _devices(jobs: list[Job], found: Sequence[Compared | Lost]) -> list[str]:
    """The sets of devices that IMUPoser saw; a note tells those that the user did not name."""
    from poser.comparison import NETWORK
    from poser.estimators import used
    from poser.report.results import measured

    of = {job.name: job for job in jobs}
    sets: dict[str, None] = {}
    for compared in measured(found):
        job = of[compared.name]
        saw = [m for n, m in compared.methods.items() if NETWORK.get(n) == "imuposer"]
        if not saw:
            continue
        names = saw[0].figures["used_sensors"]
        text = ", ".join(names)
        there = used("imuposer", job.sensors or job.recording.sensors)
        if len(there) > len(names):
            text += f" of the {len(there)} devices that it could"
        if set(names) != set(job.devices or ()):
            note(f"IMUPoser sees {text}; --devices chooses others")
        sets[text] = None
    return list(sets)
