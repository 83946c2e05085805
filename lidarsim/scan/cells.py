"""Statistics of the points in the cells of a horizontal grid: terrain and canopy models, density, coverage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from lidarsim._base.pickling import Pickled
from lidarsim._base.validation import array, one_of, real
from lidarsim._base.views import ColorMap, view
from lidarsim.errors import ArgumentValueError

if TYPE_CHECKING:
    import pyproj

    from lidarsim._base.files import PathLike
    from lidarsim._base.validation import Floats

Statistic = Literal["count", "density", "min", "max", "mean", "std"]
STATISTICS = get_args(Statistic)

MOST = 1 << 28
"""Most cells of a grid: 2 GiB."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells(Pickled):
    """A value for each cell of a horizontal grid.

    Attributes
    ----------
    values : ndarray of float64, shape (rows, columns)
        The statistic of the points in each cell; nan where there are none, but 0 for "count" and "density". The first
        row is the northernmost, that of the largest y, as in a map.
    bounds : tuple of float
        x_min, y_min, x_max, y_max of the grid, m.
    cell : float
        Length of a side of a cell, m.
    quantity : str
        What the values are, with their unit, for the colour bar: "max of z [m]".
    """

    values: Floats
    bounds: tuple[float, float, float, float]
    cell: float
    quantity: str = ""

    def __repr__(self) -> str:
        """Return the shape and the size of the cells."""
        rows, columns = self.values.shape
        return f"Cells({rows} × {columns} cells of {self.cell:g} m)"

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Return the values."""
        return np.array(self.values, dtype, copy=copy)

    def save(self, path: PathLike, *, crs: int | str | pyproj.CRS | None = None) -> None:
        """Write a GeoTIFF, in which nan marks cells without a value.

        Parameters
        ----------
        path : path-like
            The file, ``.tif`` or ``.tiff``.
        crs : int, str or pyproj.CRS, optional
            Coordinate reference system of the points, as in `lidarsim.PointCloud.save`.

        Raises
        ------
        FileFormatError
            If the suffix is not one of these.
        MissingExtraError
            If rasterio, or pyproj for `crs`, is not installed.
        OSError
            If the file cannot be written.
        TypeError, ValueError
            If `crs` is not a projected system in metres.
        """
        view(Cells, "geotiff")(self, path, crs)

    def plot(
        self,
        save: PathLike,
        *,
        hillshade: bool = False,
        title: str = "",
        limits: Sequence[float] | None = None,
        color_map: ColorMap = "viridis",
        size: tuple[int, int] = (1000, 700),
    ) -> None:
        """Draw a map with a colour bar.

        Parameters
        ----------
        save : path-like
            The file, PNG or SVG.
        hillshade : bool
            Whether to shade the cells by the slope of their values, which must be heights in m: relief under a sun in
            the north-west.
        title : str
            Title of the map, such as what it shows and in which unit.
        limits : tuple of float, optional
            Values at the ends of the colours. Default: the least and the greatest.
        color_map : {"magma", "viridis", "cividis", "grey"}
            Colours of numbers.
        size : tuple of int
            Width and height, pixels.

        Raises
        ------
        FileFormatError
            If the suffix is not one of these.
        MissingExtraError
            If Matplotlib, a dependency of PyVista, is not installed.
        OSError
            If the file cannot be written.
        TypeError, ValueError
            If an argument is not one of the values above.
        """
        options = {"hillshade": hillshade, "title": title, "limits": limits, "color_map": color_map, "size": size}
        view(Cells, "plot")(self, save, **options)


def cells_of(xyz: Floats, values: Floats, cell: object, statistic: object, bounds: npt.ArrayLike | None) -> Cells:
    """Return the statistic of the points in each cell, as documented in `lidarsim.PointCloud.raster`.

    Parameters
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Points.
    values : ndarray of float64, shape (n,)
        What is summarised.
    cell, statistic, bounds
        As given by the user.
    """
    one_of("statistic", statistic, STATISTICS)
    side = real("cell", cell, above=0.0)
    known = np.isfinite(xyz[:, :2]).all(axis=1) & (np.isfinite(values) | (statistic in {"count", "density"}))
    x, y, z = xyz[known, 0], xyz[known, 1], values[known]
    low, (rows, columns) = _grid(x, y, side, bounds)
    column, row = (np.floor(v / side) - start for v, start in ((x, low[0]), (y, low[1])))
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    place = (rows - 1 - row[inside].astype(np.intp)) * columns + column[inside].astype(np.intp)
    table = _summary(place, z[inside], rows * columns, str(statistic), side)
    edges = (low[0] * side, low[1] * side, (low[0] + columns) * side, (low[1] + rows) * side)
    return Cells(table.reshape(rows, columns), edges, side)


def _grid(
    x: Floats, y: Floats, side: float, bounds: npt.ArrayLike | None
) -> tuple[tuple[float, float], tuple[int, int]]:
    """Return the lower left corner of the grid in cells, and the numbers of rows and columns."""
    if bounds is None:
        if not len(x):
            raise ArgumentValueError("bounds", "x_min, y_min, x_max, y_max for a cloud without points", "None")
        limits = [x.min(), y.min(), x.max(), y.max()]
        high = [
            math.floor(limit / side) + 1 for limit in limits[2:]
        ]  # a point on an edge is in the cell that begins there
    else:
        limits = array("bounds", bounds, (4,)).tolist()
        if not (limits[0] < limits[2] and limits[1] < limits[3]):
            raise ArgumentValueError("bounds", "x_min < x_max and y_min < y_max", limits)
        high = [math.ceil(limit / side) for limit in limits[2:]]
    low = [math.floor(limit / side) for limit in limits[:2]]
    columns, rows = (top - bottom for top, bottom in zip(high, low, strict=True))
    if rows * columns > MOST:
        raise ArgumentValueError("cell", f"cells of which at most {MOST:,} cover the points", f"{rows * columns:,}")
    return (float(low[0]), float(low[1])), (rows, columns)


def _summary(place: npt.NDArray[np.intp], values: Floats, count: int, statistic: str, side: float) -> Floats:
    """Return the statistic of the values at each of `count` places."""
    points = np.bincount(place, minlength=count).astype(np.float64)
    if statistic == "count":
        return points
    if statistic == "density":
        return points / side**2
    if statistic in {"min", "max"}:
        extreme, start = (np.minimum, np.inf) if statistic == "min" else (np.maximum, -np.inf)
        found = np.full(count, start)
        extreme.at(found, place, values)
        return np.where(points > 0, found, np.nan)
    with np.errstate(invalid="ignore"):
        # About the mean of all values, so that heights of thousands of metres keep their digits.
        middle = values.mean() if len(values) else 0.0
        mean = np.bincount(place, values - middle, minlength=count) / points
        if statistic == "mean":
            return mean + middle
        squares = np.bincount(place, (values - middle - mean[place]) ** 2, minlength=count)
        spread: Floats = np.sqrt(squares / points)
        return spread
