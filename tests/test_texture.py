"""Reflectivity from textures, beside an oracle in rational numbers."""

from __future__ import annotations

import dataclasses
import itertools
import math
import pickle
import re
import sys
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim import materials

FLOAT32 = 2.0**-24
"""Largest relative error of a float32 that is rounded once."""

Floats = npt.NDArray[np.float64]
WRAPS = materials.WRAP
FAN = np.random.default_rng(3).uniform(-0.45, 0.45, (1300, 2))
"""y/x and z/x of the rays."""


# The oracle: exact up to the one rounding at its end


def wrap_index(wrap: str, i: int, count: int) -> int:
    """The texel at place i of the endless image, as the OpenGL specification has it."""
    if wrap == "repeat":
        return i % count
    if wrap == "clamp":
        return min(max(i, 0), count - 1)
    i %= 2 * count
    return i if i < count else 2 * count - 1 - i


def bilinear(texture: ls.Texture, u: Fraction, v: Fraction) -> Fraction:
    """The reflectivity at u, v: over the endless image, whose texels have their centres at half integers."""
    height, width = texture.values.shape
    x, y = u * width - Fraction(1, 2), v * height - Fraction(1, 2)
    total = Fraction(0)
    for i, j in itertools.product((0, 1), repeat=2):
        column, row = math.floor(x) + i, math.floor(y) + j
        weight = (1 - abs(x - column)) * (1 - abs(y - row))
        texel = texture.values[wrap_index(texture.wrap[1], row, height), wrap_index(texture.wrap[0], column, width)]
        total += weight * Fraction(float(texel))
    return total


def exact(values: npt.ArrayLike) -> list[Fraction]:
    return [Fraction(x) for x in np.asarray(values, np.float64).tolist()]


