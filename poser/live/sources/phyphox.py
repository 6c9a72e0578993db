"""The app phyphox: its remote access is asked for what is new, over HTTP, port 8080 (iPhones: 80).

GET /config tells the inputs of the experiment that is open and which buffers hold them; GET
/get?NAME=LAST|TIME gives what lies behind the time LAST of the buffer TIME:

    {"buffer": {"attX": {"size": 0, "updateMode": "partial", "buffer": [0.1, ...]}, ...},
     "status": {"session": "1f00", "measuring": true, ...}}

An experiment with the inputs `attitude` (x, y, z, and w in `abs`), `linear_acceleration` and `gravity` is
needed: examples/poser.phyphox is one. Times are s since the measurement began.
Several phones: phyphox:HOST,HOST. A phone's name is its host.
"""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

import numpy as np

from mocap.orientation import Array
from poser.live.addresses import Address
from poser.live.heard import Heard
from poser.live.packets import MAX_ACC, MAX_TIME_S, Packet, Rejected, number, rotation
from poser.live.sources.order import InOrder
from poser.live.sources.phone import Phone
from poser.live.sources.protocol import Intake, Kind, Told
from poser.live.sources.threads import Letter, Mailbox, Threaded

PORT = 8080
EVERY_S = 0.05
ANSWER_S, AGAIN_S = 2.0, 1.0  # patience for an answer, and before the next try
MAX_BODY = 1 << 20
MAX_SAMPLES = 5000
INPUTS = {"attitude": "wxyz", "linear_acceleration": "xyz", "gravity": "xyz"}
DESCRIBED, ANSWERED = b"i", b"a"  # the first byte of a letter: what follows
PARTS = {"w": "abs", "x": "x", "y": "y", "z": "z"}


@dataclass(frozen=True)
class Input:
    """The buffers of one input: of its times, and of its parts in the order of INPUTS."""

    source: str
    time: str
    parts: tuple[str, ...]

    def query(self, last_s: float | None) -> str:
        """Asks for what is behind `last_s`; for all where nothing is known yet."""
        names = (self.time, *self.parts)
        if last_s is None:
            return "&".join(f"{quote(n)}=full" for n in names)
        behind = f"{last_s:.9g}|{quote(self.time)}"
        return "&".join(f"{quote(n)}={behind}" for n in names)


def inputs(config: Any) -> tuple[Input, ...]:
    """The usable inputs of an experiment, from /config. Raises Rejected where attitude is not one."""
    found = []
    for entry in config.get("inputs", []) if isinstance(config, dict) else []:
        source = str(entry.get("source", "")).lower() if isinstance(entry, dict) else ""
        if source in INPUTS and isinstance(entry.get("outputs"), list):
            names = {k: v for o in entry["outputs"] if isinstance(o, dict) for k, v in o.items()}
            parts = tuple(str(names.get(PARTS[c], "")) for c in INPUTS[source])
            if names.get("t") and all(parts):
                found.append(Input(source, str(names["t"]), parts))
    if not any(i.source == "attitude" for i in found):
        raise Rejected("experiment without attitude")
    return tuple(found)


def described(found: tuple[Input, ...]) -> bytes:
    """The inputs as JSON, for the reader."""
    return json.dumps([[i.source, i.time, list(i.parts)] for i in found]).encode()


@dataclass
class _Asked:
    """One phone as the thread knows it."""

    address: Address
    inputs: tuple[Input, ...] = ()
    last_s: dict[str, float] = field(default_factory=dict)
    session: str = ""


