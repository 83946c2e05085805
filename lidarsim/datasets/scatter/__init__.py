"""Instances at random places on the ground, clear of each other and of the sensor at all times, some of them moving."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim._base.vectors import product
from lidarsim.config.objects import GeneratedObject
from lidarsim.datasets.draws import Stream
from lidarsim.datasets.scatter._group import Scatter
from lidarsim.datasets.scatter._instances import AnyItem, Instance, PlacedPart, Swing, instance_of
from lidarsim.datasets.scatter._outlines import Obstacles, Outline, bulge_of, steps, turns_of
from lidarsim.datasets.scatter._travel import STEP
from lidarsim.datasets.scatter._ways import Way
from lidarsim.datasets.scattered import Scattered, Tally
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig
from lidarsim.world.scene import Scene, SceneObject
from lidarsim.worlds import GROUND

if TYPE_CHECKING:
    from lidarsim.config.document import Place
    from lidarsim.run import Run

__all__ = ["Placed", "Scatter", "clearance", "nearby", "scatter"]

TRIES = 200
"""Number of places tried for an object."""

MORE = 2
"""How many times as many places are tried at once as before, after none of those had room."""

FULL = 50
"""Number of consecutive objects without room after which the rest of their group is left out."""

MOST_STEPS = 1_000_000
"""Greatest number of steps of a sequence in which anything moves."""

TOP = 1e5
"""Height above all ground, m, from which rays are cast down."""


@dataclass(frozen=True)
class Placed:
    """An object of a group, with its pose or trajectory, and its parts with theirs."""

    group: str
    index: int
    scale: float
    motion: Floats | Trajectory
    parts: tuple[PlacedPart, ...]

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the object to a scene as one instance; `place` is that of the groups."""
        taken = {item.instance for item in scene}
        # As `Scene.add` numbers an object by default, unless an object of the scene was given that number.
        instance = next(number for number in itertools.count(len(scene) + 1) if number not in taken)
        for part in self.parts:
            part.add_to(scene, place / self.group / "objects" / self.index, instance)


@dataclass(frozen=True)
class _Rule:
    """Obstacles that refuse places nearer than a gap, and the words for that, in which {} is the name of an obstacle.

    With `along`, the outline of the object is that with its gap ahead and behind.
    """

    words: str
    obstacles: Obstacles
    gap: float = 0.0
    along: bool = False


