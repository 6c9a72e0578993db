"""Windows as the online runner sees them, and their figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from learned import devices
from learned.features import COMBINATIONS
from learned.models import build, for_network
from learned.training import validation as val
from mocap import sensors as places
from mocap import synthesis
from mocap.evaluation import metrics
from mocap.motion import Motion
from tests.learned.swing import dip, validation, wavy

MOTION = wavy(80)


def test_figures_are_those_of_mocap_metrics() -> None:
    """Two clips of different lengths, every frame: mean over frames, then over clips."""
    clips = [MOTION, wavy(50, seed=3)]
    windows = val.cut([synthesis.recording(m) for m in clips], 2, 1)
    guess = wavy(130, seed=9).R_parent_joint
    found = val.figures(torch.tensor(guess).float(), windows)
    each, at = [], 0
    for m in clips:
        part = Motion(60.0, guess[at : at + len(m)], m.p_world_root, m.skeleton)
        each.append(metrics.evaluate(part, m))
        at += len(m)
    mean = metrics.mean_over(each)
    for name in ("sip_deg", "angular_deg", "position_cm"):
        assert found[name] == pytest.approx(getattr(mean, name), rel=1e-4), name


def test_lost_samples_hold_the_last_valid_one() -> None:
    rec = synthesis.recording(MOTION)
    valid = np.array(rec.valid)
    valid[:4, 1] = False
    valid[10:15, 2] = False
    rec = replace(rec, valid=valid)
    R, acc = val.held(rec)
    np.testing.assert_array_equal(R[10:15, 2], np.repeat(rec.R_world_bone[9:10, 2], 5, axis=0))
    np.testing.assert_array_equal(acc[10:15, 2], np.repeat(rec.acc_world[9:10, 2], 5, axis=0))
    # Before a sensor's first value: that value.
    np.testing.assert_array_equal(R[:4, 1], np.repeat(rec.R_world_bone[4:5, 1], 4, axis=0))
    np.testing.assert_array_equal(acc[:4, 1], np.repeat(rec.acc_world[4:5, 1], 4, axis=0))
    assert np.isfinite(R).all() and np.isfinite(acc).all()


def test_cut_repeats_the_ends() -> None:
    rec = synthesis.recording(MOTION)
    windows = val.cut([rec], 20, 5, stride=7)
    assert windows.emit == 20 and windows.R_world_bone.shape[:2] == (12, 26)
    R = torch.tensor(val.held(rec)[0]).float()
    first = windows.R_world_bone[0]
    assert torch.equal(first[:21], R[:1].expand(21, 6, 3, 3)) and torch.equal(first[25], R[5])
    last = windows.R_world_bone[11]  # around frame 77 of 80
    assert torch.equal(last[20], R[77]) and torch.equal(last[23:], R[79:].expand(3, 6, 3, 3))


@pytest.mark.parametrize("network", ["dip", "imuposer"])
def test_prediction_does_not_depend_on_the_chunks(
    network: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    model = build(for_network(network, hidden=8)).eval()
    windows = validation(MOTION, network, 1)
    poses, loss = val.predict(model, windows)
    monkeypatch.setattr(val, "CHUNK", 24)
    poses2, loss2 = val.predict(model, windows)
    torch.testing.assert_close(poses2, poses, rtol=0, atol=1e-5)
    assert loss2 == pytest.approx(loss, rel=1e-5)


def test_the_loss_without_reconstruction_ignores_the_acceleration_heads() -> None:
    model, windows = dip(), validation(MOTION)
    before = val.score(model, windows, reconstruct_acc=False)["loss"]
    with torch.no_grad():
        model.net.heads.acc.bias.add_(5.0)  # type: ignore[union-attr]
    assert val.score(model, windows, reconstruct_acc=False)["loss"] == before
    assert val.score(model, windows)["loss"] != pytest.approx(before)


def test_combinations_go_round() -> None:
    worn = devices.in_turn(23, torch.ones(26, 5, dtype=torch.bool))
    assert worn[0].nonzero().flatten().tolist() == list(COMBINATIONS[23])
    assert worn[1].nonzero().flatten().tolist() == list(COMBINATIONS[0])
    assert torch.equal(worn[1], worn[25])


def test_sensor_sets_match_the_networks() -> None:
    assert validation(MOTION, "imuposer").acc_world.shape[2] == len(places.FIVE)
