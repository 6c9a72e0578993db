"""LSL and Rerun: through a library that stands for pylsl, and through rerun's own reader."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap import orientation as ori
from mocap.errors import PoserError
from mocap.estimator import Pose
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.live.sinks import lsl, rerun

BODY = Skeleton.default()


def poses(count: int = 30) -> list[Pose]:
    motion = motions.walk(3.0)
    return [Pose(k / 60, motion.R_parent_joint[k], motion.p_world_root[k]) for k in range(count)]


class Node:
    """An element of a stream's description."""

    def __init__(self) -> None:
        self.children: list[tuple[str, Any]] = []

    def append_child(self, name: str) -> Node:
        self.children.append((name, Node()))
        return self.children[-1][1]  # type: ignore[no-any-return]

    def append_child_value(self, name: str, value: str) -> None:
        self.children.append((name, value))


class Lab:
    """Stands for pylsl."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.streams: dict[str, Any] = {}
        lab = self

        class StreamInfo:
            def __init__(self, name: str, type: str, count: int, rate: float, form: str, uid: str):
                self.name, self.count, self.rate, self.node = name, count, rate, Node()

            def desc(self) -> Node:
                return self.node

        class StreamOutlet:
            def __init__(self, info: StreamInfo):
                self.info, self.samples = info, []  # type: ignore[var-annotated]
                lab.streams[info.name] = self

            def push_sample(self, values: list[float], at: float) -> None:
                assert len(values) == self.info.count
                self.samples.append((at, values))

        self.StreamInfo, self.StreamOutlet = StreamInfo, StreamOutlet

    def local_clock(self) -> float:
        return self.now


def test_lsl_has_labels_values_and_even_times() -> None:
    lab, rng = Lab(), np.random.default_rng(0)
    sink = lsl.LslSink(BODY, 60.0, lab)
    sent = poses()
    for pose in sent:
        lab.now = 1000.0 + pose.time_s + 0.05 + (0.0 if pose is sent[0] else rng.uniform(0, 0.02))
        sink.write(pose)
    rotations, positions = lab.streams["poser rotations"], lab.streams["poser positions"]
    [(_, channels)] = rotations.info.node.children
    labels = [dict(c.children)["label"] for _, c in channels.children]
    assert labels[:5] == ["pelvis.qw", "pelvis.qx", "pelvis.qy", "pelvis.qz", "left_hip.qw"]
    assert len(labels) == 96 and positions.info.count == 72
    at, values = rotations.samples[7]
    R = ori.from_quat(np.array(values).reshape(24, 4))
    np.testing.assert_allclose(R, sent[7].R_parent_joint, atol=1e-9)
    _, p = BODY.forward(sent[7].R_parent_joint, sent[7].p_world_root)
    np.testing.assert_allclose(positions.samples[7][1], p.ravel(), atol=1e-9)
    times = np.array([t for t, _ in rotations.samples])
    # The network's jitter is not in them.
    np.testing.assert_allclose(np.diff(times), 1 / 60, atol=1e-9)
    assert at == pytest.approx(1000.05 + 7 / 60)
    assert sink.close() == {"pushed": 30}


def test_lsl_is_heard_by_lsl() -> None:
    """Through the library itself, where it is installed."""
    pylsl = pytest.importorskip("pylsl")
    sink = lsl.LslSink(BODY, 60.0, pylsl)
    [found, *_] = pylsl.resolve_byprop("name", "poser rotations", timeout=10)
    inlet = pylsl.StreamInlet(found)
    inlet.open_stream(timeout=10)
    for pose in poses(5):
        sink.write(pose)
    values, _ = inlet.pull_sample(timeout=10)
    np.testing.assert_allclose(
        ori.from_quat(np.array(values).reshape(24, 4)), poses(1)[0].R_parent_joint, atol=1e-6
    )
    first = inlet.info().desc().child("channels").first_child()
    assert (found.channel_count(), first.child_value("label")) == (96, "pelvis.qw")
    inlet.close_stream()
    assert sink.close() == {"pushed": 5}


def test_rerun_file_is_read_by_rerun(tmp_path: Path) -> None:
    rr = pytest.importorskip("rerun")
    path = tmp_path / "m.rrd"
    sink = rerun.RerunFile(path, BODY, rr)
    for pose in poses():
        sink.write(pose)
    assert not path.exists()
    assert sink.close() == {"frames": 30}
    assert [p.name for p in tmp_path.iterdir()] == ["m.rrd"]
    assert path.read_bytes()[:4] in (b"RRF2", b"RRIO", b"RRF3")
    assert path.stat().st_size > 10_000


def test_without_poses_there_is_no_file(tmp_path: Path) -> None:
    rr = pytest.importorskip("rerun")
    assert rerun.RerunFile(tmp_path / "m.rrd", BODY, rr).close() == {"frames": 0}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("module", "library", "name"),
    [("pylsl", lsl.library, "lsl"), ("rerun", rerun.library, "rerun")],
)
def test_without_the_extra_a_sentence_names_it(
    module: str, library: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(PoserError, match=rf"pip install 'poser-imu\[{name}\]'"):
        library()
