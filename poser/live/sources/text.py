"""Lines of text over UDP, as two research apps for phones, watches and earphones send them.

MobilePoser's:  ID;TYPE:t1 t2 ax ay az qx qy qz qw
IMUCoCo's:      ID;TYPE;motion:t ax ay az gx gy gz rx ry rz qx qy qz qw, several joined by &

t: s. a: acceleration without gravity, g: gravity, both of an iPhone: in g, with its sign. Where gravity
does not come, that convention is taken for granted. The device's name is ID_TYPE.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mocap import orientation as ori
from poser.live.packets import (
    MAX_ACC,
    MAX_DATAGRAM,
    MAX_MESSAGES,
    MAX_NAME,
    MAX_TIME_S,
    Packet,
    Rejected,
    number,
    rotation,
)
from poser.live.receiver import Receiver
from poser.live.sources.order import InOrder
from poser.live.sources.phone import Convention, Phone
from poser.live.sources.protocol import MAX_DEVICES, Intake, Kind, Told

IOS = Convention(False, -ori.GRAVITY)
MOBILEPOSER, IMUCOCO = 9, 14  # numbers in a line
ANEW_S = 1.0  # a time so much before the last one is of an app that began anew
MOBILEPOSER_MORE = 12  # with three angles behind


class Text:
    """The decoder, which remembers the devices."""

    def __init__(self) -> None:
        self._phones: dict[str, Phone] = {}
        self._order = InOrder()

    def __call__(self, datagram: bytes) -> Iterator[Packet | Rejected]:
        if len(datagram) > MAX_DATAGRAM:
            yield Rejected("datagram too long")
            return
        # IMUCoCo's app ends each sample with a line break, also those that it joins.
        lines = [line for line in datagram.replace(b"\n&", b"&").splitlines() if line.strip()]
        for line in lines[:MAX_MESSAGES]:
            try:
                yield from self._line(line)
            except Rejected as e:
                yield e
        if len(lines) > MAX_MESSAGES:
            yield Rejected("too many lines")

    def _line(self, line: bytes) -> Iterator[Packet]:
        try:
            head, colon, body = line.decode("ascii").partition(":")
        except UnicodeDecodeError as e:
            raise Rejected("not text") from e
        words = [w.strip() for w in head.split(";")]
        if not colon or len(words) not in (2, 3) or not all(words):
            raise Rejected("not ID;TYPE:numbers")
        phone = self._phone(f"{words[0]}_{words[1]}")
        for part in body.split("&")[:MAX_MESSAGES]:
            values, down = _numbers(part), None
            if len(values) == IMUCOCO:
                time_s, acc, q = values[0], values[1:4], values[10:14]
                down = np.array(_within(values[4:7], MAX_ACC))
            elif len(values) in (MOBILEPOSER, MOBILEPOSER_MORE):
                time_s, acc, q = values[1], values[2:5], values[5:9]
            else:
                raise Rejected("wrong number of values")
            x, y, z, w = _within(q, 2.0)
            R, felt = rotation(np.array([w, x, y, z])), np.array(_within(acc, MAX_ACC))
            if number(time_s, MAX_TIME_S) < phone.sent_s - ANEW_S:
                phone = self._phones[phone.name] = Phone(phone.name, self._order, IOS)
            if down is not None:
                phone.weigh(time_s, down)
            phone.feel(time_s, felt)
            phone.turn(time_s, R)
        yield from phone.packets()

    def _phone(self, name: str) -> Phone:
        if len(name) > MAX_NAME or not name.isprintable():
            raise Rejected("out of range")
        if name not in self._phones and len(self._phones) >= MAX_DEVICES:
            raise Rejected("too many devices")
        return self._phones.setdefault(name, Phone(name, self._order, IOS))


def _numbers(text: str) -> list[float]:
    words = text.split()
    if len(words) > 2 * IMUCOCO:
        raise Rejected("wrong number of values")
    try:
        return [float(w) for w in words]
    except ValueError as e:
        raise Rejected("not a number") from e


def _within(values: list[float], limit: float) -> list[float]:
    return [number(v, limit) for v in values]


def _make(told: Told) -> Intake:
    return Receiver(told.addresses[0], Text(), told.clock)


SOURCE = Kind(
    "text", "text lines of MobilePoser's and IMUCoCo's apps", _make, own_headings=True, far=True
)
