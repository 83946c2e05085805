"""Shards: tar files with a NumPy archive and a JSON of numbers per sample; see `lidarsim.datasets.layouts.shards`."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from lidarsim._base.files import check_regular, parsing
from lidarsim.datasets.frames import (
    Frame,
    Frames,
    Row,
    boxes_at,
    in_world,
    name_classes,
    names_in,
    recipe_of,
    validate,
)
from lidarsim.datasets.loading import has_world_points
from lidarsim.datasets.samples import Nine, Number, Rows, Three
from lidarsim.errors import FileFormatError
from lidarsim.io import npz
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.pointcloud import PointCloud, adopt, with_common_fields

Label = Annotated[int, Field(ge=0, lt=2**32)]


class Box(Row):
    """Box of a sample; see `lidarsim.Boxes`."""

    instance: Label
    label: Label
    points: Number
    center: Three
    size: Three
    rotation: Nine


class About(Row):
    """Numbers of a sample."""

    sequence: Number
    frame: Number
    seconds: float
    pose: Rows
    boxes: tuple[Box, ...] = ()


def recognise(folder: Path) -> bool:
    """Return whether a folder has shards."""
    return bool(_tars(folder))


def open_frames(folder: Path) -> Frames:
    """Return the frames of all shards, each with the points of all sensors."""
    recipe = recipe_of(folder)
    names = names_in(recipe.get("class_names", {}), folder / "recipe.yaml")
    placed = has_world_points(recipe)
    tars = _tars(folder)

    def frames(first: int) -> Iterator[Frame]:
        samples = groupby(_samples(tars), lambda sample: (sample[1].sequence, sample[1].frame))
        for number, (_, group) in enumerate(samples):
            parts = list(group)
            if number >= first:
                yield _frame(parts, names, placed=placed)

    count = len({_key(member.name) for tar in tars for member in _members(tar)})
    return Frames("shards", count, lambda first: name_classes(frames(first), names), names)


def _tars(folder: Path) -> list[Path]:
    found = (folder / "shards").glob("*.tar") if (folder / "shards").is_dir() else folder.glob("*.tar")
    return sorted(path for path in found if path.is_file())


def _key(name: str) -> str:
    """Return the part of a name that WebDataset takes for that of the sample."""
    return name.rpartition("/")[2].partition(".")[0]


def _members(path: Path) -> list[tarfile.TarInfo]:
    check_regular(path)
    with parsing(path, "tar file"), tarfile.open(path, "r:") as tar:
        return [member for member in tar if member.isfile() and member.name.endswith(".npz")]


def _samples(tars: list[Path]) -> Iterator[tuple[tuple[Path, tarfile.TarInfo], About]]:
    """Yield the archive and the numbers of each sample; archives are not read."""
    for path in tars:
        check_regular(path)
        with parsing(path, "tar file"), tarfile.open(path, "r:") as tar:
            members = {member.name: member for member in tar if member.isfile()}
            texts = {name: _read(tar, member) for name, member in members.items() if name.endswith(".json")}
        for name, member in members.items():
            if name.endswith(".npz"):
                beside = name.removesuffix(".npz") + ".json"
                if beside not in texts:
                    raise FileFormatError(f"{path}: expected a JSON beside each archive, got none for {name[:60]!a}")
                with parsing(path, "tar file of samples"):
                    numbers = json.loads(texts[beside])
                yield (path, member), validate(About, numbers, path)


def _read(tar: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    """Return the content of a member, which no more than its bytes in the file claim."""
    if member.issparse():
        raise FileFormatError(f"{member.name[:60]!a} is sparse, of {member.size:,} bytes; expected a whole file")
    if member.size > Path(str(tar.name)).stat().st_size:
        raise FileFormatError(f"it ends within {member.name[:60]!a}")
    file = tar.extractfile(member)
    data = b"" if file is None else file.read()
    if len(data) != member.size:
        raise FileFormatError(f"it ends within {member.name[:60]!a}")
    return data


def _frame(parts: list[tuple[tuple[Path, tarfile.TarInfo], About]], names: dict[int, str], *, placed: bool) -> Frame:
    frames = []
    for (path, member), about in parts:
        with parsing(path, "tar file of samples"), tarfile.open(path, "r:") as tar:
            cloud = PointCloud(adopt(npz.load(BytesIO(_read(tar, member)))))
        pose = np.array([*about.pose, 0.0, 0.0, 0.0, 1.0]).reshape(4, 4)
        boxes = _boxes(about.boxes, names) if about.boxes else None
        if placed:
            frames.append(Frame(cloud, pose, about.seconds, boxes))
        else:
            frames.append(in_world(cloud, pose, boxes, about.seconds))
    own = [cloud for frame in frames for cloud in frame.clouds]
    # Sensors of a rig each have boxes of the same instances: those of the first are shown.
    boxes = next((frame.boxes for frame in frames if frame.boxes is not None), None)
    return Frame(PointCloud.concatenate(with_common_fields(own)), frames[0].pose, frames[0].time, boxes)


def _boxes(rows: tuple[Box, ...], names: dict[int, str]) -> Boxes:
    return boxes_at(
        np.array([row.center for row in rows]),
        np.array([row.size for row in rows]),
        np.array([row.rotation for row in rows]),
        [row.label for row in rows],
        names,
        instance=[row.instance for row in rows],
        points=[row.points for row in rows],
    )
