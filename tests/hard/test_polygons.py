"""Faces of many corners, cut into triangles: what they cover, and that no edge of theirs is lost."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.world.shapes import _polygons
from lidarsim.world.shapes._polygons import of_strips, triangulate


def faces_of(outline):
    n = len(outline)
    faces, of = triangulate(np.asarray(outline, float), np.arange(n), np.array([n]))
    assert of.tolist() == [0] * (n - 2)
    return faces


def area(outline, faces):
    a, b, c = (np.asarray(outline, float)[faces[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def shoelace(outline):
    """Twice the area, exactly, of whole numbers."""
    (x, y), (u, v) = np.asarray(outline, int).T, np.roll(np.asarray(outline, int), -1, axis=0).T
    return int((x * v - y * u).sum())


def edges(faces):
    return {(a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}


def comb(teeth):
    """A comb with whole numbers as corners: not convex, with corners on its straight back."""
    back = [(x, 0) for x in range(2 * teeth + 1)]
    return back + [(x, 9 if x % 2 else 2) for x in range(2 * teeth, -1, -1)]


OUTLINES = {
    "square": [(0, 0), (2, 0), (2, 2), (0, 2)],
    "dart": [(0, 0), (4, 4), (0, 1), (-4, 4)],
    "dart, from its notch": [(0, 1), (-4, 4), (0, 0), (4, 4)],
    "house with a notch": [(0, 4), (0, 0), (4, 0), (4, 4), (2, 1)],
    "corners on edges": [(0, 0), (1, 0), (2, 0), (4, 0), (4, 2), (4, 4), (2, 4), (0, 4), (0, 1)],
    "from a corner on an edge": [(1, 0), (2, 0), (2, 2), (0, 2), (0, 0)],
    "comb": comb(7),
    "keyhole": [(0, 0), (9, 0), (9, 9), (0, 9), (0, 0), (3, 3), (3, 6), (6, 6), (6, 3), (3, 3)],
    "spiral": [
        *[(0, 0), (9, 0), (9, 9), (2, 9), (2, 3), (6, 3), (6, 6)],
        *[(5, 6), (5, 4), (3, 4), (3, 8), (8, 8), (8, 1), (0, 1)],
    ],
}  # fmt: skip


@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
@pytest.mark.parametrize("backwards", [False, True])
def test_outlines(outline, backwards):
    """Triangles of one orientation, whose areas add up to the outline's and which have all of its edges, cover it."""
    flat = outline[::-1] if backwards else outline
    twice = shoelace(flat)
    assert twice > 0 or backwards
    rng = np.random.default_rng(5)
    for turn in [np.eye(3), *Rotation.random(5, rng=rng).as_matrix()]:
        points = np.column_stack([flat, np.zeros(len(flat))]) @ turn.T
        faces = faces_of(points)
        areas = area(points, faces) @ turn[:, 2]
        tolerance = 1e-12 * abs(twice)  # products of numbers below 10, rounded a few times
        assert abs(areas.sum() - twice / 2) < tolerance
        assert (areas * math.copysign(1, twice) > -tolerance).all()
        assert {(k, (k + 1) % len(flat)) for k in range(len(flat))} <= edges(faces)


def test_random_outlines_with_corners_on_their_edges():
    rng = np.random.default_rng(6)
    short = 0
    for _ in range(300):
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(4, 12)))
        radii = rng.integers(8, 40, (len(angles), 1))
        corners = 4 * np.rint(np.stack([np.cos(angles), np.sin(angles)], axis=1) * radii)
        more = [
            (1 - part) * corner + part * following
            for corner, following in zip(corners, np.roll(corners, -1, axis=0), strict=True)
            for part in (0.0, *np.sort(rng.choice([0.25, 0.5, 0.75], rng.integers(0, 4), replace=False)))
        ]
        outline = np.array([b for a, b in zip(np.roll(more, 1, axis=0), more, strict=True) if (a != b).any()])
        try:
            ls.Polygon(np.column_stack([outline, np.zeros(len(outline))]))
        except ValueError:  # it touches itself
            continue
        points = np.column_stack([outline, np.zeros(len(outline))])
        faces = faces_of(points)
        twice = shoelace(outline)
        areas = area(points, faces)[:, 2]
        assert (areas * np.sign(twice) >= 0).all()  # whole numbers: exact
        assert 2 * areas.sum() == twice
        assert {(k, (k + 1) % len(points)) for k in range(len(points))} <= edges(faces)
        short += (areas == 0).any()
    assert short > 0  # of some, ear clipping leaves corners out


def test_order_and_orientation_of_faces():
    points = np.array([(0, 4, 0), (0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 1, 0)], float)
    faces, of = triangulate(
        points, np.array([0, 1, 2, 0, 1, 2, 3, 4, 0, 1, 4, 3, 2, 1, 1, 2, 3]), np.array([3, 5, 1, 0, 5, 3])
    )
    assert of.tolist() == [0, 1, 1, 1, 4, 4, 4, 5]
    assert (area(points, faces[1:4])[:, 2] > 0).all()
    assert area(points, faces[1:4])[:, 2].sum() == 16 - 6
    assert faces[0].tolist() == [0, 1, 2]
    assert faces[-1].tolist() == [1, 2, 3]


@pytest.mark.parametrize("scale", [1e-160, 1.0, 1e150])
def test_outlines_of_any_size(scale):
    points = np.array([(0, 4, 1), (0, 0, 1), (4, 0, 1), (4, 4, 1), (2, 1, 1)]) * scale
    mesh_faces = faces_of(points)
    areas = area(points / scale, mesh_faces)[:, 2]
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(10)


def test_an_outline_without_an_area_or_that_crosses_itself_has_its_corners():
    for outline in ([(0, 0, 0)] * 5, [(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)], [(k, 0, 0) for k in range(6)]):
        faces = faces_of(outline)
        assert set(faces.ravel().tolist()) == set(range(len(outline)))


def test_rays_see_what_a_polygon_is(monkeypatch):
    """The same decisions as Polygon's, which are exact, at the corners and in the notches."""
    outline = np.column_stack([comb(7), np.zeros(30)])
    mesh = ls.TriangleMesh(outline, faces_of(outline))
    x, y = np.meshgrid(np.arange(-1, 16, 0.25), np.arange(-1, 11, 0.25))
    origins = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    directions = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    expected = ls.Polygon(outline).cast(origins, directions).hit
    assert 500 < expected.sum() < x.size - 500
    np.testing.assert_array_equal(mesh.cast(origins, directions).hit, expected)

    def fan(points):
        n = len(points)
        return np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], axis=1)

    monkeypatch.setattr(_polygons, "_clip", fan)
    assert (ls.TriangleMesh(outline, faces_of(outline)).cast(origins, directions).hit != expected).any()


def test_strips():
    corners, sizes = of_strips(np.array([0, 1, 2, 3, 4, -1, 5, 6, 7, -1, 8, 9, 3, 2, 1]), np.array([12, 3]))
    assert sizes.tolist() == [3] * 5
    assert corners.reshape(-1, 3).tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4], [5, 6, 7], [3, 2, 1]]
    assert of_strips(np.empty(0, np.int64), np.empty(0, np.int64))[0].size == 0
