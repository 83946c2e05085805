"""Hesai's packets against a decoder written from the user manuals, against what Hesai's SDK decodes, and real ones.

The heads and the functional safety message are of packets that real sensors sent: test data of tier4/nebula (606ac41f,
Apache-2.0), nebula_hesai/test_resources/decoder_ground_truth.
"""

from __future__ import annotations

import dataclasses
import itertools
import struct
import zlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.io import packets as writing
from lidarsim.io.packets.hesai import LAYOUTS, crc32_mpeg2

DATA = Path(__file__).parents[2] / "data" / "sensors" / "hesai"
START = 1_600_000_000
"""2020-09-13T12:26:40Z."""


class Facts(NamedTuple):
    """Offsets of bytes in a packet, and constants, from section 3 and appendix B of the user manuals."""

    channels: int
    blocks: int
    first: int
    block: int
    azimuth: int
    unit: int
    speed: int
    microseconds: int
    mode: int
    date: int
    sequence: int
    size: int
    step: float
    period: float
    offset: float
    center: tuple[float, float]
    """Optical centre: forward and left, m."""
    year: int = 1900
    from_first: bool = False
    """Whether columns count from the first of the packet, else back from the last."""


OLD, QT, XT, LONG = (0.03873, 0.012), (0.0298, 0.0072), (0.0315, 0.013), (0.045, 0.01)
FACTS = {
    "hesai-pandar40p": Facts(
        40, 10, 0, 124, 2, 3, 1248, 1250, 1254, 1256, 1262, 1266, 0.004, 55.56, -28.58, OLD, year=2000
    ),
    "hesai-pandar64": Facts(64, 6, 8, 194, 0, 3, 1180, 1182, 1186, 1188, 1194, 1198, 0.004, 55.56, -42.58, OLD),
    "hesai-qt64": Facts(
        *(64, 4, 12, 258, 0, 4, 1054, 1056, 1060, 1062, 1068, 1072, 0.004, 500 / 3, 25.71, QT), from_first=True
    ),
    "hesai-xt32": Facts(32, 8, 12, 130, 0, 4, 1063, 1071, 1062, 1065, 1076, 1080, 0.004, 50, 0, XT),
    "hesai-xt32m2x": Facts(32, 6, 12, 130, 0, 4, 803, 811, 802, 805, 816, 820, 0.005, 50, 0, (0.0305, 0.013)),
    "hesai-ot128": Facts(128, 2, 12, 386, 0, 3, 818, 826, 817, 820, 831, 861, 0.004, 55.556, 0, LONG),
    "hesai-pandar128": Facts(
        128, 2, 12, 386, 0, 3, 818, 826, 817, 820, 831, 861, 0.004, 55.556, 3.148, (0.04356, 0.012)
    ),
}
MODELS = list(FACTS)


SDK: dict[str, tuple[int, list[tuple[int, int, tuple[float, float, float], int]]]] = {
    "hesai-pandar40p": (
        0xA507832E,
        [
            (0, 5457641, (-20.552670, 16.190403, 7.000116), 26),
            (0, 12791161, (0.356717, 20.001820, 5.349887), 97),
            (0, 20125281, (21.123705, 15.437956, 7.000116), 26),
        ],
    ),
    "hesai-pandar64": (
        0x537A384A,
        [
            (51, 5256289, (-29.999199, 19.207716, -3.530625), 84),
            (0, 12699441, (0.125247, 20.000746, 5.348841), 97),
            (12, 20071289, (29.137751, 19.998163, 0.513429), 57),
        ],
    ),
    "hesai-qt64": (
        0x9AD030D4,
        [
            (38, 5580630, (-19.501272, 19.997465, 4.647325), 71),
            (0, 13000350, (0.825401, 3.829827, -4.999905), 79),
            (25, 20386560, (23.621918, 18.569273, -4.999882), 16),
        ],
    ),
    "hesai-xt32": (
        0x8C37CDA8,
        [
            (6, 5359072, (-25.087072, 20.001892, 5.076739), 62),
            (0, 12800000, (0.742389, 19.998457, 5.353810), 97),
            (25, 20237800, (23.447464, 16.001289, -4.999816), 17),
        ],
    ),
    "hesai-xt32m2x": (
        0x23B1B279,
        [
            (19, 5258664, (-25.608643, 20.001789, -2.973691), 61),
            (0, 12750000, (0.672988, 19.861553, 7.000762), 33),
            (12, 20234656, (29.456972, 19.998249, 2.403289), 56),
        ],
    ),
    "hesai-ot128": (
        0x485C805C,
        [
            (76, 5076520, (-25.733007, 20.000385, -2.562030), 61),
            (0, 12602089, (0.311656, 20.000507, 5.342117), 97),
            (51, 20004415, (26.059374, 20.001678, -0.788553), 61),
        ],
    ),
    "hesai-pandar128": (
        0xBFC2D5DA,
        [
            (76, 5074669, (-23.951254, 19.997824, -2.421634), 64),
            (0, 12559028, (1.275016, 20.000748, 5.148132), 97),
            (51, 20019113, (29.999737, 17.548872, -0.767235), 86),
        ],
    ),
}
"""What HesaiLidar_SDK_2.0 (ea7f86fa, with distance_correction_flag) decodes of packets of the room in the test below.

By model: CRC-32 of the tenth packet; ring, time since START in ns, position in our axes, and reflectivity of points.
"""


