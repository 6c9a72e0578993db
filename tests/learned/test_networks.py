"""The architectures: sizes against the papers, what each output frame may see."""

from __future__ import annotations

import pytest
import torch

from learned.dip.network import FeedForward, Gaussian, WaveNet
from learned.errors import CheckpointError
from learned.models import ARCHITECTURES, Config, Dip, Imuposer, build, for_network
from mocap import sensors as places


def count(module: torch.nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def lstm_size(inputs: int, hidden: int, directions: int, layers: int = 2) -> int:
    """Weights and two biases of four gates, the second layer reading all directions of the first."""
    total = 0
    for layer in range(layers):
        width = inputs if layer == 0 else directions * hidden
        total += directions * 4 * hidden * (width + hidden + 2)
    return total


def test_imuposer_has_the_papers_size() -> None:
    """10.7 M parameters (IMUPoser, 4.1)."""
    size = count(build(for_network("imuposer")))
    assert round(size / 1e6, 1) == 10.7
    assert size == 61 * 512 + lstm_size(512, 512, 2) + 1025 * 144


def test_dip_size() -> None:
    """Dense 512, two stacked BiLSTM layers of 512, four heads (DIP, Fig. 12)."""
    heads = 2 * (135 + 15)
    assert count(build(Config())) == 61 * 512 + lstm_size(512, 512, 2) + 1025 * heads
    rnn = build(Config(architecture="rnn"))
    assert count(rnn) == 61 * 512 + lstm_size(512, 512, 1) + 513 * heads


def test_feed_forward_layers() -> None:
    """256, 512, 512, 256, 256 on 26 frames (DIP, appendix A)."""
    net = FeedForward()
    widths = [m.out_features for m in net.layers if isinstance(m, torch.nn.Linear)]
    assert widths == [256, 512, 512, 256, 256]
    assert net.layers[0].in_features == 26 * 60


REACH = {"birnn": (99, 99), "rnn": (99, 0), "feedforward": (20, 5), "wavenet": (25, 5)}


@pytest.mark.parametrize("architecture", REACH)
def test_which_frames_an_output_depends_on(architecture: str) -> None:
    """By gradient: output t sees frames t - past to t + future and none beyond."""
    torch.manual_seed(0)
    model = build(Config(architecture=architecture, hidden=8)).eval()  # type: ignore[arg-type]
    T, t = 60, 35
    x = torch.randn(1, T, 60, requires_grad=True)
    out: Gaussian = model(x)
    out.pose[0, t].sum().backward()
    assert x.grad is not None
    seen = (x.grad[0].abs().sum(-1) > 0).nonzero().flatten()
    past, future = REACH[architecture]
    assert (int(seen.min()), int(seen.max())) == (max(0, t - past), min(T - 1, t + future))


@pytest.mark.parametrize("frames", [1, 2, 7, 30])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_any_length(architecture: str, frames: int) -> None:
    network = "imuposer" if architecture == "imuposer" else "dip"
    model = build(for_network(network, architecture=architecture, hidden=8)).eval()
    y = model(torch.randn(2, frames, 60))
    y = y.pose if isinstance(y, Gaussian) else y
    assert y.shape[:2] == (2, frames)
    assert torch.isfinite(y).all()


def test_training_and_inference_agree_without_dropout() -> None:
    """Training runs `recurrent.run`, inference torch.nn.LSTM: the same network."""
    torch.manual_seed(0)
    for network in ("dip", "imuposer"):
        model = build(for_network(network, hidden=16, dropout=0.0))
        x = torch.randn(2, 9, 60)
        a, b = model.train()(x), model.eval()(x)
        a, b = (a.pose, b.pose) if isinstance(model, Dip) else (a, b)
        torch.testing.assert_close(a, b, rtol=0, atol=1e-6)


def test_dropout_acts_on_the_input_in_training_alone() -> None:
    torch.manual_seed(0)
    x = torch.randn(2, 9, 60)
    wet, dry = build(Config(hidden=8)), build(Config(hidden=8, dropout=0.0))
    assert not torch.equal(wet.train()(x).pose, wet(x).pose)
    assert torch.equal(wet.eval()(x).pose, wet(x).pose)
    assert torch.equal(dry.train()(x).pose, dry(x).pose)


def test_deviations_are_positive_whatever_comes_in() -> None:
    model = build(Config(hidden=8)).eval()
    out = model(1e3 * torch.randn(1, 5, 60))
    assert (out.pose_deviation > 0).all() and (out.acc_deviation > 0).all()


def test_wavenet_reach_is_that_of_its_dilations() -> None:
    assert sum(WaveNet().dilations) == 30


def test_no_acceleration_and_other_normalisations_change_the_input() -> None:
    widths = {
        ("root", True): 60, ("root", False): 45, ("first", True): 72, ("heading", True): 72,
    }  # fmt: skip
    for (normalisation, use_acc), width in widths.items():
        model = build(Config(normalisation=normalisation, use_acc=use_acc, hidden=8))  # type: ignore[arg-type]
        R, acc = torch.eye(3).expand(2, 4, 6, 3, 3), torch.zeros(2, 4, 6, 3)
        x, target = model.inputs(R, acc)
        assert x.shape == (2, 4, width) and target.shape == (2, 4, 15)
        assert model(x).pose.shape == (2, 4, 135)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"architecture": "transformer"}, "architecture 'transformer' unknown"),
        ({"sensors": places.SIX[::-1]}, "in this order"),
        ({"rate_hz": 30.0}, "dip runs at 60 Hz"),
        ({"architecture": "imuposer"}, "imuposer reads left_wrist"),
    ],
)
def test_what_a_configuration_refuses(changes: dict[str, object], said: str) -> None:
    with pytest.raises(CheckpointError, match=said):
        Config(**changes)  # type: ignore[arg-type]


def test_both_models_are_built_by_their_name() -> None:
    assert isinstance(build(for_network("imuposer", hidden=8)), Imuposer)
    assert isinstance(build(for_network("dip", hidden=8)), Dip)