def scatter(
    groups: dict[str, Scatter], place: Place, run: Run, seed: int, sequence: int
) -> tuple[list[Placed], Scattered]:
    """Place the objects of all groups in a sequence, group by group.

    Parameters
    ----------
    groups : dict of str to Scatter
        The groups to place.
    place : Place
        Place of the groups in the recipe.
    run : Run
        The run of the sequence, whose scene has the ground and obstacles, and whose pose is kept clear.
    seed : int
        Seed of the data set.
    sequence : int
        Number of the sequence.

    Returns
    -------
    placed : list of Placed
        The placed objects; those without room are left out.
    counts : Scattered
        Numbers of objects, why places were refused, and the objects of the scene that are in the sensor's way.

    Raises
    ------
    ConfigError
        If an object to stand on does not exist, a path of `along_m` is too short for the speed, a drawn number is out
        of range, a walker would have to run, or a sequence is too long.
    """
    times = _moments(*_span(run), run, groups.values(), place)
    outlines = [(item, _obstacle(item, times)) for item in run.scene.objects if _is_solid(item)]
    placed: list[Placed] = []
    tallies: dict[str, Tally] = {}
    standing: dict[frozenset[str], Obstacles] = {}
    # Instances in areas, instances on paths, and the latter with their gaps ahead and behind.
    others, lanes, spaced = Obstacles(), Obstacles(), Obstacles()
    for name, given in groups.items():
        there = place / name
        count = int(given.draw("count", Stream(seed, f"scatter.{name}", sequence), there))
        group = given.on_ways(run.ways, there)
        if group is None:
            tallies[name] = Tally(count, 0, {"no such ways in the street": count})
            continue
        ground, passed = _ground(run, group.on, there), _ground_of(run).union(group.on)
        if passed not in standing:
            standing[passed] = Obstacles(
                (_name(item), outline) for item, outline in outlines if item.name not in passed
            )
        along = bool(group.paths)
        rules = [
            _Rule("clear of the sensor", _sensor(run, times, group.clear_m)),
            _Rule("meets {} of the scene", standing[passed]),
            _Rule("gap to {}", others, group.gap_m),
            *(
                [_Rule("gap to {}", lanes, along=True), _Rule("gap to {}", spaced)]
                if along
                else [_Rule("gap to {}", lanes, group.gap_m)]
            ),
        ]
        instances: dict[tuple[int, int], Instance] = {}
        missed, done = 0, len(placed)
        refused: Counter[str] = Counter()
        for number in range(count):
            stream = Stream(seed, f"scatter.{name}.{number}", sequence)
            last = len(group.objects) - 1
            index = stream.integer(0, last) if group.weights is None else stream.index(group.weights)
            key = index, _variant(group.objects[index], Stream(seed, f"scatter.{name}.{number}.variant", sequence))
            if key not in instances:
                asset_seed = Stream(seed, f"scatter.{name}.{index}.{key[1]}", sequence).word()
                instances[key] = instance_of(group.objects[index], there / "objects" / index, asset_seed)
            scale = group.draw("scale", stream, there)
            way = Way(group, stream, times, there)
            phase = Stream(seed, f"scatter.{name}.{number}.phase", sequence).unit()
            swing = instances[key].swing(scale, way.travel, phase, there)
            found, reasons = _place(way, stream, swing, ground, rules)
            if found is None:
                refused += reasons
                missed += 1
                if missed == FULL:
                    break
                continue
            missed = 0
            poses, outline, spaced_out = found
            motion = Trajectory(times, poses) if way.travel.moves else poses[0]
            parts = instances[key].place(scale, swing, motion, times[0])
            placed.append(Placed(name, index, scale, motion, parts))
            (lanes if along else others).add(name, outline)
            if along:
                spaced.add(name, spaced_out)
        tallies[name] = Tally(count, len(placed) - done, dict(refused))
    near = dict.fromkeys(nearby(run, groups), 1) if clearance(groups) else {}
    return placed, Scattered(1, tallies, near)


VARIANTS = 8
"""Number of assets of an entry of a group, without a seed of its own, in a sequence."""


def _variant(item: AnyItem, stream: Stream) -> int:
    """Return which asset of a generator an object is; 0 of all others."""
    return (
        stream.integer(0, VARIANTS - 1)
        if isinstance(item, GeneratedObject) and "seed" not in item.model_fields_set
        else 0
    )


def nearby(run: Run, groups: dict[str, Scatter]) -> dict[str, float]:
    """Return the objects of a run's scene that are in the way of its sensor, and when each is first, s.

    If a group has a `clear_m`, these are the objects within the least `clear_m`, along x and along y, of the sensor, or
    the body of a rig, that begin below the highest sensor. Objects are taken as boxes. Ground and flat objects such as
    road markings are in nobody's way, nor is what the sensor is always inside of, such as a room. Without `clear_m`,
    they are the static objects whose surface a sensor passes through, exactly.
    """
    start, stop = _span(run)
    moves = isinstance(run.pose, Trajectory) or any(item.motion is not None for item in run.scene.objects)
    count = max(1, min(math.ceil((stop - start) / STEP), MOST_STEPS)) if moves else 1
    times = np.linspace(start, stop, count + 1)
    clear = clearance(groups)
    if not clear:
        return _objects_passed_through(run, times)
    on = {name for group in groups.values() for name in group.on} | _ground_of(run)
    positions = _positions(run, times)
    mounts = [part.mount[2, 3] for part in run.sensor.values()] if isinstance(run.sensor, Rig) else []
    path = Outline(_square(positions, clear), -np.inf, positions[:, 2].max() + max(mounts, default=0.0))
    found: dict[str, float] = {}
    for item in run.scene.objects:
        low, high = item.bounds
        carried = item.motion is run.pose and item.motion is not None
        if item.motion is None and ((low >= path.box[1]) | (high <= path.box[0])).any():
            continue
        if carried or item.name in on or not _is_solid(item) or low[2] == high[2]:
            continue
        outline = _obstacle(item, times)
        encloses = (outline.box[0, :2] <= path.box[0, :2]).all() and (outline.box[1] >= path.box[1]).all()
        free = path.apart_each_step(outline, 0.0)
        if outline.low <= path.high and not encloses and not free.all():
            found.setdefault(_name(item), float(times[free.argmin()]))
    return found


