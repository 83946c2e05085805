"""ROS 2 bags: one per sequence, split at the ends of shards; see `lidarsim.io.rosbag`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lidarsim.datasets.layouts._layout import Extra, Files, Layout, Summary, Write
from lidarsim.datasets.samples import Sample
from lidarsim.io import rosbag

if TYPE_CHECKING:
    from lidarsim.run import Run


class Bags(Layout):
    """ROS 2 bags with the messages of the sensors' drivers."""

    type: Literal["bags"]

    def check(self, run: Run) -> None:
        """Raise an error if a bag cannot hold the sensors."""
        super().check(run)
        run.bag("bag.mcap")

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
                    bag = stack.enter_context(_bag(path, run))
                    bags[record.sequence] = bag, about
                bag, about = bags[record.sequence]
                bag.write({record.sensor: sample.scan} if record.sensor else sample.scan)
                about["samples"] += 1
                about["points"] += record.points
                return {}

            yield write

    def finish(self, files: Files, summary: Summary) -> None:
        """Do nothing: bags need no tables."""


def _folder(sequence: int) -> str:
    return f"sequence_{sequence:04}"


@contextmanager
def _bag(path: Path, run: Run) -> Iterator[rosbag.Writer]:
    """Yield a bag of a run, which is renamed to `path`, whatever its suffix."""
    written = path.with_name("bag.mcap")
    with run.bag(written) as bag:
        yield bag
    written.replace(path)
