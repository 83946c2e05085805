"""What holds of every shape; a new one enters by its sample."""

from __future__ import annotations

import itertools
import math
import pickle
import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conformance.samples import SAMPLES, Move
from exact import cases, oracle
from exact.accuracy import judge_cast, judge_roots

import lidarsim as ls

every_sample = pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.name)
TURNS = [
    np.array(m, dtype=float)
    for rows in itertools.permutations(np.eye(3))
    for signs in itertools.product((-1, 1), repeat=3)
    if np.linalg.det(m := np.array(rows) * np.array(signs)[:, None]) > 0
]
NORMAL_TOLERANCE = 2.0**-50


@pytest.fixture(autouse=True, params=["scalar", "avx2", "avx512"])
def isa(request, instruction_sets, monkeypatch, record_property):
    """Run everything here on every instruction set."""
    if request.param not in instruction_sets:
        pytest.skip(f"this machine has no {request.param}")
    monkeypatch.setenv("LIDARSIM_ISA", request.param)
    assert ls._native.isa() == request.param
    record_property("isa", request.param)


def lattice_rays(seed=0, n=300):
    """Rays on multiples of 1/8, so that sums and products with the samples' numbers are exact and many rays touch."""
    rng = np.random.default_rng(seed)
    origins = rng.integers(-24, 25, (n, 3)) / 8
    directions = rng.integers(-12, 13, (n, 3)) / 8 - np.where(rng.random((n, 1)) < 0.7, origins, 0)
    directions[: n // 5] = np.eye(3)[rng.integers(0, 3, n // 5)] * rng.choice([-1, 0.5], (n // 5, 1))
    directions[~directions.any(axis=1)] = (0, 0, 1)
    return origins, directions


def generic_rays(seed=1, n=300):
    """Rays of full-length numbers, half of them towards the sample."""
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(n, 3)) * rng.choice([0.3, 3, 1e4], (n, 1))
    directions = np.where(rng.random((n, 1)) < 0.6, rng.uniform(-0.8, 0.8, (n, 3)) - origins, rng.normal(size=(n, 3)))
    return origins, directions


def assert_same_hits(a, b, *, normals=True):
    np.testing.assert_array_equal(a.t, b.t)
    np.testing.assert_array_equal(a.object_id, b.object_id)
    np.testing.assert_array_equal(a.primitive_id, b.primitive_id)
    if normals:
        np.testing.assert_array_equal(a.normal, b.normal)


RIGHT = set()
"""Answers that the oracle has judged: what an instruction set answers with the same bits is as right."""


def assert_right(spec, origins, directions, hits, roots):
    """Judge nearest hits, roots and some normals by the oracle."""
    arrays = (origins, directions, hits.t, hits.object_id, hits.primitive_id, hits.normal, roots)
    answer = (pickle.dumps(spec), *(array.tobytes() for array in arrays))
    if answer in RIGHT:
        return
    for verdict in (
        judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id),
        judge_roots(spec, origins, directions, roots),
    ):
        assert verdict.wrong == 0, verdict.first
        assert verdict.rounded == verdict.values
    judge = spec.judge()
    for i in np.flatnonzero(hits.hit)[:20]:
        ray = oracle.Ray.of(origins[i].tolist(), directions[i].tolist())
        normals = judge.normals(ray, oracle.nearest(judge, ray))
        assert np.abs(normals - hits.normal[i]).max(axis=1).min() <= NORMAL_TOLERANCE
    RIGHT.add(answer)


def assert_mixed(hits):
    """Guard: enough hits and enough misses."""
    assert hits.hit.sum() >= 15
    assert (~hits.hit).sum() >= 15


@every_sample
@pytest.mark.parametrize("rays", [lattice_rays, generic_rays], ids=["lattice", "generic"])
def test_agrees_with_the_oracle(sample, rays):
    origins, directions = rays()
    shape = sample.build()
    hits = shape.cast(origins, directions)
    assert_mixed(hits)
    assert_right(sample.spec(), origins, directions, hits, shape.roots(origins, directions))


@every_sample
@pytest.mark.parametrize("name", cases.transforms())
def test_transform_is_exact(sample, name):
    matrix = cases.transforms()[name]
    origins, directions = (a @ matrix[:3, :3].T for a in generic_rays(2, 120))
    origins += matrix[:3, 3]
    spec = sample.spec(transform=matrix)
    shape = spec.build()
    hits = shape.cast(origins, directions)
    assert hits.hit.sum() >= 15
    assert_right(spec, origins, directions, hits, shape.roots(origins, directions))


