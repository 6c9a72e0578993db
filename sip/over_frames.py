"""A CasADi function of one frame, evaluated over all frames of a sequence."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from mocap.orientation import Array


class OverFrames:
    """`function` mapped over frames.

    The numbers go through CasADi's buffers: its own conversion of arrays takes longer than the function.
    CasADi is column-major, so each frame's matrices travel transposed.
    """

    def __init__(self, function: ca.Function):
        self.function = function
        self._maps: dict[int, ca.Function] = {}
        # Buffers that nobody uses just now, by frames: making one takes as long as a small function.
        self._free: dict[int, list[Any]] = {}
        shapes = [function.size_out(i) for i in range(function.n_out())]
        self._shapes = [(columns, rows) for rows, columns in shapes]

    def __call__(self, *inputs: Array) -> list[Array]:
        """Outputs (T, columns, rows) at inputs (T, columns, rows), or (T, rows) of a single column."""
        T = len(inputs[0])
        if T not in self._maps:  # building the map takes longer than one evaluation
            self._maps[T], self._free[T] = self.function.map(T), []
        free = self._free[T]
        buffer: Any
        buffer, run = free.pop() if free else self._maps[T].buffer()
        kept: list[Any] = [np.ascontiguousarray(a, float).reshape(-1) for a in inputs]
        for i, array in enumerate(kept):
            buffer.set_arg(i, memoryview(array))
        outputs: list[Any] = [np.empty((T, *shape)) for shape in self._shapes]
        for i, array in enumerate(outputs):
            buffer.set_res(i, memoryview(array.reshape(-1)))
        run()
        free.append((buffer, run))
        return outputs
