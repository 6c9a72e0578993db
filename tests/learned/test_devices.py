"""Windows of recordings that do not have all places, or not always."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from learned import devices
from learned.features import COMBINATIONS
from learned.models import build, for_network
from learned.training import deviations, reach
from learned.training import validation as val
from learned.training.recorded import Recorded, at_rate, placed
from mocap import Recording, synthesis
from mocap import sensors as places
from mocap.errors import PoserError
from tests.learned.swing import wavy

THREE = ("left_wrist", "right_pocket", "head")
AT = [places.FIVE.index(n) for n in THREE]


def recording(names: tuple[str, ...] = THREE, frames: int = 60, rate_hz: float = 25.0) -> Recording:
    made = synthesis.recording(wavy(frames, rate_hz), names)
    return placed(made, {n: n for n in names if n in places.FIVE}, places.FIVE)


def moved(frames: int = 100) -> Recording:
    """At 25 Hz: the phone in the left pocket, from half on in the right one; a watch that stays."""
    made = recording(("left_wrist", "left_pocket", "right_pocket"), frames)
    valid = np.array(made.valid)
    valid[frames // 2 :, 2] = False
    valid[: frames // 2, 3] = False
    return replace(made, valid=valid)


def test_a_sensor_is_there_while_the_online_runner_holds_it() -> None:
    made = recording()
    ok = np.ones((60, 5), bool)
    ok[20:40, 0] = False  # 0.8 s: held for 12 frames of 40 ms
    ok[:5, 3] = False  # shortly before its first value
    ok[:30, 4] = False  # long before it
    found = devices.there(replace(made, valid=made.valid & ok))
    assert not found[:, [1, 2]].any()
    assert np.flatnonzero(~found[:, 0]).tolist() == list(range(32, 40))
    assert found[:, 3].all()
    # A recording's frame 0 is invalid in any case.
    assert np.flatnonzero(~found[:, 4]).tolist() == list(range(30 - 12))


def test_only_combinations_of_what_is_there_are_shown() -> None:
    there = torch.zeros(4000, 5, dtype=torch.bool)
    there[:, AT] = True
    there[2000:, 0] = False
    want = [c for c in COMBINATIONS if set(c) <= set(AT)]
    for worn in (devices.drawn(np.random.default_rng(0), there), devices.in_turn(5, there)):
        assert not (worn & ~there).any() and worn.any(1).all()
        shown = [tuple(w.nonzero().flatten().tolist()) for w in worn[:2000]]
        count = [shown.count(c) for c in want]
        assert sum(count) == 2000 and min(count) > 220  # of seven
    assert len(want) == 7
    everywhere = torch.ones(48, 5, dtype=torch.bool)
    drawn = devices.drawn(np.random.default_rng(3), everywhere)
    same = np.random.default_rng(3).integers(24, size=48)  # as runs drew before
    assert [tuple(w.nonzero().flatten().tolist()) for w in drawn] == [COMBINATIONS[c] for c in same]


@pytest.mark.parametrize("rate_hz", [25.0, 60.0])
def test_absent_places_stay_absent_at_another_rate(rate_hz: float) -> None:
    made = recording(frames=round(3 * rate_hz), rate_hz=rate_hz)
    valid = np.array(made.valid)
    valid[round(rate_hz) : round(2 * rate_hz), 0] = False
    found = at_rate(replace(made, valid=valid), 25.0)
    assert found.sensors == places.FIVE and found.rate_hz == 25.0
    assert found.valid.any(0).tolist() == [n in THREE for n in places.FIVE]
    assert not found.valid[27:48, 0].any() and found.valid[52:-2, 0].all()


def test_windows_to_train_on_say_what_is_worn_at_their_end() -> None:
    source = Recorded([moved()], 12)
    rng = np.random.default_rng(0)
    batch = source.draw(rng, 200)
    assert torch.isfinite(batch.acc_world).all()
    assert batch.there[:, 0].all() and not batch.there[:, [1, 4]].any()
    # The phone is in one pocket, or for half a second after the move in both.
    phone = batch.there[:, [2, 3]]
    assert phone.any(1).all() and 0 < int(phone.all(1).sum()) < 60
    assert min(phone.sum(0)) > 50
    # No window ends where nothing is worn.
    made = moved()
    valid = np.array(made.valid)
    valid[40:] = False
    batch = Recorded([replace(made, valid=valid)], 12).draw(rng, 100)
    assert batch.there.any(1).all()
    with pytest.raises(PoserError, match="no recording"):
        Recorded([replace(made, valid=np.zeros_like(valid))], 12)


def test_validation_shows_what_is_worn() -> None:
    made = moved()
    valid = np.array(made.valid)
    valid[80:] = False
    windows = val.cut_for("imuposer", [replace(made, valid=valid)], 100)
    assert len(windows.clip) == 80 + 12  # the last ones after half a second of nothing
    assert windows.there.any(1).all() and not windows.there[:, [1, 4]].any()
    torch.manual_seed(0)
    model = build(for_network("imuposer", hidden=8)).eval()
    seen: list[torch.Tensor] = []
    real = val.imuposer_input

    def noting(R: torch.Tensor, acc: torch.Tensor, worn: torch.Tensor) -> torch.Tensor:
        seen.append(worn)
        return real(R, acc, worn)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(val, "imuposer_input", noting)
        patch.setattr(reach, "imuposer_input", noting)
        val.score(model, windows)
        reach.inputs(model, windows, 20)
    assert not (seen[0] & ~windows.there).any() and seen[0].any(1).all()
    assert not seen[1][:, [1, 4]].any() and len(seen) == 2
    with pytest.raises(PoserError, match="no sensor"):
        val.cut_for("imuposer", [replace(made, valid=np.zeros_like(valid))])


def test_deviations_of_combinations_that_are_not_there_stay() -> None:
    torch.manual_seed(0)
    model = build(for_network("imuposer", hidden=8)).eval()
    before = model.deviation_rad.clone(), model.error_covariance.clone()
    windows = val.cut_for("imuposer", [recording()], 30)
    deviations.calibrate(model, windows, val.cut_for("imuposer", [recording(THREE[:2])], 30))
    mirror = {0: 1, 1: 0, 2: 3, 3: 2, 4: 4}
    for k, c in enumerate(COMBINATIONS):
        there = set(c) <= set(AT) or {mirror[p] for p in c} <= set(AT)
        assert torch.equal(model.deviation_rad[k], before[0][k]) != there
        assert torch.equal(model.error_covariance[k], before[1][k]) != there
