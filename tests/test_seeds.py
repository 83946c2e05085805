"""Worked examples from lecture notes on ray intersection: hand results against lidarsim and `bench.textbook`."""

from __future__ import annotations

import math

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.bench import textbook


def one(vector):
    return np.array([vector], dtype=float)


def test_two_point_ray_meets_a_unit_sphere_at_2_and_4():
    # s − e = (1, 0, 0), e − c = (−3, 0, 0), r = 1: A = 1, B = −6, C = 8, t = 3 ± 1, p = (2, 0, 0) and (4, 0, 0)
    e, s = one((0, 0, 0)), one((1, 0, 0))
    sphere = ls.Sphere((3, 0, 0), 1.0)
    roots = sphere.roots(e, s - e)
    np.testing.assert_array_equal(roots, [[2.0, 4.0]])
    np.testing.assert_array_equal(e + roots[0, 0] * (s - e), [[2, 0, 0]])
    np.testing.assert_array_equal(textbook.sphere(e, s - e, (3, 0, 0), 1.0), [[2.0, 4.0]])
    hits = sphere.cast(e, s - e)
    assert hits.t[0] == 2.0
    np.testing.assert_array_equal(hits.normal, [[-1, 0, 0]])


def test_two_point_ray_meets_a_triangle_at_3_0_0():
    # (e − a)·n = −3 and (s − e)·n = 1 up to the sign of n: t = 3, p = (3, 0, 0)
    e, s = one((0, 0, 0)), one((1, 0, 0))
    triangle = ls.Triangle((3, -1, -1), (3, 2, -1), (3, -1, 2))
    hits = triangle.cast(e, s - e)
    assert hits.t[0] == 3.0
    np.testing.assert_array_equal(e + hits.t[:, None] * (s - e), [[3, 0, 0]])
    np.testing.assert_array_equal(hits.normal, [[1, 0, 0]])  # (b − a) × (c − a), not turned towards the ray


@pytest.mark.parametrize("length", [0.5, 1, 3, 1e-200, 1e200])
def test_t_is_in_units_of_the_direction(length):
    # the plane is 4 away, whatever the distance of the two points that give the ray
    plane = ls.Plane.from_point((0, 0, 7), (0, 0, 1))
    assert plane.cast(one((1, 2, 3)), one((0, 0, length))).t[0] == 4 / length


@pytest.mark.parametrize(
    ("plane", "expected"),
    [
        pytest.param(ls.Plane((0, 0, 1), 5.0), 2.0, id="n.p = d"),
        pytest.param(ls.Plane.from_point((7, -8, 5), (0, 0, 1)), 2.0, id="N.(X - P) = 0"),
        pytest.param(ls.Plane.from_points((0, 0, 5), (1, 0, 5), (0, 1, 5)), 2.0, id="from a triangle"),
    ],
)
def test_the_three_forms_of_a_plane(plane, expected):
    # o = (0, 0, 1), d = (0, 0, 2): t = (d − o·n) / (d·n) = (5 − 1) / 2
    assert plane.cast(one((0, 0, 1)), one((0, 0, 2))).t[0] == expected
    np.testing.assert_array_equal(plane.roots(one((0, 0, 1)), one((0, 0, -2))), [[-2.0]])
    assert not plane.cast(one((0, 0, 1)), one((1, 1, 0))).hit[0]  # N·V = 0: parallel
    assert not plane.cast(one((0, 0, 5)), one((1, 1, 0))).hit[0]  # even inside the plane


