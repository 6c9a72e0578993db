"""Names of sensors: OpenSim's bodies as places, its mapping file, and mappings that users give."""

from __future__ import annotations

import json
import re
from pathlib import Path

from mocap.errors import FormatError
from mocap.findings import Finding, assumption, doubt
from mocap.formats import Options, _xml
from mocap.sensors import PLACES

_BODIES = {
    "torso": "sternum", "pelvis": "pelvis", "head": "head", "femur": "thigh", "tibia": "shank",
    "calcn": "foot", "talus": "foot", "humerus": "upper_arm", "radius": "forearm",
    "ulna": "forearm", "hand": "hand", "thorax": "sternum", "skull": "head",
}  # fmt: skip
MAX_MAPPING = 1 << 20
TORSO = assumption("torso-on-sternum")


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


def given(options: Options) -> dict[str, str]:
    """{name in the file: place} as the user gave it: in words, a JSON object, or OpenSim's mapping file.

    Raises FormatError where the file is neither.
    """
    mapping = options.mapping
    if mapping is None or isinstance(mapping, dict):
        return mapping or {}
    path = Path(mapping)
    if path.suffix.lower() == ".xml":
        _, names = read_mapping(path)
        return {k: place(v) for k, v in names.items()} | {v: place(v) for v in names.values()}
    if not path.is_file() or path.stat().st_size > MAX_MAPPING:
        raise FormatError(path, "no mapping file, or too large for one")
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as e:
        raise FormatError(path, "not a JSON object of sensor names and places") from e
    if not isinstance(found, dict) or not all(isinstance(v, str) for v in found.values()):
        raise FormatError(path, "not a JSON object of sensor names and places")
    return found


def unknown(names: tuple[str, ...]) -> list[Finding]:
    """A warning for sensors whose names are no places of the table."""
    odd = [n for n in names if n not in PLACES]
    if not odd:
        return []
    return [doubt("unknown-places", names=", ".join(odd))]
