"""The scene: a floor, bodies side by side with their labels, sensors as axes."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import socket
from typing import Any

import numpy as np

from mocap import orientation as ori
from mocap.body import Look, skin
from mocap.errors import PoserError
from mocap.orientation import Array
from mocap.skeleton import Skeleton
from poser.live.addresses import LAST_PORT, Address, resolved
from poser.viewer.guard import guarded

COLOURS = (
    (62, 126, 196),
    (224, 130, 60),
    (86, 164, 100),
    (170, 100, 180),
    (200, 80, 90),
    (120, 120, 120),
)
AXES_M = 0.14
CAMERA_M = 2.7  # from a single body
PORTS = 100  # tried from the one that was asked for
LABEL_ABOVE_M = 0.28  # over the head joint


def server(host: str, port: int) -> Any:
    """A viser server on `port`, or the next free one; on any free one for 0.

    Raises PoserError where the package is absent, or nothing can be bound there.
    """
    try:
        import viser
    except ImportError as e:
        raise PoserError("the viewer needs the package 'viser': pip install viser") from e
    numeric, free = _free(host, port)

    class Server(viser.ViserServer):  # type: ignore[misc]
        """Its share request, which any client may send, would send the scene to a relay on the internet."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            return None

        def disconnect_share_url(self) -> None:
            return

    with _mute(), guarded(host, f"viser-v{viser.__version__}"):
        made = Server(host=numeric, port=free, label="poser", verbose=False)
    made.gui.configure_theme(show_logo=False, show_share_button=False)
    made.scene.set_up_direction("+y")
    return made


def _free(host: str, port: int) -> tuple[str, int]:
    """A host as a number and a port that can be bound, from `port` on. Raises PoserError.

    viser binds in a thread of its own, and waits for ever where that fails.
    """
    address = Address(host, port)
    name = f"cannot serve on {address}"
    family, to = resolved(address, name, socket.SOCK_STREAM)
    last = min(port + PORTS - 1, LAST_PORT)
    for tried in range(port, last + 1):
        try:
            # As the server will bind: a port that was left a moment ago is free.
            with socket.create_server((to[0], tried, *to[2:]), family=family) as bound:
                return to[0], bound.getsockname()[1]
        except OSError as e:
            if e.errno != errno.EADDRINUSE:
                raise PoserError(f"{name}: {_reason(e)}") from e
    raise PoserError(f"{name}: it is taken, and so are all ports up to {last}")


def _reason(e: OSError) -> str:
    if e.errno == errno.EADDRNOTAVAIL:
        return "this machine does not have that address"
    return os.strerror(e.errno) if e.errno else str(e)


def stop(made: Any) -> None:
    """Stop a server of `server`."""
    with _mute():
        made.stop()


def _mute() -> Any:
    """viser prints a greeting and a farewell, whatever `verbose` says; stdout is for the answer."""
    return contextlib.redirect_stdout(io.StringIO())


def floor(made: Any, size_m: float = 12.0) -> None:
    """A grid of half metres on y = 0."""
    made.scene.add_grid(
        "/floor", width=size_m, height=size_m, plane="xz", cell_size=0.5, section_size=1.0,
        cell_color=(210, 210, 210), section_color=(165, 165, 165), shadow_opacity=0.2,
    )  # fmt: skip


def look_from(made: Any, centre: Array, width_m: float) -> None:
    """New cameras stand before the bodies, a little to the side and above."""
    distance = CAMERA_M + 0.7 * width_m
    made.initial_camera.up = (0.0, 1.0, 0.0)
    made.initial_camera.fov = float(np.deg2rad(45.0))
    made.initial_camera.position = tuple(centre + distance * np.array([0.25, 0.22, 0.94]))
    made.initial_camera.look_at = tuple(centre)


class Figure:
    """One body in the scene. index: its number, for name and colour. shift: (3,) m, where it stands.

    body: how it looks (`mocap.body.skin`).
    """

    def __init__(
        self, made: Any, index: int, label: str, skeleton: Skeleton, shift: Array,
        sensors: int = 0, body: Look | None = None,
    ):  # fmt: skip
        self._skeleton, self._shift = skeleton, shift
        look = skin(skeleton, body)
        name = f"/body{index}"
        still = np.tile([1.0, 0, 0, 0], (len(look.rest), 1))
        self._mesh = made.scene.add_mesh_skinned(
            f"{name}/skin",
            look.vertices.astype(np.float32),
            look.faces,
            bone_wxyzs=still,
            bone_positions=look.rest,
            skin_weights=look.weights,
            color=COLOURS[index % len(COLOURS)],
        )
        self._label = made.scene.add_label(f"{name}/label", label, anchor="bottom-center")
        self._axes = None
        if sensors:
            self._axes = made.scene.add_batched_axes(
                f"{name}/sensors",
                batched_wxyzs=np.tile([1.0, 0, 0, 0], (sensors, 1)),
                batched_positions=np.zeros((sensors, 3)),
                batched_scales=np.ones(sensors),
                axes_length=AXES_M,
                axes_radius=0.008,
            )

    @property
    def label(self) -> str:
        """What stands over the head."""
        return str(self._label.text)

    @label.setter
    def label(self, text: str) -> None:
        if text != self._label.text:
            self._label.text = text

    def pose(self, R_world_joint: Array, p_world_joint: Array) -> None:
        """Move the body: global rotations (24,3,3) and joints (24,3) m."""
        wxyz, p = ori.to_quat(R_world_joint), p_world_joint + self._shift
        for j, bone in enumerate(self._mesh.bones):
            bone.wxyz, bone.position = wxyz[j], p[j]
        self._label.position = p[15] + [0.0, LABEL_ABOVE_M, 0.0]

    def show_sensors(self, R_world: Array, p_world: Array, valid: np.ndarray) -> None:
        """Move the axes: (S,3,3), (S,3) m; those that are not valid vanish."""
        if self._axes is not None:
            self._axes.batched_wxyzs = ori.to_quat(R_world).astype(np.float32)
            self._axes.batched_positions = (p_world + self._shift).astype(np.float32)
            self._axes.batched_scales = np.where(valid, 1.0, 1e-6).astype(np.float32)
