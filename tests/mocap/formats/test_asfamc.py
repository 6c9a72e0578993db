"""ASF/AMC: bones about their own axes, and the same trials as BVH."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap import formats
from mocap import orientation as ori
from mocap.errors import FormatError
from mocap.formats import Options, asfamc
from mocap.motion import Motion
from mocap.skeleton import JOINTS, REST
from tests.mocap.formats import broken
from tests.mocap.formats.motion_files import amc_text, asf_text, extract

J = {name: j for j, name in enumerate(JOINTS)}


def a_trial(folder: Path, frames: list[dict[str, str]]) -> Path:
    (folder / "07.asf").write_text(asf_text())
    (folder / "07_01.amc").write_text(amc_text(frames))
    return folder / "07_01.amc"


def read(path: Path, options: Options | None = None) -> Motion:
    content = formats.read(path, options).content
    assert isinstance(content, Motion)
    return content


def bone(motion: Motion, a: str, b: str) -> np.ndarray:
    """Unit vectors (T,3) from joint a to joint b."""
    v = motion.p_world_joint[:, J[b]] - motion.p_world_joint[:, J[a]]
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def test_an_elbow_by_hand(tmp_path: Path) -> None:
    """90 deg about the left radius' own x axis, which is Rz(-90) Ry(-30) Rx(180) x = (0, -0.87, 0.5).

    It takes the forearm from +x to (0, 0.5, 0.87), forward and up; the upper arm stays.
    """
    m = read(a_trial(tmp_path, [{"lradius": "90"}] * 2))
    s = np.sqrt(0.75)
    np.testing.assert_allclose(bone(m, "left_shoulder", "left_elbow")[0], (1, 0, 0), atol=1e-9)
    np.testing.assert_allclose(bone(m, "left_elbow", "left_wrist")[0], (0, 0.5, s), atol=1e-9)
    np.testing.assert_allclose(bone(m, "right_elbow", "right_wrist")[0], (-1, 0, 0), atol=1e-9)


def test_angles_turn_in_the_order_of_the_skeleton(tmp_path: Path) -> None:
    """rx ry rz is Rz Ry Rx: the chest, 90 deg about x and then about z, has its y axis along z.

    Rz Ry Rx y = Rz (0, 0, 1) = z, whereas Rx Ry Rz y would be -x.
    """
    m = read(a_trial(tmp_path, [{"thorax": "90 0 90"}] * 2))
    np.testing.assert_allclose(m.R_world_joint[0, J["spine3"]][:, 1], (0, 0, 1), atol=1e-9)


def test_legs_spread_at_zero_angles(tmp_path: Path) -> None:
    """CMU's zero pose spreads the legs by 20 deg; brought together, the feet do not roll.

    -20 deg about z at the left hip and +20 at the right one, written about axes that are turned by 20
    deg about z themselves, which changes nothing.
    """
    frames = [{}, {"lfemur": "0 0 -20", "rfemur": "0 0 20"}]
    m = read(a_trial(tmp_path, frames))
    spread = np.radians(20)
    for side, sign in (("left", 1), ("right", -1)):
        thigh, foot = bone(m, f"{side}_hip", f"{side}_knee"), J[f"{side}_ankle"]
        np.testing.assert_allclose(thigh[0], (sign * np.sin(spread), -np.cos(spread), 0), atol=1e-4)
        np.testing.assert_allclose(thigh[1], (0, -1, 0), atol=1e-4)
        # The foot's own left axis is level in a pose that stands with legs together.
        assert abs(m.R_world_joint[1, foot][1, 0]) < np.sin(np.radians(3))


def test_the_path(tmp_path: Path) -> None:
    """The root moves one unit = 0.0564 m, times the ratio of our leg to the file's; feet on the floor."""
    trial = a_trial(tmp_path, [{"root": "0 17 0 0 0 0"}, {"root": "1 17 2 0 90 0"}])
    document = formats.read(trial)
    m = document.content
    assert isinstance(m, Motion) and m.rate_hz == 120.0
    assert any("120 Hz" in s for s in document.assumptions)
    assert any("1/0.45 inch" in s for s in document.assumptions)
    np.testing.assert_allclose(bone(m, "right_hip", "left_hip")[1] @ (0, 0, -1), 1, atol=1e-3)
    middle = m.p_world_joint[:, [J["left_hip"], J["right_hip"]]].mean(axis=1)
    step = (middle[1] - middle[0]) / (0.0254 / 0.45)
    # The hips' middle lies before the root, so turning by 90 deg moves it too.
    before = 2.5 * 0.25 / np.linalg.norm((0.65, -0.71, 0.25))
    legs = [REST[J[f"{s}_{a}"]] - REST[J[f"{s}_{b}"]] for s in ("left", "right")
            for a, b in (("hip", "knee"), ("knee", "ankle"))]  # fmt: skip
    ratio = np.linalg.norm(legs, axis=1).sum() / 2 / ((7.6 + 7.3) * 0.0254 / 0.45)
    np.testing.assert_allclose(step[[0, 2]], ratio * np.array([1 + before, 2 - before]), rtol=1e-6)
    assert m.p_world_joint[..., 1].min() == pytest.approx(0.02, abs=1e-9)
    assert read(trial, Options(rate_hz=60.0)).rate_hz == 60.0


