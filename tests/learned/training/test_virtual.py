"""Windows of virtual sensors against `mocap.synthesis`, clean and in the statistics of the noise."""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
import pytest
import torch

from learned.training.augmentation import Augmentation
from learned.training.corpus import pack
from learned.training.virtual_windows import LEGS, Batch, cubic_weights, spline_coefficients
from mocap import orientation as ori
from mocap import sensors as places
from mocap import synthesis
from mocap.errors import PoserError
from mocap.motion import Motion
from mocap.synthesis import Noise
from tests.learned.swing import still, wavy, windows

CLEAN = Augmentation.none()
# float32: positions to 1e-7 of a metre or two, differenced twice (4 of them) and times rate^2.
# At 25 Hz the frames lie between the corpus's: a spline's error at its ends, of order rate_corpus^-2.
ROTATION_TOLERANCE = {"dip": 3e-6, "imuposer": 5e-5}
ACC_TOLERANCE = {"dip": 4 * 2.4e-7 * 60**2, "imuposer": 0.1}


def same(batch: Batch, b: int, motion: Motion, network: str) -> None:
    """Window b of the batch is what synthesis makes of the motion's inner frames."""
    sensors = places.SIX if network == "dip" else places.FIVE
    want = synthesis.recording(motion, sensors)
    T = batch.acc_world.shape[1]
    inner = slice(1, T + 1)
    atol = ROTATION_TOLERANCE[network]
    np.testing.assert_allclose(batch.R_world_bone[b], want.R_world_bone[inner], atol=atol)
    np.testing.assert_allclose(batch.R_parent_joint[b], motion.R_parent_joint[inner], atol=atol)
    np.testing.assert_allclose(
        batch.acc_world[b], want.acc_world[inner], atol=ACC_TOLERANCE[network]
    )


@pytest.mark.parametrize(("network", "rate"), [("dip", 60.0), ("imuposer", 25.0)])
def test_clean_windows_are_the_synthesis(
    rng: np.random.Generator, network: str, rate: float
) -> None:
    """The motion is known between the corpus's frames as well: 25 Hz asks for those."""
    frames = int(69 / 60 * rate)
    just = (
        int(np.ceil((frames - 1) * 60 / rate)) + 1
    )  # frames of the corpus: it starts at the first
    batch = windows(wavy(just), network, frames - 2).draw(rng, 2)
    for b in range(2):
        same(batch, b, wavy(frames, rate), network)


def test_mirrored_windows(rng: np.random.Generator) -> None:
    motion = wavy(40)
    batch = windows(motion, frames=38, augmentation=replace(CLEAN, mirror=1.0)).draw(rng, 1)
    same(batch, 0, motion.mirrored(), "dip")


def test_headings_turn_the_whole_window(rng: np.random.Generator) -> None:
    motion = wavy(40)
    batch = windows(motion, frames=38, augmentation=replace(CLEAN, heading=True)).draw(rng, 3)
    yaws = []
    for b in range(3):
        R = batch.R_parent_joint[b, 0, 0].double().numpy() @ motion.R_parent_joint[1, 0].T
        yaws.append(float(ori.heading(R)))
        same(batch, b, motion.turned(yaws[-1]), "dip")
    assert np.ptp(yaws) > 0.1


def test_spliced_windows_take_legs_and_trunk_from_two_clips(rng: np.random.Generator) -> None:
    clips = [wavy(22, seed=k) for k in range(2)]
    corpus = pack([(f"c{k}", m) for k, m in enumerate(clips)])
    batch = windows(corpus, frames=20, augmentation=replace(CLEAN, splice=1.0)).draw(rng, 16)
    legs = list(LEGS)
    rest = [j for j in range(24) if j not in LEGS]
    pairs = set()
    for b in range(16):
        R = batch.R_parent_joint[b].numpy()
        truth = [m.R_parent_joint[1:-1] for m in clips]
        of = [
            [k for k in range(2) if np.allclose(R[:, part], truth[k][:, part], atol=1e-5)]
            for part in (legs, rest)
        ]
        assert len(of[0]) == len(of[1]) == 1
        pairs.add((of[0][0], of[1][0]))
    assert len(pairs) == 4