def clearance(groups: dict[str, Scatter]) -> float:
    """Return the least `clear_m` of groups that have one, else 0."""
    return min((group.clear_m for group in groups.values() if group.clear_m), default=0.0)


def _objects_passed_through(run: Run, times: Floats) -> dict[str, float]:
    """Return the static objects of a scene that a sensor passes through, straight from one time to the next."""
    found: dict[str, float] = {}
    if not isinstance(run.pose, Trajectory):
        return found
    scene = Scene()
    items = [item for item in run.scene.objects if item.motion is None]
    for item in items:
        scene.add(item.shape, transform=item.transform)
    poses = run.pose.at(np.clip(times, *run.pose.span)).as_matrix()
    for mount in [part.mount for part in run.sensor.values()] if isinstance(run.sensor, Rig) else [np.eye(4)]:
        positions = product(poses, mount)[:, :3, 3]
        steps_of = np.diff(positions, axis=0)
        there = np.flatnonzero(steps_of.any(axis=1))
        if len(there):
            hits = scene.cast(positions[there], steps_of[there], t_max=1.0)
            for index in np.flatnonzero(hits.hit):
                name, time = _name(items[hits.object_id[index]]), float(times[there[index]])
                found[name] = min(time, found.get(name, time))
    return found


def _span(run: Run) -> tuple[float, float]:
    """Return the start of a run, and the end of the frame after its last."""
    stop = run.time(run.frames.stop + 1)
    late = max((part.offset for part in run.sensor.values()), default=0.0) if isinstance(run.sensor, Rig) else 0.0
    return run.time(run.frames.start), stop + late


def _moments(start: float, stop: float, run: Run, groups: Iterable[Scatter], place: Place) -> Floats:
    """Return the times of the overlap checks; only the first and last if nothing moves."""
    clears = isinstance(run.pose, Trajectory) and any(group.clear_m for group in groups)
    moves = any(item.motion is not None for item in run.scene.objects)
    if not clears and not moves and not any(group.speed_m_per_s != 0 for group in groups):
        return np.array([start, stop])
    if not (stop - start) / STEP <= MOST_STEPS:
        most = MOST_STEPS * STEP
        raise place.error(f"expected sequences of at most {most:,.0f} s if anything moves, got {stop - start:,.4g} s")
    return np.append(np.arange(start, stop, STEP), stop)


def _place(
    way: Way, stream: Stream, swing: Swing, ground: Scene, rules: Sequence[_Rule]
) -> tuple[tuple[Floats, Outline, Outline] | None, Counter[str]]:
    """Return an object's poses and outlines, as `_stand` does, at the first of `TRIES` places with room for it.

    Places are tried several at a time, more the longer it takes. The first is None if no place has room; then the
    second has the number of places that each rule refused.
    """
    tried, count = 0, 1
    refused: Counter[str] = Counter()
    while tried < TRIES:
        count = min(count, TRIES - tried)
        drawn = [way.poses(stream) for _ in range(count)]
        starts = np.array([poses for poses in drawn if poses is not None])
        if not len(starts):
            return None, Counter({"no room along the path": 1})
        poses, outline, spaced = _stand(starts, swing, ground, way.group)
        reasons = _reasons(rules, outline, spaced)
        if "" in reasons:
            free = reasons.index("")
            return (poses[free], outline.at(free), spaced.at(free)), refused
        refused[f"no room on {', '.join(way.group.on)}"] += len(starts) - len(poses)
        refused.update(reasons)
        tried, count = tried + count, count * MORE
    return None, refused


