"""The keys of a group of objects to scatter, and their checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from lidarsim.config.factories import Model, either
from lidarsim.config.objects import Mesh, SceneFile, ask_size
from lidarsim.datasets.draws import Draw, DrawOr, Stream, draw_number
from lidarsim.datasets.scatter._instances import AnyItem, PlacedPart, instance_of
from lidarsim.datasets.scatter._paths import Path, path_of
from lidarsim.world.scene import Scene

if TYPE_CHECKING:
    from lidarsim.config.document import Place
    from lidarsim.worlds import Ways

__all__ = ["Scatter"]

FAR = 1e9
"""Greatest coordinate, length, angle (degrees) and speed, so that sums and products stay in float64's range."""

MOST_OBJECTS = 10_000
"""Greatest number of objects in a group: each is compared with all others at every place tried."""

MOST_POINTS = 10_000
"""Greatest number of points of a path, and of rows of a speed."""

RANGES = {
    "count": (0.0, MOST_OBJECTS),
    "offset_m": (-FAR, FAR),
    "yaw_deg": (-FAR, FAR),
    "scale": (1 / FAR, FAR),
    "speed_m_per_s": (-FAR, FAR),
}
"""Least and greatest value of each drawable number."""

Coordinate = Annotated[float, Field(ge=-FAR, le=FAR)]
Point = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
SpeedRow = Annotated[list[Annotated[float, Field(ge=0, le=FAR)]], Field(min_length=2, max_length=2)]

PathPoints = Annotated[list[Point], Field(min_length=2, max_length=MOST_POINTS)]


def _is_nested(value: object) -> bool:
    """Return whether a value is a list of paths, and not the points of one."""
    inner = value[0] if isinstance(value, list) and value else None
    return isinstance(inner, list) and bool(inner) and isinstance(inner[0], list)


if TYPE_CHECKING:
    SpeedOverTime = DrawOr | list[SpeedRow]
    Paths = list[Point] | list[list[Point]]
else:
    Paths = either(PathPoints, Annotated[list[PathPoints], Field(min_length=1, max_length=MOST_POINTS)], _is_nested)
    SpeedOverTime = either(
        DrawOr,
        Annotated[list[SpeedRow], Field(min_length=1, max_length=MOST_POINTS)],
        lambda value: isinstance(value, list),
    )


WayName = Literal["lanes", "turns", "pavements", "crossings"]

if TYPE_CHECKING:
    AlongWays = WayName | list[WayName]
else:
    AlongWays = either(WayName, Annotated[list[WayName], Field(min_length=1)], lambda value: isinstance(value, list))


