"""Every named hard case against the exact oracle: all roots, the nearest hit, its primitive, its normal."""

from __future__ import annotations

import math
from collections import Counter

import mpmath
import numpy as np
import pytest
from exact import adversarial, cases, oracle
from exact.accuracy import judge_cast, judge_roots

import lidarsim as ls

CASES = cases.hard_cases()

# Eight roundings of numbers up to 1: of a component, of the length (squares, sum, root), of their quotient.
NORMAL_TOLERANCE = 2.0**-50


def test_names_are_unique():
    assert max(Counter(case.name for case in CASES).values()) == 1


def test_groups_are_not_vacuous():
    hits, misses = Counter(), Counter()
    for case in CASES:
        shape = case.spec.judge()
        for o, d in zip(case.origins.tolist(), case.directions.tolist(), strict=True):
            found = oracle.nearest(shape, oracle.Ray.of(o, d)) is not None
            hits[case.group] += found
            misses[case.group] += not found
    assert len(hits) > 40
    for group, count in hits.items():
        barren = {"triangle, ray in its plane", "cylinder (open), along the axis and in the wall"}
        assert count >= 10 or group in barren, group
        assert count + misses[group] >= 6, group
    assert sum(misses.values()) > 9_000


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case(case, instruction_sets, monkeypatch):
    shape = case.spec.build()
    verdict = judge_roots(case.spec, case.origins, case.directions, shape.roots(case.origins, case.directions))
    assert verdict.wrong == 0, verdict.first
    assert verdict.rounded == verdict.values, "a root is not the exact value correctly rounded"

    hits = shape.cast(case.origins, case.directions)
    verdict = judge_cast(case.spec, case.origins, case.directions, hits.t, primitives=hits.primitive_id)
    assert verdict.wrong == 0, verdict.first
    assert verdict.rounded == verdict.values, "t is not the exact value correctly rounded"
    assert verdict.hits >= case.hits
    assert verdict.rays - verdict.hits >= case.misses

    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        again = shape.cast(case.origins, case.directions)
        for name in ("t", "object_id", "primitive_id", "normal"):
            np.testing.assert_array_equal(getattr(again, name), getattr(hits, name))

    np.testing.assert_array_equal(hits.hit, np.isfinite(hits.t))
    np.testing.assert_array_equal(hits.object_id, np.where(hits.hit, 0, -1))
    np.testing.assert_array_equal(hits.normal[~hits.hit], 0)
    judge = case.spec.judge()
    for i in np.flatnonzero(hits.hit)[:8]:
        ray = oracle.Ray.of(case.origins[i].tolist(), case.directions[i].tolist())
        normals = judge.normals(ray, oracle.nearest(judge, ray))
        assert np.abs(normals - hits.normal[i]).max(axis=1).min() <= NORMAL_TOLERANCE, (normals, hits.normal[i])


@pytest.mark.parametrize("kind", adversarial.KINDS)
def test_random_adversarial(kind, slow):
    rng = np.random.default_rng(2024)
    hits = 0
    for _ in range(1250 if slow else 20):
        case = adversarial.random_case(rng, kind)
        shape = case.spec.build()
        found = shape.cast(case.origins, case.directions)
        for verdict in (
            judge_cast(case.spec, case.origins, case.directions, found.t, primitives=found.primitive_id),
            judge_roots(case.spec, case.origins, case.directions, shape.roots(case.origins, case.directions)),
        ):
            assert verdict.wrong == 0, verdict.first
            assert verdict.rounded == verdict.values, "not the exact value correctly rounded"
            hits += verdict.hits
    assert hits > 1000


HALVES = np.diag((2.0, 2.0, 2.0, 1.0))
ROUND = {
    "sphere": lambda x, y, r: cases.Spec("Sphere", ((x, y, 0), r)),
    "ellipsoid": lambda x, y, r: cases.Spec("Ellipsoid", ((x, y, 0), (r, r, 3 * r))),
    "cylinder": lambda x, y, r: cases.Spec("Cylinder", ((x, y, -1), (x, y, 1), r)),
    "open-cylinder": lambda x, y, r: cases.Spec("Cylinder", ((x, y, -1), (x, y, 1), r, False)),
    "capsule": lambda x, y, r: cases.Spec("Capsule", ((x, y, -1), (x, y, 1), r)),
    "end-of-a-capsule": lambda x, y, r: cases.Spec("Capsule", ((x, y, 0), (x, y, 2), r)),
    "moved-sphere": lambda x, y, r: cases.Spec("Sphere", ((x / 2, y / 2, 0), r / 2), HALVES),
}


