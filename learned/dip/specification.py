"""DIP (Huang et al. 2018), as data."""

from __future__ import annotations

from learned.spec import Specification
from mocap import sensors as places

SPECIFICATION = Specification(
    name="dip",
    title="DIP",
    rate_hz=60.0,
    places=places.SIX,
    combinations=(tuple(range(6)),),
    architectures=("birnn", "rnn", "feedforward", "wavenet"),
    fixed_widths=("feedforward", "wavenet"),  # those of its appendix A
    experiments=("architecture", "normalisation", "no_acc", "no_acc_loss"),
    window=(20, 5),
    window_changes=True,
    most_windows=1500,
    model="learned.dip.model:Dip",
    online="learned.dip.window:window",
    deviations="learned.dip.deviations:calibrate",
)
