"""Models of sensors and rigs."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from functools import partial, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator

from lidarsim import patterns
from lidarsim._base.files import check_names, name_problem
from lidarsim.config.factories import (
    Finite,
    Model,
    Numbers,
    Part,
    Vector,
    construct,
    either,
    has,
    model_of,
    models_of,
    public,
)
from lidarsim.config.poses import Placement, build_rigid
from lidarsim.lidar import Lidar
from lidarsim.rig import Rig
from lidarsim.sensor.gnss import Gnss
from lidarsim.sensor.imu import GRAVITY, Imu, ImuErrors
from lidarsim.sensor.measurement import Measurement

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.config.document import Place
    from lidarsim.patterns import Pattern


class Table(Part):
    """Directions listed in a CSV or NPY file."""

    constructor = patterns.Table

    type: Literal["table"]
    file: str
    """CSV or NPY of directions."""
    rate_hz: float
    pulse_rate_khz: float | None = None
    """Pulses per second, for a file without times."""

    def build(self, place: Place) -> Pattern:
        """Return the pattern."""
        path = (place / "file").file(self.file)
        return construct(patterns.Table.from_file, self, ["rate_hz", "pulse_rate_khz"], place, path=path)


PATTERNS: dict[str, type[Part]] = {
    "table": Table,
    **models_of((item for item in public(patterns) if hasattr(item, "pulses")), "type", Part),
}


if TYPE_CHECKING:
    AnyPattern = Part
else:
    AnyPattern = Annotated[reduce(or_, PATTERNS.values()), Discriminator("type")]


_EXACT = Measurement()


class Effects(model_of(Measurement)):  # type: ignore[misc]
    """Noise and other effects, all off by default."""

    def build(self, place: Place, base: Measurement = _EXACT) -> Measurement:
        """Return `base` with the given effects."""
        return construct(partial(dataclasses.replace, base), self, Measurement.configuration, place)


class _Limits(Model):
    name: str = ""
    """Sensors of different names draw different noise."""
    measurement: Effects = Effects()
    """Noise and other effects."""
    min_range_m: float = 0.0
    """Least range that is reported."""
    max_range_m: float = float("inf")
    """Greatest range that is reported."""
    range_offset_m: Numbers = 0.0
    """Range that the sensor reports minus range from the beam's origin: one number, or one per ring."""


_LIMITS = _Limits.model_fields.keys() - {"measurement"}


class Measured(Model):
    """What measurements of a real unit found, where that differs from `datasheet_noise` and the limits."""

    measurement: Effects = Effects()
    min_range_m: float = 0.0
    max_range_m: float = float("inf")


class Sensor(_Limits):
    """A lidar: its own `pattern`, or a `preset` with its `mode` and `noise`, or a `file`, and the keys that differ.

    `noise` is `none`, `datasheet` or `measured`. With a preset or a file, `datasheet_noise`, `measured` and `modes` are
    merged in on request; `sources` cites the numbers.
    """

    pattern: AnyPattern
    """Directions and times of the pulses: `type` and its keys. A preset has one."""
    model: str = ""
    """Selects packets, and the point layout in bags. Default: the preset, else the name."""
    description: str = ""
    """For people."""
    datasheet_noise: Effects | None = None
    """The `measurement` that `noise: datasheet` enables."""
    measured: Measured | None = None
    """What `noise: measured` merges over `datasheet_noise` and the range gate."""
    modes: dict[str, dict[str, Any]] = {}
    """Changes by name, of which `mode` selects one."""
    datasheet: dict[str, Any] = {}
    """Figures of the data sheet, for people."""
    sources: dict[str, str] = {}
    """Sources of the values, for people."""

    @classmethod
    def keys(cls) -> Collection[str]:
        """Return the keys of a sensor, and those that the loader resolves into them."""
        return "preset", "file", "mode", "noise", *cls.model_fields

    def build(self, place: Place) -> Lidar:
        """Return the lidar."""
        parts = {
            "pattern": self.pattern.build(place / "pattern"),
            "measurement": self.measurement.build(place / "measurement"),
        }
        return construct(Lidar, self, _LIMITS | {"model"}, place, **parts)


