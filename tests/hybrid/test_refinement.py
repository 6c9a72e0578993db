"""What the refinement takes from the network: its pose, smoothed, and the covariance of its errors."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid import Tracker
from hybrid.network_errors import NetworkErrors
from hybrid.refinement import Refinement, smoothed
from mocap import orientation as ori
from mocap import sensors as places
from mocap import synthesis
from mocap.estimator import Pose, Sample
from mocap.evaluation import metrics
from mocap.motion import Motion
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from tests.hybrid.fake import FakeNetwork, motion_of, run, single, tracked


def test_smoothing_follows_a_constant_rate_without_lag_and_takes_off_tremble() -> None:
    rng = np.random.default_rng(0)
    w, dt = np.array([[1.0, 0.3, -0.5]]), 1 / 60
    true = ori.exp(w * np.arange(400)[:, None] * dt)[:, None]
    tremble = 0.01 * rng.normal(size=(400, 1, 3))
    for noise in (0.0, 1.0):
        seen = true @ ori.exp(noise * tremble)
        R, turn, out = seen[0], np.zeros((1, 3)), []
        for now in seen[1:]:
            R, turn = smoothed(R, turn, now, dt, 0.05)
            out.append(R)
        off = ori.angle_between(np.array(out), true[1:])[100:]
        if noise:
            assert off.mean() < 0.8 * ori.angle(ori.exp(tremble)).mean()
            left = [true[1:].mT @ x for x in (np.array(out), seen[1:])]
            jerk = [np.diff(ori.log(x[100:, 0]), 3, axis=0).std() for x in left]
            assert jerk[0] < 0.4 * jerk[1]
        else:
            assert off.max() < 1e-6
            np.testing.assert_allclose(turn, w, atol=1e-6)


def test_one_step_is_the_textbook_filter() -> None:
    """About one axis: x' = x + v dt, x = x' + (1 - th^2) i, v = v + (1 - th)^2 i / dt."""
    x, v, z, dt, memory = 0.2, 1.5, 0.3, 0.04, 0.1
    th = np.exp(-dt / memory)
    i = z - (x + v * dt)
    R, turn = smoothed(ori.rot_z([x]), np.array([[0, 0, v]]), ori.rot_z([z]), dt, memory)
    assert ori.log(R)[0, 2] == pytest.approx(x + v * dt + (1 - th**2) * i)
    assert turn[0, 2] == pytest.approx(v + (1 - th) ** 2 * i / dt)


def correlated(rng: np.random.Generator) -> np.ndarray:
    """(72,72) rad^2: hips and knees, shoulders and elbows err against each other, limbs' ends hardly."""
    C = np.deg2rad(2.0) ** 2 * np.eye(72)
    for upper, lower in ((1, 4), (2, 5), (16, 18), (17, 19)):
        for k in range(3):
            C[3 * upper + k, 3 * upper + k] = C[3 * lower + k, 3 * lower + k] = np.deg2rad(15) ** 2
            C[3 * upper + k, 3 * lower + k] = C[3 * lower + k, 3 * upper + k] = (
                -0.97 * np.deg2rad(15) ** 2
            )
    return C


def test_the_covariance_of_the_networks_errors_brings_the_pose_nearer() -> None:
    """Errors drawn from a covariance: the tracker that is told of it errs less than one that is not."""
    rng = np.random.default_rng(1)
    truth = motions.walk(4.0, 30.0)
    C = correlated(rng)
    error = np.linalg.cholesky(C) @ rng.normal(size=72)
    wave = np.sin(2 * np.pi * 0.2 * np.arange(len(truth)) / 30 + 0.7)
    error = (wave[:, None] * error).reshape(-1, 24, 3)
    recording = synthesis.recording(truth, places.SIX, synthesis.Noise(), 0)
    network = FakeNetwork(truth, error, places.SIX, 0, 15.0)

    class Told(FakeNetwork):
        def step(self, state, sample):  # type: ignore[no-untyped-def]
            from dataclasses import replace

            state, pose = super().step(state, sample)
            return state, None if pose is None else replace(pose, covariance=C)

    told = Told(truth, error, places.SIX, 0, 15.0)
    found = [metrics.evaluate(tracked(n, recording)[1], truth).global_deg for n in (network, told)]
    assert found[1] < 0.9 * found[0]


