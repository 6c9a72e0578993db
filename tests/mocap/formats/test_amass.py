"""AMASS files: what is written is what is read, and where the pelvis lies in either world."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError, ShapeError
from mocap.formats import Options, _npz, amass
from mocap.motion import Motion
from mocap.skeleton import REST, Skeleton
from tests.mocap.formats import broken
from tests.mocap.formats.recording_files import Evil, lying_npy, objects, with_member


def a_motion(
    rng: np.random.Generator, rate_hz: float = 60.0, body: Skeleton | None = None, T: int = 30
) -> Motion:
    """A random walk on all joints, of every angle up to pi."""
    w = np.cumsum(rng.normal(0, 0.3, (T, 24, 3)), axis=0)
    return Motion(rate_hz, ori.exp(w), rng.normal(0, 2, (T, 3)), body or Skeleton.default())


def a_file(path: Path, poses: object, **fields: object) -> Path:
    """An archive as AMASS has it."""
    T = len(poses) if isinstance(poses, np.ndarray) else 3
    given = {"poses": poses, "trans": np.zeros((T, 3)), "gender": "male",
             "mocap_framerate": 120.0, "betas": np.zeros(16), "dmpls": np.zeros((T, 8))}  # fmt: skip
    given |= fields
    np.savez(path, **{k: v for k, v in given.items() if v is not None})  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("rate_hz", [59.0, 60.0, 100.0, 120.0, 59.94])
@pytest.mark.parametrize("height", [None, 1.55])
def test_a_motion_returns(
    rng: np.random.Generator, tmp_path: Path, rate_hz: float, height: float | None
) -> None:
    first = a_motion(rng, rate_hz, Skeleton.default(height))
    amass.write_motion(tmp_path / "m.npz", first)
    back = amass.read_motion(tmp_path / "m.npz")
    assert back.rate_hz == rate_hz
    np.testing.assert_allclose(back.R_parent_joint, first.R_parent_joint, atol=1e-12)
    np.testing.assert_allclose(back.p_world_joint, first.p_world_joint, atol=1e-12)
    assert formats.read(tmp_path / "m.npz").format == "amass"


def test_bones_of_a_solved_body_return(rng: np.random.Generator, tmp_path: Path) -> None:
    table = Skeleton.default()
    body = table.with_offsets(table.offsets * rng.normal(1, 0.05, (24, 1)))
    first = a_motion(rng, body=body)
    amass.write_motion(tmp_path / "m.npz", first)
    back = amass.read_motion(tmp_path / "m.npz")
    np.testing.assert_allclose(back.p_world_joint, first.p_world_joint, atol=1e-12)
    # A height that the user tells replaces the file's body.
    tall = amass.read_motion(tmp_path / "m.npz", Options(height=1.9))
    assert tall.skeleton.stature == pytest.approx(1.9, abs=1e-9)


def test_the_file_is_the_contract(rng: np.random.Generator, tmp_path: Path) -> None:
    first = a_motion(rng)
    amass.write_motion(tmp_path / "m.npz", first, {"floor": np.array([0.0, 1.0])})
    with np.load(tmp_path / "m.npz", allow_pickle=False) as f:
        assert f["poses"].shape == (30, 156) and f["trans"].shape == (30, 3)
        for name in ("poses", "trans", "betas", "mocap_framerate"):
            assert f[name].dtype == np.float64
        assert str(f["gender"]) == "neutral" and f["mocap_framerate"] == 60.0
        assert list(f["floor"]) == [0.0, 1.0] and "height" not in f and "offsets" not in f
        # Fingers are zero but for the first joint of each hand, our joints 22 and 23.
        hand = first.poses.reshape(30, 24, 3)
        np.testing.assert_allclose(f["poses"][:, 66:69], hand[:, 22], atol=1e-12)
        np.testing.assert_allclose(f["poses"][:, 111:114], hand[:, 23], atol=1e-12)
        assert not f["poses"][:, 69:111].any() and not f["poses"][:, 114:].any()


def test_a_frame_by_hand(tmp_path: Path) -> None:
    """A body upright in AMASS's world (z up): Rx(90 deg) there is the identity here.

    Its pelvis lies at J0 + trans = J0 + (1, 2, 3), so ours at A^T of that: (x, z, -y). It faces
    AMASS's -y, our +z. The left elbow is bent by 90 deg about its local y.
    """
    poses = np.zeros((1, 156))
    poses[0, 0] = np.pi / 2
    poses[0, 3 * 18 + 1] = -np.pi / 2
    m = amass.read_motion(a_file(tmp_path / "m.npz", poses, trans=[[1.0, 2, 3]]))
    x, y, z = REST[0] + (1.0, 2.0, 3.0)
    np.testing.assert_allclose(m.p_world_root[0], (x, z, -y), atol=1e-12)
    np.testing.assert_allclose(m.R_world_joint[0, 15], np.eye(3), atol=1e-12)
    # A forearm along +x turned by -90 deg about y points along +z, forward.
    arm = m.p_world_joint[0, 20] - m.p_world_joint[0, 18]
    offset = REST[20] - REST[18]
    np.testing.assert_allclose(arm, (-offset[2], offset[1], offset[0]), atol=1e-12)


def test_the_body_does_not_sink(tmp_path: Path) -> None:
    """`trans` is no point: mapping it alone would put the pelvis |A^T J0 - J0| = 0.32 m off."""
    J0 = Skeleton.default().offsets[0]
    wrong = np.linalg.norm(ori.R_YUP_ZUP @ J0 - J0)
    assert wrong == pytest.approx(0.32, abs=0.005)
    upright = np.zeros((1, 156))
    upright[0, 0] = np.pi / 2
    # In AMASS's world SMPL's own forward pass gives R_root (j - J0) + J0 + trans for each joint.
    trans = np.array([[0.3, -0.2, 0.9]])
    R_amass = ori.rot_x(np.pi / 2)
    smpl = (REST - J0) @ R_amass.T + J0 + trans
    m = amass.read_motion(a_file(tmp_path / "m.npz", upright, trans=trans))
    np.testing.assert_allclose(m.p_world_joint[0], smpl @ ori.R_YUP_ZUP.T, atol=1e-12)


@pytest.mark.parametrize(
    ("columns", "left", "right"), [(72, 66, 69), (156, 66, 111), (165, 75, 120)]
)
def test_hand_columns(
    rng: np.random.Generator, tmp_path: Path, columns: int, left: int, right: int
) -> None:
    """The hands' first joints; in SMPL-X files jaw and eyes stand before them."""
    poses = rng.normal(0, 0.4, (4, columns))
    m = amass.read_motion(a_file(tmp_path / "m.npz", poses))
    np.testing.assert_allclose(m.poses[:, 3:66], poses[:, 3:66], atol=1e-12)
    np.testing.assert_allclose(m.poses[:, 66:69], poses[:, left : left + 3], atol=1e-12)
    np.testing.assert_allclose(m.poses[:, 69:], poses[:, right : right + 3], atol=1e-12)


