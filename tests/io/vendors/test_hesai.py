from __future__ import annotations

import hashlib
import math
import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.patterns import PolygonMirror, Pulses, Spinning, Table

TURNED = 4 * np.spacing(3 * np.pi)
"""Greatest difference of two unit vectors from the same angles, which go up to 3π: an angle of the head is a product
and a sum, and has an offset, each rounded by half a spacing on both sides; sines, cosines and their product less."""

DATA = Path(__file__).parents[2] / "data" / "sensors" / "hesai"
ANGLES = DATA / "Pandar40P_Angle_Correction_File.csv"
TIMES = DATA / "Pandar40P_Firetime_Correction_File.csv"
MIRROR = DATA / "AT128E2X_Angle_Correction_File.dat"
CENTRES = {
    "hesai-pandar40p": (-0.012, 0.03873),
    "hesai-qt64": (-0.0072, 0.0298),
    "hesai-pandar128": (-0.012, 0.04356),
    "hesai-ot128": (-0.01, 0.045),
}
"""Optical centres, m: to the right and to the front of the rotor (HesaiLidar_SDK_2.0)."""


def table(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", skiprows=1, encoding="utf-8-sig")


@pytest.mark.parametrize(
    ("path", "name"),
    [
        (ANGLES, "hesai-pandar40p"),
        (DATA / "PandarQT_Angle_Correction_File.csv", "hesai-qt64"),
        (DATA / "Pandar128E3X_Angle_Correction_File.csv", "hesai-pandar128"),
        (DATA / "OT128_Angle_Correction_File.csv", "hesai-ot128"),
    ],
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
            assert np.abs(got - (y, -x, distance * math.sin(elevation))).max() <= TURNED * (distance + front)


@pytest.mark.parametrize("model", ["Pandar40P", "PandarQT", "Pandar128E3X", "OT128", "QT128C2X"])
def test_range_counts_from_the_axis_of_the_rotor(model: str) -> None:
    angles, times = (DATA / f"{model}_{kind}_Correction_File.csv" for kind in ("Angle", "Firetime"))
    lidar = ls.Lidar.from_file(angles, firing_times=times)
    pulses = lidar.pattern.pulses()
    offset = np.asarray(lidar.range_offset)[pulses.ring]
    assert 0.017 < offset.min() < offset.max() < 0.046
    square = (pulses.origins**2).sum(axis=-1)
    for distance in (0.5, 5.0, 50.0):
        vendors = np.linalg.norm(pulses.origins + distance * pulses.directions, axis=-1)
        left_out = (square - offset**2) / (2.0 * distance)  # the next term of the series of the root
        assert np.abs(vendors - (distance + offset) - left_out).max() < square.max() ** 1.5 / distance**2
        assert np.abs(vendors - (distance + offset)).max() < 0.5e-3 / distance


def test_range_of_an_at128_counts_from_its_origin() -> None:
    assert ls.Lidar.from_file(MIRROR).range_offset == 0.0
    assert ls.Lidar.from_file(DATA / "nebula_PandarAT128.csv").range_offset == 0.0


def test_at128_spans_what_its_decoder_says() -> None:
    path = DATA / "nebula_PandarAT128.csv"
    pattern = ls.Lidar.from_file(path).pattern
    assert isinstance(pattern, PolygonMirror)
    angles = np.radians(table(path)[:, 1:])
    np.testing.assert_array_equal(pattern.elevations, angles[:, 0])
    np.testing.assert_array_equal(pattern.azimuth_offsets, -angles[:, 1])
    preset = ls.Lidar.preset("hesai-at128").pattern
    assert isinstance(preset, PolygonMirror)
    np.testing.assert_array_equal(preset.azimuth_offsets, pattern.azimuth_offsets)
    azimuth = azimuths(pattern.pulses())[0]  # 1200 columns of a tenth of a degree, from 60 - 2.4 degrees on
    np.testing.assert_allclose(azimuth, 57.6 - 0.1 * np.arange(1200), rtol=0, atol=np.degrees(TURNED))
    fast = ls.Lidar.from_file(path, rate=20.0).pattern
    assert fast.shape == (128, 600)


def azimuths(pulses: Pulses) -> np.ndarray:
    """Return the azimuths of an AT128's pulses, degrees, of shape (128, columns)."""
    order = np.lexsort((pulses.column, pulses.ring))
    x, y, _ = pulses.directions[order].T
    return np.degrees(np.arctan2(y, x)).reshape(128, -1)


def mirror_parts() -> tuple[np.ndarray, ...]:
    """Return starts, azimuths and elevations of the DAT file, degrees, and its adjustments, by its published layout."""
    data = MIRROR.read_bytes()
    numbers = struct.unpack_from("<262i", data, 16)
    adjust = np.array(struct.unpack_from("46080b", data, 16 + 262 * 4)).reshape(2, 128, 180) * 2 / 100
    whole = np.array(numbers) * 2 / 25600
    return whole[:3], whole[6:134], whole[134:], adjust[0], adjust[1]


def test_dat_and_csv_have_opposite_azimuths_and_the_same_directions() -> None:
    _, dat_azimuth, dat_elevation, *_ = mirror_parts()
    csv = table(DATA / "nebula_PandarAT128.csv")
    np.testing.assert_array_equal(dat_azimuth, -csv[:, 2])
    np.testing.assert_allclose(dat_elevation, csv[:, 1], rtol=0, atol=0.05)  # two units, with angles to 0.01 degrees
    dat, preset = ls.Lidar.from_file(MIRROR), ls.Lidar.from_file(DATA / "nebula_PandarAT128.csv")
    assert (dat.name, dat.max_range) == (preset.name, preset.max_range)
    assert isinstance(dat.pattern, Table)
    assert dat.pattern.shape == preset.pattern.shape == (128, 1200)
    for frame in range(4):
        apart = azimuths(dat.pattern.pulses(frame)) - azimuths(preset.pattern.pulses(frame))
        # What is left bends all channels alike, by less than a degree: it changes by at most 0.12 degrees in 4 degrees
        # of azimuth, and channels of a column fire within 16 us, 0.04 degrees, and are up to half a column apart.
        assert np.ptp(apart, axis=0).max() < 0.12 / 4 * (0.04 + 0.05)
        assert 0.3 < np.abs(apart).max() < 1.0
        assert np.abs(apart[:, 600]).max() < 0.2


def test_dat_points_where_the_vendors_decoder_does() -> None:
    starts, azimuth, elevation, azimuth_adjust, elevation_adjust = mirror_parts()
    pattern = ls.Lidar.from_file(MIRROR).pattern
    checked = 0
    for frame in range(3):
        pulses = pattern.pulses(frame)
        for i in range(0, len(pulses), len(pulses) // 499):
            time, ring = frame / 10.0 + pulses.time[i], pulses.ring[i]
            encoder = starts[0] + 15.0 + 1200.0 * time  # the first line enters its field of view at time 0
            place, part = divmod(encoder % 360.0 / 2.0, 1.0)
            near, far = int(place), (int(place) + 1) % 180
            adjust = [
                (1.0 - part) * table[ring, near] + part * table[ring, far]
                for table in (azimuth_adjust, elevation_adjust)
            ]
            a = math.radians(2.0 * (encoder - starts[frame]) - azimuth[ring] + adjust[0])
            e = math.radians(elevation[ring] + adjust[1])
            expected = (math.cos(e) * math.sin(a), math.cos(e) * math.cos(a), math.sin(e))
            # Angles of the encoder go up to 480 degrees, and are doubled.
            near = TURNED + 2 * np.radians(np.spacing(480.0))
            np.testing.assert_allclose(pulses.directions[i], expected, rtol=0, atol=near)
            checked += 1
    assert checked > 1400


def test_facets_of_a_dat_begin_in_their_frames(tmp_path: Path) -> None:
    data = bytearray(MIRROR.read_bytes()[:-32])
    starts = struct.unpack_from("<3I", data, 16)
    early = (starts[0], starts[0] + 119 * 12800, starts[2])  # a degree before the frame
    struct.pack_into("<3I", data, 16, *early)
    path = tmp_path / "early.dat"
    path.write_bytes(bytes(data) + hashlib.sha256(data).digest())
    pattern = ls.Lidar.from_file(path, rate=20.0).pattern
    assert pattern.rate == 20.0
    for frame in range(6):
        assert len(pattern.pulses(frame)) == 128 * 600
        assert pattern.pulses(frame).time.min() >= 0.0


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda data: data[:10], "expected a header of 16 bytes, got 10"),
        (lambda data: data[:-1], "expected 47176 bytes, got 47175"),
        (
            lambda data: data[:5000] + bytes([data[5000] ^ 1]) + data[5001:],
            "expected the last 32 bytes to be the SHA-256 of all before them, got others",
        ),
        (lambda data: data[:3] + b"\x03" + data[4:], "expected version 1.5, got 1.3"),
        (lambda data: data[:4] + b"\x40" + data[5:], "expected the 128 channels of an AT128, got 64"),
    ],
)
def test_bad_dat_is_named(tmp_path: Path, edit: Callable[[bytes], bytes], message: str) -> None:
    path = tmp_path / "angles.dat"
    path.write_bytes(edit(MIRROR.read_bytes()))
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: Hesai angle correction DAT: {message}')}$"):
        ls.Lidar.from_file(path)


