"""Where samples come from: a recording at its own pace, or devices as they are heard."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mocap.calibration import Calibration
from mocap.errors import CalibrationError
from mocap.estimator import Sample, samples
from mocap.findings import Finding
from mocap.orientation import Array
from mocap.recording import Recording
from poser.live import sender_words, senders
from poser.live.aligner import Aligner
from poser.live.alignment import to_sample
from poser.live.assembler import Assembler, Row
from poser.live.devices import DeviceTracker
from poser.live.packets import TIME_TOO_LARGE
from poser.live.receiver import Now
from poser.live.recorder import Recorder
from poser.live.sources.protocol import Intake, Witness

IDLE_S = 0.002  # the longest wait for something to happen, so that rows leave on time
MOST_UNKNOWN = 3  # names of unknown devices that are kept: senders choose them, and never end
GATHER_S = 1.0  # devices that start together show what their clocks are within this time
SOON_S = 1e-6  # a sample this near its time is due: sleeping for less is no sleep


class Source(Protocol):
    """What the loop polls. rate_hz, sensors: of the samples."""

    rate_hz: float
    sensors: tuple[str, ...]

    @property
    def joint(self) -> NDArray[np.int64] | None:
        """(S,) the joint that each sensor follows; None where only its name tells it."""
        ...

    @property
    def seat(self) -> Array | None:
        """(S,3) m where each sensor sits; None where only its name tells it."""
        ...

    def read(self, sensors: tuple[str, ...]) -> None:
        """From now on samples are of these of its sensors, in this order."""
        ...

    def open(self) -> None:
        """Begin: time counts from here. Raises PoserError where it cannot."""
        ...

    @property
    def ended(self) -> bool:
        """Nothing more will come."""
        ...

    def poll(self) -> list[Sample]:
        """The samples that are due, in order; waits a little where there are none."""
        ...

    @property
    def turns(self) -> int:
        """How often the world of its samples has changed: what was estimated before counts no more."""
        ...

    def lag_s(self, time_s: float) -> float | None:
        """How long ago in s the moment was that a sample's time names; None where time means nothing."""
        ...

    def behind_s(self, time_s: float) -> float:
        """How much later in s than its own pace a sample is that is taken now; 0 where there is no pace."""
        ...

    def facts(self) -> dict[str, Any]:
        """What happened so far, for the report."""
        ...

    def close(self) -> None: ...