def _stand(poses: Floats, swing: Swing, ground: Scene, group: Scatter) -> tuple[Floats, Outline, Outline]:
    """Return the poses, (m, k, 4, 4), of those places where all of an object is on the ground, and its outlines there.

    The second outline has the gap of the group ahead and behind, if it follows paths.

    An upright object stands at the greatest height of the ground under its middle and corners. One that tilts is
    parallel to the plane that fits the heights under its corners best, and as far above it as the highest of the five
    places asks.
    """
    low = swing.bounds[0, 2]
    corners = _corners(swing.bounds)
    plan = _move(poses, corners)
    under = np.concatenate([plan, plan.mean(axis=2, keepdims=True)], axis=2)
    origins = np.concatenate([under, np.full((*under.shape[:3], 1), TOP)], axis=3).reshape(-1, 3)
    height = TOP - ground.cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)).t.reshape(under.shape[:3])
    is_there = np.isfinite(height).all(axis=(1, 2))
    poses, height = poses[is_there], height[is_there]
    if group.tilt:
        _tilt(poses.reshape(-1, 4, 4), corners, height.reshape(-1, 5), low)
    else:
        poses[..., 2, 3] = height.max(axis=2) - low
    outline = _outline(poses, swing, swing.bounds, tilt=group.tilt)
    if not (group.paths and group.gap_m):
        return poses, outline, outline
    longer = swing.bounds + np.array([[-group.gap_m, 0.0, 0.0], [group.gap_m, 0.0, 0.0]])
    return poses, outline, _outline(poses, swing, longer, tilt=group.tilt)


def _move(poses: Floats, points: Floats) -> Floats:
    """Return where points, (c, 3), are at poses, (…, 4, 4): (…, c, 3); x and y alone, (…, c, 2), of points (c, 2)."""
    place, axes = poses[..., None], range(points.shape[1])
    # BLAS rounds these sums differently on other processors, and einsum takes up to seven times as long.
    return np.stack(
        [sum(place[..., i, j, :] * points[:, j] for j in axes) + place[..., i, 3, :] for i in axes], axis=-1
    )


def _corners(bounds: Floats) -> Floats:
    (x0, y0, _), (x1, y1, _) = bounds
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _outline(poses: Floats, swing: Swing, bounds: Floats, *, tilt: bool) -> Outline:
    """Return the outline of a box with these bounds, in which parts swing, at poses, (m, k, 4, 4)."""
    corners, low, high = _corners(bounds), bounds[0, 2], bounds[1, 2]
    if tilt:
        outline = _solid(poses, bounds)
        turns = turns_of(poses)
    else:
        plan = _move(poses, corners)
        turns = np.diff(np.unwrap(np.arctan2(poses[..., 1, 0], poses[..., 0, 0])))
        bulge = bulge_of(np.linalg.norm(corners, axis=1).max(), turns)
        heights = poses[..., 2, 3].min(axis=1) + low, poses[..., 2, 3].max(axis=1) + high
        outline = Outline(steps(plan), *heights, bulge)
    more = swing.bulge(np.abs(turns).max(axis=1, initial=0.0))
    return replace(outline, low=outline.low - more, high=outline.high + more, bulge=outline.bulge + more)


def _reasons(rules: Iterable[_Rule], outline: Outline, spaced: Outline) -> list[str]:
    """Return why the first rule that refuses each of m places does so; empty for places with room."""
    reasons = np.full(len(outline.corners), "", object)
    for rule in rules:
        found = rule.obstacles.first_refusal(spaced if rule.along else outline, rule.gap, reasons == "")
        for index in np.flatnonzero(found >= 0):
            reasons[index] = rule.words.format(rule.obstacles.names[found[index]])
    return reasons.tolist()


def _tilt(poses: Floats, corners: Floats, height: Floats, low: float) -> None:
    """Tilt poses to the ground, of which `height`, (k, 5), has the heights under the corners and their middle."""
    (x0, y0), (x1, y1) = corners[0], corners[2]
    rear_right, front_right, front_left, rear_left, _ = height.T
    # Of four corners of a rectangle, the plane that fits best has the slopes between the means of opposite sides.
    ahead = (front_right + front_left - rear_right - rear_left) / (2 * (x1 - x0)) if x1 > x0 else np.zeros(len(height))
    left = (front_left + rear_left - front_right - rear_right) / (2 * (y1 - y0)) if y1 > y0 else np.zeros(len(height))
    middle = height[:, :4].mean(axis=1)
    places = np.concatenate([corners, corners.mean(axis=0, keepdims=True)]) - corners.mean(axis=0)
    plane = middle[:, None] + ahead[:, None] * places[:, 0] + left[:, None] * places[:, 1]
    lift = (height - plane).max(axis=1)
    one, none = np.ones(len(height)), np.zeros(len(height))
    x = np.stack([one, none, ahead], axis=1) / np.hypot(1.0, ahead)[:, None]
    z = np.stack([-ahead, -left, one], axis=1)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    poses[:, :3, :3] = product(poses[:, :3, :3], np.stack([x, np.cross(z, x), z], axis=2))
    at_origin = middle - ahead * corners.mean(axis=0)[0] - left * corners.mean(axis=0)[1] + lift
    poses[:, 2, 3] = at_origin
    poses[:, :3, 3] -= low * poses[:, :3, 2]


