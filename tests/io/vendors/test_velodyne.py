from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.patterns import Spinning

DATA = Path(__file__).parents[2] / "data" / "sensors" / "velodyne"
FILES = sorted(DATA.glob("*.yaml"))


def spinning(path: Path, **options: Any) -> Spinning:
    pattern = ls.Lidar.from_file(path, **options).pattern
    assert isinstance(pattern, Spinning)
    return pattern


def model_xyz(laser: dict[str, float], azimuth: float, distance: float) -> tuple[float, float, float]:
    """Return a point by the model of a channel, step by step: X to the right, Y to the front, azimuth clockwise."""
    delta = laser["vert_correction"]
    rho = azimuth - laser.get("rot_correction", 0.0)
    vertical = laser.get("vert_offset_correction", 0.0)
    horizontal = laser.get("horiz_offset_correction", 0.0)
    q = distance * math.cos(delta) - vertical * math.sin(delta)
    x = q * math.sin(rho) - horizontal * math.cos(rho)
    y = q * math.cos(rho) + horizontal * math.sin(rho)
    z = distance * math.sin(delta) + vertical * math.cos(delta)
    return x, y, z


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_points_are_where_the_model_of_a_channel_puts_them(path: Path) -> None:
    lasers = sorted(yaml.safe_load(path.read_text())["lasers"], key=lambda laser: laser["vert_correction"])
    pattern = spinning(path)
    pulses = pattern.pulses(2)
    first = np.ceil(2 * pattern.columns_per_turn) - 2 * pattern.columns_per_turn
    assert first > 0
    for i in range(0, len(pulses), len(pulses) // 997):
        # the head is behind the sensor when a frame starts, and turns clockwise
        azimuth = math.pi + 2.0 * math.pi * pattern.rate * pulses.time[i]
        for distance in (0.9, 17.3, 120.0):
            x, y, z = model_xyz(lasers[pulses.ring[i]], azimuth, distance)
            got = pulses.origins[i] + distance * pulses.directions[i]
            assert np.abs(got - (y, -x, z)).max() <= 4 * np.spacing(4 * np.pi) * distance  # angles round, twice each


def test_vlp16_fires_by_its_ids() -> None:
    pulses = spinning(DATA / "VLP16db_ros2_vertical_offsets.yaml").pulses()
    elevations = np.degrees(np.arcsin(pulses.directions[:16, 2]))
    expected = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15]
    near = 3 * np.degrees(2.0**-53) / np.cos(np.radians(15)) + np.spacing(15.0)  # of the sine, and in degrees
    np.testing.assert_allclose(elevations, expected, rtol=0, atol=near)
    np.testing.assert_allclose(pulses.time[:16], np.arange(16) * 2.304e-6, rtol=4 * 2.0**-53)


def test_hdl64_fires_lower_and_upper_lasers_together() -> None:
    lasers = sorted(
        yaml.safe_load((DATA / "64e_s2.1-sztaki.yaml").read_text())["lasers"], key=lambda laser: laser["laser_id"]
    )
    rings = np.argsort(np.argsort([laser["vert_correction"] for laser in lasers]))
    times = spinning(DATA / "64e_s2.1-sztaki.yaml").firing_times
    np.testing.assert_array_equal(times[rings[:32]], times[rings[32:]])
    np.testing.assert_allclose(
        times[rings[:9]] * 1e6, [0, 1.26, 2.46, 3.66, 6, 7.26, 8.46, 9.66, 12], rtol=8 * 2.0**-53
    )


def test_model_of_equal_lasers_may_be_said() -> None:
    path = DATA / "64e_s2.1-sztaki.yaml"
    assert spinning(path).column_period == 48.0 / 1e6
    assert spinning(path, model="velodyne-hdl64e-s3").column_period == 57.6 / 1e6
    assert ls.Lidar.from_file(path, model="velodyne-hdl64e-s3").name == "velodyne-hdl64e-s3"


def test_models_of_32_lasers_are_told_apart() -> None:
    assert ls.Lidar.from_file(DATA / "VeloView-VLP-32C.yaml").name == "velodyne-vlp32c"


