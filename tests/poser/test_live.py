"""`poser live` as its users call it: replay to a file, what is refused, Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import formats, sensors, synthesis
from mocap.formats import native
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.synthesis import motions
from poser import estimators as the_estimators
from poser.__main__ import main
from tests.poser.handovers import handed_over
from tests.poser.live.conftest import estimators  # noqa: F401 (a fixture)


@pytest.fixture
def live(estimators: Any, folder: Path) -> Path:  # noqa: F811
    """The six noisy sensors of the built-in walk; the estimator is the test's own."""
    return folder / "rec" / "walk.npz"


@pytest.fixture
def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


@pytest.fixture
def made_with(live: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the estimator was asked for by name, last."""
    seen: dict[str, Any] = {}
    make = the_estimators.make

    def noted(*args: Any, **more: Any) -> Any:
        seen.update(more)
        return make(*args, **more)

    monkeypatch.setattr(the_estimators, "make", noted)
    return seen


def test_replay_to_a_file(live: Path, tmp_path: Path, answer: Any, estimators: Any) -> None:  # noqa: F811
    out = tmp_path / "m.npz"
    facts = answer("live", "--source", live, "--sink", out, "--speed", "max", "--method", "dip")
    assert facts["samples"] == facts["frames"] == 180
    assert facts["latency_ms_p50"] is None
    assert 0 < facts["frame_ms_p50"] <= facts["frame_ms_p99"]
    assert facts["sinks"] == {str(out): {"frames": 180, "held": 0}}
    assert estimators == [("dip", 60.0, tuple(formats.read(live).content.sensors))]  # type: ignore[union-attr]
    motion = formats.read(out).content
    assert isinstance(motion, Motion)
    assert (len(motion), motion.rate_hz) == (180, 60.0)


def test_the_recordings_own_seats_reach_the_estimator(
    live: Path, tmp_path: Path, answer: Any, made_with: dict[str, Any]
) -> None:
    recording = formats.read(live).content
    assert isinstance(recording, Recording)
    own = replace(recording, placement=recording.placement + 0.01)
    path = tmp_path / "own.npz"
    native.write_recording(path, own)
    answer("live", "--source", path, "--speed", "max", "--seconds", 1, "--method", "dip")
    np.testing.assert_allclose(made_with["seat"], own.placement)
    assert made_with["joint"].tolist() == own.joint.tolist()


def test_replay_at_its_own_pace_shows_the_latency(live: Path, tmp_path: Path, answer: Any) -> None:
    began = time.monotonic()
    facts = answer(
        "live", "--source", live, "--seconds", 1, "--speed", 2, "--sink", tmp_path / "m.bvh"
    )
    assert time.monotonic() - began > 0.45
    assert facts["frames"] + facts["left_out"] == 60
    assert 0 <= facts["latency_ms_p50"] <= facts["latency_ms_p99"]


def test_the_answer_for_people(live: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "--source", str(live), "--speed", "max"]) == 0
    said = capsys.readouterr().out
    assert "180 poses of 180 samples" in said
    assert "per sample: " in said


@pytest.mark.parametrize("kind", ["udp", "osc"])
def test_a_source_that_ends_without_samples_has_a_record_too(
    free_port: int,
    tmp_path: Path,
    answer: Any,
    capsys: pytest.CaptureFixture[str],
    kind: str,
    live: Path,
) -> None:
    out = tmp_path / "m.npz"
    words = [
        "live",
        "--source",
        f"{kind}:{free_port}",
        "--calibration",
        "bones",
        "--seconds",
        "0.1",
    ]
    facts = answer(*words, "--sink", out)
    assert (facts["samples"], facts["frames"], facts["behind_s"]) == (0, 0, 0)
    assert facts["latency_ms_p50"] is facts["frame_ms_p99"] is None
    assert facts["sinks"] == {str(out): {"frames": 0, "held": 0}}
    assert facts["devices"]["head"]["received"] == 0
    assert not out.exists()
    assert main(words) == 0
    assert "0 poses of 0 samples" in capsys.readouterr().out


def test_the_hybrid_s_network(live: Path, answer: Any, estimators: Any) -> None:  # noqa: F811
    facts = answer("live", "--source", live, "--speed", "max", "--network", "dip")
    assert (facts["method"], facts["network"]) == ("hybrid", "dip")
    assert estimators[0][0] == "hybrid"


@pytest.mark.parametrize(
    ("words", "expected", "noted"),
    [
        (("--network", "imuposer"), ("left_wrist", "right_pocket", "head"), True),
        (("--method", "imuposer"), ("left_wrist", "right_pocket", "head"), True),
        (("--method", "imuposer", "--sensors", "head"), ("head",), False),
        (("--network", "imuposer", "--devices", "left,right,left"), sensors.FIVE, False),
        (("--method", "dip"), sensors.SIX, False),
    ],
)
def test_the_default_sensors_from_the_network(
    free_port: int,
    estimators: Any,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    expected: tuple[str, ...],
    noted: bool,
) -> None:
    source = ("--source", f"udp:{free_port}", "--calibration", "bones", "--seconds", "0.01")
    assert main(["live", *source, *words]) == 0
    assert estimators[0][2] == expected
    assert ("note: imuposer sees" in capsys.readouterr().err) is noted


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--source", "udp"), 2, "'udp' lacks the port to listen on, as in udp:9000"),
        (("--source", "osc:"), 2, "'osc:' lacks the port to listen on, as in osc:9000"),
        (("--source", "udp:0"), 2, "'0' is not PORT or HOST:PORT"),
        (("--source", "udp:localhost"), 2, "is not PORT"),
        (("--source", "udp:9000", "--speed", "2"), 2, "--speed"),
        (("--source", "udp:9000", "--map", "a=nose"), 2, "'nose' is none of"),
        (("--source", "udp:9000", "--devices", "left,right"), 2, "three times left or right"),
        (
            ("--source", "udp:9000", "--devices", "left,right,left"),
            2,
            "--calibration FILE or bones",
        ),
        (("--source", "udp:9000", "--calibration", "absent.npz"), 1, "absent.npz: no such file"),
        (("--source", "absent.npz"), 1, "absent.npz: no such file"),
        (("--source", "{rec}", "--sink", "{rec}"), 2, "is the input"),
        (("--source", "{rec}", "--sink", "out.txt"), 2, "must end in .npz or .bvh"),
        (("--source", "{rec}", "--sink", "vmc:port"), 2, "is not PORT"),
        (("--source", "{rec}", "--sensors", "five"), 1, "not in the recording"),
        (
            ("--source", "{rec}", "--sink", "viewer", "--port", "99999"),
            2,
            "'99999' is not a port from",
        ),
        (("--source", "{rec}", "--sink", "viewer", "--port", "-1"), 2, "--port"),
        (("--source", "udp:é..b:9000", "--calibration", "bones"), 1, "the host is unknown"),
        (("--source", "upd:9000", "--rate", "30"), 1, "upd:9000: no such file"),
        (
            ("--source", "{rec}", "--weights", "absent.safetensors"),
            1,
            "absent.safetensors: no such file",
        ),
        (("--source", "{rec}", "--weights", "w.npz"), 2, "is no .safetensors file"),
        (
            ("--source", "udp:9000", "--method", "imuposer", "--sensors", "five"),
            1,
            "choose with --sensors",
        ),
        (
            ("--source", "udp:9000", "--devices", "left,right,left", "--sensors", "six"),
            2,
            "no device is ever tracked at left_forearm, right_forearm, left_shank, right_shank, pelvis; ",
        ),
        (
            ("--source", "{rec}", "--method", "dip", "--network", "imuposer"),
            1,
            "runs the network dip",
        ),
    ],
)
def test_refusals(live: Path, refusal: Any, words: tuple[str, ...], status: int, said: str) -> None:
    got, sentence = refusal("live", *(w.replace("{rec}", str(live)) for w in words))
    assert got == status
    assert said in sentence


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--rate", "60"),
        ("--calibration", "n"),
        ("--facing", "0"),
        ("--up", "y"),
        ("--countdown", "5"),
        ("--buffer", "0.05"),
        ("--map", "a=head"),
        ("--devices", "left,right,left"),
    ],
)
def test_what_a_recording_has_no_use_for_is_refused(
    live: Path, refusal: Any, option: str, value: str
) -> None:
    """Defaults, too, where they are given."""
    got, sentence = refusal("live", "--source", live, option, value)
    assert got == 2
    assert (
        f"argument {option}: for sensors that are heard, not for a calibrated recording" in sentence
    )


def test_without_a_sink_a_note_says_so(
    live: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["live", "--source", str(live), "--speed", "max"]
    assert main(words) == 0
    assert (
        capsys.readouterr().err.count("note: without --sink poses go nowhere; it takes FILE") == 1
    )
    for more in (["--json"], ["--sink", str(tmp_path / "m.npz")]):
        assert main([*words, *more]) == 0
        assert "--sink" not in capsys.readouterr().err


def test_a_file_that_was_not_written_is_not_told_as_one(
    free_port: int,
    estimators: Any,  # noqa: F811
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "u3.npz"
    source = ("--source", f"udp:{free_port}", "--calibration", "bones", "--seconds", "0.01")
    assert main(["live", *source, "--sink", str(out)]) == 0
    assert f"{out}: nothing written\n" in capsys.readouterr().out
    assert not out.exists()


def test_weights_of_your_own(
    live: Path, tmp_path: Path, refusal: Any, answer: Any, made_with: dict[str, Any]
) -> None:
    shipped = Path(the_estimators.__file__).parents[1] / "learned" / "weights"
    words = ("live", "--source", live, "--speed", "max", "--seconds", 1, "--weights")
    answer(*words, shipped / "dip.safetensors")
    assert made_with["weights"] == shipped / "dip.safetensors"
    got, sentence = refusal(*words, shipped / "imuposer.safetensors")
    assert got == 1 and "weights of imuposer, expected dip" in sentence
    lone = tmp_path / "lone.safetensors"
    lone.write_bytes((shipped / "dip.safetensors").read_bytes())
    got, sentence = refusal(*words, lone)
    assert got == 1 and "its description lone.json is not beside it" in sentence


def test_calibration_comes_from_what_poser_calibrate_wrote(live: Path, refusal: Any) -> None:
    got, sentence = refusal("live", "--source", "udp:9000", "--calibration", live)
    assert got == 1
    assert "holds no calibration" in sentence


PROCESS = """
import sys
sys.path.insert(0, {root!r})
from poser import estimators
from tests.poser.live.conftest import Hold
estimators.make = lambda method, rate_hz, sensors, **_: Hold(rate_hz, sensors)
from poser.__main__ import main
sys.exit(main(None))
"""


def test_a_recording_of_all_five_places_needs_no_choice(
    tmp_path: Path,
    estimators: Any,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "five.npz"
    native.write_recording(path, synthesis.recording(motions.walk(3.0), sensors.FIVE))
    assert main(["live", "--source", str(path), "--speed", "max", "--method", "imuposer"]) == 0
    assert estimators[0][2] == ("left_wrist", "right_pocket", "head")
    assert "note: imuposer sees left_wrist, right_pocket, head" in capsys.readouterr().err


def test_the_page_is_told(live: Path, free_port: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Where the port is taken it is the next free one, which nobody could guess."""
    words = ["live", "--source", str(live), "--speed", "max", "--sink", "viewer", "--json"]
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", free_port))
        taken.listen()
        assert main([*words, "--port", str(free_port)]) == 0
    said = capsys.readouterr()
    url = json.loads(said.out)["sinks"]["viewer"]["url"]
    assert f"live: the page is {url}\n" in said.err
    assert int(url.rsplit(":")[-1]) > free_port


def test_devices_of_a_recording_are_counted_at_a_time(
    tmp_path: Path,
    estimators: Any,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A phone that changes pockets: four columns, three devices, as `poser track` counts them."""
    path, recording = tmp_path / "phone.npz", handed_over()
    native.write_recording(path, recording)
    words = ["live", "--source", str(path), "--speed", "max", "--method", "imuposer"]
    assert main(words) == 0
    assert estimators[0][2] == recording.sensors
    assert "imuposer sees" not in capsys.readouterr().err
    worn = replace(recording, valid=np.ones_like(recording.valid))
    native.write_recording(path, worn)
    assert main([*words, "--sensors", "all"]) == 1
    assert "not on 4 devices" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_keeps_what_there_is(folder: Path, tmp_path: Path) -> None:
    """130, the file whole and as long as the poses told, the answer on stdout."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    root = str(Path(__file__).resolve().parents[2])
    words = ["live", "--source", f"udp:{port}", "--calibration", "bones", "--sensors", "head"]
    words += ["--sink", str(tmp_path / "m.npz"), "--json"]
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PROCESS.format(root=root)), *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    first = process.stderr.readline()
    assert "listening on 127.0.0.1" in first, process.communicate(timeout=10)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        for k in range(60):
            fields = {"device": "head", "t": k / 60, "seq": k, "q": [1, 0, 0, 0], "a": [0, 0, 0]}
            s.sendto(json.dumps(fields).encode(), ("127.0.0.1", port))
            time.sleep(1 / 60)
    time.sleep(0.5)  # the process may have to wait for its turn
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "poser live: interrupted"
    facts = json.loads(out)
    assert facts["frames"] > 0
    assert 0 < facts["devices"]["head"]["received"] <= 60
    assert [p.name for p in tmp_path.iterdir()] == ["m.npz"]
    motion = formats.read(tmp_path / "m.npz").content
    assert len(motion) == facts["sinks"][str(tmp_path / "m.npz")]["frames"]


def test_without_the_extra_a_sentence_names_it(
    live: Path, refusal: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pythonosc", None)
    got, sentence = refusal("live", "--source", live, "--sink", "vmc:39539")
    assert got == 1
    assert "pip install python-osc" in sentence
