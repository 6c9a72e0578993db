"""The pruned frame against the plain forward over the whole window."""

from __future__ import annotations

import pytest
import torch

from learned.config import for_network
from learned.dip.model import Dip
from learned.imuposer.model import Imuposer
from learned.model import build
from learned.runtime import Plain, TwoLayers, fastest, prepare


def model(network: str, **changes: object) -> Dip | Imuposer:
    torch.manual_seed(4)
    built = build(for_network(network, hidden=32, **changes)).eval()
    for name, x in built.named_parameters():
        if "weight" in name:
            x.data *= 2
    return built.requires_grad_(False)


WINDOWS = [(26, 20), (56, 50), (21, 20), (125, 124), (1, 0), (30, 0)]


@pytest.mark.parametrize(("frames", "emit"), WINDOWS)
@pytest.mark.parametrize("architecture", ["birnn", "rnn", "imuposer"])
@torch.inference_mode()
def test_unlimited_it_is_exact(architecture: str, frames: int, emit: int) -> None:
    network = "imuposer" if architecture == "imuposer" else "dip"
    net = model(network, architecture=architecture)
    x = torch.randn(frames, 60)
    runtime = prepare(net)
    assert not isinstance(runtime, Plain)
    out, whole = runtime.answer(runtime.rows(x), emit), net(x[None])[0, emit]
    if isinstance(net, Imuposer):
        torch.testing.assert_close(out, whole, atol=2e-6, rtol=1e-5)
        return
    for name in ("pose", "pose_deviation", "acc", "acc_deviation"):
        torch.testing.assert_close(getattr(out, name), getattr(whole, name), atol=2e-6, rtol=1e-5)


@torch.inference_mode()
def test_the_reach_of_layer_2_trades_error() -> None:
    """Each frame further matters less; layer 1's forward direction is never cut."""
    net = model("imuposer")
    assert isinstance(net, Imuposer)
    x = torch.randn(125, 60)
    whole = net(x[None])[0, 124]
    off = []
    for reach in (1, 4, 10, 40, 124):
        runtime = prepare(net, reach=reach)
        found = runtime.answer(runtime.rows(x), 124)
        off.append(float((found - whole).abs().max()))
    assert off[0] > 1e-3 and off[-1] < 2e-6
    assert off[3] < 1e-5
    assert off[0] > off[1] > off[2] > off[3]


@pytest.mark.parametrize("architecture", ["birnn", "rnn", "imuposer"])
@torch.inference_mode()
def test_fewer_bits_are_near(architecture: str) -> None:
    net = model("imuposer" if architecture == "imuposer" else "dip", architecture=architecture)
    x = torch.randn(26, 60)
    exact, near = prepare(net), prepare(net, "int8")
    assert isinstance(exact, TwoLayers) and isinstance(near, TwoLayers)
    off = (near.features(near.rows(x), 20) - exact.features(exact.rows(x), 20)).abs().max()
    assert 1e-5 < off <= 0.15  # nought would say that it was not used


@torch.inference_mode()
def test_other_architectures_run_whole() -> None:
    net = model("dip", architecture="wavenet")
    assert isinstance(net, Dip)
    x = torch.randn(26, 60)
    runtime = prepare(net)
    assert isinstance(runtime, Plain)
    out = runtime.answer(runtime.rows(x), 20)
    torch.testing.assert_close(out.pose, net(x[None]).pose[0, 20])
    assert out.acc.shape == (15,)


def test_the_fastest_there_is_can_be_made() -> None:
    precision = fastest()
    if "fbgemm" in torch.backends.quantized.supported_engines:
        assert (
            precision == "int8"
        )  # falling back would hide a mistake of ours, at several times the time
    runtime = prepare(model("dip"), precision)
    assert torch.isfinite(runtime.answer(runtime.rows(torch.randn(26, 60)), 20).pose).all()
