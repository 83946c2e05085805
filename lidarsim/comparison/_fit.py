"""Fits of a sensor to frames of a real unit: values of its measurement, each with an interval, or why there is none.

`_Captures` adds up sums over the frames, by the samples of the measures of `compare` where there are such. From these,
each function marked by `value` estimates one parameter of the sensor, or raises `UntoldError` with the reason why the
frames do not tell it. Later estimates use earlier ones: they are made in the order of this module.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, shown
from lidarsim.comparison._frame import Frame, Image, Mask, tile_shape
from lidarsim.comparison._inferred import Beams, NoRingsError, rings_of
from lidarsim.comparison._measures import INTENSITIES, RANGES, SIGMA, STEPS, bin_of, range_noise, ring_bias, smooth
from lidarsim.comparison._result import Cell, Comparison, Interval, Measure, Side
from lidarsim.comparison._sources import Source, intensity_unit
from lidarsim.comparison._statistics import (
    Estimate,
    Histogram,
    Indices,
    Mean,
    Rate,
    Samples,
    Step,
    Summary,
    Units,
    critical,
    estimate,
    robust_sigma,
)
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.lidar import Lidar
from lidarsim.materials import ASPHALT, Material
from lidarsim.patterns import Spinning, Table
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan
from lidarsim.sensor.measurement import Detection, Response
from lidarsim.world.scene import Scene
from lidarsim.world.shapes import Plane

FEWEST_POINTS = 1000
"""Fewest points of all frames that are fitted."""
FEWEST = 300
"""Fewest samples of a value."""
MISFIT = math.radians(1.0)
"""Median angle between the points and the beams of their rings above which frames are of another sensor. Units of one
model differ by 0.5° at most."""
POWERS = np.arange(-18.0, 4.05, 0.05)
"""Edges of the bins of the logarithm of the received power, I/R², 1/m²."""
FAINT = 6.0
"""Standard deviations of the logarithm of the power above the detection limit from which each pulse is detected: 3.7
for 1 in 10,000, and the rest for the neighbours that tell the power."""
LEVEL_COUNT = 1 << 16
"""Most intensities that a sensor reports as whole numbers of steps."""
STEPS_OF_NOISE = 20.0
"""Steps of the intensity from which its noise is measured: the rounding is then below 1.5 %."""
FEWEST_STEPS = 5.0
"""Steps of the intensity from which its mean is right beside the rounding."""
GROUND = 0.15
"""Greatest height of ground points over their plane near the sensor, m."""
APPROACHES = np.geomspace(0.01, 100.0, 922)
"""Edges of the bins of the range, m, 1 % wide."""
EDGES = 20
"""Surfaces cut off by the least range that tell it."""
SEEN = 0.995
"""Quantile of the ranges of ground points up to which the ground is taken for level."""
RETURNING = 0.97
"""Share of the pulses that are not dropped from which the intensities of the ground are those of all its echoes."""


class UntoldError(Exception):
    """The frames do not tell a value; the message says why."""


@dataclass(frozen=True)
class Found:
    """A value that the frames tell.

    Attributes
    ----------
    value : float, or tuple of (range, value)
        The value, or a table.
    interval : tuple of float
        Its 95 % interval; of a table that of its mean.
    count : int
        Number of samples.
    how : str
        What it rests on.
    rows : tuple of (label, value, low, high, count)
        Its parts: rows of a table, or rings.
    changes : dict
        Parameters of the measurement that the value replaces, or that take its place.
    """

    value: float | tuple[tuple[float, float], ...]
    interval: Interval
    count: int
    how: str
    rows: tuple[tuple[str, float, float, float, int], ...] = ()
    changes: dict[str, Any] = field(default_factory=dict)

    @property
    def mean(self) -> float:
        """The value, or the mean of a table, weighted by its samples."""
        if isinstance(self.value, float):
            return self.value
        return float(np.average([row[1] for row in self.rows], weights=[row[4] for row in self.rows]))


VALUES: dict[str, tuple[str, Callable[[_Captures], Found]]] = {}
"""Unit and estimator of each value by its name: attributes of the `Measurement` or the `Lidar`, with dots between."""


def value(name: str, unit: str = "1") -> Callable[[Callable[[_Captures], Found]], Callable[[_Captures], Found]]:
    """Register an estimator."""

    def register(function: Callable[[_Captures], Found]) -> Callable[[_Captures], Found]:
        VALUES[name] = unit, function
        return function

    return register


def fit_source(real: Source, sensor: Lidar, ground: Material | None) -> tuple[Lidar, Comparison]:
    """Fit a sensor to frames; see `lidarsim.fit`."""
    captures = _Captures(sensor, ground)
    for given in real.frames:
        captures.add(given)
    if captures.points < FEWEST_POINTS:
        raise ArgumentValueError("real", f"{FEWEST_POINTS:,} points or more", f"{captures.points:,}")
    measures = []
    for name, (unit, estimator) in VALUES.items():
        meaning = " ".join((estimator.__doc__ or "").split())
        old = _attribute(captures.lidar, name)
        try:
            found = estimator(captures)
        except UntoldError as error:
            measures.append(Measure(name=name, unit=unit, verdict="not measured", why=str(error), meaning=meaning))
        else:
            found = _rounded(found)
            captures.lidar = _with(captures.lidar, name, found)
            measures.append(_measure(name, unit, meaning, found, old))
    rings = len(captures.rings)
    sides = Side(real.name, captures.frames, captures.points, rings), Side(sensor.name, 0, 0, sensor.pattern.shape[0])
    notes = (f"the rings of the real clouds are inferred from {captures.inferred}",) if captures.inferred else ()
    return captures.lidar, Comparison(tuple(measures), *sides, notes)


def sensor_of(given: str | os.PathLike[str] | Lidar) -> tuple[Lidar, str | None]:
    """Return the sensor to start from and, of a preset, its noise: measured if it has that, else of the datasheet.

    Parameters
    ----------
    given : str, path-like or Lidar
        A preset, a file or a sensor.

    Raises
    ------
    TypeError, ValueError
        If it is none of these.
    """
    if isinstance(given, Lidar):
        return given, None
    if not isinstance(given, str | os.PathLike):
        raise ArgumentTypeError("sensor", "a Lidar, the name of a preset or a file", shown(given))
    if Path(given).suffix:
        return Lidar.from_file(Path(given)), None
    for noise in ("measured", "datasheet"):
        try:
            return Lidar.preset(str(given), noise=noise), noise
        except ArgumentValueError as error:
            if error.argument != "noise":
                raise
    return Lidar.preset(str(given)), None


def recognised(real: Source) -> tuple[Source, str]:
    """Return the same frames, and the name of the spinning preset on whose beams the points of the first one are.

    Raises
    ------
    ValueError
        If there is none.
    """
    first = next(real.frames, None)
    cloud = first.point_cloud() if isinstance(first, Scan) else first
    found: dict[str, float] = {}
    for name in Lidar.presets() if cloud is not None and len(cloud) else ():
        lidar = Lidar.preset(name)
        if cloud is None or not isinstance(lidar.pattern, Spinning):
            continue
        xyz = cloud.xyz[np.isfinite(cloud.xyz).all(axis=1) & cloud.xyz.any(axis=1)]
        try:
            ring = cloud.ring[np.isfinite(cloud.xyz).all(axis=1) & cloud.xyz.any(axis=1)].astype(np.intp)
        except AttributeError:
            try:
                ring, _ = rings_of(lidar, xyz)
            except NoRingsError:
                continue
        if 0.9 * lidar.pattern.shape[0] <= len(np.unique(ring)) and ring.max() < lidar.pattern.shape[0]:
            found[name] = _misfit(Beams.of(lidar), xyz, ring)
    best = min(found, key=lambda name: found[name], default="")
    if not best or found[best] > MISFIT:
        raise ArgumentValueError("preset", "the name of a sensor", "none", "no preset has beams where the points are")
    return replace(real, frames=chain([] if first is None else [first], real.frames)), best


def _misfit(beams: Beams, xyz: Floats, ring: npt.NDArray[np.integer]) -> float:
    """Return the median over the rings of the angle between their points and their beams, rad."""
    angles = []
    for place, name in enumerate(beams.ring):
        mine = np.flatnonzero(ring == name)
        mine = mine[:: max(len(mine) // 1000, 1)]
        if len(mine):
            reach = np.sqrt((xyz[mine] ** 2).sum(axis=1))
            angles.append(abs(float(np.median(beams.away(place, xyz[mine]) / reach))))
    return float(np.median(angles))


def _attribute(lidar: Lidar, name: str) -> Any:
    """Return a value of a sensor by its name; None if it has no such part."""
    found: Any = lidar if hasattr(lidar, name) else lidar.measurement
    for part in name.split("."):
        found = getattr(found, part, None)
    return found


def _rounded(found: Found) -> Found:
    """Return a value with the digits that files have."""
    if isinstance(found.value, tuple):
        return replace(found, value=tuple((float(f"{at:.3g}"), float(f"{one:.6g}")) for at, one in found.value))
    return replace(found, value=float(f"{found.value:.6g}"))


def _with(lidar: Lidar, name: str, found: Found) -> Lidar:
    """Return a sensor with a value."""
    changes: dict[str, Any] = {name: found.value}
    if hasattr(lidar, name):
        return replace(lidar, **changes)
    whole, _, part = name.partition(".")
    if part:
        old = getattr(lidar.measurement, whole) or (Detection(0.1, 1.0) if whole == "detection" else Response())
        changes = {whole: replace(old, **{part: found.value})}
    return replace(lidar, measurement=replace(lidar.measurement, **(changes | found.changes)))


def _measure(name: str, unit: str, meaning: str, found: Found, old: Any) -> Measure:
    """Return a value beside that of the sensor as it was."""
    low, high = found.interval
    table = old if isinstance(old, tuple) else None
    cells = []
    for label, new, *ends, count in found.rows:
        at = float(label.removesuffix(" m")) if label.endswith(" m") else math.nan
        was = math.nan if math.isnan(at) or old is None else _at(table, at) if table else float(old)
        cells.append(
            Cell(
                label=label,
                real=new,
                simulated=was,
                real_interval=(ends[0], ends[1]),
                difference=was - new,
                n_real=count,
                differs=not math.isnan(was) and not ends[0] <= was <= ends[1],
            )
        )
    if table:
        weights = [cell.n_real for cell in cells]
        was = float(np.average([cell.simulated for cell in cells], weights=weights)) if cells else _at(table, 10.0)
    else:
        was = math.nan if old is None else float(old)
    differs = any(cell.differs for cell in cells) or not low <= was <= high
    return Measure(
        name=name,
        unit=unit,
        verdict="differs" if differs else "alike",
        why=found.how,
        where="all" if cells else "",
        by="range" if isinstance(found.value, tuple) else "ring" if cells else "",
        meaning=meaning,
        cells=tuple(cells),
        real=found.mean,
        simulated=was,
        real_interval=found.interval,
        difference=was - found.mean,
        n_real=found.count,
    )


def _at(table: tuple[tuple[float, float], ...], at: float) -> float:
    """Return a table at a range."""
    ranges, values = zip(*table, strict=True)
    return float(np.interp(at, ranges, values))


BY_RANGE = len(RANGES) - 1
SUMS: dict[str, tuple[Summary, int | None]] = {
    "noise": (SIGMA, BY_RANGE),
    "noise at": (Mean(), BY_RANGE),
    "bias": (Mean(), None),
    "brightness": (Mean(), None),
    "step": (Step(STEPS), 3),
    "holes": (Rate(), len(POWERS)),
    "ground": (Rate(), len(POWERS)),
    "ground by range": (Rate(), BY_RANGE),
    "factor": (Mean(), BY_RANGE),
    "factor at": (Mean(), BY_RANGE),
    "flicker": (Histogram(SIGMA.edges, robust_sigma()), 1),
    "rounding": (Mean(), 1),
}
"""What is added up over the frames: how, and the number of cells; None: the rings."""


class _Captures:
    """What the frames tell so far, and the sensor with the values found so far.

    Parameters
    ----------
    sensor : Lidar
        The sensor as it is before the fit.
    ground : Material, optional
        What the ground is made of, if it is known.
    """

    def __init__(self, sensor: Lidar, ground: Material | None) -> None:
        self.lidar, self.known_ground, self.ground = sensor, ground is not None, ground or ASPHALT
        self.frames = self.points = 0
        self.rings = np.zeros(0, np.intp)
        self.inferred = ""
        self.missing: dict[str, str] = {}
        self.units = {name: Units() for name in SUMS}
        self.beams = Beams.of(sensor)
        self.rows: tuple[Indices, int] | None = None
        """Rings by rising elevation, and rows of a tile."""
        self.levels: npt.NDArray[np.float64] = np.zeros(0)
        """Intensities, rising, up to twice `LEVEL_COUNT`."""
        self.level_counts: Indices = np.zeros(0, np.intp)
        self.least, self.cuts = math.inf, np.zeros(0)
        """Least range, and ranges, rising, at which surfaces end that come nearer, m."""
        self.approaches = np.zeros((len(APPROACHES) - 1, 2))
        """How often surfaces that come nearer are seen at a range, and how often they end there."""
        self._unit: float | None = None
        self._last: tuple[Image, Floats] | None = None
        self._cosines = np.linspace(0.0, 1.0, 257)
        self._reflected = _reflected(self.ground, self._cosines)
        self.ground_rings = np.zeros((BY_RANGE, sensor.pattern.shape[0]), bool)
        """Which rings see the ground in each bin of range."""

    @property
    def fluctuation(self) -> tuple[float, float, float]:
        """Standard deviation of the logarithm of the power, between the ends of its interval if it is fitted."""
        try:
            low, high = self.fade.sigma_interval
        except UntoldError:
            low = high = self.lidar.measurement.power_sigma
        return low, self.lidar.measurement.power_sigma, high

    @property
    def ground_rate(self) -> float:
        """Greatest share of the pulses that the ground returns at a range; 0 if none is known."""
        found = self.estimate("ground by range")
        return float(found.value[(found.count >= 100) & (found.units >= 4)].max(initial=0.0))

    @cached_property
    def fade(self) -> Fade:
        """How returns from the ground fade."""
        return _fade(self)

    def estimate(self, name: str) -> Estimate:
        """Return the estimate of a sum, or raise the reason why there is none."""
        summary, cells = SUMS[name]
        units = self.units[name]
        if not len(units):
            raise UntoldError(self._reason(name))
        return estimate(summary, units, units.cells if cells is None else cells, seed=list(SUMS).index(name))

    def _reason(self, name: str) -> str:
        if "column" in self.missing:
            return f"the clouds {self.missing['column']}"
        if name in {"flicker", "rounding"}:
            return "this takes two frames of a sensor that stands still" + self._dark()
        if name in {"ground", "ground by range"}:
            return "no ground is seen: no level plane of 500 points or more below the sensor"
        return (self.missing.get("intensity") and "the clouds have no intensity") or self._dark("all intensities are 0")

    def _dark(self, text: str = ", and intensities that are not 0") -> str:
        return text if self.level_counts.size and self.levels.max() == 0.0 else ""

    def add(self, given: PointCloud | Scan) -> None:
        """Add what a frame tells."""
        if self._unit is None:
            self._unit = intensity_unit(given)
            response = self.lidar.measurement.response
            if self._unit != 1.0 and response is not None and response.resolution:
                self._unit = 1.0 / response.resolution  # counts of the vendor, as the preset has them
        frame = Frame.of(given, self.lidar, self._unit)
        self.frames += 1
        self.points += len(frame)
        if not len(frame):
            return
        self.missing |= frame.missing
        self.inferred = self.inferred or frame.inferred
        if frame.ring is None:
            raise ArgumentValueError("real", f"frames of {self._name}", f"clouds that {frame.missing['ring']}")
        self._check(frame)
        self.rings = np.union1d(self.rings, frame.ring)
        ranges = self._reported(frame)
        self.least = min(self.least, float(ranges.min()))
        self._take("step", _steps(frame, ranges))
        if frame.intensity is not None:
            self._add_levels(frame.intensity)
        if frame.image is None:
            return
        self._add_cuts(frame.image, ranges)
        self._add_image(frame, frame.image)

    def _add_image(self, frame: Frame, image: Image) -> None:
        """Add what rings and columns tell."""
        bright = frame.intensity
        self.rows = self.rows or (image.rings, tile_shape(image)[0])
        noise = range_noise(frame)
        ranges = noise.other
        assert ranges is not None  # noqa: S101 - `range_noise` gives them
        # Nearer, the least range may cut off a part of the noise.
        nearest = 1.2 * float(np.nanmin(image.reach))
        told = (noise.cell >= 0) & (ranges > nearest)
        noise = replace(noise, cell=np.where(told, noise.cell // (len(INTENSITIES) - 1), -1))
        self._take("noise", noise)
        self._take("noise at", Samples(noise.cell, noise.block, ranges))
        self._take("bias", ring_bias(frame))
        lit = bright is not None and bool((bright > 0.0).any())
        power = np.full(image.reach.shape, np.nan)
        shining = np.full(image.reach.shape, np.nan)
        if lit and bright is not None:
            seen = image.point >= 0
            shining[seen] = bright[image.point[seen]]
            # An intensity of 0 counts as 1e-9, which lies below all `POWERS` from 0.26 m on.
            power = np.log(np.maximum(self._intensity(shining, image.reach), 1e-9)) - 2.0 * np.log(image.reach)
            self._take("brightness", _brightness(image, np.where(self._clear(shining), shining, np.nan)))
            self._add_flicker(image, shining)
            self._last = image, shining
        agree = smooth(image)
        agree &= image.reach[:, 1:-3] > nearest
        near = power[:, 1:-3] + power[:, 3:-1]
        # Without intensities, what is near is as bright as a surface of a tenth.
        other = np.log(0.1) - 2.0 * np.log(image.reach[:, 1:-3])
        cell = bin_of(np.where(np.isfinite(near), 0.5 * near, other)[agree], POWERS)
        lost = image.lost[:, 2:-2][agree].astype(np.float64)
        self._take("holes", Samples(cell, image.block[:, 2:-2][agree], lost))
        self._add_ground(image, shining)

    @property
    def _name(self) -> str:
        return self.lidar.name or "the sensor"

    def _check(self, frame: Frame) -> None:
        """Raise an error if the frame is not of the sensor."""
        assert frame.ring is not None  # noqa: S101 - see `add`
        rings = self.lidar.pattern.shape[0]
        if frame.ring.max() >= rings:
            raise ArgumentValueError("real", f"frames of {self._name} with {rings} rings", f"ring {frame.ring.max()}")
        misfit = _misfit(self.beams, frame.xyz, frame.ring)
        if misfit > MISFIT:
            got = f"points {np.degrees(misfit):.1f}° from the beams of their rings"
            raise ArgumentValueError("real", f"frames of {self._name}", got, "is it another sensor?")

    def _reported(self, frame: Frame) -> Floats:
        """Return the range of each point as the sensor reports it: from the origin of its beam, and its offset."""
        ranges = np.empty(len(frame))
        offsets = np.broadcast_to(self.lidar.range_offset, self.lidar.pattern.shape[:1])
        for place, ring in enumerate(self.beams.ring):
            mine = frame.ring == ring
            ranges[mine] = self.beams.range(place, frame.xyz[mine]) + offsets[ring]
        return ranges

    def _take(self, name: str, samples: Samples) -> None:
        summary, cells = SUMS[name]
        if len(samples.cell):
            count = int(samples.cell.max(initial=0)) + 1 if cells is None else cells
            self.units[name].add(summary.sums(samples, count))

    def _add_levels(self, bright: Floats) -> None:
        values, counts = np.unique(np.concatenate([self.levels, bright[np.isfinite(bright)]]), return_inverse=True)
        total = np.bincount(counts, np.concatenate([self.level_counts, np.ones(len(counts) - len(self.level_counts))]))
        # Of continuous intensities, the greatest tell enough.
        self.levels, self.level_counts = values[-2 * LEVEL_COUNT :], total[-2 * LEVEL_COUNT :].astype(np.intp)

    def _intensity(self, reported: Floats, reach: Floats) -> Floats:
        """Return the intensities that the sensor's response makes the reported ones."""
        response = self.lidar.measurement.response
        if response is None:
            return reported
        factor = 1.0 if response.range is None else np.interp(reach, *np.transpose(response.range))
        intensity: Floats = reported ** (1.0 / response.exponent) / np.maximum(factor, 1e-6)
        return intensity

    def _add_cuts(self, image: Image, ranges: Floats) -> None:
        """Add at which ranges surfaces that come nearer along a ring end, and at which they go on."""
        for ahead in (slice(None), slice(None, None, -1)):
            point, lost = image.point[:, ahead], image.lost[:, ahead][:, :-3]
            near = np.where(point >= 0, ranges[point], np.nan)
            a, b, c = (1.0 / near[:, k : near.shape[1] - 3 + k] for k in (1, 2, 3))
            with np.errstate(invalid="ignore"):
                smooth = (np.abs(a - 2.0 * b + c) < 0.02 * a) & (a > b) & (b > c) & image.fired[:, ahead][:, :-3]
            last = 1.0 / a
            self.cuts = np.sort(np.concatenate([self.cuts, last[smooth & lost]]))[:10_000]
            for k, chosen in enumerate((smooth, smooth & lost)):
                self.approaches[:, k] += np.histogram(last[chosen], APPROACHES)[0]

    def _add_flicker(self, image: Image, shining: Floats) -> None:
        """Add by how much intensities differ from those of the frame before, if the sensor stands still."""
        last, bright = self._last or (image, shining)
        if self._last is None or last.reach.shape != image.reach.shape:
            return
        with np.errstate(invalid="ignore", divide="ignore"):
            still = np.abs(image.reach - last.reach) < 0.05
            still &= np.linalg.norm(image.direction - last.direction, axis=-1) < 0.1 * abs(image.step)
            if still.sum() < 0.5 * np.isfinite(image.reach).sum():
                return
            chosen = still & self._clear(shining) & image.planes.on & (np.minimum(shining, bright) > 0.0)
            ratio = np.abs(np.log(shining[chosen] / bright[chosen])) / math.sqrt(2.0)
        zero, block = np.zeros(len(ratio), np.intp), image.block[chosen]
        self._take("flicker", Samples(zero, block, ratio))
        self._take("rounding", Samples(zero, block, 0.5 / shining[chosen] ** 2 + 0.5 / bright[chosen] ** 2))

    @property
    def step_of_intensity(self) -> float:
        """Step of which all intensities are multiples; 0 if there is none."""
        levels = self.levels[:-1]  # the greatest may be a limit between steps
        if not 2 <= len(levels) <= LEVEL_COUNT:
            return 0.0
        step = float(np.diff(levels).min())
        for level in levels[np.unique(np.geomspace(1, len(levels) - 1, 60).astype(np.intp))]:
            step = level / max(np.rint(level / step), 1.0)  # the differences of float32 are less exact
        counts = levels / step
        return float(step) if (np.abs(counts - np.rint(counts)) < 0.02 + 1e-6 * counts).all() else 0.0

    def _clear(self, shining: Floats) -> Mask:
        """Return the pixels whose neighbours are brighter than the rounding and darker than the greatest intensity.

        Neighbours choose them, so that their own noise does not.
        """
        guide = np.pad(0.5 * (shining[:, 2:] + shining[:, :-2]), ((0, 0), (1, 1)), constant_values=np.nan)
        with np.errstate(invalid="ignore"):
            clear: Mask = (guide > STEPS_OF_NOISE * self.step_of_intensity) & (guide < 0.6 * self.levels[-1])
        return clear

    def _add_ground(self, image: Image, shining: Floats) -> None:
        """Add which pulses at the ground return, and how bright they are."""
        plane = _ground(image)
        if plane is None:
            return
        distance = 1.0 / np.linalg.norm(plane)
        cosine = np.abs(image.direction @ plane) * distance
        with np.errstate(divide="ignore", invalid="ignore"):
            towards = image.direction @ plane
            reach = np.where(towards > 0.0, 1.0 / towards, np.inf)
            flat = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
            height = distance * (1.0 - image.reach * towards)
            seen = image.point >= 0
            on = seen & (np.abs(height) < GROUND + 0.005 * image.reach)
            from scipy.ndimage import minimum_filter1d

            hiding = np.where(seen & ~on, image.reach * flat, np.inf).min(axis=0)
            hiding = minimum_filter1d(hiding, 7, mode="wrap")
            counts = image.fired & seen.any(axis=0) & (reach * flat < 0.95 * hiding - 0.2)
        counts &= (reach < self.lidar.max_range) & (reach > 1.1 * self.lidar.min_range)
        # Beyond the last returns nobody knows whether there is ground.
        far = 1.3 * np.quantile(reach[counts & on], SEEN) if (counts & on).any() else 0.0
        counts &= reach <= far
        bright = np.interp(cosine[counts], self._cosines, self._reflected)
        bright *= np.exp(-2.0 * self.lidar.measurement.extinction * reach[counts])
        with np.errstate(divide="ignore"):
            power = np.log(bright) - 2.0 * np.log(reach[counts])
        block, back = image.block[counts], on[counts].astype(np.float64)
        self._take("ground", Samples(bin_of(power, POWERS), block, back))
        cell = bin_of(reach[counts], RANGES)
        self._take("ground by range", Samples(cell, block, back))
        exponent = 1.0 if self.lidar.measurement.response is None else self.lidar.measurement.response.exponent
        told = np.isfinite(shining[counts]) & on[counts] & (bright > 0.0)
        if told.any() and (shining > 0.0).any():
            ratio = shining[counts][told] ** (1.0 / exponent) / bright[told]
            factor = Samples(cell[told], block[told], ratio, bright[told])
            self._take("factor", factor)
            self._take("factor at", replace(factor, value=reach[counts][told], weight=None))
            ring = np.broadcast_to(image.rings[:, None], counts.shape)[counts]
            self.ground_rings[cell[told], ring[told]] = True


