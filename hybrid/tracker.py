"""The real-time tracker: any network's estimator inside a moving horizon, that never misses a frame.

Every sample enters the window (`hybrid.window`), and what the network says of it as soon as it does; the
pose given is the window's, `lag` frames old. Where there is no window, or none of its poses, the network's
pose is refined with the sample of its own time (`hybrid.refinement`). Whatever goes wrong gives that, the
network's pose, or the last one, with the reason in `Pose.note` and a count in the state.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hybrid import contact, incoming
from hybrid.refinement import Memory, Refinement
from hybrid.settings import TrackerSettings
from hybrid.tasks import Task
from hybrid.window import NO_TIME, NO_WINDOW, Window, WindowFailed, WindowState
from mocap import checked
from mocap import sensors as places
from mocap.errors import PoserError, SensorError
from mocap.estimator import NO_MEASUREMENT, Estimator, Pose, Sample
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
    all and by reason, and what was left out of refined frames. proposals: the network's latest poses, oldest
    first. window: of the moving horizon, None without one; gone: why it has no pose of frames before it.
    """

    network: Any
    samples: tuple[Sample, ...]
    memory: Memory
    root: contact.RootState
    last: Pose | None = None
    refined_s: float | None = None
    received: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    proposals: tuple[Pose, ...] = ()
    window: WindowState | None = None
    gone: str = NO_WINDOW

    @property
    def fallbacks(self) -> int:
        """Frames whose pose is not a refined one."""
        return self.counts.get("fallback", 0)