def test_a_warped_window_runs_at_another_speed_and_its_accelerations_follow() -> None:
    """A clip at twice the speed: half the frames, four times the acceleration (p = t^2/2 along x)."""
    t = np.arange(400) / 60
    motion = still(400)
    motion = replace(motion, p_world_root=np.outer(0.5 * t**2, [1.0, 0, 0]))
    rng = np.random.default_rng(0)
    batch = windows(motion, frames=30, augmentation=replace(CLEAN, warp=0.5)).draw(rng, 40)
    # Over half a second the speed ratio is plain: acceleration = ratio^2.
    acc = batch.acc_world[:, :, 5, 0].double().mean(1)
    ratio = acc.clamp_min(0).sqrt()
    assert float(ratio.min()) > np.exp(-0.5) * 0.97 and float(ratio.max()) < np.exp(0.5) * 1.03
    assert float(ratio.max() / ratio.min()) > 1.8


def test_bends_have_the_size_they_say() -> None:
    rng = np.random.default_rng(1)
    augmentation = replace(CLEAN, bend_deg=4.0, tilt_deg=2.0)
    batch = windows(still(30), frames=20, augmentation=augmentation).draw(rng, 150)
    w = np.rad2deg(ori.log(batch.R_parent_joint.double().numpy()))
    assert w[:, :, 1:].std() == pytest.approx(4.0, rel=0.03)
    assert w[:, :, 0].std() == pytest.approx(2.0, rel=0.06)


def test_windows_with_flipped_frames_are_not_drawn() -> None:
    corpus = pack([("clip", wavy(200))])
    corpus.sound[100] = False
    batch = windows(corpus, frames=30).draw(np.random.default_rng(0), 60)
    flipped = torch.tensor(wavy(200).R_parent_joint[100]).float()
    gap = (batch.R_parent_joint - flipped).abs().amax((-1, -2, -3))
    assert float(gap.min()) > 1e-3


def test_a_short_clip_is_a_recording_that_has_just_begun(rng: np.random.Generator) -> None:
    """As online: its frames come last, before them stands the first sample, motion and sensors alike."""
    motion = wavy(22)
    batch = windows(
        motion, frames=30, augmentation=replace(CLEAN, noise=Noise(), noise_scale=(1, 1))
    )
    short = batch.draw(rng, 4)
    same_motion = torch.tensor(motion.R_parent_joint[1:-1]).float()
    np.testing.assert_allclose(
        short.R_parent_joint[:, 10:], same_motion.expand(4, -1, -1, -1, -1), atol=1e-5
    )
    for values in (short.R_parent_joint, short.R_world_bone, short.acc_world):
        assert torch.equal(values[:, :10], values[:, 10:11].expand_as(values[:, :10]))
        assert not torch.equal(values[:, 10], values[:, 12])


def test_spliced_short_clips_begin_with_the_shorter(rng: np.random.Generator) -> None:
    corpus = pack([("a", wavy(22)), ("b", wavy(16, seed=1))])
    batch = windows(corpus, frames=30, augmentation=replace(CLEAN, splice=1.0)).draw(rng, 30)
    first = (batch.acc_world == batch.acc_world[:, :1]).all((2, 3)).sum(1)
    assert set(first.tolist()) == {11, 17}
    assert float(batch.acc_world.abs().max()) < 20


def test_clips_too_short_for_any_window_are_refused() -> None:
    with pytest.raises(PoserError, match="no clip of 8 frames"):
        windows(wavy(5))


def test_a_generator_repeats() -> None:
    w = windows(wavy(60), augmentation=Augmentation())
    a, b = (w.draw(np.random.default_rng(5), 3) for _ in range(2))
    assert torch.equal(a.acc_world, b.acc_world) and torch.equal(a.R_world_bone, b.R_world_bone)


def test_the_corpus_itself_is_not_kept() -> None:
    """Its rotations take as much memory as the splines through them, which is all that is drawn from."""
    corpus = pack([("clip", wavy(60))])
    q, p = weakref.ref(corpus.q), weakref.ref(corpus.p)
    w = windows(corpus)
    del corpus
    assert q() is None and p() is None
    w.draw(np.random.default_rng(0), 2)


