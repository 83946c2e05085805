"""The pattern of the Livox Mid-360."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from fractions import Fraction
from typing import ClassVar

from lidarsim import _native
from lidarsim._base.validation import Floats, frequency
from lidarsim.patterns._parts import SteadyPattern, Ticks, cycles

TICK_RATE = 50_000
"""Rate at which the four beams fire together, Hz."""

FAST = Fraction(2189, 12)
"""Turns per second of the fast phase; the pattern repeats after 12 s."""

SLOW_TURN = 5000
"""Ticks to a turn of the slow phase."""


@dataclass(frozen=True)
class Mid360(SteadyPattern):
    """The four beams of the Livox Mid-360: all around z, from 7 degrees below the horizon to 52 above.

    The beams fire together every 20 us. With ``psi = 2 pi 2189/12 t``, ``phi = 2 pi 10 t`` and k = -1.5, -0.5, 0.5, 1.5
    for the beams, the direction is that of w turned by -psi about z, where w is a sum of ``k**p (C cos(a psi + b phi) +
    S sin(a psi + b phi))`` over the rows of a table. The table was fitted to all 800 000 directions of the scan table
    that Livox publishes for simulation (Livox-SDK/livox_laser_simulation, scan_mode/mid360.csv, MIT, copyright (c) 2021
    livox), from which it differs by 0.0048 degrees rms and 0.019 degrees at most; the published angles are rounded to
    0.01 degrees.

    Parameters
    ----------
    rate : float
        Frames per second, Hz. Each frame goes on where the one before stopped.

    Raises
    ------
    TypeError, ValueError
        If `rate` is not a number > 0.

    Examples
    --------
    >>> from lidarsim.patterns import Mid360
    >>> Mid360(rate=10.0).shape
    (4, 5000)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "rate_hz": float,
    }

    _: KW_ONLY
    rate: float = 10.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        object.__setattr__(self, "rate", frequency("rate", self.rate, at_most=TICK_RATE))
        cycles("rate", TICK_RATE, self.rate)

    @property
    def _beams(self) -> int:
        return 4

    @property
    def _tick_rate(self) -> float:
        return TICK_RATE

    def _fire(self, ticks: Ticks, directions: Floats) -> None:
        _native.fire_mid360(ticks.turns(FAST), ticks.first % SLOW_TURN, directions)
