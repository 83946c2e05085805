"""Pulses from a list."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.files import PathLike, check_path, check_regular, format_error, load_array
from lidarsim._base.lines import cells
from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, angles, array, freeze, frequency, nonzero_vectors
from lidarsim.errors import ArgumentValueError, FileFormatError
from lidarsim.patterns._parts import TURN, directions_of, per_channel, unit
from lidarsim.patterns._pulses import Pulses, ScanPattern


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Table(ScanPattern):
    """Pulses from a list: a measured pattern, or one that no other class describes.

    The times divide the list into frames: frame `k` takes the pulses from ``k / rate`` to ``(k + 1) / rate``. After the
    frame of the last time, the list repeats.

    Parameters
    ----------
    directions : array_like, shape (n, 3)
        Directions of the pulses, of any length but 0.
    times : float or array_like, shape (n,)
        Firing times since the start of the list, s, in any order. Default: all fire together at the start of each
        frame.
    rings : int or array_like, shape (n,)
        Channel of each pulse, 0 to 65,535; kept as uint16.
    columns : array_like, shape (n,), optional
        Column of each pulse in its frame, kept as uint32. Default: the number of earlier pulses of its ring there.
    origins : array_like, shape (n, 3) or (3,), optional
        Where each beam leaves the sensor, m. Default: the sensor's origin.
    rate : float
        Frames per second, Hz.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape, is not finite or is out of its range, or there are no pulses.

    Examples
    --------
    >>> import numpy as np
    >>> from lidarsim.patterns import Table
    >>> pattern = Table([[1, 0, 0], [1, 1, 0], [1, 2, 0]], times=[0.0, 0.05, 0.1], rate=10.0)
    >>> [len(pattern.pulses(frame)) for frame in range(4)]
    [2, 1, 2, 1]
    """

    directions: Floats
    times: Floats
    rings: npt.NDArray[np.uint16]
    columns: npt.NDArray[np.uint32] | None
    origins: Floats
    rate: float

    @explain_arguments
    def __init__(
        self,
        directions: npt.ArrayLike,
        *,
        times: npt.ArrayLike = 0.0,
        rings: npt.ArrayLike = 0,
        columns: npt.ArrayLike | None = None,
        origins: npt.ArrayLike | None = None,
        rate: float,
    ) -> None:
        set_ = object.__setattr__
        vectors = nonzero_vectors("directions", array("directions", directions, ("n", 3)))
        count = len(vectors)
        if not count:
            raise ArgumentValueError("directions", "at least one pulse", "none")
        set_(self, "directions", freeze(unit(vectors)))
        set_(self, "times", per_channel("times", times, count))
        if (self.times < 0.0).any():
            first = int(np.argmax(self.times < 0.0))
            raise ArgumentValueError("times", "times >= 0", f"times[{first}] = {self.times[first]:g}")
        set_(self, "rings", _indices("rings", rings, count, np.uint16))
        set_(self, "columns", None if columns is None else _indices("columns", columns, count, np.uint32))
        set_(self, "origins", per_channel("origins", np.zeros(3) if origins is None else origins, count, width=3))
        set_(self, "rate", frequency("rate", rate))
        last = float(self.times.max())
        if last / 2.0**53 * self.rate >= 1.0:  # each frame has its float64
            raise ArgumentValueError("times", f"fewer than {2**53} frames at {self.rate:g} Hz", f"{last:g} s")

    @classmethod
    def from_file(cls, path: PathLike, *, rate: float, pulse_rate: float | None = None) -> Table:
        """Return the pattern that a CSV or NPY file lists.

        Parameters
        ----------
        path : path-like
            An NPY file of shape (n, 3), directions, or (n, 2), azimuths and elevations in rad; or a CSV file whose
            first line names its columns: ``x, y, z`` or ``azimuth_deg, elevation_deg`` or ``azimuth_rad,
            elevation_rad``, and optionally ``time_s``, ``ring`` and ``column``.
        rate : float
            Frames per second, Hz.
        pulse_rate : float, optional
            Pulses per second, Hz, for a file without times: pulse i fires at ``i / pulse_rate``. Default: all fire
            together.

        Returns
        -------
        Table
            The pattern.

        Raises
        ------
        FileFormatError
            If the file cannot be read or is not such a table.
        """
        path = check_path(path)
        if path.suffix.lower() not in (".csv", ".npy"):
            raise FileFormatError(f"{path}: expected a .csv or .npy file")
        try:
            check_regular(path)
            if path.suffix.lower() == ".npy":
                columns = _npy_columns(path)
            else:
                columns = columns_of(path.read_text(encoding="utf-8-sig").splitlines())
            return cls._from_columns(columns, rate, pulse_rate)
        except OSError as error:
            raise FileFormatError(f"{path}: cannot read the file: {error.strerror or error}") from None
        except FileFormatError:
            raise
        except (TypeError, ValueError) as error:
            raise FileFormatError(f"{path}: {format_error(error)}") from None

    @classmethod
    def _from_columns(cls, columns: dict[str, Floats], rate: float, pulse_rate: float | None) -> Table:
        names = next((names for names in _DIRECTIONS if columns.keys() >= set(names)), None)
        if names is None:
            wanted = " or ".join(", ".join(names) for names in _DIRECTIONS)
            raise ValueError(f"expected columns {wanted}, got others")
        known = [*names, "time_s", "ring", "column"]
        for number, name in enumerate(columns, 1):
            if name not in known:
                raise ValueError(f"column {number}: expected one of {', '.join(known)}, got another")
        if "time_s" in columns and pulse_rate is not None:
            raise ArgumentValueError("pulse_rate", "none with the column time_s", repr(pulse_rate))
        if "elevation_rad" in names:
            angles("azimuth_rad", columns["azimuth_rad"], at_most=TURN)
            angles("elevation_rad", columns["elevation_rad"], at_most=TURN / 4)
        directions = _DIRECTIONS[names](*(array(name, columns[name], "n") for name in names))
        times: Floats | float = columns.get("time_s", 0.0)
        if pulse_rate is not None:
            times = np.arange(len(directions)) / frequency("pulse_rate", pulse_rate)
        return cls(directions, times=times, rings=columns.get("ring", 0), columns=columns.get("column"), rate=rate)

    @property
    def shape(self) -> tuple[int, int]:
        """Rings, and most columns of a frame."""
        return int(self.rings.max()) + 1, self._width

    def _fire_frame(self, frame: int, /) -> Pulses:
        order, frames = self._order
        part = frame % (int(frames[-1]) + 1)
        chosen = order[slice(*np.searchsorted(frames, (part, part + 1)))]
        rings = self.rings[chosen]
        return Pulses(
            directions=self.directions[chosen],
            origins=self.origins[chosen],
            time=np.maximum(self.times[chosen] - part / self.rate, 0.0),
            ring=rings,
            column=_ranks(rings) if self.columns is None else self.columns[chosen],
        )

    @cached_property
    def _order(self) -> tuple[npt.NDArray[np.intp], Floats]:
        """The pulses in firing order, and the frame of each."""
        order = np.lexsort((self.rings, self.times))
        return order, np.floor(self.times[order] * self.rate)

    @cached_property
    def _width(self) -> int:
        """Most columns of a frame."""
        if self.columns is not None:
            return int(self.columns.max()) + 1
        order, frames = self._order
        _, parts = np.unique(frames, return_inverse=True)
        _, counts = np.unique(parts * 2**16 + self.rings[order], return_counts=True)
        return int(counts.max())


def _ranks(rings: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint32]:
    """Return for each entry the number of earlier entries of the same ring."""
    order = np.argsort(rings, kind="stable")
    ranks = np.empty(len(rings), np.uint32)
    ranks[order] = np.arange(len(rings)) - np.searchsorted(rings[order], rings[order])
    return ranks


def _indices(name: str, value: npt.ArrayLike, count: int, dtype: type[np.unsignedinteger]) -> npt.NDArray[Any]:
    """Return `value`, one number or one per pulse, as a read-only array of `count` whole numbers that fit `dtype`."""
    values = per_channel(name, value, count)
    largest = np.iinfo(dtype).max
    wrong = (values != np.floor(values)) | (values < 0) | (values > largest)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise ArgumentValueError(name, f"whole numbers from 0 to {largest}", f"{name}[{first}] = {values[first]:g}")
    indices = values.astype(dtype)
    indices.setflags(write=False)
    return indices


def columns_of(lines: Sequence[str]) -> dict[str, Floats]:
    """Return the columns of numbers in the lines of a CSV file by the names in the first line.

    Raises
    ------
    ValueError
        If the lines are not such a table. The message shows nothing of them, which may be those of any file.
    """
    names = [name.lower() for name in cells(lines[0])] if lines else []
    if len(lines) < 2:
        raise ValueError("expected a line of names and lines of numbers, got no numbers")
    values = number_rows(lines[1:], first=2)
    if len(names) != values.shape[1] or len(set(names)) < len(names):
        raise ValueError(f"expected {values.shape[1]} different names in the first line, got {len(set(names))}")
    return dict(zip(names, values.T, strict=True))


def number_rows(lines: Sequence[str], *, first: int = 1) -> Floats:
    """Return the numbers in lines that commas divide, shape (lines, columns); `first` is the number of the first line.

    Raises
    ------
    ValueError
        If a line holds something else, or has fewer or more numbers than the first one.
    """
    if not any(map(str.strip, lines)):
        raise ValueError("expected lines of numbers, got none")
    try:
        return np.loadtxt(lines, delimiter=",", ndmin=2, comments=None, quotechar='"')
    except ValueError:
        width = 0
        for number, line in enumerate(lines, first):
            texts = cells(line) if line.strip() else []
            width = width or len(texts)
            if texts and len(texts) != width:
                raise ValueError(f"line {number}: expected {width} numbers, got {len(texts)}") from None
            if not all(map(_is_number, texts)):
                raise ValueError(f"line {number}: expected numbers, got something else") from None
        raise ValueError("expected lines of numbers, got something else") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _npy_columns(path: Path) -> dict[str, Floats]:
    values = load_array(path)
    if values.ndim != 2 or values.shape[1] not in (2, 3) or values.dtype.kind not in "fiu":
        raise ValueError(f"expected numbers of shape (n, 3) or (n, 2), got {values.dtype} of shape {values.shape}")
    names = ("x", "y", "z") if values.shape[1] == 3 else ("azimuth_rad", "elevation_rad")
    return dict(zip(names, values.T.astype(np.float64), strict=True))


_DIRECTIONS: dict[tuple[str, ...], Callable[..., Floats]] = {
    ("x", "y", "z"): lambda *components: np.stack(components, axis=-1),
    ("azimuth_deg", "elevation_deg"): lambda *angles: directions_of(*np.radians(angles)),
    ("azimuth_rad", "elevation_rad"): directions_of,
}
