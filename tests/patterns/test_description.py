from __future__ import annotations

import numpy as np
import pytest

from lidarsim.patterns import Grid, Spinning, describe
from tests.patterns.families import AT128, FAMILIES, MID40, VLP16


def test_vlp16_in_numbers() -> None:
    numbers = describe(VLP16)
    assert (numbers.rings, numbers.columns, numbers.repeats) == (16, 1809, False)
    assert numbers.pulses_per_second == pytest.approx(16 / 55.296e-6, rel=1e-4)  # 10 frames end within a cycle
    np.testing.assert_allclose(np.degrees(numbers.elevation), (-15, 15))
    np.testing.assert_allclose(np.degrees(numbers.elevation_gap), (2, 2))
    step = 2 * np.pi * 10 * 55.296e-6
    chord = 2 * np.arcsin(np.cos(np.radians((15, 1))) * np.sin(step / 2))
    np.testing.assert_allclose(numbers.pulse_gap, chord)
    assert numbers.pause == pytest.approx(20.736e-6)


def test_mirror_pauses_between_its_facets() -> None:
    numbers = describe(AT128)
    assert numbers.pause == pytest.approx(0.1 - 1199 / 24e3 - 8.24e-6)
    assert numbers.time == pytest.approx((0.0, 1199 / 24e3 + 8.24e-6))
    assert numbers.repeats


def test_rings_of_no_fixed_elevation_have_no_gap() -> None:
    assert np.isnan(describe(MID40).elevation_gap).all()
    assert np.isnan(describe(FAMILIES["mid360"]).elevation_gap).all()
    assert np.isnan(describe(Spinning([0.0])).elevation_gap).all()


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_can_be_described(name: str) -> None:
    numbers = describe(FAMILIES[name])
    assert numbers.pulses_per_second > 0
    assert numbers.azimuth[0] <= numbers.azimuth[1]


def test_a_pattern_without_pulses_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^pattern: expected one whose first frame has pulses, got none$"):
        describe(Grid([], [0.0], rate=10.0))
