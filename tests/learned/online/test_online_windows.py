"""Streaming against the batch of the same windows."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from learned import online
from learned.dip.network import Gaussian
from learned.dip.window import DipWindow
from learned.features import COMBINATIONS, imuposer_input, imuposer_pose
from learned.imuposer.window import ImuposerWindow
from learned.models import Dip, Imuposer, build, for_network
from learned.online.estimator import Online
from learned.runtime import Plain, prepare
from learned.training.validation import cut, held
from mocap import Recording, synthesis
from mocap import orientation as ori
from mocap import sensors as places
from mocap.errors import PoserError
from mocap.estimator import NO_MEASUREMENT, Pose, Sample, replay, samples
from mocap.synthesis import motions


def model(network: str, seed: int = 0, **changes: object) -> Dip | Imuposer:
    torch.manual_seed(seed)
    built = build(for_network(network, hidden=24, **changes)).eval()
    for name, x in built.named_parameters():
        if "weight" in name:  # livelier than the initial weights: outputs follow the inputs
            x.data *= 2
    if isinstance(built, Dip):
        built.out_deviation.fill_(0.5)
        built.out_mean.copy_(torch.eye(3).flatten().repeat(15))
    return built.requires_grad_(False)


def recording(
    rate_hz: float, names: tuple[str, ...], noise: str = "none", s: float = 1.5, from_s: float = 1.2
) -> Recording:
    """s seconds of walking, on the move from the start unless told; a whole recording begins with an invalid
    frame."""
    made = synthesis.recording(motions.walk(3.0 + s, rate_hz), names, synthesis.NOISES[noise], 1)
    begin = round(from_s * rate_hz)
    return made.slice(begin, begin + round(s * rate_hz))


def flushed(estimator: Online, rec: Recording) -> list[Sample]:
    rows = list(samples(rec))
    last = rows[-1]
    nothing = np.zeros(len(estimator.sensors), bool)
    for k in range(estimator.look_ahead_frames):
        rows.append(replace(last, time_s=last.time_s + (k + 1) / rec.rate_hz, valid=nothing))
    return rows


def stream(estimator: Online, rec: Recording) -> list[Pose]:
    state, poses = estimator.init(), []
    for sample in flushed(estimator, rec):
        state, pose = estimator.step(state, sample)
        if pose is not None:
            poses.append(pose)
    assert len(poses) == len(rec)
    return poses


def far(poses: list[Pose], R: np.ndarray) -> float:
    """Largest difference of any rotation's entry."""
    return float(np.abs(np.stack([p.R_parent_joint for p in poses]) - R).max())


EVERY = 10_000  # frames of layer 2: all of a window, which is exact whatever the weights

DIP_CASES = [
    ({}, (20, 5)), ({}, (50, 5)), ({}, (20, 0)), ({}, (3, 7)), ({}, (0, 0)),
    ({"architecture": "rnn"}, (20, 0)),
    ({"normalisation": "first"}, (20, 5)), ({"normalisation": "heading"}, (20, 5)),
    ({"use_acc": False}, (20, 5)),
    ({"architecture": "feedforward"}, (20, 5)), ({"architecture": "wavenet"}, (20, 5)),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "window"), DIP_CASES)
@torch.inference_mode()
def test_dip_streams_as_the_batch_of_its_windows(changes: dict, window: tuple[int, int]) -> None:
    net, rec = model("dip", **changes), recording(60.0, places.SIX, "realistic", 2.0, 0.0)
    assert isinstance(net, Dip) and not rec.valid[0].any()
    exact = Online(DipWindow(net, window, runtime=prepare(net, reach=EVERY)), 60.0)
    done = replay(exact, rec)
    w = cut([rec], *window)
    out = net(net.inputs(w.R_world_bone, w.acc_world)[0])
    at = Gaussian(
        *(v[:, w.emit] for v in (out.pose, out.pose_deviation, out.acc, out.acc_deviation))
    )
    batch = net.pose(at, w.R_world_bone[:, w.emit, 5])
    assert (
        np.ptp(batch[:, 1:].numpy(), axis=0).max() > 0.05
    )  # the poses do differ from frame to frame
    # A convolution over a window of another length adds in another order.
    # The invalid frame gets the next one's pose, whose future is one frame later than its own would be.
    R = done.motion.R_parent_joint
    assert done.notes[NO_MEASUREMENT] == 1 and np.array_equal(R[0], R[1])
    off = np.abs(R - batch.numpy())[1:].max()
    assert off < (3e-5 if changes.get("architecture") == "wavenet" else 1e-5)
    assert done.std_rad is not None
    std = net.pose_deviation(at, batch).numpy()
    np.testing.assert_allclose(done.std_rad[1:], std[1:], rtol=1e-4)
    times = [p.time_s for p in stream(exact, rec)]
    np.testing.assert_allclose(times, rec.start_s + np.arange(len(rec)) / 60)


