"""Inertial measurement units: angular rate and specific force along a trajectory."""

from __future__ import annotations

import math
import zlib
from dataclasses import KW_ONLY, dataclass, field, replace
from datetime import datetime
from typing import Self

import numpy as np

from lidarsim._base import validation
from lidarsim._base.files import PathLike, atomic_writer
from lidarsim._base.lines import LineReader, cells, numbers
from lidarsim._base.pickling import Pickled, Value
from lidarsim._base.validation import Floats
from lidarsim._base.vectors import normals, product
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.motion.georeference import unix_time
from lidarsim.motion.trajectory import Trajectory

GRAVITY = 9.80665
"""Standard gravity, m/s² (CGPM, 1901)."""

EARTH_RATE = 7.292115e-5
"""Angular velocity of the Earth, rad/s (WGS 84; NIMA TR8350.2, 3rd ed., table 3.1)."""

MOST_SAMPLES = 10_000_000
"""Most samples of a measurement, which take 2.5 GB while they are made: 14 hours at 200 Hz."""

FLICKER_TIMES: Floats = 4.0 ** np.arange(-3.0, 9.0)
"""Correlation times of the Gauss-Markov processes whose sum is the flicker noise of a bias, s."""

BLOCK = 2**15
"""Samples for which flicker noise is computed at once, in 19 MB."""

HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)


@dataclass(frozen=True, slots=True, eq=False)
class ImuErrors(Value):
    """Errors of the three gyroscopes or the three accelerometers of an IMU, as data sheets state them.

    U is rad/s for gyroscopes and m/s² for accelerometers. All default to none.

    Parameters
    ----------
    noise_density : float
        White noise (angle or velocity random walk), U/√Hz. The standard deviation of a sample is this times √rate.
    bias_instability : float
        Floor of the Allan deviation (in-run bias stability), U: flicker noise of the bias. IEEE's coefficient B, by
        which some data sheets state it, is 1.505 times the floor, √(π/(2 ln 2)).
    random_walk : float
        Random walk of the bias (rate random walk), U/s/√Hz; it begins at 0.
    bias : float
        Standard deviation of the constant bias of each axis, U, drawn once per seed.
    scale_factor : float
        Standard deviation of the relative error of the scale of each axis, drawn once per seed.
    misalignment : float
        Standard deviation of the share of each other axis in an axis, rad, drawn once per seed.
    range : float
        Samples beyond ± this saturate, U.

    Raises
    ------
    TypeError, ValueError
        If a number is negative or not finite, or the range is not positive.

    Notes
    -----
    With the true values x of three axes, a sample is clip((I + S + M)x + b + f + w + n): S the errors of scale, M
    those of alignment, off the diagonal, b the bias, f its flicker noise, w its random walk and n the white noise. The
    Allan deviation of n is noise_density/√τ, that of w random_walk·√(τ/3) (IEEE Std 952-1997, annex C), and that of f
    is bias_instability within 1 % for τ from 1 s to 50 min, at 64 Hz and more.

    Flicker noise is the sum of twelve stationary first-order Gauss-Markov processes with correlation times of 4ᵏ s, k
    from -3 to 8, and the standard deviation bias_instability each. A process of variance s² and correlation time T has
    the one-sided spectral density 4s²T/(1 + (2πfT)²). The sum over correlation times that grow by a factor r tends to
    an integral over ln T, s²/(f ln r), and the Allan variance of a density h/f is 2h ln 2: with r = 4 it is s². As the
    processes begin in their stationary state, the flicker noise also moves the bias of a run, by bias_instability·√12.

    Examples
    --------
    Data sheets of gyroscopes state noise in °/s/√Hz:

    >>> ImuErrors(noise_density=math.radians(0.005), bias=math.radians(0.5)).noise_density
    8.726646259971648e-05
    """

    _: KW_ONLY
    noise_density: float = 0.0
    bias_instability: float = 0.0
    random_walk: float = 0.0
    bias: float = 0.0
    scale_factor: float = 0.0
    misalignment: float = 0.0
    range: float = math.inf

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("noise_density", "bias_instability", "random_walk", "bias", "scale_factor", "misalignment"):
            object.__setattr__(self, name, validation.real(name, getattr(self, name), at_least=0.0))
        limit = validation.real("range", self.range, above=0.0, infinite=True)
        object.__setattr__(self, "range", limit)


