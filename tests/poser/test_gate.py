"""All online paths ask `mocap.gate`."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid import incoming
from learned.online import holding
from mocap import gate
from mocap.estimator import Sample
from poser.live.packets import Rejected, from_fields


@pytest.mark.parametrize(("factor", "counts"), [(0.99, True), (1.01, False)])
def test_tracker_networks_and_live_packets_agree(factor: float, counts: bool) -> None:
    acc = np.array([[0.0, factor * gate.MAX_ACC, 0.0]])
    sample = Sample(0.0, np.eye(3)[None], acc, np.ones(1, bool))
    cleaned, _ = incoming.clean(sample, 1, 0.0)
    assert np.isfinite(cleaned.acc_world).all() == counts and cleaned.valid.all()
    held = holding.take(None, sample, 60.0)
    assert held.acc_world.any() == counts and held.present.all()
    packet = {"device": "head", "t": 0.0, "q": [1, 0, 0, 0], "a": acc[0].tolist()}
    if counts:
        assert from_fields(packet).acc_world is not None
    else:
        with pytest.raises(Rejected, match="out of range"):
            from_fields(packet)
