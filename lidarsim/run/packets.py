"""Runs as packets, as the sensors send them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lidarsim.io import packets
from lidarsim.run._frames import CloudArguments, Frames, RunFrame
from lidarsim.run._output import Option, Output, Samples, Save, register_output

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike


def pcap(run: Frames, path: PathLike, **options: Any) -> packets.Writer:
    """Return a writer of the packets that the sensors of a run send, with its `clock`.

    The options, and the errors, are those of `lidarsim.io.packets.Writer`.
    """
    return packets.Writer(path, run.sensor, start=run.clock, **options)


@register_output
class Packets(Output):
    """Packets in one file, beside which are the files that decoders need."""

    kind: ClassVar[str] = f"packets ({', '.join(packets.SUFFIXES)})"
    suffixes: ClassVar[Collection[str]] = packets.SUFFIXES
    options: ClassVar[Mapping[str, Option]] = {
        "variant": Option(
            "--variant",
            "NAME",
            f"Layout of packets: {', '.join(packets.variants())}; default: a sensor's first that holds its returns.",
        )
    }
    cloud: ClassVar[CloudArguments | None] = {"frame": "sensor", "deskew": False}
    unix: ClassVar[bool] = True

    def __str__(self) -> str:
        return f"the packets {self.path}"

    def files(self, part: Frames, path: Path, frames: Collection[int] | None) -> list[Path]:
        """Return the file of packets and those beside it."""
        return pcap(part, path).files

    @contextmanager
    def open(self, part: Frames, path: Path, number: int, samples: Samples) -> Iterator[Save]:
        """Yield a function that writes the packets of a frame."""
        with pcap(part, path, **self.given) as writer:

            def save(frame: RunFrame) -> Iterable[Path]:
                writer.write(frame.scans)
                return writer.files

            yield save