def cross(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def weights(triangle: list[list[Fraction]], direction: list[Fraction]) -> list[Fraction]:
    """Barycentric coordinates of the point where the ray from the origin meets the plane of a triangle.

    The volume of the ray and the edge that is opposite to a corner is proportional to the weight of the corner.
    """
    a, b, c = triangle
    volumes = [dot(direction, cross(*edge)) for edge in ((b, c), (c, a), (a, b))]
    return [volume / sum(volumes) for volume in volumes]


# Meshes


def hills(seed: int = 1) -> ls.TriangleMesh:
    """A rough wall at x = 10."""
    generator = np.random.default_rng(seed)
    y, z = np.meshgrid(np.linspace(-6, 6, 9), np.linspace(-6, 6, 8))
    vertices = np.column_stack([10 + generator.uniform(-0.5, 0.5, y.size), y.ravel(), z.ravel()])
    i = (np.arange(7)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([np.column_stack([i, i + 1, i + 10]), np.column_stack([i, i + 10, i + 9])])
    return ls.TriangleMesh(vertices, faces)


def square() -> ls.TriangleMesh:
    """A unit square at x = 10, of two triangles."""
    return ls.TriangleMesh([(10, 0, 0), (10, 1, 0), (10, 1, 1), (10, 0, 1)], [(0, 1, 2), (0, 2, 3)])


SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
"""u = y and v = z of its vertices."""


def towards(points: npt.ArrayLike) -> ls.Lidar:
    return ls.Lidar(ls.patterns.Table(np.asarray(points, dtype=float), rate=10.0))


def fan() -> ls.Lidar:
    return towards(np.column_stack([np.ones(len(FAN)), FAN]))


def reflectivities(scan: ls.Scan) -> Floats:
    """Reflectivities, to the digits that the float32 intensity and incidence have."""
    result: Floats = scan.intensity[:, 0] / np.cos(scan.incidence[:, 0].astype(float))
    return result


def image(shape: tuple[int, int] = (5, 7), seed: int = 2) -> npt.NDArray[np.float32]:
    return np.random.default_rng(seed).uniform(0.1, 2.0, shape).astype(np.float32)


def corners(mesh: ls.TriangleMesh, seed: int = 4) -> Floats:
    """Coordinates that jump from face to face and leave the image on all sides."""
    return np.random.default_rng(seed).uniform(-2.5, 3.5, (len(mesh), 3, 2))


def meet(mesh: ls.TriangleMesh, place: Floats, directions: Floats) -> tuple[ls.Hits, list[list[Fraction]]]:
    """What rays from the origin hit of a placed mesh, and the barycentric coordinates of the hits."""
    scene = ls.Scene()
    scene.add(mesh, transform=place)
    struck = scene.cast(np.zeros_like(directions), directions)
    assert struck.hit.all()
    linear = [exact(row) for row in place[:3, :3]]
    moved = [
        [dot(row, exact(p)) + shift for row, shift in zip(linear, exact(place[:3, 3]), strict=True)]
        for p in mesh.vertices
    ]
    triangles = mesh.faces[struck.primitive_id].tolist()
    shares = [weights([moved[k] for k in face], exact(d)) for face, d in zip(triangles, directions, strict=True)]
    assert min(map(min, shares)) >= 0
    return struck, shares


def test_textures_are_bilinear_at_the_barycentric_coordinates() -> None:
    mesh, lidar, hits = hills(), fan(), 0
    directions = lidar.pattern.pulses().directions
    place = np.array([[1.0, 0.25, 0, 0.5], [0, 1.5, 0.5, -0.25], [0, -0.5, 1.25, 0.125], [0, 0, 0, 1]])
    met = [meet(mesh, placed, directions) for placed in (np.eye(4), place)]
    by_vertex = np.random.default_rng(5).uniform(-2.5, 3.5, (len(mesh.vertices), 2))
    for n, wrap in enumerate(itertools.product(WRAPS, repeat=2)):
        texture = ls.Texture(image(), wrap=wrap)
        coordinates = by_vertex if n % 2 else corners(mesh)
        scene = ls.Scene()
        material = ls.Material(reflectivity=texture, texture_coordinates=coordinates)
        scene.add(mesh, material=material, transform=place if n % 3 else None)
        scan = lidar.scan(scene)
        struck, shares = met[bool(n % 3)]
        hits += len(struck)
        uv = [exact(row) for row in (by_vertex if n % 2 else coordinates.reshape(-1, 2))]
        expected = np.empty(len(struck))
        for i, (face, w) in enumerate(zip(struck.primitive_id.tolist(), shares, strict=True)):
            at = [uv[k] for k in mesh.faces[face].tolist()] if n % 2 else uv[3 * face : 3 * face + 3]
            expected[i] = bilinear(texture, dot(w, [p[0] for p in at]), dot(w, [p[1] for p in at]))
        assert np.ptp(expected) > 1.5
        # Intensities are float32: half an ulp of rounding. The float64 errors before it are far less than the other.
        expected *= np.abs((struck.normal * directions).sum(axis=1))
        assert (np.abs(scan.intensity[:, 0] - expected) <= np.spacing(expected.astype(np.float32))).all(), wrap
    assert hits >= 10_000


@pytest.mark.parametrize("wrap", WRAPS)
def test_coordinates_far_beyond_the_image_wrap_exactly(wrap: Any) -> None:
    """A corner coordinate that is the same for all corners is the coordinate of each hit, to the last bit."""
    texture = ls.Texture(image((3, 8)), wrap=wrap)
    numbers = [
        0.0,
        -0.0,
        0.125,
        0.7,
        1.0,
        1.3,
        -0.3,
        2.6,
        17.4375,
        -1e3,
        1e9 + 0.3,
        -1e15 - 0.375,
        2.0**52 + 1,
        2.0**53,
    ]
    numbers += [-1e17, 1e300, -1e300, 5e-324, -5e-324, -1e-20, sys.float_info.max, -sys.float_info.max]
    for u, v in itertools.product(numbers, (0.4, -1e16, 1e300)):
        scene = ls.Scene()
        scene.add(square(), material=ls.Material(reflectivity=texture, texture_coordinates=np.tile((u, v), (4, 1))))
        found = towards([(10, 0.3, 0.6), (10, 0.7, 0.2)]).scan(scene)
        expected = float(bilinear(texture, Fraction(u), Fraction(v))) * found.pulses.directions[:, 0]
        assert (np.abs(found.intensity[:, 0] - expected) <= np.spacing(expected.astype(np.float32))).all(), (u, v)


def test_texels_have_their_places_in_the_image() -> None:
    """Row 0 is the top, and v grows downwards, as in glTF."""
    values = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    scene = ls.Scene()
    scene.add(square(), material=ls.Material(reflectivity=ls.Texture(values), texture_coordinates=SQUARE))
    centres = [(10, (i + 0.5) / 2, (j + 0.5) / 3) for j in range(3) for i in range(2)]
    assert np.allclose(reflectivities(towards(centres).scan(scene)), np.ravel(values), rtol=2 * FLOAT32, atol=0)


@pytest.mark.parametrize("wrap", WRAPS)
def test_nearest_texels(wrap: Any) -> None:
    """Each place has the texel that it lies in, as OpenGL counts them: floor of the place in texels, then wrapped."""
    values = image((3, 8))
    texture = ls.Texture(values, wrap=wrap, interpolation="nearest")

    def texel(place: float, size: int) -> int:
        i = math.floor(place * size)
        if wrap == "clamp":
            return min(max(i, 0), size - 1)
        return i % size if wrap == "repeat" or i // size % 2 == 0 else size - 1 - i % size

    for u, v in np.random.default_rng(3).uniform(-2.5, 3.5, (60, 2)).tolist():
        scene = ls.Scene()
        scene.add(square(), material=ls.Material(reflectivity=texture, texture_coordinates=np.tile((u, v), (4, 1))))
        found = reflectivities(towards([(10, 0.3, 0.6), (10, 0.7, 0.2)]).scan(scene))
        assert np.allclose(found, values[texel(v, 3), texel(u, 8)], rtol=2 * FLOAT32, atol=0), (u, v)


@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 1)])
def test_tiny_images(shape: tuple[int, int], wrap: Any) -> None:
    mesh = hills()
    same, textured = ls.Scene(), ls.Scene()
    same.add(mesh, material=ls.Material(reflectivity=float(np.float32(0.3))))
    texture = ls.Texture(np.full(shape, 0.3), wrap=wrap)
    textured.add(mesh, material=ls.Material(reflectivity=texture, texture_coordinates=corners(mesh)))
    assert fan().scan(same).intensity.tobytes() == fan().scan(textured).intensity.tobytes()


