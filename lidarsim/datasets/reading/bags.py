"""ROS 2 bags, alone or in a folder per sequence: the clouds of all topics, placed by ``/tf_static``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path

from lidarsim._base.files import natural
from lidarsim._base.shown import quantity
from lidarsim._base.validation import Floats
from lidarsim.datasets.frames import Frame, Frames, folders, names_in, recipe_of
from lidarsim.errors import LidarsimError
from lidarsim.io import rosbag
from lidarsim.scan.pointcloud import PointCloud


def recognise(path: Path) -> bool:
    """Return whether a path is a bag, or a folder with bags in it or in its folders."""
    return bool(_files(path))


def open_frames(path: Path) -> Frames:
    """Return frames of one cloud of each topic: in the sensor frame if there is one topic, else in that of the body."""
    files = _files(path)
    names = names_in(recipe_of(path).get("class_names", {}), path / "recipe.yaml") if path.is_dir() else {}
    first = islice(_frames(files), 2)  # the first one may lack sensors that start later
    sensors = {topic: message.frame_id for frame in first for topic, message in frame.items()}
    places, note = _find_mounts(files[0], sensors) if len(sensors) > 1 else ({}, "")

    def read(start: int) -> Iterator[Frame]:
        count = 0
        for count, frame in enumerate(_frames(files), 1):
            if count > start:
                yield _frame(frame, places, names)
        if count <= start:
            raise LidarsimError(f"{path}: frame: expected 0 to {count - 1}, got {start}")

    return Frames(f"ROS 2 bag, {', '.join(sensors)}", None, read, names, note)


def _frames(files: list[Path]) -> Iterator[dict[str, rosbag.Message]]:
    """Yield messages by topic: a frame ends before the second message of a topic."""
    frame: dict[str, rosbag.Message] = {}
    for file in files:
        for message in rosbag.read(file):
            if message.topic in frame:
                yield frame
                frame = {}
            frame[message.topic] = message
    yield frame


def _find_mounts(path: Path, sensors: Mapping[str, str]) -> tuple[dict[str, Floats], str]:
    """Return the pose of each sensor in the frame that all share, and a note; `sensors` has frame_id by topic."""
    mounts = rosbag.static_mounts(path)
    frames = set(sensors.values())
    roots = {mounts[name][0] if name in mounts else name for name in frames}
    topics = f"{quantity(len(sensors), 'topic')} ({', '.join(sensors)})"
    if len(roots) > 1:
        return {}, f"{topics}, not placed: /tf_static does not connect {', '.join(sorted(frames))}"
    return {name: mounts[name][1] for name in frames & mounts.keys()}, f"{topics} in {roots.pop()}"


def _frame(frame: Mapping[str, rosbag.Message], places: Mapping[str, Floats], names: Mapping[int, str]) -> Frame:
    clouds: dict[str, PointCloud] = {}
    for topic, message in frame.items():
        message.cloud.class_names = names
        place = places.get(message.frame_id)
        clouds[topic] = message.cloud if place is None else message.cloud.transformed(place)
    time = min(message.stamp for message in frame.values()) / 1e9
    return Frame(clouds if len(clouds) > 1 or places else next(iter(clouds.values())), time=time)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path] if rosbag.is_bag(path) else []
    inside = [path, *folders(path)]
    return [file for folder in inside for file in sorted(_bags(folder), key=lambda file: natural(file.name))]


def _bags(folder: Path) -> Iterator[Path]:
    return (file for file in folder.iterdir() if rosbag.is_bag(file) and file.is_file())
