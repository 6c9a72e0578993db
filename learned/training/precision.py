"""Whether mixed precision (products in bfloat16) makes training faster on a machine: measured, not looked up.

CPUs with AMX units win by it; where AVX2 emulates it a step takes up to 50 times as long. Between the two are
CPUs that have instructions for it and still lose by a tenth to a half.
"""

from __future__ import annotations

import time
from functools import cache

import torch

from learned import recurrent

UNITS, BATCH, FRAMES = 256, 64, 8  # of the layer that is timed: a round takes about 40 ms
ROUNDS = 5
ENOUGH_S = 0.3
TOLERATED = 2.0  # times float32's time: see `bfloat16_pays`


def bfloat16_pays(device: str | torch.device = "cpu", before: bool | None = None) -> bool:
    """Whether to train in bfloat16 on this machine.

    before: what the run that goes on had. On a CPU it is kept, so that a resumed run goes on as it began and
    no noise of the clock decides; but not bfloat16 where it takes more than `TOLERATED` times float32's time:
    then this is another machine. On a GPU: whether it has units for it.
    """
    if torch.device(device).type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if before is False:
        return False
    return relative_time(torch.get_num_threads()) < (TOLERATED if before else 1.0)


@cache
def relative_time(threads: int) -> float:
    """Time of a layer's forward and backward pass in bfloat16 on this CPU, float32's being 1.

    threads: as torch has them now; a process measures once for each number.
    """
    with torch.random.fork_rng(devices=[]):
        lstm = torch.nn.LSTM(UNITS, UNITS, batch_first=True)
        x = torch.randn(BATCH, FRAMES, UNITS)
    best = {False: float("inf"), True: float("inf")}
    began = time.perf_counter()
    # In turns, and the least of each: other work on the machine comes and goes.
    for _ in range(ROUNDS):
        for mixed in best:
            best[mixed] = min(best[mixed], _seconds(lstm, x, mixed))
        if time.perf_counter() - began > ENOUGH_S:
            break
    return best[True] / best[False]


def _seconds(lstm: torch.nn.LSTM, x: torch.Tensor, mixed: bool) -> float:
    began = time.perf_counter()
    with torch.autocast("cpu", torch.bfloat16, enabled=mixed):
        y = recurrent.run(lstm, x)
    y.float().sum().backward()
    return time.perf_counter() - began
