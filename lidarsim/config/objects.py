"""Models of scenes and their objects."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from functools import lru_cache, partial, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_type_hints

import numpy as np
from pydantic import Discriminator, Field, create_model

from lidarsim import worlds
from lidarsim._base.files import load_array
from lidarsim._base.shown import format_size, plain
from lidarsim._base.validation import ask
from lidarsim._base.vectors import product
from lidarsim.config.factories import (
    FloatOrText,
    Grouping,
    Model,
    Numbers,
    NumbersOrColor,
    Pair,
    Part,
    Row,
    Scale,
    Vector,
    construct,
    either,
    models_of,
    public,
)
from lidarsim.config.poses import PLACING, Motion, Placement, Twist, build_motion, build_pose, build_rigid
from lidarsim.config.units import argument_of
from lidarsim.io import raster, scenes
from lidarsim.materials import Material, named
from lidarsim.motion.trajectory import Trajectory
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.world import shapes
from lidarsim.world.rules import Options, Rule

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from lidarsim._base.validation import Floats
    from lidarsim.config.document import Place
    from lidarsim.world.scene import Scene
    from lidarsim.world.shapes import Shape


_LOOKS = (
    "reflectivity", "roughness_deg", "specular", "specular_width", "transmission", "mirror", "variation", "grain_m"
)  # fmt: skip
"""The keys of a material."""


class Object(Part, Placement):
    """An object of the scene: a shape with its placement and material."""

    name: str = ""
    """Name."""
    label: int = 0
    """Class of its points."""
    instance: int | None = None
    """Objects of one number have one box; 0: none in data sets. Default: the id + 1; choose numbers above all ids."""
    material: str | None = None
    """One of the [library](#materials); the keys below override its values."""
    reflectivity: Numbers = 1.0
    """What the surface returns as a share of a white diffuser."""
    reflectivity_per: Literal["object", "face", "vertex"] = "object"
    """`face`, `vertex`: the reflectivity is a list with one value each."""
    roughness_deg: float = 0.0
    specular: float = 0.0
    specular_width: float = 0.1
    transmission: float = 0.0
    mirror: float = 0.0
    variation: float = 0.0
    grain_m: float = 0.05
    scale: Scale = 1.0
    """Scale, applied before the placement: one number, or one per axis."""
    motion: Motion | None = None
    """How it moves: a velocity, a list of [waypoints](#waypoint) or a file of [poses](#poses)."""

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the object to `scene`."""
        self._add(self.build(place), scene, place)

    def _add(self, shape: Shape, scene: Scene, place: Place, inner: Floats | None = None, **more: object) -> None:
        material = more.pop("material", None) or self._material(place)
        transform, motion = self._place(place)
        if inner is not None:
            transform = inner if transform is None else product(transform, inner)
        more = {"transform": transform, "motion": motion, "shape": shape, "material": material, **more}
        construct(scene.add, self, ["name", "label", "instance"], place, **more)

    def _material(self, place: Place) -> Material:
        """Return the material, whose own keys override those of the library's."""
        base = Material()
        if self.material is not None:
            with place.refusals({"name": ("material", "")}):
                base = named(self.material)
        differ = partial(Material, **{argument_of(key): getattr(base, argument_of(key)) for key in _LOOKS})
        return construct(differ, self, _LOOKS, place, per=self.reflectivity_per)

    def _place(self, place: Place) -> tuple[Floats | None, Trajectory | None]:
        """Return the transform and the motion that follows it."""
        placed = self.model_fields_set & {"position_m", "rotation_deg", "scale", "matrix"}
        transform = self.to_matrix(place, self.scale) if placed else None
        if self.motion is None:
            return transform, None
        if isinstance(self.motion, Twist):
            # The motion starts at the placement, in its axes, so only the scale precedes it.
            start = build_rigid(Placement(**{key: getattr(self, key) for key in placed - {"scale"}}), place)
            motion = build_motion(start, self.motion, place / "motion")
            if isinstance(motion, Trajectory):
                transform = np.diag([*np.broadcast_to(self.scale, 3), 1.0]) if "scale" in placed else None
        else:
            motion = build_pose(self.motion, place / "motion")
        return transform, motion if isinstance(motion, Trajectory) else None


class Plane(Object):
    """The plane of points p with normal·p = distance, or through a point."""

    constructor = shapes.Plane

    shape: Literal["plane"]
    normal: Vector
    distance_m: float = 0.0
    """Distance from the origin, times the length of the normal."""
    point_m: Vector | None = None
    """A point of the plane, instead of `distance_m`."""

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        if self.point_m is None:
            return construct(shapes.Plane, self, ["normal"], place, distance=self.distance_m)
        if "distance_m" in self.model_fields_set:
            raise (place / "distance_m").error("expected either distance_m or point_m, got both")
        return construct(shapes.Plane.from_point, self, ["point_m", "normal"], place)


class Mesh(Object):
    """A triangle mesh from a file."""

    constructor = shapes.TriangleMesh

    shape: Literal["mesh"]
    file: str
    """PLY, STL, OBJ, OFF, GLB and more; objects with the same file share it."""

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the object to `scene`."""
        super().add_to(scene, place)
        ask_size(self, place)

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        return (place / "file").load(self.file, shapes.TriangleMesh.from_file)

    def bounds(self, place: Place) -> Floats:
        """Return the bounds before it is placed, m, shape (2, 3)."""
        return self.build(place).bounds


class Heightfield(Object):
    """Terrain from a NumPy file of heights, m: columns along x, rows along y."""

    constructor = shapes.TriangleMesh.from_heightfield

    shape: Literal["heightfield"]
    file: str
    """NPY of heights, m; NaN where there is a hole."""
    spacing_m: Numbers
    origin_m: Pair = [0.0, 0.0]

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        heights = (place / "file").load(self.file, load_array)
        return construct(shapes.TriangleMesh.from_heightfield, self, ["spacing_m", "origin_m"], place, z=heights)


class Raster(Object):
    """Terrain from a digital elevation model, a GeoTIFF or an Esri ASCII grid, at its coordinates."""

    constructor = shapes.TriangleMesh.from_raster

    shape: Literal["raster"]
    file: str
    """GeoTIFF or Esri ASCII grid, in m. Needs `[geo]`."""
    band: int = 1
    window_m: Row | None = None
    stride: int = 1

    def build(self, place: Place) -> shapes.TriangleMesh:
        """Return the shape."""

        def read(path: Path) -> shapes.TriangleMesh:
            return construct(shapes.TriangleMesh.from_raster, self, ["band", "window_m", "stride"], place, path=path)

        key = "raster", self.band, tuple(self.window_m or ()), self.stride
        return (place / "file").load(self.file, read, key)

    def _add(self, shape: Shape, scene: Scene, place: Place, inner: Floats | None = None, **more: object) -> None:
        crs = getattr(shape, "crs", None)
        for item in scene:
            other = getattr(item.shape, "crs", None)
            if crs and other and not raster.same_crs(crs, other):
                expected = f"expected a raster in {plain(other, most=60)}, as object {item.id} is"
                raise (place / "file").error(f"{expected}, got one in {plain(crs, most=60)}")
        super()._add(shape, scene, place, inner, **more)


class SceneRule(Part):
    """A rule for the parts of a scene file."""

    constructor = Rule

    node: str = "*"
    material: str = "*"
    label: int | None = None
    reflectivity: FloatOrText | None = None
    instance: Grouping = None
    name: str | None = None
    skip: bool = False
    """Leave the parts out."""

    def build(self, place: Place) -> Rule:
        """Return the rule."""
        keys = set(type(self).model_fields)
        if not isinstance(self.reflectivity, str) or self.reflectivity == "color":
            return construct(Rule, self, keys, place)
        with place.refusals({"name": ("reflectivity", "")}):
            material = named(self.reflectivity)
        return construct(Rule, self, keys - {"reflectivity"}, place, reflectivity=material)


class Surfels(Object):
    """Disks at the points of a cloud, with the labels that it has unless `label` is given."""

    constructor = shapes.Disks.from_points

    shape: Literal["surfels"]
    file: str
    """A point cloud of any [format](../lidarsim/io/README.md)."""
    neighbours: int = 16
    radius_m: float | None = None
    """Radius of the disks. Default: as large as the gaps between points."""

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the disks to `scene`."""
        disks, labels = self._disks(place)
        if labels is None:
            self._add(disks, scene, place)
        else:
            self._add(disks, scene, place, label=labels)

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        return self._disks(place)[0]

    def _disks(self, place: Place) -> tuple[shapes.Disks, npt.NDArray[np.uint32] | None]:
        cloud = (place / "file").load(self.file, PointCloud.load)
        with place.refusals({"points": ("file", ""), "neighbours": ("neighbours", ""), "radii": ("radius_m", "")}):
            disks, index = shapes.Disks.from_points(
                cloud.xyz, radii=self.radius_m, neighbours=self.neighbours, return_index=True
            )
        has_labels = "label" in cloud.fields and "label" not in self.model_fields_set
        return disks, cloud.label[index] if has_labels else None


class SceneFile(Object):
    """The objects of a scene file such as GLB."""

    constructor = shapes.TriangleMesh

    shape: Literal["scene_file"]
    file: str
    """GLB, glTF, DAE or a mesh; MJCF or URDF (`[mujoco]`)."""
    up: Literal["y", "z"] | None = None
    """The axis that is up. Default: as the format or the file declares."""
    unit_m: float | None = None
    """Unit of the file. Default: likewise."""
    rules: list[SceneRule] = []
    """Labels, materials and instances of the parts; the first rule that matches a part decides."""
    reflectivity: NumbersOrColor = 1.0  # type: ignore[assignment]
    """`color`: base colours become reflectivities, a guess at the infrared."""

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the objects to `scene`, named after their nodes; what a rule says of them replaces what is said here."""
        for item, instance in self.load(place).instances(len(scene), self.instance):
            more: dict[str, Any] = {"name": f"{self.name}/{item.name}".lstrip("/"), "instance": instance}
            if item.label is not None:
                more["label"] = item.label
            self._add(item.shape, scene, place, inner=item.transform, material=item.material, **more)
        ask_size(self, place)

    def bounds(self, place: Place) -> Floats:
        """Return the bounds before it is placed, m, shape (2, 3)."""
        return self.load(place).bounds

    def load(self, place: Place) -> scenes.Imported:
        """Return what the file holds."""
        others = [key for key in ("material", *_LOOKS[1:]) if key in self.model_fields_set]
        if self.reflectivity == "color" and others:
            raise (place / "reflectivity").error(f"expected a number beside {others[0]}, got color")
        rules = [rule.build(place / "rules" / index) for index, rule in enumerate(self.rules)]
        with place.refusals({"unit": ("unit_m", "")}):
            options = Options.from_arguments(
                self.up, self.unit_m, rules, "color" if self.reflectivity == "color" else None
            )
        return (place / "file").load(self.file, lambda path: scenes.objects_of(path, options), options)


LONGEST, TALLEST, SHORTEST = 20e3, 1e3, 0.1
"""Sizes of models, m: only those with another unit are longer, or larger in all directions, or shorter."""


def size_of(item: Mesh | SceneFile, place: Place) -> Floats:
    """Return the size of a model from a file, scaled, m, shape (3,)."""
    size: Floats = np.ptp(item.bounds(place), axis=0)
    size *= np.linalg.norm(item.to_matrix(place, item.scale)[:3, :3], axis=0)
    return size


def ask_size(item: Mesh | SceneFile, place: Place, scale: float = 1.0) -> None:
    """Ask if a model from a file is so large or so small that its unit is probably another one."""
    size = size_of(item, place) * scale
    if size.max() > LONGEST or size.min() > TALLEST or size.max() < SHORTEST:
        question = "mm?" if size.max() > SHORTEST else "is it in m?"
        ask(plain(item.file, most=60), f"{format_size(size)} m", question)


class GeneratedObject(Object):
    """An asset that a generator of `lidarsim.worlds` makes of a seed and its own keys, as one instance."""

    generator: ClassVar[Callable[..., worlds.Asset]]

    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the shape."""

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the parts to `scene`."""
        instance = len(scene) + 1 if self.instance is None else self.instance
        for part in self.asset(place).parts:
            self._add(part.shape, scene, place, inner=part.transform, instance=instance, **self.looks(part))

    def asset(self, place: Place) -> worlds.Asset:
        """Return the asset of its seed."""
        for key in Object.model_fields.keys() - {"name", "label", "instance", "motion", *PLACING, "scale"}:
            if key in self.model_fields_set:
                raise (place / key).error("expected none, since its parts have materials of their own")
        rng = np.random.default_rng(self.seed)
        keys = type(self).model_fields.keys() - GeneratedObject.model_fields.keys() - {"shape", "kind"}
        kind = {"kind": self.kind} if "kind" in type(self).model_fields else {}  # type: ignore[attr-defined]
        return construct(partial(type(self).generator, rng=rng), self, keys, place, **kind)

    def looks(self, part: worlds.Part) -> dict[str, Any]:
        """Return the arguments of `Scene.add` that are those of a part."""
        label = self.label if "label" in self.model_fields_set else part.label
        return {"name": f"{self.name}/{part.name}".lstrip("/"), "label": label, "material": part.material}


def _declare_generated(name: str, generator: Callable[..., worlds.Asset]) -> type[GeneratedObject]:
    """Return the model of a generator, whose keys are its arguments; those that are lengths end in _m."""
    fields: dict[str, Any] = {"shape": (Literal[name], ...)}
    types = get_type_hints(generator)
    for argument, parameter in inspect.signature(generator).parameters.items():
        if argument != "rng":
            is_length = types[argument] in {float, float | None}
            default = ... if parameter.default is inspect.Parameter.empty else parameter.default
            fields[f"{argument}_m" if is_length else argument] = (types[argument], default)
    model = create_model(name.capitalize(), __base__=GeneratedObject, **fields)
    model.generator = generator
    return model


SHAPES: dict[str, type[Object]] = {
    "plane": Plane,
    "mesh": Mesh,
    "heightfield": Heightfield,
    "raster": Raster,
    "surfels": Surfels,
    "scene_file": SceneFile,
    **{name: _declare_generated(name, getattr(worlds, name)) for name in worlds.GENERATORS},
    **models_of(public(shapes), "shape", Object),
}


if TYPE_CHECKING:
    AnyObject = Object
else:
    AnyObject = Annotated[reduce(or_, SHAPES.values()), Discriminator("shape")]


class StreetKeys(Model):
    """A street, as of `lidarsim.worlds.street`."""

    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    kind: str = "residential"
    length_m: float = 300.0

    def build(self, place: Place) -> worlds.Street:
        """Return a copy of the street, which is made once."""
        with place.refusals({"length": ("length_m", ""), "kind": ("kind", "")}):
            made = _street(self.seed, self.kind, self.length_m)
        return worlds.Street(copy.copy(made.scene), made.ways)


@lru_cache(maxsize=2)
def _street(seed: int, kind: Any, length: float) -> worlds.Street:
    return worlds.street(seed, kind, length=length)


class World(Model):
    """A street, objects that are added to it, and others in the axes of the sensor, which move along with it."""

    street: StreetKeys
    """The street."""
    objects: list[AnyObject] = []
    """Objects that are added to it."""
    vehicle: list[AnyObject] = []
    """Objects in the axes of the sensor, which move along with it, as a mast that hides what is behind it."""


if TYPE_CHECKING:
    AnyScene = list[AnyObject] | World
else:
    AnyScene = either(list[AnyObject], World, lambda value: isinstance(value, dict))
