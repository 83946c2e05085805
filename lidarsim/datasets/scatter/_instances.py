"""Instances to scatter: a shape, several parts, a scene file or a walking person each."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field

from lidarsim import worlds
from lidarsim._base.validation import Floats, short_repr
from lidarsim._base.vectors import nearest_orthogonal, product, transforms, turned_about_y
from lidarsim.config.factories import Scale
from lidarsim.config.objects import SHAPES, AnyObject, GeneratedObject, Object, SceneFile, Surfels
from lidarsim.config.poses import Placement
from lidarsim.datasets.scatter._outlines import bulge_of, turns_of
from lidarsim.datasets.scatter._travel import Travel
from lidarsim.motion.trajectory import Trajectory
from lidarsim.world.scene import Scene
from lidarsim.world.shapes import Shape
from lidarsim.worlds import _walker

if TYPE_CHECKING:
    from lidarsim.config.document import Place

__all__ = ["AnyItem", "Instance", "Part", "PlacedPart", "Swing", "instance_of"]

STRIDE = 4
"""Poses of a limb per step of its body: at the fastest gait, a knee turns by 12° from one to the next."""

ROLL = np.pi / 4
"""Greatest turn of a wheel from one pose to the next."""

MOST_POSES = 1_000_000
"""Greatest number of poses of a part."""


class ModelFile(SceneFile):
    """A scene file as one instance; parts whose names match `wheels` turn."""

    wheels: str | None = None
    """Pattern of the names of parts that turn."""


class Compound(Placement):
    """Several parts as one instance; those whose names match `wheels` turn."""

    shape: Literal["compound"]
    parts: Annotated[list[AnyObject], Field(min_length=1)]
    """Objects with their placements."""
    wheels: str | None = None
    """Pattern of the names of parts that turn."""
    scale: Scale = 1.0
    """Scale of the whole."""


class Walker(Object):
    """A person whose limbs swing at the stride of its speed."""

    shape: Literal["walker"]
    height_m: Annotated[float, Field(ge=0.1, le=10)] = 1.75
    """Height."""


KINDS: dict[str, type[Placement]] = {**SHAPES, "scene_file": ModelFile, "compound": Compound, "walker": Walker}

if TYPE_CHECKING:
    AnyItem = Object | Compound
else:
    AnyItem = Annotated[reduce(or_, KINDS.values()), Discriminator("shape")]


@dataclass(frozen=True)
class Part:
    """A part of an instance.

    Attributes
    ----------
    item : Object
        Its description, with its material.
    shape : Shape
        Its shape.
    affine : ndarray of float64, shape (4, 4)
        From the shape to the axes of the instance or, for a limb, to those of the limb.
    more : dict
        Arguments of `Scene.add` that replace those of the description.
    wheel : bool
        Whether it turns about the y axis through the middle of its bounds.
    """

    item: Object
    shape: Shape
    affine: Floats
    more: dict[str, Any] = field(default_factory=dict)
    wheel: bool = False


@dataclass(frozen=True)
class PlacedPart:
    """A part at its place, which is static or moves."""

    part: Part
    transform: Floats
    motion: Trajectory | None

    def add_to(self, scene: Scene, place: Place, instance: int) -> None:
        """Add the part to a scene."""
        more = {"transform": self.transform, "motion": self.motion, "instance": instance, **self.part.more}
        self.part.item._add(self.part.shape, scene, place, **more)


@dataclass(frozen=True)
class Swing:
    """The motion of parts relative to their instance, and what it takes up.

    Attributes
    ----------
    poses : list of ndarray of float64, shape (m, 4, 4), or None
        Poses of each part relative to the instance at `times`; None if it is fixed.
    times : ndarray of float64, shape (m,)
        Times since the start, s: each step of the instance is divided evenly.
    per_step : int
        Number of these times per step.
    bounds : ndarray of float64, shape (2, 3)
        Bounds of all parts at all of the times, in the axes of the instance, and at its foot those at rest.
    reach : list of tuple of float
        Of each part that moves, the distance of its farthest point from the origin of its poses, and the greatest turn
        from one pose to the next, rad.
    """

    poses: list[Floats | None]
    times: Floats
    per_step: int
    bounds: Floats
    reach: list[tuple[float, float]] = field(default_factory=list)

    def bulge(self, turn: Floats) -> Floats:
        """Return how far a part may be beyond the outline of its instance, whose steps turn by at most `turn`, (m,).

        Between two of its poses a part stays within its own bulge of the segments between their corners (see
        `_outlines`). Both ends of these are in the outline of the instance, which is convex. So the bulges add.
        """
        far, own = np.reshape(self.reach, (-1, 2)).T[..., None]
        most: Floats = bulge_of(far, (own + turn / self.per_step)[..., None]).max(axis=0, initial=0.0)
        return most


@dataclass(frozen=True, eq=False)
class Instance:
    """An instance that may be placed at many places and scales."""

    parts: list[Part]
    walkers: tuple[worlds.Walker, ...] = ()
    """The people among the parts, whose limbs swing."""

    @cached_property
    def along_x(self) -> bool:
        """Whether the axes of the first part tell that the instance heads along x, as those of its box would be.

        If not, an instance that rests has a motion of speed 0, whose frame tells it.
        """
        nearest = nearest_orthogonal(self.parts[0].affine[:3, :3])
        x = nearest[:, 1 if np.abs(nearest[2]).argmax() == 0 else 0]
        return bool(x[0] == np.abs(x).max())

    def swing(self, scale: float, travel: Travel, phase: float, place: Place) -> Swing:
        """Return the motion of the parts as their instance travels.

        Raises
        ------
        ConfigError
            If a person cannot walk so fast, or there are too many poses.
        """
        size = np.diag([scale, scale, scale, 1.0])
        if self.walkers:
            return self._walk(scale, travel, phase, place)
        wheels = {index: _wheel(part, size) for index, part in enumerate(self.parts) if part.wheel and travel.moves}
        least = min((half[2] for _, half in wheels.values()), default=np.inf)
        per_step = max(1, int(np.ceil(np.abs(travel.speeds).max() * travel.step / (ROLL * least))))
        times = _divide(travel.times, per_step, place)
        rest = np.array([_extent(part.shape, product(size, part.affine)) for part in self.parts])
        bounds = np.array([rest[:, 0].min(axis=0), rest[:, 1].max(axis=0)])
        poses: list[Floats | None] = [None] * len(self.parts)
        reach = []
        for index, (middle, half) in wheels.items():
            poses[index] = own = turned_about_y(middle, np.fmod(travel.ahead(times) / half[2], 2 * np.pi))
            reach.append((math.hypot(*half), float(turns_of(own).max())))
            far = np.hypot(half[0], half[2])
            bounds[:, 0] = min(bounds[0, 0], middle[0] - far), max(bounds[1, 0], middle[0] + far)
        return Swing(poses, times, per_step, bounds, reach)

    def _walk(self, scale: float, travel: Travel, phase: float, place: Place) -> Swing:
        size = np.diag([scale, scale, scale, 1.0])
        height = self.walkers[0].height * scale
        hip = _walker.HIP * height
        if not (np.abs(travel.speeds) / hip <= _walker.FASTEST).all():
            fastest, got = _walker.FASTEST * hip, np.abs(travel.speeds).max()
            expected = f"expected at most {fastest:.3g} m/s of a walker {height:.3g} m tall, got {got:.3g}"
            raise (place / "speed_m_per_s").error(expected)
        times = _divide(travel.times, STRIDE, place)
        poses: list[Floats | None] = [None] * len(self.parts)
        for walker in self.walkers:
            limbs = _strides(walker.height * scale, phase, times, travel.speed_ahead(times))
            for limb in limbs:
                limb[:, 1, 3] += walker.left * scale
            poses[walker.first : walker.first + len(limbs)] = limbs
        boxes, reach = [], []
        for part, pose in zip(self.parts, poses, strict=True):
            if pose is None:
                boxes.append(_extent(part.shape, product(size, part.affine))[None])
                continue
            boxes.append(_extents(part.shape, product(pose, size)))
            if len(pose) > 1:
                far = math.hypot(*np.abs(part.shape.bounds).max(axis=0)) * scale
                reach.append((far, float(turns_of(pose).max())))
        ends = np.concatenate(boxes)
        bounds = np.array([ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)])
        return Swing(poses, times, STRIDE, bounds, reach)

    def place(self, scale: float, swing: Swing, body: Floats | Trajectory, start: float) -> tuple[PlacedPart, ...]:
        """Return the parts at the place, or on the way, of the instance; `start` is the time of its first pose, s."""
        size = np.diag([scale, scale, scale, 1.0])
        parts = []
        if not isinstance(body, Trajectory) and not self.along_x:
            body = Trajectory.from_twist(body)
        swinging = [own for own in swing.poses if own is not None]
        motions: Iterator[Trajectory] = iter(())
        if isinstance(body, Trajectory) and swinging:
            times = start + swing.times
            times[[0, -1]] = body.times[[0, -1]]
            motions = iter(Trajectory._through(times, product(body._native.at(times), np.array(swinging))))
        for part, own in zip(self.parts, swing.poses, strict=True):
            sized = product(size, part.affine)
            if isinstance(body, Trajectory):
                if own is not None and part.wheel:
                    sized = product(transforms(np.eye(3), -own[0, :3, 3]), sized)
                parts.append(PlacedPart(part, sized, body if own is None else next(motions)))
            else:
                parts.append(PlacedPart(part, product(body, sized if own is None else product(own[0], sized)), None))
        return tuple(parts)


def _strides(height: float, phase: float, times: Floats, speeds: Floats) -> list[Floats]:
    """Return the poses of a walker's limbs at times; one who is led faster than people walk keeps to the fastest."""
    hip = _walker.HIP * height
    relative = np.clip(speeds / hip, -_walker.FASTEST, _walker.FASTEST)
    rates = _walker.gait_rate(relative)
    cycles = np.concatenate([[0.0], np.cumsum((rates[:-1] + rates[1:]) / 2 * np.diff(times))])
    return _walker.postures(height, phase + cycles, np.abs(relative))


