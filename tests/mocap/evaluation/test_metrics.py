"""Each metric against a closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.evaluation.metrics import JSON_NAMES, MASKED, Metrics, evaluate, mean_over
from mocap.motion import Motion
from mocap.sensors import SIX, SUIT
from mocap.skeleton import Skeleton
from mocap.synthesis import recording

TABLE = Skeleton.default()


def still(T: int = 120, rate: float = 60.0, skeleton: Skeleton = TABLE) -> Motion:
    return Motion(rate, np.tile(np.eye(3), (T, 24, 1, 1)), np.zeros((T, 3)), skeleton)


def moving(rng: np.random.Generator, T: int = 120, rate: float = 60.0) -> Motion:
    t = np.arange(T)[:, None, None] / rate
    phase = rng.uniform(0, 6, size=(1, 24, 3))
    R = ori.exp(0.4 * np.sin(2 * t + phase))
    p = np.stack([0.1 * np.sin(np.arange(T) / rate), 0 * t[:, 0, 0], np.arange(T) / rate], 1)
    return Motion(rate, R, p, TABLE)


def bent(joint: int, w: list[float], base: Motion) -> Motion:
    """`base` with the local rotation of one joint followed by Exp(w)."""
    R = np.array(base.R_parent_joint)
    R[:, joint] = R[:, joint] @ ori.exp(w)
    return Motion(base.rate_hz, R, base.p_world_root, base.skeleton)


def test_equal_motions_have_no_error(rng):
    m = moving(rng, 400)
    found = evaluate(m, m)
    for name in JSON_NAMES:
        value = getattr(found, name)
        if name.endswith(("_deg", "_cm", "_per_m")) and value is not None:
            assert value == pytest.approx(0, abs=1e-5), name
    assert found.translation_m == {"1": 0, "2": 0, "5": 0}
    assert found.jitter == pytest.approx(found.jitter_reference)
    assert (found.frames, found.rate_hz) == (400, 60)


def test_one_shoulder_turned(rng):
    """A shoulder turned by 0.5 rad turns itself, and of the masked body elbow, wrist and hand
    too.
    """
    m = moving(rng)
    found = evaluate(bent(16, [0, 0.5, 0], m), m)
    deg = np.rad2deg(0.5)
    assert found.sip_deg == pytest.approx(deg / 4)
    assert found.angular_deg == pytest.approx(deg * 4 / 24)  # joints 16, 18, 20, 22
    assert found.global_deg == pytest.approx(deg * 4 / 24)
    assert found.local_angular_deg == pytest.approx(deg / 15)
    assert found.root_deg == pytest.approx(0, abs=1e-6)


def test_positions_of_a_turned_shoulder():
    """From the T-pose, joints below the shoulder move by the chord 2 r sin(a/2) about its axis."""
    m = still()
    a = 0.7
    found = evaluate(bent(17, [0, 0, a], m), m)
    arms = TABLE.rest_positions - TABLE.rest_positions[17]
    chord = 2 * np.sin(a / 2) * np.linalg.norm(arms[[19, 21, 23], :2], axis=1)
    assert found.position_cm == pytest.approx(100 * chord.sum() / 24)
    assert found.world_position_cm == pytest.approx(100 * chord.sum() / 24)
    assert found.joint_cm[[19, 21, 23]] == pytest.approx(100 * chord)


@pytest.mark.parametrize("joint", MASKED)
def test_masked_joints_do_not_count(rng, joint):
    m = moving(rng)
    found = evaluate(bent(joint, [0.3, 0.2, 0.1], m), m)
    assert found.sip_deg == pytest.approx(0, abs=1e-5)
    assert found.angular_deg == pytest.approx(0, abs=1e-5)
    assert found.position_cm == pytest.approx(0, abs=1e-9)
    assert found.global_deg > 0.1


def test_root_turned_about_its_axis():
    """Only the unmasked figures see the root: every bone turns with it."""
    m = still()
    found = evaluate(bent(0, [0, 0.4, 0], m), m)
    deg = np.rad2deg(0.4)
    assert found.root_deg == pytest.approx(deg)
    assert found.global_deg == pytest.approx(deg)
    assert found.angular_deg == pytest.approx(0, abs=1e-6)
    r = np.linalg.norm((TABLE.rest_positions - TABLE.rest_positions[0])[:, [0, 2]], axis=1)
    assert found.world_position_cm == pytest.approx(100 * (2 * np.sin(0.2) * r).mean())


def test_the_body_is_the_tables(rng):
    """A taller prediction is measured on the same body."""
    m = moving(rng)
    assert evaluate(m.on(Skeleton.default(height=1.95)), m).position_cm == pytest.approx(
        0, abs=1e-9
    )


def test_jitter_of_a_turning_arm():
    """On a circle of radius r at w rad/s the third difference is r (2 sin(w dt / 2))^3 rate^3."""
    rate, w, T = 60.0, 3.0, 200
    m = still(T, rate)
    R = np.array(m.R_parent_joint)
    R[:, 16] = ori.rot_z(w * np.arange(T) / rate)
    found = evaluate(Motion(rate, R, m.p_world_root, TABLE), m)
    arms = TABLE.rest_positions - TABLE.rest_positions[16]
    r = np.linalg.norm(arms[[18, 20, 22], :2], axis=1)
    jerk = r * (2 * np.sin(w / rate / 2) * rate) ** 3
    assert found.jitter == pytest.approx(jerk.sum() / 24 / 100)
    assert found.jitter == pytest.approx((r * w**3).sum() / 2400, rel=1e-3)  # continuous: r w^3
    assert found.jitter_reference == pytest.approx(0, abs=1e-9)


def test_jitter_needs_four_frames(rng):
    m = moving(rng, 3)
    assert evaluate(m, m).jitter is None


def test_drift_of_known_speed(rng):
    """Drift of 0.1 m/s on a walk of 1 m/s: 0.1, 0.2, 0.5 m, and 0.1 m per metre."""
    T, rate = 400, 60.0
    m = still(T, rate)
    t = np.arange(T)[:, None] / rate
    walk = Motion(rate, m.R_parent_joint, t * [[0, 0, 1.0]], TABLE)
    drifting = Motion(rate, m.R_parent_joint, t * [[0.1, 0, 1.0]], TABLE)
    found = evaluate(drifting, walk)
    assert found.translation_m == pytest.approx({"1": 0.1, "2": 0.2, "5": 0.5})
    assert found.translation_m_per_m == pytest.approx(0.1)


def test_translation_is_not_aligned_by_rotation(rng):
    """Walking 1 m/s to the left instead of ahead is an error of sqrt(2) m after a second."""
    T = 100
    m = still(T)
    t = np.arange(T)[:, None] / 60
    ahead = Motion(60, m.R_parent_joint, t * [[0, 0, 1.0]], TABLE)
    found = evaluate(ahead.turned(np.pi / 2), ahead)
    assert found.translation_m["1"] == pytest.approx(np.sqrt(2))
    assert found.translation_m["2"] is None


def test_a_path_nobody_measured_has_no_error(rng):
    m = moving(rng)
    fixed = Motion(m.rate_hz, m.R_parent_joint, np.zeros((len(m), 3)), TABLE)
    for found in (evaluate(m, fixed), evaluate(fixed, m)):
        assert found.translation_m is None
        assert found.translation_m_per_m is None


def test_prediction_is_resampled(rng):
    m = moving(rng, 241, 240.0)
    found = evaluate(m, m.resampled(60.0))
    assert (found.frames, found.rate_hz) == (61, 60)
    assert found.global_deg == pytest.approx(0, abs=1e-5)


def test_lengths_may_differ_by_one_period(rng):
    m = moving(rng)
    assert evaluate(m.slice(0, 119), m).frames == 119
    assert evaluate(m, m.slice(0, 119)).frames == 119
    with pytest.raises(PoserError, match="118 frames"):
        evaluate(m.slice(0, 118), m)


def test_left_out_sensors(rng):
    """Clean sensors on all bones: what a turned thigh shows is the angle, averaged over those
    unseen.
    """
    m = moving(rng)
    rec = recording(m, SUIT)
    turned = bent(1, [0.3, 0, 0], m)
    found = evaluate(turned, m, recording=rec, seen=SIX)
    unseen = [n for n in SUIT if n not in SIX]
    below = {"left_thigh", "left_foot"}  # the left shank is seen
    assert found.left_out_deg == pytest.approx(np.rad2deg(0.3) * len(below) / len(unseen))
    assert found.instrumented_deg == pytest.approx(np.rad2deg(0.3) / 6)
    assert evaluate(m, None, recording=rec, seen=SIX).left_out_deg == pytest.approx(0, abs=1e-5)
    assert evaluate(m, m, recording=rec).left_out_deg is None
    assert evaluate(m, m, seen=SIX).instrumented_deg == pytest.approx(0, abs=1e-5)


def test_a_bone_with_a_seen_sensor_is_not_left_out(rng):
    m = moving(rng)
    rec = recording(m, ("left_wrist", "left_forearm", "head"))
    turned = bent(18, [0.3, 0, 0], m)
    found = evaluate(turned, m, recording=rec, seen=("left_wrist",))
    assert found.left_out_deg == pytest.approx(0, abs=1e-5)


def test_unknown_seen_sensor(rng):
    m = moving(rng)
    with pytest.raises(PoserError, match="left_wrist"):
        evaluate(m, m, recording=recording(m), seen=("left_wrist",))


def test_mean_over_sequences_weighs_each_once():
    a = Metrics(10, 60.0, sip_deg=10.0, jitter=None, translation_m={"1": 1.0, "2": None, "5": None})
    b = Metrics(90, 60.0, sip_deg=20.0, jitter=3.0, translation_m={"1": 3.0, "2": 4.0, "5": None})
    m = mean_over([a, b, Metrics(1, 30.0)])
    assert m.sip_deg == 15.0
    assert m.jitter == 3.0
    assert m.translation_m == {"1": 2.0, "2": 4.0, "5": None}
    assert (m.frames, m.rate_hz, m.mesh_cm) == (101, None, None)


def test_json_names_are_the_designs(rng):
    m = moving(rng)
    assert set(evaluate(m, m).to_json()) == {
        "sip_deg", "angular_deg", "local_angular_deg", "position_cm", "mesh_cm", "jitter",
        "jitter_reference", "root_deg", "global_deg", "instrumented_deg", "left_out_deg",
        "world_position_cm", "translation_m", "translation_m_per_m", "frames", "rate_hz",
    }  # fmt: skip


def test_frames_that_are_not_trusted_count_nowhere(rng):
    """Whatever the prediction and the reference are there; as if each part were evaluated alone."""
    m = moving(rng, 400)
    trusted = np.ones(400, bool)
    trusted[150:180] = False
    bad = bent(16, [0, 0.2, 0.1], m)
    R, p = np.array(bad.R_parent_joint), np.array(bad.p_world_root)
    R[150:180, 17] = ori.exp([0, 0, 3.0])
    p[150:180] += [0, 5, 0]
    broken = Motion(60.0, R, p, TABLE)
    want = evaluate(broken, m, trusted=trusted)
    marked = evaluate(broken, replace(m, trusted=trusted))
    assert want.to_json() == marked.to_json()
    assert (want.frames, want.untrusted_frames) == (370, 30)
    parts = [evaluate(bad.slice(*s), m.slice(*s)) for s in ((0, 150), (180, 400))]
    for name in ("sip_deg", "angular_deg", "local_angular_deg", "position_cm", "global_deg"):
        mean = np.average([getattr(x, name) for x in parts], weights=[150, 220])
        assert getattr(want, name) == pytest.approx(mean), name
    mean = np.average([x.jitter for x in parts], weights=[147, 217])
    assert want.jitter == pytest.approx(mean)
    assert want.translation_m == {"1": pytest.approx(0), "2": pytest.approx(0), "5": None}
    assert want.translation_m_per_m == pytest.approx(0)
    assert np.isnan(want.frame_sip_deg[150:180]).all() and np.isfinite(want.joint_deg).all()


def test_a_mask_is_checked(rng):
    m = moving(rng, 50)
    with pytest.raises(PoserError, match=r"trusted must be \(50,\) bool"):
        evaluate(m, m, trusted=np.ones(49, bool))
    with pytest.raises(PoserError, match="no frame of the reference is trusted"):
        evaluate(m, m, trusted=np.zeros(50, bool))


def test_shares_inside_stated_deviations_are_those_of_normal_errors(rng):
    truth = moving(rng, 400)
    sigma = rng.uniform(0.02, 0.1, size=(len(truth), 24, 3))
    theta = ori.log(truth.R_parent_joint)
    noisy = replace(truth, R_parent_joint=ori.exp(theta + sigma * rng.normal(size=sigma.shape)))
    found = evaluate(noisy, truth, std_rad=sigma)
    assert found.inside_1_sigma == pytest.approx(0.683, abs=0.02)
    assert found.inside_2_sigma == pytest.approx(0.954, abs=0.02)
    assert {"inside_1_sigma", "inside_2_sigma"} <= set(found.to_json())
    assert evaluate(noisy, truth).inside_1_sigma is None
    with pytest.raises(PoserError, match="std_rad"):
        evaluate(noisy, truth, std_rad=sigma[1:])
