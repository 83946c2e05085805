"""Velodyne's packets beside a decoder by the manuals and velodyne_decoder."""

from __future__ import annotations

import dataclasses
import functools
import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import velodyne_decoder

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.io import packets
from lidarsim.io.packets import Packet, Writer
from lidarsim.patterns import Grid
from lidarsim.scan.scan import Scan

START = 1_600_000_000.25  # 1600 s past the hour
ORIGIN = 1_600_000_000_250_000_000
HOUR = 3600 * 10**9  # ns
FRAMES = 3
MODES = {"strongest": 0x37, "last": 0x38, "dual": 0x39}


class Manual(NamedTuple):
    """What the manuals say of a model, in the order of the lasers."""

    product: int
    step: float  # of distances, m
    firing_us: list[float]
    cycle_us: float
    elevations: list[float]  # degrees
    offsets: list[float]  # of azimuths, clockwise, degrees
    heights_mm: list[float]  # where the beams leave the z axis
    rate: float  # Hz, of these tests

    @property
    def lasers(self) -> int:
        return len(self.elevations)

    def cycles(self, dual: bool) -> int:
        """How many firing cycles a packet of 384 points has; of the VLS-128 only whole ones."""
        return 384 // self.lasers // (2 if dual else 1)


# VLP-16 63-9243 Rev D, tables 9-1 and p. 49; VLP-32C 63-9325 Rev C, table 9-2 and p. 62; HDL-32E, laser timing;
# VLS-128 63-9483 Rev A, p. 61 to 66, with the step of 2.89 us that its firmware has since 5.2.3.0 (VeloView).
VLS_128 = """
-11.742 -1.99 3.4 -5.29 -0.78 4.61 -4.08 1.31 -6.5 -1.11 4.28 -4.41 0.1 6.48 -3.2 2.19 -3.86 1.53 -9.244 -1.77 2.74
-5.95 -0.56 4.83 -2.98 2.41 -6.28 -0.89 3.62 -5.07 0.32 7.58 -0.34 5.18 -3.64 1.75 -25 -2.43 2.96 -5.73 0.54 9.7 -2.76
2.63 -7.65 -1.55 3.84 -4.85 3.18 -5.51 -0.12 5.73 -4.3 1.09 -16.042 -2.21 4.06 -4.63 0.76 15 -3.42 1.97 -6.85 -1.33
-5.62 -0.23 5.43 -3.53 0.98 -19.582 -2.32 3.07 -4.74 0.65 11.75 -2.65 1.86 -7.15 -1.44 3.95 -2.1 3.29 -5.4 -0.01 4.5
-4.19 1.2 -13.565 -1.22 4.17 -4.52 0.87 6.08 -3.31 2.08 -6.65 1.42 -10.346 -1.88 3.51 -6.06 -0.67 4.72 -3.97 2.3 -6.39
-1 4.39 -5.18 0.21 6.98 -3.09 4.98 -3.75 1.64 -8.352 -2.54 2.85 -5.84 -0.45 8.43 -2.87 2.52 -6.17 -1.66 3.73 -4.96 0.43
"""
MANUALS = {
    "velodyne-vlp16": Manual(
        0x22,
        0.002,
        [2.304 * i for i in range(16)],
        55.296,
        [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15],
        [0.0] * 16,
        [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2],
        10.0,
    ),
    "velodyne-vlp32c": Manual(
        0x28,
        0.004,
        [2.304 * (i // 2) for i in range(32)],
        55.296,
        [
            *(-25, -1, -1.667, -15.639, -11.31, 0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667),
            *(-4, -4.667, 1.667, 1, -3.667, -3.333, 3.333, 2.333, -2.667, -3, 7, 4.667, -2.333, -2, 15, 10.333, -1.333),
        ],
        [
            *(1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4),
            *(1.4, -4.2, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4),
        ],
        [0.0] * 32,
        5.0,
    ),
    "velodyne-hdl32e": Manual(
        0x21,
        0.002,
        [1.152 * i for i in range(32)],
        46.08,
        [
            *(-30.67, -9.33, -29.33, -8, -28, -6.67, -26.67, -5.33, -25.33, -4, -24, -2.67, -22.67, -1.33, -21.33, 0),
            *(-20, 1.33, -18.67, 2.67, -17.33, 4, -16, 5.33, -14.67, 6.67, -13.33, 8, -12, 9.33, -10.67, 10.67),
        ],
        [0.0] * 32,
        [0.0] * 32,
        10.0,
    ),
    "velodyne-vls128": Manual(
        0xA1,
        0.004,
        [2.89 * (i // 8 + i // 64) for i in range(128)],
        57.8,
        [float(angle) for angle in VLS_128.split()],
        [6.354, 4.548, 2.732, 0.911, -0.911, -2.732, -4.548, -6.354] * 16,
        [0.0] * 128,
        20.0,
    ),
}


class Points(NamedTuple):
    """Points in the order of a decoder: by firing cycle, then by laser, the last return first."""

    xyz: np.ndarray
    time: np.ndarray  # s since START
    ring: np.ndarray
    range: np.ndarray
    brightness: np.ndarray
    cycle: np.ndarray
    laser: np.ndarray


def sensor(model: str, returns: str | int = "strongest", **changes: object) -> ls.Lidar:
    """A preset without noise, at the rate of its `Manual`; `changes` are those of its pattern."""
    lidar = ls.Lidar.preset(model)
    beam = ls.Beam(divergence_azimuth=3e-3, pulse_length=3e-9, rays=7) if returns not in {"strongest", "last"} else None
    return dataclasses.replace(
        lidar,
        pattern=dataclasses.replace(lidar.pattern, **{"rate": MANUALS[model].rate, **changes}),
        measurement=ls.Measurement(beam=beam, returns=returns),
        max_range=120.0,
    )


def street() -> ls.Scene:
    """Ground, walls, and leaves that cover a part of the beams before the walls; the sky returns nothing."""
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.7), material=ls.Material(reflectivity=0.3))
    scene.add(ls.Box((2.0, 80.0, 12.0), (35.0, 0.0, 2.0)), material=ls.Material(reflectivity=0.6))
    scene.add(ls.Box((80.0, 2.0, 12.0), (0.0, -25.0, 2.0)), material=ls.Material(reflectivity=0.2))
    rng = np.random.default_rng(0)
    azimuth, far = rng.uniform(-np.pi, np.pi, 4000), rng.uniform(6, 22, 4000)
    centers = np.stack([far * np.cos(azimuth), far * np.sin(azimuth), rng.uniform(-1.5, 4, 4000)], axis=-1)
    leaves = ls.Disks(centers, rng.normal(size=(4000, 3)), 0.02)
    scene.add(leaves, material=ls.Material(reflectivity=0.5))
    return scene


@functools.cache
def drive(model: str, returns: str) -> tuple[Scan, ...]:
    """Frames of a sensor that drives in a curve."""
    lidar = sensor(model, returns)
    path = ls.Trajectory.from_twist(np.eye(4), linear=(8, 0, 0), angular=(0, 0, 0.3))
    return tuple(lidar.frames(street(), path, FRAMES))


def encode(scans: tuple[Scan, ...], **options: float) -> list[Packet]:
    encoder = packets.encoders({"": scans[0].lidar}, **{"start": START, **options})[""]
    return [packet for scan in scans for packet in encoder.packets(scan)] + list(encoder.rest())


def data(sent: list[Packet]) -> list[bytes]:
    return [packet.payload for packet in sent if packet.port == packets.velodyne.DATA_PORT]


def decode(payloads: list[bytes], manual: Manual) -> Points:
    """Points by the manuals: azimuths between the firing cycles interpolated, to those of the next block."""
    raw = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, 1206)
    mode = int(raw[0, 1204])
    dual, lasers = mode == 0x39, manual.lasers
    assert (raw[:, 1204:] == (mode, manual.product)).all()
    stamps = np.array([struct.unpack_from("<I", payload, 1200)[0] for payload in payloads])
    blocks = raw[:, :1200].reshape(-1, 12, 100).astype(np.int64)
    if lasers == 128 and dual:  # the last four are empty but for the azimuth, by which drivers split turns
        assert not blocks[:, 8:, [0, 1, *range(4, 100)]].any()
        assert (blocks[:, 8:, 2:4] == blocks[:, :1, 2:4]).all()
        blocks = blocks[:, :8]
    flags = [0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF] if lasers == 128 else [0xEEFF]
    flags = np.resize(np.repeat(flags, 2) if dual else flags, blocks.shape[1])
    assert (blocks[..., 0] + 256 * blocks[..., 1] == flags).all()

    # A group of blocks has the points of one cycle, or of two of the VLP-16, and each return of them in a block.
    banks, returns = max(lasers // 32, 1), 1 + dual
    azimuths = (blocks[..., 2] + 256 * blocks[..., 3]).reshape(-1, banks * returns)
    assert (azimuths == np.minimum(azimuths[:, :1], 35999)).all()
    azimuth = np.unwrap(azimuths[:, 0].astype(float), period=36000.0)
    gap = np.diff(azimuth)
    gap = np.append(gap, gap[-1])

    points = blocks[..., 4:].reshape(len(azimuth), banks, returns, 32 // min(lasers, 32), min(lasers, 32), 3)
    points = points.transpose(0, 3, 1, 4, 2, 5).reshape(len(azimuth), -1, lasers, returns, 3)  # group, cycle, laser
    per_group = points.shape[1]
    after = np.arange(per_group)[:, None] * manual.cycle_us + np.array(manual.firing_us)
    turned = azimuth[:, None, None] + gap[:, None, None] * after / (per_group * manual.cycle_us)
    # The stamp of the VLS-128 is that of its fourth group of eight.
    of_packet = np.arange(len(azimuth)) % (len(azimuth) // len(payloads)) * per_group * manual.cycle_us
    passed = stamps - ORIGIN % HOUR / 1000
    passed[passed < -1] += HOUR / 1000  # the next hour
    first = np.repeat(passed, len(azimuth) // len(payloads)) + of_packet - (manual.firing_us[24] if banks == 4 else 0.0)
    time = (first[:, None, None] + after) * 1e-6

    distance = (points[..., 0] + 256 * points[..., 1]) * manual.step
    group, cycle, laser, number = np.nonzero(distance)
    if dual:  # both blocks hold the only return
        same = (points[..., 0, :] == points[..., 1, :]).all(axis=-1)
        kept = (number == 0) | ~same[group, cycle, laser]
        group, cycle, laser, number = (index[kept] for index in (group, cycle, laser, number))
    far = distance[group, cycle, laser, number]
    alpha = np.radians(turned[group, cycle, laser] / 100 + np.array(manual.offsets)[laser])
    omega = np.radians(np.array(manual.elevations)[laser])
    height = far * np.sin(omega) + np.array(manual.heights_mm)[laser] / 1000
    across = far * np.cos(omega)
    ring = np.argsort(np.argsort(manual.elevations))[laser]
    return Points(
        np.stack([across * np.cos(alpha), -across * np.sin(alpha), height], axis=-1),
        time[group, cycle, laser],
        ring,
        far,
        points[group, cycle, laser, number, 2],
        group * per_group + cycle,
        laser,
    )


def points_of(scans: tuple[Scan, ...], manual: Manual) -> Points:
    """The points of scans in that order."""
    laser_of = np.argsort(manual.elevations)  # by ring
    parts, before = [], 0
    for scan in scans:
        cloud = scan.point_cloud()
        laser, cycle = laser_of[cloud.ring], before + cloud.column.astype(np.int64)
        last = np.zeros(len(cloud), bool)
        for number in (1, 2):  # the farther of two is the last
            other = {1: 1, 2: -1}[number]
            two = np.flatnonzero((cloud.return_count == 2) & (cloud.return_number == number))
            last[two] = cloud.range[two] > cloud.range[two + other]
        order = np.lexsort((~last, laser, cycle))
        brightness = np.rint(np.minimum(cloud.intensity * np.float32(100), 255)).astype(int)
        fields = (cloud.xyz, cloud.time + scan.time, cloud.ring, cloud.range, brightness, cycle, laser)
        parts.append([field[order] for field in fields])
        before += len(scan) // manual.lasers
    return Points(*(np.concatenate(field) for field in zip(*parts, strict=True)))


def from_height(points: Points, manual: Manual) -> np.ndarray:
    """Distance between the origins of beams: the preset turns the height with the beam, as drivers do; manuals do not.

    They are the ends of a chord of a circle, over the elevation.
    """
    angles = np.radians(np.abs(manual.elevations))[points.laser]
    chord: np.ndarray = 2 * np.abs(manual.heights_mm)[points.laser] / 1000 * np.sin(angles / 2)
    return chord


@pytest.mark.slow("decoders find our points in all models and modes")
@pytest.mark.parametrize("returns", MODES)
@pytest.mark.parametrize("model", MANUALS)
def test_a_decoder_by_the_manuals_finds_each_point(model: str, returns: str) -> None:
    manual, scans = MANUALS[model], drive(model, returns)
    expected, got = points_of(scans, manual), decode(data(encode(scans)), manual)
    assert len(expected.ring) > 20_000
    assert len(np.unique(expected.ring)) > 0.7 * manual.lasers

    for name in ("ring", "laser", "cycle", "brightness"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), name)
    # Half a step, and two roundings of a product.
    off = np.abs(got.range - expected.range)
    assert (off <= manual.step / 2 + 2 * np.spacing(expected.range)).all()
    # Half a microsecond of the stamp, two roundings to 1 ns, and those of float64 numbers below 3600e6 us.
    assert np.abs(got.time - expected.time).max() <= 0.5e-6 + 1e-9 + 4 * np.spacing(3600.0)
    # The azimuth lies between two that are rounded to 0.01 degrees; after the last block it is extrapolated by less
    # than the gap between two, of which each end is off by half a step.
    azimuth = np.where(expected.cycle < expected.cycle.max() - 1, 0.005, 0.015)
    off = np.linalg.norm(got.xyz - expected.xyz, axis=1)
    bound = manual.step / 2 + expected.range * np.radians(azimuth) + from_height(expected, manual)
    assert (off <= bound + 1e-4 * (np.array(manual.heights_mm) != 0)[expected.laser]).all()  # heights to 0.1 mm


def calibration(lidar: ls.Lidar, manual: Manual) -> velodyne_decoder.Calibration:
    """The calibration of a sensor; that of velodyne_decoder itself has other heights of the beams' origins."""
    pattern, rings = lidar.pattern, np.argsort(np.argsort(manual.elevations))
    rows = [
        f"- {{laser_id: {laser}, rot_correction: {pattern.azimuth_offsets[ring]!r},"
        f" vert_correction: {pattern.elevations[ring]!r}, vert_offset_correction: {manual.heights_mm[laser] / 1000}}}"
        for laser, ring in enumerate(rings)
    ]
    rows = [row.replace("np.float64(", "").replace("),", ",") for row in rows]
    text = "\n".join([f"num_lasers: {len(rings)}", f"distance_resolution: {manual.step}", "lasers:", *rows])
    return velodyne_decoder.Calibration.from_string(text)


def read_by_velodyne_decoder(
    path: Path, lidar: ls.Lidar, manual: Manual, start: float
) -> tuple[np.ndarray, np.ndarray]:
    """The points, and their times since the start of the file, s."""
    config = velodyne_decoder.Config(min_range=0, max_range=1000, calibration=calibration(lidar, manual))
    clouds = list(velodyne_decoder.read_pcap(path, config, as_pcl_structs=True))
    time = [stamp.device - start + points["time"].astype(np.float64) for stamp, points in clouds]
    return np.concatenate([points for _, points in clouds]), np.concatenate(time)


@pytest.mark.slow("decoders find our points in all models and modes")
@pytest.mark.parametrize("returns", MODES)
@pytest.mark.parametrize("model", MANUALS)
def test_velodyne_decoder_finds_each_point(model: str, returns: str, tmp_path: Path) -> None:
    manual, scans = MANUALS[model], drive(model, returns)
    lidar, dual = scans[0].lidar, returns == "dual"
    start = 0.25  # a float64 of seconds since 1970 would have steps of 240 ns today
    with Writer(tmp_path / "drive.pcap", lidar, start=start) as writer:
        for scan in scans:
            writer.write(scan)
    points, time = read_by_velodyne_decoder(tmp_path / "drive.pcap", lidar, manual, start)
    expected = points_of(scans, manual)
    np.testing.assert_array_equal(points["ring"], expected.ring)
    np.testing.assert_array_equal(points["intensity"], expected.brightness)
    if dual:
        two = np.bincount(points["return_type"], minlength=4)
        assert two[1] == two[2] > 500  # strongest, last
        assert two[3] > 10_000  # both
    else:
        assert (points["return_type"] == {"strongest": 1, "last": 2}[returns]).all()

    # Of the VLS-128, it has lasers 64 to 127 a step later than the manual, as VeloView, and the stamp at 7 us.
    early, late = (8.67 - 7.0, 2.89) if manual.lasers == 128 else (0.0, 0.0)
    wrong = (early + late * (expected.laser >= 64)) * 1e-6
    # Half a microsecond of the stamp, two roundings to 1 ns, and that of a float32 of up to 0.3 s.
    off = np.abs(time - expected.time - wrong)
    assert off.max() <= 0.5e-6 + 1e-9 + np.spacing(np.float32(0.3))

    # The azimuth is rounded twice to 0.01 degrees. The turn since then is taken from two azimuths in a packet, or of
    # two packets of the VLS-128, each off by half a step; it is off for the times above, too.
    apart = {16: (22, 10), 32: (11, 5), 128: (3, 1)}[manual.lasers][dual]  # cycles
    after = max(manual.firing_us) + late + (manual.cycle_us if manual.lasers == 16 else 0.0)
    azimuth = 0.01 * (1 + after / (apart * manual.cycle_us)) + 360 * manual.rate * late * 1e-6
    xyz = np.stack([points[axis] for axis in "xyz"], axis=-1).astype(np.float64)
    off = np.linalg.norm(xyz - expected.xyz, axis=1)
    # Sines, cosines and four products and sums of float32 numbers.
    bound = manual.step / 2 + expected.range * (np.radians(azimuth) + 8 * 2.0**-24) + from_height(expected, manual)
    bound += 1e-4 * (np.array(manual.heights_mm) != 0)[expected.laser]  # heights to 0.1 mm
    known = expected.cycle >= (manual.cycles(dual) if manual.lasers == 128 else 0)  # from the second packet on
    assert (off <= bound)[known].all()


@pytest.mark.parametrize("returns", MODES)
@pytest.mark.parametrize("model", MANUALS)
def test_all_packets_are_sent_in_order(model: str, returns: str) -> None:
    manual, scans = MANUALS[model], drive(model, returns)
    sent = encode(scans)
    assert {(packet.port, len(packet.payload)) for packet in sent} == {(2368, 1206), (8308, 512)}
    cycles = sum(len(scan) for scan in scans) // manual.lasers
    assert len(data(sent)) == -(-cycles // manual.cycles(returns == "dual"))
    assert {payload[1204] for payload in data(sent)} == {MODES[returns]}

    times = [packet.time for packet in sent]
    assert times == sorted(times)
    last = times[-1 - (sent[-1].port == 8308)] - ORIGIN
    padded = (-cycles) % manual.cycles(returns == "dual") * manual.cycle_us * 1000
    fired = scans[-1].time + scans[-1].pulses.time[-1]
    assert abs(last - padded - fired * 1e9) <= 2  # four roundings to 1 ns, of half of it each


def test_the_first_bytes_are_those_that_the_manual_describes() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 10.0), material=ls.Material(reflectivity=0.42))
    lidar = sensor("velodyne-vlp16", beam_origins=(0, 0, 0))
    scan = lidar.scan(scene, time=0.001)
    payload = encode((scan,))[0].payload
    # 180 degrees: the frame starts behind the sensor. 10 m are 5000 steps of 2 mm. 1600.251 s past the hour.
    assert payload[:10] == bytes.fromhex("ffee 5046 8813 2a 8813 2a".replace(" ", ""))[:10]
    assert payload[100:104] == struct.pack("<HH", 0xEEFF, 18000 + round(36000 * 10 * 110.592e-6))
    assert payload[1200:] == struct.pack("<IBB", 1_600_251_000, 0x37, 0x22)


@pytest.mark.parametrize("returns", MODES)
@pytest.mark.parametrize("model", MANUALS)
def test_nothing_in_sight(model: str, returns: str) -> None:
    scan = sensor(model, returns).scan(ls.Scene())
    manual, sent = MANUALS[model], data(encode((scan,)))
    assert len(sent) == -(-len(scan) // manual.lasers // manual.cycles(returns == "dual"))
    points = np.frombuffer(b"".join(sent), np.uint8).reshape(-1, 1206)[:, :1200].reshape(-1, 12, 100)[..., 4:]
    assert not points.any()
    assert len(decode(sent, manual).time) == 0


def test_dual_of_a_sensor_without_a_beam_is_sent_as_its_strongest_return() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.8))
    sent = []
    for returns in ("dual", "strongest"):
        lidar = ls.Lidar.preset("velodyne-vlp16")
        measurement = ls.Measurement(returns=returns)  # type: ignore[arg-type]
        sent.append(data(encode((dataclasses.replace(lidar, measurement=measurement).scan(scene),))))
    assert sent[0] == sent[1]


def test_pairs_of_returns_are_the_last_and_the_strongest_or_second_strongest() -> None:
    """Before a wall at 8 m: a leaf that returns less, one that returns more, and none."""
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 8.0), material=ls.Material(reflectivity=0.5))
    for y, reflectivity in ((-1.0, 0.05), (1.0, 0.9)):
        # Its lower edge is just above the axes of laser 1, at 1 degree, so that it covers less than half of the beams.
        edge = (np.hypot(4.0, y) * np.tan(np.radians(1.02))).item()
        corners = [(4, y - 0.3, edge), (4, y + 0.3, edge), (4, y + 0.3, 1), (4, y - 0.3, 1)]
        scene.add(ls.Polygon(corners), material=ls.Material(reflectivity=reflectivity))
    scan = sensor("velodyne-vlp16", "dual", beam_origins=(0, 0, 0)).scan(scene)
    raw = np.frombuffer(b"".join(data(encode((scan,)))), np.uint8).reshape(-1, 1206)[:, :1200]
    blocks = raw.reshape(-1, 6, 2, 100).astype(int)
    clockwise = np.radians(blocks[:, :, 0, 2] + 256 * blocks[:, :, 0, 3]) / 100
    points = blocks[..., 7:10]  # of laser 1
    distance, brightness = (points[..., 0] + 256 * points[..., 1]) * 0.002, points[..., 2]

    is_laser, direction = scan.pulses.ring == 8, scan.pulses.directions
    azimuth = np.arctan2(direction[:, 1], direction[:, 0])
    for center, nearer, strongest in (
        (-np.arctan2(1, 4), True, 8.0),
        (np.arctan2(1, 4), True, np.hypot(4, 1)),
        (np.pi / 2, False, 8.0),
    ):
        # The leaf is 0.6 m wide; its distances differ by 0.1 m.
        seen = is_laser & (np.abs(azimuth - center) < 0.02)
        assert np.abs(scan.range[seen, 0] - strongest).max() < 0.1
        near = np.abs((clockwise + center + np.pi) % (2 * np.pi) - np.pi) < 0.02
        assert near.sum() > 2
        last, other = distance[near].T
        assert np.abs(last - 8.0).max() < 0.01
        assert np.abs(other - (np.hypot(4, 1) if nearer else 8.0)).max() < 0.1
        first, second = np.rint(scan.intensity[seen] * 100).T  # strongest first
        far, close = (first, second) if strongest == 8.0 else (second, first)
        assert set(brightness[near][:, 0]) == set(far)
        assert set(brightness[near][:, 1]) == set(close if nearer else far)


