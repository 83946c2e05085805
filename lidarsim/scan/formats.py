"""Registry of the files of point clouds."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from lidarsim._base.files import PathLike, check_folder, check_new_suffix, check_suffix
from lidarsim._base.validation import function, short_repr
from lidarsim.errors import ArgumentTypeError, FileFormatError
from lidarsim.scan.fields import Fields


@dataclass(frozen=True, slots=True)
class Format:
    """How files of a format are written and read; `register_format` says what its functions take."""

    save: Callable[..., None]
    load: Callable[[BinaryIO], Fields]
    signature: bytes


def options_of(written: Format) -> set[str]:
    """Return the names of the options of a format's `save`."""
    return set(inspect.signature(written.save).parameters)


HEAD = 16
"""Bytes at the start of a file, enough for any signature."""
FORMATS: dict[str, Format] = {}
_UNREAD: dict[str, tuple[str, tuple[bytes, ...]]] = {}


def register_format(
    suffix: str,
    *,
    save: Callable[..., None],
    load: Callable[[BinaryIO], Fields],
    signature: bytes = b"",
) -> None:
    """Let `PointCloud.save` and `PointCloud.load` handle files with a suffix.

    Parameters
    ----------
    suffix : str
        With its dot, in lower case; it may have several parts, such as ".pcd.bin".
    save : callable
        ``save(fields, file)`` writes the fields of a cloud, in order, to an open binary file. A format that can hold
        the pose from `PointCloud.save` takes it as the keyword `pose`: a 4×4 array, or None; a format that can hold
        class names takes them as the keyword `class_names`. A format takes the other arguments of `PointCloud.save`,
        `float32`, `crs` and `start`, under their names; `xyz` is already in the type that `float32` asks for.
    load : callable
        ``load(file)`` returns the fields in an open binary file, by any names, and class names, if there are any, as
        ``"class_names"``; the message of any exception becomes the reason in the error. A format whose files need not
        name their columns takes the names given to `PointCloud.load` as the keyword `columns`: a list, or None.
    signature : bytes
        First bytes of every file of the format, which identify it whatever its name; empty if there are none.

    Raises
    ------
    TypeError, ValueError
        If an argument is none of these.
    """
    check_new_suffix("suffix", suffix)
    function("save", save, "fields and a file", 2)
    function("load", load, "a file", 1)
    if not isinstance(signature, bytes):
        raise ArgumentTypeError("signature", "bytes", short_repr(signature))
    FORMATS[suffix] = Format(save, load, signature)


def register_unread(suffix: str, problem: str, *signatures: bytes) -> None:
    """Let `PointCloud.load` say what to do with files of a format that it does not read.

    Parameters
    ----------
    suffix : str
        With its dot, in lower case.
    problem : str
        What is not read, and what to do: the error for such a file.
    *signatures : bytes
        First bytes of files of the format, which identify it whatever its name.
    """
    _UNREAD[suffix] = problem, signatures


def check_output(path: PathLike, others: Collection[str] = ()) -> None:
    """Check, before any work, that `PointCloud.save` can write a file: a known suffix and a writable folder.

    Parameters
    ----------
    path : path-like
        The file to write.
    others : collection of str
        Other suffixes, which the caller writes itself.

    Raises
    ------
    FileFormatError
        If the suffix is unknown.
    OSError
        If the folder does not exist or is not writable.
    """
    check_suffix(path, {*FORMATS, *others})
    if Path(path).name.lower().endswith(".copc.laz"):
        raise FileFormatError(f"{path}: COPC, which is LAZ sorted into an octree, cannot be written; name it .laz")
    check_folder(path)


def is_point_cloud(path: PathLike) -> bool:
    """Return whether the suffix of a file belongs to a format that `PointCloud.load` reads."""
    return any(Path(path).name.lower().endswith(suffix) for suffix in FORMATS)


def format_of(path: PathLike) -> Format:
    """Return the format of a suffix; `FileFormatError` if there is none."""
    return FORMATS[check_suffix(path, FORMATS)]


def recognise(head: bytes, path: Path) -> str:
    """Return the suffix of a file's format, from its first bytes or else from its name."""
    told = {suffix for suffix, format_ in FORMATS.items() if format_.signature and head.startswith(format_.signature)}
    own = path.suffix.lower()
    if told:
        return own if own in told else min(told)
    for suffix, (problem, signatures) in _UNREAD.items():
        if head.startswith(signatures) or own == suffix:
            raise FileFormatError(f"{path}: {problem}")
    return check_suffix(path, FORMATS)