def test_splines_go_through_their_points_and_are_smooth(rng: np.random.Generator) -> None:
    x = rng.normal(size=(20, 3))
    c = spline_coefficients(x)

    def at(t: float) -> np.ndarray:
        low = min(int(t), 18)
        return cubic_weights(np.array(t - low)) @ c[low : low + 4]

    np.testing.assert_allclose([at(float(k)) for k in range(20)], x, atol=1e-6)
    h = 1e-3
    for k in range(1, 18):  # the second derivative does not jump at a frame
        before, after = (
            (at(k + s + h) - 2 * at(k + s) + at(k + s - h)) / h**2 for s in (-2 * h, 2 * h)
        )
        np.testing.assert_allclose(before, after, atol=0.3)
    line = np.outer(np.arange(40.0), [1.0, -2.0])  # and a straight path stays straight to its ends
    np.testing.assert_allclose(spline_coefficients(line)[1:-1], line, atol=1e-5)


def test_slowed_motion_has_smooth_accelerations(rng: np.random.Generator) -> None:
    """Swinging at speed s, a(t) = s^2 x''(s t): the mean over frames hides ripples, so each frame counts."""
    t = np.arange(400) / 60
    path = np.stack([0.2 * np.sin(2 * np.pi * 2.0 * t), 0 * t, 0 * t], axis=1)
    motion = replace(still(400), p_world_root=path)
    batch = windows(motion, frames=60, augmentation=replace(CLEAN, warp=0.4)).draw(rng, 20)
    acc = batch.acc_world[:, :, 5, 0].double().numpy()
    for (
        a
    ) in acc:  # of a sine the second difference is -w^2 times itself: fit it, nothing may be left
        s = np.arange(60) / 60
        left = []
        for f in np.linspace(2.0 * np.exp(-0.4), 2.0 * np.exp(0.4), 80):
            basis = np.stack([np.sin(2 * np.pi * f * s), np.cos(2 * np.pi * f * s)], axis=1)
            left.append(np.abs(a - basis @ np.linalg.lstsq(basis, a, rcond=None)[0]).max())
        assert min(left) < 0.05 * np.abs(a).max()


# -- statistics of the noise, on a body that stands still ------------------------------------------


def noisy(count: int = 100, frames: int = 60, network: str = "dip", **noise: float) -> Batch:
    """Windows of the rest pose with this noise alone, at its own size (scale 1)."""
    only = replace(Noise.none(), **noise)
    augmentation = replace(CLEAN, noise=only, noise_scale=(1.0, 1.0))
    rng = np.random.default_rng(11)
    return windows(still(4 * frames), network, frames, augmentation).draw(rng, count)


def degrees(R: torch.Tensor) -> np.ndarray:
    return np.asarray(np.rad2deg(ori.log(R.double().numpy())))


def test_mounting_is_constant_and_of_its_size() -> None:
    w = degrees(noisy(mounting_deg=4.0, frames=8, count=400).R_world_bone)
    assert np.ptp(w, axis=1).max() < 1e-3
    np.testing.assert_allclose(w[:, 0].std((0, 1)), 4.0, rtol=0.06)


def test_heading_starts_and_walks() -> None:
    w = degrees(noisy(heading_deg=3.0, heading_walk_deg=1.0, frames=30, count=200).R_world_bone)
    np.testing.assert_allclose(w[..., [0, 2]], 0, atol=1e-3)
    assert w[:, 0, :, 1].std() == pytest.approx(3.0, rel=0.05)
    walked = w[:, -1, :, 1] - w[:, 0, :, 1]
    assert walked.std() == pytest.approx(1.0 * np.sqrt(29 / 60), rel=0.05)


def test_heading_error_turns_the_accelerations_with_it() -> None:
    """White noise apart: the acceleration of a body that accelerates along x, seen by a turned sensor."""
    t = np.arange(240) / 60
    motion = replace(still(240), p_world_root=np.outer(0.5 * t**2, [1.0, 0, 0]))
    noise = replace(Noise.none(), heading_deg=20.0)
    w = windows(motion, frames=8, augmentation=replace(CLEAN, noise=noise, noise_scale=(1, 1)))
    batch = w.draw(np.random.default_rng(0), 4)
    want = batch.R_world_bone @ torch.tensor([1.0, 0, 0])
    torch.testing.assert_close(batch.acc_world, want, rtol=0, atol=0.02)


