"""Base class of layouts."""

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
"""Notes of a layout on a sample for its tables, in JSON types."""

Write = Callable[[Sample], Extra]


@dataclass
class Files:
    """Files written to a store, and their entries in the manifest."""

    store: Store
    entries: list[dict[str, Any]] = field(default_factory=list)

    def write(self, name: str, data: bytes | memoryview, **more: object) -> None:
        """Write a file; its entry in the manifest gets `more`."""
        data = bytes(data)
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
    """

    records: Callable[[], Iterator[Record]]
    labels: dict[int, int]
    class_names: dict[int, str]
    digest: str


class Noted(Model):
    """Schema of a layout's notes on a sample; empty by default."""

    model_config = ConfigDict(allow_inf_nan=False)


class Layout(Model):
    """Base of the layouts; each is also the schema of its options.

    Attributes
    ----------
    noted : type of Noted
        Schema of the notes of `writer` on a sample.
    greatest_label : int
        Greatest label that the files can hold.
    reading : str
        Text for the data card on how to read the data set, if that is not obvious.
    """

    noted: ClassVar[type[Noted]] = Noted
    greatest_label: ClassVar[int] = UINT32
    reading: ClassVar[str] = ""

    type: str

    def check(self, run: Run) -> None:
        """Raise `ValueError` if a sensor's name cannot be that of a file, or topic, of this layout."""
        if isinstance(run.sensor, Rig):
            check_names("sensors", run.sensor)

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

    @abstractmethod
    def names(self, run: Run, sequences: int) -> set[str]:
        """Return the names of its files and folders at the top level of a data set."""

    @abstractmethod
    def writer(self, files: Files, shard: int) -> AbstractContextManager[Write]:
        """Return a context manager whose value writes the samples of a shard in order."""

    @abstractmethod
    def finish(self, files: Files, summary: Summary) -> None:
        """Write the tables, when all shards are done."""
