"""A sink: poses in the browser as they come."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from mocap.estimator import Pose
from mocap.skeleton import Skeleton
from poser.live.addresses import LOCALHOST
from poser.viewer import stage

RATE_HZ = 30.0


class ViewerSink:
    """Shows at most RATE_HZ poses per second; `url` is the page."""

    def __init__(self, skeleton: Skeleton, port: int, host: str = LOCALHOST):
        self.name = "viewer"
        self._skeleton = skeleton
        self._server = stage.server(host, port)
        self.url = f"http://{host}:{self._server.get_port()}"
        self._figure = stage.Figure(self._server, 0, "live", skeleton, np.zeros(3))
        stage.floor(self._server)
        stage.look_from(self._server, np.array([0.0, 0.95, 0.0]), 0.0)
        self._text = self._server.gui.add_markdown("waiting for sensors")
        self._next_s = -np.inf
        self.shown = 0

    def write(self, pose: Pose) -> None:
        now = time.monotonic()
        if now < self._next_s:
            return
        self._next_s = now + 1.0 / RATE_HZ
        R, p = self._skeleton.forward(pose.R_parent_joint, pose.p_world_root)
        with self._server.atomic():
            self._figure.pose(R, p)
        self.shown += 1

    def tell(self, text: str) -> None:
        """A line in the page: how it goes."""
        self._text.content = text

    def close(self) -> dict[str, Any]:
        stage.stop(self._server)
        return {"shown": self.shown}
