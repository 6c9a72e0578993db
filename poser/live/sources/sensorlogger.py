"""The app Sensor Logger (iOS, Android, and their watches and earphones), pushing over HTTP, port 8000.

    POST {"messageId": 3, "sessionId": "...", "deviceId": "...",
          "payload": [{"name": "orientation", "time": 1698501144401773000, "values": {"qx": ...}}, ...]}

answered 200. time: ns since 1970. Samples come in batches, so late; the app's batch period should be as
short as it goes. Used are of a phone `orientation` (qx qy qz qw), `accelerometer` (without gravity) and
`gravity` (x y z), of a watch `wristmotion` and of earphones `headphone` (quaternionW.., accelerationX..,
gravityX..), and `battery`. Signs and units of the two systems are told apart by gravity; those of
earphones are g for the acceleration and m/s^2 for gravity.

Names: the app's device id, with /watch and /headphone behind for these. After the app's public documents.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from poser.live.heard import Heard
from poser.live.packets import MAX_ACC, MAX_NAME, Packet, Rejected, number, rotation
from poser.live.sources.order import InOrder
from poser.live.sources.phone import Phone
from poser.live.sources.protocol import MAX_DEVICES, Intake, Kind, Told
from poser.live.sources.pushed import PushServer
from poser.live.sources.threads import Letter, Threaded

PORT = 8000
MAX_SAMPLES = 20_000  # of a batch
MAX_NS = 4e18
TAKEN_S = 2.0  # a name belongs to its first session until that is silent for so long


@dataclass
class _Owner:
    """Who sends under a device id: sender and session, and when it was heard last; order: of its packets."""

    sender: str
    session: str
    heard_s: float
    order: InOrder
    battery: float | None = None
    phones: dict[str, Phone] = field(default_factory=dict)
    message: int = -1
    lost: int = 0


class SensorLogger:
    """The reader of the app's batches."""

    batched = True

    def __init__(self) -> None:
        self._owners: dict[str, _Owner] = {}
        self._order = InOrder()

    def read(self, letter: Letter) -> Iterator[Packet | Rejected]:
        try:
            yield from self._read(letter)
        except Rejected as e:
            yield e

    def _read(self, letter: Letter) -> Iterator[Packet | Rejected]:
        batch = _object(letter.body)
        owner = self._owner(batch, letter)
        payload = batch.get("payload")
        if not isinstance(payload, list):
            raise Rejected("field missing")
        if len(payload) > MAX_SAMPLES:
            raise Rejected("too many samples")
        device = batch["deviceId"]
        for time_ns, name, sample in _in_order(payload):
            try:
                _take(owner, device, name, time_ns / 1e9, sample)
            except Rejected as e:
                yield e
        for phone in owner.phones.values():
            yield from phone.packets()

    def _owner(self, batch: Mapping[str, Any], letter: Letter) -> _Owner:
        device, session = _text(batch.get("deviceId")), _text(batch.get("sessionId", "-"))
        owner = self._owners.get(device)
        if owner is None and len(self._owners) >= MAX_DEVICES:
            raise Rejected("too many devices")
        if owner is not None and owner.sender != letter.sender:
            if letter.arrival_s - owner.heard_s < TAKEN_S:
                raise Rejected("name taken by another device")
            owner = None
        if owner is None or owner.session != session:
            owner = _Owner(letter.sender, session, letter.arrival_s, self._order)
            self._owners[device] = owner
        owner.heard_s = letter.arrival_s
        count = batch.get("messageId")
        if isinstance(count, int) and not isinstance(count, bool):
            missing = count - owner.message - 1
            owner.lost += missing if owner.message >= 0 and 0 < missing < 3000 else 0
            owner.message = max(owner.message, count)
        return owner

    def heard(self) -> Mapping[str, Heard]:
        found = {}
        for owner in self._owners.values():
            for phone in owner.phones.values():
                how = phone.convention
                note = how.words() if how else "no gravity: acceleration left out"
                found[phone.name] = Heard(owner.battery, owner.lost, None, note)
        return found


def _object(body: bytes) -> dict[str, Any]:
    try:
        value = json.loads(body)
    except (ValueError, RecursionError) as e:
        raise Rejected("not JSON") from e
    if not isinstance(value, dict):
        raise Rejected("not an object")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise Rejected("field missing" if value is None else "wrong type")
    if not 0 < len(value) <= MAX_NAME - 10 or not value.isprintable():
        raise Rejected("out of range")
    return value


def _in_order(payload: list[Any]) -> list[tuple[float, str, Mapping[str, Any]]]:
    """The samples of a batch that are ones, by time: the app lists them kind by kind."""
    found = []
    for entry in payload:
        if not isinstance(entry, Mapping) or not isinstance(entry.get("values"), Mapping):
            continue
        name, time_ns = entry.get("name"), entry.get("time")
        if isinstance(time_ns, bool) or not isinstance(time_ns, int | float):
            continue
        if isinstance(name, str) and 0 <= time_ns < MAX_NS:
            found.append((time_ns, "".join(name.lower().split()), entry["values"]))
    return sorted(found, key=lambda sample: sample[0])


def _take(owner: _Owner, device: str, kind: str, time_s: float, values: Mapping[str, Any]) -> None:
    """Note one sample. Raises Rejected."""
    if kind == "battery":
        if "batteryLevel" in values:
            owner.battery = float(np.clip(number(values["batteryLevel"], 1e3), 0.0, 1.0))
    elif kind in _OF_PHONE:
        _OF_PHONE[kind](_phone(owner, device), time_s, values)
    elif kind in ("wristmotion", "headphone"):
        suffix = "watch" if kind == "wristmotion" else "headphone"
        phone = _phone(owner, f"{device}/{suffix}")
        if "gravityX" in values:
            phone.weigh(time_s, _xyz(values, "gravity"))
        if "accelerationX" in values:
            scale = ori.GRAVITY if kind == "headphone" else 1.0
            phone.feel(time_s, scale * _xyz(values, "acceleration"))
        phone.turn(time_s, _rotation(values, "quaternion"))


def _phone(owner: _Owner, name: str) -> Phone:
    if name not in owner.phones:
        owner.phones[name] = Phone(name, owner.order)
    return owner.phones[name]


def _xyz(values: Mapping[str, Any], prefix: str = "") -> Array:
    names = [prefix + (axis.upper() if prefix else axis) for axis in "xyz"]
    return np.array([number(values.get(n), MAX_ACC) for n in names])


def _rotation(values: Mapping[str, Any], prefix: str = "q") -> Array:
    names = [prefix + (axis.upper() if prefix != "q" else axis) for axis in "wxyz"]
    return rotation(np.array([number(values.get(n), 2.0) for n in names]))


_OF_PHONE: dict[str, Callable[[Phone, float, Mapping[str, Any]], None]] = {
    "orientation": lambda phone, t, v: phone.turn(t, _rotation(v)),
    "accelerometer": lambda phone, t, v: phone.feel(t, _xyz(v)),
    "gravity": lambda phone, t, v: phone.weigh(t, _xyz(v)),
}


def _make(told: Told) -> Intake:
    return Threaded(SensorLogger(), PushServer(told.addresses[0]), told.clock)


SOURCE = Kind(
    "sensorlogger", "the app Sensor Logger on phones and watches (HTTP push)", _make, PORT,
    own_headings=True, far=True, buffer_s=0.5,
)  # fmt: skip