def test_the_skeleton_is_found(tmp_path: Path) -> None:
    """SUBJECT.asf first, then the only one there; none or several others are an error."""
    trial = a_trial(tmp_path, [{}] * 2)
    shutil.copy(tmp_path / "07.asf", tmp_path / "other.asf")
    assert asfamc.find_asf(trial).name == "07.asf"
    (tmp_path / "07.asf").unlink()
    assert asfamc.find_asf(trial).name == "other.asf"
    shutil.copy(tmp_path / "other.asf", tmp_path / "third.asf")
    with pytest.raises(FormatError, match=r"needs its skeleton 07\.asf .* found 2 others"):
        formats.read(trial)
    with pytest.raises(FormatError, match="skeleton without motion"):
        formats.read(tmp_path / "third.asf")


@pytest.fixture(scope="module")
def pairs(
    shared: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[Motion, Motion]]:
    """Trials as (AMC, Daz BVH), frames aligned: the BVH has a T-pose first and loses 3 frames."""
    data = shared / "data"
    daz = extract(data / "cmu-daz-bvh.tar.xz", ("02_01", "02_05"), tmp_path_factory.mktemp("daz"))
    out = {}
    for name, path in daz.items():
        b = read(path)
        out[name] = (read(data / "cmu-amc" / f"{name}.amc").slice(2, 2 + len(b)), b)
    return out


@pytest.mark.parametrize("trial", ["02_01", "02_05"])
def test_against_the_same_trial_as_bvh(pairs: dict[str, tuple[Motion, Motion]], trial: str) -> None:
    """A conversion onto another figure keeps the pelvis exactly and the limbs up to its own bones.

    The Daz figure's forearm points 17.5 deg forward of its upper arm at zero angles where CMU's is
    straight, which makes up the forearm's bound. Its hands drop CMU's bending, so they are left out.
    """
    a, b = pairs[trial]
    assert len(a) == len(b)
    apart = np.degrees(ori.angle_between(a.R_world_joint, b.R_world_joint))
    assert apart[:, 0].max() < 0.01
    assert apart[:, [J["spine1"], J["spine2"], J["spine3"]]].mean() < 4
    walked = (a.p_world_root - a.p_world_root[0]) - (b.p_world_root - b.p_world_root[0])
    assert np.abs(walked).max() < 0.04
    bounds = {("hip", "knee"): 10, ("knee", "ankle"): 5, ("ankle", "foot"): 8,
              ("shoulder", "elbow"): 8, ("elbow", "wrist"): 22}  # fmt: skip
    for (above, below), bound in bounds.items():
        for side in ("left", "right"):
            u, v = (bone(m, f"{side}_{above}", f"{side}_{below}") for m in (a, b))
            off = np.degrees(np.arccos(np.clip(np.sum(u * v, axis=1), -1, 1)))
            assert off.mean() < bound, (side, above)
            # The same limb seen from the other's joint is constant: they move alike.
            R = b.R_world_joint[:, J[f"{side}_{above}"]]
            seen = np.einsum("tba,tb->ta", R, u)
            mean = seen.mean(axis=0) / np.linalg.norm(seen.mean(axis=0))
            wobble = np.degrees(np.arccos(np.clip(seen @ mean, -1, 1)))
            assert wobble.mean() < 3.5, (side, above)
    for side in ("left", "right"):
        assert apart[:, J[f"{side}_ankle"]].mean() < 8


