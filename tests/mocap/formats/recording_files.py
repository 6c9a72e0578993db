"""Small files of every recording format, written from a known motion, for tests to read back.

Each writer follows the format's public description, not the project's reader.
"""

from __future__ import annotations

import pickle
import struct
import zipfile
from pathlib import Path

import numpy as np
from scipy.io import savemat

from mocap import orientation as ori
from mocap import synthesis
from mocap.formats.native import write_raw, write_recording
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.skeleton import Skeleton
from tests.mocap.formats import rig_files

RATE = 60.0
FRAMES = 240  # of every file, unless told; the fuzz makes them shorter
LEGS = ("pelvis", "left_thigh", "right_thigh", "left_shank", "right_shank")


def motion(T: int | None = None, rate: float = RATE) -> Motion:
    """One second still in the rest pose, then every joint swings, to the same motion at every call."""
    rng = np.random.default_rng(7)
    t = np.arange(T or FRAMES) / rate
    grow = np.clip(t - 1.0, 0, 1)[:, None, None] ** 2
    swing = np.sin(
        2 * np.pi * t[:, None, None] * rng.uniform(0.3, 0.9, (1, 24, 3))
        + rng.uniform(0, 6, (1, 24, 3))
    )
    p = Skeleton.default().offsets[0] + 0.1 * grow[:, 0] * swing[:, 0]
    return Motion(rate, ori.exp(0.5 * grow * swing), p, Skeleton.default())


def raw(sensors: tuple[str, ...] = LEGS, T: int | None = None, rate: float = RATE) -> RawRecording:
    """Virtual raw sensors without noise on `motion`."""
    return synthesis.raw_recording(motion(T, rate), sensors, rng=3)


def recording(sensors: tuple[str, ...] = LEGS, T: int | None = None) -> Recording:
    """Virtual calibrated sensors without noise on `motion`."""
    return synthesis.recording(motion(T), sensors)


def native_recording(folder: Path) -> Path:
    write_recording(folder / "rec.npz", recording())
    return folder / "rec.npz"


def native_raw(folder: Path) -> Path:
    write_raw(folder / "raw.npz", raw())
    return folder / "raw.npz"


QMT = {
    "hip": "pelvis", "upper_leg_left": "left_thigh", "upper_leg_right": "right_thigh",
    "lower_leg_left": "left_shank", "lower_leg_right": "right_shank",
}  # fmt: skip


def qmt_data(rec: RawRecording) -> dict[str, object]:
    """Variables of a qmt file: segment quaternions of the reference, in a z-up world."""
    assert rec.reference is not None
    R_world_bone = synthesis.recording(rec.reference, rec.sensors).R_world_bone
    data: dict[str, object] = {"t": 40 + np.arange(len(rec))[:, None] / rec.rate_hz}
    for theirs, ours in QMT.items():
        s = rec.sensors.index(ours)
        quat = ori.to_quat(ori.R_ZUP_YUP @ R_world_bone[:, s])
        data[theirs] = {"acc": rec.acc[:, s], "gyr": rec.gyr[:, s], "quat": quat}
    return data


def qmt(folder: Path, data: dict[str, object] | None = None) -> Path:
    savemat(
        folder / "body.mat", data or qmt_data(raw(rate=100.0, T=FRAMES + 160)), do_compression=True
    )
    return folder / "body.mat"


OPENSIM = {
    "pelvis": "pelvis_imu", "left_thigh": "femur_l_imu", "right_thigh": "femur_r_imu",
    "left_shank": "tibia_l_imu", "right_shank": "tibia_r_imu",
}  # fmt: skip


def sto_text(rec: RawRecording) -> str:
    assert rec.R_world_sensor is not None
    quat = ori.to_quat(ori.R_ZUP_YUP @ rec.R_world_sensor)
    lines = ["DataType=Quaternion", "version=3", "OpenSimVersion=4.1", "endheader"]
    lines.append("time\t" + "\t".join(OPENSIM[n] for n in rec.sensors))
    for t, row in enumerate(quat):
        cells = (",".join(f"{v:.12g}" for v in q) for q in row)
        lines.append(f"{t / rec.rate_hz:.6f}\t" + "\t".join(cells))
    return "\n".join(lines) + "\n"


def sto(folder: Path) -> Path:
    (folder / "imu.sto").write_text(sto_text(raw()))
    return folder / "imu.sto"