def test_what_newer_and_older_files_name(tmp_path: Path) -> None:
    poses = np.zeros((3, 156))
    new = a_file(tmp_path / "a.npz", poses, mocap_framerate=None, mocap_frame_rate=np.array(100))
    assert amass.read_motion(new).rate_hz == 100.0
    none = a_file(tmp_path / "b.npz", poses, mocap_framerate=None)
    assert amass.read_motion(none, Options(rate_hz=90.0)).rate_hz == 90.0
    shaped = formats.read(a_file(tmp_path / "c.npz", poses, betas=np.ones(16)))
    assert "neutral mean shape" in shaped.assumptions[0]
    assert "--up y" in shaped.warnings[0], "an unturned root lies on its back in AMASS's world"


def layouts(poses: np.ndarray, trans: np.ndarray) -> dict[str, tuple[dict[str, object], str]]:
    """One motion of 72 columns without hands, under the names and shapes of other tools."""
    root, body, T = poses[:, :3], poses[:, 3:66], len(poses)
    hands = np.zeros((T, 90))
    return {
        "66 columns": ({"poses": poses[:, :66], "trans": trans, "fps": 50}, "no hands"),
        "joints of three": ({"poses": poses.reshape(T, 24, 3), "trans": trans, "fps": 50}, ""),
        "52 joints": (
            {"poses": np.c_[poses[:, :66], hands].reshape(T, 52, 3), "trans": trans, "fps": 50},
            "",
        ),
        "SMPL-X release": (
            {"root_orient": root, "pose_body": body, "trans": trans, "mocap_frame_rate": 50},
            "root_orient, pose_body",
        ),
        "with hands": (
            {"root_orient": root, "pose_body": body, "pose_hand": hands, "trans": trans, "fps": 50},
            "root_orient, pose_body, pose_hand",
        ),
        "from video": (
            {"global_orient": root, "body_pose": body, "transl": trans, "frame_rate": 50,
             "betas": np.zeros((T, 10))},
            "global_orient, body_pose",
        ),
        "from video, SMPL": (
            {"global_orient": root, "body_pose": poses[:, 3:], "transl": trans, "fps": 50},
            "global_orient, body_pose",
        ),
        "one person of a batch": (
            {"global_orient": root[None], "body_pose": body.reshape(1, T, 21, 3),
             "transl": trans[None], "fps": 50},
            "global_orient, body_pose",
        ),
        "AIST++": (
            {"smpl_poses": poses, "smpl_trans": 90 * trans, "smpl_scaling": np.array([90.0]), "fps": 50},
            "smpl_trans is divided by smpl_scaling, 90",
        ),
    }  # fmt: skip


