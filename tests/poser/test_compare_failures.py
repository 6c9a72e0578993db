"""`poser compare` where something cannot be: what is kept, what is told, what an earlier run left.

No method runs here: each answers with the reference itself (`instant`), so that only the bookkeeping is seen.
"""

from __future__ import annotations

import html
import json
import sys
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import sensors, synthesis
from mocap.errors import PoserError
from mocap.evaluation import metrics
from mocap.formats.native import read_recording, write_recording
from mocap.motion import Motion
from mocap.recording import Recording
from mocap.synthesis import motions
from poser import batch, comparison, console, earlier, estimators
from poser.__main__ import main
from poser.report import folder as reporting
from poser.report import pictures, results

LEGS = ("left_shank", "right_shank", "pelvis")


@pytest.fixture
def instant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every method finds the reference at once; `sip` cannot where it sees three sensors. No pictures."""

    def method(
        job: comparison.Job, name: str, reference: Motion, tell: Callable[..., None]
    ) -> results.MethodResult:
        seen = comparison.read_by(job, name)
        if name == "sip" and len(seen) == 3:
            raise PoserError("three are not enough")
        found = metrics.evaluate(reference, reference, recording=job.recording, seen=seen)
        return results.MethodResult(reference, found, {"used_sensors": list(seen)})

    monkeypatch.setattr(comparison, "_method", method)
    for name in ("pairs", "joints", "errors"):
        monkeypatch.setattr(pictures, name, lambda found: None)
    monkeypatch.setattr(pictures, "save", lambda figure, path: path.write_bytes(b"a picture"))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """walk.npz, squat.npz: six sensors; legs.npz: three of them; worn.npz: six and the five; 0.4 s."""
    where = tmp_path_factory.mktemp("compare")
    every = (*sensors.SIX, *(n for n in sensors.FIVE if n not in sensors.SIX))
    for name, worn in (
        ("walk", sensors.SIX),
        ("squat", sensors.SIX),
        ("legs", LEGS),
        ("worn", every),
    ):
        motion = motions.walk(4.0).slice(75, 99)
        write_recording(
            where / f"{name}.npz", synthesis.recording(motion, worn, synthesis.Noise(), 0)
        )
    return where


def read(out: Path) -> Any:
    return json.loads((out / "results.json").read_text())


def contents(out: Path) -> set[str]:
    return {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}


@pytest.mark.usefixtures("instant")
def test_what_a_method_needs_is_told_and_the_others_go_on(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(place / "legs.npz"), "-o", str(tmp_path)]) == 0
    record = read(tmp_path)
    (recording,) = record["recordings"]
    assert set(recording["methods"]) == {"sop", *results.NO_SKILL}
    assert set(record["mean"]) == set(recording["methods"])
    failed = recording["failed"]
    assert list(failed) == [m for m in comparison.METHODS if m != "sop"]
    assert failed["sip"] == "three are not enough"
    assert failed["dip"] == failed["hybrid-dip"]
    assert "there is no left_forearm, right_forearm, head" in failed["dip"]
    assert "one to three of left_wrist" in failed["imuposer"]
    notes = [n for n in capsys.readouterr().err.splitlines() if n.startswith("note: legs, ")]
    assert len(notes) == 3  # one for each cause
    page = (tmp_path / "report.html").read_text()
    assert "legs, sip: three are not enough" in page
    assert "legs, dip, hybrid-dip: dip needs" in page


@pytest.mark.usefixtures("instant")
def test_without_a_terminal_each_method_that_is_done_is_a_line(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["compare", str(place / "walk.npz"), str(place / "legs.npz"), "-o", str(tmp_path)]
    words += ["--methods", "sop,sip,dip", "--json"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["schema"] == results.SCHEMA
    lines = [line for line in err.splitlines() if line.startswith("poser compare: ")]
    done = ("walk, sop", "walk, sip", "walk, dip", "legs, sop")
    assert lines == [f"poser compare: {m}: done, {k} of 6" for k, m in enumerate(done, 1)]
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    console.milestone("a line", "poser compare")
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("instant")
def test_one_recording_does_not_cost_another_its_methods(place: Path, tmp_path: Path) -> None:
    words = ["compare", str(place / "legs.npz"), str(place / "walk.npz"), "-o", str(tmp_path)]
    assert main([*words, "--methods", "dip,imuposer"]) == 0
    record = read(tmp_path)
    legs, walk = record["recordings"]
    assert (legs["reference"], legs["methods"], set(legs["failed"])) == (
        None, {}, {"dip", "imuposer"},
    )  # fmt: skip
    assert set(walk["methods"]) == {"dip", "imuposer", *results.NO_SKILL}
    assert walk["failed"] == {}
    assert record["motions"] == {"walk": "walk"}
    assert not (tmp_path / "legs").exists()


@pytest.mark.usefixtures("instant")
def test_a_folder_of_other_things_is_not_written_to(
    place: Path, tmp_path: Path, refusal: Callable[..., tuple[int, str]]
) -> None:
    words = ("compare", place / "walk.npz", "-o", tmp_path, "--methods", "sop")
    for name, text in (("thesis.txt", "mine"), ("results.json", '{"schema": "mine"}')):
        (tmp_path / name).write_text(text)
        status, said = refusal(*words)
        assert status == 2 and f"{tmp_path}: holds files and no comparison" in said
        assert contents(tmp_path) == {name}
        (tmp_path / name).unlink()
    (tmp_path / ".hidden").write_text("of a file manager")
    assert main([str(w) for w in words]) == 0
    (tmp_path / "thesis.txt").write_text("mine")
    assert main([str(w) for w in words]) == 0  # its own folder, whatever else is in it
    assert (tmp_path / "thesis.txt").read_text() == "mine"


@pytest.mark.usefixtures("instant")
def test_where_nothing_can_be_measured_it_is_an_error(
    place: Path, tmp_path: Path, refusal: Callable[..., tuple[int, str]]
) -> None:
    before = json.dumps({"schema": results.SCHEMA, "recordings": []})
    (tmp_path / "results.json").write_text(before)
    words = ("compare", place / "legs.npz", "-o", tmp_path, "--methods", "sip,dip")
    status, said = refusal(*words)
    assert status == 1 and "legs, sip: three are not enough" in said
    assert contents(tmp_path) == {"results.json"}
    assert (tmp_path / "results.json").read_text() == before


@pytest.mark.usefixtures("instant")
def test_a_reference_that_does_not_fit_costs_its_recording_alone(place: Path) -> None:
    walk = read_recording(place / "walk.npz")
    jobs = [
        comparison.Job("long", walk, ("sop",), reference=motions.walk(4.0), no_skill=False),
        comparison.Job("own", walk, ("sop",), no_skill=False),
    ]
    kept: list[str] = []
    lost, own = batch.run_many(jobs, keep=lambda compared: kept.append(compared.name))
    assert isinstance(lost, results.Lost) and "lasts 4.000 s" in lost.failed["reference"]
    assert isinstance(own, results.Compared) and set(own.methods) == {"sop"}
    assert kept == ["own"]
    with pytest.raises(PoserError, match=r"long, reference: .* one frame at most"):
        comparison.run(jobs[0])


class _Future:
    def __init__(self, work: Callable[[comparison.Job], Any], job: comparison.Job) -> None:
        self.key, self.work, self.job = job.name, work, job


class _Client:
    """As much of Dask's client as is used; its workers are done in the wrong order."""

    def __init__(self, address: str, timeout: float) -> None:
        assert address == "tcp://scheduler:8786"

    def __enter__(self) -> _Client:
        return self

    def __exit__(self, *_: object) -> None: ...

    def submit(self, work: Callable[..., Any], job: comparison.Job, pure: bool) -> _Future:
        assert not pure  # two jobs alike are two jobs
        return _Future(work, job)


