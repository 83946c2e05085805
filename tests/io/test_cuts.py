"""Messages of bags that begin where the drivers of spinning sensors begin them, as rosbags reads them."""

from __future__ import annotations

from math import pi, radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import lidarsim as ls
from lidarsim.io import _cuts, rosbag
from lidarsim.patterns import Grid, Spinning

ROS = get_typestore(Stores.ROS2_HUMBLE)
TURN = 2 * pi
FRAMES = 3
START = 100.0
"""So soon after 1970 that the absolute times of the hesai layout, float64 in s, are good to a nanosecond."""
DRIVE = ls.Trajectory.from_twist(np.eye(4), linear=(10, 0, 0), angular=(0, 0, 0.3))
SPUN = ls.Lidar(
    Spinning(
        [-0.1, 0.1],
        columns=100.3,
        rate=7.0,
        clockwise=False,
        start_azimuth=1.0,
        firing_times=[0, 1e-3],
        azimuth_offsets=0.2,
    ),
    model="ouster-like",
)
LIDARS = {name: ls.Lidar.preset(name) for name in ("velodyne-vlp16", "ouster-os1-128", "hesai-pandar40p")} | {
    "spun": SPUN
}


class Cloud(NamedTuple):
    """A message: its stamp and the time of its recording, and times of points since the stamp, all in ns."""

    stamp: int
    recorded: int
    time: np.ndarray
    ring: np.ndarray
    xyz: np.ndarray


def clouds(path: Path, topic: str = "/lidar/points") -> list[Cloud]:
    """Read the messages of a topic, by the definition of sensor_msgs/PointField and the layouts of the drivers."""
    found = []
    codes = {2: "u1", 4: "u2", 6: "u4", 7: "f4", 8: "f8"}
    with Reader(path) as bag:
        for _, recorded, data in bag.messages([link for link in bag.connections if link.topic == topic]):
            message: Any = ROS.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")
            dtype = np.dtype(
                {
                    "names": [field.name for field in message.fields],
                    "formats": [f"<{codes[field.datatype]}" for field in message.fields],
                    "offsets": [field.offset for field in message.fields],
                    "itemsize": message.point_step,
                }
            )
            assert dtype in rosbag.LAYOUTS.values()
            points = np.frombuffer(bytes(message.data), dtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            names = dtype.names or ()
            if "time" in names:
                time = 1e9 * points["time"].astype(float)
            elif "timestamp" in names:
                time = np.rint(1e9 * points["timestamp"]) - stamp
            else:
                time = points["t" if "t" in names else "time_stamp"].astype(float)
            ring = points["ring" if "ring" in names else "channel"]
            found.append(Cloud(stamp, recorded, time, ring, np.stack([points[axis] for axis in "xyz"], 1)))
    return found


def ball() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 50.0), material=ls.Material(reflectivity=0.9))
    return scene


def write(path: Path, lidar: ls.Lidar, frames: Any = range(FRAMES), **more: Any) -> Path:
    """Write frames of a moving sensor."""
    scene = ball()
    with rosbag.Writer(path, trajectory=DRIVE, start=START, **more) as bag:
        for frame in frames:
            bag.write(lidar.scan(scene, DRIVE, time=frame / lidar.pattern.rate, frame=frame))
    return path


def tolerance(layout: str | None, lidar: ls.Lidar) -> float:
    """Return how far a point's time may be from the other bag's, ns: float32 below 0.25 s is good to 2**-27 s."""
    times = (layout or rosbag.layout_of(lidar)) == "velodyne"
    return 2 * 2.0**-27 * 1e9 if times else 0.0


def expect_the_same_points(got: list[Cloud], wanted: list[Cloud], within: float) -> None:
    """Check that all points are there once, in order, at the same absolute times."""
    for name in ("ring", "xyz"):
        np.testing.assert_array_equal(*(np.concatenate([getattr(part, name) for part in of]) for of in (got, wanted)))
    first = wanted[0].stamp
    times = [np.concatenate([part.stamp - first + part.time for part in of]) for of in (got, wanted)]
    np.testing.assert_allclose(*times, rtol=0, atol=within)


