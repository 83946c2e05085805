"""From what a reader returns to objects: units, axes, rules and colours, for all formats alike."""

from __future__ import annotations

import logging
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidarsim._base.files import reading_as
from lidarsim._base.pickling import Immutable
from lidarsim._base.validation import Floats, placement
from lidarsim._base.vectors import transforms
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes._animation import Bend, Figure
from lidarsim.io.scenes._model import Indices, Node, Part, SceneFile, mean_of_corners
from lidarsim.io.scenes._pictures import Textures
from lidarsim.materials import LUMINANCE, Material
from lidarsim.world.rules import Appearance, Grouping, Options, Rule
from lidarsim.world.scene import Scene
from lidarsim.world.shapes import Shape, TriangleMesh
from lidarsim.world.shapes._polygons import check_faces, triangulate
from lidarsim.world.shapes.triangle_mesh import MeshFile

Reader = Callable[[Path], SceneFile]

UPRIGHT = {
    "x": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""Turns the axis that points up to z; from x up, y to −x and z to −y, as COLLADA defines it."""


class Placed(NamedTuple):
    """An object of a scene file; None where nothing is said."""

    shape: Shape
    name: str
    label: int | None
    material: Material | None
    group: Hashable
    """Objects with the same group are one instance."""
    instance: int | Grouping | None
    """What its rule says of its instance: the number, or how its group is formed."""
    transform: Floats | None
    material_name: str
    """Name of its material in the file."""
    source: Source | None = None
    """What an animation needs to move it."""


class Source(NamedTuple):
    """Where an object that an animation moves comes from."""

    node: int
    copy: Floats
    mesh: TriangleMesh
    """The part in the pose in which the file was read."""
    bend: Bend | None


@dataclass(frozen=True, eq=False)
class Moved(Immutable):
    """The objects of a scene that the animations of its file move."""

    figure: Figure
    upright: Floats
    """From the units and axes of the file to metres and z up, shape (4, 4)."""
    sources: Mapping[int, Source]
    """By the id of the object."""

    @property
    def durations(self) -> dict[str, float]:
        """Last time of each animation, s, by its name."""
        return {name: animation.duration for name, animation in self.figure.animations.items()}

    def at(self, animation: str, time: float) -> Iterator[tuple[int, TriangleMesh, Floats | None]]:
        """Yield the id, the shape and the transform of each object at a time of an animation."""
        pose = self.figure.pose(animation, time)
        for number, (node, copy, mesh, bend) in self.sources.items():
            skinned = bend is not None and bend.skin is not None
            with np.errstate(over="ignore", invalid="ignore"):
                transform = self.upright @ (np.eye(4) if skinned else pose.places[node]) @ copy
            vertices = mesh.vertices if bend is None else bend.at(pose)
            if not (np.isfinite(transform).all() and np.isfinite(vertices).all()):
                where = f"animation {animation!a}, nodes[{node}] at {time} s"
                raise FileFormatError(f"{where}: expected a place within the range of float64")
            shape = mesh if bend is None else mesh.deformed(vertices)
            yield number, *_set_at(shape, transform)


@dataclass(frozen=True, eq=False)
class Imported:
    """What a scene file holds, after the options were applied."""

    path: Path
    objects: list[Placed]
    skipped: int
    """Parts that rules leave out."""
    left_out: list[str]
    """What else was left out, and why."""
    without_rule: list[str]
    """Paths of the nodes that no rule matched, if there are rules."""
    figure: Figure | None = None
    """The nodes that animations move."""
    upright: Floats = field(default_factory=lambda: np.eye(4))
    """From the units and axes of the file to metres and z up, shape (4, 4)."""

    @property
    def bounds(self) -> Floats:
        """Lowest and highest corner of the objects, m, shape (2, 3); nan if there are none."""
        return scene_with(self).bounds

    def instances(self, first: int, instance: int | None = None) -> Iterator[tuple[Placed, int]]:
        """Yield the objects with the numbers of their instances, if the first object has the id `first`.

        `instance` is the number of those of whose instance no rule says anything.
        """
        numbers: dict[Hashable, int] = {}
        for number, item in enumerate(self.objects, first):
            known = numbers.setdefault(item.group, number + 1)
            said = instance if item.instance is None else item.instance
            yield item, said if isinstance(said, int) else known


MOST_REPEATED = 1 << 28
"""Most bytes of meshes that are joined to one again: a few bytes of a file can place a mesh many times."""
IDENTITY = np.eye(4)
UNTOUCHED = Rule()
"""What applies to a part that no rule matches."""


def import_file(path: Path, read: Reader, options: Options) -> Imported:
    """Return what a file holds: at least one object, unless rules leave all out."""
    with reading_as(path, "a scene"):
        result = _build(path, read(path), options)
    report(path, result.left_out)
    return result


def report(path: Path, left_out: list[str]) -> None:
    """Log what of a file was left out."""
    if left_out:
        logging.getLogger("lidarsim").warning("%s: left out: %s", path, ", ".join(left_out))


def scene_with(found: Imported) -> Scene:
    """Return a scene of the objects of a file."""
    scene = Scene()
    for item, instance in found.instances(0):
        scene.add(
            item.shape,
            name=item.name,
            label=item.label or 0,
            instance=instance,
            material=item.material,
            transform=item.transform,
        )
    if found.figure is not None:
        sources = {number: item.source for number, item in enumerate(found.objects) if item.source is not None}
        scene._animations = Moved(found.figure, found.upright, sources)
    return scene


def mesh_of(read: Reader, path: Path) -> MeshFile:
    """Return all that a file holds as one mesh, in metres and z up."""
    file = read(path)
    report(path, file.left_out)
    vertices, corners = [np.empty((0, 3))], [np.empty(0, np.int64)]
    count = repeated = 0
    seen: set[Part] = set()
    for node in file.nodes:
        transform = _upright(file, Options()) @ node.transform
        for part in node.parts:
            repeated += (part.vertices.nbytes + part.corners.nbytes) * (part in seen)
            if repeated > MOST_REPEATED:
                most = f"at most {MOST_REPEATED:,} bytes of meshes that are placed again"
                raise FileFormatError(f"expected {most} in one mesh, got more; read it as a scene")
            seen.add(part)
            faces = triangulate(part.vertices, part.corners, part.sizes)[0]
            if np.linalg.det(transform[:3, :3]) < 0:  # a reflection, which would turn the surface inside out
                faces = faces[:, ::-1]
            vertices.append(_move(part.vertices, transform))
            corners.append(faces.ravel() + count)
            count += len(part.vertices)
    joined = np.concatenate(corners)
    return MeshFile(np.concatenate(vertices), joined, np.full(len(joined) // 3, 3))


def _upright(file: SceneFile, options: Options) -> Floats:
    """Return the map from the units and axes of a file to metres and z up, shape (4, 4)."""
    unit = file.unit if options.unit is None else options.unit
    return transforms(UPRIGHT[options.up or file.up] * unit, 0.0)


def _move(points: Floats, transform: Floats) -> Floats:
    """Return points at their place; they are not changed at all by the identity."""
    if np.array_equal(transform, IDENTITY):
        return points
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused as not finite
        return points @ transform[:3, :3].T + transform[:3, 3]


def _build(path: Path, file: SceneFile, options: Options) -> Imported:
    """Return the objects of a file."""
    upright = _upright(file, options)
    meshes = _Meshes()
    objects: list[Placed] = []
    without_rule: list[str] = []
    skipped = flat = 0
    for node in file.nodes:
        matched = False
        with np.errstate(over="ignore", invalid="ignore"):
            transform = upright @ node.transform
        path_of_node = node.names.path if options.rules else ""
        for part in node.parts:
            found = next((rule for rule in options.rules if rule.matches(path_of_node, part.material)), None)
            matched = matched or found is not None
            rule = found or UNTOUCHED
            if rule.skip:
                skipped += 1
                continue
            if not len(meshes.cuts(part)):
                continue
            shape, place = _set_at(meshes.mesh(part), transform)
            source = None
            if file.figure is not None and file.figure.moves(node.key[0], part.bend):
                source = Source(node.key[0], node.copy, meshes.mesh(part), part.bend)
            flattened = place is None and not np.array_equal(transform, IDENTITY)
            if flattened and source is None and shape.degenerate_count == len(shape):
                flat += 1
                continue
            appearance = options.reflectivity if rule.reflectivity is None else rule.reflectivity
            objects.append(
                Placed(
                    shape,
                    node.names.name if rule.name is None else rule.name,
                    rule.label,
                    meshes.material(part, appearance),
                    _group(node, rule),
                    rule.instance,
                    place,
                    part.material,
                    source,
                )
            )
        if options.rules and not matched:
            without_rule.append(path_of_node)
    left_out = [*file.left_out, *([f"objects scaled to nothing ({flat:,})"] if flat else [])]
    if not objects and not skipped:
        raise FileFormatError("it holds no triangles" + f"; left out: {', '.join(left_out)}" * bool(left_out))
    return Imported(path, objects, skipped, left_out, without_rule, file.figure, upright)


def _set_at(mesh: TriangleMesh, transform: Floats) -> tuple[TriangleMesh, Floats | None]:
    """Return a mesh and its transform; a singular one flattens the vertices themselves."""
    if np.array_equal(transform, IDENTITY):
        return mesh, None
    try:
        mesh._native.transformed(placement(transform))
    except ValueError:
        return TriangleMesh(_move(mesh.vertices, transform), mesh.faces), None
    return mesh, transform


class _Meshes:
    """The meshes of parts, which all nodes that place a part share, and their textures."""

    def __init__(self) -> None:
        self._cuts: dict[Part, Indices] = {}
        self._shapes: dict[Part, TriangleMesh] = {}
        self._colored: dict[Part, Material] = {}
        self._textures = Textures()

    def cuts(self, part: Part) -> Indices:
        """Return the triangles of a part by the numbers of their corners in it, shape (m, 3)."""
        if part not in self._cuts:
            check_faces(part.vertices, part.corners, part.sizes)
            cuts = np.arange(len(part.corners))
            if (part.sizes == 3).all():
                self._cuts[part] = cuts.reshape(-1, 3)
            else:
                self._cuts[part] = triangulate(part.vertices[part.corners], cuts, part.sizes)[0]
        return self._cuts[part]

    def mesh(self, part: Part) -> TriangleMesh:
        """Return the mesh of a part."""
        if part not in self._shapes:
            self._shapes[part] = TriangleMesh(part.vertices, part.corners[self.cuts(part)])
        return self._shapes[part]

    def material(self, part: Part, appearance: Appearance) -> Material | None:
        """Return the material of a part."""
        if appearance is None or isinstance(appearance, Material):
            return appearance
        if appearance != "color":
            return Material(reflectivity=appearance)
        if part not in self._colored:
            self._colored[part] = self._from_colors(part)
        return self._colored[part]

    def _from_colors(self, part: Part) -> Material:
        """Return the material whose reflectivity is the luminance of a part's base colours.

        A texture on a part whose vertices differ in colour is sampled at the vertices.
        """
        paint = part.paint()
        color, colors = np.clip(paint.color, 0.0, 1.0), paint.colors
        if colors is not None and len(colors) and (colors == colors[0]).all():
            color, colors = color * np.clip(colors[0], 0.0, 1.0), None
        if paint.picture is None or paint.uv is None:
            if colors is None:
                return Material(reflectivity=float(color @ LUMINANCE))
            return Material(reflectivity=np.clip(color * colors, 0.0, 1.0) @ LUMINANCE, per="vertex")
        if colors is not None:
            texels = self._textures.sample(paint.picture, mean_of_corners(part.corners, paint.uv))
            return Material(reflectivity=np.clip(color * colors * texels, 0.0, 1.0) @ LUMINANCE, per="vertex")
        texture = self._textures.texture(paint.picture, color)
        return Material(reflectivity=texture, texture_coordinates=paint.uv[self.cuts(part)])


def _group(node: Node, rule: Rule) -> Hashable:
    """Return what the objects of one instance have in common."""
    match rule.instance:
        case "node":
            return "node", node.key
        case "parent":
            return "parent", node.parent
        case "file":
            return "file"
        case _:
            return "top", node.top
