"""Tar files of NumPy archives, which WebDataset reads directly, and a Parquet index of them.

``shards/000000.tar`` holds, for each sample, ``<sequence>_<frame>.npz`` with its points and ``….json`` with its numbers
and pose; with a rig ``….<sensor>.npz``. ``index.parquet`` has one row per sample: the place of its archive in the tar,
and everything in the JSON except boxes.

With ``boxes: true``, or a filter of boxes, the JSON has ``boxes``, and ``boxes.parquet`` has one row per box, as in
`lidarsim.Boxes`, in the frame of the points of its sample; ``rotation`` has the rows of the matrix.

Format: https://github.com/webdataset/webdataset.
"""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from lidarsim._base.extras import import_extra
from lidarsim.datasets.layouts._layout import (
    AnyBoxFilter,
    Extra,
    Files,
    Layout,
    Notes,
    Summary,
    Write,
    class_name,
    encode,
)
from lidarsim.datasets.samples import Number, Record, Sample
from lidarsim.datasets.store import check_path
from lidarsim.errors import FileFormatError
from lidarsim.io import npz
from lidarsim.scan.fields import first_misfit

if TYPE_CHECKING:
    from lidarsim.datasets.store import Store
    from lidarsim.run import Run
    from lidarsim.scan.fields import Fields

FIELDS = ("intensity", "time", "ring", "label", "instance")
ROWS = 1 << 16
FOLDER, INDEX, BOXES = "shards", "index.parquet", "boxes.parquet"


class Located(Notes):
    """Place of a sample's archive."""

    shard: Annotated[str, AfterValidator(check_path)]
    offset: Number
    size: Number


def _boxes(value: object) -> object:
    """Return the filter that a switch stands for."""
    return {True: {}, False: None}[value] if isinstance(value, bool) else value


class Shards(Layout):
    """Tar files of NumPy archives, a Parquet index and, if there are to be, boxes.

    `xyz` is float32, and float64 in world coordinates; `fields` lists the other fields.
    """

    notes: ClassVar[type[Notes]] = Located
    in_world: ClassVar[bool] = True

    type: Literal["shards"]
    fields: list[str] = Field(default=list(FIELDS))
    """Fields besides `xyz`."""
    boxes: Annotated[AnyBoxFilter | None, BeforeValidator(_boxes)] = None
    """`true`, or a selection of [boxes](#boxes): adds them to the JSON of each sample, and `boxes.parquet`."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Fields that the archives hold."""
        return tuple(self.fields)

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return the folder of shards, and the tables."""
        return {FOLDER, INDEX} | ({BOXES} if self.boxes else set())

    @contextmanager
    def writer(self, files: Files, shard: int) -> Iterator[Write]:
        """Yield a function that adds samples to the tar of the shard."""
        name = f"{FOLDER}/{shard:06}.tar"
        about: dict[str, Any] = {"samples": 0, "points": 0}

        def add(member: str, data: bytes) -> int:
            head = tarfile.TarInfo(member)  # time 0, no owner
            head.size = len(data)
            start = tar.offset + tarfile.BLOCKSIZE
            tar.addfile(head, BytesIO(data))
            return start

        def write(sample: Sample) -> Extra:
            record = sample.record
            archive = encode(npz.save, self._arrays(sample))
            base = ".".join(filter(None, (_key(record), record.sensor)))
            offset = add(f"{base}.npz", archive)
            boxes = {"boxes": [vars(box) for box in record.boxes]} if self.boxes else {}
            add(f"{base}.json", json.dumps(_numbers(record) | boxes).encode())
            about["samples"] += 1
            about["points"] += record.points
            return {"shard": name, "offset": offset, "size": len(archive)}

        with files.local(name, about) as path, tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
            yield write

    def _arrays(self, sample: Sample) -> dict[str, Any]:
        cloud = sample.cloud
        in_world = sample.run.cloud["frame"] == "world"
        if not in_world and (misfit := first_misfit("xyz", cloud.xyz, np.float32)):
            raise FileFormatError("xyz: expected {}, got {}".format(*misfit))
        arrays = {"xyz": cloud.xyz if in_world else cloud.xyz.astype(np.float32)}
        return arrays | {name: getattr(cloud, name) for name in self.fields if name != "xyz"}

    def read(self, store: Store, record: Record) -> Fields:
        """Return the arrays of the archive."""
        with store.open(record.extra["shard"]) as file:
            file.seek(record.extra["offset"])
            return npz.load(BytesIO(file.read(record.extra["size"])))

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the tables."""
        arrow = import_extra("pyarrow", "cluster", "the index of shards")
        whole, real, text = arrow.int64(), arrow.float64(), arrow.string()
        located = {"key": text, "split": text, "sequence": whole, "frame": whole, "sensor": text}
        numbers = {"seconds": real, "points": whole, "pose": arrow.list_(real, 12)}
        place = {"shard": text, "offset": whole, "size": whole}
        _write_table(files, INDEX, located | numbers | place, (_row(record) for record in summary.records()))
        if not self.boxes:
            return
        three = dict.fromkeys(("center", "size", "velocity"), arrow.list_(real, 3))
        instances = {"instance": whole, "label": whole, "name": text, **three, "rotation": arrow.list_(real, 9)}
        seen = {"points": whole, "visibility": real, "truncation": real, "time": real}
        boxes = (
            _row(record) | vars(box) | {"name": class_name(box.label, summary.class_names)}
            for record in summary.records()
            for box in record.boxes
        )
        _write_table(files, BOXES, located | instances | seen, boxes)


def _write_table(files: Files, name: str, columns: dict[str, Any], rows: Iterator[dict[str, Any]]) -> None:
    arrow = import_extra("pyarrow", "cluster", "the tables of shards")
    parquet = import_extra("pyarrow.parquet", "cluster", "the tables of shards")
    schema = arrow.schema(columns)
    with files.local(name) as path, parquet.ParquetWriter(path, schema) as writer:
        while part := list(islice(rows, ROWS)):
            writer.write_table(arrow.Table.from_pylist(part, schema=schema))


def _row(record: Record) -> dict[str, Any]:
    return {**_numbers(record), **record.extra, "key": _key(record)}


def _key(record: Record) -> str:
    return f"{record.sequence:06}_{record.frame:06}"


def _numbers(record: Record) -> dict[str, Any]:
    names = ("sequence", "frame", "sensor", "split", "seconds", "points", "pose")
    return {name: getattr(record, name) for name in names}
