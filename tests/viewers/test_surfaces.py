"""Surfaces of a scene as triangles: on the shapes, as near as is stated, where the objects stand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import pyvista
from conformance.samples import SAMPLES, Move, Sample

import lidarsim as ls
from lidarsim.viewers._surfaces import surfaces

SHEAR = np.array([[1.5, 0.25, 0, 3], [0, -2, 0.5, 1], [0, 0, 0.75, -2], [0, 0, 0, 1]])  # which also reflects
BOX = 4.0 * np.array(list(np.ndindex(2, 2, 2))) - 2.0
ROUNDED = 64 * 2.0**-50
"""A few roundings of coordinates below 16."""

every_sample = pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.name)


def corners(block: pyvista.PolyData) -> np.ndarray:
    """Corners of each triangle, shape (n, 3, 3)."""
    found: np.ndarray = np.asarray(block.points)[block.regular_faces]
    return found


def distances(sample: Sample, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Of points near the surface of a sample, no more than their distances from it."""
    numbers = [np.asarray(number, float) for number in sample.arguments(Move())]
    if sample.shape in {"Sphere", "Spheres"}:
        return np.abs(np.linalg.norm(points[:, None] - numbers[0], axis=2) - numbers[1]).min(axis=1)
    if sample.shape == "Ellipsoid":
        center, radii, rotation = numbers
        away = np.linalg.norm((points - center) @ rotation / radii, axis=1)
        return np.abs(1 - 1 / away) * np.linalg.norm(points - center, axis=1)  # along the line through the centre
    if sample.shape == "Cylinder":
        start, end, radius = numbers[:3]
        length = np.linalg.norm(end - start)
        along = (points - start) @ (end - start) / length
        side = np.abs(np.linalg.norm(np.cross(points - start, end - start), axis=1) / length - radius)
        assert ((along > -ROUNDED) & (along < length + ROUNDED)).all()
        return side if len(numbers) == 4 else np.minimum(side, np.minimum(np.abs(along), np.abs(along - length)))
    if sample.shape == "Capsule":
        start, end, radius = numbers
        along = np.clip((points - start) @ (end - start) / np.square(end - start).sum(), 0.0, 1.0)
        return np.abs(np.linalg.norm(points - start - along[:, None] * (end - start), axis=1) - radius)
    if sample.shape in {"Disk", "Disks"}:
        centers, across, radii = np.atleast_2d(numbers[0]), np.atleast_2d(numbers[1]), numbers[2]
        off = np.abs(np.einsum("nij,ij->ni", points[:, None] - centers, across))
        rim = np.abs(np.linalg.norm(points[:, None] - centers, axis=2) - radii)
        assert (off.min(axis=1) < ROUNDED).all()
        return np.where(off < ROUNDED, rim, np.inf).min(axis=1)  # of points of the chords of the rim
    return np.nanmin(np.abs(sample.build().roots(points, normals)), axis=1)


@every_sample
@pytest.mark.parametrize("transform", [None, SHEAR], ids=["as it is", "sheared and reflected"])
@pytest.mark.parametrize("chord_error", [0.1, 0.01, 0.001])
def test_triangles_keep_within_the_chord_error(sample: Sample, transform: Any, chord_error: float) -> None:
    rng = np.random.default_rng(0)
    scene = ls.Scene()
    scene.add(sample.build(), transform=transform)
    matrix = np.eye(4) if transform is None else transform
    inverse = np.linalg.inv(matrix)
    triangles = corners(scene.to_pyvista(chord_error=chord_error)[0])
    assert len(triangles) < 3e4 * (26 if sample.shape in {"Spheres", "Disks"} else 1)
    exact = len(triangles) == len(corners(scene.to_pyvista(chord_error=chord_error / 4)[0]))  # no finer ones are needed
    triangles = triangles @ inverse[:3, :3].T + inverse[:3, 3]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(triangles), 300, p=areas / areas.sum())
    weights = np.concatenate([np.full((1, 3), 1 / 3), rng.dirichlet((1, 1, 1), 10)])
    if sample.shape == "Disk":  # flat, so that only its rim is off: a chord is across from the centre
        at_center = np.abs(triangles[0] - np.array(sample.arguments(Move())[0])).sum(axis=1).argmin()
        weights[:, at_center] = 0.0
        weights /= weights.sum(axis=1, keepdims=True)
    if sample.shape == "Disks":  # likewise: a chord is across from the first vertex, which a reflection puts last
        weights[:, 0 if np.linalg.det(matrix[:3, :3]) > 0 else 2] = 0.0
        weights /= weights.sum(axis=1, keepdims=True)
    points = (weights @ triangles[chosen]).reshape(-1, 3)
    found = distances(sample, points, np.repeat(normals[chosen] / areas[chosen, None], len(weights), axis=0))
    # The transform makes a distance at most its norm times longer.
    assert found.max() * np.linalg.norm(matrix[:3, :3], ord=2) <= (0.0 if exact else chord_error) + ROUNDED
    assert exact or found.max() > 0.01 * chord_error  # not far finer than it was asked for


