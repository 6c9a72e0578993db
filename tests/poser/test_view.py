"""Skins, tracks and the player's time, without a browser."""

from __future__ import annotations

import socket
import sys
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap import sensors, synthesis
from mocap.errors import PoserError
from mocap.synthesis import motions
from mocap.synthesis.staging import floors_of
from poser.__main__ import main
from poser.viewer import stage, tracks
from poser.viewer.live import plain
from poser.viewer.player import Player


@pytest.fixture(scope="module")
def recording() -> Any:
    return synthesis.recording(motions.walk(3.0), sensors.SIX, synthesis.Noise(), rng=1)


def test_as_measured_shows_what_the_sensors_say(recording: Any) -> None:
    motion = tracks.as_measured(recording)
    ok = recording.ori_valid
    shown = motion.R_world_joint[:, recording.joint]
    off = ori.angle_between(shown[ok], recording.R_world_bone[ok])
    assert off.max() < 1e-6
    # Lost samples keep a neighbour's rotation: the body does not fall back into the T-pose.
    assert not ok[0].any()
    np.testing.assert_array_equal(motion.R_parent_joint[0], motion.R_parent_joint[1])


def test_the_kinds_of_files(folder: Path) -> None:
    motion = tracks.read(folder / "walk.npz")
    assert motion.sensors is None and motion.seconds == pytest.approx(3.0, abs=0.02)
    recorded = tracks.read(folder / "rec" / "walk.npz")
    assert recorded.label == "walk.npz (reference)"
    assert (motion.start_s, recorded.start_s) == (None, 0.0)
    assert recorded.sensors is not None and recorded.sensors.R_world_bone.shape[1] == 6
    with pytest.raises(PoserError, match="poser calibrate it first"):
        tracks.read(folder / "raw" / "long.npz")


@pytest.fixture
def made() -> Any:
    server = stage.server("127.0.0.1", 18180)
    yield server
    stage.stop(server)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_player_s_time(made: Any, recording: Any, capsys: pytest.CaptureFixture[str]) -> None:
    slow = motions.walk(4.0, rate_hz=30.0)
    on = tracks.sensors_on(recording, recording.reference)
    player = Player(made, [tracks.Track("a", slow), tracks.Track("b", recording.reference, on)])
    player.step(1.5)
    assert player.time_s == 1.5
    # Each file has its own rate; the second has ended after 3 s, and its last frame stays.
    assert player._shown == [(45, ""), (90, "")]
    player.step(2.0)
    assert player._shown == [(105, ""), (179, " (ended)")]
    assert [f.label for f in player._figures] == ["a", "b (ended)"]
    player.playing = False
    player.step(1.0)
    assert player.time_s == 3.5
    player.playing = True
    player.step(1.0)
    assert player.time_s == 0.0
    figure = player._figures[1]
    player._stay.value = False
    player.step(0.0)
    for j in (0, 15, 21):
        bone = figure._mesh.bones[j]
        R = ori.from_quat(np.array(bone.wxyz))
        np.testing.assert_allclose(R, recording.reference.R_world_joint[0, j], atol=1e-6)
    assert not Player(made, [tracks.Track("alone", slow)])._stay.value
    assert capsys.readouterr().out == ""


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_files_that_state_their_time_share_a_clock(made: Any) -> None:
    """A part from 42 s on of what began at 40 s, and a motion that knows no clock."""
    whole, part = motions.walk(4.0), motions.walk(4.0).slice(120, 180)
    player = Player(
        made, [tracks.Track("whole", whole, start_s=40.0), tracks.Track("part", part, start_s=42.0),
               tracks.Track("free", whole)],
    )  # fmt: skip
    assert (player.begin_s, player.time_s) == (40.0, 42.0)
    assert player._shown == [(120, ""), (0, ""), (120, "")]
    player.playing = False
    player.time_s = 41.0
    player.step(0.0)
    assert player._shown == [(60, ""), (0, " (begins at 42.00 s)"), (60, "")]
    player.time_s, player.playing = 43.5, True
    player.step(0.0)
    assert [f.label for f in player._figures] == ["whole", "part (ended)", "free"]
    player.step(1.0)
    assert player.time_s == 42.0  # the end is followed by where it began