class Poller:
    """The worker: a thread a phone."""

    def __init__(self, addresses: tuple[Address, ...]):
        self._addresses = addresses
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []

    def start(self, post: Mailbox) -> None:
        for address in self._addresses:
            thread = threading.Thread(target=self._run, args=(address, post), daemon=True)
            thread.start()
            self._threads.append(thread)

    def _run(self, address: Address, post: Mailbox) -> None:
        phone = _Asked(address)
        while not self._stop.is_set():
            try:
                self._round(phone, post)
                wait = EVERY_S
            except (OSError, http.client.HTTPException):
                post.fault("no answer")
                wait = AGAIN_S
            except Rejected as e:
                post.fault(e.reason)
                phone.inputs = ()
                wait = AGAIN_S
            self._stop.wait(wait)

    def _round(self, phone: _Asked, post: Mailbox) -> None:
        """Ask once. Raises OSError, HTTPException, Rejected."""
        if not phone.inputs:
            phone.inputs, phone.last_s = inputs(_parsed(_get(phone.address, "/config"))), {}
            post.put(DESCRIBED + described(phone.inputs), str(phone.address))
        asked = "&".join(i.query(phone.last_s.get(i.source)) for i in phone.inputs)
        body = _get(phone.address, f"/get?{asked}")
        answer = _parsed(body)
        session = str(_within(answer, "status").get("session", ""))
        if session != phone.session:
            phone.session, phone.last_s = session, {}
        for i in phone.inputs:
            times = _values(answer, i.time)
            last = next((t for t in reversed(times) if isinstance(t, int | float)), None)
            if last is not None:
                phone.last_s[i.source] = float(last)
        post.put(ANSWERED + body, str(phone.address))

    def stop(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(timeout=ANSWER_S + 1.0)


def _get(address: Address, path: str) -> bytes:
    connection = http.client.HTTPConnection(address.host, address.port, timeout=ANSWER_S)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        body = answer.read(MAX_BODY + 1)
        if answer.status != 200:
            raise Rejected("answer is an error")
        if len(body) > MAX_BODY:
            raise Rejected("body too large")
        return body
    finally:
        connection.close()


def _parsed(body: bytes) -> Any:
    try:
        return json.loads(body)
    except (ValueError, RecursionError) as e:
        raise Rejected("not JSON") from e


def _within(answer: Any, name: str) -> Mapping[str, Any]:
    found = answer.get(name) if isinstance(answer, dict) else None
    return found if isinstance(found, Mapping) else {}


def _values(answer: Any, buffer: str) -> list[Any]:
    found = _within(_within(answer, "buffer"), buffer).get("buffer")
    return found if isinstance(found, list) else []


class Phyphox:
    """The reader of the answers."""

    batched = True

    def __init__(self) -> None:
        self._inputs: dict[str, tuple[Input, ...]] = {}
        self._phones: dict[str, Phone] = {}
        self._order = InOrder()
        self._session: dict[str, str] = {}
        self._measuring: dict[str, bool] = {}

    def read(self, letter: Letter) -> Iterator[Packet | Rejected]:
        try:
            content = _parsed(letter.body[1:])
            if letter.body[:1] == DESCRIBED:
                self._inputs[letter.sender] = tuple(
                    Input(source, time, tuple(parts)) for source, time, parts in content
                )
                return
            yield from self._samples(content, letter.sender)
        except Rejected as e:
            yield e

    def _samples(self, answer: Any, name: str) -> Iterator[Packet | Rejected]:
        status = _within(answer, "status")
        session = str(status.get("session", ""))
        self._measuring[name] = status.get("measuring") is True
        if self._session.get(name) != session or name not in self._phones:
            self._session[name], self._phones[name] = session, Phone(name, self._order)
        phone = self._phones[name]
        found = []
        for i in self._inputs.get(name, ()):
            columns = [_values(answer, n) for n in (i.time, *i.parts)]
            if max(map(len, columns)) > MAX_SAMPLES:
                raise Rejected("too many samples")
            found += [(i.source, row) for row in zip(*columns, strict=False)]
        for source, row in found:
            try:
                _note(phone, source, row)
            except Rejected as e:
                yield e
        yield from phone.packets()

    def heard(self) -> Mapping[str, Heard]:
        out = {}
        for name, phone in self._phones.items():
            how = phone.convention
            words = [how.words() if how else "no gravity: acceleration left out"]
            words += [] if self._measuring.get(name) else ["not measuring: press play"]
            out[name] = Heard(note=", ".join(words))
        return out


def _note(phone: Phone, source: str, row: tuple[Any, ...]) -> None:
    time_s = number(row[0], MAX_TIME_S)
    values: Array = np.array([number(v, 2.0 if source == "attitude" else MAX_ACC) for v in row[1:]])
    if source == "attitude":
        phone.turn(time_s, rotation(values))
    elif source == "gravity":
        phone.weigh(time_s, values)
    else:
        phone.feel(time_s, values)


def _make(told: Told) -> Intake:
    return Threaded(Phyphox(), Poller(told.addresses), told.clock)


SOURCE = Kind(
    "phyphox", "the app phyphox on phones (remote access)", _make, PORT,
    asks=True, own_headings=True, buffer_s=0.3,
)  # fmt: skip
