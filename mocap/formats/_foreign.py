"""Files that are not read, by suffix: what they are, and what to export instead."""

from __future__ import annotations

_RIG = "export BVH from the tool that made it (Blender: File, Export, Motion Capture)"
_MARKERS = (
    "markers are not joints: let the software that recorded them solve its skeleton, "
    "and export that as BVH"
)
_MVN = "in MVN Analyze or MVN Animate: File, Export, MVNX (with sensor data, for recordings)"
_MT = "in MT Manager: File, Export, text with calibrated data and orientation, one .txt a sensor"
_TABLE = "save each sheet as .csv, with columns such as pelvis.acc_x (docs/conventions.md)"
_ANGLES = "joint angles of an OpenSim model, of which no two are alike: export the motion as BVH"

INSTEAD: dict[str, tuple[str, str]] = {
    ".c3d": ("marker positions", _MARKERS),
    ".trc": ("marker positions", f"poser convert writes such files, and reads none: {_MARKERS}"),
    ".fbx": ("an FBX scene", _RIG),
    ".glb": ("a glTF scene", f"poser convert writes such files, and reads none: {_RIG}"),
    ".gltf": ("a glTF scene", _RIG),
    ".vrm": ("a VRM avatar", _RIG),
    ".abc": ("an Alembic scene", _RIG),
    ".dae": ("a Collada scene", _RIG),
    ".blend": ("a Blender scene", _RIG),
    ".usd": ("a USD scene", _RIG),
    ".usdz": ("a USD scene", _RIG),
    ".vmd": ("a MikuMikuDance motion", _RIG),
    ".mot": ("an OpenSim motion", f"it holds {_ANGLES}; of sensors, give the orientations' .sto"),
    ".mvn": ("an Xsens MVN session", f"export MVNX: {_MVN}"),
    ".mtb": ("an Xsens MT log in binary", f"export text: {_MT}"),
    ".xlsx": ("a workbook", f"{_TABLE}; of MVN, export MVNX: {_MVN}"),
    ".xls": ("a workbook", _TABLE),
    ".ods": ("a workbook", _TABLE),
    ".parquet": ("a Parquet table", "save it as .csv, with columns such as pelvis.acc_x"),
    ".h5": ("an HDF5 file", "save its tables as .csv, with columns such as pelvis.acc_x"),
    ".hdf5": ("an HDF5 file", "save its tables as .csv, with columns such as pelvis.acc_x"),
    ".bag": ("a ROS bag", "save each sensor's messages as .csv in one folder"),
    ".zip": ("an archive", "unpack it and give the folder or a file in it"),
    ".tar": ("an archive", "unpack it and give the folder or a file in it"),
    ".gz": ("an archive", "unpack it and give the folder or a file in it"),
    ".xz": ("an archive", "unpack it and give the folder or a file in it"),
    ".7z": ("an archive", "unpack it and give the folder or a file in it"),
    ".mp4": ("a film", "poses are estimated from sensors here, not from pictures"),
    ".avi": ("a film", "poses are estimated from sensors here, not from pictures"),
    ".mov": ("a film", "poses are estimated from sensors here, not from pictures"),
}  # fmt: skip


def instead(suffix: str) -> str | None:
    """What a file of a suffix that is not read holds and what to export instead; None where unknown."""
    if suffix not in INSTEAD:
        return None
    what, do = INSTEAD[suffix]
    return f"{suffix} files ({what}) are not read: {do}"
