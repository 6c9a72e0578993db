"""Several methods on one recording, fairly: the same reference, the same sensors where they can read them.

`Job` says what to do with one recording, `run` does it (in any process), and `results` holds what came out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap import sensors as places
from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from poser.console import Progress, part
from poser.estimators import check_devices, network_of, stand_in, used
from poser.results import Compared, Result

if TYPE_CHECKING:
    from sip import Settings

METHODS = ("sop", "sip", "dip", "imuposer", "imuposer-adam", "hybrid-dip", "hybrid-imuposer")
ALIASES = {"hybrid": "hybrid-dip"}
SOLVED = ("sop", "sip")
NETWORK = {m: network_of(m) for m in METHODS if m not in SOLVED}
# What IMUPoser sees where nothing is said: a watch on each wrist and earphones where the recording has no
# pocket, otherwise a watch, a phone and earphones.
_EVERYDAY = (("left_wrist", "right_pocket", "head"), ("left_wrist", "right_wrist", "head"))


@dataclass(frozen=True)
class Job:
    """What to run on one recording.

    name: as it is called in tables. methods: of `METHODS`. sensors: what the methods see (None: `six` where
    the recording has them, else all it has). devices: what IMUPoser sees (None: see `devices_of`).
    reference: a motion, "sip-all", or None for the recording's own. skeleton: the body that SIP solves for.
    """

    name: str
    recording: Recording
    methods: tuple[str, ...]
    sensors: tuple[str, ...] | None = None
    devices: tuple[str, ...] | None = None
    reference: Motion | str | None = None
    solver: str = "ipopt"
    skeleton: Skeleton | None = None
    no_skill: bool = True
    settings: dict[str, Any] = field(default_factory=dict)


def canonical(names: Sequence[str]) -> tuple[str, ...]:
    """Method names in the order of `METHODS`, aliases resolved, each once.

    Raises PoserError for a name that is none.
    """
    wanted = [ALIASES.get(n.strip(), n.strip()) for n in names]
    odd = [n for n in wanted if n not in METHODS]
    if odd or not wanted:
        raise PoserError(
            f"method {odd[0] if odd else '(none)'!r} unknown; known: {', '.join(METHODS)}, hybrid"
        )
    return tuple(m for m in METHODS if m in wanted)


def possible(recording: Recording, sensors: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """The methods that can read the recording: DIP needs the six places, IMUPoser one of its five."""
    seen = sensors or six_of(recording)
    six = all(stand_in(n, seen) for n in places.SIX)
    five = bool(devices_of(recording))
    able = {"dip": six, "imuposer": five}
    return tuple(m for m in METHODS if able.get(NETWORK.get(m, ""), True))


def run(job: Job, tell: Progress = lambda fraction, words: None) -> Compared:
    """Every method of a job, measured against its reference. Raises PoserError naming the method."""
    seen = job.sensors or six_of(job.recording)
    reference, words = _reference(job, part(tell, 0.0, 0.3 if job.reference == "sip-all" else 0.01))
    start = 0.3 if job.reference == "sip-all" else 0.01
    methods: dict[str, Result] = {}
    for i, name in enumerate(job.methods):
        a, b = (start + (1 - start) * (i + k) / len(job.methods) for k in (0, 1))
        try:
            methods[name] = _method(job, name, seen, reference, part(tell, a, b, name))
        except PoserError as e:
            raise PoserError(f"{job.name}, {name}: {e}") from e
    if job.no_skill:
        methods |= _no_skill(job.recording, seen, reference)
    return Compared(job.name, words, methods, reference)


def six_of(recording: Recording) -> tuple[str, ...]:
    """The six sensors of SIP and DIP where the recording has them, else all it has."""
    if all(n in recording.sensors for n in places.SIX):
        return places.SIX
    return recording.sensors


def devices_of(recording: Recording) -> tuple[str, ...]:
    """What IMUPoser sees where nothing is said: a watch, a phone in a pocket and earphones, else two
    watches and earphones, of the places (or sensors on the same bones) that the recording has; else
    whatever it has of IMUPoser's five places, at most three."""
    for wanted in _EVERYDAY:
        found = tuple(stand_in(n, recording.sensors) for n in wanted)
        if all(found):
            return tuple(f for f in found if f)
    have = {n: s for n in places.FIVE if (s := stand_in(n, recording.sensors))}
    names = list(have)[:3]
    if names == ["left_pocket", "right_pocket", "head"]:  # not among IMUPoser's combinations
        names = ["left_pocket", "head"]
    return tuple(have[n] for n in names)


# -- reference ------------------------------------------------------------------------------------


def _reference(job: Job, tell: Progress) -> tuple[Motion, str]:
    if isinstance(job.reference, Motion):
        return job.reference, "a motion file"
    if job.reference == "sip-all":
        solution = _solve(job, job.recording, "sip", tell)
        return solution.motion, f"SIP on all {len(job.recording.sensors)} sensors"
    if job.recording.reference is None:
        raise PoserError(
            f"{job.name}: holds no reference motion; give --reference MOTION, or sip-all for SIP on "
            f"all its sensors"
        )
    return job.recording.reference, "the recording's own"


# -- methods --------------------------------------------------------------------------------------


