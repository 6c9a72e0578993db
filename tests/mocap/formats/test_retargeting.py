"""One motion is one pose, whatever tool wrote the file: files of our own making, and CMU's trials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap import faults, formats
from mocap import orientation as ori
from mocap.formats import Document, Options, _upright, bvh
from mocap.motion import Motion
from mocap.skeleton import JOINTS
from tests.mocap.formats import motion_files as files
from tests.mocap.formats import rig_files as rigs

J = {name: j for j, name in enumerate(JOINTS)}
SIDES = ("left", "right")
LIMBS = ("hip", "knee", "shoulder", "elbow")
NEXT = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist"}
# Degrees that a joint may be off where a form cannot carry more: a spine of two joints bends evenly, one of
# four ours are read between; the Daz figure has no toes.
TWO = {"spine1": 8.0, "spine2": 16.0}
TOLERANCE: dict[str, dict[str, float]] = {
    "amc": {}, "motionbuilder": {}, "mixamo": {}, "mvnx": {},
    "xsens-bvh": {"spine2": 8.0},
    "along-x": TWO, "bandai": TWO,
    "daz": TWO | {"left_foot": 60.0, "right_foot": 60.0},
}  # fmt: skip
# Their constants are found from the file (or stated to a tenth of a degree).
EXACT = 0.01
ROUNDED = {"daz": 1.5, "bandai": 1.5}  # constants of these files are whole degrees


@pytest.fixture(scope="module")
def motion() -> Motion:
    return rigs.a_motion()


@pytest.fixture(scope="module")
def written(motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("rigs")
    return {name: write(folder, motion) for name, write in rigs.WRITERS.items()}


@pytest.fixture(scope="module")
def documents(written: dict[str, Path]) -> dict[str, Document]:
    return {name: formats.read(path) for name, path in written.items()}


def content(document: Document) -> Motion:
    assert isinstance(document.content, Motion)
    return document.content


def last(motion: Motion, frames: int) -> Motion:
    """The last frames: files that begin with a T-pose lose their first ones."""
    return motion.slice(len(motion) - frames, len(motion))


def bones(m: Motion) -> np.ndarray:
    """Unit vectors (T,8,3) along thighs, shanks, upper arms and forearms."""
    ends = [(J[f"{s}_{a}"], J[f"{s}_{NEXT[a]}"]) for s in SIDES for a in LIMBS]
    a, b = (m.p_world_joint[:, list(e)] for e in zip(*ends, strict=True))
    return np.asarray((b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True))


@pytest.mark.parametrize("form", rigs.WRITERS)
def test_one_motion_is_read_back(motion: Motion, documents: dict[str, Document], form: str) -> None:
    m = content(documents[form])
    truth = last(motion, len(m))
    assert len(m) == len(motion) - {"motionbuilder": 2, "daz": 7}.get(form, 0)
    off = np.degrees(ori.angle_between(m.R_world_joint, truth.R_world_joint)).max(axis=0)
    for j, name in enumerate(JOINTS):
        assert off[j] < TOLERANCE[form].get(name, ROUNDED.get(form, EXACT)), name


@pytest.mark.parametrize("form", ["motionbuilder", "daz"])
def test_a_t_pose_is_not_on_the_takes_clock(
    motion: Motion, documents: dict[str, Document], form: str
) -> None:
    """Frame 0 was put before the take: what is kept starts when it did."""
    m = content(documents[form])
    assert m.start_s == pytest.approx((len(motion) - len(m)) / motion.rate_hz)
    assert any("starts with a T-pose" in s for s in documents[form].assumptions)


@pytest.mark.parametrize("form", rigs.WRITERS)
def test_limbs_point_as_they_did(motion: Motion, documents: dict[str, Document], form: str) -> None:
    m = content(documents[form])
    cosine = np.sum(bones(m) * bones(last(motion, len(m))), axis=-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < ROUNDED.get(form, 1.0)


@pytest.mark.parametrize("form", [f for f in rigs.WRITERS if f != "mvnx"])
def test_the_path_is_the_motions(motion: Motion, documents: dict[str, Document], form: str) -> None:
    """The middle of the hips goes as far, times the ratio of our legs to the file's (below 1 for CMU's)."""
    m = content(documents[form])
    went, truth = ((p := x.p_world_root[:, [0, 2]])[-1] - p[0] for x in (m, last(motion, len(m))))
    ratio = np.linalg.norm(went) / np.linalg.norm(truth)
    assert went @ truth / (np.linalg.norm(went) * np.linalg.norm(truth)) > 0.999
    assert ratio == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("form", rigs.RIGS)
def test_limbs_point_as_in_the_file(
    written: dict[str, Path], documents: dict[str, Document], form: str
) -> None:
    """By kinematics that know of no rig: positions alone."""
    m = content(documents[form])
    seen = files.kinematics(written[form]).at
    joint = {j.plays: j.name for j in reversed(rigs.RIGS[form].joints)}
    # Of the forearm's two joints in MotionBuilder's files the first one is the elbow.
    for k, (s, a) in enumerate((s, a) for s in SIDES for a in LIMBS):
        u = (seen[joint[f"{s}_{NEXT[a]}"]] - seen[joint[f"{s}_{a}"]])[-len(m) :]
        u = u / np.linalg.norm(u, axis=1, keepdims=True)
        cosine = np.sum(u * bones(m)[:, k], axis=1)
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 1.0, (s, a)


def test_a_take_as_mvnx_and_bvh(documents: dict[str, Document]) -> None:
    a, b = (content(documents[f]).R_world_joint for f in ("mvnx", "xsens-bvh"))
    off = np.degrees(ori.angle_between(a, b)).max(axis=0)
    for name in ("neck", "head", *(f"{s}_{n}" for s in SIDES for n in ("collar", *LIMBS))):
        assert off[J[name]] < 0.1, name


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ("amc", "CMU's skeleton"),
        ("motionbuilder", "CMU's skeleton"),
        ("daz", "Daz-friendly"),
        ("bandai", "Bandai-Namco"),
    ],
)
def test_rigs_are_recognised(documents: dict[str, Document], form: str, said: str) -> None:
    """By bones and names; a rig with other bones is not taken for one."""
    assert any(said in s for s in documents[form].assumptions)
    for other in set(documents) - {"amc", "motionbuilder", form}:
        assert not any(said in s for s in documents[other].assumptions), other


def lying(motion: Motion) -> Motion:
    """The motion in a world whose z points up, as if y did."""
    turn = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    R = np.array(motion.R_parent_joint)
    R[:, 0] = turn @ R[:, 0]
    p = motion.p_world_root @ turn.T
    return Motion(motion.rate_hz, R, p, motion.skeleton)


@pytest.mark.parametrize("form", ["amc", "mixamo", "xsens-bvh"])
def test_a_z_up_motion_is_doubted_and_mended(motion: Motion, tmp_path: Path, form: str) -> None:
    """A motion that lies all the time is said; with the right axis it stands."""
    path = rigs.WRITERS[form](tmp_path, lying(motion))
    assert any("--up" in w for w in formats.read(path).warnings)
    told = formats.read(path, Options(up="z"))
    assert not [w for w in told.warnings if "upright" in w]
    mended = content(told)
    upright = last(motion, len(mended))
    off = np.degrees(ori.angle_between(mended.R_world_joint[:, 0], upright.R_world_joint[:, 0]))
    assert off.max() < 0.01


@pytest.mark.parametrize("form", ["amc", "mixamo"])
def test_an_axis_told_wrongly_is_doubted(motion: Motion, tmp_path: Path, form: str) -> None:
    path = rigs.WRITERS[form](tmp_path, motion)
    assert any("never upright" in w and "as told" in w
               for w in formats.read(path, Options(up="z")).warnings)  # fmt: skip


def test_an_amass_file_with_y_up(motion: Motion, tmp_path: Path) -> None:
    """AMASS is z-up; a y-up file of its form is doubted, and read with the axis told."""
    vectors = Rotation.from_matrix(motion.R_parent_joint.reshape(-1, 3, 3)).as_rotvec()
    poses = np.zeros((len(motion), 156))
    poses[:, :66] = vectors.reshape(len(motion), 72)[:, :66]
    np.savez(
        tmp_path / "yup_poses.npz", poses=poses, trans=motion.p_world_root, betas=np.zeros(16),
        mocap_framerate=motion.rate_hz, gender="neutral",
    )  # fmt: skip
    assert any("--up" in w for w in formats.read(tmp_path / "yup_poses.npz").warnings)
    told = formats.read(tmp_path / "yup_poses.npz", Options(up="y"))
    assert not [w for w in told.warnings if "upright" in w]
    off = ori.angle_between(content(told).R_world_joint[:, 0], motion.R_world_joint[:, 0])
    assert off.max() < 1e-6


def test_a_hierarchy_that_starts_at_the_head(motion: Motion, tmp_path: Path) -> None:
    """Neck, trunk and pelvis hang below the head: the pelvis is where the legs part."""
    rig = rigs.from_the_head(rigs.MIXAMO)
    path = tmp_path / "head.bvh"
    path.write_text(rig.bvh(motion))
    m = content(formats.read(path))
    off = np.degrees(ori.angle_between(m.R_world_joint, motion.R_world_joint)).max(axis=0)
    limbs = [f"{s}_{n}" for s in SIDES for n in (*LIMBS, "ankle", "collar", "wrist")]
    for name in ("pelvis", "spine3", *limbs):
        assert off[J[name]] < 0.01, name


@pytest.mark.parametrize("profile", ["mixamo", "unity", "cmu"])
@pytest.mark.parametrize("rest", ["t", "a"])
def test_what_is_written_for_a_tool_is_read_by_its_rules(
    motion: Motion, tmp_path: Path, profile: bvh.Profile, rest: bvh.Rest
) -> None:
    """Also once another tool has added a joint, so that the file is no longer known as the project's own."""
    path = tmp_path / "m.bvh"
    bvh.write_motion(path, motion, profile, rest)
    text = path.read_text()
    end = text.index("End Site")
    helper = "JOINT helper\n{\nOFFSET 0 1 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n"
    head, tail = text[:end], text[end:].split("}", 1)[1]
    hierarchy, motion_text = (head + helper + "{\nOFFSET 0 1 0\n}\n}\n" + tail).split("Frame Time:")
    at = 3 + 3 * hierarchy[: hierarchy.index("helper")].count("CHANNELS")
    time, *rows = (line.split() for line in motion_text.splitlines())
    rows = [[*row[:at], "0", "0", "0", *row[at:]] for row in rows]
    lines = [f"{hierarchy}Frame Time: {time[0]}", *(" ".join(row) for row in rows), ""]
    (tmp_path / "x.bvh").write_text("\n".join(lines))
    m = content(formats.read(tmp_path / "x.bvh"))
    off = np.degrees(ori.angle_between(m.R_world_joint, motion.R_world_joint)).max(axis=0)
    # A file does not tell how arms roll between an A- and a T-pose: the smallest turn is taken.
    assert off.max() < (1.0 if rest == "t" else 4.0), dict(zip(JOINTS, off.round(1), strict=True))


