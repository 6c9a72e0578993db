"""IMUPoser (Mollyn et al. 2023), as data."""

from __future__ import annotations

from learned.spec import Specification
from mocap import sensors as places

COMBINATIONS: tuple[tuple[int, ...], ...] = (
    (0,), (1,), (2,), (3,), (4,),
    (0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4),
    (0, 1, 2), (0, 1, 3), (0, 1, 4), (0, 2, 3), (0, 2, 4), (0, 3, 4), (1, 2, 3), (1, 2, 4),
    (1, 3, 4),
)  # fmt: skip
"""The 24 device combinations (its Fig. 3), as indices into `mocap.sensors.FIVE`: all subsets of one to
three places except both pockets with the head."""

FRAMES = 125
"""Of the rolling window (5.3) and of the windows in training (4.3)."""

SPECIFICATION = Specification(
    name="imuposer",
    title="IMUPoser",
    rate_hz=25.0,
    places=places.FIVE,
    combinations=COMBINATIONS,
    architectures=("imuposer",),
    window=(FRAMES - 1, 0),
    most_windows=360,
    # 4.3: batches of 256, Adam at 3e-4; neither decay nor clipping is mentioned.
    schedule={
        "batch": 256, "frames": FRAMES, "learning_rate": 3e-4, "decay": 1.0, "clip": float("inf"),
    },
    # What it gets wrong changes faster than DIP's errors, and one to three devices do not tell how spine and
    # pelvis share an error. By validation clips:
    # `benchmarks/methods.py --split validation --part imuposer --tracker JSON`.
    tracker={"step_sigma_deg": 80.0, "spine": False},
    refiners={"adam": "learned.imuposer.adam:AdamEstimator"},
    everyday=(("left_wrist", "right_pocket", "head"), ("left_wrist", "right_wrist", "head")),
    model="learned.imuposer.model:Imuposer",
    online="learned.imuposer.window:window",
    deviations="learned.imuposer.deviations:calibrate",
)  # fmt: skip
