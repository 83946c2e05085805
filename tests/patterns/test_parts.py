"""What patterns share: directions by angles, and calls of the core with arrays that do not fit."""

from __future__ import annotations

from collections.abc import Callable

import mpmath as mp
import numpy as np
import pytest
from mpmath import mpf

from lidarsim import _native
from lidarsim.patterns._parts import directions_of, rotate, unit


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6, 1e7, 1e15, 1e300])
def test_directions_are_those_of_angles_of_any_size(size: float) -> None:
    draw = np.random.default_rng(3)
    azimuth, elevation = size * draw.uniform(-1, 1, 70), draw.uniform(-1.5, 1.5, 70)
    found = directions_of(azimuth, elevation)
    with mp.workdps(400):
        for direction, a, e in zip(found, map(mpf, azimuth), map(mpf, elevation), strict=True):
            truth = mp.cos(e) * mp.cos(a), mp.cos(e) * mp.sin(a), mp.sin(e)
            # A sine or cosine is off by an ulp of 1, a product of two by two of them and its own rounding; unit
            # length takes 1.25 of half an ulp and two roundings.
            assert max(abs(mpf(x) - y) for x, y in zip(direction.tolist(), truth, strict=True)) <= 4.5 * 2.0**-52


def test_angles_are_broadcast() -> None:
    found = directions_of(np.array([[0.1], [0.2], [0.3]]), np.array([0.0, 0.5]))
    assert found.shape == (3, 2, 3)
    np.testing.assert_array_equal(found[2, 1], directions_of(np.array([0.3]), np.array([0.5]))[0])


def test_vectors_are_turned_and_scaled() -> None:
    vectors = np.array([[3.0, 4.0, 12.0], [0.0, -1e-200, 0.0], [1e300, 0.0, 0.0]])
    np.testing.assert_allclose(unit(vectors), [[3 / 13, 4 / 13, 12 / 13], [0, -1, 0], [1, 0, 0]], rtol=2**-51)
    quarter = rotate(vectors[:1], np.array([np.pi / 2]))
    np.testing.assert_allclose(quarter, [[-4.0, 3.0, 12.0]], rtol=0, atol=8 * 2**-52)


def _cycles(
    channels: int = 2, origins: int | None = None, pulses: int = 4, timed: int = 4, placed: int | None = None
) -> None:
    beams = np.tile([1.0, 0.0, 0.0], (channels, 1))
    fired = _native.Channels(beams, np.zeros(2), None if origins is None else np.zeros((origins, 3)))
    places = None if placed is None else np.empty((placed, 3))
    fired.fire([(2, 0, 0, 0.0)], (1.0, 0.0), (0.0, 1.0), np.empty((pulses, 3)), np.empty(timed), places)


@pytest.mark.parametrize(
    "call",
    [
        lambda: _cycles(channels=0),
        lambda: _cycles(channels=3),
        lambda: _cycles(origins=3, placed=4),
        lambda: _cycles(origins=2),
        lambda: _cycles(origins=2, placed=3),
        lambda: _cycles(placed=4),
        lambda: _cycles(pulses=5),
        lambda: _cycles(timed=3),
        lambda: _native.fire_polar(np.zeros(3), np.zeros(2), np.empty((3, 3))),
        lambda: _native.fire_polar(np.zeros(3), np.zeros(3), np.empty((3, 2))),
        lambda: _native.fire_palmer(0.1, (0, 1), np.empty((6, 3))[::2]),
        lambda: _native.fire_risley(np.empty((0, 3)), [], 1.5, np.empty((3, 3))),
        lambda: _native.fire_risley(np.eye(3)[:2], [], 1.5, np.empty((3, 3))),
    ],
)
def test_arrays_that_do_not_fit_are_refused(call: Callable[[], object]) -> None:
    _cycles()
    _cycles(origins=2, placed=4)
    with pytest.raises(ValueError, match="expected"):
        call()
