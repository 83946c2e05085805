"""Streets: a ground with lanes, junctions, kerbs and pavements, all that stands on it, and the ways along it.

Places are given as in OpenDRIVE: by the distance s along the middle of the street and the distance d to the left of it.
Side roads leave the street at right angles, so both run along lines of this grid, however the street bends.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import islice, pairwise, permutations, zip_longest
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from lidarsim import materials
from lidarsim._base.validation import Floats, integer, one_of, real
from lidarsim._base.vectors import product
from lidarsim.materials import Material
from lidarsim.world.scene import Scene
from lidarsim.world.shapes import TriangleMesh
from lidarsim.worlds import _labels as labels
from lidarsim.worlds._asset import Asset, draw
from lidarsim.worlds.buildings import SIZES, BuildingKind, building
from lidarsim.worlds.furnishings import OVERHEAD, FurnitureKind, furniture
from lidarsim.worlds.pedestrians import pedestrian
from lidarsim.worlds.plants import BED, TREES, TreeKind, tree
from lidarsim.worlds.vehicles import VEHICLES, VehicleKind, vehicle

__all__ = ["GROUND", "STREETS", "Street", "StreetKind", "Ways", "street"]

StreetKind = Literal["residential", "city", "rural", "car_park"]
STREETS: tuple[StreetKind, ...] = get_args(StreetKind)

Border = Literal["hedge", "bed", "fence", "wall"]
Span = tuple[float, float]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Ways:
    """Where traffic and people move in a street: lines of points on the ground, shape (k, 3), m, in their direction.

    Points are at most about a metre apart.

    Attributes
    ----------
    lanes : tuple of ndarray
        Middles of the lanes that go straight on, those of the street first, on the right.
    turns : tuple of ndarray
        From a lane into one of another road at a junction.
    pavements : tuple of ndarray
        Along the pavements between side roads, or beside a rural road.
    crossings : tuple of ndarray
        From pavement to pavement over a road, at junctions.
    """

    lanes: tuple[Floats, ...] = ()
    turns: tuple[Floats, ...] = ()
    pavements: tuple[Floats, ...] = ()
    crossings: tuple[Floats, ...] = ()


@dataclass(frozen=True)
class Street:
    """A street.

    Attributes
    ----------
    scene : Scene
        Ground, in objects named as in `GROUND`, one instance for each name, and all that stands on it.
    ways : Ways
        Where traffic and people move.
    """

    scene: Scene
    ways: Ways


GROUND = ("road", "parking", "sidewalk", "other-ground", "terrain")
"""Names of the objects that are the ground of a street, each of the class of that name."""

TILE = 80.0
"""Length of tiles of the ground, m; but for the roadway, each is on one side: rays do not enter the boxes of others."""

KERB = 0.12
"""Height of a kerb, m; 3 cm at crossings (RASt 06 and DIN 18040-3)."""

STEP = 1e-6
"""Places of grid lines are multiples of this, m: a line at the edge of a roadway is off by less, and belongs to it."""

CAMBER = 0.025
"""Slope of a road across (RASt 06)."""

CORNER = 5.0
"""Radius of kerbs at corners, m: a car turns into a residential road at 5 to 6 m (RASt 06)."""

REACH = 75.0
"""Greatest distance from the middle of the street, m."""

ROOM = 4.5
"""Height over a road that is kept free, m (RASt 06)."""

BEDS = 0.6
"""Share of the bays without a vehicle that are beds of low shrubs."""

BEND = 1 / 130
"""Greatest curvature of the street, 1/m, so that its neighbourhood does not fold."""

DEEP = 14.0
"""Greatest depth of a building, m."""


@dataclass(frozen=True)
class Layout:
    """How streets of a kind are laid out. Widths are drawn for each side, m.

    Attributes
    ----------
    lane, verge, pavement, set_back : (float, float)
        Widths of lanes, of the strip of grass between kerb and pavement, of the pavement, and of the front garden.
    parking : tuple of float
        Widths to choose from of the strip for parking; 0 for none, 5 for bays at right angles.
    occupied : float
        Share of bays in which a vehicle stands.
    buildings : tuple of str
        Kinds of buildings.
    gap : (float, float)
        Space between buildings.
    trees : (float, float)
        Distance between trees along the street; 0 for none.
    wild : (float, float)
        Plants per 100 m² behind the front gardens.
    junctions : (float, float)
        Distance between side roads; 0 for none.
    """

    lane: Span
    parking: tuple[float, ...]
    verge: Span
    pavement: Span
    set_back: Span
    occupied: float
    buildings: tuple[BuildingKind, ...]
    gap: Span
    trees: Span
    wild: Span
    junctions: Span


LAYOUTS: dict[StreetKind, Layout] = {
    "residential": Layout(
        (2.6, 3.0), (0.0, 2.0, 2.1), (0.0, 1.6), (1.8, 3.0), (2.0, 7.0), 0.4, ("house", "house", "house", "terrace"),
        (2.0, 7.0), (6.0, 12.0), (2.0, 4.0), (70.0, 120.0),
    ),
    "city": Layout(
        (3.0, 3.5), (2.0, 2.2), (0.0, 0.0), (2.5, 4.0), (0.0, 2.5), 0.6, ("terrace", "terrace", "block"), (0.0, 0.05),
        (8.0, 16.0), (0.5, 1.5), (60.0, 100.0),
    ),
    "rural": Layout(
        (2.8, 3.3), (0.0,), (1.0, 2.0), (0.0, 0.0), (8.0, 25.0), 0.0, ("house", "garage"), (25.0, 80.0), (12.0, 40.0),
        (0.5, 1.5), (110.0, 180.0),
    ),
    "car_park": Layout(
        (3.0, 3.2), (5.0,), (0.0, 0.5), (1.5, 2.0), (6.0, 25.0), 0.65, ("block", "garage"), (10.0, 30.0), (8.0, 16.0),
        (0.2, 0.6), (80.0, 120.0),
    ),
}  # fmt: skip
"""Widths: Forschungsgesellschaft für Straßen- und Verkehrswesen, 2006, Richtlinien für die Anlage von Stadtstraßen
(RASt 06): lanes of 2.75 to 3.25 m, strips for parking 2.0 m wide, pavements of 1.5 to 4 m."""

CARS: tuple[tuple[VehicleKind, float], ...] = (
    ("hatchback", 0.36), ("saloon", 0.16), ("estate", 0.18), ("suv", 0.18), ("van", 0.09), ("pickup", 0.03),
)  # fmt: skip
"""Share of each kind of parked vehicle, after new registrations by segment (Kraftfahrt-Bundesamt, 2014)."""


def street(seed: int = 0, kind: StreetKind = "residential", *, length: float = 300.0) -> Street:
    """Make a street with side roads, buildings, plants, parked vehicles, furniture, and people who stand.

    Parameters
    ----------
    seed : int
        Seed of all that is drawn, 0 to 2⁶⁴ − 1.
    kind : {"residential", "city", "rural", "car_park"}
        The kind of street.
    length : float
        Length, 60 to 1000 m: from x = −length / 2 to length / 2, along x in the middle.

    Returns
    -------
    Street
        The scene, labelled by SemanticKITTI's classes, and the ways for traffic and people, which keep to the right.

    Raises
    ------
    TypeError, ValueError
        If the seed or the length is out of range, or there is no such kind.

    Examples
    --------
    >>> import lidarsim as ls
    >>> world = ls.worlds.street(3, "residential", length=100.0)
    >>> len(world.ways.lanes) >= 2
    True
    >>> world.scene[world.scene.find("road")[0]].label
    40
    """
    rng = np.random.default_rng(integer("seed", seed, at_least=0, at_most=2**64 - 1))
    one_of("kind", kind, STREETS)
    plan = Plan.draw(rng, kind, real("length", length, at_least=60.0, at_most=1000.0))
    scene = Scene(class_names=labels.CLASS_NAMES)
    for name, mesh, material in _ground(rng, plan):
        # There are more tiles than kinds of ground, so nothing else gets one of these numbers.
        scene.add(mesh, name=name, label=_CLASSES[name], instance=GROUND.index(name) + 1, material=material)
    _Builder(rng, plan, scene).build()
    return Street(scene, plan.ways)


_CLASSES = {name: label for label, name in labels.CLASS_NAMES.items()}


@dataclass(frozen=True)
class Side:
    """Widths of a side of the street, from the middle outwards, m, and where its parts begin."""

    lane: float
    parking: float
    verge: float
    pavement: float
    set_back: float

    @property
    def kerb(self) -> float:
        """Distance of the kerb from the middle."""
        return self.lane + self.parking

    @property
    def walk(self) -> float:
        """Distance of the inner edge of the pavement."""
        return self.kerb + self.verge

    @property
    def plot(self) -> float:
        """Distance of the outer edge of the pavement."""
        return self.walk + self.pavement

    @property
    def way(self) -> float:
        """Distance of the way for people: the middle of the pavement or, without one, beside the road."""
        return (self.walk + self.plot) / 2 if self.pavement else self.kerb + 0.9

    @property
    def front(self) -> float:
        """Distance of the fronts of buildings."""
        return self.plot + self.set_back


@dataclass(frozen=True)
class Junction:
    """A side road: where it leaves, on which sides, half the width of its roadway and the width of its pavements, m."""

    s: float
    sides: tuple[int, ...]
    half: float
    pavement: float

    @property
    def plot(self) -> float:
        """Distance of the outer edge of its pavement from its middle."""
        return self.half + self.pavement

    @property
    def reach(self) -> float:
        """Distance from its middle at which the pavement of the street begins, behind the corner."""
        return self.half + max(self.pavement, CORNER + 0.5)


@dataclass(frozen=True, eq=False)
class Plan:
    """The plan of a street: its course in the world, its sides by 1 (left) and −1, and its junctions."""

    kind: StreetKind
    layout: Layout
    length: float
    sides: dict[int, Side]
    junctions: tuple[Junction, ...]
    waves: Floats
    """Amplitude, wave number and phase of curvature, of the grade, and of the hills beside, shape (3, 3, 3)."""

    @classmethod
    def draw(cls, rng: np.random.Generator, kind: StreetKind, length: float) -> Plan:
        """Draw a plan."""
        layout = LAYOUTS[kind]
        lane = draw(rng, layout.lane)
        sides = {
            side: Side(
                lane,
                float(rng.choice(layout.parking)),
                draw(rng, layout.verge) * (rng.random() < 0.3),
                draw(rng, layout.pavement),
                draw(rng, layout.set_back),
            )
            for side in (1, -1)
        }
        junctions = []
        s = -length / 2 + rng.uniform(25.0, layout.junctions[0])
        while s < length / 2 - 25.0:
            arms = ((1,), (-1,), (1, -1))[rng.integers(3)]
            half = rng.uniform(2.6, 3.2)
            junctions.append(Junction(round(s), arms, half, min(2.0, sides[1].pavement)))
            s += draw(rng, layout.junctions)
        waves = np.stack([rng.uniform(0.3, 1.0, (3, 3)), rng.uniform(0.006, 0.03, (3, 3)), rng.uniform(0, 6.3, (3, 3))])
        waves[0] *= np.array([[BEND / 3 * rng.random()], [0.012], [0.9]])
        return cls(kind, layout, length, sides, tuple(junctions), waves)

    def _wave(self, which: int, at: Floats) -> Floats:
        amplitude, number, phase = self.waves[:, which]
        total: Floats = (amplitude * np.sin(np.asarray(at)[..., None] * number + phase)).sum(axis=-1)
        return total

    @cached_property
    def course(self) -> Floats:
        """Distance, position, heading and height of the middle of the street, shape (k, 5), every half metre."""
        s = np.arange(-self.length / 2 - REACH, self.length / 2 + REACH + 0.25, 0.5)
        middle = len(s) // 2

        def integrate(values: Floats) -> Floats:
            total: Floats = np.concatenate([[0.0], np.cumsum((values[:-1] + values[1:]) / 2 * 0.5)])
            total -= total[middle]
            return total

        heading = integrate(self._wave(0, s))
        return np.column_stack(
            [s, integrate(np.cos(heading)), integrate(np.sin(heading)), heading, integrate(self._wave(1, s))]
        )

    def heading(self, s: npt.ArrayLike) -> Floats:
        """Return the heading of the street."""
        return np.asarray(np.interp(np.asarray(s, float), self.course[:, 0], self.course[:, 3]))

    def shortening(self, s: float, side: int, front: float) -> float:
        """Return the least length of lines along a building, from front to back, over that along the street."""
        bend = side * self._wave(0, s + np.linspace(0.0, 40.0, 9))
        return float(1.0 - np.max(np.maximum(bend * front, bend * (front + DEEP))))

    def at(self, s: npt.ArrayLike, d: npt.ArrayLike) -> Floats:
        """Return points on the ground, shape (…, 3)."""
        s, d = np.broadcast_arrays(np.asarray(s, float), np.asarray(d, float))
        x, y = (np.interp(s, self.course[:, 0], self.course[:, axis]) for axis in (1, 2))
        heading = self.heading(s)
        return np.stack([x - d * np.sin(heading), y + d * np.cos(heading), self.height(s, d)], axis=-1)

    def normal(self, s: Floats, d: Floats) -> Floats:
        """Return normals of the ground, shape (…, 3), of unit length, by its slopes over 1 m."""
        along, left = self.at(s + 0.5, d) - self.at(s - 0.5, d), self.at(s, d + 0.5) - self.at(s, d - 0.5)
        normal = np.cross(along, left)
        unit: Floats = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        return unit

    def near(self, s: Floats, d: Floats) -> Iterator[tuple[Junction, Floats]]:
        """Yield junctions, with the distance of places from the middle of each side road, far where it is not."""
        for junction in self.junctions:
            there = np.isin(np.sign(d), junction.sides) | (d == 0)
            yield junction, np.where(there, np.abs(s - junction.s), 1e3)

    def is_road(self, s: Floats, d: Floats) -> Bools:
        """Return whether places are on a roadway, whose corners are round at junctions."""
        across = np.abs(d)
        kerb = np.where(d >= 0, self.sides[1].kerb, self.sides[-1].kerb)
        road = across <= kerb + STEP
        for junction, aside in self.near(s, d):
            road |= aside <= junction.half + STEP
            u, v = across - kerb, aside - junction.half
            in_corner = (u >= 0) & (v >= 0) & (u <= CORNER) & (v <= CORNER)
            road |= in_corner & (np.hypot(u - CORNER, v - CORNER) >= CORNER - STEP)
        return road

    def surface(self, s: Floats, d: Floats) -> npt.NDArray[np.int64]:
        """Return the class of the ground."""
        across = np.abs(d)
        side = self.sides[1], self.sides[-1]
        lane, kerb, walk, plot, front = (
            np.where(d >= 0, getattr(side[0], name), getattr(side[1], name))
            for name in ("lane", "kerb", "walk", "plot", "front")
        )
        found = np.full(s.shape, labels.TERRAIN)
        found[(across > walk) & (across < plot)] = labels.SIDEWALK
        if self.kind in {"city", "car_park"}:
            found[(across >= plot) & (across < front + 0.5)] = labels.SIDEWALK
        aside_any = np.full(s.shape, 1e3)
        for junction, aside in self.near(s, d):
            aside_any = np.minimum(aside_any, aside - junction.half)
            found[(across > kerb) & (aside <= junction.plot)] = labels.SIDEWALK
            u, v = across - kerb, aside - junction.half
            if junction.pavement:
                found[(u >= 0) & (v >= 0) & (u <= CORNER) & (v <= CORNER) & (u + v < 1.2 * CORNER)] = labels.SIDEWALK
        parks = (across > lane) & (across <= kerb) & (aside_any > CLEAR)
        road = self.is_road(s, d)
        found[road] = labels.ROAD
        found[road & parks] = labels.PARKING
        for start, stop, left in self.drives:
            drive = (s > start) & (s < stop) & (np.sign(d) == left) & (across >= walk) & (across < front)
            found[drive & (found != labels.ROAD)] = labels.OTHER_GROUND
        return found

    @cached_property
    def drives(self) -> list[tuple[float, float, int]]:
        """From where to where, and on which side, drives lead to plots."""
        if self.kind != "residential":
            return []
        rng = np.random.default_rng(int(self.waves[2, 0, 0] * 1e6))
        starts = np.arange(-self.length / 2 + 8, self.length / 2 - 8, 18.0)
        places = [(float(np.round(s + rng.uniform(0, 12))), side) for side in (1, -1) for s in starts]
        return [(s, s + 3.0, side) for s, side in places if rng.random() < 0.35]

    def height(self, s: Floats, d: Floats) -> Floats:
        """Return the height of the ground."""
        across = np.abs(d)
        kerb = np.where(d >= 0, self.sides[1].kerb, self.sides[-1].kerb)
        base = np.interp(s, self.course[:, 0], self.course[:, 4])
        hills = self._wave(2, s + 0.7 * d) * np.clip((across - 12.0) / 40.0, 0.0, 1.0)
        # Along side roads, the camber fades out; beside them, there are kerbs.
        road = self.is_road(s, d)
        dip = -CAMBER * np.minimum(across, kerb)
        raised = KERB + 0.02 * np.clip(across - kerb, 0.0, 6.0)
        for junction, aside in self.near(s, d):
            crossing = np.abs(aside - junction.half - CROSSING[0]) < 2.0
            raised = np.where(crossing & (across < kerb + 1.0), 0.03, raised)
        rough = 0.03 * np.sin(3.1 * s + 1.7 * d) * np.sin(2.3 * d - 1.3 * s) * (across > kerb + 3.0)
        rural = 0.12 * np.clip((across - kerb) / 2.0, 0.0, 1.0) * (self.kind == "rural")
        total: Floats = base + hills + dip + np.where(road, 0.0, np.where(rural > 0, -rural, raised) + rough)
        return total

    @cached_property
    def ways(self) -> Ways:
        """The ways along the street and its side roads."""
        end = self.length / 2
        lane = self.sides[1].lane / 2
        lanes: list[Line] = [((-end, -lane), (end, -lane)), ((end, lane), (-end, lane))]
        turns: list[Line] = []
        pavements: list[Line] = []
        crossings: list[Line] = []
        for junction in self.junctions:
            for comes, goes in self._movements(junction, lane):
                if comes[0][0] == comes[1][0] and goes[0][0] == goes[1][0]:  # from side road to side road
                    lanes.append((comes[0], goes[1]))
                else:
                    turns.append(_turn(comes, goes))
            crossings += self._crossings(junction)
        for side in (1, -1):
            walk = side * self.sides[side].way
            stops = [(j.s - j.reach, j.s + j.reach) for j in self.junctions if side in j.sides]
            blocks = [(start, stop) for start, stop in _between(-end, end, stops) if stop - start > 12.0]
            pavements += [((start, walk), (stop, walk)) for start, stop in blocks]
        kinds = (lanes, turns, pavements, crossings)
        placed = iter(_place(self, [line for lines in kinds for line in lines]))
        return Ways(*(tuple(islice(placed, len(lines))) for lines in kinds))

    def _movements(self, junction: Junction, lane: float) -> Iterator[tuple[Line, Line]]:
        """Yield lanes that come to a junction with those that leave it, but for those along the street."""
        end, far, own = self.length / 2, REACH - 12.0, junction.half / 2
        arms: dict[str, tuple[Line, Line]] = {
            "west": (((-end, -lane), (junction.s, -lane)), ((junction.s, lane), (-end, lane))),
            "east": (((end, lane), (junction.s, lane)), ((junction.s, -lane), (end, -lane))),
        }
        for side in junction.sides:
            comes, goes = junction.s - side * own, junction.s + side * own
            arms[f"side {side}"] = ((comes, side * far), (comes, 0.0)), ((goes, 0.0), (goes, side * far))
        for first, second in permutations(arms, 2):
            if {first, second} != {"west", "east"}:
                yield arms[first][0], arms[second][1]

    def _crossings(self, junction: Junction) -> Iterator[Line]:
        """Yield the ways over a side road, and over the street beside it."""
        walks = {side: widths.way for side, widths in self.sides.items()}
        ends = {side: max(widths.way, min(widths.way + 4.0, widths.front - 1.0)) for side, widths in self.sides.items()}
        reach = junction.half + 10.0
        for side in junction.sides:
            yield (junction.s - reach, side * walks[side]), (junction.s + reach, side * walks[side])
        for way in (-1, 1):
            at = junction.s + way * (junction.half + CROSSING[0])
            yield (at, -ends[-1]), (at, ends[1])


Line = tuple[tuple[float, float], ...]
"""Points s and d of a line."""

CLEAR = 5.0
"""Distance from a junction within which nobody may park, m (StVO § 12)."""

CROSSING = (4.0, 3.0)
"""Distance of a crossing from the side road, and its width, m."""


def _turn(comes: Line, goes: Line) -> Line:
    """Return the line from a lane into another at right angles, by a parabola around their intersection."""
    along_s = comes[0][1] == comes[1][1]
    corner = np.array([goes[0][0], comes[0][1]] if along_s else [comes[0][0], goes[0][1]])
    before, after = corner - comes[0], np.asarray(goes[1]) - corner
    size = 6.0
    start, stop = corner - size * before / math.hypot(*before), corner + size * after / math.hypot(*after)
    t = np.linspace(0, 1, 13)[:, None]
    bend = (1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * stop
    return (comes[0], *map(tuple, bend.tolist()), goes[1])


def _place(plan: Plan, lines: Sequence[Line]) -> list[Floats]:
    """Return lines of points s and d as points on the ground, one every metre and one at each of its own."""
    dense = []
    for line in lines:
        points = np.asarray(line, float)
        pieces = [
            np.linspace(start, stop, max(2, math.ceil(math.hypot(*(stop - start)))), endpoint=False)
            for start, stop in pairwise(points)
        ]
        dense.append(np.concatenate([*pieces, points[-1:]]))
    s, d = np.concatenate(dense).T
    return np.split(plan.at(s, d), np.cumsum([len(points) for points in dense])[:-1])


def _between(start: float, stop: float, holes: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Yield the intervals that holes leave."""
    for low, high in sorted(holes):
        if low > start:
            yield start, low
        start = max(start, high)
    if stop > start:
        yield start, stop


