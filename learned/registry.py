"""The networks there are. A new one is a folder beside `dip` and `imuposer`, and a line here."""

from __future__ import annotations

from learned.dip.specification import SPECIFICATION as DIP
from learned.errors import CheckpointError
from learned.imuposer.specification import SPECIFICATION as IMUPOSER
from learned.spec import Specification
from mocap.errors import PoserError

NETWORKS: dict[str, Specification] = {s.name: s for s in (DIP, IMUPOSER)}


def specification(network: str) -> Specification:
    """By name. Raises PoserError for one that is unknown."""
    if network not in NETWORKS:
        raise PoserError(f"network {network!r} unknown; known: {', '.join(NETWORKS)}")
    return NETWORKS[network]


def of_architecture(architecture: str) -> Specification:
    """The network that has this architecture. Raises CheckpointError for one that is unknown."""
    for spec in NETWORKS.values():
        if architecture in spec.architectures:
            return spec
    known = ", ".join(a for s in NETWORKS.values() for a in s.architectures)
    raise CheckpointError(f"architecture {architecture!r} unknown; known: {known}")
