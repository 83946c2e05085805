"""ROS 2 bags: a folder per sequence, as ROS's recorder makes it, with a file per shard; see `lidarsim.io.rosbag`.

With a cut, the first and the last message of each bag are parts of a turn: at the end of a shard, one bag has the
beginning of a message and the next bag its end.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from lidarsim.datasets.layouts._layout import Extra, Files, Layout, Notes, Summary, Write
from lidarsim.datasets.samples import Number, Record, Sample
from lidarsim.datasets.store import check_path
from lidarsim.errors import FileFormatError
from lidarsim.io import _storage, rosbag
from lidarsim.run.bags import bag, write_samples

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike
    from lidarsim.datasets.store import Store
    from lidarsim.run import Run
    from lidarsim.scan.fields import Fields
    from lidarsim.sensor.gnss import GnssFixes
    from lidarsim.sensor.imu import ImuSamples


class Located(Notes):
    """Bag of a sample, and the number of its message among those of its sensor."""

    bag: Annotated[str, AfterValidator(check_path)]
    message: Number


class Bags(Layout):
    """ROS 2 bags with the messages of the sensors' drivers."""

    notes: ClassVar[type[Notes]] = Located
    of_scans: ClassVar[bool] = True
    has_samples: ClassVar[bool] = True

    type: Literal["bags"]
    cut: Literal["pattern", "driver"] | None = None
    """`driver`: begin messages where drivers of spinning sensors do; `pattern`, the default: one message per frame."""
    cut_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    """Begin messages at this azimuth."""

    @model_validator(mode="after")
    def _one(self) -> Bags:
        if self.cut is not None and self.cut_deg is not None:
            raise PydanticCustomError("cut", "expected either cut or cut_deg, got both")
        return self

    @property
    def has_frames(self) -> bool:
        """Whether each message is a frame: with a cut, messages hold the end of one frame and the start of the next."""
        return self.cut in {None, "pattern"} and self.cut_deg is None

    def _bag(self, path: PathLike, run: Run) -> rosbag.Writer:
        cut = self.cut or "pattern" if self.cut_deg is None else math.radians(self.cut_deg)
        return bag(run, path, cut=cut)

    def check(self, run: Run) -> None:
        """Raise an error if a bag cannot hold the sensors."""
        super().check(run)
        self._bag("bag.mcap", run)

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return a folder per sequence."""
        return {_folder(sequence) for sequence in range(sequences)}

    @contextmanager
    def writer(self, files: Files, shard: int) -> Iterator[Write]:
        """Yield a function that writes samples into the bag of their sequence."""
        bags: dict[int, tuple[rosbag.Writer, dict[str, Any], Mapping[str, ImuSamples | GnssFixes]]] = {}
        begun: set[int] = set()
        written: Counter[str] = Counter()
        name = ""
        with ExitStack() as stack:

            def write(sample: Sample) -> Extra:
                nonlocal name
                record, run = sample.record, sample.run
                if record.sequence not in bags:
                    stack.close()  # the bag of the previous sequence
                    about: dict[str, Any] = {"samples": 0, "points": 0, "seed": run.seed}
                    short = f"{record.frame:06}.mcap"
                    name = f"{_folder(record.sequence)}/{short}"
                    path = stack.enter_context(files.local(name, about))
                    bag = stack.enter_context(self._open(path, short, run, about))
                    bags[record.sequence] = bag, about, run.samples()
                    begun.clear()
                    written.clear()
                bag, about, samples = bags[record.sequence]
                if record.frame not in begun:
                    begun.add(record.frame)
                    _write_samples(bag, samples, run, record.frame)
                bag.write({record.sensor: sample.scan} if record.sensor else sample.scan)
                about["samples"] += 1
                about["points"] += record.points
                written[record.sensor] += 1
                return {"bag": name, "message": written[record.sensor] - 1}

            yield write

    def read(self, store: Store, record: Record) -> Fields:
        """Return the fields of a message; the bag is read up to it."""
        name, number = record.extra["bag"], record.extra["message"]
        with store.reading(name) as path:
            own = (one for one in rosbag.read(path) if record.sensor in {"", one.frame_id})
            message = next(itertools.islice(own, number, None), None)
        if message is None:
            raise FileFormatError(f"{name}: expected more than {number} clouds, got fewer")
        return {field: getattr(message.cloud, field) for field in message.cloud.fields}

    @contextmanager
    def _open(self, path: Path, name: str, run: Run, about: dict[str, Any]) -> Iterator[rosbag.Writer]:
        """Yield a bag of a run, which is renamed to `path`, whatever its suffix, and noted as the file `name`."""
        written = path.with_name("bag.mcap")
        with self._bag(written, run) as bag:
            yield bag
        written.replace(path)
        about["bag"] = _storage.rename(bag.metadata, name)

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the metadata of the bag of each sequence."""
        entries = ((entry["file"].partition("/")[0], entry.get("bag", {})) for entry in summary.files())
        for folder, notes in itertools.groupby(entries, key=lambda entry: entry[0]):
            files.write(f"{folder}/{_storage.METADATA}", _storage.metadata_of([bag for _, bag in notes]))


def _write_samples(bag: rosbag.Writer, samples: Mapping[str, ImuSamples | GnssFixes], run: Run, frame: int) -> None:
    """Write the samples of a frame, up to the start of the next; the outermost have all before and after."""
    number = run.frames.start + frame
    start = run.time(number) if frame else -math.inf
    end = run.time(number + 1) if number + 1 < run.frames.stop else math.inf
    for values in samples.values():
        write_samples(bag, values.between(start, end))


def _folder(sequence: int) -> str:
    return f"sequence_{sequence:04}"
