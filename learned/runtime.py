"""Inference of one frame of a window: the networks' own weights, only the products that frame needs.

A window of T frames whose frame `emit` is answered for needs, of two stacked bidirectional LSTM layers, of
layer 2 the forward direction only up to `emit` and the backward direction only from the window's end down to
it; the heads only there. The first layer's input product W x_t + b depends on nothing but frame t: the
caller keeps these rows from window to window (`rows`). Both are exact. The recurrent states are not kept:
each window starts from zero, as in training.

Layer 1 remembers seconds, layer 2 does not: its states `REACH` frames from `emit` no longer matter (on
validation recordings 0.0002 degrees; 20 frames 0.001, 10 frames 0.03; `benchmarks/networks.py` measures it).
Layer 2 therefore begins there, and layer 1's backward direction, which only layer 2 reads, ends there.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Literal, Protocol

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from learned.models import Dip, Imuposer, Model
from learned.networks.dip import BiRNN, Gaussian

Precision = Literal["float32", "bfloat16", "int8"]
REACH = 40  # frames of layer 2 before and after the emitted one


class Runtime(Protocol):
    """What the windows of `learned.online` are answered with."""

    def rows(self, x: Tensor) -> Tensor:
        """What can be kept of each frame: (n,W) of inputs (n,D)."""
        ...

    def features(self, rows: Tensor, emit: int) -> Tensor:
        """What the heads read at frame `emit`: (F,) of a window's rows (T,W)."""
        ...


class Recurrence:
    """One direction of one LSTM layer: h_t of h_{t-1} and the input's share of the gates.

    i, f, o = sigmoid, g = tanh of W x_t + b + U h_{t-1}; c_t = f c_{t-1} + i g; h_t = o tanh(c_t)
    (torch.nn.LSTM's equations), from h = c = 0. tanh(z) = 2 sigmoid(2 z) - 1, so the rows of g are doubled
    here and one sigmoid serves the four gates: a step is a matrix-vector product, which waits for memory,
    and few calls besides.
    """

    def __init__(self, lstm: nn.LSTM, name: str, precision: Precision) -> None:
        H = lstm.hidden_size
        doubled = torch.ones(4 * H, 1)
        doubled[2 * H : 3 * H] = 2.0
        W, U = (getattr(lstm, f"weight_{k}_{name}").detach().float() for k in ("ih", "hh"))
        b = sum(getattr(lstm, f"bias_{k}_{name}").detach().float() for k in ("ih", "hh"))
        self.hidden = H
        self.W, self.b = doubled * W, (doubled[:, 0] * b).contiguous()
        self._product = _product(doubled * U, precision)

    def run(self, shares: Tensor) -> Tensor:
        """h (T,H), in the order given, of the input's shares W x + b (T,4H)."""
        H, product = self.hidden, self._product
        h, c, tanh_c = torch.empty(len(shares), H), torch.zeros(H), torch.empty(H)
        z = torch.empty(4 * H)
        i, f, g, o = z.split(H)
        for t, share in enumerate(shares):
            if t == 0:  # from zero state: no product
                z.copy_(share)
            else:
                product(share, h[t - 1], z)
            z.sigmoid_()
            c.mul_(f).addcmul_(i, g, value=2.0).sub_(i)
            torch.tanh(c, out=tanh_c)
            torch.mul(o, tanh_c, out=h[t])
        return h


def _product(U: Tensor, precision: Precision) -> Callable[[Tensor, Tensor, Tensor], object]:
    """share, h, out -> out = share + U h, U kept at a precision."""
    if precision == "float32":
        exact = U.contiguous()
        return lambda share, h, out: torch.addmv(share, exact, h, out=out)
    if precision == "bfloat16":
        half = U.bfloat16().contiguous()
        return lambda share, h, out: torch.add(share, torch.mv(half, h.bfloat16()), out=out)
    # A scale for each row of U, symmetric; h is quantised at each step, by the kernel, to 7 bits, so that
    # sums of products cannot overflow where a CPU adds pairs of them in 16 bits.
    scale = U.abs().amax(1).clamp_min(1e-12).double() / 127
    zero = torch.zeros(len(U), dtype=torch.int64)
    with warnings.catch_warnings():  # torch announces that it will go; see `fastest`
        warnings.simplefilter("ignore")
        quantised = torch.quantize_per_channel(U, scale, zero, 0, torch.qint8)
    packed = torch.ops.quantized.linear_prepack(quantised, None)
    apply = torch.ops.quantized.linear_dynamic
    return lambda share, h, out: torch.add(share, apply(h.unsqueeze(0), packed, True)[0], out=out)


class TwoLayers:
    """`Runtime` of BiRNN (either number of directions) and IMUPoser.

    precision: of the recurrent matrices, whose reading is what a frame waits for; "bfloat16" halves it,
    "int8" quarters it, at prices that `benchmarks/networks.py` states in degrees. reach: of layer 2, frames.
    """

    def __init__(
        self,
        dense: nn.Linear,
        lstm: nn.LSTM,
        precision: Precision = "float32",
        reach: int = REACH,
    ) -> None:
        self.reach = reach
        sides = ("", "_reverse") if lstm.bidirectional else ("",)
        self.dense_W, self.dense_b = dense.weight.detach(), dense.bias.detach()
        self.first = [Recurrence(lstm, f"l0{side}", precision) for side in sides]
        self.second = [Recurrence(lstm, f"l1{side}", precision) for side in sides]
        self._W = torch.cat([r.W for r in self.first])
        self._b = torch.cat([r.b for r in self.first])

    def rows(self, x: Tensor) -> Tensor:
        return linear(torch.relu(linear(x, self.dense_W, self.dense_b)), self._W, self._b)

    def features(self, rows: Tensor, emit: int) -> Tensor:
        width = 4 * self.first[0].hidden
        begin, end = max(0, emit - self.reach), emit + 1
        if len(self.first) == 1:
            h = self.first[0].run(rows[:end])[begin:]
            (second,) = self.second
            return second.run(linear(h, second.W, second.b))[-1]
        stop = end + self.reach
        forward = self.first[0].run(rows[:stop, :width])[begin:]
        backward = self.first[1].run(rows[begin:, width:].flip(0)).flip(0)[: stop - begin]
        h = torch.cat([forward, backward], -1)
        ahead, back = self.second
        past = ahead.run(linear(h[: end - begin], ahead.W, ahead.b))[-1]
        future = back.run(linear(h[emit - begin :].flip(0), back.W, back.b))[-1]
        return torch.cat([past, future])


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


def prepare(model: Model, precision: Precision = "float32", reach: int = REACH) -> Runtime:
    """The runtime of a model: `TwoLayers` for the recurrent networks, `Plain` for the others."""
    if isinstance(model, Imuposer) or isinstance(model.net, BiRNN):
        return TwoLayers(model.net.dense, model.net.lstm, precision, reach)  # type: ignore[arg-type]
    return Plain(model)


def fastest() -> Precision:
    """int8 where this torch and this CPU have its kernels (torch plans to remove them), else float32."""
    try:
        product = _product(torch.eye(8), "int8")
        found = torch.empty(8)
        product(torch.zeros(8), torch.ones(8), found)
    except (RuntimeError, AttributeError, NotImplementedError):
        return "float32"
    return "int8" if torch.allclose(found, torch.ones(8), atol=0.02) else "float32"


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

    A frame's products are small and follow one another: a second thread gains little on an idle machine,
    and on a busy one each product waits for whichever thread runs last.
    """
    torch.set_num_threads(1)
