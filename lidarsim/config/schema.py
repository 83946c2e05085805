"""Models of configurations as a whole: a run, and scenes in files of their own."""

from __future__ import annotations

import dataclasses
import math
import re
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from lidarsim._base import validation
from lidarsim.config.factories import Finite, Model, construct
from lidarsim.config.objects import AnyScene
from lidarsim.config.poses import Pose, PoseOfRun
from lidarsim.config.sensors import AnySensor, Mounted, Sensor
from lidarsim.motion.georeference import Georeference as OnEarth
from lidarsim.motion.georeference import gps_time, projected_crs
from lidarsim.run import CloudArguments
from lidarsim.world.atmosphere import Atmosphere

if TYPE_CHECKING:
    from lidarsim.config.document import Place


class Cloud(Model):
    """Coordinate frame and deskewing of the written points."""

    frame: Literal["sensor", "world"] = "sensor"
    """Coordinates of the points."""
    deskew: bool | Literal["start", "middle", "end"] = False
    """The time to which points are deskewed by the true poses: `true` stands for `start`."""
    deskew_s: Finite | None = None
    """The same as seconds after the start of the frame."""

    @field_validator("deskew", mode="before")
    @classmethod
    def _name(cls, value: object) -> object:
        if not isinstance(value, bool) and value not in ("start", "middle", "end"):
            expected = "expected true, false, start, middle, end, or seconds as deskew_s, got {got}"
            raise PydanticCustomError("deskew", expected, {"got": validation.short_repr(value)})
        return value

    def build(self, place: Place) -> CloudArguments:
        """Return the arguments of `Scan.point_cloud`."""
        if self.deskew_s is None:
            return {"frame": self.frame, "deskew": self.deskew}
        if "deskew" in self.model_fields_set:
            raise (place / "deskew_s").error("expected either deskew or deskew_s, got both")
        return {"frame": self.frame, "deskew": self.deskew_s}


class Origin(Model):
    """Where the origin of a world is on the Earth."""

    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    altitude_m: float = 0.0

    def build(self, place: Place) -> tuple[float, float, float]:
        """Return latitude and longitude, rad, and altitude, m."""
        origin = math.radians(self.latitude_deg), math.radians(self.longitude_deg), self.altitude_m
        with place.refusals({"origin[2]": ("altitude_m", "")}):
            OnEarth(origin=origin)
        return origin


class Georeference(Model):
    """Where the world is on the Earth, and the start of the run, for GNSS receivers and for files that hold them."""

    crs: int | str | None = None
    """Coordinate reference system of the world, in m: an EPSG code such as `EPSG:25832`, or WKT. Needs `[geo]`."""
    origin: Origin | None = None
    """Place of the world's origin on WGS 84, with x to the east, y to the north and z up; instead of `crs`."""
    start: str | None = None
    """The moment of time 0 with its zone. LAS and LAZ files count GPS time from it, bags and packets Unix time."""

    def build(self, place: Place) -> tuple[int | str | None, float | datetime]:
        """Return the system and the start, after checking them."""
        if self.crs is not None:
            if self.origin is not None:
                raise (place / "origin").error("expected either crs or origin, got both")
            with (place / "crs").refusals({"crs": ("", "")}):
                projected_crs(self.crs)
        if self.start is None:
            return self.crs, 0.0
        try:
            start = datetime.fromisoformat(self.start)
        except ValueError:
            got = validation.short_repr(self.start)
            raise (place / "start").error(f"expected a moment such as 2026-05-01T10:00:00+02:00, got {got}") from None
        with place.refusals({"start": ("start", "")}):
            gps_time(start)
        return self.crs, start


def names_by_label(names: dict[str, str], place: Place) -> dict[int, str]:
    """Return class names by integer label."""
    for label in names:
        if re.fullmatch(r"0|[1-9][0-9]{0,9}", label) is None or int(label) > validation.UINT32:
            raise (place / label).error("expected a label, 0 to 4294967295")
    return {int(label): name for label, name in names.items()}


class Fog(Model):
    """Fog."""

    visibility_m: float


class Precipitation(Model):
    """Rain or snow."""

    rate_mm_per_h: float


class Air(Model):
    """The atmosphere of a scene: of fog, rain or snow, whose values its other keys replace."""

    fog: Fog | None = None
    """Fog of this visibility, m."""
    rain: Precipitation | None = None
    """Rain of this rate."""
    snow: Precipitation | None = None
    """Snow of this rate, as water."""
    extinction_per_m: float = 0.0
    backscatter_per_m_sr: float = 0.0
    label: int = 0
    aperture_mm: float = 10.0
    divergence_mrad: float = 3.0

    def build(self, place: Place) -> Atmosphere:
        """Return the atmosphere."""
        kinds = [name for name in ("fog", "rain", "snow") if getattr(self, name) is not None]
        if len(kinds) > 1:
            raise (place / kinds[1]).error(f"expected one of fog, rain and snow, got {kinds[0]} beside it")
        air = Atmosphere()
        for name in kinds:
            model = getattr(self, name)
            air = construct(getattr(Atmosphere, name), model, type(model).model_fields, place / name)
        keys = set(type(self).model_fields) - {"fog", "rain", "snow"}
        return construct(partial(dataclasses.replace, air), self, keys, place)


class SceneDocument(Model):
    """A scene in a separate file; its objects are checked with the run."""

    scene: list[object] | dict[str, object]
    class_names: dict[str, str] = {}
    atmosphere: object = None


class Config(Model):
    """A run: scene, sensor or rig, pose and frames."""

    scene: AnyScene
    """What is scanned; or the `{file: …}` of such a list, alone or as `scene` beside `class_names` and `atmosphere`.
    Keys beside `file` override single values of the file: `{file: city.yaml, street: {length_m: 500}}`."""
    class_names: dict[str, str] = {}
    """Names of labels, for legends and files: `{1: car, 2: person}`. They override those of a scene file."""
    atmosphere: Air | None = None
    """The air, instead of that of a scene file. Default: clear."""
    sensor: AnySensor | None = None
    """What scans; or `rig`."""
    rig: dict[str, Mounted] | None = None
    """Several sensors, IMUs and GNSS receivers on one body, by name."""
    pose: PoseOfRun = Pose()
    """Pose of the sensor, or of the body of the rig. Default: the origin."""
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    """Seed of all noise."""
    first_frame: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Number of the first frame. Frame k starts at k / rate, for a rig with the rate of its fastest sensor."""
    frames: Annotated[int, Field(ge=1, le=2**32)] = 1
    """Number of frames; of each station, and not for strips."""
    cloud: Cloud = Cloud()
    """How points are written."""
    georeference: Georeference = Georeference()
    """Where and when the run is. GNSS receivers need it."""

    @classmethod
    def nearest(cls, key: str) -> list[str]:
        """Return the keys that `key` may stand for: one of a sensor, whose file is not a run, or a misspelt one."""
        return [f"sensor.{key}"] if key in {*Sensor.model_fields, "preset"} else super().nearest(key)
