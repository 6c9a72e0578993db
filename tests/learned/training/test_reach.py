"""How much of layer 2 is kept: measured for the weights, carried by their description."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from learned import checkpoint, runtime
from learned.errors import CheckpointError
from learned.models import Imuposer, build, for_network
from learned.runtime import EVERY, TwoLayers, prepare
from learned.training import reach
from learned.training.export import export
from learned.training.validation import Windowed, cut_for
from learned.training.validation import recordings as recorded
from mocap.synthesis.motions import builtin


@pytest.fixture(scope="module")
def windows() -> Windowed:
    return cut_for("imuposer", recorded("imuposer", [("clip", builtin(25.0, 8.0))]), 24)


def forgetful(weight: float) -> Imuposer:
    """A network whose layer 2 forgets fast (small weight) or slowly (large): the forget gate's bias."""
    torch.manual_seed(1)
    model = build(for_network("imuposer", hidden=24)).eval().requires_grad_(False)
    assert isinstance(model, Imuposer)
    H = 24
    for side in ("", "_reverse"):
        getattr(model.net.lstm, f"bias_ih_l1{side}")[H : 2 * H] = weight
    return model


def test_a_long_memory_needs_more_frames(windows: Windowed) -> None:
    short, long = forgetful(-4.0), forgetful(3.0)
    assert reach.measured(short, windows)["reach_frames"] == reach.REACHES[0]
    assert reach.measured(long, windows) == {}  # nothing short of the window is nearly exact
    x = reach.inputs(long, windows)
    found = reach.differences(long, x, windows.emit, (20, EVERY))
    assert found[20][0] > reach.NEARLY_DEG and found[EVERY][1] < 1e-2


def test_it_travels_with_the_weights(windows: Windowed, tmp_path: Path) -> None:
    run, target = tmp_path / "best.safetensors", tmp_path / "out.safetensors"
    checkpoint.save(forgetful(-4.0), run, {})
    assert checkpoint.load(run).reach is None
    way = prepare(checkpoint.load(run))
    assert isinstance(way, TwoLayers) and way.reach == EVERY  # not measured: the whole window
    record = export(run, target, windows, {})
    model = checkpoint.load(target)
    assert model.reach == record["online"]["reach_frames"] == reach.REACHES[0]
    way = prepare(model)
    assert isinstance(way, TwoLayers) and way.reach == model.reach
    assert f"begins {model.reach} frames" in target.with_suffix(".md").read_text()


@pytest.mark.parametrize("stated", [0, -3, "40", True, 1.5, [40]])
def test_nonsense_is_refused(stated: object, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    checkpoint.save(forgetful(0.0), path, {"online": {"reach_frames": stated}})
    with pytest.raises(CheckpointError, match="reach_frames"):
        checkpoint.load(path)


def test_what_is_shipped_is_nearly_exact() -> None:
    model = checkpoint.load(checkpoint.shipped("imuposer"))
    online = checkpoint.describe(checkpoint.shipped("imuposer"))["online"]
    assert model.reach == online["reach_frames"] and online["reach_mean_deg"] <= reach.NEARLY_DEG
    held = cut_for("imuposer", recorded("imuposer", [("clip", builtin(25.0, 8.0))]), 12)
    x = reach.inputs(model, held)
    mean, _ = reach.differences(model, x, held.emit, [online["reach_frames"]])[model.reach or EVERY]
    assert mean < 2 * reach.NEARLY_DEG
    assert json.dumps(online) and isinstance(runtime.prepare(model), TwoLayers)
