"""Street furniture: lamp posts, signs, traffic lights, bins, benches, bollards, fences, walls and cables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal, get_args

import numpy as np

from lidarsim import materials
from lidarsim._base.validation import Floats, one_of, real, short_repr
from lidarsim.errors import ArgumentValueError
from lidarsim.materials import Material
from lidarsim.worlds._asset import (
    Asset,
    Piece,
    along,
    box,
    check_generator,
    draw,
    extrude,
    lathe,
    merge,
    move,
    tube,
)
from lidarsim.worlds._labels import FENCE, OTHER_OBJECT, POLE, TRAFFIC_SIGN

__all__ = ["FURNITURE", "FurnitureKind", "furniture"]

FurnitureKind = Literal["lamp", "sign", "traffic_light", "bin", "bench", "bollard", "fence", "wall", "cable"]
FURNITURE: tuple[FurnitureKind, ...] = get_args(FurnitureKind)

LONG = {"fence": (2.0, 6.0), "wall": (2.0, 6.0), "cable": (20.0, 35.0)}
"""Lengths to draw from, m, of what has a length."""

OVERHEAD = 3.0
"""Height above which people pass below, m."""

METAL, DARK = materials.PAINTED_METAL, Material(reflectivity=0.08)
WOOD = Material(reflectivity=0.45)
"""Weathered wood: between BARK and bright boards, assumed."""


def furniture(kind: FurnitureKind, rng: np.random.Generator, *, length: float | None = None) -> Asset:
    """Make a piece of street furniture that stands above the origin and faces x; what has a length runs along y.

    Parameters
    ----------
    kind : str
        "lamp", "sign", "traffic_light", "bin", "bench", "bollard", "fence", "wall" or "cable".
    rng : numpy.random.Generator
        Draws the design. Signs are 600 mm round, triangles of 900 mm, or rectangles, 2.0 to 2.4 m above the ground
        (VwV-StVO to §§ 39 to 43); lamps are 4 to 9 m high (EN 40-2); bins on wheels hold 120 to 240 l (EN 840-1).
    length : float, optional
        Length of a fence, a wall or a cable, 0.5 to 100 m. Default: drawn.

    Returns
    -------
    Asset
        Its parts. Posts are of the class pole, faces of signs traffic-sign, fences and walls fence, and the rest
        other-object.

    Raises
    ------
    TypeError, ValueError
        If `rng` is no generator, there is no such kind, or the length is out of range or given for something without a
        length.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> ls.worlds.furniture("fence", np.random.default_rng(0), length=3.0)
    Asset(1 part, 0.11 × 3.08 × 1.47 m)
    """
    one_of("kind", kind, FURNITURE)
    check_generator(rng)
    if kind not in LONG:
        if length is not None:
            raise ArgumentValueError("length", f"None, but for {', '.join(LONG)}", short_repr(length))
        pieces = list(_MADE[kind](rng))
        # What is overhead is a part of its own, so that the box of a post does not reach over the road.
        low = [piece for piece in pieces if piece.vertices[:, 2].min() < OVERHEAD]
        high = [piece for piece in pieces if piece.vertices[:, 2].min() >= OVERHEAD]
        return Asset((*merge(kind, low), *merge(f"{kind} head", high)))
    long = draw(rng, LONG[kind]) if length is None else real("length", length, at_least=0.5, at_most=100.0)
    return Asset(tuple(merge(kind, _LONG[kind](rng, long))))


def _lamp(rng: np.random.Generator) -> Iterator[Piece]:
    height, reach = rng.uniform(4.0, 9.0), rng.uniform(0.3, 1.8)
    yield tube([(0, 0, 0), (0, 0, 0.8), (0, 0, height)], [0.09, 0.075, 0.045], 10, POLE, METAL)
    yield tube(
        [(0, 0, height - 0.02), (0.5 * reach, 0, height + 0.12), (reach, 0, height + 0.15)], 0.03, 7, POLE, METAL
    )
    yield box((0.65, 0.25, 0.1), (reach + 0.2, 0, height + 0.13), POLE, METAL)


def _sign(rng: np.random.Generator) -> Iterator[Piece]:
    low = rng.uniform(2.0, 2.4)
    shape = rng.integers(4)
    if shape == 0:  # round
        angle = 2 * np.pi * np.arange(20) / 20
        outline = 0.3 * np.column_stack([np.cos(angle), np.sin(angle)]) + (0, 0.3)
    elif shape == 1:  # give way, or its reverse
        outline = np.array([(-0.45, 0.78), (0.0, 0.0), (0.45, 0.78)])
        outline = outline if rng.random() < 0.5 else np.array([(-0.45, 0.0), (0.45, 0.0), (0.0, 0.78)])
    elif shape == 2:  # stop
        angle = 2 * np.pi * (np.arange(8) + 0.5) / 8
        outline = 0.45 * np.column_stack([np.cos(angle), np.sin(angle)]) + (0, 0.42)
    else:
        wide, tall = rng.uniform(0.4, 0.9), rng.uniform(0.4, 0.9)
        outline = np.array([(-wide / 2, 0), (wide / 2, 0), (wide / 2, tall), (-wide / 2, tall)])
    top = low + outline[:, 1].max()
    yield tube([(0, 0, 0), (0, 0, top)], 0.038, 8, POLE, METAL)
    plate = extrude(outline, 0.045, 0.06, TRAFFIC_SIGN, METAL)
    plate = Piece(move(along("x", plate.vertices), (0, 0, low)), plate.faces, TRAFFIC_SIGN)
    is_face = np.min(plate.vertices[plate.faces][:, :, 0], axis=1) > 0.055
    yield plate.of(is_face, materials.SIGN_SHEETING)
    yield plate.of(~is_face, METAL)


def _traffic_light(rng: np.random.Generator) -> Iterator[Piece]:
    height = rng.uniform(3.2, 3.6)
    yield tube([(0, 0, 0), (0, 0, height)], 0.07, 9, POLE, METAL)
    yield box((0.25, 0.3, 0.9), (0.2, 0, height - 0.5), OTHER_OBJECT, DARK)
    for z in (-0.3, 0.0, 0.3):
        lens = lathe([(0.1, 0.0), (0.1, 0.03)], 10, OTHER_OBJECT, Material(reflectivity=3.0))
        yield Piece(
            move(along("x", lens.vertices), (0.325, 0, height - 0.5 + z)), lens.faces, OTHER_OBJECT, lens.material
        )


def _bin(rng: np.random.Generator) -> Iterator[Piece]:
    if rng.random() < 0.4:  # a litter bin on its post
        yield tube([(0, 0, 0), (0, 0, 1.1)], 0.03, 6, POLE, METAL)
        barrel = lathe([(0.15, 0.5), (0.19, 0.6), (0.2, 1.05)], 12, OTHER_OBJECT, METAL)
        yield Piece(move(barrel.vertices, (0.22, 0, 0)), barrel.faces, OTHER_OBJECT, METAL)
        return
    wide, deep, tall = (0.48, 0.55, 0.94) if rng.random() < 0.5 else (0.58, 0.73, 1.07)
    material = Material(reflectivity=float(rng.uniform(0.1, 0.5)))
    yield box((0.85 * deep, 0.9 * wide, tall - 0.08), (0, 0, tall / 2 - 0.04), OTHER_OBJECT, material)
    yield box((deep, wide, 0.08), (0, 0, tall - 0.04), OTHER_OBJECT, material)


def _bench(rng: np.random.Generator) -> Iterator[Piece]:
    long = rng.uniform(1.5, 2.0)
    yield box((0.42, long, 0.05), (0, 0, 0.45), OTHER_OBJECT, WOOD)
    yield box((0.05, long, 0.35), (-0.22, 0, 0.72), OTHER_OBJECT, WOOD)
    for side in (-0.4, 0.4):
        yield box((0.4, 0.06, 0.43), (0, side * long, 0.215), OTHER_OBJECT, METAL)


def _bollard(rng: np.random.Generator) -> Iterator[Piece]:
    radius, height = rng.uniform(0.04, 0.1), rng.uniform(0.8, 1.05)
    yield tube([(0, 0, 0), (0, 0, 0.9 * height), (0, 0, height)], [radius, radius, 0.5 * radius], 10, POLE, METAL)
    yield tube([(0, 0, 0.78 * height), (0, 0, 0.84 * height)], 1.03 * radius, 10, POLE, Material(reflectivity=200.0))


def _fence(rng: np.random.Generator, length: float) -> Iterator[Piece]:
    height = rng.uniform(0.9, 1.8)
    material = METAL if rng.random() < 0.4 else WOOD
    for y in _spread(length, 2.2):
        yield box((0.08, 0.08, height), (0, y, height / 2), FENCE, material)
    for z in (0.2, 0.85):
        yield box((0.04, length, 0.06), (0.03, 0, z * height), FENCE, material)
    thin, pitch = (0.02, 0.12) if material is METAL else (0.09, 0.13)
    for y in _spread(length - 0.12, pitch):
        yield box((0.02, thin, height - 0.08), (0.06, y, (height + 0.08) / 2), FENCE, material)


def _garden_wall(rng: np.random.Generator, length: float) -> Iterator[Piece]:
    height = rng.uniform(0.5, 1.8)
    material = (materials.CONCRETE, materials.BRICK, materials.PLASTER)[rng.integers(3)]
    yield box((0.24, length, height), (0, 0, height / 2), FENCE, material)
    yield box((0.32, length, 0.08), (0, 0, height + 0.04), FENCE, materials.CONCRETE)


def _cable(rng: np.random.Generator, length: float) -> Iterator[Piece]:
    share = np.linspace(-0.5, 0.5, 13)
    sag = 0.02 * length * (4 * share**2 - 1)
    height = rng.uniform(6.5, 8.0)
    yield tube(np.column_stack([np.zeros(13), share * length, height + sag]), 0.012, 5, OTHER_OBJECT, DARK)


def _spread(length: float, pitch: float) -> Floats:
    """Return places from end to end, not farther apart than a pitch."""
    return np.linspace(-length / 2, length / 2, int(np.ceil(length / pitch)) + 1)


_MADE: dict[FurnitureKind, Callable[[np.random.Generator], Iterator[Piece]]] = {
    "lamp": _lamp,
    "sign": _sign,
    "traffic_light": _traffic_light,
    "bin": _bin,
    "bench": _bench,
    "bollard": _bollard,
}
_LONG: dict[FurnitureKind, Callable[[np.random.Generator, float], Iterator[Piece]]] = {
    "fence": _fence,
    "wall": _garden_wall,
    "cable": _cable,
}
