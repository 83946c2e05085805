"""Digital elevation models: GeoTIFF and Esri ASCII grids, read by GDAL through rasterio.

GDAL may open only the file itself, by the driver of its content, and the ``.prj`` file beside an ASCII grid. Formats:
https://docs.ogc.org/is/19-008r4/19-008r4.html (GeoTIFF) and
https://desktop.arcgis.com/en/arcmap/latest/manage-data/raster-and-images/esri-ascii-raster-format.htm.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.files import atomic_writer, check_path, check_regular, check_suffix, redact
from lidarsim._base.validation import Floats, array, integer, short
from lidarsim._base.views import register_view
from lidarsim.errors import ArgumentError, ArgumentValueError, FileFormatError, MissingExtraError
from lidarsim.io._records import EXPANSION
from lidarsim.motion.georeference import projected_crs
from lidarsim.scan.cells import Cells
from lidarsim.world.scene import Scene, register_scene_reader
from lidarsim.world.shapes import TriangleMesh
from lidarsim.world.shapes.triangle_mesh import Raster, find_no_data

if TYPE_CHECKING:
    import pyproj

Result = TypeVar("Result")

SUFFIXES = (".asc", ".tif", ".tiff")
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""Signatures of TIFF and BigTIFF, in both byte orders."""

FEW, MOST = 3612**2, 1 << 26
"""Maximum number of nodes of a mesh: the first, a square degree in steps of a second of arc, in any file, since one may
hold none of its blocks; the second in one of a hundredth of the bytes of the heights. It also limits pixels of a block.

A node takes up to 122 bytes while it is read, and `NODE` while the hierarchy over its two triangles is built.
"""
NODE = 254
PIECE = 1 << 22
"""Pixels that are read at once, unless a row has more."""

FEET = 0.3048
SURVEY_FEET = 1200 / 3937
UNITS = {
    **dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), FEET),
    **dict.fromkeys(("us survey foot", "us survey feet", "us-ft", "us_ft", "ftus"), SURVEY_FEET),
}
"""Metres per unit of heights, by the names of units in lower case."""

ESRI_NO_DATA = -9999.0
"""No-data value of an ASCII grid that declares none, by Esri's description of the format."""

DISTORTION = 0.02
"""Largest relative difference of a metre of a projection from one on the ground: within a zone of UTM it is 0.0004, and
1.5 % at most in projections for Europe and the United States; in Web Mercator it is that at a latitude of 10°."""

ALONE = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no .ovr, .msk, .tfw and other files beside a GeoTIFF
    "GDAL_PAM_ENABLED": "NO",  # no .aux.xml beside an ASCII grid
    "GTIFF_POINT_GEO_IGNORE": "NO",  # nodes are the centres of pixels, even if the file declares pixels as points
}
"""Options of GDAL that keep it to the file itself."""

COLORS = {"palette", "red", "green", "blue", "alpha"}
"""Interpretations of bands that hold no heights."""


class Nodes(NamedTuple):
    """The rows and columns of a file that are read."""

    rows: range
    columns: range


def read(path: str | PathLike[str], *, band: int, window: npt.ArrayLike | None, stride: int) -> Raster:
    """Read a file as documented in `lidarsim.TriangleMesh.from_raster`."""
    path = check_path(path)
    number, step = integer("band", band, at_least=1), integer("stride", stride, at_least=1)
    part = None if window is None else _window(window)
    check_regular(path)
    rasterio = import_extra("rasterio", "geo", "reading a raster")

    def read_file() -> Raster:
        with _open(path, rasterio) as file:
            if number > file.count:
                raise ArgumentValueError("band", f"a band of {path}, 1 to {file.count}", number)
            _check(file, number, path.stat().st_size)
            crs, metres = _units(file, number)
            nodes = _nodes(file, part, step, path)
            _check_scale(file, nodes)
            x, y = _positions(file.transform, nodes)
            z = _heights(file, number, metres, nodes)
            if _turn(file.transform) < 0:  # the rows run to the right of the columns
                x, y, z = (values[::-1] if values.ndim == 2 else values for values in (x, y, z))
        return Raster(x, y, z, crs)

    with _refusals(path):
        return _with_options(rasterio, read_file)


