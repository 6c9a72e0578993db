"""What OpenSim's inverse kinematics reads: orientations of segments (`.sto`) and virtual markers (`.trc`).

OpenSim's ground: x forward, y up, z right, metres; ours is x left, y up, z forward: v_opensim = C v_ours.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap import orientation as ori
from mocap.body import mesh_skin
from mocap.errors import ShapeError
from mocap.formats._files import write_aside
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.seats import sensor_positions
from mocap.skeleton import JOINTS, TABLE_STATURE, Skeleton
from mocap.stances import pose_bones

C: Array = ori.R_OURS_ISB.T
Q_UP: Array = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""Ours to the world of Xsens' files: x forward, y left, z up."""
BODIES: dict[str, str] = {
    "pelvis": "pelvis", "spine3": "torso", "head": "head",
    "left_hip": "femur_l", "right_hip": "femur_r", "left_knee": "tibia_l", "right_knee": "tibia_r",
    "left_ankle": "calcn_l", "right_ankle": "calcn_r", "left_shoulder": "humerus_l",
    "right_shoulder": "humerus_r", "left_elbow": "radius_l", "right_elbow": "radius_r",
    "left_wrist": "hand_l", "right_wrist": "hand_r",
}  # fmt: skip
"""Our joint whose bone is a body of OpenSim's full-body models."""

MARKER_M = 0.007  # radius
# Markers of the Plug-in Gait set: our joint, and about where in its axes, m at TABLE_STATURE. The right
# side's are mirrored.
_MIDDLE: dict[str, tuple[str, tuple[float, float, float]]] = {
    "C7": ("spine3", (0.0, 0.215, -0.105)), "T10": ("spine3", (0.0, 0.0, -0.145)),
    "CLAV": ("spine3", (0.0, 0.145, 0.035)), "STRN": ("spine3", (0.0, 0.0, 0.11)),
}  # fmt: skip
_LEFT: dict[str, tuple[str, tuple[float, float, float]]] = {
    "FHD": ("head", (0.055, 0.12, 0.08)), "BHD": ("head", (0.055, 0.12, -0.085)),
    "ASI": ("pelvis", (0.115, 0.01, 0.085)), "PSI": ("pelvis", (0.045, 0.02, -0.125)),
    "SHO": ("collar", (0.075, 0.07, -0.01)), "UPA": ("shoulder", (0.12, 0.045, 0.0)),
    "ELB": ("elbow", (0.0, 0.01, -0.045)), "FRM": ("elbow", (0.12, 0.03, 0.0)),
    "WRA": ("elbow", (0.245, 0.0, 0.03)), "WRB": ("elbow", (0.245, 0.0, -0.03)),
    "FIN": ("wrist", (0.09, 0.02, 0.0)), "THI": ("hip", (0.10, -0.2, 0.0)),
    "KNE": ("knee", (0.055, 0.0, 0.0)), "TIB": ("knee", (0.055, -0.2, -0.02)),
    "ANK": ("ankle", (0.04, -0.01, -0.005)), "HEE": ("ankle", (0.0, -0.04, -0.065)),
    "TOE": ("ankle", (0.02, -0.03, 0.14)),
}  # fmt: skip


def segments(motion: Motion) -> tuple[tuple[str, ...], Array]:
    """Names of OpenSim's bodies and R_file_body (T,S,3,3), in a world with x forward, y left, z up.

    A body's axes are the ground's (x forward, y up, z right) when a person stands with arms that hang:
    R_file_body = Q R_world_bone N^T C^T with N the bone in that pose. Turned by -90 deg about x, as OpenSim's
    tools do by default for such files (`sensor_to_opensim_rotations`), they are those of its models.
    """
    joints = [JOINTS.index(j) for j in BODIES]
    hanging = pose_bones(np.array(joints), "n", 90.0)
    R = Q_UP @ motion.R_world_joint[:, joints] @ np.swapaxes(hanging, -1, -2) @ C.T
    return tuple(BODIES.values()), np.asarray(R)