_MTW_COLUMNS = (
    "PacketCounter", "SampleTimeFine", "Year", "Acc_X", "Acc_Y", "Acc_Z", "Mat[1][1]", "Mat[2][1]",
    "Mat[3][1]", "Mat[1][2]", "Mat[2][2]", "Mat[3][2]", "Mat[1][3]", "Mat[2][3]", "Mat[3][3]",
)  # fmt: skip
MAPPING = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000"><XsensDataReaderSettings><trial_prefix>MT_trial</trial_prefix>
<ExperimentalSensors>
{}
</ExperimentalSensors></XsensDataReaderSettings></OpenSimDocument>
"""


def mtw_text(rec: RawRecording, s: int, first_packet: int = 65500) -> str:
    """One sensor's export; the packet counter wraps on the way."""
    assert rec.R_world_sensor is not None
    R = ori.R_ZUP_YUP @ rec.R_world_sensor[:, s]
    lines = [
        "// Start Time: Unknown",
        f"// Update Rate: {rec.rate_hz:.1f}Hz",
        "\t".join(_MTW_COLUMNS),
    ]
    for t in range(len(rec)):
        packet = (first_packet + t) % 65536
        values = [*rec.acc[t, s], *R[t].T.ravel()]
        lines.append(f"{packet:05d}\t\t\t" + "\t".join(f"{v:.6f}" for v in values))
    return "\n".join(lines) + "\n"


def mtw(folder: Path) -> Path:
    rec = raw()
    out = folder / "trial"
    out.mkdir(exist_ok=True)
    names = []
    for s, name in enumerate(rec.sensors):
        device = f"00B4{s:04d}"
        (out / f"MT_trial_{device}.txt").write_text(mtw_text(rec, s))
        names.append(
            f'<ExperimentalSensor name="_{device}"><name_in_model>{OPENSIM[name]}</name_in_model>'
            f"</ExperimentalSensor>"
        )
    (out / "mapping.xml").write_text(MAPPING.format("\n".join(names)))
    return out


MVN_SEGMENTS = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head", "RightShoulder", "RightUpperArm",
    "RightForeArm", "RightHand", "LeftShoulder", "LeftUpperArm", "LeftForeArm", "LeftHand",
    "RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToe", "LeftUpperLeg", "LeftLowerLeg",
    "LeftFoot", "LeftToe",
)  # fmt: skip
# Joint of ours whose rotation a segment of the written file has.
MVN_JOINT = dict(
    zip(
        MVN_SEGMENTS,
        (0, 3, 3, 6, 9, 12, 15, 14, 17, 19, 21, 13, 16, 18, 20, 2, 5, 8, 11, 1, 4, 7, 10),
        strict=True,
    )
)
MVN_SENSORS = {
    "Pelvis": "pelvis", "T8": "sternum", "Head": "head", "RightForeArm": "right_forearm",
    "LeftForeArm": "left_forearm", "RightLowerLeg": "right_shank", "LeftLowerLeg": "left_shank",
}  # fmt: skip
_MVN_OURS = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # v_mvn = _MVN_OURS v_ours


def mvn_motion() -> Motion:
    """`motion` with the joints that MVN has no segment for held still against their parents."""
    m = motion()
    R = np.array(m.R_parent_joint)
    R[:, [22, 23]] = np.eye(3)
    return Motion(m.rate_hz, R, m.p_world_root, m.skeleton)


def mvnx_text(sensors: bool = True) -> str:
    m = mvn_motion()
    rec = synthesis.recording(m, tuple(MVN_SENSORS.values()))
    rng = np.random.default_rng(2)
    mount = ori.from_quat(rng.normal(size=(len(MVN_SENSORS), 4)))
    joints = [MVN_JOINT[n] for n in MVN_SEGMENTS]
    straight = rig_files.straight(m.skeleton.rest_positions)  # MVN's T-pose has straight limbs
    R_segment = _MVN_OURS @ (m.R_world_joint @ straight)[:, joints] @ _MVN_OURS.T
    p = m.p_world_joint[:, joints] @ _MVN_OURS.T
    p[:, 0] = m.p_world_joint[:, [1, 2]].mean(axis=1) @ _MVN_OURS.T
    rest = m.skeleton.rest_positions[joints] @ _MVN_OURS.T
    R_sensor = _MVN_OURS @ rec.R_world_bone @ mount @ _MVN_OURS.T
    acc = rec.acc_world @ _MVN_OURS.T
    out = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">',
    ]
    out.append(
        f'<mvn version="2022"/><subject label="a" frameRate="{RATE:g}" segmentCount="23"><segments>'
    )
    out += [
        f'<segment label="{n}" id="{i + 1}"><points/></segment>' for i, n in enumerate(MVN_SEGMENTS)
    ]
    out.append("</segments>")
    if sensors:
        out += ["<sensors>", *(f'<sensor label="{n}"/>' for n in MVN_SENSORS), "</sensors>"]
    out.append('<frames segmentCount="23">')
    identity = " ".join(["1 0 0 0"] * 23)
    out.append(_mvn_frame("identity", 0, identity, _numbers(rest), "", ""))
    for t in range(len(m)):
        quats = _numbers(ori.to_quat(R_segment[t]))
        free = _numbers(acc[t]) if sensors else ""
        own = _numbers(ori.to_quat(R_sensor[t])) if sensors else ""
        out.append(_mvn_frame("normal", round(1000 * t / RATE), quats, _numbers(p[t]), free, own))
    return "\n".join([*out, "</frames></subject></mvnx>"]) + "\n"


