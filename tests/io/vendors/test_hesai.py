from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.patterns import PolygonMirror, Spinning

DATA = Path(__file__).parents[2] / "data" / "sensors" / "hesai"
ANGLES = DATA / "Pandar40P_Angle_Correction_File.csv"
TIMES = DATA / "Pandar40P_Firetime_Correction_File.csv"
CENTRES = {"hesai-pandar40p": (-0.012, 0.03873), "hesai-qt64": (-0.0072, 0.0298)}
"""Optical centres, m: to the right and to the front of the rotor (HesaiLidar_SDK_2.0)."""


def table(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", skiprows=1, encoding="utf-8-sig")


@pytest.mark.parametrize(
    ("path", "name"), [(ANGLES, "hesai-pandar40p"), (DATA / "PandarQT_Angle_Correction_File.csv", "hesai-qt64")]
)
def test_points_are_where_the_vendors_formula_puts_them(path: Path, name: str) -> None:
    lidar = ls.Lidar.from_file(path)
    assert lidar.name == name
    angles = np.radians(table(path)[:, 1:])
    pulses = lidar.pattern.pulses()
    right, front = CENTRES[name]
    for i in range(0, len(pulses), len(pulses) // 997):
        rotor = math.pi + 2.0 * math.pi * lidar.pattern.rate * pulses.time[i]  # clockwise, from behind
        elevation, azimuth = angles[pulses.ring[i]]
        for distance in (0.5, 33.3, 200.0):
            x = distance * math.cos(elevation) * math.sin(rotor + azimuth)
            y = distance * math.cos(elevation) * math.cos(rotor + azimuth)
            x += right * math.cos(rotor) + front * math.sin(rotor)
            y += front * math.cos(rotor) - right * math.sin(rotor)
            got = pulses.origins[i] + distance * pulses.directions[i]
            assert np.abs(got - (y, -x, distance * math.sin(elevation))).max() < 1e-12


def test_at128_keeps_the_sense_of_its_mirror() -> None:
    pattern = ls.Lidar.from_file(DATA / "nebula_PandarAT128.csv").pattern
    assert isinstance(pattern, PolygonMirror)
    angles = np.radians(table(DATA / "nebula_PandarAT128.csv")[:, 1:])
    np.testing.assert_allclose(pattern.elevations, angles[:, 0])
    np.testing.assert_allclose(pattern.azimuth_offsets, angles[:, 1])
    fast = ls.Lidar.from_file(DATA / "nebula_PandarAT128.csv", rate=20.0).pattern
    assert fast.shape == (128, 600)


def test_firing_times_count_from_the_first() -> None:
    pattern = ls.Lidar.from_file(ANGLES, firing_times=TIMES).pattern
    assert isinstance(pattern, Spinning)
    rows = table(TIMES)
    by_channel = dict(zip(rows[:, 0].astype(int), rows[:, 1], strict=True))
    expected = [by_channel[channel] + 54.67 for channel in range(1, 41)]
    np.testing.assert_allclose(pattern.firing_times * 1e6, expected, atol=1e-9)
    # the preset's times are another transcript of the same table
    preset = ls.Lidar.preset("hesai-pandar40p").pattern
    assert isinstance(preset, Spinning)
    np.testing.assert_allclose(pattern.firing_times, preset.firing_times, atol=1e-12)


def test_rate_and_noise_may_be_said() -> None:
    lidar = ls.Lidar.from_file(ANGLES, rate=20.0, noise="datasheet")
    assert lidar.pattern.rate == 20.0
    assert lidar.measurement == ls.Lidar.preset("hesai-pandar40p", noise="datasheet").measurement


def test_hash_and_second_header_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "angles.csv"
    path.write_text("EEFF,1,1\n" + ANGLES.read_text() + "\n" + "0123456789abcdef" * 4 + "\n")
    np.testing.assert_array_equal(
        ls.Lidar.from_file(path).pattern.pulses().directions, ls.Lidar.from_file(ANGLES).pattern.pulses().directions
    )


def rows(channels: int, top: float, bottom: float) -> str:
    elevations = np.linspace(top, bottom, channels)
    return "Channel,Elevation,Azimuth\n" + "".join(f"{i + 1},{value},0\n" for i, value in enumerate(elevations))


KNOWN = (
    "Pandar40P (40, 15.0 to -25.0), Pandar64 (64, 15.0 to -25.0), PandarQT64 (64, 52.1 to -52.1), "
    "PandarXT32 (32, 15.0 to -16.0), XT32M2X (32, 19.5 to -20.8), PandarQT128 (128, 52.6 to -52.6), "
    "Pandar128 or OT128 (128, 15.0 to -25.0), AT128 (128, 12.9 to -12.5)"
)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (rows(40, 15, -25).replace("\n7,", "\n8,"), "expected each of the channels 1 to 40 once"),
        (rows(40, 15, -25).replace("15.0", "nan"), "elevation: expected finite numbers, got elevation[0] = nan"),
        (
            rows(40, 40, -25),
            f"expected the channels of one of {KNOWN}, got 40 channels from 40 to -25 degrees",
        ),
        (rows(128, 52.6, -52.6), "recognised a PandarQT128, which is not covered: its firing times are missing"),
        ("Channel,Elevation,Azimuth\n", "expected a line of names and lines of numbers, got no numbers"),
    ],
)
def test_bad_angles_are_named(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "angles.csv"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: Hesai angle correction CSV: {message}')}$"):
        ls.Lidar.from_file(path)


def test_truncated_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "angles.csv"
    path.write_bytes(ANGLES.read_bytes()[:-8])
    with pytest.raises(FileFormatError, match=r"angles\.csv: Hesai angle correction CSV: "):
        ls.Lidar.from_file(path)


def test_firing_times_alone_are_half_a_sensor() -> None:
    message = (
        f"{TIMES}: Hesai firetime correction CSV: the angles of the channels are missing: "
        "give the Hesai angle correction CSV as the file and this one as its firing_times"
    )
    with pytest.raises(FileFormatError, match=f"^{re.escape(message)}$"):
        ls.Lidar.from_file(TIMES)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("PandarQT_Firetime_Correction_File.csv", "expected the 40 channels of a Pandar40P, got 64"),
        ("PandarQT_Angle_Correction_File.csv", "expected a column that starts with fire"),
        ("missing.csv", None),
    ],
)
def test_bad_firing_times_are_named(name: str, message: str | None) -> None:
    path = DATA / name
    wanted = f"{path}: cannot read the file: No such file or directory"
    if message:
        wanted = f"{path}: Hesai firetime correction CSV: {message}"
    with pytest.raises(FileFormatError, match=f"^{re.escape(wanted)}$"):
        ls.Lidar.from_file(ANGLES, firing_times=path)


def test_unknown_option_is_refused() -> None:
    message = "mode: not an option of Hesai angle correction CSV; expected firing_times, rate, noise"
    with pytest.raises(TypeError, match=f"^{message}$"):
        ls.Lidar.from_file(ANGLES, mode="1024x10")
