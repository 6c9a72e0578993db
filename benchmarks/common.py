"""What the benchmarks share: the machine, a fixed matrix product, tables, parallel clips."""

from __future__ import annotations

import json
import os
import platform
import resource
import shlex
import statistics
import sys
import time
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from mocap import Motion, dataset

SHORTEST_S, LONGEST_S = 2.0, 15.0


def data_folder() -> Path:
    """`shared/` beside the repository, or $POSER_SHARED."""
    here = Path(__file__).resolve().parents[1]
    return Path(os.environ.get("POSER_SHARED", here.parent / "shared")) / "data"


def matrix_product_s(n: int = 1500, runs: int = 5) -> float:
    """Median seconds of a float64 n x n product on one thread: a measure of the machine now."""
    from threadpoolctl import threadpool_limits

    a = np.random.default_rng(0).normal(size=(n, n))
    times = []
    with threadpool_limits(1, "blas"):
        for _ in range(runs):
            t0 = time.perf_counter()
            a @ a
            times.append(time.perf_counter() - t0)
    return statistics.median(times)


def machine() -> str:
    """One line about the machine, with the fixed product beside it."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(x.split(":")[1].strip() for x in lines if x.startswith("model name"))
    except (OSError, StopIteration):
        pass  # not Linux: the platform's word has to do
    product = matrix_product_s()
    return (
        f"{model}, {os.cpu_count()} cores; 1500 x 1500 float64 product, one thread: {product:.3f} s"
    )


def clips(
    split: dataset.Split, rate_hz: float = 60.0, longest_s: float = LONGEST_S
) -> list[tuple[str, Motion]]:
    """CMU's clips of a split that accuracy is measured on: the first `longest_s` of each that has at least
    `SHORTEST_S` of trusted motion there. Frames that are not trusted (`Motion.trusted`) count nowhere."""
    found = dataset.clips(split, ("cmu",), rate_hz, max_s=longest_s)
    return [(name, motion) for name, motion in found if trusted_s(motion) >= SHORTEST_S]


def trusted_s(motion: Motion) -> float:
    """Seconds that count."""
    share = 1.0 if motion.trusted is None else float(motion.trusted.mean())
    return share * motion.seconds


def told(found: list[tuple[str, Motion]]) -> str:
    """How much of the clips counts, in words."""
    whole, counts = (sum(f(m) for _, m in found) for f in (lambda m: m.seconds, trusted_s))
    return f"{len(found)} clips, {counts:.1f} s that count, {whole - counts:.1f} s of faulty truth left out"


def keep(path: Path, rows: object) -> None:
    """Rows of figures with the command that made them, as `benchmarks/tables.py` reads them."""
    words = [f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]]
    record = {"command": f"python {shlex.join(words)}", "machine": machine(), "rows": rounded(rows)}
    path.write_text(json.dumps(record, indent=0))


def rounded(x: Any) -> Any:
    """Numbers to five digits: what is kept in the repository need not be long."""
    if isinstance(x, dict):
        return {k: rounded(v) for k, v in x.items()}
    if isinstance(x, list | tuple):
        return [rounded(v) for v in x]
    return float(f"{x:.5g}") if isinstance(x, float | np.floating) else x


def seed_of(name: str) -> int:
    """The noise of a clip depends on its name alone."""
    return zlib.crc32(name.encode())


def evenly(items: list[Any], count: int | None) -> list[Any]:
    """`count` of them at equal steps, or all."""
    return items if count is None else items[:: max(1, len(items) // count)][:count]


def row(cells: Iterable[object], widths: Iterable[int]) -> str:
    """One line of a text table."""
    return " ".join(f"{c!s:>{w}}" for c, w in zip(cells, widths, strict=False))


def resident_mb() -> float:
    """Resident memory of this process."""
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text().split()[1]) * resource.getpagesize() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10  # not Linux: the peak
