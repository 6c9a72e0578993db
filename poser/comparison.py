"""Several methods on one recording, fairly: the same reference, the same sensors where they can read them.

`Job` says what to do with one recording, `run` does it (in any process), and `results` holds what came out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from learned.registry import specification
from mocap import sensors as places
from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from poser.console import Progress, part
from poser.estimators import (
    FRAMES,
    HYBRIDS,
    at_once,
    check_devices,
    everyday,
    network_of,
    network_of_weights,
    used,
)
from poser.estimators import METHODS as ONLINE
from poser.report.results import NO_SKILL, Compared, Lost, MethodResult

if TYPE_CHECKING:
    from sip import Settings

METHODS = ("sop", "sip", *(m for m in ONLINE if m != "hybrid"), *HYBRIDS)
ABLATION = FRAMES  # run where they are named
KNOWN = (*METHODS, *ABLATION)
ALIASES = {"hybrid": "hybrid-dip"}
SOLVED = ("sop", "sip")
NETWORK = {m: network_of(m) for m in KNOWN if m not in SOLVED}


@dataclass(frozen=True)
class Job:
    """What to run on one recording.

    name: as it is called in tables. methods: of `KNOWN`. sensors: what the methods see (None: `six` where
    the recording has them, else all it has). devices: what IMUPoser sees (None: `everyday` of the sensors
    given, else of all that the recording has).
    reference: a motion, "sip-all", or None for the recording's own. skeleton: the body that is solved for.
    weights: network -> file, of those that do not run with the shipped weights.
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
    weights: dict[str, Path] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)


def weights_of(paths: Sequence[Path], methods: Sequence[str]) -> dict[str, Path]:
    """Network -> weights, of the user's files. Raises PoserError for two of one network, or for one that no
    method runs."""
    found: dict[str, Path] = {}
    for path in paths:
        network = network_of_weights(path)
        if network in found:
            raise PoserError(f"{found[network]} and {path} are both weights of {network}; give one")
        if network not in {NETWORK.get(m) for m in methods}:
            raise PoserError(
                f"{path}: weights of {network}, which none of the methods {', '.join(methods)} runs"
            )
        found[network] = path.absolute()  # a worker may have another folder
    return found


def weights_used(jobs: Sequence[Job], methods: Collection[str]) -> dict[str, dict[str, str]]:
    """Network -> file name and, where its description states one, revision of the weights that ran."""
    from learned import checkpoint

    out = {}
    for network in sorted({NETWORK[m] for m in methods if m in NETWORK}):
        path = jobs[0].weights.get(network, checkpoint.shipped(network))
        revision = checkpoint.describe(path).get("revision")
        out[network] = {"name": path.name} | (
            {} if revision is None else {"revision": str(revision)}
        )
    return out


def canonical(names: Sequence[str]) -> tuple[str, ...]:
    """Method names in the order of `KNOWN`, aliases resolved, each once.

    Raises PoserError for a name that is none.
    """
    wanted = [ALIASES.get(n.strip(), n.strip()) for n in names]
    odd = [n for n in wanted if n not in KNOWN]
    if odd or not wanted:
        raise PoserError(
            f"method {odd[0] if odd else '(none)'!r} unknown; known: {', '.join(KNOWN)}, hybrid"
        )
    return tuple(m for m in KNOWN if m in wanted)


def run(job: Job, tell: Progress = lambda fraction, words: None) -> Compared:
    """The methods of a job, measured against its reference; those that failed are in `Compared.failed`.

    Raises PoserError where nothing could be measured.
    """
    found = attempt(job, tell)
    if isinstance(found, Lost):
        raise PoserError(found.sentence)
    return found


def attempt(
    job: Job,
    tell: Progress = lambda fraction, words: None,
    done: Callable[[str], None] = lambda method: None,
) -> Compared | Lost:
    """As `run`, but a job of which nothing could be measured is `Lost`, with the reasons. done: is called
    with each method that has been measured."""
    why = obstacles(job)
    able = [m for m in job.methods if m not in why]
    if not able:
        return Lost(job.name, why)
    start = 0.3 if job.reference == "sip-all" else 0.01
    try:
        reference, words = _reference(job, part(tell, 0.0, start))
    except PoserError as e:
        return Lost(job.name, {"reference": str(e)})
    methods: dict[str, MethodResult] = {}
    for i, name in enumerate(able):
        a, b = (start + (1 - start) * (i + k) / len(able) for k in (0, 1))
        try:
            methods[name] = _method(job, name, reference, part(tell, a, b, name))
            done(name)
        except PoserError as e:
            why[name] = str(e)
    why = {m: why[m] for m in job.methods if m in why}
    if not methods:
        return Lost(job.name, why)
    if job.no_skill:
        seen = job.sensors or six_of(job.recording)
        methods |= _no_skill(job.recording, seen, reference)
    return Compared(job.name, words, methods, reference, why)


def obstacles(job: Job) -> dict[str, str]:
    """Method -> why it cannot be measured with the sensors there are; one that can is not in it."""
    found = {}
    for name in job.methods:
        try:
            seen = read_by(job, name)
        except PoserError as e:
            found[name] = str(e)
            continue
        if name == "sip" and job.reference == "sip-all" and set(seen) == set(job.recording.sensors):
            found[name] = "the reference is SIP on the same sensors: it would agree with itself"
    return found


