"""Occupancy grids: the ground truth of the maps that 2D lidars make."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base import validation
from lidarsim._base.files import PathLike, check_suffix, replacing
from lidarsim._base.pickling import Pickled
from lidarsim._base.validation import Floats, Instances, instances
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.world.scene import Scene, SceneObject
from lidarsim.world.shapes import Box, Polygon, Triangle, TriangleMesh

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
GRAY = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
"""Grey values in a map's picture, by the values of cells."""

MOST_CELLS = 1 << 28
LINES_IN_CELL = 8
"""Lines a cell, along which shapes of curved surfaces are met."""

FLAT = (Box, Polygon, Triangle, TriangleMesh)
"""Shapes whose surfaces are triangles."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid(Pickled):
    """A horizontal slice of a scene on a grid, as ROS's ``nav_msgs/OccupancyGrid``.

    Attributes
    ----------
    cells : ndarray of int8, shape (rows, columns)
        100 for occupied, 0 for free and -1 for unknown cells. Row i has y from ``origin[1] + i * resolution`` on, and
        column j has x from ``origin[0] + j * resolution`` on.
    resolution : float
        Side of a cell, m.
    origin : tuple of float
        x and y of the corner of the first cell, m.
    z : float
        Height of the slice, m.
    """

    cells: npt.NDArray[np.int8]
    resolution: float
    origin: tuple[float, float]
    z: float

    def index(self, points: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Return the row and column of points.

        Parameters
        ----------
        points : array_like, shape (n, 2) or (n, 3)
            Points x, y in the world, m.

        Returns
        -------
        ndarray of int64, shape (n, 2)
            Row and column; outside the grid they are negative or too large.
        """
        given = validation.as_array("points", points, "numbers of shape (n, 2) or (n, 3)")
        places = validation.array("points", given, ("n", 3 if given.ndim == 2 and given.shape[1] == 3 else 2))
        found: npt.NDArray[np.int64] = np.floor((places[:, :2] - self.origin) / self.resolution).astype(np.int64)
        return found[:, ::-1]

    def save(self, path: PathLike) -> None:
        """Write a map for ROS's map_server: a YAML file, and beside it a PGM picture of the same stem.

        Parameters
        ----------
        path : path-like
            The file, ``.yaml`` or ``.yml``. In the picture, the first row is that of the largest y; occupied cells are
            0, free ones 254 and unknown ones 205, as `map_saver` writes them.

        Raises
        ------
        FileFormatError
            If the suffix is not one of these.
        OSError
            If a file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> room = scene.add(ls.Box((4, 3, 2), center=(2, 1.5, 1)))
        >>> grid = ls.occupancy(scene, 0.05, z=0.2, free_from=(1, 1))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     grid.save(f"{folder}/map.yaml")
        ...     print(Path(folder, "map.yaml").read_text())
        image: map.pgm
        mode: trinary
        resolution: 0.05
        origin: [-0.1, -0.1, 0.0]
        negate: 0
        occupied_thresh: 0.65
        free_thresh: 0.196
        <BLANKLINE>
        """
        import yaml

        check_suffix(path, (".yaml", ".yml"))
        picture = Path(path).with_suffix(".pgm")
        rows, columns = self.cells.shape
        gray = np.full(self.cells.shape, GRAY[UNKNOWN], np.uint8)
        for value in (FREE, OCCUPIED):
            gray[self.cells == value] = GRAY[value]
        # Unknown: (255 - 205) / 255 = 0.19608 is not below free_thresh, so it stays unknown.
        fields = {
            "image": picture.name,
            "mode": "trinary",
            "resolution": self.resolution,
            "origin": [*self.origin, 0.0],
            "negate": 0,
            "occupied_thresh": 0.65,
            "free_thresh": 0.196,
        }
        text = yaml.safe_dump(fields, sort_keys=False, default_flow_style=None, allow_unicode=True)
        _write(picture, f"P5\n{columns} {rows}\n255\n".encode() + np.ascontiguousarray(gray[::-1]).tobytes())
        _write(Path(path), text.encode())

    def __repr__(self) -> str:
        """Return the size and the numbers of cells of each kind."""
        rows, columns = self.cells.shape
        counts = {name: int((self.cells == value).sum()) for name, value in NAMES.items()}
        shown = ", ".join(f"{count:,} {name}" for name, count in counts.items())
        return f"OccupancyGrid({rows} × {columns} cells of {self.resolution:g} m: {shown})"