# The ground


def _ground(rng: np.random.Generator, plan: Plan) -> Iterator[tuple[str, TriangleMesh, Material]]:
    """Yield name, mesh and material of tiles of each kind of ground; they share the vertices where they meet."""
    grid_s, grid_d = _round_corners(plan, *np.meshgrid(*_lines(plan), indexing="ij"))
    points = plan.at(grid_s, grid_d).reshape(-1, 3)
    number = np.arange(len(points), dtype=np.uint32).reshape(grid_s.shape)
    a, b, c, e = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.stack([a, b, c, a, c, e], axis=-1).reshape(*a.shape, 2, 3)
    mid_s, mid_d = ((grid[:-1, :-1] + grid[1:, 1:]) / 2 for grid in (grid_s, grid_d))
    surface = plan.surface(mid_s, mid_d)
    bright = np.empty(surface.shape)
    base = {
        labels.ROAD: rng.uniform(0.2, 0.34),
        labels.PARKING: rng.uniform(0.2, 0.34),
        labels.SIDEWALK: rng.uniform(0.26, 0.4),
        labels.OTHER_GROUND: rng.uniform(0.25, 0.4),
        labels.TERRAIN: rng.uniform(0.4, 0.55),
    }
    for label, value in base.items():
        bright[surface == label] = value
    for _ in range(int(plan.length / 12)):  # roads are mended in patches
        at, wide = rng.uniform(-plan.length / 2, plan.length / 2), rng.uniform(1, 6)
        left, across = rng.uniform(-8, 8), rng.uniform(0.5, 3)
        patch = (np.abs(mid_s - at) < wide) & (np.abs(mid_d - left) < across)
        bright[patch & (surface != labels.TERRAIN)] *= rng.uniform(0.6, 1.3)
    bright[_find_painted(plan, mid_s, mid_d) & (surface == labels.ROAD)] = np.asarray(
        materials.ROAD_PAINT_WORN.reflectivity
    )
    tile = 2 * np.floor(mid_s / TILE) + ((mid_d > 0) & (surface != labels.ROAD))
    for name in GROUND:
        for part in np.unique(tile[surface == _CLASSES[name]]):
            there = (surface == _CLASSES[name]) & (tile == part)
            corners = faces[there].reshape(-1, 3)
            used = np.bincount(corners.ravel(), minlength=len(points)) > 0
            number = np.cumsum(used, dtype=np.uint32) - np.uint32(1)
            mesh = TriangleMesh(points[used], number[corners])
            yield name, mesh, Material(reflectivity=np.repeat(bright[there], 2), per="face", roughness=0.3)