@pytest.mark.parametrize(
    ("origin", "roots", "t"),
    [
        pytest.param((-3, 2, 0), [math.nan, math.nan], math.inf, id="miss: discriminant < 0"),
        pytest.param((-3, 1, 0), [3, math.nan], 3, id="grazing: double root"),
        pytest.param((3, 0, 0), [-4, -2], math.inf, id="both behind"),
        pytest.param((0.5, 0, 0), [-1.5, 0.5], 0.5, id="origin inside"),
        pytest.param((-3, 0, 0), [2, 4], 2, id="both ahead"),
        pytest.param((-1, 0, 0), [0, 2], 0, id="origin on the surface"),
    ],
)
def test_the_cases_of_a_sphere(origin, roots, t):
    sphere, direction = ls.Sphere((0, 0, 0), 1.0), one((1, 0, 0))
    np.testing.assert_array_equal(sphere.roots(one(origin), direction), [roots])
    assert sphere.cast(one(origin), direction).t[0] == t
    np.testing.assert_array_equal(textbook.sphere(one(origin), direction, (0, 0, 0), 1.0)[0, 0], roots[0])


def test_halved_and_full_quadratic_agree():
    # (−VD ± √((VD)² − V²(D² − r²))) / V² with V = (0, 0, 3), D = S − C = (0, 0, −9), r = 3: VD = −27, V² = 9, D² = 81
    roots = ls.Sphere((1, 2, 4), 3.0).roots(one((1, 2, -5)), one((0, 0, 3)))
    np.testing.assert_array_equal(roots, [[(27 - 9) / 9, (27 + 9) / 9]])


def test_ngon_that_is_not_convex():
    # an L: the notch is outside though it is inside the convex hull
    polygon = ls.Polygon([(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0)])
    origins = np.array([(0.5, 0.5, 1), (1.5, 0.5, 1), (0.5, 1.5, 1), (1.5, 1.5, 1), (1, 1, 1), (2.5, 0.5, 1)])
    hits = polygon.cast(origins, np.tile((0.0, 0.0, -1.0), (6, 1)))
    np.testing.assert_array_equal(hits.hit, [True, True, True, False, True, False])
    np.testing.assert_array_equal(hits.normal[0], (0, 0, 1))


def test_inside_test_in_a_plane_through_the_origin():
    # where solving p = i·a + j·b + k·c has no unique answer: a, b, c and the origin lie in one plane
    a, b, c = (1.0, 1.0, 0.0), (3.0, 1.0, 0.0), (1.0, 3.0, 0.0)
    assert np.linalg.det([a, b, c]) == 0
    origins = np.array([(1.5, 1.5, 2.0), (3.0, 3.0, 2.0)])
    hits = ls.Triangle(a, b, c).cast(origins, np.tile((0.0, 0.0, -4.0), (2, 1)))
    np.testing.assert_array_equal(hits.t, [0.5, np.inf])


def test_weird_sphere_by_transforming_the_ray():
    # x²/4 + y² + z²/9 = 1 along each axis
    expected = [[-2.0, 2.0], [-1.0, 1.0], [-3.0, 3.0]]
    origins, directions = np.zeros((3, 3)), np.eye(3)
    np.testing.assert_array_equal(ls.Ellipsoid((0, 0, 0), (2, 1, 3)).roots(origins, directions), expected)
    moved = ls.Sphere((0, 0, 0), 1.0, transform=np.diag([2.0, 1.0, 3.0, 1.0]))
    np.testing.assert_array_equal(moved.roots(origins, directions), expected)


def test_hollow_and_capped_cylinder():
    # x² + y² = 4 between z = 0 and 3
    origins = np.array([(-5, 0, 1), (-5, 0, 4), (0, 0, -1), (0, 0, 1), (-5, 2, 1.0)])
    directions = np.array([(1, 0, 0), (1, 0, 0), (0, 0, 1), (1, 0, 0), (1.0, 0, 0)])
    nan = math.nan
    for capped, axial in ((True, [1, 4]), (False, [nan, nan])):
        roots = ls.Cylinder((0, 0, 0), (0, 0, 3), 2.0, capped=capped).roots(origins, directions)
        np.testing.assert_array_equal(roots, [[3, 7], [nan, nan], axial, [-2, 2], [5, nan]])
