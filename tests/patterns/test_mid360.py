from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from mpmath import mpf

from lidarsim.patterns import Mid360
from tests.patterns.families import DATA, LATE


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
    np.testing.assert_array_equal(pattern.pulses(120 * 10_000).directions, first)
    # A shorter period of whole frames would divide these 120, and so half, a third or a fifth of them.
    assert all(np.abs(pattern.pulses(frame).directions - first).max() > 0.01 for frame in (60, 40, 24))


def test_frame_rate_only_cuts_differently() -> None:
    fast = np.concatenate([Mid360(rate=40.0).pulses(frame).directions for frame in range(4, 8)])
    # Both are within 2 ulp of 1 of the exact directions.
    np.testing.assert_allclose(fast, Mid360(rate=10.0).pulses(1).directions, rtol=0, atol=4 * 2.0**-52)


@pytest.mark.parametrize(("rate", "error"), [(0.0, ValueError), ("fast", TypeError), (1e6, ValueError)])
def test_bad_rate_is_named(rate: object, error: type[Exception]) -> None:
    with pytest.raises(error, match=r"^rate: expected a finite number > 0 and <= 50000, got "):
        Mid360(rate=rate)  # type: ignore[arg-type]


# fmt: off
ROWS = (  # p, a, b, C in x, y, z, S in x, y, z, both in 1e-7
    (0, 0, 0, -96514, -8420251, 3341810, 0, 0, 0),
    (0, 0, 1, -20548, 1489137, 3736204, 4410844, -33100, 43890),
    (0, 0, 2, 716, 62437, 6, 13, 1214, 2),
    (0, 0, 3, -1340, 131569, 315265, 296963, -2227, 2519),
    (0, 0, 4, 113, 10012, 1, 3, 200, 0),
    (0, 0, 5, -13, 5944, 11130, 11878, -56, 90),
    (0, 0, 6, 11, 955, -1, 2, 22, 1),
    (0, 0, 7, 0, 313, 291, 284, 2, 1),
    (0, 0, 8, 2, 77, 0, 0, 0, -1),
    (0, 0, 9, 1, 23, 5, 7, -3, -2),
    (0, 0, 10, 2, 7, 2, -1, -1, 1),
    (1, 1, -8, -2, -49, -27, 26, 2, 1),
    (1, 1, -7, -2, -140, 2, 6, 4, -2),
    (1, 1, -6, 7, -553, -517, 525, 13, 14),
    (1, 1, -5, -16, -1392, 35, 1, 46, -1),
    (1, 1, -4, 148, -5475, -6857, 6962, 96, 208),
    (1, 1, -3, -192, -16714, 950, 4, 409, -21),
    (1, 1, -2, 1073, -32491, -45187, 45895, 494, 1424),
    (1, 1, -1, -1994, -173763, 12653, 45, 3735, -271),
    (1, 1, 0, -5038, -125420, -282883, -301133, 4792, 3096),
    (1, 1, 1, 22, 1839, -952, -3, -278, 19),
    (1, 1, 2, -7, -2037, -517, 524, -10, 16),
    (1, 1, 3, -19, -1603, 34, 1, 7, -1),
    (1, 1, 4, -4, -281, 27, -25, -5, -2),
    (1, 1, 5, -2, -88, -1, 2, -4, 0),
    (1, 1, 6, 1, -34, 0, 1, -3, -1),
    (1, 1, 7, 0, -9, 1, -2, -1, -2),
    (1, 1, 8, 0, -1, 3, 1, 1, 2),
    (2, 2, -4, 8, 733, -30, 1, -35, 0),
    (2, 2, -3, -25, 1094, 820, -712, -48, -43),
    (2, 2, -2, 44, 3680, -193, -3, -156, 9),
    (2, 2, -1, 53, 1654, 618, 984, -61, -16),
    (2, 2, 0, 5, 203, 29, 1, 7, -3),
    (2, 2, 1, -3, 74, -40, -82, 4, 1),
    (2, 2, 2, 1, 83, -4, -2, 0, 2),
    (2, 2, 3, 1, 26, -2, 6, 1, 0),
    (2, 2, 4, 2, 6, 3, 1, 2, 1),
    (2, 0, 0, 92, 8002, -509, 0, 0, 0),
    (2, 0, 1, 17, 3655, 2348, 2768, 11, 29),
    (2, 0, 2, 10, 843, -2, 1, 18, 0),
    (2, 0, 3, 3, 488, 199, 186, 9, 2),
    (2, 0, 4, 0, 165, 0, 0, 7, 1),
)
# fmt: on


def direction_of(tick: int, beam: int) -> list[mpf]:
    """Return the direction of a beam at a tick, by the definition of the pattern."""
    time, k = mpf(tick) / 50_000, mpf(beam) - mpf(3) / 2
    psi, phi = 2 * mp.pi * mpf(2189) / 12 * time, 2 * mp.pi * 10 * time
    w = [mpf(0)] * 3
    for power, multiple, harmonic, *values in ROWS:
        angle = multiple * psi + harmonic * phi
        for axis in range(3):
            w[axis] += k**power * (values[axis] * mp.cos(angle) + values[axis + 3] * mp.sin(angle)) / 10**7
    length = mp.sqrt(sum(x**2 for x in w))
    x, y, z = (x / length for x in w)
    return [mp.cos(psi) * x + mp.sin(psi) * y, mp.cos(psi) * y - mp.sin(psi) * x, z]


@pytest.mark.parametrize("rate", [0.7, 10.0, 1234.5])
@pytest.mark.parametrize("frame", [0, 1, 36_000, LATE])
def test_directions_are_what_the_definition_says_in_50_digits(rate: float, frame: int) -> None:
    pulses = Mid360(rate=rate).pulses(frame)
    assert len(pulses) > 100
    # As for the other families: within 2 ulp of 1, as phases are not rounded.
    tolerance = 2.0 * 2.0**-52
    with mp.workdps(50):
        first = int(mp.ceil(frame / mpf(rate) * 50_000))
        for i in np.random.default_rng(frame).integers(0, len(pulses), 30):
            truth = direction_of(first + i // 4, i % 4)
            assert max(abs(mpf(float(x)) - y) for x, y in zip(pulses.directions[i], truth, strict=True)) <= tolerance
