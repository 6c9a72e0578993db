"""Weights on disk: there and back, and everything that does not fit is refused in a sentence."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from learned import checkpoint
from learned.config import Config, for_network
from learned.dip.model import Dip
from learned.errors import CheckpointError
from learned.model import Model, build
from mocap.sensors import FIVE, SIX

NETWORKS = ("dip", "imuposer")


def small(network: str = "dip") -> Any:
    torch.manual_seed(1)
    return build(for_network(network, hidden=8)).eval()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    where = tmp_path / "w.safetensors"
    checkpoint.save(small(), where, {"licence": "MIT"})
    return where


@pytest.mark.parametrize("network", NETWORKS)
def test_there_and_back(tmp_path: Path, network: str) -> None:
    model, where = small(network), tmp_path / "w.safetensors"
    if isinstance(model, Dip):
        model.in_mean.normal_()
        model.deviation_scale.uniform_()
    checkpoint.save(model, where, {"training": {"clip": float("inf")}})
    back = checkpoint.load(where, network)
    x = torch.randn(1, 7, 60)
    torch.testing.assert_close(_flat(back(x)), _flat(model(x)), rtol=0, atol=0)
    for name, value in model.state_dict().items():
        assert torch.equal(back.state_dict()[name], value)
    assert not any(p.requires_grad for p in back.parameters()) and not back.training
    record = checkpoint.describe(where)
    assert record["config"]["sensors"] == list(SIX if network == "dip" else FIVE)
    assert record["training"]["clip"] is None  # JSON has no infinity


def _flat(out: Any) -> torch.Tensor:
    return out if isinstance(out, torch.Tensor) else out.pose


def test_half_precision_halves_the_matrices_alone(tmp_path: Path) -> None:
    model, where = small(), tmp_path / "h.safetensors"
    model.in_mean.fill_(1 / 3)
    checkpoint.save(model, where, {}, half=True)
    stored = load_file(where)
    assert stored["net.dense.weight"].dtype == torch.float16
    assert stored["net.dense.bias"].dtype == stored["in_mean"].dtype == torch.float32
    back = checkpoint.load(where)
    assert back.net.dense.weight.dtype == torch.float32  # type: ignore[union-attr]
    x = torch.randn(1, 7, 60)
    torch.testing.assert_close(back(x).pose, model(x).pose, rtol=0, atol=5e-3)


def test_loading_leaves_the_generator_alone(path: Path) -> None:
    torch.manual_seed(7)
    want = torch.rand(3)
    torch.manual_seed(7)
    checkpoint.load(path)
    assert torch.equal(torch.rand(3), want)


def _config(**changes: object) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        beside = path.with_suffix(".json")
        record = json.loads(beside.read_text())
        record["config"] |= changes
        beside.write_text(json.dumps(record))

    return apply


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.with_suffix(".json").write_text(text)


def _cut(keep: float) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        data = path.read_bytes()
        path.write_bytes(data[: int(keep * len(data))])

    return apply


def _tensor(
    name: str, change: Callable[[torch.Tensor], torch.Tensor] | None
) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        tensors = load_file(path)
        value = tensors.pop(name)
        if change is not None:
            tensors[name] = change(value).contiguous()
        save_file(tensors, path)

    return apply


def _spoiled(value: float) -> Callable[[torch.Tensor], torch.Tensor]:
    def change(x: torch.Tensor) -> torch.Tensor:
        x = x.clone()
        x.flatten()[3] = value
        return x

    return change


def _set(value: float) -> Callable[[torch.Tensor], torch.Tensor]:
    return lambda x: torch.full_like(x, value)


def _entry(i: int, j: int, value: float) -> Callable[[torch.Tensor], torch.Tensor]:
    def change(C: torch.Tensor) -> torch.Tensor:
        C = C.clone()
        C[i, j] = value
        return C

    return change


BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "sensor order": (_config(sensors=[*SIX[1:], SIX[0]]), "dip reads left_forearm"),
    "rate": (_config(rate_hz=50.0), "rate 50 Hz: dip runs at 60 Hz"),
    "rate in words": (_config(rate_hz="fast"), "config does not fit"),
    "other width": (_config(hidden=16), r"tensor net\.dense\.bias has shape \(8,\), expected \(16,\)"),
    "absurd width": (_config(hidden=10**12), "hidden is 1000000000000, expected 1 to 8192"),
    "width in words": (_config(hidden="x"), "hidden is 'x'"),
    "dropout": (_config(dropout=1.5), r"dropout is 1\.5"),
    "normalisation": (_config(normalisation="none"), "normalisation 'none' unknown"),
    "use_acc": (_config(use_acc="yes"), "use_acc is 'yes'"),
    "other architecture": (_config(architecture="wavenet"), "tensor net"),
    "unknown architecture": (_config(architecture="gru"), "architecture 'gru' unknown"),
    "unknown entry": (_config(layers=3), "config does not fit"),
    "no JSON": (lambda p: p.with_suffix(".json").unlink(), "weights come with their description"),
    "not JSON": (_text("{"), "not a description of weights"),
    "deep JSON": (_text("[" * 100_000), "not a description of weights"),
    "other JSON": (_text("[]"), "schema is not poser-weights/1"),
    "no config": (_text('{"schema": "poser-weights/1"}'), "holds no config"),
    "cut in the header": (_cut(0.01), "not a safetensors file, or cut short"),
    "cut": (_cut(0.7), "not a safetensors file, or cut short"),
    "empty": (_cut(0.0), "not a safetensors file, or cut short"),
    "absent": (lambda p: p.unlink(), "no such file"),
    "missing tensor": (_tensor("in_mean", None), "tensor in_mean has shape none"),
    "other shape": (_tensor("in_mean", lambda x: x[:-1]), "expected \\(60,\\)"),
    "nan": (_tensor("net.dense.weight", _spoiled(float("nan"))), "values that are not finite"),
    "inf": (_tensor("in_deviation", _spoiled(float("inf"))), "values that are not finite"),
    "input scaled by zero": (
        _tensor("in_deviation", _spoiled(0.0)), "in_deviation holds 0, expected deviations above zero"),
    "output scaled by zero": (_tensor("out_deviation", _set(0.0)), "out_deviation holds 0"),
    "a negative scale": (_tensor("deviation_scale", _spoiled(-1.0)), "deviation_scale holds -1"),
    "a negative deviation": (_tensor("deviation_rad", _spoiled(-0.2)), r"deviation_rad holds -0\.2"),
    "a negative variance": (
        _tensor("error_covariance", _entry(3, 3, -1.0)), "a matrix with the eigenvalue -1, expected"),
    "a covariance beyond 1": (
        _tensor("error_covariance", lambda C: _entry(1, 0, 0.09)(_entry(0, 1, 0.09)(C))),
        r"eigenvalue -0\.05, expected covariances"),
    "a covariance of one side": (
        _tensor("error_covariance", _entry(0, 1, 0.01)), "a matrix that is not symmetric"),
    "integers": (_tensor("in_mean", lambda x: x.long()), "holds torch.int64"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_what_does_not_fit_is_refused(path: Path, case: str) -> None:
    damage, said = BROKEN[case]
    damage(path)
    with pytest.raises(CheckpointError, match=said) as caught:
        checkpoint.load(path)
    text = str(caught.value)
    assert "\n" not in text and path.stem in text and len(text) - len(str(path)) < 300


def test_a_covariance_of_one_combination_is_looked_at(tmp_path: Path) -> None:
    model, where = small("imuposer"), tmp_path / "w.safetensors"
    model.error_covariance[7, 0, 0] = -0.1
    checkpoint.save(model, where, {})
    with pytest.raises(CheckpointError, match=r"error_covariance holds .* eigenvalue -0\.1"):
        checkpoint.load(where)


def test_covariances_to_single_precision_pass(tmp_path: Path) -> None:
    """Of rank one: 71 eigenvalues are zero but for rounding, which puts some of them below it."""
    model, where = small(), tmp_path / "w.safetensors"
    e = torch.randn(72)
    model.error_covariance.copy_(torch.outer(e, e))
    assert torch.linalg.eigvalsh(model.error_covariance)[0] < 0
    checkpoint.save(model, where, {})
    checkpoint.load(where)


def test_a_wrong_width_is_refused_before_the_network_is_made(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """8192 units would take 11 GB, for a description of 2 kB."""
    _config(hidden=8192)(path)
    built = []

    def watched(config: Config) -> Model:
        model = build(config)
        built.append({x.device.type for x in model.state_dict().values()})
        return model

    monkeypatch.setattr(checkpoint, "build", watched)
    with pytest.raises(CheckpointError, match=r"expected \(8192,\)"):
        checkpoint.load(path)
    assert built == [{"meta"}]


@pytest.mark.parametrize("network", NETWORKS)
def test_the_shipped_weights_load(network: str) -> None:
    assert checkpoint.load(checkpoint.shipped(network), network).config.network == network


def test_weights_of_the_other_network_are_refused(path: Path) -> None:
    with pytest.raises(CheckpointError, match="weights of dip, expected imuposer"):
        checkpoint.load(path, "imuposer")


class Evil:
    """Unpickled, it would write a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return Path.write_text, (self.target, "executed")


@pytest.mark.parametrize("write", [pickle.dump, torch.save])
def test_a_pickle_in_place_of_the_weights_runs_nothing(
    path: Path, tmp_path: Path, write: Callable[..., None]
) -> None:
    with path.open("wb") as f:
        write(Evil(tmp_path / "executed"), f)
    with pytest.raises(CheckpointError, match="not a safetensors file"):
        checkpoint.load(path)
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize("network", ["dip", "imuposer"])
def test_the_first_thing_a_process_does_may_be_to_load(network: str) -> None:
    """Constants of a network's module hold numbers, whoever imports it first."""
    code = (
        "import torch\n"
        "from learned import checkpoint\n"
        f"checkpoint.load(checkpoint.shipped({network!r}))\n"
        "import sys\n"
        "for name, module in list(sys.modules.items()):\n"
        "    if name.startswith('learned'):\n"
        "        for key, value in vars(module).items():\n"
        "            assert not (isinstance(value, torch.Tensor) and value.is_meta), (name, key)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