def _reflected(material: Material, cosines: Floats) -> Floats:
    """Return the intensity of a material, without its texture, by the cosine of the angle of incidence."""
    even = Material(
        reflectivity=material.reflectivity,
        roughness=material.roughness,
        specular=material.specular,
        specular_width=material.specular_width,
    )
    scene = Scene()
    scene.add(Plane((1, 0, 0), 1.0), material=even)
    cosines = np.maximum(cosines, 1e-6)
    aside = np.sqrt(1.0 - cosines**2)
    pattern = Table(np.column_stack([cosines, aside, np.zeros_like(cosines)]), rate=1.0)
    scan = Lidar(pattern).scan(scene)
    return np.asarray(scan.intensity[:, 0], dtype=np.float64)


def _steps(frame: Frame, ranges: Floats) -> Samples:
    """Return ranges as drivers may have rounded them: those of the cloud, from the origin, and from the beams."""
    value = np.concatenate([frame.range, frame.reach, ranges])
    cell = np.repeat(np.arange(3), len(frame))
    return Samples(cell, np.tile(frame.block, 3), value)


def _brightness(image: Image, shining: Floats) -> Samples:
    """Return by how much the logarithm of the intensity of a ring deviates from linear over each plane."""
    rows, columns = tile_shape(image)
    with np.errstate(invalid="ignore", divide="ignore"):
        on = image.planes.on & (image.planes.cosine > 0.5) & (shining > 0.0)
        bright = np.log(shining) - np.log(image.planes.cosine)
    row, column = np.nonzero(on)
    tile = row // rows * (-(-on.shape[1] // columns)) + column // columns
    x = np.column_stack([np.ones(len(row)), row % rows, column % columns]).astype(np.float64)
    y, count = bright[on], int(tile.max(initial=-1)) + 1

    def total(values: Floats) -> Floats:
        sums: Floats = np.bincount(tile, values, count).astype(np.float64)
        return sums

    matrix = np.array([[total(x[:, i] * x[:, j]) for j in range(3)] for i in range(3)]).transpose(2, 0, 1)
    right = np.array([total(x[:, i] * y) for i in range(3)]).T
    fitted = (np.linalg.pinv(matrix) @ right[..., None])[..., 0]
    return Samples(image.rings[row], image.block[on], y - (x * fitted[tile]).sum(axis=1))


