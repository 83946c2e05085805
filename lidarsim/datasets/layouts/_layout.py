"""Base class of layouts."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, ClassVar

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, ConfigDict, Field

from lidarsim._base.files import check_names
from lidarsim._base.labels import labels_of
from lidarsim._base.validation import UINT32, Floats
from lidarsim.config.factories import Model
from lidarsim.datasets.samples import Annotation, Number, Record, Sample
from lidarsim.datasets.scattered import Scattered
from lidarsim.datasets.store import Store
from lidarsim.errors import ArgumentValueError
from lidarsim.rig import Rig

if TYPE_CHECKING:
    from lidarsim.run import Run
    from lidarsim.scan.boxes import Boxes
    from lidarsim.scan.fields import Fields
    from lidarsim.world.scene import Scene

Extra = dict[str, Any]
"""Notes of a layout on a sample for its tables, in JSON types."""

Write = Callable[[Sample], Extra]


@dataclass
class Files:
    """Files written to a store, and their entries in the manifest."""

    store: Store
    entries: list[dict[str, Any]] = field(default_factory=list)

    def write(self, name: str, data: bytes, **more: object) -> None:
        """Write a file; its entry in the manifest gets `more`."""
        self.store.write(name, data)
        self._add(name, hashlib.sha256(data).hexdigest(), len(data), more)

    @contextmanager
    def local(self, name: str, more: Mapping[str, object] | None = None) -> Iterator[Path]:
        """Yield the path of a local file, which becomes the file `name` when the block ends without an error.

        Its entry in the manifest gets the contents of `more` at that time.
        """
        with self.store.writing(name) as path:
            yield path
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = path.stat().st_size
        self._add(name, digest, size, more or {})

    def write_json(self, name: str, rows: Iterable[object]) -> None:
        """Write a JSON file with a list of rows, one per line."""
        with self.local(name) as path, path.open("w", encoding="utf-8", newline="\n") as file:
            file.write("[")
            for index, row in enumerate(rows):
                file.write(("," if index else "") + "\n" + json.dumps(row))
            file.write("\n]\n")

    def _add(self, name: str, digest: str, size: int, more: Mapping[str, object]) -> None:
        self.entries.append({"file": name, "sha256": digest, "bytes": size, **more})


@dataclass(frozen=True)
class Summary:
    """Input for the tables of a layout, when all shards are done.

    Attributes
    ----------
    records : callable
        Returns an iterator over the records of all samples, ordered by sequence, frame and sensor of the rig.
    labels : dict of int to int
        Number of points by label.
    class_names : dict of int to str
        Class names of all labels that points have or the recipe names.
    digest : str
        Hash of the recipe.
    splits : dict of str to list of int
        Sequences of each split; empty without splits.
    files : callable
        Returns an iterator over the entries of the shards' files in the manifest, in order.
    scattered : Scattered
        Counts of the scattered objects.
    """

    records: Callable[[], Iterator[Record]]
    labels: dict[int, int]
    class_names: dict[int, str]
    digest: str
    splits: dict[str, list[int]] = field(default_factory=dict)
    files: Callable[[], Iterator[dict[str, Any]]] = lambda: iter(())
    scattered: Scattered = field(default_factory=Scattered)


def class_name(label: int, names: Mapping[int, str]) -> str:
    """Return the name of a class; ``class_10`` for a label 10 without one."""
    return names.get(label, f"class_{label}")


class BoxFilter(Model):
    """Which boxes a data set has.

    Attributes
    ----------
    min_points : int
        Least number of points of one sensor on an instance; in the tables of `nuscenes`, of all sensors together.
    max_range_m : float or None
        Greatest distance of the centre from the body of the rig, or from the sensor without a rig, m.
    classes : list of str or int, or None
        Names or labels of the classes.
    """

    min_points: Annotated[int, Field(ge=0)] = 1
    max_range_m: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    classes: Annotated[list[str | Annotated[int, Field(ge=0, le=UINT32)]], Field(min_length=1)] | None = None

    def labels(self, names: Mapping[int, str]) -> frozenset[int] | None:
        """Return the labels of the classes; None for all.

        Raises
        ------
        ValueError
            If there is no such class.
        """
        return None if self.classes is None else labels_of("boxes.classes", self.classes, names)

    def of(self, boxes: Boxes, origin: Floats) -> npt.NDArray[np.bool_]:
        """Return which boxes of its classes to keep, whatever their points; `origin` is the body in their frame."""
        kept: npt.NDArray[np.bool_] = boxes.instance != 0  # the number for no instance
        if self.max_range_m is not None:
            kept &= np.linalg.norm(boxes.center - origin, axis=1) <= self.max_range_m
        return kept


AnyBoxFilter = Annotated[
    BoxFilter, BeforeValidator(lambda value: {"classes": value} if isinstance(value, list) else value)
]
"""A filter of boxes; a list stands for its `classes`."""


class Notes(Model):
    """Schema of a layout's notes on a sample; empty by default."""

    model_config = ConfigDict(allow_inf_nan=False)


class Numbered(Notes):
    """Number of a sample, by which its files are named."""

    number: Number