def _with_options(rasterio: Any, work: Callable[[], Result]) -> Result:
    """Return the result of `work`, for which the options `ALONE` hold.

    It runs in a thread of its own: set in the main thread, options of GDAL hold for all threads of the process.
    """

    def run() -> Result:
        with rasterio.Env(**ALONE):
            return work()

    with ThreadPoolExecutor(1) as pool:
        return pool.submit(copy_context().run, run).result()


def same_crs(a: str, b: str) -> bool:
    """Return whether two texts are the same coordinate reference system, as far as both say of what heights are."""
    if a == b:
        return True
    pyproj = import_extra("pyproj", "geo", "reading a raster")
    one, other = map(pyproj.CRS.from_user_input, (a, b))
    if one.is_compound != other.is_compound:
        one, other = (crs.sub_crs_list[0] if crs.is_compound else crs for crs in (one, other))
    return bool(one.equals(other, ignore_axis_order=True))


def _window(value: npt.ArrayLike) -> list[float]:
    window: list[float] = array("window", value, (4,)).tolist()
    if not (window[0] < window[2] and window[1] < window[3]):
        raise ArgumentValueError("window", "x_min < x_max and y_min < y_max in x_min, y_min, x_max, y_max", window)
    return window


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Turn exceptions, of GDAL and PROJ as well, into one-line `FileFormatError` exceptions that name the file."""
    try:
        yield
    except (ArgumentError, MissingExtraError):
        raise
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except Exception as error:
        cause = error.__cause__ or error  # rasterio may only say that there was another error
        raise FileFormatError(f"{path}: not a readable raster of heights: {redact(cause)}") from error


def projections(path: Path) -> list[Path]:
    """Return where GDAL looks for the projection of an ASCII grid."""
    return [path.with_suffix(suffix) for suffix in (".prj", ".PRJ")]


@contextmanager
def _open(path: Path, rasterio: Any) -> Iterator[Any]:
    with path.open("rb") as head:
        tiff = head.read(4) in TIFF
    if not tiff:
        for file in filter(Path.exists, projections(path)):
            check_regular(file)
    kind = {"driver": "GTiff"} if tiff else {"driver": "AAIGrid", "DATATYPE": "Float64"}
    with rasterio.open(path.absolute(), **kind) as file:  # as it is: in texts, rasterio would look for URLs
        yield file


def _check(file: Any, number: int, size: int) -> None:
    """Raise an error unless a band can hold heights and the file has room for what it claims."""
    rows, columns = file.shape
    if rows < 2 or columns < 2:
        raise FileFormatError(f"expected at least 2 rows and 2 columns, got {rows:,} × {columns:,}")
    if file.driver == "AAIGrid" and 2 * rows * columns - 1 > size:  # a digit and a blank for each
        raise FileFormatError(f"it is truncated: {rows:,} × {columns:,} heights in {size:,} bytes")
    block = math.prod(file.block_shapes[number - 1])
    if block > MOST:
        raise FileFormatError(
            f"expected blocks of at most {MOST:,} pixels, got {block:,}; tile it: gdal_translate -co TILED=YES"
        )
    kind = file.dtypes[number - 1]
    if "complex" in kind:
        raise FileFormatError(f"band {number}: expected real numbers, got {kind}")
    colour = file.colorinterp[number - 1].name
    if colour in COLORS:
        raise FileFormatError(f"band {number}: expected heights, got colours ({colour})")
    if file.transform.is_identity:
        raise FileFormatError("it has no geotransform, which would place its pixels")
    if not (all(map(math.isfinite, file.transform)) and 0 < abs(_turn(file.transform)) < math.inf):
        raise FileFormatError(f"its geotransform cannot be inverted: {tuple(file.transform)[:6]}")
    scale, offset = file.scales[number - 1], file.offsets[number - 1]
    if not (math.isfinite(scale) and math.isfinite(offset)):
        raise FileFormatError(f"band {number}: expected a finite scale and offset, got {scale} and {offset}")


def _turn(transform: Any) -> float:
    """Return the determinant of a geotransform: > 0 if rows lie counter-clockwise from columns."""
    return float(transform.a * transform.e - transform.b * transform.d)


def _units(file: Any, number: int) -> tuple[str | None, float]:
    """Return the coordinate reference system, which must be in metres, and the metres per unit of height."""
    unit = file.units[number - 1] or ""
    if unit.lower() not in UNITS:
        raise FileFormatError(f"band {number}: expected heights in metres or feet, got the unit {short(repr(unit))}")
    metres = UNITS[unit.lower()]
    if not file.crs:
        return None, metres
    name = str(file.crs.to_string())
    known = import_extra("pyproj", "geo", "reading a raster").CRS.from_user_input(file.crs.to_wkt())
    vertical = [axis for axis in known.axis_info if axis.direction in {"up", "down"}]
    if known.is_geocentric or len(known.axis_info) - len(vertical) != 2:
        raise FileFormatError(f"expected coordinates of a map, got those of {short(name)}")
    for axis in known.axis_info:
        if axis not in vertical and axis.unit_conversion_factor != 1.0:
            raise FileFormatError(
                f"expected coordinates in metres, got {axis.unit_name} ({short(name)}); reproject it, as with gdalwarp"
                " -t_srs EPSG:32632 to UTM zone 32 north, or with rasterio.warp"
            )
    for axis in vertical:
        if axis.direction == "down":
            raise FileFormatError(f"expected heights, got depths ({short(name)})")
        if not unit:
            metres = float(axis.unit_conversion_factor)
    return name, metres


def _check_scale(file: Any, nodes: Nodes) -> None:
    """Raise an error if a metre of the projection is another on the ground, in the middle of some nodes."""
    if not file.crs:
        return
    pyproj = import_extra("pyproj", "geo", "reading a raster")
    crs = pyproj.CRS.from_user_input(file.crs.to_wkt())
    crs = crs.sub_crs_list[0] if crs.is_compound else crs
    if not crs.is_projected:
        return
    projection = pyproj.Proj(crs)
    x, y = _positions(file.transform, Nodes(*(of[len(of) // 2 :][:1] for of in nodes)))
    factors = projection.get_factors(*projection(x.item(), y.item(), inverse=True))
    scale = max(factors.meridional_scale, factors.parallel_scale, key=lambda value: abs(value - 1.0))
    if abs(scale - 1.0) > DISTORTION:
        raise FileFormatError(
            f"expected coordinates in metres, got {short(crs.to_string())}, where 1 m is {1.0 / scale:.3g} m on the"
            " ground; reproject it, as with gdalwarp -t_srs EPSG:32632 to UTM zone 32 north"
        )


def _nodes(file: Any, window: list[float] | None, stride: int, path: Path) -> Nodes:
    """Return the nodes to read, after checking that there are neither too few nor too many."""
    every, transform = Nodes(*(range(0, count, stride) for count in file.shape)), file.transform
    if min(map(len, every)) < 2:
        raise ArgumentValueError("stride", f"one below the rows and columns of {path}, {file.shape}", stride)
    nodes = every
    if window is not None:
        if transform.b or transform.d:
            raise ArgumentValueError("window", f"none, since the pixels of {path} are rotated or sheared", window)
        spans = (transform.e, transform.f, window[1::2]), (transform.a, transform.c, window[::2])
        nodes = Nodes(*(_cover(of, *span) for of, span in zip(every, spans, strict=True)))
        if not all(map(len, nodes)):
            ends = Nodes(*(of[:: len(of) - 1] for of in every))
            x, y = (" to ".join(map(str, sorted(values.ravel().tolist()))) for values in _positions(transform, ends))
            raise ArgumentValueError("window", f"one that overlaps the nodes of {path}, x {x}, y {y}", window)
    count = math.prod(map(len, nodes))
    most = min(MOST, max(FEW, EXPANSION * path.stat().st_size // 8))
    if count > most:
        rows, columns = map(len, nodes)
        raise FileFormatError(
            f"expected at most {most:,} nodes in a file of this size, which take {NODE * most / 1e9:.0f} GB, got"
            f" {rows:,} × {columns:,} = {count:,}; read a part of them (window) or every n-th row and column (stride)"
        )
    return nodes


def _cover(nodes: range, step: float, start: float, interval: Sequence[float]) -> range:
    """Return the fewest rows or columns whose nodes cover an interval; none if they do not overlap it."""
    low, high = interval
    if step < 0:  # the mirror image, which rounds alike
        step, start, low, high = -step, -start, -high, -low

    def place(node: int) -> float:
        return (node + 0.5) * step + start

    if not (place(nodes[0]) < high and place(nodes[-1]) > low):
        return range(0)
    first = bisect_right(nodes, low, key=place) - 1
    return nodes[max(first, 0) : bisect_left(nodes, high, key=place) + 1]


def _positions(transform: Any, nodes: Nodes) -> tuple[Floats, Floats]:
    """Return x and y of the nodes, in shapes that broadcast to rows and columns."""
    columns, rows = np.array(nodes.columns) + 0.5, (np.array(nodes.rows) + 0.5)[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        x = columns * transform.a + (rows * transform.b if transform.b else 0.0) + transform.c
        y = (columns * transform.d if transform.d else 0.0) + rows * transform.e + transform.f
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise FileFormatError("expected coordinates within the range of float64, got some beyond it")
    return x, y


def _heights(file: Any, number: int, metres: float, nodes: Nodes) -> Floats:
    """Return the heights of the nodes, m; NaN where there is no data."""
    rows, columns = nodes
    stride = rows.step
    no_data = ESRI_NO_DATA if file.driver == "AAIGrid" and file.nodata is None else np.nan
    scale, offset = file.scales[number - 1], file.offsets[number - 1]
    heights = np.empty((len(rows), len(columns)))
    across = columns[0], columns[-1] + 1
    at_once = max(1, PIECE // ((across[1] - across[0]) * stride))
    for start in range(0, len(rows), at_once):
        some = rows[start : start + at_once]
        part = (some[0], some[-1] + 1), across
        z = heights[start : start + at_once]
        z[:] = file.read(number, window=part)[::stride, ::stride]
        hole = file.read_masks(number, window=part)[::stride, ::stride] == 0
        hole |= z == no_data
        with np.errstate(over="ignore"):
            z *= scale
            z += offset
            z *= metres
        z[hole] = np.nan
        if np.isinf(z).any():
            i, j = np.argwhere(np.isinf(z))[0]
            raise FileFormatError(f"expected finite heights, got {z[i, j]} in row {some[i]}, column {columns[j]}")
    if (place := find_no_data(heights, lambda number: (number * scale + offset) * metres)) is not None:
        i, j = place
        where = f"{heights[place]:g} m in row {rows[i]}, column {columns[j]}"
        raise FileFormatError(f"expected heights, got {where}; no data? declare it, as by gdal_edit -a_nodata")
    return heights


def recognise(path: Path, _head: bytes = b"") -> bool:
    """Return whether the suffix of a file is that of a raster."""
    return path.suffix.lower() in SUFFIXES


def read_scene(path: Path) -> Scene:
    """Return a scene of the terrain in a file."""
    scene = Scene()
    scene.add(TriangleMesh.from_raster(path), name=path.name)
    return scene


def write(cells: Cells, path: str | PathLike[str], crs: int | str | pyproj.CRS | None) -> None:
    """Write a GeoTIFF as documented in `lidarsim.scan.cells.Cells.save`."""
    check_suffix(path, SUFFIXES[1:])
    system = None if crs is None else projected_crs(crs)
    rasterio = import_extra("rasterio", "geo", "writing a GeoTIFF")
    rows, columns = cells.values.shape
    left, _, _, top = cells.bounds
    profile = {
        "driver": "GTiff",
        "height": rows,
        "width": columns,
        "count": 1,
        "dtype": "float64",
        "nodata": math.nan,
        "crs": None if system is None else system.to_wkt(),
        "transform": rasterio.Affine(cells.cell, 0.0, left, 0.0, -cells.cell, top),
        "compress": "deflate",
    }

    def content() -> bytes:
        with rasterio.MemoryFile() as memory:
            with memory.open(**profile) as raster:
                raster.write(cells.values, 1)
            data: bytes = memory.read()
        return data

    with atomic_writer(path) as file:
        file.write(_with_options(rasterio, content))


register_view(TriangleMesh, "from_raster", read)
register_view(Cells, "geotiff", write)
register_scene_reader("a raster of heights, by its suffix", recognise, read_scene)
