"""What networks say of their own errors, against the errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from learned.dip.network import Gaussian
from learned.features import COMBINATIONS, DIP_JOINTS
from learned.models import build, for_network
from learned.training import deviations
from learned.training import validation as val
from mocap import orientation as ori
from mocap.motion import Motion
from mocap.skeleton import MIRROR, Skeleton
from tests.learned.swing import dip, validation, wavy

MOTION = wavy(80)


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
    deviations.calibrate(model, windows)
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
    deviations.calibrate(model, windows)
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
    found = deviations.mirrored(torch.tensor(error)).numpy()
    np.testing.assert_allclose(ori.log(np.swapaxes(a, -1, -2) @ b), found, atol=1e-12)


def test_covariance_counts_every_clip_the_same_and_can_be_inverted() -> None:
    rng = np.random.default_rng(1)
    clip = np.array([0] * 30 + [1] * 10)
    error = torch.tensor(
        rng.normal(size=(40, 24, 3)) * np.where(clip == 0, 0.1, 0.4)[:, None, None]
    )
    error[:, 10] = 0  # a joint that never errs
    w = deviations.clip_weights(clip)
    assert float(w.sum()) == pytest.approx(1)
    C = deviations.covariance(error, w)
    e = error.reshape(40, 72).numpy()
    expected = (e[:30].T @ e[:30] / 30 + e[30:].T @ e[30:] / 10) / 2
    np.testing.assert_allclose(C, expected, atol=1e-12)
    assert np.linalg.eigvalsh(deviations.shrunk(C).numpy())[0] > 1e-5


@pytest.mark.parametrize("network", ["dip", "imuposer"])
def test_half_of_a_covariance_is_of_what_was_learnt(network: str) -> None:
    """Scaled to the other half's trace; the deviations stay those of the validation errors."""

    def fitted(*sets: val.Windowed) -> val.Model:
        torch.manual_seed(0)
        model = build(for_network(network, hidden=8)).eval()
        deviations.calibrate(model, *sets)
        return model

    held, seen = validation(MOTION, network, 1), validation(wavy(60, seed=5), network, 1)
    alone, other, both = fitted(held), fitted(seen), fitted(held, seen)
    assert torch.equal(both.deviation_rad, alone.deviation_rad)
    # Shrinking towards the diagonal keeps the diagonal, so the traces are those before it.
    a, b = (m.error_covariance.reshape(-1, 72, 72) for m in (alone, other))
    trace = [x.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None] for x in (a, b)]
    expected = (a + b * trace[0] / trace[1]) / 2
    found = both.error_covariance.reshape(-1, 72, 72)
    assert float((found - expected).abs().max()) < 2e-3 * float(expected.abs().max())
    assert float((found - a).abs().max()) > 0.02 * float(a.abs().max())
