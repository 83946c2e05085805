"""Ouster's packets, read by a decoder of its own from the public documentation.

Sources: Ouster Firmware User Manual, Lidar Data, Lidar Data (LEGACY), Lidar Range to XYZ; ouster-sdk 1.0.1 for `SDK`.
"""

from __future__ import annotations

import json
import lzma
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.io.packets import Packet, encoders
from lidarsim.io.packets.ouster import crc64

PRESETS = [name for name in ls.Lidar.presets() if name.startswith("ouster-")]
VARIANTS = ["single", "dual", "low-data-rate", "legacy"]
START = 1_577_836_800 * 10**9


def _scene() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.8), material=ls.Material(reflectivity=0.3))
    scene.add(ls.Box((4, 2, 3), (12, 3, 0)), material=ls.Material(reflectivity=0.8))
    scene.add(ls.Sphere((-9, 4, 1), 2.0), material=ls.Material(reflectivity=0.5))
    return scene


SCENE = _scene()


def sensor(name: str, variant: str | None = None, **changes: Any) -> ls.Lidar:
    """A preset of 512 columns; for dual packets, with a beam that sees two echoes at edges."""
    lidar = ls.Lidar.preset(name, mode="512x10")
    if variant == "dual":
        lidar = replace(lidar, measurement=ls.Measurement(beam=ls.Beam(0.02), returns="dual"))
    return replace(lidar, **changes)


def packets_of(lidar: ls.Lidar, *scans: ls.Scan, **options: Any) -> tuple[list[Packet], dict[str, Any]]:
    """The packets and the metadata of scans."""
    encoder = encoders({"": lidar}, **options)[""]
    found = [packet for scan in scans for packet in encoder.packets(scan)]
    assert list(encoder.rest()) == []
    return found, json.loads(encoder.companions()[".json"])


class Column(NamedTuple):
    """A measurement block: its numbers, and for each return the ranges (mm), reflectivities and signals."""

    time: int
    number: int
    frame: int
    valid: bool
    encoder: int | None
    range: npt.NDArray[np.int64]
    reflectivity: npt.NDArray[np.int64]
    signal: npt.NDArray[np.int64] | None
    near_infrared: npt.NDArray[np.int64]


def bits(words: npt.NDArray[np.uint8], first: int, count: int) -> npt.NDArray[np.int64]:
    """Bits of little-endian pixels, shape (channels, bytes), counted from the lowest of the first byte."""
    values = [int.from_bytes(word.tobytes(), "little") for word in words]
    return np.array([value >> first & (1 << count) - 1 for value in values], dtype=np.int64)


# First bit and number of bits of the ranges, reflectivities, signals and the near infrared, and mm in a unit of range.
FIELDS: dict[str, Any] = {
    "LEGACY": (12, [(0, 20)], [(32, 8)], [(48, 16)], (64, 16), 1),
    "RNG19_RFL8_SIG16_NIR16": (12, [(0, 19)], [(32, 8)], [(48, 16)], (64, 16), 1),
    "RNG19_RFL8_SIG16_NIR16_DUAL": (16, [(0, 19), (32, 19)], [(24, 8), (56, 8)], [(64, 16), (80, 16)], (96, 16), 1),
    "RNG15_RFL8_NIR8": (4, [(0, 15)], [(16, 8)], None, (24, 8), 8),
}


