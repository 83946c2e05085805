"""Normals and radii of the surfels of a point cloud."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, array
from lidarsim.errors import ArgumentValueError
from lidarsim.world.shapes._primitives import widths
from lidarsim.world.shapes._tessellation import frames

FLAT = 2
"""How often the standard deviation across the plane of neighbours fits into the second largest one, at least."""

ISOLATED = 3
"""How many times as far as usual the farthest neighbour of an isolated point is."""

SECTORS = 12
_HALF = math.pi / SECTORS
_WIDEST = math.cos(math.pi / 3)
_PIECE = 1 << 14  # points at a time


class Surfels(NamedTuple):
    """Disks at points, and how many points have none.

    Parameters
    ----------
    points : ndarray of int64, shape (m,)
        The point of each disk, ascending.
    normals : ndarray, shape (m, 3)
        Normals.
    radii : ndarray, shape (m,)
        Radii, m.
    repeated, not_flat, isolated : int
        Points without a disk, each counted once, for the first of these reasons.
    """

    points: npt.NDArray[np.int64]
    normals: Floats
    radii: Floats
    repeated: int
    not_flat: int
    isolated: int


def surfels(points: Floats, normals: npt.ArrayLike | None, radii: npt.ArrayLike | None, neighbours: int) -> Surfels:
    """Return the surfels of points; see `Disks.from_points`."""
    given = None if normals is None else array("normals", normals, (len(points), 3))
    given_radii = None if radii is None else widths(radii, len(points))
    _, first = np.unique(points, axis=0, return_index=True)
    index = np.sort(first).astype(np.int64)
    repeated = len(points) - len(index)
    if given is not None and given_radii is not None:
        return Surfels(index, given[index], given_radii[index], repeated, 0, 0)
    if len(index) <= neighbours:
        raise ArgumentValueError("points", f"more than {neighbours} different points", len(index))
    from scipy.spatial import cKDTree

    places = points[index]
    tree = cKDTree(places)
    count = len(places)
    normal, radius, reach = np.empty((count, 3)), np.empty(count), np.empty(count)
    is_flat = np.ones(count, bool)
    near = np.empty((count, neighbours), np.int32 if count < 1 << 31 else np.int64)
    for start in range(0, count, _PIECE):
        piece = slice(start, start + _PIECE)
        distances: Any
        found: Any
        distances, found = tree.query(places[piece], neighbours + 1)
        near[piece], reach[piece] = found[:, 1:], distances[:, -1]
        offsets = places[found] - places[piece, None]
        if given is None:
            axes, is_flat[piece] = _planes(offsets)
            normal[piece] = axes[:, 2]
        else:
            normal[piece] = given[index[piece]]
            axes = frames(normal[piece])
        radius[piece] = _cell_radii(offsets[:, 1:] @ axes[:, :2].swapaxes(1, 2))
    is_isolated = np.zeros(count, bool)
    if given_radii is not None:
        radius = given_radii[index]
    else:
        is_flat &= radius > 0.0  # the neighbours are on a line across the plane
        for start in range(0, count, _PIECE):
            piece = slice(start, start + _PIECE)
            is_isolated[piece] = reach[piece] > ISOLATED * np.median(reach[near[piece]], axis=1)
    kept = is_flat & ~is_isolated
    if not kept.any():
        raise ArgumentValueError("points", "points on surfaces", f"none among {len(points)}")
    return Surfels(
        index[kept],
        normal[kept],
        radius[kept],
        repeated,
        int((~is_flat).sum()),
        int((is_flat & is_isolated).sum()),
    )


def _planes(offsets: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Fit planes to neighbourhoods, shape (n, k, 3).

    Returns
    -------
    axes : ndarray, shape (n, 3, 3)
        Unit vectors in rows: the two of most variance, and the normal.
    is_flat : ndarray of bool, shape (n,)
        Whether the neighbourhood is near a plane, and determines it.
    """
    centered = offsets - offsets.mean(axis=1, keepdims=True)
    scale = np.abs(centered).max(axis=(1, 2), keepdims=True)  # so that squares neither overflow nor underflow
    centered /= scale
    variances, vectors = np.linalg.eigh(centered.swapaxes(1, 2) @ centered)
    least, middle = variances[:, 0].clip(min=0.0), variances[:, 1]
    axes: Floats = vectors.swapaxes(1, 2)[:, ::-1]
    # The sign is arbitrary, but the same on every machine.
    largest = np.take_along_axis(axes[:, 2], np.abs(axes[:, 2]).argmax(axis=1)[:, None], axis=1)
    axes[:, 2] *= np.sign(largest)
    return axes, (FLAT**2 * least <= middle) & (middle > 0.0)


def _cell_radii(neighbours: Floats) -> Floats:
    """Return how far the Voronoi cells of points reach, at most, given the neighbours of each in a plane.

    The cell reaches R in the direction u only if no neighbour q is nearer to R·u than the point is: |q|² − 2 R q·u ≥ 0.
    So R <= |q|² / (2 q·u) for each q with q·u > 0. In a sector up to h away from its middle m, q·u is at least
    |q| cos(∠(q, m) + h) = q·m cos h − |q × m| sin h.
    """
    angle = np.arange(SECTORS) * (2 * math.pi / SECTORS)
    middle = np.stack([np.cos(angle), np.sin(angle)])
    across = np.stack([-middle[1], middle[0]])
    along = (neighbours @ middle) * math.cos(_HALF) - np.abs(neighbours @ across) * math.sin(_HALF)
    length = np.linalg.norm(neighbours, axis=-1, keepdims=True)
    bounds = along >= _WIDEST * length
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(bounds & (length > 0.0), length * length / (2.0 * along), np.inf).min(axis=1)
    result: Floats = np.where(np.isfinite(reach), reach, 0.0).max(axis=1)
    return result
