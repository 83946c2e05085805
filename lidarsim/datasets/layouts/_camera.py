"""What of a box a pinhole camera sees."""

from __future__ import annotations

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim._base.vectors import matvec, product

FACES = (
    (0, 1, 3, 2), (4, 6, 7, 5),  # x
    (0, 4, 5, 1), (2, 3, 7, 6),  # y
    (0, 2, 6, 4), (1, 5, 7, 3),  # z
)  # fmt: skip
"""Corners of the faces of a box, in the order of ``numpy.ndindex(2, 2, 2)``, counterclockwise seen from outside."""


def view_of_box(corners: Floats, projection: Floats, width: int, height: int) -> tuple[tuple[float, ...], float] | None:
    """Return the rectangle of the image around the visible part of a box, and the share of its volume out of view.

    The view is the cone from the camera through the pixels. Its four sides go through the camera, so the part of the
    box in it has the volume of the pyramids from the camera to what of the box's faces is in view, which count as
    negative where a face looks towards the camera: the sides of the cone add pyramids of no height.

    Parameters
    ----------
    corners : ndarray of float64, shape (8, 3)
        Corners in the frame of the camera, z forward, in the order of ``numpy.ndindex(2, 2, 2)``.
    projection : ndarray of float64, shape (3, 4)
        Frame of the camera to pixels; the camera is in the origin.
    width, height : int
        Size of the image, pixels.

    Returns
    -------
    rectangle : tuple of float
        Left, top, right and bottom, from 0 to width − 1 and height − 1.
    outside : float
        The share, 0 to 1.

        None instead of both if the box is out of view.
    """
    (row_u, row_v, row_w) = projection[:, :3]
    sides = np.array([row_u, (width - 1) * row_w - row_u, row_v, (height - 1) * row_w - row_v])
    above = product(corners, sides.T)
    if (above <= 0).all(axis=0).any():
        return None
    if (above >= 0).all():
        visible, outside = corners, 0.0
    else:
        parts = [part for face in FACES if len(part := _clip(corners[list(face)], sides))]
        edges = corners[4] - corners[0], corners[2] - corners[0], corners[1] - corners[0]
        share = sum(map(_pyramid, parts)) / abs(float((edges[0] * np.cross(edges[1], edges[2])).sum()))
        if not share > 0:
            return None
        visible, outside = np.concatenate(parts), min(max(1.0 - share, 0.0), 1.0)
    u, v, w = product(projection[:, :3], visible[matvec(visible, row_w) > 0].T)
    columns, rows = u / w, v / w
    left, right = (min(max(float(end), 0.0), width - 1.0) for end in (columns.min(), columns.max()))
    top, bottom = (min(max(float(end), 0.0), height - 1.0) for end in (rows.min(), rows.max()))
    return (left, top, right, bottom), outside


def _clip(polygon: Floats, sides: Floats) -> Floats:
    """Return the part of a polygon on the positive side of planes through the origin (Sutherland and Hodgman 1974)."""
    for side in sides:
        above = matvec(polygon, side)
        kept: list[Floats] = []
        for index in range(len(polygon)):
            start, end, h0, h1 = polygon[index - 1], polygon[index], above[index - 1], above[index]
            if (h0 >= 0) != (h1 >= 0):
                kept.append(start + h0 / (h0 - h1) * (end - start))
            if h1 >= 0:
                kept.append(end)
        polygon = np.array(kept).reshape(-1, 3)
    return polygon


def _pyramid(polygon: Floats) -> float:
    """Return the signed volume of the pyramid from the origin to a polygon."""
    (ax, ay, az), (bx, by, bz) = polygon[1:-1].T, polygon[2:].T
    # By hand, as `numpy.cross` takes several times as long for so few.
    normals = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)
    return float(matvec(normals, polygon[0]).sum()) / 6
