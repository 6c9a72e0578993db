"""The moving horizon's parts, one changed at a time: `python benchmarks/horizon.py [--split validation]`.

DIP runs once a clip and noise; every variant refines the same poses of it. Six virtual sensors at 60 Hz with
the realistic noise. Rows: means over clips (and seeds) by group: CMU's subjects of the split, and on the
validation split Bandai's clips. `68 %` and `95 %`: shares of the joints' errors, axis by axis, inside one and
two stated sigmas. ms: processor time of a frame without the network. With --against NAME each variant's
paired difference to it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import clips, evenly, keep, machine, row, seed_of, told, trusted_s

import sip
from hybrid import Tracker, TrackerSettings
from mocap import Motion, dataset, sensors, synthesis
from mocap.estimator import Pose, Replay, Sample, replay
from mocap.evaluation import metrics
from mocap.recording import Recording
from sip import PoseBelief

RATE_HZ = 60.0
FIGURES = ("sip_deg", "angular_deg", "position_cm", "jitter", "m_1s", "m_5s", "68 %", "95 %", "ms")


class Heard:
    """A network whose answers are known already."""

    def __init__(self, poses: list[Pose | None], look_ahead: int) -> None:
        self.rate_hz, self.sensors, self.look_ahead_frames = RATE_HZ, sensors.SIX, look_ahead
        self._poses = poses

    def init(self) -> int:
        return 0

    def step(self, state: int, sample: Sample) -> tuple[int, Pose | None]:
        return state + 1, self._poses[state] if state < len(self._poses) else None


class Ear:
    """A network, and all that it has said."""

    def __init__(self, network: Any) -> None:
        self.rate_hz, self.sensors = network.rate_hz, network.sensors
        self.look_ahead_frames = network.look_ahead_frames
        self.network, self.poses = network, list[Pose | None]()

    def init(self) -> Any:
        return self.network.init()

    def step(self, state: Any, sample: Sample) -> tuple[Any, Pose | None]:
        state, pose = self.network.step(state, sample)
        self.poses.append(pose)
        return state, pose


def cost(**changes: Any) -> Callable[[TrackerSettings], TrackerSettings]:
    """Changes of the window's cost."""
    return lambda s: replace(s, cost=replace(s.cost, **changes))


def how(**changes: Any) -> Callable[[TrackerSettings], TrackerSettings]:
    """Changes of the window."""
    return lambda s: replace(s, **changes)


VARIANTS: dict[str, Callable[[TrackerSettings], TrackerSettings]] = {
    "default": how(),
    "single frame": how(horizon_s=0.0),
    "window 0.2 s": how(horizon_s=0.2),
    "window 0.3 s": how(horizon_s=0.3),
    "window 0.6 s": how(horizon_s=0.6),
    "window 1 s": how(horizon_s=1.0),
    "lag 0": how(lag=0),
    "lag 20": how(lag=20),
    "2 steps": how(steps=2),
    "3 steps": how(steps=3),
    "memory 0.4 s": how(horizon_memory_s=0.4),
    "memory 2 s": how(horizon_memory_s=2.0),
    "network 0": cost(network_weight=1e-3),
    "network 0.03": cost(network_weight=0.03),
    "network 0.2": cost(network_weight=0.2),
    "prior 0.1": cost(prior_weight_listening=0.1),
    "no doubt": cost(network_doubt=0.0),
    "doubt 2": cost(network_doubt=2.0),
    "no contact": cost(sigma_contact=float("inf")),
    "no constants": cost(self_calibration=False),
    "tremble kept": how(shown_memory_s=1e-4),
    "tremble 0.05 s": how(shown_memory_s=0.05),
}
OFFLINE: dict[str, dict[str, Any]] = {
    "sip": {},
    "sip+constants": {"self_calibration": True},
    "sip+network": {"network": True},
    "sip+both": {"self_calibration": True, "network": True},
}


def one(job: tuple[str, str, Motion, int, list[str], dict[str, Any]]) -> list[dict[str, Any]]:
    """A clip under one noise: figures of each variant."""
    from learned import runtime
    from poser.estimators import make

    group, name, motion, seed, names, more = job
    runtime.one_thread()
    noise = synthesis.NOISES["realistic"]
    recording = synthesis.recording(motion, sensors.SIX, noise, seed_of(name) + seed)
    label = {"group": group, "clip": name, "seed": seed}
    network = make("dip", RATE_HZ, sensors.SIX)
    ear = Ear(network)
    said = replay(ear, recording)
    heard = Heard(ear.poses, network.look_ahead_frames)
    base = TrackerSettings.around(network)
    out = []
    for variant in names:
        if variant in OFFLINE:
            found, std, ms = offline(recording, said, OFFLINE[variant])
        elif variant == "dip":
            found, std, ms = said.motion, said.std_rad, 0.0
        else:
            change = VARIANTS.get(variant) or how_json(more[variant])
            tracker = Tracker(heard, change(base))
            began = time.process_time()
            run = replay(tracker, recording)
            ms = 1e3 * (time.process_time() - began) / len(recording)
            found, std = run.motion, run.std_rad
        m = metrics.evaluate(found, motion, std_rad=std)
        figures = {k: getattr(m, k) for k in FIGURES[:4]}
        path = m.translation_m or {}
        figures |= {"m_1s": path.get("1"), "m_5s": path.get("5"), "ms": ms}
        figures |= {"68 %": m.inside_1_sigma, "95 %": m.inside_2_sigma}
        out.append(label | {"variant": variant} | figures)
    return out


