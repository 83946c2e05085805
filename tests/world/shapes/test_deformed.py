"""Meshes that bend: casts at a refitted hierarchy are those at a mesh made anew from the same vertices, bit for bit."""

from __future__ import annotations

import pickle

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim.errors import ArgumentTypeError, ArgumentValueError

Floats = npt.NDArray[np.float64]
FIELDS = ("t", "object_id", "primitive_id", "normal")


@pytest.fixture(autouse=True, params=["scalar", "avx2", "avx512"])
def isa(request: pytest.FixtureRequest, instruction_sets: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run everything here on every instruction set."""
    if request.param not in instruction_sets:
        pytest.skip(f"this machine has no {request.param}")
    monkeypatch.setenv("LIDARSIM_ISA", request.param)


def sheet(rows: int) -> ls.TriangleMesh:
    y, x = np.mgrid[:rows, :rows]
    return ls.TriangleMesh.from_heightfield(np.sin(x / 3.0) * np.cos(y / 4.0), 1.0)


def rays(vertices: Floats, faces: npt.NDArray[np.uint32], rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Rays towards vertices, middles of edges and of triangles, as float64 has them, and some past the mesh."""
    corners = vertices[faces]
    targets = np.concatenate([corners[:, 0], (corners[:, 1] + corners[:, 2]) / 2, corners.mean(axis=1)])
    targets = targets[rng.choice(len(targets), min(len(targets), 250), replace=False)]
    size = np.ptp(vertices, axis=0).max() + 1.0
    origins = targets + rng.normal(size=targets.shape) * size * rng.choice([0.1, 1.0, 100.0], (len(targets), 1))
    return origins, np.where(rng.random((len(targets), 1)) < 0.9, targets - origins, rng.normal(size=targets.shape))


def assert_same(found: ls.TriangleMesh, vertices: Floats, *, seed: int, hit: bool = True) -> None:
    """Check that casts and roots of a deformed mesh are those of one made anew."""
    anew = ls.TriangleMesh(vertices, found.faces, transform=found.transform)
    np.testing.assert_array_equal(found.vertices, vertices)
    np.testing.assert_array_equal(found.bounds, anew.bounds)
    matrix = np.eye(4) if found.transform is None else found.transform
    origins, directions = rays(vertices, found.faces, np.random.default_rng(seed))
    origins, directions = origins @ matrix[:3, :3].T + matrix[:3, 3], directions @ matrix[:3, :3].T
    first, second = found.cast(origins, directions), anew.cast(origins, directions)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
    np.testing.assert_array_equal(found.roots(origins[:20], directions[:20]), anew.roots(origins[:20], directions[:20]))
    assert found.degenerate_count == anew.degenerate_count
    assert (second.hit.mean() > 0.5) == hit


def deformations(vertices: Floats, rng: np.random.Generator) -> dict[str, Floats]:
    """Small and large ones."""
    flat, folded = vertices.copy(), vertices.copy()
    flat[:, 2] = 0.25
    folded[:, 0] = np.abs(folded[:, 0] - folded[:, 0].mean())
    lattice = np.round(2.0 * vertices) / 2.0
    line = vertices * (1.0, 0.0, 0.0)
    return {
        "as it was": vertices,
        "bent": vertices + 0.3 * np.sin(vertices[:, [1, 2, 0]]),
        "flat": flat,
        "folded": folded,
        "turned": vertices[:, [2, 0, 1]],
        "scattered": rng.permutation(vertices),
        "far away": vertices + np.array([5e6, -3e5, 1e4]),
        "small": vertices * 1e-12,
        "large": vertices * 1e12,
        "inside out": -vertices,
        "on a lattice, some degenerate": lattice,
        "one stretched": np.where(np.arange(len(vertices))[:, None] == 7, 1e6, vertices),
        "all degenerate": line,
    }


@pytest.mark.parametrize("rows", [2, 5, 40])
def test_casts_are_those_of_a_mesh_made_anew(rows: int) -> None:
    mesh, rng = sheet(rows), np.random.default_rng(rows)
    for seed, (name, vertices) in enumerate(deformations(np.array(mesh.vertices), rng).items()):
        assert_same(mesh.deformed(vertices), vertices, seed=seed, hit=name != "all degenerate")


def test_triangles_that_were_degenerate_are_hit_once_they_are_not() -> None:
    mesh = sheet(30)
    gone = ls.TriangleMesh(mesh.vertices * (1.0, 0.0, 0.0), mesh.faces)
    assert gone.degenerate_count == len(gone)
    assert_same(gone.deformed(mesh.vertices), np.array(mesh.vertices), seed=1)


def test_a_chain_of_deformations_keeps_transform_and_origin() -> None:
    place = np.eye(4)
    place[:3] = [[0.5, 1, 0, 3], [0, -2, 0, 1], [0.25, 0, 1, 0]]
    rows = 20
    mesh = ls.TriangleMesh.from_heightfield(np.zeros((rows, rows)), 1.0, transform=place)
    rng, vertices = np.random.default_rng(3), np.array(mesh.vertices)
    for seed in range(4):
        vertices = vertices + rng.normal(scale=0.2, size=vertices.shape)
        mesh = mesh.deformed(vertices)
        assert mesh.grid == (rows, rows)
        np.testing.assert_array_equal(mesh.transform, place)
        assert_same(mesh, vertices, seed=seed)
    again = pickle.loads(pickle.dumps(mesh))  # noqa: S301 - own pickle
    assert again == mesh
    assert_same(again, vertices, seed=9)


def test_the_mesh_itself_stays_as_it_is() -> None:
    mesh = sheet(10)
    vertices, before = np.array(mesh.vertices), mesh.cast([[4.4, 4.2, 9.0]], [[0, 0, -1]]).t
    other = mesh.deformed(vertices + 1.0)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    assert mesh.cast([[4.4, 4.2, 9.0]], [[0, 0, -1]]).t == before != other.cast([[4.4, 4.2, 9.0]], [[0, 0, -1]]).t
    vertices += 7.0  # the caller's array is not kept
    assert other.cast([[5.4, 5.2, 10.0]], [[0, 0, -1]]).t == before


def test_a_scene_sees_the_shape_of_each_frame() -> None:
    mesh, scene = sheet(20), ls.Scene()
    flag = scene.add(mesh, transform=np.diag([1.0, -1.0, 1.0, 1.0]), label=np.arange(len(mesh)))
    ball = scene.add(ls.Sphere((5.0, -5.0, 9.0), 1.0))
    rng = np.random.default_rng(4)
    for shift in (0.0, 30.0, -30.0):
        vertices = np.array(mesh.vertices) + rng.normal(scale=0.1, size=mesh.vertices.shape) + np.array([shift, 0, 0])
        scene.update(flag, shape=mesh.deformed(vertices))
        anew = ls.Scene()
        anew.add(ls.TriangleMesh(vertices, mesh.faces), transform=scene[flag].transform)
        anew.add(scene[ball].shape)
        origins = rng.uniform((shift - 5, -25, 10), (shift + 25, 5, 20), (200, 3))
        directions = np.tile([0.0, 0.0, -1.0], (200, 1))
        found, right = scene.cast(origins, directions), anew.cast(origins, directions)
        assert (right.object_id == flag).any()
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(found, name), getattr(right, name))


def test_an_empty_mesh_has_nothing_to_bend() -> None:
    empty = ls.TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), int))
    made = empty.deformed(np.ones((3, 3)))
    assert len(made) == 0
    assert not made.cast([[0, 0, 0]], [[1, 1, 1]]).hit.any()


@pytest.mark.parametrize(
    ("vertices", "error", "message"),
    [
        (np.zeros((24, 3)), ArgumentValueError, r"vertices: expected shape \(25, 3\), got \(24, 3\)"),
        (np.zeros((25, 2)), ArgumentValueError, r"vertices: expected shape \(25, 3\), got \(25, 2\)"),
        (
            np.full((25, 3), np.nan),
            ArgumentValueError,
            r"vertices: expected finite numbers, got vertices\[0\]\[0\] = nan",
        ),
        ("bent", ArgumentTypeError, r"vertices: expected real numbers of shape \(25, 3\)"),
    ],
)
def test_wrong_vertices_are_refused(vertices: object, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        sheet(5).deformed(vertices)  # type: ignore[arg-type]
