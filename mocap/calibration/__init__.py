"""Raw sensors to bones: a static pose, where the wearer faces, headings, and what is wrong with a sensor."""

from mocap.calibration.calibrate import calibrate, diagnose
from mocap.calibration.calibration import Calibration
from mocap.calibration.pose_facing import PoseName
from mocap.calibration.words import sentence, summary

__all__ = ["Calibration", "PoseName", "calibrate", "diagnose", "sentence", "summary"]