def _ground(image: Image) -> Floats | None:
    """Return the level plane below the sensor with the most points, w·x = 1; None if there is none of 500 points."""
    w = image.planes.normal
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.linalg.norm(w, axis=-1)
        level: Mask = image.planes.on & (-w[..., 2] > 0.97 * size) & (size < 1.0 / 0.3)
    if level.sum() < 500:
        return None
    points = image.direction[level] * image.reach[level][:, None]
    tried = np.unique(w[level], axis=0)

    def near(plane: Floats, cut: float) -> Mask:
        found: Mask = np.abs(points @ plane - 1.0) < cut * np.linalg.norm(plane)
        return found

    best = max(tried, key=lambda plane: int(near(plane, 0.1).sum()))
    for cut in (0.2, 0.1, 0.1):
        chosen = points[near(best, cut)]
        if len(chosen) < 500:
            return None
        best = np.linalg.lstsq(chosen, np.ones(len(chosen)), rcond=None)[0]
    return np.asarray(best, np.float64)


def _ends(center: float, error: float, units: float) -> Interval:
    """Return the interval of a value with its standard error from so many units."""
    reach = float(critical(1, np.array(units))) * error
    return max(float(center - reach), 0.0), float(center + reach)


@value("range_resolution", "m")
def _range_resolution(captures: _Captures) -> Found:
    """Greatest step, of those looked for, of which all ranges are multiples."""
    steps = captures.estimate("step")
    step = float(np.nanmax(steps.value))
    if not step:
        low, high = 1e3 * STEPS[0], 1e3 * STEPS[-1]
        raise UntoldError(f"ranges are no multiples of a common step from {low:g} to {high:g} mm")
    return Found(step, (step, step), int(steps.count[0]), "all ranges are multiples of it")


