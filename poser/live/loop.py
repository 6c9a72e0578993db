"""The loop: samples of a source through an estimator into sinks, and how long that takes."""

from __future__ import annotations

import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mocap.estimator import Estimator, Pose, Sample, facts, told_late
from mocap.orientation import Array
from mocap.skeleton import TOES, Skeleton
from poser.live.latency import Latency
from poser.live.samples import Source
from poser.live.sinks.protocol import Sink

MOST_BEHIND_S = 0.25  # a loop that is later than this leaves samples out, until it is
CAUGHT_UP_S = 0.05  # no later than this, or has the newest
_ENDING = (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))


@dataclass
class Report:
    """What happened. lag: from the moment a pose describes to its delivery; step: the estimator alone.

    samples, frames: fed and delivered. fallbacks: poses that were one, notes: why, counted. behind_s: how
    much later than the source's pace the last sample was taken, most_behind_s: the largest of these.
    left_out: samples that were not fed, because the loop was too late.
    estimator: what it tells of itself (`mocap.estimator.facts`).
    """

    samples: int = 0
    frames: int = 0
    fallbacks: int = 0
    notes: Counter[str] = field(default_factory=Counter)
    lag: Latency = field(default_factory=Latency)
    step: Latency = field(default_factory=Latency)
    behind_s: float = 0.0
    most_behind_s: float = 0.0
    left_out: int = 0
    source: dict[str, Any] = field(default_factory=dict)
    sinks: dict[str, Any] = field(default_factory=dict)
    estimator: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        return {
            "samples": self.samples,
            "frames": self.frames,
            "fallbacks": self.fallbacks,
            "notes": dict(self.notes),
            **self.lag.to_dict("latency_ms"),
            **self.step.to_dict("frame_ms"),
            "behind_s": self.most_behind_s,
            "left_out": self.left_out,
            **self.estimator,
            **self.source,
            "sinks": self.sinks,
        }


def run(
    source: Source,
    estimator: Estimator,
    sinks: Sequence[Sink],
    skeleton: Skeleton,
    report: Report,
    tell: Callable[[Report], None] = lambda _: None,
) -> None:
    """Drive the estimator until the source, which is open, ends; then samples in which nothing is valid
    follow, as many as the look-ahead, so that the last frames get their poses (no times are taken of these).

    It is never later than MOST_BEHIND_S and what the computer does besides: then samples are left out, but
    for the newest of a poll. An estimator that can hurry is told how late it is (`told_late`).
    `report` is filled as it goes, so that it holds after an interruption too; `close` completes it.
    tell(report) is called once a poll.
    """
    state, turns = estimator.init(), source.turns
    shift: Array | None = None
    last: Pose | None = None
    sample: Sample | None = None

    def delivered(pose: Pose) -> None:
        nonlocal shift, last
        if shift is None:
            shift = _onto_floor(pose, skeleton, last)
        last = replace(pose, p_world_root=pose.p_world_root + shift)
        _deliver(last, sinks, report)

    while not source.ended:
        for sample in _in_time(source, report):
            if source.turns != turns:
                # Of another world than all before: the estimator begins anew, where the body is.
                state, turns, shift = estimator.init(), source.turns, None
            report.behind_s = source.behind_s(sample.time_s)
            report.most_behind_s = max(report.most_behind_s, report.behind_s)
            state = told_late(estimator, state, report.behind_s)
            began = time.perf_counter()
            state, pose = estimator.step(state, sample)
            report.step.add(time.perf_counter() - began)
            report.samples += 1
            if pose is None:
                continue
            delivered(pose)
            lag = source.lag_s(pose.time_s)
            if lag is not None:
                report.lag.add(lag)
        report.estimator = facts(estimator, state)
        tell(report)
    if sample is None:
        return
    for k in range(estimator.look_ahead_frames):
        state, pose = estimator.step(state, _nothing(sample, (k + 1) / source.rate_hz))
        if pose is not None:
            delivered(pose)


def _in_time(source: Source, report: Report) -> Iterator[Sample]:
    """The samples of a poll without those that are left out; how late each is counts when it is asked for."""
    due, behind = source.poll(), False
    for k, sample in enumerate(due, 1):
        late_s = source.behind_s(sample.time_s)
        behind = late_s > (CAUGHT_UP_S if behind else MOST_BEHIND_S)
        if behind and k < len(due):
            report.left_out += 1
        else:
            yield sample


def _nothing(sample: Sample, later_s: float) -> Sample:
    """A sample some time after another in which nothing was measured."""
    return Sample(
        sample.time_s + later_s,
        np.full_like(sample.R_world_bone, np.nan),
        np.full_like(sample.acc_world, np.nan),
        np.zeros_like(sample.valid),
    )


def _deliver(pose: Pose, sinks: Sequence[Sink], report: Report) -> None:
    for sink in sinks:
        sink.write(pose)
    report.frames += 1
    if pose.note:
        report.fallbacks += 1
        report.notes[pose.note] += 1


def _onto_floor(pose: Pose, skeleton: Skeleton, last: Pose | None) -> Array:
    """(3,) m by which a pose is moved: its lower foot onto the floor, since sensors do not tell how high a
    body is, and to where the last one was delivered."""
    _, p = skeleton.forward(pose.R_parent_joint, pose.p_world_root)
    shift = np.zeros(3) if last is None else last.p_world_root - pose.p_world_root
    shift[1] = skeleton.sole - float(p[list(TOES), 1].min())
    return shift


def close(source: Source, sinks: Sequence[Sink], report: Report) -> None:
    """Close both ends, whatever came before, and complete the report. Ctrl-C waits until it is done."""
    with _undisturbed():
        report.source = source.facts()
        source.close()
        failed: Exception | None = None
        for sink in sinks:
            try:
                report.sinks[sink.name] = sink.close()
            except Exception as e:  # the other sinks must still be closed; it is raised below
                failed = failed or e
        if failed is not None:
            raise failed


@contextmanager
def _undisturbed() -> Iterator[None]:
    """A second Ctrl-C, or a signal that asks to end, must not lose the file that the first one began."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in _ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
