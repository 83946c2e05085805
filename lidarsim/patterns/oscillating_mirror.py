"""One beam deflected by an oscillating mirror."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from lidarsim._pickling import Value
from lidarsim._validation import Floats, angle, frequency, real
from lidarsim.patterns._parts import TURN, Ticks, cycles, directions_of, fired_together
from lidarsim.patterns._pulses import Pulses


@dataclass(frozen=True)
class OscillatingMirror(Value):
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

    @property
    def shape(self) -> tuple[int, int]:
        """One ring, and most pulses of a frame."""
        return 1, cycles("pulse_rate", self.pulse_rate, self.rate)

    def pulses(self, frame: int = 0) -> Pulses:
        """Return the pulses of a frame.

        Parameters
        ----------
        frame : int
            Its number, >= 0.

        Returns
        -------
        Pulses
            In firing order.

        Raises
        ------
        TypeError, ValueError
            If `frame` is not an integer >= 0.
        """
        ticks = Ticks.of(frame, self.pulse_rate, self.rate, beams=1)
        azimuth = 0.5 * self.field_of_view * self._swing(ticks.turns(self.scan_rate))
        return fired_together(directions_of(azimuth[:, None], np.zeros(1)), ticks.time)

    def _swing(self, turns: Floats) -> Floats:
        """Return the deflection, from 1 to -1 and back, at phases in turns.

        A swing one way takes the time 1: half a reversal (T/2), a ramp (1 - T), half a reversal (T/2). It covers the
        distance 2, so the speed on the ramp is v = 2 / (1 - T/2). At a time e before the end of a swing, the distance
        left is (v/T) e**2.
        """
        swing = 2.0 * np.abs(turns % 1.0 - 0.5)
        turn = self.turn if self.turn >= sys.float_info.min else 0.0  # the quotient overflows, of no turn at all
        speed = 2.0 / (1.0 - 0.5 * turn)
        to_end = np.minimum(swing, 1.0 - swing)
        turning = to_end < 0.5 * turn
        depth = np.where(turning, 1.0 - speed / (turn or 1.0) * to_end**2, speed * (0.5 - to_end))
        return np.copysign(depth, swing - 0.5)
