"""Kinds of output of a run: a class each, which knows its suffixes, its options and its files."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from lidarsim._base.files import check_folder
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.run._frames import CloudArguments, Frames, RunFrame, insert

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike
    from lidarsim.sensor.gnss import GnssFixes
    from lidarsim.sensor.imu import ImuSamples

Samples: TypeAlias = "Mapping[str, ImuSamples | GnssFixes]"
"""The samples of IMUs and the fixes of GNSS receivers by name."""
Save: TypeAlias = Callable[[RunFrame], Iterable[Path]]
"""Writes a frame, and returns the files that it is in."""


@dataclass(frozen=True)
class Option:
    """An option of an output: a keyword of `Run.write`, and an option of the command line.

    Attributes
    ----------
    flag : str
        Its name on the command line.
    metavar, help : str
        Its values and its meaning there.
    kind : type
        Type of the text there: str, int, float or bool.
    parse : callable, optional
        Returns the value from that. Default: the value itself.
    """

    flag: str
    metavar: str
    help: str
    kind: type = str
    parse: Callable[[Any], Any] = lambda value: value


class Output(ABC):
    """Where a run is written to.

    Parameters
    ----------
    path : Path
        The path that the user gave.
    **given
        Values of some of `options`; None is the default of an option.

    Raises
    ------
    TypeError
        If there is no such option.
    ValueError
        If an option belongs to another kind of output.
    """

    kind: ClassVar[str]
    """What errors call outputs of this kind."""
    suffixes: ClassVar[Collection[str]] = ()
    folder: ClassVar[bool] = False
    """Whether it is a folder, whose name the user ends in /."""
    options: ClassVar[Mapping[str, Option]] = {}
    cloud: ClassVar[CloudArguments | None] = None
    """Coordinates of the points that it needs. Default: those of the run."""
    complete: ClassVar[bool] = False
    """Whether it holds samples, too: otherwise files next to it do."""
    unix: ClassVar[bool] = False
    """Whether its times, and those in files next to it, are Unix times: otherwise they are s of the run."""

    def __init__(self, path: Path, **given: Any) -> None:
        self.path = path
        self.given = {name: value for name, value in given.items() if value is not None}
        for name in self.given:
            if name not in self.options:
                owners = [kind.kind for kind in OUTPUTS if name in kind.options]
                if not owners:
                    raise ArgumentTypeError(name, f"one of the options {', '.join(options())}", "another")
                raise ArgumentValueError(name, f"{owners[0]} as output", str(self))

    def __str__(self) -> str:
        return str(self.path)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether a path is one of this kind, by its suffix."""
        return path.suffix.lower() in cls.suffixes

    @classmethod
    def fits(cls, path: Path, run: Frames) -> bool:
        """Return whether a run is written so to a path that `checked_output` returned."""
        return cls.takes(path)

    @classmethod
    def check(cls, path: PathLike) -> None:
        """Raise an error, before any work, if the file or folder cannot be written."""
        check_folder(path)

    @abstractmethod
    def files(self, part: Frames, path: Path, frames: Collection[int] | None) -> list[Path]:
        """Return the files of a run without legs, or of a leg; of some frames, if each has a file of its own."""

    def pattern(self, run: Frames) -> list[Path]:
        """Return the files of a run, with * for what differs between legs."""
        return self.files(run, insert(self.path, "*") if run.legs else self.path, None)

    @abstractmethod
    def open(self, part: Frames, path: Path, number: int, samples: Samples) -> AbstractContextManager[Save]:
        """Return what writes the frames of a run without legs, or of a leg; `number` is that of the leg, or 0."""


OUTPUTS: list[type[Output]] = []
"""All kinds; the first that fits is taken."""


def register_output(kind: type[Output]) -> type[Output]:
    """Add a kind of output."""
    OUTPUTS.append(kind)
    return kind


def options() -> dict[str, Option]:
    """Return the options of all kinds of output, by keyword."""
    return {name: option for kind in OUTPUTS for name, option in kind.options.items()}


def checked_output(output: PathLike) -> Path:
    """Return the path of the output of a run, after checking, before any work, that it can be written.

    Parameters
    ----------
    output : path-like
        A file of a known suffix, or, as a text that ends in /, the folder of a bag.

    Returns
    -------
    Path
        The path; that of a folder has no suffix.

    Raises
    ------
    FileFormatError
        If the suffix is unknown, or the name of a folder has one.
    OSError
        If the folder does not exist or is not writable, or has files that lidarsim did not write.
    """
    path = Path(output)
    folder = os.fspath(output).endswith(("/", os.sep))
    next(kind for kind in OUTPUTS if kind.folder == folder and kind.takes(path)).check(output)
    return path


def output_of(path: Path, run: Frames, **given: Any) -> Output:
    """Return the output of a run at a path, with its options."""
    return next(kind for kind in OUTPUTS if kind.fits(path, run))(path, **given)
