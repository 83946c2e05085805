"""Frames as readers of data sets return them, and the folders and files that they are read from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from lidarsim._base.files import check_regular, format_error, natural, parsing
from lidarsim._base.shown import plain as printable
from lidarsim._base.validation import Floats
from lidarsim.config.document import plain, read
from lidarsim.errors import FileFormatError
from lidarsim.io.semantickitti import read_labels
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.formats import is_point_cloud
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers._boxes import transform_boxes

if TYPE_CHECKING:
    import os

MOST_BYTES = 2**31
"""Greatest size of a table of text or JSON."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The points of a frame, with what else is known of it.

    Attributes
    ----------
    cloud : PointCloud or mapping of str to PointCloud
        The points, or those of each sensor.
    pose : ndarray of float64, shape (4, 4)
        Pose of the sensor in the coordinates of the points.
    time : float or None
        Time of the frame, s.
    boxes : Boxes or None
        Boxes, in the coordinates of the points.
    """

    cloud: PointCloud | Mapping[str, PointCloud]
    pose: Floats = field(default_factory=lambda: np.eye(4))
    time: float | None = None
    boxes: Boxes | None = None

    @property
    def clouds(self) -> list[PointCloud]:
        """The clouds of all sensors."""
        return [self.cloud] if isinstance(self.cloud, PointCloud) else list(self.cloud.values())


@dataclass(frozen=True)
class Frames:
    """The frames of a data set.

    Attributes
    ----------
    layout : str
        What the data set is, for people.
    count : int or None
        Number of frames; None if only reading tells.
    read : callable
        Yields the frames from a number on, counting from 0.
    class_names : mapping of int to str
        Class names by label.
    note : str
        What is not shown.
    """

    layout: str
    count: int | None
    read: Callable[[int], Iterator[Frame]]
    class_names: Mapping[int, str] = field(default_factory=dict)
    note: str = ""


class Row(BaseModel):
    """A row of a table of others: keys that it does not name are ignored."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)


Kind = TypeVar("Kind")


def validate(kind: Any, value: object, path: os.PathLike[str] | str) -> Any:
    """Return a value from the file `path` after checking its type.

    Raises
    ------
    FileFormatError
        If it is not of that type; the message names the file, the first wrong key and what is expected there.
    """
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as invalid:
        first = invalid.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"])) or "its content"
        raise FileFormatError(
            f"{path}: {printable(place, most=100)}: {format_error(ValueError(first['msg']))}"
        ) from None


def text_of(path: Path) -> str:
    """Return the text of a file."""
    check_regular(path)
    if path.stat().st_size > MOST_BYTES:
        raise FileFormatError(f"{path}: expected at most {MOST_BYTES:,} bytes, got more")
    with parsing(path, "text file"):
        return path.read_text(encoding="utf-8")


def numbers(path: Path, line: int, words: list[str]) -> list[float]:
    """Return the finite numbers in a line of a text file, counting from 1."""
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = [np.nan]
    if not np.isfinite(found).all():
        raise FileFormatError(
            f"{path}: line {line}: expected finite numbers, got {printable(' '.join(words), most=60)}"
        )
    return found


def recipe_of(folder: Path) -> dict[str, Any]:
    """Return the recipe that a data set was made by; empty if it has none."""
    path = folder / "recipe.yaml"
    recipe = plain(read(path)) if path.is_file() else {}
    return recipe if isinstance(recipe, dict) else {}


def names_in(names: object, path: os.PathLike[str] | str) -> dict[int, str]:
    """Return class names by label from a YAML mapping in the file `path`."""
    named: dict[int, str] = validate(dict[int, str], names, path)
    return named


def folders(folder: Path) -> list[Path]:
    """Return the folders in a folder, sorted by name; hidden ones are omitted."""
    return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))


def only(roots: list[Path]) -> str:
    """Return the note that of the folders of several sensors the first is shown; empty for one."""
    others = ", ".join(root.name for root in roots[1:])
    return (
        f"only {roots[0].name} is shown; paths to the folders of other sensors show these: {others}" if others else ""
    )


def point_files(folder: Path) -> list[Path]:
    """Return the point clouds in a folder, sorted as people count; ``.label`` and ``.txt`` files are none."""
    found = [
        path
        for path in folder.iterdir()
        if is_point_cloud(path)
        and path.suffix.lower() not in {".label", ".txt"}
        and not path.name.startswith(".")
        and path.is_file()
    ]
    return sorted(found, key=lambda path: natural(path.name))


def load_labelled(path: Path, labels: Path) -> PointCloud:
    """Return the points of a file with the classes and instances of a ``.label`` file, if that exists."""
    cloud = PointCloud.load(path)
    if not labels.exists():
        return cloud
    label, instance = read_labels(labels)
    if len(label) != len(cloud):
        raise FileFormatError(f"{labels}: expected a label for each of the {len(cloud):,} points, got {len(label):,}")
    cloud.label, cloud.instance = label, instance
    return cloud


def name_classes(frames: Iterator[Frame], names: Mapping[int, str]) -> Iterator[Frame]:
    """Yield frames whose clouds have class names."""
    for frame in frames:
        for cloud in frame.clouds:
            cloud.class_names = names
        yield frame


def in_world(cloud: PointCloud, pose: Floats, boxes: Boxes | None, time: float | None) -> Frame:
    """Return a frame in world coordinates, of points and boxes in the sensor frame."""
    return Frame(cloud.transformed(pose), pose, time, None if boxes is None else transform_boxes(boxes, pose))


def boxes_at(
    center: Floats, size: Floats, rotation: Floats, label: list[int], names: Mapping[int, str], **known: Any
) -> Boxes:
    """Return boxes of which a data set only tells some values; the others are 0, or nan where that is possible."""
    count = len(label)
    unknown: dict[str, Any] = {
        "velocity": np.zeros((count, 3)),
        "instance": np.zeros(count, np.uint32),
        "points": np.zeros(count, np.int64),
        "visibility": np.full(count, np.nan),
        "truncation": np.full(count, np.nan),
        "time": np.zeros(count),
    }
    own: dict[str, Any] = {name: np.asarray(known.get(name, value), value.dtype) for name, value in unknown.items()}
    return Boxes(
        center=np.reshape(center, (-1, 3)).astype(np.float64),
        size=np.reshape(size, (-1, 3)).astype(np.float64),
        rotation=np.reshape(rotation, (-1, 3, 3)).astype(np.float64),
        label=np.array(label, np.uint32),
        class_names=dict(names),
        **own,
    )
