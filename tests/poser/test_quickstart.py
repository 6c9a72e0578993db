"""`poser quickstart`: with nothing but a demonstration, asked and unasked, and with a simulated set."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import formats, sensors
from mocap import orientation as ori
from mocap.motion import Motion
from mocap.recording import RawRecording
from poser.__main__ import main
from poser.live import identifying, placement
from poser.live.identifying import Turns
from poser.live.packets import Packet
from tests.poser.live import conftest as live_fixtures

ROOT = Path(__file__).resolve().parents[2]
estimators = live_fixtures.estimators
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """A person at a terminal, who types these lines; the questions that were asked."""

    def types(*lines: str) -> list[str]:
        waiting, asked = list(lines), []

        def answer(question: str) -> str:
            asked.append(question)
            if not waiting:
                raise EOFError
            return waiting.pop(0)

        monkeypatch.setattr("builtins.input", answer)
        monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
        return asked

    return types


def test_without_hardware_and_without_questions(
    tmp_path: Path,
    estimators: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "q"
    words = ["quickstart", "--source", "demo", "--yes", "-o", str(out), "--seconds", "3"]
    assert main([*words, "--countdown", "0", "--sink", str(tmp_path / "m.npz")]) == 0
    said = capsys.readouterr()
    assert "left forearm: back of the forearm" in said.out
    assert "next time: poser live --source demo --method hybrid" in said.out
    assert "live: calibrated; where you face: " in said.err
    assert (out / "placement.png").read_bytes().startswith(PNG)
    assert isinstance(formats.read(out / "session.npz").content, RawRecording)
    motion = formats.read(tmp_path / "m.npz").content
    assert isinstance(motion, Motion) and len(motion) > 30


def test_a_person_is_asked(
    tmp_path: Path,
    estimators: Any,
    typed: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from poser.live import sources

    demo = list(sources.NAMES).index("demo") + 1
    asked = typed("nonsense", str(demo), "")
    words = ["quickstart", "-o", str(tmp_path / "q"), "--seconds", "2", "--countdown", "0"]
    assert main([*words, "--sink", str(tmp_path / "m.npz")]) == 0
    assert (len(asked) == 3 and "Press" in asked[-1]) or "press" in asked[-1]
    said = capsys.readouterr().out
    assert "What do you have?" in said and "SlimeVR trackers" in said
    assert f"a number from 1 to {len(sources.NAMES)}" in said


class Hand:
    """An intake in which one device after the other is turned: the next one whenever it is looked at anew."""

    def __init__(self, names: list[str]):
        self.names, self.k, self.rejected = names, 0, {}  # type: ignore[var-annotated]
        self.ended = False
        self.turning: str | None = None

    def open(self) -> None: ...

    def close(self) -> None: ...

    def heard(self) -> dict[str, Any]:
        return {}

    def receive(self, wait_s: float) -> Iterator[tuple[Packet, float, float | None]]:
        self.k += 1
        for name in self.names:
            angle = 0.05 * self.k if name == self.turning else 0.0
            yield Packet(name, self.k / 60, ori.rot_x(angle), np.zeros(3)), self.k / 60, None


def test_the_device_in_the_hand_is_found() -> None:
    hand = Hand(["a", "b", "c"])
    for name in ("b", "c"):
        hand.turning, hand.k = name, 0
        assert identifying.turned(hand, {"a"}, clock=lambda: 0.0) == name  # type: ignore[arg-type]
    ticks = iter(range(1000))
    hand.turning = None
    assert identifying.turned(hand, (), 50.0, lambda: float(next(ticks))) is None  # type: ignore[arg-type]


def test_two_at_once_are_unclear() -> None:
    turns = Turns()
    for angle in (0.0, 1.0, 1.6):
        turns.see("a", ori.rot_x(angle))
        turns.see("b", ori.rot_x(0.9 * angle))
    assert turns.found(()) is None
    assert turns.found({"b"}) == "a"


@pytest.mark.parametrize("names", [sensors.SIX, sensors.FIVE, sensors.SUIT])
def test_every_place_is_drawn_and_told(tmp_path: Path, names: tuple[str, ...]) -> None:
    placement.draw(tmp_path / "p.png", names)
    assert (tmp_path / "p.png").read_bytes().startswith(PNG)
    assert [p.name for p in tmp_path.iterdir()] == ["p.png"]
    for name in names:
        head, _, told = placement.words(name).partition(": ")
        assert head == name.replace("_", " ") and told != "on this bone"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "argument --source: say what you have"),
        (("--source", "m.npz"), "m.npz is no kind of devices"),
        (("--source", "slimevr"), "argument --map: say which device is where"),
        (("--source", "slimevr", "--map", "x"), "here it is name=place"),
        (("--source", "demo", "--sensors", "nose"), "nose"),
    ],
)
def test_refusals(words: tuple[str, ...], said: str, refusal: Any, tmp_path: Path) -> None:
    _, sentence = refusal("quickstart", "--yes", "-o", tmp_path / "q", *words)
    assert said in sentence
    assert not (tmp_path / "q").exists()


def test_who_does_not_answer_is_told(typed: Any, refusal: Any, tmp_path: Path) -> None:
    typed()
    status, sentence = main_refused(refusal, tmp_path)
    assert status == 2 and "--yes asks nothing" in sentence


def main_refused(refusal: Any, tmp_path: Path) -> tuple[int, str]:
    """The menu is on stdout, so that `refusal` cannot be used as it is."""
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()):
        return refusal("quickstart", "-o", tmp_path / "q")  # type: ignore[no-any-return]


def test_a_simulated_set_moves_the_body(free_port: int, tmp_path: Path, estimators: Any) -> None:
    """The page's way, unasked: the set is started, its map is given, the wearer stands and walks."""
    line = [sys.executable, str(ROOT / "examples" / "slimevr_set.py"), "--port", str(free_port)]
    line += ["--seconds", "120"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True, cwd=ROOT) as trackers:
        assert trackers.stdout is not None
        _, worn = trackers.stdout.readline().split()
        try:
            out = tmp_path / "q"
            words = [
                "quickstart",
                "--source",
                f"slimevr:{free_port}",
                "--map",
                worn,
                "--yes",
                "-o",
                str(out),
            ]
            more = ["--seconds", "26", "--countdown", "0", "--sink", str(tmp_path / "m.npz")]
            assert main([*words, *more]) == 0
        finally:
            trackers.terminate()
    motion = formats.read(tmp_path / "m.npz").content
    assert isinstance(motion, Motion) and len(motion) > 200
    moved = ori.angle_between(motion.R_parent_joint[0], motion.R_parent_joint[len(motion) // 2])
    assert moved.max() > 0.1
    raw = formats.read(out / "session.npz").content
    assert isinstance(raw, RawRecording) and not raw.common_heading


@pytest.fixture
def free_port() -> int:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])
