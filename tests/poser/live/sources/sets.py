"""Simulated sets of devices that wear a recording, one class a kind: what tests and benchmarks send."""

from __future__ import annotations

import socket
import struct

import numpy as np

from mocap import orientation as ori
from mocap.recording import Recording
from poser.live.addresses import Address
from poser.live.receiver import Receiver
from poser.live.sources import dot
from poser.live.sources.dot import Dot
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


SETS = {"text": TextSet, "dot": DotSet}
START_S = 500.0  # of the devices' clocks


def at(k: int) -> float:
    """A device's time of a frame."""
    return START_S + k / RATE