@pytest.mark.parametrize("path", [MIRROR, ANGLES, DATA / "nebula_PandarAT128.csv"])
def test_bad_rates_are_named(path: Path) -> None:
    with pytest.raises(ValueError, match=r"^rate: expected a finite number > 0, got -1\.0$"):
        ls.Lidar.from_file(path, rate=-1)


def numbers(path: Path, skip: int) -> list[list[str]]:
    return [line.split(",") for line in path.read_text(encoding="utf-8-sig").splitlines()[skip:]]


@pytest.mark.parametrize(
    ("model", "skip", "states", "unit"),
    [("OT128", 2, (5, 6), 1e-6), ("Pandar128E3X", 3, (9, 11), 1e-9)],  # the columns of mode 2, far
)
def test_states_of_the_standard_mode_take_turns(model: str, skip: int, states: tuple[int, int], unit: float) -> None:
    angles, times = (DATA / f"{model}_{kind}_Correction_File.csv" for kind in ("Angle", "Firetime"))
    rows = numbers(times, skip)
    listed = np.array([[float(row[state]) * unit for state in states] for row in rows])
    listed -= listed.min()
    channel = np.array([int(row[0]) - 1 for row in rows])
    expected = np.empty((128, 2))
    expected[channel] = listed
    pattern = ls.Lidar.from_file(angles, firing_times=times).pattern
    preset = ls.Lidar.from_file(angles).pattern
    assert pattern.shape == preset.shape == (128, 1800)
    assert isinstance(preset, Spinning)
    # Numbers of 1 ms at most in three units, and their difference.
    near = 4 * np.spacing(1e-3)
    np.testing.assert_allclose(preset.firing_times, expected[:, 0] - expected[:, 0].min(), rtol=0, atol=near)
    pulses = pattern.pulses(1)
    assert len(pulses) == 128 * 1800
    since = pulses.time - pulses.column / 18000.0
    near += 2 * np.spacing(0.1)  # the period, its multiple and the sum round, and the time of the column here
    np.testing.assert_allclose(since, expected[pulses.ring, pulses.column % 2], rtol=0, atol=near)
    # both turn and look alike: the preset is the first state
    first = preset.pulses()
    even = pulses.column == 0
    np.testing.assert_allclose(
        pulses.directions[even][np.argsort(pulses.ring[even])],
        first.directions[first.column == 0][np.argsort(first.ring[first.column == 0])],
        rtol=0,
        atol=TURNED,
    )


