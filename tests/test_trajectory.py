"""Trajectories: given poses, interpolation, circles, splines, mounts, velocities and invalid arguments."""

from __future__ import annotations

import copy
import math
import pickle
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation, RotationSpline, Slerp

import lidarsim as ls

TIMES = np.array([-1.0, 0.5, 0.75, 4.0])


def poses() -> RigidTransform:
    generator = np.random.default_rng(4)
    rotations = Rotation.from_rotvec(generator.normal(0.0, 1.0, (4, 3)))
    return RigidTransform.from_components(generator.normal(0.0, 10.0, (4, 3)), rotations)


def test_given_poses_are_met() -> None:
    trajectory = ls.Trajectory(TIMES, poses())
    assert np.allclose(trajectory.at(TIMES).as_matrix(), poses().as_matrix(), rtol=0, atol=1e-14)
    assert trajectory.span == (-1.0, 4.0)
    assert repr(trajectory) == "Trajectory(-1 to 4 s)"
    assert repr(ls.Trajectory(1.7e9 + TIMES, poses())) == "Trajectory(1699999999 to 1700000004 s)"


@pytest.mark.parametrize("matrices", [False, True])
def test_between_poses_position_is_linear_and_orientation_is_scipys_slerp(matrices: bool) -> None:
    given = poses().as_matrix() if matrices else poses()
    trajectory = ls.Trajectory(TIMES, given)
    times = np.linspace(-1.0, 4.0, 501)
    at = trajectory.at(times)
    rotations = Slerp(TIMES, poses().rotation)(times)
    assert np.allclose(at.rotation.as_matrix(), rotations.as_matrix(), rtol=0, atol=1e-14)
    translations = [np.interp(times, TIMES, axis) for axis in poses().translation.T]
    assert np.allclose(at.translation, np.transpose(translations), rtol=0, atol=1e-13)


def test_one_time_gives_one_pose() -> None:
    one = ls.Trajectory(TIMES, poses()).at(0.5)
    assert one.single
    assert np.allclose(one.as_matrix(), poses()[1].as_matrix(), rtol=0, atol=1e-14)
    assert ls.Trajectory([3.0], [np.eye(4)]).at([3.0]).as_matrix().tolist() == [np.eye(4).tolist()]


@pytest.mark.parametrize("angular", [(0.0, 0.0, 0.0), (0.0, 0.0, 1e-9), (0.3, -0.2, 0.5), (2.0, 1.0, -3.0)])
def test_a_twist_is_the_matrix_exponential(angular: tuple[float, float, float]) -> None:
    start, linear = poses()[0], (10.0, -1.0, 0.5)
    trajectory = ls.Trajectory.from_twist(start, linear, angular)
    assert trajectory.span == (-math.inf, math.inf)
    x, y, z = angular
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    twist[:3, 3] = linear
    for time in (-2.0, 0.0, 1e-3, 0.3, 5.0):
        expected = start.as_matrix() @ expm(twist * time)
        assert np.allclose(trajectory.at(time).as_matrix(), expected, rtol=0, atol=1e-12), time


EPS = np.finfo(float).eps


def exact_pose(linear: tuple[float, ...], angular: tuple[float, ...], time: float) -> np.ndarray:
    """exp(t·twist) by its formulas, with as many digits as the angle has, and 30 more."""
    w, v, t = mpmath.matrix(angular), mpmath.matrix(linear), mpmath.mpf(time)
    with mpmath.workdps(700):  # of the largest angle 1e616
        speed = mpmath.sqrt(sum(x * x for x in w))
        a = speed * t
        cross = mpmath.matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / speed
        sine, cosine = mpmath.sin(a), mpmath.cos(a)
        rotation = mpmath.eye(3) + sine * cross + (1 - cosine) * cross * cross
        way = t * v + (1 - cosine) / speed * cross * v + (t - sine / speed) * cross * cross * v
        rows = [[*(rotation[i, j] for j in range(3)), way[i]] for i in range(3)]
        return np.array([[float(x) for x in row] for row in rows])


@pytest.mark.filterwarnings("ignore:angular")  # it asks about so many radians per second
@pytest.mark.parametrize("exponent", [0, 3, 5, 5.99, 6.01, 7, 9, 12, 16, 22, 50, 154, 200, 280, 300])
def test_twists_turn_as_far_as_they_should_at_any_time(exponent: float) -> None:
    generator = np.random.default_rng(int(10 * exponent))
    for kind in range(12):
        angular = tuple(generator.normal(size=3)) if kind % 3 else (0.0, 0.0, 1.0)
        angle = 10**exponent * generator.uniform(1, 1.01)
        faster = 10 ** generator.uniform(max(-exponent, exponent - 300), min(exponent, 290)) if kind % 2 else 1.0
        speed = math.hypot(*angular) * faster
        angular, time = tuple(faster * x for x in angular), (-1) ** kind * angle / speed
        # As far as a sensor goes that turns, on circles and along screws.
        along = np.array(angular) / speed
        linear = np.cross(along, generator.normal(size=3)) + (kind > 5) * along
        linear = tuple(linear * min(1.0, 1e200 / abs(time)))
        found = ls.Trajectory.from_twist(np.eye(4), linear, angular)._native.at(np.array([time]))[0]
        truth = exact_pose(linear, angular, time)
        # Up to 1e6 rad a rotation vector is off by 3u of the angle, which is part of its square root, a sum of three
        # products and the time; past that the rate has all its digits, and 16 roundings remain.
        off = (4 if angle <= 1e6 else 0) * EPS * angle + 16 * EPS
        assert np.abs(found[:3, :3] - truth[:, :3]).max() < off
        assert np.abs(found[:3, :3] @ found[:3, :3].T - np.eye(3)).max() < 16 * EPS
        # The way is as far off as that makes its radius, and 16 roundings of how far it leads along the axis; of a
        # rotation vector's, as far as the arc.
        radius, arc = math.hypot(*linear) / speed, math.hypot(*linear) * abs(time)
        straight = abs(np.dot(linear, along) * time) if angle > 1e6 else arc
        # With twice the digits the product of two perpendicular vectors is off by EPS².
        bound = 2 * off * radius + 16 * EPS * straight + 16 * EPS**2 * arc
        assert np.abs(found[:3, 3] - truth[:, 3]).max() <= bound


