"""Livox's packets against a decoder written from the protocols, and what the vendor's own structures read of them."""

from __future__ import annotations

import dataclasses
import struct
import zlib
from typing import Any, NamedTuple

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import ArgumentValueError, FileFormatError
from lidarsim.io import packets as writing
from lidarsim.io.packets.livox import MODELS

START = 1_600_000_000 * 10**9
VARIANTS = [
    (model, variant, returns)
    for model, kind in MODELS.items()
    for variant, layouts in kind.layouts.items()
    for returns in range(1, len(layouts) + 1)
]


class Facts(NamedTuple):
    """A data type of the protocols: section 2.3 of the Mid-360's, 3.3 of the older one."""

    points: int
    format: str
    """Of a point, in the letters of `struct`."""
    tagged: bool = True


NEW = {1: Facts(96, "<iiiBB"), 2: Facts(96, "<hhhBB"), 3: Facts(96, "<IHHBB")}
OLD = {
    0: Facts(100, "<iiiB", tagged=False),
    1: Facts(100, "<IHHB", tagged=False),
    2: Facts(96, "<iiiBB"),
    3: Facts(96, "<IHHBB"),
    4: Facts(48, "<iiiBBiiiBB"),
    5: Facts(48, "<HHIBBIBB"),
}
LINES = {"livox-mid360": 4, "livox-avia": 6, "livox-mid70": 1, "livox-mid40": 1}
SPACING = {"livox-avia": 4167, "livox-mid70": 10_000, "livox-mid40": 10_000}
"""Time from point to point, ns, that drivers assume (livox_ros_driver, lds.h)."""


class Decoded(NamedTuple):
    """Arrays of shape (points, returns)."""

    xyz: Any
    reflectivity: Any
    tag: Any
    time: Any
    """ns since START, shape (points,)."""


def decode(model: str, packets: list[writing.Packet]) -> Decoded:
    """Decode packets as the protocols say."""
    new = model == "livox-mid360"
    parts: list[list[Any]] = [[], [], [], []]
    for _, _, data in packets:
        if new:
            version, length, interval, count = struct.unpack_from("<BHHH", data)
            kind, clock = data[10:12]
            checksum, time = struct.unpack_from("<IQ", data, 24)
            assert (version, length) == (0, len(data))
            assert checksum == zlib.crc32(data[28:])
            body, facts, spacing = data[36:], NEW[kind], interval * 100 // count
            assert count == facts.points
        else:
            assert data[0] == 5
            clock, kind = data[8:10]
            (time,) = struct.unpack_from("<Q", data, 10)
            body, facts, spacing = data[18:], OLD[kind], SPACING[model]
        assert clock == 1
        points = list(struct.iter_unpack(facts.format, body))
        assert len(points) == facts.points
        parts[3] += [time - START + i * spacing for i in range(len(points))]
        for point in points:
            for values, part in zip(_returns(point, facts), parts, strict=False):
                part.append(values)
    return Decoded(*map(np.array, parts))


def _returns(point: tuple[int, ...], facts: Facts) -> tuple[Any, Any, Any]:
    """Return the positions in m, reflectivities and tags of the returns of a point."""
    step = 100.0 if facts.format.startswith("<h") else 1000.0
    if facts.format == "<HHIBBIBB":
        zenith, azimuth, *rest = point
        echoes = [(depth, zenith, azimuth, *rest[i + 1 : i + 3]) for i, depth in ((0, rest[0]), (3, rest[3]))]
    else:
        size = len(facts.format.removeprefix("<")) // (1 + (facts.points == 48))
        echoes = [point[i : i + size] for i in range(0, len(point), size)]
    places = []
    for first, second, third, *_ in echoes:
        if "H" in facts.format:
            zenith, azimuth = np.radians(second / 100), np.radians(third / 100)
            across = np.sin(zenith)
            places.append(first / step * np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(zenith)]))
        else:
            places.append(np.array([first, second, third]) / step)
    return places, [echo[3] for echo in echoes], [echo[4] if facts.tagged else 0 for echo in echoes]


