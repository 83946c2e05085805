"""What a scan pattern gives: the pulses of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True, eq=False)
class Pulses:
    """The pulses of one frame, in the sensor frame (x forward, y left, z up) and in firing order.

    The arrays are read-only: a pattern whose frames are all alike gives the same ones for each.

    Attributes
    ----------
    directions : ndarray of float64, shape (n, 3)
        Unit direction of each beam.
    origins : ndarray of float64, shape (n, 3)
        Where each beam leaves the sensor, m.
    time : ndarray of float64, shape (n,)
        Firing time since the start of the frame, s.
    ring : ndarray of uint16, shape (n,)
        Channel that fired.
    column : ndarray of uint32, shape (n,)
        Column (firing cycle) of the frame.
    """

    directions: npt.NDArray[np.float64]
    origins: npt.NDArray[np.float64]
    time: npt.NDArray[np.float64]
    ring: npt.NDArray[np.uint16]
    column: npt.NDArray[np.uint32]

    def __post_init__(self) -> None:
        """Check the arguments."""
        for values in (self.directions, self.origins, self.time, self.ring, self.column):
            values.setflags(write=False)

    def __len__(self) -> int:
        return len(self.directions)


@runtime_checkable
class Pattern(Protocol):
    """A scan pattern: anything that says which pulses a frame fires.

    Attributes
    ----------
    rate : float
        Frames per second, Hz. Frame k starts k/rate after frame 0.
    shape : tuple of int
        Rings and columns of a frame, the shape of its range image.
    """

    @property
    def rate(self) -> float:
        """Frames per second, Hz."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """Rings and columns of a frame."""
        ...

    def pulses(self, frame: int = 0) -> Pulses:
        """Return the pulses of a frame.

        Parameters
        ----------
        frame : int
            Its number, from 0 on.

        Returns
        -------
        Pulses
            In firing order.
        """
        ...