_USUAL = ("noise_density", 2e-3, "rad/s/√Hz"), ("bias", 0.3, "rad/s"), ("misalignment", 0.1, "rad")
"""Largest usual errors of gyroscopes."""


@dataclass(frozen=True, slots=True, eq=False)
class Imu(Value):
    """Inertial measurement unit: three gyroscopes and three accelerometers, sampled at a fixed rate.

    Parameters
    ----------
    rate : float
        Samples per second, Hz.
    mount : RigidTransform or array_like, shape (4, 4), optional
        Pose of the IMU on the body, IMU to body; its translation is the lever arm. Default: the identity.
    gyroscope, accelerometer : ImuErrors
        Errors of the angular rate, in rad/s, and of the specific force, in m/s². Default: none.
    gravity : float
        Acceleration of free fall, along −z of the world, m/s². Default: standard gravity, 9.80665.
    latitude : float, optional
        Latitude for the rotation of the Earth, rad, in a world with x to the east, y to the north and z up, at rest on
        the Earth. Default: the Earth does not rotate.
    name : str
        Name, from which its errors derive: two IMUs of different names draw different errors.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or is out of its range.

    Notes
    -----
    With orientation R, IMU to world, angular velocity ω in the axes of the IMU, velocity v and acceleration a in the
    world, gravity g and the Earth's angular velocity Ω, the angular rate is ω + RᵀΩ and the specific force is
    Rᵀ(a + 2Ω × v − g) (P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd
    ed., 2013, section 5.4). Gravity g includes the centrifugal acceleration.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> circle = ls.Trajectory.from_twist(np.eye(4), linear=(10, 0, 0), angular=(0, 0, 0.5))
    >>> samples = ls.Imu(200.0).measure(circle, end=1.0)
    >>> len(samples)
    201
    >>> samples.angular_rate[0], samples.specific_force[0]
    (array([0. , 0. , 0.5]), array([0.     , 5.     , 9.80665]))
    """

    rate: float
    _: KW_ONLY
    mount: Floats = None  # type: ignore[assignment]
    gyroscope: ImuErrors = field(default_factory=ImuErrors)
    accelerometer: ImuErrors = field(default_factory=ImuErrors)
    gravity: float = GRAVITY
    latitude: float | None = None
    name: str = "imu"

    def __post_init__(self) -> None:
        """Check the arguments."""
        set_ = object.__setattr__
        set_(self, "rate", validation.frequency("rate", self.rate))
        set_(self, "mount", validation.freeze(validation.optional_pose("mount", self.mount)))
        for name in ("gyroscope", "accelerometer"):
            if not isinstance(getattr(self, name), ImuErrors):
                raise ArgumentTypeError(name, "ImuErrors", validation.short_repr(getattr(self, name)))
        for name, most, unit in _USUAL:
            validation.ask_above(f"gyroscope.{name}", getattr(self.gyroscope, name), most, unit, "degrees?")
        set_(self, "gravity", validation.real("gravity", self.gravity, at_least=0.0))
        if self.latitude is not None:
            quarter = math.pi / 2
            set_(self, "latitude", validation.angle("latitude", self.latitude, at_least=-quarter, at_most=quarter))
        sensor_name(self.name)

    def measure(
        self, trajectory: Trajectory, *, start: float | None = None, end: float | None = None, seed: int = 0
    ) -> ImuSamples:
        """Measure along the trajectory of the body.

        Parameters
        ----------
        trajectory : Trajectory
            The body's pose, body to world, as a spline or a constant twist: linear interpolation has no acceleration
            at its poses. A body at rest is ``Trajectory.from_twist(pose)``.
        start, end : float, optional
            Time of the first sample and of the last sample at the latest, s. Default: those of the trajectory; a
            constant twist needs both `end` and, unless it is 0, `start`.
        seed : int
            Seed of the errors, 0 to 2⁶⁴ − 1.

        Returns
        -------
        ImuSamples
            Samples at start + k/rate.

        Raises
        ------
        TypeError, ValueError
            If the velocity of the trajectory jumps, it does not cover the times or has no end, or there would be more
            than ten million samples.

        Notes
        -----
        Biases, errors of scale and misalignments are those of the unit: the seed and the name determine them. White
        noise, flicker noise and random walks also depend on the time of the first sample, in whole ns, so that those of
        measurements with other starts, such as the strips of a survey, are independent. They begin anew with each
        measurement, its random walks at 0: measure once, and take parts with `ImuSamples.between`, for noise that goes
        on from one part to the next.
        """
        times = sample_times(trajectory, self.rate, start, end)
        seed = validation.integer("seed", seed, at_least=0, at_most=2**64 - 1)
        exact = trajectory @ self.mount
        rotations = exact.at(times).as_matrix()[:, :3, :3]
        velocities, rates = exact.velocity(times)
        accelerations, _ = exact.acceleration(times)
        accelerations[:, 2] += self.gravity
        to_sensor = rotations.transpose(0, 2, 1)
        if self.latitude is not None:
            earth = EARTH_RATE * np.array([0.0, math.cos(self.latitude), math.sin(self.latitude)])
            rates += product(to_sensor, earth[:, None])[..., 0]
            accelerations += 2.0 * np.cross(earth, velocities)
        forces = product(to_sensor, accelerations[..., None])[..., 0]
        kinds = enumerate(((rates, self.gyroscope), (forces, self.accelerometer)))
        # The streams of the constants of the unit, of white noise and random walk, and of flicker noise.
        parts = (0, 0.0), (0, times[0]), (FLICKER, times[0])
        rates, forces = (
            _measure(values, errors, self.rate, *(noise_bits(seed, self.name, kind + of, at) for of, at in parts))
            for kind, (values, errors) in kinds
        )
        return ImuSamples(times, rates, forces, self)


