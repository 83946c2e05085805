"""Faces of any number of corners, cut into triangles."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import ArgumentValueError

Indices = npt.NDArray[np.int64]


def triangulate(vertices: Floats, corners: Indices, sizes: Indices) -> tuple[Indices, Indices]:
    """Cut faces into triangles, in the order of the faces and of their orientation.

    A convex face becomes a fan from its first corner; all others are cut by ear clipping, seen along the axis that is
    nearest to their normal. A face of n corners becomes n − 2 triangles, be some of them degenerate: so each edge of a
    face is an edge of a triangle, and neighbours have no gap between them.

    Parameters
    ----------
    vertices : ndarray of float64, shape (n, 3)
        m.
    corners : ndarray of int64, shape (k,)
        Vertices of the faces, one face after the other.
    sizes : ndarray of int64, shape (m,)
        How many corners each face has; those with fewer than three become no triangles.

    Returns
    -------
    faces : ndarray of int64, shape (t, 3)
        The triangles.
    of : ndarray of int64, shape (t,)
        From which face each is.

    Raises
    ------
    ValueError
        If a vertex is not finite, or a face names one that is not there.
    """
    check_faces(vertices, corners, sizes)
    starts = np.cumsum(sizes) - sizes
    of = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
    faces = np.empty((len(of), 3), np.int64)
    places = np.cumsum(np.maximum(sizes - 2, 0)) - np.maximum(sizes - 2, 0)  # of the first triangle of each face
    for size in np.unique(sizes[sizes > 2]).tolist():
        which = np.flatnonzero(sizes == size)
        outlines = corners[starts[which, None] + np.arange(size)]
        step = np.arange(size - 2)
        cut = np.stack([np.broadcast_to(outlines[:, :1], outlines[:, 2:].shape), outlines[:, 1:-1], outlines[:, 2:]], 2)
        if size > 3:
            for i in np.flatnonzero(~_convex(vertices, outlines)):
                cut[i] = outlines[i][_clip(vertices[outlines[i]])]
        faces[places[which, None] + step] = cut
    return faces, of


def check_faces(vertices: Floats, corners: Indices, sizes: Indices) -> None:
    """Raise `ValueError` if a vertex is not finite, or a face names one that is not there; see `triangulate`."""
    finite = np.isfinite(vertices)
    if not finite.all():
        i, j = np.argwhere(~finite)[0]
        raise ArgumentValueError("vertices", "finite numbers", f"vertices[{i}][{j}] = {vertices[i, j]}")
    wrong = (corners < 0) | (corners >= len(vertices))
    if wrong.any():
        k = int(np.argmax(wrong))
        starts = np.cumsum(sizes) - sizes
        i = int(np.searchsorted(starts, k, side="right")) - 1
        last = len(vertices) - 1
        raise ArgumentValueError("faces", f"indices from 0 to {last}", f"faces[{i}][{k - starts[i]}] = {corners[k]}")


def of_strips(corners: Indices, sizes: Indices) -> tuple[Indices, Indices]:
    """Return the triangles of strips as faces, and their sizes; within a strip, an index of −1 begins a new one.

    Every other triangle of a strip is wound the other way, so that all are on the same side.
    """
    triangles = [np.empty((0, 3), np.int64)]
    for row in np.split(corners, np.cumsum(sizes)[:-1]):
        for part in np.split(row, np.flatnonzero(row == -1)):
            strip = part[part != -1]
            steps = np.arange(max(len(strip) - 2, 0))
            odd = steps % 2
            triangles.append(np.stack([strip[steps], strip[steps + 1 + odd], strip[steps + 2 - odd]], axis=1))
    faces = np.concatenate(triangles)
    return faces.ravel(), np.full(len(faces), 3, np.int64)


def _normals(points: Floats) -> tuple[Floats, Floats]:
    """Return twice the vector area of outlines, shape (m, size, 3), and the cross products of edges at their corners.

    The outlines are scaled and shifted, which changes no sign, so that no product overflows.
    """
    local = points - points[:, :1]
    local /= np.maximum(np.abs(local).max(axis=(1, 2), keepdims=True), np.finfo(np.float64).tiny)
    following = np.roll(local, -1, axis=1)
    edges = following - local
    return np.cross(local, following).sum(axis=1), np.cross(np.roll(edges, 1, axis=1), edges)


def flattened(points: Floats, normal: Floats) -> Floats:
    """Return `points` along the axis nearest to `normal`, seen from where the outline turns left: shape (n, 2)."""
    drop = int(np.argmax(np.abs(normal)))
    axes = [(drop + 1) % 3, (drop + 2) % 3]
    if normal[drop] < 0:
        axes.reverse()
    return np.ascontiguousarray(points[:, axes])


def _convex(vertices: Floats, outlines: Indices) -> npt.NDArray[np.bool_]:
    """Return of which outlines no corner turns against the whole; an outline in doubt may be called not convex."""
    normal, turns = _normals(vertices[outlines])
    convex: npt.NDArray[np.bool_] = (np.einsum("mik,mk->mi", turns, normal) >= 0.0).all(axis=1)
    return convex


def _clip(points: Floats) -> Indices:
    """Cut one outline, shape (n, 3), into n − 2 triangles by ear clipping."""
    import mapbox_earcut

    n = len(points)
    normal = _normals(points[None])[0][0]
    outline = flattened(points - points[0], normal)
    ears = mapbox_earcut.triangulate_float64(outline, np.array([n], np.uint32)).reshape(-1, 3).astype(np.int64)
    ears = np.concatenate([ears, _slivers(ears, n)])
    if len(ears) != n - 2:  # of an outline that crosses itself
        ears = np.stack([np.zeros(n - 2, np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)
    return ears


def with_holes(points: Floats, ends: Indices) -> Indices:
    """Cut a plane outline with holes into triangles that turn as the outline does, shape (t, 3).

    Parameters
    ----------
    points : ndarray of float64, shape (n, 3)
        Corners of the outline, then those of each hole.
    ends : ndarray of int64, shape (m,)
        Where the outline and each hole end among the corners.
    """
    import mapbox_earcut

    normal = _normals(points[None, : ends[0]])[0][0]
    flat = flattened(points - points[0], normal)
    triangles = mapbox_earcut.triangulate_float64(flat, ends.astype(np.uint32)).reshape(-1, 3).astype(np.int64)
    first, second = (flat[triangles[:, k]] - flat[triangles[:, 0]] for k in (1, 2))
    backwards = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
    triangles[backwards] = triangles[backwards][:, ::-1]
    return triangles


def _slivers(ears: Indices, n: int) -> Indices:
    """Return the triangles that ear clipping leaves out since their corners lie on one line.

    The edges of the triangles that are neither shared by two of them nor edges of the outline go round gaps without an
    area, each of which becomes a fan.
    """
    edges = Counter((a, b) for ear in ears.tolist() for a, b in zip(ear, [*ear[1:], ear[0]], strict=True))
    edges.update(((i + 1) % n, i) for i in range(n))  # the outline, backwards
    following: dict[int, list[int]] = {}
    for (a, b), count in edges.items():
        for _ in range(count - edges.get((b, a), 0)):
            following.setdefault(b, []).append(a)  # the gap is on the other side
    slivers = []
    while following:
        start = next(iter(following))
        gap = [start]
        while (ends := following.get(gap[-1])) is not None:
            gap.append(ends.pop())
            if not ends:
                del following[gap[-2]]
            if gap[-1] == start:
                break
        slivers += [(start, b, c) for b, c in pairwise(gap[1:-1])]
    return np.array(slivers, np.int64).reshape(-1, 3)