@pytest.mark.parametrize("worn", COMBINATIONS[::5] + COMBINATIONS[-1:])
@torch.inference_mode()
def test_imuposer_streams_as_the_batch_of_its_windows(worn: tuple[int, ...]) -> None:
    """A recording as it is written, whose window is full after 5 s of the 8."""
    net, rec = model("imuposer"), recording(25.0, places.FIVE, "realistic", 8.0, 0.0)
    assert isinstance(net, Imuposer) and not rec.valid[0].any()
    names = tuple(places.FIVE[k] for k in worn)
    estimator = Online(ImuposerWindow(net, names, runtime=prepare(net, reach=EVERY)), 25.0)
    assert estimator.look_ahead_frames == 0
    done = replay(estimator, rec.select(names))
    w = cut([rec], 124, 0)
    mask = torch.zeros(len(rec), 5, dtype=torch.bool)
    mask[:, list(worn)] = True
    batch = imuposer_pose(net(imuposer_input(w.R_world_bone, w.acc_world, mask))[:, 124])
    assert np.ptp(batch.numpy(), axis=0).max() > 0.05
    # float32: rounding of the smoothed accelerations grows so far in weights as lively as these. The inputs
    # themselves are compared below, to the rounding.
    assert np.abs(done.motion.R_parent_joint - batch.numpy()).max() < 3e-5
    std = net.deviation_rad[COMBINATIONS.index(worn)]
    assert done.std_rad is not None
    np.testing.assert_allclose(done.std_rad, std.expand(len(rec), 24, 3))


@torch.inference_mode()
def test_imuposers_kept_inputs_are_those_of_its_window() -> None:
    """At every frame, each row of the window that is carried along is what the batch of that window reads:
    where the window leaves a frame behind, the mean of the accelerations at its edge changes."""
    net = model("imuposer")
    rec = recording(25.0, places.FIVE[:3], "realistic", 8.0, 0.0).slice(1, 200)
    assert isinstance(net, Imuposer)
    window = ImuposerWindow(net, rec.sensors, runtime=Plain(net))  # its rows are the inputs
    full = recording(25.0, places.FIVE, "realistic", 8.0, 0.0).slice(1, 200)
    R, acc = held(full)
    R[:, :3], acc[:, :3] = held(rec)
    mask = torch.tensor([True, True, True, False, False])
    estimator, edge = Online(window, 25.0), 0.0
    state = estimator.init()
    for t, sample in enumerate(samples(rec)):
        state, _ = estimator.step(state, sample)
        at = np.arange(t - 124, t + 1).clip(0)
        want = imuposer_input(torch.tensor(R[at]).float(), torch.tensor(acc[at]).float(), mask)
        rows = torch.as_tensor(state.network.rows)
        torch.testing.assert_close(rows, want, rtol=0, atol=1e-5)
        edge = max(
            edge, float((want[0, :9] - torch.tensor(acc[at[0], :3]).flatten() / 30).abs().max())
        )
    assert t > 150 and edge > 0.01


@pytest.mark.parametrize("rate_hz", [60.0, 100.0, 25.0])
@pytest.mark.parametrize("network", ["dip", "imuposer"])
def test_a_saved_state_resumes_and_old_states_stay_as_they_were(
    network: str, rate_hz: float
) -> None:
    net = model(network)
    names = places.SIX if network == "dip" else places.FIVE[:3]
    rec = recording(rate_hz, names, "realistic", 1.0)
    estimator = (
        online.dip(net, rate_hz) if network == "dip" else online.imuposer(net, rate_hz, names)
    )
    whole = stream(estimator, rec)
    rows, state, poses = flushed(estimator, rec), estimator.init(), []
    for k, sample in enumerate(rows):
        saved = pickle.dumps(state)
        if k % 7 == 0:  # one step that is thrown away, on the very state that goes on
            estimator.step(state, rows[0])
        state, pose = estimator.step(pickle.loads(saved) if k % 3 == 0 else state, sample)
        poses += [pose] if pose is not None else []
    assert far(poses, np.stack([p.R_parent_joint for p in whole])) == 0


