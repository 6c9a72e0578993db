"""Xsens DOT: golden notifications, and a client that stands for Bluetooth."""

from __future__ import annotations

import asyncio
import struct
import time as real
from collections.abc import Callable
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.recording import Recording
from poser.live.packets import Packet, Rejected
from poser.live.sources import dot
from poser.live.sources.dot import Bluetooth, Dot
from poser.live.sources.threads import Letter, Threaded
from tests.poser.live.sources.conftest import RATE, wxyz, zup

NAME = "d4:22:cd:00:00:01"


def read(reader: Dot, body: bytes, what: bytes = dot.MEASURED) -> list[Packet | Rejected]:
    return list(reader.read(Letter(what + body, NAME, 1.0)))


def test_a_notification_of_the_documented_layout() -> None:
    """1.5 s; w = 1; 1 m/s^2 up, which is z of the sensor's world."""
    golden = bytes.fromhex(
        "60e31600 0000803f 00000000 00000000 00000000 00000000 00000000 0000803f"
    )
    [packet] = read(Dot(), golden)
    assert isinstance(packet, Packet)
    assert (packet.device, packet.time_s) == (NAME, 1.5)
    np.testing.assert_allclose(packet.R_world_sensor, ori.R_YUP_ZUP)
    np.testing.assert_allclose(packet.acc_world, [0, 1, 0])


def test_the_clock_goes_on_where_it_wraps() -> None:
    reader = Dot()
    times = []
    for us in (2**32 - 20_000, 2**32 - 3_000, 13_000):
        [packet] = read(reader, struct.pack("<I7f", us, 1, 0, 0, 0, 0, 0, 0))
        assert isinstance(packet, Packet)
        times.append(packet.time_s)
    np.testing.assert_allclose(np.diff(times), [0.017, 0.016])


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"", "too short"),
        (struct.pack("<I7f", 1, 0, 0, 0, 0, 0, 0, 0), "not a unit quaternion"),
        (struct.pack("<I7f", 1, np.nan, 0, 0, 0, 0, 0, 0), "not finite"),
        (struct.pack("<I7f", 1, 1, 0, 0, 0, 0, 0, 1e9), "out of range"),
    ],
)
def test_what_does_not_fit_is_refused(body: bytes, reason: str) -> None:
    [found] = read(Dot(), body)
    assert isinstance(found, Rejected) and found.reason == reason


class Air:
    """Stands for bleak: sensors that replay a recording while they are told to measure."""

    def __init__(self, recording: Recording, names: list[str]):
        self.recording, self.names = recording, names
        self.written: list[tuple[str, str, bytes]] = []
        self.scans = 0
        self.broken: set[str] = set()
        self.drop_at: dict[str, int] = {}
        air = self

        class Scanner:
            @staticmethod
            async def discover(timeout: float) -> list[Any]:
                air.scans += 1
                await asyncio.sleep(0.01)
                return [SimpleNamespace(name=n, address=f"D4:22:CD:00:00:0{k}")
                        for k, n in enumerate(air.names)]  # fmt: skip

        class Client:
            def __init__(self, device: Any, disconnected_callback: Callable[[Any], None]):
                self.device, self.gone = device, disconnected_callback
                self.callback: Callable[[Any, bytearray], None] | None = None
                self.task: asyncio.Task[None] | None = None

            async def __aenter__(self) -> Any:
                if self.device.address in air.broken:
                    air.broken.discard(self.device.address)
                    raise OSError("device is not there")
                return self

            async def __aexit__(self, *_: object) -> None:
                if self.task is not None:
                    self.task.cancel()

            async def read_gatt_char(self, uuid: str) -> bytearray:
                assert uuid == dot.BATTERY
                return bytearray([87, 0])

            async def start_notify(self, uuid: str, callback: Any) -> None:
                assert uuid == dot.PAYLOAD
                self.callback = callback

            async def write_gatt_char(self, uuid: str, data: bytes, response: bool) -> None:
                air.written.append((self.device.address, uuid, data))
                if data == dot.START:
                    self.task = asyncio.create_task(self._measure())

            async def _measure(self) -> None:
                s = int(self.device.address[-1])
                for k in range(len(air.recording)):
                    if air.drop_at.get(self.device.address) == k:
                        del air.drop_at[self.device.address]
                        self.gone(self)
                        return
                    R = zup(air.recording.R_world_bone[k, s])
                    acc = ori.R_ZUP_YUP @ np.nan_to_num(air.recording.acc_world[k, s])
                    assert self.callback is not None
                    us = round(k / RATE * 1e6)
                    self.callback(None, bytearray(struct.pack("<I7f", us, *wxyz(R), *acc)))
                    await asyncio.sleep(0.001)

        self.BleakScanner, self.BleakClient = Scanner, Client


def listen(intake: Threaded, seconds: float) -> list[Packet]:
    found, until = [], real.monotonic() + seconds
    while real.monotonic() < until:
        found += [p for p, _, _ in intake.receive(0.01)]
    return found


def test_sensors_are_found_and_measure(worn: Recording) -> None:
    air = Air(worn, ["Xsens DOT", "a lamp", "Movella DOT"])
    with closing(Threaded(Dot(), Bluetooth(air))) as intake:
        intake.open()
        found = listen(intake, 1.2)
    names = {"d4:22:cd:00:00:00": 0, "d4:22:cd:00:00:02": 2}
    assert {p.device for p in found} == set(names)
    for p in found:
        k, s = round(p.time_s * RATE), names[p.device]
        np.testing.assert_allclose(p.R_world_sensor, worn.R_world_bone[k, s], atol=1e-6)
        np.testing.assert_allclose(p.acc_world, np.nan_to_num(worn.acc_world[k, s]), atol=1e-5)
    assert [h.battery for h in intake.heard().values()] == [0.87, 0.87]
    # What was started is stopped.
    assert {a for a, _, data in air.written if data == dot.STOP} == {a.upper() for a in names}
    assert all(uuid == dot.CONTROL for _, uuid, _ in air.written)


def test_a_sensor_that_goes_away_is_found_again(
    worn: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dot, "AGAIN_S", 0.05)
    air = Air(worn, ["Xsens DOT"])
    air.broken, air.drop_at = {"D4:22:CD:00:00:00"}, {"D4:22:CD:00:00:00": 30}
    with closing(Threaded(Dot(), Bluetooth(air))) as intake:
        intake.open()
        found = listen(intake, 1.5)
    assert intake.rejected["connection failed"] == 1
    starts = sum(data == dot.START for _, _, data in air.written)
    assert starts == 2
    times = [p.time_s for p in found]
    assert times.count(0.0) == 2  # measured anew


def test_no_bluetooth_is_counted_and_ends_in_time(
    monkeypatch: pytest.MonkeyPatch, worn: Recording
) -> None:
    monkeypatch.setattr(dot, "AGAIN_S", 0.05)
    air = Air(worn, [])

    async def fails(timeout: float) -> list[Any]:
        raise OSError("no adapter")

    air.BleakScanner.discover = staticmethod(fails)  # type: ignore[method-assign]
    intake = Threaded(Dot(), Bluetooth(air))
    intake.open()
    assert listen(intake, 0.3) == []
    began = real.monotonic()
    intake.close()
    assert real.monotonic() - began < 2.0
    assert intake.rejected["no Bluetooth"] >= 2
