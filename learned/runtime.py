"""Inference of one frame of a window: the networks' own weights, only the products that frame needs.

A window of T frames whose frame `emit` is answered for needs, of two stacked bidirectional LSTM layers, of
layer 2 the forward direction only up to `emit` and the backward direction only from the window's end down to
it; the heads only there. What depends on nothing but frame t (the dense layer, and where it is kept in
float32 the first layer's input product) the caller keeps from window to window (`rows`). Both are exact. The
recurrent states are not kept: each window starts from zero, as in training.

Layer 1 remembers seconds, layer 2 often less: some frames from `emit` its states hardly matter any more. How
many is measured with the weights (`training.reach`); layer 2 begins there, and layer 1's backward direction,
which only layer 2 reads, ends there. Without a measurement the whole window counts.

A frame waits for the weights to be read from memory. In "int8" they are a quarter: torch's dynamic
quantisation, one scale per matrix, inputs and states quantised as they come (7 bits, so that sums of products
cannot overflow where a CPU adds pairs of them in 16 bits). The two directions of a layer do not wait for each
other: the backward one runs on a second thread.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Literal, Protocol

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from learned.dip.network import BiRNN, Gaussian
from learned.models import Dip, Imuposer, Model

Precision = Literal["float32", "int8"]
EVERY = 1_000_000  # frames of layer 2 before and after the emitted one: all that there are


class Runtime(Protocol):
    """What the windows of `learned.online` are answered with."""

    def rows(self, x: Tensor) -> Tensor:
        """What can be kept of each frame: (n,W) of inputs (n,D)."""
        ...

    def features(self, rows: Tensor, emit: int) -> Tensor:
        """What the heads read at frame `emit`: (F,) of a window's rows (T,W)."""
        ...


class Exact:
    """One direction of one LSTM layer in float32: h_t of h_{t-1} and the input's share of the gates.

    i, f, o = sigmoid, g = tanh of W x_t + b + U h_{t-1}; c_t = f c_{t-1} + i g; h_t = o tanh(c_t)
    (torch.nn.LSTM's equations), from h = c = 0. tanh(z) = 2 sigmoid(2 z) - 1, so the rows of g are doubled
    here and one sigmoid serves the four gates.
    """

    def __init__(self, lstm: nn.LSTM, name: str) -> None:
        H = lstm.hidden_size
        doubled = torch.ones(4 * H, 1)
        doubled[2 * H : 3 * H] = 2.0
        W, U, b = _weights(lstm, name)
        self.hidden = H
        self.W, self.b = doubled * W, (doubled[:, 0] * b).contiguous()
        self._U = (doubled * U).contiguous()

    def run(self, x: Tensor) -> Tensor:
        """h (T,H) of inputs x (T,D), in the order given."""
        return self.run_shares(linear(x, self.W, self.b))

    def run_shares(self, shares: Tensor) -> Tensor:
        """h (T,H), in the order given, of the input's shares W x + b (T,4H)."""
        H = self.hidden
        h, c, tanh_c = torch.empty(len(shares), H), torch.zeros(H), torch.empty(H)
        z = torch.empty(4 * H)
        i, f, g, o = z.split(H)
        for t, share in enumerate(shares):
            if t == 0:  # from zero state: no product
                z.copy_(share)
            else:
                torch.addmv(share, self._U, h[t - 1], out=z)
            z.sigmoid_()
            c.mul_(f).addcmul_(i, g, value=2.0).sub_(i)
            torch.tanh(c, out=tanh_c)
            torch.mul(o, tanh_c, out=h[t])
        return h


class Int8:
    """One direction of one LSTM layer by torch's dynamically quantised kernel; h (T,H) of x (T,D)."""

    def __init__(self, lstm: nn.LSTM, name: str) -> None:
        W, U, b = _weights(lstm, name)
        alone = nn.LSTM(W.shape[1], lstm.hidden_size, batch_first=True)
        alone.weight_ih_l0.data, alone.weight_hh_l0.data = W, U
        alone.bias_ih_l0.data, alone.bias_hh_l0.data = b, torch.zeros_like(b)
        with warnings.catch_warnings():  # torch announces that it will go; see `fastest`
            warnings.simplefilter("ignore")
            (self._lstm,) = torch.ao.quantization.quantize_dynamic(
                nn.Sequential(alone), {nn.LSTM}, dtype=torch.qint8
            )

    def run(self, x: Tensor) -> Tensor:
        h: Tensor = self._lstm(x[None])[0][0]
        return h


def _weights(lstm: nn.LSTM, name: str) -> tuple[Tensor, Tensor, Tensor]:
    """W (4H,D), U (4H,H) and the sum of both biases (4H,) of a layer and direction as `l0_reverse`."""
    W, U = (getattr(lstm, f"weight_{k}_{name}").detach().float() for k in ("ih", "hh"))
    b_ih, b_hh = (getattr(lstm, f"bias_{k}_{name}").detach().float() for k in ("ih", "hh"))
    return W.contiguous(), U.contiguous(), b_ih + b_hh


