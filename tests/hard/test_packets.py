"""Many rays at once: whatever bundles, orders and filters the core casts them by, each ray gets what it gets alone.

Frames of a sensor share an origin or nearly so, and their rays lie side by side; these are the rays that are bundled.
Each frame here is cast whole, shuffled, cut short and ray by ray, bit against bit, and a sample of it is held against
the oracle.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from exact import cases, oracle
from exact.accuracy import judge_cast

import lidarsim as ls


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


def assert_cast_alone_and_exactly(spec, origins, directions, instruction_sets, monkeypatch):
    """Assert that rays find together what each finds alone, which is the exact answer, and return the hits."""
    shape = spec.build()
    hits = shape.cast(origins, directions)
    verdict = judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id)
    assert (verdict.wrong, verdict.rounded) == (0, verdict.values), verdict.first
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        assert same(shape.cast(origins, directions), hits)
        for i in range(len(origins)):
            assert same(shape.cast(origins[i : i + 1], directions[i : i + 1]), part(hits, slice(i, i + 1))), i
    return hits


# Packets hold rays whose largest coordinate is between 1e±30: the first mix is of these, the second of all lengths.
@pytest.mark.parametrize("reach", [98, 1000])
@pytest.mark.parametrize("matrix", [None, "shear", "uneven", "turn-utm"])
@pytest.mark.parametrize("kind", cases.basic_specs())
def test_directions_of_every_length_at_once(kind, matrix, reach, instruction_sets, monkeypatch):
    spec = cases.basic_specs()[kind]
    rng = np.random.default_rng(reach)
    n = 96
    # From one corner, so that all point into one octant, and from places around it.
    origins = np.array((-2.0, -3.0, -4.0)) + rng.choice([0.0, 0.25], (n, 1)) * rng.random((n, 3))
    directions = rng.uniform(-0.7, 0.7, (n, 3)) - origins
    if matrix is not None:
        linear, offset = cases.transforms()[matrix][:3, :3], cases.transforms()[matrix][:3, 3]
        origins, directions = origins @ linear.T + offset, directions @ linear.T
        spec = cases.Spec(spec.kind, spec.args, cases.transforms()[matrix])
    directions *= 2.0 ** np.linspace(-reach, reach, n)[rng.permutation(n), None].round()
    hits = assert_cast_alone_and_exactly(spec, origins, directions, instruction_sets, monkeypatch)
    assert hits.hit.sum() >= 10


@pytest.mark.parametrize(("scale", "wall"), [(0.3, 1e-21), (1e-3, 1e-21), (1e-34, 1e-30)])
def test_short_rays_whose_sign_is_lost_beside_long_ones(scale, wall, instruction_sets, monkeypatch):
    """In the coordinates of a mesh that was sheared, the x of short rays is what the rounding of their numbers left."""
    matrix = np.eye(4)
    matrix[0, 2] = scale
    z = np.random.default_rng(5).uniform(0.7, 0.9, 400)
    off = np.array([float(Fraction(scale * x) - Fraction(scale) * Fraction(x)) for x in z.tolist()])
    z, off = (x[off < -scale * 2.0**-56][:48] for x in (z, off))
    assert len(z) == 48
    # A wall at x = -wall, as high as the highest hit.
    top = wall * float((z / -off).max()) * 10
    mesh = cases.Spec("TriangleMesh", ([(-wall, -top, 0), (-wall, top, 0), (-wall, 0, top)], [(0, 1, 2)]), matrix)
    for apart in (98, 116, 180):
        short = np.ldexp(np.stack([scale * z, np.zeros(48), z], axis=1), -apart // 2)
        long = np.ldexp(np.tile((0.05 + 0.7 * scale, 0, 0.7), (16, 1)), apart // 2)
        directions = np.concatenate([short, long])
        hits = assert_cast_alone_and_exactly(mesh, np.zeros_like(directions), directions, instruction_sets, monkeypatch)
        assert hits.hit.tolist() == [True] * 48 + [False] * 16
