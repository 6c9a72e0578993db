"""The real-time tracker: any network's estimator, refined frame by frame, that never misses a frame.

Samples are kept until the network emits the pose of their time; that pose is refined with that sample.
Whatever goes wrong gives the network's pose, or the last one, with the reason in `Pose.note` and a count
in the state.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hybrid import contact, incoming
from hybrid.refinement import Memory, Refinement
from hybrid.settings import TrackerSettings
from hybrid.tasks import Task
from mocap import sensors as places
from mocap.errors import SensorError
from mocap.estimator import Estimator, Pose, Sample
from mocap.motion import check_rate
from mocap.orientation import Array
from mocap.skeleton import Skeleton

NETWORK_FAILED = "the network failed"
NETWORK_SILENT = "the network gave no pose"
NETWORK_BROKEN = "the network's pose is not a pose"
NO_SAMPLE = "no sample of the pose's time"
TIME_GAP = "a gap in time"
TIME_BACK = "time did not advance"
NETWORK_NOTE = "the network fell back"
SPARE_SAMPLES = 4  # kept beyond the look-ahead, for a network that is late


@dataclass(frozen=True, eq=False)
class TrackerState:
    """All that one step hands to the next; pickle it to resume later.

    network: the network's own state. samples: the latest, oldest first. received: samples so far.
    last: the pose given last. refined_s: time of the frame refined last. counts: frames, fallbacks in
    all and by reason, and what was left out of refined frames.
    """

    network: Any
    samples: tuple[Sample, ...]
    memory: Memory
    root: contact.RootState
    last: Pose | None = None
    refined_s: float | None = None
    received: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def fallbacks(self) -> int:
        """Frames whose pose is not a refined one."""
        return self.counts.get("fallback", 0)


class Tracker:
    """`Estimator` around a network's `Estimator`: same rate, sensors and look-ahead.

    settings: default, those that the network asks for (`TrackerSettings.around`). tasks: what makes up a
    frame's cost; default, `hybrid.tasks.standard` of the settings, to which more can be added
    (`hybrid.tasks`). joint (S,), seat (S,3) m: where the sensors sit; default, the table of places.
    skeleton: the body; default, the table's. Raises SensorError for sensors that are not in the table
    without them.
    """

    def __init__(
        self,
        network: Estimator,
        settings: TrackerSettings | None = None,
        *,
        tasks: Sequence[Task] | None = None,
        skeleton: Skeleton | None = None,
        joint: np.ndarray | None = None,
        seat: Array | None = None,
    ) -> None:
        self.network = network
        self.settings = settings or TrackerSettings.around(network)
        self.rate_hz = check_rate(network.rate_hz, "Tracker")
        self.sensors = tuple(network.sensors)
        self.look_ahead_frames = int(network.look_ahead_frames)
        self.skeleton = skeleton or Skeleton.default()
        if joint is None or seat is None:
            table_joint, table_seat = places.joints_and_seats(self.sensors)
            joint = table_joint if joint is None else joint
            seat = table_seat if seat is None else seat
        if np.shape(joint) != (len(self.sensors),) or np.shape(seat) != (len(self.sensors), 3):
            raise SensorError(
                f"Tracker: joint and seat must be given for {len(self.sensors)} sensors"
            )
        self.refinement = Refinement(self.skeleton, np.asarray(joint), seat, self.settings, tasks)
        self._contact = contact.Contact(self.skeleton)

    def init(self) -> TrackerState:
        """A fresh state."""
        return TrackerState(self.network.init(), (), self.refinement.start(), contact.start())

    def step(self, state: TrackerState, sample: Sample) -> tuple[TrackerState, Pose | None]:
        """Feed one sample; the refined pose of `look_ahead_frames` ago, or None before the first."""
        counts = defaultdict(int, state.counts)
        expected = state.samples[-1].time_s + 1 / self.rate_hz if state.samples else 0.0
        sample, events = incoming.clean(sample, len(self.sensors), expected)
        _add(counts, events)
        kept = self.look_ahead_frames + 1 + SPARE_SAMPLES
        samples = (*state.samples, sample)[-kept:]
        received = state.received + 1
        network, pose, trouble = self._ask(state.network, sample)
        state = replace(state, network=network, samples=samples, received=received)
        if pose is None and received <= self.look_ahead_frames:
            if trouble != NETWORK_SILENT:
                counts[trouble] += 1
            return replace(state, counts=dict(counts)), None
        state, pose, reason = self._pose(state, pose, trouble, counts)
        counts["frames"] += 1
        if reason:
            counts[reason] += 1
            counts["fallback"] += 1
            pose = replace(pose, note="; ".join(n for n in (reason, pose.note) if n))
        return replace(state, last=pose, counts=dict(counts)), pose

    def _ask(self, state: Any, sample: Sample) -> tuple[Any, Pose | None, str]:
        """The network's next state, its pose or None, and what is wrong where None."""
        try:
            state, answer = self.network.step(state, sample)
        except Exception:  # code that is not ours: whatever it raises, the frame gets a pose
            return self.network.init(), None, NETWORK_FAILED
        if answer is None:
            return state, None, NETWORK_SILENT
        pose = incoming.proposal(answer)
        return state, pose, "" if pose is not None else NETWORK_BROKEN

    def _pose(
        self, state: TrackerState, pose: Pose | None, trouble: str, counts: defaultdict[str, int]
    ) -> tuple[TrackerState, Pose, str]:
        """The state after this frame, its pose, and why the pose is a fallback."""
        if pose is None:
            due = state.samples[-1 - min(self.look_ahead_frames, len(state.samples) - 1)]
            return state, self._held(state, due.time_s), trouble
        if pose.note:
            counts[NETWORK_NOTE] += 1
        sample = incoming.sample_at(state.samples, pose.time_s, 0.5 / self.rate_hz)
        if self.settings.translation and np.isfinite(state.root.p).all():
            # Whatever happens to this frame, the root stays where its path has led.
            pose = replace(pose, p_world_root=np.array(state.root.p))
        if sample is None:
            return state, pose, NO_SAMPLE
        before, period = state.refined_s, 1 / self.rate_hz
        dt = period if before is None else pose.time_s - before
        if not 0 < dt <= max(self.settings.gap_s, 1.5 * period):
            root = replace(state.root, soles=None)
            memory = self.refinement.start()
            state = replace(state, refined_s=pose.time_s, memory=memory, root=root)
            return state, pose, TIME_GAP if dt > 0 else TIME_BACK
        memory, refined = self.refinement.refine(state.memory, pose, sample, dt)
        _add(counts, refined.events)
        root, p = state.root, pose.p_world_root
        if self.settings.translation:
            root = self._located(root, refined.R_parent_joint, p, sample, dt)
            p = root.p
        state = replace(state, refined_s=pose.time_s, memory=memory, root=root)
        out = Pose(pose.time_s, refined.R_parent_joint, p, refined.std_rad, pose.note)
        return state, out, refined.reason

    def _located(
        self, root: contact.RootState, R: Array, p: Array, sample: Sample, dt: float
    ) -> contact.RootState:
        """The root's path one frame on, with the pelvis sensor's acceleration where it is worn."""
        pelvis = self.refinement.pelvis
        acc = np.full(3, np.nan) if pelvis is None else sample.acc_world[pelvis]
        return self._contact.step(root, self._contact.soles(R), acc, dt, p)

    def _held(self, state: TrackerState, time_s: float) -> Pose:
        """The last pose once more, or the rest pose where there is none."""
        if state.last is not None:
            return replace(state.last, time_s=time_s, note="")
        return Pose(time_s, np.tile(np.eye(3), (24, 1, 1)), np.zeros(3))


def _add(counts: defaultdict[str, int], events: Mapping[str, int]) -> None:
    """Count the events, in place."""
    for name, times in events.items():
        counts[name] += times
