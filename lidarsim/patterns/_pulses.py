"""The pulses of a frame, and the protocol of scan patterns."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
import numpy.typing as npt

from lidarsim._base.pickling import Immutable, Value
from lidarsim._base.shown import extent
from lidarsim._base.validation import array, frequency, in_order, integer, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError


class _OfOneOrigin(Immutable):
    """Base of `Pulses`, with what is not an array."""

    __slots__ = ("__weakref__", "_origin")

    _origin: tuple[float, ...] | None
    """Common origin of all pulses, or None. With a common origin, scans do not read `origins`."""


@dataclass(frozen=True, slots=True, eq=False)
class Pulses(_OfOneOrigin):
    """The pulses of one frame, in the sensor frame (x forward, y left, z up) and in firing order.

    Arguments are converted to NumPy arrays. The arrays are read-only, so a pattern whose frames are all alike can
    return the same pulses for each frame. Arrays that already have the right type are shared, not copied; only origins
    that are all equal are copied. The caller's arrays remain writable.

    Parameters
    ----------
    directions : array_like, shape (n, 3)
        Unit direction of each pulse, kept as float64.
    origins : array_like, shape (n, 3)
        Where each pulse leaves the sensor, m, kept as float64.
    time : array_like, shape (n,)
        Firing time since the start of the frame, s, kept as float64.
    ring : array_like of int, shape (n,)
        Channel that fires, 0 to 65,535, kept as uint16.
    column : array_like of int, shape (n,)
        Column (firing cycle) of the frame, 0 to 2³² − 1, kept as uint32.

    Raises
    ------
    TypeError, ValueError
        If an argument does not hold numbers or has the wrong shape, a time is not finite, or a ring or column is not
        an integer in its range. Lengths of directions and finiteness of origins are checked when the pulses are fired.

    Examples
    --------
    >>> from lidarsim.patterns import Pulses
    >>> pulses = Pulses([[1, 0, 0], [0, 1, 0]], [[0, 0, 0]] * 2, time=[0, 1e-5], ring=[0, 0], column=[0, 1])
    >>> pulses.ring.dtype, len(pulses)
    (dtype('uint16'), 2)
    """

    directions: npt.NDArray[np.float64]
    origins: npt.NDArray[np.float64]
    time: npt.NDArray[np.float64]
    ring: npt.NDArray[np.uint16]
    column: npt.NDArray[np.uint32]

    def __post_init__(self) -> None:
        """Check and convert the arguments."""
        directions = array("directions", self.directions, ("n", 3), finite=False)
        count = len(directions)
        origins = array("origins", self.origins, (count, 3), finite=False)
        same = count > 0 and bool((origins == origins[0]).all())
        converted = {
            "directions": directions,
            "origins": origins.copy() if same else origins,  # `_origin` must stay true if the caller changes them
            "time": array("time", self.time, (count,)),
            "ring": _check_numbers("ring", self.ring, count, np.uint16),
            "column": _check_numbers("column", self.column, count, np.uint32),
        }
        object.__setattr__(self, "_origin", tuple(origins[0].tolist()) if same else None)
        for name, values in converted.items():
            shared = values.view()
            shared.setflags(write=False)
            object.__setattr__(self, name, shared)

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        return cls(**contents)

    @property
    def azimuth(self) -> npt.NDArray[np.float64]:
        """Azimuth of each pulse, counterclockwise from x, -π to π rad: ndarray of float64, shape (n,)."""
        x, y, _ = np.ascontiguousarray(self.directions.T)
        azimuth: npt.NDArray[np.float64] = np.arctan2(y, x)
        return azimuth

    @property
    def elevation(self) -> npt.NDArray[np.float64]:
        """Elevation of each pulse above the x-y plane, -π/2 to π/2 rad: ndarray of float64, shape (n,)."""
        elevation: npt.NDArray[np.float64] = np.arcsin(np.clip(self.directions[:, 2], -1.0, 1.0))
        return elevation

    def __len__(self) -> int:
        return len(self.directions)

    def __repr__(self) -> str:
        """Return the number of pulses, rings and columns, and the time span."""
        rings, columns = (len(np.unique(numbers)) for numbers in (self.ring, self.column))
        return f"Pulses({len(self):,} of {rings:,} rings and {columns:,} columns, time {extent(self.time)} s)"


def make_pulses(
    directions: npt.NDArray[np.float64],
    origins: npt.NDArray[np.float64],
    time: npt.NDArray[np.float64],
    ring: npt.NDArray[np.uint16],
    column: npt.NDArray[np.uint32],
    *,
    origin: tuple[float, ...] | None,
) -> Pulses:
    """Return pulses of read-only arrays that a pattern has made as `Pulses` describes them, without checks.

    `origin` is that of all pulses, if they have one.
    """
    made = Pulses.__new__(Pulses)
    set_ = object.__setattr__
    set_(made, "_origin", origin)
    set_(made, "directions", directions)
    set_(made, "origins", origins)
    set_(made, "time", time)
    set_(made, "ring", ring)
    set_(made, "column", column)
    return made


def _check_numbers(name: str, value: Any, count: int, dtype: type[np.unsignedinteger[Any]]) -> npt.NDArray[Any]:
    """Return `value` as a C-contiguous array of `count` integers that fit `dtype`."""
    if isinstance(value, np.ndarray) and value.dtype == dtype and value.shape == (count,):
        return in_order(value, dtype)
    given = array(name, value, (count,), finite=False)
    most = np.iinfo(dtype).max
    wrong = ~((given >= 0) & (given <= most) & (given == np.floor(given)))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ArgumentValueError(name, f"integers from 0 to {most}", f"{name}[{i}] = {given[i]:g}")
    return given.astype(dtype)


@runtime_checkable
class Pattern(Protocol):
    """A scan pattern: any object that returns the pulses of a frame.

    Attributes
    ----------
    rate : float
        Frames per second, Hz. Frame k starts k/rate after frame 0.
    shape : tuple of int
        Rings and columns of a frame.
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
        ...