def decode(payload: bytes, metadata: dict[str, Any]) -> list[Column]:
    """The columns of a packet, after checking all that surrounds them."""
    form = metadata["lidar_data_format"]
    profile, channels = form["udp_profile_lidar"], form["pixels_per_column"]
    size, ranges, reflectivities, signals, near_infrared, step = FIELDS[profile]
    legacy = profile == "LEGACY"
    head, column, tail = (0, 16 + channels * size + 4, 0) if legacy else (32, 12 + channels * size, 32)
    assert len(payload) == head + form["columns_per_packet"] * column + tail
    frame = None
    if not legacy:
        kind, frame, identity = struct.unpack_from("<HHQ", payload)
        assert kind == 1
        assert identity & 0xFFFFFF == metadata["sensor_info"]["initialization_id"] > 0
        assert identity >> 24 == int(metadata["sensor_info"]["prod_sn"])
        assert not any(payload[12:32])
        assert not any(payload[-32:-8])
        assert struct.unpack("<Q", payload[-8:])[0] == checksum(payload[:-8])
    columns = []
    for k in range(form["columns_per_packet"]):
        block = payload[head + k * column : head + (k + 1) * column]
        ticks: int | None = None
        if legacy:
            time, number, frame, ticks = struct.unpack_from("<QHHI", block)
            status = struct.unpack("<I", block[-4:])[0]
            assert status in {0, 0xFFFFFFFF}
            pixels = block[16:-4]
        else:
            time, number, status = struct.unpack_from("<QHH", block)
            assert status in {0, 1}
            pixels = block[12:]
        words = np.frombuffer(pixels, np.uint8).reshape(channels, size)
        used = [*ranges, *reflectivities, *(signals or []), near_infrared]
        mask = sum(((1 << count) - 1) << first for first, count in used)
        assert not any(int.from_bytes(word.tobytes(), "little") & ~mask for word in words)
        columns.append(
            Column(
                *(time, number, int(frame or 0), bool(status), ticks),
                np.stack([bits(words, *place) for place in ranges]) * step,
                np.stack([bits(words, *place) for place in reflectivities]),
                None if signals is None else np.stack([bits(words, *place) for place in signals]),
                bits(words, *near_infrared),
            )
        )
    return columns


def checksum(message: bytes) -> int:
    """The CRC-64 in the footer of an XZ file's block, which is the one that Ouster uses."""
    file = lzma.compress(message, check=lzma.CHECK_CRC64, preset=0)
    index = 4 * (struct.unpack_from("<I", file, len(file) - 8)[0] + 1)  # the footer has 12 bytes, the index before it
    return int(struct.unpack_from("<Q", file, len(file) - 12 - index - 8)[0])


def points(column: Column, metadata: dict[str, Any], echo: int) -> npt.NDArray[np.float64]:
    """The points of a column, m, shape (channels, 3), by the manual's formula."""
    beam = metadata["beam_intrinsics"]
    to_lidar = np.array(beam["beam_to_lidar_transform"]).reshape(4, 4)
    to_sensor = np.array(metadata["lidar_intrinsics"]["lidar_to_sensor_transform"]).reshape(4, 4)
    out, up = to_lidar[0, 3], to_lidar[2, 3]
    n = math.hypot(out, up)
    assert beam["lidar_origin_to_beam_origin_mm"] == n
    encoder = 2.0 * math.pi * (1.0 - column.number / metadata["lidar_data_format"]["columns_per_frame"])
    azimuth = encoder - np.radians(beam["beam_azimuth_angles"])
    altitude = np.radians(beam["beam_altitude_angles"])
    r = column.range[echo] - n
    x = r * np.cos(azimuth) * np.cos(altitude) + out * math.cos(encoder)
    y = r * np.sin(azimuth) * np.cos(altitude) + out * math.sin(encoder)
    z = r * np.sin(altitude) + up
    return ((to_sensor @ np.stack([x, y, z, np.ones_like(x)]))[:3] / 1e3).T


@pytest.mark.slow("decoders find our points in all variants and modes")
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", PRESETS)
def test_a_decoder_finds_our_points(name: str, variant: str) -> None:
    lidar = sensor(name, variant)
    scans = [lidar.scan(SCENE, frame=frame, time=frame / 10.0, seed=4) for frame in (6, 7)]
    packets, metadata = packets_of(lidar, *scans, variant=variant)
    channels = lidar.pattern.shape[0]
    columns = [column for packet in packets for column in decode(packet.payload, metadata)]
    assert len(packets) == 64
    assert [(column.frame, column.number) for column in columns] == [(f, m) for f in (6, 7) for m in range(512)]
    assert all(column.valid for column in columns)
    if variant == "legacy":
        assert [column.encoder for column in columns[:512]] == [176 * m for m in range(512)]
    # A range is off by half a step at most. Angles are rounded to 5e-11 degrees, 1e-12 rad, or 3e-10 m at 300 m, and
    # lengths to 5e-13 m; float64 adds less.
    bound = 0.5e-3 * (8 if variant == "low-data-rate" else 1) + 1e-9
    seen = [0, 0]
    for k, scan in enumerate(scans):
        ends = scan.pulses.origins[:, None] + scan.pulses.directions[:, None] * scan.range[..., None]
        ends = ends.reshape(512, channels, -1, 3)
        times = np.rint((scan.time + scan.pulses.time.reshape(512, -1)[:, 0]) * 1e9).astype(np.int64) + START
        bright = np.rint(np.clip(scan.intensity, 0, 2.55) * 100).reshape(512, channels, -1)
        for m, column in enumerate(columns[512 * k : 512 * (k + 1)]):
            assert column.time == times[m]
            assert not column.near_infrared.any()
            for echo in range(ends.shape[2]):
                hit = np.isfinite(ends[m, :, echo, 0])
                assert ((column.range[echo] > 0) == hit).all()
                off = np.linalg.norm(points(column, metadata, echo) - ends[m, :, echo], axis=1)[hit]
                assert (off <= bound).all()
                # float32 products of whole percents and 100 may fall on either side of a half
                assert np.allclose(column.reflectivity[echo][hit], bright[m, hit, echo], rtol=0, atol=1)
                assert not column.reflectivity[echo][~hit].any()
                if column.signal is not None:
                    assert (column.signal[echo] == column.reflectivity[echo]).all()
                seen[echo] += int(hit.sum())
    assert seen[0] > 10_000
    assert (seen[1] > 100) == (variant == "dual")


