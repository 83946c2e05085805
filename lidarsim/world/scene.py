"""Scenes: shapes with names, labels, materials and motions."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from lidarsim import _native as core
from lidarsim._base.files import PathLike, check_path, check_regular
from lidarsim._base.names import explain_arguments
from lidarsim._base.pickling import Immutable, Pickled
from lidarsim._base.shown import html_table, plain, quantity
from lidarsim._base.validation import (
    UINT32,
    Floats,
    Instances,
    Transform,
    array,
    as_array,
    check_options,
    function,
    instances,
    integer,
    named_labels,
    one_or_each,
    placement,
    rays,
    real,
    short_repr,
    t_range,
)
from lidarsim._base.views import Plotted, view
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.materials import Material
from lidarsim.motion.trajectory import Trajectory
from lidarsim.world.atmosphere import Atmosphere
from lidarsim.world.rules import Options, Rule
from lidarsim.world.shapes import Disks, Hits, Shape, Spheres, TriangleMesh

if TYPE_CHECKING:
    import pyvista

Label = int | npt.NDArray[np.uint32]

DIFFUSE = Material()
HEAD = 1 << 16  # bytes at the start of a file that determine its kind
MOST_LINES = 12  # maximum lines of a repr
MOST = 2**31 - 1  # maximum id: hits store ids as int32


FILES = "TriangleMesh.from_file(path) reads a mesh"
"""Hint at what a path given as a shape means."""

FIELDS = ("id", "shape", "name", "label", "instance", "material", "transform", "motion")


class SceneObject(core.SceneObject, Immutable):
    """A shape in a scene.

    Attributes
    ----------
    id : int
        Id in the scene, which hits refer to.
    shape : Shape
        The shape in its own coordinates.
    name : str
        Name for people; it need not be unique.
    label : int or ndarray of uint32, shape (m,)
        Class of the object, 0 to 2³² − 1, or of each face of a `TriangleMesh`, or each of `Spheres` or `Disks`.
    instance : int
        Number that distinguishes instances of a class, 0 to 2³² − 1; objects that are parts of one instance share it.
    material : Material
        How its surface returns light.
    transform : ndarray of float64, shape (4, 4), or None
        Affine map, object to world; None for the identity.
    motion : Trajectory or None
        Rigid motion over time, applied after `transform`; None for a static object.
    """

    __slots__ = ()

    def _contents(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in FIELDS}

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> SceneObject:
        return _check(**contents)

    def __repr__(self) -> str:
        """Return the id, name, shape, label and instance."""
        label = f"{len(np.unique(self.label))} labels" if isinstance(self.label, np.ndarray) else f"label {self.label}"
        name = f" {self.name!r}" if self.name else ""
        moves = "" if self.motion is None else ", moves"
        return f"SceneObject {self.id}{name}: {self.shape}, {label}, instance {self.instance}{moves}"


def _check(  # noqa: PLR0917 - the fields, in their order
    id: int,  # noqa: A002 - the name of the field
    shape: Shape,
    name: str,
    label: Any,
    instance: object,
    material: Material,
    transform: Transform | None,
    motion: Trajectory | None,
    like: SceneObject | None = None,
) -> SceneObject:
    """Return an object after checking its fields; `like` is one with the same label, instance and material."""
    if not isinstance(shape, Shape):
        raise ArgumentTypeError(
            "shape", "a lidarsim shape", type(shape).__name__, FILES if isinstance(shape, str | Path) else ""
        )
    if not isinstance(name, str):
        raise ArgumentTypeError("name", "a string", short_repr(name))
    if not isinstance(material, Material):
        raise ArgumentTypeError("material", "a Material", type(material).__name__)
    if motion is not None and not isinstance(motion, Trajectory):
        raise ArgumentTypeError("motion", "a Trajectory", type(motion).__name__)
    if material._per != "object":
        _check_reflectivity(material, shape)
    if type(label) is not int or not 0 <= label <= UINT32:
        label = _label(label, shape, None if like is None else like.label)
    number = integer("instance", instance, at_least=0, at_most=UINT32)
    place = None if transform is None else placement(transform)
    return SceneObject(id, shape, name, label, number, material, place, motion, like)


class _Changes(TypedDict, total=False):
    """The fields of an object that can be changed."""

    shape: Shape
    name: str
    label: npt.ArrayLike
    instance: int
    material: Material | None
    transform: Transform | None
    motion: Trajectory | None


class _Animations(Protocol):
    """How the animations of a file move the objects of its scene."""

    @property
    def durations(self) -> dict[str, float]: ...
    def at(self, animation: str, time: float, /) -> Iterable[tuple[int, Shape, Floats | None]]: ...


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Snapshot:
    """The objects at one moment, in the core.

    `atmosphere` is the air, `items` are the objects. `ids` are their ids in order, followed by -1 for "no object"; None
    if these are 0, 1, 2, …. `span` is the time interval that the motions of all movers cover.
    """

    version: object
    atmosphere: Atmosphere | None
    items: tuple[SceneObject, ...]
    native: core.Scene
    ids: npt.NDArray[np.int32] | None
    movers: tuple[tuple[SceneObject, Trajectory], ...]
    span: tuple[float, float]

    def places_of(self, ids: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Return the places of objects in the core by their ids; -1 stays -1."""
        if self.ids is None:
            return ids
        return np.where(ids < 0, -1, np.searchsorted(self.ids[:-1], ids)).astype(np.int32)

    def ids_of(self, places: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Return the ids of objects by their places in the core; -1 stays -1."""
        return places if self.ids is None else self.ids[places]

    def without(self, instances: Collection[int]) -> Snapshot:
        """Return the same moment without the objects of some instances."""
        if not instances:
            return self
        items = [item for item in self.items if item.instance not in instances]
        movers = tuple(mover for mover in self.movers if mover[0].instance not in instances)
        ids = np.array([*(item.id for item in items), -1], dtype=np.int32)
        native = core.Scene([*items])
        return replace(self, version=object(), items=tuple(items), native=native, ids=ids, movers=movers)

    def times(self, time: float | npt.ArrayLike, count: int) -> Floats | None:
        """Return the checked time of each of `count` rays, or None if nothing moves."""
        if not self.movers and isinstance(time, float) and math.isfinite(time):
            return None
        when = one_or_each("time", time, "n")
        if when.ndim and len(when) != count:
            raise ArgumentValueError("time", f"one number or one for each of {count} rays", len(when))
        if not self.movers:
            return None
        times = np.broadcast_to(when, count).copy()
        if count:
            self.check_motions(times.min(), times.max())
        return times

    def check_motions(
        self, first: float, last: float, until: Callable[[float], float] = float, *, argument: str = "time"
    ) -> None:
        """Raise an error that names the first object whose motion does not cover these times.

        `until` maps the end of a motion to the time up to which it may be extrapolated; `argument` is what they are of.
        """
        if self.span[0] <= first and last <= self.span[1]:
            return
        for item, motion in self.movers:
            start, end = motion._native.span()
            if first < start or (last > end and last > until(end)):
                name = f" ({item.name!r})" if item.name else ""
                raise ArgumentValueError(
                    argument,
                    f"times within the motion of object {item.id}{name}, {start} to {end} s",
                    f"{first} to {last} s",
                )


class Scene(Pickled, Plotted):
    """A collection of objects to cast rays at.

    Iterating over a scene yields its objects in the order of their ids; ``len(scene)`` is the number of objects and
    ``scene[id]`` is one object. Scenes can be copied and pickled: a copy has the same objects under the same ids, and
    changing one does not change the other. Shapes and materials are immutable, so copies share them.

    Parameters
    ----------
    class_names : mapping of int to str, optional
        Class names by label, for legends, summaries and files.

    Attributes
    ----------
    class_names : mapping of int to str
        Read-only class names by label.
    atmosphere : Atmosphere or None
        The air of scans: fog, rain or snow; None for clear air. It can be set. Casts do not see it.

    Raises
    ------
    TypeError, ValueError
        If a class name is not a string, or its label is out of range.

    Notes
    -----
    One thread may change a scene while others cast rays at it or scan it: each cast and each scan sees the scene as it
    was before or after a change, never in between. Only one thread at a time may change a scene.

    After a change, the next cast rebuilds the bounding volume hierarchy over the objects, or refits it if they have
    only moved a little. The hierarchy over the triangles of a mesh is built once, at the first cast, however often the
    mesh is added or moved.

    Examples
    --------
    >>> import lidarsim as ls
    >>> scene = ls.Scene(class_names={40: "road"})
    >>> road = scene.add(ls.Plane((0, 0, 1), 0.0), name="road", label=40)
    >>> ball = scene.add(ls.Sphere((5, 0, 1), 1.0), name="ball", label=1)
    >>> hits = scene.cast([[0, 0, 1], [0, 0, 1], [0, 0, 1]], [[1, 0, 0], [0, 1, -1], [0, 0, 1]])
    >>> hits.t
    array([ 4.,  1., inf])
    >>> hits.object_id
    array([ 1,  0, -1], dtype=int32)
    >>> scene.update(ball, shape=ls.Sphere((5, 0, 1), 2.0))
    >>> scene.cast([[0, 0, 1]], [[1, 0, 0]]).t
    array([3.])
    """

    # No others: `scene.atmospher = fog` would leave the air clear.
    __slots__ = "__weakref__", "_animations", "_atmosphere", "_class_names", "_items", "_kept", "_next", "_version"

    @explain_arguments
    def __init__(self, *, class_names: Mapping[int, str] | None = None) -> None:
        self._class_names = named_labels("class_names", class_names)
        self._atmosphere: Atmosphere | None = None
        self._items: dict[int, SceneObject] = {}
        self._next = 0
        self._kept: Snapshot | None = None
        self._animations: _Animations | None = None
        self._change()

    @explain_arguments
    def add(
        self,
        shape: Shape,
        *,
        name: str = "",
        label: npt.ArrayLike = 0,
        instance: int | None = None,
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
            Name for people and for `find`.
        label : int or array_like of int, shape (m,)
            Class of the object, 0 to 2³² − 1; for a `TriangleMesh` of m faces, `Spheres` or `Disks`, optionally
            one each.
        instance : int, optional
            Number that distinguishes instances of a class, 0 to 2³² − 1; objects that are parts of one instance share
            it. Default: the object's id + 1; so choose numbers above the number of objects. Data sets have no box of
            instance 0.
        material : Material, optional
            How its surface returns light. Default: a perfect diffuser.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map, object to world; it may shear and reflect. It is applied after the shape's own transform, if
            any.
        motion : Trajectory, optional
            Rigid motion over time, applied after `transform`. At time t the object is at the float64 pose of the motion
            at t, for which casts are exact. The motion must cover the times of all casts and scans.

        Returns
        -------
        int
            The object's id, which hits refer to: 0 for the first object, then 1, and so on. Ids of removed objects are
            not reused.

        Raises
        ------
        TypeError
            If `shape` is not a shape, `name` not a string, `label` or `instance` not an integer, `motion` not a
            trajectory, or `material` not a material; or if labels or reflectivities per face or vertex, or a texture,
            are given for a shape that is not a mesh.
        ValueError
            If a label or the instance is out of range, the transform is singular, or the number of labels,
            reflectivities or texture coordinates does not match the faces or vertices of the mesh.
        """
        number = self._next
        if number > MOST:
            raise ArgumentValueError("shape", f"at most {MOST + 1} objects in the life of a scene", "one more")
        if instance is None:
            instance = number + 1
        if material is None:
            material = DIFFUSE
        self._items[number] = _check(number, shape, name, label, instance, material, transform, motion)
        self._next = number + 1
        self._change()
        return number

    def update(self, object_id: int, **changes: Unpack[_Changes]) -> None:
        """Change an object.

        Parameters
        ----------
        object_id : int
            Id of the object, which does not change.
        **changes
            Any of `shape`, `name`, `label`, `instance`, `material`, `transform` and `motion`, as in `add`; the others
            stay unchanged.

        Raises
        ------
        KeyError
            If there is no such object.
        TypeError, ValueError
            As in `add`; the object is then unchanged.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> ball = scene.add(ls.Sphere((0, 0, 0), 1.0))
        >>> for x in (5.0, 6.0):
        ...     place = np.eye(4)
        ...     place[0, 3] = x
        ...     scene.update(ball, transform=place)
        ...     print(scene.cast([[0, 0, 0]], [[1, 0, 0]]).t)
        [4.]
        [5.]
        """
        item = self._item(object_id)
        allowed = _Changes.__annotations__
        for name in changes:
            if name not in allowed:
                raise ArgumentTypeError(name, f"a keyword of {', '.join(allowed)}", repr(name))
        given: dict[str, Any] = dict(changes)
        if given.get("material", DIFFUSE) is None:
            given["material"] = DIFFUSE
        if given.get("instance", 0) is None:
            given["instance"] = item.id + 1
        looks = {"label", "instance", "material"}
        like = None if given.keys() & looks else item  # a mesh may have one label per face, which is then shared
        self._items[item.id] = _check(**(item._contents() | given), like=like)
        self._change()

    def update_transforms(self, ids: npt.ArrayLike, transforms: npt.ArrayLike) -> None:
        """Change the transforms of many objects at once, as after a step of a physics engine.

        Parameters
        ----------
        ids : array_like of int, shape (m,)
            Ids of the objects, each of them once.
        transforms : array_like, shape (m, 4, 4)
            Transform of each, as in `add`.

        Raises
        ------
        KeyError
            If there is no such object.
        TypeError, ValueError
            If an id is there twice, or a transform is not finite or not invertible; nothing is then changed.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> balls = [scene.add(ls.Sphere((0, 0, 0), 1.0)) for _ in range(2)]
        >>> places = np.tile(np.eye(4), (2, 1, 1))
        >>> places[:, 0, 3] = 5.0, 9.0
        >>> scene.update_transforms(balls, places)
        >>> scene.cast_all([[0, 0, 0]], [[1, 0, 0]], most=4).t
        array([[ 4.,  6.,  8., 10.]])
        """
        given = as_array("ids", ids, "integers of shape (m,)")
        if given.ndim != 1 or (given.dtype.kind not in "iu" and given.size):
            raise ArgumentTypeError("ids", "integers of shape (m,)", f"{given.dtype} of shape {given.shape}")
        numbers: list[int] = given.tolist()
        items = [self._items.get(number) or self._item(number) for number in numbers]
        places = array("transforms", transforms, (len(items), 4, 4))
        wrong = (places[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=1)
        if wrong.any():
            i = int(np.argmax(wrong))
            got = f"transforms[{i}] with {tuple(places[i, 3].tolist())}"
            raise ArgumentValueError("transforms", "a last row of (0, 0, 0, 1)", got)
        changed = dict(zip(numbers, core.place(items, places), strict=True))
        if len(changed) < len(numbers):
            twice = next(number for number in numbers if numbers.count(number) > 1)
            raise ArgumentValueError("ids", "each id once", f"{twice} twice")
        self._items.update(changed)  # at once, for the threads that cast
        self._change()

    def remove(self, object_id: int) -> None:
        """Remove an object; the others keep their ids.

        Parameters
        ----------
        object_id : int
            Id of the object.

        Raises
        ------
        KeyError
            If there is no such object.
        """
        del self._items[self._item(object_id).id]
        self._change()

    def find(self, name: str) -> list[int]:
        """Return the ids of the objects with a name.

        Parameters
        ----------
        name : str
            The whole name, as given to `add`.

        Returns
        -------
        list of int
            Ids in ascending order; empty if there are none.
        """
        if not isinstance(name, str):
            raise ArgumentTypeError("name", "a string", short_repr(name))
        return [item.id for item in self if item.name == name]

    @classmethod
    def from_file(
        cls,
        path: PathLike,
        *,
        up: Literal["y", "z"] | None = None,
        unit: float | None = None,
        rules: Sequence[Rule] = (),
        reflectivity: float | Material | Literal["color"] | None = None,
        time: float | None = None,
        animation: str | None = None,
    ) -> Scene:
        """Read a scene from a file, whose kind is determined by its content.

        Whatever the file's units and axes, the scene is in metres with z up: from y up, (x, y, z) becomes (x, −z, y).

        Parameters
        ----------
        path : path-like
            A scene file: glTF 2.0 (GLB or glTF) or COLLADA (DAE); a mesh file: OBJ, OFF, PLY or STL; a model of MuJoCo,
            MJCF or URDF, as `lidarsim.mujoco.World` shows it at first; an elevation model that
            `TriangleMesh.from_raster` reads; or a scene in YAML, as in configurations. The last two take no options.
            Files that it refers to are read only if they are beside or below it.
        up : {"y", "z"}, optional
            The axis of the file that points up. Default: as the file declares (glTF: y; DAE: its own), else z.
        unit : float, optional
            Unit of length of the file, m. Default: as the file declares (glTF: 1; DAE: its own), else 1.
        rules : sequence of Rule
            What becomes of the parts of the file: of those rules that match a part, the first decides.
        reflectivity : float, Material or "color", optional
            Reflectivity or material of the parts for which no rule gives one; "color" for the luminance of the base
            colours: factor × texture × vertex colours of glTF, ``Kd`` × ``map_Kd`` × vertex colours of OBJ, the vertex
            colours of PLY, the diffuse colour of DAE. Default: a perfect diffuser.
        time : float, optional
            Time of the animation, s, whose pose the scene shows first; see `animate`. Default: the pose without any.
        animation : str, optional
            Name of the animation; see `animate`.

        Returns
        -------
        Scene
            The objects in the order of the file, each node before the nodes below it. An object has the name of its
            node; parts of a node, which differ in material, are objects of the same name. Objects below the same top
            node are one instance, unless a rule says otherwise. The nodes that place one mesh share it. In an OBJ file,
            each object (or group) is a node; in an STL file, each solid.

        Raises
        ------
        ConfigError, FileFormatError
            If the file cannot be read as a scene.
        MissingExtraError
            If reading it takes a package that is not installed.
        OSError
            If the file cannot be opened.
        TypeError, ValueError
            If an option is invalid or does not apply to a file of this kind.

        Notes
        -----
        Without a time, skins are read in their rest pose, and morph targets of glTF with the default weights. `animate`
        plays the animations of glTF; those of other formats, cameras and lights are passed over. What else is left out,
        such as points, lines and nodes scaled to nothing, is reported to the logger ``lidarsim``.
        """
        options = Options.from_arguments(up, unit, rules, reflectivity)
        path = check_path(path)
        check_regular(path)
        kind = _kind_of(path)
        if kind is None:
            raise FileFormatError(f"{path}: expected a scene of one of these kinds: {', '.join(sorted(_readers))}")
        _, read = _readers[kind]
        given = {name: value for name, value in vars(options).items() if value is not None and value != ()}
        check_options(kind, read, given)
        scene = read(path, **given)
        if not isinstance(scene, Scene):
            raise ArgumentTypeError(f"reader {kind!r}", "a Scene", short_repr(scene))
        if time is not None or animation is not None:
            scene.animate(0.0 if time is None else time, animation=animation)
        return scene

    @property
    def animations(self) -> Mapping[str, float]:
        """Duration of each animation of the file that the scene was read from: read-only mapping of name to s."""
        return MappingProxyType({} if self._animations is None else self._animations.durations)

    def animate(self, time: float, *, animation: str | None = None) -> None:
        """Move all objects to where an animation of the scene's file has them at a time.

        Nodes, skins and morph targets follow the samplers of the file, glTF. Casts are exact for the vertices and
        transforms of that moment, which stay until the next call, also during a scan.

        Parameters
        ----------
        time : float
            Time in the animation, s. Before its first and after its last keyframe, it stands still; to loop it, take
            the remainder: ``time % scene.animations[name]``.
        animation : str, optional
            Its name, one of `animations`; those without a name have their number. Default: the first.

        Raises
        ------
        FileFormatError
            If the file has something at a place that is not finite at that time.
        TypeError, ValueError
            If the time is not finite, or the scene has no such animation; nothing is then moved.

        Notes
        -----
        The shapes and transforms of objects that animations move are set, whatever they were; other objects and other
        properties stay, objects that were removed stay removed, and objects may be added. To put a figure into another
        scene, add its objects there, and hand their shapes on:

        >>> import lidarsim as ls
        >>> def put(figure, scene, **options):  # options: motion=…, label=…
        ...     return {item.id: scene.add(item.shape, transform=item.transform, **options) for item in figure}
        >>> def show(figure, scene, ids, time):
        ...     figure.animate(time)
        ...     for item in figure:
        ...         scene.update(ids[item.id], shape=item.shape, transform=item.transform)
        """
        moment = real("time", time)
        known = self.animations
        if animation is not None and not isinstance(animation, str):
            raise ArgumentTypeError("animation", "the name of an animation", short_repr(animation))
        if self._animations is None or (animation is not None and animation not in known):
            names = ", ".join(plain(name, most=60) for name in known)
            expected = f"one of {names}" if known else "a scene from a glTF file with animations"
            got = "a scene without" if animation is None else short_repr(animation)
            raise ArgumentValueError("animation", expected, got)
        changed = {}
        for number, shape, transform in self._animations.at(animation or next(iter(known)), moment):
            item = self._items.get(number)
            if item is not None:
                fields = item._contents() | {"shape": shape, "transform": transform}
                changed[number] = _check(**fields, like=item)
        self._items.update(changed)  # at once, for the threads that cast
        self._change()

    @property
    def class_names(self) -> Mapping[int, str]:
        """Names of labels, read-only: mapping of int to str; "air" if the label is of the atmosphere alone."""
        air = self._atmosphere
        if air is None or air.label in self._class_names or any(np.any(item.label == air.label) for item in self):
            return MappingProxyType(self._class_names)
        return MappingProxyType({**self._class_names, air.label: "air"})

    @property
    def atmosphere(self) -> Atmosphere | None:
        """The air, as scans see it: Atmosphere, or None for clear air, which is the default.

        Raises
        ------
        TypeError
            If it is set to anything else.
        """
        return self._atmosphere

    @atmosphere.setter
    def atmosphere(self, value: Atmosphere | None) -> None:
        if value is not None and not isinstance(value, Atmosphere):
            raise ArgumentTypeError("atmosphere", "an Atmosphere or None", short_repr(value))
        self._atmosphere = value
        self._change()

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """The objects in the order of their ids: tuple of SceneObject."""
        return tuple(self._items.copy().values())

    @property
    def bounds(self) -> Floats:
        """Minimum and maximum corner of a box around all bounded objects, m: ndarray of float64, shape (2, 3).

        Objects that move are where they are without their motion, placed by their `transform` alone. The corners are
        nan if no object is bounded. A plane, for example, is unbounded.
        """
        boxes = [box for box in (item.bounds for item in self) if np.isfinite(box).all()]
        if not boxes:
            return np.full((2, 3), np.nan)
        low, high = np.stack(boxes, axis=1)
        return np.stack([low.min(axis=0), high.max(axis=0)])

    def _item(self, object_id: object) -> SceneObject:
        if isinstance(object_id, str):
            raise ArgumentTypeError("object_id", "an integer", repr(object_id), "scene.find gives the ids of a name")
        number = integer("object_id", object_id)
        try:
            return self._items[number]
        except KeyError:
            if 0 <= number < self._next:
                raise KeyError(f"object_id: expected the id of an object, got {number}, which was removed") from None
            raise KeyError(f"object_id: expected an id below {self._next}, got {number}") from None

    def _change(self) -> None:
        """Bump the version, which makes the snapshot outdated."""
        self._version = object()

    def _snapshot(self) -> Snapshot:
        """Return the current objects in the core, and keep them for the next cast.

        Objects are changed before the version is bumped, and the version is read before the objects. So a snapshot
        contains every change up to its version.
        """
        version = self._version
        kept = self._kept
        if kept is None or kept.version is not version:
            items = self.objects
            if kept is not None and len(items) == len(kept.items) and all(map(operator.is_, items, kept.items)):
                kept = self._kept = replace(kept, version=version, atmosphere=self._atmosphere)
                return kept
            native = core.Scene(list(items), None if kept is None else kept.native)
            ids = None
            if items and items[-1].id != len(items) - 1:
                ids = np.array([*(item.id for item in items), -1], dtype=np.int32)
            movers = tuple([(item, item.motion) for item in items if item.motion is not None])
            spans = [motion._native.span() for _, motion in movers]
            span = (
                max((start for start, _ in spans), default=-math.inf),
                min((end for _, end in spans), default=math.inf),
            )
            kept = self._kept = Snapshot(version, self._atmosphere, items, native, ids, movers, span)
        return kept

    def cast(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike,
        *,
        t_min: float = 0.0,
        t_max: float = math.inf,
        time: float | npt.ArrayLike = 0.0,
        ignore: Instances = (),
    ) -> Hits:
        """Find the nearest hit of each ray.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Rays ``origin + t * direction``. A direction may have any length but zero.
        t_min, t_max : float
            Closed interval of t, in units of the length of the direction; 0 <= t_min <= t_max.
        time : float or array_like, shape (n,)
            Time of each ray, s: the ray meets every object at its pose at that time.
        ignore : collection of int
            Instances that the rays pass through as if they were not in the scene: a robot's own body, for example.

        Returns
        -------
        Hits
            One entry per ray. The nearest object and primitive are decided exactly; at equal t, the lowest object id
            and then the lowest primitive id win.

        Raises
        ------
        ValueError
            If a shape is wrong, a number is not finite, a direction is zero, the interval of t is invalid, the motion
            of an object does not cover the times, or no object is of an instance to ignore.
        """
        now = self._snapshot()
        o, d = rays(origins, directions)
        t, places, primitives, normals = now.native.cast(
            o, d, *t_range(t_min, t_max), now.times(time, len(o)), instances("ignore", ignore)
        )
        return Hits(t, now.ids_of(places), primitives, normals)

    def cast_all(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike,
        *,
        most: int,
        t_min: float = 0.0,
        t_max: float = math.inf,
        time: float | npt.ArrayLike = 0.0,
        ignore: Instances = (),
    ) -> Hits:
        """Find all hits of each ray, as if every surface let it pass.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Rays ``origin + t * direction``. A direction may have any length but zero.
        most : int
            Number of hits to keep per ray, k: the nearest ones; at least 1.
        t_min, t_max : float
            Closed interval of t, in units of the length of the direction; 0 <= t_min <= t_max.
        time : float or array_like, shape (n,)
            Time of each ray, s, as in `cast`.
        ignore : collection of int
            Instances that the rays pass through, as in `cast`.

        Returns
        -------
        Hits
            Arrays of shape (n, k), and (n, k, 3) for the normals, in ascending order of the exact t; at equal t, in
            ascending order of the object id. The first hit is that of `cast`, and a row ends with misses if there are
            fewer than k hits. An object is hit once at one t, also where a ray meets several of its triangles, spheres
            or disks there, or only touches it.

        Raises
        ------
        ValueError
            If a shape is wrong, a number is not finite, a direction is zero, `most` is not positive, the interval of t
            is invalid, the motion of an object does not cover the times, or no object is of an instance to ignore.
        MemoryError
            If there is no memory for n·k hits; raised before work.

        Examples
        --------
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> wall = scene.add(ls.Box((1, 10, 3), center=(5, 0, 1.5)))
        >>> ball = scene.add(ls.Sphere((8, 0, 1), 0.5))
        >>> hits = scene.cast_all([[0, 0, 1]], [[1, 0, 0]], most=5)
        >>> hits.t
        array([[4.5, 5.5, 7.5, 8.5, inf]])
        >>> hits.object_id
        array([[ 0,  0,  1,  1, -1]], dtype=int32)
        """
        most = integer("most", most, at_least=1, at_most=MOST)
        now = self._snapshot()
        o, d = rays(origins, directions)
        t, places, primitives, normals = now.native.cast_all(
            o, d, *t_range(t_min, t_max), now.times(time, len(o)), most, instances("ignore", ignore)
        )
        shape = len(o), most
        return Hits(
            t.reshape(shape),
            now.ids_of(places).reshape(shape),
            primitives.reshape(shape),
            normals.reshape(*shape, 3),
        )

    def occluded(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike,
        *,
        t_min: float = 0.0,
        t_max: float = math.inf,
        time: npt.ArrayLike = 0.0,
        ignore: Instances = (),
    ) -> npt.NDArray[np.bool_]:
        """Return whether each ray hits anything: the same as ``scene.cast(...).hit``, but faster.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Rays ``origin + t * direction``. A direction may have any length but zero; the vector from one point to
            another, with a `t_max` of 1, tests the line of sight between them.
        t_min, t_max : float
            Closed interval of t, in units of the length of the direction; 0 <= t_min <= t_max.
        time : float, or array_like, shape (n,)
            Time of each ray, s, as in `cast`.
        ignore : collection of int
            Instances that the rays pass through, as in `cast`.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether there is a hit with t_min <= t <= t_max, decided exactly.

        Raises
        ------
        ValueError
            If a shape is wrong, a number is not finite, a direction is zero, the interval of t is invalid, the motion
            of an object does not cover the times, or no object is of an instance to ignore.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> wall = scene.add(ls.Box((1, 10, 3), center=(5, 0, 1.5)))
        >>> eye, targets = np.array([0.0, 0.0, 1.0]), np.array([[10.0, 0.0, 1.0], [4.0, 0.0, 1.0]])
        >>> scene.occluded(np.broadcast_to(eye, targets.shape), targets - eye, t_max=1.0)
        array([ True, False])
        """
        now = self._snapshot()
        o, d = rays(origins, directions)
        return now.native.occluded(o, d, *t_range(t_min, t_max), now.times(time, len(o)), instances("ignore", ignore))

    def __getitem__(self, object_id: int) -> SceneObject:
        """Return an object by its id."""
        return self._item(object_id)

    def __contains__(self, item: object) -> bool:
        """Return whether there is an object of this id or name, or this object."""
        return any(item in (each.id, each.name) or item is each for each in self)

    def __iter__(self) -> Iterator[SceneObject]:
        """Iterate over the objects as they are now, in the order of their ids."""
        return iter(self.objects)

    def to_pyvista(
        self, *, chord_error: float | None = None, bounds: npt.ArrayLike | None = None
    ) -> pyvista.MultiBlock:
        """Return the surfaces of the objects as triangles in world coordinates, for display.

        Parameters
        ----------
        chord_error : float, optional
            Maximum distance of a triangle from the surface that it approximates, m. Default: 1/200 of the radius of
            each sphere, ellipsoid, cylinder, capsule and disk. All other shapes are exact.
        bounds : array_like, shape (2, 3), optional
            Minimum and maximum coordinates of everything else in the view, m. A plane is clipped to a box around these
            and all other objects, enlarged by a tenth of its size and until it contains the plane's point nearest to
            its centre.

        Returns
        -------
        pyvista.MultiBlock
            One named block per object, in order; empty if the object has no triangles. A block has the cell data
            ``object_id`` and ``label`` and the field data ``name``. Objects of one mesh share the connectivity of its
            triangles.

        Raises
        ------
        MissingExtraError
            If PyVista is not installed.
        TypeError, ValueError
            If `chord_error` is not a positive number or is less than a millionth of the radius of an object, or
            `bounds` are not finite numbers of that shape.
        """
        converted: pyvista.MultiBlock = view(Scene, "pyvista")(self, chord_error=chord_error, bounds=bounds)
        return converted

    def to_open3d(
        self, *, chord_error: float | None = None, bounds: npt.ArrayLike | None = None
    ) -> list[dict[str, Any]]:
        """Return the surfaces of the objects as triangles in world coordinates, for display.

        Parameters
        ----------
        chord_error : float, optional
            As in `to_pyvista`.
        bounds : array_like, shape (2, 3), optional
            As in `to_pyvista`.

        Returns
        -------
        list of dict
            Argument of ``open3d.visualization.draw``: for each object with triangles, its ``name``, made unique by its
            id in front, and its ``geometry``, an ``open3d.t.geometry.TriangleMesh`` with the triangle attributes
            ``object_id`` and ``label``.

        Raises
        ------
        MissingExtraError
            If Open3D is not installed.
        TypeError, ValueError
            As in `to_pyvista`.
        """
        converted: list[dict[str, Any]] = view(Scene, "open3d")(self, chord_error=chord_error, bounds=bounds)
        return converted

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self._items)

    def __repr__(self) -> str:
        """Return the number of objects of each shape and label, and the bounds."""
        title, rows = self._facts()
        return "\n".join([title, *(f"  {count:>8} {what}" if count else f"  {what}" for count, what in rows)])

    def _repr_html_(self) -> str:
        """Return a small HTML table for notebooks."""
        return html_table(*self._facts())

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        """Return a title with the bounds, and rows of a number of objects and what they are."""
        kinds: dict[str, int] = {}
        for item in self:
            label = item.label if isinstance(item.label, int) else None
            named = "labels by face" if label is None else plain(self._class_names.get(label, f"label {label}"))
            what = f"{type(item.shape).__name__}, {named}"
            kinds[what] = kinds.get(what, 0) + 1
        shown = sorted(kinds.items(), key=lambda kind: -kind[1])[:MOST_LINES]
        rows = [("", str(self._atmosphere))] if self._atmosphere else []
        rows += [(f"{count:,} ×", what) for what, count in shown]
        if len(kinds) > len(shown):
            rows.append((f"{sum(kinds.values()) - sum(count for _, count in shown):,} ×", "others"))
        extent = ""
        box = self.bounds
        if np.isfinite(box).all():
            low, high = (", ".join(f"{round(x, 6) + 0.0:.6g}" for x in corner.tolist()) for corner in box)
            extent = f", bounds ({low}) to ({high}) m"
        return f"Scene: {quantity(len(self), 'object')}{extent}", rows

    def _contents(self) -> dict[str, Any]:
        contents = {
            "class_names": dict(self._class_names),
            "atmosphere": self._atmosphere,
            "objects": self.objects,
            "next": self._next,
        }
        return contents if self._animations is None else contents | {"animations": self._animations}

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Objects are immutable. The hierarchy over them is shared until either scene changes.
        version, kept = self._version, self._kept
        scene = self._from_contents(self._contents())
        if kept is not None and kept.version is version and kept.items == scene.objects:
            scene._version, scene._kept = version, kept
        return scene

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        scene = cls.__new__(cls)
        Scene.__init__(scene)
        scene._class_names = contents["class_names"]
        scene._atmosphere = contents.get("atmosphere")
        scene._items = {item.id: item for item in contents["objects"]}
        scene._next = contents["next"]
        scene._animations = contents.get("animations")
        return scene


_readers: dict[str, tuple[Callable[[Path, bytes], bool], Callable[..., Scene]]] = {}


def _kind_of(path: Path) -> str | None:
    """Return the name of the kind of a file, or None if it is of none."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    return next((kind for kind, (recognise, _) in _readers.items() if recognise(path, head)), None)


def is_scene_file(path: Path) -> bool:
    """Return whether `Scene.from_file` knows the kind of a file."""
    return path.is_file() and _kind_of(path) is not None


def register_scene_reader(name: str, recognise: Callable[[Path, bytes], bool], read: Callable[..., Scene]) -> None:
    """Let `Scene.from_file` read one more kind of file.

    Parameters
    ----------
    name : str
        Name of the kind of file in errors, such as "lidarsim YAML".
    recognise : callable
        ``recognise(path, head)`` returns whether a file is of this kind; `head` is its first 64 KiB.
    read : callable
        ``read(path, **options)`` returns the `Scene`; its keyword arguments are the options of `from_file` that apply.

    Raises
    ------
    TypeError
        If `recognise` or `read` is no such function.
    """
    function("recognise", recognise, "a path and its first bytes", 2)
    function("read", read, "a path", 1)
    _readers[name] = recognise, read


def _label(value: npt.ArrayLike, shape: Shape, own: Label | None) -> Label:
    """Return the label of an object, or a copy of the labels of its faces, after checking them.

    `own` are the labels that the object has so far: if these are the value, only their number is checked.
    """
    if isinstance(value, str):
        expected = f"an integer from 0 to {UINT32}"
        raise ArgumentTypeError(
            "label", expected, short_repr(value), "names of labels are the class_names of the scene"
        )
    if not isinstance(value, (np.ndarray, list, tuple)):
        return integer("label", value, at_least=0, at_most=UINT32)
    given = as_array("label", value, "one integer, or one per face")
    if given.ndim == 0:
        return integer("label", value, at_least=0, at_most=UINT32)
    if not isinstance(shape, TriangleMesh | Spheres | Disks):
        expected = "one integer, or a TriangleMesh, Spheres or Disks for one each"
        raise ArgumentTypeError("label", expected, type(shape).__name__)
    if given.dtype.kind not in "iu" or given.shape != (len(shape),):
        raise ArgumentValueError(
            "label", f"one integer, or {len(shape)}, one {_each(shape)}", f"{given.dtype} of shape {given.shape}"
        )
    if given is own:
        return given
    wrong = (given < 0) | (given > UINT32)
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ArgumentValueError("label", f"integers from 0 to {UINT32}", f"label[{i}] = {given[i]}")
    labels = np.array(given, dtype=np.uint32)
    labels.setflags(write=False)
    return labels


def _each(shape: Shape) -> str:
    return {Spheres: "per sphere", Disks: "per disk"}.get(type(shape), "per face")


def _check_reflectivity(material: Material, shape: Shape) -> None:
    """Raise an error if the texture, or the reflectivities per face or vertex, do not fit the shape."""
    per = material.per
    if isinstance(shape, Spheres | Disks) and per == "face":
        counts = {"face": len(shape)}
    elif isinstance(shape, TriangleMesh):
        counts = {"face": len(shape), "vertex": len(shape.vertices)}
    else:
        shapes = "TriangleMesh, Spheres or Disks" if per == "face" else "TriangleMesh"
        wanted = "texture" if per == "texture" else f"reflectivity per {per}"
        raise ArgumentTypeError("material", f"a {shapes} for a {wanted}", type(shape).__name__)
    if material.texture_coordinates is not None:
        given, per = material.texture_coordinates, "vertex" if material.texture_coordinates.ndim == 2 else "face"
        expected = f"texture coordinates of {counts[per]} {'vertices' if per == 'vertex' else 'faces'}"
    else:
        given = np.asarray(material.reflectivity)
        expected = f"{counts[per]} reflectivities, one {f'per {per}' if per == 'vertex' else _each(shape)}"
    if len(given) != counts[per]:
        raise ArgumentValueError("material", expected, len(given))
