"""People: figures of limbs in a posture, with what they carry or push."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from lidarsim import materials
from lidarsim._base.validation import Floats, one_of, real
from lidarsim._base.vectors import matvec, product
from lidarsim.materials import Material
from lidarsim.world.shapes import Capsule, Ellipsoid, Shape, TriangleMesh
from lidarsim.worlds import _walker
from lidarsim.worlds._asset import (
    Asset,
    Part,
    Piece,
    Walker,
    along,
    box,
    check_generator,
    lathe,
    loft,
    merge,
    move,
    translation,
    tube,
)
from lidarsim.worlds._labels import PERSON

__all__ = ["LOADS", "POSTURES", "Load", "Posture", "pedestrian", "person"]

Posture = Literal["walking", "standing", "sitting"]
Load = Literal["nothing", "bag", "rucksack", "pram", "umbrella", "child"]
POSTURES: tuple[Posture, ...] = get_args(Posture)
LOADS: tuple[Load, ...] = get_args(Load)

HEIGHTS = ((1.77, 0.075), (1.64, 0.07))
"""Mean and standard deviation of the heights of men and women, m. NCD Risk Factor Collaboration, 2016, A century of
trends in adult human height, eLife 5, e13410, has means of 1.71 to 1.83 m and 1.60 to 1.69 m in Europe; deviations are
those of most national surveys."""

ARMS = {5, 6, 10, 11}
"""Upper arms and forearms among the limbs."""

PUSHING: dict[str, Any] = {"shoulder": (40.0, 40.0), "elbow": (35.0, 35.0)}
"""Flexion of the arms of someone who pushes a pram, degrees, as in `_walker.figure`."""

SHIRTS = (materials.CLOTH, materials.CLOTH_DARK, materials.CLOTH_LIGHT)
TROUSERS = (materials.CLOTH, materials.CLOTH_DARK)


def pedestrian(
    rng: np.random.Generator,
    *,
    posture: Posture | None = None,
    load: Load | None = None,
    height: float | None = None,
) -> Asset:
    """Make a person who faces x, the hips above the origin.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws what is not given, build and clothes.
    posture : {"walking", "standing", "sitting"}, optional
        The posture; the phase of a step is drawn. Someone who sits does so at the height of a chair.
    load : {"nothing", "bag", "rucksack", "pram", "umbrella", "child"}, optional
        What the person carries, pushes or leads; only the first three of someone who sits.
    height : float, optional
        Height of the person, 0.5 to 2.5 m. Default: drawn for an adult.

    Returns
    -------
    Asset
        One part a limb, and the load. All of them are of the class person.

    Raises
    ------
    TypeError, ValueError
        If `rng` is no generator, the posture or the load is unknown, someone is to sit with something to push, lead or
        hold up, or the height is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> ls.worlds.pedestrian(np.random.default_rng(3), posture="standing", load="umbrella", height=1.8)
    Asset(13 parts, 1.18 × 1.12 × 2.04 m)
    """
    check_generator(rng)
    if posture is None:
        posture = POSTURES[rng.choice(3, p=(0.7, 0.25, 0.05))]
    one_of("posture", posture, POSTURES)
    seated = posture == "sitting"
    if load is None:
        load = LOADS[rng.choice(3, p=(0.6, 0.2, 0.2)) if seated else rng.choice(6, p=(0.4, 0.2, 0.2, 0.06, 0.06, 0.08))]
    one_of("load", load, LOADS[:3] if seated else LOADS)
    if height is None:
        mean, sigma = HEIGHTS[rng.integers(2)]
        height = float(np.clip(rng.normal(mean, sigma), mean - 3 * sigma, mean + 3 * sigma))
    height = real("height", height, at_least=0.5, at_most=2.5)
    parts = _figure(rng, height, posture, pushes=load == "pram", holds=load == "umbrella")
    walkers = [Walker(0, height)]
    if load == "child":
        small = float(rng.uniform(0.95, 1.3))
        walkers.append(Walker(len(parts), small, left=0.45))
        parts += [_shift(part, (0.0, 0.45, 0.0)) for part in _figure(rng, small, posture)]
    parts += [replace(part, label=PERSON) for part in merge(load, _load(load, height, seated=seated))]
    return Asset(tuple(parts), () if seated else tuple(walkers))


def _figure(
    rng: np.random.Generator, height: float, posture: Posture, *, pushes: bool = False, holds: bool = False
) -> list[Part]:
    """Return the limbs of a person in a posture, with the lower foot on the ground."""
    arms: dict[str, Any] = {}
    if pushes:
        arms = PUSHING
    elif holds:
        arms = {"shoulder": (5.0, 30.0), "elbow": (10.0, 110.0)}
    if posture == "walking":
        phase, speed = rng.random(), rng.uniform(0.9, 1.5) / (_walker.HIP * height)
        poses = [pose[-1] for pose in _walker.postures(height, np.array([phase]), np.array([speed]))]
        if arms:
            still = _walker.figure(height, hip=(0, 0), knee=(0, 0), **arms)
            poses = [product(poses[0], still[k]) if k in ARMS else pose for k, pose in enumerate(poses)]
        return _dress(rng, height, poses)
    bent: dict[str, Any]
    if posture == "sitting":
        hips = 0.285 * height
        bent = {"hip": (88, 88), "knee": (88, 88), "shoulder": (25, 25), "elbow": (60, 60), "lean": -5.0}
    else:
        hips = _walker.HIP * height
        arms = arms or {"shoulder": tuple(rng.uniform(-5, 20, 2)), "elbow": tuple(rng.uniform(5, 70, 2))}
        bent = {"hip": (3, -3), "knee": (2, 4), "ankle": (-3, 3), **arms}
    parts = person(rng, height, (0.0, 0.0, hips), **bent)
    low = float(Asset(tuple(parts)).bounds[0, 2])
    return [_shift(part, (0.0, 0.0, -low)) for part in parts]


def person(
    rng: np.random.Generator,
    height: float,
    hips: tuple[float, float, float],
    label: int = PERSON,
    *,
    helmet: bool = False,
    **flexion: Any,
) -> list[Part]:
    """Return the limbs of a person with the hips at a place, bent by `_walker.figure`."""
    shift = translation(*hips)
    poses = [product(shift, pose) for pose in _walker.figure(height, **flexion)]
    return _dress(rng, height, poses, label, helmet=helmet)


def _dress(
    rng: np.random.Generator, height: float, poses: list[Floats], label: int = PERSON, *, helmet: bool = False
) -> list[Part]:
    """Return the limbs at their poses, in clothes, and thicker or thinner than most."""
    girth = float(np.clip(rng.normal(1.1, 0.12), 0.85, 1.5))
    shirt, trousers = SHIRTS[rng.integers(3)], TROUSERS[rng.integers(2)]
    parts = []
    for (name, limb), pose in zip(_walker.limbs(height), poses, strict=True):
        shape: Shape = limb
        material = trousers if name.endswith(("thigh", "shank", "foot")) else shirt
        if isinstance(limb, Ellipsoid) and name == "head":
            material = materials.PAINTED_METAL if helmet else materials.SKIN
            shape = Ellipsoid(limb.center, np.multiply(limb.radii, 1.25)) if helmet else limb
        elif name == "torso":
            shape = _torso(height, girth)
        elif isinstance(limb, Capsule) and not name.endswith("foot"):
            shape = Capsule(limb.start, limb.end, limb.radius * girth)
        parts.append(Part(name, shape, label, material, pose))
    return parts


TRUNK = (
    (-0.035, 0.05, 0.07),
    (0.0, 0.07, 0.092),
    (0.09, 0.062, 0.085),
    (0.2, 0.07, 0.105),
    (0.265, 0.06, 0.125),
    (0.295, 0.045, 0.09),
    (0.31, 0.033, 0.036),
    (0.36, 0.031, 0.033),
)
"""Cross-sections of torso and neck, as shares of a person's height: height above the hips, half the depth, half the
width."""


def _torso(height: float, girth: float) -> TriangleMesh:
    angle = 2 * np.pi * np.arange(14) / 14
    rings = np.array(
        [np.column_stack([depth * np.cos(angle), width * np.sin(angle), np.full(14, z)]) for z, depth, width in TRUNK]
    )
    stout = 1 + (girth - 1) * np.interp(rings[..., 2:], [0.25, 0.31], [1, 0])
    piece = loft(rings * np.concatenate([stout, stout, np.ones_like(stout)], axis=-1) * height)
    return TriangleMesh(piece.vertices, piece.faces)


def _shift(part: Part, shift: tuple[float, float, float]) -> Part:
    place = np.eye(4) if part.transform is None else part.transform.copy()
    place[:3, 3] += shift
    return Part(part.name, part.shape, part.label, part.material, place)


def _load(load: Load, height: float, *, seated: bool) -> list[Piece]:
    hips = 0.29 * height if seated else _walker.HIP * height
    if load == "bag":
        return [
            box(
                (0.3, 0.1, 0.32),
                (0.02, -0.165 * height, 0.16 if seated else 0.55 * hips),
                material=materials.CLOTH_DARK,
            )
        ]
    if load == "rucksack":
        return [_make_rounded((0.2, 0.3, 0.48), (-0.2, 0, hips + 0.17 * height), materials.CLOTH)]
    if load == "umbrella":
        top = 1.12 * height
        outside = [(0.54, -0.22), (0.45, -0.11), (0.25, -0.02), (0.02, 0.02)]
        profile = [(radius, z - 0.02) for radius, z in outside[::-1]][:-1] + outside
        canopy = lathe([(radius, top + z) for radius, z in profile], 16, material=materials.CLOTH)
        hand = (0.26 * height, -0.15 * height, 0.0)
        stick = tube([(*hand[:2], 0.62 * height), (*hand[:2], top + 0.01)], 0.01, 6, material=materials.PAINTED_METAL)
        return [replace(canopy, vertices=move(canopy.vertices, hand)), stick]
    if load == "pram":
        x = 0.3 * height + 0.45
        body = _make_rounded((0.75, 0.4, 0.3), (x, 0, 0.62), materials.CLOTH)
        hood = _make_rounded((0.35, 0.42, 0.3), (x + 0.2, 0, 0.85), materials.CLOTH_DARK)
        limbs = _walker.figure(height, hip=(0, 0), knee=(0, 0), **PUSHING)
        left, right = (matvec(limbs[arm], np.array([0, 0, -_walker.FOREARM * height, 1])) for arm in (6, 11))
        hands = [(*hand[:2], hips + hand[2]) for hand in (left, right)]
        bars = [
            tube(ends, 0.015, 6, material=materials.PAINTED_METAL)
            for ends in (hands, [(x - 0.2, 0.2, 0.5), hands[0]], [(x - 0.2, -0.2, 0.5), hands[1]])
        ]
        wheels = []
        for ahead in (0.28, -0.28):
            for side in (0.26, -0.26):
                disc = lathe([(0.14, -0.02), (0.14, 0.02)], 12, material=materials.RUBBER)
                wheels.append(replace(disc, vertices=move(along("y", disc.vertices), (x + ahead, side, 0.14))))
                wheels.append(
                    tube(
                        [(x + ahead, side * 0.8, 0.14), (x + ahead * 0.5, side * 0.7, 0.5)],
                        0.012,
                        6,
                        material=materials.PAINTED_METAL,
                    )
                )
        return [body, hood, *bars, *wheels]
    return []


def _make_rounded(size: npt.ArrayLike, middle: npt.ArrayLike, material: Material) -> Piece:
    """Return an ellipsoid with a size."""
    angle = np.linspace(0.1, np.pi - 0.1, 7)
    ball = lathe([(np.sin(a), -np.cos(a)) for a in angle], 12, material=material)
    return Piece(
        ball.vertices * (np.asarray(size, float) / 2) + np.asarray(middle, float), ball.faces, material=material
    )