@every_sample
def test_scene_composes_transforms_exactly(sample):
    first, second = cases.transforms()["thirds"], cases.transforms()["turn-utm"]
    shape = sample.build(transform=first)
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, -1e9), 1.0))
    scene.add(shape, transform=second)
    origins, directions = generic_rays(3, 100)
    for matrix in (first, second):
        origins, directions = origins @ matrix[:3, :3].T + matrix[:3, 3], directions @ matrix[:3, :3].T
    hits = scene.cast(origins, directions)
    judge = oracle.Transformed(sample.spec(transform=first).judge(), second)
    want = [
        oracle.nearest(judge, oracle.Ray.of(*ray)) for ray in zip(origins.tolist(), directions.tolist(), strict=True)
    ]
    assert sum(w is not None for w in want) >= 15
    for i, crossing in enumerate(want):
        assert hits.object_id[i] == (-1 if crossing is None else 1)
        if crossing is not None:
            assert hits.t[i] == float(crossing.t)


@every_sample
def test_scene_of_one_is_the_shape(sample):
    for origins, directions in (lattice_rays(), generic_rays()):
        scene = ls.Scene()
        scene.add(sample.build())
        assert_same_hits(scene.cast(origins, directions), sample.build().cast(origins, directions))


@every_sample
def test_roots_are_a_padded_ascending_array(sample):
    origins, directions = generic_rays()
    roots = sample.build().roots(origins, directions)
    assert roots.dtype == np.float64
    assert roots.flags.c_contiguous
    assert roots.ndim == 2
    assert len(roots) == len(origins)
    assert roots.shape[1] >= 1
    known = ~np.isnan(roots)
    assert known.sum() >= 30
    assert not np.diff(known.astype(int), axis=1).clip(min=0).any(), "nan comes last"
    assert (np.diff(roots, axis=1)[known[:, 1:]] >= 0).all()
    assert sample.build().roots(np.empty((0, 3)), np.empty((0, 3))).shape[0] == 0


@every_sample
def test_cast_is_the_first_root_in_range(sample):
    origins, directions = generic_rays()
    shape = sample.build()
    roots = shape.roots(origins, directions)
    for t_min, t_max in ((0.0, math.inf), (0.5, 1.5), (1.0, 1.0), (2.0, 1e300)):
        within = np.where((roots >= t_min) & (roots <= t_max), roots, np.inf).min(axis=1)
        np.testing.assert_array_equal(shape.cast(origins, directions, t_min=t_min, t_max=t_max).t, within)


@every_sample
def test_range_holds_both_ends(sample):
    origins, directions = lattice_rays()
    shape = sample.build()
    first = shape.cast(origins, directions)
    for i in np.flatnonzero(first.hit)[:60]:
        o, d, t = origins[i : i + 1], directions[i : i + 1], float(first.t[i])
        assert shape.cast(o, d, t_min=t, t_max=t).t[0] == t
        assert t == 0 or shape.cast(o, d, t_max=math.nextafter(t, 0)).t[0] == math.inf
        assert shape.cast(o, d, t_min=math.nextafter(t, math.inf)).t[0] > t


@every_sample
def test_hits_are_plain_arrays(sample):
    origins, directions = generic_rays()
    hits = sample.build().cast(origins, directions)
    n = len(origins)
    for array, shape, dtype in (
        (hits.t, (n,), np.float64),
        (hits.hit, (n,), np.bool_),
        (hits.object_id, (n,), np.int32),
        (hits.primitive_id, (n,), np.int32),
        (hits.normal, (n, 3), np.float64),
    ):
        assert (array.shape, array.dtype) == (shape, dtype)
        assert array.flags.c_contiguous
    np.testing.assert_array_equal(hits.hit, np.isfinite(hits.t))
    np.testing.assert_array_equal(hits.object_id, np.where(hits.hit, 0, -1))
    np.testing.assert_array_equal(hits.normal[~hits.hit], 0)
    np.testing.assert_allclose(np.linalg.norm(hits.normal[hits.hit], axis=1), 1, rtol=0, atol=4 * 2.0**-52)
    empty = sample.build().cast(np.empty((0, 3)), np.empty((0, 3)))
    assert (len(empty), empty.normal.shape) == (0, (0, 3))


@every_sample
def test_shift_by_powers_of_two_changes_no_bit(sample):
    origins, directions = lattice_rays()
    still = sample.build()
    hits, roots = still.cast(origins, directions), still.roots(origins, directions)
    assert_mixed(hits)
    for shift in ((2.0**20, -(2.0**22), 2.0**30), (2.0**40, 2.0**40, 2.0**40)):
        moved = sample.build(Move(shift=np.array(shift)))
        np.testing.assert_array_equal(moved.roots(origins + shift, directions), roots)
        assert_same_hits(moved.cast(origins + shift, directions), hits)


