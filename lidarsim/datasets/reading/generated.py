"""Data sets of lidarsim, read by their notes: those of a layout that has no reader of its own here."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from lidarsim.datasets import loading, manifest
from lidarsim.datasets.frames import Frame, Frames, in_world


def recognise(folder: Path) -> bool:
    """Return whether lidarsim made a data set in a folder."""
    return (folder / manifest.RECIPE).is_file() and (folder / manifest.PARTS).is_dir()


def open_frames(folder: Path) -> Frames:
    """Return the frames of all sequences, and of each sensor of a rig, in their order."""
    frames = loading.load(folder, None)

    def read(first: int) -> Iterator[Frame]:
        for number in range(first, len(frames)):
            frame = frames[number]
            if frame.cloud._in_sensor_frame:
                yield in_world(frame.cloud, frame.pose, frame.boxes, frame.time)
            else:
                yield Frame(frame.cloud, frame.pose, frame.time, frame.boxes)

    return Frames(frames.layout.type, len(frames), read, frames.class_names)
