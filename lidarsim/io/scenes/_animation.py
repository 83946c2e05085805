"""Animations, skins and morph targets: where nodes and vertices are at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim._base.vectors import transforms
from lidarsim.errors import FileFormatError

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
"""Numbers of the properties that animations change; the number of weights is that of the morph targets."""


class Sampler(NamedTuple):
    """Values at times, and how to interpolate between them."""

    times: Floats
    """Ascending, s, shape (k,)."""
    values: Floats
    """Shape (k, w), or (k, 3, w) for cubic splines: each with its in-tangent before it and its out-tangent after it."""
    interpolation: str
    """One of LINEAR, STEP and CUBICSPLINE."""
    turns: bool
    """Whether the values are quaternions, between which LINEAR is spherical."""

    def at(self, time: float) -> Floats:
        """Return the value at a time, shape (w,): before the first time the first, after the last the last."""
        cubic = self.interpolation == "CUBICSPLINE"
        key = int(np.searchsorted(self.times, time, side="right")) - 1
        points: Floats = self.values[:, 1] if cubic else self.values
        if key < 0 or key == len(self.times) - 1 or self.interpolation == "STEP":
            found: Floats = points[max(key, 0)]
            return found
        step = self.times[key + 1] - self.times[key]
        u = (time - self.times[key]) / step
        first, second = points[key], points[key + 1]
        if cubic:
            leaving, entering = step * self.values[key, 2], step * self.values[key + 1, 0]
            return np.asarray(
                (2 * u**3 - 3 * u**2 + 1) * first
                + (u**3 - 2 * u**2 + u) * leaving
                + (3 * u**2 - 2 * u**3) * second
                + (u**3 - u**2) * entering
            )
        return _slerp(first, second, u) if self.turns else (1.0 - u) * first + u * second


def _slerp(first: Floats, second: Floats, u: float) -> Floats:
    """Return the quaternion on the shorter arc between two, of any length."""
    a, b = first / np.linalg.norm(first), second / np.linalg.norm(second)
    if a @ b < 0.0:
        b = -b
    angle = 2.0 * np.arctan2(np.linalg.norm(b - a), np.linalg.norm(b + a))
    if angle == 0.0:
        return a
    return np.asarray((np.sin((1.0 - u) * angle) * a + np.sin(u * angle) * b) / np.sin(angle))


class Animation(NamedTuple):
    """What an animation does to each property of each node that it moves."""

    duration: float
    """Its last time, s."""
    channels: Mapping[tuple[int, str], Sampler]
    """Samplers by node and property: "translation", "rotation", "scale" or "weights"."""


class Skin(NamedTuple):
    """Nodes that move vertices, and the maps from the bound mesh to their coordinates."""

    joints: npt.NDArray[np.int64]
    inverse: Floats | None


@dataclass(frozen=True, eq=False)
class Pose:
    """Where everything is at a time."""

    places: Floats
    """Of all nodes, node to scene, shape (n, 4, 4)."""
    skins: Mapping[int, Skin]
    weights: Mapping[int, Floats] = field(default_factory=dict)
    """Of the morph targets of nodes, where an animation changes them."""

    def joints(self, skin: int) -> Floats:
        """Return the maps from the bound mesh of a skin to the scene, one a joint, shape (joints, 4, 4)."""
        joints, inverse = self.skins[skin]
        with np.errstate(over="ignore", invalid="ignore"):
            return self.places[joints] if inverse is None else self.places[joints] @ inverse


@dataclass(frozen=True, eq=False)
class Bend:
    """How the vertices of a primitive follow morph targets and a skin."""

    node: int
    vertices: Floats
    """Shape (n, 3)."""
    weights: tuple[float, ...] = ()
    targets: tuple[Floats | None, ...] = ()
    """Displacements by each morph target, shape (n, 3); None for those that are never used."""
    skin: int | None = None
    joints: npt.NDArray[np.int64] | None = None
    """Joints that move each vertex, shape (n, k)."""
    influence: Floats | None = None
    """Their weights, shape (n, k)."""

    def of(self, used: npt.NDArray[np.bool_]) -> Bend:
        """Return the same for some of the vertices."""
        return Bend(
            self.node,
            self.vertices[used],
            self.weights,
            tuple(None if target is None else target[used] for target in self.targets),
            self.skin,
            None if self.joints is None else self.joints[used],
            None if self.influence is None else self.influence[used],
        )

    def at(self, pose: Pose) -> Floats:
        """Return the vertices in a pose, shape (n, 3); some may overflow."""
        vertices = self.vertices
        with np.errstate(over="ignore", invalid="ignore"):
            weights = pose.weights.get(self.node, self.weights)
            for weight, target in zip(weights, self.targets, strict=True) if self.targets else ():
                if target is not None and weight:
                    vertices = vertices + weight * target
            if self.skin is None or self.joints is None or self.influence is None:
                return vertices
            maps = pose.joints(self.skin)
            homogeneous = np.column_stack((vertices, np.ones(len(vertices))))
            moved = np.zeros((len(vertices), 3))
            for joint, weight in zip(self.joints.T, self.influence.T, strict=True):
                moved += weight[:, None] * np.einsum("nij,nj->ni", maps[joint, :3], homogeneous)
            return moved / total_of(self.influence)[:, None]


def total_of(influence: Floats) -> Floats:
    """Return the sums of the weights of each vertex, set by set of four."""
    total = np.zeros(len(influence))
    for start in range(0, influence.shape[1], 4):
        total += influence[:, start : start + 4].sum(axis=1)
    return total


@dataclass(frozen=True, eq=False)
class Figure:
    """The nodes of a document that animations move."""

    animations: Mapping[str, Animation]
    parents: Sequence[int | None]
    rest: Pose
    local: Mapping[int, tuple[Floats, Floats, Floats] | Floats]
    """By node that moves, each before those below it: translation, rotation and scale, or the matrix, at rest."""
    moving: frozenset[int]
    """The nodes that move with an animation, and those whose morph targets do."""

    def moves(self, node: int, bend: Bend | None) -> bool:
        """Return whether an animation moves a node with a mesh, or the vertices of that."""
        if bend is None:
            return node in self.local
        skinned = bend.skin is not None and any(int(joint) in self.local for joint in self.rest.skins[bend.skin].joints)
        return skinned or (bend.skin is None and node in self.local) or bend.node in self.moving

    def pose(self, animation: str, time: float) -> Pose:
        """Return where everything is at a time of an animation."""
        channels = self.animations[animation].channels
        places = self.rest.places.copy()
        for node, rest in self.local.items():
            if isinstance(rest, tuple):
                translation, rotation, scale = (
                    channels[node, name].at(time) if (node, name) in channels else value
                    for name, value in zip(WIDTHS, rest, strict=True)
                )
                where = f"animation {animation!a}, rotation of nodes[{node}] at {time} s"
                own = local_matrix(translation, rotation, scale, where)
            else:
                own = rest
            parent = self.parents[node]
            with np.errstate(over="ignore", invalid="ignore"):
                places[node] = own if parent is None else places[parent] @ own
        weights = {node: sampler.at(time) for (node, name), sampler in channels.items() if name == "weights"}
        return Pose(places, self.rest.skins, weights)


def local_matrix(translation: Floats, rotation: Floats, scale: Floats, where: str) -> Floats:
    """Return the transform of a node, shape (4, 4)."""
    return transforms(rotations(rotation[None], where)[0] * scale, translation)


def rotations(quaternions: Floats, where: str) -> Floats:
    """Return the matrices of quaternions (x, y, z, w) of any length but zero, shape (n, 3, 3).

    A matrix of quaternions (0, 0, 0, w) is the identity, and the matrices of half turns about an axis are exact.
    """
    largest = np.abs(quaternions).max(axis=1, keepdims=True)
    wrong = np.flatnonzero(largest[:, 0] == 0.0)
    if len(wrong):
        raise FileFormatError(f"{where}: expected quaternions other than zero, got zero at place {wrong[0]}")
    scaled = quaternions / largest
    x, y, z, w = scaled.T
    s = 2.0 / (scaled**2).sum(axis=1)
    rows = [
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
