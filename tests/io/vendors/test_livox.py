from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.patterns import Pattern, Table


def write(path: Path, pattern: Pattern, frames: int) -> None:
    """Write the directions of a pattern as Livox does: hundredths of a degree, and the row's number as time."""
    x, y, z = np.concatenate([pattern.pulses(frame).directions for frame in range(frames)]).T
    azimuth = np.degrees(np.arctan2(y, x)) % 360.0
    zenith = 90.0 - np.degrees(np.arcsin(z))
    rows = np.c_[np.arange(len(x)), azimuth, zenith]
    np.savetxt(
        path, rows, fmt=["%d", "%.2f", "%.2f"], delimiter=",", header="Time/s,Azimuth/deg,Zenith/deg", comments=""
    )


@pytest.mark.parametrize(
    ("name", "shape"), [("livox-mid40", (1, 10_000)), ("livox-mid70", (1, 10_000)), ("livox-mid360", (4, 5_000))]
)
def test_pattern_is_that_of_the_file(tmp_path: Path, name: str, shape: tuple[int, int]) -> None:
    path = tmp_path / "pattern.csv"
    preset = ls.Lidar.preset(name)
    write(path, preset.pattern, 3)
    lidar = ls.Lidar.from_file(path)
    assert isinstance(lidar.pattern, Table)
    assert lidar.pattern.shape == shape
    assert (lidar.name, lidar.min_range, lidar.max_range) == (name, preset.min_range, preset.max_range)
    for frame in range(4):
        got, expected = lidar.pattern.pulses(frame), preset.pattern.pulses(frame % 3)
        # angles rounded to 0.01 degrees, half of it in each of two
        near = np.sqrt(2) * np.radians(0.005) + np.spacing(1.0)
        np.testing.assert_allclose(got.directions, expected.directions, rtol=0, atol=near)
        np.testing.assert_allclose(got.time, expected.time, rtol=0, atol=2 * np.spacing(0.3))  # of three frames
        np.testing.assert_array_equal(got.ring, expected.ring)


def test_pulse_rate_of_another_model_may_be_said(tmp_path: Path) -> None:
    path = tmp_path / "pattern.csv"
    path.write_text("Time/s,Azimuth/deg,Zenith/deg\n0,0,90\n1,10,80\n2,350,100\n")
    lidar = ls.Lidar.from_file(path, pulse_rate=50.0, rate=10.0)
    assert [len(lidar.pattern.pulses(frame)) for frame in range(2)] == [3, 3]
    np.testing.assert_allclose(lidar.pattern.pulses().time, [0.0, 0.02, 0.04], rtol=2 * 2.0**-53)
    z = np.sin(np.radians([0.0, 10.0, -10.0]))
    np.testing.assert_allclose(lidar.pattern.pulses().directions[:, 2], z, rtol=0, atol=4 * 2.0**-53)
    assert lidar.name == "livox"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "0,0,90\n1,50,80\n",
            (
                "recognised a field of view of 50.0 by 10.0 degrees, of none of livox-mid40, "
                "livox-mid70, livox-mid360: its pulse_rate is missing"
            ),
        ),
        ("0,0,nan\n", "Zenith/deg: expected finite numbers, got Zenith/deg[0] = nan"),
        ("0,inf,90\n", "Azimuth/deg: expected finite numbers, got Azimuth/deg[0] = inf"),
        ("", "expected a line of names and lines of numbers, got no numbers"),
    ],
)
def test_bad_file_is_named(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "pattern.csv"
    path.write_text("Time/s,Azimuth/deg,Zenith/deg\n" + content)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: Livox scan pattern CSV: {message}')}$"):
        ls.Lidar.from_file(path)


def test_truncated_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "pattern.csv"
    path.write_text("Time/s,Azimuth/deg,Zenith/deg\n0,0,90\n1,50")
    with pytest.raises(FileFormatError, match=r"pattern\.csv: Livox scan pattern CSV: "):
        ls.Lidar.from_file(path)
