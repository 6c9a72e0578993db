"""Active device tracking: which consumer devices are worn, and where.

After section 7 of IMUPoser (Mollyn et al., CHI 2023): earbuds that are connected are in the ears. A
watch that is connected and moves is on the arm its owner prefers. A phone whose screen is lit and that
moves is in a hand, one with a dark screen and a covered proximity sensor is in a pocket; the distance to
a worn watch tells which side, else the owner's preference. What the paper leaves open: "moves" is a turn
of more than MOVING_RAD within a second, and lasts STILL_S after it; a pocket's side is read from how near
the watch comes (a hand swings past its own pocket, but may reach anywhere); a dark, uncovered, moving
phone stays where it was; a change counts once it has lasted HOLD_S. A distance counts for DISTANCE_S,
since ranging goes on for as long as both devices are near; screen and proximity are told when they change,
so that the last word holds, however old. Nothing here tells a phone held to the ear: without the call's
state it looks like one in a pocket.

`step` is a pure function over an explicit state; `DeviceTracker` feeds it from rows and messages.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from mocap import orientation as ori
from mocap.orientation import Array
from poser.live.assembler import Row
from poser.live.packets import Status

Side = Literal["left", "right"]
PHONE, WATCH, EARBUDS = "phone", "watch", "earbuds"
DEVICES = (WATCH, PHONE, EARBUDS)
"""In the order in which they count where two share a place: a watch sits firmer than a phone in the hand."""

MOVING_RAD = np.deg2rad(
    0.5
)  # a lying device turns by its noise alone, standing people sway by more
STILL_S = 3.0
HOLD_S = 0.5
HAND_M = 0.3  # watch to phone: 0.1 m in the same hand, 0.5 m and more in the other
POCKET_M = (
    0.34  # watch to phone at the nearest: 0.21 to 0.28 m on the same side, 0.38 to 0.45 m across
)
DISTANCE_S = 10.0  # after the last distance the owner's preference holds again
SMOOTH_S = 0.3  # distances by radio scatter by a decimetre
NEAREST = 0.2  # the quantile that stands for "the nearest"
WINDOW_S = 10.0
STEP_S = 0.1  # distances are kept at this interval


@dataclass(frozen=True)
class Preferences:
    """What the owner said once: the phone's pocket, the hand that holds it, the watch's arm."""

    pocket: Side = "left"
    hand: Side = "right"
    watch: Side = "left"


@dataclass(frozen=True)
class Seen:
    """One device at one moment. moving: turned within the last second. to_watch_m: phone only, None where
    no distance is known."""

    connected: bool = False
    moving: bool = False
    screen: bool | None = None
    proximity: bool | None = None
    to_watch_m: float | None = None


@dataclass(frozen=True)
class Device:
    """What is remembered of one device: its place (None: not worn), and a place that may follow it.

    moved_s: when it moved last. usage: screen and proximity; distances_m, smoothed, since they changed.
    """

    place: str | None = None
    candidate: str | None = None
    since_s: float = 0.0
    moved_s: float = -np.inf
    usage: tuple[bool | None, bool | None] = (None, None)
    smoothed_m: float | None = None
    distances_m: tuple[float, ...] = ()
    kept_s: float = -np.inf


@dataclass(frozen=True)
class State:
    """time_s of the last step, and every device."""

    time_s: float = 0.0
    devices: Mapping[str, Device] = field(
        default_factory=lambda: {name: Device() for name in DEVICES}
    )

    @property
    def where(self) -> dict[str, str]:
        """The place of every device that is worn."""
        return {n: d.place for n, d in self.devices.items() if d.place is not None}


def step(state: State, time_s: float, seen: Mapping[str, Seen], owner: Preferences) -> State:
    """The state after what was seen at `time_s`; devices that are not in `seen` are not connected."""
    after: dict[str, Device] = {}
    for name in DEVICES:
        what = seen.get(name, Seen())
        noted = _note(state.devices[name], what, time_s, time_s - state.time_s)
        place = _place(name, noted, what, time_s, owner, after.get(WATCH))
        after[name] = _settle(noted, place, time_s, what.connected)
    return State(time_s, after)


def _note(device: Device, what: Seen, time_s: float, dt: float) -> Device:
    """Remember movement, and distances since the device is used as it is."""
    usage = (what.screen, what.proximity)
    if usage != device.usage:
        device = replace(device, usage=usage, smoothed_m=None, distances_m=(), kept_s=-np.inf)
    if what.moving:
        device = replace(device, moved_s=time_s)
    if what.to_watch_m is None:
        return replace(device, smoothed_m=None, distances_m=(), kept_s=-np.inf)
    old = device.smoothed_m
    share = 1.0 if old is None else 1.0 - np.exp(-max(dt, 0.0) / SMOOTH_S)
    smooth = what.to_watch_m if old is None else old + share * (what.to_watch_m - old)
    device = replace(device, smoothed_m=float(smooth))
    if time_s - device.kept_s < STEP_S - 1e-9:
        return device
    kept = (*device.distances_m[-round(WINDOW_S / STEP_S) + 1 :], float(smooth))
    return replace(device, distances_m=kept, kept_s=time_s)


def _place(
    name: str, device: Device, what: Seen, time_s: float, owner: Preferences, watch: Device | None
) -> str | None:
    """Where the device is by what is seen of it now."""
    if not what.connected:
        return None
    if name == EARBUDS:
        return "head"
    if time_s - device.moved_s > STILL_S:
        return None
    if name == WATCH:
        return f"{owner.watch}_wrist"
    wrist = watch.place if watch is not None and device.distances_m else None
    if what.screen:
        side = _side(wrist, float(np.median(device.distances_m[-15:] or [0.0])), HAND_M)
        return f"{side or owner.hand}_wrist"
    if what.proximity:
        nearest = float(np.quantile(device.distances_m or [0.0], NEAREST))
        return f"{_side(wrist, nearest, POCKET_M) or owner.pocket}_pocket"
    return device.place


def _side(wrist: str | None, distance_m: float, limit_m: float) -> Side | None:
    """The watch's own side where it is near, else the other; None without a worn watch."""
    if wrist is None:
        return None
    return "left" if wrist.startswith("left") == (distance_m < limit_m) else "right"


