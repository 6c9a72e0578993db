"""`poser compare`: the record, the motions, the page; the same whatever the number of processes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import formats, sensors, synthesis
from mocap.errors import PoserError
from mocap.evaluation import metrics
from mocap.formats.amass import write_motion
from mocap.formats.native import FORMAT as NATIVE
from mocap.motion import Motion
from mocap.synthesis import motions, staging
from poser import comparison, estimators
from poser.__main__ import main
from poser.report import results, skeletons

FAST = ("--solver", "banded", "--methods", "sop,sip")


def short(name: str) -> Motion:
    """0.8 s in the middle of a built-in motion."""
    motion: Motion = getattr(motions, name)(4.0)
    return motion.slice(75, 123)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """walk.npz and squat.npz: 0.8 s, six noisy sensors; bare.npz: the same without a reference, suit.npz."""
    from dataclasses import replace

    folder = tmp_path_factory.mktemp("compare")
    assert NATIVE.write is not None
    for i, name in enumerate(("walk", "squat")):
        motion = short(name)
        noisy = synthesis.recording(motion, sensors.SIX, synthesis.Noise(), i)
        NATIVE.write(folder / f"{name}.npz", noisy)
    NATIVE.write(folder / "bare.npz", replace(noisy, reference=None))
    suit = synthesis.recording(short("walk").slice(0, 60), sensors.SUIT, synthesis.Noise(), 3)
    NATIVE.write(folder / "suit.npz", replace(suit, reference=None))
    return folder


@pytest.fixture(scope="module")
def compared(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "made"
    paths = [str(recordings / f"{n}.npz") for n in ("walk", "squat")]
    assert main(["compare", *paths, "-o", str(out), *FAST]) == 0
    return out


def test_record_holds_what_evaluate_and_solve_say(compared: Path, recordings: Path) -> None:
    record = json.loads((compared / "results.json").read_text())
    assert record["schema"] == "poser-compare/1"
    assert [r["name"] for r in record["recordings"]] == ["walk", "squat"]
    for r in record["recordings"]:
        truth = formats.read(recordings / f"{r['name']}.npz").content.reference
        for name in ("sop", "sip"):
            written = formats.read(compared / r["name"] / f"{name}.npz").content
            assert isinstance(written, Motion)
            found = metrics.evaluate(written, truth)
            said = r["methods"][name]
            assert said["sip_deg"] == pytest.approx(found.sip_deg, abs=1e-6)
            assert said["position_cm"] == pytest.approx(found.position_cm, abs=1e-6)
            assert {"status", "seconds", "iterations", "cost", "used_sensors"} <= set(said)
            assert set(metrics.JSON_NAMES) <= set(said)
    for name in ("sop", "sip", "mean-pose", "nearest-pose"):
        each = [r["methods"][name]["sip_deg"] for r in record["recordings"]]
        assert record["mean"][name]["sip_deg"] == pytest.approx(np.mean(each))


def test_processes_change_nothing(compared: Path, recordings: Path, tmp_path: Path) -> None:
    paths = [str(recordings / f"{n}.npz") for n in ("walk", "squat")]
    assert main(["compare", *paths, "-o", str(tmp_path), *FAST, "--jobs", "2"]) == 0
    a, b = (_timeless(p / "results.json") for p in (compared, tmp_path))
    assert a == b


def _timeless(path: Path) -> Any:
    def strip(x: Any) -> Any:
        if isinstance(x, dict):
            return {k: strip(v) for k, v in x.items() if "seconds" not in k and "_ms" not in k}
        if isinstance(x, list):
            return [strip(v) for v in x]
        return round(x, 6) if isinstance(x, float) else x

    return strip(json.loads(path.read_text()))


def test_one_recording_writes_into_the_folder_itself(recordings: Path, tmp_path: Path) -> None:
    words = ["compare", str(recordings / "walk.npz"), "-o", str(tmp_path / "new"), *FAST]
    assert main([*words, "--from", "0.2", "--to", "0.6"]) == 0
    names = {p.name for p in (tmp_path / "new").iterdir()}
    assert {"sop.npz", "sip.npz", "reference.npz", "results.json", "report.html"} <= names
    motion = formats.read(tmp_path / "new" / "sip.npz").content
    assert len(motion) == 24


def test_sip_all_is_sip_on_every_sensor(recordings: Path, tmp_path: Path) -> None:
    words = ["compare", str(recordings / "suit.npz"), "-o", str(tmp_path), *FAST]
    assert main([*words, "--reference", "sip-all"]) == 0
    record = json.loads((tmp_path / "results.json").read_text())["recordings"][0]
    assert record["reference"] == "SIP on all 17 sensors"
    assert record["methods"]["sip"]["used_sensors"] == list(sensors.SIX)
    # Eleven sensors were left out: there is an angle to what they measured.
    assert record["methods"]["sip"]["left_out_deg"] > 1
    solved = tmp_path / "all.npz"
    rec = str(recordings / "suit.npz")
    assert main(["solve", rec, "-o", str(solved), "--solver", "banded"]) == 0
    same = metrics.evaluate(
        formats.read(solved).content, formats.read(tmp_path / "reference.npz").content
    )
    assert same.global_deg == pytest.approx(0, abs=1e-3)
    # Bodies that the report shows side by side stand on one floor.
    for name in ("reference", "sip", "mean-pose"):
        motion = formats.read(tmp_path / f"{name}.npz").content
        assert staging.floor_of(motion) == pytest.approx(0, abs=1e-6), name


def test_sip_is_not_measured_against_itself(recordings: Path, tmp_path: Path) -> None:
    words = ["compare", str(recordings / "walk.npz"), "-o", str(tmp_path), *FAST]
    assert main([*words, "--reference", "sip-all"]) == 0
    record = json.loads((tmp_path / "results.json").read_text())["recordings"][0]
    assert "sip" not in record["methods"] and record["methods"]["sop"]["sip_deg"] > 0.1
    assert "would agree with itself" in record["failed"]["sip"]
    assert "would agree with itself" in (tmp_path / "report.html").read_text()


def test_a_mean_says_over_how_many_recordings(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(recordings / "walk.npz"), str(recordings / "suit.npz")]
    words = ["compare", *paths, "-o", str(tmp_path), *FAST, "--reference", "sip-all"]
    assert main(words) == 0
    mean = json.loads((tmp_path / "results.json").read_text())["mean"]
    assert (mean["sop"]["recordings"], mean["sip"]["recordings"]) == (2, 1)
    said = capsys.readouterr().out
    assert "SIP (1 of 2)" in said and "SOP " in said and "SOP (" not in said


def test_sensors_without_accelerations_are_told(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    whole = formats.read(recordings / "walk.npz").content
    acc = np.array(whole.acc_world)
    acc[:, :2] = np.nan
    assert NATIVE.write is not None
    NATIVE.write(tmp_path / "half.npz", replace(whole, acc_world=acc))
    said = f"no acceleration of {', '.join(whole.sensors[:2])}: networks"
    out = tmp_path / "out.npz"
    assert main(["track", str(tmp_path / "half.npz"), "-o", str(out), "--method", "dip"]) == 0
    assert said in capsys.readouterr().err
    words = ["compare", str(tmp_path / "half.npz"), "-o", str(tmp_path / "c"), "--methods", "dip"]
    assert main(words) == 0
    assert said in capsys.readouterr().err
    assert main([*words[:4], "--methods", "sop", "--solver", "banded"]) == 0
    assert "no acceleration" not in capsys.readouterr().err  # SOP does not ask for any
    # Nor is a sensor told that only the reference reads.
    acc = np.array(whole.acc_world)
    acc[:, whole.sensors.index("pelvis")] = np.nan
    NATIVE.write(tmp_path / "hips.npz", replace(whole, acc_world=acc))
    words = ["compare", str(tmp_path / "hips.npz"), "-o", str(tmp_path / "d"), "--solver", "banded"]
    assert main([*words, "--methods", "imuposer", "--reference", "sip-all"]) == 0
    assert "no acceleration" not in capsys.readouterr().err


ONLINE = ("dip", "imuposer", "imuposer-adam", "hybrid-dip", "hybrid-imuposer")


def test_the_online_methods_with_the_shipped_weights(recordings: Path, tmp_path: Path) -> None:
    words = ["compare", str(recordings / "walk.npz"), "-o", str(tmp_path)]
    assert main([*words, "--methods", ",".join(ONLINE)]) == 0
    methods = json.loads((tmp_path / "results.json").read_text())["recordings"][0]["methods"]
    truth = formats.read(recordings / "walk.npz").content.reference
    for name in ONLINE:
        said = methods[name]
        assert said["frames"] == len(truth) and said["look_ahead_frames"] == 5
        # As `track --json` names them: both hybrids are "hybrid", and the network is beside it.
        method = "hybrid" if name.startswith("hybrid") else name
        network = "imuposer" if "imuposer" in name else "dip"
        assert (said["method"], said["network"]) == (method, network)
        assert 0 < said["frame_ms_p50"] <= said["frame_ms_p99"]
        motion = formats.read(tmp_path / f"{name}.npz").content
        assert len(motion) == len(truth)
        # The wrists stand for watches: IMUPoser sees these and the head.
        devices = ["left_forearm", "right_forearm", "head"]
        seen = devices if "imuposer" in name else list(sensors.SIX)
        assert said["used_sensors"] == seen
    assert methods["dip"]["sip_deg"] < methods["mean-pose"]["sip_deg"]
    assert methods["hybrid-dip"]["instrumented_deg"] < methods["dip"]["instrumented_deg"]


def test_methods_see_what_they_read_and_no_more() -> None:
    suit = synthesis.recording(short("walk"), (*sensors.SUIT, *sensors.FIVE[2:4]), None, 0)
    job = comparison.Job("suit", suit, ("dip", "imuposer"), suit.sensors, no_skill=False)
    found = comparison.run(job).methods
    assert found["dip"].figures["used_sensors"] == list(sensors.SIX)
    assert found["dip"].metrics.left_out_deg is not None
    names = ["left_forearm", "right_pocket", "head"]
    assert found["imuposer"].figures["used_sensors"] == names
    two = comparison.Job("two", suit, ("imuposer",), ("head", "pelvis"), no_skill=False)
    assert comparison.run(two).methods["imuposer"].figures["used_sensors"] == ["head"]
    pockets = suit.select(("left_pocket", "right_pocket", "head"))
    assert estimators.devices_of("imuposer", pockets.sensors) == ("left_pocket", "head")
    with pytest.raises(PoserError, match="head together"):
        comparison.run(comparison.Job("x", suit, ("imuposer",), None, pockets.sensors))


def test_solve_starts_from_a_network(recordings: Path, tmp_path: Path) -> None:
    rec = str(recordings / "walk.npz")
    solved = {}
    for start in ("prior", "dip", "imuposer"):
        out = str(tmp_path / f"{start}.npz")
        assert main(["solve", rec, "-o", out, "--solver", "banded", "--start", start]) == 0
        solved[start] = formats.read(tmp_path / f"{start}.npz").content
    same = metrics.evaluate(solved["dip"], solved["prior"]).global_deg
    assert same is not None and same < 3  # the same valley, whatever the start


def test_a_motion_file_as_reference(recordings: Path, tmp_path: Path) -> None:
    write_motion(tmp_path / "truth.npz", short("squat"))
    words = ["compare", str(recordings / "bare.npz"), "-o", str(tmp_path / "o"), *FAST]
    assert main([*words, "--reference", str(tmp_path / "truth.npz")]) == 0
    record = json.loads((tmp_path / "o" / "results.json").read_text())["recordings"][0]
    assert record["methods"]["sip"]["instrumented_deg"] < 10


def test_refusals(
    recordings: Path, tmp_path: Path, refusal: Callable[..., tuple[int, str]]
) -> None:
    out = ("-o", tmp_path / "o")
    status, said = refusal("compare", recordings / "bare.npz", *out, *FAST)
    assert status == 1 and "bare.npz" in said and "--reference" in said
    status, said = refusal("compare", recordings / "walk.npz", *out, "--methods", "sip,magic")
    assert status == 2 and "magic" in said and "hybrid-dip" in said
    walk = recordings / "walk.npz"
    status, said = refusal("compare", walk, walk, *out, *FAST)
    assert status == 2 and "walk" in said
    two = (walk, recordings / "squat.npz")
    status, said = refusal("compare", *two, *out, *FAST, "--reference", walk)
    assert status == 2 and "several" in said
    NATIVE.write(tmp_path / "sip.npz", formats.read(walk).content)  # type: ignore[misc]
    status, said = refusal("compare", tmp_path / "sip.npz", "-o", tmp_path, *FAST)
    assert status == 2 and "overwritten" in said
    status, said = refusal("compare", walk, *out, *FAST, "--jobs", "0")
    assert status == 2 and "--jobs" in said


def test_canonical_names() -> None:
    assert comparison.canonical(["hybrid", "sip", "sip"]) == ("sip", "hybrid-dip")
    with pytest.raises(PoserError, match="unknown"):
        comparison.canonical([])


def test_worst_frames_are_apart_and_in_order() -> None:
    truth = motions.walk(3.0)
    wrong = np.array(truth.R_parent_joint)
    from mocap import orientation as ori

    for t, angle in ((20, 0.5), (21, 0.49), (150, 0.9)):
        wrong[t, 1] = wrong[t, 1] @ ori.exp([angle, 0, 0])
    bad = Motion(truth.rate_hz, wrong, truth.p_world_root, truth.skeleton)
    result = results.MethodResult(bad, metrics.evaluate(bad, truth))
    found = results.Compared("x", "y", {"sip": result}, truth)
    assert comparison.worst_frames(found, "sip", 2) == [150, 20]


def test_player_holds_the_joints_to_the_millimetre() -> None:
    import base64
    import re

    truth = short("walk").slice(0, 60)
    result = results.MethodResult(truth, metrics.evaluate(truth, truth))
    text = skeletons.section([results.Compared("</script>", "y", {"sip": result}, truth)])
    found = re.search(r'id="player-data">(.*?)</script>', text, flags=re.S)
    assert found is not None
    data = json.loads(found.group(1))
    track = data["recordings"][0]["tracks"][1]
    assert data["recordings"][0]["name"] == "</script>" and track["name"] == "SIP"
    raw = np.frombuffer(base64.b64decode(track["data"]), "<i2").reshape(-1, 24, 3)
    p = truth.resampled(30).p_world_joint
    p = p - p[:, :1] * [1, 0, 1]  # over the middle of the floor
    np.testing.assert_allclose(raw / 1000, p, atol=6e-4)
    assert max(track["error_cm"]) == 0


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """own.safetensors and twin.safetensors of DIP, phone.safetensors of IMUPoser: tiny, untrained."""
    import torch

    from learned import checkpoint
    from learned.config import for_network
    from learned.model import build

    where = tmp_path_factory.mktemp("weights")
    for name, network in (("own", "dip"), ("twin", "dip"), ("phone", "imuposer")):
        torch.manual_seed(0)
        about = {"revision": "abc1234"} if name == "own" else {}
        model = build(for_network(network, hidden=8))
        checkpoint.save(model, where / f"{name}.safetensors", about)
    return where


def test_weights_of_the_user_are_run_and_named(
    recordings: Path, weights: Path, tmp_path: Path
) -> None:
    rec, out = str(recordings / "walk.npz"), tmp_path / "out"
    own = [str(weights / f"{n}.safetensors") for n in ("phone", "own")]
    words = ["compare", rec, "-o", str(out), "--methods", "dip,imuposer,hybrid-dip"]
    assert main([*words, "--weights", *own]) == 0
    record = json.loads((out / "results.json").read_text())
    assert record["schema"] == "poser-compare/1"
    assert record["weights"] == {
        "dip": {"name": "own.safetensors", "revision": "abc1234"},
        "imuposer": {"name": "phone.safetensors"},
    }
    assert "own.safetensors (dip)" in (out / "report.html").read_text()
    tracked = tmp_path / "tracked.npz"
    for method, file in (("dip", own[1]), ("imuposer", own[0])):
        line = ["track", rec, "-o", str(tracked), "--method", method, "--weights", file]
        assert main(line) == 0
        a, b = (formats.read(p).content for p in (tracked, out / f"{method}.npz"))
        np.testing.assert_allclose(a.R_parent_joint, b.R_parent_joint, atol=1e-6)


def test_the_shipped_weights_are_named_where_a_network_ran(
    compared: Path, recordings: Path, tmp_path: Path
) -> None:
    assert json.loads((compared / "results.json").read_text())["weights"] == {}
    words = ["compare", str(recordings / "walk.npz"), "-o", str(tmp_path), "--methods", "sop,dip"]
    assert main([*words, "--solver", "banded"]) == 0
    named = json.loads((tmp_path / "results.json").read_text())["weights"]
    assert list(named) == ["dip"] and named["dip"]["name"] == "dip.safetensors"


def test_weights_that_serve_no_method_are_refused(
    recordings: Path, weights: Path, tmp_path: Path, refusal: Callable[..., Any]
) -> None:
    own, twin, phone = (weights / f"{n}.safetensors" for n in ("own", "twin", "phone"))
    lone = tmp_path / "lone.safetensors"
    lone.write_bytes(own.read_bytes())
    line = ("compare", recordings / "walk.npz", "-o", tmp_path / "out", "--methods", "dip")
    for given, said in (
        ((own, twin), "are both weights of dip"),
        ((phone,), "weights of imuposer, which none of the methods dip runs"),
        (
            (tmp_path / "no.safetensors",),
            "poser compare: " + str(tmp_path / "no.safetensors: no such"),
        ),
        ((lone,), "its description lone.json is not beside it"),
    ):
        status, sentence = refusal(*line, "--weights", *given)
        assert status == 1 and said in sentence
    assert not (tmp_path / "out").exists()


def test_a_device_that_is_named_is_served_by_another_on_its_bone(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["compare", str(recordings / "walk.npz"), "-o", str(tmp_path), "--methods", "imuposer"]
    assert main([*words, "--devices", "left_wrist"]) == 0
    assert "left_forearm stands in for left_wrist" in capsys.readouterr().err
    record = json.loads((tmp_path / "results.json").read_text())["recordings"][0]
    assert record["methods"]["imuposer"]["used_sensors"] == ["left_forearm"]


def test_the_single_frame_is_run_where_it_is_named() -> None:
    assert comparison.canonical(("hybrid", "frame-dip", "dip")) == (
        "dip",
        "hybrid-dip",
        "frame-dip",
    )
    assert not {"frame-dip", "frame-imuposer"} & set(comparison.METHODS)
    assert comparison.NETWORK["frame-imuposer"] == "imuposer"
