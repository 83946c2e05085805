"""What frames of a real unit tell of its sensor: sums over the frames, from which `_estimators` takes values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.comparison._frame import Frame, Image, Mask, check_reach, tile_shape
from lidarsim.comparison._inferred import Beams
from lidarsim.comparison._measures import INTENSITIES, RANGES, SIGMA, STEPS, bin_of, range_noise, smooth
from lidarsim.comparison._sources import intensity_unit
from lidarsim.comparison._statistics import (
    BLOCKS,
    Estimate,
    Histogram,
    Indices,
    Mean,
    Rate,
    Samples,
    Step,
    Summary,
    Units,
    estimate,
    robust_sigma,
)
from lidarsim.errors import ArgumentValueError
from lidarsim.lidar import Lidar
from lidarsim.materials import ASPHALT, Material
from lidarsim.patterns import Table
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan
from lidarsim.world.scene import Scene
from lidarsim.world.shapes import Plane

MISFIT = math.radians(1.0)
"""Median angle between the points and the beams of their rings above which frames are of another sensor. Units of one
model differ by 0.5° at most."""
POWERS = np.arange(-18.0, 4.05, 0.05)
"""Edges of the bins of the logarithm of the received power, I/R², 1/m²."""
LEVEL_COUNT = 1 << 16
"""Most intensities that a sensor reports as whole numbers of steps."""
FEWEST_STEPS = 5.0
"""Steps of the intensity from which its mean is right beside the rounding."""
BRIGHTEST = 0.6
"""Share of the greatest intensity up to which a limit does not cut off noise."""
STEPS_OF_NOISE = 20.0
"""Steps of the intensity from which its noise is measured: the rounding is then below 1.5 %."""
GROUND = 0.15
"""Greatest height of ground points over their plane near the sensor, m."""
NEAR_FIELD = 1.0
"""Range up to which captures lose more pulses on surfaces than farther away, m: see lidarsim/presets/README.md."""
APPROACHES = np.geomspace(0.01, 100.0, 922)
"""Edges of the bins of the range, m, 1 % wide."""
SEEN = 0.995
"""Quantile of the ranges of ground points up to which the ground is taken for level."""


class UntoldError(Exception):
    """The frames do not tell a value; the message says why."""


BY_RANGE = len(RANGES) - 1
SUMS: dict[str, tuple[Summary, int]] = {
    "noise": (SIGMA, BY_RANGE),
    "noise at": (Mean(), BY_RANGE),
    "step": (Step(STEPS), 3),
    "holes": (Rate(), BY_RANGE * len(POWERS)),
    "ground": (Rate(), len(POWERS)),
    "ground at": (Mean(), len(POWERS)),
    "ground by range": (Rate(), BY_RANGE),
    "factor": (Mean(), BY_RANGE),
    "factor at": (Mean(), BY_RANGE),
    "flicker": (Histogram(SIGMA.edges, robust_sigma), 1),
    "rounding": (Mean(), 1),
}
"""What is added up over the frames: how, and the number of cells."""


class Captures:
    """Sums over the frames so far, by the samples of the measures of `compare` where there are such.

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
        response = sensor.measurement.response
        self._curve = None if response is None or response.curve is None else np.transpose(response.curve)
        rings = sensor.pattern.shape[0]
        self.equations = {name: np.zeros((BLOCKS, rings, 2 + rings)) for name in ("bias", "brightness")}
        """Normal equations of what rings have of their own; see `_normal_equations`."""
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
        self._reflected = _reflect(self.ground, self._cosines)
        self.ground_rings = np.zeros((BY_RANGE, sensor.pattern.shape[0]), bool)
        """Which rings see the ground in each bin of range."""

    def estimate(self, name: str) -> Estimate:
        """Return the estimate of a sum, or raise the reason why there is none."""
        summary, cells = SUMS[name]
        if not len(self.units[name]):
            raise UntoldError(self.reason(name))
        return estimate(summary, self.units[name], cells, seed=list(SUMS).index(name))

    def reason(self, name: str) -> str:
        """Return the reason why there are no samples of a sum."""
        if "column" in self.missing:
            return f"the clouds {self.missing['column']}"
        if name in {"flicker", "rounding"}:
            return "this takes two frames of a sensor that stands still" + self._dark()
        if name in {"ground", "ground by range"}:
            return "no ground is seen: no level plane of 500 points or more below the sensor"
        if "intensity" in self.missing:
            return "the clouds have no intensity"
        return self._dark("all intensities are 0") or "no planes are seen"

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
        ranges = self._report_ranges(frame)
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
        noise = range_noise(frame)
        ranges = noise.other
        assert ranges is not None  # noqa: S101 - `range_noise` gives them
        # Nearer, the least range may cut off a part of the noise.
        nearest = 1.2 * float(np.nanmin(image.reach))
        told = (noise.cell >= 0) & (ranges > nearest)
        noise = replace(noise, cell=np.where(told, noise.cell // (len(INTENSITIES) - 1), -1))
        self._take("noise", noise)
        self._take("noise at", Samples(noise.cell, noise.block, ranges))
        on = image.planes.on & (image.planes.cosine > 0.3)
        self.equations["bias"] += _normal_equations(image, image.planes.deviation, on, self.lidar.pattern.shape[0])
        lit = bright is not None and bool((bright > 0.0).any())
        power = np.full(image.reach.shape, np.nan)
        shining = np.full(image.reach.shape, np.nan)
        if lit and bright is not None:
            seen = image.point >= 0
            shining[seen] = bright[image.point[seen]]
            # An intensity of 0 counts as 1e-9, which lies below all `POWERS` from 0.26 m on.
            power = np.log(np.maximum(self._intensity(shining, image.reach), 1e-9)) - 2.0 * np.log(image.reach)
            on = self._are_even(image, shining)
            with np.errstate(invalid="ignore", divide="ignore"):
                brightness = np.log(self.light(shining)) - np.log(image.planes.cosine)
            self.equations["brightness"] += _normal_equations(image, brightness, on, self.lidar.pattern.shape[0])
            self._add_flicker(image, shining)
            self._last = image, shining
        agree = smooth(image)
        agree &= image.reach[:, 1:-3] > nearest
        near = power[:, 1:-3] + power[:, 3:-1]
        # Without intensities, what is near is as bright as a surface of a tenth.
        other = np.log(0.1) - 2.0 * np.log(image.reach[:, 1:-3])
        cell = bin_of(np.where(np.isfinite(near), 0.5 * near, other)[agree], POWERS)
        ranges = image.reach[:, 1:-3][agree]
        far = (cell >= 0) & (ranges > NEAR_FIELD)
        cell = np.where(far, bin_of(ranges, RANGES) * len(POWERS) + cell, -1)
        lost = image.lost[:, 2:-2][agree].astype(np.float64)
        self._take("holes", Samples(cell, image.block[:, 2:-2][agree], lost))
        self._add_ground(image, self.light(shining))

    @property
    def _name(self) -> str:
        return self.lidar.name or "the sensor"

    def _check(self, frame: Frame) -> None:
        """Raise an error if the frame is not of the sensor."""
        assert frame.ring is not None  # noqa: S101 - see `add`
        rings = self.lidar.pattern.shape[0]
        if frame.ring.max() >= rings:
            raise ArgumentValueError("real", f"frames of {self._name} with {rings} rings", f"ring {frame.ring.max()}")
        angle = misfit(self.beams, frame.xyz, frame.ring)
        if angle > MISFIT:
            got = f"points {np.degrees(angle):.1f}° from the beams of their rings"
            raise ArgumentValueError(
                "real", f"frames of {self._name}", got, "another sensor, or points in the world, as of E57?"
            )
        check_reach("real", frame, self.lidar)

    def _report_ranges(self, frame: Frame) -> Floats:
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
            self.units[name].add(summary.sums(samples, cells))

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
        intensity: Floats = self.light(reported) ** (1.0 / response.exponent) / np.maximum(factor, 1e-6)
        return intensity

    def light(self, reported: Floats) -> Floats:
        """Return intensities before the curve of the response, from reported ones of the same shape."""
        return reported if self._curve is None else np.interp(reported, self._curve[1], self._curve[0])

    @property
    def brightest(self) -> float:
        """Greatest reported intensity below the part of the curve that is so flat that rounding leaves few levels."""
        if self._curve is None:
            return float(self.levels[-1])
        light, reported = self._curve[:, 1:]
        step = self.step_of_intensity
        flat = light[:-1] * np.diff(reported) / np.diff(light) < FEWEST_STEPS * step
        return float(min(self.levels[-1], reported[:-1][flat].min(initial=np.inf) - step))

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
            chosen = still & self._are_clear(shining) & image.planes.on & (np.minimum(shining, bright) > 0.0)
            ratio = np.abs(np.log(self.light(shining[chosen]) / self.light(bright[chosen]))) / math.sqrt(2.0)
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
        if counts[-1] > LEVEL_COUNT:  # the step of float32 itself
            return 0.0
        return float(step) if (np.abs(counts - np.rint(counts)) < 0.02 + 1e-6 * counts).all() else 0.0

    def _are_clear(self, shining: Floats) -> Mask:
        """Return the pixels whose neighbours are brighter than the rounding and darker than the greatest intensity.

        Neighbours choose them, so that their own noise does not.
        """
        guide = np.pad(0.5 * (shining[:, 2:] + shining[:, :-2]), ((0, 0), (1, 1)), constant_values=np.nan)
        with np.errstate(invalid="ignore"):
            clear: Mask = (guide > STEPS_OF_NOISE * self.step_of_intensity) & (guide < BRIGHTEST * self.brightest)
        return clear

    def _are_even(self, image: Image, shining: Floats) -> Mask:
        """Return the points on planes in tiles whose mean intensity is clear of rounding and of a limit.

        Whole tiles are selected: to select points by their own intensity would bias the factors of the rings.
        """
        with np.errstate(invalid="ignore"):
            on: Mask = image.planes.on & (image.planes.cosine > 0.5) & (shining > 0.0)
        tile = _tiles(image)
        count = np.bincount(tile[on], minlength=tile.max() + 1)
        mean = np.bincount(tile[on], shining[on], len(count)) / np.maximum(count, 1)
        even: Mask = (mean > FEWEST_STEPS * self.step_of_intensity) & (mean < BRIGHTEST * self.brightest)
        return on & even[tile]

    def _add_ground(self, image: Image, shining: Floats) -> None:
        """Add which pulses at the ground return, and how bright they are."""
        plane = _find_ground(image)
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
        level = bin_of(power, POWERS)
        self._take("ground", Samples(level, block, back))
        self._take("ground at", Samples(level, block, power))
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


def _reflect(material: Material, cosines: Floats) -> Floats:
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


def _tiles(image: Image) -> Indices:
    """Return the tile of each pixel, by row, shape (R, C)."""
    rows, columns = tile_shape(image)
    high, wide = image.reach.shape
    tile: Indices = np.add.outer(np.arange(high) // rows * -(-wide // columns), np.arange(wide) // columns)
    return tile


def _normal_equations(image: Image, values: Floats, on: Mask, rings: int) -> Floats:
    """Return the normal equations for one number per ring: each value is that number plus a plane over its tile.

    The planes are eliminated. Shape (BLOCKS, rings, 2 + rings): number of points, right-hand side, and matrix row of
    each block and ring.
    """
    rows, columns = tile_shape(image)
    row, column = np.nonzero(on)
    all_tiles = _tiles(image)
    tile, tiles = all_tiles[on], int(all_tiles.max()) + 1
    place = tile * rows + row % rows
    count = np.bincount(place, minlength=tiles * rows).reshape(tiles, rows)
    # A ring that only brushes a plane, as the ground before a wall, is of another surface.
    along = (count >= 0.5 * count.max(axis=1, keepdims=True)).ravel()[place]
    row, column, tile, place = row[along], column[along], tile[along], place[along]
    x = np.stack([np.ones(len(row)), row % rows, column % columns]).astype(np.float64)
    y = values[row, column]

    def total(values: Floats) -> Floats:
        return np.bincount(tile, values, tiles).astype(np.float64)

    def by_row(values: Floats) -> Floats:
        return np.bincount(place, values, tiles * rows).reshape(tiles, rows).astype(np.float64)

    matrix = np.array([[total(one * other) for other in x] for one in x]).transpose(2, 0, 1)
    right = np.array([total(one * y) for one in x]).T
    parts = np.stack([by_row(one) for one in x], axis=-1)
    leverage = parts @ np.linalg.pinv(matrix, hermitian=True)
    own = parts[..., :1] * np.eye(rows) - leverage @ parts.swapaxes(1, 2)
    rest = by_row(y) - (leverage @ right[..., None])[..., 0]
    high, wide = on.shape
    across = -(-wide // columns)
    ring = image.rings[np.minimum(np.arange(tiles)[:, None] // across * rows + np.arange(rows), high - 1)]
    block = image.block[0, np.minimum(np.arange(tiles) % across * columns + columns // 2, wide - 1)]
    sums = np.zeros((BLOCKS, rings, 2 + rings))
    np.add.at(sums, (block[:, None], ring, 0), parts[..., 0])
    np.add.at(sums, (block[:, None], ring, 1), rest)
    np.add.at(sums, (block[:, None, None], ring[:, :, None], 2 + ring[:, None, :]), own)
    return sums


def _find_ground(image: Image) -> Floats | None:
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


def misfit(beams: Beams, xyz: Floats, ring: npt.NDArray[np.integer]) -> float:
    """Return the median over the rings of the angle between their points and their beams, rad."""
    angles = []
    for place, name in enumerate(beams.ring):
        mine = np.flatnonzero(ring == name)
        mine = mine[:: max(len(mine) // 1000, 1)]
        if len(mine):
            reach = np.sqrt((xyz[mine] ** 2).sum(axis=1))
            angles.append(abs(float(np.median(beams.away(place, xyz[mine]) / reach))))
    return float(np.median(angles))
