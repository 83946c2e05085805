"""Scans of 2D lidars as ROS has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidarsim._base.pickling import Pickled
from lidarsim._base.shown import quantity
from lidarsim.errors import ArgumentValueError
from lidarsim.patterns import Pulses
from lidarsim.sensor.sensor import Sensor

SPREAD = 1e-3
"""Largest deviation of a beam from an equal step that counts as equal, in steps: ROS stores angles as float32."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LaserScan(Pickled):
    """The ranges of one turn of a 2D lidar, with the fields of ROS's ``sensor_msgs/LaserScan``.

    Angles are counter-clockwise about z from x of the sensor frame, and increase from entry to entry.

    Attributes
    ----------
    angle_min, angle_max : float
        Angles of the first and the last entry, rad.
    angle_increment : float
        Angle between entries, rad.
    time_increment : float
        Time between entries, s; negative for a sensor that turns clockwise, whose first entry is measured last.
    scan_time : float
        Period of the scans, s.
    range_min, range_max : float
        Limits of the sensor's range, m.
    ranges : ndarray of float32, shape (n,)
        m. As ROS defines it (REP 117), infinity where there is no return, and minus infinity where it is nearer than
        `range_min`.
    intensities : ndarray of float32, shape (n,)
        Intensity as in a `Scan`; 0 where there is no return.
    time : float
        Time of the first entry, s: that of ROS's header.
    """

    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: npt.NDArray[np.float32]
    intensities: npt.NDArray[np.float32]
    time: float = 0.0

    @property
    def angles(self) -> npt.NDArray[np.float64]:
        """Angle of each entry, rad: ndarray of float64, shape (n,)."""
        return self.angle_min + self.angle_increment * np.arange(len(self.ranges), dtype=np.float64)

    def __len__(self) -> int:
        """Return the number of entries."""
        return len(self.ranges)


def laser_scan_of(
    sensor: Sensor,
    pulses: Pulses,
    start: float,
    *,
    ranges: npt.NDArray[np.float64],
    intensities: npt.NDArray[np.float32],
    too_near: npt.NDArray[np.bool_],
) -> LaserScan:
    """Return a scan as documented in `lidarsim.Scan.laser_scan`.

    Of each pulse: its range, NaN where it has no return, its intensity, and whether it is below the minimum range.
    """
    n = len(ranges)
    rings = np.unique(pulses.ring)
    if n < 2 or len(rings) > 1:
        got = quantity(n, "pulse") if n < 2 else f"{len(rings)} rings"
        raise ArgumentValueError("scan", "one of a 2D lidar: one ring of at least two pulses", got)
    if pulses.directions[:, 2].any() or pulses.origins.any():
        i = int(np.argmax((pulses.directions[:, 2] != 0.0) | pulses.origins.any(axis=1)))
        got = f"pulse {i} from {pulses.origins[i].tolist()} along {pulses.directions[i].tolist()}"
        raise ArgumentValueError("scan", "one of a 2D lidar: pulses in the plane z = 0, from its middle", got)
    azimuths = np.unwrap(np.arctan2(pulses.directions[:, 1], pulses.directions[:, 0]))
    backwards = bool(azimuths[-1] < azimuths[0])
    order = slice(None, None, -1) if backwards else slice(None)
    azimuths, times = azimuths[order], pulses.time[order]
    first = float(np.arctan2(np.sin(azimuths[0]), np.cos(azimuths[0])))  # a full turn may have begun at pi
    step = float(azimuths[-1] - azimuths[0]) / (n - 1)
    off = np.abs(azimuths - azimuths[0] - step * np.arange(n))
    if not off.max() <= SPREAD * step:
        i = int(np.argmax(off))
        got = f"beam {i} of {n} off by {np.degrees(off[i]):.3g}° with steps of {np.degrees(step):.3g}°"
        raise ArgumentValueError("scan", "one of beams in equal steps of azimuth", got)
    found = ranges[order].astype(np.float32)
    missing = np.isnan(found)
    found[missing] = np.inf
    found[too_near[order]] = -np.inf
    return LaserScan(
        first,
        first + step * (n - 1),
        step,
        float(times[-1] - times[0]) / (n - 1),
        1.0 / sensor.pattern.rate,
        sensor.min_range,
        sensor.max_range,
        found,
        np.where(missing, np.float32(0.0), intensities[order]),
        start + float(times[0]),
    )