LAYOUTS = tuple(layouts(np.zeros((2, 72)), np.zeros((2, 3))))


@pytest.mark.parametrize("pickled", [False, True])
@pytest.mark.parametrize("name", LAYOUTS)
def test_other_names_and_shapes_are_the_same_motion(
    rng: np.random.Generator, tmp_path: Path, name: str, pickled: bool
) -> None:
    poses = np.cumsum(rng.normal(0, 0.05, (20, 72)), axis=0)
    poses[:, 66:] = 0
    trans = rng.normal(0, 1, (20, 3))
    fields, said = layouts(poses, trans)[name]
    if pickled and "poses" in fields:
        pytest.skip("a pickle of the field `poses` alone is no known tool's")
    want = amass.read_motion(a_file(tmp_path / "w.npz", poses, trans=trans, mocap_framerate=50.0))
    path = tmp_path / ("m.pkl" if pickled else "m.npz")
    if pickled:
        path.write_bytes(pickle.dumps(fields))
    else:
        np.savez(path, **{k: np.asarray(v) for k, v in fields.items()})  # type: ignore[arg-type]
    doc = formats.read(path)
    assert isinstance(doc.content, Motion) and doc.content.rate_hz == 50.0
    np.testing.assert_allclose(doc.content.R_parent_joint, want.R_parent_joint, atol=1e-12)
    np.testing.assert_allclose(doc.content.p_world_root, want.p_world_root, atol=1e-12)
    assert any(said in a for a in (*doc.assumptions, ""))


def test_a_rate_that_nobody_says_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    np.savez(path, smpl_poses=np.zeros((3, 72)), smpl_trans=np.zeros((3, 3)), smpl_scaling=90.0)
    with pytest.raises(FormatError, match="say it with --rate HZ; AIST"):
        formats.read(path)
    assert formats.read(path, Options(rate_hz=60.0)).content.rate_hz == 60.0


def test_lengths_of_pose_and_path_must_agree(tmp_path: Path) -> None:
    path, R, b = tmp_path / "m.npz", np.zeros((3, 3)), np.zeros((4, 63))
    np.savez(path, root_orient=R, pose_body=b, trans=R, fps=30)
    with pytest.raises(FormatError, match="frames of root_orient 3 and pose_body 4"):
        formats.read(path)
    np.savez(path, root_orient=R, pose_body=b[:3], trans=b[:, :3], fps=30)
    with pytest.raises(FormatError, match=r"'trans': has shape \(4, 3\), expected \(3, 3\)"):
        formats.read(path)
    np.savez(path, smpl_poses=np.zeros((3, 72)), smpl_trans=R, smpl_scaling=0.0, fps=30)
    with pytest.raises(FormatError, match="'smpl_scaling': is 0, expected above zero"):
        formats.read(path)


