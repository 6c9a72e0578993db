"""Tracks as pictures: side by side in a film, or in rows and columns of moments."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import uniform_filter1d

from mocap import orientation as ori
from mocap.body import Look, skin
from mocap.errors import PoserError
from mocap.orientation import Array
from mocap.synthesis.staging import floors_of
from poser.render.raster import Camera
from poser.render.scene import Label, Thing, boxes, draw, font, write
from poser.viewer.stage import COLOURS, LABEL_ABOVE_M
from poser.viewer.tracks import Clock, Track, clock

Tell = Callable[[float, str], None]

AROUND_M = 0.14  # of the joints: a body's flesh
OVER_M = 0.30  # the head joint: head and label
TILT = np.radians(8.0)
FIELD = np.radians(28.0)  # of view, upright
FOLLOW_S = 2.0  # a camera that follows a path follows its mean over so long
GIF_COLOURS = 128


class Stage:
    """Bodies of tracks before a camera.

    view_deg: where the camera stands about the first body as it begins: 0 before it, 90 at its left. body:
    how they look (`mocap.body.skin`). Several bodies stay side by side without their paths; one alone
    walks, and the camera goes along. The floor is under the feet. The camera is as far as the widest
    pose of all needs.
    """

    def __init__(self, tracks: Sequence[Track], view_deg: float = 25.0, body: Look | None = None):
        self.tracks = tracks
        self.clock: Clock = clock(tracks)
        self._skins = [skin(t.motion.skeleton, body) for t in tracks]
        self._floors = [floors_of(t.motion) for t in tracks]
        first = tracks[0].motion
        begin = tracks[0].frame(self.clock.first - self.clock.starts[0])
        facing = float(ori.heading(first.R_parent_joint[begin, 0])) + np.radians(view_deg)
        self._back = np.array([np.sin(facing), 0.0, np.cos(facing)])
        self.right = np.cross([0.0, 1.0, 0.0], self._back)
        width = max(1, round(FOLLOW_S * first.rate_hz))
        self._path = uniform_filter1d(first.p_world_root * [1, 0, 1], width, axis=0, mode="nearest")
        self.wide, self._low, self._high = self._extent()

    def _extent(self) -> tuple[float, float, float]:
        """The width of a body's place, its lowest and its highest point, m: of all poses."""
        wide, low, high = 0.0, 0.0, 0.0
        for track, floors in zip(self.tracks, self._floors, strict=True):
            p = track.motion.p_world_joint - floors[:, None, None] * [0, 1, 0]
            side = (p - p[:, :1]) @ self.right
            wide = max(wide, 2 * float(np.abs(side).max()) + 2 * AROUND_M)
            low = min(low, float(p[..., 1].min()) - AROUND_M / 2)
            high = max(high, float(p[..., 1].max()) + OVER_M)
        return wide, low, high

    def camera(self, target: Array, size: tuple[int, int], bodies: int) -> Camera:
        """One that has so many bodies in its picture."""
        width, height = size
        focal = height / 2 / np.tan(FIELD / 2)
        wide = self.wide * bodies
        # What is nearer than the target, and leaves the picture first, needs some more.
        distance = focal * 1.08 * max((self._high - self._low) / height, wide / width)
        away = self._back * np.cos(TILT) + np.array([0.0, np.sin(TILT), 0.0])
        centre = target * [1, 0, 1] + np.array([0.0, (self._low + self._high) / 2, 0.0])
        return Camera(centre + distance * away, centre, focal, size)

    def picture(self, time_s: float, size: tuple[int, int]) -> Image.Image:
        """All bodies at a time."""
        alone = len(self.tracks) == 1
        k = self.frame(0, time_s)
        target = self._path[k] if alone else np.zeros(3)
        things, labels = [], []
        for i, track in enumerate(self.tracks):
            place = None if alone else (i - (len(self.tracks) - 1) / 2) * self.wide * self.right
            more, above = self.body(i, time_s, place)
            things += more
            labels.append(Label(track.label, above))
        out = draw(self.camera(target, size, len(self.tracks)), things, labels)
        write(ImageDraw.Draw(out), f"{time_s:.2f} s", (12, 10))
        return out

    def cell(self, i: int, time_s: float, size: tuple[int, int]) -> Image.Image:
        """One body at a time, without words."""
        things, _ = self.body(i, time_s, np.zeros(3))
        return draw(self.camera(np.zeros(3), size, 1), things)

    def frame(self, i: int, time_s: float) -> int:
        """A track's frame at a time of the clock."""
        return self.tracks[i].frame(time_s - self.clock.starts[i])

    def body(self, i: int, time_s: float, place: Array | None) -> tuple[list[Thing], Array]:
        """What there is of a track, and the place (3,) m over its head.

        place: of the pelvis on the floor; None leaves it on its path.
        """
        track, k = self.tracks[i], self.frame(i, time_s)
        motion = track.motion
        shift = -np.array([0.0, self._floors[i][k], 0.0])
        if place is not None:
            shift += place - motion.p_world_root[k] * [1, 0, 1]
        p = motion.p_world_joint[k] + shift
        look = self._skins[i]
        vertices = look.posed(motion.R_world_joint[k], p)
        colour = COLOURS[i % len(COLOURS)]
        things = [Thing(vertices, look.faces, look.normals(vertices), colour)]
        if track.sensors is not None:
            s = track.sensors
            ok = s.valid[k]
            things.append(boxes(s.R_world_bone[k, ok], s.p_world[k, ok] + shift))
        return things, p[15] + [0.0, LABEL_ABOVE_M - 0.04, 0.0]


