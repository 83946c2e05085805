"""The description of a lidar sensor: a scan pattern, a range gate and measurement errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, fields
from functools import cached_property

import numpy as np

from lidarsim import _native
from lidarsim._base.pickling import Pickled
from lidarsim._base.shown import short, text_table
from lidarsim._base.validation import ask_above, each_ring, real, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.patterns import Pattern
from lidarsim.patterns._pulses import check_pattern, pulses_of
from lidarsim.patterns.description import field_of_view
from lidarsim.sensor.imu import sensor_name
from lidarsim.sensor.measurement import Measurement

FARTHEST = {"min_range": 1e3, "max_range": 1e5}
"""Limits of ranges, m, beyond which the unit is probably another one."""

MOST_ROWS = 14  # maximum lines of a repr below its title


@dataclass(frozen=True)
class Sensor(Pickled):
    """What a lidar sensor is; `lidarsim.Lidar` documents the parameters, and adds what scans with it."""

    pattern: Pattern
    _: KW_ONLY
    measurement: Measurement = field(default_factory=Measurement)
    min_range: float = 0.0
    max_range: float = math.inf
    range_offset: float | Sequence[float] = 0.0
    name: str = ""
    model: str = ""

    def __post_init__(self) -> None:
        """Check the arguments."""
        check_pattern(self.pattern)
        if not isinstance(self.measurement, Measurement):
            raise ArgumentTypeError("measurement", "a Measurement", short_repr(self.measurement))
        sensor_name(self.name)
        if not isinstance(self.model, str):
            raise ArgumentTypeError("model", "a string", short_repr(self.model))
        object.__setattr__(self, "model", self.model or self.name)
        object.__setattr__(self, "min_range", real("min_range", self.min_range, at_least=0.0))
        object.__setattr__(self, "max_range", real("max_range", self.max_range, at_least=self.min_range, infinite=True))
        for name, most in FARTHEST.items():
            ask_above(name, getattr(self, name), most, "m", "mm?")
        if self.measurement.false_returns > 0.0 and self.max_range == math.inf:
            raise ArgumentValueError(
                "max_range", "a finite number with false_returns", "inf", "they are uniform over the range gate"
            )
        object.__setattr__(self, "range_offset", each_ring("range_offset", self.range_offset))
        _check_rings("range_offset", self.range_offset, self.pattern)
        _check_rings("range_bias", self.measurement.range_bias, self.pattern)

    def __repr__(self) -> str:
        """Return the main figures of the datasheet and the active effects."""
        rings, columns = self.pattern.shape
        azimuth, elevation = field_of_view(pulses_of(self.pattern, 0))
        effects = [
            f"{item.name}={short(getattr(self.measurement, item.name))}"
            for item in fields(Measurement)
            if getattr(self.measurement, item.name) != item.default
        ]
        rows = [
            ("pattern", f"{type(self.pattern).__name__}, {rings:,} × {columns:,} at {self.pattern.rate:g} Hz"),
            ("azimuth", "{:.4g}° to {:.4g}°".format(*np.degrees(azimuth))),
            ("elevation", "{:.4g}° to {:.4g}°".format(*np.degrees(elevation))),
            ("range", f"{self.min_range:g} to {self.max_range:g} m"),
            *(("" if i else "effects", effect) for i, effect in enumerate(effects or ["none"])),
        ]
        if len(rows) > MOST_ROWS:
            rows[MOST_ROWS - 1 :] = [("", f"and {len(rows) - MOST_ROWS + 1} more")]
        return text_table(f"{type(self).__name__} {self.name}".rstrip(), rows)

    @cached_property
    def _receiver(self) -> _native.Receiver:
        """The measurement in the core."""
        return _native.Receiver(self)


def _check_rings(name: str, value: float | Sequence[float], pattern: Pattern) -> None:
    """Raise `ArgumentValueError` if a pattern has not as many rings as a value has numbers."""
    rings = pattern.shape[0]
    if isinstance(value, Sequence) and len(value) != rings:
        raise ArgumentValueError(name, f"one number, or one per ring ({rings})", len(value))