# What ouster-sdk 1.0.1 reads from the packets of `sensor("ouster-os1-128", variant)` and this scene, by
# `ouster.sdk.open_source("a.pcap")`, in channel, column and return: time in ns, range in mm, reflectivity, and x, y, z
# in m, by XYZLut, rounded to 1e-6 m.
SDK: dict[tuple[str, int, int, int], tuple[int, int, int, tuple[float, float, float]]] = {
    ("single", 127, 0, 0): (1577836800700000000, 4956, 11, (-4.589749, -0.335889, -1.80005)),
    ("single", 80, 511, 0): (1577836800799804688, 16829, 3, (-16.697132, 1.022089, -1.800054)),
    ("dual", 77, 243, 0): (1577836800747460938, 20113, 2, (19.847553, 2.69469, -1.792267)),
    ("dual", 77, 243, 1): (1577836800747460938, 14165, 1, (13.978056, 1.897908, -1.251117)),
    ("dual", 127, 0, 0): (1577836800700000000, 4955, 11, (-4.588823, -0.335821, -1.799678)),
    ("low-data-rate", 127, 0, 0): (1577836800700000000, 4952, 11, (-4.586045, -0.335617, -1.798563)),
    ("low-data-rate", 80, 511, 0): (1577836800799804688, 16832, 3, (-16.700108, 1.022271, -1.800381)),
    ("legacy", 127, 0, 0): (1577836800700000000, 4956, 11, (-4.589749, -0.335889, -1.80005)),
    ("legacy", 80, 511, 0): (1577836800799804688, 16829, 3, (-16.697132, 1.022089, -1.800054)),
}


def test_ouster_sdk_agrees() -> None:
    assert {variant for variant, *_ in SDK} == set(VARIANTS)
    for variant in VARIANTS:
        lidar = sensor("ouster-os1-128", variant)
        scan = lidar.scan(SCENE, frame=7, time=0.7, seed=3)
        packets, metadata = packets_of(lidar, scan, variant=variant)
        columns = [column for packet in packets for column in decode(packet.payload, metadata)]
        ends = scan.pulses.origins[:, None] + scan.pulses.directions[:, None] * scan.range[..., None]
        ends = ends.reshape(512, 128, -1, 3)
        for (of, channel, m, echo), (time, distance, reflectivity, xyz) in SDK.items():
            if of == variant:
                column = columns[m]
                found = column.time, column.range[echo, channel], column.reflectivity[echo, channel]
                assert found == (time, distance, reflectivity)
                # the table is rounded to 1e-6 m in each coordinate
                assert np.abs(points(column, metadata, echo)[channel] - xyz).max() <= 0.6e-6
                step = 8e-3 if variant == "low-data-rate" else 1e-3
                assert np.linalg.norm(ends[m, channel, echo] - xyz) <= 0.5 * step + 1e-6


