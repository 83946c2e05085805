from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from lidarsim.patterns import OscillatingMirror


def azimuth(**arguments: float) -> np.ndarray:
    directions = (
        OscillatingMirror(field_of_view=1.0, scan_rate=5.0, pulse_rate=10e3, rate=1.0, **arguments).pulses().directions
    )
    assert not directions[:, 2].any()
    return np.arctan2(directions[:, 1], directions[:, 0])


@pytest.mark.parametrize("turn", [0.0, 0.2, 1.0])
def test_swing_goes_from_end_to_end_and_back(turn: float) -> None:
    swing = azimuth(turn=turn)
    np.testing.assert_allclose(swing[[0, 1000, 2000, 3000]], [0.5, -0.5, 0.5, -0.5], atol=1e-12)
    np.testing.assert_allclose(swing[[500, 1500]], 0.0, atol=1e-12)
    np.testing.assert_allclose(swing[:2000], swing[2000:4000], atol=1e-12)
    np.testing.assert_allclose(swing[1:1000], swing[1999:1000:-1], atol=1e-12)
    assert np.abs(swing).max() <= 0.5


@pytest.mark.parametrize("turn", [0.0, 0.2, 1.0])
def test_mirror_is_at_constant_speed_but_for_its_turns(turn: float) -> None:
    speed = np.diff(azimuth(turn=turn)[:1001])
    acceleration = np.diff(speed)
    turning = int(500 * turn)
    np.testing.assert_allclose(acceleration[turning + 1 : 999 - turning - 1], 0.0, atol=1e-12)
    if turning:
        np.testing.assert_allclose(acceleration[1 : turning - 1], acceleration[1], atol=1e-12)
        assert acceleration[1] < 0.0
    # a swing of 1 rad in 1000 steps, for the part `turn` of them at half the speed on average; a step near the fastest
    # moment is slower by up to a thousandth
    assert speed.min() == pytest.approx(-1e-3 / (1.0 - 0.5 * turn), rel=1.1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"field_of_view": 0.0}, "field_of_view: expected a finite number > 0 and <= 6.28319, got 0.0"),
        ({"scan_rate": -1.0}, "scan_rate: expected a finite number > 0, got -1.0"),
        ({"pulse_rate": np.inf}, "pulse_rate: expected a finite number > 0, got inf"),
        ({"rate": 1e5}, "rate: expected a finite number > 0 and <= 10000, got 100000.0"),
        ({"turn": 1.5}, "turn: expected a finite number from 0 to 1, got 1.5"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        OscillatingMirror(**{"field_of_view": 1.0, "scan_rate": 5.0, "pulse_rate": 1e4, "rate": 1.0, **arguments})
