"""Sizes of the augmentation and of the sensors' noise that training draws around."""

from __future__ import annotations

from dataclasses import dataclass, field

from mocap.synthesis import Noise


@dataclass(frozen=True)
class Augmentation:
    """How training motion is varied, per window.

    mirror: probability of exchanging left and right.
    splice: probability of putting the legs of one clip under the trunk and arms of another.
    warp: the time scale is exp(uniform(-warp, warp)); accelerations follow from the warped motion.
    bend_deg: size of a smooth random bending of each joint, 1 sigma per axis: half of it constant over the
    window, half a slow sine. The reference bends too: sensors are put on the motion as augmented.
    tilt_deg: the same for the pelvis.
    heading: whether the whole window is turned to a random heading.
    scale: 1 sigma of the body's size (log).
    seat_m: 1 sigma of the sensors' seats besides the noise's own.
    noise: of the sensors.
    noise_scale: (low, high); each window's noise is multiplied by a number drawn uniformly between them.
    """

    mirror: float = 0.5
    splice: float = 0.25
    warp: float = 0.3
    bend_deg: float = 4.0
    tilt_deg: float = 3.0
    heading: bool = True
    scale: float = 0.06
    seat_m: float = 0.01
    noise: Noise = field(default_factory=Noise)
    noise_scale: tuple[float, float] = (0.3, 1.5)

    @classmethod
    def none(cls) -> Augmentation:
        """The motion as it is, clean sensors."""
        return cls(
            mirror=0, splice=0, warp=0, bend_deg=0, tilt_deg=0, heading=False, scale=0, seat_m=0,
            noise=Noise.none(), noise_scale=(0, 0),
        )  # fmt: skip