class Tracker:
    """`Estimator` around a network's `Estimator`: same rate and sensors; `look_ahead_frames` is the lag.

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
        if not hasattr(network, "step"):
            raise PoserError(f"Tracker: network must be an estimator, got {type(network).__name__}")
        self.network = network
        self.settings = TrackerSettings.around(network) if settings is None else settings
        checked.instance(self.settings, TrackerSettings, "Tracker: settings")
        self.rate_hz = check_rate(network.rate_hz, "Tracker")
        self.sensors = tuple(network.sensors)
        self._late = int(network.look_ahead_frames)
        lag = self.settings.lag
        self.look_ahead_frames = self._late if lag is None else lag
        self.skeleton = Skeleton.default() if skeleton is None else skeleton
        checked.instance(self.skeleton, Skeleton, "Tracker: skeleton")
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
        self.window: Window | None = None
        if self.settings.horizon_s:
            self.window = Window(
                self.skeleton, np.asarray(joint), np.asarray(seat, float), self.rate_hz,
                self.settings, self._late, self.look_ahead_frames,
            )  # fmt: skip

    def init(self) -> TrackerState:
        """A fresh state."""
        window = None if self.window is None else self.window.start()
        return TrackerState(
            self.network.init(), (), self.refinement.start(), contact.start(), window=window
        )

    def step(self, state: TrackerState, sample: Sample) -> tuple[TrackerState, Pose | None]:
        """Feed one sample; the pose of `look_ahead_frames` ago, or None before the first."""
        began = time.perf_counter()
        counts = defaultdict(int, state.counts)
        expected = state.samples[-1].time_s + 1 / self.rate_hz if state.samples else 0.0
        sample, events = incoming.clean(sample, len(self.sensors), expected)
        _add(counts, events)
        kept = max(self.look_ahead_frames, self._late) + 1 + SPARE_SAMPLES
        samples = (*state.samples, sample)[-kept:]
        received = state.received + 1
        network, pose, trouble = self._ask(state.network, sample)
        if pose is None and received <= self._late:
            if trouble != NETWORK_SILENT:
                counts[trouble] += 1
            trouble = ""
        state = replace(state, network=network, samples=samples, received=received)
        if self.window is not None:
            state = self._horizon(self.window, state, sample, pose, began, counts)
        if received <= self.look_ahead_frames and (pose is None or self.window is not None):
            return replace(state, counts=dict(counts)), None
        state, pose, reason = self._given(state, pose, trouble, counts)
        counts["frames"] += 1
        if reason:
            counts[reason] += 1
            counts["fallback"] += 1
            pose = replace(pose, note="; ".join(n for n in (reason, pose.note) if n))
        return replace(state, last=pose, counts=dict(counts)), pose

    def _horizon(
        self,
        window: Window,
        state: TrackerState,
        sample: Sample,
        pose: Pose | None,
        began: float,
        counts: defaultdict[str, int],
    ) -> TrackerState:
        """The state with the sample and the network's pose in the window."""
        before, reason = state.window, ""
        assert before is not None
        if len(state.samples) > 1:
            dt = sample.time_s - state.samples[-2].time_s
            reason = self._break(dt) or ("" if window.fills(dt) else TIME_GAP)
        if reason:
            before = window.restarted(before)
        said = pose if pose is not None and not pose.note else None
        try:
            after = window.step(before, sample, said, began, counts)
        except WindowFailed as e:
            after, reason = window.restarted(before), str(e)
        if not reason and after.pause:
            reason = NO_TIME
        proposals = state.proposals if pose is None else (*state.proposals, pose)
        return replace(
            state,
            window=after,
            gone=reason or state.gone,
            proposals=proposals[-len(state.samples) :],
        )

    def _break(self, dt: float) -> str:
        """What is wrong with a sample that is dt s after the one before, or nothing."""
        if 0 < dt <= max(self.settings.gap_s, 1.5 / self.rate_hz):
            return ""
        return TIME_GAP if dt > 0 else TIME_BACK

    def _given(
        self, state: TrackerState, pose: Pose | None, trouble: str, counts: defaultdict[str, int]
    ) -> tuple[TrackerState, Pose, str]:
        """The state after this frame, its pose, and why the pose is a fallback."""
        if self.window is None or state.window is None:
            return self._pose(state, pose, trouble, counts)
        if pose is not None and pose.note:
            counts[NETWORK_NOTE] += 1
        due = state.samples[-1 - min(self.look_ahead_frames, len(state.samples) - 1)]
        window, found = self.window.pose(state.window, due.time_s, state.last)
        state = replace(state, window=window)
        if found is not None:
            seen = (due.valid & np.isfinite(due.R_world_bone).all((-1, -2))).any()
            if not self.settings.translation and pose is not None:
                found = replace(found, p_world_root=pose.p_world_root)
            return state, found, trouble or ("" if seen else NO_MEASUREMENT)
        return self._single(state, due, trouble, counts)

    def _single(
        self, state: TrackerState, due: Sample, trouble: str, counts: defaultdict[str, int]
    ) -> tuple[TrackerState, Pose, str]:
        """As `_pose`, of a frame that the window has no pose of: the network's nearest to its time."""
        if not state.proposals:
            return state, self._held(state, due.time_s), trouble or state.gone
        pose = min(reversed(state.proposals), key=lambda p: abs(p.time_s - due.time_s))
        p = pose.p_world_root if state.last is None else state.last.p_world_root
        pose = replace(pose, time_s=due.time_s, p_world_root=np.array(p))
        before = state.refined_s
        dt = 1 / self.rate_hz if before is None else due.time_s - before
        if self._break(dt):
            dt, state = 1 / self.rate_hz, replace(state, memory=self.refinement.start())
        memory, refined = self.refinement.refine(state.memory, pose, due, dt)
        _add(counts, refined.events)
        state = replace(state, memory=memory, refined_s=due.time_s)
        out = Pose(due.time_s, refined.R_parent_joint, np.array(p), refined.std_rad, pose.note)
        return state, out, trouble or refined.reason or state.gone

    def told_late(self, state: TrackerState, late_s: float) -> TrackerState:
        """The state, told how many s too late its next sample is taken (`mocap.estimator.told_late`)."""
        if state.window is None:
            return state
        return replace(state, window=replace(state.window, late_s=late_s))

    def facts(self, state: TrackerState) -> dict[str, Any]:
        """Figures of the run so far: lag_frames; of the window its frames now and at most, steps a frame,
        what happened to it; and, where they are estimated, heading_deg by sensor as taken out now."""
        if self.window is None or state.window is None:
            return {"window_frames": 0}
        found = self.window.facts(state.window, state.counts)
        u = self.window.constants(state.window)
        if u is not None:
            named = zip(self.sensors, u, strict=True)
            found["heading_deg"] = {n: float(np.rad2deg(c[3])) for n, c in named}
        return found

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
        before = state.refined_s
        dt = 1 / self.rate_hz if before is None else pose.time_s - before
        if reason := self._break(dt):
            root = replace(state.root, soles=None)
            memory = self.refinement.start()
            state = replace(state, refined_s=pose.time_s, memory=memory, root=root)
            return state, pose, reason
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
