"""Buildings: walls with recessed windows and doors around a footprint, balconies and roofs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from lidarsim import materials
from lidarsim._base.validation import Floats, integer, one_of, real
from lidarsim.materials import Material
from lidarsim.worlds._asset import Asset, Piece, box, check_generator, draw, extrude, merge
from lidarsim.worlds._labels import BUILDING

__all__ = ["BUILDINGS", "BuildingKind", "building"]

BuildingKind = Literal["house", "terrace", "block", "garage"]
BUILDINGS: tuple[BuildingKind, ...] = get_args(BuildingKind)

Span = tuple[float, float]

SIZES: dict[BuildingKind, tuple[Span, Span, tuple[int, int]]] = {
    "house": ((8.0, 13.0), (8.0, 11.0), (1, 2)),
    "terrace": ((6.0, 18.0), (9.0, 12.0), (3, 4)),
    "block": ((16.0, 32.0), (11.0, 14.0), (4, 6)),
    "garage": ((3.0, 9.0), (5.0, 7.0), (1, 1)),
}
"""Width along the street, depth and storeys. T. Loga et al., 2016, TABULA building typologies in 20 European countries,
Energy and Buildings 132, 4-12: houses of 60 to 140 m² a storey, terraces and blocks of 100 to 450 m²."""

STOREY = (2.7, 3.1)
"""Height of a storey, floor to floor, m: rooms of 2.4 to 2.8 m (building codes of the German states) and a ceiling."""

WINDOW = (0.9, 1.6)
"""Width of a window, m; sills are 0.9 m above the floor, lintels 2.2 m (DIN 5034-1)."""
SILL, LINTEL, STEP = 0.9, 2.2, 0.15

PITCH = (0.55, 1.0)
"""Slope of a roof: 29° to 45°, as tiles need at least 22° (ZVDH, rules for roofing with tiles)."""

WALLS = (materials.PLASTER, materials.PLASTER, materials.BRICK, materials.CONCRETE)
ROOFS = (materials.ROOF_TILE, materials.ROOF_TILE, materials.PAINTED_METAL)


def building(
    kind: BuildingKind,
    rng: np.random.Generator,
    *,
    width: float | None = None,
    depth: float | None = None,
    storeys: int | None = None,
) -> Asset:
    """Make a building whose front is at x = 0, its middle at the origin, and faces x.

    Parameters
    ----------
    kind : str
        "house", "terrace" (of a closed row), "block" or "garage".
    rng : numpy.random.Generator
        Draws what is not given, footprint, windows, roof and materials.
    width, depth : float, optional
        Size of the footprint along y and x, 2 to 100 m. Default: drawn.
    storeys : int, optional
        Number of storeys, 1 to 40. Default: drawn.

    Returns
    -------
    Asset
        Walls and roof, and panes of glass, which close the walls.

    Raises
    ------
    TypeError, ValueError
        If `rng` is no generator, there is no such kind, or a size or the number of storeys is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> ls.worlds.building("house", np.random.default_rng(2), width=10.0)
    Asset(2 parts, 8.78 × 10.00 × 3.54 m)
    """
    one_of("kind", kind, BUILDINGS)
    check_generator(rng)
    spans = SIZES[kind]
    wide, deep = (
        draw(rng, span) if given is None else real(name, given, at_least=2.0, at_most=100.0)
        for name, given, span in (("width", width, spans[0]), ("depth", depth, spans[1]))
    )
    drawn_storeys = int(rng.integers(spans[2][0], spans[2][1] + 1))
    count = drawn_storeys if storeys is None else integer("storeys", storeys, at_least=1, at_most=40)
    return Asset(tuple(merge("building", _pieces(kind, rng, wide, deep, count))))


def _pieces(kind: BuildingKind, rng: np.random.Generator, wide: float, deep: float, storeys: int) -> Iterator[Piece]:
    wall, roof = _tint(rng, WALLS), _tint(rng, ROOFS)
    storey = draw(rng, STOREY)
    height = storeys * storey + (0.3 if kind != "garage" else 0.0)
    half = wide / 2
    outline = np.array([(-deep, -half), (0.0, -half), (0.0, half), (-deep, half)])
    angled = kind in {"house", "block"} and rng.random() < 0.35
    if angled:  # a corner of the front is cut out
        cut, back = rng.uniform(0.3, 0.5) * wide, rng.uniform(0.2, 0.4) * deep
        corner = (0.0, half - cut), (-back, half - cut), (-back, half)
        outline = np.array([(-deep, -half), (0.0, -half), *corner, (-deep, half)])
    levels = [0.0, STEP]
    for floor in range(storeys):
        levels += [floor * storey + SILL, floor * storey + min(LINTEL, storey - 0.3)]
    yield from _walls(kind, rng, outline, np.array([*levels, height]), wall)
    if kind == "block":
        yield from _balconies(rng, half, storeys, storey, wall)
    flat = kind == "garage" or (kind == "block" and rng.random() < 0.6) or angled
    if flat:
        yield extrude(outline, height, height + 0.25, BUILDING, roof)
        if kind == "block":
            yield box((3.0, 4.0, 2.2), (-deep / 2, 0.0, height + 1.3), BUILDING, wall)
        return
    rise = draw(rng, PITCH) * deep / 2
    middle = -deep / 2
    gable = np.array([(-deep, height), (0.0, height), (middle, height + rise)])
    yield _across(gable, -half + 0.01, half - 0.01, wall)
    eaves, over, thick = 0.5, 0.4 if kind == "house" else 0.02, 0.22
    drop = eaves * rise / (deep / 2)
    under = np.array([(-deep - eaves, height - drop), (middle, height + rise), (eaves, height - drop)])
    cover = np.concatenate([under, under[::-1]])
    cover[:, 1] += 0.01 + np.repeat([0.0, thick], 3)
    yield _across(cover, -half - over, half + over, roof)
    yield box((0.5, 0.6, 1.4), (middle - 0.8, rng.uniform(-0.3, 0.3) * wide, height + rise + 0.2), BUILDING, wall)


def _tint(rng: np.random.Generator, choices: tuple[Material, ...]) -> Material:
    """Return one of some materials, somewhat brighter or darker."""
    base = choices[rng.integers(len(choices))]
    value = float(np.asarray(base.reflectivity)) * rng.uniform(0.5, 1.1)
    return Material(reflectivity=value, roughness=base.roughness)


def _across(profile: Floats, low: float, high: float, material: Material) -> Piece:
    """Return a prism along y of a profile in x and z, counter-clockwise with x to the right and z up."""
    prism = extrude(profile, low, high, BUILDING, material)
    x, z, y = prism.vertices.T
    return Piece(np.column_stack([x, y, z]), prism.faces[:, ::-1], BUILDING, material)


def _walls(
    kind: BuildingKind, rng: np.random.Generator, outline: Floats, levels: Floats, material: Material
) -> Iterator[Piece]:
    """Yield the walls over an outline with floor and ceiling, and the panes in them.

    `levels` has the heights of the ground, of the doorstep, of the sill and lintel of each storey, and of the eaves.
    The front is the second side of the outline, and has a door.
    """
    window, gap, recess = draw(rng, WINDOW), rng.uniform(0.7, 1.5), rng.uniform(0.08, 0.2)
    ring, vertices, faces, is_glass = [], [], [], []
    total = 0
    for side, start in enumerate(outline):
        end = outline[(side + 1) % len(outline)]
        long = math.hypot(*(end - start))
        blind = kind == "garage" or (kind == "terrace" and side % 2 == 0)  # in a row, the next house is there
        count = max(0, int((long - gap) / (window + gap)))
        if blind:
            count = min(count, 1) if side == 1 else 0
        wide = long - 0.6 if blind else window
        between = (long - count * wide) / (count + 1)
        lines = between + np.arange(count) * (wide + between)
        share = np.array([0.0, *np.stack([lines, lines + wide], axis=1).ravel() / long, 1.0])
        deep = np.zeros((len(share) - 1, len(levels) - 1))
        if not blind:
            deep[1::2, 2:-1:2] = recess
        glass = (deep > 0) & (rng.random(deep.shape) < 0.8)
        if side == 1 and count:
            door = 2 * int(rng.integers(count)) + 1
            deep[door, 1:3], glass[door, 1:3] = recess, False
        own, corners = _wall(start, end, share, levels, deep)
        vertices.append(own)
        faces.append(corners + total)
        is_glass.append(np.zeros(len(corners), bool))
        is_glass[-1][: 2 * glass.size] = np.repeat(glass.ravel(), 2)
        ring.append(_between(start, end, share[:-1]))
        total += len(own)
    # Floor and ceiling meet the walls at each of their corners: a fan around a point that sees all of the outline.
    edge = np.concatenate(ring)
    middle = (outline[0] + outline[2 if len(outline) == 4 else 3]) / 2
    lids = np.stack([np.column_stack([[*edge, middle], np.full(len(edge) + 1, z)]) for z in levels[[0, -1]]])
    j = np.arange(len(edge))
    after = np.roll(j, -1)
    floor = np.stack([after, j, np.full(len(j), len(j))], axis=1)
    ceiling = np.stack([j, after, np.full(len(j), len(j))], axis=1) + len(j) + 1
    points = np.concatenate([*vertices, *lids])
    corners = np.concatenate(faces).astype(np.uint32)
    caps = (np.concatenate([floor, ceiling]) + total).astype(np.uint32)
    panes = np.concatenate(is_glass)
    yield Piece(points, corners[panes], BUILDING, materials.GLASS)
    yield Piece(points, np.concatenate([corners[~panes], caps]), BUILDING, material)


def _wall(
    start: Floats, end: Floats, share: Floats, levels: Floats, deep: Floats
) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return vertices and faces of a grid of cells, of which each is recessed by a depth.

    Two faces of each cell come first, then those of the reveals between cells of different depth.
    """
    along = (end - start) / math.hypot(*(end - start))
    inward = np.array([-along[1], along[0]])

    edge = _between(start, end, share)

    def quads(*corners: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Floats]) -> Floats:
        points = np.empty((len(corners[0][0]), len(corners), 3))
        for corner, (i, j, depth) in enumerate(corners):
            points[:, corner, :2] = edge[i] + depth[:, None] * inward
            points[:, corner, 2] = levels[j]
        return points

    i, j = (index.ravel() for index in np.indices(deep.shape))
    d = deep[i, j]
    cells = quads((i, j, d), (i + 1, j, d), (i + 1, j + 1, d), (i, j + 1, d))
    i, j = np.nonzero(deep[:-1] != deep[1:])
    a, b = deep[i, j], deep[i + 1, j]
    upright = quads((i + 1, j, a), (i + 1, j, b), (i + 1, j + 1, b), (i + 1, j + 1, a))
    i, j = np.nonzero(deep[:, :-1] != deep[:, 1:])
    a, b = deep[i, j], deep[i, j + 1]
    level = quads((i, j + 1, a), (i + 1, j + 1, a), (i + 1, j + 1, b), (i, j + 1, b))
    vertices = np.concatenate([cells, upright, level]).reshape(-1, 3)
    corners = np.arange(0, len(vertices), 4)[:, None] + np.array([0, 1, 2, 0, 2, 3])
    return vertices, corners.reshape(-1, 3)


def _between(start: Floats, end: Floats, share: Floats) -> Floats:
    """Return points from the start, of share 0, to the end, of share 1: exactly these, so that walls meet."""
    points: Floats = start * (1 - share[:, None]) + end * share[:, None]
    return points


def _balconies(rng: np.random.Generator, half: float, storeys: int, storey: float, wall: Material) -> Iterator[Piece]:
    """Yield balconies one above the other, in some places of the front."""
    for y in np.arange(-half + 2.5, half - 2.0, rng.uniform(5.0, 8.0)):
        for floor in range(1, storeys):
            z = floor * storey
            yield box((1.4, 3.2, 0.18), (0.72, y, z), BUILDING, materials.CONCRETE)
            yield box((0.06, 3.2, 0.95), (1.39, y, z + 0.55), BUILDING, wall)
            for side in (-1.57, 1.57):
                yield box((1.3, 0.05, 0.95), (0.7, y + side, z + 0.55), BUILDING, wall)
