from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from lidarsim import Lidar
from lidarsim.patterns import PolygonMirror
from tests.patterns.families import AT128, VQ780


def test_facet_sweeps_from_left_to_right_at_constant_speed() -> None:
    pattern = PolygonMirror(sweep=1.5, field_of_view=1.0, line_rate=10.0, pulse_rate=15e3, rate=10.0)
    pulses = pattern.pulses()
    angles = np.arctan2(pulses.directions[:, 1], pulses.directions[:, 0])
    np.testing.assert_allclose(angles, 0.5 - np.arange(1000) * 1e-3, atol=2e-15)
    np.testing.assert_allclose(pulses.time, np.arange(1000) / 15e3, rtol=1e-14)


def test_at128_scans_1200_columns_of_a_tenth_of_a_degree() -> None:
    pulses = AT128.pulses(5)
    assert AT128.shape == (3, 1200)
    assert len(pulses) == 3 * 1200
    of_ring = np.degrees(np.arctan2(pulses.directions[:, 1], pulses.directions[:, 0]))[pulses.ring == 1]
    np.testing.assert_allclose(of_ring, 60.0 - 0.65 - 0.1 * np.arange(1200), atol=1e-12)


def test_channels_fire_while_the_mirror_moves() -> None:
    pulses = AT128.pulses()
    np.testing.assert_array_equal(pulses.ring[:3], [1, 2, 0])
    angles = np.arctan2(pulses.directions[:3, 1], pulses.directions[:3, 0])
    moved = np.radians(60.0) - np.radians(240.0) * 10.0 * np.array([0.0, 4.112e-6, 8.24e-6])
    np.testing.assert_allclose(angles, moved + np.radians([-0.65, 2.4, 2.4]), atol=1e-15)


def test_only_the_field_of_view_is_fired_into() -> None:
    kept = sum(len(VQ780.pulses(frame)) for frame in range(50))
    # two thirds of 5 s at 500 kHz, and part of a cycle a line
    assert kept == pytest.approx(5 * 500e3 * 2 / 3, abs=5 * 297)
    angles = [np.arctan2(*VQ780.pulses(frame).directions[:, [1, 0]].T) for frame in range(3)]
    assert np.degrees(np.abs(np.concatenate(angles))).max() <= 30.0 + 1e-12


@pytest.mark.parametrize("rate", [5.0, 15.0, 20.0])
def test_a_facet_per_frame_at_any_rate(rate: float) -> None:
    pattern = Lidar.preset("hesai-at128", rate=rate).pattern
    # A cycle that is on the border belongs to neither of two fields of view.
    assert [abs(len(pattern.pulses(frame)) - 128 * 12_000 / rate) <= 128 for frame in range(6)] == [True] * 6
    assert pattern.shape[1] == pytest.approx(12_000 / rate, abs=1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"field_of_view": 2.0}, "field_of_view: expected a finite number > 0 and <= 1.5, got 2.0; degrees?"),
        ({"sweep": 0.0}, "sweep: expected a finite number > 0 and <= 12.5664, got 0.0"),
        ({"line_rate": np.nan}, "line_rate: expected a finite number > 0 and <= 15000, got nan"),
        ({"line_rate": 2e4}, "line_rate: expected a finite number > 0 and <= 15000, got 20000.0"),
        ({"elevations": []}, "elevations: expected 1 to 65536 of them, got 0"),
        ({"elevations": [0.0, 0.1], "azimuth_offsets": [0.0]}, "azimuth_offsets: expected shape (2,), got (1,)"),
        (
            {"firing_times": 1.0},
            "firing_times: expected times >= 0 and < 6.66667e-05 s, that of a cycle, got firing_times[0] = 1",
        ),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    good = {"sweep": 1.5, "field_of_view": 1.0, "line_rate": 10.0, "pulse_rate": 15e3, "rate": 10.0}
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        PolygonMirror(**{**good, **arguments})
