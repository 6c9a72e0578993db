"""Are left and right exchanged on a pair that is alone on its limbs, such as a six-sensor set's shanks?

`limb_levels.check_swapped` compares the levels of a limb; a pair alone has none to be compared with,
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
from mocap import sensors as places
from mocap.calibration import facing as face
from mocap.calibration import limb_levels
from mocap.calibration.static_pose import Pose
from mocap.findings import Finding
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
# By how much lower the score must be where another level of the limb has the same sides: only the whole limb
# can be exchanged then, which is a rarer mistake than a person who moves like the other side.
WHOLE_LIMB = 0.5
OWN_HEADINGS = 0.5  # the same of shanks each in a world of its own: a right pair showed -1.07
RAISED = 0.5  # horizontal part of up in an arm's frame, of 1, from which it is raised sideways
RAISED_S = 2.0  # time for which both arms must have been raised, to tell a side
UNANIMOUS = 0.9  # share of that time, as a difference of the two sides, that must say the same
LOWERED = 0.15  # part of up along left, median, from which an arm counts as lowered from the T-pose


def check_pairs(
    raw: RawRecording, pose: Pose, facing: Array, sigma: Array, name: str, known: set[str]
) -> list[Finding]:
    """Warnings about shanks and (after an N-pose) forearms whose sides are exchanged.

    facing (S,) rad: the wearer's forward in each sensor's world, sigma (S,) its uncertainty. name: "n" or
    "t". known: sensors that another check has named already. In a suit, where another level of the limb has
    the same sides, it takes `WHOLE_LIMB` more.
    """
    joints, _ = places.joints_and_seats(raw.sensors)
    found = []
    for kind in WEIGHTS if name == "n" else ("shank",):
        sides = [f"left_{kind}", f"right_{kind}"]
        if not {"pelvis", *sides} <= set(raw.sensors) or known & set(sides):
            continue
        score = side_score(raw, pose, facing, sigma, kind)
        limit, whole = EXCHANGED, ""
        if kind == "shank" and not raw.common_heading:
            limit -= OWN_HEADINGS
        if score < limit and limb_levels.agrees(raw, joints, kind):
            limit -= WHOLE_LIMB
            whole = ", with the other sensors of these limbs,"
        if score < limit:
            text = (
                f"left_{kind} and right_{kind}{whole} are probably exchanged: their motion fits the pelvis "
                f"better the other way round (score {score:+.1f}, {-score:+.1f} if exchanged)"
            )
            found += [Finding("warning", n, "swapped", text, score) for n in sides]
    return found


def check_sides(raw: RawRecording, pose: Pose, facing: Array, name: str) -> list[Finding]:
    """Do the arms rise (from the N-pose) or drop (from the T-pose) on the side they are named after?

    Up in the frame carried to the pose: a left arm raised sideways from the N-pose carries it to the
    left, one lowered from the T-pose to the right. facing (S,) rad: the wearer's forward in each sensor's
    world.

    In the N-pose only the upper arms tell, because forearms cross the chest; and not for certain, because an
    arm raised forward and turned outward carries up to the other side, and some dance like that. So both
    arms must have been raised sideways for RAISED_S, nearly always to the wrong side; headings must be
    common, as an own one is told by the arm's swing and may be the opposite; and where forearms are worn
    with their sides on the same limbs, their habits must say the same.
    """
    kinds = ("upper_arm",) if name == "n" else ("upper_arm", "forearm", "wrist")
    if name == "n" and not raw.common_heading:
        return []
    found = []
    for kind in kinds:
        sides = [f"left_{kind}", f"right_{kind}"]
        if not all(n in raw.sensors for n in sides):
            continue
        values = [_goes_left(raw, pose, facing, n, name) for n in sides]
        if values[0] < 0 < values[1] and not (name == "n" and _forearms_fit(raw, pose, facing)):
            text = (
                f"left_{kind} and right_{kind} are probably exchanged: the left one goes to the right "
                f"and the right one to the left; or the facing is off by 180 deg"
            )
            found += [Finding("warning", n, "swapped", text, values[0]) for n in sides]
    return found


def _goes_left(raw: RawRecording, pose: Pose, facing: Array, sensor: str, name: str) -> float:
    """How clearly an arm rises or drops to the left: -1 to 1, 0 where it is not clear."""
    s = raw.sensors.index(sensor)
    _, up, _ = face.carried(raw, pose, s)
    h = face.complex_heading(up) * np.exp(-1j * facing[s])
    if name == "t":
        lowered = -float(np.median(h.imag))
        return lowered if abs(lowered) > LOWERED else 0.0
    raised = h.imag[(np.abs(h.imag) > RAISED) & (np.abs(h.imag) > np.abs(h.real))]
    if len(raised) < RAISED_S * raw.rate_hz:
        return 0.0
    share = float(np.sign(raised).mean())
    return share if abs(share) > UNANIMOUS else 0.0


def _forearms_fit(raw: RawRecording, pose: Pose, facing: Array) -> bool:
    """Are there forearms on the same limbs as the upper arms, that turn as those of these sides do?"""
    if not {"pelvis", "left_forearm", "right_forearm"} <= set(raw.sensors):
        return False
    joints, _ = places.joints_and_seats(raw.sensors)
    same = limb_levels.agrees(raw, joints, "upper_arm")
    unknown = np.full(len(raw.sensors), np.pi)
    return same and side_score(raw, pose, facing, unknown, "forearm") > 0.5 * EXCHANGED


def side_score(raw: RawRecording, pose: Pose, facing: Array, sigma: Array, kind: str) -> float:
    """Log odds that left and right of a kind are named rightly; 0 where there is too little to tell by.

    facing, sigma (S,): see `check_pairs`.
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
    cues = _cues(D, face.lowpass(acc, LOWPASS_HZ, raw.rate_hz), raw.rate_hz)
    score = _sum(WEIGHTS[kind], cues)
    if kind == "shank":
        return score
    habits = _sum(HABITS, cues)
    if not (certain and raw.common_heading):
        return habits
    return score if score * habits > 0 else 0.0


def _sum(weights: dict[str, float], cues: dict[str, float]) -> float:
    return float(sum(w * np.clip(cues[c], -LONGEST, LONGEST) for c, w in weights.items()))


def _cues(D: Array, acc: Array, rate_hz: float) -> dict[str, float]:
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
