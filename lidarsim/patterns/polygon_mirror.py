"""Beams swept by the facets of a rotating polygon, one line per facet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, angle, angles, freeze, frequency, one_or_each
from lidarsim.patterns._parts import (
    TURN,
    Cycles,
    Ticks,
    ask_order,
    count_used_cycles,
    cycles,
    firing_times_within,
    per_channel,
    ratio,
    rings,
)
from lidarsim.patterns._pulses import Pulses, ScanPattern


@dataclass(frozen=True, eq=False, init=False, repr=False)
class PolygonMirror(ScanPattern):
    """Channels that a rotating polygon sweeps about z at constant speed, each facet from the left end to the right.

    While a polygon of N mirrors turns by ``2 pi / N``, a facet sweeps the beam by twice that angle. Only the field of
    view is used; the rest of the line is a pause. Line `l` enters the field of view at ``l / line_rate``. Firing cycles
    start at ``m / pulse_rate``, independently of the mirror; cycles outside the field of view are left out. Channel `i`
    fires at ``time = m / pulse_rate + firing_times[i]`` with::

        azimuth   = field_of_view / 2 - sweep (time - l / line_rate) line_rate + azimuth_offsets[i]
        elevation = elevations[i]

    The bow that a real polygon gives to lines at elevations other than 0 is not modelled.

    Parameters
    ----------
    elevations : float or array_like, shape (channels,)
        Elevation of each channel, rad. A channel's index here is its ring. Default: one
        channel at 0, for an airborne scanner looking along x.
    sweep : float
        Angle that a facet sweeps, rad: ``4 pi / N``.
    field_of_view : float
        Used part of the sweep, rad.
    line_rate : float, optional
        Facets per second, Hz. Default: `rate`, a facet per frame.
    pulse_rate : float
        Firing cycles per second, Hz: pulses of each channel.
    rate : float
        Frames per second, Hz.
    azimuth_offsets : float or array_like, shape (channels,)
        Azimuth of each channel relative to the sweep, rad, counter-clockwise seen from above.
    firing_times : float or array_like, shape (channels,)
        Firing time of each channel since the start of its cycle, s, from 0 to less than the duration of a cycle.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape, is not finite or is out of its range.

    Notes
    -----
    On scanners of this kind see A. Wehr and U. Lohr, Airborne laser scanning: an introduction and overview, ISPRS
    Journal of Photogrammetry and Remote Sensing 54, 1999.

    Examples
    --------
    >>> from math import radians
    >>> from lidarsim.patterns import PolygonMirror
    >>> pattern = PolygonMirror(sweep=radians(90), field_of_view=radians(60), line_rate=300, pulse_rate=900e3, rate=100)
    >>> pattern.shape, len(pattern.pulses())
    ((1, 6000), 6000)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "elevations_deg": list[float],
        "sweep_deg": float,
        "field_of_view_deg": float,
        "line_rate_hz": float,
        "pulse_rate_khz": float,
        "rate_hz": float,
        "azimuth_offsets_deg": float | list[float],
        "firing_times_us": float | list[float],
    }

    elevations: Floats
    sweep: float
    field_of_view: float
    line_rate: float | None
    pulse_rate: float
    rate: float
    azimuth_offsets: Floats
    firing_times: Floats

    @explain_arguments
    def __init__(
        self,
        elevations: npt.ArrayLike = (0.0,),
        *,
        sweep: float,
        field_of_view: float,
        line_rate: float | None = None,
        pulse_rate: float,
        rate: float,
        azimuth_offsets: npt.ArrayLike = 0.0,
        firing_times: npt.ArrayLike = 0.0,
    ) -> None:
        set_ = object.__setattr__
        tilts = np.atleast_1d(one_or_each("elevations", elevations, "channels"))
        set_(self, "elevations", freeze(angles("elevations", tilts, at_most=TURN / 4)))
        channels = rings("elevations", len(self.elevations))
        set_(self, "sweep", angle("sweep", sweep, above=0.0, at_most=2.0 * TURN))
        set_(self, "field_of_view", angle("field_of_view", field_of_view, above=0.0, at_most=min(self.sweep, TURN)))
        set_(self, "pulse_rate", frequency("pulse_rate", pulse_rate))
        if line_rate is not None:
            line_rate = frequency("line_rate", line_rate, at_most=self.pulse_rate)
        set_(self, "line_rate", line_rate)
        set_(self, "rate", frequency("rate", rate, at_most=self.pulse_rate))
        cycles("pulse_rate", self.pulse_rate, self.rate)
        offsets = per_channel("azimuth_offsets", azimuth_offsets, channels)
        set_(self, "azimuth_offsets", angles("azimuth_offsets", offsets, at_most=TURN))
        set_(self, "firing_times", firing_times_within(1.0 / self.pulse_rate, firing_times, channels))
        ask_order("elevations", self.elevations, self.azimuth_offsets, self.firing_times)

    @property
    def _line_rate(self) -> float:
        return self.rate if self.line_rate is None else self.line_rate

    @property
    def shape(self) -> tuple[int, int]:
        """Rings, and most columns of a frame."""
        lines = Fraction(self._line_rate) / Fraction(self.rate)
        if lines.denominator > 1:
            return len(self.elevations), cycles("pulse_rate", self.pulse_rate, self.rate)
        return len(self.elevations), int(lines) * self._count_used(0.0)

    def _fire_frame(self, frame: int, /) -> Pulses:
        now = Ticks.of(frame, self.pulse_rate, self.rate)
        # Line `l` starts `cycles / lines` pulses after the one before, at the first tick from there on.
        cycles, lines = ratio(self.pulse_rate, self._line_rate)
        runs = []
        for line in range(now.first * lines // cycles, (now.first + now.count - 1) * lines // cycles + 1):
            first = -(-line * cycles // lines)
            late = (first * lines - line * cycles) / lines
            start = first - now.first
            here = max(0, start)
            columns = min(now.count, start + self._count_used(late)) - here
            if columns > 0:
                runs.append((columns, here, here - start, late))
        return self._cycles.fire(runs, rate=self.pulse_rate, wait=now.wait, azimuth=0.5 * self.field_of_view)

    @cached_property
    def _cycles(self) -> Cycles:
        return Cycles(
            self.elevations,
            self.azimuth_offsets,
            self.firing_times,
            np.zeros((len(self.elevations), 3)),
            speed=-self.sweep * self._line_rate,
            columns=self.shape[1],
        )

    def _count_used(self, wait: float) -> int:
        """Return how many cycles of a line lie in the field of view; the first starts `wait` of a cycle late."""
        return count_used_cycles(self.pulse_rate / self._line_rate, self.field_of_view / self.sweep, wait)