@value("range_sigma", "m")
def _range_sigma(captures: _Captures) -> Found:
    """Noise of the range within a ring on planes, from third differences of 1/range, less the rounding of the range.

    One number where all ranges agree to chance, else a table by range.
    """
    found, at = captures.estimate("noise"), captures.estimate("noise at").value
    rounding = captures.lidar.measurement.range_resolution
    with np.errstate(invalid="ignore"):
        square = found.value**2 - rounding**2 / 12.0
        told = (found.count >= FEWEST) & (found.units >= 4) & (square > (0.3 * rounding) ** 2)
    if not told.any():
        hidden = bool(((found.count >= FEWEST) & (found.units >= 4)).any())
        raise UntoldError(
            f"the rounding to {1e3 * rounding:g} mm hides it" if hidden else f"fewer than {FEWEST} samples on planes"
        )
    sigma, n = np.sqrt(square[told]), found.count[told]
    error = found.error[told] * found.value[told] / sigma
    units = found.units[told]
    ends = [_ends(*each) for each in zip(sigma, error, units, strict=True)]
    rows = tuple(
        (f"{place:.3g} m", float(one), *pair, int(count))
        for place, one, pair, count in zip(at[told], sigma, ends, n, strict=True)
    )
    how = "noise of all surfaces, weak echoes included, in place of other terms"
    changes = {"range_sigma_slope": 0.0, "range_sigma_limit": 0.0}
    weight = 1.0 / np.maximum(error, 1e-9) ** 2  # 1 nm, which no range resolves, where all samples are equal
    mean = float(np.average(sigma, weights=weight))
    interval = _ends(mean, float(weight.sum() ** -0.5), float(np.median(units)))
    if _agree(sigma, error, mean):
        return Found(mean, interval, int(n.sum()), f"{how}; all ranges agree", changes=changes)
    table = tuple((float(place), float(one)) for place, one in zip(at[told], sigma, strict=True))
    average = float(np.average(sigma, weights=n))
    spread = float(np.sqrt(((n / n.sum() * error) ** 2).sum()))
    interval = _ends(average, spread, float(np.median(units)))
    return Found(table, interval, int(n.sum()), f"{how}; by range", rows, changes)


