"""Many rays at once: whatever bundles, orders and filters the core casts them by, each ray gets what it gets alone.

Frames of a sensor share an origin or nearly so, and their rays lie side by side; these are the rays that are bundled.
Each frame here is cast whole, shuffled, cut short and ray by ray, bit against bit, and a sample of it is held against
the oracle.
"""

from __future__ import annotations

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.bench import cases, oracle


def terrain(shift=0.0, scale=1.0):
    rng = np.random.default_rng(1)
    n = 24
    x, y = np.meshgrid(np.arange(n) - n / 2, np.arange(n) - n / 2)
    z = np.cumsum(rng.normal(size=(n, n)), axis=1) * 0.3 - 3
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3) * scale + shift
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    return vertices, np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def mesh_at(shift=0.0, scale=1.0):
    return [(cases.Spec("TriangleMesh", terrain(shift, scale)), None)]


def street(shift=0.0):
    """A plane, meshes, instances of them, and every other shape, some moved."""
    vertices, faces, _ = cases.closed_meshes()["torus"]
    torus = cases.Spec("TriangleMesh", (vertices, faces))
    specs = [(cases.Spec("Plane.from_point", (np.full(3, shift) - (0, 0, 2.5), (0.01, 0.02, 1.0))), None)]
    rng = np.random.default_rng(2)
    for number, spec in enumerate([torus, torus, torus, *list(cases.basic_specs().values())[1:] * 2]):
        matrix = np.eye(4)
        matrix[:3, :3] = cases.rotations(1, number)[0] * rng.uniform(0.5, 1.5, 3)
        around = 2.4 * number
        matrix[:3, 3] = shift + (3 + number / 3) * np.array((np.cos(around), np.sin(around), rng.uniform(-0.3, 0.3)))
        specs.append((spec, matrix))
    return specs


WORLDS = {
    "terrain": (mesh_at(), 0.0, 1.0),
    "terrain-5e6": (mesh_at(5e6), 5e6, 1.0),
    "terrain-1e9": (mesh_at(1e9), 1e9, 1.0),
    "terrain-tiny": (mesh_at(0.0, 2.0**-70), 0.0, 2.0**-70),
    "terrain-huge": (mesh_at(0.0, 2.0**70), 0.0, 2.0**70),
    "street": (street(), 0.0, 1.0),
    "street-5e6": (street(5e6), 5e6, 1.0),
}


def sweep(rings=16, columns=64):
    """Directions of a spinning sensor, ring by ring."""
    azimuth = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    elevation = np.radians(np.linspace(-35, 10, rings))[:, None]
    parts = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) + 0 * azimuth)
    return np.stack(parts, axis=-1).reshape(-1, 3)


def shared_origin(vertices):
    del vertices
    directions = sweep()
    return np.zeros_like(directions), directions


def moving_origin(vertices):
    del vertices
    directions = sweep()
    return np.linspace((0, 0, 0), (0.3, -0.2, 0.05), len(directions)), directions


def to_vertices_and_edges(vertices):
    targets = np.concatenate([vertices, (vertices[1:] + vertices[:-1]) / 2])[:900]
    targets = targets[np.argsort(np.arctan2(targets[:, 1], targets[:, 0]))]
    return np.zeros_like(targets), targets


def parallel_to_an_axis(vertices):
    """Straight down a grid that meets the terrain's vertices and edges, with zeros of either sign."""
    del vertices
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-12, 12, 0.75), np.arange(-12, 12, 0.75)))
    directions = np.tile((0.0, -0.0, -1.0), (len(x), 1))
    directions[::3, 0] = -0.0
    return np.stack([x, y, np.full_like(x, 20.0)], axis=1), directions


def of_any_length(vertices):
    origins, directions = moving_origin(vertices)
    return origins, directions * 2.0 ** np.random.default_rng(3).integers(-300, 300, (len(directions), 1))


def one_ray_over_and_over(vertices):
    return np.zeros((100, 3)), np.repeat(vertices[200:201] / 3, 100, axis=0)


FRAMES = (
    shared_origin,
    moving_origin,
    to_vertices_and_edges,
    parallel_to_an_axis,
    of_any_length,
    one_ray_over_and_over,
)


def same(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("t", "object_id", "primitive_id", "normal")
    )


def part(hits, index):
    return ls.Hits(*(getattr(hits, name)[index] for name in ("t", "object_id", "primitive_id", "normal")))


@pytest.fixture(scope="module", params=WORLDS)
def world(request):
    specs, shift, scale = WORLDS[request.param]
    scene, judge = ls.Scene(), oracle.Scene()
    for spec, matrix in specs:
        scene.add(spec.build(), transform=matrix)
        judge.add(spec.judge(), matrix)
    return scene, judge, shift, scale


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: frame.__name__)
def test_bundled_rays(world, frame, instruction_sets, monkeypatch, slow):
    scene, judge, shift, scale = world
    origins, directions = frame(terrain()[0])
    origins, directions = origins * scale + shift, directions * scale
    hits = scene.cast(origins, directions)
    assert hits.hit.sum() >= 30

    rng = np.random.default_rng(4)
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        assert same(scene.cast(origins, directions), hits)
        order = rng.permutation(len(origins))
        assert same(scene.cast(origins[order], directions[order]), part(hits, order))
        for n in (1, 2, 7, 8, 9, 15, 16, 17, 31, 33, 63, 64, 65):
            start = int(rng.integers(0, len(origins) - n))
            cut = slice(start, start + n)
            assert same(scene.cast(origins[cut], directions[cut]), part(hits, cut)), n
        for i in rng.integers(0, len(origins), 60):
            assert same(scene.cast(origins[i : i + 1], directions[i : i + 1]), part(hits, slice(i, i + 1))), i
        nearer = np.median(hits.t[hits.hit])
        limited = scene.cast(origins, directions, t_max=nearer)
        beyond = hits.t > nearer
        np.testing.assert_array_equal(limited.t, np.where(beyond, np.inf, hits.t))
        np.testing.assert_array_equal(limited.object_id, np.where(beyond, -1, hits.object_id))

    for i in rng.integers(0, len(origins), 400 if slow else 20):
        want = judge.nearest(oracle.Ray.of(origins[i].tolist(), directions[i].tolist()))
        assert hits.object_id[i] == (-1 if want is None else want[0])
        if want is not None:
            number, crossing = want
            assert hits.t[i] == float(crossing.t)
            assert hits.primitive_id[i] == (min(crossing.faces) if judge.shapes[number].primitives else 0)
