"""What a kind of device has to offer: the intake that `Network` polls, and how it is named and told.

A new kind is one module in this folder with `SOURCE = Kind(...)`, and its name in `NAMES` of the folder's
`__init__`. Its intake yields `Packet`s: orientation in a y-up world, acceleration in that world without
gravity, the device's own time. What does not fit is counted in `rejected` by few fixed words and stops
nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from mocap.orientation import Array
from poser.live.addresses import Address
from poser.live.heard import Heard
from poser.live.packets import Packet
from poser.live.receiver import Now

MAX_DEVICES = 32  # of one kind: their names are chosen by whoever sends


class Intake(Protocol):
    """Packets of the devices of one kind, as they come."""

    rejected: Counter[str]

    @property
    def ended(self) -> bool:
        """Nothing more will come."""
        ...

    @property
    def read_s(self) -> float:
        """All that came before this time was given out; what came later may still wait. In a flood, now."""
        ...

    def open(self) -> None:
        """Begin. Raises PoserError where it cannot."""
        ...

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        """Packets, when they came, and when they had not come yet (None where that is not known).

        Waits for the first one at most `wait_s`, and ends whatever the devices do.
        """
        ...

    def heard(self) -> Mapping[str, Heard]:
        """What the devices told of themselves, by name; none where they tell nothing."""
        ...

    def close(self) -> None: ...


@runtime_checkable
class Witness(Protocol):
    """An intake whose maker has solved the whole body himself: a reference to compare with."""

    def pose(self, device: str, time_s: float) -> tuple[Array, Array] | None:
        """R_world_joint (24,3,3), and the middle between the hips (3,) m, of the wearer of a device, at a
        time of the device's clock; None where it is not known."""
        ...


@dataclass(frozen=True)
class Told:
    """What an intake is made from: what stands behind the kind's name, and what the session is about.

    addresses: where to listen, or the devices to ask; empty for kinds without any. sensors: the places.
    rate_hz, countdown_s: of the session. up: the senders' vertical axis, where it is not the kind's own.
    """

    addresses: tuple[Address, ...]
    sensors: tuple[str, ...]
    rate_hz: float
    countdown_s: float
    up: str
    clock: Now


@dataclass(frozen=True)
class Kind:
    """A kind of source.

    words: what it is, in a line. port: the default; 0 where it has to be said; None where there is none.
    asks: hosts are asked instead of listened for. own_headings: each device has a heading of its own.
    bones: orientations are those of bones. buffer_s: the longest wait for late packets that suits it.
    worn: the devices for these places where nobody says, {device: place}; None: named by their places.
    far: the devices are not on this machine. turns: its senders choose their vertical axis.
    starts_anew: devices' own headings are others after each start.
    """

    name: str
    words: str
    make: Callable[[Told], Intake]
    port: int | None = 0
    asks: bool = False
    own_headings: bool = False
    bones: bool = False
    buffer_s: float = 0.05
    worn: Callable[[Sequence[str]], dict[str, str]] | None = None
    far: bool = False
    turns: bool = False
    starts_anew: bool = True

    @property
    def spelling(self) -> str:
        """As it is written on the command line."""
        if self.asks:
            return f"{self.name}:HOST"
        if self.port is None:
            return self.name
        return f"{self.name}[:{self.port}]" if self.port else f"{self.name}:PORT"