def _method(
    job: Job, name: str, seen: tuple[str, ...], reference: Motion, tell: Progress
) -> Result:
    if name in SOLVED:
        from poser.commands.solve import record

        solution = _solve(job, job.recording.select(seen), name, tell)
        figures = record(solution)
        figures["frame_ms_mean"] = 1e3 * solution.seconds / len(solution.motion)
        return _result(job, solution.motion, reference, seen, figures)
    from poser import tracking

    if NETWORK[name] == "imuposer":
        those = job.recording.select(job.sensors) if job.sensors else job.recording
        seen = job.devices or devices_of(those)
    # What the network reads of them, in its own order: what it does not read it has not seen.
    found = used(NETWORK[name], seen)
    if NETWORK[name] == "imuposer":
        check_devices(found)
    seen = tuple(found.values())
    tracked = tracking.track(
        job.recording.select(seen), "hybrid" if name.startswith("hybrid") else name, NETWORK[name],
        progress=tell,
    )  # fmt: skip
    return _result(job, tracked.run.motion, reference, seen, tracked.record())


def _solve(job: Job, recording: Recording, terms: Any, tell: Progress) -> Any:
    import sip

    settings: Settings = sip.Settings(terms=terms, solver=job.solver, **job.settings)  # type: ignore[arg-type]
    return sip.solve(recording, job.skeleton, settings, tell)


def _result(
    job: Job, motion: Motion, reference: Motion, seen: tuple[str, ...], figures: dict[str, Any]
) -> Result:
    from mocap import metrics
    from poser.staging import on_the_floor

    found = metrics.evaluate(motion, reference, recording=job.recording, seen=seen)
    return Result(on_the_floor(motion), found, figures | {"used_sensors": list(seen)})


def _no_skill(recording: Recording, seen: tuple[str, ...], reference: Motion) -> dict[str, Result]:
    """The two rows that need no skill, from the prior's mean and its bank of poses."""
    from mocap import metrics, noskill
    from sip.prior import shipped

    prior, chosen = shipped(), recording.select(seen)
    out = {}
    for name, motion in (
        ("mean-pose", noskill.mean_pose(chosen, prior.mean)),
        ("nearest-pose", noskill.nearest_pose(chosen, prior.poses)),
    ):
        found = metrics.evaluate(motion, reference, recording=recording, seen=seen)
        out[name] = Result(motion, found, {"used_sensors": list(seen)})
    return out


# -- many recordings ------------------------------------------------------------------------------


def run_many(
    jobs: Sequence[Job],
    processes: int = 1,
    tell: Progress = lambda fraction, words: None,
    cluster: str | None = None,
    keep: Callable[[Compared], None] = lambda compared: None,
) -> list[Compared]:
    """All jobs in their order; several at a time where asked, each in a process of its own.

    cluster: address of a Dask scheduler whose workers do them (the extra `cluster`). keep: called with each
    result as it comes, so that an interruption loses none that is done.
    """
    if cluster is not None:
        return _on_cluster(jobs, cluster, tell, keep)
    done: list[Compared | None] = [None] * len(jobs)
    if processes <= 1 or len(jobs) <= 1:
        for i, job in enumerate(jobs):
            words = f"{job.name} ({i + 1} of {len(jobs)})" if len(jobs) > 1 else ""
            done[i] = run(job, part(tell, i / len(jobs), (i + 1) / len(jobs), words))
            keep(done[i])  # type: ignore[arg-type]
        return [d for d in done if d is not None]
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    # Spawned, not forked: torch and OpenMP do not survive a fork of a process that has used them.
    with ProcessPoolExecutor(
        min(processes, len(jobs)), mp_context=get_context("spawn"), initializer=_one_thread
    ) as pool:
        futures = {pool.submit(run, job): i for i, job in enumerate(jobs)}
        try:
            for count, future in enumerate(as_completed(futures), 1):
                i = futures[future]
                done[i] = future.result()
                keep(done[i])  # type: ignore[arg-type]
                tell(count / len(jobs), f"{jobs[i].name}: done, {count} of {len(jobs)}")
        except BaseException:
            running = list((pool._processes or {}).values())  # shutdown forgets them
            pool.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.terminate()
            raise
    return [d for d in done if d is not None]


def _one_thread() -> None:
    """A worker uses one core: the processes are the parallelism. Ctrl-C is the parent's to handle."""
    import os
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


def _on_cluster(
    jobs: Sequence[Job], address: str, tell: Progress, keep: Callable[[Compared], None]
) -> list[Compared]:
    try:
        from dask.distributed import Client, as_completed
    except ImportError as e:
        raise PoserError(
            "--cluster needs dask.distributed: pip install 'poser-imu[cluster]'"
        ) from e
    done: dict[int, Compared] = {}
    with Client(address, timeout=30) as client:
        futures = [client.submit(run, job, pure=False) for job in jobs]
        place = {f.key: i for i, f in enumerate(futures)}
        for future, result in as_completed(futures, with_results=True):
            done[place[future.key]] = result
            keep(result)
            tell(len(done) / len(jobs), f"{len(done)} of {len(jobs)} recordings")
    return [done[i] for i in sorted(done)]


def worst_frames(compared: Compared, method: str, count: int = 3) -> list[int]:
    """The frames with the largest position error of a method, at least a second apart, worst first."""
    error = compared.methods[method].metrics.frame_position_cm
    if error is None:
        return []
    error = np.array(error)
    rate = compared.methods[method].metrics.rate_hz or 60.0
    found: list[int] = []
    for t in np.argsort(-error, kind="stable"):
        if all(abs(int(t) - f) >= rate for f in found):
            found.append(int(t))
        if len(found) == count:
            break
    return found


def check_paths(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Where the motions of each recording go: the folder itself for one, a folder each for several."""
    if len(names) == 1:
        return {names[0]: folder}
    return {name: folder / name for name in names}
