"""Light that goes on: panes, nets and mirrors, against casts that follow each way by themselves."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim.patterns import Table

Floats = npt.NDArray[np.float64]

IDENTITY = np.eye(4)

ROUNDING = 2.0**-53
"""Largest relative error of a float64 that is rounded once."""

FLOAT32 = 2.0**-24
"""Largest relative error of a float32 that is rounded once: u/(1 + u), with this u. That leaves u², or 32 roundings of
float64, for what is rounded."""

TURN = 20
"""Roundings of a mirrored direction d − (2(d·n)/(n·n))·n, of length 1: three of d·n, twice; three of n·n, one of the
quotient and one of its product with n, of a vector of length 2 at most; one of the difference; three of the unit d."""

PLACE = 4
"""Roundings of a point o + t·d: two of t, which is right to an ulp, and two of its formula."""


def rounding(length: float, mirrors: int = 1) -> float:
    """Return a bound of the rounding of a way of this length by flat mirrors, m."""
    return (TURN * mirrors + PLACE * (mirrors + 1)) * ROUNDING * length


def lidar(directions: npt.ArrayLike, depth: int, **more: Any) -> ls.Lidar:
    unit = np.asarray(directions, dtype=float)
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    return ls.Lidar(Table(unit, rate=10.0), measurement=ls.Measurement(depth=depth, **more))


def ahead(depth: int, **more: Any) -> ls.Lidar:
    return lidar([(1, 0, 0)], depth, **more)


def wall(x: float) -> ls.Plane:
    return ls.Plane((1, 0, 0), x)


def pane(transmission: float, mirror: float = 0.0, reflectivity: float = 0.1) -> ls.Material:
    return ls.Material(reflectivity=reflectivity, transmission=transmission, mirror=mirror)


# Panes, by hand


def test_two_panes_by_hand() -> None:
    scene = ls.Scene()
    for x, material in ((2.0, pane(0.5)), (3.0, pane(0.8)), (5.0, ls.Material(reflectivity=0.6))):
        scene.add(wall(x), label=int(x), material=material)
    scan = ahead(3, returns=3, extinction=0.01).scan(scene)
    assert scan.path is not None
    assert scan.range.tolist() == [[2.0, 3.0, 5.0]]
    assert scan.path.tolist() == [[0, 1, 2]]
    assert scan.label.tolist() == [[2, 3, 5]]
    assert scan.return_count.tolist() == [3]
    through = np.array([0.1, 0.1 * 0.5**2, 0.6 * (0.5 * 0.8) ** 2]) * np.exp(-0.02 * scan.range[0])
    assert scan.intensity[0] == pytest.approx(through, rel=FLOAT32)
    # Power is intensity over R²: 0.025 at 2 m, 0.0028 at 3 m and 0.0038 at 5 m.
    for returns, expected in (("strongest", [2.0]), ("first", [2.0]), ("last", [5.0]), ("dual", [2.0, 5.0])):
        assert ahead(3, returns=returns).scan(scene).range.tolist() == [expected]
    assert ahead(2, returns=2).scan(scene).range.tolist() == [[2.0, 3.0]]
    cloud = scan.point_cloud()
    assert cloud.path.dtype == np.uint8
    assert cloud.path.tolist() == [0, 1, 2]
    assert cloud.xyz[:, 0].tolist() == [2.0, 3.0, 5.0]
    assert scan.true_points()[:, 0].tolist() == [2.0, 3.0, 5.0]


def test_the_strongest_may_be_behind_the_glass_and_the_detection_limit_may_hide_it() -> None:
    scene = ls.Scene()
    scene.add(wall(10.0), material=pane(0.9, reflectivity=0.001))
    scene.add(wall(12.0), material=ls.Material(reflectivity=0.5))
    scan = ahead(2).scan(scene)
    assert scan.range.tolist() == [[12.0]]
    assert float(scan.intensity[0, 0]) == pytest.approx(0.5 * 0.9**4 / 0.9**2, rel=FLOAT32)
    # The limit is between 0.5·0.81/144 and 0.001/100 of the power that 0.1 returns from r: r² = 0.1/limit.
    hidden = ahead(2, returns=2, detection=ls.Detection(0.1, math.sqrt(0.1 / 1e-4))).scan(scene)
    assert np.array_equal(hidden.range, [[12.0, math.nan]], equal_nan=True)
    nothing = ahead(2, returns=2, detection=ls.Detection(0.1, 1.0)).scan(scene)
    assert nothing.status.tolist() == [ls.Status.below_threshold]
    assert nothing.object_id.tolist() == [[1, -1]]


def test_with_depth_1_the_shares_change_nothing() -> None:
    plain, glazed = ls.Scene(), ls.Scene()
    for scene, shares in ((plain, {}), (glazed, {"transmission": 0.5, "mirror": 0.5})):
        scene.add(ls.Sphere((8, 0, 0), 2.0), material=ls.Material(reflectivity=0.3, **shares))
        scene.add(wall(12.0))
    directions = np.random.default_rng(1).normal((3, 0, 0), 1.0, (500, 3))
    for measurement in ({}, {"beam": ls.Beam(5e-3), "returns": 3}):
        a, b = (lidar(directions, 1, **measurement).scan(scene) for scene in (plain, glazed))
        assert a.path is b.path is a.mirrored_point is None
        for name in ("range", "intensity", "object_id", "normal", "status"):
            assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=name != "status")
    # Where no light goes on, depth only adds the field.
    deep = lidar(directions, 9).scan(plain)
    first = lidar(directions, 1).scan(plain)
    assert deep.path is not None
    assert np.array_equal(deep.range, first.range, equal_nan=True)
    assert np.array_equal(deep.path[:, 0], np.where(deep.object_id[:, 0] < 0, 255, 0))
    assert deep.mirrored_point is None


# Mirrors


def image(point: list[Fraction], normal: list[Fraction], distance: Fraction) -> list[Fraction]:
    """The mirror image of a point in the plane n·p = d, in exact rationals."""
    off = sum(n * p for n, p in zip(normal, point, strict=True)) - distance
    square = sum(n * n for n in normal)
    return [p - 2 * off / square * n for p, n in zip(point, normal, strict=True)]


@pytest.mark.parametrize("normal", [(1, 0, 0), (-2, 1, 0), (3, 1, -2)])
def test_ghosts_are_at_the_mirror_images(normal: tuple[int, int, int]) -> None:
    """Each pulse is aimed at the image of the centre of a ball, so it meets the ball head on, by way of the mirror."""
    distance, radius = normal[0] * 6.0, 0.25
    random = np.random.default_rng(2)
    scene = ls.Scene()
    scene.add(ls.Plane(normal, distance), material=pane(0.0, 0.9))
    toward = -np.sign(normal[0]) * np.array(normal) / np.linalg.norm(normal)
    centers = random.uniform((-3, -9, -9), (1, 9, 9), (40, 3)) + 2 * toward
    images = [
        [float(x) for x in image([*map(Fraction, c)], [*map(Fraction, normal)], Fraction(distance))]
        for c in centers.tolist()
    ]
    found = 0
    for center, seen in zip(centers, images, strict=True):
        ball = scene.add(ls.Sphere(center, radius), label=7, material=ls.Material(reflectivity=0.5))
        scan = lidar([seen], 2, returns="last").scan(scene)
        scene.remove(ball)
        if scan.object_id[0, 0] != ball or scan.path is None or scan.mirrored_point is None or not scan.path[0, 0]:
            continue  # the ball is in the way
        found += 1
        near = rounding(float(np.linalg.norm(seen)))
        assert scan.true_range[0, 0] == pytest.approx(np.linalg.norm(seen) - radius, rel=0, abs=near)
        assert scan.incidence[0, 0] <= near / radius  # the pulse passes the centre so near
        assert float(scan.intensity[0, 0]) == pytest.approx(0.5 * 0.9**2, rel=FLOAT32)
        ghost = np.asarray(seen) * (1.0 - radius / np.linalg.norm(seen))
        assert scan.point_cloud().xyz[0] == pytest.approx(ghost, rel=0, abs=near)
        assert np.linalg.norm(scan.true_points()[0] - center) == pytest.approx(radius, rel=0, abs=near)
        assert np.array_equal(scan.true_points(), scan.mirrored_point[0])
    assert found > 25


def test_two_mirrors_at_right_angles_return_the_pulse() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 1, 0), 8.0), material=pane(0.0, 0.5))
    scene.add(ls.Plane((1, -1, 0), 8.0), material=pane(0.0, 0.8))
    scene.add(ls.Sphere((0, 0, 0), 0.5), label=3)  # around the sensor, which sees it from inside in the corner
    scene.update(2, shape=ls.Plane((1, 0, 0), -1.0))
    directions = [(1, y, z) for y in (-0.3, 0.01, 0.2) for z in (-0.4, 0.0, 0.3)]
    scan = lidar(directions, 3, returns="last").scan(scene)
    assert scan.path is not None
    assert np.all(scan.path == 2)
    assert np.all(scan.object_id == 2)
    # The pulse comes back parallel: it goes 8 m to the corner's image and 1 m further than the sensor, along x.
    unit = lidar(directions, 1).pattern.pulses(0).directions
    near = rounding(17.0 / unit[:, 0].min(), mirrors=2)
    assert scan.true_range[:, 0] == pytest.approx(17.0 / unit[:, 0], rel=0, abs=near)
    assert scan.true_points()[:, 0] == pytest.approx(-1.0, rel=0, abs=near)
    # Rounding of the cosine, which is of two mirrored directions.
    assert scan.intensity[:, 0] == pytest.approx(unit[:, 0] * 0.4**2, rel=FLOAT32 + 2 * TURN * ROUNDING)


@pytest.mark.parametrize("depth", [2, 3, 10, 255])
def test_a_hall_of_mirrors_has_as_many_images_as_depth(depth: int) -> None:
    scene = ls.Scene()
    scene.add(wall(3.0), material=pane(0.0, 1.0))
    scene.add(wall(-2.0), material=pane(0.0, 1.0))
    scan = ahead(depth, returns=depth).scan(scene)
    assert scan.path is not None
    assert scan.path[0].tolist() == [*range(depth)]
    assert scan.range[0].tolist() == [3.0 + 5.0 * k for k in range(depth)]
    assert scan.object_id[0].tolist() == [k % 2 for k in range(depth)]
    # Inside a mirror ball, along a diameter: of a curved mirror only the root at the mirror is left out.
    ball = ls.Scene()
    ball.add(ls.Sphere((0.5, 0, 0), 2.5), material=pane(0.0, 1.0))
    scan = ahead(depth, returns=depth).scan(ball)
    assert scan.range[0].tolist() == [3.0 + 5.0 * k for k in range(depth)]


def test_ten_thousand_panes_in_a_row() -> None:
    scene = ls.Scene()
    places = 2.0 + np.arange(10_000) / 1000
    corners = np.array([(0, -1, -1), (0, 1, -1), (0, 0, 2)], dtype=float)
    vertices = corners + np.stack([places, 0 * places, 0 * places], axis=1)[:, None]
    mesh = ls.TriangleMesh(vertices.reshape(-1, 3), np.arange(30_000).reshape(-1, 3))
    panes = scene.add(mesh, material=pane(0.999))
    scene.add(wall(13.0))
    scan = ahead(255, returns=255).scan(scene)
    assert scan.path is not None
    assert scan.range[0].tolist() == places[:255].tolist()
    assert scan.path[0].tolist() == [*range(255)]
    # Of 254 panes, each of the two products rounds.
    assert scan.intensity[0] == pytest.approx(0.1 * 0.999 ** (2 * np.arange(255)), rel=FLOAT32 + 2 * 254 * ROUNDING)
    # Where each pane also mirrors, there are 2²⁵⁴ ways, of which the strongest are followed.
    scene.update(panes, material=pane(0.9, 0.1))
    scan = ahead(255, returns=255).scan(scene)
    assert scan.path is not None
    assert scan.return_count.tolist() == [255]
    straight = scan.path[0] == np.round((scan.range[0] - 2.0) * 1000)
    assert np.count_nonzero(straight) > 20


# Hard places


def test_a_pane_flush_with_a_wall() -> None:
    """Of coincident surfaces the lower id is first, and a mirror that hangs on a wall does not show that wall."""
    for normal in ((1.0, 0.0, 0.0), (0.3, 0.1, 0.05)):
        for first in (True, False):
            scene = ls.Scene()
            plane = ls.Plane(normal, 5.0 * normal[0])
            materials = [pane(0.5), ls.Material(reflectivity=0.4)]
            for material in materials if first else materials[::-1]:
                scene.add(plane, material=material)
            scan = ahead(3, returns=3).scan(scene)
            assert scan.object_id.tolist() == ([[0, 1, -1]] if first else [[0, -1, -1]])
            assert np.ptp(scan.true_range[0, : 1 + first]) == 0.0
            scene.update(0 if first else 1, material=pane(0.0, 0.5))
            scene.add(ls.Plane((1, 0, 0), -2.0))
            scan = ahead(3, returns=3).scan(scene)
            assert scan.object_id.tolist() == ([[0, 2, -1]] if first else [[0, -1, -1]])


def test_a_mirror_of_many_triangles_in_one_plane_is_left_as_a_whole() -> None:
    """Pulses at the edges and corners of the triangles, which rounding may put on either side of the plane."""
    steps = np.linspace(-2.0, 2.0, 9)
    y, z = (grid.ravel() for grid in np.meshgrid(steps, steps))
    vertices = np.stack([np.full_like(y, 5.3), y, z], axis=1)
    faces = [face for k in range(72) if k % 9 < 8 for face in ((k, k + 1, k + 10), (k, k + 10, k + 9))]
    scene = ls.Scene()
    scene.add(ls.TriangleMesh(vertices, faces), material=pane(0.0, 0.9))
    scene.add(ls.Plane((1, 0, 0), -3.0))
    inner = vertices[(np.abs(y) < 2) & (np.abs(z) < 2)]
    edges = (inner[:-1] + inner[1:]) / 2
    scan = lidar(np.concatenate([inner, edges]), 2, returns="last").scan(scene)
    assert np.all(scan.object_id == 1)
    assert np.all(scan.true_range > 8.0)


def test_grazing_incidence_and_a_pane_seen_edge_on() -> None:
    scene = ls.Scene()
    scene.add(ls.Box((4.0, 2.0, 1.0), center=(6.0, 0.0, -0.5)), material=pane(0.5))  # its top is at z = 0
    scene.add(wall(20.0))
    scan = ahead(4, returns=4).scan(scene)
    every = scene.cast_all([(0, 0, 0)], [(1, 0, 0)], most=4)
    assert np.array_equal(scan.range[0], [*every.t[0][np.isfinite(every.t[0])], math.nan], equal_nan=True)
    # A sphere that is touched is met once; a triangle in the plane of the pulse never.
    scene = ls.Scene()
    scene.add(ls.Sphere((5, 0, 1), 1.0), material=pane(0.5))
    scene.add(ls.Triangle((6, -1, 0), (8, -1, 0), (7, 1, 0)), material=pane(0.5))
    scene.add(wall(9.0))
    scan = ahead(4, returns=4).scan(scene)
    assert scan.object_id.tolist() == [[0, 2, -1, -1]]
    assert scan.range[0, :2].tolist() == [5.0, 9.0]
    # At the grazing end of a mirror floor, the image is as far below it.
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -(2.0**-20)), material=pane(0.0, 1.0))
    scene.add(wall(9.0))
    scan = lidar([(1.0, 0.0, -(2.0**-18))], 2, returns="last").scan(scene)
    assert scan.path is not None
    assert scan.path.tolist() == [[1]]
    expected = [9.0, 0.0, 9 * 2.0**-18 - 2.0**-19]
    assert scan.true_points()[0] == pytest.approx(expected, rel=(TURN + 2 * PLACE) * ROUNDING, abs=0)


# Brute force


@dataclasses.dataclass
class Met:
    """A surface at the end of a way."""

    path: int
    range: float
    object: int
    share: float
    point: Floats
    cosine: float
    error: float
    """Bound of the error of range and point by rounding, m."""
    turned: float
    """Likewise of the directions of the light and of the normal, rad."""


def curvature(shape: ls.Shape) -> float:
    """Return the greatest curvature of a surface, 1/m."""
    radii = getattr(shape, "radii", getattr(shape, "radius", np.inf))
    return 0.0 if isinstance(shape, ls.Disk) else float(np.max(1.0 / np.asarray(radii)))


def reflect(o: Floats, d: Floats, t: float, n: Floats) -> tuple[Floats, Floats]:
    """The documented formula, the sums of products in their order."""
    dn = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
    nn = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    return o + t * d, d - 2.0 * dn / nn * n


def follow(scene: ls.Scene, alone: dict[int, ls.Scene], o: Floats, d: Floats, depth: int, time: float) -> list[Met]:
    """All surfaces that light meets from an origin, by casts alone.

    Rounding is followed to first order. Light that is `aside` and `turned` meets a surface so far from where it should,
    over the cosine of its incidence. That turns the normal by the curvature, and the mirrored light by twice as much.
    """
    found: list[Met] = []
    todo: list[tuple[Floats, Floats, int, float, float, int, float, float, float]] = [
        (o, d, 0, 0.0, 1.0, -1, 0.0, 0.0, 0.0)
    ]
    while todo:
        o, d, path, before, share, mirror, aside, turned, late = todo.pop()
        hits = scene.cast_all([o], [d], most=64, time=time)
        skipped = math.nan
        if mirror >= 0:
            back, forth = (alone[mirror].cast_all([o], [way], most=1, time=time).t[0, 0] for way in (-d, d))
            # Nearest to the origin is the mirror itself: met at once, or not at all if rounding put it behind.
            assert not aside < min(back, forth) < 1000 * aside
            skipped = forth if forth <= back and forth <= aside else math.nan
        for t, object_id, normal in zip(hits.t[0], hits.object_id[0], hits.normal[0], strict=True):
            if path == depth or not math.isfinite(t):
                break
            if t == skipped and object_id == mirror:
                continue
            leg = t * np.linalg.norm(d)
            cosine = abs(normal @ d)
            off = (aside + turned * leg + PLACE * ROUNDING * (np.linalg.norm(o) + leg)) / cosine
            bent = off * curvature(scene[object_id].shape)
            found.append(Met(path, before + leg, object_id, share, o + t * d, cosine, late + off, turned + bent))
            material = scene[object_id].material
            path += 1
            if material.mirror > 0.0 and path < depth:
                start, way = reflect(o, d, t, normal)
                then = off, turned + 2 * bent + TURN * ROUNDING, late + off
                todo.append((start, way, path, before + leg, share * material.mirror**2, object_id, *then))
            if material.transmission == 0.0:
                break
            share *= material.transmission**2
    return sorted(found, key=lambda met: met.range)


def crowd(random: np.random.Generator, movers: bool) -> ls.Scene:
    """Shapes of each kind, most of which transmit or mirror, in a closed room."""
    scene = ls.Scene()
    shares = [(0.0, 0.0), (0.8, 0.0), (0.0, 0.9), (0.6, 0.3), (0.3, 0.6)]

    def material() -> ls.Material:
        return pane(*shares[random.integers(len(shares))], reflectivity=random.uniform(0.1, 1.0))

    def place() -> Floats:
        return random.uniform(-8, 8, 3)

    octahedron = ls.TriangleMesh(
        [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)],
        [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)],
    )
    scene.add(ls.Box((24, 24, 24)), material=ls.Material(reflectivity=0.5))
    for _ in range(12):
        center = place()
        scene.add(ls.Sphere(place(), random.uniform(0.5, 2)), material=material())
        scene.add(ls.Cylinder(center, center + random.normal(0, 1.5, 3), random.uniform(0.3, 1)), material=material())
        scene.add(ls.Disk(place(), random.normal(size=3), random.uniform(1, 3)), material=material())
        corner, across, up = place(), random.normal(0, 2, 3), random.normal(0, 2, 3)
        scene.add(ls.Polygon([corner, corner + across, corner + across + up, corner + up]), material=material())
        turn = np.eye(4)
        turn[:3, :3], turn[:3, 3] = random.normal(0, 1, (3, 3)), place()
        motion = ls.Trajectory.from_twist(IDENTITY, random.normal(0, 1, 3), random.normal(0, 0.2, 3))
        scene.add(octahedron, transform=turn, material=material(), motion=motion if movers else None)
    scene.add(ls.Spheres(random.uniform(-8, 8, (20, 3)), random.uniform(0.2, 0.8, 20)), material=material())
    return scene


@pytest.mark.parametrize(("seed", "movers"), [(0, False), (1, False), (2, True), (3, True)])
def test_ways_are_those_that_casts_find(seed: int, movers: bool) -> None:
    random = np.random.default_rng(seed)
    scene, depth, time = crowd(random, movers), 5, 0.75
    alone = {}
    for item in scene:
        alone[item.id] = ls.Scene()
        alone[item.id].add(item.shape, transform=item.transform, motion=item.motion)
    scan = lidar(random.normal(size=(600, 3)), depth, returns=depth).scan(scene, time=time)
    assert scan.path is not None
    directions = scan.pulses.directions
    compared, branched, bent = 0, 0, 0
    for pulse, direction in enumerate(directions):
        expected = follow(scene, alone, np.zeros(3), direction, depth, time)
        count = min(len(expected), depth)
        assert scan.return_count[pulse] == count
        branched += len(expected) > depth
        # Ranges that differ by rounding alone, of ways that meet again, may come in either order.
        if any(b.range - a.range <= a.error + b.error for a, b in pairwise(expected[: count + 1])):
            continue
        for k, met in enumerate(expected[:count]):
            assert scan.object_id[pulse, k] == met.object
            assert scan.path[pulse, k] == met.path
            assert scan.true_range[pulse, k] == pytest.approx(met.range, rel=0, abs=2 * met.error)  # both round
            brightest = float(scene[met.object].material.reflectivity) * met.share
            near = brightest * (2 * met.turned + FLOAT32 * met.cosine)
            assert float(scan.intensity[pulse, k]) == pytest.approx(brightest * met.cosine, rel=0, abs=near)
            compared += 1
            bent += met.path > 0 and not math.isnan(scan.mirrored_point[pulse, k, 0])
        points = scan.mirrored_point[pulse, :count]
        for k in np.flatnonzero(~np.isnan(points[:, 0])):
            assert points[k] == pytest.approx(expected[k].point, rel=0, abs=2 * expected[k].error)
    assert compared > 700
    assert branched > 25
    assert bent > 100


# What the sensor makes of it


def street() -> ls.Scene:
    """A window in front of a wall, and a mirror that shows a ball that moves, as does the mirror."""
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.5), material=pane(0.0, 0.2, reflectivity=0.3))
    scene.add(ls.Polygon([(6, -4, -1), (6, 0, -1), (6, 0, 2), (6, -4, 2)]), material=pane(0.6, 0.3))
    scene.add(ls.Plane((1, 0.1, 0), 9.0), material=ls.Material(reflectivity=0.7))
    moves = ls.Trajectory.from_twist(IDENTITY, (0.5, -0.25, 0.1))
    scene.add(ls.Sphere((2.5, 3, 0), 1.0), material=pane(0.0, 0.5), motion=moves)
    turned = ls.Trajectory.from_twist(IDENTITY, (-1.0, 0.2, 0.0), (0, 0, 0.02))
    scene.add(ls.Box((0.1, 4, 3), center=(7, 2.5, 0)), material=pane(0.0, 0.9), motion=turned)
    return scene


NOISY: dict[str, Any] = {
    "range_sigma": 0.02,
    "range_resolution": 1e-3,
    "azimuth_sigma": 1e-3,
    "dropout": 0.1,
    "detection": ls.Detection(0.1, 30.0),
    "power_sigma": 0.3,
    "extinction": 0.01,
    "crossover": (1.0, 3.0),
    "receiver_offset": -0.03,
    "false_returns": 0.2,
}


def spinning(**measurement: Any) -> ls.Lidar:
    pattern = ls.patterns.Spinning(
        np.radians(np.linspace(-15, 10, 8)), columns=180, rate=10.0, firing_times=np.linspace(0, 1e-4, 8)
    )
    return ls.Lidar(pattern, measurement=ls.Measurement(**measurement), max_range=60.0)


def arrays(scan: ls.Scan) -> dict[str, npt.NDArray[Any]]:
    names = [field.name for field in dataclasses.fields(scan)]
    return {name: array for name in names if isinstance(array := getattr(scan, name), np.ndarray)}


@pytest.mark.parametrize("beam", [None, ls.Beam(5e-3, 3e-3, rays=7)], ids=["ray", "beam"])
@pytest.mark.parametrize("returns", ["strongest", "last", 4])
def test_the_same_bits_for_all_threads_instruction_sets_and_parts(
    beam: ls.Beam | None, returns: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, sensor = street(), spinning(**NOISY, beam=beam, returns=returns, depth=4)
    moving = ls.Trajectory.from_twist(IDENTITY, (3.0, 0.5, 0.0), (0, 0, 0.3))
    scan = sensor.scan(scene, moving, time=0.5, seed=3)
    expected = arrays(scan)
    assert {"path", "mirrored_point", "source", "radial_velocity", "true_direction"} < expected.keys()
    assert np.count_nonzero((scan.path > 0) & (scan.path < 255)) > 20
    pose = expected.pop("pose", None)
    assert pose is None
    best = ls._native.isa()  # type: ignore[attr-defined]
    for isa in ("scalar", "avx2", "avx512")[: ("scalar", "avx2", "avx512").index(best) + 1]:
        for threads in ("1", "3"):
            monkeypatch.setenv("LIDARSIM_ISA", isa)
            monkeypatch.setenv("LIDARSIM_THREADS", threads)
            again = arrays(sensor.scan(scene, moving, time=0.5, seed=3))
            for name, array in expected.items():
                assert np.array_equal(array, again[name], equal_nan=array.dtype.kind == "f"), (isa, threads, name)
    chosen = np.random.default_rng(0).permutation(len(scan))[:300]
    part = arrays(ls.scan.scan.scan(sensor, scene, moving, time=0.5, seed=3, indices=chosen))
    for name, array in expected.items():
        assert np.array_equal(array[chosen], part[name], equal_nan=array.dtype.kind == "f"), name


def test_single_returns_are_the_first_of_several() -> None:
    """Pulses of one return are measured eight at a time, and those that go on once more; others one by one."""
    scene = street()
    for noise in ({}, NOISY):
        one, several = (spinning(**noise, depth=4, returns=count).scan(scene, time=0.5, seed=1) for count in (1, 4))
        first = arrays(several)
        assert one.path is not None
        for name, array in arrays(one).items():
            other = first[name]
            if name == "return_count":
                other = np.minimum(other, 1)
            elif other.ndim > 1 and name != "pose":
                other = other[:, :1]
            assert np.array_equal(array, other, equal_nan=array.dtype.kind == "f"), name
        last = spinning(**noise, depth=4, returns="last").scan(scene, time=0.5, seed=1)
        assert np.count_nonzero(last.path != one.path) > 100


def test_radial_velocity_is_the_rate_of_the_length_of_the_way() -> None:
    """Sensor, mirrors and what is seen in them move; each point of the way is one of its body."""
    scene, sensor, start, step = street(), spinning(depth=2, returns=2), 0.5, 1e-4
    moving = ls.Trajectory.from_twist(IDENTITY, (3.0, 0.5, 0.2), (0, 0, 0.1))
    scan = sensor.scan(scene, moving, time=start)
    assert scan.mirrored_point is not None
    assert scan.radial_velocity is not None
    compared, of_movers = 0, 0
    for pulse, entry in np.argwhere(~np.isnan(scan.mirrored_point[..., 0])):
        time = start + scan.pulses.time[pulse]

        def move(item: ls.SceneObject | None, point: Floats, by: float, time: float = time) -> Floats:
            """Return where a point of a body is a while later."""
            path = moving if item is None else item.motion
            if path is None:
                return point
            then: Floats = (path.at(time + by) * path.at(time).inv()).apply(point)
            return then

        pose = moving.at(time)
        origin, direction = pose.translation, pose.rotation.apply(scan.pulses.directions[pulse].copy())
        hit = scene.cast([origin], [direction], time=time)
        mirror, met = scene[int(hit.object_id[0])], scene[int(scan.object_id[pulse, entry])]
        points = [
            (None, origin),
            (mirror, origin + hit.t[0] * direction),
            (met, pose.apply(scan.mirrored_point[pulse, entry].copy())),
        ]

        def legs(by: float, points: Any = points) -> Floats:
            places = [move(item, point, by) for item, point in points]
            return np.diff(places, axis=0)

        def length(by: float) -> float:
            return float(np.linalg.norm(legs(by), axis=1).sum())

        # Where a surface is met does not change the length, to first order. Poses round the places of a rotation and a
        # shift four times, there and back.
        near = rounding(length(0.0)) + 8 * ROUNDING * length(0.0)
        assert length(0.0) == pytest.approx(scan.true_range[pulse, entry], rel=0, abs=near)
        # The central difference is off by step²/6 of the third derivative, which is at most 3v³/R² for each of the two
        # legs of length R whose ends part at v (3v·a/R, of the turns, is less), and velocities are float32.
        rate = (length(step) - length(-step)) / (2 * step)
        speed = np.linalg.norm(legs(step) - legs(-step), axis=1) / (2 * step)
        third = (3 * speed**3 / np.linalg.norm(legs(0.0), axis=1) ** 2).sum()
        near = step**2 / 6 * third + near / step + FLOAT32 * abs(rate)
        assert float(scan.radial_velocity[pulse, entry]) == pytest.approx(rate, rel=0, abs=near)
        compared += 1
        of_movers += mirror.motion is not None or met.motion is not None
    assert compared > 200
    assert of_movers > 50


def test_a_beam_sees_the_wall_behind_a_pane_as_an_echo_of_its_own() -> None:
    scene = ls.Scene()
    scene.add(wall(10.0), material=pane(0.5))
    scene.add(wall(14.0), material=ls.Material(reflectivity=0.6))
    beam = ls.Beam(2e-3, pulse_length=5e-9, rays=19)
    oblique = 1e-3**2 / 2  # less one, the least cosine in the beam, which makes ranges longer and intensities lower
    scan = ahead(2, beam=beam, returns=3).scan(scene)
    assert scan.path is not None
    assert scan.return_count.tolist() == [2]
    assert scan.range[0, :2] == pytest.approx([10.0, 14.0], rel=oblique)
    assert scan.path[0].tolist() == [0, 1, 255]
    assert scan.intensity[0, :2] == pytest.approx([0.1, 0.6 * 0.25], rel=oblique + FLOAT32)
    # Nearer to each other than the pulse is long, they are one echo, between the two.
    scene.update(1, shape=wall(10.3))
    scan = ahead(2, beam=beam, returns=3).scan(scene)
    assert scan.return_count.tolist() == [1]
    near, far = 0.1 / 10**2, 0.15 / 10.3**2
    assert scan.range[0, 0] == pytest.approx(10 + 0.3 * far / (near + far), rel=oblique)
    # A slanted wall in a mirror is one echo, as wide as it is by itself.
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 30.0), material=pane(0.0, 1.0, reflectivity=0.0))
    scene.add(ls.Plane((1, 2, 0), -20.0))
    wide = ls.Beam(20e-3, pulse_length=1e-9, rays=37)
    in_mirror = ahead(2, beam=wide, returns=5).scan(scene)
    scene.remove(0)
    scene.update(1, shape=ls.Plane((-1, 2, 0), -80.0))
    itself = ahead(2, beam=wide, returns=5).scan(scene)
    assert np.ptp(itself.true_range[0, :1]) == 0.0
    seen = in_mirror.path[0] == 1
    assert np.count_nonzero(seen) == itself.return_count[0] == 1
    near = (TURN + 2 * PLACE) * ROUNDING
    assert in_mirror.range[0, seen] == pytest.approx(itself.range[0, :1], rel=near)
    # Both are rounded to float32.
    assert in_mirror.intensity[0, seen] == pytest.approx(itself.intensity[0, :1], rel=2 * FLOAT32)


@pytest.mark.parametrize("rays", [7, 19])
def test_the_truth_of_an_echo_is_that_of_the_innermost_sub_ray_behind_a_pane_or_not(rays: int) -> None:
    scene, sight = ls.Scene(), ls.Beam(5e-3, rays=rays)
    # The axis alone, or it and some next to it, meet the pane.
    scene.add(ls.Disk((5, 0, 0), (1, 0, 0), 0.004), material=ls.Material(reflectivity=0.0, transmission=0.99))
    wall = scene.add(ls.Plane((1, 0, 0.5), 10.0))
    scan = ahead(2, beam=sight, returns=3).scan(scene)
    assert scan.path is not None
    assert scan.true_direction is not None
    here = scan.object_id[0] == wall
    assert here.sum() == 1
    assert scan.path[0, here] == 1
    assert scan.true_range[0, here] == 10.0
    assert scan.true_direction[0, here].tolist() == [[1, 0, 0]]


def test_boxes_do_not_hold_ghosts() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 10.0), material=pane(0.0, 0.9))
    car = scene.add(ls.Box((2, 2, 2), center=(6, 5, 0)))
    sensor = spinning(depth=2, returns=2)
    scan = sensor.scan(scene)
    cloud = scan.point_cloud()
    own = cloud.object_id == car
    inside = np.all(np.abs(cloud.xyz - (6, 5, 0)) < 1.001, axis=1)
    assert 0 < np.count_nonzero(own & inside) < np.count_nonzero(own)
    (points,) = scan.boxes().points
    assert points == np.count_nonzero(own & inside)