def _lines(plan: Plan) -> tuple[Floats, Floats]:
    """Return the lines of the grid, along and across: at each edge, and every 1.5 m or less between."""
    end = plan.length / 2 + REACH
    s = [np.arange(-end, end + 0.75, 1.5)]
    fine = np.arange(0.0, CORNER + 0.3, 0.35)
    for junction in plan.junctions:
        edges = np.array([0.0, junction.plot, *(junction.half + fine)])
        s += [junction.s - edges, junction.s + edges]
    across = [np.array([0.0])]
    for side, widths in plan.sides.items():
        kerb = widths.kerb
        edges = np.array([
            0.06, widths.lane, kerb - 0.2, kerb - 0.08, widths.walk, widths.plot, widths.front,
            *(kerb + fine),
            *np.arange(0.5, widths.lane, 0.5),
            *np.arange(widths.plot + 1.5, 24.0, 1.5),
            *np.linspace(24.0, REACH, 22),
        ])  # fmt: skip
        across.append(side * edges)
    kerbs = [side * (widths.kerb + face) for side, widths in plan.sides.items() for face in (0.0, 0.03)]
    side_kerbs = [j.s + way * (j.half + face) for j in plan.junctions for way in (1, -1) for face in (0.0, 0.03)]
    return _distinct(side_kerbs, np.concatenate(s)), _distinct(kerbs, np.concatenate(across))