def test_twists_of_whole_turns_are_where_they_began() -> None:
    """Rates are exact: 2π·10ᵏ s, rounded to float64, at 1 rad/s is short of whole turns by what rounding took."""
    for k in range(0, 19, 2):
        time = 2 * math.pi * 10**k
        with mpmath.workdps(60):
            expected = float(mpmath.sin(mpmath.mpf(time) - 2 * mpmath.pi * 10**k))
        matrix = ls.Trajectory.from_twist(np.eye(4), angular=(0, 0, 1))._native.at(np.array([time]))[0]
        assert matrix[1, 0] == pytest.approx(expected, abs=4 * EPS if k > 5 else 4 * EPS * time)


@pytest.mark.filterwarnings("ignore:angular")
def test_a_twist_ends_where_float64_does() -> None:
    fast = ls.Trajectory.from_twist(np.eye(4), linear=(0, -1e290, 0), angular=(0, 0, 1e200))
    assert fast.span == (-math.inf, math.inf)
    last = 2.0**980 / 1e290
    assert np.isfinite(fast.at([-last, last]).as_matrix()).all()
    message = f"times: expected times from {-last} to {last} s, got times = 1e+20"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        fast.at(1e20)
    scene = ls.Scene()
    scene.add(ls.Sphere((5, 0, 0), 1.0), name="ball", motion=fast)
    with pytest.raises(ValueError, match=r"^time: expected times within the motion of object 0 \('ball'\), "):
        scene.cast([[0, 0, 0]], [[1, 0, 0]], time=1e20)
    with pytest.raises(ValueError, match=r"^pose: expected a trajectory over all pulses, got one from "):
        ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0)).scan(ls.Scene(), fast, time=1e20)
    turning = ls.Trajectory.from_twist(np.eye(4), angular=(0, 0, 1e200))
    assert np.isfinite(turning.at([-1.7e308, 5e-324, 1.7e308]).as_matrix()).all()


def spline() -> ls.Trajectory:
    return ls.Trajectory(TIMES, poses(), interpolation="spline")


class ConvergedSpline(RotationSpline):
    """SciPy's, iterated until rounding is all that changes."""

    MAX_ITER = 1000
    TOL = 4 * EPS


def test_a_spline_is_scipys() -> None:
    position, turn = CubicSpline(TIMES, poses().translation), ConvergedSpline(TIMES, poses().rotation)
    times, lengths = np.linspace(-1.0, 4.0, 501), np.diff(TIMES)

    def size(terms: np.ndarray) -> float:
        """Largest sum of the absolute values of the terms of a polynomial, cubic one first."""
        return sum((np.abs(part).max(axis=1) * lengths ** (3 - i)).max() for i, part in enumerate(terms))

    # Horner's rule rounds 6 times here and there, coefficients are rounded twice more each: 16 roundings of half an ulp
    # of no more than `size`. A velocity has three times as large terms, over the shortest time.
    at = spline().at(times)
    assert np.abs(at.translation - position(times)).max() < 16 * EPS * size(position.c)
    linear, angular = spline().velocity(times)
    assert np.abs(linear - position(times, 1)).max() < 48 * EPS * size(position.c) / lengths.min()
    # A rotation is off by the error of its angle, and by 16 roundings in its matrix and SciPy's quaternions. Angular
    # velocities go through a matrix of angles, whose entries are below 2.
    angle = 16 * EPS * size(turn.interpolator.c)
    assert np.abs(at.rotation.as_matrix() - turn(times).as_matrix()).max() < angle + 16 * EPS
    assert np.abs(angular - turn(times, 1)).max() < 2 * 3 * angle / lengths.min()
    assert np.abs(linear).max() > 10
    assert np.abs(angular).max() > 1


def leaps(trajectory: ls.Trajectory) -> np.ndarray:
    """How far velocities and accelerations on both sides of each pose within differ, of their size: (k, 2)."""
    found = []
    lengths = np.diff(trajectory.times)
    for k, time in enumerate(trajectory.times[1:-1]):
        before, step = np.nextafter(time, -math.inf), 1e-6 * min(lengths[k], lengths[k + 1])
        for i in (0, 1):
            velocities = [trajectory.velocity(t)[i] for t in (before - step, before, time, time + step)]
            sides = (velocities[1] - velocities[0]) / step, (velocities[3] - velocities[2]) / step
            size = np.abs(velocities).max()
            # Beside an acceleration of nearly zero, one is seen that the velocity would have gained in a step.
            scale = np.linalg.norm(sides[1]) + size / lengths.max()
            found.append(
                (np.linalg.norm(velocities[2] - velocities[1]) / size, np.linalg.norm(sides[1] - sides[0]) / scale)
            )
    return np.array(found)


def test_a_spline_is_smooth_where_lines_have_bends() -> None:
    # The one-sided differences are off by half a step times the third derivative, some 1e-5 of the acceleration.
    assert leaps(spline()).max() < 1e-3
    assert leaps(ls.Trajectory(TIMES, poses()))[:, 0].min() > 0.1


