"""Inertial measurement units beside integration, finite differences, formulas by hand and the Allan variance."""

from __future__ import annotations

import copy
import itertools
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import FileFormatError

pytestmark = pytest.mark.filterwarnings("ignore:gyroscope")  # large errors show best what they do

GRAVITY = 9.80665
EARTH = 7.292115e-5

ROUNDING = 2.0**-53
"""Largest relative error of a float64 that is rounded once."""

TURN = 8 * ROUNDING
"""Error of a vector that is turned, relative to its length: entries of a matrix round four times, and their products
with the vector four times."""


def flight(seed: int = 0, count: int = 9) -> ls.Trajectory:
    """A spline with turns about all axes."""
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.uniform(-1.5, 1.5, (count, 3)))
    poses = RigidTransform.from_components(rng.uniform(-5, 5, (count, 3)), turns)
    return ls.Trajectory(np.cumsum(rng.uniform(0.5, 1.0, count)), poses, interpolation="spline")


def pose(angle: float, *position: float) -> np.ndarray:
    return RigidTransform.from_components(position, Rotation.from_rotvec([angle, 0.2 * angle, -angle])).as_matrix()


def strapdown(samples: ls.ImuSamples, trajectory: ls.Trajectory, earth: np.ndarray) -> tuple[float, float]:
    """Largest errors of position, m, and orientation, rad, when the samples are integrated by the trapezoidal rule.

    The axes of the world turn with the Earth: the orientation by minus its angle, the velocity by Coriolis.
    """
    step = np.diff(samples.time)
    rotation = trajectory.at(samples.time[0]).rotation
    position, velocity = trajectory.at(samples.time[0]).translation, trajectory.velocity(samples.time[0])[0]
    rates, forces = samples.angular_rate, samples.specific_force
    free_fall = np.array([0.0, 0.0, -GRAVITY])
    places, turns = [position], [rotation]
    for k, h in enumerate(step):
        after = Rotation.from_rotvec(-h * earth) * rotation * Rotation.from_rotvec(h * (rates[k] + rates[k + 1]) / 2)
        acceleration = (rotation.apply(forces[k]) + after.apply(forces[k + 1])) / 2 + free_fall
        acceleration -= 2 * np.cross(earth, velocity + h / 2 * acceleration)
        position = position + h * velocity + h * h / 2 * acceleration
        velocity, rotation = velocity + h * acceleration, after
        places.append(position)
        turns.append(rotation)
    truth = trajectory.at(samples.time)
    off = np.linalg.norm(np.array(places) - truth.translation, axis=1).max()
    return float(off), float((truth.rotation.inv() * Rotation.concatenate(turns)).magnitude().max())


@pytest.mark.slow("exact inertial samples integrate to the trajectory")
@pytest.mark.parametrize("latitude", [None, math.radians(48.0)])
def test_exact_samples_integrate_to_the_trajectory(latitude: float | None) -> None:
    body = flight()
    earth = np.zeros(3) if latitude is None else EARTH * np.array([0.0, math.cos(latitude), math.sin(latitude)])
    start = body.span[0]
    # All end at the same time. The errors of the trapezoidal rule are c h² + O(h³), from the jumps of the jerk at the
    # poses; here O(h³) is below 5 %.
    rates = 100.0, 200.0, 400.0, 1600.0
    units = (ls.Imu(rate, latitude=latitude) for rate in rates)
    errors = [strapdown(imu.measure(body, end=start + 4.0), body, earth) for imu in units]
    for coarse, fine, ratio in ((0, 1, 4), (1, 2, 4), (2, 3, 16)):
        np.testing.assert_allclose(np.divide(errors[coarse], errors[fine]), ratio, rtol=0.05)
    assert errors[3][0] < 1e-3
    assert errors[3][1] < 1e-4