@pytest.mark.parametrize("kind", ROUND)
def test_roots_next_to_midpoints_are_correctly_rounded(kind):
    """t = c ± r/√(1 + δ²), with r half the last place of c: short of a midpoint by r·δ²/2, however small δ is."""
    rng = np.random.default_rng(6)
    centers = [1 + 2.0**-52, 2 - 2.0**-52, 1 + 2.0**-51, -1.5, *rng.uniform(1, 2, 4), 2.0**90 * rng.uniform(1, 2)]
    depths = [20, 40, 60, 90, 120, 126, 127, 128, 129, 130, 131, 132, 160, 200, 250, 300, 400, 480]
    for center in map(float, centers):
        radius = math.ulp(center) / 2
        for delta in (2.0**-depth for depth in depths):
            with mpmath.workprec(2200):
                reach = radius / mpmath.sqrt(1 + mpmath.mpf(delta) ** 2)
                exact = center - reach, center + reach
                with mpmath.workprec(53):
                    want = [float(+t) for t in exact]
            assert want == [center, center]
            shape = ROUND[kind](center, center * delta, radius).build()
            ray = [(0, 0, 0)], [(1, delta, 0)]
            assert shape.roots(*ray)[0].tolist() == want, (center, delta)
            assert shape.cast(*ray).t[0] == (center if center > 0 else math.inf)


@pytest.mark.parametrize("power", [100, 190, 250, 300, 500])
def test_normal_of_a_small_sphere_far_away(power):
    """At half the radius beside the centre; t needs twice as many bits as the sphere is farther than large."""
    radius = 2.0**-power
    hits = ls.Sphere((1, 0, 0), radius).cast([(0, radius / 2, 0)], [(1, 0, 0)])
    assert hits.t[0] == 1
    np.testing.assert_allclose(hits.normal[0], (-math.sqrt(0.75), 0.5, 0), rtol=0, atol=NORMAL_TOLERANCE)


RANGED = [case for case in CASES if case.name.endswith(("-direction-times-1", "transform-thirds"))]
RANGED += [
    case
    for case in CASES
    if "through-rim" in case.name
    or "through-seam" in case.name
    or "edges-corners" in case.name
    or "at-5e6" in case.name
]


@pytest.mark.parametrize("case", RANGED, ids=lambda case: case.name)
def test_range_is_closed_at_both_ends(case):
    shape, judge = case.spec.build(), case.spec.judge()
    first = shape.cast(case.origins, case.directions)
    checked = 0
    for i in np.flatnonzero(first.hit)[:12]:
        o, d, t = case.origins[i : i + 1], case.directions[i : i + 1], float(first.t[i])
        below, above = math.nextafter(t, 0), math.nextafter(t, math.inf)
        assert shape.cast(o, d, t_max=t).t[0] == t
        assert shape.cast(o, d, t_min=t, t_max=t).t[0] == t
        assert shape.cast(o, d, t_min=below).t[0] == t
        assert t == 0 or not shape.cast(o, d, t_max=below).hit[0]
        ray = oracle.Ray.of(o[0].tolist(), d[0].tolist())
        beyond = oracle.nearest(judge, ray, t_min=above)
        assert shape.cast(o, d, t_min=above).t[0] == (math.inf if beyond is None else float(beyond.t))
        checked += 1
    assert checked or case.hits == 0


def test_open_and_capped_cylinder_share_their_side():
    # a line that is not along the axis crosses the capped one where it crosses the open one, and the caps else
    open_roots = caps = 0
    for case in CASES:
        if not case.name.startswith("cylinder-capped") or "along-axis" in case.name:
            continue
        start, end, radius, _ = case.spec.args
        tube = cases.Spec("Cylinder", (start, end, radius, False)).build()
        side = tube.roots(case.origins, case.directions)
        full = case.spec.build().roots(case.origins, case.directions)
        for rows in zip(side, full, strict=True):
            some, every = (set(row[~np.isnan(row)].tolist()) for row in rows)
            assert some <= every
            open_roots += len(some)
            caps += len(every - some)
    assert min(open_roots, caps) > 300
