"""Starts for a solve: the window that moves, sent along a recording and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap import orientation as ori
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.skeleton import Skeleton
from sip import initial
from sip import kinematics as kin
from sip.horizon import Horizon, HorizonSettings, run
from sip.kinematics import BODY, ROOT_P, ROOT_W
from sip.problem import reference_root
from sip.settings import Settings
from sip.solve import Progress, share

MOST_HZ = 60.0


def passes(
    recording: Recording,
    skeleton: Skeleton | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> dict[str, Motion]:
    """The recording's poses as `sip.horizon` follows them, "forward" and "backward" in time.

    The window goes along with a movement into poses that a start in the prior's mean does not lead to.
    Backward is the recording reversed: R(T-1-t) and a(T-1-t), since a second derivative does not mind the
    direction of time. Above `MOST_HZ` it sees every k-th frame. Sensors' constants and terms of one's own
    are left out.
    """
    skeleton, settings = skeleton or Skeleton.default(), settings or Settings()
    plain = replace(settings, self_calibration=False, extra=())
    factor = max(1, int(recording.rate_hz / MOST_HZ + 1e-6))
    coarse = initial.coarsened(recording, factor)
    how = HorizonSettings(steps=2)
    rate = coarse.rate_hz
    horizon = Horizon(skeleton, recording.joint, recording.placement, rate, plain, how)
    found = {}
    for i, (name, order) in enumerate((("forward", 1), ("backward", -1))):
        tell = share(progress, i, 2, f"following {name}: ")
        R, p = run(horizon, in_order(coarse, order), horizon.size - 1, progress=tell)
        motion = Motion(rate, R[::order], p[::order], skeleton, recording.start_s)
        found[name] = _fine(motion, recording, horizon, factor)
    return found


def in_order(recording: Recording, order: int) -> Recording:
    """The recording as it is, or with -1 its last frame first."""
    if order == 1:
        return recording
    turned = {
        name: getattr(recording, name)[::-1].copy()
        for name in ("R_world_bone", "acc_world", "valid")
    }
    return replace(recording, reference=None, **turned)


def _fine(motion: Motion, recording: Recording, horizon: Horizon, factor: int) -> Motion:
    """A motion of every `factor`-th frame at the recording's rate."""
    if factor == 1:
        return motion
    prior, T = horizon.model.prior, len(recording)
    x, R_ref = initial.from_motion(motion, prior)
    x, R_ref = initial.refined(x, R_ref, factor, T, reference_root(recording))
    R_root = R_ref @ ori.exp(x[:, ROOT_W])
    theta = np.asarray(prior.complete(x[:, BODY]))
    return kin.unpack(
        x[:, ROOT_P], R_root, theta, recording.rate_hz, motion.skeleton, recording.start_s
    )