NAMES = {"occupied": OCCUPIED, "free": FREE, "unknown": UNKNOWN}


def _write(path: Path, data: bytes) -> None:
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def occupancy(
    scene: Scene,
    resolution: float,
    z: float,
    *,
    bounds: npt.ArrayLike | None = None,
    free_from: npt.ArrayLike | None = None,
    time: float = 0.0,
    ignore: Instances = (),
) -> OccupancyGrid:
    """Return which cells of a horizontal grid are occupied: the true map of a 2D lidar at that height.

    A cell is occupied if a surface passes through it at height z, be it seen from outside or from inside.

    Parameters
    ----------
    scene : Scene
        The scene.
    resolution : float
        Side of a cell, m.
    z : float
        Height of the slice, m.
    bounds : array_like, shape (2, 2), optional
        Least and greatest x and y of the grid, m. Default: those of all bounded objects, where they are at `time`, and
        a cell more on each side. The grid begins at multiples of the resolution and covers them.
    free_from : array_like, shape (2,) or (k, 2), optional
        Points from which free space is found, such as where the robot stands: cells that are reached from there
        without passing an occupied one, from side to side, are free, and others, such as the inside of objects, are
        unknown. Default: all cells that are not occupied are free.
    time : float
        Time at which moving objects are placed, s.
    ignore : collection of int
        Instances that the map leaves out, such as the robot.

    Returns
    -------
    OccupancyGrid
        The grid.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong type or out of range, no object is bounded and `bounds` are not given, no object
        is of an instance to ignore, or the grid would have more than 2²⁸ cells.

    Notes
    -----
    Meshes, boxes and polygons are cut exactly, to the rounding of float64: a triangle crosses the slice if it has a
    vertex at z or above and one below. So one that lies in the slice is not crossed, but what stands on it is. Other
    shapes are met along lines, eight a cell in both directions; a piece of their outline that is smaller than an eighth
    of a cell may be missed, as where the slice only touches the top of a sphere.

    Examples
    --------
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> room = scene.add(ls.Box((4, 3, 2), center=(2, 1.5, 1)))
    >>> post = scene.add(ls.Cylinder((2, 1, 0), (2, 1, 2), 0.25))
    >>> ls.occupancy(scene, 0.1, z=0.5, free_from=(1, 1))
    OccupancyGrid(34 × 43 cells of 0.1 m: 160 occupied, 1,099 free, 203 unknown)
    """
    if not isinstance(scene, Scene):
        raise ArgumentTypeError("scene", "a Scene", validation.short_repr(scene))
    side = validation.real("resolution", resolution, above=0.0)
    height, when = validation.real("z", z), validation.real("time", time)
    world, unseen = scene._snapshot(), instances("ignore", ignore)
    if unseen is not None:
        world.native.expect_instances(unseen)
        world = world.without(unseen.tolist())
    world.check_motions(when, when)
    grid = _grid(world.items, side, bounds, when)
    occupied = np.zeros(grid.shape, bool)
    flat = [item for item in world.items if isinstance(item.shape, FLAT)]
    curved = [item for item in world.items if not isinstance(item.shape, FLAT)]
    for item in flat:
        _mark_segments(occupied, _cut(item, height, when) - grid.low, side)
    _mark_lines(occupied, curved, grid, height, when)
    cells = np.where(occupied, np.int8(OCCUPIED), np.int8(FREE))
    if free_from is not None:
        cells[~occupied & ~_find_reached(occupied, grid, free_from)] = UNKNOWN
    return OccupancyGrid(cells, side, (float(grid.low[0]), float(grid.low[1])), height)