def sample_times(trajectory: Trajectory, rate: float, start: float | None, end: float | None) -> Floats:
    """Return the times at which a sensor that is not a lidar samples: start + k/rate, up to the end.

    Parameters
    ----------
    trajectory : Trajectory
        The body's pose.
    rate : float
        Samples per second, Hz.
    start, end : float, optional
        Time of the first sample and of the last sample at the latest, s. Default: those of the trajectory.

    Raises
    ------
    TypeError, ValueError
        If the trajectory does not cover the times or has no end, or there would be more than ten million samples.
    """
    if not isinstance(trajectory, Trajectory):
        raise ArgumentTypeError("trajectory", "a Trajectory", validation.short_repr(trajectory))
    first, last = trajectory.span
    if start is not None:
        first = validation.real("start", start, at_least=first, at_most=last)
    elif math.isinf(first):
        first = 0.0
    if end is not None:
        last = validation.real("end", end, at_least=first, at_most=last)
    elif math.isinf(last):
        raise ArgumentValueError("end", "a time, as the trajectory has no end", "none")
    steps = (last - first) * rate
    if not steps < MOST_SAMPLES:
        raise ArgumentValueError("rate", f"at most {MOST_SAMPLES:,} samples", f"{steps:.3g} of them")
    times = first + np.arange(math.floor(steps) + 2) / rate  # one more than the product, which is rounded, says
    return times[times <= last]