def write_orientations(path: str | Path, motion: Motion) -> None:
    """Write the orientation of every segment as `.sto`, for OpenSim's IMU inverse kinematics.

    One column a body, `tibia_r_imu` and so on, quaternions w,x,y,z; see `segments` for world and axes.
    """
    _check(motion)
    bodies, R = segments(motion)
    quats = ori.to_quat(R)
    head = [
        f"DataRate={motion.rate_hz:.6f}", "DataType=Quaternion", "version=3", "OpenSimVersion=4.4",
        "endheader", "\t".join(["time", *(f"{b}_imu" for b in bodies)]),
    ]  # fmt: skip
    rows = (
        "\t".join([f"{t:.8g}", *(",".join(f"{x:.9f}" for x in q) for q in row)])
        for t, row in zip(_times(motion), quats, strict=True)
    )
    _write(path, [*head, *rows])


def seats(skeleton: Skeleton) -> tuple[tuple[str, ...], list[int], Array]:
    """Names of Plug-in Gait's markers, joints that carry them, and places (M,3) m in those joints' axes.

    A marker's centre is `MARKER_M` over the vertex of the free mesh that is nearest to its place in the
    table.
    """
    table = dict(_MIDDLE)
    for side, word, sign in (("L", "left_", 1.0), ("R", "right_", -1.0)):
        for name, (joint, (x, y, z)) in _LEFT.items():
            table[side + name] = (joint if joint in JOINTS else word + joint, (sign * x, y, z))
    joints = [JOINTS.index(joint) for joint, _ in table.values()]
    body = mesh_skin(skeleton)
    scale = skeleton.stature / TABLE_STATURE
    wanted = body.rest[joints] + scale * np.array([at for _, at in table.values()])
    nearest = np.linalg.norm(body.vertices - wanted[:, None], axis=-1).argmin(axis=1)
    skin = body.vertices[nearest] + MARKER_M * body.normals(body.vertices)[nearest]
    return tuple(table), joints, skin - body.rest[joints]


def markers(motion: Motion) -> tuple[tuple[str, ...], Array]:
    """Names and places (T,M,3) m, in OpenSim's ground, of Plug-in Gait's markers and all joint centres.

    Markers are rigid on our bones (`seats`); joint centres have our joints' names.
    """
    names, joints, places = seats(motion.skeleton)
    p = np.concatenate(
        [sensor_positions(motion, np.array(joints), places), motion.p_world_joint], axis=1
    )
    return (*names, *JOINTS), p @ C.T


def write_markers(path: str | Path, motion: Motion) -> None:
    """Write virtual markers (see `markers`) as `.trc`, in millimetres, for OpenSim's scaling and inverse
    kinematics."""
    _check(motion)
    names, p = markers(motion)
    T, M, rate = len(p), len(names), f"{motion.rate_hz:.6f}"
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{T}\t{M}\tmm\t{rate}\t1\t{T}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{m}" for m in range(1, M + 1) for axis in "XYZ"),
        "",
    ]
    rows = (
        "\t".join([str(k + 1), f"{t:.8g}", *(f"{x:.4f}" for x in row)])
        for k, (t, row) in enumerate(zip(_times(motion), 1000 * p.reshape(T, -1), strict=True))
    )
    _write(path, [*head, *rows])


def _check(motion: Motion) -> None:
    if motion.skeleton.names != JOINTS:
        raise ShapeError("OpenSim's tables are written of the 24-joint body only")


def _times(motion: Motion) -> Array:
    return np.asarray(motion.start_s + np.arange(len(motion)) / motion.rate_hz)


def _write(path: str | Path, lines: list[str]) -> None:
    with write_aside(path) as aside, aside.open("w", encoding="utf-8", newline="\n") as f:
        f.writelines(line + "\n" for line in lines)