class VendorSensor(_Limits):
    """A lidar from a YAML file or a vendor's own, with values that the file lacks and changes to it."""

    file: str
    """A sensor in YAML, calibration of Velodyne, Hesai or RoboSense, metadata of Ouster, or times of Livox."""
    mode: str | None = None
    """One of the modes of its model."""
    model: str | None = None
    """Model, if the file does not state it."""
    noise: Literal["none", "datasheet", "measured"] = "none"
    """Noise of the preset of its model."""
    rate_hz: float | None = None
    """Frames per second, if the file does not state it."""
    pulse_rate_khz: float | None = None
    """Pulses per second, likewise."""
    firing_times: str | None = None
    """A file of firing times, likewise."""

    def build(self, place: Place) -> Lidar:
        """Return the lidar."""
        files: dict[str, object] = {"path": (place / "file").file(self.file)}
        if self.firing_times is not None:
            files["firing_times"] = (place / "firing_times").file(self.firing_times)
        if self.noise != "none":
            files["noise"] = self.noise
        lidar = construct(Lidar.from_file, self, ["mode", "model", "rate_hz", "pulse_rate_khz"], place, **files)
        measurement = self.measurement.build(place / "measurement", lidar.measurement)
        differ = partial(dataclasses.replace, lidar)
        return construct(differ, self, _LIMITS, place, measurement=measurement)


if TYPE_CHECKING:
    AnySensor = Sensor | VendorSensor
else:
    AnySensor = either(Sensor, VendorSensor, has("file"))


class _Errors(Model):
    """Errors of the gyroscopes or accelerometers of an IMU."""

    def build(self, place: Place) -> ImuErrors:
        """Return the errors."""
        return construct(ImuErrors, self, type(self).model_fields, place)


class Gyroscope(_Errors):
    """Errors of the gyroscopes of an IMU."""

    noise_density_deg_per_s_per_sqrt_hz: float = 0.0
    bias_instability_deg_per_h: float = 0.0
    random_walk_deg_per_s2_per_sqrt_hz: float = 0.0
    bias_deg_per_s: float = 0.0
    scale_factor: float = 0.0
    misalignment_deg: float = 0.0
    range_deg_per_s: float = float("inf")


class Accelerometer(_Errors):
    """Errors of the accelerometers of an IMU."""

    noise_density_m_per_s2_per_sqrt_hz: float = 0.0
    bias_instability_m_per_s2: float = 0.0
    random_walk_m_per_s3_per_sqrt_hz: float = 0.0
    bias_m_per_s2: float = 0.0
    scale_factor: float = 0.0
    misalignment_deg: float = 0.0
    range_m_per_s2: float = float("inf")


class InertialUnit(Model):
    """An IMU."""

    rate_hz: float
    gyroscope: Gyroscope = Gyroscope()
    """Errors of the gyroscopes."""
    accelerometer: Accelerometer = Accelerometer()
    """Errors of the accelerometers."""
    gravity_m_per_s2: float = GRAVITY
    latitude_deg: float | None = None

    def build(self, place: Place, name: str, mount: Floats) -> Imu:
        """Return the IMU of this name and pose on the body."""
        errors = {
            "gyroscope": self.gyroscope.build(place / "gyroscope"),
            "accelerometer": self.accelerometer.build(place / "accelerometer"),
        }
        keys = type(self).model_fields.keys() - errors
        return construct(Imu, self, keys, place, name=name, mount=mount, **errors)


class Receiver(Model):
    """A GNSS receiver."""

    rate_hz: float
    position_sigma_m: float | Vector = 0.0
    drift_sigma_m: float | Vector = 0.0
    drift_time_s: float = 300.0

    def build(self, place: Place, name: str, mount: Floats) -> Gnss:
        """Return the receiver of this name and pose on the body."""
        return construct(Gnss, self, type(self).model_fields, place, name=name, mount=mount)


class Mounted(Placement):
    """A lidar, an IMU or a GNSS receiver of a rig: its placement on the body, and the delay of a lidar's frames."""

    sensor: AnySensor | None = None
    """A lidar,"""
    imu: InertialUnit | None = None
    """or an IMU,"""
    gnss: Receiver | None = None
    """or a GNSS receiver, whose position is that of the antenna."""
    offset_s: Finite | None = None
    """Of a lidar: its frame k starts at k / rate plus this."""

    def build(self, place: Place, name: str) -> tuple[Any, ...]:
        """Return the member of the rig of this name."""
        if expected := name_problem(name):  # files get this name
            raise place.error(f"expected {expected}")
        mount = build_rigid(self, place)
        kinds = [kind for kind in ("imu", "gnss", "sensor") if getattr(self, kind) is not None]
        if not kinds:
            raise place.error("missing key 'sensor', 'imu' or 'gnss'")
        kind, *more = kinds
        for key in [*more, *(["offset_s"] if "offset_s" in self.model_fields_set and kind != "sensor" else [])]:
            raise (place / key).error(f"expected none beside {'an imu' if kind == 'imu' else 'a gnss'}")
        if self.sensor is not None:
            return self.sensor.build(place / "sensor"), mount, self.offset_s or 0.0
        return getattr(self, kind).build(place / kind, name, mount), None


def build_rig(sensors: dict[str, Mounted], place: Place) -> Rig:
    """Return the rig of these sensors."""
    parts = {name: member.build(place / name, name) for name, member in sensors.items()}
    with place.refusals():
        check_names("sensors", parts)
        return Rig(parts)
