"""Raw sensors to bones: a static pose, where the wearer faces, headings, and what is wrong with a sensor."""

from mocap.calibration.calibrate import Calibration, calibrate
from mocap.calibration.pose_facing import PoseName

__all__ = ["Calibration", "PoseName", "calibrate"]