def strip(stage: Stage, times: Sequence[float], cell: tuple[int, int], tell: Tell) -> Image.Image:
    """A row a track, a column a time, names at the left and times above."""
    left, top = 34, 30
    rows, columns = len(stage.tracks), len(times)
    out = Image.new("RGB", (left + columns * cell[0], top + rows * cell[1]), "white")
    pen = ImageDraw.Draw(out)
    for c, t in enumerate(times):
        write(pen, f"{t:.1f} s", (left + (c + 0.5) * cell[0], top - 8), anchor="mb")
        for r in range(rows):
            tell((c * rows + r) / (rows * columns), f"picture {c * rows + r + 1}")
            out.paste(stage.cell(r, t, cell), (left + c * cell[0], top + r * cell[1]))
    for r, track in enumerate(stage.tracks):
        out.paste(_upright(track.label, cell[1]), (4, top + r * cell[1]))
    return out


def _upright(text: str, length: int) -> Image.Image:
    """A name written upwards, shortened to fit."""
    out = Image.new("RGB", (length, 26), "white")
    pen = ImageDraw.Draw(out)
    while len(text) > 4 and pen.textlength(text, font=font(15)) > length - 8:
        text = text[:-2].rstrip("…") + "…"
    write(pen, text, (length / 2, 13), anchor="mm")
    return out.rotate(90, expand=True)


def frames(
    stage: Stage, begin: float, end: float, fps: float, size: tuple[int, int], tell: Tell
) -> Iterator[Image.Image]:
    """Pictures every 1/fps s from `begin` to `end`."""
    count = max(1, round((end - begin) * fps) + 1)
    for k in range(count):
        tell(k / count, f"frame {k + 1} of {count}")
        yield stage.picture(min(end, begin + k / fps), size)


def write_gif(path: Path, pictures: Iterator[Image.Image], fps: float) -> None:
    """An animation that goes on for ever; GIF's time counts in hundredths of a second."""
    made = [p.quantize(GIF_COLOURS, dither=Image.Dither.NONE) for p in pictures]
    made[0].save(
        path, format="GIF", save_all=True, append_images=made[1:], loop=0, optimize=False,
        duration=10 * round(100 / fps),
    )  # fmt: skip


def write_mp4(
    path: Path, pictures: Iterator[Image.Image], fps: float, size: tuple[int, int]
) -> None:
    """H.264 in MP4, by ffmpeg. Raises PoserError where its package is absent, OSError where it fails or the
    film is not whole: of a full disk, ffmpeg tells nothing that its package passes on."""
    try:
        import imageio_ffmpeg
    except ImportError as e:
        raise PoserError(
            "films need the package 'imageio-ffmpeg': pip install 'poser-imu[render]' (.gif and .png do not)"
        ) from e
    film = imageio_ffmpeg.write_frames(
        str(path), size, fps=fps, codec="libx264", pix_fmt_in="rgb24", pix_fmt_out="yuv420p",
        quality=8, macro_block_size=2, ffmpeg_log_level="error",
        output_params=["-movflags", "+faststart"],
    )  # fmt: skip
    sent = 0
    try:
        with closing(film):
            film.send(None)
            for picture in pictures:
                film.send(picture.tobytes())
                sent += 1
    except OSError as e:
        raise OSError(
            errno.EIO, f"ffmpeg could not write the film: {str(e).splitlines()[0]}"
        ) from e
    try:
        there, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError:
        there = 0
    if there != sent:
        raise OSError(
            errno.EIO,
            f"ffmpeg wrote {there} of {sent} pictures that can be read; is the disk full?",
        )