def how_json(changes: dict[str, Any]) -> Callable[[TrackerSettings], TrackerSettings]:
    """Changes of the window and, under "cost", of its cost."""
    plain = {k: v for k, v in changes.items() if k != "cost"}
    return lambda s: replace(s, cost=replace(s.cost, **changes.get("cost", {})), **plain)


def offline(
    recording: Recording, said: Replay, changes: dict[str, Any]
) -> tuple[Motion, np.ndarray | None, float]:
    """SIP's motion, deviations and milliseconds a frame."""
    settings = sip.Settings(
        solver="banded",
        self_calibration=changes.get("self_calibration", False),
        uncertainty=True,
    )
    belief = None
    if changes.get("network"):
        assert said.covariance is not None
        belief = PoseBelief(said.motion.R_parent_joint, said.covariance)
    began = time.process_time()
    found = sip.solve(recording, settings=settings, belief=belief)
    ms = 1e3 * (time.process_time() - began) / len(recording)
    return found.motion, found.std_rad, ms


def jobs(args: argparse.Namespace) -> list[tuple[str, str, Motion]]:
    """Group, name and motion of each clip."""
    found = [
        (f"CMU {dataset.subject_of(name)}", name, m)
        for name, m in evenly(clips(args.split, RATE_HZ, args.seconds), args.clips)
    ]
    print(told([(n, m) for _, n, m in found]))
    if args.split == "validation" and args.bandai:
        rest = dataset.clips("validation", ("bandai",), RATE_HZ, max_s=args.seconds)
        rest = [(n, m) for n, m in rest if trusted_s(m) >= 2.0]
        found += [("Bandai", n, m) for n, m in evenly(rest, args.bandai)]
    return found


def table(rows: list[dict[str, Any]], against: str | None) -> str:
    """A row a variant and group."""
    widths = (24, 10, 6, *[12] * len(FIGURES))
    out = [row(("variant", "group", "runs", *FIGURES), widths)]
    groups = list(dict.fromkeys(r["group"] for r in rows))
    by = {(r["variant"], r["clip"], r["seed"]): r for r in rows}
    for variant in dict.fromkeys(r["variant"] for r in rows):
        for group in ["all", *(groups if len(groups) > 1 else [])]:
            part = [r for r in rows if r["variant"] == variant and group in ("all", r["group"])]
            out.append(row((variant, group, len(part), *(mean(part, k) for k in FIGURES)), widths))
        if against and variant != against:
            mine = [r for r in rows if r["variant"] == variant]
            pairs = [(r, by[against, r["clip"], r["seed"]]) for r in mine]
            said = []
            for k in FIGURES[:3]:
                d = np.array([a[k] - b[k] for a, b in pairs])
                said.append(f"{k} {d.mean():+.2f} +- {d.std() / np.sqrt(len(d)):.2f}")
            out.append(f"{'':24s} against {against}: {', '.join(said)}")
    return "\n".join(out)


def mean(part: list[dict[str, Any]], key: str) -> str:
    """Over those that have it."""
    there = [r[key] for r in part if r[key] is not None]
    return f"{np.mean(there):.2f}" if there else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="validation", choices=("validation", "test"))
    parser.add_argument("--variants", default=",".join(VARIANTS), help="names, comma between them")
    parser.add_argument(
        "--more", type=json.loads, default={}, metavar="JSON",
        help="""variants of one's own: '{"mine": {"steps": 1, "cost": {"network_weight": 0.05}}}'""",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=6.0, help="of each clip")
    parser.add_argument("--clips", type=int, help="of CMU, evenly over the split (default: all)")
    parser.add_argument("--bandai", type=int, default=4, help="clips, on the validation split")
    parser.add_argument("--seeds", type=int, default=1, help="of the noise")
    parser.add_argument("--against", default="default")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    print(machine())
    names = [*args.variants.split(","), *args.more] if args.variants else list(args.more)
    if unknown := set(names) - {*VARIANTS, *OFFLINE, *args.more, "dip"}:
        parser.error(f"no variant {', '.join(sorted(unknown))}")
    work = [(*c, seed, names, args.more) for c in jobs(args) for seed in range(args.seeds)]
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for i, found in enumerate(pool.map(one, work)):
            rows += found
            print(f"\r{i + 1}/{len(work)}   ", end="", file=sys.stderr)
    print(file=sys.stderr)
    print(table(rows, args.against if args.against in names else None))
    if args.output:
        keep(args.output, rows)


if __name__ == "__main__":
    main()
