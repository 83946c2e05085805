"""The measures: one function for each, which turns a frame into samples, registered in `STATISTICS` by `measure`.

A new measure is one more function here. Its decorator says how samples become a value, what its cells are, what a frame
needs to have, and which difference is too small to matter.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.comparison._frame import ROUGH, Frame, Image, Mask
from lidarsim.comparison._statistics import (
    Divergence,
    Histogram,
    Indices,
    Mean,
    Rate,
    Samples,
    Share,
    Slope,
    Step,
    Summary,
    quantile,
    robust_sigma,
    trimmed_mean,
)

Need = Literal["ring", "column", "intensity", "elevation", "counted", "scene", "frames"]
"""What a measure needs: fields, rings that were not inferred from elevations, columns that are those of the cloud, one
scene on both sides, two real frames of it."""

RANGES = np.array([0.0, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 35.0, 60.0, 100.0, 200.0, math.inf])
"""Edges of the bins of range, m."""
COSINES = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0])
"""Edges of the bins of the cosine of the angle of incidence."""
INTENSITIES = np.array([-math.inf, 0.1, 0.25, 0.6, math.inf])
"""Edges of the bins of intensity."""
JUMPS = np.array([0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, math.inf])
"""Edges of the bins of the range jump at an edge, m."""
RUNS = np.array([1.0, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, 50.0, 100.0, math.inf])
"""Edges of the bins of the length of runs of missing pixels."""
STEPS = np.array([0.5, 1.0, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 20.0, 25.0, 50.0]) * 1e-3
"""Steps of the range that are looked for, m."""
HEIGHT = 0.4
"""Step of heights, m."""
FALL_OFF = 10.0
"""α of the density-aware Chamfer distance, 1/m: a point 0.1 m from its nearest neighbour counts e times less."""
PAIRED = 20_000
"""Most points of a frame, about, whose neighbours in another frame are searched."""
NEAR = 1.0
"""Distance between points of two clouds up to which they may be of one scene, m."""


@dataclass(frozen=True)
class Cells:
    """Cells of a measure.

    Attributes
    ----------
    what : str
        What the cells are bins of.
    labels : tuple of str or None
        Their labels; None: the rings, by number.
    """

    what: str
    labels: tuple[str, ...] | None

    def label(self, cell: int) -> str:
        """Return the label of a cell."""
        return f"ring {cell}" if self.labels is None else self.labels[cell]


@dataclass(frozen=True)
class Pair:
    """A frame beside a real frame that it is held against, each thinned alike to `PAIRED` points, about.

    Attributes
    ----------
    frame, reference : Frame
        The frame and the real frame.
    """

    frame: Frame
    reference: Frame

    @cached_property
    def own(self) -> Indices:
        """The chosen points of the frame."""
        return self._choose(self.frame, 0)

    @cached_property
    def other(self) -> Indices:
        """The chosen points of the reference."""
        return self._choose(self.reference, 1)

    def _choose(self, frame: Frame, seed: int) -> Indices:
        share = PAIRED / max(len(self.reference), 1)
        return np.flatnonzero(np.random.default_rng(seed).random(len(frame)) < share)

    @cached_property
    def nearest(self) -> tuple[Floats, Indices, Floats, Indices]:
        """Distance and index of the neighbours of `own` among `other`, and of `other` among `own`."""
        from scipy.spatial import KDTree

        a, b = self.frame.xyz[self.own], self.reference.xyz[self.other]
        return (*KDTree(b).query(a), *KDTree(a).query(b))

    @cached_property
    def overlap(self) -> bool:
        """Whether half of the points have one of the reference within `NEAR`."""
        return bool(len(self.own) and len(self.other) and np.median(self.nearest[0]) < NEAR)


@dataclass(frozen=True)
class Statistic:
    """A measure before it is applied.

    Attributes
    ----------
    name, unit, meaning : str
        Name, unit of its values, and what it says.
    samples : callable
        Returns the samples of a frame, or of a pair.
    summary : Summary
        How samples become a value.
    cells : Cells
        Its cells.
    needs : tuple of str
        What a frame needs to have.
    least, relative : float
        A difference is relevant if it exceeds `least`, in `unit`, and `relative` times the real value.
    centred : bool
        Whether only differences between cells count: of both sides the mean of the cells is subtracted.
    upwards : bool
        Whether only a simulated value above the real one counts.
    """

    name: str
    unit: str
    meaning: str
    samples: Callable[[Frame], Samples] | Callable[[Pair], Samples]
    summary: Summary
    cells: Cells
    needs: tuple[Need, ...]
    least: float
    relative: float
    centred: bool
    upwards: bool


STATISTICS: dict[str, Statistic] = {}
"""The measures by name, in the order of the report."""


def measure(
    name: str,
    unit: str,
    summary: Summary,
    cells: Cells,
    *needs: Need,
    least: float = 0.0,
    relative: float = 0.0,
    centred: bool = False,
    upwards: bool = False,
) -> Callable[[Callable[..., Samples]], Callable[..., Samples]]:
    """Register a function as a measure; the parameters are those of `Statistic`, its docstring says what it means."""

    def register(function: Callable[..., Samples]) -> Callable[..., Samples]:
        meaning = " ".join((function.__doc__ or "").split())
        STATISTICS[name] = Statistic(
            name, unit, meaning, function, summary, cells, needs, least, relative, centred=centred, upwards=upwards
        )
        return function

    return register


def _bins(what: str, edges: Floats, unit: str) -> Cells:
    def label(low: float, high: float) -> str:
        if math.isinf(high):
            return f"over {low:g}{unit}"
        return f"{low:g} to {high:g}{unit}" if math.isfinite(low) else f"up to {high:g}{unit}"

    return Cells(what, tuple(label(*ends) for ends in itertools.pairwise(edges)))


def bin_of(values: npt.NDArray[np.floating], edges: Floats) -> Indices:
    """Return the bin of each value, the last edge included; -1 outside and of nan."""
    place = np.searchsorted(edges, values, "right") - 1
    place[values == edges[-1]] = len(edges) - 2
    place[~(values >= edges[0]) | (place >= len(edges) - 1)] = -1
    return place


def _logarithmic(low: float, high: float) -> Floats:
    """Return edges of bins from 0 and then from `low` to `high` on, 40 a decade."""
    return np.concatenate([[0.0], np.geomspace(low, high, round(40 * math.log10(high / low)) + 1)])


ONE = Cells("", ("all",))
BY_RING = Cells("ring", None)
BY_RANGE = _bins("range", RANGES, " m")
BY_COSINE = _bins("cos incidence", COSINES, "")
BY_JUMP = _bins("range jump", JUMPS, " m")
BY_RUN = Cells("pixels", ("1", "2", "3", "4 and 5", "6 to 9", "10 to 19", "20 to 49", "50 to 99", "100 or more"))
BY_RANGE_AND_INTENSITY = Cells(
    "range and intensity",
    tuple(
        f"{near}, intensity {bright}"
        for near in BY_RANGE.labels or ()
        for bright in _bins("", INTENSITIES, "").labels or ()
    ),
)


def _image(frame: Frame) -> Image:
    assert frame.image is not None  # noqa: S101 - `needs` says so
    return frame.image


def _intensity(frame: Frame) -> Floats:
    assert frame.intensity is not None  # noqa: S101 - `needs` says so
    return frame.intensity


@measure("points by range", "share", Share(), BY_RANGE, least=0.01)
def points_by_range(frame: Frame) -> Samples:
    """Share of the points in each bin of range."""
    return Samples(bin_of(frame.reach, RANGES), frame.block, frame.reach)


@measure("points by ring", "share", Share(), BY_RING, "ring", relative=0.05)
def points_by_ring(frame: Frame) -> Samples:
    """Share of the points of each ring."""
    assert frame.ring is not None  # noqa: S101 - `needs` says so
    return Samples(frame.ring, frame.block, frame.reach)


def _find_returned(frame: Frame) -> tuple[Floats, Floats, Floats, Indices]:
    """Return range, cosine, whether it returned, and block of the pulses that met a surface."""
    if frame.truth is not None:
        truth = frame.truth
        return truth.reach, truth.cosine, truth.returned.astype(np.float64), truth.block
    image = _image(frame)
    planes = image.planes
    counts = planes.on | (image.lost & planes.within & np.isfinite(planes.reach))
    return planes.reach[counts], planes.cosine[counts], planes.on[counts].astype(np.float64), image.block[counts]


@measure("return rate by range", "share", Rate(), BY_RANGE, "column", least=0.02)
def return_rate_by_range(frame: Frame) -> Samples:
    """Share of the pulses at a plane that return, by range.

    A pulse counts if its ring has points of the plane before and behind it. If both sides are scans, all pulses that
    met a surface count.
    """
    reach, _, returned, block = _find_returned(frame)
    return Samples(bin_of(reach, RANGES), block, returned)


@measure("return rate by incidence", "share", Rate(), BY_COSINE, "column", least=0.02)
def return_rate_by_incidence(frame: Frame) -> Samples:
    """Share of the pulses at a plane that return, by the cosine of the angle of incidence."""
    _, cosine, returned, block = _find_returned(frame)
    return Samples(bin_of(cosine, COSINES), block, returned)


SIGMA = Histogram(_logarithmic(1e-5, 1.0), robust_sigma)


@measure("range noise", "m", SIGMA, BY_RANGE_AND_INTENSITY, "column", least=2e-4, relative=0.1)
def range_noise(frame: Frame) -> Samples:
    """Noise of the range within a ring: its standard deviation on planes, the quantisation of the range included.

    On a plane 1/range is a sinusoid of azimuth along a ring, whose third difference over neighbouring columns is near
    zero. The third difference of independent noise has a variance of 20 σ².
    """
    image = _image(frame)
    # A sinusoid of amplitude A has third differences up to A (2 sin(δ/2))³ at a step δ: of 1/range A is 1/(r cosθ) at
    # most, and at δ = 2π/1024 and cosθ = 0.5 that is 5e-7 r of the range, a hundredth of the noise at 100 m.
    u = 1.0 / image.reach
    third = u[:, 3:] - 3.0 * (u[:, 2:-1] - u[:, 1:-2]) - u[:, :-3]
    on, steep = image.planes.on, image.planes.cosine
    whole = on[:, 3:] & on[:, 2:-1] & on[:, 1:-2] & on[:, :-3] & ~(steep[:, 1:-2] < 0.5)
    reach = image.reach[:, 1:-2][whole]
    cell = bin_of(reach, RANGES)
    levels = len(INTENSITIES) - 1
    bright = (
        levels - 1 if frame.intensity is None else bin_of(frame.intensity[image.point[:, 1:-2][whole]], INTENSITIES)
    )
    cell = np.where(cell >= 0, cell * levels + bright, -1)
    return Samples(cell, image.block[:, 1:-2][whole], np.abs(third[whole]) * reach**2 / math.sqrt(20.0), other=reach)


@measure("ring bias", "m", Mean(), BY_RING, "column", least=2e-3, centred=True)
def ring_bias(frame: Frame) -> Samples:
    """Mean deviation of each ring, along the beam, from planes fitted over several rings, less that of all rings."""
    image = _image(frame)
    on = image.planes.on & (image.planes.cosine > 0.3)
    ring = np.broadcast_to(image.rings[:, None], on.shape)[on]
    return Samples(ring, image.block[on], image.planes.deviation[on])


@measure("dual returns", "share", Rate(), ONE, "column", least=5e-3)
def dual_returns(frame: Frame) -> Samples:
    """Share of the pulses with points that have two or more."""
    image = _image(frame)
    seen = image.returns > 0
    return Samples(np.zeros(seen.sum(), np.intp), image.block[seen], (image.returns[seen] > 1).astype(np.float64))


@measure(
    "separation of dual returns",
    "m",
    Histogram(np.linspace(0.0, 20.0, 1001), quantile(0.01)),
    ONE,
    "column",
    least=0.05,
)
def separation(frame: Frame) -> Samples:
    """Least distance between the returns of a pulse: their 1st percentile."""
    image = _image(frame)
    return Samples(np.zeros(len(image.separation), np.intp), image.separation_block, image.separation)


def _edges(frame: Frame, kind: Literal["mixed", "lost", "dual"]) -> Samples:
    """Return which edges along a ring are of a kind: a pixel between two sides of three smooth pixels each.

    The jump is that between the lines through either side at the pixel, which on a slanted surface is none. The echo of
    a pulse that meets both surfaces is off each by the share of the power that the other returns. A beam up to 1.8
    columns wide, Gaussian and cut off at 1/e², makes no two pixels that are off both by a tenth. So sides are smooth to
    a tenth of the jump, and steps with more pixels between them are not counted: a surface lies there.
    """
    image = _image(frame)
    r = image.reach
    width = max(r.shape[1] - 6, 0)
    a3, a2, a1, m, b1, b2, b3 = (r[:, i : width + i] for i in range(7))
    middle = np.s_[:, 3:-3]
    a, b = a1 + a2 - a3, b1 + b2 - b3
    jump = np.abs(b - a)
    with np.errstate(invalid="ignore"):
        steps = (a1 - a2, a2 - a3, b1 - b2, b2 - b3)
        smooth = np.all([np.abs(step) <= 0.1 * jump for step in steps], axis=0) & (jump >= JUMPS[0])
        off = np.minimum(np.abs(m - a), np.abs(m - b))
        between = (m > np.minimum(a, b)) & (m < np.maximum(a, b)) & (off > 0.2 * jump)
        clean = (off <= 0.2 * jump) & (image.returns[middle] == 1)
        twice = clean & (off <= 0.1 * (jump - off))
    lost, dual = image.lost[middle], image.returns[middle] > 1
    kinds = {"mixed": between & ~dual, "lost": lost, "dual": dual}
    known = smooth & (between | lost | dual | clean)
    # An edge whose pixels all lie on its sides is found twice: at the last pixel before the jump, and at the first one
    # behind it. Each time, the other of the two belongs to a side, so that the jump is smaller by its offset.
    weight = np.where(twice[known], 0.5, 1.0)
    return Samples(
        bin_of(jump[known], JUMPS), image.block[middle][known], kinds[kind][known].astype(np.float64), weight
    )


@measure("mixed points at edges", "share", Rate(), BY_JUMP, "column", least=0.05)
def mixed_points(frame: Frame) -> Samples:
    """Share of the edges, by the jump of the range along a ring, with a single point between the two surfaces."""
    return _edges(frame, "mixed")


@measure("lost returns at edges", "share", Rate(), BY_JUMP, "column", least=0.05)
def lost_at_edges(frame: Frame) -> Samples:
    """Share of the edges, by the jump of the range along a ring, with a pulse that does not return."""
    return _edges(frame, "lost")


@measure("dual returns at edges", "share", Rate(), BY_JUMP, "column", least=0.05)
def dual_at_edges(frame: Frame) -> Samples:
    """Share of the edges, by the jump of the range along a ring, with a pulse of two or more returns."""
    return _edges(frame, "dual")


@measure("holes in smooth rings", "share", Rate(), BY_RANGE, "column", least=2e-3)
def holes(frame: Frame) -> Samples:
    """Share of the pulses that do not return between two neighbours on either side that agree in range."""
    image = _image(frame)
    agree = smooth(image)
    lost = image.lost[:, 2:-2][agree].astype(np.float64)
    return Samples(bin_of(image.reach[:, 1:-3][agree], RANGES), image.block[:, 2:-2][agree], lost)


def smooth(image: Image) -> Mask:
    """Return which pulses have two neighbours on either side that agree in range, shape (R, C - 4)."""
    r = image.reach
    before, a, _, b, behind = (r[:, i : r.shape[1] - 4 + i] for i in range(5))
    with np.errstate(invalid="ignore"):
        near = ROUGH + 0.01 * np.minimum(a, b)
        agree = (np.abs(b - a) < near) & (np.abs(a - before) < near) & (np.abs(behind - b) < near)
    return agree & image.fired[:, 2:-2]


@measure("runs of missing pixels", "share", Share(), BY_RUN, "column", least=0.02)
def runs_of_missing(frame: Frame) -> Samples:
    """Share of the runs of pulses along a ring that do not return, between two that do, by their length."""
    image = _image(frame)
    row, column = np.nonzero(image.point >= 0)
    length = np.where(np.diff(row) == 0, np.diff(column) - 1, 0).astype(np.float64)
    return Samples(bin_of(length, RUNS), image.block[row[:-1], column[:-1]], length)


@measure("isolated points", "share", Rate(), BY_RANGE, "column", least=2e-3)
def isolated_points(frame: Frame) -> Samples:
    """Share of the first returns without a neighbour at a like range, as drops, fog and false returns are.

    Neighbours are the pixels up to two columns and one ring away; a like range differs by 0.5 m or 5 % at most.
    """
    reach = _image(frame).reach
    padded = np.pad(reach, ((1, 1), (2, 2)), constant_values=np.nan)
    high, wide = reach.shape
    alone = np.isfinite(reach)
    near = np.maximum(0.5, 0.05 * reach)
    for down, across in itertools.product(range(3), range(5)):
        if (down, across) != (1, 2):
            with np.errstate(invalid="ignore"):
                alone &= ~(np.abs(padded[down : down + high, across : across + wide] - reach) <= near)
    seen = np.isfinite(reach)
    return Samples(bin_of(reach[seen], RANGES), _image(frame).block[seen], alone[seen].astype(np.float64))


BRIGHTEST = 1e5
"""More than any intensity: whole numbers of 16 bits are."""
BRIGHTNESS = Histogram(_logarithmic(1e-4, BRIGHTEST), trimmed_mean(0.1, 0.9))


@measure("intensity by range", "1", BRIGHTNESS, BY_RANGE, "intensity", least=5e-3, relative=0.1)
def intensity_by_range(frame: Frame) -> Samples:
    """Mean intensity, without the lowest and the highest tenth, by range."""
    return Samples(bin_of(frame.reach, RANGES), frame.block, _intensity(frame))


@measure("intensity by incidence", "1", BRIGHTNESS, BY_COSINE, "column", "intensity", least=5e-3, relative=0.1)
def intensity_by_incidence(frame: Frame) -> Samples:
    """Mean intensity of points on planes, without the lowest and the highest tenth, by the cosine of the incidence."""
    image = _image(frame)
    on = image.planes.on
    return Samples(bin_of(image.planes.cosine[on], COSINES), image.block[on], _intensity(frame)[image.point[on]])


@measure(
    "scatter of intensity",
    "1",
    Histogram(_logarithmic(1e-3, 10.0), quantile(0.5)),
    BY_RANGE,
    "column",
    "intensity",
    least=0.01,
    relative=0.15,
)
def scatter_of_intensity(frame: Frame) -> Samples:
    """Relative scatter of the intensity along a ring on planes: 1.4826 times the median of |second difference|/√6.

    The second difference is that of three neighbours, over their mean; of independent noise it has a variance of 6 σ².
    """
    image = _image(frame)
    on = image.planes.on
    whole = on[:, 2:] & on[:, 1:-1] & on[:, :-2]
    bright = np.where(on, _intensity(frame)[image.point], np.nan)
    a, b, c = bright[:, :-2][whole], bright[:, 1:-1][whole], bright[:, 2:][whole]
    mean = (a + b + c) / 3.0
    scatter = np.divide(np.abs(a - 2.0 * b + c), mean, out=np.full(len(mean), np.nan), where=mean > 0.0)
    cell = np.where(mean > 0.0, bin_of(image.reach[:, 1:-1][whole], RANGES), -1)
    return Samples(cell, image.block[:, 1:-1][whole], 1.4826 * scatter / math.sqrt(6.0))


@measure(
    "distribution of intensity",
    "bit",
    Divergence(_logarithmic(1e-3, BRIGHTEST)),
    ONE,
    "intensity",
    least=0.02,
    upwards=True,
)
def distribution_of_intensity(frame: Frame) -> Samples:
    """Jensen-Shannon divergence of the intensities from the real ones, beside that by chance."""
    return Samples(np.zeros(len(frame), np.intp), frame.block, _intensity(frame))


@measure("distribution of height", "bit", Divergence(HEIGHT * np.arange(-50.5, 51.5)), ONE, least=0.02, upwards=True)
def distribution_of_height(frame: Frame) -> Samples:
    """Jensen-Shannon divergence of the heights over the sensor, in steps of 0.4 m, beside that by chance."""
    # Each point counts for the two nearest steps, by its distance from them: so a road may lie on the edge of two.
    place = frame.xyz[:, 2] / HEIGHT
    below = np.floor(place)
    one = np.zeros(2 * len(frame), np.intp)
    value = HEIGHT * np.concatenate([below, below + 1.0])
    return Samples(one, np.tile(frame.block, 2), value, np.concatenate([1.0 + below - place, place - below]))


@measure("ring elevation", "rad", Slope(), BY_RING, "ring", "elevation", least=5e-4)
def ring_elevation(frame: Frame) -> Samples:
    """Elevation of each ring: the slope of height over horizontal distance, whatever the height of its origin."""
    assert frame.ring is not None  # noqa: S101 - `needs` says so
    away = np.hypot(frame.xyz[:, 0], frame.xyz[:, 1])
    return Samples(frame.ring, frame.block, frame.xyz[:, 2], other=away)


@measure("ring azimuth offset", "rad", Mean(), BY_RING, "column", "counted", least=5e-4, centred=True)
def ring_azimuth(frame: Frame) -> Samples:
    """Azimuth of the points of each ring relative to that of their columns, less that of all rings."""
    image = _image(frame)
    seen = image.point >= 0
    ring = np.broadcast_to(image.rings[:, None], seen.shape)[seen]
    return Samples(ring, image.block[seen], image.offset[seen])


@measure("range step", "m", Step(STEPS), ONE)
def range_step(frame: Frame) -> Samples:
    """Greatest step, of those looked for, of which all ranges are multiples; 0 if there is none."""
    return Samples(np.zeros(len(frame), np.intp), frame.block, frame.range)


OFFSET = Histogram(np.linspace(-0.5, 0.5, 1001), trimmed_mean(0.2, 0.8))


@measure("range offset in one scene", "m", OFFSET, BY_RANGE, "scene", "column", least=5e-3)
def range_offset(pair: Pair) -> Samples:
    """Distance of the points, along the beam, from the planes of the real frame: mean of the middle three fifths."""
    from scipy.spatial import KDTree

    frame, image = pair.frame, _image(pair.reference)
    on = image.planes.on & (image.planes.cosine > 0.3)
    chosen = pair.own
    if not on.any():
        return Samples(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))
    away, nearest = KDTree(pair.reference.xyz[image.point[on]]).query(frame.xyz[chosen])
    beam = frame.xyz[chosen] / frame.reach[chosen, None]
    facing = (beam * image.planes.normal[on][nearest]).sum(axis=1)
    with np.errstate(divide="ignore"):
        offset = frame.reach[chosen] - 1.0 / facing
    fits: Mask = (away < 0.3 + 0.02 * frame.reach[chosen]) & (facing > 0.0) & (np.abs(offset) < 0.5)
    return Samples(bin_of(frame.reach[chosen][fits], RANGES), frame.block[chosen][fits], offset[fits])


@measure("density-aware Chamfer distance", "1", Mean(), ONE, "scene", "frames", least=0.02, upwards=True)
def chamfer(pair: Pair) -> Samples:
    """Distance of the points of a frame from those of the real frame, 0 to 1; of the real frames, from the one before.

    With ŷ the nearest neighbour of x and n the number of points that have the neighbour ŷ, it is the mean of
    1 − exp(−α |x − ŷ|)/n, averaged over both directions (T. Wu et al., Density-aware Chamfer distance as a
    comprehensive metric for point cloud completion, NeurIPS 2021); α is 10/m.
    """
    near, nearest, back, backwards = pair.nearest
    parts = []
    for away, neighbour in ((near, nearest), (back, backwards)):
        crowd = np.bincount(neighbour)[neighbour]
        parts.append((1.0 - np.exp(-FALL_OFF * away) / crowd, np.full(len(away), 0.5 * PAIRED / len(away))))
    value, weight = (np.concatenate(part) for part in zip(*parts, strict=True))
    block = np.concatenate([pair.frame.block[pair.own], pair.reference.block[pair.other]])
    return Samples(np.zeros(len(value), np.intp), block, value, weight)
