"""The trainer: it learns, it can be killed anywhere, and it refuses what cannot be gone on with."""

from __future__ import annotations

import json
import math
import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learned import checkpoint
from learned.errors import CheckpointError, TrainingError
from learned.features import DIP_JOINTS
from learned.kinematics import angle_between
from learned.models import ARCHITECTURES, Architecture, Dip, Model, build, for_network
from learned.training import trainer as module
from learned.training.parallel import World
from learned.training.run_folder import Identity, RunFolder
from learned.training.trainer import Trainer, pose_error
from learned.training.validation import score
from mocap.errors import PoserError
from tests.learned.swing import tiny, trainer, validation, wavy, windows

NETWORKS = ("dip", "imuposer")


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_SCALER_BATCHES", 1)


def weights(t: Trainer) -> dict[str, torch.Tensor]:
    """Every tensor that a run leaves behind: the model, its running mean."""
    both = {f"model.{k}": v for k, v in t.model.state_dict().items()}
    return both | {f"average.{k}": v for k, v in t.average.state_dict().items()}


def equal(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> None:
    assert a.keys() == b.keys()
    for name in a:
        assert torch.equal(a[name], b[name]), name


def log(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(x) for x in (folder / "log.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("network", NETWORKS)
def test_a_run_leaves_weights_a_state_and_a_log(tmp_path: Path, network: str) -> None:
    told: list[dict[str, Any]] = []
    t = trainer(tmp_path, tiny(network))
    path = t.run(told.append)
    assert [row["step"] for row in log(tmp_path)] == [5, 10, 12]
    assert {"validation_sip_deg", "validation_loss", "rate"} < log(tmp_path)[0].keys()
    assert [r["step"] for r in told if "validation_loss" in r] == [5, 10, 12]
    best = checkpoint.load(path, network)
    record = checkpoint.describe(path)
    found = pose_error(score(best, t.validation))
    least = min(pose_error(r, "validation_") for r in log(tmp_path))
    assert found == pytest.approx(least, rel=1e-5)
    assert pose_error(record["validation"], "validation_") == pytest.approx(found, rel=1e-5)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "best.json", "best.safetensors", "log.jsonl", "state.pt",
    ]  # fmt: skip


@pytest.mark.parametrize(("network", "kill_at"), [("dip", 3), ("dip", 5), ("imuposer", 7)])
def test_killed_and_resumed_is_uninterrupted(
    tmp_path: Path, network: str, kill_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed after any step, the state saved at some step before: the same weights, log and best."""
    whole = trainer(tmp_path / "whole", tiny(network))
    whole.run()
    monkeypatch.setattr(module, "SAVE_EVERY_S", 0.0)
    killed = trainer(tmp_path / "killed", tiny(network))
    one = killed._one

    def dying() -> float:
        if killed.step == kill_at:
            raise SystemExit  # nothing is saved any more, as by a signal that cannot be caught
        return one()

    monkeypatch.setattr(killed, "_one", dying)
    with pytest.raises(SystemExit):
        killed.run()
    resumed = trainer(tmp_path / "killed", tiny(network))
    assert resumed.step == kill_at
    resumed.run()
    equal(weights(resumed), weights(whole))
    drop = ("seconds",)
    rows = [[{k: v for k, v in r.items() if k not in drop} for r in log(tmp_path / name)]
            for name in ("whole", "killed")]  # fmt: skip
    assert rows[0] == rows[1]
    a, b = ((tmp_path / name / "best.safetensors").read_bytes() for name in ("whole", "killed"))
    assert a == b


def test_killed_between_validation_and_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The log has a line that the state does not know of: it is not written twice."""
    whole = trainer(tmp_path / "whole")
    whole.run()
    folder = tmp_path / "killed"
    killed = trainer(folder)
    save = killed._save

    def dying() -> None:
        if killed.validated == 5:
            raise SystemExit
        save()

    monkeypatch.setattr(killed, "_save", dying)
    with pytest.raises(SystemExit):
        killed.run()
    assert [r["step"] for r in log(folder)] == [5]
    with (folder / "log.jsonl").open("a") as f:
        f.write('{"step": 6, "trunc')  # and a line of which half was written
    resumed = trainer(folder)
    assert resumed.step == 1  # what is saved early
    resumed.run()
    assert [r["step"] for r in log(folder)] == [5, 10, 12]
    equal(weights(resumed), weights(whole))


@pytest.mark.parametrize(("kill_at", "saved"), [(3, 1), (5, 5), (7, 5), (11, 10)])
def test_killed_in_the_first_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kill_at: int, saved: int
) -> None:
    """A state is there from the first step on, and after every validation: log and best are not lost."""
    killed = trainer(tmp_path)
    one = killed._one

    def dying() -> float:
        if killed.step == kill_at:
            raise SystemExit
        return one()

    monkeypatch.setattr(killed, "_one", dying)
    with pytest.raises(SystemExit):
        killed.run()
    resumed = trainer(tmp_path)
    assert (resumed.step, resumed.earlier) == (saved, [])
    resumed.run()
    assert [r["step"] for r in log(tmp_path)] == [5, 10, 12]


@pytest.mark.parametrize("where", ["step", "validation"])
def test_ctrl_c_saves_a_whole_step(
    tmp_path: Path, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real signal in the middle of a step or of a validation: resumed as if it had not been."""
    whole = trainer(tmp_path / "whole")
    whole.run()
    stopped = trainer(tmp_path / "stopped")
    if where == "step":
        loss = stopped._loss

        def interrupted(batch: Any) -> torch.Tensor:
            if stopped.step == 6:
                os.kill(os.getpid(), signal.SIGINT)
            return loss(batch)

        monkeypatch.setattr(stopped, "_loss", interrupted)
    else:
        monkeypatch.setattr(
            module, "score", lambda *a: os.kill(os.getpid(), signal.SIGINT) or score(*a)
        )
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        stopped.run()
    assert signal.getsignal(signal.SIGINT) is before
    monkeypatch.undo()
    resumed = trainer(tmp_path / "stopped")
    assert resumed.step == (7 if where == "step" else 5)
    resumed.run()
    equal(weights(resumed), weights(whole))
    assert [r["step"] for r in log(tmp_path / "stopped")] == [5, 10, 12]


def test_a_finished_run_is_left_alone_and_can_be_prolonged(tmp_path: Path) -> None:
    trainer(tmp_path).run()
    again = trainer(tmp_path)
    again.run()
    assert again.step == 12 and len(log(tmp_path)) == 3
    longer = trainer(tmp_path, tiny(steps=14))
    longer.run()
    assert [r["step"] for r in log(tmp_path)] == [5, 10, 12, 14]


def test_other_settings_or_other_motions_are_refused(tmp_path: Path) -> None:
    trainer(tmp_path, data="a").run()
    with pytest.raises(TrainingError, match="holds a run with other settings"):
        trainer(tmp_path, tiny(batch=4), data="a")
    with pytest.raises(TrainingError, match="holds a run with other settings"):
        trainer(tmp_path, tiny(config={"hidden": 9}), data="a")
    with pytest.raises(TrainingError, match="holds a run on other motions"):
        trainer(tmp_path, data="b")


def test_other_windows_to_validate_on_are_refused(tmp_path: Path) -> None:
    """Its best weights and its patience would be compared with figures of other motions."""
    settings, source = tiny(), windows(wavy(), "dip", tiny().frames)
    mine, other = (validation(wavy(seed=k), "dip", 30) for k in (0, 1))
    Trainer(settings, source, mine, tmp_path).run()
    first = replace(other, R_parent_joint=mine.R_parent_joint, acc_world=mine.acc_world)
    for wrong in (other, first, mine.only(torch.arange(len(mine.clip)) > 0)):
        with pytest.raises(TrainingError, match="holds a run that was validated on other motions"):
            Trainer(settings, source, wrong, tmp_path)
    # As another processor may round them.
    rounded = replace(mine, acc_world=mine.acc_world * (1 + 1e-7))
    assert Trainer(settings, source, rounded, tmp_path).step == 12
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    del state["validation"]  # an earlier version wrote none
    torch.save(state, tmp_path / "state.pt")
    t = Trainer(tiny(steps=13), source, other, tmp_path)
    t.run()
    assert t.step == 13
    with pytest.raises(TrainingError, match="validated on other motions"):
        Trainer(settings, source, mine, tmp_path)


@pytest.mark.parametrize("keep", [0.0, 0.5])
def test_a_damaged_state_is_refused(tmp_path: Path, keep: float) -> None:
    trainer(tmp_path).run()
    state = tmp_path / "state.pt"
    state.write_bytes(state.read_bytes()[: int(keep * state.stat().st_size)])
    with pytest.raises(TrainingError, match="cannot be resumed from") as caught:
        trainer(tmp_path)
    assert "\n" not in str(caught.value)


class _Evil:
    """Unpickled, it makes a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


def test_a_state_that_would_run_code_is_refused(tmp_path: Path) -> None:
    """In one sentence of ours, and nothing runs."""
    trainer(tmp_path / "run").run()
    state = torch.load(tmp_path / "run" / "state.pt", weights_only=True)
    evil = state | {"step": _Evil(tmp_path / "made")}
    torch.save(evil, tmp_path / "run" / "state.pt")
    with pytest.raises(TrainingError) as caught:
        trainer(tmp_path / "run")
    said = str(caught.value)
    assert said.endswith("state.pt: cannot be resumed from; it is damaged, or holds more than tensors "
                         "and is not loaded")  # fmt: skip
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("lacks", ["step", "numpy", "torch", "model", "settings"])
def test_a_state_that_lacks_something_is_refused(tmp_path: Path, lacks: str) -> None:
    trainer(tmp_path).run()
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    del state[lacks]
    torch.save(state, tmp_path / "state.pt")
    with pytest.raises(TrainingError, match="damaged, or no state of a run"):
        trainer(tmp_path)


def test_a_loss_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    t = trainer(tmp_path)
    with torch.no_grad():
        next(t.model.parameters()).fill_(math.nan)
    with pytest.raises(TrainingError, match="the loss is not finite at step 0") as caught:
        t.run()
    assert isinstance(caught.value, PoserError)
    assert list(tmp_path.iterdir()) == []  # no state that could not be gone on with


def test_patience_stops_early(tmp_path: Path) -> None:
    t = trainer(tmp_path, tiny(steps=60, every=1, patience=2, learning_rate=1e-12, average=0.0))
    t.best = -math.inf  # nothing can be better
    t.run()
    assert t.step == 2 and t.stale()


def figures(loss: float, degrees: float, cm: float) -> dict[str, float]:
    return {"loss": loss, "sip_deg": degrees, "angular_deg": degrees, "position_cm": cm}


SCRIPT = [figures(0.2, 30.0, 9.0), figures(0.1, 28.0, 8.0), figures(0.3, 24.0, 7.0)]
SCRIPT += [figures(0.4, 24.0, 7.5)] * 5
"""Losses that are least at the second validation, pose errors at the third."""


class Scripted:
    """In place of `score`: figures of a script. shown: the models' tensors at each call."""

    def __init__(self, degrees: list[float]) -> None:
        self.degrees, self.shown = iter(degrees), list[dict[str, torch.Tensor]]()

    def __call__(self, model: Model, *more: Any) -> dict[str, float]:
        self.shown.append({k: v.clone() for k, v in model.state_dict().items()})
        return figures(0.1, next(self.degrees), 0.0)


@pytest.mark.parametrize("last", ["best.safetensors", "best.json"])
@pytest.mark.parametrize(("often", "best"), [(False, 2), (True, 4)])
def test_killed_while_the_best_weights_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: str, often: bool, best: int
) -> None:
    """Done again, the validation of step 4 may find less (a GPU): weights and description agree all the
    same. Saved at step 2, the weights of then are there to be written again; saved at step 3 no more.
    """
    if often:
        monkeypatch.setattr(module, "SAVE_EVERY_S", 0.0)
    monkeypatch.setattr(module, "score", Scripted([30.0, 20.0]))
    killed, put = trainer(tmp_path, tiny(steps=4, every=2)), Path.replace

    def dying(aside: Path, target: Path) -> Path:
        found = put(aside, target)
        if killed.step == 4 and target.name == last:
            raise SystemExit
        return found

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", dying)
        with pytest.raises(SystemExit):
            killed.run()
    if last == "best.safetensors":
        with pytest.raises(CheckpointError, match=r"best\.json: no such file"):
            checkpoint.describe(tmp_path / "best.safetensors")
    again = Scripted([31.0] if often else [30.0, 31.0])
    monkeypatch.setattr(module, "score", again)
    resumed = trainer(tmp_path, tiny(steps=4, every=2))
    assert resumed.best == math.inf
    resumed.run()
    row = checkpoint.describe(tmp_path / "best.safetensors")["validation"]
    assert (row["step"], resumed.best_step) == (best, best)
    assert row["validation_angular_deg"] == resumed.best == (31.0 if often else 30.0)
    equal(checkpoint.load(tmp_path / "best.safetensors").state_dict(), again.shown[0])
    assert [r["step"] for r in log(tmp_path)] == [2, 4]
    assert (
        trainer(tmp_path, tiny(steps=4, every=2)).best == resumed.best
    )  # nothing is lost any more


GONE = [("best.safetensors",), ("best.json",), ("best.safetensors", "best.json")]


@pytest.mark.parametrize("gone", GONE)
def test_best_weights_that_were_removed_are_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gone: tuple[str, ...]
) -> None:
    """Of a run that was over, and of one that goes on: nothing else changes."""
    whole = trainer(tmp_path / "whole")
    whole.run()
    left = (tmp_path / "whole" / "best.safetensors").read_bytes()
    part = trainer(tmp_path / "part")
    # Interrupted right after its first validation.
    monkeypatch.setattr(part, "_verdict", lambda _: module._STOP if part.validated else module._GO)
    with pytest.raises(KeyboardInterrupt):
        part.run()
    for folder in (tmp_path / "whole", tmp_path / "part"):
        for name in gone:
            (folder / name).unlink()
        t = trainer(folder)
        assert t.best == math.inf
        t.run()
        equal(weights(t), weights(whole))
        assert left == (folder / "best.safetensors").read_bytes()
        row = checkpoint.describe(folder / "best.safetensors")["validation"]
        assert [r["step"] for r in log(folder)] == [5, 10, 12] and row == log(folder)[-1]


def test_a_run_that_patience_ended_stays_over_without_its_best_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left of it is validated again, and is the best that there is."""
    settings = tiny(steps=60, every=1, patience=2)
    monkeypatch.setattr(module, "score", Scripted([20.0, 21.0, 22.0]))
    trainer(tmp_path, settings).run()
    for path in tmp_path.glob("best.*"):
        path.unlink()
    monkeypatch.setattr(module, "score", Scripted([22.0]))
    again = trainer(tmp_path, settings)
    again.run()
    assert again.step == 3 and again.stale() and (again.best, again.best_step) == (22.0, 3)
    assert checkpoint.describe(tmp_path / "best.safetensors")["validation"] == log(tmp_path)[-1]
    assert len(log(tmp_path)) == 3


def test_the_best_weights_have_the_least_pose_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not the least loss; early stopping counts the validations without a lesser one."""
    script = iter(SCRIPT)
    monkeypatch.setattr(module, "score", lambda *a: next(script))
    t = trainer(tmp_path, tiny(steps=100, every=1, patience=2))
    t.run()
    assert checkpoint.describe(tmp_path / "best.safetensors")["validation"]["step"] == 3
    assert t.best == 31.0
    assert t.step == 5 and t.stale()


def test_a_state_of_an_earlier_version_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It chose by the loss and did not say how it began: the weights it chose are the ones to beat."""
    script = iter(SCRIPT)
    monkeypatch.setattr(module, "score", lambda *a: next(script))
    trainer(tmp_path, tiny(steps=2, every=1)).run()
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    state["best"] = 0.1  # the loss
    for name in ("best_error", "best_step", "start", "validation", "bfloat16"):
        del state[name]
    del state["model"]["error_covariance"], state["average"]["error_covariance"]
    torch.save(state, tmp_path / "state.pt")
    resumed = trainer(tmp_path, tiny(steps=4, every=1), start=build(tiny().config))
    assert (resumed.step, resumed.best) == (2, 36.0)
    resumed.run()
    assert checkpoint.describe(tmp_path / "best.safetensors")["validation"]["step"] == 3
    assert resumed.since_best == 1


def test_a_run_begun_with_other_weights_is_refused(tmp_path: Path) -> None:
    torch.manual_seed(3)
    start, other = build(tiny().config), build(tiny().config)
    trainer(tmp_path / "a", start=start).run()
    assert trainer(tmp_path / "a", start=start).step == 12
    for wrong in (other, None):
        with pytest.raises(TrainingError, match="holds a run that began with other weights"):
            trainer(tmp_path / "a", start=wrong)
    trainer(tmp_path / "b").run()
    with pytest.raises(TrainingError, match="holds a run that began with other weights"):
        trainer(tmp_path / "b", start=start)


def test_a_run_begun_anew_keeps_the_earlier_log_and_weights(tmp_path: Path) -> None:
    """Twice over: neither is lost, and the new log has the rows of the new run alone."""
    trainer(tmp_path).run()
    first = {n: (tmp_path / n).read_bytes() for n in ("log.jsonl", "best.safetensors", "best.json")}
    for k in (1, 2):
        (tmp_path / "state.pt").unlink()
        t = trainer(tmp_path, tiny(steps=5, seed=k))
        assert sorted(p.name for p in t.earlier) == sorted(f"{n}.{k}" for n in first)
        t.run()
        assert [row["step"] for row in log(tmp_path)] == [5]
    assert {n: (tmp_path / f"{n}.1").read_bytes() for n in first} == first
    assert trainer(tmp_path, tiny(steps=5, seed=2)).earlier == []


def test_a_state_is_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first step and after every validation; not again at the end."""
    written: list[int] = []
    write = RunFolder.write

    def counting(self: RunFolder, state: dict[str, Any], identity: Identity) -> None:
        written.append(state["step"])
        write(self, state, identity)

    monkeypatch.setattr(RunFolder, "write", counting)
    trainer(tmp_path).run()
    assert written == [1, 5, 10, 12]


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("acc", [True, False])
def test_every_weight_that_is_trained_has_a_gradient(
    tmp_path: Path, architecture: Architecture, acc: bool
) -> None:
    """Several processes wait for that of each (DistributedDataParallel)."""
    network = "imuposer" if architecture == "imuposer" else "dip"
    config = {"architecture": architecture}
    t = trainer(tmp_path, tiny(network, config, reconstruct_acc=acc))
    t._one()
    trained = {k: p for k, p in t.model.named_parameters() if p.requires_grad}
    assert [k for k, p in trained.items() if p.grad is None] == []
    fixed = {k.rsplit(".", 1)[0] for k, _ in t.model.named_parameters() if k not in trained}
    want = {"net.heads.acc", "net.heads.acc_deviation"} if network == "dip" and not acc else set()
    assert fixed == want | ({"net.residual.7"} if architecture == "wavenet" else set())


def test_minutes_stop_and_validate(tmp_path: Path) -> None:
    t = trainer(tmp_path, tiny(steps=None, minutes=1e-3))
    t.run()
    assert 0.06 <= t.seconds < 5
    assert log(tmp_path)[-1]["step"] == t.step


def test_switching_off_the_acceleration_loss(tmp_path: Path) -> None:
    t = trainer(tmp_path, tiny(reconstruct_acc=False))
    before = {k: v.clone() for k, v in t.model.state_dict().items()}
    t.run()
    after = t.model.state_dict()
    moved = {k for k in after if not torch.equal(after[k], before[k])}
    assert "net.heads.pose.weight" in moved
    assert not {k for k in moved if k.startswith("net.heads.acc")}


def test_switching_off_dropout(tmp_path: Path) -> None:
    """Without it the loss of a batch is a function of the weights alone."""
    for rate, repeats in ((0.0, True), (0.2, False)):
        t = trainer(tmp_path / str(rate), tiny(config={"dropout": rate}))
        batch = t.source.draw(np.random.default_rng(0), 3)
        assert torch.equal(t._loss(batch), t._loss(batch)) is repeats


def test_the_running_mean(tmp_path: Path) -> None:
    """average = 0 is the weights themselves; else a mean of all steps so far, the youngest ahead."""
    t = trainer(tmp_path / "a", tiny(average=0.0))
    t.run()
    for a, b in zip(t.average.parameters(), t.model.parameters(), strict=True):
        assert torch.equal(a, b)
    t = trainer(tmp_path / "b", tiny(average=0.999))
    want = [p.detach().clone() for p in t.model.parameters()]
    for step in range(1, 5):
        t._one()
        keep = (1 + step) / (10 + step)
        want = [keep * w + (1 - keep) * p for w, p in zip(want, t.model.parameters(), strict=True)]
    for a, b in zip(t.average.parameters(), want, strict=True):
        torch.testing.assert_close(a, b)


def test_a_start_keeps_its_scalers(tmp_path: Path) -> None:
    torch.manual_seed(3)
    start = build(for_network("dip", hidden=8))
    assert isinstance(start, Dip)
    start.in_mean.fill_(0.25)
    t = trainer(tmp_path, start=start)
    assert torch.equal(t.model.state_dict()["in_mean"], start.in_mean)
    t.run()
    assert not torch.equal(
        start.net.dense.weight,
        t.model.state_dict()["net.dense.weight"],  # type: ignore[union-attr]
    )


def test_bfloat16_trains_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "bfloat16_pays", lambda device, before: True)
    t = trainer(tmp_path, tiny(bfloat16=True))
    t.run()
    assert all(math.isfinite(r["training_loss"]) for r in log(tmp_path))
    assert t.precision == "bfloat16" == checkpoint.describe(t.files.best)["precision"]


