"""poser render: what it writes, refuses and leaves behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mocap import sensors, synthesis
from mocap.formats import amass, native
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.__main__ import main
from poser.render import film
from poser.viewer import tracks


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("render")
    walk = motions.walk(3.0, rate_hz=30.0)
    amass.write_motion(folder / "walk.npz", walk)
    recording = synthesis.recording(walk, sensors.SIX, rng=0)
    assert native.FORMAT.write is not None
    native.FORMAT.write(folder / "rec.npz", recording)
    return folder


def test_a_strip_has_a_row_a_file_and_a_column_a_time(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "strip.png"
    words = ["render", str(folder / "rec.npz"), str(folder / "walk.npz"), "-o", str(out)]
    assert main([*words, "--at", "0.5,1,1.5", "--size", "64x80", "--labels", "truth,SIP"]) == 0
    picture = np.asarray(Image.open(out))
    assert picture.shape == (30 + 2 * 80, 34 + 3 * 64, 3)
    # Each picture has its body: pixels of its colour, blue above and orange below.
    for row, channel in ((0, 2), (1, 0)):
        for column in range(3):
            y, x = 30 + row * 80, 34 + column * 64
            cell = picture[y : y + 80, x : x + 64].astype(int)
            assert (cell[..., channel] - cell[..., 2 - channel] > 60).sum() > 100


def test_a_gif_lasts_as_long_as_was_asked_for(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "film.gif"
    words = ["render", str(folder / "walk.npz"), "-o", str(out), "--size", "96x80"]
    assert main([*words, "--from", "1", "--to", "1.5", "--fps", "10"]) == 0
    with Image.open(out) as gif:
        assert gif.size == (96, 80)
        assert gif.n_frames == 6
        assert gif.info["duration"] == 100


def test_a_film(folder: Path, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "film.mp4"
    words = ["render", str(folder / "walk.npz"), "-o", str(out), "--size", "128x96"]
    assert main([*words, "--to", "0.4", "--fps", "20", "--body", "capsules"]) == 0
    count, seconds = ffmpeg.count_frames_and_secs(str(out))
    assert (count, seconds) == (9, pytest.approx(0.45, abs=0.06))


def test_an_interrupted_film_leaves_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(film.Stage, "picture", interrupt)
    for name in ("a.gif", "b.mp4"):
        assert main(["render", str(folder / "walk.npz"), "-o", str(tmp_path / name)]) == 130
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["-o", "a.avi"], 2, ".mp4 or .gif or .png"),
        (["-o", "a.png", "--fps", "3"], 2, "--fps: is for films"),
        (["-o", "a.mp4", "--at", "3"], 2, "--at: is for a .png"),
        (["-o", "a.gif", "--fps", "90"], 2, "at most 50"),
        (["-o", "a.mp4", "--size", "99x100"], 2, "even numbers"),
        (["-o", "a.mp4", "--body", "smpl"], 2, "needs --smpl"),
        (["-o", "a.mp4", "--labels", "a,b"], 2, "2 names for 1 files"),
        (["-o", "a.mp4", "--from", "8"], 1, "nothing between 8"),
    ],
)
def test_what_is_refused(
    words: list[str], status: int, said: str, folder: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["render", str(folder / "walk.npz"), *words]) == status
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_bodies_keep_their_place_and_stand_on_the_floor() -> None:
    walk = motions.walk(3.0, rate_hz=30.0)
    tall = motions.walk(3.0, rate_hz=30.0, skeleton=Skeleton.default(1.95))
    stage = film.Stage([tracks.Track("a", walk), tracks.Track("b", tall)])
    for i in range(2):
        for t in (0.0, 1.0, 2.5):
            (body, *_), above = stage.body(i, t, np.array([i * 2.0, 0, 0]))
            assert body.vertices[:, 1].min() == pytest.approx(0, abs=0.04)
            middle = body.vertices[:, [0, 2]].mean(axis=0)
            np.testing.assert_allclose(middle, [i * 2.0, 0], atol=0.15)
            assert above[1] > body.vertices[:, 1].max()


def test_every_pose_is_in_the_picture() -> None:
    walk = motions.walk(3.0, rate_hz=30.0)
    stage = film.Stage([tracks.Track("a", walk)] * 3)
    size = (320, 180)
    camera = stage.camera(np.zeros(3), size, 3)
    for i in range(3):
        for t in np.linspace(0, 2.9, 6):
            place = (i - 1) * stage.wide * stage.right
            (body, *_), _ = stage.body(i, t, place)
            seen = camera.project(body.vertices)
            assert (seen[:, :2] > 0).all() and (seen[:, :2] < size).all()
