"""Poses as streams of the Lab Streaming Layer, for labs that record EEG or force plates beside them.

Two streams of type MoCap, by the library pylsl (extra `lsl`): `poser rotations`, local joint rotations as
quaternions w x y z (NAME.qw ..), and `poser positions`, joints in the world in m, y up (NAME.x ..). A
sample's time on LSL's clock is that of its pose, by the quickest sample of the last seconds: the moment
itself was earlier by the latency that poser tells.
"""

from __future__ import annotations

from typing import Any

from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.estimator import Pose
from mocap.skeleton import JOINTS, Skeleton
from poser.console import UsageError
from poser.live.device_clock import WINDOW_S
from poser.live.sinks.protocol import Sink, SinkKind, SinkOrder

STREAMS = (
    ("rotations", ("qw", "qx", "qy", "qz"), "normalized"),
    ("positions", ("x", "y", "z"), "meters"),
)


def library() -> Any:
    """The package `pylsl`; raises PoserError where it is not installed or finds no liblsl."""
    try:
        import pylsl
    except (ImportError, RuntimeError) as e:
        raise PoserError("LSL needs the package 'pylsl': pip install 'poser-imu[lsl]'") from e
    return pylsl


class LslSink:
    """The outlets. pylsl: the library, or what stands for it."""

    name = "lsl"

    def __init__(self, skeleton: Skeleton, rate_hz: float, pylsl: Any):
        self._skeleton, self._pylsl = skeleton, pylsl
        self._outlets = [self._outlet(rate_hz, *stream) for stream in STREAMS]
        self._offset: tuple[float, float] | None = (
            None  # LSL's time less the pose's, and since when
        )
        self.pushed = 0

    def _outlet(self, rate_hz: float, what: str, parts: tuple[str, ...], unit: str) -> Any:
        count = len(JOINTS) * len(parts)
        info = self._pylsl.StreamInfo(
            f"poser {what}", "MoCap", count, rate_hz, "float32", f"poser-{what}"
        )
        channels = info.desc().append_child("channels")
        for joint in JOINTS:
            for part in parts:
                channel = channels.append_child("channel")
                channel.append_child_value("label", f"{joint}.{part}")
                channel.append_child_value("unit", unit)
        return self._pylsl.StreamOutlet(info)

    def write(self, pose: Pose) -> None:
        now = self._pylsl.local_clock()
        offset = now - pose.time_s
        if self._offset is None or offset < self._offset[0] or now - self._offset[1] > WINDOW_S:
            self._offset = offset, now
        _, p = self._skeleton.forward(pose.R_parent_joint, pose.p_world_root)
        values = (ori.to_quat(pose.R_parent_joint), p)
        for outlet, what in zip(self._outlets, values, strict=True):
            outlet.push_sample(what.ravel().tolist(), pose.time_s + self._offset[0])
        self.pushed += 1

    def close(self) -> dict[str, Any]:
        self._outlets.clear()
        return {"pushed": self.pushed}


def _make(told: SinkOrder) -> Sink:
    if told.text:
        raise UsageError("argument --sink: lsl has no address")
    return LslSink(told.skeleton, told.rate_hz, library())


SINK = SinkKind("lsl", "lsl", "Lab Streaming Layer: rotations and positions", _make)