class Decoded(NamedTuple):
    """Arrays of shape (columns, returns, channels)."""

    time: Any
    """ns since START."""
    range: Any
    """From Hesai's zero, m; 0 without a return."""
    reflectivity: Any
    xyz: Any
    head: Any
    """Azimuths of the blocks, shape (columns, returns), 0.01 degrees."""
    state: Any
    """Of the blocks, likewise."""
    sequence: list[int]


def decode(model: str, packets: list[writing.Packet], files: dict[str, bytes]) -> Decoded:
    """Decode packets as the manuals say."""
    facts = FACTS[model]
    ends, heads, units, states, sequence, returns, speed = [], [], [], [], [], 1, 0
    for _, _, data in packets:
        assert len(data) == facts.size
        returns = 2 if data[facts.mode] == 0x39 else 1
        (speed,) = struct.unpack_from("<H", data, facts.speed)
        (microseconds,) = struct.unpack_from("<I", data, facts.microseconds)
        year, *rest = data[facts.date : facts.date + 6]
        moment = datetime(year + facts.year, *rest, tzinfo=UTC)
        stamp = 1_000_000 * (round(moment.timestamp()) - START) + microseconds
        sequence += struct.unpack_from("<I", data, facts.sequence)
        count = facts.blocks // returns
        turns = struct.unpack_from("<H", data, STATES)[0] if model in IN_TURN else 0
        for number in range(facts.blocks):
            states.append(turns << 2 * number >> 14 & 3)  # `getAngleState` in the SDK's udp_protocol_v1_4.h
            column, at = number // returns, facts.first + facts.block * number
            ends.append(stamp + facts.offset + facts.period * (column if facts.from_first else column - count + 1))
            heads += struct.unpack_from("<H", data, at + facts.azimuth)
            units.append(data[at + facts.azimuth + 2 : at + facts.block])
    angles = columns(files[".angles.csv"], 1)
    elevation, azimuth = np.radians(angles[:, 1]), np.radians(angles[:, 2])
    place = FIRETIMES[model]
    listed = columns(files[".firetimes.csv"], place.skip) / place.per_us
    firetime = np.stack([listed[:, place.column + place.width * state] for state in states])
    raw = np.frombuffer(b"".join(units), np.uint8).reshape(-1, facts.channels, facts.unit)
    distance = facts.step * (raw[..., 0] + 256.0 * raw[..., 1])
    # 1 rpm is 6e-6 degrees a microsecond; azimuths grow clockwise from the x axis
    turned = -np.radians(np.array(heads)[:, None] / 100 + firetime * speed * 6e-6)
    along, up = turned - azimuth, np.broadcast_to(elevation, turned.shape)
    direction = np.stack([np.cos(up) * np.cos(along), np.cos(up) * np.sin(along), np.sin(up)], axis=-1)
    x, y = facts.center
    center = np.stack(
        [np.cos(turned) * x - np.sin(turned) * y, np.sin(turned) * x + np.cos(turned) * y, 0 * up], axis=-1
    )
    inner = (center * direction).sum(axis=-1)
    r = np.sqrt(np.maximum(inner**2 - x**2 - y**2 + distance**2, 0)) - inner  # |center + r direction| = distance
    time = 1e3 * (np.array(ends)[:, None] + firetime)
    grids = [time, distance, raw[..., 2], center + r[..., None] * direction, np.array(heads), np.array(states)]
    return Decoded(*(grid.reshape(-1, returns, *grid.shape[1:]) for grid in grids), sequence)


