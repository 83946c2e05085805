from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from lidarsim.patterns import Spinning
from tests.patterns.families import HOKUYO, OUSTER, PARTIAL, VLP16


def azimuth(directions: np.ndarray) -> np.ndarray:
    return np.arctan2(directions[:, 1], directions[:, 0])


def test_vlp16_fires_its_lasers_in_order_of_their_ids_every_55_296_us() -> None:
    pulses = VLP16.pulses()
    elevations = np.degrees(np.arcsin(pulses.directions[:16, 2]))
    by_id = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15]
    np.testing.assert_allclose(elevations, by_id, atol=1e-12)
    np.testing.assert_allclose(pulses.time[:17] * 1e6, [*(2.304 * np.arange(16)), 55.296], rtol=1e-14)
    np.testing.assert_array_equal(pulses.ring[:4], [0, 8, 1, 9])


def test_azimuth_moves_on_within_a_firing_cycle() -> None:
    pulses = VLP16.pulses()
    step = np.diff(np.unwrap(azimuth(pulses.directions[:32])))
    # 10 turns a second, clockwise, for 2.304 us, and for the 20.736 us from the last laser to the next cycle
    expected = np.full(31, -2 * np.pi * 10 * 2.304e-6)
    expected[15] = -2 * np.pi * 10 * 20.736e-6
    np.testing.assert_allclose(step, expected, rtol=0, atol=4e-15)


def test_turn_starts_behind_and_runs_clockwise() -> None:
    angles = azimuth(OUSTER.pulses().directions).reshape(1024, 4)
    head = np.unwrap(angles[:, 0] + np.radians(4.2))
    np.testing.assert_allclose(head, np.pi - np.arange(1024) * 2 * np.pi / 1024, atol=4e-15)


def test_partial_field_of_view_keeps_the_columns_inside_it_ends_included() -> None:
    pulses = HOKUYO.pulses()
    assert HOKUYO.shape == (1, 1081)
    np.testing.assert_allclose(np.degrees(azimuth(pulses.directions)), np.linspace(-135, 135, 1081), atol=1e-12)
    np.testing.assert_allclose(pulses.time, np.arange(1081) / (1440 * 40), rtol=1e-14)


def test_partial_field_of_view_has_the_x_axis_in_its_middle() -> None:
    pattern = Spinning([0.0], columns=1000, field_of_view=1.0)
    first, last = azimuth(pattern.pulses().directions)[[0, -1]]
    assert first == pytest.approx(0.5, abs=1e-15)
    assert -0.5 <= last < -0.5 + 2 * np.pi / 1000


@pytest.mark.parametrize("degrees", [0.25, 0.5, 0.1, 1.0, 45.0, 90.0, 120.0, 270.25, 359.9])
@pytest.mark.parametrize("columns", [360, 720, 1024, 1440, 3600])
def test_field_of_view_of_whole_columns_in_degrees_has_that_many(degrees: float, columns: int) -> None:
    wanted = degrees * columns / 360
    pattern = Spinning([0.0], columns=columns, field_of_view=np.radians(degrees))
    assert pattern.shape[1] == (round(wanted) if abs(wanted - round(wanted)) < 1e-9 else int(np.ceil(wanted)))


def test_columns_of_fractional_number_alternate_between_turns() -> None:
    counts = [len(VLP16.pulses(frame)) // 16 for frame in range(1000)]
    assert set(counts) == {1808, 1809}
    # 100 s hold floor(100 / 55.296e-6) + 1 starts of a cycle
    assert sum(counts) == 1_808_449 + 1


@pytest.mark.parametrize(
    ("rate", "period", "columns"), [(10.0, 50e-6, 2000.0), (5.5, 1 / 1980.0, 360.0), (10.0, 1 / 30000.0, 3000.0)]
)
def test_column_period_of_whole_columns_gives_that_many(rate: float, period: float, columns: float) -> None:
    assert Spinning([0.0], rate=rate, column_period=period).columns_per_turn == columns


def test_column_period_keeps_its_columns_when_the_rate_changes() -> None:
    fast = Spinning([0.0], rate=20.0, column_period=55.296e-6)
    assert fast.columns_per_turn == pytest.approx(1 / (20 * 55.296e-6), rel=1e-15)
    assert fast.pulses().time[1] == pytest.approx(55.296e-6, rel=1e-15)


def test_origins_turn_with_the_head() -> None:
    pulses = OUSTER.pulses()
    head = azimuth(pulses.directions) - np.radians([-4.2, -1.4, 1.4, 4.2])[pulses.ring]
    expected = np.c_[0.015806 * np.cos(head), 0.015806 * np.sin(head), np.full(len(head), 0.03618)]
    np.testing.assert_allclose(pulses.origins, expected, atol=1e-16)


def test_default_is_1024_columns_from_the_origin() -> None:
    pulses = Spinning([0.0, 0.1]).pulses()
    assert len(pulses) == 2048
    assert not pulses.origins.any()


def test_counter_clockwise_is_the_mirror_image() -> None:
    right = PARTIAL.pulses(3).directions
    left = Spinning([0.1, -0.2], columns=700.25, rate=7.0, field_of_view=1.0, firing_times=[1e-4, 0.0], clockwise=False)
    np.testing.assert_allclose(left.pulses(3).directions * (1, -1, 1), right, atol=1e-16)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"elevations": []}, "elevations: expected 1 to 65536 of them, got 0"),
        ({"elevations": 0.1}, "elevations: expected shape (channels,), got ()"),
        ({"elevations": [0.0, np.nan]}, "elevations: expected finite numbers, got elevations[1] = nan"),
        ({"elevations": ["up"]}, "elevations: expected real numbers of shape (channels,), got dtype <U2"),
        ({"azimuth_offsets": [0.0] * 3}, "azimuth_offsets: expected shape (2,), got (3,)"),
        ({"azimuth_offsets": np.inf}, "azimuth_offsets: expected finite numbers, got azimuth_offsets = inf"),
        ({"columns": 0}, "columns: expected a finite number >= 1, got 0.0"),
        (
            {"columns": 10, "column_period": 1e-3},
            "columns, column_period: expected one of them, got 10 and 0.001",
        ),
        ({"column_period": 0.2}, "column_period: expected a finite number > 0 and <= 0.1, got 0.2"),
        ({"rate": 0.0}, "rate: expected a finite number > 0, got 0.0"),
        ({"rate": "10"}, "rate: expected a finite number > 0, got '10'"),
        (
            {"firing_times": [0.0, 1e-3]},
            "firing_times: expected times >= 0 and < 9.76563e-05 s, that of a cycle, got firing_times[1] = 0.001",
        ),
        (
            {"firing_times": [-1e-6, 0.0]},
            "firing_times: expected times >= 0 and < 9.76563e-05 s, that of a cycle, got firing_times[0] = -1e-06",
        ),
        ({"beam_origins": [[0, 0, 0]] * 3}, "beam_origins: expected shape (2, 3), got (3, 3)"),
        ({"beam_origins": [0, 0]}, "beam_origins: expected shape (3,), got (2,)"),
        ({"clockwise": 1}, "clockwise: expected True or False, got 1"),
        ({"field_of_view": 7.0}, "field_of_view: expected a finite number > 0 and <= 6.28319, got 7.0; degrees?"),
        ({"start_azimuth": np.nan}, "start_azimuth: expected a finite number from -6.28319 to 6.28319, got nan"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        Spinning(**{"elevations": [0.0, 0.1], **arguments})