def _agree(values: Floats, errors: Floats, mean: float) -> bool:
    """Return whether values are one number to chance: by their sum of squares, at the level of 5 %."""
    from scipy.special import chdtrc

    return len(values) < 2 or bool(chdtrc(len(values) - 1, (((values - mean) / errors) ** 2).sum()) > 0.05)


@value("channel_bias_sigma", "m")
def _channel_bias(captures: _Captures) -> Found:
    """How much rings are biased: standard deviation of their deviations from planes over several rings, less errors.

    Biases that a plane follows, equal ones and those linear in the elevation of neighbouring rings, do not show. If the
    rings differ, each gets its own deviation as `range_bias`, in place of one that is drawn.
    """
    found, rings = _ring_spread(captures, "bias", "deviations of rings from planes")
    if not found.interval[0]:
        return found
    biases = np.full(captures.lidar.pattern.shape[0], np.mean(captures.lidar.measurement.range_bias))
    biases[rings] += [deviation for _, deviation, *_ in found.rows]
    own = tuple(float(f"{bias:.4g}") for bias in biases)
    how = f"{found.how}, which are their range_bias in its place"
    return replace(found, how=how, changes={"range_bias": own, "channel_bias_sigma": 0.0})


def _ring_spread(captures: _Captures, name: str, how: str) -> tuple[Found, Indices]:
    """Return the standard deviation between rings of values that lack what is linear within the rows of a tile.

    The second array has the ring of each row.
    """
    from scipy.special import chdtri

    found = captures.estimate(name)
    if captures.rows is None:
        raise UntoldError("the clouds have no columns")
    rings, high = captures.rows
    rows, seen, squares, noise, freedom, count = [], [], 0.0, 0.0, 0, 0
    for start in range(0, len(rings), high):
        row = np.arange(start, min(start + high, len(rings)))
        ring = rings[row]
        told = ring < len(found.value)
        row, ring = row[told], ring[told]
        told = (found.count[ring] >= 50) & np.isfinite(found.error[ring]) & (found.units[ring] >= 4)
        row, ring = row[told], ring[told]
        if len(ring) < 4:
            continue
        q, _ = np.linalg.qr(np.column_stack([np.ones(len(row)), row - row.mean()]))
        rest = found.value[ring] - q @ (q.T @ found.value[ring])
        squares += float((rest**2).sum())
        noise += float((found.error[ring] ** 2 * (1.0 - (q**2).sum(axis=1))).sum())
        freedom += len(ring) - 2
        count += int(found.count[ring].sum())
        reach = critical(1, found.units[ring]) * found.error[ring]
        ends = zip(ring, rest, rest - reach, rest + reach, found.count[ring], strict=True)
        rows += [(f"ring {int(i)}", float(v), float(a), float(b), int(n)) for i, v, a, b, n in ends]
        seen.append(ring)
    if freedom < 4:
        raise UntoldError("fewer than 4 rings more than planes over them need have 50 points on planes")
    each = noise / freedom
    value = math.sqrt(max(squares / freedom - each, 0.0))
    low, high_end = (math.sqrt(max(squares / float(chdtri(freedom, share)) - each, 0.0)) for share in (0.025, 0.975))
    if not high_end:
        raise UntoldError("the errors of the rings hide it")
    spread = Found(value, (low, high_end), count, f"{how}, {len(rows)} rings", tuple(rows))
    return spread, np.concatenate(seen)