@every_sample
@pytest.mark.parametrize("transform", [None, SHEAR], ids=["as it is", "sheared and reflected"])
def test_triangles_face_outward_as_the_shape_does(sample: Sample, transform: Any) -> None:
    scene = ls.Scene()
    scene.add(sample.build(), transform=transform)
    triangles = corners(scene.to_pyvista()[0])
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1, keepdims=True)
    # Where a corner of the box lies in a plane, its outline has one twice: an edge below 64 times a rounded one.
    large = areas[:, 0] > 64 * ROUNDED
    centres, normals = triangles.mean(axis=1)[large], normals[large] / areas[large]
    start = centres + normals
    hits = scene.cast(start, centres - start)
    assert hits.hit.mean() > 0.9  # a bent mesh may hide one
    # The chord error is a 200th of a radius below 2, lengthened by the transform to less than three times that.
    near = hits.hit & (np.abs(hits.t - 1) < 0.03)
    assert near.mean() > (0.4 if sample.shape in {"Spheres", "Disks"} else 0.7)  # many hide parts of each other
    assert (np.einsum("ij,ij->i", hits.normal, normals)[near] > 0).all()


@every_sample
def test_closed_shapes_stay_closed(sample: Sample) -> None:
    if sample.inside is None:
        pytest.skip("the shape has no inside")
    vertices, faces = sample.build()._tessellate(0.05, BOX)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses == 2).all()
    directions = np.random.default_rng(1).normal(size=(500, 3))
    hits = ls.TriangleMesh(vertices, faces).cast(np.broadcast_to(sample.inside, (500, 3)), directions)
    assert hits.hit.all()


def test_a_smaller_error_takes_more_triangles_and_none_is_wasted() -> None:
    sphere = ls.Sphere((0, 0, 0), 2.0)
    counts = {error: len(sphere._tessellate(error, BOX)[1]) for error in (None, 0.1, 0.01, 0.001)}
    assert counts[None] == counts[0.01]  # a 200th of the radius
    assert counts[0.1] < counts[0.01] < counts[0.001] < 20 * counts[0.01]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"chord_error": 0.0}, "chord_error: expected a finite number > 0, got 0.0"),
        (
            {"chord_error": 1e-9},
            "chord_error: expected at least 1.2e-06 of the radius of each object, got 5e-10 of one",
        ),
        ({"bounds": [1, 2, 3]}, "bounds: expected shape (2, 3), got (3,)"),
    ],
)
def test_bad_arguments(options: Any, message: str) -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 1.0))
    for convert in (scene.to_pyvista, scene.to_open3d):
        with pytest.raises(ValueError) as caught:  # noqa: PT011
            convert(**options)
        assert str(caught.value) == message


def test_planes_end_a_tenth_beyond_what_is_seen() -> None:
    scene = ls.Scene()
    scene.add(ls.Box((10, 20, 4), (0, 0, 2)), name="house")
    scene.add(ls.Plane((0, 0, 1), 0.0), name="ground")
    scene.add(ls.Plane((1, 0, 0), 50.0), name="far wall")
    ground, wall = (np.asarray(scene.to_pyvista()[i].points) for i in (1, 2))
    rounded = 8 * 2.0**-47  # numbers below 128, a few times
    assert np.abs(ground).max(axis=0) == pytest.approx([5.5, 11, 0], rel=0, abs=rounded)
    assert np.ptp(wall, axis=0) == pytest.approx([0, 22, 4.4], rel=0, abs=rounded)
    assert wall[:, 0] == pytest.approx(50, rel=0, abs=rounded)
    wider = np.asarray(scene.to_pyvista(bounds=[(-100, -30, 0), (100, 30, 0)])[1].points)
    assert np.abs(wider).max(axis=0) == pytest.approx([110, 33, 0], rel=0, abs=rounded)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 2, 3), (-1, 0, 1)])
