"""Meshes: closed ones never leak, ties go to the lowest index, a hierarchy answers as brute force in rationals does."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from exact import cases, oracle
from exact.accuracy import judge_cast, judge_roots

import lidarsim as ls

MESHES = cases.closed_meshes()


def check(vertices, faces, origins, directions):
    """Assert that everything agrees with the oracle, and return the hits."""
    spec = cases.Spec("TriangleMesh", (vertices, faces))
    mesh = spec.build()
    hits = mesh.cast(origins, directions)
    for verdict in (
        judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id),
        judge_roots(spec, origins, directions, mesh.roots(origins, directions)),
    ):
        assert verdict.wrong == 0, verdict.first
        assert verdict.rounded == verdict.values, "not the exact value correctly rounded"
    return hits


@pytest.mark.parametrize("offset", cases.OFFSETS)
@pytest.mark.parametrize("name", MESHES)
def test_closed_mesh_does_not_leak(name, offset):
    vertices, faces, inside = MESHES[name]
    vertices, inside = vertices + cases.OFFSETS[offset], inside + cases.OFFSETS[offset]
    origins, directions = cases.leak_rays(vertices, faces, inside, np.random.default_rng(1))
    assert len(origins) >= 30
    mesh = ls.TriangleMesh(vertices, faces)
    assert int((~mesh.cast(origins, directions).hit).sum()) == 0
    assert int((~mesh.cast(origins, -directions).hit).sum()) == 0
    moved = ls.TriangleMesh(vertices, faces, transform=cases.transforms()["turn-utm"])
    matrix = cases.transforms()["turn-utm"]
    o, d = origins @ matrix[:3, :3].T + matrix[:3, 3], directions @ matrix[:3, :3].T
    if offset in {"0", "5e5"}:  # farther out, moving the origin in float64 may carry it out of the mesh
        assert int((~moved.cast(o, d).hit).sum()) == 0


@pytest.mark.parametrize("name", ["tetrahedron", "torus", "icosphere", "fan-100"])
def test_crossings_of_a_closed_mesh_are_odd_from_inside(name):
    vertices, faces, inside = MESHES[name]
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(2000, 3))
    origins = np.tile(inside, (2000, 1)).astype(float)
    roots = ls.TriangleMesh(vertices, faces).roots(origins, directions)
    np.testing.assert_array_equal((roots > 0).sum(axis=1) % 2, 1)
    np.testing.assert_array_equal((roots < 0).sum(axis=1) % 2, 1)
    if name == "torus":
        assert (roots > 0).sum(axis=1).max() >= 3


@pytest.mark.parametrize("valence", [3, 4, 5, 8, 20, 63, 64, 65, 100])
@pytest.mark.parametrize("offset", ["0", "5e6"])
def test_apex_of_a_fan_is_hit_once(valence, offset):
    vertices, faces = cases.fan(valence)
    vertices = vertices + cases.OFFSETS[offset]
    apex = vertices[valence]
    rng = np.random.default_rng(valence)
    directions = rng.normal(size=(60, 3)) * 2.0 ** rng.integers(-30, 30, (60, 1))
    origins = apex - directions * 2.0 ** rng.integers(-3, 3, (60, 1))
    exact = (apex - origins) / directions  # keep the rays that pass through the apex exactly
    exact = (exact == exact[:, :1]).all(axis=1) & (apex - exact[:, :1] * directions == origins).all(axis=1)
    check(vertices, faces, origins, directions)
    if offset == "0":
        assert exact.sum() >= 10


def test_tie_of_coplanar_triangles_goes_to_the_lowest_index():
    vertices = [(0, 0, 0), (4, 0, 0), (0, 4, 0), (4, 4, 0), (2, -1, 1), (2, 5, -1)]
    faces = np.array([(3, 1, 2), (0, 1, 2), (0, 1, 3), (0, 3, 2), (0, 1, 2)])
    half = np.arange(-1, 10) / 2
    origins = np.array([(x, y, 3.0) for x in half for y in half])
    directions = np.tile((0.0, 0.0, -2.0), (len(origins), 1))
    hits = check(vertices, faces, origins, directions)
    assert set(hits.primitive_id[hits.hit].tolist()) == {0, 1}
    shuffled = np.random.default_rng(3).permutation(len(faces))
    check(vertices, faces[shuffled], origins, directions)


def test_no_area_no_hit_but_counted():
    vertices = [(0, 0, 0), (1, 1, 1), (3, 3, 3), (0, 0, 5), (0.1, 0.1, 0.1), (0.3, 0.3, 0.3), (0.7, 0.7, 0.7)]
    # a point, a segment, three points on a line exactly, and three that float64 products may not see on a line
    faces = [(0, 0, 0), (0, 3, 0), (0, 1, 2), (4, 5, 6)]
    mesh = ls.TriangleMesh(vertices, faces)
    assert mesh.degenerate_count == 4
    rng = np.random.default_rng(4)
    targets = np.array(vertices)[rng.integers(0, 7, 200)]
    origins = rng.normal(size=(200, 3))
    assert not mesh.cast(origins, targets - origins).hit.any()
    assert np.isnan(mesh.roots(origins, targets - origins)).all()
    # a sliver of one ulp has an area
    sliver = ls.TriangleMesh([(0, 0, 0), (1, 1, 1), (3, 3, math.nextafter(3, 4))], [(0, 1, 2)])
    assert sliver.degenerate_count == 0


QUARTER = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])  # z to x, x to y, y to z
SHIFT = np.array([[1, 0, 0, 0.1], [0, 1, 0, 5e5], [0, 0, 1, 0.3], [0, 0, 0, 1.0]])


def check_alone(spec, o, d):
    """Assert that the exact oracle and casts of one ray agree with a cast; return the verdict and the hits."""
    mesh = spec.build()
    hits = mesh.cast(o, d)
    verdict = judge_cast(spec, o, d, hits.t, primitives=hits.primitive_id)
    assert verdict.wrong == 0, verdict.first
    alone = np.concatenate([mesh.cast(o[i : i + 1], d[i : i + 1]).t for i in range(len(o))])
    np.testing.assert_array_equal(alone, hits.t)
    return verdict, hits


@pytest.mark.parametrize("matrix", [np.eye(4), QUARTER, SHIFT], ids=["as-given", "turned", "shifted"])
def test_rays_in_the_planes_of_a_mesh_meet_what_stands_on_them(matrix, instruction_sets, monkeypatch):
    # 12 × 12 squares and their walls fill several levels of a hierarchy, most of whose boxes are flat
    vertices, faces = cases.terraces(12)
    rng = np.random.default_rng(13)
    origins = np.column_stack([rng.integers(-2, 28, (300, 2)) / 2, rng.integers(0, 3, 300)])
    ways = rng.normal(size=(300, 2)) * rng.integers(0, 2, (300, 2))
    directions = np.column_stack([ways, np.zeros(300)])[(ways != 0).any(axis=1)]
    origins = origins[: len(directions)]
    spec = cases.Spec("TriangleMesh", (vertices, faces), None if (matrix == np.eye(4)).all() else matrix)
    o, d = origins @ matrix[:3, :3].T + matrix[:3, 3], directions @ matrix[:3, :3].T
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        _, hits = check_alone(spec, o, d)
        assert 60 <= hits.hit.sum() <= 240, "rays that hit walls, and rays that miss"


def test_rays_in_the_planes_of_a_moving_mesh():
    # the motion is exact: along the plane by whole numbers
    vertices, faces = cases.terraces(12)
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(2.0, -1.0, 0.0))
    moving, still = ls.Scene(), ls.Scene()
    moving.add(ls.TriangleMesh(vertices, faces), motion=drive)
    still.add(ls.TriangleMesh(vertices, faces))
    rng = np.random.default_rng(14)
    origins = np.column_stack([rng.integers(-2, 28, (200, 2)) / 2, rng.integers(0, 3, 200)])
    directions = np.column_stack([rng.integers(1, 4, 200), rng.integers(-2, 3, 200), np.zeros(200)]).astype(float)
    times = rng.integers(0, 4, 200).astype(float)
    there = origins + times[:, None] * (2.0, -1.0, 0.0)
    found = moving.cast(there, directions, time=times)
    np.testing.assert_array_equal(found.t, still.cast(origins, directions).t)
    assert 40 <= np.isfinite(found.t).sum() <= 190


TILT = np.array([[1, 0, 0], [0, math.sqrt(0.75), -0.5], [0, 0.5, math.sqrt(0.75)]])  # by 30°, rounded
SLOPE = np.array([[1, 0, 0], [0, 0.75, -1], [0, 1, 0.75]])  # exact for the whole numbers of terraces


def affine(linear, offset):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, offset
    return matrix


PLACED = {
    "as-given": np.eye(4),
    "tilted": affine(TILT, (0, 0, 0)),
    "tilted-and-far": affine(TILT @ cases.rotations(1, 3)[0], (0.1, 5e5, 0.3)),
    "stretched": affine(np.diag((3.0, 0.1, 1.7)) @ TILT, (0.5, 0.0, -0.25)),
    "on-an-exact-slope": affine(SLOPE, (0, 0, 0)),
}


def grazing(n, count, rng):
    """Return rays in the planes of terraces, and next to them: too low, or at too small an angle, for float32."""
    heights = rng.integers(0, 3, count) + rng.choice([0.0, 1e-17, -1e-13, 2.0**-40, 1e-300, -1e-200], count)
    origins = np.column_stack([rng.integers(-2, 2 * n + 4, (count, 2)) / 2, heights])
    slopes = rng.choice([0.0, 0.0, 1e-17, -1e-16, 2.0**-41, -1e-13], count)
    ways = np.column_stack([rng.normal(size=(count, 2)) * rng.integers(0, 2, (count, 2)), slopes])
    some = (ways[:, :2] != 0).any(axis=1)
    back = rng.choice([0.0, 0.0, 0.0, 1e5], (count, 1))  # from far away
    return (origins - back * ways)[some], ways[some]


@pytest.mark.parametrize("place", PLACED)
def test_rays_that_graze_the_planes_of_a_mesh(place, instruction_sets, monkeypatch):
    # some leave the plane, some cross it once, far away or on the mesh, and some run in it
    matrix, (vertices, faces) = PLACED[place], cases.terraces(12)
    origins, directions = grazing(12, 400, np.random.default_rng(15))
    spec = cases.Spec("TriangleMesh", (vertices, faces), None if place == "as-given" else matrix)
    o, d = origins @ matrix[:3, :3].T + matrix[:3, 3], directions @ matrix[:3, :3].T
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        verdict, hits = check_alone(spec, o, d)
        assert verdict.rounded == verdict.values, "not the exact value correctly rounded"
        assert 100 < hits.hit.sum() < 250


@pytest.mark.parametrize("place", PLACED)
def test_rays_that_graze_the_planes_of_a_moving_mesh(place, instruction_sets, monkeypatch):
    # `cast_all` takes each ray by itself through boxes alone
    vertices, faces = cases.terraces(12)
    matrix, rng = PLACED[place], np.random.default_rng(16)
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(2.0, -1.0, 0.0), angular=(0.3, 0.2, -0.1))
    scene = ls.Scene()
    scene.add(ls.TriangleMesh(vertices, faces), transform=matrix, motion=drive)
    origins, directions = grazing(12, 600, rng)
    times = rng.choice([0.0, 0.7, 1.5], len(origins))
    poses = drive.at(times).as_matrix() @ matrix
    o = np.einsum("nij,nj->ni", poses[:, :3, :3], origins) + poses[:, :3, 3]
    d = np.einsum("nij,nj->ni", poses[:, :3, :3], directions)
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        first, every = scene.cast(o, d, time=times), scene.cast_all(o, d, time=times, most=1)
        np.testing.assert_array_equal(first.t, every.t[:, 0])
        np.testing.assert_array_equal(first.primitive_id, every.primitive_id[:, 0])
        assert 100 < first.hit.sum() < 400


def test_faces_that_gain_an_area_are_found():
    # without an area a face is in no hierarchy; a new shape of the mesh must have it
    flat = ls.TriangleMesh([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0)], [(0, 1, 2), (0, 1, 3)])
    assert flat.degenerate_count == 1
    ray = np.array([(1.0, 0.25, 1.0)]), np.array([(0.0, 0.0, -1.0)])
    assert not flat.cast(*ray).hit.any()
    shaped = flat.deformed([(0, 0, 0), (1, 1, 0), (2, 0, 0), (0, 1, 0)])
    assert shaped.cast(*ray).primitive_id.tolist() == [0]
    assert shaped.deformed(flat.vertices).degenerate_count == 1


@pytest.mark.parametrize("size", [1e307, 1.7e308])
def test_coordinates_near_the_largest_float(size, instruction_sets, monkeypatch):
    # already the sum of two of them may be infinite
    rng = np.random.default_rng(10)
    vertices = size * rng.uniform(-1, 1, (30, 3))
    faces = rng.integers(0, 30, (40, 3))
    a, b = vertices[faces[:, 0]], vertices[faces[:, 1]]
    targets = np.concatenate([vertices, a / 2 + b / 2, size * rng.uniform(-1, 1, (50, 3))])
    origins = np.concatenate([rng.normal(size=(60, 3)), size * rng.uniform(-0.05, 0.05, (60, 3))])
    directions = (targets / 2 - origins / 2) * rng.choice([1.0, 1e-200, 2.0**-1000, 1e-307], (120, 1))
    hits = check(vertices, faces, origins, directions)
    assert hits.hit.sum() > 60
    assert hits.t.max(where=hits.hit, initial=0.0) > 1e306
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        again = ls.TriangleMesh(vertices, faces).cast(origins, directions)
        for name in ("t", "primitive_id", "normal"):
            np.testing.assert_array_equal(getattr(again, name), getattr(hits, name))


@pytest.mark.parametrize("place", [0.0, 0.1, 5e6, 1e307])
def test_one_point_over_and_over(place, instruction_sets, monkeypatch):
    mesh = ls.TriangleMesh(np.full((30, 3), place), np.random.default_rng(11).integers(0, 30, (20, 3)))
    assert mesh.degenerate_count == 20
    scene = ls.Scene()
    scene.add(mesh)
    scene.add(ls.Plane.from_point((place, place, place), (1.0, 2.0, 3.0)))
    origins = place + max(place, 1.0) * np.random.default_rng(12).uniform(0.5, 1.0, (50, 3))
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        assert not mesh.cast(origins, place - origins).hit.any()
        assert np.isnan(mesh.roots(origins, place - origins)).all()
        assert set(scene.cast(origins, place - origins).object_id.tolist()) == {1}


def test_t_junction_that_is_exact_does_not_leak():
    # the vertex (1/2, 1/2) lies exactly on the long edge of the other triangle
    vertices = [(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0), (0.5, 0.5, 0)]
    faces = [(0, 2, 1), (0, 4, 3), (4, 1, 3)]
    rng = np.random.default_rng(5)
    s = np.concatenate([[0.5], rng.integers(1, 1024, 200) / 1024])
    origins = np.stack([s, s, np.ones_like(s)], axis=1)
    assert check(vertices, faces, origins, np.tile((0.0, 0.0, -1.0), (len(s), 1))).hit.all()


def test_t_junction_that_is_rounded_leaks_as_documented():
    # 0.1·(1, 3) is rounded off the edge from (0, 0) to (1, 3): between it and the vertex there is a gap
    vertices = np.array([(0, 0, 0), (1, 3, 0), (2, 0, 0), (-1, 3, 0), (0.1, 0.3, 0), (0.7, 2.1, 0)])
    faces = [(0, 2, 1), (0, 4, 3), (4, 5, 3), (5, 1, 3)]
    rng = np.random.default_rng(6)
    y = rng.uniform(0, 3, 1000)
    x = y / 3
    around = np.concatenate([x, np.nextafter(x, 9), np.nextafter(x, -9)])
    origins = np.stack([around, np.tile(y, 3), np.ones_like(around)], axis=1)
    hits = check(vertices, faces, origins, np.tile((0.0, 0.0, -1.0), (len(around), 1)))
    leaks = int((~hits.hit).sum())
    assert 0 < leaks < 250
    assert "T-junction" in ls.TriangleMesh.__doc__


def test_hierarchy_is_brute_force():
    rng = np.random.default_rng(7)
    for offset in (0.0, 5e6):
        centers = rng.uniform(-10, 10, (3000, 1, 3))
        corners = centers + rng.normal(size=(3000, 3, 3)) * rng.choice(
            [1e-3, 0.3, 5], (3000, 1, 1), p=(0.3, 0.65, 0.05)
        )
        vertices, faces = corners.reshape(-1, 3) + offset, np.arange(9000).reshape(-1, 3)
        origins = rng.uniform(-12, 12, (120, 3)) + offset
        directions = np.where(
            rng.random((120, 1)) < 0.7, vertices[rng.integers(0, 9000, 120)] - origins, rng.normal(size=(120, 3))
        )
        directions[:25] = np.eye(3)[rng.integers(0, 3, 25)] * rng.choice([-1, 1], (25, 1))
        hits = check(vertices, faces, origins, directions)
        assert hits.hit.sum() > 70


@pytest.mark.parametrize("offset", ["0", "5e6", "1e9"])
def test_heightfield(offset):
    rng = np.random.default_rng(8)
    z = np.cumsum(rng.normal(size=(40, 50)), axis=0) * 0.2
    shift = cases.OFFSETS[offset]
    mesh = ls.TriangleMesh.from_heightfield(z, (0.5, 0.25), (shift, -shift))
    assert (len(mesh), mesh.degenerate_count) == (2 * 39 * 49, 0)
    grid = mesh.vertices.reshape(40, 50, 3)
    np.testing.assert_array_equal(grid[..., 2], z)
    np.testing.assert_array_equal(grid[..., 0], np.broadcast_to(shift + 0.5 * np.arange(50), (40, 50)))
    np.testing.assert_array_equal(grid[..., 1], np.broadcast_to(-shift + 0.25 * np.arange(40)[:, None], (40, 50)))
    # straight down through every vertex, and slanted ones
    down = mesh.vertices + np.array((0, 0, 50.0))
    hits = mesh.cast(down, np.tile((0.0, 0.0, -1.0), (len(down), 1)))
    assert hits.hit.all()
    np.testing.assert_array_equal(
        hits.t,
        np.array([float(oracle.Fraction(a) - oracle.Fraction(b)) for a, b in zip(down[:, 2], z.ravel(), strict=True)]),
    )
    assert (hits.normal[:, 2] > 0).all()
    pick = rng.integers(0, len(down), 120)
    origins = down[pick] + rng.normal(size=(120, 3)) * (3, 3, 0)
    check(mesh.vertices, mesh.faces, origins, mesh.vertices[rng.permutation(len(down))[:120]] - origins)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7])
def test_heightfield_with_holes(share):
    """Against the triangles of the same heights without holes, and rays through each of those."""
    rng = np.random.default_rng(11)
    z = rng.normal(size=(25, 30))
    whole = ls.TriangleMesh.from_heightfield(z, (0.5, 0.25), (3, -4))
    there = rng.random(z.shape) >= share
    mesh = ls.TriangleMesh.from_heightfield(np.where(there, z, np.nan), (0.5, 0.25), (3, -4))
    assert mesh.grid == whole.grid == (25, 30)
    np.testing.assert_array_equal(mesh.vertices, whole.vertices[there.ravel()])
    kept = there.ravel()[whole.faces].all(axis=1)
    assert 0 < kept.sum() < len(whole)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], whole.vertices[whole.faces[kept]])
    down = whole.vertices[whole.faces].mean(axis=1) + np.array((0, 0, 50))
    hits = mesh.cast(down, np.tile((0.0, 0.0, -1.0), (len(down), 1)))
    np.testing.assert_array_equal(hits.hit, kept)
    np.testing.assert_array_equal(hits.primitive_id[kept], np.arange(kept.sum()))


def test_real_meshes():
    pyvista = pytest.importorskip("pyvista")
    from pyvista import examples

    rng = np.random.default_rng(9)
    for path in (examples.planefile, examples.antfile):
        mesh = ls.TriangleMesh.from_file(path)
        surface = pyvista.read(path)
        vertices = mesh.vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        origins = low + (high - low) * rng.uniform(-0.5, 1.5, (80, 3))
        directions = vertices[rng.integers(0, len(vertices), 80)] - origins
        hits = check(vertices, mesh.faces, origins, directions)
        assert hits.hit.sum() >= 70  # a vertex of the rim of an open mesh may be missed by an ulp
        assert len(mesh) == surface.n_cells


def soup():
    vertices, faces, _ = MESHES["torus"]
    return vertices.astype(np.float32).astype(float), faces


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "off", "glb"])
def test_from_file(tmp_path, suffix):
    import trimesh

    vertices, faces = soup()
    path = tmp_path / f"torus.{suffix}"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    mesh = ls.TriangleMesh.from_file(path)
    assert len(mesh) == len(faces)
    if suffix == "glb":  # y up
        vertices = vertices[:, [0, 2, 1]] * [1, -1, 1]
    # text formats round the numbers: the triangles are those of the file, in order
    np.testing.assert_allclose(mesh.vertices[mesh.faces], vertices[faces], atol=1e-6)


@pytest.mark.parametrize("tensor", [True, False])
def test_from_open3d(tensor):
    from lidarsim.viewers.open3d import import_open3d

    o3d = import_open3d()
    vertices, faces = soup()
    if tensor:
        given = o3d.t.geometry.TriangleMesh(vertices.astype(np.float32), faces.astype(np.int32))
    else:
        given = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces))
    mesh = ls.TriangleMesh.from_open3d(given)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)


def test_from_pyvista():
    pyvista = pytest.importorskip("pyvista")
    vertices, faces = soup()
    mesh = ls.TriangleMesh.from_pyvista(pyvista.PolyData.from_regular_faces(vertices, faces))
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)
    cube = ls.TriangleMesh.from_pyvista(pyvista.Cube())  # quadrilaterals
    assert len(cube) == 12
    solid = ls.TriangleMesh.from_pyvista(pyvista.ImageData(dimensions=(2, 2, 2)))  # a volume has a surface
    assert len(solid) == 12
    for box in (cube, solid):
        center = box.vertices.mean(axis=0)
        directions = np.random.default_rng(0).normal(size=(50, 3))
        assert box.cast(np.tile(center, (50, 1)), directions).hit.all()


def area(vertices, faces):
    return np.linalg.norm(np.cross(*np.diff(vertices[faces], axis=1).transpose(1, 0, 2)), axis=1).sum() / 2


def perimeter(vertices, faces):
    """Sum of the perimeters of all triangles."""
    return np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2).sum()


def volume(vertices, faces):
    a, b, c = (np.asarray(vertices, float)[faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def pyvista_meshes():
    import pyvista as pv

    ball = pv.Sphere()
    return {
        "cube": pv.Cube(),
        "cylinder": pv.Cylinder(),  # quadrilaterals and two caps of a hundred corners
        "cone": pv.Cone(),
        "arrow": pv.Arrow(),
        "capsule": pv.Capsule(),
        "dodecahedron": pv.Dodecahedron(),
        "clipped": ball.clip("z", value=0.1),
        "triangle and quadrilateral": pv.PolyData(
            np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1.0]]), faces=[3, 0, 1, 4, 4, 0, 1, 2, 3]
        ),
        "strips": ball.strip(),
        "strips and polygons": ball.strip() + pv.Cylinder(center=(3, 0, 0)),
        "with lines and points": pv.Cylinder() + pv.Line() + pv.PolyData(np.eye(3)),
        "cells": pv.Cylinder().cast_to_unstructured_grid(),
        "volume": pv.ImageData(dimensions=(3, 4, 5)),
        "curved grid": pv.StructuredGrid(*np.meshgrid(np.arange(3.0), np.arange(4.0), [0.0, 2.0])),
    }


@pytest.mark.parametrize("name", pyvista_meshes())
def test_from_pyvista_of_any_faces(name, caplog):
    """The area and the enclosed volume are those of VTK's own triangles, which may divide polygons otherwise.

    The division of a plane polygon changes neither. VTK rounds coordinates to float32, which moves a corner by at most
    `off`, so that polygons are not quite plane. That changes the area of a triangle by at most half of its perimeter
    times `off`, and the volume by at most the area times `off`.
    """
    given = pyvista_meshes()[name]
    mesh = ls.TriangleMesh.from_pyvista(given)
    surface = given if hasattr(given, "strips") else given.extract_surface(algorithm=None)
    triangles = surface.triangulate()
    ours, theirs = (mesh.vertices, mesh.faces), (np.asarray(triangles.points, float), triangles.regular_faces)
    off = np.sqrt(3) * 2.0**-24 * np.abs(mesh.vertices).max()
    perimeters, areas = ([measure(*one) for one in (ours, theirs)] for measure in (perimeter, area))
    assert areas[0] == pytest.approx(areas[1], rel=0, abs=off * sum(perimeters) / 2)
    assert volume(*ours) == pytest.approx(volume(*theirs), rel=0, abs=off * sum(areas))
    left_out = ["mesh: 4 points and lines left out, which nothing hits"] if name == "with lines and points" else []
    assert [record.getMessage() for record in caplog.records] == left_out


def test_from_pyvista_of_a_concave_face():
    pyvista = pytest.importorskip("pyvista")
    angles = np.arange(10) * np.pi / 5
    radii = np.array([2.0, 0.7] * 5)
    star = np.stack([radii * np.cos(angles), radii * np.sin(angles), 0 * angles], axis=1)
    mesh = ls.TriangleMesh.from_pyvista(pyvista.PolyData(star, faces=[10, *range(10)]))
    above = np.stack([np.cos(angles), np.sin(angles), 1 + 0 * angles], axis=1)  # over the points, and over the notches
    assert mesh.cast(above, np.broadcast_to([0.0, 0.0, -1.0], above.shape)).hit.tolist() == [True, False] * 5


def test_from_pyvista_refuses_what_has_no_surface():
    pyvista = pytest.importorskip("pyvista")
    with pytest.raises(ValueError, match=r"^mesh: expected faces, got 3 points and lines alone$"):
        ls.TriangleMesh.from_pyvista(pyvista.PolyData(np.eye(3)))
    with pytest.raises(ValueError, match=r"^mesh: expected faces, got 1 points and lines alone$"):
        ls.TriangleMesh.from_pyvista(pyvista.Line())
    with pytest.raises(TypeError, match=r"^mesh: expected a pyvista\.DataSet, got dict$"):
        ls.TriangleMesh.from_pyvista({})


BAD_MESHES = [
    (([(0, 0, 0)], [(0, 0, 1)]), ValueError, "faces: expected indices from 0 to 0, got faces[0][2] = 1"),
    (([(0, 0, 0)], [(0, -1, 0)]), ValueError, "faces: expected indices from 0 to 0, got faces[0][1] = -1"),
    (([(0, 0, 0)], [(0.0, 0.0, 0.0)]), TypeError, "faces: expected integers of shape (m, 3), got dtype float64"),
    (([(0, 0, 0)], [(0, 0)]), ValueError, "faces: expected shape (m, 3), got (1, 2)"),
    (([(0, 0, 0)], [0, 0, 0]), ValueError, "faces: expected shape (m, 3), got (3,)"),
    (([(0, 0)], [(0, 0, 0)]), ValueError, "vertices: expected shape (n, 3), got (1, 2)"),
    (([(0, math.nan, 0)], [(0, 0, 0)]), ValueError, "vertices: expected finite numbers, got vertices[0][1] = nan"),
    (
        ([(0, 0, 0), (0, 0, math.inf)], [(0, 0, 0)]),
        ValueError,
        "vertices: expected finite numbers, got vertices[1][2] = inf",
    ),
    (([("a", "b", "c")], [(0, 0, 0)]), TypeError, "vertices: expected real numbers of shape (n, 3), got dtype <U1"),
]


@pytest.mark.parametrize(("arguments", "error", "message"), BAD_MESHES, ids=[message for _, _, message in BAD_MESHES])
def test_bad_meshes(arguments, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        ls.TriangleMesh(*arguments)


def test_empty_mesh_is_legal():
    mesh = ls.TriangleMesh(np.empty((0, 3)), np.empty((0, 3), dtype=int))
    assert not mesh.cast([[0, 0, 0]], [[1, 0, 0]]).hit.any()
    assert np.isnan(mesh.roots([[0, 0, 0]], [[1, 0, 0]])).all()


BAD_HEIGHTS = [
    (([[0.0, 1.0]], 1.0), "z: expected at least 2 rows and 2 columns, got shape (1, 2)"),
    (([0.0, 1.0], 1.0), "z: expected shape (rows, columns), got (2,)"),
    ((np.full((2, 2), np.nan), 1.0), "z: expected a triangle of heights, got NaN at a corner of each triangle"),
    (
        ([[np.nan, 1.0], [1.0, 1.0]], 1.0),
        "z: expected a triangle of heights, got NaN at a corner of each triangle",
    ),
    (([[1.0, 1.0], [1.0, -np.inf]], 1.0), "z: expected finite heights, or NaN for a hole, got z[1][1] = -inf"),
    ((np.zeros((2, 2)), (1.0, 0.0)), "spacing: expected numbers > 0, got spacing[1] = 0.0"),
    ((np.zeros((2, 2)), -1.0), "spacing: expected numbers > 0, got spacing[0] = -1.0"),
    ((np.zeros((2, 2)), 1.0, (0.0, 0.0, 0.0)), "origin: expected shape (2,), got (3,)"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_HEIGHTS, ids=[message for _, message in BAD_HEIGHTS])
def test_bad_heightfields(arguments, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.TriangleMesh.from_heightfield(*arguments)


def test_bad_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=f"^{re.escape(str(tmp_path / 'none.ply'))}: no such mesh file$"):
        ls.TriangleMesh.from_file(tmp_path / "none.ply")
    for name, content in (
        ("empty.ply", b""),
        ("noise.stl", b"\x00\x01\x02" * 50),
        ("text.obj", b"hello\n"),
        ("what.xyzzy", b""),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(ls.errors.FileFormatError, match=f"^{re.escape(str(path))}: cannot be read as a mesh: "):
            ls.TriangleMesh.from_file(path)


def test_degenerate_triangles_of_a_file_are_reported_once(tmp_path, caplog):
    path = tmp_path / "flat.off"
    path.write_text("OFF\n4 3 0\n0 0 0\n1 0 0\n0 1 0\n2 0 0\n3 0 1 2\n3 0 1 3\n3 0 0 1\n")
    mesh = ls.TriangleMesh.from_file(path)
    assert mesh.degenerate_count == 2
    assert [record.getMessage() for record in caplog.records] == [
        f"{path}: 2 of 3 triangles are degenerate; nothing hits them"
    ]
    mesh.cast([[0, 0, 1]], [[0, 0, -1]])
    assert len(caplog.records) == 1