@every_sample
def test_quarter_turns_change_no_bit_of_t(sample):
    origins, directions = lattice_rays()
    still = sample.build()
    hits, roots = still.cast(origins, directions), still.roots(origins, directions)
    assert len(TURNS) == 24
    for turn in TURNS:
        moved = sample.build(Move(turn=turn))
        np.testing.assert_array_equal(moved.roots(origins @ turn.T, directions @ turn.T), roots)
        turned = moved.cast(origins @ turn.T, directions @ turn.T)
        assert_same_hits(turned, hits, normals=False)
        if sample.shape not in {"Box", "Cylinder"}:  # at edges and rims another face may be named
            np.testing.assert_allclose(turned.normal, hits.normal @ turn.T, rtol=0, atol=NORMAL_TOLERANCE)


@every_sample
def test_scale_by_powers_of_two_changes_no_bit(sample):
    origins, directions = lattice_rays()
    still = sample.build()
    hits, roots = still.cast(origins, directions), still.roots(origins, directions)
    for scale in (2.0**-40, 2.0**-3, 2.0**17, 2.0**100):
        moved = sample.build(Move(scale=scale))
        np.testing.assert_array_equal(moved.roots(origins * scale, directions), roots * scale)
        np.testing.assert_array_equal(moved.roots(origins * scale, directions * scale), roots)
        moved_hits = moved.cast(origins * scale, directions * scale)
        assert_same_hits(moved_hits, hits, normals=False)
        np.testing.assert_allclose(moved_hits.normal, hits.normal, rtol=0, atol=NORMAL_TOLERANCE)


@every_sample
@pytest.mark.parametrize("power", [1, -1, 50, -50, 500, -500])
def test_direction_times_a_power_of_two(sample, power):
    shape = sample.build()
    for origins, directions in (lattice_rays(), generic_rays()):
        scaled = np.ldexp(directions, power)
        np.testing.assert_array_equal(shape.roots(origins, scaled), np.ldexp(shape.roots(origins, directions), -power))
        hits = shape.cast(origins, directions)
        np.testing.assert_array_equal(shape.cast(origins, scaled).t, np.ldexp(hits.t, -power))
        np.testing.assert_array_equal(shape.cast(origins, scaled).object_id, hits.object_id)


@every_sample
def test_reversed_line_has_the_same_roots_negated(sample):
    shape = sample.build()
    for origins, directions in (lattice_rays(), generic_rays()):
        roots = shape.roots(origins, directions)
        np.testing.assert_array_equal(np.sort(-shape.roots(origins, -directions), axis=1), roots)


@every_sample
def test_origin_slid_along_an_exact_line(sample):
    origins, directions = lattice_rays()
    shape = sample.build()
    roots, slid = shape.roots(origins, directions), shape.roots(origins - 64 * directions, directions)
    np.testing.assert_array_equal(np.isnan(slid), np.isnan(roots))
    known = ~np.isnan(roots)
    assert known.sum() >= 20
    # t and t + 64 are each rounded once, so they differ by 64 to within half an ulp of either
    allowed = (np.spacing(np.abs(slid)) + np.spacing(np.abs(roots))) / 2
    assert (np.abs((slid - roots) - 64) <= allowed + np.spacing(64.0))[known].all()


@every_sample
def test_a_ray_does_not_know_its_neighbours(sample):
    origins, directions = generic_rays(n=500)
    shape = sample.build()
    hits, roots = shape.cast(origins, directions), shape.roots(origins, directions)
    order = np.random.default_rng(4).permutation(len(origins))
    shuffled = shape.cast(origins[order], directions[order])
    for name in ("t", "object_id", "primitive_id", "normal"):
        np.testing.assert_array_equal(getattr(shuffled, name), getattr(hits, name)[order])
    for i in range(0, len(origins), 7):
        one = shape.cast(origins[i : i + 1], directions[i : i + 1])
        assert (one.t[0], one.primitive_id[0]) == (hits.t[i], hits.primitive_id[i])
        np.testing.assert_array_equal(one.normal[0], hits.normal[i])
        row = shape.roots(origins[i : i + 1], directions[i : i + 1])[0]
        np.testing.assert_array_equal(row[~np.isnan(row)], roots[i][~np.isnan(roots[i])])