@pytest.mark.parametrize(
    ("name", "preset"),
    [
        ("VLP16db_ros2_vertical_offsets.yaml", "velodyne-vlp16"),
        ("64e_s2.1-sztaki.yaml", "velodyne-hdl64e-s2"),
        ("VeloView-VLP-32C.yaml", "velodyne-vlp32c"),
    ],
)
def test_presets_are_those_files(name: str, preset: str) -> None:
    file, ours = ls.Lidar.from_file(DATA / name), ls.Lidar.preset(preset)
    assert (file.name, file.min_range, file.max_range) == (ours.name, ours.min_range, ours.max_range)
    for got, expected in ((file.pattern.pulses(1), ours.pattern.pulses(1)),):
        # Presets keep 1e-5 degrees, of two angles, and 0.001 mm, of three lengths.
        np.testing.assert_allclose(got.directions, expected.directions, rtol=0, atol=np.sqrt(2) * np.radians(0.5e-5))
        np.testing.assert_allclose(got.origins, expected.origins, rtol=0, atol=np.sqrt(3) * 0.5e-6)
        np.testing.assert_allclose(got.time, expected.time, rtol=4 * 2.0**-53)
        np.testing.assert_array_equal(got.ring, expected.ring)


def test_rate_may_be_said() -> None:
    pattern = spinning(DATA / "VLP16db_ros2_vertical_offsets.yaml", rate=20.0)
    assert pattern.rate == 20.0
    assert pattern.shape == (16, 905)


def text(lasers: int, extra: str = "", **changes: str) -> str:
    rows = [{"laser_id": str(i), "vert_correction": str(0.01 * i), **changes} for i in range(lasers)]
    listed = "".join("- {" + ", ".join(f"{key}: {value}" for key, value in row.items()) + "}\n" for row in rows)
    return f"lasers:\n{listed}num_lasers: {lasers}\n{extra}"


def test_vls128_fires_in_steps_of_its_later_firmware(tmp_path: Path) -> None:
    path = tmp_path / "vls128.yaml"
    path.write_text(text(128))  # elevations rise with the ids, so that rings are ids
    laser = np.arange(128)
    times = spinning(path).firing_times * 1e6
    near = 4 * np.spacing(60.0)  # us
    np.testing.assert_allclose(times, 2.89 * (laser // 8 + laser // 64), rtol=0, atol=near)
    preset = ls.Lidar.preset("velodyne-vls128").pattern
    assert isinstance(preset, Spinning)
    assert preset.column_period == pytest.approx(20 * 2.89e-6, rel=4 * 2.0**-53)
    np.testing.assert_allclose(np.sort(preset.firing_times * 1e6), np.sort(times), rtol=0, atol=near)


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (text(16).replace("num_lasers: 16", ""), {}, "num_lasers: expected 16, the number of lasers listed, got none"),
        (
            text(16).replace("num_lasers: 16", "num_lasers: 32"),
            {},
            "num_lasers: expected 16, the number of lasers listed, got 32",
        ),
        (
            text(16, vert_correction=".nan"),
            {},
            "vert_correction: expected finite numbers, got vert_correction[0] = nan",
        ),
        (text(16, vert_correction="up"), {}, "vert_correction: expected real numbers of shape (16,), got dtype <U2"),
        (text(16, laser_id="3"), {}, "laser_id: expected each of 0 to 15 once"),
        (text(16).replace("laser_id: 2,", ""), {}, "laser_id is missing in lasers[2]"),
        (text(40), {}, "lasers: expected as many as a supported model has, 16, 32, 64, 128, got 40"),
        (text(16), {"model": "velodyne-vls128"}, "model: velodyne-vls128 has 128 lasers, the file 16"),
        (
            text(16),
            {"model": "vlp16"},
            (
                "model: expected one of velodyne-vlp16, velodyne-vlp32c, velodyne-hdl32e, velodyne-hdl64e-s2, "
                "velodyne-hdl64e-s3, velodyne-vls128, got 'vlp16'"
            ),
        ),
        ("lasers: 3 # vert_correction\n", {}, "lasers: expected a list of mappings"),
        (text(16) + "- {", {}, "not valid YAML at line 19: did not find expected key"),
    ],
)
def test_bad_calibration_is_named(tmp_path: Path, content: str, options: dict[str, Any], message: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: Velodyne calibration YAML: {message}')}$"):
        ls.Lidar.from_file(path, **options)


def test_truncated_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_bytes((DATA / "VLP16db_ros2_vertical_offsets.yaml").read_bytes()[:1000])
    with pytest.raises(
        FileFormatError, match=r"calibration\.yaml: Velodyne calibration YAML: not valid YAML at line \d+: "
    ):
        ls.Lidar.from_file(path)
