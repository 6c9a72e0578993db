"""`recurrent.run` is torch.nn.LSTM: values and gradients, in double precision."""

from __future__ import annotations

import pytest
import torch

from learned import recurrent


@pytest.mark.parametrize("bidirectional", [False, True])
@pytest.mark.parametrize("layers", [1, 2])
def test_values_and_gradients(bidirectional: bool, layers: int) -> None:
    torch.manual_seed(3)
    lstm = torch.nn.LSTM(5, 7, layers, batch_first=True, bidirectional=bidirectional).double()
    x = torch.randn(3, 11, 5, dtype=torch.float64, requires_grad=True)
    weights = torch.randn(3, 11, 14 if bidirectional else 7, dtype=torch.float64)
    found = []
    for forward in (lambda v: lstm(v)[0], lambda v: recurrent.run(lstm, v)):
        y = forward(x)
        grads = torch.autograd.grad((y.tanh() * weights).sum(), [x, *lstm.parameters()])
        found.append([y.detach(), *grads])
    for ours, theirs in zip(found[1], found[0], strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-10)


def test_gradients_against_finite_differences() -> None:
    torch.manual_seed(4)
    lstm = torch.nn.LSTM(2, 3, 1, batch_first=True, bidirectional=True).double()
    x = torch.randn(2, 4, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: recurrent.run(lstm, v), (x,))


def test_one_frame() -> None:
    lstm = torch.nn.LSTM(2, 3, 2, batch_first=True, bidirectional=True)
    x = torch.randn(1, 1, 2)
    torch.testing.assert_close(recurrent.run(lstm, x), lstm(x)[0])


def test_autocast_computes_in_half_precision() -> None:
    torch.manual_seed(5)
    lstm = torch.nn.LSTM(4, 6, 1, batch_first=True)
    x = torch.randn(2, 9, 4)
    with torch.autocast("cpu", torch.bfloat16):
        y = recurrent.run(lstm, x)
    assert y.dtype == torch.bfloat16
    y.float().sum().backward()
    assert lstm.weight_hh_l0.grad is not None and lstm.weight_hh_l0.grad.dtype == torch.float32
    # bfloat16 carries 8 bits: the values agree to its rounding over nine steps.
    torch.testing.assert_close(y.float(), lstm(x)[0], rtol=0, atol=0.05)