class Firetimes(NamedTuple):
    """Where a firetime correction file has the times."""

    skip: int = 1
    column: int = 1
    per_us: float = 1.0
    width: int = 1
    """Columns of a state: of far and near, or one of both."""


FIRETIMES = dict.fromkeys(MODELS, Firetimes()) | {
    "hesai-ot128": Firetimes(2, 5),
    "hesai-pandar128": Firetimes(3, 9, 1e3, width=2),
}
IN_TURN = {"hesai-ot128": "OT128", "hesai-pandar128": "Pandar128E3X"}
"""Models whose columns are in two states in turn, and the names in their files."""
STATES = 814
"""Offset of the states of the blocks in their packets."""


def columns(content: bytes, skip: int) -> Any:
    """Return the numbers of a correction file by channel; absent ones are nan."""
    lines = content.decode().replace("-,", "nan,").splitlines()
    table = np.loadtxt(lines, delimiter=",", skiprows=skip)
    return table[np.argsort(table[:, 0])]


def sensor(model: str, *, returns: Any = "strongest", rate: float = 20.0, **changes: Any) -> ls.Lidar:
    """Return a sensor of which a frame has half as many columns as at 10 Hz."""
    lidar = ls.Lidar.preset(model)
    pattern = dataclasses.replace(lidar.pattern, rate=rate, **changes)  # type: ignore[type-var]
    beam = ls.Beam(0.004, rays=7) if returns == "dual" else None
    return dataclasses.replace(lidar, pattern=pattern, measurement=ls.Measurement(beam=beam, returns=returns))


def street() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.8), material=ls.Material(reflectivity=0.2))
    scene.add(ls.Box((4, 60, 10), (20, 0, 0)), material=ls.Material(reflectivity=0.7))
    for place in range(8):
        scene.add(ls.Cylinder((8, place - 3.5, -2), (8, place - 3.5, 4), 0.1), material=ls.Material(reflectivity=1.3))
    return scene


def encode(
    lidar: ls.Lidar, scans: list[ls.Scan], variant: str | None = None
) -> tuple[list[writing.Packet], dict[str, bytes]]:
    """Return all packets and the files beside them."""
    encoder = writing.format_of(lidar, variant).encoder(lidar, start=START * 10**9, port=2368, variant=variant)
    packets = [packet for scan in scans for packet in encoder.packets(scan)]
    return [*packets, *encoder.rest()], dict(encoder.companions())


def in_columns(scans: list[ls.Scan], of: Any) -> Any:
    """Return values of the pulses of all scans in shape (columns, channels, ...), with channels in order."""
    parts = []
    for scan in scans:
        order = np.lexsort([scan.pulses.ring, scan.pulses.column])
        parts.append(np.asarray(of(scan))[order])
    values = np.concatenate(parts)
    return values.reshape(-1, scans[0].pulses.ring.max() + 1, *values.shape[1:])


def reported_order(scans: list[ls.Scan]) -> Any:
    """Return ranges from the beams' origins in the order of the blocks, shape (columns, returns, channels), 0 for none.

    The last return, then the strongest or second strongest, which is nearer; a single return is in both blocks.
    """
    ranges = np.nan_to_num(in_columns(scans, lambda scan: scan.range))
    if ranges.shape[-1] == 2:
        two = ranges[..., 1] > 0
        farther, nearer = ranges.max(axis=-1), ranges.min(axis=-1)
        ranges = np.stack([np.where(two, values, ranges[..., 0]) for values in (farther, nearer)], axis=-1)
    return ranges.transpose(0, 2, 1)


def in_turn(model: str, *, returns: str = "strongest") -> ls.Lidar:
    """Return a sensor from Hesai's own files, whose columns are in two states in turn."""
    angles, times = (DATA / f"{IN_TURN[model]}_{kind}_Correction_File.csv" for kind in ("Angle", "Firetime"))
    lidar = ls.Lidar.from_file(angles, firing_times=times, rate=20.0)
    pattern = lidar.pattern
    assert isinstance(pattern, ls.patterns.Table)
    beam = ls.Beam(0.004, rays=7) if returns == "dual" else None
    return dataclasses.replace(lidar, measurement=ls.Measurement(beam=beam, returns=returns))