def instance_of(item: AnyItem, place: Place, seed: int = 0) -> Instance:
    """Return an instance with its parts, wheels last, so that its box has the axes of its body.

    `seed` is that of an asset without a seed of its own.

    Raises
    ------
    ConfigError
        If a part has a motion of its own, no part matches `wheels` or all do, or a walker is placed.
    """
    if "instance" in item.model_fields_set:
        raise (place / "instance").error("expected none, since each copy is an instance of its own")
    if isinstance(item, GeneratedObject) and "seed" not in item.model_fields_set:
        item = item.model_copy(update={"seed": seed})
    asset = item.asset(place) if isinstance(item, GeneratedObject) else None
    if (walking := _walkers(item, asset, place)) is not None:
        return walking
    parts = list(_parts(item, place, asset))
    pattern = item.wheels if isinstance(item, ModelFile | Compound) else None
    if not parts:
        raise (place / "file").error("expected a file with objects, got none")
    if pattern is not None:
        parts = [replace(part, wheel=fnmatchcase(_name(part), pattern)) for part in parts]
        if len({part.wheel for part in parts}) == 1:
            names = ", ".join(sorted({short_repr(_name(part)) for part in parts}))
            which = "a part that is no wheel" if parts[0].wheel else f"the name of a part, of {names}"
            there = f" in {short_repr(item.file)}" if isinstance(item, ModelFile) else ""
            raise (place / "wheels").error(f"expected {which}{there}, got {short_repr(pattern)}")
    parts.sort(key=lambda part: part.wheel)
    return Instance(parts)


