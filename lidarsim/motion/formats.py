"""Registry of the files of trajectories."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim._base import validation
from lidarsim._base.files import PathLike, check_new_suffix, check_path, check_suffix
from lidarsim._base.lines import LineReader, numbers
from lidarsim._base.validation import Floats, array
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError


@dataclass(frozen=True, slots=True)
class _Format:
    name: str
    looks: str
    recognise: Callable[[str], bool]
    read: Callable[[Iterator[str]], tuple[Floats | None, Floats]]
    suffixes: tuple[str, ...]
    write: Callable[[Floats, Floats, BinaryIO], None]


_FORMATS: list[_Format] = []


def register_trajectory_format(
    name: str,
    looks: str,
    recognise: Callable[[str], bool],
    read: Callable[[Iterator[str]], tuple[Floats | None, Floats]],
    *,
    suffixes: tuple[str, ...],
    write: Callable[[Floats, Floats, BinaryIO], None],
) -> None:
    """Let `Trajectory.load` and `Trajectory.save` handle one more format of text files.

    Parameters
    ----------
    name : str
        Name of the format in errors, such as "TUM".
    looks : str
        Short description of a file.
    recognise : callable
        ``recognise(line)`` returns whether a file with this first line is of this format.
    read : callable
        ``read(lines)`` returns times, shape (n,), or None if the format has none, and poses, shape (n, 4, 4). `lines`
        are the lines of the file, from the first on, without empty lines and comments. An error is reported with the
        number of the last line read.
    suffixes : tuple of str
        Suffixes for which `save` chooses this format, with their dot, in lower case.
    write : callable
        ``write(times, poses, file)`` writes times, shape (n,), and poses, shape (n, 4, 4), to an open binary file.

    Raises
    ------
    TypeError, ValueError
        If an argument is none of these.
    """
    validation.function("recognise", recognise, "a line", 1)
    validation.function("read", read, "lines", 1)
    validation.function("write", write, "times, poses and a file", 3)
    if not isinstance(suffixes, tuple):
        raise ArgumentTypeError("suffixes", "a tuple of suffixes", validation.short_repr(suffixes))
    for index, suffix in enumerate(suffixes):
        check_new_suffix(f"suffixes[{index}]", suffix)
    _FORMATS.append(_Format(name, looks, recognise, read, suffixes, write))


@dataclass(frozen=True, slots=True)
class _Tables:
    name: str
    recognise: Callable[[Path], bool]
    read: Callable[[Path, str | None], tuple[Floats, Floats]]


_TABLES: list[_Tables] = []


def register_trajectory_tables(
    name: str, recognise: Callable[[Path], bool], read: Callable[[Path, str | None], tuple[Floats, Floats]]
) -> None:
    """Let `Trajectory.load` read one more format of tables in several files.

    Parameters
    ----------
    name : str
        Name of the format in errors.
    recognise : callable
        ``recognise(path)`` returns whether a path is that of such a table.
    read : callable
        ``read(path, scene)`` returns the rising times, shape (n,), and the poses, shape (n, 4, 4), of a scene, or of
        the only one if `scene` is None.
    """
    _TABLES.append(_Tables(name, recognise, read))


def writer_of(path: PathLike) -> Callable[[Floats, Floats, BinaryIO], None]:
    """Return the function that writes the format of a suffix; `FileFormatError` if there is none."""
    forms = {suffix: form for form in _FORMATS for suffix in form.suffixes}
    return forms[check_suffix(path, forms)].write


def read_poses(path: PathLike, times: PathLike | npt.ArrayLike | None, scene: str | None) -> tuple[Floats, Floats]:
    """Return the times and poses of a file, as documented in `Trajectory.load`."""
    path = check_path(path)
    tables = next((tables for tables in _TABLES if tables.recognise(path)), None)
    if tables is not None:
        if times is not None:
            raise ArgumentValueError("times", f"none for {path}, which is {tables.name} and has its own", "some")
        return tables.read(path, scene)
    lines = LineReader(path)
    with lines.refusals():
        first = next(iter(lines), "")
        form = next((form for form in _FORMATS if form.recognise(first)), None)
        if form is None:
            kinds = "; ".join(f"{form.name}: {form.looks}" for form in _FORMATS)
            raise ValueError(f"expected poses ({kinds}), got {'something else' if first else 'nothing'}")
        own, poses = form.read(chain([first], lines))
    if scene is not None:
        raise ArgumentValueError("scene", f"none for {path}, which is {form.name}", validation.short_repr(scene))
    if own is not None:
        if times is not None:
            raise ArgumentValueError("times", f"none for {path}, which is {form.name} and has its own", "some")
        return lines.rising(array("times", own, ("n",))), poses
    if times is None:
        raise ArgumentValueError("times", f"those of {path}, since {form.name} has none of its own", "none")
    if isinstance(times, str | os.PathLike):
        lines = LineReader(times)
        with lines.refusals():
            stamps = np.array([numbers(line.split(), 1)[0] for line in lines])
        what, stamps = str(lines.path), lines.rising(stamps)
    else:
        what, stamps = "times", array("times", times, ("n",))
    if len(stamps) != len(poses):
        expected = f"{len(poses)} times, one for each pose of {path}"
        if what != "times":
            raise FileFormatError(f"{what}: expected {expected}, got {len(stamps)}")
        raise ArgumentValueError(what, expected, len(stamps))
    return stamps, poses