@value("response.resolution")
def _intensity_step(captures: _Captures) -> Found:
    """Step of which all intensities are multiples."""
    count = _count_intensities(captures)
    step = captures.step_of_intensity
    if not step:
        raise UntoldError("intensities are no multiples of a common step")
    return Found(step, (step, step), count, f"{len(captures.levels)} different intensities are multiples of it")


@value("response.limit")
def _intensity_limit(captures: _Captures) -> Found:
    """Greatest intensity, if more points have it than the tenth of the intensities below it."""
    count = _count_intensities(captures)
    most = float(captures.levels[-1])
    top = captures.level_counts[-1]
    below = captures.level_counts[:-1][captures.levels[:-1] > 0.9 * most].sum()
    if top < 20 or top <= below:
        raise UntoldError("no intensities pile up at the greatest")
    return Found(most, (most, most), count, f"{top:,} points have it")


def _count_intensities(captures: _Captures) -> int:
    """Return the number of intensities, or raise the reason why they tell nothing."""
    if "intensity" in captures.missing:
        raise UntoldError("the clouds have no intensity")
    if captures.levels[-1] == 0.0:
        raise UntoldError("all intensities are 0")
    return int(captures.level_counts.sum())


@value("detection.range", "m")
def _detection(captures: _Captures) -> Found:
    """Range of the detection limit, at its reflectivity, from the share of the pulses that the ground returns."""
    fade = captures.fade
    reflectivity = (captures.lidar.measurement.detection or Detection(0.1, 1.0)).reflectivity
    at, high, low = (math.sqrt(reflectivity) * math.exp(-0.5 * limit) for limit in (fade.limit, *fade.limit_interval))
    return Found(at, (low, high), fade.count, f"for a reflectivity of {reflectivity:g}; {fade.how}")


