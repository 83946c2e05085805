"""Statistics that are functions of sums, so that frames stream and a bootstrap only resamples sums.

A measure gives samples. Each belongs to a cell, such as a bin of range, and to a block of columns of its frame. A
`Summary` adds them up to sums for each block and cell, and computes a value for each cell from sums. Resampling blocks
with replacement, which is what the bootstrap does, is then a matrix product with the sums.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats

Indices = npt.NDArray[np.intp]

BLOCKS = 16
"""Blocks of columns in a frame."""
FEW = 16
"""Most frames whose blocks are resampled one by one; of more frames, whole frames are."""
MOST = 128
"""Even number of units at which two units in a row become one."""
FEWEST_UNITS = 4
"""Fewest units with samples that tell an error."""
RESAMPLES = 400
LEVEL = 0.95
KEPT = 0.8
"""Share of the samples that tell a standard deviation."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of a measure in a frame.

    Attributes
    ----------
    cell, block : ndarray of int, shape (m,)
        Cell and block of each sample. Samples of negative cells are left out.
    value : ndarray of float64, shape (m,)
        The samples; of a `Share` unused.
    weight : ndarray of float64, shape (m,), or None
        Weights; None: 1 each.
    other : ndarray of float64, shape (m,), or None
        The abscissas of a `Slope`.
    """

    cell: Indices
    block: Indices
    value: Floats
    weight: Floats | None = None
    other: Floats | None = None


class Summary(ABC):
    """How samples become sums, and sums a value and a number of samples for each cell."""

    @abstractmethod
    def sums(self, samples: Samples, cells: int) -> Floats:
        """Return the sums of each block and cell, shape (BLOCKS, cells, k)."""

    @abstractmethod
    def value(self, sums: Floats) -> Floats:
        """Return the value of each cell, shape (..., cells), from sums of shape (..., cells, k)."""

    def count(self, sums: Floats) -> Floats:
        """Return the number of samples of each cell, shape (..., cells): the first of its sums."""
        return sums[..., 0]

    def error(self, sums: Floats) -> Floats:
        """Return the least standard error of each value that its number of samples allows, shape (cells,).

        It is 0 where only the bootstrap knows.
        """
        return np.zeros(len(sums))


def _sum(samples: Samples, cells: int, columns: list[Floats]) -> Floats:
    """Return sums of weighted columns, shape (BLOCKS, cells, columns)."""
    chosen = samples.cell >= 0
    place = samples.block[chosen] * cells + samples.cell[chosen]
    parts = [np.bincount(place, column[chosen], BLOCKS * cells) for column in columns]
    sums: Floats = np.stack(parts, axis=-1).reshape(BLOCKS, cells, len(columns)).astype(np.float64, copy=False)
    return sums


def _ratio(above: Floats, below: Floats) -> Floats:
    """Return a quotient, nan where there is nothing to divide by."""
    quotient: Floats = np.divide(above, below, out=np.full(np.broadcast(above, below).shape, np.nan), where=below > 0)
    return quotient


class Mean(Summary):
    """Weighted mean."""

    def sums(self, samples: Samples, cells: int) -> Floats:
        """Return number, weights, and weighted samples."""
        one = np.ones(len(samples.cell))
        weight = one if samples.weight is None else samples.weight
        return _sum(samples, cells, [one, weight, weight * samples.value])

    def value(self, sums: Floats) -> Floats:
        """Return the mean."""
        return _ratio(sums[..., 2], sums[..., 1])


class Rate(Mean):
    """Share of samples that are 1 among samples that are 0 or 1."""

    def error(self, sums: Floats) -> Floats:
        """Return the binomial standard error, with half a success and half a failure more, so that 0 of n has one."""
        share = (sums[..., 2] + 0.5) / (sums[..., 1] + 1.0)
        return np.sqrt(share * (1.0 - share) / (sums[..., 1] + 1.0))


class Share(Summary):
    """Share of all samples that a cell has."""

    def sums(self, samples: Samples, cells: int) -> Floats:
        """Return the number of samples."""
        return _sum(samples, cells, [np.ones(len(samples.cell))])

    def value(self, sums: Floats) -> Floats:
        """Return the part that each cell has of all."""
        return _ratio(sums[..., 0], sums[..., 0].sum(axis=-1, keepdims=True))

    def count(self, sums: Floats) -> Floats:
        """Return the number of samples of all cells: a cell without any has a share of 0."""
        total: Floats = sums[..., 0].sum(axis=-1, keepdims=True)
        return np.broadcast_to(total, sums.shape[:-1])

    def error(self, sums: Floats) -> Floats:
        """Return the binomial standard error."""
        total = sums[..., 0].sum()
        share = (sums[..., 0] + 0.5) / (total + 1.0)
        error: Floats = np.sqrt(share * (1.0 - share) / (total + 1.0))
        return error


class Slope(Summary):
    """Angle of a regression line, rad: arctan of the slope of the samples over their abscissas."""

    def sums(self, samples: Samples, cells: int) -> Floats:
        """Return the moments up to the second that a regression needs."""
        x, y = np.zeros(0) if samples.other is None else samples.other, samples.value
        return _sum(samples, cells, [np.ones(len(y)), x, y, x * x, x * y])

    def value(self, sums: Floats) -> Floats:
        """Return the angle; nan where all abscissas are equal to within the rounding of the sums."""
        n, x, y, xx, xy = np.moveaxis(sums, -1, 0)
        spread = n * xx - x * x
        # Sums of n positive terms are off by n ulp at most, products of sums by about twice that.
        known = spread > 2.0 * n * np.finfo(np.float64).eps * n * xx
        return np.arctan(_ratio(n * xy - x * y, np.where(known, spread, 0.0)))


@dataclass(frozen=True)
class Histogram(Summary):
    """A statistic of the distribution of the samples, from their histogram.

    Attributes
    ----------
    edges : ndarray of float64, shape (bins + 1,)
        Edges of the bins. Samples beyond the ends count into the first and the last bin.
    statistic : callable
        ``statistic(centres, counts)`` returns the value for counts of shape (..., bins).
    """

    edges: Floats
    statistic: Callable[[Floats, Floats], Floats]

    @property
    def _bins(self) -> int:
        return len(self.edges) - 1

    def sums(self, samples: Samples, cells: int) -> Floats:
        """Return the number of samples in each bin."""
        chosen = samples.cell >= 0
        place = np.clip(np.searchsorted(self.edges, samples.value[chosen], "right") - 1, 0, self._bins - 1)
        place += (samples.block[chosen] * cells + samples.cell[chosen]) * self._bins
        weight = None if samples.weight is None else samples.weight[chosen]
        counts = np.bincount(place, weight, BLOCKS * cells * self._bins)
        return counts.reshape(BLOCKS, cells, self._bins).astype(np.float64)

    def value(self, sums: Floats) -> Floats:
        """Return the statistic."""
        return self.statistic(0.5 * (self.edges[1:] + self.edges[:-1]), sums)

    def count(self, sums: Floats) -> Floats:
        """Return the number of samples."""
        counts: Floats = sums.sum(axis=-1)
        return counts


class Divergence(Histogram):
    """The distribution of the samples, which is held against that of the other side; see `divergence`."""

    def __init__(self, edges: Floats) -> None:
        super().__init__(edges, quantile(0.5))


def trimmed_mean(low: float, high: float) -> Callable[[Floats, Floats], Floats]:
    """Return the mean of the samples between two quantiles, as a statistic of a histogram."""

    def statistic(centres: Floats, counts: Floats) -> Floats:
        total = counts.sum(axis=-1, keepdims=True)
        up_to = np.clip(np.cumsum(counts, axis=-1), low * total, high * total)
        inside = np.diff(up_to, prepend=low * total)
        return _ratio(inside @ centres, inside.sum(axis=-1))

    return statistic


def robust_sigma(centres: Floats, counts: Floats) -> Floats:
    """Return the standard deviation of a centred normal distribution from the histogram of absolute samples.

    It is the root mean square of the smallest samples, the share `KEPT` of them, over what that is for a standard
    normal distribution: with z the quantile at (1 + `KEPT`)/2 and φ the density, ∫ t² φ(t) dt from −z to z is
    `KEPT` − 2 z φ(z). The largest samples, which come from edges, do not count.
    """
    normal = NormalDist()
    z = normal.inv_cdf(0.5 * (1.0 + KEPT))
    inside = (KEPT - 2.0 * z * normal.pdf(z)) / KEPT
    return np.sqrt(trimmed_mean(0.0, KEPT)(centres * centres, counts) / inside)


def quantile(share: float) -> Callable[[Floats, Floats], Floats]:
    """Return a quantile as a statistic of a histogram, linear within the bin."""

    def statistic(centres: Floats, counts: Floats) -> Floats:
        total = counts.sum(axis=-1)
        up_to = np.cumsum(counts, axis=-1)
        i = np.minimum((up_to < (share * total)[..., None]).sum(axis=-1), len(centres) - 1)
        here = np.take_along_axis(counts, i[..., None], -1)[..., 0]
        before = np.take_along_axis(up_to, i[..., None], -1)[..., 0] - here
        width = centres[1] - centres[0]
        found = centres[i] + (_ratio(share * total - before, here) - 0.5) * width
        return np.where(total > 0, found, np.nan)

    return statistic


@dataclass(frozen=True)
class Step(Summary):
    """Largest candidate step that divides all samples, up to a common offset; 0 if there is none.

    For samples x and a step q the mean of exp(2πi x/q) is of length 1 if all x are multiples of q, and near 0 if they
    have no such step.

    Attributes
    ----------
    steps : ndarray of float64, shape (k,)
        The steps, rising.
    """

    steps: Floats

    def sums(self, samples: Samples, cells: int) -> Floats:
        """Return number, and cosine and sine for each step."""
        turns = 2.0 * math.pi * np.mod(samples.value[:, None] / self.steps, 1.0)
        columns = [np.ones(len(turns)), *np.cos(turns).T, *np.sin(turns).T]
        return _sum(samples, cells, columns)

    def value(self, sums: Floats) -> Floats:
        """Return the greatest step whose mean is longer than half."""
        n, k = sums[..., 0], len(self.steps)
        length = np.hypot(sums[..., 1 : k + 1], sums[..., k + 1 :])
        found = np.where(length > 0.5 * n[..., None], self.steps, 0.0).max(axis=-1)
        return np.where(n > 0, found, np.nan)


class Units:
    """The sums of a measure on one side, for each unit that the bootstrap resamples.

    A unit is a block of columns; of more than `FEW` frames, a frame or several in a row.
    """

    def __init__(self) -> None:
        self._units: list[Floats] = []
        self._frames = 0
        self._span, self._open = 1, 0  # frames in a unit, and in the last one

    def add(self, sums: Floats) -> None:
        """Add the sums of a frame, shape (BLOCKS, cells, k)."""
        self._frames += 1
        if self._frames <= FEW:
            self._units += list(sums)
            return
        if self._frames == FEW + 1:
            self._units = [_total(part) for part in _parts(self._units, BLOCKS)]
            self._open = 1
        if self._open < self._span:
            self._units[-1] = _total([self._units[-1], sums.sum(axis=0)])
            self._open += 1
        else:
            self._units.append(sums.sum(axis=0))
            self._open = 1
        if len(self._units) == MOST and self._open == self._span:
            self._units = [_total(part) for part in _parts(self._units, 2)]
            self._span *= 2
            self._open = self._span

    def sums(self, cells: int) -> Floats:
        """Return the sums of all units, shape (units, cells, k)."""
        return np.stack([_pad(unit, cells) for unit in self._units])

    @property
    def cells(self) -> int:
        """Number of cells that any unit has."""
        return max((len(unit) for unit in self._units), default=0)

    def __len__(self) -> int:
        return len(self._units)


def _parts(units: list[Floats], length: int) -> Iterator[list[Floats]]:
    for start in range(0, len(units), length):
        yield units[start : start + length]


def _total(units: list[Floats]) -> Floats:
    cells = max(map(len, units))
    return np.sum([_pad(unit, cells) for unit in units], axis=0)  # type: ignore[no-any-return]


def _pad(unit: Floats, cells: int) -> Floats:
    return unit if len(unit) == cells else np.pad(unit, ((0, cells - len(unit)), (0, 0)))


@dataclass(frozen=True, slots=True)
class Estimate:
    """What one side tells of a measure, for each cell.

    Attributes
    ----------
    value, count, units : ndarray of float64, shape (cells,)
        Value, number of samples, and number of units with samples.
    resampled : ndarray of float64, shape (RESAMPLES, cells)
        Values of the resampled units.
    error, floor : ndarray of float64, shape (cells,)
        Standard error, and the least that the number of samples allows.
    """

    value: Floats
    count: Floats
    units: Floats
    resampled: Floats
    error: Floats
    floor: Floats

    def has(self, samples: int) -> npt.NDArray[np.bool_]:
        """Return which cells have so many samples, in `FEWEST_UNITS`: shape (cells,)."""
        enough: npt.NDArray[np.bool_] = (self.count >= samples) & (self.units >= FEWEST_UNITS)
        return enough

    def interval(self, cell: int) -> tuple[float, float]:
        """Return the interval of a cell at the level `LEVEL`."""
        return interval(self.resampled[:, cell])


def interval(resampled: Floats) -> tuple[float, float]:
    """Return the percentile interval of resampled values at the level `LEVEL`; nan if there are none."""
    known = resampled[np.isfinite(resampled)]
    if not known.size:
        return math.nan, math.nan
    low, high = np.quantile(known, (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL))
    return float(low), float(high)


def estimate(summary: Summary, units: Units, cells: int, seed: int) -> Estimate:
    """Return the values of one side and their bootstrap distribution; the seed makes it repeatable."""
    sums = units.sums(cells)
    with_data = (summary.count(sums) > 0).sum(axis=0).astype(np.float64)
    told = with_data > 0  # all others stay nan
    sums = sums[:, told]
    n, total = len(sums), sums.sum(axis=0)
    weights = np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES).astype(np.float64)
    resampled = summary.value((weights @ sums.reshape(n, -1)).reshape(RESAMPLES, *sums.shape[1:]))
    result = Estimate(
        value=np.full(cells, np.nan),
        count=np.zeros(cells),
        units=with_data,
        resampled=np.full((RESAMPLES, cells), np.nan),
        error=np.full(cells, np.nan),
        floor=np.full(cells, np.nan),
    )
    result.value[told], result.count[told] = summary.value(total), summary.count(total)
    result.resampled[:, told], result.floor[told] = resampled, summary.error(total)
    result.error[told] = np.maximum(_spread(resampled, with_data[told]), result.floor[told])
    return result


def error_of_difference(one: Estimate, other: Estimate) -> Floats:
    """Return the standard error of the difference of two estimates.

    If both have as many units and were resampled with the same seed, so are pairs of units, and what units have in
    common, as the same walls in a block of columns, does not count. Pairs of unrelated units are resampled as rightly.
    """
    spread = _spread(other.resampled - one.resampled, np.minimum(one.units, other.units))
    return np.maximum(spread, np.hypot(one.floor, other.floor))


def divergence(one: Units, other: Units, seed: int) -> tuple[Estimate, Estimate]:
    """Return by how much the distribution of one side diverges from its own, drawn again, and that of the other side.

    Divergences are those of Jensen and Shannon, in bits, of the histograms of all units (J. Lin, Divergence measures
    based on the Shannon entropy, IEEE Trans. Inf. Theory 37, 1991). Chance alone makes them greater than 0, by as much
    as the first estimate says.
    """
    rng = np.random.default_rng(seed)
    sums = [units.sums(1)[:, 0] for units in (one, other)]
    first, again, theirs = (
        rng.multinomial(len(part), np.full(len(part), 1.0 / len(part)), size=RESAMPLES).astype(np.float64) @ part
        for part in (sums[0], *sums)
    )
    chance, found = jensen_shannon(first, again), jensen_shannon(first, theirs)
    values = float(np.mean(chance)), float(jensen_shannon(sums[0].sum(axis=0), sums[1].sum(axis=0)))
    estimates = []
    for part, value, resampled in zip(sums, values, (chance, found), strict=True):
        n = part.sum(axis=1)
        units = np.array([np.count_nonzero(n)], np.float64)
        error = _spread(resampled[:, None], units)
        zero = np.zeros(1)
        estimates.append(Estimate(np.array([value]), n.sum(keepdims=True), units, resampled[:, None], error, zero))
    return estimates[0], estimates[1]


def jensen_shannon(one: Floats, other: Floats) -> Floats:
    """Return the Jensen-Shannon divergence of histograms, shape (..., bins), in bits: 0 to 1."""
    from scipy.special import entr

    p, q = (_ratio(part, part.sum(axis=-1, keepdims=True)) for part in (one, other))
    bits: Floats = (entr(0.5 * (p + q)) - 0.5 * (entr(p) + entr(q))).sum(axis=-1) / math.log(2.0)
    return bits


def _spread(resampled: Floats, units: Floats) -> Floats:
    """Return the standard deviation of each cell, (cells,), over the rows of `resampled`, (samples, cells).

    The bootstrap's variance over m units is too small by (m − 1)/m.
    """
    inflation = np.sqrt(units / np.maximum(units - 1.0, 1.0))
    cells = np.ascontiguousarray(resampled.T)
    spread = np.full(len(cells), np.nan)
    whole = np.isfinite(cells).all(axis=1)
    spread[whole] = _deviation(cells[whole])
    for cell in np.flatnonzero(~whole):
        known = cells[cell][np.isfinite(cells[cell])]
        if len(known) > 1:
            spread[cell] = _deviation(known)
    return spread * inflation


def _deviation(values: Floats) -> Any:
    """Return the standard deviation along the last axis, exactly 0 of equal values."""
    return np.where(np.ptp(values, axis=-1) > 0.0, values.std(axis=-1, ddof=1), 0.0)


def critical(tests: int, units: Floats) -> Any:
    """Return how many standard errors a difference may have by chance in one of so many tests, at the level `LEVEL`.

    It is Student's quantile for one degree of freedom less than there are units, at a level that Bonferroni's
    inequality divides among the tests.
    """
    from scipy.special import stdtrit

    return stdtrit(np.maximum(units - 1.0, 1.0), 1.0 - 0.5 * (1.0 - LEVEL) / max(tests, 1))
