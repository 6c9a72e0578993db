"""OpenSim's names: the mapping file of its IMU reader, and bodies of its models as places."""

from __future__ import annotations

import re
from pathlib import Path

from mocap.errors import FormatError
from mocap.formats import _xml
from mocap.sensors import PLACES

_BODIES = {
    "torso": "sternum", "pelvis": "pelvis", "head": "head", "femur": "thigh", "tibia": "shank",
    "calcn": "foot", "talus": "foot", "humerus": "upper_arm", "radius": "forearm",
    "ulna": "forearm", "hand": "hand", "thorax": "sternum", "skull": "head",
}  # fmt: skip
TORSO = "the torso sensor is taken to sit on the sternum"


def place(name: str) -> str:
    """The place of a body of an OpenSim model (`tibia_r_imu`: `right_shank`); unknown names stay."""
    plain = re.sub(r"_imu$", "", name.strip().lower())
    if plain in PLACES:
        return plain
    match = re.fullmatch(r"([a-z]+?)(?:_([lr]))?", plain)
    ours = _BODIES.get(match[1]) if match else None
    if match is None or ours is None:
        return name
    side = {"l": "left_", "r": "right_", None: ""}[match[2]]
    return side + ours if side + ours in PLACES else name


def read_mapping(path: Path) -> tuple[str, dict[str, str]]:
    """Trial prefix and {sensor suffix: name in the model} of an XsensDataReaderSettings file.

    Raises FormatError where the file names no sensor.
    """
    prefix, sensor, names = "", "", {}
    for e in _xml.elements(path, frozenset({"trial_prefix", "name_in_model"})):
        if e.text is None:
            sensor = e.attributes.get("name", "") if e.tag == "ExperimentalSensor" else sensor
        elif e.tag == "trial_prefix":
            prefix = e.text.strip()
        elif e.tag == "name_in_model" and sensor:
            names[sensor.lstrip("_")] = e.text.strip()
    if not names:
        raise FormatError(path, "names no ExperimentalSensor")
    return prefix, names


def unknown(names: tuple[str, ...]) -> list[str]:
    """A warning for sensors whose names are no places of the table."""
    odd = [n for n in names if n not in PLACES]
    if not odd:
        return []
    return [f"no place of the table: {', '.join(odd)}; name them with a mapping"]