CASES = [
    ("velodyne-vlp16", None, "driver", 0.0),
    ("velodyne-vlp16", "autoware", "driver", 0.0),
    ("velodyne-vlp16", "ouster", "driver", None),
    ("velodyne-vlp16", "livox", "driver", None),
    ("velodyne-vlp16", None, radians(-100), radians(-100)),
    ("velodyne-vlp16", None, "pattern", None),
    ("velodyne-vlp16", None, TURN / 2, None),
    ("velodyne-vlp16", None, -TURN / 2, None),
    ("hesai-pandar40p", None, "driver", 0.0),
    ("hesai-pandar40p", None, 6, 6.0),
    ("ouster-os1-128", None, "driver", None),
    ("ouster-os1-128", None, 0.25, 0.25),
    ("ouster-os1-128", "autoware", "driver", 0.0),
    ("spun", None, "driver", pi),
    ("spun", "velodyne", "driver", 0.0),
    ("spun", None, 1.0, None),
]


@pytest.mark.slow("messages of bags are one turn from the cut of each driver")
@pytest.mark.parametrize(("name", "layout", "cut", "azimuth"), CASES)
def test_a_message_is_one_turn_from_the_cut(
    name: str, layout: str | None, cut: Any, azimuth: float | None, tmp_path: Path
) -> None:
    lidar = LIDARS[name]
    pattern: Any = lidar.pattern
    period = 1e9 / pattern.rate
    if azimuth is None:  # as the pattern has it
        write(tmp_path / "a.mcap", lidar, layout=layout)
        write(tmp_path / "b.mcap", lidar, layout=layout, cut=cut)
        assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
        return
    whole = clouds(write(tmp_path / "a.mcap", lidar, layout=layout))
    parts = clouds(write(tmp_path / "b.mcap", lidar, layout=layout, cut=cut))
    assert [len(whole), len(parts)] == [FRAMES, FRAMES + 1]
    within = tolerance(layout, lidar)
    expect_the_same_points(parts, whole, within)

    turns = -1 if pattern.clockwise else 1
    column = TURN / pattern.columns_per_turn
    ahead = turns * (azimuth - pattern.start_azimuth) % TURN / TURN * period
    for number, part in enumerate(parts):
        begins = round(START * 1e9) + (ahead + (number - 1) * period if number else 0)
        assert begins - 2 < part.stamp <= begins + 1
        assert part.time.min() >= 0
        assert part.time.max() < period
        assert (np.diff(part.time) >= 0).all()
        assert abs(part.recorded - part.stamp - part.time.max()) <= within
        # The head turns steadily from the cut on. Beams that leave up to 4 cm off the axis are seen at 45 m or more.
        head = np.arctan2(part.xyz[:, 1], part.xyz[:, 0]) - pattern.azimuth_offsets[part.ring]
        turned = turns * (head - (azimuth if number else pattern.start_azimuth))
        off = (turned - TURN * part.time / period + pi) % TURN - pi
        assert np.abs(off).max() < 0.04 / 45 + 1e-5
        # The first cycle begins less than a cycle after the cut, and all of a turn is there.
        assert TURN * part.time.min() / period < column
        if 0 < number < FRAMES:
            assert TURN - TURN * part.time.max() / period <= column


@pytest.mark.parametrize("rate", [3.0, 7.0, 10.0, 20.0])
@pytest.mark.parametrize("clockwise", [True, False])
def test_a_pulse_at_the_cut_begins_the_message(rate: float, clockwise: bool) -> None:
    lidar = ls.Lidar(Spinning([0.0], columns=360, rate=rate, clockwise=clockwise))
    time = lidar.pattern.pulses().time
    cloud = ls.PointCloud(xyz=np.ones((360, 3)), time=time)
    for degrees in range(-179, 180):
        cut = _cuts.time_of(radians(degrees), "velodyne", lidar)
        assert cut is not None
        before, since = _cuts.divide(cloud, cut, 0)
        first = 180 - degrees if clockwise else 180 + degrees
        assert [len(before), len(since)] == [first, 360 - first]
        assert 0 <= since.time[0] < 1.5e-9
        np.testing.assert_allclose(since.time, time[first:] - cut / 1e9, rtol=0, atol=0.5e-9 + 2 * np.spacing(0.4))


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("start", [pi, -pi, 1.0, radians(77)])
def test_a_cut_at_the_start_of_the_pattern_or_beside_it_leaves_frames_whole(start: float, clockwise: bool) -> None:
    lidar = ls.Lidar(Spinning([0.0], columns=360, rate=10.0, clockwise=clockwise, start_azimuth=start))
    for cut in (start, np.nextafter(start, 4), np.nextafter(start, -4), start - TURN if start > 0 else start + TURN):
        assert _cuts.time_of(cut, "velodyne", lidar) is None
    assert _cuts.time_of(start - 1e-6, "velodyne", lidar) == (15 if clockwise else 99_999_984)