def _walkers(item: AnyItem, asset: worlds.Asset | None, place: Place) -> Instance | None:
    """Return a walker, or people who can walk; None for other instances."""
    if isinstance(item, Walker):
        parts = [Part(item, shape, np.eye(4)) for _, shape in _walker.limbs(item.height_m)]
        instance = Instance(parts, (worlds.Walker(0, item.height_m),))
    elif isinstance(item, GeneratedObject) and asset is not None and asset.walkers:
        limbs = {walker.first + limb for walker in asset.walkers for limb in range(_walker.LIMBS)}
        instance = Instance(list(_parts_of_asset(item, asset, np.eye(4), limbs)), asset.walkers)
    else:
        return None
    for key in sorted(item.model_fields_set & {"position_m", "rotation_deg", "matrix", "motion", "scale"}):
        hint = "use height_m" if key == "scale" else "it walks upright, ahead"
        raise (place / key).error(f"expected no {key} of a walker: {hint}")
    return instance


def _name(part: Part) -> str:
    name: str = part.more.get("name", part.item.name)
    return name


def _parts(item: AnyItem, place: Place, asset: worlds.Asset | None = None) -> Iterator[Part]:
    """Yield the parts of an instance; `asset` is that of a generator, if it is known."""
    if "motion" in item.model_fields_set:
        raise (place / "motion").error("expected no motion, since the group moves its objects")
    base = item.to_matrix(place, item.scale)
    if isinstance(item, Compound):
        for index, member in enumerate(item.parts):
            if "instance" in member.model_fields_set:
                raise (place / "parts" / index / "instance").error("expected none, since all parts are one instance")
            for part in _parts(member, place / "parts" / index):
                yield replace(part, affine=product(base, part.affine))
    elif isinstance(item, SceneFile):
        yield from _parts_of_file(item, base, place)
    elif isinstance(item, Surfels):
        disks, labels = item._disks(place)
        yield Part(item, disks, base, {} if labels is None else {"label": labels})
    elif isinstance(item, GeneratedObject):
        yield from _parts_of_asset(item, asset or item.asset(place), base)
    else:
        yield Part(item, item.build(place), base)