def test_the_variant_follows_from_the_returns() -> None:
    beam = ls.Beam(0.02)
    for returns, variant, order in (
        ("strongest", "RNG19_RFL8_SIG16_NIR16", "STRONGEST_TO_WEAKEST"),
        ("first", "RNG19_RFL8_SIG16_NIR16", "NEAREST_TO_FARTHEST"),
        ("last", "RNG19_RFL8_SIG16_NIR16", "FARTHEST_TO_NEAREST"),
        ("dual", "RNG19_RFL8_SIG16_NIR16_DUAL", "STRONGEST_TO_WEAKEST"),
        (1, "RNG19_RFL8_SIG16_NIR16", "NEAREST_TO_FARTHEST"),
        (2, "RNG19_RFL8_SIG16_NIR16_DUAL", "NEAREST_TO_FARTHEST"),
    ):
        lidar = sensor("ouster-os0-128", measurement=ls.Measurement(beam=beam, returns=returns))  # type: ignore[arg-type]
        packets, metadata = packets_of(lidar, lidar.scan(SCENE))
        assert metadata["lidar_data_format"]["udp_profile_lidar"] == variant
        assert metadata["config_params"]["udp_profile_lidar"] == variant
        assert metadata["config_params"]["return_order"] == order
        near = far = 0
        for packet in packets:
            for column in decode(packet.payload, metadata):
                if len(column.range) == 2:
                    both = column.range[1] > 0
                    assert (column.range[0][both] > 0).all()
                    near += int((column.range[0] < column.range[1])[both].sum())
                    far += int((column.range[0] > column.range[1])[both].sum())
        if returns == "dual":
            assert near > 0
            assert far > 0  # the strongest is often the farther one
        if returns == 2:
            assert near > 50
            assert far == 0
    # one return in packets of two
    lidar = sensor("ouster-os1-64")
    packets, metadata = packets_of(lidar, lidar.scan(SCENE), variant="dual")
    assert not any(column.range[1].any() for packet in packets for column in decode(packet.payload, metadata))


def test_frames_are_counted() -> None:
    lidar = sensor("ouster-os1-64")
    scans = [lidar.scan(SCENE, frame=frame, time=k / 10) for k, frame in enumerate((65_534, 65_535, 0, 0, 70_000))]
    for variant in ("single", "legacy"):
        packets, metadata = packets_of(lidar, *scans, variant=variant)
        numbers = [{column.frame for column in decode(packet.payload, metadata)} for packet in packets]
        assert all(len(number) == 1 for number in numbers)
        # A number that is not above the last one counts on, since equal numbers would make one frame of two scans.
        assert [min(number) for number in numbers[::32]] == [65_534, 65_535, 0, 1, 70_000 - 65_536]


def test_a_packet_is_sent_when_its_last_column_is_fired() -> None:
    lidar = sensor("ouster-os1-64")
    packets, metadata = packets_of(lidar, lidar.scan(SCENE, time=0.1), start=1e9, port=9000)
    times = [max(column.time for column in decode(packet.payload, metadata)) for packet in packets]
    assert [packet.time for packet in packets] == times
    assert times[0] == 10**18 + 10**8 + round(15 / 512 / 10 * 1e9)
    assert {packet.port for packet in packets} == {9000}
    config = metadata["config_params"]
    assert (config["udp_port_lidar"], config["udp_port_imu"]) == (9000, 9001)


@pytest.mark.parametrize(("first", "count"), [(0, 512), (250, 101), (5, 500), (400, 224), (500, 50), (16, 16), (17, 1)])
def test_a_part_of_a_turn(first: int, count: int) -> None:
    """Columns that are not fired are in the packets, but not valid; frames are divided at column 0."""
    whole = sensor("ouster-os1-64")
    pattern = replace(
        whole.pattern,  # type: ignore[type-var]
        field_of_view=2.0 * math.pi * (count / 512),
        start_azimuth=math.pi - 2.0 * math.pi * (first / 512),
    )
    lidar = replace(whole, pattern=pattern)
    assert lidar.pattern.shape == (64, count)
    scan = lidar.scan(SCENE, frame=2, time=0.2)
    packets, metadata = packets_of(lidar, scan)
    last = (first + count - 1) % 512
    assert metadata["lidar_data_format"]["column_window"] == [first, last]
    # The window of directions, in thousandths of a degree, holds those of the columns: column 0 looks along 0.
    start, end = metadata["config_params"]["azimuth_window"]
    beyond = (-360_000 * np.arange(512) / 512 - start + 0.5) % 360_000
    inside = beyond <= ((end - start) % 360_000 or 360_000 * (count == 512)) + 1.0
    assert set(np.flatnonzero(inside)) == {(first + k) % 512 for k in range(count)}
    columns = [column for packet in packets for column in decode(packet.payload, metadata)]
    numbers = 2 * 512 + first + np.arange(count)
    assert len(packets) == numbers[-1] // 16 - numbers[0] // 16 + 1
    valid = [column for column in columns if column.valid]
    assert [512 * column.frame + column.number for column in valid] == numbers.tolist()
    ends = (scan.pulses.origins + scan.pulses.directions * scan.range).reshape(count, 64, 3)
    for k, column in enumerate(valid):
        hit = np.isfinite(ends[k, :, 0])
        off = np.linalg.norm(points(column, metadata, 0) - ends[k], axis=1)[hit]
        assert (off <= 0.5e-3 + 1e-9).all()  # as above
    assert not any(column.range.any() or column.time for column in columns if not column.valid)


