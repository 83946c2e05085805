"""Triangle mesh."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._files import check_regular, reading_as
from lidarsim._validation import Floats, Transform, array, as_array, in_order, one_or_each, positive
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.shapes._polygons import Indices, of_strips, triangulated
from lidarsim.shapes._shape import Shape
from lidarsim.shapes._tessellation import Triangles

if TYPE_CHECKING:
    import open3d
    import pyvista
    import trimesh


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
    """

    vertices: Floats
    corners: Indices
    sizes: Indices
    names: Sequence[str] = ()
    parts: Indices | None = None


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

    __slots__ = ()
    __match_args__ = ("vertices", "faces")

    def __init__(self, vertices: npt.ArrayLike, faces: npt.ArrayLike, *, transform: Transform | None = None) -> None:
        points = array("vertices", vertices, ("n", 3))
        super().__init__(_native.Shape.triangle_mesh(points, _faces(faces, len(points)), False), transform)

    @classmethod
    def from_file(cls, path: str | PathLike[str], *, transform: Transform | None = None) -> Self:
        """Read a mesh file: PLY, STL, OBJ and OFF, and GLB and what else trimesh reads.

        Faces of more than three corners are cut into triangles, be they convex or not.

        Parameters
        ----------
        path : str or path-like
            The file; its units are taken as metres. A file of several meshes is read as one. Of the files that it
            names, only those beside or below it are read.
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
        path = Path(fspath(path))
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such mesh file")
        file = read_mesh(path)
        try:
            faces, _ = triangulated(file.vertices, file.corners, file.sizes)
            mesh = cls(file.vertices, faces, transform=transform)
        except ValueError as error:
            raise FileFormatError(f"{path}: {error}") from error
        if mesh.degenerate_count:
            logging.getLogger("lidarsim").warning(
                "%s: %d of %d triangles are degenerate; nothing hits them", path, mesh.degenerate_count, len(mesh)
            )
        return mesh

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh, *, transform: Transform | None = None) -> Self:
        """Make a mesh from a ``trimesh.Trimesh``.

        Parameters
        ----------
        mesh : trimesh.Trimesh
            Its vertices and faces are copied.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh.

        Returns
        -------
        TriangleMesh
            The same triangles in the same order.

        Raises
        ------
        ValueError
            If its vertices or faces are not those of a valid mesh.
        """
        return cls(np.asarray(mesh.vertices), np.asarray(mesh.faces), transform=transform)

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
        ValueError
            If its vertices or faces are not those of a valid mesh.
        """
        if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):  # the tensor mesh
            return cls(mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy(), transform=transform)
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
            raise ArgumentTypeError("mesh", "a pyvista.DataSet", type(mesh).__name__)
        surface: Any = mesh
        if not hasattr(mesh, "GetPolys"):
            try:
                surface = mesh.extract_surface(algorithm=None)
            except TypeError:  # before PyVista 0.47 there was only this algorithm, and no argument
                surface = mesh.extract_surface()
        points = np.asarray(surface.points, np.float64)
        faces, strips = _cells(surface.GetPolys()), of_strips(*_cells(surface.GetStrips()))
        triangles, _ = triangulated(points, *map(np.concatenate, zip(faces, strips, strict=True)))
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
            origin[1] + i·spacing.
        spacing : float or array_like, shape (2,)
            Distance between columns (along x) and rows (along y), m, > 0.
        origin : array_like, shape (2,)
            Position x, y of ``z[0, 0]``, m.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the mesh.

        Returns
        -------
        TriangleMesh
            Two triangles a cell, cell after cell along the rows; normals point up.

        Raises
        ------
        ValueError
            If a number is not finite, the grid is too small, or the spacing is not positive.
        """
        heights = array("z", z, ("rows", "columns"))
        rows, columns = heights.shape
        if rows < 2 or columns < 2:
            raise ArgumentValueError("z", "at least 2 rows and 2 columns", f"shape {heights.shape}")
        step = positive("spacing", np.broadcast_to(one_or_each("spacing", spacing, 2), (2,)).tolist())
        x0, y0 = array("origin", origin, (2,))
        with np.errstate(over="ignore"):
            x, y = np.meshgrid(x0 + step[0] * np.arange(columns), y0 + step[1] * np.arange(rows))
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ArgumentValueError("origin, spacing", "a grid within the range of float64", "one beyond it")
        corner = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
        faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
        return cls(np.stack([x, y, heights], axis=-1).reshape(-1, 3), faces, transform=transform)

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

    def _tessellated(self, _chord_error: float | None, _box: Floats, /) -> Triangles:
        return self.vertices, self.faces

    def __len__(self) -> int:
        return self._native.primitives()

    def __repr__(self) -> str:
        """Return the numbers of vertices and faces."""
        placed = "" if self.transform is None else ", transform=…"
        return f"TriangleMesh({len(self.vertices):,} vertices, {len(self):,} faces{placed})"


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
