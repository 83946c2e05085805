"""The world: shapes with names, labels and materials."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim import _native as core
from lidarsim._validation import Transform, affine, array, integer, rays, t_range
from lidarsim._views import view
from lidarsim.materials import Material
from lidarsim.shapes import Hits, Shape, TriangleMesh
from lidarsim.trajectory import Trajectory

if TYPE_CHECKING:
    import pyvista


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """A shape in a scene.

    Attributes
    ----------
    shape : Shape
        The shape in its own coordinates.
    name : str
        For people; it need not be unique.
    label : int
        Class of the object, 0 to 2³² − 1.
    material : Material
        How its surface returns light.
    transform : ndarray of float64, shape (4, 4), or None
        Affine map, object to world; None for the identity.
    motion : Trajectory or None
        Rigid motion over time, after `transform`; None for what stands still.
    """

    shape: Shape
    name: str
    label: int
    material: Material
    transform: npt.NDArray[Any] | None
    motion: Trajectory | None


class Scene:
    """Objects that rays are cast at together.

    Examples
    --------
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> road = scene.add(ls.Plane((0, 0, 1), 0.0), name="road", label=40)
    >>> ball = scene.add(ls.Sphere((5, 0, 1), 1.0), name="ball", label=1)
    >>> hits = scene.cast([[0, 0, 1], [0, 0, 1], [0, 0, 1]], [[1, 0, 0], [0, 1, -1], [0, 0, 1]])
    >>> hits.t
    array([ 4.,  1., inf])
    >>> hits.object_id
    array([ 1,  0, -1], dtype=int32)
    """

    def __init__(self) -> None:
        self._objects: list[tuple[SceneObject, core.Shape]] = []
        self._in_core: tuple[int, core.Scene, core.Appearances] | None = None

    def add(
        self,
        shape: Shape,
        *,
        name: str = "",
        label: int = 0,
        material: Material | None = None,
        transform: Transform | None = None,
        motion: Trajectory | None = None,
    ) -> int:
        """Add an object.

        Parameters
        ----------
        shape : Shape
            A mesh may be added many times; its triangles and their hierarchy are shared.
        name : str
            For people.
        label : int
            Class of the object, 0 to 2³² − 1.
        material : Material, optional
            How its surface returns light; by default a perfect diffuser.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map, object to world; it may shear and reflect. It comes after the transform that the shape may
            have of its own.
        motion : Trajectory, optional
            Rigid motion over time, which comes after `transform`: at time t the object is where its pose at t takes it,
            as float64 has it, and all that is exact about casts is so for that pose. It has to cover the times of all
            casts and scans.

        Returns
        -------
        int
            The object's id, which hits refer to: 0 for the first object, then 1, and so on.

        Raises
        ------
        TypeError
            If `shape` is not a shape, `name` not a string, `label` not an integer, `motion` not a trajectory, or
            `material` not a material, or one with a reflectivity per face or vertex where the shape is no mesh.
        ValueError
            If the label is out of range, the transform cannot be inverted, or the mesh has another number of faces or
            vertices than the material has reflectivities.
        """
        if not isinstance(shape, Shape):
            raise TypeError(f"shape: expected a lidarsim shape, got {type(shape).__name__}")
        if not isinstance(name, str):
            raise TypeError(f"name: expected a string, got {name!r}")
        if material is not None and not isinstance(material, Material):
            raise TypeError(f"material: expected a Material, got {type(material).__name__}")
        if motion is not None and not isinstance(motion, Trajectory):
            raise TypeError(f"motion: expected a Trajectory, got {type(motion).__name__}")
        material = material or Material()
        _check_reflectivity(material, shape)
        label = integer("label", label, at_least=0, at_most=2**32 - 1)
        placed = shape._native
        if transform is not None:
            transform = affine("transform", transform)
            placed = placed.transformed(transform.tolist())
        if motion is not None:
            placed = placed.moving(motion._native)
        self._objects.append((SceneObject(shape, name, label, material, transform, motion), placed))
        return len(self._objects) - 1

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """The objects in the order of their ids: tuple of SceneObject."""
        return tuple(item for item, _ in self._objects)

    @property
    def _native(self) -> core.Scene:
        return self._core()[1]

    def _core(self) -> tuple[int, core.Scene, core.Appearances]:
        """Return the number of objects, and the scene and the labels and reflectivities that the core has of them.

        They are cached. Objects are only ever added, so a cache is up to date if it has as many as there are now; this
        also holds if another thread made it.
        """
        kept = self._in_core
        if kept is None or kept[0] != len(self._objects):
            objects = self._objects.copy()
            looks = [
                (item.label, item.material.per, np.atleast_1d(np.asarray(item.material.reflectivity, dtype=np.float64)))
                for item, _ in objects
            ]
            kept = len(objects), core.Scene([placed for _, placed in objects]), core.Appearances(looks)
            self._in_core = kept
        return kept

    def cast(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike,
        *,
        t_min: float = 0.0,
        t_max: float = math.inf,
        time: float | npt.ArrayLike = 0.0,
    ) -> Hits:
        """Find the nearest hit of each ray.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Rays ``origin + t * direction``. A direction may have any length but zero.
        t_min, t_max : float
            Range of t, in units of the length of the direction; 0 <= t_min <= t_max. Both ends belong to it.
        time : float or array_like, shape (n,)
            When the rays are cast, s: each meets every object where it then is.

        Returns
        -------
        Hits
            One entry a ray. Which object and primitive is nearest is decided exactly; of equal t the lowest object id
            comes first, then the lowest primitive id.

        Raises
        ------
        ValueError
            If a shape is wrong, a number is not finite, a direction is zero, the range is not one, or the motion of an
            object does not cover the times.
        """
        o, d = rays(origins, directions)
        when = array("time", time, ("n",) if np.ndim(time) else ())
        if when.ndim and len(when) != len(o):
            raise ValueError(f"time: expected one number or one for each of {len(o)} rays, got {len(when)}")
        world = self._native
        times = np.broadcast_to(when, len(o)).copy() if world.moves() else None
        if times is not None and len(times):
            self._check_motions(times.min(), times.max())
        return Hits(*world.cast(o, d, *t_range(t_min, t_max), times))

    def _check_motions(self, first: float, last: float, until: Callable[[float], float] = float) -> None:
        """Raise an error that names the first object whose motion does not cover these times.

        `until` says to which time a motion may be carried on, by its last.
        """
        for i, item in enumerate(self.objects):
            if item.motion is None:
                continue
            start, end = item.motion.span
            if first < start or last > until(end):
                name = f" ({item.name!r})" if item.name else ""
                raise ValueError(
                    f"time: expected times within the motion of object {i}{name}, {start} to {end} s,"
                    f" got {first} to {last} s"
                )

    def to_pyvista(
        self, *, chord_error: float | None = None, bounds: npt.ArrayLike | None = None
    ) -> pyvista.MultiBlock:
        """Return the surfaces of the objects as triangles, in the world, to look at.

        Parameters
        ----------
        chord_error : float, optional
            Greatest distance of a triangle from the surface that it stands for, m. By default a 200th of the radius of
            each sphere, ellipsoid and cylinder; all other shapes are exact.
        bounds : array_like, shape (2, 3), optional
            Least and greatest coordinates of what else is seen, m. A plane is clipped to a box around all other objects
            and these, widened by a tenth of its size, and so far that it holds the point of the plane nearest to its
            middle.

        Returns
        -------
        pyvista.MultiBlock
            A block for each object, in their order and by their names; empty where an object has no triangles. A block
            has the cell data ``object_id`` and ``label`` and the field data ``name``. Objects of one mesh share the
            connectivity of its triangles.

        Raises
        ------
        MissingExtraError
            If PyVista is not installed.
        TypeError, ValueError
            If `chord_error` is no positive number, or less than a millionth of the radius of an object, or `bounds`
            are not finite numbers of that shape.
        """
        converted: pyvista.MultiBlock = view(Scene, "pyvista")(self, chord_error=chord_error, bounds=bounds)
        return converted

    def to_open3d(
        self, *, chord_error: float | None = None, bounds: npt.ArrayLike | None = None
    ) -> list[dict[str, Any]]:
        """Return the surfaces of the objects as triangles, in the world, to look at.

        Parameters
        ----------
        chord_error : float, optional
            As in `to_pyvista`.
        bounds : array_like, shape (2, 3), optional
            As in `to_pyvista`.

        Returns
        -------
        list of dict
            What ``open3d.visualization.draw`` takes: for each object that has triangles its ``name``, with its id
            before it so that it is unique, and the ``geometry``, an ``open3d.t.geometry.TriangleMesh`` with the
            attributes ``object_id`` and ``label`` of each triangle.

        Raises
        ------
        MissingExtraError
            If Open3D is not installed.
        TypeError, ValueError
            As in `to_pyvista`; or if a label is beyond 2⁵³.
        """
        converted: list[dict[str, Any]] = view(Scene, "open3d")(self, chord_error=chord_error, bounds=bounds)
        return converted

    def plot(self, **options: Any) -> Any:
        """Show the surfaces; a short way to write ``lidarsim.show(scene, …)``.

        Parameters
        ----------
        **options
            Those of `lidarsim.show`: `color_by`, `save`, `camera` and others.

        Returns
        -------
        Page or None
            What `lidarsim.show` returns.
        """
        return view(Scene, "plot")(self, **options)

    def __len__(self) -> int:
        return len(self._objects)


def _check_reflectivity(material: Material, shape: Shape) -> None:
    """Raise an error where a reflectivity per face or vertex does not fit the shape."""
    per = material.per
    if per == "object":
        return
    if not isinstance(shape, TriangleMesh):
        raise TypeError(f"material: expected a TriangleMesh for a reflectivity per {per}, got {type(shape).__name__}")
    wanted = len(shape) if per == "face" else len(shape.vertices)
    given = np.size(material.reflectivity)
    if given != wanted:
        raise ValueError(f"material: expected {wanted} reflectivities, one per {per}, got {given}")
