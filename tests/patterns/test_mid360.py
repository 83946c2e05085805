from __future__ import annotations

import numpy as np
import pytest

from lidarsim.patterns import Mid360
from tests.patterns.families import DATA


def test_directions_are_those_that_livox_publishes() -> None:
    rows, azimuth, elevation = np.loadtxt(DATA / "livox" / "mid360_rows.csv", delimiter=",", skiprows=1, dtype=int).T
    assert len(rows) == 300
    pulses = [Mid360(rate=10.0).pulses(frame) for frame in range(4)]
    x, y, z = np.concatenate([frame.directions for frame in pulses])[rows].T
    np.testing.assert_array_equal(np.concatenate([frame.ring for frame in pulses])[rows], rows % 4)
    across = (np.degrees(np.arctan2(y, x)) - azimuth / 100 + 180) % 360 - 180
    error = np.hypot(across * np.hypot(x, y), np.degrees(np.arcsin(z)) - elevation / 100)
    # 0.019 degrees at most over the whole table, as its fit says; the table is rounded to 0.01
    assert error.max() < 0.0195


def test_four_beams_fire_together_every_20_us() -> None:
    pulses = Mid360().pulses(2)
    np.testing.assert_array_equal(pulses.ring[:8], [0, 1, 2, 3] * 2)
    np.testing.assert_allclose(pulses.time[[0, 3, 4, 7, 8]], [0, 0, 20e-6, 20e-6, 40e-6], rtol=1e-14)


def test_pattern_repeats_after_12_s_and_no_sooner() -> None:
    pattern = Mid360(rate=10.0)
    first = pattern.pulses(0).directions
    # 21 890 000 turns later, reduced exactly
    np.testing.assert_allclose(pattern.pulses(120 * 10_000).directions, first, atol=1e-15)
    # A shorter period of whole frames would divide these 120, and so half, a third or a fifth of them.
    assert all(np.abs(pattern.pulses(frame).directions - first).max() > 0.01 for frame in (60, 40, 24))


def test_frame_rate_only_cuts_differently() -> None:
    fast = np.concatenate([Mid360(rate=40.0).pulses(frame).directions for frame in range(4, 8)])
    np.testing.assert_allclose(fast, Mid360(rate=10.0).pulses(1).directions, atol=1e-13)


@pytest.mark.parametrize(("rate", "error"), [(0.0, ValueError), ("fast", TypeError), (1e6, ValueError)])
def test_bad_rate_is_named(rate: object, error: type[Exception]) -> None:
    with pytest.raises(error, match=r"^rate: expected a finite number > 0 and <= 50000, got "):
        Mid360(rate=rate)  # type: ignore[arg-type]
