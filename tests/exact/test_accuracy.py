"""The accuracy table and those who judge it."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np
import pytest
from exact import accuracy, adversarial, cases
from exact.accuracy import judge_cast, judge_roots

SPHERE = cases.Spec("Sphere", ((0.0, 0.0, 0.0), 1.0))
ORIGINS = np.array([(-3.0, 0.0, 0.0), (-3.0, 2.0, 0.0), (-3.0, 1.0, 0.0), (-3.0, 0.5, 0.0)])
DIRECTIONS = np.tile((1.0, 0.0, 0.0), (4, 1))
EXACT = np.array([2.0, math.inf, 3.0, float(3 - Decimal("0.75").sqrt())])


def test_a_right_answer_is_right():
    verdict = judge_cast(SPHERE, ORIGINS, DIRECTIONS, EXACT)
    assert (verdict.rays, verdict.hits, verdict.wrong, verdict.values, verdict.rounded) == (4, 3, 0, 3, 3)
    assert (verdict.worst, verdict.first) == (0.5, "")


@pytest.mark.parametrize(
    ("index", "t", "field"),
    [(0, math.inf, "missed"), (1, 3.0, "invented"), (0, 4.0, "other"), (2, math.inf, "missed")],
)
def test_a_wrong_decision_is_found(index, t, field):
    given = EXACT.copy()
    given[index] = t
    verdict = judge_cast(SPHERE, ORIGINS, DIRECTIONS, given)
    assert (verdict.wrong, getattr(verdict, field)) == (1, 1)
    assert str(list(ORIGINS[index].tolist())) in verdict.first


@pytest.mark.parametrize("ulps", [1, 2, 1000])
def test_an_error_is_measured_in_ulps(ulps):
    given = EXACT.copy()
    given[2] += ulps * 2.0**-51
    verdict = judge_cast(SPHERE, ORIGINS, DIRECTIONS, given)
    assert (verdict.wrong, verdict.worst, verdict.rounded) == (0, ulps, 2)
    assert bool(verdict.first) == (ulps > 1)


def test_a_wrong_primitive_is_found():
    vertices, faces = cases.fan(5)
    spec = cases.Spec("TriangleMesh", (vertices, faces))
    origins, directions = cases.leak_rays(vertices, faces, np.zeros(3), np.random.default_rng(0))
    hits = spec.build().cast(origins, directions)
    assert judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id).wrong == 0
    assert judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id + 1).other == len(origins)


@pytest.mark.parametrize(
    ("rows", "wrong"),
    [
        ([[2, 4], [np.nan, np.nan], [3, np.nan]], 0),
        ([[2, np.nan], [np.nan, np.nan], [3, np.nan]], 1),
        ([[2, 4], [1, np.nan], [3, 3]], 2),
        ([[2, 4], [np.nan, np.nan], [np.nan, 3]], 1),
    ],
)
def test_roots_are_judged_as_a_whole(rows, wrong):
    assert judge_roots(SPHERE, ORIGINS[:3], DIRECTIONS[:3], np.array(rows, dtype=float)).wrong == wrong


def test_table_of_a_few_cases():
    wanted = {
        "triangle-at-5e6-from-50",
        "sphere-r0.001-distance1e+06-b1-1e-12",
        "polygon-8-at-0",
        "box-cube-at-0-edges-corners",
    }
    few = [case for case in cases.hard_cases() if case.name in wanted]
    assert len(few) == 4
    report = accuracy.measure(few)
    report.leaks = accuracy.measure_leaks({"5e6": 5e6})
    assert len(report.rows) == 4
    for group, row in report.rows.items():
        own = row["lidarsim"]
        assert (own.wrong, own.errs) == (0, False)
        assert own.worst <= 0.5
        assert own.rounded == own.values > 0
        assert (row["textbook"] is None) == group.startswith("polygon")
    assert report.rows["triangle at 5e6 m"]["textbook"].worst > 1e3
    assert report.leaks["5e6"]["lidarsim"][0] == 0
    assert report.leaks["5e6"]["textbook"][0] > 0
    assert [report.errs(engine) for engine in ("lidarsim", "textbook")] == [False, True]
    table = report.to_markdown()
    assert table.count("\n| ") == 2 + 4 + 1
    assert "| polygon, to vertices and edges |" in table


def test_peers_agree_on_easy_rays():
    # each engine, asked what it can answer, answers to its precision: the table compares like with like
    engines = accuracy._available_engines()
    assert {"textbook", "lidarsim"} <= set(engines)
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(40, 3)) * 3
    directions = rng.uniform(-0.3, 0.3, (40, 3)) - origins
    asked = 0
    for spec in cases.basic_specs().values():
        want = accuracy.ENGINES["lidarsim"](spec, origins, directions)
        for name, engine in engines.items():
            t = engine(spec, origins, directions)
            if t is not None:
                asked += 1
                # float32 of Open3D, for a direction of about 1 and rays of some metres
                np.testing.assert_allclose(t, want, rtol=1e-5 if name == "Open3D" else 1e-9)
    assert asked >= 2 * 8
    points = [cases.Spec("Plane.from_point", ((0.1, 0.2, 0.3), (1.0, 2.0, -1.0))), cases.Spec("Box", ((1, 2, 3),))]
    for spec in points:
        for engine in engines.values():
            t = engine(spec, origins, directions)
            assert t is None or np.allclose(t, accuracy.ENGINES["lidarsim"](spec, origins, directions), rtol=1e-9)


def test_random_rays_are_judged():
    lines = []
    verdicts = accuracy.measure_random(80 * len(adversarial.KINDS), 3, lines.append)
    assert list(verdicts) == list(adversarial.KINDS)
    assert len(lines) == len(adversarial.KINDS)
    for verdict in verdicts.values():
        assert (verdict.rays, verdict.wrong) == (80, 0), verdict.first
        assert verdict.rounded == verdict.values


@pytest.mark.parametrize("kind", adversarial.KINDS)
def test_a_sample_serves_where_nothing_aims_at_a_shape(kind, monkeypatch):
    monkeypatch.delitem(adversarial.MAKERS, kind)
    rng, verdict = np.random.default_rng(1), accuracy.Verdict()
    for _ in range(4):
        case = adversarial.random_case(rng, kind, 40)
        hits = case.spec.build().cast(case.origins, case.directions)
        verdict.add(judge_cast(case.spec, case.origins, case.directions, hits.t, primitives=hits.primitive_id))
    assert 30 <= verdict.hits <= 130
    assert not verdict.errs, verdict.first
