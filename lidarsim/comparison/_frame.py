"""A frame as measures see it: its points, their image of rings and columns, and the planes in that image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.comparison._inferred import ELEVATIONS, TURN, NoRingsError, circular_mean, columns_of, rings_of
from lidarsim.comparison._statistics import BLOCKS, Indices
from lidarsim.errors import ArgumentValueError
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan
from lidarsim.sensor.sensor import Sensor

Mask = npt.NDArray[np.bool_]
Kind = TypeVar("Kind", bound=np.generic)

MOST_RINGS = 1024
"""Number of rings up to which rings are compared one by one."""
SPARSEST = 64
"""Most cells of an image for each point: a cloud with fewer points has no columns to speak of."""
ROUGH = 0.05
"""Greatest robust deviation from a plane of the points of a tile, m: what is rougher is no plane."""
FINEST = 1e-3
"""Deviation from a plane up to which a point is on it in any case, m: noise-free points deviate only by rounding."""
FARTHEST_ORIGIN = 1.0
"""Distance from the origin of a sensor within which its beams begin, m."""
PIXELS = 24
"""Fewest points of a plane."""
UNEVEN = math.radians(2.0)
"""Median deviation from even steps up to which columns are steps of azimuth, rad: a beam 3 cm beside the axis
deviates so much at 1 m, and patterns that do not turn deviate by a part of their field of view."""
CANDIDATES = 16
"""Planes through three points that are tried in a tile. If 60 % of its points are on one plane, all three points of a
candidate are with probability 0.216, and those of at least one of 16 with probability 0.98."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What a scan knows of the pulses that met a surface.

    Attributes
    ----------
    reach, cosine : ndarray of float64, shape (m,)
        True range, m, and cosine of the angle of incidence.
    returned : ndarray of bool, shape (m,)
        Whether the pulse gave a point.
    block : ndarray of int, shape (m,)
        Block of each pulse.
    """

    reach: Floats
    cosine: Floats
    returned: Mask
    block: Indices


@dataclass(frozen=True)
class Frame:
    """Points of a frame in the sensor frame, finite and not at the origin.

    Attributes
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Positions, m.
    reach : ndarray of float64, shape (n,)
        Distance from the origin of the sensor frame, m.
    range : ndarray of float64, shape (n,)
        Range as the cloud has it, m; else the reach.
    intensity : ndarray of float64, shape (n,), or None
        Intensity; 1 is a white diffuser.
    ring : ndarray of int, shape (n,), or None
        Channel.
    block : ndarray of int, shape (n,)
        Block of columns.
    image : Image or None
        Pixels by ring and column.
    truth : Truth or None
        What a scan knows.
    missing : dict of str to str
        Why something is missing: "ring", "elevation", "column", "intensity".
    inferred : str
        What the rings are inferred from; "" if the cloud has rings.
    """

    xyz: Floats
    reach: Floats
    range: Floats
    intensity: Floats | None
    ring: Indices | None
    block: Indices
    image: Image | None
    truth: Truth | None
    missing: dict[str, str]
    inferred: str

    def __len__(self) -> int:
        return len(self.reach)

    @property
    def middle(self) -> float:
        """Median distance of the points, m."""
        return float(np.median(self.reach))

    @property
    def range_difference(self) -> float:
        """Median difference of the ranges from the distances, m: at most how far from the origin beams begin."""
        return float(np.median(np.abs(self.range - self.reach)))

    @classmethod
    def of(cls, given: PointCloud | Scan, sensor: Sensor | None, intensity_unit: float) -> Frame:
        """Return a cloud or a scan, in the sensor frame, as a frame.

        `sensor` gives rings and columns to a cloud without them; `intensity_unit` is that of `_sources.intensity_unit`.
        """
        cloud = given.point_cloud() if isinstance(given, Scan) else given
        reach = np.sqrt((cloud.xyz * cloud.xyz).sum(axis=1))
        known = np.isfinite(reach) & (reach > 0.0)
        fields = {name: getattr(cloud, name)[known] for name in cloud.fields}
        missing: dict[str, str] = {}
        xyz = fields["xyz"]
        ring, inferred = fields.get("ring"), ""
        if ring is not None and ring.size and ring.max() >= MOST_RINGS:
            missing["ring"] = f"have rings up to {ring.max():,}, more than the {MOST_RINGS:,} that are compared"
            ring = None
        elif ring is None:
            try:
                ring, inferred = rings_of(sensor, xyz)
            except NoRingsError as error:
                missing["ring"] = str(error)
        if inferred == ELEVATIONS:
            missing["elevation"] = "have no rings but those that follow from the elevations themselves"
        if "intensity" not in fields:
            missing["intensity"] = "have no intensity"
        azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
        column = fields.get("column")
        exact = column is not None
        if ring is not None and column is None:
            column = None if sensor is None else columns_of(sensor, ring, xyz)
        if ring is None:
            missing["column"] = missing["ring"]
        elif column is None:
            more = " that follow from their azimuths and the sensor" if sensor else "; the argument sensor tells them"
            missing["column"] = f"have no columns{more}"
        pulses = given.pulses if isinstance(given, Scan) else None
        image = None
        if ring is not None and column is not None and len(ring):
            fired = None if pulses is None else (pulses.ring.astype(np.intp), pulses.column.astype(np.intp))
            try:
                image = Image.of(fields, ring.astype(np.intp), column.astype(np.intp), fired, counted=exact)
            except NoImageError as error:
                missing["column"] = str(error)
        return cls(
            xyz=xyz,
            reach=reach[known],
            range=fields.get("range", reach[known]),
            intensity=fields["intensity"] / intensity_unit if "intensity" in fields else None,
            ring=None if ring is None else ring.astype(np.intp),
            block=_blocks(azimuth if column is None else column),
            image=image,
            truth=_truth(given) if isinstance(given, Scan) else None,
            missing=missing,
            inferred=inferred,
        )


def check_reach(argument: str, frame: Frame, sensor: Sensor) -> None:
    """Raise `ArgumentValueError` if half of the points are beyond what the sensor sees."""
    if frame.middle > sensor.max_range:
        expected = f"frames of {sensor.name or 'the sensor'}, which sees {sensor.max_range:g} m"
        raise ArgumentValueError(argument, expected, f"half of the points beyond {frame.middle:.4g} m", "mm?")


@dataclass(frozen=True)
class Image:
    """Pixels of the rings, by rising elevation, and of the columns, shifted by ring so that a column looks one way.

    Attributes
    ----------
    rings : ndarray of int, shape (R,)
        Ring of each row.
    point : ndarray of int, shape (R, C)
        Index of the first return; -1 where there is none.
    fired : ndarray of bool, shape (R, C)
        Whether a pulse was fired.
    returns : ndarray of int, shape (R, C)
        Returns of the pulse.
    reach : ndarray of float64, shape (R, C)
        Distance of the first return from the origin, m; nan where there is none.
    direction : ndarray of float64, shape (R, C, 3)
        Where the pulse went: to its point, else as the fitted angles of its ring and its column say.
    block : ndarray of int, shape (R, C)
        Block of columns.
    offset : ndarray of float64, shape (R, C)
        Azimuth of the point, less that of its column and the mean of all rings, rad; nan where there is none.
    step : float
        Azimuth from column to column, rad.
    separation, separation_block : ndarray of float64 and of int, shape (m,)
        Of each point that is another return than the first, its distance from that, m, and its block.
    counted : bool
        Whether the columns are those of the cloud, and not inferred from azimuths.
    """

    rings: Indices
    point: Indices
    fired: Mask
    returns: Indices
    reach: Floats
    direction: Floats
    block: Indices
    offset: Floats
    step: float
    separation: Floats
    separation_block: Indices
    counted: bool

    @classmethod
    def of(
        cls,
        fields: dict[str, npt.NDArray[Any]],
        ring: Indices,
        column: Indices,
        fired: tuple[Indices, Indices] | None,
        *,
        counted: bool,
    ) -> Image:
        """Return the image of points by ring and column, or raise `NoImageError`."""
        xyz: Floats = fields["xyz"]
        reach = np.sqrt((xyz * xyz).sum(axis=1))
        names, row, column, shot = _lay_out(ring, column, fired)
        width = shot.shape[1]
        point = _first_returns(fields, row, column, shot.shape)
        seen = point >= 0

        def pixels(values: Floats) -> Floats:
            filled = np.full(point.shape, np.nan)
            filled[seen] = values[point[seen]]
            return filled

        angles = _Angles.of(pixels(np.arctan2(xyz[:, 1], xyz[:, 0])), pixels(np.arcsin(xyz[:, 2] / reach)))
        direction = angles.directions(width)
        direction[seen] = xyz[point[seen]] / reach[point[seen], None]
        pixel = row * width + column
        others = np.flatnonzero(point.ravel()[pixel] != np.arange(len(pixel)))
        if not counted and "return_number" not in fields:
            # Two points in a pixel are returns of one pulse only if they lie in one direction: inferred columns may
            # hold two pulses, which are a step apart.
            first = xyz[point.ravel()[pixel[others]]] / reach[point.ravel()[pixel[others]], None]
            apart = np.linalg.norm(xyz[others] / reach[others, None] - first, axis=1)
            others = others[apart < 0.25 * abs(angles.step)]
        separation = np.abs(reach[others] - reach[point.ravel()[pixel[others]]])
        returns = seen + np.bincount(pixel[others], minlength=point.size).reshape(point.shape)
        block = np.broadcast_to(np.arange(width) * BLOCKS // width, point.shape).astype(np.intp)
        shift = angles.shift(width)
        move = _Rows(np.argsort(angles.height, kind="stable"), shift - shift.min(), width + int(np.ptp(shift)))
        return cls(
            rings=names[move.order],
            point=move(point, -1),
            fired=move(shot | seen, False),
            returns=move(returns, 0),
            reach=move(pixels(reach), np.nan),
            direction=move(direction, 0.0),
            block=move(block, 0),
            offset=move(angles.offset, np.nan),
            step=angles.step,
            separation=separation,
            separation_block=block.ravel()[pixel[others]],
            counted=counted,
        )

    @cached_property
    def planes(self) -> Planes:
        """The planes of the image."""
        return Planes.of(self)

    @cached_property
    def lost(self) -> Mask:
        """Pixels whose pulse was fired and did not return."""
        return self.fired & (self.point < 0)


class NoImageError(Exception):
    """Points have no image; the message says what the clouds have instead."""


def _lay_out(
    ring: Indices, column: Indices, fired: tuple[Indices, Indices] | None
) -> tuple[Indices, Indices, Indices, Mask]:
    """Return the rings, row and column of each point, and which pixels had a pulse: all, if it is not known."""
    rings, columns = ring, column
    if fired is not None:
        rings, columns = (np.concatenate(pair) for pair in ((ring, fired[0]), (column, fired[1])))
    first = columns.min()
    spacing = max(int(np.gcd.reduce(columns - first)), 1)  # some count the ticks of an encoder
    columns = (columns - first) // spacing
    names, rows = np.unique(rings, return_inverse=True)
    shape = len(names), int(columns.max()) + 1
    if math.prod(shape) > SPARSEST * max(len(rings), PIXELS):
        raise NoImageError("have too many columns for their points")
    shot = np.full(shape, fired is None)
    shot[rows[len(ring) :], columns[len(ring) :]] = True
    return names, rows[: len(ring)], columns[: len(ring)], shot


@dataclass(frozen=True)
class _Angles:
    """Angles of rows and columns: pixel azimuth = mean + row offset + column × step.

    Attributes
    ----------
    height, lead : ndarray of float64, shape (R,)
        Elevation of each row, and its azimuth relative to the mean of all, rad; 0 of rows without points.
    mean, step : float
        Mean azimuth of column 0, and azimuth from column to column, rad.
    offset : ndarray of float64, shape (R, C)
        Azimuth of each point less the mean and the steps, rad; nan where there is none.
    """

    height: Floats
    lead: Floats
    mean: float
    step: float
    offset: Floats

    @classmethod
    def of(cls, azimuth: Floats, elevation: Floats) -> _Angles:
        """Fit the angles to those of the points, nan where there are none."""
        width = azimuth.shape[1]
        step = _median(_wrap(np.diff(azimuth, axis=1)))
        lag = max(width // 8, 1)
        # The median of single steps is off by less than half a turn over an eighth of the columns.
        step += _median(_wrap(azimuth[:, lag:] - azimuth[:, :-lag] - step * lag)) / lag
        start = azimuth - step * np.arange(width)
        phase = np.array([circular_mean(row[np.isfinite(row)]) for row in start])
        if _median(np.abs(_wrap(start - phase[:, None]))) > UNEVEN:
            raise NoImageError(
                "have columns that are no even steps of azimuth, as if points were not in the sensor frame"
            )
        mean = circular_mean(phase[np.isfinite(phase)])
        height = np.array([_median(row) for row in elevation])
        return cls(height, np.nan_to_num(_wrap(phase - mean)), mean, step, _wrap(start - mean))

    def directions(self, width: int) -> Floats:
        """Return the direction of each pixel, shape (R, C, 3)."""
        turn = self.mean + self.lead[:, None] + self.step * np.arange(width)
        level = np.broadcast_to(self.height[:, None], turn.shape)
        return np.stack([np.cos(level) * np.cos(turn), np.cos(level) * np.sin(turn), np.sin(level)], axis=-1)

    def shift(self, width: int) -> Indices:
        """Return by how many columns each row leads."""
        if not self.step:
            return np.zeros(len(self.lead), np.intp)
        shift: Indices = np.clip(np.rint(self.lead / self.step), -width, width).astype(np.intp)
        return shift


@dataclass(frozen=True)
class _Rows:
    """Arrays by row and column, with rows in an order and each row shifted by some columns."""

    order: Indices
    shift: Indices
    width: int

    def __call__(self, array: npt.NDArray[Kind], fill: float) -> npt.NDArray[Kind]:
        moved = np.full((len(self.order), self.width, *array.shape[2:]), fill, array.dtype)
        for row, old in enumerate(self.order):
            start = self.shift[old]
            moved[row, start : start + array.shape[1]] = array[old]
        return moved


@dataclass(frozen=True)
class Planes:
    """The plane of each tile of an image: w·x = 1 for the points x on it.

    Attributes
    ----------
    normal : ndarray of float64, shape (R, C, 3)
        w, 1/m; nan in tiles without a plane.
    deviation : ndarray of float64, shape (R, C)
        Range of the point less that of the plane in its direction, m; nan where either is missing.
    on : ndarray of bool, shape (R, C)
        Points on the plane.
    reach : ndarray of float64, shape (R, C)
        Distance of the plane in the direction of the pulse, m; nan where it does not meet it.
    cosine : ndarray of float64, shape (R, C)
        Cosine of the angle of incidence; nan where the tile has too few rings to know.
    within : ndarray of bool, shape (R, C)
        Pixels that have points on the plane before and behind them in their ring and tile.
    """

    normal: Floats
    deviation: Floats
    on: Mask
    reach: Floats
    cosine: Floats
    within: Mask

    @classmethod
    def of(cls, image: Image) -> Planes:
        """Fit a plane to each tile, about 8° high and 10° wide: robustly, by the least median of deviations.

        u = 1/range is linear in the direction d: on the plane w·x = 1, u = w·d. A deviation of the range is r²(w·d − u)
        to first order.
        """
        rows, columns = tile_shape(image)
        high, wide = image.reach.shape
        down, across = -(-high // rows), -(-wide // columns)
        padding = ((0, down * rows - high), (0, across * columns - wide))

        def tiles(array: npt.NDArray[Kind], fill: float) -> npt.NDArray[Kind]:
            more = ((0, 0),) * (array.ndim - 2)
            padded = np.pad(array, (*padding, *more), constant_values=fill)
            cut = padded.reshape(down, rows, across, columns, *array.shape[2:]).swapaxes(1, 2)
            return cut.reshape(down * across, rows * columns, *array.shape[2:])

        def whole(array: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
            back = array.reshape(down, across, rows, columns, *array.shape[2:]).swapaxes(1, 2)
            return back.reshape(down * rows, across * columns, *array.shape[2:])[:high, :wide]

        r, d = tiles(image.reach, np.nan), tiles(image.direction, 0.0)
        w, spread, on = _fit_planes(r, d)
        predicted = np.einsum("tpk,tk->tp", d, w)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(predicted > 0.0, 1.0 / predicted, np.nan)
            cosine = predicted / np.sqrt((w * w).sum(axis=-1))[:, None]
        flat = on.reshape(-1, rows, columns)
        before = np.logical_or.accumulate(flat, axis=2)
        behind = np.logical_or.accumulate(flat[:, :, ::-1], axis=2)[:, :, ::-1]
        rings = flat.any(axis=2).sum(axis=1)
        cosine[rings < 3] = np.nan
        w[~np.isfinite(spread)] = np.nan
        return cls(
            normal=whole(np.repeat(w[:, None], rows * columns, axis=1)),
            deviation=whole(r - reach),
            on=whole(on),
            reach=whole(reach),
            cosine=whole(cosine),
            within=whole((before & behind).reshape(on.shape)),
        )


def _fit_planes(r: Floats, d: Floats) -> tuple[Floats, Floats, Mask]:
    """Return for each tile the plane w, the spread of the points about it, nan without one, and the points on it."""
    tiles, pixels = r.shape
    seen = np.isfinite(r)
    count = seen.sum(axis=1)
    w, spread, on = np.full((tiles, 3), np.nan), np.full(tiles, np.nan), np.zeros(r.shape, bool)
    enough = np.flatnonzero(count >= PIXELS)
    if not len(enough):
        return w, spread, on
    r, d, seen, count = r[enough], d[enough], seen[enough], count[enough]
    u = np.divide(1.0, r, out=np.zeros_like(r), where=seen)
    square = np.where(seen, r * r, 0.0)
    rng = np.random.default_rng(0)  # the same choice each time
    first = np.argsort(~seen, axis=1, kind="stable")
    which = (rng.random((len(enough), 3 * CANDIDATES + 64)) * count[:, None]).astype(np.intp)
    chosen = np.take_along_axis(first, which, axis=1)
    du = np.take_along_axis(u, chosen, axis=1)
    dd = np.take_along_axis(d, chosen[:, :, None], axis=1)
    corners = dd[:, : 3 * CANDIDATES].reshape(-1, CANDIDATES, 3, 3)
    tried = (np.linalg.pinv(corners) @ du[:, : 3 * CANDIDATES].reshape(-1, CANDIDATES, 3, 1))[..., 0]
    # Candidates are judged by the median deviation of 64 points.
    judged = np.abs(tried @ dd[:, 3 * CANDIDATES :].swapaxes(1, 2) - du[:, None, 3 * CANDIDATES :])
    judged *= np.take_along_axis(square, chosen[:, 3 * CANDIDATES :], axis=1)[:, None]
    best = np.median(judged, axis=2).argmin(axis=1)
    plane = tried[np.arange(len(enough)), best]
    away = _deviations(plane, d, u, square, seen)
    cut = np.maximum(4.0 * 1.4826 * np.nanmedian(away, axis=1), FINEST)
    for _ in range(4):
        inside = away <= cut[:, None]
        # Errors of u grow with 1/r² at equal errors of the range, so squares are weighted with r⁴.
        weight = np.where(inside, square * square, 0.0)
        weight /= np.maximum(weight.max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
        matrix = np.einsum("tp,tpi,tpj->tij", weight, d, d)
        # Directions of one ring span two dimensions: the third is cut where it is rounding, pixels times an ulp.
        inverse = np.linalg.pinv(matrix, rcond=pixels * np.finfo(np.float64).eps, hermitian=True)
        plane = np.einsum("tij,tp,tpj,tp->ti", inverse, weight, d, u)
        away = _deviations(plane, d, u, square, seen)
        kept = np.where(away <= cut[:, None], away, np.nan)
        kept[~np.isfinite(kept).any(axis=1)] = np.inf
        scale = 1.4826 * np.nanmedian(kept, axis=1)
        cut = np.maximum(4.0 * scale, FINEST)
    inside = away <= cut[:, None]
    # A plane is smooth, holds at least four tenths of the points, and lies in front of the sensor.
    smooth = (scale <= ROUGH) & (inside.sum(axis=1) >= np.maximum(0.4 * count, PIXELS))
    w[enough[smooth]], spread[enough[smooth]], on[enough[smooth]] = plane[smooth], scale[smooth], inside[smooth]
    return w, spread, on


def _deviations(plane: Floats, d: Floats, u: Floats, square: Floats, seen: Mask) -> Floats:
    away = np.abs(np.einsum("tpk,tk->tp", d, plane) - u) * square
    return np.where(seen, away, np.nan)


def tile_shape(image: Image) -> tuple[int, int]:
    """Return rows and columns of a tile."""
    rise = np.arcsin(np.clip(np.nanmedian(image.direction[:, :, 2], axis=1), -1.0, 1.0))
    gap = float(np.median(np.diff(rise))) if len(rise) > 1 else math.inf
    rows = int(np.clip(np.radians(8.0) / max(gap, np.radians(0.1)), 4, 16))
    columns = int(np.clip(np.radians(10.0) / max(abs(image.step), np.radians(0.1)), 16, 64))
    return -(-len(rise) // max(len(rise) // rows, 1)), columns  # tiles of about equal height


def _first_returns(
    fields: dict[str, npt.NDArray[Any]], row: Indices, column: Indices, shape: tuple[int, int]
) -> Indices:
    """Return the index of the first return of each pixel; -1 where there is none."""
    number = fields.get("return_number")
    order = np.arange(len(row)) if number is None else np.argsort(number, kind="stable")
    point = np.full(shape, -1, np.intp)
    point[row[order[::-1]], column[order[::-1]]] = order[::-1]  # what is written last stays
    return point


def _truth(scan: Scan) -> Truth:
    met = np.flatnonzero(scan.object_id[:, 0] >= 0)
    return Truth(
        reach=scan.true_range[met, 0],
        cosine=np.cos(scan.incidence[met, 0].astype(np.float64)),
        returned=scan.return_count[met] > 0,
        block=_blocks(scan.pulses.column)[met],
    )


def _blocks(values: npt.NDArray[Any]) -> Indices:
    """Return the block of each value among blocks of equal width."""
    if not values.size:
        return np.zeros(0, np.intp)
    numbers = values.astype(np.float64)
    low, high = numbers.min(), numbers.max()
    place = (numbers - low) * (BLOCKS / (high - low) if high > low else 0.0)
    blocks: Indices = np.minimum(place.astype(np.intp), BLOCKS - 1)
    return blocks


def _wrap(angle: Floats) -> Floats:
    """Return angles between -π and π, rad."""
    return np.mod(angle + math.pi, TURN) - math.pi


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else 0.0