class TwoLayers:
    """`Runtime` of BiRNN (either number of directions) and IMUPoser; reach: of layer 2, frames."""

    def __init__(
        self,
        dense: nn.Linear,
        lstm: nn.LSTM,
        precision: Precision = "float32",
        reach: int = EVERY,
    ) -> None:
        self.reach = reach
        sides = ("", "_reverse") if lstm.bidirectional else ("",)
        kind = Int8 if precision == "int8" else Exact
        self._dense_W, self._dense_b = dense.weight.detach(), dense.bias.detach()
        self._first: list[Exact | Int8] = [kind(lstm, f"l0{side}") for side in sides]
        self._second: list[Exact | Int8] = [kind(lstm, f"l1{side}") for side in sides]
        exact = [r for r in self._first if isinstance(r, Exact)]
        if exact:
            self._W = torch.cat([r.W for r in exact])
            self._b = torch.cat([r.b for r in exact])
        self._keeps_shares = bool(exact)

    def rows(self, x: Tensor) -> Tensor:
        x = torch.relu(linear(x, self._dense_W, self._dense_b))
        return linear(x, self._W, self._b) if self._keeps_shares else x

    def features(self, rows: Tensor, emit: int) -> Tensor:
        begin, end = max(0, emit - self.reach), emit + 1
        if len(self._first) == 1:
            return self._second[0].run(self._layer_1(0, rows[:end])[begin:])[-1]
        stop = end + self.reach
        backward = _beside(lambda: self._layer_1(1, rows[begin:].flip(0)).flip(0)[: stop - begin])
        forward = self._layer_1(0, rows[:stop])[begin:]
        h = torch.cat([forward, backward.result()], -1)
        ahead, back = self._second
        future = _beside(lambda: back.run(h[emit - begin :].flip(0))[-1])
        return torch.cat([ahead.run(h[: end - begin])[-1], future.result()])

    def _layer_1(self, side: int, rows: Tensor) -> Tensor:
        """h (T,H) of layer 1, in the order given."""
        layer = self._first[side]
        if isinstance(layer, Exact):
            width = 4 * layer.hidden
            return layer.run_shares(rows[:, side * width : (side + 1) * width])
        return layer.run(rows)


def _beside(work: Callable[[], Tensor]) -> Future[Tensor]:
    """Begin `work` on this process's second thread."""

    def inferring() -> Tensor:  # the mode belongs to a thread
        with torch.inference_mode():
            return work()

    return _second_thread(os.getpid()).submit(inferring)


@cache
def _second_thread(process: int) -> ThreadPoolExecutor:
    """One for each process: threads do not survive a fork."""
    return ThreadPoolExecutor(1, thread_name_prefix="backward", initializer=one_thread)


class Plain:
    """`Runtime` of any network by its own forward over the whole window: what others are compared with."""

    def __init__(self, model: Model) -> None:
        self.model = model

    def rows(self, x: Tensor) -> Tensor:
        return x

    def features(self, rows: Tensor, emit: int) -> Tensor:
        out = self.model(rows.unsqueeze(0))
        if isinstance(out, Gaussian):
            return torch.cat([out.pose, out.pose_deviation, out.acc, out.acc_deviation], -1)[
                0, emit
            ]
        return out[0, emit]


def prepare(model: Model, precision: Precision = "float32", reach: int | None = None) -> Runtime:
    """The runtime of a model: `TwoLayers` for the recurrent networks, `Plain` for the others.

    reach: frames of layer 2 on either side of the emitted one; default: what was measured for these weights.
    """
    reach = reach or model.reach or EVERY
    if isinstance(model, Imuposer) or isinstance(model.net, BiRNN):
        return TwoLayers(model.net.dense, model.net.lstm, precision, reach)  # type: ignore[arg-type]
    return Plain(model)


def fastest() -> Precision:
    """int8 where this torch and this CPU have its kernels (torch plans to remove them), else float32."""
    lstm = nn.LSTM(4, 4)
    try:
        found = Int8(lstm, "l0").run(torch.ones(3, 4))
    except (RuntimeError, AttributeError):  # NotImplementedError is a RuntimeError
        return "float32"
    return "int8" if torch.allclose(found, lstm(torch.ones(3, 4))[0], atol=0.05) else "float32"


def gaussian(model: Dip, runtime: Runtime, features: Tensor) -> Gaussian:
    """DIP's prediction for the emitted frame, (135,) and (15,), scaled units."""
    if isinstance(runtime, Plain):
        sizes = (135, 135, 15, 15)
        return Gaussian(*features.split(sizes))
    out: Gaussian = model.net.heads(features)  # type: ignore[operator]
    return out


def pose_numbers(model: Imuposer, runtime: Runtime, features: Tensor) -> Tensor:
    """IMUPoser's 144 numbers of the emitted frame."""
    if isinstance(runtime, Plain):
        return features
    return model.net.head(features)


def one_thread() -> None:
    """Let torch work on one thread in this process.

    A frame's products are small and follow one another: a second thread inside each gains little on an idle
    machine, and on a busy one each product waits for whichever thread runs last.
    """
    torch.set_num_threads(1)