@pytest.mark.parametrize("mounts", [(), (pose(0.4, 1, 2, 3),), (pose(0.4, 1, 2, 3), pose(-1.0, 0.5, 0, 4))])
@pytest.mark.parametrize("kind", ["spline", "twist", "world"])
def test_accelerations_are_derivatives_of_the_velocity(kind: str, mounts: tuple[np.ndarray, ...]) -> None:
    if kind == "twist":
        trajectory = ls.Trajectory.from_twist(pose(1.0, 1, 2, 3), (3, 1, 2), (0.3, -0.5, 0.8))
    else:
        trajectory = flight(3)
    for mount in mounts:
        trajectory = trajectory @ mount
    if kind == "world":
        trajectory = pose(2.0, 5, 6, 7) @ trajectory
    times = np.linspace(1.3, 4.5, 50)
    times = times[np.abs(times[:, None] - trajectory.times).min(axis=1) > 2e-3]
    got = trajectory.acceleration(times)
    assert np.abs(got[0]).max() > 1.0
    for i, exact in enumerate(got):
        coarse, fine = (
            (trajectory.velocity(times + h)[i] - trajectory.velocity(times - h)[i]) / (2 * h) for h in (1e-3, 5e-4)
        )
        # Richardson's extrapolation is off by h⁴/480 times the fifth derivative of the velocity, here below 1e6.
        np.testing.assert_allclose(exact, (4 * fine - coarse) / 3, rtol=0, atol=1e-12 / 480 * 1e6)
    np.testing.assert_array_equal(trajectory.acceleration(times[3])[0], got[0][3])


def test_accelerations_are_continuous_at_the_poses() -> None:
    body = flight(5)
    inner = body.times[1:-1]
    before, after = body.acceleration(np.nextafter(inner, 0)), body.acceleration(inner)
    for a, b in zip(before, after, strict=True):
        # At the end of a segment they are the sum of two terms up to thrice as long, whose coefficients solve a system
        # of condition 3 at most: 3·3 times some five roundings, and a turn. The times differ by nothing against that.
        np.testing.assert_allclose(a, b, rtol=0, atol=(3 * 3 * 5 * ROUNDING + TURN) * np.abs(b).max())


def test_a_body_at_rest_measures_gravity() -> None:
    tilted = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    still = ls.Trajectory.from_twist(RigidTransform.from_components([1, 2, 3], tilted))
    samples = ls.Imu(100.0).measure(still, start=2.0, end=3.0)
    np.testing.assert_array_equal(samples.time, 2.0 + np.arange(101) / 100.0)
    np.testing.assert_array_equal(samples.angular_rate, np.zeros((101, 3)))
    want = tilted.inv().apply([0, 0, GRAVITY])
    np.testing.assert_allclose(samples.specific_force, np.tile(want, (101, 1)), rtol=0, atol=TURN * GRAVITY)
    moon = ls.Imu(100.0, gravity=1.62).measure(still, end=0.0)
    np.testing.assert_allclose(np.linalg.norm(moon.specific_force, axis=1), 1.62, rtol=TURN)


def test_lever_arm_on_a_circle() -> None:
    # Speed v at radius r = v/w to the left; at m = (-1, -0.5, 0) the radius vector is (-1, -r - 0.5): the acceleration
    # -w² times it is (w², w²(r + 0.5)). The IMU is turned by 90° to the left: its x is the body's y, its y minus x.
    v, w = 10.0, 0.5
    mount = RigidTransform.from_components([-1.0, -0.5, 0.0], Rotation.from_euler("z", math.pi / 2)).as_matrix()
    circle = ls.Trajectory.from_twist(np.eye(4), (v, 0, 0), (0, 0, w))
    samples = ls.Imu(50.0, mount=mount).measure(circle, end=4.0)
    want = [w * w * (v / w + 0.5), -w * w, GRAVITY]
    # The pose and its acceleration turn, and the force is turned back.
    near = 3 * TURN * float(np.linalg.norm(want))
    np.testing.assert_allclose(samples.specific_force, np.tile(want, (len(samples), 1)), rtol=0, atol=near)
    np.testing.assert_allclose(samples.angular_rate, np.tile([0, 0, w], (len(samples), 1)), rtol=2 * TURN)


def test_the_earth_turns() -> None:
    latitude, speed = math.radians(48.0), 20.0
    imu = ls.Imu(10.0, latitude=latitude)
    east = ls.Trajectory.from_twist(np.eye(4), (speed, 0, 0))
    samples = imu.measure(east, end=1.0)
    np.testing.assert_allclose(
        samples.angular_rate[0], [0, EARTH * math.cos(latitude), EARTH * math.sin(latitude)], rtol=TURN
    )
    # The Coriolis acceleration of a body that moves east points to the south and, by Eötvös, up: it is subtracted.
    coriolis = 2 * EARTH * speed
    want = [0, coriolis * math.sin(latitude), GRAVITY - coriolis * math.cos(latitude)]
    np.testing.assert_allclose(samples.specific_force[0], want, rtol=TURN)