def _numbers(x: np.ndarray) -> str:
    return " ".join(f"{v:.7g}" for v in np.ravel(x))


def _mvn_frame(kind: str, ms: int, quat: str, p: str, free: str, own: str) -> str:
    sensors = (
        f"<sensorFreeAcceleration>{free}</sensorFreeAcceleration>"
        f"<sensorOrientation>{own}</sensorOrientation>"
        if free
        else ""
    )
    return (
        f'<frame time="{ms}" index="{ms}" type="{kind}"><orientation>{quat}</orientation>'
        f"<position>{p}</position>{sensors}</frame>"
    )


def mvnx(folder: Path) -> Path:
    (folder / "take.mvnx").write_text(mvnx_text())
    return folder / "take.mvnx"


def csv_lines(
    rec: RawRecording, sensors: tuple[str, ...], prefix: bool = True, header: str = ""
) -> list[str]:
    """Header comment, column names, rows, of these sensors; quaternions to a z-up world."""
    assert rec.R_world_sensor is not None
    quat = ori.to_quat(ori.R_ZUP_YUP @ rec.R_world_sensor)
    kinds = (("acc", "xyz", rec.acc), ("gyr", "xyz", rec.gyr), ("quat", "wxyz", quat))
    names, blocks = ["t"], [np.arange(len(rec))[:, None] / rec.rate_hz]
    for n in sensors:
        for kind, axes, values in kinds:
            names += [f"{n}.{kind}_{a}" if prefix else f"{kind}_{a}" for a in axes]
            blocks.append(values[:, rec.sensors.index(n)])
    rows = np.concatenate(blocks, axis=1)
    text = ["# " + (header or "acc: m/s^2, gyr: rad/s, world: z-up"), ",".join(names)]
    return text + [",".join(f"{v:.9g}" for v in row) for row in rows]


def csv_wide(folder: Path) -> Path:
    rec = raw()
    (folder / "wide.csv").write_text("\n".join(csv_lines(rec, rec.sensors)) + "\n")
    return folder / "wide.csv"


def csv_folder(folder: Path) -> Path:
    rec = raw()
    out = folder / "table"
    out.mkdir(exist_ok=True)
    for n in rec.sensors:
        (out / f"{n}.csv").write_text("\n".join(csv_lines(rec, (n,), prefix=False)) + "\n")
    return out


def watch_lines(rec: RawRecording, s: int = 0) -> list[str]:
    """Sensor Logger's WristMotion.csv of one sensor: gravity apart, a quaternion to a z-up world."""
    assert rec.R_world_sensor is not None
    R = ori.R_ZUP_YUP @ rec.R_world_sensor[:, s]
    gravity = ori.GRAVITY * R[:, 2]  # R^T e_z
    seconds = np.arange(len(rec)) / rec.rate_hz
    lines = [
        "time,seconds_elapsed,rotationRateX,rotationRateY,rotationRateZ,gravityX,gravityY,gravityZ,"
        "accelerationX,accelerationY,accelerationZ,quaternionW,quaternionX,quaternionY,quaternionZ"
    ]
    blocks = (rec.gyr[:, s], gravity, rec.acc[:, s] - gravity, ori.to_quat(R))
    for t, row in zip(seconds, np.concatenate(blocks, axis=1), strict=True):
        stamp = 1_700_000_000_000_000_000 + round(t * 1e9)
        lines.append(f"{stamp},{t:.6f}," + ",".join(f"{v:.9g}" for v in row))
    return lines