GYROSCOPE, ACCELEROMETER, RECEIVER = 0, 1, 4
"""Streams of random bits of each sensor."""

FLICKER = 2
"""Distance from the stream of an inertial sensor to that of its flicker noise."""


def noise_bits(seed: int, name: str, stream: int, start: float) -> np.random.Philox:
    """Return the random bits of a sensor for a measurement that begins at `start`, s.

    The key has the seed in its lower half, the name and stream in its upper; the second word of the counter has the
    start, in whole ns.
    """
    key = seed | zlib.crc32(name.encode()) << 64 | stream << 96
    return np.random.Philox(key=key, counter=round(start * 1e9) % 2**64 << 64)


def sensor_name(name: object) -> str:
    """Return the name of a sensor; raise an error unless it is a text that UTF-8 can encode."""
    if not isinstance(name, str):
        raise ArgumentTypeError("name", "a text", validation.short_repr(name))
    try:
        name.encode()
    except UnicodeEncodeError:
        raise ArgumentValueError("name", "text that UTF-8 can encode", ascii(name)) from None
    return name


def _measure(values: Floats, errors: ImuErrors, rate: float, *bits: np.random.Philox) -> Floats:
    """Return the exact values of three axes, shape (n, 3), with errors as documented in `ImuErrors`."""
    of_unit, of_noise, of_flicker = bits
    once = normals(of_unit, (12,))
    matrix = np.eye(3)
    matrix[~np.eye(3, dtype=bool)] = errors.misalignment * once[:6]
    matrix[np.diag_indices(3)] += errors.scale_factor * once[6:9]
    measured = product(matrix, values[..., None])[..., 0] + errors.bias * once[9:]
    if errors.noise_density or errors.random_walk:
        # Row by row, so that a longer measurement begins like a shorter one. From 0 s, two rows are those of `once`.
        noise = normals(of_noise, (len(values) + 2, 2, 3))[2:]
        measured += errors.noise_density * math.sqrt(rate) * noise[:, 0]
        measured[1:] += np.cumsum(errors.random_walk / math.sqrt(rate) * noise[1:, 1], axis=0)
    if errors.bias_instability:
        steps = np.divide(1.0 / rate, FLICKER_TIMES)
        measured += errors.bias_instability * gauss_markov(of_flicker, len(values), steps)
    return np.clip(measured, -errors.range, errors.range)


def gauss_markov(bits: np.random.Philox, count: int, steps: Floats) -> Floats:
    """Return the sums of stationary first-order Gauss-Markov processes of unit variance on three axes.

    A sample is e⁻ˢ times the one before plus √(1 − e⁻²ˢ) times a standard normal number (A. Gelb, Applied Optimal
    Estimation, 1974, section 3.8).

    Parameters
    ----------
    bits : numpy.random.Philox
        Where the numbers are drawn, sample by sample, so that a longer sum begins like a shorter one.
    count : int
        Number of samples.
    steps : ndarray of float64, shape (k,)
        For each process s, the time between samples in correlation times; inf is white noise.

    Returns
    -------
    ndarray of float64, shape (count, 3)
        The sums of the k processes.
    """
    total = np.zeros((count, 3))
    kept, fresh = np.exp(-steps)[:, None], np.sqrt(-np.expm1(-2.0 * steps))[:, None]
    state = None
    for start in range(0, count, BLOCK):
        part = total[start : start + BLOCK]
        values = normals(bits, (len(part), len(steps), 3))
        for k in range(len(part)):
            if state is not None:
                values[k] = fresh * values[k] + kept * state
            state = values[k]
        for k in range(len(steps)):
            part += values[:, k]
    return total


