from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.patterns import Spinning

DATA = Path(__file__).parents[2] / "data" / "sensors" / "robosense"


def spinning(path: Path) -> Spinning:
    pattern = ls.Lidar.from_file(path).pattern
    assert isinstance(pattern, Spinning)
    return pattern


@pytest.mark.parametrize(("name", "channels"), [("rs_lidar_16", 16), ("rs_lidar_32", 32)])
def test_angles_are_those_of_the_file_from_the_lowest(name: str, channels: int) -> None:
    path = DATA / f"{name}_angle.csv"
    rows = [[float(cell) for cell in line.split(",")] for line in path.read_text().split()]
    assert len(rows) == channels
    rows.sort()
    pattern = spinning(path)
    np.testing.assert_allclose(np.degrees(pattern.elevations), [row[0] for row in rows], rtol=4 * 2.0**-53)
    azimuths = [row[1] if len(row) > 1 else 0.0 for row in rows]  # clockwise there
    np.testing.assert_allclose(np.degrees(pattern.azimuth_offsets), np.negative(azimuths), rtol=4 * 2.0**-53)


@pytest.mark.parametrize("name", ["rs16", "rs32"])
def test_preset_is_the_same_unit(name: str) -> None:
    lidar = ls.Lidar.from_file(DATA / f"rs_lidar_{name[2:]}_angle.csv", noise="datasheet")
    preset = ls.Lidar.preset(f"robosense-{name}", noise="datasheet")
    assert dataclasses.replace(lidar, pattern=preset.pattern) == preset
    pattern, expected = lidar.pattern, preset.pattern
    assert isinstance(pattern, Spinning)
    assert isinstance(expected, Spinning)
    # the preset of the 16 has design values, within 0.04 degrees of this unit's
    np.testing.assert_allclose(pattern.elevations, expected.elevations, rtol=0, atol=np.radians(0.04))
    np.testing.assert_array_equal(pattern.azimuth_offsets, expected.azimuth_offsets)
    np.testing.assert_allclose(pattern.firing_times, expected.firing_times, rtol=4 * 2.0**-53)


def test_rate_may_be_said() -> None:
    assert ls.Lidar.from_file(DATA / "rs_lidar_32_angle.csv", rate=20.0).pattern.rate == 20.0


def test_other_tables_are_not_taken_for_angles(tmp_path: Path) -> None:
    path = tmp_path / "numbers.csv"
    path.write_text("1.0\n" * 17)
    message = f"{path}: expected a file of one of these kinds: "
    with pytest.raises(FileFormatError, match=f"^{re.escape(message)}"):
        ls.Lidar.from_file(path)