def test_a_shape_that_changes_is_averaged_and_said(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    betas = np.zeros((3, 10))
    betas[:, 0] = 0.0, 1.0, 2.0
    R = np.zeros((3, 3))
    np.savez(path, global_orient=R, body_pose=np.zeros((3, 63)), transl=R, fps=30, betas=betas)
    doc = formats.read(path)
    assert isinstance(doc.content, Motion) and doc.content.skeleton.betas[0] == pytest.approx(1.0)
    assert any("betas change" in a for a in doc.assumptions)


def test_extras_stay_out_of_the_format(rng: np.random.Generator, tmp_path: Path) -> None:
    for extra in ({"poses": np.zeros(3)}, {"things": np.array([{}], object)}):
        with pytest.raises(ShapeError, match="cannot be stored"):
            amass.write_motion(tmp_path / "m.npz", a_motion(rng), extra)
    assert not list(tmp_path.iterdir())


BROKEN: dict[str, tuple[dict[str, object], str]] = {
    "63 columns": ({"poses": np.zeros((3, 63))}, r"'poses': has shape \(3, 63\), expected \(T, 66\)"),
    "no frames": ({"poses": np.zeros((0, 156))}, "has shape"),
    "three axes": ({"poses": np.zeros((3, 2, 78))}, "has shape"),
    "nan": ({"poses": np.full((3, 156), np.nan)}, "frame 0, field 'poses': is nan, expected radians"),
    "in degrees": ({"poses": np.full((3, 156), 90.0)}, "is 90, expected radians"),
    "trans inf": ({"trans": np.full((3, 3), np.inf)}, "field 'trans': is inf, expected metres"),
    "trans longer": ({"trans": np.zeros((4, 3))}, r"'trans': has shape \(4, 3\), expected \(3, 3\)"),
    "no trans": ({"trans": None}, "'trans' is missing"),
    "no poses": ({"poses": None}, "'poses' is missing"),
    "text": ({"poses": np.array([["a"] * 156])}, "expected real numbers"),
    "pickle": ({"poses": np.array([{}], object)}, "pickled objects, which are never loaded"),
    "rate zero": ({"mocap_framerate": 0.0}, "rate_hz must lie between"),
    "rate nan": ({"mocap_framerate": np.nan}, "expected a finite number"),
    "no rate": ({"mocap_framerate": None}, "no frame rate"),
    "betas nan": ({"betas": np.full(16, np.nan)}, "no shape of finite numbers"),
    "a giant": ({"height": np.array(17.5)}, r"height 17\.5 m is outside"),
    "bones of 4": ({"offsets": np.zeros((24, 4))}, r"has shape \(24, 4\)"),
}  # fmt: skip


def in_file(fields: dict[str, object]) -> broken.Break:
    return lambda d: a_file(d / "m.npz", **{"poses": np.zeros((3, 156)), **fields})  # type: ignore[arg-type]


def evil(folder: Path) -> Path:
    """An array that would write a file when unpickled."""
    return in_file({"poses": objects([Evil(folder / "executed")])})(folder)


def lying(folder: Path) -> Path:
    return with_member(
        in_file({})(folder), folder / "lie.npz", "poses.npy", lying_npy((10**12, 156))
    )


CASES: broken.Cases = {name: (in_file(fields), said) for name, (fields, said) in BROKEN.items()} | {
    "cut": (lambda d: broken.cut(in_file({})(d), 0.5), "damaged or cut short"),
    "empty": (lambda d: broken.cut(in_file({})(d), 0.0), "damaged or cut short"),
    "malicious": (evil, "pickled objects, which are never loaded"),
    "huge count": (lying, "declares"),
}


@pytest.mark.parametrize("case", CASES)
def test_broken_files(tmp_path: Path, case: str) -> None:
    make, message = CASES[case]
    broken.must_fail(make(tmp_path), amass.FORMAT, message)
    assert not (tmp_path / "executed").exists()


def test_centimetres_are_doubted(tmp_path: Path) -> None:
    """A walk of 1.3 m/s written in cm flies at 130 m/s."""
    trans = np.zeros((30, 3))
    trans[:, 0] = 1.3 * np.arange(30) / 120
    path = a_file(tmp_path / "m.npz", np.zeros((30, 156)), trans=trans)
    assert not any("metres" in w for w in formats.read(path).warnings)
    path = a_file(tmp_path / "m.npz", np.zeros((30, 156)), trans=100 * trans)
    said = formats.read(path).warnings
    assert any("moves at 130 m/s (median): trans may not be in metres" in w for w in said)


@pytest.mark.parametrize("keep", [0.05, 0.5, 0.99])
def test_a_file_cut_short(rng: np.random.Generator, tmp_path: Path, keep: float) -> None:
    amass.write_motion(tmp_path / "m.npz", a_motion(rng))
    path = broken.cut(tmp_path / "m.npz", keep)
    broken.must_fail(path, amass.FORMAT, "damaged or cut short")
    with pytest.raises(FormatError, match="cut short"):
        formats.read(path)


def test_a_long_still_motion_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour of one pose packs to almost nothing, and is still no bomb to the reader."""
    monkeypatch.setattr(_npz, "BOMB_BYTES", 1 << 18)  # as if 400 frames were an hour
    T = 400
    still = Motion(60.0, np.tile(np.eye(3), (T, 24, 1, 1)), np.zeros((T, 3)), Skeleton.default())
    amass.write_motion(tmp_path / "m.npz", still)
    assert len(amass.read_motion(tmp_path / "m.npz")) == T
    with np.load(tmp_path / "m.npz") as f:
        np.savez_compressed(tmp_path / "m.npz", **dict(f))
    with pytest.raises(FormatError, match="packed in"):
        amass.read_motion(tmp_path / "m.npz")
