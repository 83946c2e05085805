"""Triangle mesh."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.files import check_path, check_regular, reading_as
from lidarsim._base.names import explain_arguments
from lidarsim._base.shown import plain, quantity
from lidarsim._base.validation import Floats, Transform, array, as_array, in_order, one_or_each, positive
from lidarsim._base.vectors import product
from lidarsim._base.views import view
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.world.shapes._polygons import Indices, of_strips, triangulate
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles

if TYPE_CHECKING:
    import open3d
    import pyvista
    import trimesh


IN_HULL = range(1_000, 100_001)
"""Numbers of vertices whose convex hull is computed: fewer are compared in microseconds; more would take over 0.1 s."""


class MeshFile(NamedTuple):
    """What a mesh file holds, in its order.

    Parameters
    ----------
    vertices : ndarray of float64, shape (n, 3)
        m.
    corners : ndarray of int64, shape (k,)
        Vertices of the faces, one face after the other.
    sizes : ndarray of int64, shape (m,)
        How many corners each face has.
    names : sequence of str
        Names of the parts that the file divides the mesh into; empty if it does not.
    parts : ndarray of int64, shape (m,), optional
        To which part each face belongs.
    colors : callable, optional
        ``colors()`` returns the sRGB colours of the vertices, ndarray of float64, shape (n, 3): 0 to 1 in valid files.
    """

    vertices: Floats
    corners: Indices
    sizes: Indices
    names: Sequence[str] = ()
    parts: Indices | None = None
    colors: Callable[[], Floats] | None = None


class Raster(NamedTuple):
    """Heights on a grid of nodes.

    Parameters
    ----------
    x, y : ndarray of float64
        Positions of the nodes, m, of shapes that broadcast to that of `z`.
    z : ndarray of float64, shape (rows, columns)
        Heights, m; NaN where there is none. Seen from above, the next row lies to the left of the way to the next
        column.
    crs : str, optional
        Coordinate reference system of x and y.
    """

    x: Floats
    y: Floats
    z: Floats
    crs: str | None = None


class TriangleMesh(Shape):
    """Triangles over shared vertices, open or closed.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Vertices, m.
    faces : array_like of int, shape (m, 3)
        Indices of the vertices of each triangle, whose normal is as for :class:`Triangle`.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the mesh.

    Raises
    ------
    TypeError
        If the faces are not integers.
    ValueError
        If a number is not finite, a face names a vertex that is not there, or the transform cannot be inverted.

    Notes
    -----
    Rays meet each triangle as they meet a :class:`Triangle`, with exact signs. Therefore no ray passes between two
    triangles that share an edge or a vertex, anywhere in space. Triangles whose edges only lie on each other (a
    T-junction) share nothing once their vertices are rounded, and a ray may pass there. Degenerate triangles are legal;
    nothing hits them.

    Examples
    --------
    >>> import lidarsim as ls
    >>> mesh = ls.TriangleMesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    >>> hits = mesh.cast([(0.25, 0.75, 2.0)], [(0, 0, -1)])
    >>> hits.t, hits.primitive_id
    (array([2.]), array([1], dtype=int32))
    """

    __slots__ = ("_crs", "_grid", "_hull")
    __match_args__ = ("vertices", "faces")

    _crs: str | None
    _grid: tuple[int, int] | None

    @explain_arguments
    def __init__(self, vertices: npt.ArrayLike, faces: npt.ArrayLike, *, transform: Transform | None = None) -> None:
        points = array("vertices", vertices, ("n", 3))
        super().__init__(_native.Shape.triangle_mesh(points, _faces(faces, len(points)), False), transform)
        self._note(None, None)

    def _note(self, crs: str | None, grid: tuple[int, int] | None) -> Self:
        """Set where the mesh came from, once."""
        object.__setattr__(self, "_crs", crs)
        object.__setattr__(self, "_grid", grid)
        return self

    @classmethod
    def from_file(cls, path: str | PathLike[str], *, transform: Transform | None = None) -> Self:
        """Read a file as one mesh: PLY, STL, OBJ or OFF, or a scene file such as GLB.

        Faces of more than three corners are cut into triangles, be they convex or not.

        Parameters
        ----------
        path : str or path-like
            A mesh file, whose numbers are taken as they are, in metres; or a scene file as in `Scene.from_file` (glTF,
            COLLADA), of which all objects are read as one mesh, in metres with z up whatever its units and axes. Of the
            files that it names, only those beside or below it are read.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh.

        Returns
        -------
        TriangleMesh
            The vertices and faces in the order of the file. Degenerate triangles are reported to the logger
            ``lidarsim``.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        FileFormatError
            If it cannot be read as a mesh.
        ValueError
            If its vertices or faces are not those of a valid mesh.
        """
        path = check_path(path)
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such mesh file")
        file = read_mesh(path)
        try:
            faces, _ = triangulate(file.vertices, file.corners, file.sizes)
            mesh = cls(file.vertices, faces, transform=transform)
        except ValueError as error:
            raise FileFormatError(f"{path}: {error}") from error
        if mesh.degenerate_count:
            logging.getLogger("lidarsim").warning(
                "%s: %d of %d triangles are degenerate; nothing hits them", path, mesh.degenerate_count, len(mesh)
            )
        return mesh

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh | trimesh.Scene, *, transform: Transform | None = None) -> Self:
        """Make a mesh from a ``trimesh.Trimesh`` or ``trimesh.Scene``.

        Parameters
        ----------
        mesh : trimesh.Trimesh or trimesh.Scene
            Its vertices and faces are copied: of a scene those of all meshes, each where its nodes place it.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh.

        Returns
        -------
        TriangleMesh
            The same triangles in the same order.

        Raises
        ------
        TypeError
            If it is neither.
        ValueError
            If its vertices or faces are not those of a valid mesh, or a scene has none.
        """
        given: Any = mesh
        parts = [given]
        if hasattr(given, "dump") and hasattr(given, "geometry"):  # a scene, which may have paths and clouds as well
            parts = [part for part in given.dump() if hasattr(part, "faces")]
            if not parts:
                raise ArgumentValueError("mesh", "a trimesh.Scene with meshes", "one without")
        if not all(hasattr(part, "vertices") and hasattr(part, "faces") for part in parts):
            raise ArgumentTypeError("mesh", "a trimesh.Trimesh or trimesh.Scene", type(given).__name__, _reader(given))
        before = np.cumsum([0, *(len(part.vertices) for part in parts)])
        faces = [np.asarray(part.faces) + start for part, start in zip(parts, before, strict=False)]
        return cls(np.concatenate([part.vertices for part in parts]), np.concatenate(faces), transform=transform)

    @classmethod
    def from_open3d(
        cls, mesh: open3d.geometry.TriangleMesh | open3d.t.geometry.TriangleMesh, *, transform: Transform | None = None
    ) -> Self:
        """Make a mesh from an Open3D triangle mesh.

        Parameters
        ----------
        mesh : open3d.geometry.TriangleMesh or open3d.t.geometry.TriangleMesh
            Its vertices and triangles are copied.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh.

        Returns
        -------
        TriangleMesh
            The same triangles in the same order.

        Raises
        ------
        TypeError
            If it is something else, such as a point cloud or lines.
        ValueError
            If its vertices or faces are not those of a valid mesh, or it is a tensor mesh without any.
        """
        if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):  # the tensor mesh
            if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
                raise ArgumentValueError("mesh", "positions of vertices and indices of triangles", "a mesh without")
            return cls(mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy(), transform=transform)
        if not (hasattr(mesh, "vertices") and hasattr(mesh, "triangles")):
            raise ArgumentTypeError("mesh", "an Open3D TriangleMesh", type(mesh).__name__, _reader(mesh))
        return cls(np.asarray(mesh.vertices), np.asarray(mesh.triangles), transform=transform)

    @classmethod
    def from_pyvista(cls, mesh: pyvista.DataSet, *, transform: Transform | None = None) -> Self:
        """Make a mesh from the surface of a PyVista data set.

        Parameters
        ----------
        mesh : pyvista.DataSet
            Its surface. Faces of more than three corners are cut into triangles, be they convex or not, and so are
            triangle strips, which come last; points and lines are left out, which is reported to the logger
            ``lidarsim``.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh.

        Returns
        -------
        TriangleMesh
            The triangles of the surface, in the order of its faces.

        Raises
        ------
        TypeError
            If it is no data set, but several blocks of them, for one.
        ValueError
            If its vertices or faces are not those of a valid mesh.
        """
        if not hasattr(mesh, "extract_surface"):
            raise ArgumentTypeError("mesh", "a pyvista.DataSet", type(mesh).__name__, _reader(mesh))
        surface: Any = mesh
        if not hasattr(mesh, "GetPolys"):
            try:
                surface = mesh.extract_surface(algorithm=None)
            except TypeError:  # before PyVista 0.47 there was only this algorithm, and no argument
                surface = mesh.extract_surface()
        points = np.asarray(surface.points, np.float64)
        faces, strips = _cells(surface.GetPolys()), of_strips(*_cells(surface.GetStrips()))
        triangles, _ = triangulate(points, *map(np.concatenate, zip(faces, strips, strict=True)))
        left_out = surface.n_verts + surface.n_lines
        if left_out and not len(triangles):
            raise ArgumentValueError("mesh", "faces", f"{left_out} points and lines alone")
        if left_out:
            logging.getLogger("lidarsim").warning("mesh: %d points and lines left out, which nothing hits", left_out)
        return cls(points, triangles, transform=transform)

    @classmethod
    def from_heightfield(
        cls,
        z: npt.ArrayLike,
        spacing: npt.ArrayLike,
        origin: npt.ArrayLike = (0.0, 0.0),
        *,
        transform: Transform | None = None,
    ) -> Self:
        """Make terrain from heights on a regular grid.

        Parameters
        ----------
        z : array_like, shape (rows, columns)
            Heights, m, at least two rows and two columns. ``z[i, j]`` stands at x = origin[0] + j·spacing, y =
            origin[1] + i·spacing. NaN, or a masked entry of a masked array, is a hole: no triangle touches that node.
        spacing : float or array_like, shape (2,)
            Distance between columns (along x) and rows (along y), m, > 0.
        origin : array_like, shape (2,)
            Position x, y of ``z[0, 0]``, m.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh.

        Returns
        -------
        TriangleMesh
            Two triangles a cell, cell after cell along the rows; normals point up. The vertices are the nodes that have
            a height, row after row: ``z[~np.isnan(z)]`` if `z` is not masked.

        Raises
        ------
        ValueError
            If a height is infinite or seems to stand for no data, such as −9999 far from all others, no triangle is
            without NaN, the grid is too small, the spacing is not positive, or another number is not finite.
        """
        if isinstance(z, np.ma.MaskedArray) and z.dtype.kind in "fiu":
            z = np.where(np.ma.getmaskarray(z), np.nan, np.ma.getdata(z))
        heights = array("z", z, ("rows", "columns"), finite=False)
        rows, columns = heights.shape
        if rows < 2 or columns < 2:
            raise ArgumentValueError("z", "at least 2 rows and 2 columns", f"shape {heights.shape}")
        infinite = np.isinf(heights)
        if infinite.any():
            i, j = np.argwhere(infinite)[0]
            raise ArgumentValueError("z", "finite heights, or NaN for a hole", f"z[{i}][{j}] = {heights[i, j]}")
        if (place := find_no_data(heights)) is not None:
            i, j = place
            raise ArgumentValueError("z", "heights, or NaN for a hole", f"z[{i}][{j}] = {heights[i, j]:g}", "no data?")
        step = positive("spacing", np.broadcast_to(one_or_each("spacing", spacing, 2), (2,)).tolist())
        x0, y0 = array("origin", origin, (2,))
        with np.errstate(over="ignore"):
            x, y = x0 + step[0] * np.arange(columns), y0 + step[1] * np.arange(rows)
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ArgumentValueError("origin, spacing", "a grid within the range of float64", "one beyond it")
        points, faces = _terrain(Raster(x, y[:, None], heights))
        if not len(faces):
            raise ArgumentValueError("z", "a triangle of heights", "NaN at a corner of each triangle")
        return cls(points, faces, transform=transform)._note(None, heights.shape)

    @classmethod
    def from_raster(
        cls,
        path: str | PathLike[str],
        *,
        band: int = 1,
        window: npt.ArrayLike | None = None,
        stride: int = 1,
        transform: Transform | None = None,
    ) -> Self:
        """Read terrain from a digital elevation model: GeoTIFF or Esri ASCII grid.

        The nodes are the centres of the pixels, in the coordinates of the raster; so they are for GDAL, whether the
        file declares pixels as areas or as points. Rows may run north or south. Pixels need not be square, and the
        raster may be rotated.

        Parameters
        ----------
        path : str or path-like
            The file. Its coordinate reference system has to be in metres; a file without one is taken as being in
            metres. Only the file itself is read and, for an ASCII grid, the ``.prj`` file beside it.
        band : int
            Number of the band of heights, from 1 on. They are in the unit that the band or the vertical part of the
            coordinate reference system declares, metres or feet, and become metres.
        window : array_like, shape (4,), optional
            The part of the raster to read, x_min, y_min, x_max, y_max in its coordinates, m: the fewest nodes that
            cover it. Default: all of it.
        stride : int
            Take every n-th row and column, counted from the first of the raster. A raster that is read by windows has
            the same nodes in all of them. Heights are those of the nodes; nothing is averaged.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh. Casts are exact at the coordinates of any projection, so the mesh may stay
            there.

        Returns
        -------
        TriangleMesh
            As from `from_heightfield`, with the rows counter-clockwise from the columns. Nodes without data are holes:
            those that equal the band's no-data value (−9999 in an ASCII grid that declares none), are masked, or are
            NaN.

        Raises
        ------
        FileFormatError
            If the file cannot be read as a raster of heights, if more than 67,108,864 nodes (2²⁶, which take 17 GB)
            would be read, if its coordinates are in degrees or feet, or in metres that differ from those on the ground
            by more than 2 %, as in Web Mercator, or if a height seems to stand for no data, such as −9999 far from all
            others, and the file does not declare it.
        FileNotFoundError
            If there is no such file.
        MissingExtraError
            If rasterio or pyproj is not installed.
        TypeError, ValueError
            If the file has no such band, the window does not overlap the raster, or the stride leaves less than two
            rows or columns.
        """
        raster: Raster = view(TriangleMesh, "from_raster")(path, band=band, window=window, stride=stride)
        points, faces = _terrain(raster)
        if not len(faces):
            raise FileFormatError(f"{path}: expected a triangle of heights, got no data at a corner of each triangle")
        return cls(points, faces, transform=transform)._note(raster.crs, raster.z.shape)

    def deformed(self, vertices: npt.ArrayLike) -> Self:
        """Return the mesh with its vertices elsewhere, as of a body that bends.

        Casts are as exact as those of a mesh built from these vertices, and give the same bits. The hierarchy is that
        of this mesh, refitted, which takes a tenth of the time of building one. Casts take longer the farther apart
        triangles have moved that were neighbours; if these are scattered, make a new mesh instead.

        Parameters
        ----------
        vertices : array_like, shape (n, 3)
            New positions of all vertices of the mesh, before its transform, m.

        Returns
        -------
        TriangleMesh
            A mesh of the same faces and the same transform.

        Raises
        ------
        TypeError, ValueError
            If these are not finite numbers, or not as many as the mesh has vertices.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> sheet = ls.TriangleMesh.from_heightfield(np.zeros((20, 20)), 1.0)
        >>> scene = ls.Scene()
        >>> flag = scene.add(sheet)
        >>> for time in (0.0, 0.5):
        ...     x, y, _ = sheet.vertices.T
        ...     scene.update(flag, shape=sheet.deformed(np.column_stack((x, y, np.sin(x - time)))))
        ...     print(scene.cast([[3.0, 5.0, 10.0]], [[0, 0, -1]]).t.round(3))
        [9.859]
        [9.402]
        """
        points = array("vertices", vertices, (len(self.vertices), 3))
        mesh = type(self).__new__(type(self))
        Shape.__init__(mesh, self._native.deformed(points))
        return mesh._note(self.crs, self.grid)

    @property
    def crs(self) -> str | None:
        """Coordinate reference system of the raster that the mesh was read from, if it declares one: str or None.

        It is a name such as ``EPSG:32632`` if there is one, else WKT; `pyproj.CRS` takes both.
        """
        return self._crs

    @property
    def grid(self) -> tuple[int, int] | None:
        """Numbers of rows and columns of the heights that the mesh was made from, holes included: (int, int) or None.

        Since each node that is no hole is a vertex, there are ``rows * columns - len(mesh.vertices)`` holes.
        """
        return self._grid

    @property
    def vertices(self) -> npt.NDArray[np.float64]:
        """The vertices before any transform, m: read-only ndarray of float64, shape (n, 3)."""
        return self._native.vertices()

    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """The faces: read-only ndarray of uint32, shape (m, 3)."""
        return self._native.faces()

    @property
    def degenerate_count(self) -> int:
        """Number of triangles whose vertices lie on one line, exactly; nothing hits them."""
        return self._native.degenerate()

    def _reach(self, directions: Floats, /) -> Floats:
        hull: Floats | None = getattr(self, "_hull", None)
        if hull is None:
            hull = _corners_of_hull(self.vertices[np.unique(self.faces)])
            object.__setattr__(self, "_hull", hull)  # a cache: the mesh does not change
        reach: Floats = product(directions, hull.T).max(axis=1)
        return reach

    def _tessellate(self, _chord_error: float | None, _box: Floats, /) -> Triangles:
        return self.vertices, self.faces

    def _contents(self) -> dict[str, Any]:
        return {**super()._contents(), "crs": self.crs, "grid": self.grid}

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        made = {name: value for name, value in contents.items() if name not in {"crs", "grid"}}
        return cls(**made)._note(contents.get("crs"), contents.get("grid"))

    def __len__(self) -> int:
        return self._native.primitives()

    def __repr__(self) -> str:
        """Return the numbers of vertices and faces, and the coordinate reference system."""
        crs = "" if self.crs is None else f", {plain(self.crs, most=60)}"
        placed = "" if self.transform is None else ", transform=…"
        return f"TriangleMesh({len(self.vertices):,} vertices, {quantity(len(self), 'face')}{crs}{placed})"


NO_DATA = (999.0, 9999.0, 99999.0, 32767.0, 32768.0, 65535.0)
"""Numbers that programs write, with either sign, where there is no height; larger ones are beyond `HIGHEST`."""

HIGHEST = 12_000.0
"""Height that nothing on Earth exceeds, up or down, m."""

FAR = 900.0
"""Distance from all other heights, m, beyond which such a number is hardly a height."""


def find_no_data(heights: Floats, stored: Callable[[float], float] = float) -> tuple[int, int] | None:
    """Return row and column of the first height that seems to stand for no data, if there is one.

    It is the lowest or the highest, `FAR` from all others, and either beyond `HIGHEST` or one of `NO_DATA` as
    ``stored(number)`` returns it in the unit of the heights.
    """
    usual = {stored(sign * number) for number in NO_DATA for sign in (1.0, -1.0)}
    for extreme in (np.fmin, np.fmax):
        value = float(extreme.reduce(heights, axis=None))
        if value in usual or abs(value) > HIGHEST:
            alike = heights == value
            nearest = float(extreme.reduce(heights[~alike], axis=None, initial=np.nan))
            if not abs(nearest - value) <= FAR:
                i, j = np.argwhere(alike)[0].tolist()
                return i, j
    return None


def _terrain(raster: Raster) -> tuple[Floats, npt.NDArray[np.uint32]]:
    """Return the nodes that have a height, and two triangles a cell but for those that touch another node."""
    z = raster.z
    there = ~np.isnan(z)
    points = np.empty((np.count_nonzero(there), 3))
    for axis, values in enumerate((raster.x, raster.y, z)):
        points[:, axis] = np.broadcast_to(values, z.shape)[there]
    number = np.cumsum(there, dtype=np.uint32).reshape(z.shape) - np.uint32(1)
    a, b, c, d = _corners(number)
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    if len(points) < z.size:
        a, b, c, d = _corners(there)
        faces = faces[np.stack([a & b & c, a & c & d], axis=-1).ravel()]
    return points, faces


def _corners(nodes: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], ...]:
    """Return the values at the four corners of each cell, counter-clockwise."""
    return nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, 1:], nodes[1:, :-1]


def _corners_of_hull(points: Floats) -> Floats:
    """Return the points that are corners of their convex hull, or all points if these are not `IN_HULL` or flat."""
    if len(points) not in IN_HULL:
        return points
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners: Floats = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points
    return corners


def _reader(value: object) -> str:
    """Return the hint at the method that makes a mesh of what was given."""
    match value:
        case str() | PathLike():
            return "TriangleMesh.from_file reads files"
        case _ if any(hasattr(value, name) for name in ("points", "point", "xyz", "vertices")):
            return "Disks.from_points makes surfaces of points"
    return ""


def _cells(array: Any) -> tuple[Indices, Indices]:
    """Return the vertices of a ``vtkCellArray``, one cell after the other, and how many each has."""
    from vtkmodules.util import numpy_support

    convert: Any = numpy_support.vtk_to_numpy
    if not array.GetNumberOfCells():
        return np.empty(0, np.int64), np.empty(0, np.int64)
    corners, ends = convert(array.GetConnectivityArray()), convert(array.GetOffsetsArray())
    return corners.astype(np.int64), np.diff(ends).astype(np.int64)


def _faces(value: npt.ArrayLike, vertices: int) -> npt.NDArray[np.uint32]:
    given = as_array("faces", value, "integers of shape (m, 3)")
    if given.size == 0:
        given = given.reshape(-1, 3).astype(np.uint32)
    if given.dtype.kind not in "iu":
        raise ArgumentTypeError("faces", "integers of shape (m, 3)", f"dtype {given.dtype}")
    if given.ndim != 2 or given.shape[1] != 3:
        raise ArgumentValueError("faces", "shape (m, 3)", given.shape)
    wrong = (given < 0) | (given >= vertices)
    if wrong.any():
        i, j = np.argwhere(wrong)[0]
        hint = "; counted from 1?" if given.min() == 1 and given.max() == vertices else ""
        raise ArgumentValueError("faces", f"indices from 0 to {vertices - 1}", f"faces[{i}][{j}] = {given[i, j]}{hint}")
    return in_order(given, np.uint32)


def register_mesh_reader(recognise: Callable[[Path], bool], read: Callable[[Path], MeshFile]) -> None:
    """Let `TriangleMesh.from_file` read one more kind of file.

    Parameters
    ----------
    recognise : callable
        ``recognise(path)`` says by its name whether a file is of this kind.
    read : callable
        ``read(path)`` returns the `MeshFile` of a regular file, or raises an error of any kind.
    """
    _readers.append((recognise, read))


_readers: list[tuple[Callable[[Path], bool], Callable[[Path], MeshFile]]] = []


def read_mesh(path: Path) -> MeshFile:
    """Read a mesh file of any kind.

    Raises
    ------
    FileFormatError
        If it cannot be read as a mesh, or holds no face of three corners.
    """
    check_regular(path)
    with reading_as(path, "a mesh"):
        read = next((read for recognise, read in _readers if recognise(path)), None)
        if read is None:
            raise FileFormatError(f"unknown extension {path.suffix!r}")
        file = read(path)
        if not (file.sizes > 2).any():
            raise FileFormatError("it holds no triangles")
        return file