def poses_of(rotations: Rotation) -> np.ndarray:
    """Poses of these orientations, in different places."""
    matrices = np.tile(np.eye(4), (len(rotations), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = rotations.as_matrix(), rotations.as_rotvec()
    return matrices


@pytest.mark.parametrize("unevenness", [0.0, 1.0, 1.5])
def test_splines_join_large_turns_at_uneven_times(unevenness: float) -> None:
    """Steps that last from 1 to 10^(2·unevenness) times as long as another, through any orientations."""
    scipys = 0
    for seed in range(20):
        generator = np.random.default_rng(seed)
        times = np.cumsum(10 ** generator.uniform(-unevenness, unevenness, 7))
        rotations = Rotation.random(7, rng=generator)
        trajectory = ls.Trajectory(times, poses_of(rotations), interpolation="spline")
        assert leaps(trajectory).max() < 1e-3, seed
        between = trajectory._native.at(np.linspace(times[0], times[-1], 200))[:, :3, :3]  # as it is, not made rigid
        assert np.abs(between @ between.transpose(0, 2, 1) - np.eye(3)).max() < 16 * EPS
        # With |J| <= 1, |A| <= π/2 and without N, the largest angular velocity w at a pose is below
        # 3/2 m + (½α + ¼πβ)w <= 3/2 m + ¼πw, with m the largest mean one of a step: 7 m. N leaves it there.
        lengths, turns = np.diff(times), (rotations[:-1].inv() * rotations[1:]).magnitude()
        speeds = np.linalg.norm(trajectory.velocity(times)[1], axis=1)
        assert speeds.max() < 1.5 / (1 - math.pi / 4) * (turns / lengths).max()
        with np.errstate(all="ignore"):
            try:
                rates = RotationSpline(times, rotations)(times, 1)
            except (ValueError, np.linalg.LinAlgError):
                continue
        scipys += np.allclose(rates, trajectory.velocity(times)[1], rtol=1e-6, atol=1e-6 * speeds.max())
    assert 0 < scipys < 20, "those that SciPy's ten iterations solve, and others"


def test_a_spline_of_many_small_turns_is_scipys() -> None:
    generator = np.random.default_rng(1)
    times = np.cumsum(generator.uniform(0.05, 0.15, 300))
    rotations = Rotation.from_rotvec(np.cumsum(generator.normal(0, 0.02, (300, 3)), axis=0))
    angular = ls.Trajectory(times, poses_of(rotations), interpolation="spline").velocity(times)[1]
    expected = ConvergedSpline(times, rotations)(times, 1)
    # The solution of the equations is off by a few roundings of its largest number, times their condition, at most 3;
    # turns, from quaternions here and there, by the roundings of a unit quaternion over the shortest time.
    assert np.abs(angular - expected).max() < 64 * EPS / np.diff(times).min()


def test_a_spline_that_is_not_found_is_refused_by_name() -> None:
    generator = np.random.default_rng(28)
    times = np.concatenate([[0.0], np.cumsum(10 ** generator.uniform(-3, 3, 4))])
    matrices = poses_of(Rotation.random(5, rng=28))
    message = (
        "poses: expected orientations that a spline can join, got ones whose spline was not found near times[2] = "
        f"{times[2]}; use more even times, smaller turns or interpolation='linear'"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Trajectory(times, matrices, interpolation="spline")
    ls.Trajectory(times, matrices)


def test_splines_of_one_and_two_poses_are_lines() -> None:
    for n in (1, 2):
        line, curve = (ls.Trajectory(TIMES[:n], poses()[:n], interpolation=kind) for kind in ("linear", "spline"))
        times = np.linspace(*line.span, 7)
        assert np.array_equal(line.at(times).as_matrix(), curve.at(times).as_matrix())
        assert np.array_equal(line.velocity(times), curve.velocity(times))


def test_given_poses_are_met_to_the_bit() -> None:
    matrices = poses().as_matrix()
    line, curve = ls.Trajectory(TIMES, matrices), spline()
    for trajectory in (line, curve):
        assert np.array_equal(trajectory.times, TIMES)
        assert np.array_equal(trajectory.poses.translation, matrices[:, :3, 3])
        assert np.array_equal(trajectory.poses.as_matrix(), line.poses.as_matrix())
        with pytest.raises(ValueError, match="read-only"):
            trajectory.times[0] = 5.0
    circle = ls.Trajectory.from_twist(poses()[1], (1, 0, 0))
    assert (circle.times.tolist(), circle.poses.as_matrix().shape) == ([0.0], (1, 4, 4))


MOUNT = RigidTransform.from_components([1.5, -0.5, 2.0], Rotation.from_rotvec([0.3, -0.2, 1.0]))
KINDS = {
    "linear": lambda: ls.Trajectory(TIMES, poses()),
    "spline": spline,
    "twist": lambda: ls.Trajectory.from_twist(poses()[1], (3, 0, 1), (0.2, -0.1, 0.7)),
    "mounted": lambda: spline() @ MOUNT,
    "mounted twice": lambda: (spline() @ MOUNT) @ MOUNT.inv() @ MOUNT,
    "mounted on a twist": lambda: ls.Trajectory.from_twist(poses()[1], (3, 0, 1), (0.2, -0.1, 0.7)) @ MOUNT,
}


@pytest.mark.parametrize("kind", ["linear", "spline", "twist"])
def test_a_mount_is_fixed_to_the_body_at_every_time(kind: str) -> None:
    body, times = KINDS[kind](), np.linspace(-1.0, 4.0, 501)
    sensor = body @ MOUNT
    assert sensor.span == body.span
    expected = body.at(times) * MOUNT
    size = np.abs(body.at(times).translation).max() + np.abs(MOUNT.translation).sum()
    assert np.abs(sensor.at(times).as_matrix() - expected.as_matrix()).max() < 8 * EPS * size
    assert np.abs(sensor.poses.as_matrix() - (body.poses * MOUNT).as_matrix()).max() < 8 * EPS * size
    # A mount on a mount, and a matrix in place of a RigidTransform.
    twice = (body @ MOUNT.as_matrix()) @ MOUNT
    assert np.abs(twice.at(times).as_matrix() - (expected * MOUNT).as_matrix()).max() < 16 * EPS * size


def test_a_mount_is_more_than_mounted_poses() -> None:
    sensor = ls.Trajectory(TIMES, poses()) @ MOUNT
    joined = ls.Trajectory(TIMES, sensor.poses)
    apart = np.linalg.norm(sensor.at(2.0).translation - joined.at(2.0).translation)
    assert apart > 0.5  # an arc, and its chord


@pytest.mark.parametrize("kind", KINDS)
def test_velocities_are_finite_differences(kind: str) -> None:
    trajectory, h = KINDS[kind](), 1e-4
    # Times off the poses, where lines have bends, by more than h.
    times = np.concatenate([np.linspace(a + 0.01, b - 0.01, 40) for a, b in pairwise(TIMES)])
    linear, angular = trajectory.velocity(times)
    assert linear.shape == angular.shape == (len(times), 3)
    before, after = trajectory.at(times - h), trajectory.at(times + h)

    # (f(t+h) − f(t−h))/2h is the derivative and h²/6 of the third one, and third derivatives are second differences of
    # the velocity. To each difference rounding adds a few ulps of the size of f over h. Of rotations,
    # log(R(t−h)ᵀR(t+h))/2h is ω + h²/6·(ω̈ + ω×ω̇) and terms of h⁴ (the Magnus expansion about t).
    def second(i: int) -> float:
        near, at, far = (trajectory.velocity(times + step)[i] for step in (-0.005, 0.0, 0.005))
        return float(np.abs(near - 2 * at + far).max() / 0.005**2)

    def first(i: int) -> float:
        near, far = (trajectory.velocity(times + step)[i] for step in (-0.005, 0.005))
        return float(np.linalg.norm(far - near, axis=1).max() / 0.01)

    size = np.abs(before.translation).max()
    bound = h**2 / 6 * second(0) + 16 * EPS * size / h
    assert np.abs((after.translation - before.translation) / (2 * h) - linear).max() < bound
    assert np.abs(linear).max() > 1000 * bound
    turned = (before.rotation.inv() * after.rotation).as_rotvec() / (2 * h)
    speed = np.linalg.norm(angular, axis=1).max()
    bound = h**2 / 6 * (math.sqrt(3) * second(1) + speed * first(1)) + 16 * EPS / h
    assert np.abs(turned - angular).max() < bound
    assert np.abs(angular).max() > 1000 * bound


def test_velocities_at_one_time_and_at_bends() -> None:
    line = ls.Trajectory([0.0, 1.0, 3.0], [np.eye(4), translation(1), translation(5)])
    linear, angular = line.velocity(0.5)
    assert (linear.tolist(), angular.tolist()) == ([1, 0, 0], [0, 0, 0])
    assert line.velocity([0.0, 1.0, 3.0])[0][:, 0].tolist() == [1.0, 2.0, 2.0]
    still = ls.Trajectory([1.0], [np.eye(4)])
    assert np.array_equal(still.velocity(1.0), np.zeros((2, 3)))


def translation(x: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix


def pickle_and_load(trajectory: ls.Trajectory) -> ls.Trajectory:
    return pickle.loads(pickle.dumps(trajectory))  # noqa: S301 - our own


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, pickle_and_load])
def test_copies_have_the_same_bits(kind: str, again: Callable[[ls.Trajectory], ls.Trajectory]) -> None:
    trajectory, times = KINDS[kind](), np.linspace(-1.0, 4.0, 101)
    other = again(trajectory)
    assert np.array_equal(trajectory.at(times).as_matrix(), other.at(times).as_matrix())
    assert np.array_equal(trajectory.velocity(times), other.velocity(times))
    assert (trajectory.span, trajectory.times.tolist()) == (other.span, other.times.tolist())
    assert not other.times.flags.writeable


def test_what_is_given_may_change_afterwards() -> None:
    times, matrices = np.array([0.0, 1.0]), np.array([np.eye(4), translation(1)])
    trajectory = ls.Trajectory(times, matrices)
    times[1], matrices[1] = 9.0, translation(9)
    assert trajectory.span == (0.0, 1.0)
    assert trajectory.at(1.0).translation.tolist() == [1, 0, 0]
    assert pickle_and_load(trajectory).at(1.0).translation.tolist() == [1, 0, 0]


@pytest.mark.parametrize("kind", ["linear", "spline", "twist", "mounted"])
def test_the_same_motion_in_another_world(kind: str) -> None:
    trajectories = {
        "linear": ls.Trajectory([0.0, 0.3, 0.4, 1.0], poses()),
        "spline": spline(),
        "twist": ls.Trajectory.from_twist(translation(3), linear=(2, 0.5, 0), angular=(0.1, 0, 0.7)),
        "mounted": spline() @ translation(1),
    }
    trajectory = trajectories[kind]
    world = RigidTransform.from_components([100.0, -20.0, 3.0], Rotation.from_euler("zyx", [2.0, 0.3, -0.4]))
    first, last = np.clip(trajectory.span, 0.0, 1.0)
    times = np.linspace(first, last, 101)
    expected = world.as_matrix() @ trajectory.at(times).as_matrix()
    for moved_world in (world, world.as_matrix()):
        other = moved_world @ trajectory
        assert isinstance(other, ls.Trajectory)
        assert other.span == trajectory.span
        # Entries up to 200 m pass through some twenty roundings, in two orders.
        np.testing.assert_allclose(other.at(times).as_matrix(), expected, rtol=0, atol=40 * math.ulp(200.0))
        velocity, angular = trajectory.velocity(times)
        np.testing.assert_allclose(
            other.velocity(times)[0], world.rotation.apply(velocity), rtol=0, atol=40 * math.ulp(np.abs(velocity).max())
        )
        np.testing.assert_allclose(
            other.velocity(times)[1], angular, rtol=0, atol=40 * math.ulp(max(1.0, np.abs(angular).max()))
        )
    again = world.inv() @ (world @ trajectory)
    np.testing.assert_allclose(
        again.at(times).as_matrix(), trajectory.at(times).as_matrix(), rtol=0, atol=60 * math.ulp(200.0)
    )
    assert pickle_and_load(world @ trajectory).span == trajectory.span


def test_poses_of_a_camera_are_turned_to_those_of_a_body(tmp_path: Path) -> None:
    """A camera that drives ahead and turns right is a body that drives ahead along x and turns to negative yaw."""
    right = Rotation.from_euler("y", 0.5)  # y is down
    ahead = RigidTransform.from_components([0.0, 0.0, 10.0], right)
    camera = ls.Trajectory([0.0, 1.0], np.stack([np.eye(4), ahead.as_matrix()]))
    camera.save(tmp_path / "drive.kitti")
    body = ls.Trajectory.load(tmp_path / "drive.kitti", times=[0.0, 1.0], axes="camera")
    assert body.at(0.0).as_matrix().tolist() == np.eye(4).tolist()
    assert body.at(1.0).translation.tolist() == [10.0, 0.0, 0.0]
    np.testing.assert_allclose(body.at(1.0).rotation.as_rotvec(), [0, 0, -0.5], rtol=0, atol=4 * math.ulp(0.5))
    with pytest.raises(ValueError, match=r"^axes: expected 'body' or 'camera', got 'ned'"):
        ls.Trajectory.load(tmp_path / "drive.kitti", times=[0.0, 1.0], axes="ned")


@pytest.mark.parametrize(
    ("world", "message"),
    [
        (np.diag([1, 1, 2, 1]), "world: expected a rigid transform (orthonormal rotation), "),
        (np.eye(3), "world: expected shape (4, 4), got (3, 3)"),
        (translation(2.0**981), "world: expected numbers up to "),
    ],
)
def test_bad_worlds(world: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        world @ spline()


@pytest.mark.parametrize(
    ("mount", "error", "message"),
    [
        (np.diag([1, 1, 2, 1]), ValueError, "mount: expected a rigid transform (orthonormal rotation), "),
        (np.eye(3), ValueError, "mount: expected shape (4, 4), got (3, 3)"),
        (spline(), TypeError, "mount: expected a pose, got a Trajectory"),
    ],
)
def test_bad_mounts(mount: object, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        spline() @ mount


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ls.Trajectory([], []), "times: expected at least one, got none"),
        (lambda: ls.Trajectory([0.0, math.nan], [np.eye(4)] * 2), "times: expected finite numbers, got times[1] = nan"),
        (
            lambda: ls.Trajectory([0, 1, 1], [np.eye(4)] * 3),
            "times: expected rising times, got times[2] = 1.0 after 1.0",
        ),
        (lambda: ls.Trajectory([0, 1], [np.eye(4)]), "poses: expected shape (2, 4, 4), one per time, got (1, 4, 4)"),
        (lambda: ls.Trajectory([0], np.eye(4)), "poses: expected shape (1, 4, 4), one per time, got (4, 4)"),
        (
            lambda: ls.Trajectory([0, 1], [np.eye(4), np.diag([1, 1, 2, 1])]),
            "poses[1]: expected a rigid transform (orthonormal rotation), got one 3 away from it, determinant 2",
        ),
        (
            lambda: ls.Trajectory([0, 1], [np.eye(4), np.diag([1, 1, -1, 1])]),
            "poses[1]: expected a rigid transform (orthonormal rotation), got a reflection, determinant -1",
        ),
        (
            lambda: ls.Trajectory([0, 1], [np.eye(4), translation(math.nan)]),
            "poses: expected finite numbers, got poses[1][0][3] = nan",
        ),
        (
            lambda: ls.Trajectory([0, 1], [np.eye(4), 2 * np.eye(4)]),
            "poses[1]: expected a last row of (0, 0, 0, 1), got (0.0, 0.0, 0.0, 2.0)",
        ),
        (
            lambda: ls.Trajectory([0, 1], [translation(-1.5e308), translation(1.5e308)]),
            "times, poses: expected times, positions and velocities within the range of float64, got others",
        ),
        (
            lambda: ls.Trajectory([-1.5e308, 1.5e308], [np.eye(4)] * 2),
            "times, poses: expected times, positions and velocities within the range of float64, got others",
        ),
        (
            lambda: ls.Trajectory([0, 1e-200, 1], [translation(x) for x in (0, 1e200, 2)], interpolation="spline"),
            "times, poses: expected times, positions and velocities within the range of float64, got others",
        ),
        (
            lambda: ls.Trajectory([0], [np.eye(4)], interpolation="cubic"),
            "interpolation: expected 'linear' or 'spline', got 'cubic'",
        ),
        (
            lambda: ls.Trajectory(TIMES, poses()).velocity(5.0),
            "times: expected times from -1.0 to 4.0 s, got times = 5.0",
        ),
        (
            lambda: ls.Trajectory(TIMES, poses()).at([0.0, 5.0]),
            "times: expected times from -1.0 to 4.0 s, got times[1] = 5.0",
        ),
        (
            lambda: ls.Trajectory.from_twist(np.eye(4), linear=(0, 1e300, 0)),
            "linear: expected numbers up to 1.02e+295 of what moves, got 1e+300",
        ),
        (
            lambda: ls.Trajectory.from_twist(np.eye(4), angular=(0, 0, -1e308)),
            "angular: expected numbers up to 1.02e+295 of what moves, got 1e+308",
        ),
        (
            lambda: ls.Trajectory.from_twist(translation(1e300)),
            "pose: expected numbers up to 1.02e+295 of what moves, got 1e+300",
        ),
        (
            lambda: ls.Trajectory(TIMES, poses()) @ translation(1e300),
            "mount: expected numbers up to 1.02e+295 of what moves, got 1e+300",
        ),
        (
            lambda: ls.Trajectory([0, 1], [translation(0), translation(1e300)]),
            "times, poses: expected times, positions and velocities within the range of float64, got others",
        ),
        (
            lambda: ls.Trajectory(TIMES, [[1], [2, 3]]),
            "poses: expected shape (4, 4, 4), one per time, got a ragged sequence",
        ),
        (
            lambda: ls.Trajectory.from_twist(np.eye(4), linear=(1, 2)),
            "linear: expected shape (3,), got (2,)",
        ),
        (
            lambda: ls.Trajectory.from_twist(np.eye(4), angular=(0, 0, math.inf)),
            "angular: expected finite numbers, got angular[2] = inf",
        ),
        (
            lambda: ls.Trajectory(TIMES, poses()).at([0.0, 4.5]),
            "times: expected times from -1.0 to 4.0 s, got times[1] = 4.5",
        ),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        make()


def turning() -> ls.Trajectory:
    twist = ls.Trajectory.from_twist(np.eye(4), linear=(10, 0, 0), angular=(0, 0, 0.3))
    times = np.linspace(0.0, 20.0, 11)
    return ls.Trajectory(times, twist.at(times), interpolation="spline")


def test_a_constant_error_is_a_mount_and_a_shift() -> None:
    path = turning()
    assert path.perturbed().at(3.3).as_matrix().tolist() == (path @ np.eye(4)).at(3.3).as_matrix().tolist()
    off = path.perturbed(boresight=(0.01, -0.02, 0.03), lever_arm=(1, 2, 3)).at(3.3)
    mount = RigidTransform.from_components((1, 2, 3), Rotation.from_euler("xyz", (0.01, -0.02, 0.03)))
    # A dozen roundings of positions below 64 and of rotations.
    np.testing.assert_allclose(off.as_matrix(), (path.at(3.3) * mount).as_matrix(), rtol=0, atol=16 * 2.0**-47)
    drawn = path.perturbed(position_sigma=(1.0, 0.0, 2.0), orientation_sigma=0.1, seed=4)
    shifts = (drawn.at([0.0, 7.7, 20.0]).translation - path.at([0.0, 7.7, 20.0]).translation).T
    assert (np.abs(shifts[[0, 2]]).max(axis=1) > 1e-3).all()
    assert np.abs(shifts - shifts[:, :1]).max() < 16 * 2.0**-46  # constant, for positions below 128
    assert np.abs(shifts[1]).max() < 16 * 2.0**-46
    turns = (path.at([0.0, 7.7]).rotation.inv() * drawn.at([0.0, 7.7]).rotation).as_rotvec()
    assert np.linalg.norm(turns[0]) > 0.01
    assert np.abs(turns[1] - turns[0]).max() < 16 * 2.0**-52


def test_the_errors_have_the_deviation_and_the_correlation_that_they_should() -> None:
    """Two thousand flights: means and covariances at three times, beside those of the process, at 5 sigma."""
    path, seeds, times = ls.Trajectory([0.0, 4.0], [np.eye(4)] * 2), 2000, np.array([0.0, 0.8, 4.0])
    sigmas, scale = np.array([0.5, 0.5, 0.5, 0.01, 0.02, 0.03]), 2.0
    errors = np.empty((seeds, 3, 6))
    for seed in range(seeds):
        found = path.perturbed(position_sigma=0.5, orientation_sigma=sigmas[3:], correlation_time=scale, seed=seed).at(
            times
        )
        errors[seed] = np.hstack([found.translation, found.rotation.as_rotvec()])
    errors /= sigmas
    assert np.abs(errors.mean(axis=0)).max() < 5 / np.sqrt(seeds)
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)):
        right = np.exp(-abs(times[i] - times[j]) / scale)
        # The variance of a product of two standard normals with correlation r is 1 + r².
        off = (errors[:, i] * errors[:, j]).mean(axis=0) - right
        assert np.abs(off).max() < 5 * np.sqrt((1 + right**2) / seeds)
    assert np.abs((errors[:, 0, 0] * errors[:, 0, 1]).mean()) < 5 / np.sqrt(seeds)  # independent axes


def test_a_perturbed_spline_stays_smooth_and_near() -> None:
    path, dense = turning(), np.linspace(0.0, 20.0, 1001)
    found = path.perturbed(position_sigma=1e-6, correlation_time=1.0, seed=1)
    assert found.span == path.span
    assert len(found.times) == 201
    # The spline through points of a cubic spline, its knots among them, is this spline. The errors are below 10 sigma,
    # and a cubic spline through them stays within twice their range.
    assert np.abs(found.at(dense).translation - path.at(dense).translation).max() < 2e-5
    again = path.perturbed(position_sigma=1e-6, correlation_time=1.0, seed=1)
    assert found.at(dense).as_matrix().tolist() == again.at(dense).as_matrix().tolist()
    assert (
        found.at(dense).as_matrix().tolist()
        != path.perturbed(position_sigma=1e-6, correlation_time=1.0, seed=2).at(dense).as_matrix().tolist()
    )


def test_changing_errors_of_a_mounted_sensor_leave_it_on_the_arc_of_its_body() -> None:
    """A body that turns by a right angle each second carries a sensor 2 m ahead, and one on that."""
    knots, dense = np.arange(3.0), np.linspace(0.0, 2.0, 201)
    turned = Rotation.from_rotvec(np.outer(knots, (0.0, 0.0, math.pi / 2)))
    aside = RigidTransform.from_components((0.0, 1.0, 0.5), Rotation.from_euler("xyz", (0.3, 1.0, -2.0)))
    path = ls.Trajectory(knots, RigidTransform.from_rotation(turned)) @ translation(2.0) @ aside
    sigmas: dict[str, Any] = {"position_sigma": 0.5, "correlation_time": 3.0, "seed": 3}
    found = path.perturbed(**sigmas)
    # What stands at the origin has the errors alone, and what is linear in both poses is linear in their sum.
    still = ls.Trajectory(knots, np.stack([np.eye(4)] * 3))
    expected = path.at(dense).translation + still.perturbed(**sigmas).at(dense).translation
    assert np.abs(still.perturbed(**sigmas).at(dense).translation).max() > 0.1
    np.testing.assert_allclose(found.at(dense).translation, expected, rtol=0, atol=64 * math.ulp(4.0))
    np.testing.assert_allclose(
        found.at(dense).rotation.as_matrix(), path.at(dense).rotation.as_matrix(), rtol=0, atol=64 * math.ulp(1.0)
    )
    found = path.perturbed(**sigmas, orientation_sigma=0.1, boresight=(0.1, 0.2, 0.3), lever_arm=(1, 2, 3))
    error = still.perturbed(**sigmas, orientation_sigma=0.1).at(found.times)
    mount = RigidTransform.from_components((1, 2, 3), Rotation.from_euler("xyz", (0.1, 0.2, 0.3)))
    shifted = RigidTransform.from_translation(error.translation) * path.at(found.times)
    right = shifted * RigidTransform.from_rotation(error.rotation) * mount
    np.testing.assert_allclose(found.at(found.times).as_matrix(), right.as_matrix(), rtol=0, atol=64 * math.ulp(8.0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"position_sigma": -1.0}, "position_sigma: expected numbers >= 0, got -1"),
        ({"orientation_sigma": (1, 2)}, r"orientation_sigma: expected shape \(3,\), got \(2,\)"),
        ({"position_sigma": 1, "correlation_time": 0.0}, "correlation_time: expected a real number > 0, got 0.0"),
        (
            {"position_sigma": 1, "correlation_time": 1e-9},
            "expected a time that needs at most 10,000,000 poses, got 1e-09",
        ),
        ({"boresight": (0, 0, 0.5)}, r"boresight: expected numbers from .*, got boresight\[2\] = 0.5; degrees\?"),
        ({"orientation_sigma": 0.5}, r"orientation_sigma: expected numbers from .* degrees\?"),
        ({"boresight": 1.0}, r"boresight: expected shape \(3,\), got"),
        ({"seed": -1}, "seed: expected an integer"),
    ],
)
def test_errors_that_do_not_fit(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        turning().perturbed(**arguments)


def test_an_endless_trajectory_has_no_changing_errors() -> None:
    path = ls.Trajectory.from_twist(np.eye(4), linear=(10, 0, 0))
    with pytest.raises(
        ValueError, match=r"^correlation_time: expected inf, as the trajectory has no end, got 2\.0; give"
    ):
        path.perturbed(position_sigma=1.0, correlation_time=2.0)


# Strips of a survey

SURVEY: dict[str, Any] = {"height": 500.0, "speed": 60.0, "overlap": 0.3, "field_of_view": math.radians(40)}
SWATH = 2 * 500 * math.tan(math.radians(20))
KITE = [(0, 0), (2000, 600), (2400, 2000), (500, 1300)]


def swaths(strips: list[ls.Trajectory]) -> list[npt.NDArray[np.float64]]:
    """Return the corners on the ground of what each strip sees, shape (4, 2)."""
    found = []
    for strip in strips:
        ends, left = strip.poses.translation[:, :2], strip.poses.as_matrix()[0, :2, 1]
        found.append(
            np.array(
                [ends[0] + side * left for side in (-SWATH / 2, SWATH / 2)]
                + [ends[1] + side * left for side in (SWATH / 2, -SWATH / 2)]
            )
        )
    return found


def within(points: npt.NDArray[np.float64], corners: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Return which points lie in a convex polygon, whatever its orientation, to a micrometre of rounding."""
    sides = []
    for a, b in pairwise([*corners, corners[0]]):
        (x, y), (u, v) = b - a, (points - a).T
        sides.append((x * v - y * u) / np.hypot(x, y))
    return (np.min(sides, axis=0) > -1e-6) | (np.max(sides, axis=0) < 1e-6)


@pytest.mark.parametrize(
    ("height", "overlap", "width", "count"),
    [(500, 0.2, 1000, 1), (500, 0.2, 1800, 2), (500, 0.3, 1700, 2), (500, 0.2, 1001, 2)],
)
@pytest.mark.parametrize("north", [0.0, 5.264e6])
def test_strips_that_just_cover_an_area_are_enough(
    height: float, overlap: float, width: float, count: int, north: float
) -> None:
    area = (0, north, 3000, north + width)
    turn = np.radians(90)  # of which the tangent of the half is 1 but for rounding
    strips = ls.Trajectory.strips(area, height=height, speed=50, overlap=overlap, field_of_view=turn)
    assert len(strips) == count


@pytest.mark.parametrize("heading", [0.0, 0.4, math.pi / 2, -2.0])
@pytest.mark.parametrize("area", [(0, 0, 1500, 2000), KITE], ids=["rectangle", "polygon"])
def test_strips_cover_the_area_and_no_fewer_would(area: Any, heading: float) -> None:
    strips = ls.Trajectory.strips(area, **SURVEY, heading=heading)
    rectangle = np.array([(0, 0), (1500, 0), (1500, 2000), (0, 2000)], float)
    corners = np.array(KITE, float) if area is KITE else rectangle
    grid = np.stack(np.meshgrid(np.arange(0, 2401, 23.0), np.arange(0, 2001, 19.0)), axis=-1).reshape(-1, 2)
    inside = np.concatenate([grid[within(grid, corners)], corners])
    assert len(inside) > 1000
    seen = np.array([within(inside, swath) for swath in swaths(strips)])
    assert seen.any(axis=0).all()
    left = np.array([-math.sin(heading), math.cos(heading)])
    width = np.ptp(corners @ left)
    assert SWATH + (len(strips) - 2) * 0.7 * SWATH < width <= SWATH + (len(strips) - 1) * 0.7 * SWATH
    lines = np.array([strip.poses.translation[0, :2] @ left for strip in strips])
    assert np.diff(lines) == pytest.approx(0.7 * SWATH)
    assert lines.mean() == pytest.approx(0.5 * ((corners @ left).min() + (corners @ left).max()))


def test_strips_fly_to_and_fro_one_after_the_other() -> None:
    strips = ls.Trajectory.strips(
        (500_000, 5_400_000, 501_500, 5_402_000), **SURVEY, heading=math.pi / 2, turn=45, ground=300, margin=30
    )
    assert len(strips) == 6
    for number, strip in enumerate(strips):
        start, end = strip.span
        assert end - start == pytest.approx(2060 / 60)
        assert strip.velocity(start)[0] == pytest.approx([0, -60 if number % 2 else 60, 0])
        assert strip.at(start).translation[1:] == pytest.approx([5_402_030 if number % 2 else 5_399_970, 800])
        rotation = strip.at(end).rotation.as_matrix()
        assert rotation[:, 0] == pytest.approx([0, -1 if number % 2 else 1, 0])
        assert rotation[:, 2] == pytest.approx([0, 0, 1])
    assert strips[0].span[0] == 0
    assert [after.span[0] - before.span[1] for before, after in pairwise(strips)] == pytest.approx([45] * 5)
    east = [strip.poses.translation[0, 0] for strip in strips]
    assert east == sorted(east, reverse=True)  # from right to left


def test_a_strip_is_as_long_as_the_area_in_its_swath() -> None:
    """In a triangle whose hypotenuse is x = y, a strip along x begins where its left border meets it."""
    strips = ls.Trajectory.strips([(0, 0), (2000, 2000), (2000, 0)], **SURVEY)
    assert len(strips) > 2
    for strip in strips:
        x, y = strip.poses.translation[:, 0], strip.poses.translation[0, 1]
        assert sorted(x) == pytest.approx([max(y - SWATH / 2, 0), 2000])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"area": (0, 0, 0, 5)}, r"^area: expected x_min < x_max and y_min < y_max, got \[0, 0, 0, 5\]$"),
        ({"area": (0, 0, 5)}, r"^area: expected shape \(4,\), got \(3,\)"),
        ({"area": [(0, 0), (5, 5)]}, "^area: expected x_min, y_min, x_max, y_max, or at least 3 corners, got 2"),
        ({"area": [(0, 0), (0, 5), (0, 9)]}, "^area: expected a length above 0 along the line of flight, got 0 m"),
        ({"area": [(0, 0), (0, 5, 2)]}, "^area: expected "),
        ({"overlap": 1.0}, "^overlap: expected a share from 0 to less than 1, got 1; 20 % is 0.2"),
        ({"overlap": -0.1}, "^overlap: expected a finite number >= 0"),
        ({"height": 0.0}, "^height: expected a finite number > 0"),
        ({"speed": -1.0}, "^speed: expected a finite number > 0"),
        ({"field_of_view": 40.0}, "^field_of_view: expected an angle less than π, got 40; degrees"),
        ({"turn": 1e20}, "^turn, speed: expected strips whose times differ, and within the range of float64, got one"),
        ({"turn": 1e308}, "^turn, speed: expected strips whose times differ"),
        ({"height": 1e308, "field_of_view": 3.0}, "^height: expected a height whose swath is within the range of"),
        ({"turn": -1.0}, "^turn: expected a finite number >= 0"),
        ({"field_of_view": 1e-6}, "^area: expected one that 10,000 strips cover, got "),
    ],
)
def test_strips_that_cannot_be_flown(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        ls.Trajectory.strips(**{"area": (0, 0, 1500, 2000), **SURVEY, **arguments})


def test_trajectories_through_many_poses_are_those_of_each() -> None:
    times = np.array([0.0, 0.1, 0.35, 2.0])
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (5, 4, 1, 1))
    poses[..., :3, :3] = Rotation.random(20, rng).as_matrix().reshape(5, 4, 3, 3)
    poses[..., :3, 3] = rng.normal(size=(5, 4, 3))
    when = np.linspace(0.0, 2.0, 50)
    together = ls.Trajectory._through(times, poses)
    assert len(together) == 5
    for one, own in zip(together, poses, strict=True):
        assert (one.at(when).as_matrix() == ls.Trajectory(times, own).at(when).as_matrix()).all()