def allan_variance(values: np.ndarray, m: int) -> tuple[float, int]:
    """Allan variance of clusters of m samples (IEEE Std 952), and the number of differences."""
    means = values[: len(values) // m * m].reshape(-1, m, 3).mean(axis=1)
    differences = np.diff(means, axis=0)
    return float((differences**2).mean() / 2), differences.size


STILL = ls.Trajectory.from_twist(np.eye(4))


@pytest.mark.slow("noise of inertial sensors has the Allan variance of its data sheet")
@pytest.mark.parametrize("kind", ["gyroscope", "accelerometer"])
def test_allan_variance_of_the_noise(kind: str) -> None:
    rate, density, walk = 100.0, 0.02, 0.03
    field = {"gyroscope": "angular_rate", "accelerometer": "specific_force"}[kind]
    exact = getattr(ls.Imu(rate).measure(STILL, end=2000.0), field)

    def noise(**errors: float) -> np.ndarray:
        imu = ls.Imu(rate, **{kind: ls.ImuErrors(**errors)})
        return getattr(imu.measure(STILL, end=2000.0, seed=1), field) - exact

    white, drift = noise(noise_density=density), noise(random_walk=walk)
    np.testing.assert_array_equal(drift[0], 0.0)
    for m in (1, 10, 100, 1000):
        # Adjacent differences of white noise correlate by -1/2, so that the variance of the estimate is 3/K of its
        # square; those of a random walk by at most 1/4, which gives less.
        got, count = allan_variance(white, m)
        assert abs(got / (density**2 / (m / rate)) - 1) < 5 * math.sqrt(3 / count)
        got, count = allan_variance(drift, m)
        discrete = (2 * m * m + 1) / (2 * m * m)  # sums instead of integrals; 1 for many samples
        assert abs(got / (walk**2 * m / rate / 3 * discrete) - 1) < 5 * math.sqrt(3 / count)
    both = noise(noise_density=density, random_walk=walk)
    # Three times a sum with the exact value, and twice its difference, of less than 16 together.
    assert np.abs(both).max() + np.abs(exact).max() < 16
    np.testing.assert_allclose(both, white + drift, rtol=0, atol=6 * 16 * ROUNDING)


def flicker_variance(lags: np.ndarray, m: int, rate: float) -> np.ndarray:
    """Covariance of differences of adjacent cluster means of m samples, `lags` clusters apart, of flicker of floor 1.

    The twelve processes have the autocovariance exp(-|t|/T), T = 4^k s. The covariance of two cluster means l apart is
    the sum over j of (m - |j|) exp(-|l m + j|/(rate T))/m², and that of their differences is 2 c(l) - c(l-1) - c(l+1).
    """
    j = np.arange(-m + 1, m)
    near = np.unique(np.abs(np.concatenate([lags - 1, lags, lags + 1])))
    means = np.zeros(near.max() + 1)
    for time in 4.0 ** np.arange(-3, 9):
        for lag in near:
            means[lag] += ((m - np.abs(j)) * np.exp(-np.abs(lag * m + j) / (rate * time))).sum() / m**2
    return 2 * means[np.abs(lags)] - means[np.abs(lags - 1)] - means[np.abs(lags + 1)]


def test_the_floor_of_the_allan_deviation_is_that_of_the_data_sheet() -> None:
    # The Allan variance of a Gauss-Markov process of correlation time T (IEEE Std 952, annex C.1.5), of variance 1.
    for seconds in np.geomspace(1.0, 3000.0, 50):
        share = 4.0 ** np.arange(-3, 9) / seconds
        allan = 2 * share * (1 - share / 2 * (3 - 4 * np.exp(-1 / share) + np.exp(-2 / share)))
        assert abs(math.sqrt(allan.sum()) - 1) < 0.01, seconds
    sampled = (
        flicker_variance(np.array([0]), 64, 64.0)[0] / 2
    )  # samples do not average what is faster: at 1 s, the most
    assert abs(math.sqrt(sampled) - 1) < 0.01


@pytest.mark.slow("noise of inertial sensors has the Allan variance of its data sheet")
@pytest.mark.parametrize("kind", ["gyroscope", "accelerometer"])
@pytest.mark.parametrize("m", [4, 64, 512])
def test_allan_variance_of_the_bias_instability(kind: str, m: int) -> None:
    rate, floor = 4.0, math.radians(2.0 / 3600)
    imu = ls.Imu(rate, **{kind: ls.ImuErrors(bias_instability=floor)})
    field = {"gyroscope": "angular_rate", "accelerometer": "specific_force"}[kind]
    values = getattr(imu.measure(STILL, end=16_384.0, seed=5), field) - getattr(
        ls.Imu(rate).measure(STILL, end=16_384.0), field
    )
    got, count = allan_variance(values, m)
    # The mean of squares of n normal numbers of covariances c(i - j) has the variance 2/n² of the sum of all c². The
    # covariance of the differences falls as the lag to the power of -2: beyond 8 lags, c² adds less than 1e-3.
    lags = np.arange(-8, 9)
    covariance = flicker_variance(lags, m, rate)
    want = covariance[8] / 2 * floor**2
    sigma = math.sqrt(2 / count * (covariance**2).sum()) / 2 * floor**2
    assert abs(got - want) < 4 * sigma
    assert sigma < 0.25 * want


def test_flicker_goes_on_from_block_to_block_and_draws_nothing_else() -> None:
    wavering = ls.Imu(1000.0, gyroscope=ls.ImuErrors(bias_instability=1.0))
    values = wavering.measure(STILL, end=70.0).angular_rate  # three blocks of 32,768 samples
    np.testing.assert_array_equal(values[:1001], wavering.measure(STILL, end=1.0).angular_rate)
    step = np.abs(np.diff(values, axis=0)).max(axis=1)
    assert step[[32_767, 65_535]].max() < step.max()  # a process that began anew would jump by 12 draws: 5 or so
    assert step.max() < 5 * math.sqrt(2 * 12 * 64e-3)
    white = ls.ImuErrors(noise_density=1.0)
    both = ls.ImuErrors(noise_density=1.0, bias_instability=1.0)
    one, two = (ls.Imu(10.0, gyroscope=e).measure(STILL, end=9.0).angular_rate for e in (white, both))
    alone = ls.Imu(10.0, gyroscope=ls.ImuErrors(bias_instability=1.0)).measure(STILL, end=9.0)
    np.testing.assert_allclose(two, one + alone.angular_rate, rtol=0, atol=2 * 20 * ROUNDING)
    assert (alone.specific_force == [0, 0, GRAVITY]).all()


def test_constant_errors_have_their_standard_deviations() -> None:
    spin = ls.Trajectory.from_twist(np.eye(4), angular=(1, 0, 0))
    errors = ls.ImuErrors(bias=0.1)
    scale, misalignment = ls.ImuErrors(scale_factor=0.1), ls.ImuErrors(misalignment=0.1)

    def draw(errors: ls.ImuErrors) -> np.ndarray:
        imu = ls.Imu(1.0, gyroscope=errors)
        return np.array([imu.measure(spin, end=0.0, seed=seed).angular_rate[0] for seed in range(400)]) - [1, 0, 0]

    def share(values: np.ndarray) -> float:
        """Deviation of the variance from its expectation, in standard deviations of its estimate."""
        return abs(float((values**2).mean()) / 0.01 - 1) / math.sqrt(2 / values.size)

    assert share(draw(errors)) < 5
    scaled, misaligned = draw(scale), draw(misalignment)
    assert share(scaled[:, 0]) < 5
    assert share(misaligned[:, 1:]) < 5
    np.testing.assert_array_equal(scaled[:, 1:], 0.0)
    np.testing.assert_array_equal(misaligned[:, 0], 0.0)


def test_errors_depend_on_seed_name_and_axis_only() -> None:
    noisy = ls.ImuErrors(noise_density=0.1, bias=0.1)
    imu = ls.Imu(100.0, gyroscope=noisy, accelerometer=noisy)
    first = imu.measure(STILL, end=1.0, seed=4)
    longer = imu.measure(STILL, end=2.0, seed=4)
    np.testing.assert_array_equal(longer.angular_rate[:101], first.angular_rate)
    np.testing.assert_array_equal(longer.specific_force[:101], first.specific_force)
    other = ls.Imu(100.0, gyroscope=noisy, accelerometer=noisy, name="other").measure(STILL, end=1.0, seed=4)
    for a, b in (
        (first.angular_rate, imu.measure(STILL, end=1.0, seed=5).angular_rate),
        (first.angular_rate, other.angular_rate),
        (first.angular_rate, first.specific_force - [0, 0, GRAVITY]),
        (first.angular_rate[:, 0], first.angular_rate[:, 1]),
    ):
        assert (a != b).all()


def test_errors_from_time_0_stay_as_they_are() -> None:
    errors = ls.ImuErrors(noise_density=0.1, bias_instability=0.1, random_walk=0.1, bias=0.1)
    samples = ls.Imu(100.0, gyroscope=errors, accelerometer=errors).measure(STILL, end=1.0, seed=4)
    first = [0.7533011928982398, 1.02793856128994, -0.7453844185791297]
    last = [-1.212822268836426, -0.5095551701090277, 6.236311328856279]
    assert samples.angular_rate[0].tolist() == first
    assert samples.specific_force[-1].tolist() == last


@pytest.mark.parametrize("kind", ["noise_density", "bias_instability", "random_walk"])
@pytest.mark.parametrize("field", ["angular_rate", "specific_force"])
def test_noise_differs_between_starts_and_biases_do_not(kind: str, field: str) -> None:
    def measured(start: float, **errors: float) -> np.ndarray:
        drawn = ls.ImuErrors(**errors)
        imu = ls.Imu(10.0, gyroscope=drawn, accelerometer=drawn)
        values: np.ndarray = getattr(imu.measure(STILL, start=start, end=start + 100.0, seed=4), field)
        return values[:1000]

    starts = -97.0, 0.0, 0.01, 97.0, 1.7e9  # 0.01 s is a tenth of the time between samples
    units = [measured(start, bias=0.1, scale_factor=0.01, misalignment=0.01) for start in starts]
    assert all((unit == units[0][0]).all() for unit in units)
    noises = [measured(start, **{kind: 1e-3}) - measured(start) for start in starts]
    for one, other in itertools.combinations(noises, 2):
        assert (one[1:] != other[1:]).all()
        if kind == "noise_density":  # three thousand independent numbers
            assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 5 / math.sqrt(one.size)
    if kind == "random_walk":
        assert all((noise[0] == 0).all() for noise in noises)
    np.testing.assert_array_equal(measured(97.0, **{kind: 1e-3}) - measured(97.0), noises[3])


def test_samples_saturate() -> None:
    samples = ls.Imu(10.0, accelerometer=ls.ImuErrors(range=5.0), gyroscope=ls.ImuErrors(range=0.1)).measure(
        ls.Trajectory.from_twist(np.eye(4), angular=(0, 0, -3)), end=0.0
    )
    assert samples.specific_force[0].tolist() == [0, 0, 5]
    assert samples.angular_rate[0].tolist() == [0, 0, -0.1]


def test_a_sample_at_the_end_is_kept() -> None:
    # 0.29 * 100 is 28.999999999999996, but 29/100 is 0.29.
    assert ls.Imu(100.0).measure(STILL, end=0.29).time[-1] == 0.29
    body = flight()
    times = ls.Imu(33.0).measure(body).time
    first, last = body.span
    assert times[0] == first
    assert last - 1 / 33 < times[-1] <= last


def test_euroc_csv(tmp_path: Path) -> None:
    samples = ls.Imu(200.0, gyroscope=ls.ImuErrors(noise_density=0.01)).measure(flight())
    samples.save(tmp_path / "imu.csv")
    head, first, *_ = (tmp_path / "imu.csv").read_text().splitlines()
    assert head == (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    )
    assert first.split(",")[0] == str(round(samples.time[0] * 1e9))
    table = np.loadtxt(tmp_path / "imu.csv", delimiter=",")
    np.testing.assert_array_equal(table[:, 1:], np.hstack([samples.angular_rate, samples.specific_force]))
    read = ls.ImuSamples.load(tmp_path / "imu.csv")
    np.testing.assert_array_equal(read.angular_rate, samples.angular_rate)
    np.testing.assert_array_equal(read.specific_force, samples.specific_force)
    np.testing.assert_allclose(read.time, samples.time, rtol=0, atol=0.5e-9 + np.spacing(samples.time[-1]))  # whole ns
    assert read.imu is None
    assert len(read) == len(samples)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "imu.csv: expected samples of an IMU, got none"),
        ("#only a header\n", "imu.csv:1: expected samples of an IMU, got none"),
        ("0,1,2,3,4,5\n", "imu.csv:1: expected 7 numbers, got 6"),
        ("0,1,2,3,4,5,x\n", "imu.csv:1: expected finite numbers, got something else"),
        ("#h\n5,1,2,3,4,5,6\n5,1,2,3,4,5,6\n", "imu.csv:3: expected rising times"),
    ],
)
def test_damaged_csv(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "imu.csv").write_text(text)
    with pytest.raises(FileFormatError) as caught:
        ls.ImuSamples.load(tmp_path / "imu.csv")
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda: ls.Imu(0.0), "rate: expected a finite number > 0, got 0.0"),
        (lambda: ls.Imu(100.0, mount=np.diag([2.0, 1, 1, 1])), "mount: expected a rigid transform"),
        (lambda: ls.Imu(100.0, gyroscope=0.1), "gyroscope: expected ImuErrors, got 0.1"),
        (lambda: ls.Imu(100.0, latitude=48.0), "latitude: expected"),
        (lambda: ls.Imu(100.0, gravity=-9.81), "gravity: expected a finite number >= 0"),
        (lambda: ls.Imu(100.0, name=3), "name: expected a text, got 3"),
        (lambda: ls.ImuErrors(noise_density=-1.0), "noise_density: expected a finite number >= 0, got -1.0"),
        (lambda: ls.ImuErrors(range=0.0), "range: expected a real number > 0, got 0.0"),
        (lambda: ls.Imu(100.0).measure(np.eye(4)), "trajectory: expected a Trajectory"),
        (lambda: ls.Imu(100.0).measure(STILL), "end: expected a time, as the trajectory has no end, got none"),
        (lambda: ls.Imu(100.0).measure(flight(), start=-1.0), "start: expected"),
        (lambda: ls.Imu(100.0).measure(flight(), end=99.0), "end: expected"),
        (lambda: ls.Imu(1e9).measure(STILL, end=1.0), "rate: expected at most 10,000,000 samples, got 1e+09 of them"),
    ],
)
def test_bad_arguments(call: Any, problem: str) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        call()
    assert str(caught.value).startswith(problem)


