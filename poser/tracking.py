"""An online method over a whole recording: exactly its frames, aligned in time whatever the look-ahead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from poser.console import Progress

if TYPE_CHECKING:
    from mocap.estimator import Replay
    from mocap.recording import Recording
    from mocap.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Tracked:
    """What a method made of a recording, the sensors that it read, and the rate its network runs at."""

    run: Replay
    method: str
    network: str
    look_ahead_frames: int
    sensors: tuple[str, ...]
    network_hz: float
    facts: Mapping[str, Any] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """What `track --json` and results.json say of it. notes: fallbacks by reason. frame_ms: of each frame
        of the recording, also of those in which a slower network is not run. Then what the estimator tells
        of itself (`mocap.estimator.facts`)."""
        ms = 1e3 * self.run.frame_s
        return {
            "method": self.method,
            "network": self.network,
            "network_hz": self.network_hz,
            "frames": len(self.run.motion),
            "rate_hz": self.run.motion.rate_hz,
            "frame_ms_p50": float(np.percentile(ms, 50)),
            "frame_ms_p99": float(np.percentile(ms, 99)),
            "frame_ms_mean": float(ms.mean()),
            "fallbacks": self.run.fallbacks,
            "notes": dict(self.run.notes),
            "look_ahead_frames": self.look_ahead_frames,
            "used_sensors": list(self.sensors),
            **self.facts,
        }


def track(
    recording: Recording,
    method: str,
    network: str,
    *,
    weights: Path | None = None,
    window: tuple[int, int] | None = None,
    skeleton: Skeleton | None = None,
    tracker: Mapping[str, Any] | None = None,
    progress: Progress = lambda fraction, words: None,
) -> Tracked:
    """Run dip, imuposer, imuposer-adam, hybrid or the single frame's (frame-dip, frame-imuposer) over the
    recording, sample by sample.

    skeleton: the wearer's body. tracker: settings of the hybrid other than by default.
    Raises PoserError where the recording's sensors do not serve the method.
    """
    from learned import specification
    from mocap.estimator import facts, replay
    from poser.estimators import make

    estimator = make(
        method, recording.rate_hz, recording.sensors,
        network=network, weights=weights, window=window, skeleton=skeleton,
        joint=recording.joint, seat=recording.placement, tracker=tracker,
    )  # fmt: skip
    run = replay(estimator, recording, lambda share: progress(share, method), skeleton)
    ahead, names = estimator.look_ahead_frames, estimator.sensors
    told = facts(estimator, run.state)
    return Tracked(run, method, network, ahead, names, specification(network).rate_hz, told)
