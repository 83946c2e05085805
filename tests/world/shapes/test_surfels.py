"""Surfels: a scan as a scene for another sensor, measured against the mesh that was scanned."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls

Floats = npt.NDArray[np.float64]
SOURCE, OTHER = np.array([0.0, 0.0, 3.0]), np.array([2.5, -1.5, 1.8])
WIDTH = 12.0


def hills() -> ls.TriangleMesh:
    """Hills about a metre high and 15 m long, of triangles of 5 cm."""
    x = np.arange(-WIDTH, WIDTH, 0.05)
    z = 0.5 * np.sin(x / 2.4)[None] * np.cos(x / 3.1)[:, None]
    return ls.TriangleMesh.from_heightfield(z, 0.05, (-WIDTH, -WIDTH))


def directions(count: int) -> Floats:
    """Directions to points of a grid below a sensor: count² of them, evenly spaced on level ground 3 m below."""
    steps = (np.arange(count) + 0.5) / count * 2 - 1
    x, y = np.meshgrid(steps * WIDTH * 0.9, steps * WIDTH * 0.9)
    return np.stack([x, y, np.full_like(x, -3.0)], axis=-1).reshape(-1, 3)


@dataclass
class Comparison:
    """What another sensor sees of the surfels of a scan, where the first sensor saw the mesh."""

    incidence: Floats
    is_hole: npt.NDArray[np.bool_]
    error: Floats  # m, along the ray; nan at holes


def compare(mesh: ls.TriangleMesh, count: int, noise: float = 0.0, neighbours: int = 16) -> tuple[Comparison, float]:
    """Scan with count² rays, make surfels, and cast from elsewhere. Also returns the spacing of points below."""
    d = directions(count)
    first = mesh.cast(np.tile(SOURCE, (len(d), 1)), d)
    points = SOURCE + first.t[first.hit, None] * d[first.hit]
    points += np.random.default_rng(1).normal(size=points.shape) * noise
    disks = ls.Disks.from_points(points, neighbours=neighbours)
    rng = np.random.default_rng(2)
    targets = np.stack([*rng.uniform(-0.7 * WIDTH, 0.7 * WIDTH, (2, 20_000)), np.zeros(20_000)], axis=-1)
    d = targets - OTHER
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = np.tile(OTHER, (len(d), 1))
    want, got = mesh.cast(o, d), disks.cast(o, d)
    # What the first sensor saw: nothing was in between, and it is within the grid.
    spot = OTHER + np.where(want.hit, want.t, 0.0)[:, None] * d
    seen = mesh.cast(np.tile(SOURCE, (len(d), 1)), spot - SOURCE, t_max=1 - 1e-3)
    kept = want.hit & ~seen.hit & (np.abs(spot[:, :2]).max(axis=1) < 0.75 * WIDTH)
    cosine = np.abs(np.einsum("ij,ij->i", want.normal, d))
    error = np.where(got.hit, got.t - np.where(want.hit, want.t, 0.0), np.nan)
    made = Comparison(np.arccos(cosine[kept].clip(max=1.0)), ~got.hit[kept], error[kept])
    return made, 2 * WIDTH * 0.9 / count


def test_another_sensor_sees_the_surface() -> None:
    mesh = hills()
    for count, neighbours in ((150, 16), (150, 8), (300, 16)):
        seen, spacing = compare(mesh, count, neighbours=neighbours)
        assert len(seen.error) > 10_000
        steep = np.degrees(seen.incidence) > 80
        hole = seen.is_hole | (np.abs(np.nan_to_num(seen.error)) > 3 * spacing)
        assert hole[~steep].mean() < 0.002
        # The chord of a disk of radius r is off a surface of curvature 1/R by up to r²/(2 R): here R > 8 m, and r is
        # at most about the spacing, which grows with the slope of the ground to the first sensor. Points lie in the
        # plane fitted to 16 neighbours up to 2 spacings away to within (2 spacings)²/(4 R). Along the ray, over cos θ.
        bound = (spacing**2 / 16 + spacing**2 / 8) / np.cos(seen.incidence)
        assert (np.abs(seen.error[~hole & ~steep]) < 2 * bound[~hole & ~steep]).mean() > 0.99
        assert np.median(np.abs(seen.error[~hole & ~steep])) < spacing**2 / 16


def test_edges_of_things_grow_by_no_more_than_the_spacing() -> None:
    """A box on a floor: disks hang over its edges, and its own are cut off."""
    size, low = np.array((2.0, 3.0, 1.5)), np.array((3.0, -1.0, 0.0))
    corners = low + np.array(list(np.ndindex(2, 2, 2))) * size
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (1, 3, 7, 5)]
    ground = np.array([(-20, -20, 0), (20, -20, 0), (20, 20, 0), (-20, 20, 0.0)])
    quads = np.array([*sides, (8, 9, 10, 11)])
    mesh = ls.TriangleMesh(
        np.concatenate([corners, ground]), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    )
    for spacing in (0.1, 0.05):
        grid = np.arange(-8, 8, spacing)
        targets = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        points = []
        for source in (np.array((0.0, -3.0, 4.0)), np.array((9.0, 4.0, 4.0))):
            d = np.column_stack([targets, np.zeros(len(targets))]) - source
            seen = mesh.cast(np.tile(source, (len(d), 1)), d)
            points.append(source + seen.t[seen.hit, None] * d[seen.hit])
        disks = ls.Disks.from_points(np.concatenate(points))
        o = np.array((1.0, -3.5, 1.2))
        rng = np.random.default_rng(6)
        d = low + rng.uniform(-0.2, 1.2, (20_000, 3)) * size - o
        o = np.tile(o, (len(d), 1))
        want, got = mesh.cast(o, d), disks.cast(o, d)
        length = np.linalg.norm(d, axis=1)
        false_hit = got.hit & (got.t * length < want.t * length - 3 * spacing)
        # A false hit is beside an edge: a ray that misses by more than a spacing or two sees what is behind.
        wide = mesh_of_box(low - 2 * spacing, size + 4 * spacing).cast(o, d)
        assert 0 < false_hit.sum() < 0.1 * len(d)
        assert not (false_hit & ~wide.hit).any()


def mesh_of_box(low: Floats, size: Floats) -> ls.Shape:
    return ls.Box(size, low + size / 2)


def test_disks_of_a_plane_leave_no_hole() -> None:
    """At any density, evenly or at random or in lines of a scanner: disks cover the cells of their points."""
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(60) / 10, np.arange(60) / 10), axis=-1).reshape(-1, 2)
    lines = np.stack(np.meshgrid(np.arange(120) / 20, np.arange(20) * 0.3), axis=-1).reshape(-1, 2)
    turn = Rotation.from_euler("xyz", (0.3, 0.4, 0.5)).as_matrix()
    shift = np.array([4e5, 5e6, 100.0])
    # Coordinates below 2²³ m are rounded by at most 2⁻³¹ m, which puts a point at most this far off the plane.
    off = np.sqrt(3.0) * 2.0**-31
    for plane, neighbours in ((grid, 8), (grid, 16), (lines, 32), (rng.uniform(0, 6, (4000, 2)), 16)):
        points = np.column_stack([plane, np.zeros(len(plane))]) @ turn.T + shift
        disks = ls.Disks.from_points(points, neighbours=neighbours)
        assert len(disks) == len(points)
        tilts = np.linalg.norm(np.cross(disks.normals, turn[:, 2]), axis=1)
        assert (tilts * disks.radii).max() <= off
        spots = np.column_stack([rng.uniform(0.6, 5.2, (20_000, 2)), np.zeros(20_000)]) @ turn.T + shift
        for slant in ((0.0, 0.0, 1.0), (3.0, -1.0, 0.5)):
            d = np.broadcast_to(np.array(slant) @ turn.T, spots.shape)
            hits = disks.cast(spots - d, d)
            # Of random points, 0.75¹⁶ = 1 % have no neighbour in some quarter, which looks like an edge.
            assert hits.hit.mean() >= (1.0 if plane is grid else 0.999)
            # The disk's centre, its tilt, the spot and the origin of the ray each have an error of at most `off`.
            np.testing.assert_allclose(hits.t[hits.hit], 1.0, rtol=0, atol=4 * off / slant[2])
        # and they are not much larger than needed
        area = np.pi * np.square(disks.radii).sum() / 36
        assert area < 8


def test_outliers_have_no_disk(caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(4)
    floor = np.column_stack([rng.uniform(0, 5, (3000, 2)), np.zeros(3000)])
    wire = np.column_stack([np.linspace(0, 5, 300), np.full(300, 9.0), np.full(300, 4.0)])
    strays = rng.uniform((0, 0, 2), (5, 5, 5), (5, 3))
    points = np.concatenate([floor, floor[:7], wire, strays])
    with caplog.at_level(logging.WARNING, "lidarsim"):
        disks, index = ls.Disks.from_points(points, return_index=True)
    np.testing.assert_array_equal(disks.centers, points[index])
    assert (index < 3000).all()
    assert len(index) > 2990
    lost = len(points) - len(index)
    (record,) = caplog.records
    assert record.getMessage().startswith(f"points: {lost} of {len(points)} have no disk: 7 repeated, ")
    alone = ls.Disks.from_points(floor, normals=[(0, 0, 2.0)] * 3000, radii=0.1)
    assert len(alone) == 3000
    np.testing.assert_array_equal(alone.radii, 0.1)
    np.testing.assert_array_equal(alone.normals, [(0, 0, 2.0)] * 3000)
    with pytest.raises(ValueError, match="points: expected points on surfaces, got none among 300"):
        ls.Disks.from_points(wire)


def test_scale_and_place_change_nothing() -> None:
    rng = np.random.default_rng(5)
    points = rng.integers(-999, 999, (500, 3)) / 64 * (1, 1, 1 / 64)
    still = ls.Disks.from_points(points)
    moved = ls.Disks.from_points(points * 2.0**300)
    np.testing.assert_array_equal(moved.normals, still.normals)
    np.testing.assert_array_equal(moved.radii, still.radii * 2.0**300)
    shifted = ls.Disks.from_points(points + 2.0**20)
    np.testing.assert_array_equal(shifted.radii, still.radii)
