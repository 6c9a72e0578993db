"""The z-buffer against geometry."""

from __future__ import annotations

import numpy as np
import pytest

from mocap.body.capsules import capsule
from poser.render.raster import Camera, hits
from poser.render.scene import Thing, boxes, draw

SIZE = (64, 48)


def flat(x: list[float], y: list[float], depth: float | list[float]) -> np.ndarray:
    return np.stack([x, y, np.broadcast_to(depth, len(x))], axis=-1).astype(float)


SQUARE = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@pytest.mark.parametrize("cull", [True, False])
def test_a_square_of_two_triangles_covers_every_pixel_once(cull: bool) -> None:
    seen = flat([5, 5, 40, 40], [3, 30, 30, 3], 2.0)
    found = hits(seen, SQUARE, SIZE, cull)
    assert len(found.pixel) == len(set(found.pixel)) == 35 * 27
    rows, columns = np.divmod(found.pixel, SIZE[0])
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (3, 29, 5, 39)
    np.testing.assert_allclose(found.share.sum(axis=1), 1, atol=1e-9)


def test_what_faces_away_is_left_out() -> None:
    seen = flat([5, 5, 40, 40], [3, 30, 30, 3], 2.0)
    assert len(hits(seen, SQUARE[:, ::-1], SIZE).pixel) == 0
    assert len(hits(seen, SQUARE[:, ::-1], SIZE, cull=False).pixel) == 35 * 27


def test_the_nearest_is_seen_whatever_the_order() -> None:
    near, far = flat([5, 5, 40, 40], [3, 30, 30, 3], 1.0), flat([0, 0, 60, 60], [0, 45, 45, 0], 2.0)
    for a, b, first in ((near, far, 0), (far, near, 2)):
        found = hits(np.concatenate([a, b]), np.concatenate([SQUARE, SQUARE + 4]), SIZE)
        assert np.isin(found.face, [first, first + 1]).sum() == 35 * 27
        assert len(found.pixel) == 60 * 45


def test_depth_is_that_of_a_plane_in_perspective() -> None:
    """Points a + s u + t v of a plane: where a pixel's ray meets it, depth = n.a / n.ray."""
    camera = Camera(np.zeros(3), np.array([0.0, 0, 1]), 60.0, SIZE)
    corners = np.array([[-1.0, -1, 3], [-1.5, 1, 4], [1.5, 1, 7], [1, -1, 6]])
    corners[3] = corners[0] + (corners[2] - corners[1])  # in one plane
    found = hits(camera.project(corners), SQUARE, SIZE, cull=False)
    assert len(found.pixel) > 300
    row, column = np.divmod(found.pixel, SIZE[0])
    ray = np.stack([column + 0.5 - 32, row + 0.5 - 24, np.full(len(row), 60.0)], -1) / 60
    ray = ray @ camera.R_world_camera.T
    n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    np.testing.assert_allclose(found.depth, n @ corners[0] / (ray @ n), rtol=1e-6)


def test_a_ball_is_a_disc_of_its_size() -> None:
    vertices, faces = capsule(np.zeros(3), np.array([0, 1e-6, 0]), 0.5)
    camera = Camera(np.array([0.0, 0, 20]), np.zeros(3), 1600.0, (200, 200))
    found = hits(camera.project(vertices), faces, camera.size)
    exact = np.pi * (1600 * 0.5 / 20) ** 2
    assert 0.95 * exact < len(found.pixel) < 1.01 * exact
    assert found.depth.min() == pytest.approx(19.5, abs=0.02)


def test_what_is_behind_the_camera_is_not_seen() -> None:
    camera = Camera(np.array([0.0, 0, 1]), np.zeros(3), 100.0, SIZE)
    behind = np.array([[-1.0, -1, 3], [1, -1, 3], [0, 1, 3]])
    assert len(hits(camera.project(behind), np.array([[0, 1, 2]]), SIZE, cull=False).pixel) == 0


def test_a_picture_has_its_bodies_where_they_are() -> None:
    camera = Camera(np.array([0.0, 1, 6]), np.array([0.0, 1, 0]), 300.0, (160, 120))
    empty = np.asarray(draw(camera, []), int)
    left = boxes(np.eye(3)[None], np.array([[-0.5, 1.0, 0.0]]))
    big = Thing(left.vertices * 1.0, left.faces, left.normals, (200, 0, 0))
    changed = np.abs(np.asarray(draw(camera, [big]), int) - empty).sum(axis=-1) > 60
    rows, columns = np.nonzero(changed)
    # x to the right, 300 / 6 pixels a metre
    assert columns.mean() == pytest.approx(80 - 25, abs=2) and rows.mean() == pytest.approx(
        60, abs=2
    )
