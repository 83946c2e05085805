"""Runs as point clouds: a file for each frame and sensor, or one LAS file for each strip of a flight."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from lidarsim._base.validation import short_repr
from lidarsim.errors import ArgumentValueError, FileFormatError, LidarsimError
from lidarsim.io import las
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig
from lidarsim.run._frames import Frames, RunFrame, insert
from lidarsim.run._output import OUTPUTS, Option, Output, Samples, Save, register_output
from lidarsim.scan.formats import check_output
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike


def _names(text: str) -> list[str]:
    """Parse names of fields with commas between them."""
    names = list(filter(None, text.split(",")))
    if not names:
        raise LidarsimError(f"--fields: expected names such as intensity,ring, or xyz alone, got {short_repr(text)}")
    return names


class Clouds(Output):
    """A file for each frame and sensor."""

    kind: ClassVar[str] = "a point cloud file"
    options: ClassVar[Mapping[str, Option]] = {
        "fields": Option(
            "--fields", "NAME,…", "Fields of the points to write besides x, y, z; default: all.", parse=_names
        ),
        "float32": Option(
            "--float32/--float64",
            "",
            "Type of x, y, z where a format has both; default: that of the format.",
            kind=bool,
        ),
    }

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether a path is one of this kind: what is none of the others."""
        return True

    @classmethod
    def check(cls, path: PathLike) -> None:
        """Raise an error if no format of point clouds has the suffix, or the file cannot be written."""
        check_output(path, [suffix for kind in OUTPUTS for suffix in kind.suffixes])

    def files(self, part: Frames, path: Path, frames: Collection[int] | None) -> list[Path]:
        """Return the files of all frames or of some."""
        return [part.path_of(path, *of) for of in part.clouds(frames)]

    def pattern(self, run: Frames) -> list[Path]:
        """Return the files, with * for sensor and number."""
        return [run.path_of(self.path, "*", "*")]

    @contextmanager
    def open(self, part: Frames, path: Path, number: int, samples: Samples) -> Iterator[Save]:
        """Yield a function that writes the clouds of a frame."""
        in_world = part.cloud["frame"] == "world"

        def save(frame: RunFrame) -> Iterator[Path]:
            for name, cloud in frame.clouds.items():
                file = part.path_of(path, name, frame.number)
                pose = None if in_world else frame.poses[name]
                if path.suffix.lower() in las.SUFFIXES:
                    of_run = _of_run(part, frame.scans[name], cloud)
                    of_run.save(file, pose=pose, crs=part.crs if in_world else None, start=part.start, **self.given)
                else:
                    cloud.save(file, pose=pose, **self.given)
                yield file

        yield save


class Strips(Clouds):
    """A LAS file for each strip and sensor, whose points have the number of the strip as point_source_id."""

    @classmethod
    def fits(cls, path: Path, run: Frames) -> bool:
        """Return whether a run is written so: it has strips, and the format is LAS."""
        moves = any(isinstance(leg.pose, Trajectory) for leg in run.legs)
        return moves and path.suffix.lower() in las.SUFFIXES

    def files(self, part: Frames, path: Path, frames: Collection[int] | None) -> list[Path]:
        """Return a file for each sensor."""
        return [*_strip_paths(part, path).values()]

    @contextmanager
    def open(self, part: Frames, path: Path, number: int, samples: Samples) -> Iterator[Save]:
        """Yield a function that appends a frame to the files of a strip."""
        if part.cloud["frame"] != "world":
            raise FileFormatError(f"{path}: expected points in the world, with cloud.frame: world, for a strip")
        if self.given.get("float32"):
            raise ArgumentValueError("float32", "a format with float32 coordinates", f"the strip {path}")
        fields = self.given.get("fields")
        paths = _strip_paths(part, path)
        with ExitStack() as stack:
            writers = {
                name: stack.enter_context(las.Writer(file, crs=part.crs, fields=fields)) for name, file in paths.items()
            }

            def save(frame: RunFrame) -> Iterable[Path]:
                for name, cloud in frame.clouds.items():
                    writers[name].write(_of_run(part, frame.scans[name], cloud, number), start=part.start)
                return paths.values()

            yield save


def _strip_paths(part: Frames, path: Path) -> dict[str, Path]:
    return {name: insert(path, name if isinstance(part.sensor, Rig) else "") for name in part.lidars}


def _of_run(part: Frames, scan: Scan, cloud: PointCloud, number: int = 0) -> PointCloud:
    """Return a cloud for LAS: times since the start of the run, and in the world the fields of the flight."""
    of_run = copy.copy(cloud)
    of_run.time = cloud.time + scan.time
    if part.cloud["frame"] == "world" and isinstance(scan.pose, Trajectory):
        for name, values in las.flight_fields(scan, point_source_id=number).items():
            setattr(of_run, name, values)
    return of_run


for kind in (Strips, Clouds):  # the last kind, which takes what no other takes
    register_output(kind)
