"""Are left and right exchanged on a pair that is alone on its limbs, such as a six-sensor set's shanks?

`checks.levels` compares the levels of a limb; a pair alone has none to be compared with,
and every single pose of it is a possible one. What tells the sides then is the pelvis and how people move.
In the wearer's world, D(t) being a rotation since the pose, v = D^T e_y and w the pelvis' rate of turning:

- `tilt`: v goes to the sensor's own side. A forearm does when it is raised sideways, and also when it turns
  inward and then bends, as before the body; of 178 right pairs none did the opposite on the whole.
- `outward`: the twist against the pelvis. Shanks turn outward from the stance; forearms inward.
- `rising`: a forearm turns inward while it rises and outward while it sinks.
- `turning`, `round`: a body that turns pushes its left side back by dw/dt and to the right by w^2.
- `push`, `swing`: the shank that swings has the larger acceleration, and the pelvis is pushed towards it; the
  leg in front has its side of the pelvis in front.

Each cue changes its sign with the exchange. Weights are those of a logistic regression without offset
(ridge 0.02) on 49 clips of CMU and 107 of Bandai's training motion, sensors with the realistic noise, 8 to
20 s each, a group of n clips (subject or style) counting as sqrt(n). With each group left out in turn,
and 22 clips of validation and test, the least score of right shanks was -0.6, of right forearms +0.2, by
habits alone -0.7: EXCHANGED leaves room. What is not named may still be exchanged: everyday motion without
a walk often does not show shanks. See `benchmarks/diagnostics.py` for what is found of other people.

`outward` and `rising` need no facing: the twist is about the vertical. They alone tell forearms where the
facing is uncertain or found for each sensor (arms by a swing that would be the other leg's), and elsewhere
they must not say the opposite, as a facing that is off by 180 deg would turn `tilt` round.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from mocap import orientation as ori
from mocap.calibration import facing as face
from mocap.calibration.static_pose import StaticPose
from mocap.orientation import Array
from mocap.recording import RawRecording

WEIGHTS = {
    "shank": {
        "push": 0.24, "swing": 0.52, "outward": 1.51, "round": 0.81, "turning": 0.50, "tilt": 0.83,
    },
    "forearm": {"outward": -0.90, "rising": -0.75, "tilt": 1.42},
}  # fmt: skip
HABITS = {"outward": -1.61, "rising": -1.03}  # weights of what tells forearms without a facing
EXCHANGED = -1.0  # score below which a pair is named
UNCERTAIN_DEG = 40.0  # of a facing with which shanks tell nothing, and forearms by HABITS alone
LONGEST = 4.0  # a cue counts at most this much: one that is constant has no spread to be divided by
AT_LEAST_S = 10.0  # with the pose: what the weights were fitted to
SWING_S = 1.5  # a stride: slower than that it is turning, not swinging
LOWPASS_HZ = 3.0
TURNING_HZ, ROUND_HZ = 1.0, 0.5  # below which an acceleration is that of turning
FLOOR = 0.1  # spread of an angle, rad, or of v, below which its mean says less


def side_score(
    raw: RawRecording, pose: StaticPose, facing: Array, sigma: Array, kind: str
) -> float:
    """Log odds that left and right of a kind are named rightly; 0 where there is too little to tell by.

    facing (S,) rad: the wearer's forward in each sensor's world, sigma (S,) its uncertainty.
    """
    worn = [raw.sensors.index(n) for n in ("pelvis", f"left_{kind}", f"right_{kind}")]
    certain = bool((sigma[worn] < np.radians(UNCERTAIN_DEG)).all())
    if kind == "shank" and not certain:
        return 0.0
    assert raw.R_world_sensor is not None
    R = raw.R_world_sensor[:, worn]
    ok = raw.valid[:, worn].all(axis=1) & np.isfinite(R).all((1, 2, 3))
    if ok.sum() < AT_LEAST_S * raw.rate_hz:
        return 0.0
    here = ori.rot_y(-facing[worn])
    # Since the pose, in the wearer's world: B(t) B(pose)^T.
    D = here @ R[ok] @ np.swapaxes(here @ pose.R_world_sensor[worn], -1, -2)
    acc = (here @ R[ok] @ raw.acc[ok][:, worn, :, None])[..., 0] - np.array([0, ori.GRAVITY, 0])
    cues = side_cues(D, face.lowpass(acc, LOWPASS_HZ, raw.rate_hz), raw.rate_hz)
    score = _sum(WEIGHTS[kind], cues)
    if kind == "shank":
        return score
    habits = _sum(HABITS, cues)
    if not (certain and raw.common_heading):
        return habits
    return score if score * habits > 0 else 0.0


def _sum(weights: dict[str, float], cues: dict[str, float]) -> float:
    return float(sum(w * np.clip(cues[c], -LONGEST, LONGEST) for c, w in weights.items()))


def side_cues(D: Array, acc: Array, rate_hz: float) -> dict[str, float]:
    """The cues of (pelvis, left, right): D (N,3,3,3) since the pose, acc (N,3,3) m/s^2 without gravity."""

    def low(x: Array, cutoff_hz: float = LOWPASS_HZ) -> Array:
        return face.lowpass(x, cutoff_hz, rate_hz)

    pelvis = D[:, 0]
    forward = pelvis[:, :, 2] * [1, 0, 1]
    forward /= np.linalg.norm(forward, axis=1, keepdims=True) + 1e-9
    left = np.cross([0, 1, 0], forward)
    ahead = -np.einsum("nsi,ni->ns", D[:, 1:, :, 1], forward)
    turn = np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))
    w = low(np.gradient(low(turn)) * rate_hz)
    size = np.linalg.norm(acc[:, 1:], axis=-1)
    apart = acc[:, 1] - acc[:, 2]
    twist = ori.log(np.swapaxes(pelvis, -1, -2)[:, None] @ D[:, 1:])[..., 1]
    up = D[:, 1:, 1]
    rise = np.gradient(low(np.arccos(np.clip(up[..., 1], -1, 1))), axis=0)
    inward = low(np.gradient(twist, axis=0))
    stride = round(SWING_S * rate_hz)
    return {
        "tilt": _steady(up[:, 0, 0] - up[:, 1, 0]),
        "outward": _steady(twist[:, 0] - twist[:, 1]),
        "rising": _correlation(inward[:, 0], rise[:, 0]) - _correlation(inward[:, 1], rise[:, 1]),
        "turning": _correlation(
            low(np.einsum("ni,ni->n", apart, forward), TURNING_HZ),
            -low(np.gradient(w), TURNING_HZ),
        ),
        "round": _correlation(
            low(np.einsum("ni,ni->n", apart, left), ROUND_HZ), -low(w**2, ROUND_HZ)
        ),
        "push": _correlation(size[:, 0] - size[:, 1], np.einsum("ni,ni->n", acc[:, 0], left)),
        "swing": _correlation(_fast(ahead[:, 0] - ahead[:, 1], stride), -_fast(turn, stride)),
    }


def _steady(x: Array) -> float:
    """Mean over spread."""
    return float(x.mean() / (x.std() + FLOOR))


def _fast(x: Array, n: int) -> Array:
    """What is quicker than a moving mean over n frames."""
    return np.asarray(x - uniform_filter1d(x, n))


def _correlation(a: Array, b: Array) -> float:
    spread = a.std() * b.std()
    return float(((a - a.mean()) * (b - b.mean())).mean() / spread) if spread > 1e-9 else 0.0