def watch(folder: Path) -> Path:
    (folder / "WristMotion.csv").write_text("\n".join(watch_lines(raw())) + "\n")
    return folder / "WristMotion.csv"


DIP_17 = (
    "head", "sternum", "pelvis", "left_shoulder_blade", "right_shoulder_blade", "left_upper_arm",
    "right_upper_arm", "left_forearm", "right_forearm", "left_thigh", "right_thigh", "left_shank",
    "right_shank", "left_hand", "right_hand", "left_foot", "right_foot",
)  # fmt: skip


def dip_data(T: int | None = None) -> dict[str, np.ndarray]:
    """Variables of a DIP-IMU file, with the accelerations it lacks at both ends as NaN."""
    rec = recording(DIP_17, T)
    assert rec.reference is not None
    return {"imu_ori": np.array(rec.R_world_bone), "imu_acc": np.array(rec.acc_world),
            "gt": rec.reference.poses}  # fmt: skip


def dip(folder: Path, data: object = None) -> Path:
    # Protocol 2, as Python 2 wrote them.
    (folder / "01.pkl").write_bytes(pickle.dumps(data or dip_data(), protocol=2))
    return folder / "01.pkl"


MAJOR = [1, 2, 3, 4, 5, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19]
SIX = ("left_forearm", "right_forearm", "left_shank", "right_shank", "head", "pelvis")


def dip_npz_data(clips: int = 2) -> dict[str, list[np.ndarray]]:
    """Sequences of the npz release: five sensors against the pelvis, 15 joints as flat matrices."""
    rec = recording(SIX)
    assert rec.reference is not None
    to_root = np.swapaxes(rec.R_world_bone[:, 5:], -1, -2)
    R = to_root @ rec.R_world_bone[:, :5]
    acc = np.einsum("tsij,tsj->tsi", to_root, rec.acc_world[:, :5] - rec.acc_world[:, 5:])
    pose = rec.reference.R_parent_joint[:, MAJOR]
    T = len(rec)
    use = slice(1, T - 1)
    return {
        "orientation": [R[use].reshape(T - 2, 45)] * clips,
        "acceleration": [acc[use].reshape(T - 2, 15)] * clips,
        "smpl_pose": [pose[use].reshape(T - 2, 135)] * clips,
    }


def objects(items: list[object]) -> np.ndarray:
    """A one-dimensional array of objects, which numpy stores as a pickle."""
    out = np.empty(len(items), object)
    for i, item in enumerate(items):
        out[i] = item
    return out


def dip_npz(folder: Path) -> Path:
    arrays = {k: objects(v) for k, v in dip_npz_data().items()}  # type: ignore[arg-type]
    np.savez(folder / "own_test.npz", **arrays, data_id=np.arange(2), file_id=np.array(["a", "b"]))
    return folder / "own_test.npz"


TC_SENSORS = {
    "Head": "head", "Sternum": "sternum", "Pelvis": "pelvis", "L_UpArm": "left_upper_arm",
    "R_UpArm": "right_upper_arm", "L_LowArm": "left_forearm", "R_LowArm": "right_forearm",
    "L_UpLeg": "left_thigh", "R_UpLeg": "right_thigh", "L_LowLeg": "left_shank",
    "R_LowLeg": "right_shank", "L_Foot": "left_foot", "R_Foot": "right_foot",
}  # fmt: skip
_TC_BONE = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])
_TC_WORLD = np.diag([-1.0, 1, -1])
TC_JOINTS = {"Hips": 0, "Spine": 3, "RightArm": 17, "RightForeArm": 19, "RightHand": 21,
             "LeftArm": 16, "LeftForeArm": 18, "LeftHand": 20, "RightUpLeg": 2, "RightLeg": 5,
             "RightFoot": 8, "LeftUpLeg": 1, "LeftLeg": 4, "LeftFoot": 7}  # fmt: skip