@value("power_sigma")
def _power_sigma(captures: _Captures) -> Found:
    """Scatter of the logarithm of the power, from how gradually returns from the ground fade with range."""
    fade = captures.fade
    return Found(fade.sigma, fade.sigma_interval, fade.count, fade.how)


@value("dropout")
def _dropout(captures: _Captures) -> Found:
    """Share of the pulses without a return between four neighbours that agree, where echoes are far above the limit."""
    from scipy.special import betaincinv

    errors = captures.lidar.measurement
    detection = errors.detection or Detection(0.1, 30.0)  # any lidar sees as far
    limit = math.log(detection.reflectivity / detection.range**2)
    bright = limit + 0.5 * errors.power_sigma**2 + max(FAINT * errors.power_sigma, 0.5)
    enough = bright < POWERS
    captures.estimate("holes")
    if len(captures.units["ground by range"]) and captures.ground_rate < 0.8:
        raise UntoldError("the ground does not return most pulses, so that the detection limit is not known")
    sums = captures.units["holes"].sums(len(POWERS))[:, enough].sum(axis=1)
    n, lost = sums[:, 1], sums[:, 2]
    if n.sum() < FEWEST_POINTS:
        raise UntoldError("too few pulses at smooth surfaces whose echoes are far above the detection limit")
    share = lost.sum() / n.sum()
    # Of blocks: the linearised variance of a ratio (W. G. Cochran, Sampling Techniques, Wiley, 1977, 2.11).
    units = np.count_nonzero(n)
    square = units / (units - 1.0) * ((lost - share * n) ** 2).sum() / n.sum() ** 2 if units > 1 else math.inf
    alike = min(n.sum(), share * (1.0 - share) / square) if share and square else n.sum()
    low, high = (
        float(betaincinv(share * alike + up, alike - share * alike + 1 - up, level)) if share or up else 0.0
        for up, level in ((0, 0.025), (1, 0.975))
    )
    return Found(float(share), (low, high), int(n.sum()), "pulses lost within smooth rings")


@value("response.ring_sigma")
def _ring_factors(captures: _Captures) -> Found:
    """How much the factors of rings scatter: standard deviation of their logarithms, from intensities on planes."""
    _count_intensities(captures)
    found, _ = _ring_spread(captures, "brightness", "intensities of rings on planes")
    response = captures.lidar.measurement.response or Response()
    scale = 1.0 / response.exponent
    low, high = found.interval
    return replace(
        found,
        value=scale * found.mean if isinstance(found.value, float) else found.value,
        interval=(scale * low, scale * high),
    )


@value("response.sigma")
def _flicker(captures: _Captures) -> Found:
    """Relative standard deviation of intensities from frame to frame, where the sensor stands still.

    Scatter along a ring is not told from the texture of surfaces. What `power_sigma` makes, fitted or
    not, is subtracted.
    """
    _count_intensities(captures)
    found, rounding = captures.estimate("flicker"), captures.estimate("rounding")
    if found.count[0] < FEWEST or found.units[0] < 4:
        raise UntoldError("too few points have the intensity and the place of the frame before")
    errors = captures.lidar.measurement
    exponent = 1.0 if errors.response is None else errors.response.exponent
    fluctuation = captures.fluctuation
    rounding_part = captures.step_of_intensity**2 / 12.0 * float(rounding.value[0])
    square, error = float(found.value[0] ** 2) - rounding_part, float(2.0 * found.value[0] * found.error[0])
    reach = float(critical(1, found.units)[0]) * error
    low, at, high = (
        max(square + by - (exponent * power) ** 2, 0.0) ** 0.5
        for by, power in zip((-reach, 0.0, reach), fluctuation[::-1], strict=True)
    )
    if not low and fluctuation[2]:
        raise UntoldError(f"the fluctuation of the power, {fluctuation[1]:.2g}, hides it")
    if not high:
        raise UntoldError("the rounding of intensities hides it")
    # In its middle 80 %, ln(1 + s·g) scatters like a normal number of standard deviation s·(1 + 0.6 s²).
    at, low, high = (each / (1.0 + 0.6 * each**2) for each in (at, low, high))
    return Found(at, (low, high), int(found.count[0]), "differences from frame to frame")


@value("response.range")
def _factors(captures: _Captures) -> Found:
    """Factor of intensities by range, from the ground, where all its echoes are detected."""
    _count_intensities(captures)
    if not captures.known_ground:
        raise UntoldError("it is not told from the reflectivity of surfaces; the argument ground gives that of one")
    rates, found = captures.estimate("ground by range"), captures.estimate("factor")
    sums = captures.units["factor"].sums(BY_RANGE).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        bright = sums[:, 2] / sums[:, 0]
        told = (
            (rates.value > RETURNING * (1.0 - captures.lidar.measurement.dropout))
            & (found.count >= FEWEST)
            & (found.units >= 4)
        )
        told &= bright > FEWEST_STEPS * captures.step_of_intensity
    if not told.any():
        raise UntoldError(f"nowhere {FEWEST} pulses or more meet the ground and all return")
    response = captures.lidar.measurement.response or Response()
    # Few rings see the ground at a range, and each has a factor of its own.
    rings = np.maximum(captures.ground_rings.sum(axis=1), 1)
    error = np.hypot(found.error, found.value * response.ring_sigma / np.sqrt(rings))
    at = captures.estimate("factor at").value
    table, rows = [], []
    for i in np.flatnonzero(told):
        table.append((float(at[i]), float(found.value[i])))
        ends = _ends(found.value[i], error[i], min(found.units[i], max(rings[i], 2.0)))
        rows.append((f"{at[i]:.3g} m", float(found.value[i]), *ends, int(found.count[i])))
    weight = found.count[told] / found.count[told].sum()
    interval = _ends(float(weight @ found.value[told]), float(np.sqrt(((weight * error[told]) ** 2).sum())), 16.0)
    return Found(tuple(table), interval, int(found.count[told].sum()), "from the ground given", tuple(rows))


