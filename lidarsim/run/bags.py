"""Runs as ROS 2 bags: all frames of a run in one file, or in a folder."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lidarsim._base.validation import short_repr
from lidarsim.errors import LidarsimError
from lidarsim.io import _storage, rosbag
from lidarsim.rig import Rig
from lidarsim.run._frames import Frames, RunFrame
from lidarsim.run._output import Option, Output, Samples, Save, register_output
from lidarsim.sensor.gnss import GnssFixes

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike
    from lidarsim.io._cuts import Cut
    from lidarsim.sensor.imu import ImuSamples


def bag(run: Frames, path: PathLike, **options: Any) -> rosbag.Writer:
    """Return a writer of a ROS 2 bag for scans of a run, with its sensors, its trajectory and its `clock`.

    The options, and the errors, are those of `lidarsim.io.rosbag.Writer`.
    """
    sensors = run.sensor if isinstance(run.sensor, Rig) else None
    return rosbag.Writer(path, sensors=sensors, trajectory=run.pose, start=run.clock, **options)


def write_samples(writer: rosbag.Writer, values: ImuSamples | GnssFixes) -> None:
    """Write the samples of an IMU or the fixes of a receiver."""
    if isinstance(values, GnssFixes):
        writer.write_gnss(values)
    else:
        writer.write_imu(values)


def _cut(text: str) -> Cut:
    """Parse where messages begin: pattern, driver or an azimuth in degrees."""
    match text:
        case "pattern" | "driver":
            return text
    try:
        degrees = float(text)
    except ValueError:
        degrees = math.nan
    if not -360.0 <= degrees <= 360.0:
        raise LidarsimError(f"--cut: expected pattern, driver or -360 to 360 degrees, got {short_repr(text)}")
    return math.radians(degrees)


class Bag(Output):
    """A bag of one file. It holds scans as drivers publish them, whatever the coordinates of the run's points."""

    kind: ClassVar[str] = f"a bag ({', '.join(rosbag.SUFFIXES)})"
    suffixes: ClassVar[Collection[str]] = rosbag.SUFFIXES
    options: ClassVar[Mapping[str, Option]] = {
        "layout": Option("--layout", "NAME", f"Point layout of a bag: {', '.join(rosbag.NAMES)}; default: by vendor."),
        "cut": Option(
            "--cut",
            "pattern|driver|DEGREES",
            "Begin messages of a bag as the pattern (default) or the driver begins frames, or at an azimuth.",
            parse=_cut,
        ),
    }
    complete: ClassVar[bool] = True
    unix: ClassVar[bool] = True

    def __str__(self) -> str:
        return f"the bag {self.path}"

    def files(self, part: Frames, path: Path, frames: Collection[int] | None) -> list[Path]:
        """Return the bag."""
        return [path]

    @contextmanager
    def open(self, part: Frames, path: Path, number: int, samples: Samples) -> Iterator[Save]:
        """Yield a function that writes a frame into the bag, after all samples."""
        with bag(part, path, **self.given) as writer:
            for values in samples.values():
                write_samples(writer, values)

            def save(frame: RunFrame) -> Iterable[Path]:
                writer.write(frame.scans if isinstance(part.sensor, Rig) else frame.scans[""])
                return [path]

            yield save


class BagFolder(Bag):
    """A bag in a folder, in several files if it is split."""

    kind: ClassVar[str] = "the folder of a bag, which ends in /,"
    options: ClassVar[Mapping[str, Option]] = {
        **Bag.options,
        "max_size": Option(
            "--max-bag-size", "BYTES", "Split a bag in a folder into files of about this size.", kind=int
        ),
        "max_duration": Option(
            "--max-bag-duration", "SECONDS", "Split a bag in a folder into files of this duration.", kind=float
        ),
    }
    folder: ClassVar[bool] = True

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether a path is one of this kind: of folders there is no other."""
        return True

    @classmethod
    def fits(cls, path: Path, run: Frames) -> bool:
        """Return whether a run is written so: the path has no suffix."""
        return _storage.is_folder(path)

    @classmethod
    def check(cls, path: PathLike) -> None:
        """Raise an error unless a bag can become the folder."""
        _storage.check_folder(path)


for kind in (Bag, BagFolder):
    register_output(kind)
