"""Scans of 2D lidars as ROS's LaserScan: laser_geometry's formula gives the points of the scan."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import ArgumentValueError


def room() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Box((6, 8, 3), center=(1, 0, 0)))
    scene.add(ls.Cylinder((2, 1, -1), (2, 1, 1), 0.3))
    return scene


def wall_and_post() -> ls.Scene:
    """A wall on one side, and a post nearer than any minimum range."""
    scene = ls.Scene()
    scene.add(ls.Polygon([(3, -9, -1), (3, 9, -1), (3, 9, 1), (3, -9, 1)]))
    scene.add(ls.Cylinder((0.1, 0.3, -1), (0.1, 0.3, 1), 0.05))
    return scene


@pytest.mark.parametrize("name", ["sick-lms111", "hokuyo-utm30lx", "rplidar-a1"])
def test_angles_and_ranges_give_the_points(name: str) -> None:
    lidar = ls.Lidar.preset(name, noise="datasheet")
    scan = lidar.scan(room(), time=2.0, seed=3)
    found = scan.laser_scan()
    angles, there = found.angles, np.isfinite(found.ranges)
    points = scan.point_cloud()
    assert len(points) == there.sum() > 300
    order = np.argsort(np.arctan2(points.xyz[:, 1], points.xyz[:, 0]))
    cloud = points[order] if name == "rplidar-a1" else points
    # The azimuth of a point that is off by π may be −π there, and angle_min the other.
    x, y = found.ranges[there] * np.cos(angles[there]), found.ranges[there] * np.sin(angles[there])
    mine = np.column_stack((x, y))
    mine = mine[np.argsort(np.arctan2(mine[:, 1], mine[:, 0]))] if name == "rplidar-a1" else mine
    # float32 ranges round by 2⁻²⁴. Angles, sums of the first and of a multiple of their step, and the direction of the
    # pulse round by some spacings of π.
    near = float(found.ranges[there].max()) * (2.0**-24 + 4 * np.spacing(np.pi))
    np.testing.assert_allclose(mine, cloud.xyz[:, :2], rtol=0, atol=near)
    assert found.angle_increment > 0
    last = found.angle_min + (len(found) - 1) * found.angle_increment
    assert abs(found.angle_max - last) <= 2 * np.spacing(np.pi)  # the step, its product and the sum round
    assert (found.scan_time, found.range_min, found.range_max) == (
        1.0 / lidar.pattern.rate,
        lidar.min_range,
        lidar.max_range,
    )
    assert found.ranges.dtype == found.intensities.dtype == np.float32


@pytest.mark.parametrize("clockwise", [False, True])
def test_time_of_an_entry_is_that_of_its_pulse(clockwise: bool) -> None:
    pattern = ls.patterns.Spinning([0.0], columns=360, rate=10.0, clockwise=clockwise)
    scan = ls.Lidar(pattern).scan(room(), time=5.0)
    found = scan.laser_scan()
    assert (found.time_increment < 0) == clockwise
    times = found.time + found.time_increment * np.arange(len(found))
    directions = np.column_stack((np.cos(found.angles), np.sin(found.angles)))
    nearest = np.argmax(directions @ scan.pulses.directions[:, :2].T, axis=1)
    assert len(set(nearest.tolist())) == len(found) == 360
    # The time of the first entry rounds, and both sums.
    np.testing.assert_allclose(times, 5.0 + scan.pulses.time[nearest], rtol=0, atol=2 * np.spacing(5.1))
    np.testing.assert_array_equal(found.ranges, scan.range[nearest, 0].astype(np.float32))
    np.testing.assert_array_equal(found.intensities, scan.intensity[nearest, 0])


def test_what_has_no_return_is_infinite_and_what_is_too_near_minus_infinite() -> None:
    scan = replace(ls.Lidar.preset("sick-lms111"), min_range=0.5).scan(wall_and_post())
    found = scan.laser_scan()
    status = scan.status
    assert {int(ls.Status.hit), int(ls.Status.miss), int(ls.Status.below_min_range)} <= set(status.tolist())
    assert (found.ranges == -np.inf).sum() == (status == ls.Status.below_min_range).sum()
    assert np.isfinite(found.ranges).sum() == (status == ls.Status.hit).sum()
    assert not np.isnan(found.ranges).any()
    assert not found.intensities[~np.isfinite(found.ranges)].any()
    again = pickle.loads(pickle.dumps(found))  # noqa: S301 - own pickle
    np.testing.assert_array_equal(again.ranges, found.ranges)


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        (ls.patterns.Spinning([0.0, 0.1], columns=20), "one ring of at least two pulses, got 2 rings"),
        (ls.patterns.Spinning([0.1], columns=20), r"in the plane z = 0, from its middle, got pulse 0"),
        (ls.patterns.Spinning([0.0], columns=1), "at least two pulses, got 1 pulse"),
        (ls.patterns.Grid([0.0, 0.1, 0.3], [0.0], rate=10.0), "equal steps of azimuth, got beam 1 of 3 off by"),
        (
            ls.patterns.Spinning([0.0], columns=20, beam_origins=[(0, 0, 0.1)]),
            r"from its middle, got pulse 0 from \[0.0, 0.0, 0.1\]",
        ),
    ],
)
def test_other_scans_are_refused(pattern: ls.patterns.Pattern, message: str) -> None:
    with pytest.raises(ArgumentValueError, match=message):
        ls.Lidar(pattern).scan(room()).laser_scan()