def test_firing_cycles_that_fill_no_packet_wait_for_the_next_frame() -> None:
    scans = drive("velodyne-vlp16", "strongest")
    encoder = packets.encoders({"": scans[0].lidar}, start=START)[""]
    counts = [len(data(list(encoder.packets(scan)))) for scan in scans]
    assert [len(scan) // 16 for scan in scans] == [1809, 1808, 1809]
    assert counts == [1809 // 24, (1809 + 1808) // 24 - 1809 // 24, 5426 // 24 - 3617 // 24]
    (rest,) = data(list(encoder.rest()))
    assert list(encoder.rest()) == []

    # 2 of the 24 cycles are left; then the head turns on, and nothing returns.
    assert 5426 % 24 == 2
    blocks = np.frombuffer(rest, np.uint8)[:1200].reshape(12, 100).astype(int)
    assert blocks[0, 4:].any()
    assert not blocks[1:, 4:].any()
    azimuth = blocks[:, 2] + 256 * blocks[:, 3]
    turn = 36000 * 10 * 110.592e-6
    assert np.abs(np.diff(azimuth) % 36000 - turn).max() < 1.0  # each is rounded by half a step


def test_a_frame_that_does_not_follow_the_last_starts_a_packet() -> None:
    manual = MANUALS["velodyne-hdl32e"]
    first, _, third = drive("velodyne-hdl32e", "dual")
    sent = data(encode((first, third)))
    assert len(sent) == 2171 // 6 + 1 + 2170 // 6 + 1
    early, late = (points_of((scan,), manual) for scan in (first, third))
    alone = decode(sent[: 2171 // 6 + 1], manual), decode(sent[2171 // 6 + 1 :], manual)
    for got, expected in zip(alone, (early, late), strict=True):
        np.testing.assert_array_equal(got.laser, expected.laser)
        np.testing.assert_array_equal(got.cycle, expected.cycle)
        assert np.abs(got.time - expected.time).max() < 0.51e-6
        assert np.linalg.norm(got.xyz - expected.xyz, axis=1).max() < 0.002 + 120 * np.radians(0.015)


@pytest.mark.parametrize("width", [np.pi / 3, np.pi / 300])
def test_a_sector_fills_its_last_packet_each_turn(width: float) -> None:
    lidar = sensor("velodyne-vlp32c", field_of_view=width, start_azimuth=width / 2)
    scans = tuple(lidar.frames(street(), None, 3))
    cycles = [len(scan) // 32 for scan in scans]
    sent = data(encode(scans))
    assert len(sent) == sum(-(-count // 12) for count in cycles)
    stamps = np.array([struct.unpack_from("<I", payload, 1200)[0] for payload in sent])
    starts = np.array([scan.time + scan.pulses.time[0] for scan in scans])
    firsts = stamps[np.cumsum([0, *(-(-count // 12) for count in cycles[:-1])])]
    assert np.abs(firsts - ORIGIN % HOUR / 1000 - starts * 1e6).max() < 0.51
    azimuth = np.array([struct.unpack_from("<H", payload, 2)[0] for payload in sent])
    assert ((azimuth >= 33000) | (azimuth <= 3000)).all()


def test_position_packets_tell_the_time() -> None:
    sent = encode(drive("velodyne-vlp16", "strongest"))
    positions = [packet for packet in sent if packet.port == 8308]
    assert len(positions) == len(data(sent)) // 14 > 10
    for packet in positions:
        found = velodyne_decoder.TelemetryPacket(packet.payload)
        second = packet.time // 10**9
        moment = datetime.fromtimestamp(second, UTC).replace(tzinfo=None)
        assert found.pps_status == velodyne_decoder.TelemetryPacket.PpsStatus.LOCKED
        assert found.nmea_time == moment
        passed = (found.pps_time - moment).total_seconds()
        assert abs(passed - packet.time % 10**9 / 1e9) < 1.5e-6  # half a unit of the stamp, and one of datetime
        assert found.nmea_sentence.startswith(f"$GPRMC,{moment:%H%M%S},V,")
        assert found.nmea_sentence[-7:-4] == ",N*"  # mode: not valid
        assert found.nmea_sentence.endswith("\r\n")
        assert not found.parse_nmea().fix_available
        assert not any(packet.payload[:0xC6])
        assert not any(packet.payload[0xCE + len(found.nmea_sentence) :])


def test_stamps_start_again_at_the_full_hour() -> None:
    scans = drive("velodyne-vls128", "dual")[:1]
    start = 7200 - 0.02
    sent = data(encode(scans, start=start))
    stamps = np.array([struct.unpack_from("<I", payload, 1200)[0] for payload in sent])
    assert (np.diff(stamps) < 0).sum() == 1
    assert stamps.max() < 3_600_000_000
    since = np.where(stamps > 1_800_000_000, stamps - 3_600_000_000, stamps)
    fired = np.arange(len(sent)) * 57.8 + 3 * 2.89
    assert np.abs(since + 20_000 - fired).max() < 0.51


def test_ports() -> None:
    lidar = sensor("velodyne-vlp16")
    scan = lidar.scan(ls.Scene())
    two = packets.encoders({"left": lidar, "right": lidar})
    assert {packet.port for packet in two["left"].packets(scan)} == {2368, 8308}
    assert {packet.port for packet in two["right"].packets(scan)} == {2370, 2371}
    (own,) = packets.encoders({"": lidar}, port=9000).values()
    assert {packet.port for packet in own.packets(scan)} == {9000, 9001}


def test_the_zero_of_range_is_that_of_the_sensor() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 10.0))
    offsets = [0.01 * ring for ring in range(16)]
    lidar = dataclasses.replace(sensor("velodyne-vlp16", beam_origins=(0, 0, 0)), range_offset=offsets)
    points = decode(data(encode((lidar.scan(scene),))), MANUALS["velodyne-vlp16"])
    assert np.abs(points.range - 10.0 - np.array(offsets)[points.ring]).max() <= 0.001 + 2 * np.spacing(10.0)


def test_a_calibrated_unit(tmp_path: Path) -> None:
    """Its rings may be in another order than those of the design; its decoder has its calibration."""
    manual, rng = MANUALS["velodyne-vlp32c"], np.random.default_rng(1)
    tilts = np.array(manual.elevations) + rng.uniform(-0.25, 0.25, 32)
    offsets = np.array(manual.offsets) + rng.uniform(-0.1, 0.1, 32)
    assert (np.argsort(tilts) != np.argsort(manual.elevations)).any()
    rows = [
        f"- {{laser_id: {laser}, rot_correction: {-np.radians(turn)}, vert_correction: {np.radians(tilt)}}}"
        for laser, (tilt, turn) in enumerate(zip(tilts, offsets, strict=True))
    ]
    (tmp_path / "unit.yaml").write_text("\n".join(["num_lasers: 32", "lasers:", *rows]))
    unit = dataclasses.replace(ls.Lidar.from_file(tmp_path / "unit.yaml"), measurement=ls.Measurement(), max_range=120)
    scans = (unit.scan(street()),)
    own = manual._replace(elevations=list(tilts), offsets=list(offsets))
    got, expected = decode(data(encode(scans)), own), points_of(scans, own)
    np.testing.assert_array_equal(got.ring, expected.ring)
    assert np.linalg.norm(got.xyz - expected.xyz, axis=1).max() <= 0.002 + expected.range.max() * np.radians(0.015)


def preset_with(model: str = "velodyne-vlp16", **changes: object) -> ls.Lidar:
    return dataclasses.replace(ls.Lidar.preset(model), **changes)


@pytest.mark.parametrize(
    ("lidar", "message"),
    [
        (
            lambda: preset_with(pattern=ls.Lidar.preset("velodyne-vlp32c").pattern),
            "elevations: expected 16 rings for velodyne-vlp16 packets, got 32",
        ),
        (
            lambda: preset_with(pattern=Grid([0.0], np.zeros(16), rate=10.0)),
            "pattern: expected Spinning for velodyne-vlp16 packets, got Grid",
        ),
        (
            lambda: sensor("velodyne-vlp16", clockwise=False),
            "clockwise: expected True for velodyne-vlp16 packets, got False",
        ),
        (
            lambda: sensor("velodyne-vls128", column_period=53.3e-6, firing_times=0.0),
            "column_period: expected 57.8 µs for velodyne-vls128 packets, got 53.3 µs",
        ),
        (
            lambda: sensor("velodyne-hdl32e", column_period=None, columns=2100),
            "column_period: expected 46.08 µs for velodyne-hdl32e packets, got 47.619 µs",
        ),
        (
            lambda: sensor("velodyne-vlp16", firing_times=0.0),
            "firing_times: expected 2.304 µs for ring 8 of velodyne-vlp16, got 0 µs",
        ),
        (
            lambda: sensor("velodyne-vlp16", elevations=np.radians(np.linspace(-7.5, 7.5, 16))),
            "got -7.5° and 0° in ring 0",
        ),
        (
            lambda: sensor("velodyne-vlp16", 2),
            "returns: expected strongest, last, dual for velodyne-vlp16 packets, got 2",
        ),
        (
            lambda: preset_with(measurement=ls.Measurement(returns="first")),
            "returns: expected strongest, last, dual for velodyne-vlp16 packets, got 'first'",
        ),
        (lambda: preset_with("velodyne-hdl64e-s3"), "got 'velodyne-hdl64e-s3'"),
    ],
)
def test_sensors_that_do_not_fit(lidar: object, message: str) -> None:
    with pytest.raises(FileFormatError) as caught:
        packets.encoders({"": lidar()})
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("model", "distance", "most"),
    [("velodyne-vlp16", 0.0009, 131.07), ("velodyne-vlp16", 131.0711, 131.07), ("velodyne-vls128", 262.1421, 262.14)],
)
def test_ranges_that_do_not_fit(model: str, distance: float, most: float) -> None:
    def send(radius: float) -> list[bytes]:
        scene = ls.Scene()
        scene.add(ls.Sphere((0, 0, 0), radius))
        lidar = dataclasses.replace(sensor(model, beam_origins=(0, 0, 0)), min_range=0.0, max_range=np.inf)
        return data(encode((lidar.scan(scene),)))

    step = MANUALS[model].step
    with pytest.raises(
        FileFormatError, match=f"range: expected {step} to {most} m for {model} packets, got {distance}"
    ):
        send(distance)
    assert decode(send(step if distance < 1 else most), MANUALS[model]).range[0] in (step, 65535 * step)


def test_scans_that_do_not_fit() -> None:
    first, second, _ = drive("velodyne-vlp16", "strongest")
    with pytest.raises(FileFormatError, match=r"time: expected a scan after 0\.19\d+ s, got one at 0\.0 s"):
        encode((second, first))
    with pytest.raises(FileFormatError, match="scan: expected pattern and returns of 'velodyne-vlp16'"):
        encode((first, *drive("velodyne-vlp32c", "strongest")[1:]))
    with pytest.raises(FileFormatError, match="scan: expected pattern and returns of 'velodyne-vlp16'"):
        encode((first, *drive("velodyne-vlp16", "last")[1:]))