def sensor(model: str, returns: int = 1) -> ls.Lidar:
    lidar = ls.Lidar.preset(model, rate=50.0)
    if returns == 1:
        return lidar
    return dataclasses.replace(lidar, measurement=ls.Measurement(beam=ls.Beam(0.01, rays=7), returns="dual"))


def street() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.8), material=ls.Material(reflectivity=0.2))
    scene.add(ls.Box((4, 8, 10), (20, 0, 0)), material=ls.Material(reflectivity=0.7))
    for place in range(8):
        scene.add(ls.Cylinder((8, place - 3.5, -2), (8, place - 3.5, 4), 0.1), material=ls.Material(reflectivity=1.8))
    return scene


def encode(lidar: ls.Lidar, scans: list[ls.Scan], variant: str | None = None) -> list[writing.Packet]:
    encoder = writing.format_of(lidar, variant).encoder(lidar, start=START, port=56300, variant=variant)
    packets = [packet for scan in scans for packet in encoder.packets(scan)]
    assert not encoder.companions()
    return [*packets, *encoder.rest()]


@pytest.mark.slow("packets hold each pulse of a moving sensor")
@pytest.mark.parametrize(("model", "variant", "returns"), VARIANTS)
def test_every_pulse_of_a_moving_sensor_is_decoded_within_the_steps_of_the_packets(
    model: str, variant: str, returns: int
) -> None:
    lidar = sensor(model, returns)
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(3, 0.5, 0), angular=(0, 0, 0.2))
    scans = list(lidar.frames(street(), drive, 3))
    packets = encode(lidar, scans, variant)
    decoded = decode(model, packets)

    count = sum(len(scan) for scan in scans)
    assert count <= len(decoded.time) < count + len(decoded.time) // len(packets)
    assert not decoded.xyz[count:].any()
    ranges = np.nan_to_num(np.sort(np.concatenate([scan.range for scan in scans]), axis=1))
    directions = np.concatenate([scan.pulses.directions for scan in scans])
    assert (ranges == 0).any()
    assert (ranges > 0).all(axis=1).any()
    true = ranges[..., None] * directions[:, None]
    if variant == "spherical":
        # half a step of depth, and half of 0.01 degrees in zenith and azimuth
        bound = 5e-4 + np.hypot(1, 1) * np.radians(0.005) * ranges
        assert (np.linalg.norm(decoded.xyz[:count] - true, axis=-1) <= bound * (1 + 2.0**-20)).all()
    else:
        step = 1e-2 if variant == "cartesian-16-bit" else 1e-3
        assert np.abs(decoded.xyz[:count] - true).max() <= step / 2 * (1 + 2.0**-20)  # as steps are rounded
    assert np.array_equal(decoded.xyz[:count].any(axis=-1), ranges > 0)

    brightness = np.concatenate([np.rint(np.clip(np.nan_to_num(scan.intensity), 0, 1.7) * 150) for scan in scans])
    if returns == 1:
        assert np.array_equal(decoded.reflectivity[:count], np.where(ranges > 0, brightness, 0))
    assert not decoded.reflectivity[count:].any()
    tags = np.array([0, 16]) if len(decoded.tag[0]) == 2 else np.zeros(1)
    assert (decoded.tag == tags).all()

    # The pulses of a cycle are fired together; decoders space their points evenly.
    time = np.concatenate([(scan.time + scan.pulses.time) * 1e9 for scan in scans])
    period = MODELS[model].period
    assert np.abs(decoded.time[:count] - time).max() < period
    assert decoded.time[:: len(decoded.time) // len(packets)] == pytest.approx(
        time[:: len(decoded.time) // len(packets)], rel=0, abs=1
    )


SIZES = {
    ("livox-mid360", "cartesian", 1): (1380, 1),
    ("livox-mid360", "cartesian-16-bit", 1): (804, 2),
    ("livox-mid360", "spherical", 1): (996, 3),
    ("livox-avia", "cartesian", 1): (1362, 2),
    ("livox-avia", "cartesian", 2): (1362, 4),
    ("livox-avia", "spherical", 1): (978, 3),
    ("livox-avia", "spherical", 2): (786, 5),
    ("livox-mid40", "cartesian", 1): (1318, 0),
    ("livox-mid40", "spherical", 1): (918, 1),
}
"""Bytes of a packet, of the older models as in livox_ros_driver (lds.h), and its data type."""


@pytest.mark.parametrize(("case", "expected"), SIZES.items())
def test_sizes_and_types_are_the_vendors(case: tuple[str, str, int], expected: tuple[int, int]) -> None:
    model, variant, returns = case
    lidar = sensor(model, returns)
    packets = encode(lidar, [lidar.scan(ls.Scene())], variant)
    at = 10 if model == "livox-mid360" else 9
    assert {(len(packet.payload), packet.payload[at]) for packet in packets} == {expected}
    assert not any(decode(model, packets).xyz.ravel())


def test_the_header_of_the_mid360() -> None:
    lidar = sensor("livox-mid360")
    scans = list(lidar.frames(street(), None, 2))
    packets = encode(lidar, scans)
    assert packets[0].payload[:12].hex() == "006405f811600000000001 01".replace(" ", "")
    # 24 cycles of 20 us: 460 us from the first to the last; 1000 cycles a frame
    counts = [struct.unpack_from("<H", packet.payload, 7)[0] for packet in packets]
    assert counts == [*range(41), *range(43)]
    assert {packet.payload[12:24] for packet in packets} == {bytes(12)}
    assert writing.format_of(lidar).port == 56300
    assert [packet.time - START for packet in packets[:2]] == [460_000, 940_000]


def test_the_header_of_the_avia() -> None:
    lidar = sensor("livox-avia")
    packets = encode(lidar, [lidar.scan(street())])
    # version, slot, id, reserved; status: 1588 signal and synchronised by it; PTP, data type 2
    assert packets[0].payload[:10].hex() == "05010100" + "00600000" + "0102"
    assert writing.format_of(lidar).port == 56001


def test_of_dual_returns_the_nearer_comes_first() -> None:
    lidar = sensor("livox-avia", 2)
    scan = lidar.scan(street())
    two = ~np.isnan(scan.range[:, 1])
    assert (scan.range[two, 0] > scan.range[two, 1]).any()
    assert (scan.range[two, 0] < scan.range[two, 1]).any()
    distance = np.linalg.norm(decode("livox-avia", encode(lidar, [scan])).xyz, axis=-1)[: len(scan)]
    assert (distance[two, 0] < distance[two, 1]).all()
    assert not distance[~two, 1].any()


def test_points_that_fill_no_packet_wait_for_the_next_scan() -> None:
    lidar = sensor("livox-mid70")  # 2000 points a frame, 96 in a packet
    encoder = writing.format_of(lidar).encoder(lidar, start=START, port=56001, variant=None)
    counts = [len(list(encoder.packets(scan))) for scan in lidar.frames(street(), None, 5)]
    assert counts == [20, 21, 21, 21, 21]
    (last,) = encoder.rest()
    assert not list(encoder.rest())
    assert decode("livox-mid70", [last]).xyz.any(axis=-1)[16:].sum() == 0  # 10000 = 104 96 + 16


def test_a_packet_ends_before_a_gap() -> None:
    lidar = sensor("livox-mid70")
    scene = street()
    scans = [lidar.scan(scene, time=time, frame=frame) for time, frame in ((0.0, 0), (0.5, 25))]
    packets = encode(lidar, scans)
    assert len(packets) == 2 * 21
    decoded = decode("livox-mid70", packets)
    assert decoded.time[21 * 96] == 500_000_000
    assert not decoded.xyz[2000 : 21 * 96].any()


VENDOR: dict[tuple[str, str, int], tuple[int, list[tuple[int, tuple[float, float, float], int, int]]]] = {
    ("livox-mid360", "cartesian", 1): (
        0xDE347246,
        [
            (460, (8.01, 3.4, 0.005), 80, 0),
            (2016, (-34.333, -31.217, -1.8), 1, 0),
            (3819, (7.928, -3.43, 0.189), 253, 0),
        ],
    ),
    ("livox-mid360", "cartesian-16-bit", 1): (
        0x5AEE1F4E,
        [
            (460, (8.01, 3.4, 0.01), 80, 0),
            (2015, (-12.65, -10.78, -1.8), 3, 0),
            (3819, (7.93, -3.43, 0.19), 253, 0),
        ],
    ),
    ("livox-mid360", "spherical", 1): (
        0xC8BFB287,
        [
            (460, (8.702, 89.97, 23), 80, 0),
            (2016, (46.438, 92.22, 222.28), 1, 0),
            (3819, (8.641, 88.75, 336.6), 253, 0),
        ],
    ),
    ("livox-avia", "cartesian", 1): (
        0x5D915FAF,
        [
            (0, (2.748, -0.772, -1.8), 16, 0),
            (1585, (3.598, 1.937, -1.8), 12, 0),
            (4799, (7.901, -0.484, 2.531), 255, 0),
        ],
    ),
    ("livox-avia", "cartesian", 2): (
        0xC025339A,
        [
            (1028, (7.918, -2.583, -1.541), 52, 0),
            (1029, (9.244, -3.016, -1.8), 3, 16),
            (2447, (19.17, 8.102, -1.798), 2, 16),
        ],
    ),
    ("livox-avia", "spherical", 1): (
        0x3147F6A8,
        [
            (0, (3.374, 122.24, 344.31), 16, 0),
            (1585, (4.465, 113.77, 28.29), 12, 0),
            (4799, (8.311, 72.27, 356.49), 255, 0),
        ],
    ),
    ("livox-avia", "spherical", 2): (
        0x236C4B0E,
        [
            (1028, (8.47, 100.49, 341.93), 52, 0),
            (1029, (9.888, 100.49, 341.93), 3, 16),
            (2447, (20.89, 94.94, 22.91), 2, 16),
        ],
    ),
    ("livox-mid70", "cartesian", 1): (
        0xD105192C,
        [
            (86, (7.939, -3.579, 2.984), 59, 0),
            (982, (4.738, -2.635, -1.8), 9, 0),
            (1999, (2.846, 0.806, -1.8), 16, 0),
        ],
    ),
    ("livox-mid70", "cartesian", 2): (
        0x3DBC5B27,
        [
            (386, (7.936, -1.598, 0.965), 40, 0),
            (387, (18.005, -3.626, 2.189), 63, 16),
            (1427, (17.999, 3.096, 0.564), 90, 16),
        ],
    ),
    ("livox-mid70", "spherical", 1): (
        0x1665DB79,
        [
            (86, (9.206, 71.09, 335.73), 59, 0),
            (982, (5.713, 108.37, 330.92), 9, 0),
            (1999, (3.462, 121.32, 15.82), 16, 0),
        ],
    ),
    ("livox-mid70", "spherical", 2): (
        0x2848AAFF,
        [
            (386, (8.153, 83.2, 348.61), 40, 0),
            (387, (18.497, 83.2, 348.61), 63, 16),
            (1427, (18.272, 88.23, 9.76), 90, 16),
        ],
    ),
    ("livox-mid40", "cartesian", 1): (
        0x42F85FE8,
        [
            (0, (7.405, 1.827, -1.8), 7, 0),
            (1147, (18, 2.901, 3.125), 102, 0),
            (1929, (18, -1.512, 4.989), 101, 0),
        ],
    ),
    ("livox-mid40", "spherical", 1): (
        0x04B3FAB2,
        [
            (0, (7.837, 103.28, 13.86), 7, 0),
            (1147, (18.498, 80.27, 9.15), 102, 0),
            (1929, (18.74, 74.56, 355.2), 101, 0),
        ],
    ),
}
"""What the structures of Livox-SDK (9306596a, livox_def.h) and Livox-SDK2 (livox_lidar_def.h) read of packets of the
street in the test below, compiled by GCC 12.

By model, variant and number of returns: CRC-32 of all packets; number of the return (among all returns of all points),
x, y, z in m or depth in m, theta and phi in degrees, reflectivity, and tag. The CRC-32 of all packets of the Mid-360 is
also right by FastCRC of Livox-SDK2.
"""


@pytest.mark.parametrize(("model", "variant", "returns"), VARIANTS)
def test_the_vendors_structures_read_the_same_points(model: str, variant: str, returns: int) -> None:
    lidar = sensor(model, returns)
    packets = encode(lidar, [lidar.scan(street(), frame=2)], variant)
    checksum, points = VENDOR[model, variant, returns]
    assert zlib.crc32(b"".join(packet.payload for packet in packets)) == checksum
    decoded = decode(model, packets)
    for number, place, brightness, tag in points:
        at = divmod(number, returns)
        xyz = np.array(place)
        if variant == "spherical":
            depth, zenith, azimuth = place[0], *np.radians(place[1:])
            xyz = depth * np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
        assert decoded.xyz[at] == pytest.approx(xyz, rel=2.0**-48, abs=2.0**-48)
        assert (decoded.reflectivity[at], decoded.tag[at]) == (brightness, tag)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pulse_rate": 50e3}, "pattern: expected 6 rings that fire together every 25 us for packets of livox-avia"),
        ({"beams": [[1, 0, 0]]}, "pattern: expected 6 rings"),
    ],
)
def test_refuses_a_pattern_that_does_not_fit(change: dict[str, Any], message: str) -> None:
    lidar = ls.Lidar.preset("livox-avia")
    lidar = dataclasses.replace(lidar, pattern=dataclasses.replace(lidar.pattern, **change))  # type: ignore[type-var]
    with pytest.raises(FileFormatError, match=message):
        writing.encoders({"": lidar})


