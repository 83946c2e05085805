"""Many spheres or disks in one object."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import lidarsim as ls

ISAS = ("scalar", "avx2", "avx512")
KINDS = (ls.Spheres, ls.Disks)
every_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)


def cloud(kind: type, n: int, seed: int = 0, shift: float = 0.0) -> tuple[Any, list[Any]]:
    """n random shapes that overlap, as one object and as objects of their own."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform(-4, 4, (n, 3)) + shift
    radii = rng.uniform(0.1, 0.6, n)
    normals = rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-3, 4, (n, 1))
    if kind is ls.Spheres:
        return ls.Spheres(centers, radii), [ls.Sphere(c, r) for c, r in zip(centers, radii, strict=True)]
    singles = [ls.Disk(c, m, r) for c, m, r in zip(centers, normals, radii, strict=True)]
    return ls.Disks(centers, normals, radii), singles


def rays(n: int, shift: float, far: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """Bundles from a few origins, and rays from anywhere."""
    rng = np.random.default_rng(9)
    origins = np.repeat(rng.normal(size=(n // 100, 3)) * far, 100, axis=0)
    origins[: n // 2] = rng.normal(size=(n // 2, 3)) * far
    return origins + shift, rng.uniform(-4, 4, (n, 3)) - origins


@every_kind
@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("shift", [0.0, 5e6])
def test_one_object_is_hit_as_many_are(
    kind: type, isa: str, shift: float, instruction_sets: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    if isa not in instruction_sets:
        pytest.skip(f"this machine has no {isa}")
    monkeypatch.setenv("LIDARSIM_ISA", isa)
    shapes, singles = cloud(kind, 300, shift=shift)
    turn = np.array([[0.6, -0.8, 0, 1], [0.8, 0.6, 0, 2], [0, 0, 1.5, 3], [0, 0, 0, 1]])
    for far, transform in ((6.0, None), (6.0, turn), (6e4, None), (6e4, turn)):
        one, many = ls.Scene(), ls.Scene()
        one.add(shapes, transform=transform)
        for single in singles:
            many.add(single, transform=transform)
        origins, directions = rays(4000, shift, far)
        if transform is not None:
            origins, directions = origins @ turn[:3, :3].T + turn[:3, 3], directions @ turn[:3, :3].T
        for t_min, t_max in ((0.0, np.inf), (0.9, 1.1)):
            got = one.cast(origins, directions, t_min=t_min, t_max=t_max)
            want = many.cast(origins, directions, t_min=t_min, t_max=t_max)
            assert want.hit.sum() > 500
            assert (~want.hit).sum() > 500
            np.testing.assert_array_equal(got.t, want.t)
            np.testing.assert_array_equal(np.where(got.hit, got.primitive_id, -1), want.object_id)
            np.testing.assert_allclose(got.normal, want.normal, rtol=0, atol=2.0**-50)


@every_kind
def test_equal_shapes_are_one_hit_of_the_first(kind: type) -> None:
    shapes, _ = cloud(kind, 50)
    rows = [np.tile(getattr(shapes, name), (3, 1) if name != "radii" else 3) for name in shapes.__match_args__]
    origins, directions = rays(2000, 0.0)
    once, thrice = shapes.cast(origins, directions), kind(*rows).cast(origins, directions)
    assert once.hit.sum() > 200
    for name in ("t", "primitive_id", "normal"):
        np.testing.assert_array_equal(getattr(once, name), getattr(thrice, name))
    np.testing.assert_array_equal(shapes.roots(origins, directions), kind(*rows).roots(origins, directions))


@every_kind
def test_attributes_are_the_arguments(kind: type) -> None:
    shapes, singles = cloud(kind, 100)
    assert len(shapes) == 100
    for name, single in (("centers", "center"), ("radii", "radius"), ("normals", "normal")):
        if name in shapes.__match_args__:
            values = getattr(shapes, name)
            np.testing.assert_array_equal(values, [getattr(shape, single) for shape in singles])
            assert not values.flags.writeable
    restored = type(shapes)._from_contents(shapes._contents())  # as unpickling does
    assert restored == shapes
    low, high = shapes.bounds
    np.testing.assert_array_equal(low, np.min([shape.bounds[0] for shape in singles], axis=0))
    np.testing.assert_array_equal(high, np.max([shape.bounds[1] for shape in singles], axis=0))
    assert kind.__name__ in repr(shapes)


@every_kind
def test_none_is_never_hit(kind: type) -> None:
    shapes = kind(*[np.empty((0, 3))] * (len(kind.__match_args__) - 1), 1.0)
    assert len(shapes) == 0
    assert np.isnan(shapes.bounds).all()
    assert not shapes.cast([(0, 0, 0)], [(1, 0, 0)]).hit.any()
    scene = ls.Scene()
    scene.add(shapes, transform=np.diag([2.0, 2, 2, 1]))
    assert not scene.cast([(0, 0, 0)], [(1, 0, 0)]).hit.any()


@every_kind
def test_memory_is_bounded_and_shared(kind: type) -> None:
    rng = np.random.default_rng(1)
    n = 20_000
    points = rng.uniform(-1, 1, (n, 3)) * (50, 50, 1)
    arguments = (points, 0.1) if kind is ls.Spheres else (points, rng.normal(size=(n, 3)), 0.1)
    shapes = kind(*arguments)
    assert shapes._native.bytes() <= (100 if kind is ls.Disks else 70) * n
    # A pickle of two instances holds the numbers once.
    scene = ls.Scene()
    scene.add(shapes)
    scene.add(shapes, transform=np.diag([2.0, 2, 2, 1]))
    numbers = 8 * n * (4 if kind is ls.Spheres else 7)
    assert len(pickle.dumps(scene)) < 1.2 * numbers


@every_kind
def test_labels_and_reflectivities_are_one_each(kind: type) -> None:
    shapes, _ = cloud(kind, 40)
    scene, reflectivity = ls.Scene(), np.linspace(0.1, 0.9, 40)
    labels = np.arange(40) % 7
    scene.add(shapes, label=labels, material=ls.Material(reflectivity=reflectivity, per="face"))
    lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-0.5, 0.5, 90), np.linspace(-0.5, 0.5, 90), rate=10.0))
    pose = np.eye(4)
    pose[0, 3] = -9.0
    seen = lidar.scan(scene, pose).point_cloud(frame="world")
    hits = scene.cast(np.broadcast_to(pose[:3, 3], seen.xyz.shape), seen.xyz - pose[:3, 3])
    assert len(seen) > 500
    np.testing.assert_array_equal(seen.label, labels[hits.primitive_id])
    # Intensity and incidence are float32.
    incidence = seen.incidence.astype(float)
    near = 2.0**-24 * (1.0 + np.tan(incidence.max()))
    np.testing.assert_allclose(seen.intensity, reflectivity[hits.primitive_id] * np.cos(incidence), rtol=near)
    with pytest.raises(ValueError, match="label: expected one integer, or 40, one per"):
        scene.add(shapes, label=[1, 2])
    with pytest.raises(ValueError, match="material: expected 40 reflectivities, one per"):
        scene.add(shapes, material=ls.Material(reflectivity=[0.5], per="face"))
    with pytest.raises(TypeError, match="material: expected a TriangleMesh for a reflectivity per vertex"):
        scene.add(shapes, material=ls.Material(reflectivity=[0.5], per="vertex"))


def test_overlapping_disks_of_one_plane_hit_the_lowest() -> None:
    """Disks of one plane, whose t tie: also where no axis is across the plane."""
    for normal in ((0.0, 0.0, 3.0), (1.0, 2.0, 2.0)):
        along = np.cross(normal, (1.0, 0.0, 0.0)) if normal[0] else np.array((0.0, 1.0, 0.0))
        centers = np.arange(30)[:, None] * along / 8
        disks = ls.Disks(centers, np.tile(normal, (30, 1)), 1.0)
        targets = centers + along / 16
        hits = disks.cast(targets + np.array(normal), np.tile(-np.array(normal), (30, 1)))
        np.testing.assert_array_equal(hits.t, 1.0)
        gap = np.linalg.norm(centers[None] - targets[:, None], axis=2)
        np.testing.assert_array_equal(hits.primitive_id, (gap <= 1.0).argmax(axis=1))


def test_many_disks_are_drawn_as_octagons() -> None:
    from lidarsim.viewers._surfaces import surfaces

    rng = np.random.default_rng(2)
    disks = ls.Disks(rng.normal(size=(1000, 3)), rng.normal(size=(1000, 3)), 0.25)
    scene = ls.Scene()
    scene.add(disks, label=np.arange(1000) % 5)
    (surface,) = surfaces(scene)
    corners = surface.points()[surface.faces].reshape(1000, -1, 3)
    assert corners.shape[1] == 3 * 6
    np.testing.assert_allclose(
        np.linalg.norm(corners - disks.centers[:, None], axis=2), 0.25, rtol=0, atol=8 * 4 * 2.0**-53
    )
    np.testing.assert_array_equal(surface.labels.reshape(1000, -1), np.tile(np.arange(1000)[:, None] % 5, (1, 6)))
    a, b, c = np.moveaxis(surface.points()[surface.faces], 1, 0)
    up = np.cross(b - a, c - a).reshape(1000, -1, 3)
    assert (np.einsum("ijk,ik->ij", up, disks.normals) > 0).all()