def test_a_diagonal_covariance_is_the_deviations() -> None:
    settings = single(network_floor_deg=1e-6)
    errors = NetworkErrors(settings, (1, 4, 16, 18))
    std = np.deg2rad(np.random.default_rng(2).uniform(3, 20, size=(24, 3)))
    R, p = np.tile(np.eye(3), (24, 1, 1)), np.zeros(3)
    a = errors.of(Pose(0, R, p, std))
    b = errors.of(Pose(0, R, p, std, "", np.diag(std.ravel() ** 2)))
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-6)


@pytest.mark.parametrize("bad", [np.full((72, 72), np.nan), -np.eye(72), np.eye(3), "C"])
def test_a_covariance_that_is_none_is_not_used(bad: object) -> None:
    truth = motions.walk(3.0, 30.0).slice(20, 50)
    recording = synthesis.recording(truth, places.SIX)

    class Odd(FakeNetwork):
        def step(self, state, sample):  # type: ignore[no-untyped-def]
            from dataclasses import replace

            state, pose = super().step(state, sample)
            return state, None if pose is None else replace(pose, covariance=bad)

    plain, odd = (
        motion_of(run(Tracker(kind(truth, None, places.SIX, 0), single()), recording)[0], truth)
        for kind in (FakeNetwork, Odd)
    )
    assert isinstance(odd, Motion)
    np.testing.assert_allclose(odd.R_parent_joint, plain.R_parent_joint, atol=1e-12)


@pytest.mark.parametrize("sensors", [places.SIX, places.SIX[:5], ("head",)])
def test_stated_deviations_are_those_of_the_errors(sensors: tuple[str, ...]) -> None:
    """Network errors from a covariance, sensor errors of the stated sigma, held until the QP is at rest."""
    rng, skeleton, dt = np.random.default_rng(4), Skeleton.default(), 1 / 60
    settings = single(
        orientation_sigma_deg=6.0, network_floor_deg=1e-3, network_memory_s=0, step_sigma_deg=60.0,
        rate_limit_deg_s=1e6,
    )  # fmt: skip
    joint, seat = places.joints_and_seats(sensors)
    refinement = Refinement(skeleton, joint, seat, settings)
    true = ori.exp(
        0.2 * rng.normal(size=(24, 3))
    )  # elbows and knees inside their limits, or widened
    C, std = correlated(rng) / 9, np.deg2rad(np.full((24, 3), 4.0))
    R_bone = skeleton.rotations(true)[joint]
    free, z = list(refinement.free), []
    for _ in range(60):
        off = ori.exp((np.linalg.cholesky(C) @ rng.normal(size=72)).reshape(24, 3))
        seen = R_bone @ ori.exp(np.deg2rad(6.0) * rng.normal(size=(len(joint), 3)))
        seen = np.where(
            (joint == 0)[:, None, None], R_bone, seen
        )  # the pelvis sensor counts as exact
        pose = Pose(0, true @ off.mT, np.zeros(3), std, "", C)
        sample = Sample(0.0, seen, np.zeros((len(joint), 3)), np.ones(len(joint), bool))
        memory = refinement.start()
        for _ in range(15):
            memory, found = refinement.refine(memory, pose, sample, dt)
        assert not found.reason and found.std_rad is not None
        error = ori.log(found.R_parent_joint.mT @ true)[free]
        z.append(error / found.std_rad[free])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.12)
    by_joint = np.sqrt(np.mean(np.square(z), axis=(0, 2)))
    assert by_joint.min() > 0.7 and by_joint.max() < 1.35