SENSORS = [*((model, sensor) for model in MODELS), *((model, in_turn) for model in IN_TURN)]


@pytest.mark.slow("packets hold each pulse of a moving sensor")
@pytest.mark.parametrize("returns", ["strongest", "dual"])
@pytest.mark.parametrize(("model", "make"), SENSORS)
def test_every_pulse_of_a_moving_sensor_is_decoded_within_the_steps_of_the_packets(
    model: str, make: Any, returns: str
) -> None:
    facts = FACTS[model]
    lidar = dataclasses.replace(make(model, returns=returns), max_range=30.0)  # the ground goes on beyond
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(3, 0.5, 0), angular=(0, 0, 0.2))
    scans = list(lidar.frames(street(), drive, 3))
    packets, files = encode(lidar, scans)
    decoded = decode(model, packets, files)

    count, size = sum(len(scan) for scan in scans) // facts.channels, facts.blocks // decoded.time.shape[1]
    assert len(packets) == -(-count // size)
    assert decoded.sequence == [*range(1, len(packets) + 1)]
    assert not decoded.range[count:].any()

    time = in_columns(scans, lambda scan: (scan.time + scan.pulses.time) * 1e9)
    # A time stamp is rounded to 1 us, and the columns of a packet may drift from the decoder's by as much, as 55.56 us
    # do from 1/18000 s. Files of times have ns.
    assert np.abs(decoded.time[:count] - time[:, None]).max() <= 500 + 500 + 1
    whole = count // size
    sent = time[: whole * size].reshape(whole, -1).max(axis=1)
    assert np.abs([packet.time - START * 10**9 for packet in packets[:whole]] - sent).max() <= 2  # two roundings

    found = reported_order(scans)
    hit = found > 0
    assert hit.any()
    assert not hit.all()
    assert np.array_equal(decoded.range[:count] > 0, hit)
    origin, along = (
        in_columns(scans, lambda scan, of=of: getattr(scan.pulses, of)) for of in ("origins", "directions")
    )
    true = origin[:, None] + found[..., None] * along[:, None]
    apart = np.linalg.norm(decoded.xyz[:count] - true, axis=-1)[hit]
    # Half a step; presets round the zero of ranges to 10 um, and count it to first order (lidarsim.io.vendors.hesai).
    zero = 1e-5 + np.hypot(*facts.center) ** 2 / 2 / found[hit]
    # The head is rounded to 0.01 degrees, three angles to 1e-6 degrees or ns.
    angle = np.radians(0.005 + 3 * 1e-6 / 2 + 1e-9 / 2 * 360 * lidar.pattern.rate)
    assert (apart <= facts.step / 2 + zero + angle * (found[hit] + np.hypot(*facts.center))).all()

    shown = in_columns(scans, lambda scan: np.rint(np.clip(np.nan_to_num(scan.intensity), 0, 2.55) * 100))
    assert {*np.unique(decoded.reflectivity[:count][hit])} <= {*np.unique(shown)}
    if returns == "strongest":
        assert np.array_equal(decoded.reflectivity[:count, 0], np.where(hit[:, 0], shown[..., 0], 0))


@pytest.mark.parametrize("returns", ["strongest", "dual"])
@pytest.mark.parametrize("model", IN_TURN)
def test_columns_are_in_their_states_in_turn_with_hesais_own_firetimes(model: str, returns: str) -> None:
    lidar = in_turn(model, returns=returns)
    packets, files = encode(lidar, [lidar.scan(street())])
    assert decode(model, packets, files).state.tolist() == [[k % 2] * (1 + (returns == "dual")) for k in range(900)]
    place = FIRETIMES[model]
    path = DATA / f"{IN_TURN[model]}_Firetime_Correction_File.csv"
    theirs = columns(path.read_text(encoding="utf-8-sig").encode(), place.skip)
    ours = columns(files[".firetimes.csv"], place.skip)
    shown = [place.column, place.column + place.width]
    assert (theirs[:, shown[0]] != theirs[:, shown[1]]).any()
    assert ours[:, shown] == pytest.approx(theirs[:, shown], rel=0, abs=5e-7)  # 6 decimals


def test_states_in_turn_are_recognised_within_the_steps_of_packets() -> None:
    """Half a step of azimuths is 0.005 degrees, and a stamp is right to 0.5 us."""
    lidar = in_turn("hesai-ot128")
    table: ls.patterns.Table = lidar.pattern  # type: ignore[assignment]
    refused = "pattern: expected 128 channels that spin clockwise or the firetimes of 2 states in turn for packets of"

    def check(fits: bool, **changes: Any) -> None:
        other = dataclasses.replace(lidar, pattern=dataclasses.replace(table, **changes), range_offset=0.0)
        if fits:
            assert writing.encoders({"": other})
        else:
            with pytest.raises(FileFormatError, match=f"^{refused} hesai-ot128, got Table of "):
                writing.encoders({"": other})

    check(
        True,
        directions=table.directions[::-1],
        **{  # another order
            name: getattr(table, name)[::-1] for name in ("times", "rings", "columns", "origins")
        },
    )
    for place in (7, 64_000):
        azimuth, up = np.arctan2(*table.directions[place, 1::-1]), np.arcsin(table.directions[place, 2])
        for degrees, fits in ((0.0045, True), (-0.0045, True), (0.0055, False), (-0.0055, False)):
            for along, across in ((degrees, 0.0), (0.0, degrees)):
                a, e = azimuth + np.radians(along), up + np.radians(across)
                directions = table.directions.copy()
                directions[place] = np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)
                check(fits, directions=directions)
        for late, fits in ((0.45e-6, True), (0.55e-6, False)):
            times = table.times.copy()
            times[place] += late
            check(fits, times=times)
    rings = table.rings.copy()
    rings[5] = 6
    check(False, rings=rings)
    check(False, columns=None)
    check(False, **{name: getattr(table, name)[:-1] for name in ("directions", "times", "rings", "columns", "origins")})
    with pytest.raises(
        FileFormatError, match="pattern: expected 32 channels that spin clockwise for packets of hesai-xt"
    ):
        writing.encoders({"": dataclasses.replace(lidar, model="hesai-xt32")})