# ------------------------------------------------------------------------------- CMU's own files

MOTIONBUILDER = ("02_01", "16_15", "49_02")
# The Daz profile was estimated on 01, 03, 07, 08, 10 and 14; these subjects it has not seen.
DAZ = ("02_01", "05_02", "06_01", "09_01")
UNPACKED = Path.home() / ".cache" / "poser"


@pytest.fixture(scope="module")
def cmu(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Path]]:
    """Files of the trials by form, from the unpacked archives or out of the packed ones."""
    wanted = sorted({*MOTIONBUILDER, *DAZ})
    members = {
        "amc": ("cmu-amc", [f"{n}.amc" for n in wanted] + [f"{n[:2]}.asf" for n in wanted]),
        "daz": ("cmu-daz-bvh", [f"{n}.bvh" for n in DAZ]),
    }
    found = {"motionbuilder": {n: shared / "data" / "cmu-motionbuilder-bvh" / f"{n}.bvh"
                               for n in MOTIONBUILDER}}  # fmt: skip
    for form, (archive, names) in members.items():
        there = {p.name: p for p in (UNPACKED / archive).rglob("*.*") if p.name in names}
        if set(there) != set(names):
            into = tmp_path_factory.mktemp(form)
            there = files.members(shared / "data" / f"{archive}.tar.xz", names, into)
        found[form] = {p.stem: p for p in there.values() if p.suffix != ".asf"}
    return found


