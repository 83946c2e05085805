"""One beam deflected by an oscillating mirror."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from lidarsim import _native
from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, angle, frequency, real
from lidarsim.patterns._parts import TURN, SteadyPattern, Ticks, cycles


@explain_arguments
@dataclass(frozen=True)
class OscillatingMirror(SteadyPattern):
    """A beam that swings to and fro about x in the x-y plane: the zigzag of an airborne scanner that looks along x.

    The azimuth starts at the left end. The beam swings at constant speed and reverses at constant acceleration; the
    reversals take a fraction `turn` of the time. Pulse `m` fires at ``m / pulse_rate``. Each frame continues where the
    previous one stopped.

    Parameters
    ----------
    field_of_view : float
        Angle from end to end, rad.
    scan_rate : float
        Periods, there and back, per second, Hz.
    pulse_rate : float
        Pulses per second, Hz.
    rate : float
        Frames per second, Hz.
    turn : float
        Fraction of the time spent turning back, from 0 (a triangle wave, the default) to 1 (never at constant speed,
        nearly a sine).

    Raises
    ------
    TypeError, ValueError
        If an argument is not a number or is out of its range.

    Examples
    --------
    >>> from math import pi
    >>> from lidarsim.patterns import OscillatingMirror
    >>> pattern = OscillatingMirror(field_of_view=pi / 4, scan_rate=50.0, pulse_rate=150e3, rate=10.0)
    >>> pattern.shape
    (1, 15000)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "field_of_view_deg": float,
        "scan_rate_hz": float,
        "pulse_rate_khz": float,
        "rate_hz": float,
        "turn": float,
    }

    _: KW_ONLY
    field_of_view: float
    scan_rate: float
    pulse_rate: float
    rate: float
    turn: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        set_ = object.__setattr__
        set_(self, "field_of_view", angle("field_of_view", self.field_of_view, above=0.0, at_most=TURN))
        set_(self, "scan_rate", frequency("scan_rate", self.scan_rate))
        set_(self, "pulse_rate", frequency("pulse_rate", self.pulse_rate))
        set_(self, "rate", frequency("rate", self.rate, at_most=self.pulse_rate))
        cycles("pulse_rate", self.pulse_rate, self.rate)
        set_(self, "turn", real("turn", self.turn, at_least=0.0, at_most=1.0))

    def _fire(self, ticks: Ticks, directions: Floats) -> None:
        _native.fire_oscillating_mirror(self.field_of_view, self.turn, ticks.turns(self.scan_rate), directions)
