from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.patterns import Spinning

DATA = Path(__file__).parents[2] / "data" / "sensors" / "ouster"
FILES = sorted(DATA.glob("*.json"))
RANGES_MM = (800.0, 12_345.0, 120_000.0)


def flatten(path: Path) -> dict[str, Any]:
    """Return the keys of all levels that the formula needs."""
    keys: dict[str, Any] = {}

    def walk(part: dict[str, Any]) -> None:
        for key, value in part.items():
            if isinstance(value, dict):
                walk(value)
            else:
                keys.setdefault(key, value)

    walk(json.loads(path.read_text()))
    return keys


TURNED = 8 * np.spacing(4 * np.pi) + 4 * 2.0**-53
"""Greatest difference of two points from the same angles and matrix, relative to the range: angles, up to 4π, are a
product and a sum, and have an offset, each rounded by half a spacing on both sides, and are turned by the matrix."""


def published_xyz(keys: dict[str, Any], column: int, channel: int, r: float) -> list[float]:
    """Return a point in mm by Ouster's formula, step by step, and the distance n that its range begins with."""
    columns = keys["columns_per_frame"]
    default = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}[keys["prod_line"][:4]]
    b03 = keys.get("lidar_origin_to_beam_origin_mm", default)
    b23 = 0.0
    if "beam_to_lidar_transform" in keys:
        b03, b23 = keys["beam_to_lidar_transform"][3], keys["beam_to_lidar_transform"][11]
    n = math.sqrt(b03**2 + b23**2)
    encoder = 2.0 * math.pi * (1.0 - column / columns)
    azimuth = -2.0 * math.pi * keys["beam_azimuth_angles"][channel] / 360.0
    altitude = 2.0 * math.pi * keys["beam_altitude_angles"][channel] / 360.0
    x = (r - n) * math.cos(encoder + azimuth) * math.cos(altitude) + b03 * math.cos(encoder)
    y = (r - n) * math.sin(encoder + azimuth) * math.cos(altitude) + b03 * math.sin(encoder)
    z = (r - n) * math.sin(altitude) + b23
    m = keys["lidar_to_sensor_transform"]
    return [m[4 * i] * x + m[4 * i + 1] * y + m[4 * i + 2] * z + m[4 * i + 3] for i in range(3)] + [n]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_points_are_where_the_published_formula_puts_them(path: Path) -> None:
    keys = flatten(path)
    pulses = ls.Lidar.from_file(path).pattern.pulses()
    first = keys.get("column_window", [0])[0]
    assert len(pulses) >= 23 * len(keys["beam_altitude_angles"])
    for i in range(0, len(pulses), max(1, len(pulses) // 997)):
        for r in RANGES_MM:
            *xyz, n = published_xyz(keys, first + int(pulses.column[i]), int(pulses.ring[i]), r)
            got = pulses.origins[i] + (r - n) / 1e3 * pulses.directions[i]
            assert np.abs(got - np.array(xyz) / 1e3).max() <= TURNED * r / 1e3


def vendors_points(path: Path) -> list[tuple[int, int, float, float, float]]:
    """Return channel, column of the frame, x, y and z, m, of what the vendor's table makes of a range of 12.345 m.

    Written by ``ouster.sdk.core.XYZLut(info, use_extrinsics=False)`` of ouster-sdk 1.0.1, which pins versions of other
    packages that the tests need newer.
    """
    with (DATA / "xyz_of_the_vendor.csv").open(encoding="utf-8", newline="") as lines:
        rows = [row for row in csv.DictReader(lines) if row["metadata"] == path.stem]
    return [
        (int(row["channel"]), int(row["column"]), float(row["x_m"]), float(row["y_m"]), float(row["z_m"]))
        for row in rows
    ]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_range_counts_from_where_the_published_formula_does(path: Path) -> None:
    *_, n = published_xyz(flatten(path), 0, 0, 0.0)
    assert 12.0 < n < 28.0
    assert ls.Lidar.from_file(path).range_offset == pytest.approx(n / 1e3, rel=4 * 2.0**-53)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_points_are_those_of_the_vendors_table(path: Path) -> None:
    pulses = ls.Lidar.from_file(path).pattern.pulses()
    *_, n = published_xyz(flatten(path), 0, 0, 0.0)
    first = flatten(path).get("column_window", [0])[0]
    expected = vendors_points(path)
    assert len(expected) == 35
    for channel, column, *xyz in expected:
        at = np.flatnonzero((pulses.ring == channel) & (first + pulses.column == column))
        assert len(at) == 1
        got = pulses.origins[at[0]] + (12_345 - n) / 1e3 * pulses.directions[at[0]]
        np.testing.assert_allclose(got, xyz, rtol=0, atol=TURNED * 12.345)


def test_all_beams_of_a_column_fire_together() -> None:
    pulses = ls.Lidar.from_file(DATA / "2_1_2_os1-991913000010-64.json").pattern.pulses()
    np.testing.assert_allclose(pulses.time, pulses.column / 10_240, rtol=4 * 2.0**-53)


def test_column_window_is_kept() -> None:
    lidar = ls.Lidar.from_file(DATA / "2_0_0_os1-992008000494-128_col_win_legacy.json")
    assert lidar.pattern.shape == (128, 2036 - 2014 + 1)


def test_mode_replaces_that_of_the_file() -> None:
    lidar = ls.Lidar.from_file(DATA / "2_0_0_os1-992008000494-128_col_win_legacy.json", mode="512x20")
    assert isinstance(lidar.pattern, Spinning)
    assert (lidar.pattern.shape, lidar.pattern.rate) == ((128, 512), 20.0)


def test_limits_and_noise_are_those_of_the_family() -> None:
    path = DATA / "OS-2-128-U1_v2.3.0_1024x10.json"
    preset = ls.Lidar.preset("ouster-os2-128", noise="datasheet")
    lidar = ls.Lidar.from_file(path, noise="datasheet")
    assert (lidar.min_range, lidar.max_range, lidar.measurement) == (
        preset.min_range,
        preset.max_range,
        preset.measurement,
    )
    assert ls.Lidar.from_file(path).measurement == ls.Measurement()
    assert lidar.name == "ouster-os-2-128"


def test_measured_noise_is_that_of_the_family() -> None:
    lidar = ls.Lidar.from_file(DATA / "OS-2-128-U1_v2.3.0_1024x10.json", noise="measured")
    preset = ls.Lidar.preset("ouster-os2-128", noise="measured")
    assert (lidar.min_range, lidar.measurement) == (preset.min_range, preset.measurement)


@pytest.mark.parametrize(
    ("profile", "step"),
    [("RNG19_RFL8_SIG16_NIR16", 0.001), ("RNG15_RFL8_NIR8", 0.008), ("FUSA_RNG15_RFL8_NIR8_DUAL", 0.008)],
)
def test_ranges_of_a_low_data_rate_have_steps_of_8_mm(profile: str, step: float, tmp_path: Path) -> None:
    document = json.loads((DATA / "OS-2-128-U1_v2.3.0_1024x10.json").read_text())
    document["data_format"]["udp_profile_lidar"] = profile
    path = tmp_path / "sensor.json"
    path.write_text(json.dumps(document))
    for noise in ("datasheet", "measured"):
        assert ls.Lidar.from_file(path, noise=noise).measurement.range_resolution == step
    assert ls.Lidar.from_file(path).measurement == ls.Measurement()


def change(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda document: document.update(changes)


def remove(key: str) -> Callable[[dict[str, Any]], None]:
    return lambda document: document.pop(key)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (remove("beam_azimuth_angles"), "beam_azimuth_angles is missing"),
        (remove("beam_altitude_angles"), "beam_altitude_angles is missing"),
        (
            change(beam_altitude_angles=[math.nan] * 32),
            "beam_altitude_angles: expected finite numbers, got beam_altitude_angles[0] = nan",
        ),
        (change(beam_azimuth_angles=[0.0] * 31), "beam_azimuth_angles: expected shape (32,), got (31,)"),
        (
            change(beam_altitude_angles=[[0.0] * 4] * 8),
            "beam_altitude_angles: expected shape (channels,), got (8, 4)",
        ),
        (
            change(lidar_mode="1000x10"),
            "lidar_mode: expected one of 512x10, 512x20, 1024x10, 1024x20, 2048x10, 4096x5, got '1000x10'",
        ),
        (
            remove("lidar_mode"),
            "lidar_mode: expected one of 512x10, 512x20, 1024x10, 1024x20, 2048x10, 4096x5, got None",
        ),
        (change(lidar_mode="512x10"), "columns_per_frame: expected 512, got 1024"),
        (change(data_format={"pixels_per_column": 64}), "pixels_per_column: expected 32, got 64"),
        (change(data_format=[]), "data_format: expected an object, got []"),
        (
            change(data_format={"column_window": [0, 1024]}),
            "column_window: expected columns from 0 to 1023, got [0, 1024]",
        ),
        (change(prod_line="OX-9"), "prod_line: expected a product that starts with OS-0, OS-1, OS-2, got 'OX-9'"),
        (
            change(lidar_to_sensor_transform=[1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]),
            "lidar_to_sensor_transform: expected a turn about z and a shift along it",
        ),
        (
            change(beam_to_lidar_transform=[1, 0, 0, 15, 0, 1, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1]),
            "beam_to_lidar_transform: expected a shift along x and z alone",
        ),
        (
            change(lidar_origin_to_beam_origin_mm="far"),
            "lidar_origin_to_beam_origin_mm: expected real numbers of shape (3,), got dtype <U32",
        ),
    ],
)
def test_bad_metadata_is_named(tmp_path: Path, edit: Callable[[dict[str, Any]], None], message: str) -> None:
    document = json.loads((DATA / "OS-0-32-U1_v2.2.0_1024x10.json").read_text())
    edit(document)
    path = tmp_path / "metadata.json"
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: Ouster metadata JSON: {message}')}$"):
        ls.Lidar.from_file(path)


def test_truncated_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "metadata.json"
    path.write_bytes((DATA / "2_1_2_os1-991913000010-64.json").read_bytes()[:2000])
    with pytest.raises(FileFormatError, match=r"metadata\.json: Ouster metadata JSON: not valid JSON at line \d+: "):
        ls.Lidar.from_file(path)


def test_unknown_option_is_refused() -> None:
    message = "rate: expected none, since Ouster metadata JSON has mode, noise as options, got 10.0"
    with pytest.raises(TypeError, match=f"^{message}$"):
        ls.Lidar.from_file(FILES[0], rate=10.0)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
@pytest.mark.parametrize("given", [None, ""])
def test_a_file_without_a_product_is_told_by_its_beams(path: Path, given: str | None, tmp_path: Path) -> None:
    keys = flatten(path)
    product = keys.pop("prod_line")
    reduced = tmp_path / "reduced.json"
    reduced.write_text(json.dumps(keys if given is None else {**keys, "prod_line": given}))
    lidar, whole = ls.Lidar.from_file(reduced), ls.Lidar.from_file(path)
    assert (lidar.max_range, lidar.range_offset) == (whole.max_range, whole.range_offset)
    assert lidar.name.startswith(f"ouster-{product[:4].lower()}-{len(keys['beam_altitude_angles'])}")
    keys["beam_altitude_angles"] = [2 * angle for angle in keys["beam_altitude_angles"]]
    reduced.write_text(json.dumps(keys))
    if product.startswith("OS-0"):
        with pytest.raises(
            FileFormatError, match="prod_line: expected a product that starts with OS-0, OS-1, OS-2, got ''"
        ):
            ls.Lidar.from_file(reduced)