@pytest.mark.usefixtures("instant")
def test_a_cluster_gives_the_jobs_order_back(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def as_completed(futures: list[_Future], with_results: bool) -> list[tuple[_Future, Any]]:
        assert with_results
        return [(f, f.work(f.job)) for f in reversed(futures)]

    dask = types.SimpleNamespace(Client=_Client, as_completed=as_completed)
    monkeypatch.setitem(sys.modules, "dask", types.ModuleType("dask"))
    monkeypatch.setitem(sys.modules, "dask.distributed", dask)  # type: ignore[arg-type]
    walk, legs = (read_recording(place / f"{n}.npz") for n in ("walk", "legs"))
    jobs = [
        comparison.Job("a", walk, ("sop",), no_skill=False),
        comparison.Job("b", legs, ("dip",), no_skill=False),
        comparison.Job("c", walk, ("sip",), no_skill=False),
    ]
    kept: list[str] = []
    came = batch.run_many(jobs, cluster="tcp://scheduler:8786", keep=lambda c: kept.append(c.name))
    assert [c.name for c in came] == ["a", "b", "c"]
    assert isinstance(came[1], results.Lost)
    assert kept == ["c", "a"]


@pytest.mark.usefixtures("instant")
def test_the_folder_holds_this_runs_files_alone(place: Path, tmp_path: Path) -> None:
    two = [str(place / "walk.npz"), str(place / "squat.npz")]
    out = ["-o", str(tmp_path), "--methods"]
    assert main(["compare", *two, *out, "sop,sip,dip"]) == 0
    assert {"walk/dip.npz", "squat/sip.npz", "joints.png"} <= contents(tmp_path)
    mine = ["mine.npz", "squat/notes.txt"]
    for name in mine:
        (tmp_path / name).write_text("mine")
    assert main(["compare", *two[:1], *out, "sop"]) == 0
    page = ["results.json", "report.html", "worst.png", "joints.png", "errors.png"]
    motion = [f"{n}.npz" for n in ("sop", *results.NO_SKILL, "reference")]
    assert contents(tmp_path) == {*page, *motion, *mine}
    # And from one recording's folder to several's, of which one is left from a run without a record.
    (tmp_path / "walk").mkdir()
    for name in ("hybrid-dip", "reference"):
        (tmp_path / "walk" / f"{name}.npz").write_text("interrupted")
    assert main(["compare", *two, *out, "sip"]) == 0
    motion = [f"{n}.npz" for n in ("sip", *results.NO_SKILL, "reference")]
    both = [f"{r}/{m}" for r in ("walk", "squat") for m in motion]
    assert contents(tmp_path) == {*(n for n in page if n != "errors.png"), *both, *mine}


@pytest.mark.parametrize(
    "record", [None, "[]", "{", '{"schema": "poser-compare/1", "motions": 3}', '{"schema": "mine"}']
)
def test_files_of_others_stay(record: str | None, tmp_path: Path) -> None:
    (tmp_path / "walk").mkdir()
    for name in ("dip.npz", "worst.png", "walk/sip.npz"):
        (tmp_path / name).write_text("mine")
    if record is not None:
        (tmp_path / "results.json").write_text(record)
    assert earlier.files_in(tmp_path, [tmp_path]) == []
    assert earlier.files_in(tmp_path, [tmp_path / "walk", tmp_path / "squat"]) == []


def test_a_record_cannot_point_outside_its_folder(tmp_path: Path) -> None:
    out, other = tmp_path / "out", tmp_path / "other"
    for folder in (out / "in", other):
        folder.mkdir(parents=True)
        (folder / "sip.npz").write_text("a motion")
    motions_at = {"a": "../other", "b": str(other), "c": "in"}
    listed = [{"name": n, "methods": {"sip": {}, "../../other/sip": {}}} for n in motions_at]
    record = {"schema": results.SCHEMA, "recordings": listed, "motions": motions_at}
    (out / "results.json").write_text(json.dumps(record))
    found = earlier.files_in(out, [out])
    assert found == [out / "in" / "sip.npz", out / "results.json"]
    earlier.remove(found, out)
    assert contents(tmp_path) == {"other/sip.npz"}
    assert list(out.iterdir()) == []


@pytest.mark.usefixtures("instant")
def test_a_reference_left_by_an_earlier_run_is_not_removed(
    place: Path, tmp_path: Path, refusal: Callable[..., tuple[int, str]]
) -> None:
    two = [str(place / "walk.npz"), str(place / "squat.npz")]
    assert main(["compare", *two, "-o", str(tmp_path), "--methods", "sop"]) == 0
    before = contents(tmp_path)
    reference = tmp_path / "walk" / "sop.npz"
    words = ("compare", two[0], "-o", tmp_path, "--methods", "sop", "--reference", reference)
    status, said = refusal(*words)
    assert status == 2 and "is an input" in said
    assert contents(tmp_path) == before


@pytest.mark.usefixtures("instant")
@pytest.mark.parametrize(
    ("words", "seen", "told"),
    [
        ([], ["left_wrist", "right_pocket", "head"], " of the 5 devices that it could"),
        (["--sensors", "five"], ["left_wrist", "right_pocket", "head"], " of the 5 devices"),
        (["--sensors", "left_pocket,head,pelvis"], ["left_pocket", "head"], "; --devices"),
        (["--sensors", "six"], ["left_forearm", "right_forearm", "head"], "; --devices"),
        (["--devices", "head,pelvis"], ["head"], " of the 5 devices that it could"),
        (["--devices", "head,right_wrist"], ["right_wrist", "head"], None),
    ],
)
def test_devices_are_those_of_the_sensors_given_and_a_choice_is_told(
    words: list[str], seen: list[str], told: str | None, place: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    line = ["compare", str(place / "worn.npz"), "-o", str(tmp_path), "--methods", "imuposer"]
    assert main([*line, *words]) == 0
    said = capsys.readouterr().err
    assert read(tmp_path)["recordings"][0]["methods"]["imuposer"]["used_sensors"] == seen
    names = ", ".join(seen)
    page = html.unescape((tmp_path / "report.html").read_text())
    assert f"<dt>IMUPoser's devices</dt><dd>{names}" in page
    if told is None:
        assert "IMUPoser sees" not in said
    else:
        assert f"note: IMUPoser sees {names}{told}" in said


def test_too_many_devices_are_named_with_the_option_that_chooses(place: Path) -> None:
    worn = read_recording(place / "worn.npz")
    job = comparison.Job("x", worn, ("imuposer",), None, sensors.FIVE)
    assert "choose with --devices" in comparison.obstacles(job)["imuposer"]
    with pytest.raises(PoserError, match="choose with --sensors"):
        estimators.check_devices("imuposer", {n: n for n in sensors.FIVE})


@pytest.mark.usefixtures("instant")
@pytest.mark.parametrize("words", [(), ("--devices", "five"), ("--sensors", "five")])
def test_devices_that_are_never_worn_together_are_all_seen(
    words: tuple[str, ...], place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two of the five places, then the three others."""
    worn = read_recording(place / "worn.npz").select(sensors.FIVE)
    valid = np.zeros((len(worn), 5), bool)
    valid[:12, [0, 2]], valid[12:, [1, 3, 4]] = True, True
    write_recording(tmp_path / "moves.npz", replace(worn, valid=valid))
    line = ["compare", str(tmp_path / "moves.npz"), "-o", str(tmp_path / "o")]
    assert main([*line, "--methods", "imuposer,hybrid-imuposer", *words]) == 0
    methods = read(tmp_path / "o")["recordings"][0]["methods"]
    for name in ("imuposer", "hybrid-imuposer"):
        assert methods[name]["used_sensors"] == list(sensors.FIVE)
    assert "devices that it could" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        ({"sigma": {"seat_m": 0.01, "acc_white": 0.35}}, "seat_m 0.01, acc_white 0.35"),
        ({"sigma": {"seat_m": 0.01, "acc_white": None}}, "seat_m 0.01, acc_white not a number"),
        ({"sigma": {"seat_m": "lots", "loss": []}}, "seat_m, loss not a number"),
        ({"sigma": {"seat_m": 10**400}}, "seat_m not a number"),
        ({"sigma": 3}, "do not tell"),
        ({"sigma": None, "seed": 1}, "do not tell"),
        ({"seed": 1}, "do not tell"),
    ],
)
def test_odd_notes_of_the_noise(noise: dict[str, Any], words: str, place: Path) -> None:
    recording: Recording = replace(read_recording(place / "walk.npz"), noise=noise)
    assert words in reporting.noise_words(recording)