def frames_of(replace: Callable[[str], str]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = a_trial(folder, [{}] * 3)
        text = path.read_text()
        path.write_text(replace(text))
        assert path.read_text() != text
        return path

    return make


def skeleton_of(replace: Callable[[str], str]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = a_trial(folder, [{}] * 3)
        text = asf_text()
        (folder / "07.asf").write_text(replace(text))
        assert (folder / "07.asf").read_text() != text
        return path

    return make


AMC = {
    "cut inside a frame": (lambda s: s[: int(0.8 * len(s))], "frame 3"),
    "cut before frame 1": (lambda s: s[:40], "no line that is a frame's number"),
    "no skeleton's bone": (lambda s: s.replace("lradius", "antenna"), "'antenna'"),
    "not a number": (lambda s: s.replace("lradius 0", "lradius abc"), "'abc', expected a number"),
    "nan": (lambda s: s.replace("lradius 0", "lradius nan"), "rx is nan"),
    "huge": (lambda s: s.replace("lradius 0", "lradius 1e300"), "rx is 1e"),
    "a value too many": (
        lambda s: s[:200] + s[200:].replace("lradius 0", "lradius 0 0", 1),
        "frame",
    ),
    "a frame missing": (lambda s: s.replace("\n2\n", "\n7\n"), "found '7', expected '2'"),
    "a bone twice": (lambda s: s.replace("ltibia 0", "lradius 0", 1), "'lradius' occurs twice"),
    "nothing": (lambda s: "", "no line that is a frame's number"),
    "garbage": (lambda s: "\x01\x02 garbage" * 50, "no line that is a frame's number"),
    "degrees said to be radians": (
        lambda s: s.replace(":DEGREES", ":RADIANS").replace("lradius 0", "lradius 90", 1),
        "frame 1, bone lradius: an angle is 90, expected radians",
    ),
    "zero bytes": (lambda s: s + "\0", "zero bytes"),
}
ASF = {
    "cut in the bones": (lambda s: s[: len(s) // 2], "has no"),
    "cut in the hierarchy": (lambda s: s[:-60], "has no parent"),
    "empty": (lambda s: "", "no bones"),
    "no number": (lambda s: s.replace("length 4.9", "length long", 1), "'long', expected 1 numbers"),
    "nan": (lambda s: s.replace("length 4.9", "length nan", 1), "'nan', expected 1 numbers"),
    "direction of nothing": (lambda s: s.replace("direction 1 0 0", "direction 0 0 0", 1), "length 0"),
    "two parents": (lambda s: s.replace("root lowerback", "root lowerback lradius"), "two parents"),
    "a circle": (lambda s: s.replace("root lowerback", "head lowerback"), "does not hang on the root"),
    "unknown bone": (lambda s: s.replace("root lowerback", "root tail lowerback"), "'tail' has no data"),
    "odd axes": (lambda s: s.replace("0 0 20 XYZ", "0 0 20 XXZ", 1), "order of axes"),
    "odd freedom": (lambda s: s.replace("dof rx ry rz", "dof rx rx", 1), "degrees of freedom"),
    "no arm": (lambda s: s.replace("lradius", "pole").replace("lwrist", "cane"), "expected a bone"),
}  # fmt: skip


def a_huge_file(folder: Path) -> Path:
    path = a_trial(folder, [{}])
    with path.open("r+b") as f:
        f.truncate(1 << 40)  # sparse: takes no space
    return path


CASES: broken.Cases = {name: (frames_of(change), said) for name, (change, said) in AMC.items()}
CASES |= {f"asf: {name}": (skeleton_of(change), said) for name, (change, said) in ASF.items()}
CASES["huge file"] = (a_huge_file, "1048576 MiB, at most 512 are read")


@pytest.mark.parametrize("case", CASES)
def test_broken_files(tmp_path: Path, case: str) -> None:
    make, message = CASES[case]
    broken.must_fail(make(tmp_path), asfamc.FORMAT, message)
