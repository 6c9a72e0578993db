"""The online methods on the fixed split: `python benchmarks/methods.py [--split test] [--part dip|imuposer]`.

dip: DIP online (20,5) and the hybrid around it, six virtual sensors with the realistic noise at 60 Hz, the
very recordings of `split.py`, whose SOP and SIP rows stand beside these. The hybrid is compared with its
network clip by clip (bootstrap over clips of the mean difference, 95 %).

imuposer: all 24 device combinations at 25 Hz: the network, its ten Adam steps, the hybrid, on the last 3 s of
what is read of each clip: what comes before fills the network's window of 5 s. The network runs once and the
refinements see the same poses, so that their own times can be told apart.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from common import clips, evenly, keep, machine, row, seed_of, told, trusted_s

from mocap import Motion, dataset, sensors, synthesis
from mocap.estimator import Pose, Sample, replay
from mocap.evaluation import metrics, noskill
from mocap.skeleton import Skeleton
from sip.prior import shipped

if TYPE_CHECKING:
    from learned.imuposer.model import Imuposer

NAMES = (
    "sip_deg", "angular_deg", "position_cm", "instrumented_deg", "global_deg", "jitter", "acc_error",
)  # fmt: skip
PAIRED = ("sip_deg", "angular_deg", "position_cm", "instrumented_deg", "jitter", "acc_error")
IMUPOSER_HZ = 25.0
IMUPOSER_S = 3.0  # of each clip, after the window is full
ENOUGH_S = 1.0
EARLY = 5  # frames that the network wakes before: an answer may come some frames after its window


class Playback:
    """An estimator that gives poses already made: the network of a refinement that is timed alone.

    covariance: of the network's errors, as its own poses carry it.
    """

    def __init__(
        self,
        motion: Motion,
        std_rad: np.ndarray | None,
        covariance: np.ndarray,
        names: tuple[str, ...],
    ) -> None:
        self.rate_hz, self.sensors, self.look_ahead_frames = motion.rate_hz, names, 0
        self._motion, self._std, self._covariance = motion, std_rad, covariance

    def init(self) -> int:
        """The first frame."""
        return 0

    def step(self, state: int, sample: Sample) -> tuple[int, Pose]:
        """The next pose."""
        m = self._motion
        std = None if self._std is None else self._std[state]
        pose = Pose(
            sample.time_s, m.R_parent_joint[state], m.p_world_root[state], std, "", self._covariance
        )
        return state + 1, pose


class Asleep:
    """IMUPoser's runtime, which does no work for its first `frames` windows: nobody looks at them."""

    def __init__(self, runtime: Any, frames: int) -> None:
        self._runtime, self._left = runtime, frames
        self.rows = runtime.rows

    def answer(self, rows: Any, emit: int) -> Any:
        """Of the awake runtime, or the rest pose."""
        import torch

        if self._left > 0:
            self._left -= 1
            return torch.tensor([1.0, 0, 0, 0, 1, 0]).repeat(24)
        return self._runtime.answer(rows, emit)


def figures(
    motion: Motion, truth: Motion, recording: synthesis.Recording, ms: np.ndarray | None
) -> dict[str, Any]:
    """Metrics of one method on one clip; acc_error: joints' accelerations against the reference's,
    root fixed and masked as in metrics.md, m/s^2."""
    m = metrics.evaluate(motion, truth, recording=recording, seen=recording.sensors)
    out: dict[str, Any] = {k: getattr(m, k) for k in NAMES if k != "acc_error"}
    p, q = (_joints(x) for x in (motion, truth))
    error = np.linalg.norm(np.diff(p - q, 2, axis=0), axis=-1).mean(axis=1) * truth.rate_hz**2
    trusted = np.ones(len(truth), bool) if truth.trusted is None else truth.trusted
    out["acc_error"] = float(error[trusted[:-2] & trusted[1:-1] & trusted[2:]].mean())
    out["jitter_reference"] = m.jitter_reference
    if ms is not None:
        out |= {"ms_p50": float(np.median(ms)), "ms_p99": float(np.percentile(ms, 99))}
    return out