def test_a_turned_person_changes_nothing_but_the_pelvis() -> None:
    net, rec = model("dip"), recording(60.0, places.SIX)
    estimator = online.dip(net, 60.0)
    a, b = stream(estimator, rec), stream(estimator, rec.turned(1.0))
    for p, q in zip(a, b, strict=True):
        assert np.abs(p.R_parent_joint[1:] - q.R_parent_joint[1:]).max() < 1e-5
        assert ori.angle_between(ori.rot_y(1.0) @ p.R_parent_joint[0], q.R_parent_joint[0]) < 1e-6


def test_a_device_that_is_not_worn_has_no_influence() -> None:
    net, rec = model("imuposer"), recording(25.0, places.FIVE, s=1.0)
    worn = ("right_wrist", "head")
    few = stream(online.imuposer(net, 25.0, worn), rec.select(worn))
    valid = np.tile([n in worn for n in places.FIVE], (len(rec), 1))
    for junk in (np.nan, np.inf, 1e30):
        estimator = online.imuposer(net, 25.0, places.FIVE)
        R = np.where(valid[..., None, None], rec.R_world_bone, junk)
        acc = np.where(valid[..., None], rec.acc_world, junk)
        state = estimator.init()
        for t, want in enumerate(few):
            state, pose = estimator.step(state, Sample(t / 25, R[t], acc[t], valid[t]))
            assert pose is not None and np.array_equal(pose.R_parent_joint, want.R_parent_joint)
            assert pose.note == ""


def test_devices_come_and_go() -> None:
    net, rec = model("imuposer"), recording(25.0, places.FIVE[:2], s=5.0)
    estimator = online.imuposer(net, 25.0, rec.sensors)
    alone = online.imuposer(net, 25.0, rec.sensors[:1])
    valid = np.ones((len(rec), 2), bool)
    valid[20:30, 1] = False  # 0.4 s: held
    valid[40:70, 1] = False  # 1.2 s: not worn any more from 0.5 s on
    valid[90:, :] = False  # both: nothing is worn from 0.5 s on
    state, lonely, poses, others = estimator.init(), alone.init(), [], []
    for t, s in enumerate(samples(rec)):
        state, pose = estimator.step(state, replace(s, valid=valid[t]))
        one = Sample(s.time_s, s.R_world_bone[:1], s.acc_world[:1], valid[t, :1])
        lonely, other = alone.step(lonely, one)
        assert pose is not None and other is not None
        poses.append(pose)
        others.append(other)
    pairs = zip(poses, others, strict=True)
    same = np.array([np.abs(p.R_parent_joint - q.R_parent_joint).max() < 1e-5 for p, q in pairs])
    assert not same[:52].any() and same[52:70].all() and not same[70:102].any()
    assert [bool(p.note) for p in poses] == [t > 101 for t in range(len(rec))]
    assert far(poses[102:], poses[101].R_parent_joint) == 0


@pytest.mark.parametrize("lost", [25, 40, 100])
@torch.inference_mode()
def test_all_devices_that_come_back(lost: int) -> None:
    """Rows kept from before the loss are not taken for those of the frames since: every pose afterwards is
    that of a window whose rows are all computed anew."""
    net, rec = model("imuposer"), recording(25.0, places.FIVE[:2], "realistic", 9.0)
    assert isinstance(net, Imuposer)
    valid = np.array(rec.valid)
    valid[80 : 80 + lost] = False

    class Anew(ImuposerWindow):
        def _rows(self, state, worn, kept):  # type: ignore[no-untyped-def]
            return super()._rows(state, worn, False)

    runtime = prepare(net, reach=EVERY)
    both = [
        replay(Online(kind(net, rec.sensors, runtime=runtime), 25.0), replace(rec, valid=valid))
        for kind in (ImuposerWindow, Anew)
    ]
    R, want = (run.motion.R_parent_joint for run in both)
    assert both[0].notes["no device is worn"] == lost - 12  # 0.5 s are held
    assert np.abs(R - want).max() < 1e-4 and np.ptp(R[80 + lost :], axis=0).max() > 0.05