@dataclass(frozen=True)
class _Grid:
    low: Floats
    side: float
    shape: tuple[int, int]


def _grid(items: Sequence[SceneObject], side: float, bounds: npt.ArrayLike | None, time: float) -> _Grid:
    """Return the grid that covers the bounds."""
    if bounds is None:
        still = Scene()
        for item in items:
            still.add(item.shape, transform=_place(item, time))
        corners = still.bounds[:, :2]
        if not np.isfinite(corners).all():
            raise ArgumentValueError("bounds", "some, since no object of the scene is bounded", "none")
        corners = corners + np.array([[-side], [side]])
    else:
        corners = validation.array("bounds", bounds, (2, 2))
        if not (corners[0] < corners[1]).all():
            raise ArgumentValueError("bounds", "minima below maxima", corners.tolist())
    first, last = np.floor(corners[0] / side), np.ceil(corners[1] / side)
    columns, rows = (last - first).tolist()
    if not rows * columns <= MOST_CELLS:
        raise ArgumentValueError("resolution", f"a grid of at most {MOST_CELLS:,} cells", f"{rows * columns:.3g}")
    return _Grid(first * side, side, (int(rows), int(columns)))


def _place(item: SceneObject, time: float) -> Floats | None:
    """Return the map from an object to the world at a time, shape (4, 4); None for the identity."""
    if item.motion is None:
        return item.transform
    pose: Floats = item.motion.at(time).as_matrix()
    return pose if item.transform is None else pose @ item.transform


def _cut(item: SceneObject, z: float, time: float) -> Floats:
    """Return the segments in which an object of triangles crosses a height, shape (n, 2, 2)."""
    vertices, faces = item.shape._tessellate(None, np.zeros((8, 3)))
    matrix = np.eye(4)
    for map_ in (item.shape.transform, _place(item, time)):
        matrix = matrix if map_ is None else map_ @ matrix
    points = vertices if np.array_equal(matrix, np.eye(4)) else vertices @ matrix[:3, :3].T + matrix[:3, 3]
    above = points[:, 2] >= z
    sides = above[faces]
    crossed = sides.any(axis=1) & ~sides.all(axis=1)
    faces, sides = faces[crossed], sides[crossed]
    # The corner that is alone on its side comes first, and both edges from it cross.
    alone = np.argmax(sides != (sides.sum(axis=1) > 1)[:, None], axis=1)
    corners = np.take_along_axis(faces, (alone[:, None] + np.arange(3)) % 3, axis=1)
    apex = points[corners[:, 0]]
    ends = []
    for other in (1, 2):
        end = points[corners[:, other]]
        share = (z - apex[:, 2]) / (end[:, 2] - apex[:, 2])
        ends.append(apex[:, :2] + share[:, None] * (end - apex)[:, :2])
    return np.stack(ends, axis=1).reshape(-1, 2, 2)


