"""`poser live` with devices: listing, recording and playing, kinds by name, refusals."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import formats, sensors
from mocap import orientation as ori
from mocap.motion import Motion
from mocap.recording import RawRecording, Recording
from mocap.synthesis import motions
from poser.__main__ import main
from poser.live import sinks, sources
from tests.poser.live.conftest import estimators  # noqa: F401 (a fixture)
from tests.poser.live.sources.test_mvn import suit

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def test_what_is_heard_is_listed(answer: Any, capsys: pytest.CaptureFixture[str]) -> None:
    facts = answer("live", "--source", "demo", "--list", "--seconds", "0.5")
    assert list(facts["devices"]) == list(sensors.SIX) and facts["rejected"] == {}
    for name, told in facts["devices"].items():
        assert told["place"] == name and told["acceleration"]
        assert 20 < told["rate_hz"] < 70
    assert (
        main(["live", "--source", "demo", "--list", "--seconds", "0.3", "--sensors", "head"]) == 0
    )
    assert "head" in capsys.readouterr().out.splitlines()[2]


@pytest.mark.parametrize("kind", ["slimevr", "mvn", "sensorlogger", "text", "udp"])
def test_nothing_heard_is_said(
    kind: str, free_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["live", "--source", f"{kind}:{free_port}", "--list", "--seconds", "0.1"]) == 0
    assert capsys.readouterr().out == "nothing heard\n"


def test_what_is_refused_is_listed(free_port: int, capsys: pytest.CaptureFixture[str]) -> None:
    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            for _ in range(50):
                s.sendto(b"\0" * 20, ("127.0.0.1", free_port))
                time.sleep(0.02)

    thread = threading.Thread(target=send)
    thread.start()
    assert main(["live", "--source", f"slimevr:{free_port}", "--list", "--seconds", "0.8"]) == 0
    thread.join()
    assert "refused: no handshake: " in capsys.readouterr().out


WORDS = (
    "live",
    "--source",
    "demo",
    "--countdown",
    "0",
    "--sensors",
    "head,pelvis",
    "--method",
    "dip",
)


def test_a_session_is_recorded_and_played_again(
    tmp_path: Path,
    answer: Any,
    estimators: Any,  # noqa: F811
) -> None:
    """Played and calibrated again, the poses are those of the session; and poser calibrate takes it."""
    session = tmp_path / "s.npz"
    first = answer(*WORDS, "--seconds", 4, "--record", session, "--sink", tmp_path / "a.npz")
    assert first["frames"] > 60
    raw = formats.read(session).content
    assert isinstance(raw, RawRecording) and raw.sensors == ("head", "pelvis")
    again = answer("live", "--source", session, "--countdown", "0", "--method", "dip",
                   "--sink", tmp_path / "b.npz")  # fmt: skip
    a, b = (formats.read(tmp_path / n).content for n in ("a.npz", "b.npz"))
    assert isinstance(a, Motion) and isinstance(b, Motion)
    assert again["frames"] >= first["frames"] - 3
    n = min(len(a), len(b))
    off = np.rad2deg(ori.angle_between(a.R_parent_joint[:n], b.R_parent_joint[:n]))
    # The pose is found within a frame or two of where it was, which turns everything by its sway.
    assert np.median(off.max(axis=1)) < 2.0
    assert main(["calibrate", str(session), "-o", str(tmp_path / "c.npz"), "--facing", "0"]) == 0
    facts = answer(
        "live", "--source", session, "--calibration", tmp_path / "c.npz", "--method", "dip"
    )
    assert facts["frames"] >= len(raw) - 2  # no pose is waited for


def test_a_suit_s_session_needs_no_calibration_and_has_its_reference(
    tmp_path: Path,
    free_port: int,
    answer: Any,
    estimators: Any,  # noqa: F811
) -> None:
    """What MVN streams, recorded, is compared with what MVN made of it."""
    session, motion = tmp_path / "s.npz", motions.builtin(seconds=8.0)

    def send() -> None:
        began = time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            for k in range(len(motion)):
                s.sendto(suit(motion, k), ("127.0.0.1", free_port))
                time.sleep(max(0.0, began + (k + 1) / 60 - time.monotonic()))

    thread = threading.Thread(target=send)
    thread.start()
    words = (
        "live",
        "--source",
        f"mvn:{free_port}",
        "--method",
        "dip",
        "--seconds",
        5,
        "--buffer",
        1.5,
    )
    answer(*words, "--record", session)
    thread.join()
    kept = formats.read(session).content
    assert isinstance(kept, Recording) and kept.reference is not None
    bones = kept.reference.R_world_joint[:, kept.joint]
    ok = kept.ori_valid
    assert ok.mean() > 0.5
    assert np.rad2deg(np.median(ori.angle_between(kept.R_world_bone[ok], bones[ok]))) < 0.5


@pytest.mark.usefixtures("estimators")
def test_a_second_session_does_not_overwrite_its_source(tmp_path: Path, refusal: Any) -> None:
    session = tmp_path / "s.npz"
    assert main([*WORDS, "--seconds", "0.5", "--record", str(session), "--json"]) == 0
    status, sentence = refusal("live", "--source", session, "--record", session)
    assert status == 2 and "is the input" in sentence


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--source", "phyphox"), 2, "lacks the device's address, as in phyphox:192.168.0.7"),
        (("--source", "slimevr:0"), 2, "is not PORT or HOST:PORT"),
        (("--source", "slimevr:99999"), 2, "is not PORT or HOST:PORT"),
        (("--source", "text"), 2, "lacks the port to listen on, as in text:9000"),
        (("--source", "dot:5"), 2, "dot has no address"),
        (("--source", "demo:5"), 2, "demo has no address"),
        (("--source", "slimevr", "--up", "z"), 2, "slimevr has an axis of its own"),
        (("--source", "slimevr", "--reset", "n"), 2, "--reset: for a calibration from a file"),
        (("--source", "slimevr", "--speed", "2"), 2, "--speed: for a calibrated recording alone"),
        (("--source", "nothing.npz", "--list"), 2, "is no kind of devices"),
        (("--source", "demo", "--record", "x.txt"), 2, "must end in .npz"),
        (("--source", "demo", "--sink", "lsl:9"), 2, "lsl has no address"),
        (("--source", "demo", "--sink", "viewer:9"), 2, "viewer has no address"),
        (("--source", "demo", "--sink", "vrchat:a:b"), 2, "is not PORT or HOST:PORT"),
    ],
)
def test_refusals(refusal: Any, words: tuple[str, ...], status: int, said: str) -> None:
    got, sentence = refusal("live", *words)
    assert (got, said in sentence) == (status, True), sentence


def test_a_taken_port_is_one_sentence(free_port: int, refusal: Any) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", free_port))
        status, sentence = refusal("live", "--source", f"slimevr:{free_port}", "--list")
    assert status == 1 and f"cannot listen on 127.0.0.1:{free_port}" in sentence


def test_the_help_and_the_page_know_every_kind(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    page = (ROOT / "docs" / "devices.md").read_text() + (ROOT / "docs" / "live.md").read_text()
    for kind in sources.kinds():
        assert kind.name in said and f"--source {kind.name}" in page, kind.name
        assert kind.words
    for sink in sinks.kinds():
        for word in sink.spelling.split(", "):
            assert f"`{word}`" in page, word


@pytest.fixture
def listing(free_port: int) -> Iterator[subprocess.Popen[str]]:
    words = ["-m", "poser", "live", "--source", f"slimevr:{free_port}", "--list", "--seconds", "60"]
    process = subprocess.Popen(
        [sys.executable, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    yield process
    process.kill()
    process.communicate()


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_shows_what_was_heard(listing: subprocess.Popen[str], free_port: int) -> None:
    """As soon as it answers: 130, and the table."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.settimeout(0.5)
        hello = bytes([0, 0, 0, 3]) + bytes(8 + 28) + b"\x01s" + bytes([2, 0, 0, 0, 0, 9]) + b"\x01"
        for _ in range(100):
            s.sendto(hello, ("127.0.0.1", free_port))
            try:
                assert s.recv(256).startswith(b"\x03Hey OVR")
                break
            except OSError:  # not listening yet
                time.sleep(0.2)
        s.sendto(bytes.fromhex("0000000f 0000000000000001 00 01 0d"), ("127.0.0.1", free_port))
        time.sleep(0.5)
    listing.send_signal(signal.SIGINT)
    out, err = listing.communicate(timeout=30)
    assert listing.returncode == 130 and err == "poser live: interrupted\n"
    assert "02:00:00:00:00:09/0" in out