@pytest.mark.parametrize("size", [1e-150, 1e-90, 1.0, 1e90, 1e150])
def test_the_size_of_a_triangle_does_not_matter(size: float) -> None:
    scene = ls.Scene()
    mesh = ls.TriangleMesh(size * square().vertices, square().faces)
    scene.add(mesh, material=ls.Material(reflectivity=ls.Texture([[0.2, 0.6]]), texture_coordinates=SQUARE))
    scan = towards([(10, 0.25, 0.4), (10, 0.5, 0.4), (10, 0.75, 0.4)]).scan(scene)
    assert np.allclose(reflectivities(scan), [0.2, 0.4, 0.6], rtol=2 * FLOAT32, atol=0)


def motion() -> ls.Trajectory:
    turn = math.radians(20)
    pose = np.eye(4)
    pose[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    pose[:3, 3] = 0.5, -0.25, 0.125
    return ls.Trajectory([0.0, 1.0], [np.eye(4), pose])


def test_textures_move_with_their_objects() -> None:
    mesh = hills()
    material = ls.Material(reflectivity=ls.Texture(image()), texture_coordinates=corners(mesh))
    moving, still = ls.Scene(), ls.Scene()
    moving.add(mesh, material=material, motion=motion())
    still.add(mesh, material=material, transform=motion().at(0.75).as_matrix())
    left, right = fan().scan(moving, time=0.75), fan().scan(still)
    assert (left.status == ls.Status.hit).sum() > 1000
    assert np.ptp(left.intensity[np.isfinite(left.intensity)]) > 1
    assert np.allclose(left.intensity, right.intensity, rtol=2 * FLOAT32, atol=0, equal_nan=True)


@pytest.mark.parametrize("measurement", [ls.Measurement(), ls.Measurement(beam=ls.Beam(0.02, rays=19))])
def test_instruction_sets_and_threads_change_nothing(
    instruction_sets: list[str], monkeypatch: pytest.MonkeyPatch, measurement: ls.Measurement
) -> None:
    mesh, scans = hills(), []
    for isa, threads in [*((isa, "1") for isa in instruction_sets), (instruction_sets[-1], "2")]:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        monkeypatch.setenv("LIDARSIM_THREADS", threads)
        scene = ls.Scene()
        texture = ls.Texture(image(), wrap=("mirror", "repeat"))
        scene.add(mesh, material=ls.Material(reflectivity=texture, texture_coordinates=corners(mesh)), motion=motion())
        pattern = ls.patterns.Grid(np.linspace(-0.4, 0.4, 70), np.linspace(-0.4, 0.4, 50), rate=10.0)
        scans.append(ls.Lidar(pattern, measurement=measurement).scan(scene).intensity)
    assert np.ptp(scans[0][np.isfinite(scans[0])]) > 0.5
    assert {scan.tobytes() for scan in scans} == {scans[0].tobytes()}


def road(sides: bool = False) -> tuple[ls.TriangleMesh, Floats]:
    """A road along x of 8 m, and its coordinates: u across it, from the left to the right, and v along it."""
    mesh = ls.TriangleMesh([(-40, 4, 0), (-40, -4, 0), (40, -4, 0), (40, 4, 0)], [(0, 1, 2), (0, 2, 3)])
    coordinates = np.array([(0.0, 10.0), (1.0, 10.0), (1.0, 0.0), (0.0, 0.0)])
    return mesh, coordinates[mesh.faces] if sides else coordinates


@pytest.mark.parametrize("sides", [False, True], ids=["by vertex", "by corner"])
def test_a_lidar_sees_the_markings_of_a_road(sides: bool) -> None:
    """A lane marking every 8 m, 3 m long and 0.2 m wide, in the middle, and a line 0.1 m wide on each side."""
    grey, white = 38, 250
    colors = np.full((80, 160, 3), grey, np.uint8)  # 0.1 m by 0.05 m
    colors[:30, 78:82] = colors[:, 4:6] = colors[:, 154:156] = white
    mesh, coordinates = road(sides)
    material = ls.Material.from_texture(colors, coordinates, wrap=("clamp", "repeat"))
    assert material.per == "texture"
    assert isinstance(material.reflectivity, ls.Texture)
    dark, bright = (float(materials.linear_light(np.array(x / 255.0))) for x in (grey, white))
    scene = ls.Scene()
    scene.add(mesh, material=material)
    pattern = ls.patterns.Spinning(np.radians(np.linspace(-25, -4, 64)), columns=2048)
    pose = np.eye(4)
    pose[2, 3] = 1.8
    scan = ls.Lidar(pattern).scan(scene, pose)
    cloud = scan.point_cloud(frame="world")
    x, y = cloud.xyz[:, 0], cloud.xyz[:, 1]
    found = cloud.intensity / np.cos(cloud.incidence.astype(float))
    # Intensity and incidence are float32, and the latter is at most 86 degrees from the normal.
    near = FLOAT32 * (1.0 + math.tan(math.radians(86)))
    # From the middle of a texel on, as the edge is linear over one.
    along = (40 - x) % 8
    lane = (np.abs(y) <= 0.075) & (along >= 0.05) & (along <= 2.95)
    lines = np.abs(np.abs(y) - 3.75) <= 0.025
    gap = (np.abs(y) <= 0.075) & (along >= 3.05) & (along <= 7.95)
    bare = (np.abs(y) >= 0.125) & (np.abs(y) <= 3.675)
    for where, expected, least in ((lane, bright, 100), (lines, bright, 100), (gap, dark, 100), (bare, dark, 10_000)):
        assert where.sum() > least
        assert np.allclose(found[where], expected, rtol=near, atol=0)
    between = ~(lane | lines | gap | bare)
    assert (found[between] >= dark * (1.0 - near)).all()
    assert (found[between] <= bright * (1.0 + near)).all()


def test_a_beam_averages_a_texture_over_its_footprint() -> None:
    """A ray meets the middle of a bright stripe; the footprint of a beam is six stripes wide."""
    scene = ls.Scene()
    stripes = ls.Texture(np.tile([[0.1, 0.9]], (1, 16)))
    scene.add(square(), material=ls.Material(reflectivity=stripes, texture_coordinates=SQUARE))
    ray = towards([(10, 17.5 / 32, 0.5)])
    beam = dataclasses.replace(ray, measurement=ls.Measurement(beam=ls.Beam(0.02, rays=91)))
    assert reflectivities(ray.scan(scene))[0] == pytest.approx(0.9, rel=2 * FLOAT32)
    assert reflectivities(beam.scan(scene))[0] == pytest.approx(0.5, abs=0.05)


# Objects


def test_a_texture_is_a_value() -> None:
    values = np.array([[0.25, 0.5, 1.0], [0.75, 0.0, 2.0]])
    texture = ls.Texture(values, wrap=["clamp", "mirror"])  # type: ignore[arg-type]
    values[0, 0] = 9.0
    assert texture.values.tolist() == [[0.25, 0.5, 1.0], [0.75, 0.0, 2.0]]
    assert (texture.values.dtype, texture.values.flags.writeable) == (np.float32, False)
    assert texture.wrap == ("clamp", "mirror")
    assert ls.Texture(values).wrap == ("repeat", "repeat")
    assert texture == ls.Texture(texture.values, wrap=texture.wrap) != ls.Texture(texture.values)
    assert texture != ls.Texture(values, wrap=texture.wrap)
    assert repr(texture) == "Texture(values=<2 × 3: 0 … 2>, wrap=('clamp', 'mirror'), interpolation='linear')"
    assert ls.Texture(np.asfortranarray(values)) == ls.Texture(values)


def test_a_textured_material_is_a_value() -> None:
    texture = ls.Texture([[0.5, 1.0]])
    material = ls.Material(reflectivity=texture, texture_coordinates=SQUARE, roughness=0.3)
    assert (material.per, material.roughness) == ("texture", 0.3)
    assert material.reflectivity is texture
    assert material.texture_coordinates is not None
    assert material.texture_coordinates.tolist() == SQUARE.tolist()
    assert not material.texture_coordinates.flags.writeable
    assert material == ls.Material(
        reflectivity=ls.Texture([[0.5, 1.0]]), per="texture", texture_coordinates=SQUARE, roughness=0.3
    )
    assert material != ls.Material(reflectivity=texture, texture_coordinates=SQUARE + 1, roughness=0.3)
    assert material != ls.Material(reflectivity=ls.Texture([[0.5, 2.0]]), texture_coordinates=SQUARE, roughness=0.3)
    assert material != ls.Material(reflectivity=0.5, roughness=0.3)
    assert ls.Material(reflectivity=[0.5, 1.0], per="face") != material
    assert ls.Material().texture_coordinates is None


def test_a_pickle_holds_a_texture_once() -> None:
    texture = ls.Texture(image((300, 400)))
    scene = ls.Scene()
    for i in range(5):
        material = ls.Material(reflectivity=texture, texture_coordinates=SQUARE + i)
        scene.add(square(), material=material)
        scene.add(square(), material=material)
    data = pickle.dumps(scene)
    assert len(data) < 1.1 * texture.values.nbytes
    other = pickle.loads(data)  # noqa: S301 - our own
    assert len({id(item.material.reflectivity) for item in other}) == 1
    assert [item.material for item in other] == [item.material for item in scene]
    lidar = towards([(10, 0.3, 0.6)])
    assert lidar.scan(other).intensity.tobytes() == lidar.scan(scene).intensity.tobytes()


def test_a_view_keeps_the_values_alive() -> None:
    values = ls.Texture(image((200, 300))).values
    coordinates = ls.Material(reflectivity=ls.Texture([[1.0]]), texture_coordinates=SQUARE).texture_coordinates
    [ls.Texture(np.zeros((200, 300))) for _ in range(10)]
    assert coordinates is not None
    assert values.tobytes() == image((200, 300)).tobytes()
    assert coordinates.tolist() == SQUARE.tolist()


def test_images_become_luminance() -> None:
    colors = np.random.default_rng(7).integers(0, 256, (6, 9, 4), np.uint8)
    by_integers = ls.Material.from_texture(colors, SQUARE)
    by_floats = ls.Material.from_texture(colors / 255.0, SQUARE)
    assert by_integers == by_floats
    assert isinstance(by_integers.reflectivity, ls.Texture)
    each = ls.Material.from_colors(colors.reshape(-1, 4), per="vertex")
    expected = np.asarray(each.reflectivity).astype(np.float32).reshape(6, 9)
    assert by_integers.reflectivity.values.tolist() == expected.tolist()


TEXTURE = ls.Texture([[0.5, 1.0]])


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: ls.Texture([0.5, 1.0]), ValueError, "values: expected shape (height, width), got (2,)"),
        (lambda: ls.Texture(0.5), ValueError, "values: expected shape (height, width), got ()"),
        (lambda: ls.Texture(np.zeros((0, 3))), ValueError, "values: expected at least one, got shape (0, 3)"),
        (lambda: ls.Texture([[]]), ValueError, "values: expected at least one, got shape (1, 0)"),
        (
            lambda: ls.Texture([[0.5], [-0.5]]),
            ValueError,
            "values: expected numbers from 0 to 3.4e+38, got values[1][0] = -0.5",
        ),
        (
            lambda: ls.Texture([[0.5, 1e39]]),
            ValueError,
            "values: expected numbers from 0 to 3.4e+38, got values[0][1] = 1e+39",
        ),
        (lambda: ls.Texture([[math.nan]]), ValueError, "values: expected finite numbers, got values[0][0] = nan"),
        (
            lambda: ls.Texture(np.zeros((2, 2), np.uint8)),
            TypeError,
            "values: expected reflectivities, got dtype uint8; Material.from_texture takes colours",
        ),
        (
            lambda: ls.Texture([["a"]]),
            TypeError,
            "values: expected real numbers of shape (height, width), got dtype <U1",
        ),
        (
            lambda: ls.Texture([[1.0]], wrap="tile"),  # type: ignore[arg-type]
            ValueError,
            "wrap: expected 'repeat', 'clamp' or 'mirror', got 'tile'",
        ),
        (
            lambda: ls.Texture([[1.0]], wrap=("clamp",)),  # type: ignore[arg-type]
            ValueError,
            "wrap: expected one for u and one for v, got ('clamp',)",
        ),
        (
            lambda: ls.Texture([[1.0]], wrap=("clamp", 3)),  # type: ignore[arg-type]
            ValueError,
            "wrap: expected 'repeat', 'clamp' or 'mirror', got 3",
        ),
        (
            lambda: ls.Material(reflectivity=TEXTURE),
            TypeError,
            "texture_coordinates: expected u, v of the vertices or corners for a Texture, got None",
        ),
        (
            lambda: ls.Material(reflectivity=TEXTURE, texture_coordinates=np.zeros(4)),
            ValueError,
            "texture_coordinates: expected shape (n, 2) or (m, 3, 2), got (4,)",
        ),
        (
            lambda: ls.Material(reflectivity=TEXTURE, texture_coordinates=np.zeros((4, 3))),
            ValueError,
            "texture_coordinates: expected shape (n, 2), got (4, 3)",
        ),
        (
            lambda: ls.Material(reflectivity=TEXTURE, texture_coordinates=np.zeros((4, 2, 2))),
            ValueError,
            "texture_coordinates: expected shape (m, 3, 2), got (4, 2, 2)",
        ),
        (
            lambda: ls.Material(reflectivity=TEXTURE, texture_coordinates=[(0, 0), (0, math.inf)]),
            ValueError,
            "texture_coordinates: expected finite numbers, got texture_coordinates[1][1] = inf",
        ),
        (
            lambda: ls.Material(reflectivity=0.5, texture_coordinates=SQUARE),
            TypeError,
            "texture_coordinates: expected None, or a Texture as the reflectivity, got an array of shape (4, 2)",
        ),
        (
            lambda: ls.Material(reflectivity=TEXTURE, texture_coordinates=SQUARE, per="vertex"),
            TypeError,
            "reflectivity: expected numbers with per='vertex', got a Texture",
        ),
        (
            lambda: ls.Material(reflectivity=0.5, per="texture"),
            TypeError,
            "reflectivity: expected a Texture with per='texture', got 0.5",
        ),
        (
            lambda: ls.Material.from_texture(np.zeros((3, 3)), SQUARE),
            ValueError,
            "image: expected shape (height, width, 3) or (height, width, 4), got (3, 3)",
        ),
        (
            lambda: ls.Material(reflectivity=ls.Texture([[0.5]])),
            TypeError,
            "texture_coordinates: expected u, v of the vertices or corners for a Texture, got None",
        ),
        (
            lambda: ls.Material(reflectivity=np.zeros(3), per="vertex", texture_coordinates=SQUARE),
            TypeError,
            "texture_coordinates: expected None, or a Texture as the reflectivity, got an array of shape (4, 2)",
        ),
        (
            lambda: ls.Material.from_colors(np.zeros((3, 3)), per="object"),  # type: ignore[arg-type]
            ValueError,
            "per: expected 'face' or 'vertex', got 'object'",
        ),
    ],
)
def test_what_makes_no_texture_is_refused(make: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        make()


@pytest.mark.parametrize(
    ("shape", "coordinates", "message"),
    [
        (ls.Sphere((0, 0, 0), 1.0), SQUARE, "material: expected a TriangleMesh for a texture, got Sphere"),
        (square(), SQUARE[:3], "material: expected texture coordinates of 4 vertices, got 3"),
        (square(), np.zeros((4, 3, 2)), "material: expected texture coordinates of 2 faces, got 4"),
    ],
)
def test_textures_that_do_not_fit_are_refused(shape: ls.Shape, coordinates: Floats, message: str) -> None:
    scene = ls.Scene()
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        scene.add(shape, material=ls.Material(reflectivity=TEXTURE, texture_coordinates=coordinates))
    assert len(scene) == 0