def test_a_plane_alone_is_seen_around_the_origin(normal: Any) -> None:
    scene = ls.Scene()
    scene.add(ls.Plane(normal, 5.0))
    points = np.asarray(scene.to_pyvista()[0].points)
    assert len(points) >= 3
    # Three coordinates below 32 and their products below 128, each rounded a few times.
    assert points @ normal == pytest.approx(np.full(len(points), 5.0), rel=0, abs=32 * 2.0**-47)
    assert 10 <= np.abs(points).max() < 30


def test_blocks_say_which_object_they_are_and_share_what_they_can() -> None:
    scene = ls.Scene()
    mesh = ls.TriangleMesh([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    for k in range(3):
        scene.add(mesh, name=f"car {k}", label=10 + k, transform=[[1, 0, 0, 5 * k], *np.eye(4)[1:]])
    scene.add(ls.TriangleMesh(np.empty((0, 3)), np.empty((0, 3), int)), name="nothing")
    blocks = scene.to_pyvista()
    assert blocks.keys() == ["car 0", "car 1", "car 2", "nothing"]
    assert blocks["nothing"].n_cells == 0
    for k in range(3):
        block = blocks[f"car {k}"]
        assert (block.cell_data["label"] == 10 + k).all()
        assert block.cell_data["label"].dtype == np.uint32
        assert (block.cell_data["object_id"] == k).all()
        assert list(block.field_data["name"]) == [f"car {k}"]
        assert block.GetPolys() is blocks["car 0"].GetPolys()
        np.testing.assert_array_equal(block.points, mesh.vertices + np.array([5 * k, 0, 0]))
    found = surfaces(scene)
    assert found[0].vertices is found[2].vertices
    shown = scene.to_open3d()
    assert [part["name"] for part in shown] == ["0 car 0", "1 car 1", "2 car 2"]
    for k, part in enumerate(shown):
        positions = part["geometry"].vertex.positions.numpy()
        np.testing.assert_array_equal(positions, mesh.vertices + np.array([5 * k, 0, 0]))
        np.testing.assert_array_equal(part["geometry"].triangle.indices.numpy(), mesh.faces)
        assert set(part["geometry"].triangle.label.numpy().ravel()) == {10 + k}


def test_a_scene_is_shown_as_it_was_before_or_after_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ls.Scene()
    ball = scene.add(ls.Sphere((0, 0, 0), 1.0))
    tessellate = ls.Sphere._tessellate

    def change(*of: Any) -> Any:
        if ball in scene:
            scene.remove(ball)
            scene.add(ls.Plane((0, 0, 1), 0.0))
        return tessellate(*of)

    monkeypatch.setattr(ls.Sphere, "_tessellate", change)
    assert [surface.object_id for surface in surfaces(scene)] == [ball]


def test_far_from_the_origin_no_digit_is_lost() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((5e6, 4e5, 0.1), 1.0))
    (block,) = scene.to_pyvista()
    assert block.points.dtype == np.float64
    # Coordinates of 5e6 are rounded by 2**-31 at most, in the vertex and in the difference.
    assert np.abs(np.linalg.norm(block.points - [5e6, 4e5, 0.1], axis=1) - 1).max() < 4 * 2.0**-31


def test_parts_are_the_faces_of_each_category() -> None:
    vertices, faces = ls.Sphere((1, 2, 3), 1.0)._tessellate(0.1, BOX)
    scene = ls.Scene()
    scene.add(ls.TriangleMesh(vertices, faces), label=np.arange(len(faces)) % 3, transform=SHEAR)
    (surface,) = surfaces(scene)
    whole = surface.points()[surface.faces]
    parts = dict(surface.parts(surface.item.label))
    assert list(parts) == [0, 1, 2]
    for label, part in parts.items():
        np.testing.assert_array_equal(part.points()[part.faces], whole[label::3])
        assert len(np.unique(part.faces)) == len(part.vertices)


def test_refined_triangles_are_low_and_cover_the_same() -> None:
    scene = ls.Scene()
    scene.add(ls.Box((4, 400, 8), (0, 0, 4)))
    (surface,) = surfaces(scene)
    fine = surface.refine(1.0)
    triangles = fine.points()[fine.faces]
    assert np.ptp(triangles[:, :, 2], axis=1).max() <= 1.0
    sides = triangles[:, 1:] - triangles[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
    assert area == pytest.approx(2 * (4 * 400 + 4 * 8 + 400 * 8), rel=1e-12)  # thousands of roundings
    flat = np.ptp(triangles[:, :, 2], axis=1) == 0
    assert flat.sum() == 4  # what lies level stays as it was
    assert len(surface.refine(1e-9).faces) < 1e6