class Layout(Model):
    """Base of the layouts; each is also the schema of its options.

    Attributes
    ----------
    notes : type of Notes
        Schema of the notes of `writer` on a sample.
    greatest_label : int
        Greatest label that the files can hold.
    reading : str
        Text for the data card on how to read the data set, if that is not obvious.
    in_world : bool
        Whether the points may be in world coordinates.
    of_scans : bool
        Whether the files are made of scans rather than of clouds, which `after_scan` may change.
    has_samples : bool
        Whether the files can hold the samples of IMUs and the fixes of GNSS receivers.
    """

    notes: ClassVar[type[Notes]] = Notes
    greatest_label: ClassVar[int] = UINT32
    reading: ClassVar[str] = ""
    in_world: ClassVar[bool] = False
    of_scans: ClassVar[bool] = False
    has_samples: ClassVar[bool] = False

    type: str

    @property
    def has_frames(self) -> bool:
        """Whether the files hold the cloud of each frame, which `read` returns."""
        return True

    @property
    def columns(self) -> tuple[str, ...] | None:
        """Fields of a cloud that the files hold besides `xyz`; None for any."""
        return None

    @property
    def box_filter(self) -> BoxFilter | None:
        """The option `boxes`; None for a layout without boxes, in which points are not deskewed by default."""
        return getattr(self, "boxes", None)

    def has_boxes(self, frame: int) -> bool:
        """Return whether a frame is annotated with boxes, if only with none."""
        return self.box_filter is not None

    @property
    def least_points(self) -> int:
        """Least number of points of one sensor on an instance with a box."""
        return 0 if self.box_filter is None else self.box_filter.min_points

    def shares_stamp(self, frame: int) -> bool:
        """Return whether all sensors of a frame have the stamp of the first, to which their points are deskewed."""
        return False

    def annotations(self, frame: Iterable[Record]) -> Iterator[tuple[Record, Annotation]]:
        """Yield the boxes of a frame, each with a record whose frame of reference it is in."""
        return ((record, box) for record in frame for box in record.boxes)

    def check(self, run: Run) -> None:
        """Raise `ValueError` if a sensor's name cannot be that of a file, or topic, of this layout."""
        for name in () if self.has_samples else [*run.imus, *run.receivers]:
            kind = "an imu" if name in run.imus else "a gnss"
            hint = "the layout bags has them"
            raise ArgumentValueError(f"rig.{name}", f"a sensor, as data sets of {self.type} have no others", kind, hint)
        if isinstance(run.sensor, Rig):
            check_names("sensors", [*run.sensor, *run.imus, *run.receivers])

    def check_labels(self, class_names: Mapping[int, str], scene: Scene) -> None:
        """Raise `ValueError` if a label is too great for the files of this layout."""
        most = self.greatest_label
        labels = {"class_names": iter(class_names)}
        labels["atmosphere"] = iter([scene.atmosphere.label] if scene.atmosphere else [])
        labels["scene"] = (int(np.max(item.label, initial=0)) for item in scene.objects)
        for argument, given in labels.items():
            for label in given:
                if label > most:
                    raise ArgumentValueError(argument, f"labels from 0 to {most} in {self.type}", label)

    def check_classes(self, class_names: Mapping[int, str]) -> None:
        """Raise `ValueError` if the files cannot hold a class name, or if a filter names no class."""
        if self.box_filter is not None:
            self.box_filter.labels(class_names)

    @abstractmethod
    def names(self, run: Run, sequences: int) -> set[str]:
        """Return the names of its files and folders at the top level of a data set."""

    @abstractmethod
    def writer(self, files: Files, shard: int) -> AbstractContextManager[Write]:
        """Return a context manager whose value writes the samples of a shard in order."""

    @abstractmethod
    def read(self, store: Store, record: Record) -> Fields:
        """Return the fields of a sample's cloud that the files hold."""

    @abstractmethod
    def finish(self, files: Files, summary: Summary) -> None:
        """Write the tables, when all shards are done."""


class SampleFiles(Layout):
    """Base of layouts in which each sample has files of its own.

    Attributes
    ----------
    top : tuple of str
        Names of the files and folders of a sensor.
    """

    notes: ClassVar[type[Notes]] = Numbered
    top: ClassVar[tuple[str, ...]]

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return a folder per sensor of a rig, or the names for a single sensor."""
        return set(run.sensor) if isinstance(run.sensor, Rig) else {*self.top}

    @contextmanager
    def writer(self, files: Files, shard: int) -> Iterator[Write]:
        """Yield a function that writes the files of a sample."""

        def write(sample: Sample) -> Extra:
            extra = self.note(sample)
            record = dataclasses.replace(sample.record, extra=extra)
            about = {"points": record.points, "seconds": record.seconds, "seed": sample.run.seed}
            for name, data in self.contents(record, sample).items():
                files.write(name, data, **about)
            return extra

        yield write

    def note(self, sample: Sample) -> Extra:
        """Return the notes on a sample: by default its number among those of all sequences."""
        return {"number": sample.number}

    @abstractmethod
    def contents(self, record: Record, sample: Sample) -> dict[str, bytes]:
        """Return the files of a sample by name; `record` is its record with its notes."""


def encode(save: Callable[[Fields, BinaryIO], None], fields: Fields) -> bytes:
    """Return the file that a format makes of the fields of a cloud."""
    buffer = BytesIO()
    save(fields, buffer)
    return buffer.getvalue()


def root(sensor: str) -> str:
    """Return the folder of a sensor of a rig, with a slash; empty for a single sensor."""
    return f"{sensor}/" if sensor else ""


def number_name(record: Record) -> str:
    """Return the name of the files of a numbered sample."""
    return f"{record.extra['number']:06}"
