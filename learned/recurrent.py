"""LSTM layers for training on a CPU: torch.nn.LSTM's weights and results, several times its speed.

torch's own CPU kernel accumulates the recurrent weight's gradient step by step; here all that does not
depend on the recurrence is one product over the whole window (the input's share of the gates before the
loop, the weights' gradient after it), which bfloat16 units run near their peak. Inference uses
torch.nn.LSTM itself.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import linear


class _Recurrence(torch.autograd.Function):
    """h (T,B,H) of gates' input share x (T,B,4H) and recurrent weight U (4H,H); gates i, f, g, o.

    i, f, o = sigmoid, g = tanh of x_t + U h_{t-1}; c_t = f c_{t-1} + i g; h_t = o tanh(c_t)
    (torch.nn.LSTM's equations), from h = c = 0.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, U: Tensor) -> Tensor:
        T, B, width = x.shape
        H = width // 4
        Ut = U.t().contiguous()
        h, c = x.new_zeros(T + 1, B, H), x.new_zeros(T + 1, B, H)
        gates, tanh_c = torch.empty_like(x), x.new_empty(T, B, H)
        for t in range(T):
            z = torch.addmm(x[t], h[t], Ut)
            a = gates[t]
            torch.sigmoid(z, out=a)
            torch.tanh(z[:, 2 * H : 3 * H], out=a[:, 2 * H : 3 * H])
            torch.mul(a[:, H : 2 * H], c[t], out=c[t + 1])
            c[t + 1].addcmul_(a[:, :H], a[:, 2 * H : 3 * H])
            torch.tanh(c[t + 1], out=tanh_c[t])
            torch.mul(a[:, 3 * H :], tanh_c[t], out=h[t + 1])
        ctx.save_for_backward(U, h, c, gates, tanh_c)
        return h[1:]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        U, h, c, gates, tanh_c = ctx.saved_tensors
        (dh_out,) = grads
        T, _B, H = dh_out.shape
        i, f, g, o = gates.split(H, -1)
        # Derivatives of each gate's pre-activation per unit of dc (i, f, g) or dh (o), all t at once.
        di, df, dg = g * i * (1 - i), c[:-1] * f * (1 - f), i * (1 - g * g)
        do, dc_dh = tanh_c * o * (1 - o), o * (1 - tanh_c * tanh_c)
        dz = torch.empty_like(gates)
        dh, dc = torch.zeros_like(h[0]), torch.zeros_like(h[0])
        for t in range(T - 1, -1, -1):
            dh = dh + dh_out[t]
            dc = torch.addcmul(dc, dh, dc_dh[t])
            row = dz[t]
            torch.mul(dc, di[t], out=row[:, :H])
            torch.mul(dc, df[t], out=row[:, H : 2 * H])
            torch.mul(dc, dg[t], out=row[:, 2 * H : 3 * H])
            torch.mul(dh, do[t], out=row[:, 3 * H :])
            dc = dc * f[t]
            dh = row @ U
        return dz, dz.reshape(-1, 4 * H).t() @ h[:-1].reshape(-1, H)


def run(lstm: torch.nn.LSTM, x: Tensor) -> Tensor:
    """What `lstm(x)[0]` gives for x (B,T,D), batch first, from zero state; autocast is followed.

    On a GPU it is `lstm(x)[0]`: cuDNN needs no help.
    """
    if x.device.type != "cpu":
        return lstm(x)[0]
    if torch.is_autocast_enabled("cpu"):
        x = x.to(torch.get_autocast_dtype("cpu"))
    out = x.transpose(0, 1)
    for layer in range(lstm.num_layers):
        sides = []
        for suffix in ("", "_reverse") if lstm.bidirectional else ("",):
            name = f"l{layer}{suffix}"
            W, U = getattr(lstm, f"weight_ih_{name}"), getattr(lstm, f"weight_hh_{name}")
            b = getattr(lstm, f"bias_ih_{name}") + getattr(lstm, f"bias_hh_{name}")
            share = linear(out.flip(0) if suffix else out, W.to(x.dtype), b.to(x.dtype))
            h = _Recurrence.apply(share, U.to(x.dtype))
            sides.append(h.flip(0) if suffix else h)
        out = torch.cat(sides, -1)
    return out.transpose(0, 1)
