"""ROS 2 bags: one per sequence, split at the ends of shards; see `lidarsim.io.rosbag`.

With a cut, the first and the last message of each bag are parts of a turn: at the end of a shard, one bag has the
beginning of a message and the next bag its end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from lidarsim.datasets.layouts._layout import Extra, Files, Layout, Summary, Write
from lidarsim.datasets.samples import Sample
from lidarsim.io import rosbag

if TYPE_CHECKING:
    from lidarsim._files import PathLike
    from lidarsim.run import Run


class Bags(Layout):
    """ROS 2 bags with the messages of the sensors' drivers."""

    type: Literal["bags"]
    cut: Literal["pattern", "driver"] | None = None
    cut_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None

    @model_validator(mode="after")
    def _one(self) -> Bags:
        if self.cut is not None and self.cut_deg is not None:
            raise PydanticCustomError("cut", "expected either cut or cut_deg, got both")
        return self

    def _bag(self, path: PathLike, run: Run) -> rosbag.Writer:
        cut = self.cut or "pattern" if self.cut_deg is None else math.radians(self.cut_deg)
        return run.bag(path, cut=cut)

    def check(self, run: Run) -> None:
        """Raise an error if a bag cannot hold the sensors."""
        super().check(run)
        self._bag("bag.mcap", run)

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return a folder per sequence."""
        del run
        return {_folder(sequence) for sequence in range(sequences)}

    @contextmanager
    def writer(self, files: Files, shard: int) -> Iterator[Write]:
        """Yield a function that writes samples into the bag of their sequence."""
        del shard
        bags: dict[int, tuple[rosbag.Writer, dict[str, Any]]] = {}
        with ExitStack() as stack:

            def write(sample: Sample) -> Extra:
                record, run = sample.record, sample.run
                if record.sequence not in bags:
                    stack.close()  # the bag of the previous sequence
                    about: dict[str, Any] = {"samples": 0, "points": 0, "seed": run.seed}
                    path = stack.enter_context(files.local(f"{_folder(record.sequence)}/{record.frame:06}.mcap", about))
                    bag = stack.enter_context(self._open(path, run))
                    bags[record.sequence] = bag, about
                bag, about = bags[record.sequence]
                bag.write({record.sensor: sample.scan} if record.sensor else sample.scan)
                about["samples"] += 1
                about["points"] += record.points
                return {}

            yield write

    @contextmanager
    def _open(self, path: Path, run: Run) -> Iterator[rosbag.Writer]:
        """Yield a bag of a run, which is renamed to `path`, whatever its suffix."""
        written = path.with_name("bag.mcap")
        with self._bag(written, run) as bag:
            yield bag
        written.replace(path)

    def finish(self, files: Files, summary: Summary) -> None:
        """Do nothing: bags need no tables."""


def _folder(sequence: int) -> str:
    return f"sequence_{sequence:04}"
