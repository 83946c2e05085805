from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.patterns import Palmer


def test_beam_goes_round_a_cone_from_left_to_up() -> None:
    pulses = Palmer(half_angle=0.3, scan_rate=10.0, pulse_rate=4e3, rate=10.0).pulses(7)
    assert len(pulses) == 400
    np.testing.assert_allclose(pulses.directions[:, 0], np.cos(0.3), rtol=1e-15)
    angle = np.unwrap(np.arctan2(pulses.directions[:, 2], pulses.directions[:, 1]))
    np.testing.assert_allclose(angle, np.arange(400) * 2 * np.pi / 400, atol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"half_angle": 4.0}, "half_angle: expected a finite number > 0 and <= 3.14159, got 4.0; degrees?"),
        ({"scan_rate": 0.0}, "scan_rate: expected a finite number > 0, got 0.0"),
        ({"pulse_rate": True}, "pulse_rate: expected a finite number > 0, got True"),
        ({"rate": 5e3}, "rate: expected a finite number > 0 and <= 4000, got 5000.0"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        Palmer(**{"half_angle": 0.3, "scan_rate": 10.0, "pulse_rate": 4e3, "rate": 10.0, **arguments})


@pytest.mark.parametrize(
    ("height", "speed", "lines", "density", "printed"), [(75, 10, 69, 91.6, 92), (150, 26, 77, 17.6, 18)]
)
def test_density_on_the_ground_is_that_of_a_data_sheet(
    height: float, speed: float, lines: float, density: float, printed: float
) -> None:
    """RIEGL VQ-840-GL, data sheet, scan patterns: mean densities at two heights, with 50 kHz and 20 degrees off nadir.

    The unit's scan is 28 degrees long in the direction of flight, not 40, which does not change the mean.
    """
    half_angle = np.radians(20)
    reach, band = height * np.tan(half_angle), 20.0
    seconds = np.ceil((2 * reach + band) / speed)
    cone = Palmer(half_angle=half_angle, scan_rate=lines, pulse_rate=50e3, rate=1 / seconds)
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0))
    start = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, height], [0, 0, 0, 1]])  # x down, z ahead
    flight = ls.Trajectory.from_twist(start, linear=(0, 0, speed))
    x, y, _ = ls.Lidar(cone).scan(scene, flight).point_cloud("world").xyz.T
    # A band across the flight that the whole cone passes.
    whole = (x >= reach) & (x < reach + band)
    assert np.abs(y[whole]).max() <= reach
    found = whole.sum() / (band * 2 * reach)
    assert found == pytest.approx(density, rel=0.005)
    assert found == pytest.approx(printed, rel=0.025)
