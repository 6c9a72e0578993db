"""A network is its specification and its model: all that is said of it, and one of our own beside them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import learned
from learned import checkpoint
from learned.config import Config, for_network
from learned.errors import CheckpointError
from learned.model import Model, build
from learned.online.estimator import NetworkEstimate
from learned.registry import NETWORKS, specification
from learned.spec import Specification, named
from learned.training.corpus import pack
from learned.training.export import export
from learned.training.settings import TrainSettings
from learned.training.trainer import Trainer
from learned.training.validation import cut_for, recordings
from learned.training.virtual_windows import Windows
from learned.tree import from_6d, to_6d
from mocap import sensors as places
from mocap.errors import PoserError
from mocap.estimator import replay
from tests.learned.swing import wavy

TOY = Specification(
    name="toy",
    title="Toy",
    rate_hz=30.0,
    places=("pelvis", "head"),
    combinations=((0, 1),),
    architectures=("toy",),
    window=(3, 0),
    most_windows=20,
    model="tests.learned.test_registry:Toy",
    online="tests.learned.test_registry:window",
    deviations="tests.learned.test_registry:calibrate",
    schedule={"batch": 4, "frames": 8, "learning_rate": 1e-2},
    tracker={"spine": False},
)


class Toy(Model):
    """A linear map from the two orientations of a frame to 24 rotations."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.net = nn.Linear(18, 144)
        self.register_buffer("error_covariance", torch.eye(72))

    def examples(self, R: Tensor, acc: Tensor, truth: Tensor, shown: Tensor) -> tuple[Tensor, Any]:
        return R.flatten(-3), to_6d(truth).flatten(-2)

    def loss(self, out: Any, target: Any, reconstruct_acc: bool = True) -> Tensor:
        return torch.mean((out - target) ** 2)

    def pose(self, out: Any, R_world_bone: Tensor) -> Tensor:
        return from_6d(out.unflatten(-1, (24, 6)))


def calibrate(model: Toy, windows: Any, trained: Any) -> None:
    model.error_covariance.copy_(0.1 * torch.eye(72))


def window(model: Toy, sensors: tuple[str, ...], names: Any, frames: Any, way: Any) -> ToyWindow:
    return ToyWindow(model, sensors)


class ToyWindow:
    future = 0

    def __init__(self, model: Toy, sensors: tuple[str, ...]) -> None:
        self.model, self.sensors, self.rate_hz = model, sensors, model.config.rate_hz

    @torch.inference_mode()
    def tick(self, state: Any, R: Any, acc: Any, present: Any, jumped: bool) -> tuple[Any, Any]:
        sensors = torch.as_tensor(R).float()
        pose = self.model.pose(self.model(sensors.flatten()), sensors)
        return state, NetworkEstimate(pose.double().numpy(), np.full((24, 3), 0.3))


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Specification:
    monkeypatch.setitem(NETWORKS, "toy", TOY)
    return TOY


def test_a_network_of_ones_own_trains_ships_and_streams(toy: Specification, tmp_path: Path) -> None:
    """A specification, a model, a line in the registry: nothing else knows it."""
    motion = wavy(90, 30.0)
    settings = TrainSettings.paper("toy", steps=4, every=2, bfloat16=False)
    source = Windows(
        pack([("clip", motion.resampled(60.0))]),
        toy.places,
        toy.rate_hz,
        settings.frames,
        settings.augmentation,
    )
    windows = cut_for("toy", recordings("toy", [("clip", motion)]))
    best = Trainer(settings, source, windows, tmp_path / "run").run()
    target = tmp_path / "toy.safetensors"
    described = export(best, target, windows, {})
    assert described["config"]["architecture"] == "toy"
    assert "Toy (toy" in target.with_suffix(".md").read_text()
    with pytest.raises(CheckpointError, match="weights of toy, expected dip"):
        checkpoint.load(target, "dip")
    estimator = learned.estimator("toy", 30.0, weights=target)
    assert estimator.tracker_hints == toy.tracker
    recording = recordings("toy", [("clip", motion)])[0]
    assert len(replay(estimator, recording).motion) == len(recording)


def test_every_model_keeps_what_its_specification_says() -> None:
    for spec in NETWORKS.values():
        for architecture in spec.architectures:
            model = build(for_network(spec.name, architecture=architecture, hidden=8))
            assert type(model) is named(spec.model)
            assert model.config.specification is spec and model.config.network == spec.name
        assert spec.trained_on([spec.places[i] for i in spec.combinations[-1]])
        assert set(spec.places) <= set(places.PLACES)
    assert specification("dip").needs_all and not specification("imuposer").needs_all
    assert not specification("imuposer").trained_on(("left_pocket", "right_pocket", "head"))
    with pytest.raises(PoserError, match="known: dip, imuposer"):
        specification("transpose")


def test_importing_the_package_does_not_import_torch() -> None:
    code = (
        "import sys, learned; learned.specification('dip')\n"
        "assert 'torch' not in sys.modules\n"
        "learned.build; assert 'torch' in sys.modules\n"
        "assert all(hasattr(learned, name) for name in dir(learned))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