def totalcapture(folder: Path, calibrated: bool = True, extra: int = 2) -> Path:
    """`.sensors`, calibration and positions such that the reader's formulas give `recording` back.

    R_M_B = R_I_M^T R_I_S R_S_B with R_S_B = R(q_bone)^T bone and R_I_M = R(q_ref)^T world. The position
    file has `extra` frames more at its start.
    """
    m = motion()
    rec = synthesis.recording(m, tuple(TC_SENSORS.values()))
    rng = np.random.default_rng(5)
    S = len(TC_SENSORS)
    R_M_I = np.tile(ori.rot_y(0.4) @ ori.R_YUP_ZUP, (S, 1, 1))  # the inertial world is z-up
    R_S_B = ori.from_quat(rng.normal(size=(S, 4)))
    R_I_S = np.swapaxes(R_M_I, -1, -2) @ rec.R_world_bone @ np.swapaxes(R_S_B, -1, -2)
    acc_world = np.array(rec.acc_world)
    acc_world[[0, -1]] = acc_world[[1, -2]]
    force = acc_world + np.array([0, ori.GRAVITY, 0])
    acc = np.einsum("tsji,tsj->tsi", R_M_I @ R_I_S, force)
    gyr = np.zeros_like(acc)
    gyr[1:] = ori.log(np.swapaxes(R_I_S[:-1], -1, -2) @ R_I_S[1:]) * RATE
    lines = [f"{S}\t{len(m)}"]
    quat = ori.to_quat(R_I_S)
    for t in range(len(m)):
        lines.append(f"{t + 1}")
        for s, name in enumerate(TC_SENSORS):
            values = [*quat[t, s], *acc[t, s], *gyr[t, s], 0.1, 0.2, 0.3]
            lines.append(name + "\t" + "\t".join(f"{v:.8g}" for v in values))
    path = folder / "s1_acting1_Xsens_AuxFields.sensors"
    path.write_text("\n".join(lines) + "\n")
    if calibrated:
        # R_S_B = R(q)^T bone  <=>  R(q) = bone R_S_B^T; R_M_I^T = R(q)^T world <=> R(q) = world R_M_I.
        _tc_calibration(
            folder / "s1_acting1_calib_imu_bone.txt", _TC_BONE @ np.swapaxes(R_S_B, -1, -2)
        )
        _tc_calibration(folder / "s1_acting1_calib_imu_ref.txt", _TC_WORLD @ R_M_I)
        _tc_positions(folder / "gt_skel_gbl_pos.txt", m, extra)
    return path


def _tc_calibration(path: Path, R: np.ndarray) -> None:
    lines = [f"{len(R)}"]
    for name, q in zip(TC_SENSORS, ori.to_quat(R, scalar_first=False), strict=True):
        lines.append(name + " " + " ".join(f"{v:.9g}" for v in q))
    path.write_text("\n".join(lines) + "\n")


def _tc_positions(path: Path, m: Motion, extra: int) -> None:
    p = m.p_world_joint[:, list(TC_JOINTS.values())] * [-1, 1, -1] / 0.0254
    p = np.concatenate([np.repeat(p[:1], extra, axis=0), p])
    lines = ["\t".join(TC_JOINTS)]
    lines += ["\t".join(" ".join(f"{v:.7g}" for v in q) for q in row) for row in p]
    path.write_text("\n".join(lines) + "\n")


TC_PKL = ("left_shank", "right_shank", "left_forearm", "right_forearm", "head", "pelvis")


def tc_pkl_data() -> dict[str, np.ndarray]:
    rec = recording(TC_PKL)
    assert rec.reference is not None
    return {"ori": np.array(rec.R_world_bone), "acc": np.array(rec.acc_world)[:-1],
            "gt": rec.reference.poses}  # fmt: skip


def tc_pkl(folder: Path, data: object = None) -> Path:
    if data is None:
        data = tc_pkl_data()
        data["ori"] = data["ori"][:-1]  # one frame fewer than the poses
    (folder / "s1_acting1.pkl").write_bytes(pickle.dumps(data, protocol=2))
    return folder / "s1_acting1.pkl"


class Evil:
    """Unpickled without care, this would write a file."""

    def __init__(self, target: Path):
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return Path.write_text, (self.target, "executed")


class LyingArray:
    """Pickled as an array of doubles that declares `shape` and holds eight bytes."""

    def __init__(self, shape: tuple[int, ...]):
        self.shape = shape

    def __reduce__(self) -> tuple[object, ...]:
        make, arguments, state = np.zeros(1).__reduce__()  # type: ignore[misc]
        return make, arguments, (state[0], self.shape, *state[2:])


def lying_npy(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    """An .npy member that declares `shape` and holds eight bytes."""
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(8)


def with_member(source: Path, target: Path, name: str, data: bytes) -> Path:
    """A copy of an archive in which one member holds other bytes."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for item in old.namelist():
            new.writestr(item, data if item == name else old.read(item))
    return target
