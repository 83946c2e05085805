"""Full waveforms: the received power of pulses over range."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base.pickling import Pickled
from lidarsim._base.shown import extent, html_table, quantity, text_table
from lidarsim._base.validation import Floats, short_repr
from lidarsim._base.views import view
from lidarsim.errors import ArgumentTypeError

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike

HALF_SPEED_OF_LIGHT = 299_792_458.0 / 2.0
"""m/s; light travels a range twice."""

MARGIN = 6.0
"""Standard deviations of a Gaussian that are recorded; beyond, it is below half an ulp of a float32 of its peak."""


class Waveform(NamedTuple):
    """The waveform of one pulse."""

    range: Floats
    power: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Waveforms(Pickled):
    """Received power of m pulses over time, sampled as a full-waveform recorder does.

    ``waveforms[i]`` has two arrays: the `range` of each sample of the i-th waveform, m, and its `power`. A waveform
    begins and ends where the light of all surfaces and of the air that the pulse met has faded; a pulse that met
    nothing has no samples.

    Attributes
    ----------
    pulse : ndarray of int64, shape (m,)
        Index of each pulse in its scan.
    first : ndarray of int64, shape (m,)
        Number of the first sample of each waveform. Sample k is received k·`sample_period` after the peak of the pulse
        was emitted, from range c/2·k·`sample_period`. It may be negative: a pulse begins before its peak.
    offsets : ndarray of int64, shape (m + 1,)
        The i-th waveform is ``samples[offsets[i]:offsets[i + 1]]``.
    samples : ndarray of float32, shape (k,)
        Received power of all waveforms, one after another, 1/m². In this unit, the echo of a surface at normal
        incidence that the whole beam hits at range R has the peak ρ/R², where ρ is its reflectivity: intensity/R².
    sample_period : float
        Time between two samples, s.
    pulse_length : float
        Duration of the emitted pulse, full width at half maximum, s.

    Notes
    -----
    The waveform is the emitted pulse convolved with the cross-section of what the beam meets, as in W. Wagner et al.
    (Gaussian decomposition and calibration of a novel small-footprint full-waveform digitising airborne laser scanner,
    ISPRS J. 60, 2006): the sum over the sub-rays of the beam of a Gaussian each. The surfaces behind panes and in
    mirrors are part of it. The sum is that from which the scan takes its echoes (see `Beam`): the area of an isolated
    echo, divided by that of the emitted pulse of peak 1, is intensity/R², and its centroid is the range before errors.
    HELIOS++ (L. Winiwarter et al., Virtual laser scanning with HELIOS++, Remote Sensing of Environment 269, 2022) sums
    sub-rays alike, with the pulse (t/τ)²·exp(-t/τ).

    Fog adds the integral of its backscatter along the beam up to the surfaces, rain and snow the drops and flakes that
    the scan drew. Extinction weakens all of it. The waveform ends before the receiver: it has no range noise,
    fluctuation of power, detection limit, drop-out or false returns.

    Examples
    --------
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> leaf = scene.add(ls.Box((0.1, 9.0, 9.0), center=(8.05, 4.5, 0.0)))
    >>> wall = scene.add(ls.Plane((1, 0, 0), 10.0))
    >>> beam = ls.Beam(2e-3, pulse_length=4e-9)
    >>> lidar = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0), measurement=ls.Measurement(beam=beam))
    >>> waveforms = lidar.scan(scene).waveforms()
    >>> waveforms
    Waveforms of 1 pulse: 33 samples, one every 1 ns
      range  6.59543 … 11.3921 m
    >>> range, power = waveforms[0]
    >>> print(range[power.argmax()].round(3), power.max().round(5))
    7.945 0.00831
    """

    pulse: npt.NDArray[np.int64]
    first: npt.NDArray[np.int64]
    offsets: npt.NDArray[np.int64]
    samples: npt.NDArray[np.float32]
    sample_period: float
    pulse_length: float

    def __len__(self) -> int:
        """Return the number of pulses."""
        return len(self.pulse)

    def __getitem__(self, index: int) -> Waveform:
        """Return the ranges, m, and the power of the samples of a waveform."""
        try:
            i = operator.index(index)
        except TypeError:
            raise ArgumentTypeError("index", "the number of a waveform", short_repr(index)) from None
        if not -len(self) <= i < len(self):
            raise IndexError(f"index: expected -{len(self)} to {len(self) - 1}, got {i}")
        i %= len(self)
        power = self.samples[self.offsets[i] : self.offsets[i + 1]]
        return Waveform(self._step * (self.first[i] + np.arange(len(power))), power)

    def __iter__(self) -> Iterator[Waveform]:
        """Yield each waveform."""
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        """Return the number of pulses and samples, and the extent of their ranges."""
        return text_table(*self._facts())

    def _repr_html_(self) -> str:
        """Return a small HTML table for notebooks."""
        return html_table(*self._facts())

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        held = self.counts > 0
        ends = np.stack([self.first, self.first + self.counts - 1])[:, held] * self._step
        rows = [("range", f"{found} m") for found in [extent(ends)] if found]
        period = f"{self.sample_period * 1e9:g} ns"
        title = f"Waveforms of {quantity(len(self), 'pulse')}: {len(self.samples):,} samples, one every {period}"
        return title, rows

    @property
    def _step(self) -> float:
        return HALF_SPEED_OF_LIGHT * self.sample_period

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Number of samples of each waveform: ndarray of int64, shape (m,)."""
        return np.diff(self.offsets)

    @property
    def time(self) -> Floats:
        """Time of the first sample of each, s after the peak of its pulse was emitted: ndarray of float64, (m,)."""
        return self.first.astype(np.float64) * self.sample_period

    @property
    def emitted(self) -> Waveform:
        """The emitted pulse, of peak 1 at range 0, sampled alike: two arrays as those of a waveform."""
        sigma = HALF_SPEED_OF_LIGHT * self.pulse_length / np.sqrt(8.0 * np.log(2.0))
        most = int(MARGIN * sigma / self._step)
        reach = self._step * np.arange(-most, most + 1, dtype=np.float64)
        return Waveform(reach, np.exp(-0.5 * (reach / sigma) ** 2).astype(np.float32))

    def save(self, path: PathLike) -> None:
        """Write a NumPy archive: one array for each attribute, under its name.

        Parameters
        ----------
        path : path-like
            The file, ``.npz``.

        Raises
        ------
        FileFormatError
            If the suffix is another.
        OSError
            If the file cannot be written.
        """
        view(Waveforms, "to_npz")(self, path)

    @classmethod
    def load(cls, path: PathLike) -> Waveforms:
        """Read a file that `save` wrote.

        Parameters
        ----------
        path : path-like
            The file, ``.npz``.

        Returns
        -------
        Waveforms
            The same arrays.

        Raises
        ------
        FileFormatError
            If the suffix is another, or the file is damaged or holds other arrays.
        OSError
            If the file cannot be read.
        """
        loaded: Waveforms = view(Waveforms, "from_npz")(path)
        return loaded
