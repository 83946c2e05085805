"""Plants: leaves are disks around the twigs of trees, and triangles that cover shrubs, with gaps that pulses pass."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from lidarsim import materials
from lidarsim._base.validation import Floats, one_of, real, short_repr
from lidarsim._base.vectors import product
from lidarsim.errors import ArgumentValueError
from lidarsim.materials import Material
from lidarsim.world.shapes import Disks, TriangleMesh
from lidarsim.worlds._asset import Asset, Part, Piece, check_generator, draw, loft, merge, tube
from lidarsim.worlds._labels import TERRAIN, TRUNK, VEGETATION

__all__ = ["TREES", "TreeKind", "tree"]

TreeKind = Literal["broadleaf", "conifer", "young", "hedge", "bed", "bush", "grass"]
TREES: tuple[TreeKind, ...] = get_args(TreeKind)

Span = tuple[float, float]


@dataclass(frozen=True)
class Habit:
    """How a plant grows.

    Attributes
    ----------
    height : (float, float)
        Least and greatest height, m.
    stem : (float, float)
        Height of the crown's foot over that of the plant.
    spread : (float, float)
        Radius of the crown over the height of the plant.
    girth : float
        Radius of the trunk at its foot over the height of the plant; 0 if it has no trunk.
    density : float
        Area of leaves, one side, per volume of the crown, m²/m³; 0 for shrubs and grass.
    leaf : float
        Radius of a disk, m: a bunch of leaves or needles, or a blade; of shrubs, the length of edges of triangles.
    rough : float
        How far corners of triangles stray, m. From smoother shrubs, a network learns to take walls for plants.
    """

    height: Span
    stem: Span
    spread: Span
    girth: float
    density: float
    leaf: float
    rough: float = 0.0


HABITS: dict[TreeKind, Habit] = {
    "broadleaf": Habit((7.0, 14.0), (0.2, 0.35), (0.2, 0.36), 0.018, 0.9, 0.2),
    "conifer": Habit((7.0, 16.0), (0.06, 0.16), (0.14, 0.22), 0.016, 1.8, 0.19),
    "young": Habit((4.0, 6.5), (0.33, 0.45), (0.14, 0.22), 0.008, 0.9, 0.1),
    "hedge": Habit((0.7, 2.3), (0.0, 0.0), (0.0, 0.0), 0.0, 0.0, 0.12, 0.1),
    "bed": Habit((0.08, 0.7), (0.0, 0.0), (0.0, 0.0), 0.0, 0.0, 0.12, 0.1),
    "bush": Habit((0.8, 2.2), (0.0, 0.0), (0.4, 0.65), 0.0, 0.0, 0.2, 0.3),
    "grass": Habit((0.15, 0.45), (0.0, 0.0), (0.0, 0.0), 0.0, 0.0, 0.035),
}
"""Height and spread of trees in towns: H. Pretzsch et al., 2015, Crown size and growing space requirement of common
tree species in urban centres, parks, and forests, Urban Forestry & Urban Greening 14, 466-479. Young trees are as
nurseries sell them (FLL, 2020, Gütebestimmungen für Baumschulpflanzen): trunks 16 to 25 cm around. Leaves: an index of
3 to 5 of crowns 4 to 7 m deep (J. Klingberg et al., 2017, Mapping leaf area of urban greenery using aerial LiDAR and
ground-based measurements in Gothenburg, Sweden, Urban Forestry & Urban Greening 26, 31-40). Beds are as low as in
SemanticKITTI 00, where half of the low plants are below 0.3 m."""

HEDGE_DEPTH = 0.4
"""Half the thickness of a hedge over its height."""

BED = 2.0
"""Width of a bed of low shrubs, m: that of a strip for parking, which such beds divide."""

OVERLAP = 0.3
"""How much larger than faces of the hull the triangles of a shrub are: 7 % of a hedge stay open, and 9 % of a bush."""

FILL = 0.55
"""Share of a disk or triangle that its bunch of leaves fills: with full ones, vegetation has a median intensity of
0.49, and of 0.34 in SemanticKITTI 00 and 08."""

TUFTS = 2.0
"""Width of a patch of grass tufts, m."""


def tree(
    kind: TreeKind,
    rng: np.random.Generator,
    *,
    height: float | None = None,
    length: float | None = None,
    clearance: float = 0.0,
) -> Asset:
    """Make a plant that stands above the origin.

    Parameters
    ----------
    kind : str
        "broadleaf", "conifer", "young", "hedge" (along x), "bed" (of low shrubs, along x, 2 m wide), "bush" or "grass"
        (tufts on a square of 2 m).
    rng : numpy.random.Generator
        Draws size, branches and leaves.
    height : float, optional
        Height, 0.05 to 60 m. Default: drawn.
    length : float, optional
        Length of a hedge or bed, 0.5 to 50 m. Default: drawn, 2 to 6 m.
    clearance : float
        Height up to which a tree is pruned, 0 to 60 m, but at most 0.8 of its own height: 4.5 m over roads.

    Returns
    -------
    Asset
        Trunk and branches as meshes, and leaves as `Disks`, if there are any; of hedges, beds and bushes, leaves as a
        mesh with gaps. The trunk below the crown is of the class trunk, grass of the class terrain, and all else
        vegetation.

    Raises
    ------
    TypeError, ValueError
        If `rng` is no generator, there is no such kind, or a length is out of range or given for something else than a
        hedge or bed.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> oak = ls.worlds.tree("broadleaf", np.random.default_rng(5), height=10.0)
    >>> [part.name for part in oak.parts]
    ['trunk', 'branches', 'leaves']
    """
    one_of("kind", kind, TREES)
    check_generator(rng)
    habit = HABITS[kind]
    tall = draw(rng, habit.height) if height is None else real("height", height, at_least=0.05, at_most=60.0)
    if kind in {"hedge", "bed"}:
        long = draw(rng, (2.0, 6.0)) if length is None else real("length", length, at_least=0.5, at_most=50.0)
        wide = BED if kind == "bed" else 2 * HEDGE_DEPTH * min(tall, 1.5)
        return Asset((_make_clipped(rng, habit, long, wide, tall),))
    if length is not None:
        raise ArgumentValueError("length", "None, but for a hedge or bed", short_repr(length))
    if kind == "grass":
        return Asset((_tufts(rng, habit, tall),))
    if kind == "bush":
        return Asset((_make_bush(rng, habit, draw(rng, habit.spread) * tall, tall),))
    clear = min(real("clearance", clearance, at_least=0.0, at_most=60.0), 0.8 * tall)
    leaf = min(habit.leaf, tall / 8)
    foot, radius = draw(rng, habit.stem) * tall, draw(rng, habit.spread) * tall
    foot = max(foot, clear)
    twigs = _twigs(kind, rng, foot, tall, radius)
    volume = 2 / 3 * 2 * np.pi * radius**2 * (tall - foot) / 2 * (0.5 if kind == "conifer" else 1.0)
    count = int(habit.density * volume / (np.pi * leaf**2))
    # Leaves gather around the twigs, so that there are gaps between them.
    bunch = (0.16 if kind != "conifer" else 0.13) * radius
    at = twigs[rng.integers(len(twigs), size=count)] + rng.normal(0.0, bunch, (count, 3)) * (1, 1, 0.7)
    at[:, 2] = np.clip(at[:, 2], max(0.4 * foot, 1.1 * leaf), tall)
    at = at[at[:, 2] >= clear + 2 * leaf * bool(clear)]
    leaves = _leaves(rng, at, leaf, materials.CONIFER if kind == "conifer" else materials.FOLIAGE)
    trunk, *branches = _wood(rng, twigs, habit.girth * tall, foot, (0.95 if kind == "conifer" else 0.7) * tall)
    # Branches are a part of their own, so that the box of a trunk does not reach over the road.
    wood = *merge("trunk", [trunk]), *merge("branches", branches)
    return Asset((*wood, leaves) if len(at) else tuple(wood))


def _leaves(rng: np.random.Generator, at: Floats, radius: float, material: Material) -> Part:
    """Return leaves that face all ways alike."""
    normals = rng.normal(size=(len(at), 3))
    return Part("leaves", Disks(at, normals, radius * rng.uniform(0.8, 1.2, len(at))), VEGETATION, _fill(material))


def _fill(material: Material) -> Material:
    """Return the material of a surface that leaves fill in part."""
    looks = {key: value for key, value in material._contents().items() if key != "reflectivity"}
    return Material(reflectivity=FILL * np.asarray(material.reflectivity), **looks)


def _twigs(kind: TreeKind, rng: np.random.Generator, foot: float, tall: float, radius: float) -> Floats:
    """Return points on the crown and in it, more of them outside: the ends of branches."""
    count = 90
    if kind == "conifer":
        share = np.sqrt(rng.random(count))  # from the top down
        turn, out = rng.uniform(0, 2 * np.pi, count), share * radius * rng.uniform(0.5, 1.0, count)
        return np.column_stack([out * np.cos(turn), out * np.sin(turn), tall - 0.2 - share * (tall - foot - 0.2)])
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    deep = rng.uniform(0.45, 0.9, count)[:, None]
    # A crown is not round: it bulges in some directions.
    lumps = 1 + 0.3 * np.sin(product(ways, rng.normal(0, 2.5, (3, 3))) + rng.uniform(0, 6, 3)).mean(
        axis=1, keepdims=True
    )
    half = (tall - foot) / 2
    points: Floats = ways * deep * lumps * (radius, radius, half) + (0, 0, foot + half)
    return points


def _wood(rng: np.random.Generator, twigs: Floats, girth: float, foot: float, tall: float) -> list[Piece]:
    """Return the trunk, which is part of the crown above its foot, and the branches to some of the twigs."""
    fork = min(max(foot, 0.3), 0.9 * tall)
    bend = rng.normal(0, 0.02 * tall, (2, 2))
    top = (*bend[1], tall)
    radius = girth * rng.uniform(0.8, 1.3)
    middle = (*bend[0], fork)
    pieces = [
        tube([(0, 0, 0), (0, 0, 0.3 * fork), middle], [1.25 * radius, radius, 0.85 * radius], 9, TRUNK, materials.BARK),
        tube([middle, top], [0.85 * radius, 0.2 * radius], 7, VEGETATION, materials.BARK),
    ]
    for end in twigs[rng.permutation(len(twigs))[:12]]:
        end[2] = max(end[2], fork + min(0.2, 0.1 * tall))
        height = np.clip(end[2] - 0.6 * np.hypot(*end[:2]), fork, 0.9 * top[2])
        share = (height - fork) / (top[2] - fork)
        start = np.array([*(bend[0] + share * (bend[1] - bend[0])), height])
        knee = (start + end) / 2 - (0, 0, 0.08 * math.hypot(*(end - start)))
        thick = radius * (0.45 - 0.25 * share)
        pieces.append(tube([start, knee, end], [thick, 0.6 * thick, 0.2 * thick], 5, VEGETATION, materials.BARK))
    return pieces


def _make_clipped(rng: np.random.Generator, habit: Habit, long: float, wide: float, tall: float) -> Part:
    """Return a shrub that is clipped to a block."""
    ends, shrink = [long / 2] * 3, np.array([1.0, 2.0]) / 3
    between = _steps(-long / 2, long / 2, habit.leaf)
    x = np.concatenate([np.negative(ends[:2]), between, ends[:2]])
    size = np.concatenate([shrink, np.ones(len(between)), shrink[::-1]])
    side, top = _steps(0.0, tall, habit.leaf), _steps(-wide / 2, wide / 2, habit.leaf)
    y = np.concatenate([np.full(len(side), wide / 2), top[-2:0:-1], np.full(len(side), -wide / 2)])
    z = np.concatenate([side, np.full(len(top) - 2, tall), side[::-1]])
    return _make_shrub(rng, habit, x, size, np.column_stack([y, z]))


def _make_bush(rng: np.random.Generator, habit: Habit, radius: float, tall: float) -> Part:
    """Return a shrub that is round, and flat below."""
    edge = min(habit.leaf, tall / 8)
    along = _steps(0.0, np.pi, edge / radius)[1:-1]
    around = _steps(-0.25 * np.pi, 1.25 * np.pi, edge / radius)
    outline = np.column_stack([radius * np.cos(around), np.maximum(tall * (0.4 + 0.6 * np.sin(around)), 0.0)])
    return _make_shrub(rng, habit, -radius * np.cos(along), np.sin(along), outline)


def _make_shrub(rng: np.random.Generator, habit: Habit, x: Floats, size: Floats, outline: Floats) -> Part:
    """Return leaves on a hull through sections at x, of a size relative to an outline in y and z, with gaps."""
    tall = outline[:, 1].max()
    middle = np.array([0.0, tall / 2])
    sections = middle + size[:, None, None] * (outline - middle)
    rings = np.concatenate([np.broadcast_to(x[:, None, None], (*sections.shape[:2], 1)), sections], axis=2)
    hull = loft(rings)
    leaves = hull.vertices[hull.faces]
    leaves += OVERLAP * (leaves - leaves.mean(axis=1, keepdims=True))
    low, high = min(habit.rough, tall / 4) * np.array([(-0.5, -0.5, -1.0), (0.5, 0.5, 0.0)])
    leaves += rng.uniform(low, high, leaves.shape)
    leaves = np.clip(leaves, hull.vertices.min(axis=0) + low * (1, 1, 0), hull.vertices.max(axis=0) + high)
    mesh = TriangleMesh(leaves.reshape(-1, 3), np.arange(leaves.size // 3, dtype=np.uint32).reshape(-1, 3))
    return Part("leaves", mesh, VEGETATION, _fill(materials.FOLIAGE))


def _steps(start: float, stop: float, step: float) -> Floats:
    """Return numbers from start to stop, at most a step apart."""
    return np.linspace(start, stop, math.ceil((stop - start) / step) + 1)


def _tufts(rng: np.random.Generator, habit: Habit, tall: float) -> Part:
    """Return blades that stand up, in tufts."""
    tufts = rng.uniform(-TUFTS / 2, TUFTS / 2, (30, 2))
    at = np.repeat(tufts, 12, axis=0) + rng.normal(0, 0.06, (360, 2))
    heights = rng.beta(1.2, 2.5, 360) * tall
    normals = rng.normal(size=(360, 3)) * (1, 1, 0.3)
    blades = Disks(np.column_stack([at, np.maximum(heights, habit.leaf)]), normals, habit.leaf)
    return Part("leaves", blades, TERRAIN, materials.GRASS)
