"""Tar files of NumPy archives, which WebDataset reads directly, and a Parquet index of them.

``shards/000000.tar`` holds, for each sample, ``<sequence>_<frame>.npz`` with its points and ``….json`` with its numbers
and pose; with a rig ``….<sensor>.npz``. ``index.parquet`` has one row per sample: the place of its archive in the tar,
and everything in the JSON.

Format: https://github.com/webdataset/webdataset.
"""

from __future__ import annotations

import dataclasses
import json
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field

from lidarsim._extras import import_extra
from lidarsim.datasets.layouts._layout import Extra, Files, Layout, Noted, Summary, Write
from lidarsim.datasets.samples import Number, Record, Sample
from lidarsim.datasets.store import check_path
from lidarsim.errors import FileFormatError
from lidarsim.io import npz

if TYPE_CHECKING:
    from lidarsim.run import Run

FIELDS = ("intensity", "time", "ring", "label", "object_id")
ROWS = 1 << 16
FOLDER, INDEX = "shards", "index.parquet"


class Located(Noted):
    """Place of a sample's archive."""

    shard: Annotated[str, AfterValidator(check_path)]
    offset: Number
    size: Number


class Shards(Layout):
    """Tar files of NumPy archives, and a Parquet index. `xyz` is float32; `fields` lists the other fields."""

    noted: ClassVar[type[Noted]] = Located

    type: Literal["shards"]
    fields: list[str] = Field(default=list(FIELDS))

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return the folder of shards, and their index."""
        del run, sequences
        return {FOLDER, INDEX}

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
            buffer = BytesIO()
            npz.save(self._arrays(sample), buffer)
            base = ".".join(filter(None, (f"{record.sequence:06}_{record.frame:06}", record.sensor)))
            offset = add(f"{base}.npz", buffer.getvalue())
            add(f"{base}.json", json.dumps(_said(record)).encode())
            about["samples"] += 1
            about["points"] += record.points
            return {"shard": name, "offset": offset, "size": buffer.tell()}

        with files.local(name, about) as path, tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
            yield write

    def _arrays(self, sample: Sample) -> dict[str, Any]:
        cloud = sample.cloud
        for name in self.fields:
            if name not in cloud.fields:
                raise FileFormatError(f"fields: expected some of {', '.join(cloud.fields)}, got {name!r}")
        arrays = {"xyz": cloud.xyz.astype(np.float32)}
        return arrays | {name: getattr(cloud, name) for name in self.fields if name != "xyz"}

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the index."""
        arrow = import_extra("pyarrow", "cluster", "the index of shards")
        parquet = import_extra("pyarrow.parquet", "cluster", "the index of shards")
        numbers = {
            "sequence": arrow.int64(),
            "frame": arrow.int64(),
            "seconds": arrow.float64(),
            "points": arrow.int64(),
        }
        numbers |= {"offset": arrow.int64(), "size": arrow.int64()}
        texts = dict.fromkeys(("shard", "key", "sensor"), arrow.string())
        schema = arrow.schema({**texts, **numbers, "pose": arrow.list_(arrow.float64(), 12)})
        with files.local(INDEX) as path, parquet.ParquetWriter(path, schema) as writer:
            samples = summary.records()
            while records := list(islice(samples, ROWS)):
                rows = [{**_said(record), **record.extra, "key": _key(record)} for record in records]
                writer.write_table(arrow.Table.from_pylist(rows, schema=schema))


def _key(record: Record) -> str:
    return f"{record.sequence:06}_{record.frame:06}"


def _said(record: Record) -> dict[str, Any]:
    return {key: value for key, value in dataclasses.asdict(record).items() if key not in {"body", "extra"}}