class Scatter(Model):
    """A group of objects; each is one of `objects`."""

    objects: Annotated[list[AnyItem], Field(min_length=1)]
    """Objects without a `motion`, of which each member is one. One with `files: models/*.glb` stands for any match."""
    weights: list[Annotated[float, Field(gt=0, le=FAR)]] | None = None
    """Weight of each object; each match of `files` is an object. Default: equal."""
    on: Annotated[list[str], Field(min_length=1)]
    """Names of the scene objects on which the entire outline stands."""
    count: DrawOr
    """Number of members, up to 10,000. Those without room are left out and counted."""
    area_m: Annotated[list[Point], Field(min_length=2, max_length=2)] | None = None
    """Two corners of the rectangle of their origins."""
    along_m: Paths | None = None
    """Instead: points of a path, or a list of paths, of which each member takes one."""
    along: AlongWays | None = None
    """Instead: ways of a street, of which each member takes one."""
    interpolation: Literal["linear", "spline"] = "linear"
    """Between the points of `along_m`."""
    offset_m: DrawOr = 0.0
    """Distance to the left of the path."""
    yaw_deg: DrawOr = 0.0
    """Heading relative to the x axis or the path. Those that head back follow their path backwards."""
    scale: DrawOr = 1.0
    """Scale factor."""
    speed_m_per_s: SpeedOverTime = 0.0
    """Speed ahead. Negative: in an area, they reverse; on a path, they turn around and come. Or rows of time and speed,
    linear in between."""
    tilt: bool = False
    """Pitch and roll with the ground, as vehicles do."""
    gap_m: Annotated[float, Field(ge=0, le=FAR)] = 0.0
    """Least distance from other members, at all times; on paths, ahead and behind alone."""
    clear_m: Annotated[float, Field(ge=0, le=FAR)] = 0.0
    """Least distance from the sensor, or the body of the rig, at all times."""

    @cached_property
    def paths(self) -> list[Path]:
        """The paths along which the objects are placed; none in an area."""
        given = self.along_m or []
        return [
            path_of(np.asarray(points), self.interpolation)
            for points in (given if _is_nested(given) else [given] if given else [])
        ]

    def on_ways(self, ways: Ways | None, place: Place) -> Scatter | None:
        """Return the group with the ways of a street as its paths, if it is placed along them; None if it has none."""
        if self.along is None:
            return self
        if ways is None:
            raise (place / "along").error("expected along_m or area_m, since the scene is not a street")
        names = [self.along] if isinstance(self.along, str) else self.along
        paths = [Path(line[:, :2]) for name in names for line in getattr(ways, name)]
        # They replace the cached property, which computes the paths of `along_m`.
        return self.model_copy(update={"along": None, "paths": paths}) if paths else None

    def check(self, place: Place) -> None:
        """Raise an error if keys contradict each other, or if an object cannot be built and placed."""
        given_keys = [key for key in ("area_m", "along_m", "along") if getattr(self, key) is not None]
        if len(given_keys) != 1:
            raise place.error(f"expected one of area_m, along_m and along, got {' and '.join(given_keys) or 'none'}")
        if self.weights is not None and len(self.weights) != len(self.objects):
            raise (place / "weights").error(
                f"expected one for each of {len(self.objects)} objects and matches of files, got {len(self.weights)}"
            )
        if self.along_m is None and self.interpolation != "linear":
            raise (place / "interpolation").error(f"expected along_m beside it, got {given_keys[0]}")
        there = place / "along_m"
        given: Sequence[Any] = self.along_m or ()
        if _is_nested(given):
            for index, points in enumerate(given):
                self._check_path(points, there / index)
        else:
            self._check_path(given, there)
        for key in RANGES:
            self._check_number(key, place / key)
        if self.area_m is not None and self.offset_m != 0.0:
            raise (place / "offset_m").error("expected along_m or along beside it, got area_m")
        for index, item in enumerate(self.objects):
            _check_instance(item, place / "objects" / index)
            if isinstance(item, Mesh | SceneFile):
                ask_size(item, place / "objects" / index, _middle(self.scale))

    def _check_path(self, points: Sequence[Any], place: Place) -> None:
        for index, (point, after) in enumerate(pairwise(points)):
            if not math.dist(point, after) >= 1 / FAR:
                error = "expected points that differ from one to the next"
                raise (place / (index + 1)).error(f"{error}, by {1 / FAR:g} m at least")
        if self.interpolation == "spline" and not (path_of(np.asarray(points), "spline").lengths > 0).all():
            raise place.error("expected points that a spline can join, got some too near to each other")

    def _check_number(self, key: str, place: Place) -> None:
        value = getattr(self, key)
        if isinstance(value, list):
            for index, (row, after) in enumerate(pairwise(value)):
                if not row[0] < after[0]:
                    raise (place / (index + 1) / 0).error(f"expected rising times, got {after[0]} after {row[0]}")
            return
        if not isinstance(value, Draw):
            _expect(key, value, place)
            if key == "count" and value != int(value):
                raise place.error(f"expected an integer, got {value}")
            return
        value.check(place, numbers=True)
        for end in value.ends or (value.normal or ())[:1]:
            _expect(key, end, place)

    def draw(self, key: str, stream: Stream, place: Place) -> float:
        """Return the value of a number, drawn if necessary, after checking its range."""
        value = draw_number(getattr(self, key), stream)
        if key == "count":  # normal numbers may be negative
            value = max(value, 0.0)
        _expect(key, value, place / key)
        return value


def _check_instance(item: AnyItem, place: Place) -> None:
    """Raise an error if an instance cannot be built, or is unbounded or too large."""
    scene = Scene()
    instance = instance_of(item, place)
    for part in instance.parts:
        PlacedPart(part, part.affine, None).add_to(scene, place, 0)
    for built in scene.objects:
        if not built.shape.bounded:
            raise place.error("expected a bounded object, got an unbounded one")
        size = np.abs(built.bounds).max()
        if not size <= FAR:
            raise place.error(f"expected an object within {FAR:g} m of its origin, got one of {size:g} m")


def _middle(value: float | Draw) -> float:
    """Return a number, or the middle of those that may be drawn."""
    if not isinstance(value, Draw):
        return value
    return float(np.mean(value.ends or (value.normal or ())[:1]))


def _expect(key: str, value: float, place: Place) -> None:
    least, greatest = RANGES[key]
    if not least <= value <= greatest:
        raise place.error(f"expected a number from {least:g} to {greatest:g}, got {value:g}")
