"""Windows as the online runner sees them, their figures, and deviations fitted to errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from learned import validation as val
from learned.features import COMBINATIONS, DIP_JOINTS
from learned.models import build, for_network
from learned.networks.dip import Gaussian
from mocap import metrics, synthesis
from mocap import orientation as ori
from mocap import sensors as places
from mocap.motion import Motion
from mocap.skeleton import MIRROR, Skeleton
from tests.learned.swing import validation, wavy

MOTION = wavy(80)


def dip(**config: object) -> val.Dip:
    torch.manual_seed(0)
    model = build(for_network("dip", hidden=8, **config)).eval()
    assert isinstance(model, val.Dip)
    return model


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
    worn = val.worn_in_turn(23, 26)
    assert worn[0].nonzero().flatten().tolist() == list(COMBINATIONS[23])
    assert worn[1].nonzero().flatten().tolist() == list(COMBINATIONS[0])
    assert torch.equal(worn[1], worn[25])


def test_pose_deviation_against_monte_carlo() -> None:
    """Noise on the 135 numbers, projected: its spread in the tangent is what the formula says."""
    model = dip()
    rng = np.random.default_rng(4)
    R = torch.tensor(ori.exp(rng.normal(size=(24, 3)))).float()
    sigma = torch.tensor(rng.uniform(0.002, 0.02, size=135)).float()
    model.out_deviation.copy_(torch.tensor(rng.uniform(0.5, 2, size=135)).float())
    flat = R[list(DIP_JOINTS)].flatten()
    out = Gaussian(flat, sigma / model.out_deviation, torch.zeros(15), torch.ones(15))
    predicted = model.pose_deviation(out, R)
    noise = torch.tensor(rng.normal(size=(20_000, 135))).float() * sigma
    noisy = model.pose(
        Gaussian((flat + noise) / model.out_deviation, sigma, out.acc, out.acc_deviation), R[0]
    )
    w = ori.log((R.mT @ noisy).double().numpy())[:, list(DIP_JOINTS)]
    np.testing.assert_allclose(w.std(axis=0), predicted[list(DIP_JOINTS)], rtol=0.03)


def test_calibrated_deviations_have_unit_variance() -> None:
    model, windows = dip(), validation(MOTION, stride=2)
    windows = replace(windows, R_parent_joint=windows.R_parent_joint.clone())
    val.calibrate_deviations(model, windows)
    t = windows.emit
    with torch.no_grad():
        out = model(model.inputs(windows.R_world_bone, windows.acc_world)[0])
        at = Gaussian(
            *(v[:, t] for v in (out.pose, out.pose_deviation, out.acc, out.acc_deviation))
        )
        pose = model.pose(at, windows.R_world_bone[:, t, 5])
        spread = model.pose_deviation(at, pose)
    error = ori.log((pose.mT @ windows.R_parent_joint[:, t]).double().numpy())
    z = error / spread.numpy()
    predicted = list(DIP_JOINTS)
    np.testing.assert_allclose(np.sqrt((z[:, predicted] ** 2).mean(axis=(0, 2))), 1, rtol=1e-3)
    rest = [j for j in range(24) if j not in predicted and j != 0]
    np.testing.assert_allclose(
        np.sqrt((z[:, rest] ** 2).mean(axis=0)), np.ones((len(rest), 3)), rtol=2e-2
    )


def test_imuposer_deviations_are_its_errors_by_combination() -> None:
    """An error counts for its combination and, mirrored, for the mirrored one."""
    torch.manual_seed(0)
    model = build(for_network("imuposer", hidden=8)).eval()
    windows = validation(MOTION, "imuposer", 1)
    val.calibrate_deviations(model, windows)
    truth = windows.R_parent_joint[:, windows.emit].double()

    def errors(devices: list[int]) -> np.ndarray:
        worn = torch.zeros(len(windows.clip), 5, dtype=torch.bool)
        worn[:, devices] = True
        with torch.no_grad():
            y = model(val.imuposer_input(windows.R_world_bone, windows.acc_world, worn))
        return ori.log((val.imuposer_pose(y[:, windows.emit]).double().mT @ truth).numpy())

    own, twin = errors([1, 3]), errors([0, 2])
    other = twin[:, list(MIRROR)] * [1, -1, -1]
    both = np.concatenate([own, other]).reshape(-1, 72)
    C = both.T @ both / len(both)
    k = COMBINATIONS.index((1, 3))
    np.testing.assert_allclose(model.deviation_rad[k].flatten(), np.sqrt(np.diag(C)), rtol=1e-4)
    expected = 0.9 * C + 0.1 * np.diag(np.diag(C))
    np.testing.assert_allclose(model.error_covariance[k], expected, atol=1e-5)
    assert not torch.allclose(model.deviation_rad[k], model.deviation_rad[0])


def test_mirrored_errors_are_errors_of_the_mirrored_motion() -> None:
    rng = np.random.default_rng(0)
    R, error = ori.exp(rng.normal(size=(1, 24, 3))), 0.3 * rng.normal(size=(1, 24, 3))
    body, root = Skeleton.default(), np.zeros((1, 3))
    a = Motion(60, R, root, body).mirrored().R_parent_joint
    b = Motion(60, R @ ori.exp(error), root, body).mirrored().R_parent_joint
    found = val.mirrored(torch.tensor(error)).numpy()
    np.testing.assert_allclose(ori.log(np.swapaxes(a, -1, -2) @ b), found, atol=1e-12)


def test_covariance_counts_every_clip_the_same_and_can_be_inverted() -> None:
    rng = np.random.default_rng(1)
    clip = np.array([0] * 30 + [1] * 10)
    error = torch.tensor(
        rng.normal(size=(40, 24, 3)) * np.where(clip == 0, 0.1, 0.4)[:, None, None]
    )
    error[:, 10] = 0  # a joint that never errs
    w = val.clip_weights(clip)
    assert float(w.sum()) == pytest.approx(1)
    C = val.covariance(error, w)
    e = error.reshape(40, 72).numpy()
    expected = (e[:30].T @ e[:30] / 30 + e[30:].T @ e[30:] / 10) / 2
    np.testing.assert_allclose(C, expected, atol=1e-12)
    assert np.linalg.eigvalsh(val.shrunk(C).numpy())[0] > 1e-5


def test_sensor_sets_match_the_networks() -> None:
    assert validation(MOTION, "imuposer").acc_world.shape[2] == len(places.FIVE)
