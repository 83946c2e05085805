"""Files: written whole or not at all, and what is said of those that cannot be read."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from lidarsim.errors import FileFormatError

PathLike = str | os.PathLike[str]


def check_suffix(path: PathLike, known: Collection[str]) -> str:
    """Return the longest of the `known` suffixes that the name of `path` ends in, whatever its case."""
    name = Path(path).name.lower()
    fitting = [suffix for suffix in known if name.endswith(suffix) and name != suffix]
    if not fitting:
        suffix = Path(path).suffix.lower()
        what = f"unknown extension {suffix!r}" if suffix else "no extension"
        *others, last = sorted(known)
        raise FileFormatError(f"{path}: {what}, expected {', '.join(others)}{' or ' if others else ''}{last}")
    return max(fitting, key=len)


def check_folder(path: PathLike) -> None:
    """Raise `OSError` unless a file `path` can be written as far as its folder goes: it exists and lets us write."""
    path = Path(path)
    folder = path.parent
    if path.is_dir():
        raise IsADirectoryError(f"{path}: expected a file to write, got a folder")
    if not folder.exists():
        raise FileNotFoundError(f"{path}: the folder {folder} does not exist")
    if not folder.is_dir():
        raise NotADirectoryError(f"{path}: {folder} is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{path}: no permission to write in the folder {folder}")


@contextmanager
def atomic_writer(path: PathLike) -> Iterator[BinaryIO]:
    """Open a binary file that takes the name `path` when the block ends well; else `path` stays as it was.

    Raises
    ------
    OSError
        If the file cannot be written; the message names `path`.
    """
    check_folder(path)
    target = Path(path).resolve()  # a link keeps pointing to its file
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())  # the content is on disk before the name is
        temporary.replace(target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(f"{path}: cannot be written: {error.strerror or error}") from error
        raise


@contextmanager
def parsing(path: PathLike, kind: str) -> Iterator[None]:
    """Let parsers of a file fail as they will, and raise a `FileFormatError` of one line that names the file.

    A missing package, and a disk that cannot be read, pass as they are; not so a seek to where no file has bytes, which
    is what a damaged file claims.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, ImportError) or (isinstance(error, OSError) and error.errno != errno.EINVAL):
            raise
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise FileFormatError(f"{path}: not a readable {kind}: {reason}") from error
