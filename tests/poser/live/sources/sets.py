"""Simulated sets of devices that wear a recording, one class a kind: what tests and benchmarks send."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Sequence

import numpy as np

from mocap import orientation as ori
from mocap.recording import Recording
from poser.live.addresses import Address
from poser.live.receiver import Receiver
from poser.live.sources import dot, phyphox
from poser.live.sources.dot import Dot
from poser.live.sources.phyphox import Input, Phyphox
from poser.live.sources.sensorlogger import SensorLogger
from poser.live.sources.text import Text
from poser.live.sources.threads import Mailbox, Threaded
from tests.poser.live.sources.conftest import RATE, Time, wxyz, zup

Frame = tuple[int, bytes]
"""Whose it is, and what it sends."""


class Post:
    """A worker that brings letters without a network."""

    def start(self, post: Mailbox) -> None:
        self.box = post

    def stop(self) -> None: ...


class TextSet:
    """Phones with IMUCoCo's app: lines over UDP."""

    garbage, reason = b"\xff\xfe\x00", "not text"

    def __init__(self, recording: Recording, time: Time):
        self.recording = recording
        self.intake = Receiver(Address("127.0.0.1", 0), Text(), time)
        self._sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]

    def where(self) -> dict[str, str]:
        return {f"p{s}_phone": name for s, name in enumerate(self.recording.sensors)}

    def frame(self, s: int, k: int, time_s: float) -> bytes:
        R, acc = self.recording.R_world_bone[k, s], np.nan_to_num(self.recording.acc_world[k, s])
        w, *xyz = wxyz(zup(R))
        a, down = -R.T @ acc / ori.GRAVITY, -R.T @ np.array([0, 1.0, 0])
        words = " ".join(repr(float(x)) for x in (time_s, *a, *down, 0, 0, 0, *xyz, w))
        return f"p{s};phone;motion:{words}\n".encode()

    def bring(self, s: int, body: bytes, other: bool = False) -> None:
        self._sockets[other].sendto(body, ("127.0.0.1", self.intake.port))

    def close(self) -> None:
        for s in self._sockets:
            s.close()


class DotSet:
    """DOTs, whose notifications are there without Bluetooth."""

    garbage, reason = b"\x01\x02", "too short"

    def __init__(self, recording: Recording, time: Time):
        self.recording, self._post = recording, Post()
        self.intake = Threaded(Dot(), self._post, time)

    @staticmethod
    def _name(s: int) -> str:
        return f"d4:22:cd:00:00:0{s}"

    def where(self) -> dict[str, str]:
        return {self._name(s): name for s, name in enumerate(self.recording.sensors)}

    def frame(self, s: int, k: int, time_s: float) -> bytes:
        acc = ori.R_ZUP_YUP @ np.nan_to_num(self.recording.acc_world[k, s])
        q = wxyz(zup(self.recording.R_world_bone[k, s]))
        return struct.pack("<I7f", round(time_s * 1e6) % 2**32, *q, *acc)

    def bring(self, s: int, body: bytes, other: bool = False) -> None:
        self._post.box.put(dot.MEASURED + body, self._name(s))

    def close(self) -> None: ...


Rows = Sequence[tuple[int, float]]
"""Frames and the device's times of them."""


class LoggerSet:
    """Phones with Sensor Logger, Android's way, whose posts are there without HTTP."""

    garbage, reason = b"\xff", "not JSON"

    def __init__(self, recording: Recording, time: Time):
        self.recording, self._post = recording, Post()
        self.intake = Threaded(SensorLogger(), self._post, time)
        self._messages = [0] * len(recording.sensors)

    def where(self) -> dict[str, str]:
        return {f"p{s}": name for s, name in enumerate(self.recording.sensors)}

    def frame(self, s: int, k: int, time_s: float) -> bytes:
        return self.batch(s, [(k, time_s)])

    def batch(self, s: int, rows: Rows) -> bytes:
        payload, self._messages[s] = [], self._messages[s] + 1
        for k, time_s in rows:
            q, acc, gravity = carried(self.recording, s, k)
            values = (
                ("orientation", dict(zip(("qw", "qx", "qy", "qz"), q, strict=True))),
                ("accelerometer", dict(zip("xyz", acc, strict=True))),
                ("gravity", dict(zip("xyz", gravity, strict=True))),
            )
            payload += [{"name": n, "time": round(time_s * 1e9), "values": v} for n, v in values]
        session = "first" if rows[0][1] >= START_S else "second"
        told = {"messageId": self._messages[s], "sessionId": session, "deviceId": f"p{s}"}
        return json.dumps(told | {"payload": payload}).encode()

    def bring(self, s: int, body: bytes, other: bool = False) -> None:
        self._post.box.put(body, f"192.168.0.{100 + s if other else s}")

    def close(self) -> None: ...


class PhyphoxSet:
    """Phones with phyphox, whose answers are there without HTTP."""

    garbage, reason = b"<html>", "not JSON"
    inputs = (
        Input("attitude", "tt", ("tw", "tx", "ty", "tz")),
        Input("linear_acceleration", "at", ("ax", "ay", "az")),
        Input("gravity", "gt", ("gx", "gy", "gz")),
    )

    def __init__(self, recording: Recording, time: Time):
        self.recording, self._post = recording, Post()
        self.intake = Threaded(Phyphox(), self._post, time)
        self._described: set[int] = set()

    @staticmethod
    def _name(s: int) -> str:
        return f"192.168.0.{s}:8080"

    def where(self) -> dict[str, str]:
        return {self._name(s): name for s, name in enumerate(self.recording.sensors)}

    def frame(self, s: int, k: int, time_s: float) -> bytes:
        return self.batch(s, [(k, time_s)])

    def batch(self, s: int, rows: Rows) -> bytes:
        found = [carried(self.recording, s, k) for k, _ in rows]
        buffers: dict[str, list[float]] = {}
        for n, wanted in enumerate(self.inputs):
            buffers[wanted.time] = [time_s for _, time_s in rows]
            for c, name in enumerate(wanted.parts):
                buffers[name] = [values[n][c] for values in found]
        session = "first" if rows[0][1] >= START_S else "second"
        return json.dumps(
            {
                "buffer": {n: {"buffer": v} for n, v in buffers.items()},
                "status": {"session": session, "measuring": True},
            }
        ).encode()

    def bring(self, s: int, body: bytes, other: bool = False) -> None:
        if s not in self._described:
            self._described.add(s)
            self._post.box.put(phyphox.DESCRIBED + phyphox.described(self.inputs), self._name(s))
        self._post.box.put(phyphox.ANSWERED + body, self._name(s))

    def close(self) -> None: ...


def carried(recording: Recording, s: int, k: int) -> tuple[list[float], list[float], list[float]]:
    """What a phone says of a frame: its quaternion, acceleration and gravity in its own axes."""
    R, acc = recording.R_world_bone[k, s], np.nan_to_num(recording.acc_world[k, s])
    return wxyz(zup(R)), (R.T @ acc).tolist(), (R.T @ np.array([0, ori.GRAVITY, 0])).tolist()


SETS = {"text": TextSet, "dot": DotSet, "sensorlogger": LoggerSet, "phyphox": PhyphoxSet}
START_S = 500.0  # of the devices' clocks


def at(k: int) -> float:
    """A device's time of a frame."""
    return START_S + k / RATE
