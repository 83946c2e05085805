"""Channels on a spinning head."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, cast

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import (
    Floats,
    Vector,
    angle,
    angles,
    array,
    ask,
    ask_above,
    flag,
    freeze,
    frequency,
    real,
)
from lidarsim.errors import ArgumentValueError
from lidarsim.patterns._parts import (
    TURN,
    Cycles,
    ask_order,
    count_used_cycles,
    firing_times_within,
    per_channel,
    rings,
    wait,
)
from lidarsim.patterns._pulses import Pulses, ScanPattern

PER_MINUTE = 300.0, 1500.0
"""The usual turns of heads, 5 to 25 a second, in turns per minute."""

FARTHEST_BEAM = 1.0
"""Distance of a beam from the centre, m, beyond which the unit is probably another one."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Spinning(ScanPattern):
    """Channels on a head that spins about the z axis: one frame per turn.

    The head fires its channels in cycles, one cycle per column. Cycle `c` of a frame starts when the head has made
    ``(c + d) / columns`` of a turn, and channel `i` fires ``firing_times[i]`` later, when the head has moved on::

        time      = (c + d) / (columns rate) + firing_times[i]
        azimuth   = start_azimuth -/+ 2 pi rate time + azimuth_offsets[i]        - clockwise, + counter-clockwise
        elevation = elevations[i]

    If `columns` is a whole number, d is 0 and all frames are alike. Otherwise cycles continue across turns, and the
    first cycle of frame `k` starts ``d = ceil(k columns) - k columns`` of a cycle late.

    Parameters
    ----------
    elevations : array_like, shape (channels,)
        Elevation of each channel, rad, -pi/2 to pi/2. A channel's index here is its ring.
    azimuth_offsets : float or array_like, shape (channels,)
        Azimuth of each channel relative to the head, rad, counter-clockwise seen from above as all azimuths are.
    columns : float, optional
        Firing cycles per turn, >= 1. Default: 1024, or what follows from `column_period`.
    column_period : float, optional
        Time from one firing cycle to the next, s, in place of `columns`: there are ``1 / (rate column_period)``.
    rate : float
        Turns, and so frames, per second, Hz.
    firing_times : float or array_like, shape (channels,)
        Firing time of each channel since the start of its cycle, s, from 0 to less than the duration of a cycle.
    beam_origins : array_like, shape (channels, 3) or (3,), optional
        Where each beam leaves the sensor while the head's azimuth is 0, m; they turn with the head. Default: the
        sensor's origin.
    clockwise : bool
        Whether the head spins clockwise seen from above.
    field_of_view : float
        Angle over which the head fires, rad, up to 2 pi; cycles that start outside it are left out.
    start_azimuth : float, optional
        Azimuth of the head when a frame starts, rad. Default: half the field of view before the x axis, so that a full
        turn starts behind the sensor and a partial field of view has x in its middle.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape, is not finite or is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> from lidarsim.patterns import Spinning
    >>> pattern = Spinning(np.radians([-15.0, 0.0, 15.0]), columns=360, rate=10.0)
    >>> pulses = pattern.pulses()
    >>> len(pulses), pattern.shape
    (1080, (3, 360))
    >>> pulses.ring[:4]
    array([0, 1, 2, 0], dtype=uint16)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "elevations_deg": list[float],
        "azimuth_offsets_deg": float | list[float],
        "columns": float,
        "column_period_us": float,
        "rate_hz": float,
        "firing_times_us": float | list[float],
        "beam_origins_mm": Vector | list[Vector],
        "clockwise": bool,
        "field_of_view_deg": float,
        "start_azimuth_deg": float,
    }

    elevations: Floats
    azimuth_offsets: Floats
    columns: float | None
    column_period: float | None
    rate: float
    firing_times: Floats
    beam_origins: Floats
    clockwise: bool
    field_of_view: float
    start_azimuth: float

    @explain_arguments
    def __init__(
        self,
        elevations: npt.ArrayLike,
        *,
        azimuth_offsets: npt.ArrayLike = 0.0,
        columns: float | None = None,
        column_period: float | None = None,
        rate: float = 10.0,
        firing_times: npt.ArrayLike = 0.0,
        beam_origins: npt.ArrayLike | None = None,
        clockwise: bool = True,
        field_of_view: float = TURN,
        start_azimuth: float | None = None,
    ) -> None:
        set_ = object.__setattr__
        tilts = array("elevations", elevations, ("channels",))
        set_(self, "elevations", freeze(angles("elevations", tilts, at_most=TURN / 4)))
        channels = rings("elevations", len(self.elevations))
        offsets = per_channel("azimuth_offsets", azimuth_offsets, channels)
        set_(self, "azimuth_offsets", angles("azimuth_offsets", offsets, at_most=TURN))
        if np.ptp(self.azimuth_offsets) > TURN:
            ask("azimuth_offsets", f"{np.ptp(self.azimuth_offsets):g} rad apart", "degrees?")
        set_(self, "rate", frequency("rate", rate))
        if PER_MINUTE[0] <= self.rate <= PER_MINUTE[1]:
            ask("rate", f"{self.rate:g} turns per second", "rpm?")
        if columns is not None and column_period is not None:
            raise ArgumentValueError("columns, column_period", "one of them", f"{columns!r} and {column_period!r}")
        if columns is None and column_period is None:
            columns = 1024
        set_(self, "columns", None if columns is None else real("columns", columns, at_least=1.0))
        if column_period is not None:
            column_period = real("column_period", column_period, above=0.0, at_most=1.0 / self.rate)
        set_(self, "column_period", column_period)
        if self.columns_per_turn > 2.0**32:
            name = "columns" if column_period is None else "column_period"
            raise ArgumentValueError(name, f"at most {1 << 32} columns a turn", f"{self.columns_per_turn:g}")
        cycle = 1.0 / (self.columns_per_turn * self.rate)
        set_(self, "firing_times", firing_times_within(cycle, firing_times, channels))
        ask_order("elevations", self.elevations, self.azimuth_offsets, self.firing_times)
        origins = np.zeros(3) if beam_origins is None else beam_origins
        set_(self, "beam_origins", per_channel("beam_origins", origins, channels, width=3))
        ask_above("beam_origins", self.beam_origins, FARTHEST_BEAM, "m", "mm?")
        set_(self, "clockwise", flag("clockwise", clockwise))
        set_(self, "field_of_view", angle("field_of_view", field_of_view, above=0.0, at_most=TURN))
        if start_azimuth is None:
            start_azimuth = (0.5 if self.clockwise else -0.5) * self.field_of_view
        set_(self, "start_azimuth", angle("start_azimuth", start_azimuth, at_least=-TURN, at_most=TURN))

    @cached_property
    def columns_per_turn(self) -> float:
        """Firing cycles per turn, from `columns` or `column_period`.

        A value within 2 ulp of a whole number is taken as that number: `rate`, `column_period`, their product and the
        quotient are each rounded by up to half an ulp.
        """
        if self.column_period is None:
            return cast("float", self.columns)
        columns = 1.0 / (self.rate * self.column_period)
        whole = round(columns)
        return float(whole) if abs(columns - whole) <= 2.0**-51 * columns else columns

    @property
    def shape(self) -> tuple[int, int]:
        """Rings and most columns of a frame."""
        return len(self.elevations), self._count_used(0.0)

    def _fire_frame(self, frame: int, /) -> Pulses:
        late = wait(frame, self.columns_per_turn, 1.0)
        return self._turn(late) if late else self._even_turn

    @cached_property
    def _even_turn(self) -> Pulses:
        return self._turn(0.0)

    def _count_used(self, late: float) -> int:
        """Return how many cycles of a turn lie in the field of view; the first starts `late`, in cycles."""
        return count_used_cycles(self.columns_per_turn, self.field_of_view / TURN, late)

    @cached_property
    def _cycles(self) -> Cycles:
        return Cycles(
            self.elevations,
            self.azimuth_offsets,
            self.firing_times,
            self.beam_origins,
            speed=(-TURN if self.clockwise else TURN) * self.rate,
            columns=self.shape[1],
        )

    def _turn(self, late: float) -> Pulses:
        rate, turn = self.columns_per_turn * self.rate, (self._count_used(late), 0, 0, late)
        return self._cycles.fire([turn], rate=rate, wait=late, azimuth=self.start_azimuth)
