"""Inference of one frame of a window: the networks' own weights, only the products that frame needs.

A window of T frames whose frame `emit` is answered for needs, of two stacked bidirectional LSTM layers,
layer 1 whole, but of layer 2 the forward direction only up to `emit` and the backward direction only from
the window's end down to it; the heads only there. The first layer's input product W x_t + b depends on
nothing but frame t: the caller keeps these rows from window to window (`rows`). Both are exact. The
recurrent states are not kept: each window starts from zero, as in training.
"""

from __future__ import annotations

from typing import Literal, Protocol

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from learned.models import Dip, Imuposer, Model
from learned.networks.dip import BiRNN, Gaussian

Precision = Literal["float32", "bfloat16"]
PRECISIONS: dict[Precision, torch.dtype] = {"float32": torch.float32, "bfloat16": torch.bfloat16}


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

    def __init__(self, lstm: nn.LSTM, name: str, dtype: torch.dtype) -> None:
        H = lstm.hidden_size
        doubled = torch.ones(4 * H, 1)
        doubled[2 * H : 3 * H] = 2.0
        W, U = (getattr(lstm, f"weight_{k}_{name}").detach().float() for k in ("ih", "hh"))
        b = sum(getattr(lstm, f"bias_{k}_{name}").detach().float() for k in ("ih", "hh"))
        self.hidden = H
        self.W, self.b = doubled * W, (doubled[:, 0] * b).contiguous()
        self.U = (doubled * U).to(dtype).contiguous()

    def run(self, shares: Tensor) -> Tensor:
        """h (T,H), in the order given, of the input's shares W x + b (T,4H)."""
        H, dtype = self.hidden, self.U.dtype
        h, c, tanh_c = torch.empty(len(shares), H), torch.zeros(H), torch.empty(H)
        z = torch.empty(4 * H)
        i, f, g, o = z.split(H)
        for t, share in enumerate(shares):
            if t == 0:  # from zero state: no product
                z.copy_(share)
            elif dtype == torch.float32:
                torch.addmv(share, self.U, h[t - 1], out=z)
            else:
                torch.add(share, torch.mv(self.U, h[t - 1].to(dtype)), out=z)
            z.sigmoid_()
            c.mul_(f).addcmul_(i, g, value=2.0).sub_(i)
            torch.tanh(c, out=tanh_c)
            torch.mul(o, tanh_c, out=h[t])
        return h


class TwoLayers:
    """`Runtime` of BiRNN (either number of directions) and IMUPoser.

    precision: of the recurrent matrices, whose reading is what a frame waits for; "bfloat16" halves it,
    at the price that `benchmarks/networks.py` states in degrees.
    """

    def __init__(self, dense: nn.Linear, lstm: nn.LSTM, precision: Precision = "float32") -> None:
        dtype = PRECISIONS[precision]
        sides = ("", "_reverse") if lstm.bidirectional else ("",)
        self.dense_W, self.dense_b = dense.weight.detach(), dense.bias.detach()
        self.first = [Recurrence(lstm, f"l0{side}", dtype) for side in sides]
        self.second = [Recurrence(lstm, f"l1{side}", dtype) for side in sides]
        self._W = torch.cat([r.W for r in self.first])
        self._b = torch.cat([r.b for r in self.first])

    def rows(self, x: Tensor) -> Tensor:
        return linear(torch.relu(linear(x, self.dense_W, self.dense_b)), self._W, self._b)

    def features(self, rows: Tensor, emit: int) -> Tensor:
        width = 4 * self.first[0].hidden
        if len(self.first) == 1:
            h = self.first[0].run(rows[: emit + 1])
            (second,) = self.second
            return second.run(linear(h, second.W, second.b))[-1]
        forward, backward = rows[:, :width], rows[:, width:].flip(0)
        h = torch.cat([self.first[0].run(forward), self.first[1].run(backward).flip(0)], -1)
        ahead, back = self.second
        past = ahead.run(linear(h[: emit + 1], ahead.W, ahead.b))[-1]
        future = back.run(linear(h[emit:].flip(0), back.W, back.b))[-1]
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


def prepare(model: Model, precision: Precision = "float32") -> Runtime:
    """The runtime of a model: `TwoLayers` for the recurrent networks, `Plain` for the others."""
    if isinstance(model, Imuposer) or isinstance(model.net, BiRNN):
        return TwoLayers(model.net.dense, model.net.lstm, precision)  # type: ignore[arg-type]
    return Plain(model)


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
