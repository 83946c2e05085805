"""Comparisons of real point clouds with simulated ones.

Each measure is a statistic of the points of each side, with an interval by bootstrap over the frames, or, of few
frames, over blocks of columns. A measure differs if in some of its cells (bins of range, rings, …) the difference is
relevant, by a limit stated with the measure, and larger than chance makes the largest of all that are compared
(Bonferroni's inequality over all cells of all measures, Student's distribution over blocks), or if that holds of the
mean over all its cells. Sides are alike only where a difference just relevant would have been found; each cell gives
the least that would have counted.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from lidarsim._base.shown import quantity
from lidarsim._base.validation import short_repr
from lidarsim.comparison import _report as _report  # registers the page
from lidarsim.comparison._fit import fit_source, recognise, sensor_of
from lidarsim.comparison._frame import FARTHEST_ORIGIN, Frame, check_reach
from lidarsim.comparison._measures import STATISTICS, Pair, Statistic
from lidarsim.comparison._result import Cell, Comparison, Contrast, Measure, Side, Verdict, reasons, values
from lidarsim.comparison._sources import Given, Source, intensity_unit, source
from lidarsim.comparison._statistics import (
    FEWEST_UNITS,
    Divergence,
    Estimate,
    Share,
    Units,
    critical,
    divergence,
    error_of_difference,
    estimate,
    interval,
)
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.lidar import Lidar
from lidarsim.materials import Material
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan

__all__ = [
    "Cell",
    "Comparison",
    "Contrast",
    "Measure",
    "Side",
    "compare",
    "compare_sources",
    "fit",
    "fit_source",
    "reasons",
    "recognise",
    "sensor_of",
    "source",
    "values",
]

SensorLike = str | os.PathLike[str] | Lidar | None

FEWEST = 50
"""Fewest samples of a cell that is compared."""
UNLIKE = 1.1
"""Ratio of the numbers of rings above which sensors are unlike: fewer rings may just see nothing."""


def compare(real: Given, simulated: Given, *, sensor: SensorLike = None) -> Comparison:
    """Compare simulated point clouds with real ones, measure by measure.

    Parameters
    ----------
    real, simulated : PointCloud, Scan, path-like, or iterable of these
        Frames in the sensor frame, as drivers give them: a cloud, a scan, a point cloud file, a ROS 2 bag with the
        clouds of one sensor, a folder of these (with subfolders, in the order of the numbers in their names), or an
        iterable of them. Frames are read one at a time. Without a field `range`, the range is the distance from the
        origin. Intensities that are whole numbers above 1 are taken as percent.
    sensor : str, path-like or Lidar, optional
        The sensor, its name in `Lidar.presets()`, or a file that `Lidar.from_file` reads. It assigns rings to points
        without any, by their order if it is that of KITTI, else by their elevations, and columns to points without any,
        by their azimuths. `Comparison.notes` mention rings that are inferred.

    Returns
    -------
    Comparison
        A table of measures. Those that cannot be taken give the reason.

    Raises
    ------
    FileFormatError, OSError
        If a file cannot be read.
    TypeError, ValueError
        If an argument is none of these, one side has no points, or half of the points of a frame are farther than the
        sensor sees.

    Notes
    -----
    Most measures use the rings and columns of the clouds: neighbours along a ring, planes over several rings and
    columns, and pulses without a point, which are the empty columns of a ring. Two measures need both sides to have
    seen one scene from one place; their real value is that of the real frames among themselves.

    Examples
    --------
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> _ = scene.add(ls.Plane((0, 0, 1), -1.8)), scene.add(ls.Box((16, 12, 8)))
    >>> lidar = ls.Lidar.preset("velodyne-vlp16", noise="datasheet")
    >>> real, simulated = (list(lidar.frames(scene, None, 2, seed=seed)) for seed in (1, 2))

    Another seed is another unit of the sensor, with other biases of its channels:

    >>> comparison = ls.compare(real, simulated)
    >>> [measure.name for measure in comparison.differing]
    ['ring bias', 'range offset in one scene']
    >>> comparison["range noise"].verdict
    'alike'
    """
    return compare_sources(source("real", real), source("simulated", simulated), sensor)


def fit(
    real: Given, sensor: str | os.PathLike[str] | Lidar, *, ground: Material | None = None
) -> tuple[Lidar, Comparison]:
    """Fit a sensor to real frames of one's own unit.

    Parameters
    ----------
    real : PointCloud, Scan, path-like, or iterable of these
        Frames in the sensor frame, as `compare` takes them.
    sensor : str, path-like or Lidar
        The sensor to start from: a preset by its name, with measured noise if it has that, else with noise of the
        datasheet; a file that `Lidar.from_file` reads; or a sensor.
    ground : Material, optional
        What the ground of the frames is made of. Default: `materials.ASPHALT` for the detection limit, and intensities
        by range are not fitted.

    Returns
    -------
    lidar : Lidar
        The sensor with the fitted values; all others are kept.
    comparison : Comparison
        A measure for each value, by its name in `Measurement`, such as "range_sigma" or "response.limit", or in
        `Lidar`, "min_range": the fitted value with its 95 % interval as `real`, that of `sensor` as `simulated`,
        `n_real` samples. Values that could not be fitted are "not measured"; `why` has the reason. Tables have a cell
        for each row, values of rings one for each ring.

    Raises
    ------
    FileFormatError, OSError
        If a file cannot be read.
    TypeError, ValueError
        If an argument is none of these, there are too few points, or they are not of the sensor: their rings are
        unknown, more than it has, or not where its beams are, or half of them are farther than it sees.

    Notes
    -----
    Values are those that simulate such frames, in the model of `Measurement`: `range_sigma` is the noise of all
    surfaces on planes, weak echoes included, and replaces `range_sigma_limit`; unless ranges disagree, it is a multiple
    of that of `sensor`. `channel_bias_sigma` is how much rings differ; if they do, each gets its own `range_bias`
    instead, less the share that is likely error, and less what is linear in the elevation of neighbouring rings, which
    on planes looks like a slope. The range of `detection` depends on the reflectivity of the ground: for twice the
    reflectivity, it is 0.7 times as far.

    Examples
    --------
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> _ = scene.add(ls.Plane((0, 0, 1), -1.8)), scene.add(ls.Box((16, 12, 8)))
    >>> unit = ls.Lidar(ls.Lidar.preset("velodyne-vlp16").pattern, measurement=ls.Measurement(range_sigma=0.02))
    >>> lidar, comparison = ls.fit(unit.frames(scene, None, 2), "velodyne-vlp16")
    >>> round(lidar.measurement.range_sigma, 3)
    0.02
    >>> comparison["detection.range"].why
    'the ground returns most pulses wherever it is seen'
    """
    lidar, _ = sensor_of(sensor)
    if ground is not None and not isinstance(ground, Material):
        raise ArgumentTypeError("ground", "a Material or None", short_repr(ground))
    return fit_source(source("real", real), lidar, ground)


def compare_sources(real: Source, simulated: Source, sensor: SensorLike) -> Comparison:
    """Compare two sources; see `compare`."""
    lidar = _sensor(sensor)
    only_scans = True  # which know what became of each pulse
    sides = _Side("real", real.name), _Side("simulated", simulated.name)
    overlaps: list[bool] = []
    last: Frame | None = None
    for one, other in zip_longest(real.frames, simulated.frames):
        only_scans &= isinstance(one, Scan | None) and isinstance(other, Scan | None)
        a, b = sides[0].frame(one, lidar), sides[1].frame(other, lidar)
        for side, frame in zip(sides, (a, b), strict=True):
            if frame is not None:
                side.add(frame if only_scans else replace(frame, truth=None))
        if a is not None and b is not None:
            overlaps.append(_add_pair(sides, a, b, last))
        last = a
    for side in sides:
        if not side.points:
            raise ArgumentValueError(side.argument, "points", f"none in {quantity(side.frames, 'frame')}")
    return _judge(*sides, lidar, overlap=any(overlaps))


class _Side:
    """The sums of one side so far."""

    def __init__(self, argument: str, name: str) -> None:
        self.argument, self.name = argument, name
        self.frames = self.points = 0
        self.middle, self.farthest = math.inf, 0.0  # least of the medians of frames, and greatest distance, m
        self.range_difference = 0.0
        self.rings = np.zeros(0, np.intp)
        self.inferred: dict[str, None] = {}  # an ordered set
        self.missing: dict[str, str] = {}
        self.units = {name: Units() for name in STATISTICS}
        self._unit: float | None = None

    def frame(self, given: PointCloud | Scan | None, sensor: Lidar | None) -> Frame | None:
        """Return a cloud or a scan as a frame; None if there is none, or it has no points."""
        if given is None:
            return None
        self.frames += 1
        if self._unit is None and (isinstance(given, Scan) or len(given)):
            self._unit = intensity_unit(given)
        frame = Frame.of(given, sensor, self._unit or 1.0)
        if not len(frame):
            return None
        if sensor is not None:
            check_reach(self.argument, frame, sensor)
        return frame

    def add(self, frame: Frame) -> None:
        """Add the samples of a frame."""
        self.points += len(frame)
        self.middle, self.farthest = min(self.middle, frame.middle), max(self.farthest, float(frame.reach.max()))
        self.range_difference = max(self.range_difference, frame.range_difference)
        if frame.ring is not None:
            self.rings = np.union1d(self.rings, frame.ring)
        self.missing |= frame.missing
        if frame.inferred:
            self.inferred[frame.inferred] = None
        if frame.image is not None and not frame.image.counted:
            self.missing["counted"] = "have no columns but those that follow from the azimuth itself"
        for name, statistic in STATISTICS.items():
            if not set(statistic.needs) & {*self.missing, "scene"}:
                self.take(name, statistic.samples, frame)

    def take(self, name: str, samples: Callable[..., Any], what: Frame | Pair) -> None:
        """Add the samples of a measure."""
        statistic = STATISTICS[name]
        found = samples(what)
        cells = statistic.cells.labels
        count = int(found.cell.max(initial=-1)) + 1 if cells is None else len(cells)
        self.units[name].add(statistic.summary.sums(found, count))

    @property
    def summary(self) -> Side:
        """What was compared, for the report."""
        return Side(self.name, self.frames, self.points, len(self.rings))


def _add_pair(sides: tuple[_Side, _Side], real: Frame, simulated: Frame, last: Frame | None) -> bool:
    """Add what a simulated frame shows beside the real one, and that beside the last; return whether they overlap."""
    pair = Pair(simulated, real)
    if not pair.overlap:
        return False
    lacks = {*sides[0].missing, *sides[1].missing}
    for name, statistic in STATISTICS.items():
        if "scene" not in statistic.needs or lacks & set(statistic.needs):
            continue
        sides[1].take(name, statistic.samples, pair)
        if "frames" not in statistic.needs:
            sides[0].take(name, statistic.samples, Pair(real, real))
        elif last is not None:
            sides[0].take(name, statistic.samples, Pair(real, last))
    return True


def _sensor(sensor: SensorLike) -> Lidar | None:
    if sensor is None or isinstance(sensor, Lidar):
        return sensor
    if not isinstance(sensor, str | os.PathLike):
        raise ArgumentTypeError("sensor", "a Lidar, the name of a preset or a file", short_repr(sensor))
    if sensor in Lidar.presets():
        return Lidar.preset(str(sensor))
    if not Path(sensor).suffix:
        raise ArgumentValueError(
            "sensor", f"a Lidar, a file or one of {', '.join(Lidar.presets())}", short_repr(sensor)
        )
    return Lidar.from_file(Path(sensor))


def _judge(real: _Side, simulated: _Side, sensor: Lidar | None, *, overlap: bool) -> Comparison:
    """Return the verdicts on all measures."""
    refused: dict[str, str] = {}
    found: dict[str, tuple[Estimate, Estimate]] = {}
    unlike = _unlike(real, simulated, sensor)
    for i, (name, statistic) in enumerate(STATISTICS.items()):
        why = _lacking(statistic, real, simulated, overlap=overlap)
        if not why and statistic.cells.labels is None:
            why = unlike
        if not why:
            found[name] = _estimate(statistic, real.units[name], simulated.units[name], seed=2 * i)
        else:
            refused[name] = why
    contrasts = {name: _contrast(STATISTICS[name], *pair) for name, pair in found.items()}
    tests = sum(int(contrast.compared.sum()) for contrast in contrasts.values())
    measures = [
        _measure(statistic, contrasts[name], tests) if name in found else _refuse(statistic, refused[name])
        for name, statistic in STATISTICS.items()
    ]
    notes = [
        f"the rings of the {side.argument} clouds are inferred from {' or '.join(side.inferred)}"
        for side in (real, simulated)
        if side.inferred
    ]
    notes += [f"{unlike}: these are unlike sensors"] if unlike else []
    notes += [
        f"half of the {side.argument} points are beyond {side.middle:.4g} m, and all {other.argument} ones nearer: mm?"
        for side, other in ((real, simulated), (simulated, real))
        if side.middle > other.farthest
    ]
    notes += [
        f"ranges of the {side.argument} clouds differ from the distances to the origin by"
        f" {side.range_difference:.4g} m, as if points were not in the sensor frame"
        for side in (real, simulated)
        if side.range_difference > FARTHEST_ORIGIN
    ]
    return Comparison(tuple(measures), real.summary, simulated.summary, tuple(notes))


def _lacking(statistic: Statistic, real: _Side, simulated: _Side, *, overlap: bool) -> str:
    """Return what either side lacks for a measure; "" if it has all."""
    for need in statistic.needs:
        if need == "scene":
            if not overlap:
                return "the clouds do not overlap: this needs one scene, seen from one place"
            continue
        if need == "frames" and not real.units[statistic.name]:
            return "what the real clouds differ among themselves takes two frames of them"
        for side in (real, simulated):
            if need in side.missing:
                return f"the {side.argument} clouds {side.missing[need]}"
    for side in (real, simulated):
        if not side.units[statistic.name]:
            return f"the {side.argument} clouds have no frame for it"
    return ""


def _unlike(real: _Side, simulated: _Side, sensor: Lidar | None) -> str:
    """Return how the sensors are unlike; "" if they have as many rings, or the rings of the one that is given."""
    a, b = len(real.rings), len(simulated.rings)
    if not a or not b or max(a, b) <= UNLIKE * min(a, b):
        return ""
    if sensor is not None and max(real.rings.max(), simulated.rings.max()) < sensor.pattern.shape[0]:
        return ""
    return f"the real clouds have points in {a} rings, the simulated ones in {b}"


def _are_compared(real: Estimate, simulated: Estimate) -> Any:
    """Return which cells have enough samples on both sides."""
    known = np.isfinite(real.value + simulated.value) & np.isfinite(real.error + simulated.error)
    return known & real.has(FEWEST) & simulated.has(FEWEST)


def _center(one: Estimate, cells: Any) -> Estimate:
    """Return values less their mean over some cells."""
    with np.errstate(invalid="ignore"):
        means = np.array([_mean(values[cells]) for values in one.resampled])
    return replace(one, value=one.value - _mean(one.value[cells]), resampled=one.resampled - means[:, None])


def _mean(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def _estimate(statistic: Statistic, real: Units, simulated: Units, seed: int) -> tuple[Estimate, Estimate]:
    """Return the estimates of both sides; units are resampled in pairs if there are as many on both sides."""
    if isinstance(statistic.summary, Divergence):
        return divergence(real, simulated, seed)
    cells = max(real.cells, simulated.cells)
    unpaired = len(real) != len(simulated)
    return (
        estimate(statistic.summary, real, cells, seed),
        estimate(statistic.summary, simulated, cells, seed + unpaired),
    )


@dataclass(frozen=True, slots=True)
class _Contrast:
    """The estimates of both sides, and which of their cells are compared.

    Attributes
    ----------
    real, simulated : Estimate
        The estimates; with a last cell for the mean over all others if it is pooled.
    compared : ndarray of bool, shape (cells,)
        Which cells have enough samples.
    relevant, error : ndarray of float64, shape (cells,)
        Limit of what is relevant, and standard error of the difference.
    pooled : bool
        Whether the last cell is the mean over all others.
    """

    real: Estimate
    simulated: Estimate
    compared: Any
    relevant: Any
    error: Any
    pooled: bool


def _contrast(statistic: Statistic, real: Estimate, simulated: Estimate) -> _Contrast:
    """Return both sides of a measure side by side, centred and pooled as the measure says."""
    compared = _are_compared(real, simulated)
    if statistic.centred:
        real, simulated = _center(real, compared), _center(simulated, compared)
    relevant = np.maximum(statistic.least, statistic.relative * np.abs(real.value))
    # Shares and what is centred have the same mean on both sides.
    several = compared.sum() > 1 and not statistic.centred and not isinstance(statistic.summary, Share)
    if several:
        # Cells count by their samples, in units of what is relevant in them.
        n = 1.0 / (1.0 / real.count[compared] + 1.0 / simulated.count[compared])
        weight = n / relevant[compared]
        weight /= weight.sum()
        relevant = np.append(relevant, weight @ relevant[compared])
        real, simulated = (_with_mean(one, compared, weight, n / n.sum()) for one in (real, simulated))
        compared = np.append(compared, True)
    return _Contrast(real, simulated, compared, relevant, error_of_difference(real, simulated), several)


def _with_mean(one: Estimate, cells: Any, weight: Any, share: Any) -> Estimate:
    """Return an estimate with one more cell, the weighted mean of some; a share of the samples weights its units."""
    drawn = one.resampled[:, cells]
    drawn = np.where(np.isfinite(drawn), drawn, one.value[cells]) @ weight
    floor = float(np.sqrt(((weight * one.floor[cells]) ** 2).sum()))
    inflation = np.sqrt(share @ one.units[cells] / (share @ one.units[cells] - 1.0))
    more = {
        "value": weight @ one.value[cells],
        "count": one.count[cells].sum(),
        "units": share @ one.units[cells],
        "error": max(float(drawn.std(ddof=1)) * inflation, floor),
        "floor": floor,
    }
    appended = {name: np.append(getattr(one, name), value) for name, value in more.items()}
    return Estimate(**appended, resampled=np.column_stack([one.resampled, drawn]))


def _measure(statistic: Statistic, contrast: _Contrast, tests: int) -> Measure:
    """Return the verdict on a measure."""
    real, simulated, compared, relevant = contrast.real, contrast.simulated, contrast.compared, contrast.relevant
    difference = simulated.value - real.value
    chance = critical(tests, np.minimum(real.units, simulated.units)) * contrast.error
    least = np.where(compared, np.maximum(chance, relevant), np.nan)
    size = difference if statistic.upwards else np.abs(difference)
    differs = size > least
    drawn = simulated.resampled - real.resampled
    told = np.flatnonzero((real.count > 0) | (simulated.count > 0))
    if isinstance(statistic.summary, Share):  # every cell has a share, which may be 0
        told = np.flatnonzero(np.nan_to_num(real.value) + np.nan_to_num(simulated.value) > 0)
    cells = {
        int(i): Cell(
            label="all" if contrast.pooled and i == len(compared) - 1 else statistic.cells.label(int(i)),
            real=float(real.value[i]),
            simulated=float(simulated.value[i]),
            real_interval=real.interval(int(i)),
            simulated_interval=simulated.interval(int(i)),
            difference=float(difference[i]),
            difference_interval=interval(drawn[:, i]),
            n_real=round(real.count[i]),
            n_simulated=round(simulated.count[i]),
            least=float(least[i]),
            differs=bool(differs[i]),
        )
        for i in told
    }
    if not compared.any():
        why = f"no part of it has {FEWEST} samples in {FEWEST_UNITS} blocks on both sides"
        return replace(_refuse(statistic, why), cells=tuple(cells.values()))
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(compared, size / least, -np.inf)
    excess[np.isnan(excess)] = 0.0  # no difference where none would be too small
    worst = int(np.argmax(excess))
    number = int(differs.sum())
    of = f" in {number} of {int(compared.sum())} cells" if compared.sum() > 1 else ""
    verdict: Verdict = "differs" if number else "alike" if _tells(contrast, chance) else "cannot tell"
    # What would have counted over all, or typically in a cell.
    over = np.flatnonzero(compared)[-1:] if contrast.pooled else np.flatnonzero(compared)
    typical, matters = (float(np.median(limit[over])) for limit in (least, relevant))
    if number:
        why = f"the difference is relevant and beyond chance{of}"
    elif verdict == "cannot tell":
        why = f"chance could hide differences up to {typical:.2g} {statistic.unit}; {matters:.2g} would be relevant"
    elif typical:
        why = f"differences above {typical:.2g} {statistic.unit} would have counted{', typically' if of else ''}"
    else:
        why = "any difference would have counted"
    headline = cells.get(worst) or next(iter(cells.values()))
    return Measure(
        name=statistic.name,
        unit=statistic.unit,
        verdict=verdict,
        why=why,
        where=headline.label,
        by=statistic.cells.what,
        meaning=statistic.meaning,
        cells=tuple(cells.values()),
        **{part.name: getattr(headline, part.name) for part in fields(Contrast)},
    )


def _tells(contrast: _Contrast, chance: Any) -> bool:
    """Return whether a relevant difference would have been beyond chance: over all, or for half of the samples."""
    clear = chance <= contrast.relevant
    if contrast.pooled:
        return bool(clear[-1])
    n = np.where(contrast.compared, np.minimum(contrast.real.count, contrast.simulated.count), 0.0)
    return bool(n[clear].sum() >= 0.5 * n.sum())


def _refuse(statistic: Statistic, why: str) -> Measure:
    return Measure(
        name=statistic.name,
        unit=statistic.unit,
        verdict="not measured",
        why=why,
        by=statistic.cells.what,
        meaning=statistic.meaning,
    )