def test_a_client_that_comes_in_mid_step_does_not_end_it(
    made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    player, stop, said = Player(made, [tracks.Track("a", motions.walk(4.0))]), Event(), []

    def step(passed_s: float) -> None:
        said.append(passed_s)
        if len(said) == 1:
            raise RuntimeError("deque mutated during iteration")
        if len(said) == 3:
            stop.set()

    monkeypatch.setattr(player, "step", step)
    player.run(stop)
    assert len(said) == 3 and player._shown is None
    monkeypatch.setattr(player, "step", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        player.run(Event())


def test_what_cannot_be_viewed(folder: Path, refusal: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for words, said in (
        (("absent.npz",), "no such file"),
        ((folder / "raw" / "long.npz",), "poser calibrate"),
    ):
        status, sentence = refusal("view", *words, "--no-browser")
        assert status == 1
        assert said in sentence
    monkeypatch.setitem(sys.modules, "viser", None)
    status, sentence = refusal("view", folder / "walk.npz", "--no-browser")
    assert status == 1
    assert "pip install viser" in sentence


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--port", "99999"), 2, "argument --port: '99999' is not a port from 1 to 65535"),
        (("--port", "-1"), 2, "argument --port"),
        (("--port", "9" * 5000), 2, "is not a port"),
        (("--host", "192.0.2.1"), 1, "cannot serve on 192.0.2.1:8080: this machine does not have"),
        (("--host", "a..b"), 1, "a..b:8080: the host is unknown"),
    ],
)
def test_where_nothing_can_be_served(
    folder: Path, refusal: Any, words: tuple[str, ...], status: int, said: str
) -> None:
    """A sentence; viser alone would wait for ever in each of these."""
    got, sentence = refusal("view", folder / "walk.npz", "--no-browser", *words)
    assert got == status
    assert said in sentence


def test_a_taken_port_gives_the_next_free_one(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        host, free = stage._free("127.0.0.1", port)
        assert host == "127.0.0.1" and port < free < port + stage.PORTS
        monkeypatch.setattr(stage, "PORTS", 1)
        with pytest.raises(PoserError, match=f"{port}: it is taken, and so are all .* {port}$"):
            stage._free("127.0.0.1", port)
    assert stage._free("localhost", 0)[1] > 0


def test_a_line_of_strangers_is_no_markup() -> None:
    """The page would load a picture, follow a link, run what stands in braces."""
    assert (
        plain("unknown devices (![](//evil.example/x))")
        == "unknown devices (???(??evil.example?x))"
    )
    assert not set("<>{}[]!`*\\/&") & set(plain("<img src=x> {alert(1)} `a` *b* \\ &lt;"))
    assert (
        plain("180 poses, latency 12.3 ms (99 %: 15.0)")
        == "180 poses, latency 12.3 ms (99 %: 15.0)"
    )


def test_ctrl_c_ends_the_viewer(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Player, "run", interrupted)
    assert main(["view", str(folder / "walk.npz"), "--no-browser", "--port", "18190"]) == 130
    said = capsys.readouterr()
    assert said.out == ""
    assert "http://127.0.0.1:181" in said.err
    assert said.err.splitlines()[-1] == "poser view: interrupted"


def test_in_place_a_body_stands_whatever_its_path() -> None:
    """Heights that drift or climb are taken off; a jump is not, nor anything of a motion on the floor."""
    walk, jumps = motions.walk(6.0), motions.jumping_jack(4.0)
    np.testing.assert_allclose(floors_of(walk), 0.0, atol=0.005)
    climb = np.outer(0.3 * np.arange(len(walk)) / walk.rate_hz, [0.0, 1.0, 0.0])
    drifting = replace(walk, p_world_root=walk.p_world_root + climb)
    np.testing.assert_allclose(floors_of(drifting), climb[:, 1], atol=0.03)
    feet = jumps.p_world_joint[:, [10, 11], 1].min(axis=1) - floors_of(jumps)
    assert feet.max() - feet.min() > 0.06
    assert floors_of(walk.slice(0, 1)).shape == (1,)
    over = np.array(walk.R_parent_joint)
    over[:, 0] = ori.rot_x(np.full(len(walk), np.pi)) @ over[:, 0]
    handstand = replace(walk, R_parent_joint=over)
    lowest = handstand.p_world_joint[..., 1].min(axis=1) - floors_of(handstand)
    assert np.abs(lowest).max() < 0.1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_player_takes_the_drift_off(made: Any) -> None:
    walk = motions.walk(4.0)
    up = replace(walk, p_world_root=walk.p_world_root + np.array([0.0, 0.7, 0.0]))
    player = Player(made, [tracks.Track("a", walk), tracks.Track("b", up)])
    heights = []
    for stay in (True, False):
        player._stay.value, player._shown = stay, None
        player.show()
        heights.append([f._mesh.bones[10].position[1] for f in player._figures])
    assert heights[0][1] == pytest.approx(heights[0][0], abs=1e-6)
    assert heights[1][1] == pytest.approx(heights[1][0] + 0.7, abs=1e-6)