@value("response.exponent")
def _exponent(_: _Captures) -> Found:
    """Exponent of the response to intensities."""
    raise UntoldError("this takes targets of known reflectivities")


@value("min_range", "m")
def _min_range(captures: _Captures) -> Found:
    """Least range: that at which surfaces end that come nearer along a ring, if they end at the same range."""
    if len(captures.cuts) < EDGES:
        raise UntoldError("no surfaces come so near")
    first, last = captures.cuts[0], captures.cuts[EDGES - 1]
    middle = np.sqrt(APPROACHES[1:] * APPROACHES[:-1])
    near, far = (
        captures.approaches[(middle > start * first) & (middle < end * first)].sum(axis=0)
        for start, end in ((0.99, max(last / first, 1.02)), (1.1, 1.5))
    )
    # Where the sensor is blind, more of them end than farther away, where pulses are lost as anywhere.
    often = near[1] * max(far[0], 1.0) > 3.0 * max(far[1], 1.0) * near[0]
    if not often or captures.least < first - 0.01 or last > 1.1 * first + 0.05:
        raise UntoldError("no surfaces are cut off at the least range")
    # The least of n numbers that are even from an unknown start on is beyond it by more than three mean gaps in 5 %.
    start = first - math.log(20.0) * (last - first) / (EDGES - 1) - captures.lidar.measurement.range_resolution
    return Found(float(captures.least), (float(start), float(captures.least)), EDGES, "surfaces end there")


@dataclass(frozen=True)
class Fade:
    """How returns from the ground fade with the received power.

    Attributes
    ----------
    limit, sigma : float
        Logarithm of the power at the detection limit, and standard deviation of that of the power of an echo.
    limit_interval, sigma_interval : tuple of float
        Their 95 % intervals.
    count : int
        Number of pulses.
    how : str
        What they rest on.
    """

    limit: float
    sigma: float
    limit_interval: Interval
    sigma_interval: Interval
    count: int
    how: str


def _fade(captures: _Captures) -> Fade:
    """Return how the ground fades, by maximum likelihood.

    A pulse of mean power P gives a point with probability (1 − d)·Φ((ln P − l − w²/2)/w): l is the logarithm of the
    power at the limit, d the share that returns from nowhere.
    """
    from scipy.optimize import minimize
    from scipy.special import log_ndtr, ndtr

    by_range = captures.estimate("ground by range")
    rates = by_range.value[(by_range.count >= 100) & (by_range.units >= 4)]
    if captures.ground_rate < 0.8:
        raise UntoldError("the ground does not return most pulses at any range")
    if rates.min() > 0.5:
        raise UntoldError("the ground returns most pulses wherever it is seen")
    units = captures.units["ground"].sums(len(POWERS))[..., 1:]
    units = units[units.sum(axis=(1, 2)) > 0]
    told = units.sum(axis=(0, 2)) > 0
    x, total, back = POWERS[told] + 0.5 * (POWERS[1] - POWERS[0]), units[:, told, 0], units[:, told, 1]

    def losses(parameters: Floats) -> Floats:
        """Return the negative logarithm of the likelihood of each unit."""
        start, log_width, lost = float(parameters[0]), float(parameters[1]), float(ndtr(parameters[2]))
        z = (x - start) * math.exp(-log_width)
        missed = np.log(1.0 - (1.0 - lost) * ndtr(z))  # of at least the share lost, which `bounds` keep above 2e-7
        of_units: Floats = -(back @ (np.log1p(-lost) + log_ndtr(z)) + (total - back) @ missed)
        return of_units

    start = np.array([x[np.argmin(np.abs(np.cumsum(back.sum(axis=0)) / back.sum() - 0.1))], -0.7, -2.5])
    bounds = [(-20.0, 5.0), (-4.0, 1.5), (-5.0, -0.5)]

    def loss(parameters: Floats) -> float:
        return float(losses(parameters).sum())

    best: Floats = minimize(loss, start, method="L-BFGS-B", bounds=bounds).x
    # Variances of units that are no independent pulses (P. J. Huber, Proc. 5th Berkeley Symposium, 1967).
    steps = 1e-3 * np.eye(3)
    slopes = np.array([losses(best + step) - losses(best - step) for step in steps]).T / 2e-3
    signs = ((1, 1), (-1, -1), (1, -1), (-1, 1))
    curve = np.array(
        [[sum(a * b * loss(best + a * one + b * other) for a, b in signs) for other in steps] for one in steps]
    )
    inverse, n = np.linalg.pinv(curve / 4e-6, hermitian=True), len(total)
    covariance = inverse @ (slopes.T @ slopes) @ inverse * n / max(n - 1.0, 1.0)
    reach = float(critical(1, np.array(n)))
    square = math.exp(2.0 * best[1])
    towards = np.array([1.0, -square, 0.0])
    limit, error = best[0] - 0.5 * square, reach * math.sqrt(towards @ covariance @ towards)
    ends = best[1] + reach * math.sqrt(covariance[1, 1]) * np.array([0.0, -1.0, 1.0])
    # The power of the echoes and the texture of the ground scatter together.
    sigma, low, high = np.sqrt(np.maximum(np.exp(2.0 * ends) - captures.ground.variation**2, 0.0)).tolist()
    reflectivity = captures.ground.reflectivity
    return Fade(
        limit=float(limit),
        sigma=sigma,
        limit_interval=(float(limit - error), float(limit + error)),
        sigma_interval=(low, high),
        count=int(total.sum()),
        how=f"returns from the ground, of reflectivity {reflectivity} and roughness {captures.ground.roughness:g}",
    )