@every_sample
def test_closed_surface_has_an_inside(sample):
    if sample.inside is None:
        assert sample.shape in {"Plane", "Cylinder", "Disk", "Disks", "Spheres", "Triangle", "Polygon"}
        return
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(400, 3)) * 2.0 ** rng.integers(-60, 60, (400, 1))
    origins = np.tile(sample.inside, (400, 1)).astype(float)
    shape = sample.build()
    assert shape.cast(origins, directions).hit.all()
    roots = shape.roots(origins, directions)
    np.testing.assert_array_equal((roots > 0).sum(axis=1) % 2, 1)
    np.testing.assert_array_equal((roots < 0).sum(axis=1) % 2, 1)
    outward = np.einsum("ij,ij->i", shape.cast(origins, directions).normal, directions)
    assert (outward > 0).mean() > 0.9  # outward, whichever side is seen; a mesh that is not convex turns a few


@every_sample
def test_input_of_any_layout_is_taken_and_kept(sample):
    origins, directions = generic_rays(n=50)
    shape = sample.build()
    hits = shape.cast(origins, directions)
    for o, d in (
        (origins.tolist(), directions.tolist()),
        (np.asfortranarray(origins), np.asfortranarray(directions)),
        (np.repeat(origins, 2, axis=0)[::2], np.flip(np.flip(directions, axis=0).copy(), axis=0)),
        (origins.astype(">f8"), directions.astype(np.longdouble)),
    ):
        assert_same_hits(shape.cast(o, d), hits)
    small = shape.cast(origins.astype(np.float32), directions.astype(np.float32))
    wide = shape.cast(origins.astype(np.float32).astype(float), directions.astype(np.float32).astype(float))
    assert_same_hits(small, wide)
    o, d = origins.copy(), directions.copy()
    o.flags.writeable = d.flags.writeable = False
    assert_same_hits(shape.cast(o, d), hits)


def misalign(values):
    return np.frombuffer(b"\0" + values.tobytes(), np.uint8)[1:].view(values.dtype).reshape(values.shape)


