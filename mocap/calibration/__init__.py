"""Raw sensors to bones: a static pose, where the wearer faces, headings, and what is wrong with a sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mocap.lazy_names import lazy
from mocap.words import sentence, summary

if TYPE_CHECKING:
    from mocap.calibration.pose_facing import PoseName
    from mocap.calibration.procedure import calibrate, diagnose
    from mocap.calibration.record import Calibration

__all__ = ["Calibration", "PoseName", "calibrate", "diagnose", "sentence", "summary"]

# Readers need the checks alone, not what calibration imports of scipy.
__getattr__ = lazy(
    __name__,
    {
        "Calibration": "record",
        "PoseName": "pose_facing",
        "calibrate": "procedure",
        "diagnose": "procedure",
    },
)