def test_bfloat16_is_used_where_it_is_faster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Elsewhere the run is that of single precision."""
    monkeypatch.setattr(module, "bfloat16_pays", lambda device, before: False)
    plain = trainer(tmp_path / "a", tiny())
    plain.run()
    asked = trainer(tmp_path / "b", tiny(bfloat16=True))
    asked.run()
    equal(weights(plain), weights(asked))
    assert asked.precision == "float32" == checkpoint.describe(asked.files.best)["precision"]


def test_precision_may_change_on_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By option or machine; what was measured before is asked for again, over single precision between."""
    told: list[bool | None] = []
    monkeypatch.setattr(
        module, "bfloat16_pays", lambda device, before: told.append(before) or before is None
    )
    trainer(tmp_path, tiny(bfloat16=True)).run()
    other = trainer(tmp_path, tiny(steps=14))
    assert (other.step, other.precision, told) == (12, "float32", [None])
    other.run()
    again = trainer(tmp_path, tiny(steps=16, bfloat16=True))
    assert (again.step, again.precision, told) == (14, "float32", [None, True])
    again._save()
    trainer(tmp_path, tiny(steps=16, bfloat16=True))
    assert told == [None, True, False]


def test_a_process_with_other_settings_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its cooldown would end elsewhere. With the same it takes what the first has, but for the draws."""
    first = trainer(tmp_path / "a", tiny(steps=12))
    first.run()
    monkeypatch.setattr(
        World, "share", lambda self, value: first._state() | first.identity.to_state()
    )
    monkeypatch.setattr(World, "wrapped", lambda self, model: model)
    with pytest.raises(TrainingError, match="process 1 was given other settings than the first"):
        trainer(tmp_path / "b", tiny(steps=11), world=World(1, 2))
    other = trainer(tmp_path / "b", tiny(steps=12), world=World(1, 2))
    equal(weights(other), weights(first))
    assert (other.step, other.best) == (12, first.best)
    assert other.rng.bit_generator.state != first.rng.bit_generator.state


def test_the_generator_of_the_gpu_travels_with_the_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dropout is drawn there. (Without a GPU here: that torch is asked and told.)"""
    states = {"cuda:1": torch.tensor([1, 2, 3], dtype=torch.uint8)}
    monkeypatch.setattr(torch.cuda, "get_rng_state", lambda device: states[str(device)])
    gpu, cpu = torch.device("cuda:1"), torch.device("cpu")
    saved = module.generators(gpu)
    assert saved.keys() == {"torch", "cuda"} and module.generators(cpu).keys() == {"torch"}
    found: dict[str, torch.Tensor] = {}
    monkeypatch.setattr(
        torch.cuda, "set_rng_state", lambda x, device: found.update({str(device): x})
    )
    module.set_generators(cpu, saved)
    module.set_generators(gpu, module.generators(cpu))  # saved on a CPU
    assert found == {}
    module.set_generators(gpu, saved)
    assert found == states


def test_a_small_network_learns_one_clip_by_heart(tmp_path: Path) -> None:
    """Under 1 deg on 8 frames seen again and again (the full size: docs/training.md)."""
    motion = wavy(10, size=0.2)
    settings = tiny(
        config={"hidden": 32, "dropout": 0.0}, steps=200, batch=1, frames=8, every=200,
        learning_rate=1e-2, decay_steps=8, average=0.0,
    )  # fmt: skip
    source = windows(motion, "dip", 8)
    t = Trainer(settings, source, validation(motion, "dip", 4), tmp_path)
    t.run()
    batch = source.draw(np.random.default_rng(0), 1)
    model = t.model.eval()
    assert isinstance(model, Dip)
    with torch.no_grad():
        out = model(model.inputs(batch.R_world_bone, batch.acc_world)[0])
        pose = model.pose(out, batch.R_world_bone[:, :, 5])
    kept = list(DIP_JOINTS)
    angle = torch.rad2deg(angle_between(pose[:, :, kept], batch.R_parent_joint[:, :, kept]))
    assert float(angle.mean()) < 1.0