def test_tissue_wobbles_with_its_correlation() -> None:
    w = degrees(noisy(tissue_deg=2.0).R_world_bone)
    assert w.std() == pytest.approx(2.0, rel=0.03)
    lag = 18  # 0.3 s at 60 Hz: one correlation time
    correlation = (w[:, lag:] * w[:, :-lag]).mean() / (w**2).mean()
    assert correlation == pytest.approx(np.exp(-1), abs=0.04)


@pytest.mark.parametrize(("network", "rate"), [("dip", 60.0), ("imuposer", 25.0)])
def test_acceleration_noise_scales_with_the_rate(network: str, rate: float) -> None:
    acc = noisy(acc_white=0.35, acc_bias=0.1, network=network).acc_world.double().numpy()
    constant = acc.mean(axis=1)
    white = (acc - constant[:, None]).std() * np.sqrt(60 / 59)
    assert white == pytest.approx(0.35 * np.sqrt(rate / 60), rel=0.03)
    of_mean = 0.1**2 + 0.35**2 * (rate / 60) / 60
    assert constant.std() == pytest.approx(np.sqrt(of_mean), rel=0.05)


def test_lost_samples_hold_the_last_value() -> None:
    """With white noise every sample differs from the one before it, unless it was lost."""
    acc = noisy(acc_white=1.0, loss=0.04, loss_s=0.1, frames=90).acc_world
    held = (acc[:, 1:] == acc[:, :-1]).all(-1).numpy()
    assert held.mean() == pytest.approx(0.04, rel=0.15)
    begins = held[:, 1:] & ~held[:, :-1]
    assert held[:, 1:].sum() / begins.sum() == pytest.approx(6.0, rel=0.15)  # 0.1 s at 60 Hz


def test_bones_are_wrong_by_5_percent_and_alike_on_both_sides() -> None:
    """A root that spins: each acceleration is proportional to the distance from the axis."""
    t = np.arange(12) / 60
    R = np.array(still(12).R_parent_joint)
    R[:, 0] = ori.rot_y(2 * t)
    motion = replace(still(12), R_parent_joint=R)
    noise = replace(Noise.none(), bone=0.05)
    w = windows(motion, frames=10, augmentation=replace(CLEAN, noise=noise, noise_scale=(1, 1)))
    clean = windows(motion, frames=10).draw(np.random.default_rng(0), 1).acc_world.norm(dim=-1)
    size = w.draw(np.random.default_rng(0), 150).acc_world.norm(dim=-1)
    factor = (size / clean).mean(1).numpy()
    left, right = factor[:, 0], factor[:, 1]
    # Collar, shoulder and elbow share the distance; the seat does not scale.
    assert 0.01 < left.std() < 0.05
    assert np.corrcoef(left, right)[0, 1] > 0.98


def test_seats_move() -> None:
    """On a spinning body a seat off by d changes the acceleration by omega^2 d."""
    t = np.arange(12) / 60
    R = np.array(still(12).R_parent_joint)
    R[:, 0] = ori.rot_y(4 * t)
    motion = replace(still(12), R_parent_joint=R)
    w = windows(motion, frames=10, augmentation=replace(CLEAN, seat_m=0.02))
    clean = windows(motion, frames=10).draw(np.random.default_rng(0), 1).acc_world
    apart = w.draw(np.random.default_rng(0), 150).acc_world - clean
    assert float(apart[..., [0, 2]].std()) == pytest.approx(16 * 0.02, rel=0.05)


def test_noise_scale_spreads_over_its_range() -> None:
    noise = replace(Noise.none(), acc_bias=1.0)
    augmentation = replace(CLEAN, noise=noise, noise_scale=(0.0, 2.0))
    acc = windows(still(40), frames=8, augmentation=augmentation).draw(
        np.random.default_rng(2), 300
    )
    # Scale k uniform on (0, 2): the variance of k times a unit normal is E k^2 = 4/3.
    assert float(acc.acc_world.std()) == pytest.approx(np.sqrt(4 / 3), rel=0.05)
