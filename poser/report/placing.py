"""Where a method's skeleton is drawn beside the reference: few methods know where the body is."""

from __future__ import annotations

from mocap.orientation import Array


def beside(p: Array, reference: Array) -> Array:
    """Joints (...,24,3) m moved so that the pelvis is above the reference's and both stand on one floor.

    The lowest joint comes to the height of the reference's lowest: the feet of a body that stands where the
    reference squats are not under the floor. Rotations are untouched.
    """
    shift = reference[..., 0, :] - p[..., 0, :]
    shift[..., 1] = reference[..., 1].min(axis=-1) - p[..., 1].min(axis=-1)
    moved: Array = p + shift[..., None, :]
    return moved