def test_more_devices_than_it_was_trained_on() -> None:
    net, rec = model("imuposer"), recording(25.0, places.FIVE, s=0.4)
    assert isinstance(net, Imuposer)
    net.deviation_rad[COMBINATIONS.index((0, 2, 4))] = 0.1
    poses = stream(online.imuposer(net, 25.0, places.FIVE), rec)
    chosen = ("left_wrist", "left_pocket", "head")
    few = stream(online.imuposer(net, 25.0, chosen), rec.select(chosen))
    assert far(poses, np.stack([p.R_parent_joint for p in few])) < 1e-5
    assert all("only left_wrist, left_pocket, head is used" in p.note for p in poses)


def test_a_lost_sensor_is_told() -> None:
    net, rec = model("dip"), recording(60.0, places.SIX, s=1.5)
    valid = np.ones((len(rec), 6), bool)
    valid[30:, 4] = False
    poses = stream(online.dip(net, 60.0), replace(rec, valid=valid))
    said = [p.note for p in poses]
    assert said[59] == "" and said[60] == "nothing from head" and said[-1] == "nothing from head"


def test_a_jump_of_the_clock_parts_the_window() -> None:
    net, rec = model("dip"), recording(60.0, places.SIX)
    estimator = online.dip(net, 60.0)
    rows = list(samples(rec))
    late = [replace(s, time_s=s.time_s + 9) for s in rows[40:]]
    first, second = stream(estimator, rec.slice(0, 40)), stream(estimator, rec.slice(40, len(rec)))
    state, poses = estimator.init(), []
    for s in rows[:40] + late:
        state, pose = estimator.step(state, s)
        poses += [pose] if pose is not None else []
    want = np.stack([p.R_parent_joint for p in first + second])[: len(poses)]
    assert far(poses, want) < 1e-5


@pytest.mark.parametrize("window", [(-1, 5), (20, -2), (5000, 5)])
def test_windows_that_are_none(window: tuple[int, int]) -> None:
    with pytest.raises(PoserError, match="window"):
        DipWindow(model("dip"), window)


def test_places_that_are_none() -> None:
    with pytest.raises(PoserError, match="left_shank"):
        ImuposerWindow(model("imuposer"), ("left_shank",))
    with pytest.raises(PoserError, match="one place"):
        ImuposerWindow(model("imuposer"), ("left_wrist", "left_forearm"), (0, 0))


@pytest.mark.parametrize("rate_hz", [25.0, 60.0])
@torch.inference_mode()
def test_imuposer_starts_from_the_first_values_of_devices_that_are_late(rate_hz: float) -> None:
    """Nothing of the T-pose is in any pose: frames that can wait for the first device get the first answer,
    those before are marked, and a replay gives them the first answer, too."""
    net, late = model("imuposer"), 30
    rec = recording(rate_hz, places.FIVE[:2], s=3.0).turned(2.0)
    valid = np.array(rec.valid)
    valid[:late] = False
    rec = replace(rec, valid=valid)
    assert isinstance(net, Imuposer)
    exact = Online(ImuposerWindow(net, rec.sensors, runtime=prepare(net, reach=EVERY)), rate_hz)
    poses, ahead = stream(exact, rec), exact.look_ahead_frames
    unknown = [p.note == "no pose yet" for p in poses]
    # Samples that the first tick after the first device can wait for.
    first = unknown.index(False)
    assert late - ahead <= first <= late and not any(unknown[first:])
    assert (first < late) == (ahead > 0) and poses[first].note == ""
    assert all(p.std_rad is not None and (p.std_rad == np.pi / 2).all() for p in poses[:first])
    assert far(poses[first : late + 1], poses[late].R_parent_joint) < 1e-5
    whole = np.stack([p.R_parent_joint for p in stream(exact, rec.slice(late, len(rec)))])
    if ahead == 0:
        assert far(poses[late:], whole) < 1e-5
    run = replay(exact, rec)
    assert run.notes == {NO_MEASUREMENT: late} and len(run.motion) == len(rec)
    assert np.abs(run.motion.R_parent_joint[late:] - whole).max() < 1e-6
    assert np.ptp(run.motion.R_parent_joint[: late + 1], axis=0).max() == 0
    assert run.std_rad is not None