def test_channels_of_a_qt128_take_turns() -> None:
    angles, times = DATA / "QT128C2X_Angle_Correction_File.csv", DATA / "QT128C2X_Firetime_Correction_File.csv"
    lidar = ls.Lidar.from_file(angles, firing_times=times)
    assert (lidar.name, lidar.min_range, lidar.max_range) == ("hesai-qt128", 0.05, 50.0)
    pulses = lidar.pattern.pulses()
    assert len(pulses) == 86_400  # 864 000 a second
    rows = np.array([[float(cell) for cell in row] for row in numbers(times, 3)])
    for loop in range(2):
        fired = rows[rows[:, 2 * loop] > 0.0][:, 2 * loop : 2 * loop + 2]
        in_loop = pulses.column % 2 == loop
        assert set(pulses.ring[in_loop]) == {int(number) - 1 for number in fired[:, 0]}
        when = dict(zip(fired[:, 0].astype(int) - 1, fired[:, 1] - 0.6, strict=True))  # the first fires at 0.6 us
        expected = [when[ring] for ring in pulses.ring[in_loop]]
        near = 2e6 * np.spacing(0.1) + 4 * np.spacing(1e3)  # the period, its multiple, the sum and the column; us
        since = (pulses.time - pulses.column / 9000.0)[in_loop] * 1e6
        np.testing.assert_allclose(since, expected, rtol=0, atol=near)
    elevation = np.degrees(np.arcsin(pulses.directions[:, 2]))
    # Of the sine of at most 53 degrees, and in degrees.
    near = 3 * np.degrees(2.0**-53) / np.cos(np.radians(53)) + np.spacing(53.0)
    np.testing.assert_allclose(elevation, table(angles)[pulses.ring, 1], rtol=0, atol=near)
    right, front = 0.0072, 0.0354
    rotor = math.pi + 20.0 * math.pi * pulses.time
    origin = [front * np.cos(rotor) - right * np.sin(rotor), -right * np.cos(rotor) - front * np.sin(rotor)]
    np.testing.assert_allclose(pulses.origins[:, :2].T, origin, rtol=0, atol=TURNED * front)
    azimuth = -(rotor + np.radians(table(angles)[pulses.ring, 2]))
    flat = pulses.directions[:, :2] / np.hypot(*pulses.directions[:, :2].T)[:, None]
    np.testing.assert_allclose(flat, np.c_[np.cos(azimuth), np.sin(azimuth)], rtol=0, atol=TURNED)