def test_of_dual_returns_the_last_comes_first_and_a_single_one_twice() -> None:
    lidar = sensor("hesai-xt32", returns="dual")
    scans = [lidar.scan(street())]
    packets, files = encode(lidar, scans)
    far, near = decode("hesai-xt32", packets, files).range.transpose(1, 0, 2)
    ranges = in_columns(scans, lambda scan: scan.range)
    two = ~np.isnan(ranges[..., 1])
    one = ~np.isnan(ranges[..., 0]) & ~two
    last_is_strongest = ranges[..., 0] > ranges[..., 1]
    assert (two & last_is_strongest).any()
    assert (two & ~last_is_strongest).any()
    assert one.any()
    assert (far[two] > near[two]).all()
    assert np.array_equal(far[one], near[one])
    offset = np.asarray(lidar.range_offset)
    strongest = ranges[..., 0] + offset
    half = FACTS["hesai-xt32"].step / 2 * (1 + 2.0**-50)  # as a step times a whole number is rounded
    assert (np.abs(np.where(last_is_strongest, far, near) - strongest)[two] <= half).all()


@pytest.mark.parametrize("model", MODELS)
def test_all_packets_of_an_empty_scene_are_sent_with_distances_of_zero(model: str) -> None:
    lidar = sensor(model)
    packets, files = encode(lidar, [lidar.scan(ls.Scene())])
    decoded = decode(model, packets, files)
    assert len(decoded.time) >= lidar.pattern.shape[1]
    assert not decoded.range.any()
    assert not decoded.reflectivity.any()
    assert len(np.unique(decoded.head)) > 0.9 * len(decoded.time)


def test_columns_that_fill_no_packet_wait_for_the_next_scan_and_the_last_packet_is_filled() -> None:
    lidar = sensor("hesai-pandar40p")  # 899.93 columns a turn, 10 in a packet
    scene = street()
    scans = list(lidar.frames(scene, None, 40))
    encoder = writing.format_of(lidar).encoder(lidar, start=START * 10**9, port=2368, variant=None)
    counts = [len(list(encoder.packets(scan))) for scan in scans]
    assert sum(counts) == sum(len(scan) for scan in scans) // 400
    assert set(counts) == {89, 90}
    (last,) = encoder.rest()
    assert not list(encoder.rest())
    decoded = decode("hesai-pandar40p", [last], dict(encoder.companions()))
    waiting = sum(len(scan) for scan in scans) // 40 % 10
    assert 0 < waiting < 10
    assert decoded.range[:waiting].any()
    assert not decoded.range[waiting:].any()
    # 0.01 degrees are 7200 in 50 ms; both ends are rounded
    steps = np.diff(decoded.head[:, 0].astype(int)) % 36000
    assert np.abs(steps - 36000 * 20 * 55.56e-6).max() <= 1