@pytest.mark.parametrize("rate_hz", [25.0, 60.0])
def test_an_hour_without_a_device_costs_no_memory(rate_hz: float) -> None:
    """A minute of it: each sample has its pose, the state does not grow; then a device comes."""
    net = model("imuposer")
    exact = online.imuposer(net, rate_hz, places.FIVE)
    state, sizes, count = exact.init(), [], 0
    nothing = np.zeros(5, bool)
    for k in range(round(60 * rate_hz)):
        R, acc = np.full((5, 3, 3), np.nan), np.full((5, 3), np.nan)
        state, pose = exact.step(state, Sample(k / rate_hz, R, acc, nothing))
        if pose is not None:
            count += 1
            assert pose.note == "no pose yet"
        if k % 100 == 99:
            sizes.append(len(pickle.dumps(state)))
    assert count == k + 1 - exact.look_ahead_frames
    assert max(sizes) == max(sizes[:10])
    assert (len(state.answers), len(state.waiting)) == (0, exact.look_ahead_frames)
    one = np.array([True, False, False, False, False])
    for j in range(1, 2 + exact.look_ahead_frames):
        sample = Sample((k + j) / rate_hz, np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3)), one)
        state, pose = exact.step(state, sample)
    assert pose is not None and pose.note == ""


@torch.inference_mode()
def test_dip_starts_from_the_first_values_of_sensors_that_are_late() -> None:
    """The first frames of a recording have no valid sample: they are answered for by the first that has."""
    net = model("dip")
    rec = recording(60.0, places.SIX, "none", 1.0).turned(2.0)
    valid = np.array(rec.valid)
    valid[:3] = False
    late = replace(rec, valid=valid)
    exact = Online(DipWindow(net, (20, 5), runtime=prepare(net, reach=EVERY)), 60.0)
    poses = stream(exact, late)
    w = cut([late], 20, 5)
    out = net(net.inputs(w.R_world_bone, w.acc_world)[0])
    at = Gaussian(
        *(v[:, w.emit] for v in (out.pose, out.pose_deviation, out.acc, out.acc_deviation))
    )
    batch = net.pose(at, w.R_world_bone[:, w.emit, 5])
    assert far(poses, batch.numpy()) < 1e-5
    assert np.abs(poses[0].R_parent_joint[0] - rec.R_world_bone[3, 5]).max() < 1e-5


@pytest.mark.parametrize("normalisation", ["root", "first"])
@pytest.mark.parametrize(
    "invalid",
    [
        {4: (0, 40)},  # the head comes late
        {5: (0, 40)},  # the pelvis does
        {0: (0, 80), 1: (20, 90)},  # and these never in one frame before frame 90
    ],
)
@torch.inference_mode()
def test_each_late_sensor_is_filled_in_by_itself(
    invalid: dict[int, tuple[int, int]], normalisation: str
) -> None:
    """From the frame that it comes, poses are those of windows that hold its first value before: what the
    other sensors did in the meantime is kept."""
    net = model("dip", normalisation=normalisation)
    rec = recording(60.0, places.SIX, "realistic", 2.0).turned(2.0)
    valid = np.ones((len(rec), 6), bool)
    for sensor, (begin, end) in invalid.items():
        valid[begin:end, sensor] = False
    late = replace(rec, valid=valid)
    exact = Online(DipWindow(net, (20, 5), runtime=prepare(net, reach=EVERY)), 60.0)
    R = np.stack([p.R_parent_joint for p in stream(exact, late)])
    w = cut([late], 20, 5)
    out = net(net.inputs(w.R_world_bone, w.acc_world)[0])
    at = Gaussian(
        *(v[:, w.emit] for v in (out.pose, out.pose_deviation, out.acc, out.acc_deviation))
    )
    batch = net.pose(at, w.R_world_bone[:, w.emit, 5]).numpy()
    since = max(end for begin, end in invalid.values() if begin == 0) - 5
    assert np.abs(R[since:] - batch[since:]).max() < 1e-5
    assert np.ptp(R[:, 1:], axis=0).max() > 0.05


@torch.inference_mode()
def test_a_dead_sensor_costs_itself_alone() -> None:
    """Poses are those of a stream in which it says identity and zero all the time."""
    net, rec = model("dip"), recording(60.0, places.SIX, "realistic", 1.0)
    valid, R, acc = np.array(rec.valid), np.array(rec.R_world_bone), np.array(rec.acc_world)
    valid[:, 4] = False
    R[:, 4], acc[:, 4] = np.eye(3), 0.0
    still = replace(rec, R_world_bone=R, acc_world=acc, valid=np.ones_like(valid))
    exact = Online(DipWindow(net, (20, 5), runtime=prepare(net, reach=EVERY)), 60.0)
    poses = stream(exact, replace(rec, valid=valid))
    want = stream(exact, replace(still, valid=valid | (np.arange(6) == 4)))
    assert far(poses, np.stack([p.R_parent_joint for p in want])) < 1e-6
    assert all(p.note == "nothing from head" for p in poses)
