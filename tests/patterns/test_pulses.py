"""Pulses: what is converted, what is shared, and which patterns are none."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.patterns import Pulses, Spinning


def test_the_callers_arrays_stay_writable_and_ours_are_not() -> None:
    given = (np.eye(3), np.diag([1.0, 2.0, 3.0]), np.zeros(3), np.zeros(3, np.uint16), np.arange(3, dtype=np.uint32))
    pulses = Pulses(*given)
    for name, array in zip(("directions", "origins", "time", "ring", "column"), given, strict=True):
        assert array.flags.writeable
        assert np.shares_memory(array, getattr(pulses, name))
        with pytest.raises(ValueError, match="read-only"):
            getattr(pulses, name)[0] = 1


def test_origins_that_are_all_alike_are_ours() -> None:
    """Scans read one of them alone, so that the caller must not change the others."""
    given, numbers = np.full((100, 3), [0.1, 0.2, 0.3]), np.arange(100)
    pulses = Pulses(np.tile([1.0, 0.0, 0.0], (100, 1)), given, np.zeros(100), numbers, numbers)
    given[7] = 0.0
    assert np.array_equal(pulses.origins, np.full((100, 3), [0.1, 0.2, 0.3]))
    assert pulses.origins.flags.c_contiguous
    assert not pulses.origins.flags.writeable
    assert np.shares_memory(replace(pulses, origins=given).origins, given)


class Described:
    """A pattern of which only the description counts."""

    def __init__(self, rate: Any = 10.0, shape: Any = (1, 3)) -> None:
        self.rate, self.shape = rate, shape

    def pulses(self, frame: int = 0) -> Pulses:
        raise NotImplementedError(frame)


@pytest.mark.parametrize(
    ("pattern", "error", "message"),
    [
        (Described(rate="10"), TypeError, "pattern.rate: expected a finite number > 0, got '10'"),
        (Described(rate=0), ValueError, "pattern.rate: expected a finite number > 0, got 0.0"),
        (Described(shape=3), TypeError, "pattern.shape: expected (rings, columns), got 3"),
        (Described(shape=(1, 2.5)), TypeError, "pattern.shape: expected an integer >= 0, got 2.5"),
        (None, TypeError, "pattern: expected a scan pattern (rate, shape, pulses), got None"),
        (
            Spinning,
            TypeError,
            "pattern: expected a scan pattern (rate, shape, pulses), got <class 'lidar...ing.Spinning'>",
        ),
    ],
)
def test_patterns_that_are_none_are_refused(pattern: Any, error: type[Exception], message: str) -> None:
    assert ls.Lidar(Described()).pattern.rate == 10.0
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        ls.Lidar(pattern)


def test_beam_angles() -> None:
    azimuths, elevations = np.radians([-170.0, -30.0, 0.0, 100.0]), np.radians([-80.0, -5.0, 0.0, 60.0])
    pulses = ls.patterns.Grid(azimuths, elevations, rate=10.0).pulses()
    # a coordinate is rounded to 2**-53, which moves an angle by that over the cosine of 80°
    bound = 4 * 2.0**-53 / np.cos(np.radians(80.0))
    assert np.abs(pulses.azimuth - np.repeat(azimuths, 4)).max() < bound
    assert np.abs(pulses.elevation - np.tile(elevations, 4)).max() < bound
    assert pulses.azimuth.shape == pulses.elevation.shape == (16,)