def test_firing_times_count_from_the_first() -> None:
    pattern = ls.Lidar.from_file(ANGLES, firing_times=TIMES).pattern
    assert isinstance(pattern, Spinning)
    rows = table(TIMES)
    by_channel = dict(zip(rows[:, 0].astype(int), rows[:, 1], strict=True))
    expected = [by_channel[channel] + 54.67 for channel in range(1, 41)]
    np.testing.assert_allclose(pattern.firing_times * 1e6, expected, rtol=0, atol=4 * np.spacing(60.0))  # us
    # the preset's times are another transcript of the same table
    preset = ls.Lidar.preset("hesai-pandar40p").pattern
    assert isinstance(preset, Spinning)
    near = 4 * np.spacing(1e-3)  # numbers below 1 ms, in two units and from another zero
    np.testing.assert_allclose(pattern.firing_times, preset.firing_times, rtol=0, atol=near)


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


def rows(channels: int, top: float, bottom: float, azimuth: float) -> str:
    elevations = np.linspace(top, bottom, channels)
    lines = (f"{i + 1},{value},{azimuth}\n" for i, value in enumerate(elevations))
    return "Channel,Elevation,Azimuth\n" + "".join(lines)


HALF_A_QT128 = (
    "recognised a QT128C2X, whose channels do not all fire in each column: give the Hesai firetime correction CSV as "
    "its firing_times"
)
KNOWN = (
    "Pandar40P (40, 15.0 to -25.0, +-5.2), Pandar64 (64, 15.0 to -25.0, +-5.2), PandarQT64 (64, 52.1 to -52.1, +-8.7), "
    "PandarXT32 (32, 15.0 to -16.0, +-0.0), XT32M2X (32, 19.5 to -20.8, +-0.0), QT128C2X (128, 52.6 to -52.6, +-10.1), "
    "Pandar128E3X (128, 14.4 to -25.0, +-7.8), OT128 (128, 15.0 to -24.8, +-4.6), AT128 (128, 12.9 to -12.5, +-2.4)"
)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (rows(40, 15, -25, 5).replace("\n7,", "\n8,"), "expected each of the channels 1 to 40 once"),
        (rows(40, 15, -25, 5).replace("15.0", "nan"), "elevation: expected finite numbers, got elevation[0] = nan"),
        (
            rows(40, 40, -25, 5),
            f"expected channels, elevations and azimuths of one of {KNOWN}, got 40 channels, 40 to -25, +-5 degrees",
        ),
        (
            rows(128, 15, -25, -1),
            f"expected channels, elevations and azimuths of one of {KNOWN}, got 128 channels, 15 to -25, +-1 degrees",
        ),
        (rows(128, 52.6, -52.6, 10), HALF_A_QT128),
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


@pytest.mark.parametrize("path", sorted(DATA.glob("*_Firetime_*")), ids=lambda path: path.stem)
def test_firing_times_alone_are_half_a_sensor(path: Path) -> None:
    message = (
        f"{path}: Hesai firetime correction CSV: the angles of the channels are missing: "
        "give the Hesai angle correction CSV as the file and this one as its firing_times"
    )
    with pytest.raises(FileFormatError, match=f"^{re.escape(message)}$"):
        ls.Lidar.from_file(path)


def test_qt128_has_no_data_sheet() -> None:
    angles, times = DATA / "QT128C2X_Angle_Correction_File.csv", DATA / "QT128C2X_Firetime_Correction_File.csv"
    message = "noise: expected None, since no datasheet noise is known for the QT128C2X, got 'datasheet'"
    with pytest.raises(ValueError, match=f"^{message}$"):
        ls.Lidar.from_file(angles, firing_times=times, noise="datasheet")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("PandarQT_Firetime_Correction_File.csv", "expected the 40 channels of a Pandar40P, got 64"),
        ("PandarQT_Angle_Correction_File.csv", "expected a column that starts with fire"),
        ("OT128_Firetime_Correction_File.csv", "expected the 40 channels of a Pandar40P, got 128"),
        ("QT128C2X_Firetime_Correction_File.csv", "expected the 40 channels of a Pandar40P, got 128"),
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
    message = (
        "mode: expected none, since Hesai angle correction CSV has firing_times, rate, noise as options, got '1024x10'"
    )
    with pytest.raises(TypeError, match=f"^{message}$"):
        ls.Lidar.from_file(ANGLES, mode="1024x10")
