"""A picture of bodies on a floor: skins and sensors through the z-buffer, shadows, labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from mocap.orientation import Array
from poser.render.raster import Camera, hits

Colour = tuple[int, int, int]

FINE = 2  # pixels are computed so many times finer each way, then averaged
SKY, GROUND = (250, 251, 252), (232, 235, 238)
LINE = (205, 210, 215)
SHADOW = 0.72  # of the light
SUN = np.array([0.35, 0.85, 0.4]) / np.linalg.norm([0.35, 0.85, 0.4])
FLOOR_M, CELL_M = 6.0, 0.5
SENSOR_COLOUR = (236, 120, 32)
SENSOR_M = np.array([0.024, 0.034, 0.010])  # half of its edges


@dataclass(frozen=True, eq=False)
class Thing:
    """A mesh to draw: vertices (V,3) m, faces (F,3), unit normals (V,3), its colour."""

    vertices: Array
    faces: NDArray[np.int32]
    normals: Array
    colour: Colour


@dataclass(frozen=True)
class Label:
    """Words at a place (3,) m in the world, under their end."""

    text: str
    at: Array
    colour: Colour = (60, 64, 68)


def boxes(R_world: Array, p_world: Array) -> Thing:
    """Sensors (S,3,3), (S,3) m as small boxes."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    sides, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            quad = corner[corner[:, axis] == sign]
            quad = quad[[0, 1, 3, 2]]
            n = np.cross(quad[1] - quad[0], quad[2] - quad[0])
            sides.append(quad if n[axis] * sign > 0 else quad[::-1])
            normals.append(np.eye(3)[axis] * sign)
    local = np.concatenate(sides) * SENSOR_M
    n_local = np.repeat(normals, 4, axis=0)
    k = np.arange(0, 24, 4)[:, None]
    faces = np.concatenate([k + np.array(three) for three in ((0, 1, 2), (0, 2, 3))])
    v = np.einsum("sij,vj->svi", R_world, local) + p_world[:, None]
    n = np.einsum("sij,vj->svi", R_world, n_local)
    every = np.concatenate([faces + 24 * s for s in range(len(v))] or [faces[:0]])
    return Thing(v.reshape(-1, 3), every.astype(np.int32), n.reshape(-1, 3), SENSOR_COLOUR)


def draw(camera: Camera, things: Sequence[Thing], labels: Sequence[Label] = ()) -> Image.Image:
    """The picture, of the camera's size. The floor is y = 0."""
    fine = _scaled(camera, FINE)
    picture = _background(fine, camera.target)
    _shadow(picture, camera, things)
    if things:
        _paint(picture, fine, things)
    out = picture.reduce(FINE)
    pen = ImageDraw.Draw(out)
    for label in labels:
        x, y, depth = camera.project(label.at)
        if depth > 0.1:
            write(pen, label.text, (x, y), label.colour, anchor="mb")
    return out


def write(
    pen: ImageDraw.ImageDraw, text: str, at: tuple[float, float], colour: Colour = (60, 64, 68),
    anchor: str = "la", size: int = 15,
) -> None:  # fmt: skip
    """Words at a pixel. anchor: which of their ends is there (as Pillow has it)."""
    pen.text(at, text, fill=colour, font=font(size), anchor=anchor)


@cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """The typeface that comes with matplotlib."""
    import matplotlib

    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts/ttf/DejaVuSans.ttf"), size)


def _scaled(camera: Camera, factor: float) -> Camera:
    width, height = camera.size
    size = (round(width * factor), round(height * factor))
    return Camera(camera.eye, camera.target, camera.focal * factor, size)