def _parts_of_file(item: SceneFile, base: Floats, place: Place) -> Iterator[Part]:
    for index, rule in enumerate(item.rules):
        if rule.instance is not None:
            raise (place / "rules" / index / "instance").error("expected none, since the file is one instance")
    for placed in item.load(place).objects:
        more: dict[str, Any] = {"name": f"{item.name}/{placed.name}".lstrip("/"), "material": placed.material}
        if item.label or placed.label is not None:
            more["label"] = item.label if placed.label is None else placed.label
        inner = np.eye(4) if placed.transform is None else placed.transform
        yield Part(item, placed.shape, product(base, inner), more)


def _parts_of_asset(
    item: GeneratedObject, asset: worlds.Asset, base: Floats, limbs: Collection[int] = ()
) -> Iterator[Part]:
    """Yield the parts of an asset, without their poses those of some indices."""
    for index, made in enumerate(asset.parts):
        inner = np.eye(4) if made.transform is None or index in limbs else made.transform
        yield Part(item, made.shape, product(base, inner), item.looks(made), made.name.startswith("wheel"))


def _extents(shape: Shape, affines: Floats) -> Floats:
    """Return the bounds of a shape under affine maps of shape (m, 4, 4): (m, 2, 3)."""
    if shape.transform is not None:
        affines = product(affines, shape.transform)
    linear, shift = affines[:, :3, :3], affines[:, :3, 3]
    low, high = (shape._reach(sign * linear.reshape(-1, 3)).reshape(-1, 3) for sign in (-1.0, 1.0))
    return np.stack([shift - low, shift + high], axis=1)


def _extent(shape: Shape, affine: Floats) -> Floats:
    """Return the bounds of a shape under an affine map, (2, 3)."""
    linear = affine[:3, :3]
    if (linear == np.diag(np.diag(linear))).all():
        return shape._image(affine).bounds()
    return shape._extent(affine[:3])


def _wheel(part: Part, size: Floats) -> tuple[Floats, Floats]:
    """Return the middle of a wheel, and half its size: its radius is half its height."""
    low, high = _extent(part.shape, product(size, part.affine))
    return (low + high) / 2, (high - low) / 2


def _divide(times: Floats, per_step: int, place: Place) -> Floats:
    """Return times with each step divided evenly."""
    if len(times) * per_step > MOST_POSES:
        raise place.error(f"expected at most {MOST_POSES:,} poses of a part in a sequence, got more")
    share = np.arange(per_step) / per_step
    return np.append((times[:-1, None] + np.diff(times)[:, None] * share).reshape(-1), times[-1])
