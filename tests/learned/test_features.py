"""What goes into the networks and comes out: both ways, and what must not matter."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from learned.config import Normalisation
from learned.dip import features as dip
from learned.features import DEVIATION_FLOOR, Scaler, project
from learned.imuposer import features as imuposer
from learned.imuposer.specification import COMBINATIONS
from learned.tree import rot_y
from mocap import orientation as ori
from mocap.evaluation.metrics import DIP_JOINTS

T, ROOT = 12, 5


@pytest.fixture
def six(rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    R = torch.as_tensor(ori.exp(rng.normal(size=(2, T, 6, 3))))
    return R, torch.as_tensor(rng.normal(size=(2, T, 6, 3)) * 5)


@pytest.fixture
def five(six: tuple[torch.Tensor, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    return six[0][:, :, :5], six[1][:, :, :5]


def test_scaler_both_ways(rng: np.random.Generator) -> None:
    x = torch.as_tensor(rng.normal(size=(50, 8, 4)) * [1, 10, 0.1, 0] + [0, 5, 1, 3]).float()
    scaler = Scaler.fit(x)
    y = scaler.scale(x)
    torch.testing.assert_close(y.mean((0, 1)), torch.zeros(4), rtol=0, atol=1e-4)
    torch.testing.assert_close(y.std((0, 1))[:3], torch.ones(3), rtol=0, atol=2e-3)
    torch.testing.assert_close(scaler.unscale(y), x)
    assert torch.equal(scaler.deviation[3], torch.tensor(DEVIATION_FLOOR))  # constant


def test_dip_input_is_equations_9_and_10(six: tuple[torch.Tensor, torch.Tensor]) -> None:
    R, acc = six
    x = dip.dip_input(R, acc)
    for s in range(5):
        R_rel = R[1, 3, ROOT].T @ R[1, 3, s]
        a_rel = R[1, 3, ROOT].T @ (acc[1, 3, s] - acc[1, 3, ROOT])
        torch.testing.assert_close(x[1, 3, 9 * s : 9 * s + 9], R_rel.flatten())
        torch.testing.assert_close(x[1, 3, 45 + 3 * s : 48 + 3 * s], a_rel)


@pytest.mark.parametrize("normalisation", ["root", "first", "heading"])
def test_a_turn_about_gravity_changes_nothing_for_dip(
    six: tuple[torch.Tensor, torch.Tensor], normalisation: Normalisation
) -> None:
    """Appendix C's normalisations too: each removes the heading of the whole window."""
    R, acc = six
    Ry = rot_y(torch.tensor(1.1, dtype=torch.float64))
    turned = dip.dip_input(Ry @ R, acc @ Ry.T, normalisation)
    torch.testing.assert_close(turned, dip.dip_input(R, acc, normalisation))


def test_first_and_heading_are_what_they_say(six: tuple[torch.Tensor, torch.Tensor]) -> None:
    R, acc = six
    first = dip.dip_input(R, acc, "first")
    torch.testing.assert_close(first[:, 0, 45:54].unflatten(-1, (3, 3)),
                               torch.eye(3, dtype=torch.float64).expand(2, 3, 3))  # fmt: skip
    x = dip.dip_input(R, acc, "heading")
    yaw = ori.heading(R[1, 4, ROOT].numpy())
    Ry = torch.as_tensor(ori.rot_y(-yaw))
    torch.testing.assert_close(x[1, 4, 45:54], (Ry @ R[1, 4, ROOT]).flatten())
    torch.testing.assert_close(x[1, 4, 54:57], Ry @ (acc[1, 4, 0] - acc[1, 4, ROOT]))
    torch.testing.assert_close(x[1, 4, 69:72], Ry @ acc[1, 4, ROOT])


def test_dip_target_and_pose_are_inverse(rng: np.random.Generator) -> None:
    R = torch.as_tensor(ori.exp(rng.normal(size=(3, 24, 3))))
    back = dip.dip_pose(dip.dip_target(R), R[:, 0])
    kept = [0, *DIP_JOINTS]
    torch.testing.assert_close(back[:, kept], R[:, kept])
    others = [j for j in range(24) if j not in kept]
    assert torch.equal(back[:, others], torch.eye(3, dtype=R.dtype).expand(3, len(others), 3, 3))


def test_projection_is_the_numpy_one(rng: np.random.Generator) -> None:
    M = rng.normal(size=(40, 3, 3))  # half of them with a negative determinant
    found = project(torch.as_tensor(M)).numpy()
    np.testing.assert_allclose(found, ori.project(M), atol=1e-9)


def test_imuposer_target_and_pose_are_inverse(rng: np.random.Generator) -> None:
    R = torch.as_tensor(ori.exp(rng.normal(size=(3, 24, 3))))
    torch.testing.assert_close(imuposer.imuposer_pose(imuposer.imuposer_target(R)), R)


def test_the_24_combinations() -> None:
    """All subsets of one to three of the five except both pockets with the head."""
    subsets = [c for n in (1, 2, 3) for c in itertools.combinations(range(5), n)]
    assert set(COMBINATIONS) == set(subsets) - {(2, 3, 4)}
    assert len(COMBINATIONS) == 24


@pytest.mark.parametrize("length", [1, 2, 3, 5, 12])
def test_smoothing_against_a_loop(rng: np.random.Generator, length: int) -> None:
    acc = rng.normal(size=(2, length, 5, 3))
    found = imuposer.smooth(torch.as_tensor(acc)).numpy()
    for t in range(length):
        want = acc[:, max(0, t - 2) : t + 3].mean(axis=1)
        np.testing.assert_allclose(found[:, t], want, atol=1e-12)


def test_imuposer_input_layout(five: tuple[torch.Tensor, torch.Tensor]) -> None:
    R, acc = five
    x = imuposer.imuposer_input(R, acc, torch.ones(2, 5, dtype=torch.bool))
    torch.testing.assert_close(x[..., :15], imuposer.smooth(acc).flatten(-2) / 30)
    torch.testing.assert_close(x[..., 15:], R.flatten(-3))


@pytest.mark.parametrize("rubbish", [1e6, float("nan"), float("inf")])
def test_what_a_device_not_worn_holds_has_no_influence(
    five: tuple[torch.Tensor, torch.Tensor], rubbish: float
) -> None:
    R, acc = five
    for combination in COMBINATIONS:
        worn = torch.zeros(2, 5, dtype=torch.bool)
        worn[:, list(combination)] = True
        clean = imuposer.imuposer_input(R, acc, worn)
        R2, acc2 = R.clone(), acc.clone()
        R2[:, :, ~worn[0]] = rubbish
        acc2[:, :, ~worn[0]] = rubbish
        assert torch.equal(imuposer.imuposer_input(R2, acc2, worn), clean)
        absent = [3 * s + k for s in range(5) if s not in combination for k in range(3)]
        assert (clean[..., absent] == 0).all()


def test_a_device_that_comes_in_mid_window(five: tuple[torch.Tensor, torch.Tensor]) -> None:
    """Its mean goes over the frames it was worn; before that it is blank, whatever it held."""
    R, acc = five[0], five[1].clone()
    worn = torch.ones(2, T, 5, dtype=torch.bool)
    worn[:, :6, 1] = False
    acc[:, :6, 1] = float("nan")
    x = imuposer.imuposer_input(R, acc, worn)
    assert (x[:, :6, 3:6] == 0).all() and torch.isfinite(x).all()
    torch.testing.assert_close(x[:, 6, 3:6], acc[:, 6:9, 1].mean(1) / 30)
    torch.testing.assert_close(x[:, 9, 3:6], acc[:, 7:12, 1].mean(1) / 30)
