"""GNSS receivers: positions along a trajectory, as latitude, longitude and altitude."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from datetime import datetime

import numpy as np
import numpy.typing as npt

from lidarsim._base import validation
from lidarsim._base.files import PathLike
from lidarsim._base.pickling import Value
from lidarsim._base.validation import Floats
from lidarsim._base.vectors import sigmas_of_axes
from lidarsim.errors import ArgumentTypeError
from lidarsim.motion.georeference import Georeference
from lidarsim.motion.trajectory import Trajectory
from lidarsim.sensor.imu import (
    RECEIVER,
    Samples,
    gauss_markov,
    load_rows,
    noise_bits,
    sample_times,
    save_rows,
    sensor_name,
)

HEADER = "#timestamp [ns],latitude [deg],longitude [deg],altitude [m]"


@dataclass(frozen=True, slots=True, eq=False)
class Gnss(Value):
    """GNSS receiver: measures the position of its antenna at a fixed rate.

    Parameters
    ----------
    rate : float
        Fixes per second, Hz.
    mount : RigidTransform or array_like, shape (4, 4), optional
        Pose of the antenna on the body, antenna to body; its translation is the lever arm. Default: the identity.
    position_sigma : float or array_like, shape (3,)
        Standard deviation of the white noise of a fix, the same or to the east, to the north and up, m.
    drift_sigma : float or array_like, shape (3,)
        Standard deviation of the slow error, of satellite orbits, atmosphere and multipath, likewise, m.
    drift_time : float
        Time after which the correlation of the slow error has fallen to 1/e, s.
    name : str
        Name, from which its errors derive: two receivers of different names draw different errors.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or is out of its range.

    Notes
    -----
    The slow error is a stationary first-order Gauss-Markov process on each axis (A. Gelb, Applied Optimal Estimation,
    1974, section 3.8). Errors are added along the axes of the world, which point to the east, to the north and up where
    it is georeferenced.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> drive = ls.Trajectory.from_twist(np.eye(4), linear=(10, 0, 0))
    >>> munich = ls.Georeference(origin=(math.radians(48.137), math.radians(11.575), 520.0))
    >>> fixes = ls.Gnss(5.0).measure(drive, munich, end=1.0)
    >>> [f"{math.degrees(angle):.6f}" for angle in fixes.longitude]
    ['11.575000', '11.575027', '11.575054', '11.575081', '11.575107', '11.575134']
    """

    rate: float
    _: KW_ONLY
    mount: Floats = None  # type: ignore[assignment]
    position_sigma: npt.ArrayLike = 0.0
    drift_sigma: npt.ArrayLike = 0.0
    drift_time: float = 300.0
    name: str = "gnss"

    def __post_init__(self) -> None:
        """Check the arguments."""
        set_ = object.__setattr__
        set_(self, "rate", validation.frequency("rate", self.rate))
        set_(self, "mount", validation.freeze(validation.optional_pose("mount", self.mount)))
        for name in ("position_sigma", "drift_sigma"):
            set_(self, name, validation.freeze(sigmas_of_axes(name, getattr(self, name))))
        set_(self, "drift_time", validation.real("drift_time", self.drift_time, above=0.0))
        sensor_name(self.name)

    def measure(
        self,
        trajectory: Trajectory,
        georeference: Georeference,
        *,
        start: float | None = None,
        end: float | None = None,
        seed: int = 0,
    ) -> GnssFixes:
        """Measure along the trajectory of the body.

        Parameters
        ----------
        trajectory : Trajectory
            The body's pose, body to world. A body at rest is ``Trajectory.from_twist(pose)``.
        georeference : Georeference
            Where the world is on the Earth.
        start, end : float, optional
            Time of the first fix and of the last fix at the latest, s. Default: those of the trajectory; a constant
            twist needs both `end` and, unless it is 0, `start`.
        seed : int
            Seed of the errors, 0 to 2⁶⁴ − 1.

        Returns
        -------
        GnssFixes
            Fixes at start + k/rate.

        Raises
        ------
        TypeError, ValueError
            If the trajectory does not cover the times or has no end, there would be more than ten million fixes, or the
            trajectory leaves the area of the coordinate reference system.

        Notes
        -----
        Errors depend on the seed, the name and the time of the first fix, in whole ns, so that those of measurements
        with other starts, such as the strips of a survey, are independent. The slow error, too, begins anew with each
        measurement: measure once, and take parts with `GnssFixes.between`, for one that goes on from one part to the
        next.
        """
        times = sample_times(trajectory, self.rate, start, end)
        if not isinstance(georeference, Georeference):
            raise ArgumentTypeError("georeference", "a Georeference", validation.short_repr(georeference))
        seed = validation.integer("seed", seed, at_least=0, at_most=2**64 - 1)
        position = (trajectory @ self.mount).at(times).as_matrix()[:, :3, 3]
        steps = math.inf, 1.0 / (self.rate * self.drift_time)
        for kind, (given, step) in enumerate(zip((self.position_sigma, self.drift_sigma), steps, strict=True)):
            sigma = np.asarray(given, np.float64)
            if sigma.any():
                bits = noise_bits(seed, self.name, RECEIVER + kind, times[0])
                position = position + sigma * gauss_markov(bits, len(times), np.array([step]))
        return GnssFixes(times, *georeference.geodetic(position), self)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GnssFixes(Samples):
    """Fixes of a GNSS receiver.

    Attributes
    ----------
    time : ndarray of float64, shape (n,)
        Times, s.
    latitude, longitude : ndarray of float64, shape (n,)
        Geodetic latitude and longitude on WGS 84, rad.
    altitude : ndarray of float64, shape (n,)
        Height above the ellipsoid of WGS 84, m.
    gnss : Gnss or None
        The receiver; None if the fixes were read from a file.
    """

    time: Floats
    latitude: Floats
    longitude: Floats
    altitude: Floats
    gnss: Gnss | None = None

    def save(self, path: PathLike, *, start: float | datetime = 0.0) -> None:
        """Write the fixes as CSV.

        A header line is followed by one line per fix: time in whole ns, latitude and longitude in degrees and altitude
        in m, at full precision.

        Parameters
        ----------
        path : path-like
            The file, in a folder that exists.
        start : float or datetime
            Moment of time 0, as in `ImuSamples.save`.

        Raises
        ------
        OSError
            If the file cannot be written.
        TypeError, ValueError
            If `start` is no such moment.
        """
        columns = np.degrees(self.latitude), np.degrees(self.longitude), self.altitude
        save_rows(path, HEADER, self.time, np.column_stack(columns), start)

    @classmethod
    def load(cls, path: PathLike, *, start: float | datetime = 0.0) -> GnssFixes:
        """Read a CSV file as `save` writes it.

        Parameters
        ----------
        path : path-like
            The file.
        start : float or datetime
            Moment of time 0, as in `ImuSamples.load`.

        Returns
        -------
        GnssFixes
            The fixes; `time` is in s since `start`.

        Raises
        ------
        FileFormatError
            If the file cannot be read or a line is not of the format; the message names the line.
        TypeError, ValueError
            If `start` is no such moment.
        """
        times, table = load_rows(path, 3, "fixes of a GNSS receiver", start)
        latitude, longitude = np.radians(table[:, :2].T)
        return cls(times, latitude, longitude, table[:, 2].copy())