def _settle(device: Device, place: str | None, time_s: float, connected: bool) -> Device:
    """A change of place counts after HOLD_S; a lost connection at once."""
    if place == device.place or not connected:
        return replace(device, place=place, candidate=place, since_s=time_s)
    if place != device.candidate:
        return replace(device, candidate=place, since_s=time_s)
    if time_s - device.since_s >= HOLD_S:
        return replace(device, place=place, since_s=time_s)
    return device


class DeviceTracker:
    """Feeds `step` from the rows of the assembler and the messages of the devices.

    changes: how often a device changed its place so far.
    """

    def __init__(self, owner: Preferences, rate_hz: float):
        self._owner = owner
        self._state = State()
        self._recent: deque[Row] = deque(maxlen=max(2, round(rate_hz) + 1))
        self._status: dict[str, Status] = {}
        self._to_watch_m: float | None = None  # of the phone, by whichever of the two measured
        self._measured_s: float | None = None  # time of the first row since then
        self.changes = 0

    @property
    def where(self) -> dict[str, str]:
        """The place of every device that is worn."""
        return self._state.where

    def hear(self, device: str, status: Status) -> None:
        """What a device says of itself; where it says nothing of something, its last word holds."""
        old = self._status.get(device, Status())
        self._status[device] = Status(
            old.screen if status.screen is None else status.screen,
            old.proximity if status.proximity is None else status.proximity,
        )
        other = {PHONE: WATCH, WATCH: PHONE}.get(device, "")
        if other in status.distances:
            self._to_watch_m, self._measured_s = status.distances[other], None

    def step(self, row: Row, devices: Sequence[str]) -> dict[str, str]:
        """The places after this row, whose devices are in the order of `devices`."""
        self._recent.append(row)
        if self._measured_s is None:
            self._measured_s = row.time_s
        if row.time_s - self._measured_s > DISTANCE_S:
            self._to_watch_m = None
        seen = {name: self._seen(name, d) for d, name in enumerate(devices)}
        before = self.where
        self._state = step(self._state, row.time_s, seen, self._owner)
        self.changes += len(set(self.where.items()) ^ set(before.items())) > 0
        return self.where

    def _seen(self, name: str, d: int) -> Seen:
        valid = [r.R_world_sensor[d] for r in self._recent if r.valid[d]]
        status = self._status.get(name, Status())
        distance = self._to_watch_m if name == PHONE else None
        return Seen(bool(valid), _turns(valid), status.screen, status.proximity, distance)


def _turns(R: Sequence[Array]) -> bool:
    """Whether rotations of the last second differ by more than MOVING_RAD from the newest."""
    if len(R) < 2:
        return False
    return bool((ori.angle_between(np.array(R[:-1]), R[-1]) > MOVING_RAD).any())
