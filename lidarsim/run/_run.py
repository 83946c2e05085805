"""A configured run: scan all frames, and write them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidarsim._base.files import Place, atomic_writer, check_folder
from lidarsim.errors import LidarsimError
from lidarsim.motion.trajectory import Trajectory
from lidarsim.run._frames import Frames, RunFrame, insert
from lidarsim.run._output import checked_output, output_of

if TYPE_CHECKING:
    from datetime import datetime

    from lidarsim._base.files import PathLike
    from lidarsim._base.validation import Floats
    from lidarsim.sensor.gnss import GnssFixes
    from lidarsim.sensor.imu import ImuSamples


@dataclass(frozen=True)
class Run(Frames):
    """A configuration, built and ready to scan; `Frames` documents its attributes."""

    def write(
        self, output: PathLike, *, each: Callable[[RunFrame], object] | None = None, **options: Any
    ) -> list[Path]:
        """Scan all frames, and write point clouds, a ROS 2 bag or packets.

        A bag holds all frames, in one file or in a folder, and so do packets (``.pcap``), next to which are the files
        that decoders need. Both hold what the sensors measure, whatever `cloud` is. Otherwise each point cloud gets its
        own file, numbered if there are several frames, and with the sensor's name if there is a rig. With several
        frames, the poses of each sensor at its moments (OUTPUT_poses.tum) and the start times of its scans
        (OUTPUT_times.txt) are written next to them. The samples of an IMU and the fixes of a GNSS receiver are messages
        of the bag, or a file of their own (OUTPUT_NAME.csv, as `ImuSamples.save` and `GnssFixes.save`). Times in files
        next to a bag or packets are Unix times, as the stamps of these are.

        With `legs`, the number of the strip or station precedes these in the names, and each gets a bag, or a file of
        packets, of its own. A strip is one file in LAS and LAZ, in which its number is the point_source_id. LAS and LAZ
        files of points in world coordinates have the fields of `lidarsim.io.las.flight_fields` if the sensor moves.

        Parameters
        ----------
        output : path-like
            The file; its suffix determines the format. A text that ends in / is the folder of a bag.
        each : callable, optional
            Called with each `RunFrame` after it has been written.
        **options
            Of point clouds: `fields` and `float32`, as in `PointCloud.save`. Of bags: `layout` and `cut`, and in a
            folder `max_size` and `max_duration`, as in `lidarsim.io.rosbag.Writer`. Of packets: `variant`, as in
            `lidarsim.io.packets.Writer`.

        Returns
        -------
        list of Path
            The files, in the order in which they were written.

        Raises
        ------
        FileFormatError
            If the suffix is unknown, the format cannot hold a cloud, or a sensor has no packets.
        OSError
            If a file cannot be written.
        LidarsimError
            As in `check_places`.
        ValueError
            If the trajectory does not cover the frames, the points are in the sensor frame and the run has a coordinate
            reference system, or an option is not one of the kind of output.
        """
        path = checked_output(output)
        to = output_of(path, self, **options)
        if to.cloud is not None and self.cloud != to.cloud:
            return replace(self, cloud=to.cloud).write(output, each=each, **options)
        self.check_places(path)
        if self.legs:
            self.check_coverage()
        written: dict[Path, None] = {}
        tracks: dict[str, list[tuple[float, float, Floats]]] = {}
        place = Place(path)
        zero = self.clock.timestamp() if to.unix else 0.0
        with place.errors_as_given():
            parts = [(number, part, file, part.samples()) for number, part, file in self._legs(place.path)]
            for number, part, file, samples in parts:
                with to.open(part, file, number, samples) as save:
                    if not to.complete:
                        written.update(dict.fromkeys(_save_samples(samples, file, self.clock if to.unix else 0.0)))
                    for frame in part.measured():
                        written.update(dict.fromkeys(save(frame)))
                        for name, scan in frame.scans.items():
                            track = zero + scan.time, zero + frame.moments[name], frame.poses[name]
                            tracks.setdefault(name, []).append(track)
                        if each:
                            each(frame)
            if len(self.frames) > 1:
                for name, track_of_it in tracks.items():
                    written.update(dict.fromkeys(_save_track(place.path, name, track_of_it)))
        return [place.as_given(file) for file in written]

    def check_places(self, output: Path, pictures: Path | None = None) -> None:
        """Check, before any work, that each file of the run can be written, in a place of its own.

        Paths that differ only in case are equal on some systems.

        Parameters
        ----------
        output : Path
            Output of `write`, as from `checked_output`.
        pictures : Path, optional
            Pictures of the frames, which the caller writes as `path_of` names them.

        Raises
        ------
        LidarsimError
            If a file would replace another one of the run or one of `sources`, also by way of links.
        OSError
            If the folder of a file does not exist or is not writable.
        """
        to = output_of(output, self)
        taken = self._read
        within = {folder: what for place, what in taken.items() for folder in place.parents}
        names = [path.name for path in (*self.sources, *self.files(output, ()))]
        names += [name for path in (output, pictures) if path for name in _links_beside(path)]
        # Frames differ only in their numbers: those that are not in any of these names cannot meet them.
        frames = {int(digits) for name in names for digits in re.findall("[0-9]+", name)}
        frames |= {part.frames.start for part in self.parts}
        written = self.files(output, frames)
        if pictures:
            written += [self.path_of(pictures, *of) for part in self.parts for of in part.clouds(frames)]
        for path in written:
            (to.check if to.folder and not path.suffix else check_folder)(path)
            if got := taken.get(_place(path)) or within.get(_place(path)):
                raise LidarsimError(f"{path}: expected a file of its own, got {got}")
            taken[_place(path)] = f"the place of {path}"

    def check_unread(self, *paths: Path) -> None:
        """Raise `LidarsimError` if a file that the caller writes is one of `sources`, also by way of links."""
        for path in paths:
            if got := self._read.get(_place(path)):
                raise LidarsimError(f"{path}: expected a file of its own, got {got}")

    @property
    def _read(self) -> dict[Path, str]:
        """How errors call each of `sources`, by its place."""
        return {_place(path): f"that of {path}, which the run reads" for path in self.sources}

    def files(self, output: Path, frames: Collection[int] | None = None) -> list[Path]:
        """Return the files that `write` makes; in a rig, a sensor may lack a scan in some frames.

        Parameters
        ----------
        output : Path
            As in `write`.
        frames : collection of int, optional
            Numbers of the frames whose point clouds are listed, if each has a file of its own. Default: all.

        Returns
        -------
        list of Path
            The files.
        """
        to = output_of(output, self)
        found: list[Path] = []
        for _, part, place in self._legs(output):
            if not to.complete:
                found += [_samples_path(place, name) for name in [*self.imus, *self.receivers]]
            found += to.files(part, place, frames)
        if len(self.frames) > 1:
            found += [path for name in self.lidars for path in _track_paths(output, name)]
        return found

    def _legs(self, output: Path) -> Iterator[tuple[int, Frames, Path]]:
        """Yield the number of each leg, its frames and its output; 0, this run and `output` if there are no legs."""
        for number, part in zip([leg.number for leg in self.legs] or [0], self.parts, strict=True):
            yield number, part, insert(output, str(number)) if number else output


def _place(path: Path) -> Path:
    """Return what is equal for paths of the same file, also where case does not matter."""
    return Path(os.path.realpath(path).casefold())


def _links_beside(path: Path) -> list[str]:
    """Return the names of the links in the folder of a path; none if there is no such folder."""
    with suppress(OSError), os.scandir(path.parent) as entries:
        return [entry.name for entry in entries if entry.is_symlink()]
    return []


def _save_track(output: Path, name: str, track: list[tuple[float, float, Floats]]) -> Iterator[Path]:
    """Write the poses of a sensor and the start times of its scans; yield the paths."""
    starts, moments, matrices = zip(*track, strict=True)
    poses, times = _track_paths(output, name)
    Trajectory(moments, np.array(matrices)).save(poses)
    yield poses
    with atomic_writer(times) as file:
        file.writelines(f"{start!r}\n".encode("ascii") for start in starts)
    yield times


def _save_samples(
    samples: Mapping[str, ImuSamples | GnssFixes], output: Path, start: float | datetime
) -> Iterator[Path]:
    """Write samples of IMUs and receivers, whose time 0 is `start`, into files next to `output`; yield the paths."""
    for name, values in samples.items():
        values.save(_samples_path(output, name), start=start)
        yield _samples_path(output, name)


def _samples_path(output: Path, name: str) -> Path:
    """Return the path of the samples of an IMU or a receiver."""
    return insert(output, name, suffix=".csv")


def _track_paths(output: Path, name: str) -> tuple[Path, Path]:
    """Return the paths of the poses and times of a sensor."""
    return insert(output, name, "poses", suffix=".tum"), insert(output, name, "times", suffix=".txt")
