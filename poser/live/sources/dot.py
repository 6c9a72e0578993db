"""Xsens (Movella) DOT over Bluetooth, by the library bleak (extra `dot`).

Sensors that advertise themselves as Xsens or Movella DOT are connected one after another. Writing
`[1, 1, 3]` to the measurement control 2001 starts the payload "extended quaternion", which comes as
notifications on 2003, little-endian:

    u32 time in us, f32 quaternion w x y z, f32 free acceleration x y z m/s^2, in all 32 bytes

in a local earth frame that is z-up; gravity is removed. 3001 has the battery in percent. A sensor's name
is its Bluetooth address, in lower case. A sensor that goes away is looked for again.
"""

from __future__ import annotations

import asyncio
import struct
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.errors import PoserError
from poser.live.heard import Heard
from poser.live.packets import MAX_ACC, SEQUENCE_MODULUS, Packet, Rejected, number, rotation
from poser.live.sources.protocol import MAX_DEVICES, Intake, Kind, Told
from poser.live.sources.threads import Letter, Mailbox, Threaded

CONTROL, PAYLOAD, BATTERY = (
    f"1517{short}-4947-11e9-8646-d663bd873d93" for short in ("2001", "2003", "3001")
)
START, STOP = bytes([1, 1, 3]), bytes([1, 0, 3])
NAMES = ("xsens dot", "movella dot")
SIZE = 32
LOOK_S = 5.0  # a scan
AGAIN_S = 1.0
GOODBYE_S = 5.0
WRAP_S = 2**32 / 1e6
MEASURED, CHARGED = b"m", b"b"  # the first byte of a letter: what follows


class Bluetooth:
    """The worker: an event loop in a thread. library: bleak, or what stands for it."""

    def __init__(self, library: Any):
        self._library = library
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._over: asyncio.Event | None = None
        self._connected: set[str] = set()

    def start(self, post: Mailbox) -> None:
        ready = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(post, ready), daemon=True)
        self._thread.start()
        ready.wait(AGAIN_S)

    def _run(self, post: Mailbox, ready: threading.Event) -> None:
        asyncio.run(self._search(post, ready))

    async def _search(self, post: Mailbox, ready: threading.Event) -> None:
        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        ready.set()
        tasks: set[asyncio.Task[None]] = set()
        while not self._over.is_set():
            try:
                found = await self._library.BleakScanner.discover(timeout=LOOK_S)
            except Exception:
                # Whatever its backend raises: no adapter, switched off, not allowed.
                post.fault("no Bluetooth")
                found = []
            for device in () if self._over.is_set() else found:
                named = (device.name or "").lower().startswith(NAMES)
                if named and device.address not in self._connected and len(tasks) < MAX_DEVICES:
                    self._connected.add(device.address)
                    task = asyncio.create_task(self._stay(device, post))
                    tasks.add(task)
                    task.add_done_callback(tasks.discard)
            await self._pause(AGAIN_S)
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _pause(self, seconds: float) -> None:
        assert self._over is not None
        try:
            await asyncio.wait_for(self._over.wait(), seconds)
        except TimeoutError:
            return

    async def _stay(self, device: Any, post: Mailbox) -> None:
        """Connect, measure, and stay until the sensor goes away or all ends."""
        assert self._over is not None
        name, gone = device.address.lower(), asyncio.Event()
        try:
            client = self._library.BleakClient(device, disconnected_callback=lambda _: gone.set())
            async with client:
                level = await client.read_gatt_char(BATTERY)
                post.put(CHARGED + bytes(level[:1]), name)
                await client.start_notify(PAYLOAD, lambda _, data: post.put(MEASURED + data, name))
                await client.write_gatt_char(CONTROL, START, response=True)
                ends = [asyncio.create_task(e.wait()) for e in (gone, self._over)]
                await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
                for end in ends:
                    end.cancel()
                if not gone.is_set():
                    await client.write_gatt_char(CONTROL, STOP, response=True)
        except Exception:
            # Again whatever the backend raises: the sensor is looked for again.
            post.fault("connection failed")
        finally:
            self._connected.discard(device.address)

    def stop(self) -> None:
        if self._loop is not None and self._over is not None and not self._loop.is_closed():
            try:
                self._loop.call_soon_threadsafe(self._over.set)
            except RuntimeError:
                return  # closed meanwhile
        if self._thread is not None:
            self._thread.join(timeout=LOOK_S + GOODBYE_S)


class Dot:
    """The reader of notifications."""

    batched = False

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, float, int]] = {}  # s as sent, s of wraps, packets
        self._battery: dict[str, float] = {}

    def read(self, letter: Letter) -> Iterator[Packet | Rejected]:
        what, body = letter.body[:1], letter.body[1:]
        if what == CHARGED:
            if body:
                self._battery[letter.sender] = min(body[0], 100) / 100.0
            return
        try:
            yield self._packet(body, letter.sender)
        except Rejected as e:
            yield e

    def _packet(self, body: bytes, name: str) -> Packet:
        if len(body) < SIZE:
            raise Rejected("too short")
        us, *values = struct.unpack_from("<I7f", body)
        R = ori.R_YUP_ZUP @ rotation(np.array([number(v, 2.0) for v in values[:4]]))
        acc = ori.R_YUP_ZUP @ np.array([number(v, MAX_ACC) for v in values[4:]])
        sent = us / 1e6
        before, wrapped, count = self._last.get(name, (sent, 0.0, 0))
        if before - sent > WRAP_S / 2:
            wrapped += WRAP_S
        self._last[name] = sent, wrapped, count + 1
        # A connection keeps the order: what did not come will not come.
        return Packet(name, sent + wrapped, R, acc, (count + 1) % SEQUENCE_MODULUS)

    def heard(self) -> Mapping[str, Heard]:
        names = {*self._last, *self._battery}
        return {n: Heard(battery=self._battery.get(n)) for n in sorted(names)}


def _library() -> Any:
    try:
        import bleak
    except ImportError as e:
        raise PoserError("Xsens DOT needs the package 'bleak': pip install 'poser-imu[dot]'") from e
    return bleak


def _make(told: Told) -> Intake:
    return Threaded(Dot(), Bluetooth(_library()), told.clock)


SOURCE = Kind("dot", "Xsens (Movella) DOT over Bluetooth", _make, None)
