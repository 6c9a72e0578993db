"""Several processes that train one network: what they must agree on.

`torchrun` starts them and sets RANK, WORLD_SIZE and LOCAL_RANK. Gradients are averaged by torch's
DistributedDataParallel; the first process alone decides how to begin and when to stop, validates and writes.
The others need no folder in common with it.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist
from torch import nn

from learned.errors import TrainingError


@dataclass(frozen=True)
class World:
    """`size` processes; this is number `rank`, on `device`."""

    rank: int = 0
    size: int = 1
    device: str = "cpu"

    @property
    def first(self) -> bool:
        """Whether this process decides and writes."""
        return self.rank == 0

    def agree(self, *values: float) -> tuple[float, ...]:
        """The first process' values, in every process."""
        if self.size == 1:
            return values
        shared = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.broadcast(shared, 0)
        return tuple(shared.tolist())

    def share(self, value: dict[str, Any]) -> dict[str, Any]:
        """The first process' tensors, numbers and texts, in every process; sent tensors lie on the CPU."""
        if self.size == 1:
            return value
        box: list[Any] = [None]
        if self.first:
            sent = io.BytesIO()
            torch.save(value, sent)
            box = [sent.getvalue()]
        dist.broadcast_object_list(box, 0, device=torch.device(self.device))
        got: dict[str, Any] = torch.load(io.BytesIO(box[0]), weights_only=True, map_location="cpu")
        return got

    def wrapped(self, model: nn.Module) -> Any:
        """`model` as it is called in training: every process ends a backward pass with the same gradients."""
        return model if self.size == 1 else nn.parallel.DistributedDataParallel(model)

    def leave(self) -> None:
        """The end of the common work."""
        if self.size > 1:
            dist.destroy_process_group()


def join(device: str = "cpu") -> World:
    """The world that the environment tells of; alone where WORLD_SIZE is not set.

    device: cpu (gloo) or cuda (nccl, the GPU of LOCAL_RANK). Raises TrainingError where CUDA is wanted
    and absent or of fewer GPUs than processes, or the processes do not find each other.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise TrainingError("this machine or this build of torch has no CUDA device; use cpu")
    size = int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        return World(device=device)
    if device == "cuda":
        local, count = int(os.environ.get("LOCAL_RANK", "0")), torch.cuda.device_count()
        if local >= count:
            raise TrainingError(f"process {local} of this machine has no GPU: there are {count}")
        torch.cuda.set_device(local)
        device = f"cuda:{local}"
    try:
        dist.init_process_group("gloo" if device == "cpu" else "nccl")
    except (ValueError, RuntimeError) as e:
        raise TrainingError(f"the {size} processes cannot find each other: {e}") from e
    return World(dist.get_rank(), size, device)
