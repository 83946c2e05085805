from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from lidarsim.bench import exact, scenes
from lidarsim.bench.scenes import UTM, Rays, World
from lidarsim.bench.speed import MESHES
from lidarsim.world.scene import Scene


def some(rays: Rays, count: int) -> Rays:
    return rays[np.random.default_rng(0).choice(len(rays), count, replace=False)]


def test_meshes_have_their_sizes() -> None:
    worlds = [scenes.city(), scenes.terrain(), scenes.scans()]
    assert [world.name for world in worlds] == ["city", "terrain", "scans"]
    for world, triangles in zip(worlds, (740_000, 1_000_000, 718_000), strict=True):
        assert world.triangles == pytest.approx(triangles, rel=0.01)


@pytest.mark.parametrize("make", [*MESHES.values(), scenes.analytic], ids=[*MESHES, "analytic"])
def test_the_lidar_sees_much_of_each_world(make: Callable[..., World]) -> None:
    world = make() if make is scenes.analytic else make(5000)
    truth = exact.first_hits(world, some(scenes.lidar(world, 128, 32, math.pi / 4), 100))
    hit = truth.surface >= 0
    assert hit.sum() >= 40
    assert len(set(truth.surface[hit].tolist())) >= 15


def test_bodies_of_scans_are_closed_and_uneven() -> None:
    world = scenes.scans(4000)
    assert world.mesh is not None
    vertices, faces = world.mesh
    edges = Counter(map(tuple, np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert np.percentile(area, 95) > 10 * np.percentile(area, 5)


def test_finer_terrain_is_the_same_terrain() -> None:
    coarse, fine = scenes.terrain(2 * 16**2), scenes.terrain(2 * 64**2)
    assert coarse.mesh is not None
    assert fine.mesh is not None
    difference = fine.mesh[0].reshape(65, 65, 3)[::4, ::4] - coarse.mesh[0].reshape(17, 17, 3)
    assert np.ptp(coarse.mesh[0][:, 2]) > 10
    assert np.abs(difference[..., :2]).max() < 1e-9
    assert np.abs(difference[..., 2] - difference[8, 8, 2]).max() < 10


def surfaces(world: World, mesh: World) -> list[float]:
    """Largest distance of the vertices of each object's triangles from the object, over its size."""
    assert mesh.mesh is not None
    vertices, faces = mesh.mesh
    result = []
    for index, spec in enumerate(world.shapes[1:], 1):
        corners = vertices[np.unique(faces[mesh.owner == index])]
        center = spec.args[0] if spec.kind != "Box" else spec.args[1]
        if spec.kind == "Cylinder":
            start, end, radius = spec.args
            axis = (end - start) / np.linalg.norm(end - start)
            away = np.linalg.norm(np.cross(corners - start, axis), axis=1)
            onto = (corners - start) @ axis / np.linalg.norm(end - start)
            rim = np.minimum(np.abs(away / radius - 1), away / radius)
            result.append(float(np.maximum(rim, np.minimum(np.abs(onto), np.abs(onto - 1))).max()))
        elif spec.kind == "Box":
            result.append(float(np.abs(np.abs(corners - center) - spec.args[0] / 2).max()))
        else:
            turn = spec.args[2] if spec.kind == "Ellipsoid" else np.eye(3)
            unit = (corners - center) @ turn / spec.args[1]
            result.append(float(np.abs(np.linalg.norm(unit, axis=1) - 1).max()))
    return result


def test_tessellation_lies_on_the_shapes() -> None:
    world = scenes.analytic(40)
    mesh = world.tessellate(2)
    assert mesh.owner is not None
    assert set(mesh.owner.tolist()) == set(range(41))
    distances = surfaces(world, mesh)
    assert len(distances) == 40
    assert max(distances) < 1e-12


@pytest.mark.parametrize("kind", ["Sphere", "Ellipsoid", "Cylinder"])
def test_each_level_of_tessellation_errs_a_quarter_of_the_last(kind: str) -> None:
    """The sagitta of an edge goes with the square of its length."""
    world = scenes.analytic(100)
    rays = scenes.lidar(world, 128, 256, math.pi / 4)
    scene = Scene()
    for spec in world.shapes:
        scene.add(spec.build())
    exact = scene.cast(rays.origins, rays.directions)
    errors = []
    for mesh in map(world.tessellate, (1, 2, 3)):
        hits = mesh.shapes[0].build().cast(rays.origins, rays.directions)
        owner = np.asarray(mesh.owner)[hits.primitive_id]
        same = hits.hit & (owner == exact.object_id) & np.array([spec.kind == kind for spec in world.shapes])[owner]
        assert same.sum() > 200
        errors.append(np.median(np.abs(hits.t[same] - exact.t[same])))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.1)


def test_lidar_fires_from_one_place_column_by_column() -> None:
    world = scenes.analytic(4, UTM)
    rays = scenes.lidar(world, 128, 16, math.pi / 4)
    assert rays.name == "128 × 16"
    assert rays.one_origin
    assert len(rays) == 128 * 16
    assert (rays.origins == world.sensor).all()
    elevation = np.arcsin(rays.directions[:, 2]).reshape(16, 128)
    # Below 0.5 rad: an elevation, its sine, which has a derivative of at least 0.9, and its arcsine are each rounded.
    expected = np.tile(np.linspace(-math.pi / 8, math.pi / 8, 128), (16, 1))
    np.testing.assert_allclose(elevation, expected, rtol=0, atol=4 * 2.0**-54)


def test_random_rays_fill_the_box() -> None:
    world = scenes.city(900, UTM)
    rays = scenes.random_rays(world, 1000)
    assert not rays.one_origin
    inside = (world.low <= rays.origins) & (rays.origins <= world.high)
    assert inside.all()
    span = np.ptp(rays.origins, axis=0) / (world.high - world.low)
    assert (span > 0.95).all()
    # The norm, its quotients, and the norm of these: each a few roundings.
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1, rtol=0, atol=8 * 2.0**-53)
    assert np.abs(rays.directions.mean(axis=0)).max() < 5 / math.sqrt(3 * 1000)  # five sigma
