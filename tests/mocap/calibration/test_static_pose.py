"""Which still window is taken for the pose, where several could be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors as places
from mocap.calibration import calibrate
from mocap.calibration.static_pose import find_static
from mocap.motion import Motion
from mocap.synthesis import motions
from mocap.synthesis.staging import with_static_pose
from tests.mocap.calibration.people import clip, worn


def held(angle_deg: float, seconds: float) -> Motion:
    """3 s of N-pose, 12 s of walking, then `seconds` with both arms turned forward by an angle."""
    motion = with_static_pose(motions.walk(12.0), "n", 3.0)
    R = np.repeat(np.array(motion.R_parent_joint[:1]), round(seconds * motion.rate_hz), axis=0)
    R[:, [16, 17]] = ori.rot_x(np.radians(-angle_deg)) @ R[:, [16, 17]]
    end = np.repeat(motion.p_world_root[-1:], len(R), axis=0)
    R[:, 0] = motion.R_parent_joint[-1, 0]
    return replace(
        motion,
        R_parent_joint=np.concatenate([motion.R_parent_joint, R]),
        p_world_root=np.concatenate([motion.p_world_root, end]),
    )


@pytest.mark.parametrize("noise", ["none", "realistic"])
def test_a_stance_in_another_posture_is_told(noise: str) -> None:
    """Arms raised forward for 4 s at the end: as long and as still as the N-pose at the start."""
    raw = worn(held(80.0, 4.0), places.SIX, noise)
    window = find_static(raw)
    assert window.start < 150 and window.rival is not None and window.rival[0] > 900
    _, cal = calibrate(raw, strict=False)
    (said,) = [f for f in cal.diagnostics if f.code == "pose-ambiguous"]
    assert "0." in said.sentence and "name its time (--at 1" in said.sentence
    assert "pose-ambiguous" not in {
        f.code for f in calibrate(raw, at=1.5, strict=False)[1].diagnostics
    }


@pytest.mark.parametrize(("angle", "seconds"), [(0.0, 4.0), (80.0, 0.7)])
def test_the_same_posture_or_a_moment_is_no_rival(angle: float, seconds: float) -> None:
    assert find_static(worn(held(angle, seconds), places.SIX)).rival is None


@pytest.mark.parametrize("name", ["indian_14", "salsa_16"])
def test_a_stance_before_deep_movement_is_found(name: str) -> None:
    """Its trunk and thighs lean 42 to 51 deg from the mean of the dance; half a second later does not."""
    motion = clip(name)
    for seed in range(5):
        for sensors in (places.SIX, places.SUIT):
            window = find_static(worn(motion, sensors, "realistic", seed))
            assert window.stop < 3.5 * 60 and window.stop - window.start >= 60