@pytest.mark.parametrize("preset", ["sick-lms111", "hokuyo-utm30lx", "hesai-at128", "livox-mid360", "livox-mid40"])
@pytest.mark.parametrize("cut", ["driver", 0.5])
def test_other_sensors_keep_their_frames(preset: str, cut: Any, tmp_path: Path) -> None:
    lidar, scene = ls.Lidar.preset(preset), ball()
    for name, more in (("a.mcap", {}), ("b.mcap", {"cut": cut})):
        with rosbag.Writer(tmp_path / name, **more) as bag:
            for scan in lidar.frames(scene, None, 2):
                bag.write(scan)
    assert len(list(rosbag.read(tmp_path / "b.mcap"))) == 2
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_sensor_of_no_layout_of_its_own_is_cut_at_a_given_azimuth(tmp_path: Path) -> None:
    lidar = LIDARS["velodyne-vlp16"]
    with rosbag.Writer(tmp_path / "a.mcap", layout="livox", cut=0.0) as bag:
        for scan in lidar.frames(ball(), None, 2):
            bag.write(scan)
    assert [message.stamp % 10**9 for message in rosbag.read(tmp_path / "a.mcap")] == [0, 50_000_000, 150_000_000]


def test_each_sensor_of_a_rig_by_its_driver(tmp_path: Path) -> None:
    presets = {"top": "velodyne-vlp16", "rear": "ouster-os1-64", "left": "sick-lms111", "low": "livox-mid360"}
    rig = ls.Rig({name: (ls.Lidar.preset(preset), None, 0.01) for name, preset in presets.items()})
    with rosbag.Writer(tmp_path / "a.mcap", sensors=rig, cut="driver", start=START) as bag:
        for scans in rig.frames(ball(), None, 10):  # 50 Hz: 2 frames of 10 Hz, 10 of the SICK
            bag.write(scans)
    stamps: dict[str, list[int]] = {}
    for message in rosbag.read(tmp_path / "a.mcap"):
        stamps.setdefault(message.frame_id, []).append(message.stamp // 10**6 - 100_000)
    assert stamps == {
        "top": [10, 60, 160],
        "rear": [10, 110],
        "left": list(range(10, 210, 20)),
        "low": [10, 110],
    }


def test_frames_that_do_not_follow_one_another_are_not_joined(tmp_path: Path) -> None:
    lidar = LIDARS["velodyne-vlp16"]
    frames = [0, 1, 3]
    whole = clouds(write(tmp_path / "a.mcap", lidar, frames))
    parts = clouds(write(tmp_path / "b.mcap", lidar, frames, cut="driver"))
    assert [part.stamp // 10**6 - 100_000 for part in parts] == [0, 50, 150, 300, 350]
    expect_the_same_points(parts, whole, tolerance(None, lidar))


@pytest.mark.parametrize("rate", [7.0, 9.99, 13.7])
def test_late_frames_follow_one_another(rate: float, tmp_path: Path) -> None:
    lidar = ls.Lidar(Spinning([0.0], columns=4, rate=rate), model="ouster")
    cloud = ls.PointCloud(xyz=np.ones((4, 3)), time=lidar.pattern.pulses().time)
    first = round(2e6 * rate)  # after 23 days
    with rosbag.Writer(tmp_path / "a.mcap", cut=0.0, rate=1e-3) as bag:
        for frame in range(first, first + 100):
            bag.write_cloud(cloud, frame / rate, lidar=lidar)
    assert [len(part.ring) for part in clouds(tmp_path / "a.mcap")] == [2, *[4] * 99, 2]


def test_a_change_of_layout_ends_the_message(tmp_path: Path) -> None:
    pattern = Spinning([0.0], columns=4, rate=10.0)
    cloud = ls.PointCloud(xyz=np.ones((4, 3)), time=pattern.pulses().time)
    sensors: tuple[ls.Lidar | None, ...] = (ls.Lidar(pattern), ls.Lidar(pattern, model="hesai-x"), None)
    with rosbag.Writer(tmp_path / "a.mcap", cut=0.0, start=START) as bag:
        for frame, lidar in enumerate(sensors):
            bag.write_cloud(cloud, frame / 10, lidar=lidar)
    got = [(part.stamp // 10**6 - 100_000, len(part.ring)) for part in clouds(tmp_path / "a.mcap")]
    assert got == [(0, 2), (50, 2), (100, 2), (150, 2), (200, 4)]
    in_the_file = [message.stamp for message in rosbag.read(tmp_path / "a.mcap")]
    assert in_the_file == sorted(in_the_file)


def test_points_in_any_order_are_cut_in_firing_order(tmp_path: Path) -> None:
    lidar = LIDARS["velodyne-vlp16"]
    sorted_, mixed = (tmp_path / name for name in ("a.mcap", "b.mcap"))
    for path in (sorted_, mixed):
        with rosbag.Writer(path, cut="driver") as bag:
            for scan in lidar.frames(ball(), None, 2):
                cloud = scan.point_cloud()
                cloud.time[::100], cloud.xyz[1::100] = np.nan, np.nan
                time, fields = cloud.time.copy(), cloud.fields
                given = cloud[np.random.default_rng(scan.frame).permutation(len(cloud))] if path == mixed else cloud
                bag.write_cloud(given, scan.time, lidar=lidar)
                np.testing.assert_array_equal(cloud.time, time)
                assert cloud.fields == fields
    assert [len(part.ring) // 1000 for part in clouds(mixed)] == [14, 28, 14]  # 98 % of 28,936 a turn
    assert sorted_.read_bytes() == mixed.read_bytes()


def test_messages_may_be_empty(tmp_path: Path) -> None:
    lidar = ls.Lidar(Spinning([0.0], columns=4, rate=10.0), model="ouster")
    cloud = ls.PointCloud(xyz=np.ones((4, 3)), time=lidar.pattern.pulses().time)
    with rosbag.Writer(tmp_path / "a.mcap", cut=0.0) as bag:
        for frame, seen in enumerate((cloud[:0], cloud[:1], cloud[3:], cloud[:0])):
            bag.write_cloud(seen, frame / 10, lidar=lidar)
    parts = clouds(tmp_path / "a.mcap")
    assert [(part.time / 1e6).round().tolist() for part in parts] == [[], [50], [], [25], []]
    assert all(part.recorded - part.stamp == part.time.max(initial=0) for part in parts)


@pytest.mark.parametrize(
    ("cut", "error", "message"),
    [
        ("front", ValueError, "cut: expected 'pattern', 'driver' or an azimuth in rad, got 'front'"),
        (90, ValueError, "cut: expected a finite number from -6.28319 to 6.28319, got 90.0; degrees?"),
        (np.nan, ValueError, "cut: expected a finite number"),
        (None, TypeError, "cut: expected 'pattern', 'driver' or an azimuth in rad, got None"),
        ([0.0], TypeError, r"cut: expected 'pattern', 'driver' or an azimuth in rad, got \[0.0\]"),
        (True, TypeError, "cut: expected 'pattern', 'driver' or an azimuth in rad, got True"),
    ],
)
def test_bad_cuts(cut: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        rosbag.Writer("a.mcap", cut=cut)


def test_clouds_to_be_cut_have_times(tmp_path: Path) -> None:
    cloud = ls.PointCloud(xyz=np.ones((4, 3)))
    with rosbag.Writer(tmp_path / "a.mcap", cut="driver") as bag:
        bag.write_cloud(cloud)
        bag.write_cloud(cloud, 1.0, lidar=ls.Lidar(Grid([0.0], [0.0], rate=10.0)))
    assert len(clouds(tmp_path / "a.mcap")) == 2
    with (
        pytest.raises(ValueError, match="cloud: expected the time of each point, by which to cut, got no field time"),
        rosbag.Writer(tmp_path / "b.mcap", cut="driver") as bag,
    ):
        bag.write_cloud(cloud, lidar=LIDARS["velodyne-vlp16"])
    assert not (tmp_path / "b.mcap").exists()


def test_an_error_in_the_last_message_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lidar = ls.Lidar(Spinning([0.0], columns=4, rate=10.0))
    cloud = ls.PointCloud(xyz=np.ones((4, 3)), time=lidar.pattern.pulses().time)

    def full(*_: Any) -> None:
        raise OSError("no room")

    with pytest.raises(OSError, match="no room"), rosbag.Writer(tmp_path / "a.mcap", cut="driver") as bag:  # noqa: PT012
        bag.write_cloud(cloud, lidar=lidar)
        monkeypatch.setattr(bag, "_send", full)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="expected to be written in a with block"):
        bag.write_cloud(cloud, lidar=lidar)
    with pytest.raises(KeyError, match="first"), rosbag.Writer(tmp_path / "a.mcap", cut="driver") as bag:  # noqa: PT012
        bag.write_cloud(cloud, lidar=lidar)
        monkeypatch.setattr(bag, "_send", full)
        raise KeyError("first")
    assert not list(tmp_path.iterdir())
