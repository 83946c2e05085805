"""Beams on a grid of azimuths and elevations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, angles, array, freeze, frequency, real
from lidarsim.patterns._parts import TURN, ask_order, directions_of, expect_room, rings
from lidarsim.patterns._pulses import Pulses, ScanPattern


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Grid(ScanPattern):
    """Beams at each azimuth and elevation of a grid: a flash or solid-state lidar; with one elevation, a 2D one.

    Columns fire in the given order, `column_period` apart; all rings of a column fire together. All frames are alike.

    Parameters
    ----------
    azimuths : array_like, shape (columns,)
        Azimuth of each column, rad, -2 pi to 2 pi, counter-clockwise seen from above.
    elevations : array_like, shape (rings,)
        Elevation of each ring, rad, -pi/2 to pi/2.
    rate : float
        Frames per second, Hz.
    column_period : float
        Time from one column to the next, s. 0, the default, is a flash: the whole frame fires at once.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape, is not finite, or the columns take longer than a frame.

    Examples
    --------
    >>> import numpy as np
    >>> from lidarsim.patterns import Grid
    >>> flash = Grid(np.radians(np.linspace(60, -60, 160)), np.radians(np.linspace(15, -15, 60)), rate=25.0)
    >>> len(flash.pulses()), flash.shape
    (9600, (60, 160))
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "azimuths_deg": list[float],
        "elevations_deg": list[float],
        "rate_hz": float,
        "column_period_us": float,
    }

    azimuths: Floats
    elevations: Floats
    rate: float
    column_period: float

    @explain_arguments
    def __init__(
        self, azimuths: npt.ArrayLike, elevations: npt.ArrayLike, *, rate: float, column_period: float = 0.0
    ) -> None:
        set_ = object.__setattr__
        set_(self, "azimuths", freeze(angles("azimuths", array("azimuths", azimuths, ("columns",)), at_most=TURN)))
        tilts = array("elevations", elevations, ("rings",))
        set_(self, "elevations", freeze(angles("elevations", tilts, at_most=TURN / 4)))
        rings("elevations", len(self.elevations), at_least=0)
        for name in ("azimuths", "elevations"):
            ask_order(name, getattr(self, name))
        set_(self, "rate", frequency("rate", rate))
        longest = 1.0 / self.rate / max(len(self.azimuths), 1)
        set_(self, "column_period", real("column_period", column_period, at_least=0.0, at_most=longest))

    @property
    def shape(self) -> tuple[int, int]:
        """Rings and columns of a frame."""
        return len(self.elevations), len(self.azimuths)

    def _fire_frame(self, _frame: int, /) -> Pulses:
        return self._pulses

    @cached_property
    def _pulses(self) -> Pulses:
        rows, columns = self.shape
        expect_room(rows * columns)
        column = np.repeat(np.arange(columns, dtype=np.uint32), rows)
        return Pulses(
            directions=directions_of(self.azimuths[:, None], self.elevations).reshape(-1, 3),
            origins=np.zeros((rows * columns, 3)),
            time=column.astype(np.float64) * self.column_period,
            ring=np.tile(np.arange(rows, dtype=np.uint16), columns),
            column=column,
        )
