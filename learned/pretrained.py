"""A network with its weights as an online estimator, in one call."""

from __future__ import annotations

from pathlib import Path

from learned import checkpoint, runtime
from learned.online.estimator import Online
from learned.online.streaming import stream
from mocap.skeleton import Skeleton


def estimator(
    network: str,
    rate_hz: float,
    sensors: tuple[str, ...] | None = None,
    places: tuple[str, ...] | None = None,
    *,
    weights: Path | None = None,
    window: tuple[int, int] | None = None,
    skeleton: Skeleton | None = None,
    precision: runtime.Precision | None = None,
) -> Online:
    """The estimator of a network for samples at `rate_hz`, as `poser track` runs it.

    network: of `learned.NETWORKS`. weights: a file of them (default: the shipped ones). precision: default,
    int8 where this machine has the kernels (`learned.runtime.fastest`). The rest: `learned.online.stream`.
    `hybrid.Tracker` goes around the result. Raises CheckpointError for weights that do not fit.

    On a small CPU `torch.set_num_threads(1)` makes frames faster and steadier; that is for the program to
    say.
    """
    model = checkpoint.load(weights or checkpoint.shipped(network), network)
    return stream(
        model, rate_hz, sensors, places,
        window=window, skeleton=skeleton, precision=precision or runtime.fastest(),
    )  # fmt: skip
