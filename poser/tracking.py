"""An online method over a whole recording: exactly its frames, aligned in time whatever the look-ahead."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap.motion import Motion
from mocap.recording import Recording
from poser.console import Progress


@dataclass(frozen=True, eq=False)
class Tracked:
    """The motion and how the method did: frame_s (T,) seconds of each step, fallbacks by reason."""

    motion: Motion
    method: str
    network: str
    frame_s: np.ndarray
    look_ahead_frames: int
    notes: Counter[str]
    std_rad: np.ndarray | None = None

    def record(self) -> dict[str, Any]:
        """What `--json` and results.json say of it."""
        ms = 1e3 * self.frame_s
        return {
            "method": self.method,
            "network": self.network,
            "frames": len(self.motion),
            "rate_hz": self.motion.rate_hz,
            "frame_ms_p50": float(np.percentile(ms, 50)),
            "frame_ms_p99": float(np.percentile(ms, 99)),
            "frame_ms_mean": float(ms.mean()),
            "fallbacks": sum(self.notes.values()),
            "fallback_reasons": dict(self.notes),
            "look_ahead_frames": self.look_ahead_frames,
        }


def track(
    recording: Recording,
    method: str,
    network: str,
    *,
    weights: Path | None = None,
    window: tuple[int, int] | None = None,
    progress: Progress = lambda fraction, words: None,
) -> Tracked:
    """Run dip, imuposer, imuposer-adam or hybrid over the recording, sample by sample.

    Raises PoserError where the recording's sensors do not serve the method.
    """
    from mocap.estimator import replay
    from poser.estimators import make

    estimator = make(
        method,
        recording.rate_hz,
        recording.sensors,
        network=network,
        weights=weights,
        window=window,
    )
    run = replay(estimator, recording, lambda share: progress(share, method))
    return Tracked(
        run.motion,
        method,
        network,
        run.frame_s,
        estimator.look_ahead_frames,
        run.notes,
        run.std_rad,
    )
