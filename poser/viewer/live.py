"""A sink: poses in the browser as they come."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from mocap.body import Look
from mocap.estimator import Pose
from mocap.skeleton import Skeleton
from poser.live.addresses import LOCALHOST, Address
from poser.viewer import stage

RATE_HZ = 30.0
FOLLOW_M = 0.5  # the body may walk so far from where cameras look before they go along
EYES = np.array([0.0, 0.95, 0.0])
REST = np.tile(np.eye(3), (24, 1, 1))


def plain(text: str) -> str:
    """A line without what Markdown or HTML could mean: devices of strangers are named in it, and such a name
    must not make the page load or run anything."""
    return re.sub(r"[^\w .,:;()%@+-]", "?", text)


class ViewerSink:
    """Shows at most RATE_HZ poses per second; `url` is the page."""

    def __init__(
        self, skeleton: Skeleton, port: int, host: str = LOCALHOST, body: Look | None = None
    ):
        self.name = "viewer"
        self._skeleton = skeleton
        self._server = stage.server(host, port)
        self.url = f"http://{Address(host, self._server.get_port())}"
        self._figure = stage.Figure(self._server, 0, "live", skeleton, np.zeros(3), body=body)
        # Until the first pose it stands on the floor, arms out.
        _, p = skeleton.forward(REST, np.zeros(3))
        p[:, 1] += skeleton.sole - p[:, 1].min()
        self._figure.pose(REST, p)
        stage.floor(self._server)
        self._centre = np.zeros(3)
        stage.look_from(self._server, EYES, 0.0)
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
        self._follow(p[0])
        self.shown += 1

    def _follow(self, place: np.ndarray) -> None:
        """Take the cameras along, those of open pages as their users have turned them."""
        away = (place - self._centre) * [1.0, 0.0, 1.0]
        distance = float(np.linalg.norm(away))
        if distance <= FOLLOW_M:
            return
        move = away * (1 - FOLLOW_M / distance)
        self._centre = self._centre + move
        stage.look_from(self._server, self._centre + EYES, 0.0)
        for client in self._server.get_clients().values():
            with suppress(AssertionError):  # a page that has not told yet where its camera is
                client.camera.position = client.camera.position + move

    def tell(self, text: str) -> None:
        """A line in the page: how it goes."""
        self._text.content = plain(text)

    def offer(self, words: Mapping[str, str], ask: Callable[[str], None]) -> None:
        """A button for each of these {name: words}."""
        for name, label in words.items():
            button = self._server.gui.add_button(label)
            button.on_click(lambda _, name=name: ask(name))

    def close(self) -> dict[str, Any]:
        stage.stop(self._server)
        return {"url": self.url, "shown": self.shown}