@pytest.mark.parametrize("name", PRESETS)
def test_our_metadata_are_those_of_the_sensor(name: str, tmp_path: Path) -> None:
    lidar = ls.Lidar.preset(name)
    path = tmp_path / "a.json"
    path.write_bytes(encoders({"": lidar})[""].companions()[".json"])
    read = ls.Lidar.from_file(path)
    for what in ("elevations", "azimuth_offsets", "beam_origins", "columns", "rate", "start_azimuth", "field_of_view"):
        given, found = getattr(lidar.pattern, what), getattr(read.pattern, what)
        # 1e-10 degrees and 1e-9 mm, to which the metadata are rounded
        assert np.abs(np.asarray(given) - found).max() <= 2e-12, what
    assert read.range_offset == lidar.range_offset
    assert (read.min_range, read.max_range) == (lidar.min_range, lidar.max_range)
    # and so they describe themselves, to the last bit
    again = encoders({"": replace(read, name=lidar.name, model=lidar.model)})[""].companions()[".json"]
    assert again == path.read_bytes()
    kind = {"0": "OS-0", "1": "OS-1", "2": "OS-2"}[name[9]]
    assert json.loads(again)["sensor_info"]["prod_line"] == f"{kind}-{lidar.pattern.shape[0]}"


def test_metadata_of_another_sensor_of_its_own(tmp_path: Path) -> None:
    """Beams that leave above the lidar frame, a lidar frame of its own, 32 channels, and a model that is a product."""
    lidar = sensor("ouster-os1-64")
    metadata = json.loads(encoders({"": lidar})[""].companions()[".json"])
    beam = metadata["beam_intrinsics"]
    beam["beam_altitude_angles"] = beam["beam_altitude_angles"][::2]
    beam["beam_azimuth_angles"] = beam["beam_azimuth_angles"][::2]
    beam["beam_to_lidar_transform"][11] = 5.5
    metadata["lidar_intrinsics"]["lidar_to_sensor_transform"][:8] = [0.6, -0.8, 0, 0, 0.8, 0.6, 0, 0]
    metadata["lidar_data_format"]["pixels_per_column"] = 32
    metadata["sensor_info"]["prod_line"] = "OS-1-32-G"
    path = tmp_path / "own.json"
    path.write_text(json.dumps(metadata), encoding="ascii")
    own = ls.Lidar.from_file(path)
    assert own.model == "ouster-os-1-32-g"
    scan = own.scan(SCENE)
    packets, found = packets_of(own, scan)
    assert found["sensor_info"]["prod_line"] == "OS-1-32"
    ends = (scan.pulses.origins + scan.pulses.directions * scan.range).reshape(512, 32, 3)
    columns = [column for packet in packets for column in decode(packet.payload, found)]
    off = np.array([np.linalg.norm(points(column, found, 0) - ends[k], axis=1) for k, column in enumerate(columns)])
    assert np.isfinite(off).sum() > 1000
    assert np.nanmax(off) <= 0.5e-3 + 1e-9  # as above


def test_destaggered_rows_look_the_same_way() -> None:
    lidar = sensor("ouster-os1-64")
    _, metadata = packets_of(lidar)
    shift = np.array(metadata["lidar_data_format"]["pixel_shift_by_row"])
    azimuth = np.degrees(lidar.pattern.azimuth_offsets)  # type: ignore[attr-defined]
    # The head turns clockwise: a channel that looks to the left sees a direction later, by as many columns.
    assert (np.abs(azimuth + shift * 360 / 512) <= 0.5 * 360 / 512).all()
    assert len(np.unique(shift)) > 2


def _pattern(**changes: Any) -> dict[str, Any]:
    return {"pattern": replace(sensor("ouster-os1-64").pattern, **changes)}  # type: ignore[type-var]


