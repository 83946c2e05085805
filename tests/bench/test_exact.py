"""The exact hits that the report measures errors against, beside the oracle of the tests."""

from __future__ import annotations

import ast
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from exact import cases, oracle

from lidarsim.bench import exact, scenes
from lidarsim.bench.scenes import UTM, Rays, Spec

ORIGIN = (0.0, 0.0, 0.0)
SMALL = {
    "city": lambda offset: scenes.city(900, offset),
    "terrain": lambda offset: scenes.terrain(600, offset),
    "scans": lambda offset: scenes.scans(600, offset),
    "analytic": lambda offset: scenes.analytic(40, offset),
    "tessellation": lambda offset: scenes.analytic(12, offset).tessellate(1),
}


def some(rays: Rays, count: int) -> Rays:
    return rays[np.random.default_rng(0).choice(len(rays), count, replace=False)]


def fractions(*values: float) -> exact.Vector:
    x, y, z = map(Fraction, values)
    return x, y, z


def test_it_shares_no_code_with_what_it_judges() -> None:
    tree = ast.parse(Path(exact.__file__).read_text(encoding="utf-8"))
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    modules |= {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    assert {name for name in modules if str(name).startswith("lidarsim")} == {"lidarsim.bench.scenes"}


@pytest.mark.parametrize("offset", [ORIGIN, UTM], ids=["origin", "utm"])
@pytest.mark.parametrize("name", SMALL)
def test_truth_is_that_of_brute_force(name: str, offset: npt.ArrayLike) -> None:
    world = SMALL[name](offset)
    scene = oracle.Scene()
    for spec in world.shapes:
        scene.add(cases.Spec(spec.kind, spec.args).judge())
    hits = 0
    for rays in (some(scenes.lidar(world, 16, 64, 1.0), 15), scenes.random_rays(world, 15)):
        truth = exact.first_hits(world, rays)
        for o, d, t, surface in zip(
            rays.origins.tolist(), rays.directions.tolist(), truth.t, truth.surface, strict=True
        ):
            expected = scene.nearest(oracle.Ray.of(o, d))
            if expected is None or t is None:
                assert (expected, t, surface) == (None, None, -1)
            else:
                index, crossing = expected
                # Both roots are rational, or both are rounded: the oracle's to 320 bits.
                assert abs(t / crossing.t.fraction() - 1) < Fraction(1, 2**250)
                assert crossing.t.s or t == crossing.t.fraction()
                assert surface == (index if world.mesh is None else min(crossing.faces))
                hits += 1
    assert hits >= 10


@pytest.mark.parametrize(
    ("spec", "origin", "direction", "expected"),
    [
        (Spec("Sphere", (np.zeros(3), 5.0)), (-5, 3, 0), (2, 0, 0), Fraction(1, 2)),
        (Spec("Sphere", (np.zeros(3), 5.0)), (0, 5, 0), (1, 0, 0), 0),
        (Spec("Sphere", (np.zeros(3), 5.0)), (1, 0, 0), (1, 0, 0), 4),
        (Spec("Sphere", (np.zeros(3), 5.0)), (6, 0, 0), (1, 0, 0), None),
        (Spec("Sphere", (np.zeros(3), 5.0)), (-9, math.nextafter(5, 6), 0), (1, 0, 0), None),
        (Spec("Ellipsoid", (np.zeros(3), np.array([1.0, 2, 3]), np.eye(3)[[1, 2, 0]])), (9, 0, 0), (-1, 0, 0), 7),
        (Spec("Box", (np.array([2.0, 4, 6]), np.zeros(3))), (-3, 2, 3), (1, 0, 0), 2),
        (Spec("Box", (np.array([2.0, 4, 6]), np.zeros(3))), (-3, 2.5, 3), (1, 0, 0), None),
        (Spec("Cylinder", (np.zeros(3), np.array([0.0, 0, 4]), 1.0)), (1, 0, 9), (0, 0, -1), 5),
        (Spec("Cylinder", (np.zeros(3), np.array([0.0, 0, 4]), 1.0)), (1.5, 0, 9), (0, 0, -1), None),
        (Spec("Cylinder", (np.zeros(3), np.array([0.0, 0, 4]), 1.0)), (-3, 0, 5), (2, 0, -1), 1),
        (Spec("Plane.from_point", (np.zeros(3), np.array([0.0, 0, 2]))), (0, 0, 3), (0, 1, -2), Fraction(3, 2)),
        (Spec("Plane.from_point", (np.zeros(3), np.array([0.0, 0, 2]))), (0, 0, 0), (0, 1, 0), None),
    ],
)
def test_worked_examples(spec: Spec, origin: tuple[float, ...], direction: tuple[float, ...], expected: object) -> None:
    assert exact.solid_hit(spec, fractions(*origin), fractions(*direction)) == expected


def test_only_shapes_of_the_analytic_scene_are_known() -> None:
    with pytest.raises(ValueError, match="got Polygon"):
        exact.solid_hit(Spec("Polygon", ()), fractions(0, 0, 0), fractions(0, 0, 1))


def test_roots_keep_their_bits_where_differences_cancel() -> None:
    """From 2⁻⁵⁰ above a unit sphere, the near root is 2⁻⁵⁰ (exactly), by a difference of numbers near 1."""
    near = exact.solid_hit(Spec("Sphere", (np.zeros(3), 1.0)), fractions(1 + 2.0**-50, 0, 0), fractions(-1, 0, 0))
    assert near == Fraction(1, 2**50)
    # Along (−1, ε, 0) the root is irrational: t² (1 + ε²) − 2 a t + a² − 1 = 0 for a = 1 + 2⁻⁵⁰.
    a, slope = Fraction(1 + 2.0**-50), Fraction(2.0**-30)
    t = exact.solid_hit(
        Spec("Sphere", (np.zeros(3), 1.0)), (a, *fractions(0, 0, 0)[1:]), (Fraction(-1), slope, Fraction(0))
    )
    assert t is not None
    # The polynomial changes by about 2 t times a relative change of t.
    assert abs(t * t * (1 + slope**2) - 2 * a * t + a * a - 1) < 2 * t / 2**254


def test_ulps_are_of_the_exact_value() -> None:
    quarter_above = Fraction(1) + Fraction(1, 2**54)
    assert exact.ulps(quarter_above, 1.0) == 0.25
    assert exact.ulps(quarter_above, 1 + 2.0**-52) == 0.75
    assert exact.ulps(Fraction(1, 3), 1 / 3) < 0.5


def test_only_round_shapes_tell_casters_apart() -> None:
    world = scenes.analytic(40)
    truth = exact.first_hits(world, some(scenes.lidar(world, 128, 32, math.pi / 4), 200))
    kinds = [world.shapes[surface].kind for surface in truth.surface if surface >= 0]
    assert truth.telling.sum() == sum(kind in {"Sphere", "Cylinder", "Ellipsoid"} for kind in kinds)
    assert 0 < truth.telling.sum() < len(kinds)
    mesh = world.tessellate(0)
    truth = exact.first_hits(mesh, some(scenes.lidar(mesh, 128, 32, math.pi / 4), 50))
    assert truth.telling.tolist() == (truth.surface >= 0).tolist()


def test_rays_along_the_sides_of_boxes_may_meet_them() -> None:
    for place in (0.0, 5e-324, 0.1, -1e7):
        low, high = np.full((1, 3), place), np.full((1, 3), place + 1.0)
        for corner in ((low[0, 0], low[0, 1]), (high[0, 0], high[0, 1]), (low[0, 0], high[0, 1])):
            origin, up = np.array([*corner, low[0, 2] - 1.0]), np.array([0.0, 0.0, 1.0])
            assert exact._may_meet(low, high, origin, up).all()
            assert not exact._may_meet(low, high, origin, -up).any()
            assert not exact._may_meet(low, high, origin - [2.0, 0.0, 0.0], up).any()