def test_a_packet_ends_before_a_gap_between_scans_or_in_the_field_of_view() -> None:
    lidar = sensor("hesai-xt32", field_of_view=np.radians(101.0))
    scans = list(lidar.frames(street(), None, 3))
    packets, files = encode(lidar, scans)
    columns_ = len(scans[0]) // 32
    assert columns_ % 8
    assert len(packets) == 3 * -(-columns_ // 8)
    decoded = decode("hesai-xt32", packets, files)
    time = in_columns(scans, lambda scan: (scan.time + scan.pulses.time) * 1e9).reshape(3, columns_, 32)
    written = decoded.time[:, 0].reshape(3, -1, 32)[:, :columns_]
    assert np.abs(written - time).max() <= 501  # of the stamp, and of times in ns
    assert not decoded.range.reshape(3, -1, 32)[:, columns_:].any()


def test_times_are_those_of_utc() -> None:
    lidar = sensor("hesai-ot128")
    moment = datetime(2028, 2, 29, 23, 59, 59, tzinfo=UTC)
    encoder = writing.format_of(lidar).encoder(
        lidar, start=round(moment.timestamp()) * 10**9 + 975_000_000, port=2368, variant=None
    )
    packets = list(encoder.packets(lidar.scan(ls.Scene())))
    facts = FACTS["hesai-ot128"]
    dates = [(tuple(packet.payload[facts.date : facts.date + 6])) for packet in packets]
    assert dates[0] == (128, 2, 29, 23, 59, 59)
    assert dates[-1] == (128, 3, 1, 0, 0, 0)
    stamps = [struct.unpack_from("<I", packet.payload, facts.microseconds)[0] for packet in packets]
    assert stamps[0] == 975_000 + round(1e6 * lidar.pattern.column_period)
    assert stamps[-1] < 25_000
    assert max(stamps) < 1_000_000


REAL = {
    "hesai-pandar40p": "ffee",
    "hesai-pandar64": "eeff400600040000",
    "hesai-qt64": "eeff03010000400401040201",
    "hesai-xt32": "eeff06010000200801040201",
}
"""First bytes of packets that real sensors sent, with dual returns; a Pandar40P with mark of the first block."""


@pytest.mark.parametrize("model", REAL)
def test_packets_begin_as_those_of_real_sensors(model: str) -> None:
    lidar = sensor(model, returns="dual")
    packets, _ = encode(lidar, [lidar.scan(ls.Scene())])
    assert {packet.payload[: len(REAL[model]) // 2].hex() for packet in packets} == {REAL[model]}
    assert {packet.payload[FACTS[model].mode] for packet in packets} == {0x39}
    assert {packet.port for packet in packets} == {2368}


def test_packets_of_new_models_begin_as_the_manuals_say() -> None:
    for model, returns, head in (
        ("hesai-ot128", "strongest", "eeff0104800080020004 0107"),
        ("hesai-ot128", "dual", "eeff0104800080020104 0207"),
        ("hesai-pandar128", "last", "eeff0104000080020004 0107"),
        ("hesai-xt32m2x", "first", "eeff0601000020060005 0101"),
    ):
        lidar = sensor(model, returns=returns)
        packets, _ = encode(lidar, [lidar.scan(ls.Scene())])
        assert packets[0].payload[:12] == bytes.fromhex(head)
        assert (
            packets[0].payload[FACTS[model].mode]
            == {"strongest": 0x37, "last": 0x38, "first": 0x33, "dual": 0x39}[returns]
        )


def test_a_plain_packet_has_no_sequence_number_as_a_real_pandar40p_sent_it() -> None:
    lidar = sensor("hesai-pandar40p")
    scan = lidar.scan(street())
    plain, numbered = ([packet.payload for packet in encode(lidar, [scan], variant)[0]] for variant in ("plain", None))
    assert {len(payload) for payload in plain} == {1262}
    assert plain == [payload[:-4] for payload in numbered]


def test_checksums_are_those_that_real_sensors_send() -> None:
    message = bytes.fromhex("0105000000000000000000000000".ljust(26, "0")[:26])
    real = 0x11B13B3F  # functional safety of a QT128: from the state of the sensor to the reserved bytes
    rows = np.frombuffer(message[1:], np.uint8)[None]
    assert crc32_mpeg2(rows).tolist() == [real]
    assert crc32_mpeg2(np.frombuffer(b"123456789", np.uint8)[None]).tolist() == [0x0376E6E7]  # its check value


@pytest.mark.parametrize(("model", "covered"), [("hesai-ot128", 12), ("hesai-pandar128", 4)])
def test_checksums_cover_body_functional_safety_and_tail(model: str, covered: int) -> None:
    lidar = sensor(model)
    packets, _ = encode(lidar, [lidar.scan(street())])
    counters = []
    for packet in packets:
        for start, end, place in ((12, 784, 784), (789, 789 + covered, 801), (805, 857, 857)):
            row = np.frombuffer(packet.payload[start:end], np.uint8)[None]
            assert crc32_mpeg2(row)[0] == struct.unpack_from("<I", packet.payload, place)[0]
        assert packet.payload[789] >> 5 == 1  # normal
        counters.append(packet.payload[789] & 7)
    assert sum(a != b for a, b in itertools.pairwise(counters)) == 9  # ten messages in 50 ms


FILES = {
    "hesai-pandar40p": ("Pandar40P", ["Firetime"]),  # the preset has the angles of the design
    "hesai-qt64": ("PandarQT", ["Angle", "Firetime"]),
    "hesai-ot128": ("OT128", ["Angle", "Firetime"]),
    "hesai-pandar128": ("Pandar128E3X", ["Angle", "Firetime"]),
}


@pytest.mark.parametrize("model", FILES)
def test_correction_files_are_hesais_own(model: str) -> None:
    name, kinds = FILES[model]
    place = FIRETIMES[model]
    _, files = encode(ls.Lidar.preset(model), [])
    for kind in kinds:
        path = DATA / f"{name}_{kind}_Correction_File.csv"
        skip, shown = (1, [0, 1, 2]) if kind == "Angle" else (place.skip, [0, place.column])
        theirs = columns(path.read_text(encoding="utf-8-sig").encode(), skip)
        ours = columns(files[f".{kind.lower()}s.csv"], skip)
        assert ours[:, shown] == pytest.approx(theirs[:, shown], rel=0, abs=5e-7)  # 6 decimals


def test_correction_files_can_be_read_again(tmp_path: Path) -> None:
    lidar = ls.Lidar.preset("hesai-xt32")
    with writing.Writer(tmp_path / "drive.pcap", lidar) as writer:
        writer.write(lidar.scan(ls.Scene()))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.angles.csv", "drive.firetimes.csv", "drive.pcap"]
    again = ls.Lidar.from_file(tmp_path / "drive.angles.csv", firing_times=tmp_path / "drive.firetimes.csv")
    assert again.model == "hesai-xt32"
    for name in ("elevations", "azimuth_offsets"):
        assert getattr(again.pattern, name) == pytest.approx(getattr(lidar.pattern, name), rel=0, abs=np.radians(5e-7))
    # Half a step of 1e-6 µs, and roundings of numbers below 1 ms.
    near = 0.5e-12 + 4 * np.spacing(1e-3)
    assert again.pattern.firing_times == pytest.approx(lidar.pattern.firing_times, rel=0, abs=near)


@pytest.mark.parametrize("model", SDK)
def test_hesais_sdk_decodes_the_same_points(model: str) -> None:
    lidar = sensor(model)
    scene = ls.Scene()
    scene.add(ls.Box((60, 40, 12), (0, 0, 1)))
    packets, files = encode(lidar, [lidar.scan(scene)])
    assert zlib.crc32(packets[9].payload) == SDK[model][0]  # the bytes are those that the SDK decoded
    decoded = decode(model, packets, files)
    for ring, time, xyz, brightness in SDK[model][1]:
        column = np.abs(decoded.time[:, 0, ring] - time).argmin()
        # The SDK cuts each firetime, read as float32, to ns.
        # The SDK cuts firetimes, read as float32, to ns, and takes multiples of 166.667 us to 10 ns.
        assert decoded.time[column, 0, ring] == pytest.approx(time, rel=0, abs=1.5 + 5.0)
        assert decoded.reflectivity[column, 0, ring] == brightness
        # It cuts four angles to 1/25600 degrees: of the firetime and the channel, and both from the optical centre.
        distance = decoded.range[column, 0, ring]
        apart = np.linalg.norm(decoded.xyz[column, 0, ring] - xyz)
        assert apart <= distance * (4 * np.radians(1 / 25600) + 8 * 2.0**-24)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pattern": ls.patterns.Grid([0.0], [0.0], rate=10.0)}, "pattern: expected 32 channels that spin clockwise"),
        ({"clockwise": False}, "pattern: expected 32 channels that spin clockwise for packets of hesai-xt32, got Spin"),
        ({"elevations": [0.0]}, "pattern: expected 32 channels"),
        (
            {"rate": 2000.0, "columns": 10},
            "pattern: expected a rate of at most 1092 Hz for packets of hesai-xt32, got 2000",
        ),
        ({"columns": 1024}, "column_period of 50 us for packets of hesai-xt32, got 97.6562 us"),
        ({"returns": 2}, "returns: expected one of 'strongest', 'last', 'first', 1, 'dual' for packets of hesai-xt32"),
    ],
)
def test_refuses_a_sensor_that_does_not_fit(changes: dict[str, Any], message: str) -> None:
    lidar = ls.Lidar.preset("hesai-xt32")
    if "returns" in changes:
        lidar = dataclasses.replace(lidar, measurement=ls.Measurement(beam=ls.Beam(0.004), **changes))
    elif "pattern" in changes:
        lidar = dataclasses.replace(lidar, **changes, range_offset=0.0)
    else:
        kept = {"elevations": lidar.pattern.elevations, "columns": 2000, "clockwise": True} | changes
        lidar = dataclasses.replace(lidar, pattern=ls.patterns.Spinning(**kept), range_offset=0.0)
    with pytest.raises(FileFormatError, match=message):
        writing.encoders({"": lidar})


def test_a_pandar40p_has_no_first_returns() -> None:
    with pytest.raises(
        FileFormatError, match=r"returns: expected one of 'strongest', 'last', 'dual' for .* got 'first'"
    ):
        writing.encoders({"": sensor("hesai-pandar40p", returns="first")})


@pytest.mark.parametrize(("at", "low", "high"), [(262.2, 0.004, 262.14), (0.0, 0.004, 262.14)])
def test_refuses_a_range_that_does_not_fit(at: float, low: float, high: float) -> None:
    lidar = dataclasses.replace(sensor("hesai-ot128"), min_range=0.0, max_range=np.inf)
    scene = ls.Scene()
    if at:
        scene.add(ls.Sphere((0, 0, 0), at))
    else:  # from 9.9545 m to 9.9592 m, as the optical centre is 45 mm ahead
        lidar = dataclasses.replace(lidar, range_offset=-9.955)
        scene.add(ls.Sphere((0, 0, 0), 10.0))
    with pytest.raises(
        FileFormatError, match=f"range: expected {low} to {high} m for packets of hesai-ot128, got range"
    ):
        encode(lidar, [lidar.scan(scene)])


def test_refuses_years_that_do_not_fit() -> None:
    for model, year, message in (
        ("hesai-pandar40p", 1999, "time: expected the years 2000 to 2069, got 1999-06-01"),
        ("hesai-pandar40p", 2070, "time: expected the years 2000 to 2069, got 2070-06-01"),
        ("hesai-xt32", 1969, "time: expected a scan from 1970 to 2106-02-07, got one at -"),
        ("hesai-xt32", 2107, "time: expected a scan from 1970 to 2106-02-07, got one at 4.3"),
    ):
        lidar = sensor(model)
        start = round(datetime(year, 6, 1, tzinfo=UTC).timestamp()) * 10**9
        encoder = writing.format_of(lidar).encoder(lidar, start=start, port=2368, variant=None)
        with pytest.raises(FileFormatError, match=message):
            list(encoder.packets(lidar.scan(ls.Scene())))


def test_refuses_a_scan_of_another_sensor() -> None:
    with pytest.raises(FileFormatError, match="scan: expected one of the sensor that the packets are of"):
        encode(sensor("hesai-xt32"), [sensor("hesai-xt32m2x").scan(ls.Scene())])


def test_all_layouts_are_tested() -> None:
    assert FACTS.keys() == LAYOUTS.keys()
    assert {model for model in writing.names() if model.startswith("hesai")} == LAYOUTS.keys()