def compared(a: Path, b: Path) -> np.ndarray:
    """Mean angles (24,) deg relative to the pelvis, over trusted frames, at the lag that fits best."""
    first, second = (faults.mend(content(formats.read(p))) for p in (a, b))
    R, Q = (
        np.swapaxes(m.motion.R_world_joint[:, :1], -1, -2) @ m.motion.R_world_joint
        for m in (first, second)
    )
    found = []
    for lag in range(12):
        n = min(len(R) - lag, len(Q))
        good = first.trusted[lag : lag + n] & second.trusted[:n]
        off = np.degrees(ori.angle_between(R[lag : lag + n][good], Q[:n][good])).mean(axis=0)
        found.append(off)
    return min(found, key=lambda off: float(off.mean()))


@pytest.mark.slow
@pytest.mark.parametrize("trial", MOTIONBUILDER)
def test_amc_and_motionbuilder_are_one_pose(cmu: dict[str, dict[str, Path]], trial: str) -> None:
    """Frame 0 of the BVH is a T-pose, so its frame 3, the first that is read, is AMC's third."""
    a, b = (content(formats.read(cmu[form][trial])) for form in ("amc", "motionbuilder"))
    assert len(b) == len(a) - 2
    assert b.start_s - a.start_s == pytest.approx(2 / a.rate_hz)
    off = np.degrees(ori.angle_between(a.R_world_joint[2:], b.R_world_joint)).max(axis=0)
    assert off.max() < 0.1, dict(zip(JOINTS, off.round(2), strict=True))
    went = (a.p_world_root[2:] - a.p_world_root[2]) - (b.p_world_root - b.p_world_root[0])
    assert np.abs(went).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("trial", DAZ)
