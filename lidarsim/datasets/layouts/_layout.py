"""What a layout is."""

from __future__ import annotations

import hashlib
import json
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import ConfigDict

from lidarsim._files import check_names
from lidarsim._validation import UINT32
from lidarsim.config.schema import Model
from lidarsim.datasets.samples import Record, Sample
from lidarsim.datasets.store import Store
from lidarsim.errors import ArgumentValueError
from lidarsim.rig import Rig

if TYPE_CHECKING:
    from lidarsim.run import Run
    from lidarsim.scene import Scene

Extra = dict[str, Any]
"""What a layout notes of a sample for its tables, as JSON can hold it."""

Write = Callable[[Sample], Extra]


@dataclass
class Files:
    """Files on their way into a store, and their entries in the manifest."""

    store: Store
    entries: list[dict[str, Any]] = field(default_factory=list)

    def write(self, name: str, data: bytes | memoryview, **more: object) -> None:
        """Write a file; its entry in the manifest gets `more`."""
        data = bytes(data)
        self.store.write(name, data)
        self._add(name, hashlib.sha256(data).hexdigest(), len(data), more)

    @contextmanager
    def local(self, name: str, more: Mapping[str, object] | None = None) -> Iterator[Path]:
        """Yield the path of a local file to write, which becomes the file `name` when the block ends well.

        Its entry in the manifest gets what `more` then holds.
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
    """What a layout's tables are made from, when all shards are there.

    Attributes
    ----------
    records : callable
        Iterates over the records of all samples in their order: sequence, frame, sensor of the rig.
    labels : dict of int to int
        How many points have each label.
    class_names : dict of int to str
        Class names of all labels that points have, and of those that the recipe names.
    digest : str
        Hash of the recipe.
    """

    records: Callable[[], Iterator[Record]]
    labels: dict[int, int]
    class_names: dict[int, str]
    digest: str


class Noted(Model):
    """Schema of what a layout notes of a sample; nothing here."""

    model_config = ConfigDict(allow_inf_nan=False)


class Layout(Model):
    """Base of the layouts, which are also the keys of their options.

    Attributes
    ----------
    noted : type of Noted
        Schema of what `writer` notes of a sample.
    greatest_label : int
        The greatest that its files can hold.
    reading : str
        Lines of the data card on how to read it, if that is not obvious.
    """

    noted: ClassVar[type[Noted]] = Noted
    greatest_label: ClassVar[int] = UINT32
    reading: ClassVar[str] = ""

    type: str

    def check(self, run: Run) -> None:
        """Raise `ValueError` if the names of the sensors cannot be those of files, or topics, of this layout."""
        if isinstance(run.sensor, Rig):
            check_names("sensors", run.sensor)

    def check_labels(self, class_names: Mapping[int, str], scene: Scene) -> None:
        """Raise `ValueError` if a label is greater than the files of this layout can hold."""
        most = self.greatest_label
        labels = {"class_names": iter(class_names)}
        labels["scene"] = (int(np.max(item.label, initial=0)) for item in scene.objects)
        for argument, given in labels.items():
            for label in given:
                if label > most:
                    raise ArgumentValueError(argument, f"labels from 0 to {most} in {self.type}", label)

    @abstractmethod
    def names(self, run: Run, sequences: int) -> set[str]:
        """Return the names of the files and folders that it writes at the top of a data set."""

    @abstractmethod
    def writer(self, files: Files, shard: int) -> AbstractContextManager[Write]:
        """Return what writes the samples of a shard, in their order."""

    @abstractmethod
    def finish(self, files: Files, summary: Summary) -> None:
        """Write the tables, when all shards are there."""
