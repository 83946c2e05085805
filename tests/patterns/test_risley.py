from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from lidarsim.patterns import Prism, Risley
from tests.patterns.families import DATA, MID40

MID70 = Risley(
    [Prism(7294 / 60, phase=np.pi, entry_tilt=np.radians(18.0)), Prism(-4664 / 60, exit_tilt=np.radians(18.0))],
    refractive_index=1.8144,
    pulse_rate=100e3,
    rate=10.0,
)


@pytest.mark.parametrize(("name", "pattern"), [("mid40", MID40), ("mid70", MID70)])
def test_directions_are_those_that_livox_publishes(name: str, pattern: Risley) -> None:
    table = np.loadtxt(DATA / "livox" / f"{name}_rows.csv", delimiter=",", skiprows=1)
    assert len(table) == 250
    # Row m of the table is fired 10 us after time 0 and m times 10 us more.
    row = table[:, 0].astype(int) + 1
    frames = [pattern.pulses(frame).directions for frame in range(3)]
    x, y, z = np.concatenate(frames)[row].T
    # The prisms were fitted to 1.4e-5 degrees, the float32 of the table's angles.
    np.testing.assert_allclose(np.degrees(np.arctan2(y, x)), np.degrees(table[:, 1]), atol=1.5e-5)
    np.testing.assert_allclose(np.degrees(np.arcsin(z)), np.degrees(table[:, 2]), atol=1.5e-5)


def test_one_prism_deviates_as_the_thin_prism_formula_says() -> None:
    tilt, index = 1e-4, 1.5
    pattern = Risley([Prism(1.0, exit_tilt=tilt)], refractive_index=index, pulse_rate=100.0, rate=1.0)
    deviation = np.arccos(pattern.pulses().directions[:, 0])
    np.testing.assert_allclose(deviation, (index - 1.0) * tilt, rtol=1e-7)  # and terms of tilt**2 = 1e-8


def test_glass_without_refraction_leaves_the_beam_alone() -> None:
    pattern = Risley([Prism(3.0, entry_tilt=0.3, exit_tilt=-0.2)], refractive_index=1.0, pulse_rate=50.0, rate=1.0)
    np.testing.assert_allclose(pattern.pulses().directions, np.tile([1.0, 0.0, 0.0], (50, 1)), atol=2e-16)


def test_faces_of_the_same_tilt_only_shift_the_beam() -> None:
    pattern = Risley([Prism(3.0, entry_tilt=0.3, exit_tilt=0.3)], refractive_index=1.7, pulse_rate=50.0, rate=1.0)
    np.testing.assert_allclose(pattern.pulses().directions, np.tile([1.0, 0.0, 0.0], (50, 1)), atol=1e-15)


def test_pattern_does_not_repeat() -> None:
    first = MID40.pulses(0).directions
    for frame in range(1, 40):
        assert np.abs(MID40.pulses(frame).directions - first).max() > 0.01


def test_total_reflection_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"^prisms: expected each face to let the beams through, got total reflection$"
    ):
        Risley([Prism(1.0, exit_tilt=0.8)], refractive_index=1.5, pulse_rate=10.0, rate=1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"prisms": [1.0]}, "prisms: expected Prism objects, got prisms[0] = 1.0"),
        ({"refractive_index": 0.9}, "refractive_index: expected a finite number >= 1, got 0.9"),
        ({"pulse_rate": 0.0}, "pulse_rate: expected a finite number > 0, got 0.0"),
        ({"rate": 200.0}, "rate: expected a finite number > 0 and <= 100, got 200.0"),
        ({"beams": [[0, 0, 0]]}, "beams: expected non-zero vectors, got beams[0] = (0, 0, 0)"),
        ({"beams": np.empty((0, 3))}, "beams: expected 1 to 65536 of them, got 0"),
        ({"beams": [1, 0, 0]}, "beams: expected shape (beams, 3), got (3,); of one, [[x, y, z]]"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        Risley(**{"prisms": [], "refractive_index": 1.5, "pulse_rate": 100.0, "rate": 10.0, **arguments})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rotation_rate": np.nan}, "rotation_rate: expected a finite number, got nan"),
        ({"exit_tilt": 2.0}, "exit_tilt: expected a finite number from -1.5708 to 1.5708, got 2.0; degrees?"),
    ],
)
def test_bad_prisms_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        Prism(**{"rotation_rate": 1.0, **arguments})
