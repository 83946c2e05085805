"""ROS 2 bags, alone or in a folder per sequence: the clouds of one topic, in the sensor frame."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from lidarsim.datasets.reading._frames import Frame, Frames, folders, names_in, natural, recipe_of
from lidarsim.io import rosbag


def recognise(path: Path) -> bool:
    """Return whether a path is a bag, or a folder with bags in it or in its folders."""
    return bool(_files(path))


def open_frames(path: Path) -> Frames:
    """Return the clouds of the topic of the first cloud."""
    files = _files(path)
    names = names_in(recipe_of(path).get("class_names", {}), path / "recipe.yaml") if path.is_dir() else {}
    topic = next(rosbag.read(files[0])).topic

    def read(first: int) -> Iterator[Frame]:
        messages = (message for file in files for message in rosbag.read(file, topic=topic))
        for message in islice(messages, first, None):
            message.cloud.class_names = names
            yield Frame(message.cloud, time=message.stamp / 1e9)

    return Frames(f"ROS 2 bag, {topic}", None, read, names)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path] if path.suffix.lower() in rosbag.SUFFIXES else []
    inside = [path, *folders(path)]
    return [file for folder in inside for file in sorted(_bags(folder), key=lambda file: natural(file.name))]


def _bags(folder: Path) -> Iterator[Path]:
    return (file for file in folder.iterdir() if file.suffix.lower() in rosbag.SUFFIXES and file.is_file())