def test_amc_and_daz_are_one_pose(cmu: dict[str, dict[str, Path]], trial: str) -> None:
    """But for hands, which the Daz figure turns about the forearm alone, and toes, which it has not."""
    off = compared(cmu["amc"][trial], cmu["daz"][trial])
    kept = [j for n, j in J.items() if j and not n.endswith(("wrist", "hand", "foot"))]
    assert off[kept].mean() < 5.0
    assert off[kept].max() < 12.0, dict(zip(JOINTS, off.round(1), strict=True))


# ------------------------------------------------------------------------ what people have brought


@pytest.fixture
def cases(shared: Path) -> Path:
    if not (shared / "cases").is_dir():
        pytest.skip("the folder shared/cases is absent")
    return shared / "cases"


def test_a_file_that_starts_at_the_head(cases: Path) -> None:
    """The pelvis turns by 0 to 40 deg, the chest stays."""
    R = content(formats.read(cases / "bvh" / "rooted_at_head.bvh")).R_world_joint
    turned = np.degrees(ori.angle_between(R[:1], R))
    assert turned[:, J["pelvis"]].max() == pytest.approx(40, abs=0.5)
    assert turned[:, J["spine3"]].max() < 0.5


@pytest.mark.parametrize(
    ("name", "up"), [("bvh/51_yrest_zmotion.bvh", "z"), ("amass/yup.npz", "y")]
)
def test_files_with_another_axis_up(cases: Path, name: str, up: _upright.Up) -> None:
    """They are doubted, and stand once the axis is told."""
    assert any("--up" in w for w in formats.read(cases / name).warnings)
    told = formats.read(cases / name, Options(up=up))
    assert not [w for w in told.warnings if "upright" in w]
    assert content(told).R_world_joint[0, 0, 1, 1] > 0.9