def _joints(motion: Motion) -> np.ndarray:
    local = np.array(motion.R_parent_joint)
    local[:, list(metrics.MASKED)] = np.eye(3)
    body = Skeleton.default()
    return body.forward(local, np.zeros((len(motion), 3)))[1]


def dip_clip(job: tuple[str, Motion, str | None, dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean pose, nearest pose, DIP and hybrid on one clip; and the hybrid with other settings, if any."""
    import hybrid
    from poser.estimators import make

    name, motion, weights, settings = job
    recording = synthesis.recording(
        motion, sensors.SIX, synthesis.NOISES["realistic"], seed_of(name)
    )
    prior = shipped()
    out = []
    for method, found in noskill.both(recording, prior.mean, prior.poses).items():
        out.append({"clip": name, "method": method} | figures(found, motion, recording, None))
    chosen = Path(weights) if weights else None
    dip = make("dip", 60.0, sensors.SIX, weights=chosen)
    single = hybrid.TrackerSettings.around(dip, horizon_s=0.0)
    ways = {
        "dip": dip,
        "frame-dip": hybrid.Tracker(dip, single),
        "hybrid": hybrid.Tracker(dip),
    }
    if settings:
        ways["hybrid, set"] = hybrid.Tracker(dip, hybrid.TrackerSettings(**settings))
    for method, estimator in ways.items():
        run = replay(estimator, recording)
        found = figures(run.motion, motion, recording, 1e3 * run.frame_s)
        out.append({"clip": name, "method": method, "fallbacks": run.fallbacks} | found)
    return out


@dataclass(frozen=True)
class Run:
    """The network on one combination of devices, the last `IMUPOSER_S` of a clip: what a refinement is given.

    number: of the combination. ms (T,): of a frame.
    """

    number: int
    recording: synthesis.Recording
    truth: Motion
    poses: Motion
    std_rad: np.ndarray | None
    ms: np.ndarray

    def playback(self, covariance: np.ndarray) -> Playback:
        """The network once more."""
        return Playback(self.poses, self.std_rad, covariance, self.recording.sensors)


def imuposer_runs(name: str, clip: Motion, model: Imuposer) -> Iterator[Run]:
    """The 24 combinations on one clip; none where less than `ENOUGH_S` of what is looked at is trusted."""
    from learned import runtime
    from learned.imuposer.specification import COMBINATIONS
    from learned.imuposer.window import ImuposerWindow
    from learned.online.estimator import Online

    everything = synthesis.recording(
        clip, sensors.FIVE, synthesis.NOISES["realistic"], seed_of(name)
    )
    before = max(0, len(clip) - round(IMUPOSER_S * IMUPOSER_HZ))
    if trusted_s(clip.slice(before, len(clip))) < ENOUGH_S:
        return
    runtime.one_thread()
    awake = runtime.prepare(model, runtime.fastest())
    for k, combination in enumerate(COMBINATIONS):
        worn = tuple(sensors.FIVE[place] for place in combination)
        whole = everything.select(worn)
        window = ImuposerWindow(model, worn, runtime=Asleep(awake, max(0, before - EARLY)))
        run = replay(Online(window, IMUPOSER_HZ), whole)
        yield Run(
            k,
            whole.slice(before, len(whole)),
            clip.slice(before, len(clip)),
            run.motion.slice(before, len(whole)),
            None if run.std_rad is None else run.std_rad[before:],
            1e3 * run.frame_s[before:],
        )


def imuposer_clip(job: tuple[str, Motion, str | None, dict[str, Any]]) -> list[dict[str, Any]]:
    """Every combination of devices on one clip; settings: of the hybrid."""
    import hybrid
    from learned import checkpoint
    from learned.imuposer.adam import AdamEstimator
    from learned.imuposer.model import Imuposer
    from learned.registry import specification

    name, clip, weights, settings = job
    mean = shipped().mean
    chosen = Path(weights) if weights else None
    model = checkpoint.load(chosen or checkpoint.shipped("imuposer"), "imuposer")
    assert isinstance(model, Imuposer)
    covariances = [c.double().numpy() for c in model.error_covariance]
    tracker = hybrid.TrackerSettings(**{**specification("imuposer").tracker, **settings})
    out = []
    for run in imuposer_runs(name, clip, model):
        recording = run.recording
        label = {"clip": name, "devices": list(recording.sensors)}
        still = noskill.mean_pose(recording, mean)
        out.append(label | {"method": "mean-pose"} | figures(still, run.truth, recording, None))
        found = figures(run.poses, run.truth, recording, run.ms)
        out.append(label | {"method": "imuposer"} | found)
        network = run.playback(covariances[run.number])
        joints = tuple(sensors.lookup(n).joint for n in recording.sensors)
        ways = {
            "imuposer-adam": AdamEstimator(network, joints),
            "hybrid": hybrid.Tracker(network, tracker),
        }
        for method, refined in ways.items():
            again = replay(refined, recording)
            found = figures(again.motion, run.truth, recording, 1e3 * again.frame_s)
            out.append(label | {"method": method} | found)
    return out


# -- tables ---------------------------------------------------------------------------------------


def means(results: Sequence[dict[str, Any]], names: Sequence[str] = NAMES) -> list[str]:
    """The mean over clips of each figure."""
    extra = ("ms_p50", "ms_p99")
    out = [f"{np.mean([r[k] for r in results]):.2f}" for k in names]
    return out + [
        f"{np.median([r[k] for r in results]):.2f}" if all(k in r for r in results) else "-"
        for k in extra
    ]


def by_subject(results: list[dict[str, Any]]) -> str:
    """A row a method, and below it one a subject."""
    widths = (16, 6, *[17] * len(NAMES), 8, 8)
    out = [row(("method", "clips", *NAMES, "ms p50", "ms p99"), widths)]
    subjects = sorted({dataset.subject_of(r["clip"]) for r in results})
    for method in dict.fromkeys(r["method"] for r in results):
        mine = [r for r in results if r["method"] == method]
        out.append(row((method, len(mine), *means(mine)), widths))
        for s in subjects:
            part = [r for r in mine if dataset.subject_of(r["clip"]) == s]
            out.append(row((f"  subject {s}", len(part), *means(part)), widths))
    return "\n".join(out)


def paired(results: list[dict[str, Any]], new: str, old: str, seed: int = 0) -> str:
    """Mean over clips of new - old with its bootstrap 95 % interval, for each figure."""
    rng = np.random.default_rng(seed)
    out = []
    for key in PAIRED:
        values = {m: {r["clip"]: r[key] for r in results if r["method"] == m} for m in (new, old)}
        d = np.array([values[new][c] - values[old][c] for c in values[new]])
        draws = d[rng.integers(len(d), size=(10_000, len(d)))].mean(axis=1)
        low, high = np.percentile(draws, (2.5, 97.5))
        out.append(f"{key}: {d.mean():+.3f} [{low:+.3f}, {high:+.3f}]")
    return f"{new} - {old}, mean over clips [95 %]: " + "; ".join(out)


def by_devices(results: list[dict[str, Any]]) -> str:
    """IMUPoser's table: by number of devices and by combination, mean over clips."""
    names = ("position_cm", "sip_deg", "global_deg", "instrumented_deg", "jitter")
    widths = (44, 14, *[17] * len(names), 8, 8)
    out = [row(("devices", "method", *names, "ms p50", "ms p99"), widths)]
    methods = list(dict.fromkeys(r["method"] for r in results))
    groups: list[tuple[str, list[dict[str, Any]]]] = [("all 24 combinations", results)]
    groups += [(f"{n} devices", [r for r in results if len(r["devices"]) == n]) for n in (1, 2, 3)]
    groups += [
        (f"all, subject {s}", [r for r in results if dataset.subject_of(r["clip"]) == s])
        for s in sorted({dataset.subject_of(r["clip"]) for r in results})
    ]
    for combination in dict.fromkeys(tuple(r["devices"]) for r in results):
        part = [r for r in results if tuple(r["devices"]) == combination]
        groups.append((", ".join(combination), part))
    for label, part in groups:
        for method in methods:
            mine = [r for r in part if r["method"] == method]
            out.append(row((label, method, *means(mine, names)), widths))
    out.append(_wins(results))
    return "\n".join(out)


def _wins(results: list[dict[str, Any]]) -> str:
    """In how many combinations the hybrid is better than the Adam steps, mean over clips, by each figure."""
    found = []
    for key in (
        "sip_deg",
        "angular_deg",
        "position_cm",
        "global_deg",
        "instrumented_deg",
        "jitter",
    ):
        mean: dict[tuple[str, ...], dict[str, float]] = {}
        for combination in dict.fromkeys(tuple(r["devices"]) for r in results):
            part = [r for r in results if tuple(r["devices"]) == combination]
            mean[combination] = {
                m: float(np.mean([r[key] for r in part if r["method"] == m]))
                for m in ("hybrid", "imuposer-adam")
            }
        wins = sum(m["hybrid"] < m["imuposer-adam"] for m in mean.values())
        found.append(f"{key} {wins}")
    return (
        f"combinations of {len(mean)} in which the hybrid beats the Adam steps: {', '.join(found)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="test", choices=("validation", "test"))
    parser.add_argument("--part", default="dip,imuposer")
    parser.add_argument("--weights", help="other weights than the shipped ones (one part alone)")
    parser.add_argument(
        "--seconds", type=float, default=15.0, help="of each clip; imuposer: at most 8"
    )
    parser.add_argument(
        "--tracker", type=json.loads, default={}, metavar="JSON",
        help="hybrid.TrackerSettings to compare with the default (dip) or to use (imuposer), as "
        """'{"positions": true}'""",
    )  # fmt: skip
    parser.add_argument("--clips", type=int, help="how many, evenly over the split (default: all)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    print(machine())
    kept: dict[str, Any] = {}
    for part in args.part.split(","):
        rate, seconds = (
            (60.0, args.seconds)
            if part == "dip"
            else (IMUPOSER_HZ, min(5.0 + IMUPOSER_S, args.seconds))
        )
        tried = evenly(clips(args.split, rate, seconds), args.clips)
        work = dip_clip if part == "dip" else imuposer_clip
        began = time.monotonic()
        results: list[dict[str, Any]] = []
        with ProcessPoolExecutor(args.jobs) as pool:
            for i, found in enumerate(
                pool.map(work, [(*c, args.weights, args.tracker) for c in tried])
            ):
                results += found
                print(f"\r{part} {i + 1}/{len(tried)}   ", end="", file=sys.stderr)
        print(file=sys.stderr)
        print(
            f"\n{part}, {args.split} split, {told(tried)}, up to {seconds:g} s each at {rate:g} Hz, "
            f"realistic noise; {time.monotonic() - began:.0f} s"
        )
        if part == "dip":
            print(by_subject(results))
            print(paired(results, "hybrid", "dip"))
            print(paired(results, "hybrid", "frame-dip"))
            if args.tracker:
                print(paired(results, "hybrid, set", "hybrid"))
        else:
            print(by_devices(results))
            averaged = _over_devices(results)
            print(paired(averaged, "hybrid", "imuposer-adam"))
            print(paired(averaged, "hybrid", "imuposer"))
        kept[part] = results
    if args.output:
        keep(args.output, kept)


def _over_devices(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row a clip and method: the mean over combinations."""
    out = []
    for clip in dict.fromkeys(r["clip"] for r in results):
        for method in dict.fromkeys(r["method"] for r in results):
            part = [r for r in results if r["clip"] == clip and r["method"] == method]
            out.append(
                {"clip": clip, "method": method}
                | {k: np.mean([r[k] for r in part]) for k in PAIRED}
            )
    return out


if __name__ == "__main__":
    main()
