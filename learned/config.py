"""What a network is: enough to build it again, and to refuse weights of another one."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from learned.errors import CheckpointError
from learned.registry import of_architecture, specification
from learned.spec import Specification
from mocap import sensors as places

Normalisation = Literal["root", "first", "heading"]


@dataclass(frozen=True)
class Config:
    """The `config` of a description of weights.

    architecture: one of those of a `Specification`, which it thereby names.
    rate_hz, sensors: the specification's; others are refused.
    hidden: width of the recurrent layers (recurrent architectures alone).
    dropout: share of the inputs left out in training.
    normalisation, use_acc: DIP's experiments (appendices C and D, 3.4.3); others leave them alone.
    """

    architecture: str = "birnn"
    rate_hz: float = 60.0
    sensors: tuple[str, ...] = places.SIX
    hidden: int = 512
    dropout: float = 0.2
    normalisation: Normalisation = "root"
    use_acc: bool = True

    def __post_init__(self) -> None:
        spec = self.specification
        object.__setattr__(self, "sensors", tuple(self.sensors))
        if self.sensors != spec.places:
            raise CheckpointError(
                f"sensors {', '.join(self.sensors)}: {spec.name} reads {', '.join(spec.places)}, "
                "in this order"
            )
        if self.rate_hz != spec.rate_hz:
            raise CheckpointError(
                f"rate {self.rate_hz:g} Hz: {spec.name} runs at {spec.rate_hz:g} Hz"
            )

    @property
    def specification(self) -> Specification:
        """Of the network that this is a configuration of."""
        return of_architecture(self.architecture)

    @property
    def network(self) -> str:
        """Its name."""
        return self.specification.name

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self) | {"sensors": list(self.sensors)}


def for_network(network: str, **changes: Any) -> Config:
    """The default configuration of a network, with these changes."""
    spec = specification(network)
    base: dict[str, Any] = {
        "architecture": spec.architectures[0], "rate_hz": spec.rate_hz, "sensors": spec.places,
    }  # fmt: skip
    return Config(**(base | changes))