class Samples(Pickled):
    """Base of what a sensor measures at a fixed rate: arrays with one row per sample, of which one is `time`."""

    __slots__ = ()

    time: Floats

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time)

    def between(self, start: float, end: float) -> Self:
        """Return the samples of an interval.

        Parameters
        ----------
        start, end : float
            Its start, included, and its end, excluded, s; they may be infinite.

        Returns
        -------
        Self
            The samples whose times are in it.

        Raises
        ------
        TypeError, ValueError
            If a time is not a number.
        """
        start, end = (validation.real(n, v, infinite=True) for n, v in (("start", start), ("end", end)))
        rows = slice(*np.searchsorted(self.time, (start, end)))
        contents = self._contents().items()
        return replace(
            self,  # type: ignore[type-var]
            **{name: values[rows] for name, values in contents if isinstance(values, np.ndarray)},
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ImuSamples(Samples):
    """Samples of an IMU.

    Attributes
    ----------
    time : ndarray of float64, shape (n,)
        Times, s.
    angular_rate : ndarray of float64, shape (n, 3)
        Angular rate in the axes of the IMU, rad/s.
    specific_force : ndarray of float64, shape (n, 3)
        Specific force in the axes of the IMU, m/s²: (0, 0, 9.80665) at rest and level.
    imu : Imu or None
        The IMU; None if the samples were read from a file.
    """

    time: Floats
    angular_rate: Floats
    specific_force: Floats
    imu: Imu | None = None

    def save(self, path: PathLike, *, start: float | datetime = 0.0) -> None:
        """Write the samples as CSV in the format of the EuRoC MAV data set.

        A header line is followed by one line per sample: time in whole ns, angular rate in rad/s and specific force in
        m/s², at full precision.

        Parameters
        ----------
        path : path-like
            The file, in a folder that exists.
        start : float or datetime
            Moment of time 0: seconds since 1970, or a datetime with a time zone; it makes Unix times of the times.

        Raises
        ------
        OSError
            If the file cannot be written.
        TypeError, ValueError
            If `start` is no such moment.
        """
        save_rows(path, HEADER, self.time, np.hstack([self.angular_rate, self.specific_force]), start)

    @classmethod
    def load(cls, path: PathLike, *, start: float | datetime = 0.0) -> ImuSamples:
        """Read a CSV file in the format of the EuRoC MAV data set, as `save` writes it.

        Parameters
        ----------
        path : path-like
            The file.
        start : float or datetime
            Moment of time 0, as in `save`: of Unix times, which float64 holds to 0.2 µs, it makes exact ones.

        Returns
        -------
        ImuSamples
            The samples; `time` is in s since `start`.

        Raises
        ------
        FileFormatError
            If the file cannot be read or a line is not of the format; the message names the line.
        TypeError, ValueError
            If `start` is no such moment.
        """
        times, table = load_rows(path, 6, "samples of an IMU", start)
        return cls(times, np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3:]))


def save_rows(path: PathLike, header: str, times: Floats, table: Floats, start: float | datetime) -> None:
    """Write a CSV file: a header, then per row its time since `start`, in whole ns, and the numbers of `table`."""
    zero = unix_time(start)
    with atomic_writer(path) as file:
        file.write(f"{header}\n".encode("ascii"))
        file.writelines(
            f"{zero + round(time * 1e9)},{','.join(map(repr, row))}\n".encode("ascii")
            for time, row in zip(times.tolist(), table.tolist(), strict=True)
        )


def load_rows(path: PathLike, columns: int, what: str, start: float | datetime) -> tuple[Floats, Floats]:
    """Return the times since `start`, s, (n,), and the table, (n, columns), of a file that `save_rows` writes."""
    zero, lines = unix_time(start), LineReader(path)
    times, rows = [], []
    with lines.refusals():
        for line in lines:
            texts = cells(line)
            rows.append(numbers(texts, columns + 1))
            times.append(((int(texts[0]) if texts[0].isdecimal() else rows[-1][0]) - zero) / 10**9)
        if not rows:
            raise ValueError(f"expected {what}, got none")
    return lines.rising(np.array(times)), np.array(rows)[:, 1:]
