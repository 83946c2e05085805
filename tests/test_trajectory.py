"""Trajectories: poses met, poses between, circles, and what is refused."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ls.Trajectory([], []), "times: expected at least one, got none"),
        (lambda: ls.Trajectory([0.0, math.nan], [np.eye(4)] * 2), "times: expected finite numbers, got times[1] = nan"),
        (
            lambda: ls.Trajectory([0, 1, 1], [np.eye(4)] * 3),
            "times: expected rising times, got times[2] = 1.0 after 1.0",
        ),
        (lambda: ls.Trajectory([0, 1], [np.eye(4)]), "poses: expected shape (2, 4, 4), one a time, got (1, 4, 4)"),
        (lambda: ls.Trajectory([0], np.eye(4)), "poses: expected shape (1, 4, 4), one a time, got (4, 4)"),
        (
            lambda: ls.Trajectory([0, 1], [np.eye(4), np.diag([1, 1, 2, 1])]),
            "poses[1]: expected a rigid transform (orthonormal rotation), got one 3 away from it, determinant 2",
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
