from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from lidarsim.patterns import Grid
from tests.patterns.families import COLUMNS, FLASH


def test_flash_fires_all_beams_at_once() -> None:
    pulses = FLASH.pulses()
    assert len(pulses) == 6 * 16
    assert not pulses.time.any()
    assert not pulses.origins.any()
    azimuth = np.degrees(np.arctan2(pulses.directions[:, 1], pulses.directions[:, 0])).reshape(16, 6)
    # Directions round thrice by 2⁻⁵³, and an angle and its degrees twice by half a spacing.
    near = 3 * np.degrees(2.0**-53) / np.cos(np.radians(10)) + np.spacing(30.0)
    expected = np.repeat(np.linspace(30, -30, 16)[:, None], 6, axis=1)
    np.testing.assert_allclose(azimuth, expected, rtol=0, atol=near)
    elevation = np.degrees(np.arcsin(pulses.directions[:, 2])).reshape(16, 6)
    expected = np.repeat(np.linspace(10, -10, 6)[None], 16, axis=0)
    np.testing.assert_allclose(elevation, expected, rtol=0, atol=near)


def test_columns_fire_one_after_the_other() -> None:
    pulses = COLUMNS.pulses(9)
    np.testing.assert_allclose(pulses.time, [0, 0, 0.02, 0.02, 0.04, 0.04, 0.06, 0.06], rtol=2.0**-52)
    np.testing.assert_array_equal(pulses.ring, [0, 1] * 4)
    np.testing.assert_array_equal(pulses.column, [0, 0, 1, 1, 2, 2, 3, 3])


def test_grid_without_beams_is_empty() -> None:
    assert len(Grid([], [0.0], rate=1.0).pulses()) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"azimuths": [[0.0]]}, "azimuths: expected shape (columns,), got (1, 1)"),
        ({"elevations": [np.inf]}, "elevations: expected finite numbers, got elevations[0] = inf"),
        ({"elevations": np.zeros(65537)}, "elevations: expected 0 to 65536 of them, got 65537"),
        ({"rate": -1}, "rate: expected a finite number > 0, got -1.0"),
        ({"column_period": 0.06}, "column_period: expected a finite number from 0 to 0.05, got 0.06"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        Grid(**{"azimuths": [0.0, 0.1], "elevations": [0.0], "rate": 10.0, **arguments})