def _background(camera: Camera, middle: Array) -> Image.Image:
    """Ground that becomes sky, and lines every CELL_M around `middle` that fade away."""
    height = camera.size[1]
    rise = np.linspace(0.0, 1.0, height)[:, None, None]
    shade = np.array(SKY) + (np.array(GROUND) - SKY) * np.clip(2.2 * rise - 0.6, 0, 1)
    picture = Image.fromarray(shade.astype(np.uint8)).resize(camera.size, Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(picture)
    n = round(FLOOR_M / CELL_M)
    origin = np.round(middle / CELL_M) * CELL_M * [1, 0, 1]
    steps = np.arange(-n, n + 1) * CELL_M
    thick = max(1, round(height / 900))
    for along in (0, 2):
        start = np.zeros((len(steps), len(steps) - 1, 3))
        start[..., 2 - along] = steps[:, None]
        start[..., along] = steps[:-1]
        end = start + CELL_M * np.eye(3)[along]
        a, b = camera.project(origin + start), camera.project(origin + end)
        far = np.linalg.norm(origin + (start + end) / 2 - middle * [1, 0, 1], axis=-1)
        fade = np.clip(1 - far / FLOOR_M, 0, 1) ** 0.8
        shown = (np.minimum(a[..., 2], b[..., 2]) > 0.1) & (fade > 0.02)
        rows = np.clip((a[..., 1] + b[..., 1]) / 2, 0, height - 1).astype(int)
        under = shade[rows, 0]
        ink = under + fade[..., None] * (np.array(LINE) - under)
        for p, q, colour in zip(a[shown], b[shown], ink[shown], strict=True):
            line = (float(p[0]), float(p[1]), float(q[0]), float(q[1]))
            pen.line(line, fill=tuple(int(c) for c in colour), width=thick)
    return picture


def _shadow(picture: Image.Image, camera: Camera, things: Sequence[Thing]) -> None:
    """Darken the floor where the sun does not reach it: coarse and blurred."""
    half = _scaled(camera, 0.5)
    mask = np.zeros(half.size[0] * half.size[1], np.uint8)
    for thing in things:
        flat = thing.vertices - thing.vertices[:, 1:2] / SUN[1] * SUN
        mask[hits(half.project(flat), thing.faces, half.size, cull=False).pixel] = 255
    soft = Image.fromarray(mask.reshape(half.size[::-1]))
    soft = soft.filter(ImageFilter.GaussianBlur(half.size[1] / 150))
    soft = soft.resize(picture.size, Image.Resampling.BILINEAR)
    dark = picture.point([int(c * SHADOW) for c in range(256)] * 3)
    picture.paste(dark, mask=soft)


def _paint(picture: Image.Image, camera: Camera, things: Sequence[Thing]) -> None:
    """The nearest triangle at every pixel: light from the sun, from the sky and from the eye."""
    vertices = np.concatenate([t.vertices for t in things])
    normals = np.concatenate([t.normals for t in things])
    starts = np.cumsum([0, *(len(t.vertices) for t in things)])
    faces = np.concatenate([t.faces + s for t, s in zip(things, starts, strict=False)])
    paint = np.repeat(
        np.array([t.colour for t in things], float), [len(t.faces) for t in things], 0
    )
    found = hits(camera.project(vertices), faces, camera.size)
    n = np.einsum("nk,nki->ni", found.share, normals[faces[found.face]])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    facing = np.clip(-n @ camera.R_world_camera[:, 2], 0, 1)
    light = 0.34 + 0.50 * np.clip(n @ SUN, 0, 1) + 0.10 * n[:, 1] + 0.22 * facing
    gloss = 40 * np.clip(n @ _halfway(camera), 0, 1) ** 30
    shade = np.clip(paint[found.face] * light[:, None] + gloss[:, None], 0, 255)
    pixels = np.array(picture).reshape(-1, 3)
    pixels[found.pixel] = shade.astype(np.uint8)
    picture.paste(Image.fromarray(pixels.reshape(camera.size[1], camera.size[0], 3)))


def _halfway(camera: Camera) -> Array:
    both = SUN - camera.R_world_camera[:, 2]
    return np.asarray(both / np.linalg.norm(both))