def _mark_segments(occupied: npt.NDArray[np.bool_], segments: Floats, side: float) -> None:
    """Mark the cells that segments pass through; coordinates count from the corner of the grid."""
    segments = segments / side
    while len(segments):
        low, high = np.floor(segments.min(axis=1)), np.floor(segments.max(axis=1))
        rows, columns = occupied.shape
        inside = ((high >= 0) & (low < (columns, rows))).all(axis=1)
        segments, low, high = segments[inside], low[inside], high[inside]
        within = (low == high).all(axis=1)
        at = low[within].astype(np.int64)
        occupied[at[:, 1], at[:, 0]] = True
        segments, low, high = segments[~within], low[~within], high[~within]
        if not len(segments):
            return
        # Each other one is divided where it crosses the middle grid line of its longer side.
        rows_of = np.arange(len(segments))
        axis = np.argmax(high - low, axis=1)
        first, last = low[rows_of, axis], high[rows_of, axis]
        line = first + np.ceil((last - first) / 2.0)
        start, end = segments[rows_of, 0, axis], segments[rows_of, 1, axis]
        share = (line - start) / (end - start)
        middle = segments[:, 0] + share[:, None] * (segments[:, 1] - segments[:, 0])
        middle[rows_of, axis] = line
        before = np.minimum(start, end) == start  # the part that ends at the line belongs to the cells before it
        parts = []
        for k, toward in ((0, before), (1, ~before)):
            part = segments.copy()
            part[:, 1 - k] = middle
            near = np.where(toward, np.nextafter(line, -np.inf), line)
            part[rows_of, 1 - k, axis] = near
            parts.append(part)
        segments = np.concatenate(parts)


def _mark_lines(occupied: npt.NDArray[np.bool_], items: list[SceneObject], grid: _Grid, z: float, time: float) -> None:
    """Mark the cells where lines along x and y meet the surfaces of objects."""
    if not items:
        return
    scene = Scene()
    for item in items:
        scene.add(item.shape, transform=item.transform, motion=item.motion)
    rows, columns = grid.shape
    for axis, count, length in ((0, rows, columns), (1, columns, rows)):
        for lines in _pieces(count * LINES_IN_CELL + 1):
            across = lines / LINES_IN_CELL * grid.side
            origins = np.empty((len(lines), 3))
            origins[:, axis], origins[:, 1 - axis], origins[:, 2] = grid.low[axis], grid.low[1 - axis] + across, z
            hits = _all_hits(scene, origins, axis, length * grid.side, time)
            line, place = np.nonzero(np.isfinite(hits))
            along = np.clip(np.floor(hits[line, place] / grid.side).astype(np.int64), 0, length - 1)
            number = lines[line]
            cell, on_edge = number // LINES_IN_CELL, number % LINES_IN_CELL == 0
            for cells, those in ((cell, cell < count), (cell - 1, on_edge & (cell > 0))):
                at = (cells[those], along[those]) if axis == 0 else (along[those], cells[those])
                occupied[at] = True


def _pieces(count: int) -> Iterator[npt.NDArray[np.int64]]:
    """Yield the numbers below a count, a piece at a time."""
    size = 1 << 14
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count))


def _all_hits(scene: Scene, origins: Floats, axis: int, length: float, time: float) -> Floats:
    """Return t of all hits along an axis, shape (n, k), infinite where there are fewer."""
    directions = np.zeros_like(origins)
    directions[:, axis] = 1.0
    most = 16
    while True:
        t = scene.cast_all(origins, directions, most=most, t_max=length, time=time).t
        if not np.isfinite(t[:, -1]).any():
            return t
        most *= 2


def _find_reached(occupied: npt.NDArray[np.bool_], grid: _Grid, free_from: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return the cells that are connected to points from side to side."""
    from scipy import ndimage

    given = validation.as_array("free_from", free_from, "numbers of shape (2,) or (k, 2)")
    points = validation.array("free_from", np.atleast_2d(given), ("k", 2))
    column, row = np.floor((points - grid.low) / grid.side).astype(np.int64).T
    rows, columns = occupied.shape
    for i in range(len(points)):
        if not (0 <= row[i] < rows and 0 <= column[i] < columns) or occupied[row[i], column[i]]:
            where = "free_from" if given.ndim == 1 else f"free_from[{i}]"
            expected = "points in cells of the grid that are not occupied"
            raise ArgumentValueError("free_from", expected, f"{where} = {points[i].tolist()}")
    parts: Any
    parts, _ = ndimage.label(~occupied)
    reached: npt.NDArray[np.bool_] = np.isin(parts, np.unique(parts[row, column]))
    return reached
