"""The viewer as a browser shows it: real canvas pixels, and no request to anywhere else."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import matplotlib.image
import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

from mocap import sensors, synthesis
from mocap.estimator import Pose
from mocap.motion import Motion
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.viewer import stage
from poser.viewer.live import ViewerSink
from poser.viewer.player import Player
from poser.viewer.tracks import Track, as_measured, sensors_on

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-sync",
    "--disable-component-update", "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
    "--window-size=1000,640", "--force-device-scale-factor=0.5", "--remote-debugging-port=0",
)  # fmt: skip
pytestmark = [
    # Without a graphics card a picture takes seconds, on a machine busy with other work many more.
    pytest.mark.timeout(600),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine"),
    # viser's own threads and sockets outlive its stop by a moment.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


class Page:
    """One page of a headless Chromium, driven over its debugging protocol."""

    def __init__(self, socket: ClientConnection):
        self._socket, self._count = socket, 0
        self.requests: list[str] = []
        self._loaded = False

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": params}))
        while True:
            said = json.loads(self._socket.recv(timeout=120))
            self._note(said)
            if said.get("id") == self._count:
                assert "error" not in said, said
                return said["result"]

    def go(self, url: str) -> None:
        """Open a page and wait until it has loaded: before, it is not there to be looked at."""
        self.call("Network.enable")
        self.call("Page.enable")
        self.call("Page.navigate", url=url)
        # The event may have come before the answer to the call.
        while not self._loaded:
            self._note(json.loads(self._socket.recv(timeout=120)))

    def _note(self, said: dict[str, Any]) -> None:
        self._loaded |= said.get("method") == "Page.loadEventFired"
        if said.get("method") == "Network.requestWillBeSent":
            self.requests.append(said["params"]["request"]["url"])
        if said.get("method") == "Network.webSocketCreated":
            self.requests.append(said["params"]["url"])

    def text(self) -> str:
        found = self.call("Runtime.evaluate", expression="document.body.innerText")
        return str(found["result"].get("value"))

    def picture(self) -> np.ndarray:
        data = base64.b64decode(self.call("Page.captureScreenshot")["data"])
        return matplotlib.image.imread(io.BytesIO(data), format="png")[..., :3]

    def until(self, fits: Callable[[np.ndarray], bool], seconds: float = 120.0) -> np.ndarray:
        """The first picture that fits; fails with the last one."""
        end = time.monotonic() + seconds
        while True:
            picture = self.picture()
            if fits(picture):
                return picture
            assert time.monotonic() < end, f"nothing in the picture: {ink(picture)}"
            time.sleep(0.3)


@contextmanager
def opened(url: str, folder: Path) -> Iterator[Page]:
    assert CHROMIUM is not None
    with subprocess.Popen(
        [CHROMIUM, *FLAGS, f"--user-data-dir={folder / 'profile'}", "about:blank"],
        stderr=subprocess.PIPE, text=True,
    ) as browser:  # fmt: skip
        try:
            assert browser.stderr is not None
            found = next(
                m for m in (re.search(r"ws://127.0.0.1:(\d+)/", x) for x in browser.stderr) if m
            )
            pages = _json(f"http://127.0.0.1:{found.group(1)}/json")
            target = next(p for p in pages if p["type"] == "page")["webSocketDebuggerUrl"]
            with connect(target, max_size=None) as socket:
                page = Page(socket)
                page.go(url)
                yield page
        finally:
            browser.terminate()


def _json(url: str) -> Any:
    from urllib.request import urlopen

    with urlopen(url, timeout=30) as answer:
        return json.load(answer)


def ink(picture: np.ndarray, colour: tuple[int, int, int] | None = None) -> float:
    """Share of the picture that is coloured; with `colour`, that has its hue."""
    saturated = picture.max(axis=2) - picture.min(axis=2) > 0.15
    if colour is not None:
        wanted = np.array(colour) - np.mean(colour)
        hue = picture - picture.mean(axis=2, keepdims=True)
        cos = hue @ wanted / (np.linalg.norm(hue, axis=2) * np.linalg.norm(wanted) + 1e-9)
        saturated &= cos > 0.95
    return float(scene(saturated).mean())


def scene(picture: np.ndarray) -> np.ndarray:
    """Without the controls at the right and the browser's notices at the top left."""
    height, width = picture.shape[:2]
    return picture[int(0.27 * height) :, : int(0.66 * width)]


def everything_is_local(page: Page) -> None:
    hosts = {urlsplit(u).hostname for u in page.requests if not u.startswith(("data:", "blob:"))}
    assert hosts == {"127.0.0.1"}


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    return tmp_path


def walk() -> Motion:
    return motions.walk(4.0)


def test_bodies_side_by_side(shots: Path) -> None:
    recording = synthesis.recording(walk(), sensors.SIX, synthesis.Noise(), rng=1)
    measured = as_measured(recording)
    tracks = [
        Track("truth.npz", walk(), sensors_on(recording, walk())),
        Track("measured.npz", measured, sensors_on(recording, measured)),
    ]
    made = stage.server("127.0.0.1", 18080)
    try:
        player = Player(made, tracks)
        player.playing = False
        with opened(f"http://127.0.0.1:{made.get_port()}", shots) as page:
            # Both bodies are there, in their colours, about as large as each other.
            both = page.until(lambda p: all(ink(p, c) > 0.004 for c in stage.COLOURS[:2]))
            matplotlib.image.imsave(shots / "two.png", both)
            first, second = (ink(both, c) for c in stage.COLOURS[:2])
            assert 0.4 < first / second < 2.5
            words = page.text()
            assert "Play" in words and "time, s" in words and "in place" in words
            # Time moves them.
            player.time_s = 2.0
            player.show()
            later = page.until(lambda p: float(np.abs(scene(p - both)).mean()) > 0.003)
            matplotlib.image.imsave(shots / "later.png", later)
            everything_is_local(page)
    finally:
        stage.stop(made)


def test_live_poses(shots: Path) -> None:
    sink = ViewerSink(Skeleton.default(), 18090)
    try:
        with opened(sink.url, shots) as page:
            motion = walk()
            sink.write(Pose(0.0, motion.R_parent_joint[0], motion.p_world_root[0]))
            sink.tell("latency 12.3 ms")
            picture = page.until(lambda p: ink(p, stage.COLOURS[0]) > 0.004)
            matplotlib.image.imsave(shots / "live.png", picture)
            assert "latency 12.3 ms" in page.text()
            everything_is_local(page)
            for metre in range(1, 13):  # out of the picture, if it stood still
                sink._next_s = 0.0
                sink.write(
                    Pose(0.1 * metre, motion.R_parent_joint[0], np.array([-metre, 0.9, 0.0]))
                )
            page.until(lambda p: ink(p, stage.COLOURS[0]) > 0.004)
    finally:
        assert sink.close() == {"url": "http://127.0.0.1:18090", "shown": 13}