class RecordingSource:
    """The samples of a recording when they are due. speed: 2 is twice as fast, None as fast as asked."""

    def __init__(
        self,
        recording: Recording,
        speed: float | None = 1.0,
        clock: Now = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ):
        self.rate_hz, self._recording = recording.rate_hz, recording
        self._speed, self._clock, self._sleep = speed, clock, sleep
        self._first_s = recording.start_s
        self._began: float | None = None
        self.read(recording.sensors)

    def read(self, sensors: tuple[str, ...]) -> None:
        chosen = self._recording.select(sensors)
        self.sensors, self.joint, self.seat = sensors, chosen.joint, chosen.placement
        self._samples = samples(chosen)
        self._next: Sample | None = next(self._samples)

    def open(self) -> None:
        self._began = self._clock()

    turns = 0

    @property
    def ended(self) -> bool:
        return self._next is None

    def poll(self) -> list[Sample]:
        due: list[Sample] = []
        if self._speed is None:
            self._take(due)
            return due
        while self._next is not None and self._lag(self._next.time_s) > -SOON_S:
            self._take(due)
        if self._next is not None and not due:
            # The time may have come while we looked.
            self._sleep(max(0.0, min(IDLE_S, -self._lag(self._next.time_s))))
        return due

    def _take(self, due: list[Sample]) -> None:
        if self._next is not None:
            due.append(self._next)
        self._next = next(self._samples, None)

    def _lag(self, time_s: float) -> float:
        assert self._began is not None and self._speed is not None
        return self._clock() - self._began - (time_s - self._first_s) / self._speed

    def lag_s(self, time_s: float) -> float | None:
        return None if self._speed is None or self._began is None else self._lag(time_s)

    def behind_s(self, time_s: float) -> float:
        return max(0.0, self.lag_s(time_s) or 0.0)

    def facts(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        self._samples = iter(())


class Network:
    """Samples of `sensors` from devices, through their intake.

    where: the place of each device; a device that is not in it is refused. aligner: knows the constants of
    devices, or that there are none; no sample before it does. tracker: tells instead of `where` which devices
    are worn, and where. seconds: end so long after `open`. recorder: keeps the rows as they come. up: the
    senders' vertical axis, as the intake was told. doubts: what senders do wrong, as it was found.
    """

    def __init__(
        self,
        intake: Intake,
        assembler: Assembler,
        sensors: tuple[str, ...],
        where: Mapping[str, str],
        aligner: Aligner | None = None,
        tracker: DeviceTracker | None = None,
        seconds: float | None = None,
        clock: Now = time.monotonic,
        recorder: Recorder | None = None,
        up: str = "y",
    ):
        self.rate_hz, self.sensors = assembler.rate_hz, sensors
        self.joint: NDArray[np.int64] | None = None
        self.seat: Array | None = None
        self._intake, self._assembler, self._clock = intake, assembler, clock
        self._where, self._aligner = where, aligner or Aligner()
        self._tracker, self._recorder = tracker, recorder
        self._seconds, self._end_s = seconds, np.inf
        self._heard: set[str] = set()
        self._unknown: list[str] = []
        self.doubts: list[Finding] = []
        self._doubted_s = np.inf  # since when a clock shows what was not told yet
        names = assembler.devices
        trunk = [where.get(n) in senders.TRUNK for n in names]
        self._watchman = senders.Watchman(names, trunk, self.rate_hz, up)

    def read(self, sensors: tuple[str, ...]) -> None:
        self.sensors = sensors

    def open(self) -> None:
        self._intake.open()
        if self._seconds is not None:
            self._end_s = self._clock() + self._seconds

    @property
    def ended(self) -> bool:
        return self._clock() >= self._end_s

    def poll(self) -> list[Sample]:
        for packet, arrival, since in self._intake.receive(IDLE_S):
            if packet.device not in self._assembler.devices:
                self._refuse(packet.device)
                continue
            self._heard.add(packet.device)
            if self._tracker is not None and packet.status is not None:
                self._tracker.hear(packet.device, packet.status)
            if packet.R_world_sensor is not None:
                self._assembler.push(packet, arrival, since)
        self._judge_times()
        if self._intake.ended:
            # The rows behind the last packet are not waited for.
            self._end_s = min(self._end_s, self._clock() + self._assembler.delay_s)
        # Rows wait for what has come but is not read yet.
        rows = self._assembler.pull(min(self._clock(), self._intake.read_s))
        if self._recorder is not None:
            self._recorder.take(rows, self._whole)
        due: list[Sample] = []
        for row in rows:
            self._judge(row)
            turns = self.turns
            if not self._aligned(row):
                continue
            if self.turns != turns:
                due.clear()  # of the world before
            due.append(self._sample(row))
        return due

    def _whole(self, time_s: float) -> tuple[Array, Array] | None:
        """The pose as the devices' maker has it at a row's time."""
        name = self._assembler.devices[0]
        at = self._assembler.device_time(name, time_s)
        if at is None or not isinstance(self._intake, Witness):
            return None
        return self._intake.pose(name, at)

    def _refuse(self, device: str) -> None:
        self._intake.rejected["device unknown"] += 1
        # A character a column: wide ones would wrap the line that is written over.
        name = device.encode("ascii", "backslashreplace").decode()
        if len(self._unknown) < MOST_UNKNOWN and name not in self._unknown:
            self._unknown.append(name)

    def _judge_times(self) -> None:
        """What the devices' clocks show, GATHER_S after the first of them did: one sentence for all."""
        found = senders.clocks(self._assembler.paces, self._intake.rejected[TIME_TOO_LARGE])
        told = {(f.code, n) for f in self.doubts for n in f.details.get("sensors", ("",))}
        found = [
            f
            for f in found
            if any((f.code, n) not in told for n in f.details.get("sensors", ("",)))
        ]
        now = self._clock()
        self._doubted_s = min(self._doubted_s, now) if found else np.inf
        if now - self._doubted_s >= GATHER_S:
            self.doubts += found

    def _judge(self, row: Row) -> None:
        """Raises CalibrationError where a pose is waited for that wrong accelerations would spoil."""
        for finding in self._watchman.take(row, self.waiting):
            self.doubts.append(finding)
            if finding.severity == "error" and self.waiting:
                raise CalibrationError(sender_words.sentence(finding))

    def _aligned(self, row: Row) -> bool:
        """Whether the constants are known; where they are not found, with what is known of the senders."""
        try:
            return self._aligner.push(row)
        except CalibrationError as e:
            raise CalibrationError(
                "; ".join([str(e), *map(sender_words.sentence, self.doubts)])
            ) from e

    def _sample(self, row: Row) -> Sample:
        where = self._where
        if self._tracker is not None:
            where = self._tracker.step(row, self._assembler.devices)
        return to_sample(row, self._assembler.devices, where, self.sensors, self._aligner.table)

    @property
    def calibration(self) -> Calibration | None:
        """The last one that was found."""
        return self._aligner.calibration

    @property
    def turns(self) -> int:
        return self._aligner.turns

    @property
    def resets(self) -> tuple[str, ...]:
        """What may be asked for."""
        return tuple(self._aligner.resets)

    def ask(self, how: str) -> None:
        """Ask for one of `resets`. Any thread may call this."""
        self._aligner.ask(how)

    @property
    def trouble(self) -> str:
        """Why the last reset failed; empty where it did not."""
        return self._aligner.trouble

    @property
    def waiting(self) -> bool:
        """Whether the pose has not been found yet."""
        return self._aligner.waiting

    @property
    def walks(self) -> bool:
        """Whether walking is part of the calibration."""
        return self._aligner.walks

    @property
    def prompt(self) -> str:
        """What the wearer should do now; empty once the pose is found."""
        start = self._assembler.start_s
        return "" if start is None else self._aligner.prompt(self._clock() - start)

    @property
    def missing(self) -> tuple[str, ...]:
        """Devices that nothing came from yet; none once a tracked one came, for they come and go."""
        if self._tracker is not None and self._heard:
            return ()
        return tuple(n for n in self._assembler.devices if n not in self._heard)

    @property
    def unknown(self) -> tuple[str, ...]:
        """The first MOST_UNKNOWN names of devices that are none of ours."""
        return tuple(self._unknown)

    @property
    def doubled(self) -> tuple[str, ...]:
        """Devices whose name another sender gives itself, too."""
        return tuple(n for n, c in self._assembler.counts.items() if c.others)

    def lag_s(self, time_s: float) -> float | None:
        start = self._assembler.start_s
        return None if start is None else self._clock() - start - time_s

    def behind_s(self, time_s: float) -> float:
        return max(0.0, (self.lag_s(time_s) or 0.0) - self._assembler.delay_s)

    def facts(self) -> dict[str, Any]:
        heard = self._intake.heard()
        devices = {n: c.to_dict() for n, c in self._assembler.counts.items()}
        for name, told in heard.items():
            if name in devices and told.lost is not None:
                devices[name]["lost"] = max(told.lost, devices[name]["lost"])
        out: dict[str, Any] = {
            "rejected": dict(sorted(self._intake.rejected.items())),
            "unknown_devices": list(self._unknown),
            "skipped_frames": self._assembler.skipped,
            "silent": list(self._assembler.silent(self._clock())),
            "devices": devices,
        }
        if heard:
            out["heard"] = {n: told.to_dict() for n, told in heard.items()}
        if self._tracker is not None:
            out["places"] = dict(self._tracker.where)
            out["place_changes"] = self._tracker.changes
        return out

    def close(self) -> None:
        self._intake.close()
        if self._recorder is not None:
            self._recorder.close()