FORMS = {
    "lists": np.ndarray.tolist,
    "tuple": lambda values: tuple(values.tolist()),
    "by columns": np.asfortranarray,
    "with gaps": lambda values: np.repeat(values, 2, axis=0)[::2],
    "backwards": lambda values: np.flip(np.flip(values).copy()),
    "unaligned": misalign,
    "swapped bytes": lambda values: values.astype(values.dtype.newbyteorder()),
    "long doubles": lambda values: values.astype(np.longdouble),
    "masked": np.ma.array,
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@every_sample
def test_arguments_of_any_form_make_the_same_shape(sample, form):
    matrix = np.array([[0.5, 0.25, 0, 0], [0, 2, -1, 0], [0, 0.75, 1, 0], [0, 0, 0, 1]])  # its transpose is a map too
    spec = sample.spec(transform=matrix)
    given = [form(x) if isinstance(x, np.ndarray) and x.dtype == np.float64 else x for x in spec.args]
    shape, expected = cases.Spec(spec.kind, tuple(given), form(matrix)).build(), spec.build()
    assert shape == expected
    np.testing.assert_array_equal(shape.transform, matrix)
    assert_same_hits(shape.cast(*generic_rays()), expected.cast(*generic_rays()))
    scene = ls.Scene()
    scene.add(sample.build(), transform=form(matrix))
    assert_same_hits(scene.cast(*generic_rays()), expected.cast(*generic_rays()))


@pytest.mark.parametrize(
    "center",
    [(1, -2, 3.5), (2**53 + 1, -(2**63), 2**62 + 1537), [-0.0, 5e-324, 1e308], (np.float32(0.1), np.int64(3), True)],
)
def test_numbers_are_taken_as_numpy_takes_them(center):
    expected = np.asarray(center).astype(np.float64)
    for form in (tuple, list, np.array):
        taken = ls.Sphere(form(center), 1.0).center
        assert (taken.tobytes(), taken.dtype, taken.flags.writeable) == (expected.tobytes(), np.float64, False)


@every_sample
def test_is_immutable(sample):
    shape = sample.build()
    for name in ("radius", "transform", "_native", "vertices"):
        with pytest.raises(AttributeError, match=f"^{sample.shape} is immutable: cannot set '{name}'$"):
            setattr(shape, name, 1.0)


@every_sample
def test_argument_arrays_are_copied(sample):
    spec = sample.spec()
    shape = spec.build()
    origins, directions = generic_rays()
    before = shape.cast(origins, directions)
    changed = 0
    for argument in spec.args:
        if isinstance(argument, np.ndarray):
            argument[:] = 0
            changed += 1
    assert changed
    assert_same_hits(shape.cast(origins, directions), before)


@every_sample
def test_many_python_threads_at_once(sample):
    shape = sample.build()
    origins, directions = generic_rays(n=2000)
    want = shape.cast(origins, directions)
    with ThreadPoolExecutor(7) as pool:
        for hits in pool.map(lambda _: shape.cast(origins, directions), range(14)):
            assert_same_hits(hits, want)


BAD_RAYS = [
    (np.zeros((2, 3)), np.ones((3, 3)), "origins, directions: expected arrays of equal length, got 2 and 3"),
    (np.zeros(3), np.ones(3), "origins: expected shape (n, 3), got (3,); of one, [[x, y, z]]"),
    (np.zeros((2, 2)), np.ones((2, 2)), "origins: expected shape (n, 3), got (2, 2)"),
    (np.zeros((1, 3)), np.ones((1, 4)), "directions: expected shape (n, 3), got (1, 4)"),
    ([[0, 0, math.nan]], [[1, 0, 0]], "origins: expected finite numbers, got origins[0][2] = nan"),
    ([[0, 0, 0]] * 2, [[1, 0, 0], [0, math.inf, 0]], "directions: expected finite numbers, got directions[1][1] = inf"),
    ([[0, -math.inf, 0]], [[1, 0, 0]], "origins: expected finite numbers, got origins[0][1] = -inf"),
    (
        [[0, 0, 0]] * 2,
        [[1, 0, 0], [0, -0.0, 0]],
        "directions: expected non-zero vectors, got directions[1] = (0, 0, 0)",
    ),
    ([[0, 0, 0], [1, 2]], [[1, 0, 0]] * 2, "origins: expected numbers of shape (n, 3), got a ragged sequence"),
]


@every_sample
@pytest.mark.parametrize(("origins", "directions", "message"), BAD_RAYS)
def test_bad_rays(sample, origins, directions, message):
    shape = sample.build()
    for method in (shape.cast, shape.roots):
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            method(origins, directions)


BAD_RANGES = [
    ({"t_min": -1.0}, ValueError, "t_min: expected a finite number >= 0, got -1.0"),
    ({"t_min": math.inf}, ValueError, "t_min: expected a finite number >= 0, got inf"),
    ({"t_max": math.nan}, ValueError, "t_max: expected a real number >= 0, got nan"),
    ({"t_min": 2.0, "t_max": 1.0}, ValueError, "t_max: expected a real number >= 2, got 1.0"),
    ({"t_max": "far"}, TypeError, "t_max: expected a real number >= 0, got 'far'"),
]


@pytest.mark.parametrize(("keywords", "error", "message"), BAD_RANGES)
def test_bad_range(keywords, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        ls.Sphere((0, 0, 0), 1.0).cast([[0, 0, 0]], [[1, 0, 0]], **keywords)


BAD_TRANSFORMS = [
    (np.zeros((4, 4)), "transform: expected a last row of (0, 0, 0, 1), got (0.0, 0.0, 0.0, 0.0)"),
    (np.diag((1.0, 0.0, 1.0, 1.0)), "transform: expected an invertible matrix, got determinant 0"),
    (
        [[1, 2, 3, 0], [4, 5, 6, 0], [7, 8, 9, 0], [0, 0, 0, 1]],
        "transform: expected an invertible matrix, got determinant 0",
    ),
    (np.full((4, 4), np.nan), "transform: expected finite numbers, got transform[0][0] = nan"),
    (np.eye(3), "transform: expected shape (4, 4), got (3, 3); a rotation is transform[:3, :3]"),
]


@every_sample
@pytest.mark.parametrize(("matrix", "message"), BAD_TRANSFORMS)
def test_bad_transform(sample, matrix, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        sample.build(transform=matrix)
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Scene().add(sample.build(), transform=matrix)


def test_nearly_singular_transform_is_taken():
    # the determinant is 2⁻⁵², far below what float64 elimination of 1e16-sized numbers can tell from 0
    matrix = np.eye(4)
    matrix[:2, :2] = [[1.0, 1.0], [1.0, 1.0 + 2.0**-52]]
    shape = ls.Sphere((0, 0, 0), 1.0, transform=matrix)
    judge = oracle.Transformed(oracle.Sphere((0, 0, 0), 1.0), matrix)
    origins, directions = np.zeros((3, 3)), np.eye(3)
    want = [[float(t) for t in row] for row in oracle.roots(judge, origins, directions)]
    np.testing.assert_array_equal(shape.roots(origins, directions), want)