DUAL = ls.Measurement(beam=ls.Beam(0.02), returns="dual")
REFUSED: dict[str, tuple[dict[str, Any], str | None, str]] = {
    "columns": (
        _pattern(columns=500),
        None,
        "columns and rate: expected those of one of the modes 512x10, .*, got 500x10",
    ),
    "rate": (_pattern(rate=15.0), None, "columns and rate: expected those of one of the modes .*, got 512x15"),
    "channels": (
        _pattern(elevations=[0.1, 0.0], azimuth_offsets=0.0, firing_times=0.0, beam_origins=np.array([0.01, 0, 0])),
        None,
        "channels: expected one of 16, 32, 64, 128 for Ouster's packets, got 2",
    ),
    "direction": (_pattern(clockwise=False), None, "clockwise: expected True for Ouster's packets, got False"),
    "times": (
        _pattern(firing_times=np.linspace(0, 1e-5, 64)),
        None,
        "firing_times: expected 0: all channels of a column",
    ),
    "beams": (
        _pattern(beam_origins=np.linspace((0, 0, 0), (0.01, 0, 0), 64)),
        None,
        "beam_origins: expected the same for all channels for Ouster's packets, got several",
    ),
    "side": (_pattern(beam_origins=np.array([0.01, 0.002, 0])), None, "beam_origins: expected y = 0 .*, got 0.002 m"),
    "zero": (
        {"range_offset": 0.0},
        None,
        "range_offset: expected one number, at least 0.012163 m, the distance of the ",
    ),
    "zeros": ({"range_offset": np.linspace(0.1, 0.2, 64)}, None, "range_offset: expected one number"),
    "pattern": (
        {"pattern": ls.patterns.Grid([0.0], [0.0], rate=10.0)},
        None,
        "pattern: expected Spinning for Ouster's packets, got Grid",
    ),
    "model": ({"model": "ouster-osdome-128"}, None, r"model: expected ouster-os0-\*, ouster-os1-\* or ouster-os2-\*"),
    "returns": ({"measurement": DUAL}, "single", "returns: expected one return for single packets, got 'dual'"),
    "low": (
        {"measurement": DUAL},
        "low-data-rate",
        "returns: expected one return for low-data-rate packets, got 'dual'",
    ),
    "three": (
        {"measurement": replace(DUAL, returns=3)},
        "dual",
        "returns: expected up to two returns for dual packets, got 3",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_sensors_that_do_not_fit_are_refused(case: str) -> None:
    changes, variant, message = REFUSED[case]
    lidar = replace(sensor("ouster-os1-64"), **changes)
    with pytest.raises(FileFormatError, match=f"^{message}"):
        encoders({"": lidar}, variant=variant)


@pytest.mark.parametrize("variant", VARIANTS)
def test_ranges_that_do_not_fit_are_refused(variant: str) -> None:
    step, most = {"low-data-rate": (8, 32767), "legacy": (1, 1048575)}.get(variant, (1, 524287))
    lidar = sensor("ouster-os1-64")
    offset = float(np.asarray(lidar.range_offset))
    for steps, fits in ((1, True), (0.4, False), (most, True), (most + 1, False)):
        scan = lidar.scan(SCENE)
        scan.range[100, 0] = steps * step / 1e3 - offset
        if fits:
            packets, metadata = packets_of(lidar, scan, variant=variant)
            column = decode(packets[0].payload, metadata)[1]
            assert column.range[0, 100 - 64] == round(steps) * step
        else:
            message = rf"^range in {step} mm: expected 1 to {most} for a return in .*, got range in {step} mm\[100\] = "
            with pytest.raises(FileFormatError, match=message):
                packets_of(lidar, scan, variant=variant)


@pytest.mark.parametrize("time", [-1.0, 5e9, 1e300])
def test_times_that_do_not_fit_are_refused(time: float) -> None:
    lidar = sensor("ouster-os1-64")
    with pytest.raises(FileFormatError, match=r"^time in ns: expected 0 to 4611686018427387904 for packets, got "):
        packets_of(lidar, lidar.scan(SCENE, time=time), start=0.0)


@pytest.mark.parametrize("words", [1, 2, 3, 7, 8, 9, 1551])
def test_the_checksum_is_that_of_xz(words: int) -> None:
    messages = np.random.default_rng(words).integers(0, 2**64, (3, words), dtype=np.uint64)
    messages[2] = 0
    found = crc64(messages).tolist()
    assert found == [checksum(message.astype("<u8").tobytes()) for message in messages]
    assert len(set(found)) == 3
