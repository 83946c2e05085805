from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

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