class ScanPattern(Value):
    """Base of the patterns of this package."""

    __slots__ = ()

    def pulses(self, frame: int = 0) -> Pulses:
        """Return the pulses of a frame.

        Parameters
        ----------
        frame : int
            Its number, >= 0.

        Returns
        -------
        Pulses
            In firing order; those that fire together are in the order of their rings.

        Raises
        ------
        TypeError, ValueError
            If `frame` is not an integer >= 0.
        """
        return self._fire_frame(integer("frame", frame, at_least=0))

    def _fire_frame(self, frame: int, /) -> Pulses:
        """Return the pulses of a frame, whose number was checked."""
        raise NotImplementedError


def check_pattern(pattern: object) -> None:
    """Check that an object is a scan pattern. The pulses of a frame are checked when they are fired.

    Raises
    ------
    TypeError, ValueError
        If it has no `rate`, `shape` or `pulses`, its rate is not a number > 0, or its shape not two integers >= 0.
    """
    if not isinstance(pattern, Pattern) or isinstance(pattern, type):
        hint = "Lidar.preset(name) makes a sensor" if isinstance(pattern, str) else ""
        raise ArgumentTypeError("pattern", "a scan pattern (rate, shape, pulses)", short_repr(pattern), hint)
    frequency("pattern.rate", pattern.rate)
    shape = pattern.shape
    if not isinstance(shape, tuple | list) or len(shape) != 2:
        raise ArgumentTypeError("pattern.shape", "(rings, columns)", short_repr(shape))
    for count in shape:
        integer("pattern.shape", count, at_least=0)


def pulses_of(pattern: Pattern, frame: int) -> Pulses:
    """Return the pulses of a frame of any pattern, checked and converted from any object with the same attributes.

    Raises
    ------
    TypeError, ValueError
        If the pattern returns something else, or arrays that are not such pulses.
    """
    given: Any = pattern.pulses(frame)
    if isinstance(given, Pulses):
        return given
    names = [field.name for field in fields(Pulses)]
    missing = [name for name in names if not hasattr(given, name)]
    if missing:
        raise ArgumentTypeError(
            "pattern.pulses", f"Pulses, with {', '.join(names)}", f"{type(given).__name__} without {missing[0]}"
        )
    return Pulses(*(getattr(given, name) for name in names))
