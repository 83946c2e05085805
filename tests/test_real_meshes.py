"""Third-party meshes, scanned by configuration and from Python, against brute force in integers.

PyVista's wheel contains an airplane and an ant. Vertices and rays are floats, that is, integers over a power of two:
every triangle is tested against every ray of a sample without rounding.
"""

from __future__ import annotations

from fractions import Fraction
from math import isqrt
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import pyvista.examples

import lidarsim as ls

Floats = npt.NDArray[np.float64]

# The sensor stands above the airplane, and behind the ant.
MESHES = {
    "airplane": (pyvista.examples.planefile, (900.0, 700.0, 420.0)),
    "ant": (pyvista.examples.antfile, (-40.0, 3.0, 1.0)),
}
PATTERNS = {
    "airplane": ls.patterns.Spinning(np.radians(np.linspace(-75, -20, 12)), columns=400),
    "ant": ls.patterns.Spinning(np.radians(np.linspace(-30, 30, 40)), columns=1440, field_of_view=np.pi / 3),
}
CONFIG = """\
sensor:
  pattern: {{type: spinning, elevations_deg: {elevations}, columns: {columns}, field_of_view_deg: {view}}}
pose: {{position_m: {position}}}
scene: [{{shape: mesh, file: {file}, label: 7}}]
"""


def integers(values: npt.ArrayLike) -> tuple[npt.NDArray[np.object_], int]:
    """Return float64 values as Python integers over one denominator."""
    ratios = [float(value).as_integer_ratio() for value in np.ravel(values)]
    denominator = max(d for _, d in ratios)
    whole = np.array([n * (denominator // d) for n, d in ratios], dtype=object)
    return whole.reshape(np.shape(values)), denominator


def nearest(
    corners: npt.NDArray[np.object_], scale: int, origin: Floats, direction: Floats
) -> tuple[Fraction, int] | None:
    """Return the first hit of a ray: its exact t and the lowest of the triangles that have it; None if all are missed.

    The signs of d·(b×c), d·(c×a), d·(a×b), seen from the origin, say on which side of each edge the line passes
    (R. J. Segura and F. R. Feito, Algorithms to test ray-triangle intersection: comparative study, WSCG 2001). Zero
    counts as either.
    """
    (o, w), (d, v) = integers(origin), integers(direction)
    a, b, c = np.moveaxis(corners * w - o * scale, 1, 0)  # in units of 1 / (scale w)
    sides = np.stack([np.cross(b, c) @ d, np.cross(c, a) @ d, np.cross(a, b) @ d])
    slope = sides.sum(axis=0)  # d·n for n = (b − a) × (c − a)
    inside = ((sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)) & (slope != 0)
    hits = []
    for face in np.flatnonzero(inside):
        n = np.cross(b[face] - a[face], c[face] - a[face])
        t = Fraction(int(n @ a[face]) * v, int(slope[face]) * scale * w)
        if t >= 0:
            hits.append((t, int(face)))
    return min(hits, default=None)


def length(vector: Floats) -> Fraction:
    """Return the length of a vector to a relative 2^-200."""
    whole, denominator = integers(vector)
    return Fraction(isqrt(int(whole @ whole) << 400), denominator << 200)


def ulps(value: float, exact: Fraction) -> float:
    return float(abs(Fraction(value) - exact) / Fraction(np.spacing(float(exact))))


def config(folder: Path, name: str) -> Path:
    file, position = MESHES[name]
    pattern = PATTERNS[name]
    path = folder / f"{name}.yaml"
    path.write_text(
        CONFIG.format(
            elevations=np.degrees(pattern.elevations).tolist(),
            columns=pattern.columns,
            view=np.degrees(pattern.field_of_view),
            position=list(position),
            file=file,
        ),
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("name", MESHES)
def test_every_hit_of_a_scan_is_exact(name: str) -> None:
    file, position = MESHES[name]
    mesh = ls.TriangleMesh.from_file(file)
    scene = ls.Scene()
    scene.add(mesh)
    pose = np.eye(4)
    pose[:3, 3] = position
    scan = ls.Lidar(PATTERNS[name]).scan(scene, pose)
    found = scene.cast(scan.pulses.origins + position, scan.pulses.directions)

    corners, scale = integers(mesh.vertices[mesh.faces])
    hits = misses = 0
    for pulse in range(0, len(scan.status), 29):
        exact = nearest(corners, scale, np.array(position), scan.pulses.directions[pulse])
        assert (scan.status[pulse] == ls.Status.hit) == (exact is not None) == found.hit[pulse]
        if exact is None:
            misses += 1
            continue
        hits += 1
        t, face = exact
        assert found.t[pulse] == float(t)
        assert ulps(scan.true_range[pulse, 0], t * length(scan.pulses.directions[pulse])) <= 1
        assert scan.range[pulse, 0] == scan.true_range[pulse, 0]
        assert found.primitive_id[pulse] == face
        a, b, c = mesh.vertices[mesh.faces[face]]
        normal = np.cross(b - a, c - a)
        # float32 vertices: the cross product and its length err by a few roundings of float64, the field is a float32
        assert np.abs(scan.normal[pulse, 0] - normal / np.linalg.norm(normal)).max() < 1e-6
    assert hits >= 30
    assert misses >= 30


@pytest.mark.parametrize("name", MESHES)
def test_a_configuration_scans_the_same(name: str, tmp_path: Path) -> None:
    run = ls.config.load(config(tmp_path, name))
    scene = ls.Scene()
    scene.add(ls.TriangleMesh.from_file(MESHES[name][0]), label=7)
    pose = np.eye(4)
    pose[:3, 3] = MESHES[name][1]
    by_config, by_python = run.scan(), ls.Lidar(run.lidar.pattern).scan(scene, pose)
    assert (by_config.status == ls.Status.hit).sum() > 500
    first, second = by_config.point_cloud(), by_python.point_cloud()
    assert first.fields == second.fields
    for field in first.fields:
        assert np.array_equal(getattr(first, field), getattr(second, field)), field
    assert set(first.label) == {7}
