"""One beam that a tilted rotating mirror deflects along a cone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from lidarsim import _native
from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, angle, frequency
from lidarsim.patterns._parts import TURN, SteadyPattern, Ticks, cycles


@explain_arguments
@dataclass(frozen=True)
class Palmer(SteadyPattern):
    """A beam that moves along a cone about x, from left to up: the circles of a bathymetric scanner looking along x.

    Pulse `m` fires at ``m / pulse_rate`` towards ``(cos a, sin a cos h, sin a sin h)`` with ``h = 2 pi scan_rate m /
    pulse_rate``. Each frame continues where the previous one stopped.

    Parameters
    ----------
    half_angle : float
        Angle a between the beam and x, rad.
    scan_rate : float
        Turns per second, Hz.
    pulse_rate : float
        Pulses per second, Hz.
    rate : float
        Frames per second, Hz.

    Raises
    ------
    TypeError, ValueError
        If an argument is not a number or is out of its range.

    Examples
    --------
    >>> from math import radians
    >>> from lidarsim.patterns import Palmer
    >>> Palmer(half_angle=radians(20), scan_rate=80.0, pulse_rate=200e3, rate=10.0).shape
    (1, 20000)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "half_angle_deg": float,
        "scan_rate_hz": float,
        "pulse_rate_khz": float,
        "rate_hz": float,
    }

    _: KW_ONLY
    half_angle: float
    scan_rate: float
    pulse_rate: float
    rate: float

    def __post_init__(self) -> None:
        """Check the arguments."""
        set_ = object.__setattr__
        set_(self, "half_angle", angle("half_angle", self.half_angle, above=0.0, at_most=TURN / 2))
        set_(self, "scan_rate", frequency("scan_rate", self.scan_rate))
        set_(self, "pulse_rate", frequency("pulse_rate", self.pulse_rate))
        set_(self, "rate", frequency("rate", self.rate, at_most=self.pulse_rate))
        cycles("pulse_rate", self.pulse_rate, self.rate)

    def _fire(self, ticks: Ticks, directions: Floats) -> None:
        _native.fire_palmer(self.half_angle, ticks.turns(self.scan_rate), directions)