def _distinct(kerbs: Sequence[float], lines: Floats) -> Floats:
    """Return lines of kerbs, and others at least 1 cm from these and each other, in order, as multiples of `STEP`."""
    kept, rest = (np.unique(np.round(np.asarray(given) / STEP) * STEP) for given in (kerbs, lines))
    rest = rest[(np.abs(rest[:, None] - kept) > 0.01).all(axis=1)]
    return np.sort(np.append(kept, rest[np.append(True, np.diff(rest) > 0.01)]))


def _round_corners(plan: Plan, s: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Return the places of a grid, moved so that its lines along kerbs are round at corners.

    Squares around the centre of a corner become circles, of which the outermost is the kerb.
    """
    kerb = np.where(d >= 0, plan.sides[1].kerb, plan.sides[-1].kerb)
    for junction, aside in plan.near(s, d):
        to_centre = CORNER + kerb - np.abs(d), CORNER + junction.half - aside
        square, circle = np.maximum(*to_centre), np.hypot(*to_centre)
        corner = (np.minimum(*to_centre) > 0) & (square <= CORNER + STEP)
        shift = np.where(corner, 1.0 - square / np.where(corner, circle, 1.0), 0.0)
        s, d = s + np.sign(s - junction.s) * to_centre[1] * shift, d + np.sign(d) * to_centre[0] * shift
    return s, d


def _find_painted(plan: Plan, s: Floats, d: Floats) -> Bools:
    """Return where the road is painted: middle line, edges of rural roads, stop lines and zebra crossings."""
    across, kerb = np.abs(d), np.where(d >= 0, plan.sides[1].kerb, plan.sides[-1].kerb)
    free = np.ones(s.shape, bool)
    stripes = np.zeros(s.shape, bool)
    for junction in plan.junctions:
        aside = np.abs(s - junction.s)
        free &= aside > junction.half + 2.0
        zebra = (np.abs(aside - junction.half - CROSSING[0]) < CROSSING[1] / 2) & (across < kerb - 0.2)
        stripes |= zebra & (np.floor(across / 0.5) % 2 == 0) & (plan.sides[1].pavement > 0)
        free &= np.abs(aside - junction.half - CROSSING[0]) > CROSSING[1]
    dashes = (across < 0.06) & (np.mod(s, 9.0) < 3.0)
    edges = (across > kerb - 0.2) & (across < kerb - 0.08) & (plan.kind == "rural")
    painted: Bools = (free & (dashes | edges)) | stripes
    return painted


# What stands there


@dataclass
class _Builder:
    """Puts assets of a pool, each of which is made once, at places of a plan."""

    rng: np.random.Generator
    plan: Plan
    scene: Scene
    pools: dict[str, list[Asset]] = field(default_factory=dict)
    puts: list[tuple[Asset, str, tuple[float, ...]]] = field(default_factory=list)
    """Assets to add: names, and places s and d, turn, scale and depth in the ground."""

    def build(self) -> None:
        """Fill the street."""
        for side in (1, -1):
            self._park(side)
            self._houses(side)
            self._trees(side)
            self._furniture(side)
        self._background()
        self._cables()
        crowded = self._find_crowded()
        self._sitters(crowded)
        self.puts = [put for put, left_out in zip_longest(self.puts, crowded) if not left_out]
        s, d, yaw, scale, sunk = np.array([how for _, _, how in self.puts]).reshape(-1, 5).T
        turn = self.plan.heading(s) + yaw
        cosine, sine = scale * np.cos(turn), scale * np.sin(turn)
        places = np.zeros((len(turn), 4, 4))
        places[:, 0, 0], places[:, 0, 1], places[:, 1, 0], places[:, 1, 1] = cosine, -sine, sine, cosine
        places[:, 2, 2], places[:, 3, 3] = scale, 1.0
        places[:, :3, 3] = self.plan.at(s, d)
        places[:, 2, 3] -= sunk
        parked = np.isin([name for _, name, _ in self.puts], VEHICLES)
        places[parked, :3, :3] = _tilt(places[parked, :3, :3], self.plan.normal(s[parked], d[parked]))
        indoors = self._find_indoors(places, scale)
        for (asset, name, _), place, inside in zip(self.puts, places, indoors, strict=True):
            if name not in TREES or not inside:
                asset.add_to(self.scene, name=name, transform=place)

    def _find_crowded(self) -> Bools:
        """Return a mask of furniture and people on a road, or in a trunk, a vehicle, a fence, a wall or each other."""
        room = {key: _room(asset) for key, asset in {id(asset): asset for asset, *_ in self.puts}.items()}
        x, y = np.moveaxis(np.array([room[id(asset)] for asset, *_ in self.puts]), -1, 0)
        s, d, yaw, scale = np.array([how[:4] for *_, how in self.puts]).T[..., None]
        cosine, sine = scale * np.cos(yaw), scale * np.sin(yaw)
        corners = np.stack([s + cosine * x - sine * y, d + sine * x + cosine * y], axis=-1)
        low, high, s, d = corners.min(axis=1), corners.max(axis=1), s[:, 0], d[:, 0]
        names = np.array([name for _, name, _ in self.puts])
        may_go = np.isin(names, LOOSE)
        there = np.isin(names, (*VEHICLES, *TREES, "fence", "wall"))
        crowded: Bools = may_go & self.plan.is_road(s, d)
        for index in np.flatnonzero(may_go & ~crowded):
            crowded[index] = (there[:, None] & (low < high[index]) & (high > low[index])).all(axis=1).any()
            there[index] = not crowded[index]
        return crowded

    def _find_indoors(self, places: Floats, scale: Floats) -> Bools:
        """Return which trunks, or middles of what has none, are in the footprint of a building."""
        reach = scale * np.array([_trunk_radius(asset) for asset, *_ in self.puts])
        indoors = np.zeros(len(places), bool)
        for (asset, name, _), place in zip(self.puts, places, strict=True):
            if name == "building":
                low, high = _footprint(asset)
                at = product(places[:, :2, 3] - place[:2, 3], place[:2, :2])
                indoors |= ((low - reach[:, None] < at) & (at < high + reach[:, None])).all(axis=1)
        return indoors

    def _put(
        self, asset: Asset, name: str, at: Span, yaw: float = 0.0, *, scale: float = 1.0, sunk: float = 0.0
    ) -> None:
        """Note an asset to add at a place s and d, turned from the direction of the street."""
        self.puts.append((asset, name, (*at, yaw, scale, sunk)))

    def _one(self, name: str, make: object, count: int) -> Asset:
        """Return one of a pool of assets."""
        pool = self.pools.setdefault(name, [])
        index = int(self.rng.integers(count))
        while len(pool) <= index:
            pool.append(make(self.rng))  # type: ignore[operator]
        return pool[index]

    def _tree(self, kind: TreeKind, s: float, d: float, low: float = 0.8, high: float = 1.2) -> None:
        plant = self._one(kind, partial(tree, kind), 4)
        turn, scale = self.rng.uniform(0, 6.3), self.rng.uniform(low, high)
        if kind == "bush":  # beside the roadway
            kerb = self.plan.sides[1 if d > 0 else -1].kerb
            d = math.copysign(max(abs(d), kerb + scale * math.hypot(*np.abs(plant.bounds[:, :2]).max(axis=0))), d)
        self._put(plant, kind, (s, d), turn, scale=scale)

    def _item(self, kind: FurnitureKind, s: float, d: float, yaw: float) -> None:
        self._put(self._one(kind, partial(furniture, kind), 4), kind, (s, d), yaw)

    def _car(self, s: float, d: float, yaw: float) -> None:
        kinds, shares = zip(*CARS, strict=True)
        kind = kinds[self.rng.choice(len(kinds), p=np.array(shares) / sum(shares))]
        count = 5 if kind == "hatchback" else 3
        self._put(self._one(kind, partial(vehicle, kind), count), kind, (s, d), yaw + self.rng.normal(0, 0.02))

    def _free(self, s: float, side: int, room: float) -> bool:
        """Return whether no side road is near."""
        return all(
            abs(s - junction.s) > junction.half + room for junction in self.plan.junctions if side in junction.sides
        )

    def _along(self, spacing: Span, side: int, room: float) -> Iterator[float]:
        """Yield places along a side, away from side roads."""
        s = -self.plan.length / 2 + self.rng.uniform(0, spacing[1])
        while s < self.plan.length / 2:
            if self._free(s, side, room):
                yield s
            s += draw(self.rng, spacing)

    def _park(self, side: int) -> None:
        widths, layout = self.plan.sides[side], self.plan.layout
        if not widths.parking:
            return
        upright = widths.parking > 4.0
        pitch = 2.6 if upright else 6.0
        stretch = np.arange(-self.plan.length / 2, self.plan.length / 2, pitch)
        for s in stretch:
            if not (self._free(s, side, CLEAR + 3.0) and self._free(s, -side, CLEAR + 3.0)):
                continue
            middle = side * (widths.lane + widths.parking / 2)
            if self.rng.random() < layout.occupied:
                ahead = np.pi * (side > 0) + np.pi * (self.rng.random() < 0.1)
                yaw = np.pi / 2 * self.rng.choice((1, -1)) if upright else ahead
                shift = (0.0, 0.0) if upright else (self.rng.uniform(-0.3, 0.3), -0.05 * side)
                self._car(s + shift[0], middle + shift[1], yaw)
            elif self.rng.random() < BEDS:
                self._put(self._one("bed", partial(tree, "bed"), 4), "bed", (s, middle), np.pi / 2 * upright)
                if self.rng.random() < 0.5:
                    street_tree = self._one("street tree", partial(tree, "broadleaf", clearance=ROOM), 4)
                    self._put(street_tree, "broadleaf", (s, middle), self.rng.uniform(0, 6.3))

    def _houses(self, side: int) -> None:
        plan, widths, layout, rng = self.plan, self.plan.sides[side], self.plan.layout, self.rng
        holes = [(j.s - j.plot - 1.0, j.s + j.plot + 1.0) for j in plan.junctions if side in j.sides]
        for start, stop in _between(-plan.length / 2 - 20.0, plan.length / 2 + 20.0, holes):
            s = start + draw(rng, layout.gap) / 2
            while s < stop - 7.0:
                kind = layout.buildings[rng.integers(len(layout.buildings))]
                short = plan.shortening(s, side, widths.front)
                room = (stop - s) * short
                house = building(kind, rng, width=min(draw(rng, _WIDTHS[kind]), room - 0.5))
                width = float(np.diff(house.bounds, axis=0)[0, 1])
                if width > room:
                    break
                back = widths.front + rng.normal(0, 0.6) * (layout.gap[1] > 1.0)
                long = width / short
                at = s + long / 2, side * max(back, widths.plot + 0.3)
                self._put(house, "building", at, -side * np.pi / 2, sunk=self._depth(house, at, 0.25))
                self._garden(side, s, s + long)
                s += long + draw(rng, layout.gap)

    def _depth(self, house: Asset, at: Span, least: float) -> float:
        """Return how deep a building that faces the street stands in the ground, so that no wall ends above it."""
        s, d = at
        side = 1 if d > 0 else -1
        low, high = _footprint(house)
        x, y = np.linspace(low, high, 7).T
        along, across = np.meshgrid(s + side * y / self.plan.shortening(s - 20.0, side, abs(d)), d - side * x)
        height = self.plan.height(np.append(along, s), np.append(across, d))
        return max(least, float(height[-1] - height.min()) + 0.05)

    def _garden(self, side: int, start: float, stop: float) -> None:
        """Put a fence, wall, hedge or bed at the pavement, and plants behind it and behind the house."""
        widths, rng = self.plan.sides[side], self.rng
        if self.plan.kind == "residential" and widths.set_back > 1.5 and rng.random() < 0.9:
            border = _BORDERS[rng.choice(len(_BORDERS), p=(0.4, 0.3, 0.15, 0.15))]
            self._row(border, side, start, stop, widths.plot + 0.45 + (BED / 2 - 0.4) * (border == "bed"))
        if widths.set_back > BED + 1.0 and rng.random() < 0.5:  # shrubs in front of the house
            shrubs: Border = "bed" if rng.random() < 0.7 else "hedge"
            self._row(shrubs, side, start, stop, widths.front - BED / 2 - 0.6)
        if widths.set_back > 1.8:
            low, high = widths.plot + 1.2, widths.plot + np.clip(widths.set_back - 0.9, 1.3, 6.0)
            for _ in range(rng.poisson((stop - start) * (high - low) * rng.choice((0.1, 0.2, 0.3)))):
                kind: TreeKind = "young" if rng.random() < 0.06 else "bush"
                self._tree(kind, rng.uniform(start, stop), side * rng.uniform(low, high), 0.9, 1.5)

    def _row(self, kind: Border, side: int, start: float, stop: float, across: float) -> None:
        """Put pieces of 3 m along a plot, except on its drives."""
        match kind:
            case "fence" | "wall":
                made, count, yaw = partial(furniture, kind, length=3.0), 2, side * np.pi / 2
            case "hedge" | "bed":
                made, count, yaw = partial(tree, kind, length=3.0), 4, 0.0
        for middle in np.arange(start + 1.5, stop - 1.5, 3.0):
            if not any(low - 1.6 < middle < high + 1.6 and left == side for low, high, left in self.plan.drives):
                self._put(self._one(f"{kind} 3 m", made, count), kind, (middle, side * across), yaw)

    def _trees(self, side: int) -> None:
        widths, layout, rng = self.plan.sides[side], self.plan.layout, self.rng
        if not layout.trees[1]:
            return
        at = widths.kerb + 0.7 if widths.verge > 0.8 or not widths.pavement else widths.plot - 0.5
        if widths.set_back > 3.0 and rng.random() < 0.6:
            at = max(widths.plot + 1.8, widths.lane + 3.5)
        young = rng.random() < 0.3
        for s in self._along(layout.trees, side, 8.0):
            if young:
                self._tree("young", s, side * max(at, widths.kerb + 0.9), 0.9, 1.1)
                continue
            plant = self._one("broadleaf", partial(tree, "broadleaf"), 4)
            if at < widths.lane + np.abs(plant.bounds[:, :2]).max() + 0.5:  # it would hang over the road
                plant = self._one("street tree", partial(tree, "broadleaf", clearance=ROOM), 4)
            self._put(plant, "broadleaf", (s, side * at), rng.uniform(0, 6.3))
            if widths.verge > 0.8 and rng.random() < 0.7:  # low shrubs grow at its foot
                bed = self._one("bed 3 m", partial(tree, "bed", length=3.0), 4)
                self._put(bed, "bed", (s, side * (widths.kerb + widths.verge / 2)), scale=0.9 * widths.verge / BED)
            for _ in range(rng.integers(0, 3)):  # bushes grow at its foot
                self._tree("bush", s + rng.uniform(-1.2, 1.2), side * (at + rng.uniform(0.0, 0.3)), 0.4, 0.8)

    def _furniture(self, side: int) -> None:
        widths, rng = self.plan.sides[side], self.rng
        kerb = widths.kerb + 0.45
        inward = -side * np.pi / 2
        for s in self._along((24.0, 34.0), side, 2.0):
            self._item("lamp", s, side * kerb, inward)
        for s in self._along((25.0, 60.0), side, 3.0):
            self._item("sign", s, side * kerb, np.pi if side < 0 else 0.0)
        for junction in self.plan.junctions:
            for way in (-1, 1):
                beyond = 1.8 if side in junction.sides else -2.2  # a corner is on this side of the crossing
                s = junction.s + way * (junction.half + CROSSING[0] + beyond)
                if self.plan.kind == "city" and way == side:
                    self._item("traffic_light", s, side * kerb, np.pi * (way < 0))
                elif side in junction.sides:
                    self._item("sign", junction.s + way * (junction.half + 0.4), side * (widths.kerb + 7.0), inward)
        if not widths.pavement:
            return
        outer = side * (widths.plot - 0.35)
        for kind, spacing in (("bin", (15.0, 50.0)), ("bench", (50.0, 120.0)), ("bollard", (20.0, 60.0))):
            for s in self._along(spacing, side, 4.0):
                for k in range(rng.integers(2, 5) if kind == "bollard" else 1):
                    at = side * kerb if kind == "bollard" else outer
                    self._item(kind, s + 1.5 * k, at, inward)  # type: ignore[arg-type]
        for s in self._along((25.0, 70.0), side, 4.0):
            person = self._one("standing", partial(pedestrian, posture="standing"), 4)
            self._put(person, "person", (s, side * (widths.walk + 0.6 * widths.pavement)), rng.uniform(0, 6.3))

    def _background(self) -> None:
        """Put houses of a second row and plants at random places behind the fronts."""
        plan, rng = self.plan, self.rng
        density = draw(rng, plan.layout.wild) / 100.0
        for side in (1, -1):
            low = plan.sides[side].front + DEEP
            for s in np.arange(-plan.length / 2, plan.length / 2, 24.0):
                if plan.kind != "rural" and self._free(s, side, 12.0) and rng.random() < 0.7:
                    house = self._one("second row", partial(building, "house"), 4)
                    at = s, side * (low + rng.uniform(6.0, 12.0))
                    self._put(house, "building", at, -side * np.pi / 2, sunk=self._depth(house, at, 0.5))
            low = plan.sides[side].front + (4.0 if plan.kind == "rural" else 10.0)
            count = rng.poisson(density * plan.length * (REACH - low) * 0.5)
            near = rng.beta(1.0, 1.8, count) * (REACH - low - 4.0) + low
            for s, d in zip(rng.uniform(-plan.length / 2, plan.length / 2, count), near, strict=True):
                if self._free(s, side, 7.0):
                    kinds: tuple[TreeKind, ...] = ("broadleaf", "broadleaf", "conifer", "bush", "bush")
                    self._tree(kinds[rng.integers(5)], s, side * d)
            for s in rng.uniform(-plan.length / 2, plan.length / 2, int(plan.length / 12)):
                if self._free(s, side, 3.0) and plan.kind in {"rural", "residential"}:
                    d = plan.sides[side].plot + rng.uniform(1.2, 3.0)
                    self._tree("grass", s, side * d)

    def _cables(self) -> None:
        """Span cables over a city street, from front to front."""
        if self.plan.kind == "city":
            left, right = (max(side.front, side.plot + 0.3) for side in self.plan.sides.values())
            for s in self._along((25.0, 50.0), 1, 12.0):
                if self._free(s, -1, 12.0):
                    cable = self._one("cable", partial(furniture, "cable", length=left + right), 3)
                    self._put(cable, "cable", (s, (left - right) / 2))

    def _sitters(self, crowded: Bools) -> None:
        """Put someone on every other bench, unless it is left out."""
        for (_, name, (s, d, yaw, *_)), left_out in zip([*self.puts], crowded, strict=True):
            if name == "bench" and self.rng.random() < 0.5:
                seated = self._one("seated", partial(pedestrian, posture="sitting"), 4)
                if not left_out:
                    self._put(seated, "person", (s, d), yaw)


def _tilt(axes: Floats, normal: Floats) -> Floats:
    """Return upright axes, in the columns of (k, 3, 3), tilted so that z is the normal; x keeps its heading."""
    x = axes[:, :, 0].copy()
    x[:, 2] = -(x * normal).sum(axis=1) / normal[:, 2]
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    tilted: Floats = np.stack([x, np.cross(normal, x), normal], axis=2)
    return tilted


def _room(asset: Asset) -> Floats:
    """Return the corners, (4, 2), of a rectangle around what people would walk into."""
    solid = [
        part.bounds[:, :2]
        for part in asset.parts
        if part.name not in {"leaves", "branches"} and part.bounds[0, 2] < OVERHEAD
    ]
    if not solid:
        return np.full((4, 2), np.nan)
    (left, right), (near, far) = np.min([low for low, _ in solid], axis=0), np.max([high for _, high in solid], axis=0)
    return np.array([(x, y) for x in (left, near) for y in (right, far)])


def _footprint(asset: Asset) -> Floats:
    """Return the low and high corner, x and y, of a rectangle around the feet of the walls of a building."""
    points = np.concatenate([part.shape.vertices for part in asset.parts if isinstance(part.shape, TriangleMesh)])
    feet = points[points[:, 2] == 0.0, :2]
    return np.array([feet.min(axis=0), feet.max(axis=0)])


def _trunk_radius(asset: Asset) -> float:
    """Return how far the trunk of a plant reaches from its middle; 0 for anything without a trunk."""
    return max((float(np.abs(part.bounds[:, :2]).max()) for part in asset.parts if part.name == "trunk"), default=0.0)


LOOSE = ("lamp", "sign", "traffic_light", "bin", "bench", "bollard", "person")
"""Names of what is left out where there is no room."""

_BORDERS: tuple[Border, ...] = get_args(Border)
_WIDTHS = {kind: width for kind, (width, _, _) in SIZES.items()} | {"terrace": (8.0, 18.0)}
