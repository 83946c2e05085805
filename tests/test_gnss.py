"""GNSS receivers: lever arms, statistics of their errors, files and refusals."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import FileFormatError

STILL = ls.Trajectory.from_twist(np.eye(4))
EQUATOR = ls.Georeference(origin=(0.0, 0.0, 0.0))
AXIS, SQUARED = 6_378_137.0, 0.00669437999014  # of WGS 84


def position(fixes: ls.GnssFixes) -> np.ndarray:
    """East, north and up near the origin at the equator, where a radian is a in longitude and a(1 - e²) in latitude."""
    return np.column_stack([fixes.longitude * AXIS, fixes.latitude * AXIS * (1 - SQUARED), fixes.altitude])


def test_the_antenna_is_on_a_lever_arm() -> None:
    mount = RigidTransform.from_components([1.0, 2.0, 0.5], Rotation.from_euler("z", 0.3)).as_matrix()
    spin = ls.Trajectory.from_twist(np.eye(4), (3, 0, 0), (0, 0, 1.0))
    fixes = ls.Gnss(5.0, mount=mount).measure(spin, EQUATOR, end=2.0, seed=1)
    assert len(fixes) == 11
    np.testing.assert_array_equal(fixes.time, np.arange(11) / 5)
    # The body is at 3 (sin t, 1 - cos t): the arm (1, 2) turns by t with it.
    t = fixes.time
    east = 3 * np.sin(t) + np.cos(t) - 2 * np.sin(t)
    north = 3 * (1 - np.cos(t)) + np.sin(t) + 2 * np.cos(t)
    # In 6 m the surface curves away by 6²/2a, 3 µm.
    np.testing.assert_allclose(position(fixes), np.column_stack([east, north, np.full(11, 0.5)]), rtol=0, atol=3e-6)


def test_linear_trajectories_and_poses_at_rest() -> None:
    corner = ls.Trajectory([0.0, 1.0, 2.0], [np.eye(4)] * 2 + [RigidTransform.from_translation([1, 0, 0]).as_matrix()])
    fixes = ls.Gnss(2.0).measure(corner, EQUATOR)
    # The arc is shorter than the way east x by the share x²/3a², and three operations round.
    np.testing.assert_allclose(fixes.longitude * AXIS, [0, 0, 0, 0.5, 1], rtol=1 / (3 * AXIS**2) + 4 * 2.0**-52)


def test_errors_have_their_standard_deviations_and_correlation() -> None:
    rate, time = 1.0, 5.0
    noisy = ls.Gnss(rate, position_sigma=(1.0, 2.0, 3.0)).measure(STILL, EQUATOR, end=9999.0, seed=3)
    errors = position(noisy)
    # Ten thousand independent numbers: the variance is off by its own share √(2/n), five times at most.
    np.testing.assert_allclose(errors.var(axis=0), [1, 4, 9], rtol=5 * math.sqrt(2 / 10_000))
    slow = position(ls.Gnss(rate, drift_sigma=1.0, drift_time=time).measure(STILL, EQUATOR, end=39_999.0, seed=3))
    # Neighbours are correlated by r = e^(-1/5): the variance of a mean of squares is 2 (1 + r²)/((1 - r²) n).
    r, n = math.exp(-1 / (rate * time)), 40_000
    share = math.sqrt(2 * (1 + r * r) / ((1 - r * r) * n))
    np.testing.assert_allclose((slow**2).mean(axis=0), 1.0, rtol=5 * share)
    kept = (slow[1:] * slow[:-1]).mean(axis=0)
    np.testing.assert_allclose(kept, r, rtol=5 * share)
    assert (np.abs(errors[1:] * errors[:-1]).mean(axis=0) > 0).all()


def test_errors_depend_on_seed_and_name_only() -> None:
    gnss = ls.Gnss(10.0, position_sigma=0.1, drift_sigma=1.0)
    first, longer = (gnss.measure(STILL, EQUATOR, end=end, seed=4) for end in (1.0, 2.0))
    np.testing.assert_array_equal(longer.latitude[:11], first.latitude)
    part = longer.between(0.5, 1.0)
    np.testing.assert_array_equal(part.altitude, longer.altitude[5:10])
    assert part.gnss is longer.gnss
    other = ls.Gnss(10.0, position_sigma=0.1, drift_sigma=1.0, name="b").measure(STILL, EQUATOR, end=1.0, seed=4)
    fifth = gnss.measure(STILL, EQUATOR, end=1.0, seed=5)
    assert (first.latitude != other.latitude).all()
    assert (first.latitude != fifth.latitude).all()


def test_errors_from_time_0_stay_as_they_are() -> None:
    fixes = ls.Gnss(10.0, position_sigma=0.1, drift_sigma=1.0).measure(STILL, EQUATOR, end=1.0, seed=4)
    np.testing.assert_allclose(fixes.altitude[[0, -1]], [-0.629361410625279, -0.7067095683887601], rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind", ["position_sigma", "drift_sigma"])
def test_errors_differ_between_starts(kind: str) -> None:
    gnss = ls.Gnss(1.0, **{kind: 1.0})

    def errors(start: float) -> np.ndarray:
        return position(gnss.measure(STILL, EQUATOR, start=start, end=start + 2.0, seed=4))

    starts = [97.0 * k for k in range(400)]
    found = np.array([errors(start) for start in starts])
    assert len(np.unique(found)) == found.size
    # The mean of 400 independent legs is off by its own standard deviation, 1/20, five times at most.
    assert (abs(found.mean(axis=0)) < 5 / 20).all()
    assert (errors(0.2) != errors(0.0)).all()  # a fifth of the time between fixes
    np.testing.assert_array_equal(errors(97.0), found[1])


def test_csv(tmp_path: Path) -> None:
    munich = ls.Georeference(origin=(math.radians(48.137), math.radians(11.575), 520.0))
    fixes = ls.Gnss(10.0, position_sigma=1.0).measure(STILL, munich, end=3.0)
    fixes.save(tmp_path / "gnss.csv")
    head, first, *_ = (tmp_path / "gnss.csv").read_text().splitlines()
    assert head == "#timestamp [ns],latitude [deg],longitude [deg],altitude [m]"
    assert first.startswith("0,48.13")
    read = ls.GnssFixes.load(tmp_path / "gnss.csv")
    np.testing.assert_allclose(read.time, fixes.time, rtol=0, atol=0.6e-9)
    for name in ("latitude", "longitude"):  # two products, to degrees and back
        np.testing.assert_allclose(getattr(read, name), getattr(fixes, name), rtol=2 * 2.0**-52)
    np.testing.assert_array_equal(read.altitude, fixes.altitude)
    assert read.gnss is None
    (tmp_path / "bad.csv").write_text("0,1,2\n")
    with pytest.raises(FileFormatError, match=r"bad\.csv:1: expected 4 numbers, got 3"):
        ls.GnssFixes.load(tmp_path / "bad.csv")
    (tmp_path / "none.csv").write_text("#\n")
    with pytest.raises(FileFormatError, match="expected fixes of a GNSS receiver, got none"):
        ls.GnssFixes.load(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda: ls.Gnss(0.0), "rate: expected a finite number > 0, got 0.0"),
        (lambda: ls.Gnss(-5), "rate: expected a finite number > 0, got -5"),
        (lambda: ls.Gnss(5.0, position_sigma=-1.0), "position_sigma: expected numbers >= 0, got -1"),
        (lambda: ls.Gnss(5.0, position_sigma=(1.0, 2.0)), "position_sigma: expected"),
        (lambda: ls.Gnss(5.0, drift_time=0.0), "drift_time: expected a finite number > 0, got 0.0"),
        (lambda: ls.Gnss(5.0, mount=np.diag([2.0, 1, 1, 1])), "mount: expected a rigid transform"),
        (lambda: ls.Gnss(5.0, name=3), "name: expected a text, got 3"),
        (lambda: ls.Gnss(5.0).measure(STILL, None, end=1.0), "georeference: expected a Georeference, got None"),
        (lambda: ls.Gnss(5.0).measure(np.eye(4), EQUATOR), "trajectory: expected a Trajectory"),
        (lambda: ls.Gnss(5.0).measure(STILL, EQUATOR), "end: expected a time, as the trajectory has no end, got none"),
        (
            lambda: ls.Gnss(5.0).measure(ls.Trajectory.from_twist(np.eye(4), (2e6, 0, 0)), EQUATOR, end=1.0),
            "positions: expected coordinates within 1,000,000 m of the origin",
        ),
    ],
)
def test_bad_arguments(call: Any, problem: str) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        call()
    assert str(caught.value).startswith(problem)


def test_receivers_are_values() -> None:
    gnss = ls.Gnss(5.0, position_sigma=(1, 1, 2), drift_sigma=0.5)
    assert pickle.loads(pickle.dumps(gnss)) == gnss == copy.deepcopy(gnss)  # noqa: S301
    assert gnss != ls.Gnss(5.0)
    assert not gnss.mount.flags.writeable
