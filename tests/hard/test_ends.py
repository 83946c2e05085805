"""Numbers from one end of float64 to the other, where products overflow, vanish and cancel."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from exact import cases
from exact.accuracy import judge_cast, judge_roots
from hard.test_random import area, determinant
from hypothesis import assume, given
from hypothesis import strategies as st

MOST = sys.float_info.max
number = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, 5e-324, sys.float_info.min, 2.0**-1000, 2.0**1000, MOST, -MOST, MOST / 2]),
    st.floats(allow_nan=False, allow_infinity=False),
)
length = st.one_of(st.sampled_from([1.0, MOST, 5e-324]), st.floats(5e-324, MOST))
vector = st.tuples(number, number, number)
direction = vector.filter(any)
line = st.tuples(vector, direction)
matrices = st.one_of(st.none(), st.lists(number, min_size=12, max_size=12))
shapes = {
    "Plane": st.tuples(direction, number),
    "Sphere": st.tuples(vector, length),
    "Box": st.tuples(st.tuples(length, length, length), vector),
    "Cylinder": st.tuples(vector, vector, length, st.booleans()),
    "Capsule": st.tuples(vector, vector, length),
    "Disk": st.tuples(vector, direction, length),
    "Spheres": st.tuples(*(st.lists(kind, min_size=3, max_size=3) for kind in (vector, length))),
    "Disks": st.tuples(*(st.lists(kind, min_size=3, max_size=3) for kind in (vector, direction, length))),
    "Triangle": st.tuples(vector, vector, vector),
    "TriangleMesh": st.tuples(
        st.lists(vector, min_size=5, max_size=5), st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=1, max_size=6)
    ),
}


@pytest.mark.slow("any numbers end in a result or a documented error")
@pytest.mark.parametrize("kind", shapes)
def test_any_numbers(kind: str, slow: bool) -> None:
    # With the examples of the slow profile, more than a million casts of all kinds.
    lines = st.lists(line, min_size=36, max_size=40) if slow else st.lists(line, min_size=1, max_size=10)

    @given(shapes[kind], matrices, lines)
    def check(arguments, matrix, lines):
        assume(kind != "Triangle" or area(*arguments))
        assume(kind not in {"Cylinder", "Capsule"} or arguments[0] != arguments[1])
        if matrix is not None:
            matrix = np.array([*matrix, 0, 0, 0, 1.0]).reshape(4, 4)
            assume(determinant(matrix))
        spec = cases.Spec(kind, arguments, matrix)
        origins, directions = np.array([o for o, _ in lines]), np.array([d for _, d in lines])
        shape = spec.build()
        hits = shape.cast(origins, directions)
        for verdict in (
            judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id),
            judge_roots(spec, origins, directions, shape.roots(origins, directions)),
        ):
            assert (verdict.wrong, verdict.rounded) == (0, verdict.values), verdict.first

    check()