@pytest.mark.parametrize(("model", "most"), [("livox-mid360", "one return"), ("livox-avia", "up to two returns")])
def test_refuses_more_returns_than_the_packets_hold(model: str, most: str) -> None:
    lidar = dataclasses.replace(sensor(model), measurement=ls.Measurement(beam=ls.Beam(0.01), returns=3))
    with pytest.raises(FileFormatError, match=f"returns: expected {most} for packets of {model}, got 3"):
        writing.encoders({"": lidar})


@pytest.mark.parametrize(
    ("variant", "distance", "message"),
    [
        (
            "cartesian-16-bit",
            400.0,
            "expected points at least 0.01 m away and within 327.67 m for packets of livox-mid",
        ),
        ("cartesian", 2e-4, "expected points at least 0.001 m away and within 2.14748e.06 m"),
        ("spherical", 5e6, "expected points at least 0.001 m away and within 4.29497e.06 m"),
    ],
)
def test_refuses_a_range_that_does_not_fit(variant: str, distance: float, message: str) -> None:
    lidar = dataclasses.replace(sensor("livox-mid360"), min_range=0.0, max_range=np.inf)
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), distance))
    with pytest.raises(FileFormatError, match=f"range: {message}"):
        encode(lidar, [lidar.scan(scene)], variant)


def test_refuses_unknown_variants_and_scans_of_others() -> None:
    with pytest.raises(ArgumentValueError, match="one of cartesian, spherical for livox-avia"):
        writing.encoders({"": sensor("livox-avia")}, variant="cartesian-16-bit")
    with pytest.raises(FileFormatError, match="scan: expected one of the sensor that the packets are of"):
        encode(sensor("livox-avia"), [sensor("livox-mid70").scan(ls.Scene())])


def test_a_pattern_of_the_vendors_table_fits() -> None:
    lidar = sensor("livox-mid360")
    pulses = lidar.pattern.pulses(2)
    table = ls.patterns.Table(pulses.directions, times=pulses.time, rings=pulses.ring, rate=50.0)
    again = dataclasses.replace(lidar, pattern=table)
    scan = lidar.scan(street(), frame=2)
    assert scan.summary()["hit"] > 0
    assert encode(again, [again.scan(street())]) == encode(lidar, [scan])


def test_all_models_are_tested() -> None:
    assert {model: kind.lines for model, kind in MODELS.items()} == LINES
    assert {model for model in writing.names() if model.startswith("livox")} == MODELS.keys()