def test_linear_interpolation_has_no_acceleration_at_its_poses() -> None:
    poses = [pose(a, a * a, 0, 0) for a in (0.0, 1.0, 2.0)]
    corner = ls.Trajectory([0.0, 1.0, 2.0], poses)
    with pytest.raises(ValueError, match=r"velocity jumps at times\[1\] = 1\.0; make or load it with interp.*spline"):
        ls.Imu(100.0).measure(corner)
    straight = ls.Trajectory([0.0, 1.0], poses[:2])
    assert len(ls.Imu(100.0).measure(straight)) == 101
    rest = ls.Trajectory([0.0, 1.0, 3.0], [poses[1]] * 3)
    np.testing.assert_allclose(np.linalg.norm(ls.Imu(9.0).measure(rest).specific_force, axis=1), GRAVITY, rtol=TURN)
    single = ls.Trajectory([1.0], poses[:1])
    assert ls.Imu(100.0).measure(single).time.tolist() == [1.0]


def test_accelerations_beyond_float64_are_refused() -> None:
    steps = np.array([0.0, 1e-200, 2e-200])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0.0, 1.0, 0.0]
    jump = ls.Trajectory(steps, poses, interpolation="spline")
    with pytest.raises(ValueError, match="accelerations within the range of float64"):
        jump.acceleration(0.0)


def test_imus_are_values() -> None:
    imu = ls.Imu(200.0, mount=pose(0.1, 1, 2, 3), gyroscope=ls.ImuErrors(noise_density=0.1))
    assert pickle.loads(pickle.dumps(imu)) == imu == copy.deepcopy(imu)  # noqa: S301
    assert imu != ls.Imu(200.0)
    assert hash(imu) == hash(copy.copy(imu))
    assert not imu.mount.flags.writeable