def _ground_of(run: Run) -> frozenset[str]:
    """Return the names of the objects that are the ground of a street, and so no obstacles."""
    return frozenset(() if run.ways is None else GROUND)


def _ground(run: Run, on: Sequence[str], place: Place) -> Scene:
    """Return the ground for objects as a scene."""
    objects = run.scene.objects
    missing = set(on) - {item.name for item in objects} - _ground_of(run)
    if missing:
        raise (place / "on").error(f"expected names of objects in the scene, got {min(missing)!r}")
    ground = Scene()
    for item in objects:
        if item.name in on:
            ground.add(item.shape, transform=item.transform)
    return ground


def _name(item: SceneObject) -> str:
    return item.name or f"object {item.id}"


def _is_solid(item: SceneObject) -> bool:
    """Return whether an object takes up a bounded space: it is not a plane, for example, nor an empty shape."""
    return bool(np.isfinite(item.shape.bounds).all())


def _obstacle(item: SceneObject, times: Floats) -> Outline:
    """Return the outline of an object in the scene; a motion is taken to be straight within a step."""
    if item.motion is None:
        return _fit_turned(item) or Outline(_corners(item.bounds)[None], *item.bounds[:, 2])
    first, last = item.motion.span
    poses = item.motion._native.at(np.clip(times, first, last))
    return _solid(poses, item.bounds)


def _fit_turned(item: SceneObject) -> Outline | None:
    """Return the outline of an object that is turned, which its bounds along x and y exceed."""
    place = item.transform
    if place is None:
        return None
    (a, b, c), (d, e, f), (g, h, _) = place[:3, :3].tolist()
    if c or f or g or h:
        return _fit_upright_box(item, place)
    if not b or a * e <= b * d:
        return None
    box = item.shape.bounds
    plan = product(_corners(box), place[:2, :2].T) + place[:2, 3]
    heights = np.sort(box[:, 2] * place[2, 2] + place[2, 3])
    return Outline(plan[None], float(heights[0]), float(heights[1]))


def _fit_upright_box(item: SceneObject, place: Floats) -> Outline:
    """Return the outline of the upright box around a tilted object, aligned with its axis that is longest in plan."""
    axes = place[:2, :3] / np.abs(place[:2, :3]).max()  # subnormal numbers have no exact lengths
    lengths = np.hypot(*axes)
    x, y = (axes[:, lengths.argmax()] / lengths.max()).tolist()
    turn = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
    bounds = item.shape._extent(product(turn, place[:3]))
    return Outline(product(_corners(bounds), turn[:2, :2])[None], *bounds[:, 2])


def _solid(poses: Floats, bounds: Floats) -> Outline:
    """Return the outline of a box with these bounds at poses, (…, k, 4, 4)."""
    solid = np.array([[x, y, z] for z in bounds[:, 2] for x, y in _corners(bounds)])  # the lower four first
    body = _move(poses, solid)
    bulge = bulge_of(np.linalg.norm(solid, axis=1).max(), turns_of(poses))
    heights = body[..., 2].min(axis=(-2, -1)) - bulge, body[..., 2].max(axis=(-2, -1)) + bulge
    return Outline(steps(body[..., :2]), *heights, bulge)


def _sensor(run: Run, times: Floats, clear: float) -> Obstacles:
    """Return a square around the sensor, or the body of the rig, at all times; empty if `clear` is 0."""
    return Obstacles([("", Outline(_square(_positions(run, times), clear), -np.inf, np.inf))] if clear else ())


def _positions(run: Run, times: Floats) -> Floats:
    """Return where the sensor, or the body of the rig, is at times, shape (k, 3); once if it stands still."""
    if not isinstance(run.pose, Trajectory):
        return np.asarray(run.pose)[None, :3, 3]
    first, last = run.pose.span
    positions: Floats = run.pose.at(np.clip(times, first, last)).translation
    return positions


def _square(positions: Floats, half: float) -> Floats:
    """Return the corners of squares around positions in each step."""
    square = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return steps(positions[:, None, :2] + square)