def read_by(job: Job, name: str) -> tuple[str, ...]:
    """The sensors that a method reads, in its own order: what it does not read it has not seen.

    Raises SensorError where they do not serve it.
    """
    if name in SOLVED:
        return job.sensors or six_of(job.recording)
    network = NETWORK[name]
    if specification(network).needs_all:
        return tuple(used(network, job.sensors or six_of(job.recording)).values())
    there = job.sensors or job.recording.sensors
    found = used(network, job.devices or everyday(network, there, job.recording))
    check_devices(network, at_once(network, found, job.recording), "--devices")
    return tuple(found.values())


def read_by_any(job: Job) -> tuple[str, ...]:
    """The sensors that the methods and the reference read, in the recording's order."""
    return job.recording.sensors if job.reference == "sip-all" else _read(job, job.methods)


def read_by_networks(job: Job) -> tuple[str, ...]:
    """The sensors that the networks among the methods read, in the recording's order."""
    return _read(job, [m for m in job.methods if m in NETWORK])


def _read(job: Job, methods: Sequence[str]) -> tuple[str, ...]:
    why = obstacles(job)
    read = {n for m in methods if m not in why for n in read_by(job, m)}
    return tuple(n for n in job.recording.sensors if n in read)


def six_of(recording: Recording) -> tuple[str, ...]:
    """The six sensors of SIP and DIP where the recording has them, else all it has."""
    if all(n in recording.sensors for n in places.SIX):
        return places.SIX
    return recording.sensors


# -- reference ------------------------------------------------------------------------------------


def _reference(job: Job, tell: Progress) -> tuple[Motion, str]:
    """The truth and where it comes from, in words. Raises PoserError where there is none that fits."""
    from mocap.synthesis.staging import on_the_floor

    if isinstance(job.reference, Motion):
        slower = min(job.reference.rate_hz, job.recording.rate_hz)
        # As `metrics.evaluate` demands, but before hours of solving rather than after each method.
        if abs(job.reference.seconds - job.recording.seconds) > (1 + 1e-6) / slower:
            raise PoserError(
                f"the reference lasts {job.reference.seconds:.3f} s, the recording "
                f"{job.recording.seconds:.3f} s: they may differ by one frame at most"
            )
        return job.reference, "a motion file"
    if job.reference == "sip-all":
        solution = _solve(job, job.recording, "sip", tell)
        return (
            on_the_floor(solution.motion),
            f"SIP on all {len(job.recording.sensors)} sensors",
        )
    if job.recording.reference is None:
        raise PoserError(
            "the recording holds no reference motion; give --reference MOTION, or sip-all for SIP on "
            "all its sensors"
        )
    return replace(job.recording.reference, start_s=job.recording.start_s), "the recording's own"


# -- methods --------------------------------------------------------------------------------------


def _method(job: Job, name: str, reference: Motion, tell: Progress) -> MethodResult:
    seen = read_by(job, name)
    if name in SOLVED:
        from poser.commands.solve import record

        solution = _solve(job, job.recording.select(seen), name, tell)
        figures = record(solution)
        figures["frame_ms_mean"] = 1e3 * solution.seconds / len(solution.motion)
        return _result(job, solution.motion, reference, seen, figures)
    from poser import tracking

    tracked = tracking.track(
        job.recording.select(seen), "hybrid" if name.startswith("hybrid") else name, NETWORK[name],
        weights=job.weights.get(NETWORK[name]), progress=tell, skeleton=job.skeleton,
    )  # fmt: skip
    return _result(job, tracked.run.motion, reference, seen, tracked.record())


def _solve(job: Job, recording: Recording, terms: Any, tell: Progress) -> Any:
    import sip

    settings: Settings = sip.Settings(terms=terms, solver=job.solver, **job.settings)  # type: ignore[arg-type]
    return sip.solve(recording, job.skeleton, settings, tell)


def _result(
    job: Job, motion: Motion, reference: Motion, seen: tuple[str, ...], figures: dict[str, Any]
) -> MethodResult:
    from mocap.evaluation import metrics
    from mocap.synthesis.staging import on_the_floor

    found = metrics.evaluate(motion, reference, recording=job.recording, seen=seen)
    return MethodResult(on_the_floor(motion), found, figures | {"used_sensors": list(seen)})


def _no_skill(
    recording: Recording, seen: tuple[str, ...], reference: Motion
) -> dict[str, MethodResult]:
    """The two rows that need no skill, from the prior's mean and its bank of poses."""
    from mocap.evaluation import metrics, noskill
    from mocap.synthesis.staging import on_the_floor
    from sip.prior import shipped

    prior, chosen = shipped(), recording.select(seen)
    out = {}
    for name, motion in noskill.both(chosen, prior.mean, prior.poses).items():
        found = metrics.evaluate(motion, reference, recording=recording, seen=seen)
        out[name] = MethodResult(on_the_floor(motion), found, {"used_sensors": list(seen)})
    return out


# -- what came out -------------------------------------------------------------------------------


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


def joint_means(found: list[Compared]) -> dict[str, Any]:
    """Per method the mean angle of each joint (24,) in deg, over all recordings."""
    out = {}
    for name in dict.fromkeys(n for c in found for n in c.methods if n not in NO_SKILL):
        each = [c.methods[name].metrics.joint_deg for c in found if name in c.methods]
        known = [k for k in each if k is not None]
        if known:
            out[name] = np.mean(known, axis=0)
    return out


def check_paths(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Where the motions of each recording go: the folder itself for one, a folder each for several."""
    if len(names) == 1:
        return {names[0]: folder}
    return {name: folder / name for name in names}
