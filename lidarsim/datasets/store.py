"""Stores of data sets: a folder or an object store, with atomic writes.

Files have relative names, with ``/`` between folders. Neither names nor links can lead outside.
"""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import stat
import sys
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Protocol

from lidarsim._base import files
from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, format_error
from lidarsim._base.validation import short
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError, LidarsimError

if sys.platform == "win32":
    fcntl = None
else:
    import fcntl

TEMPORARY = ".lidarsim-set-", ".tmp"
"""Prefix and suffix of the temporary folders at the top of a data set, in which files are written."""

LOCK = "lock"
"""File in such a folder, locked by its writer; the system releases the lock when the writer ends for any reason."""

_TEMPORARY = re.compile(r"\.lidarsim-set-[0-9a-f]{16}\.tmp")
_SCHEME = re.compile(r"(?:[A-Za-z0-9+.-]+::)*([A-Za-z][A-Za-z0-9+.-]+):/")
_UNSAFE = re.compile(r"[\x00-\x1f\x7f-\x9f\\:\ud800-\udfff]")
LONGEST_PATH, LONGEST_PART = 1000, 255

SYNCS = 8
"""Files flushed to disk at a time: one flush of the disk's cache then serves several."""


class Store(Protocol):
    """Files by name; it can be pickled."""

    def write(self, name: str, data: bytes) -> None:
        """Write a file; folders are created."""

    def create(self, name: str, data: bytes) -> bool:
        """Write a file unless it exists, and return whether it was written; of concurrent calls, one succeeds."""

    def writing(self, name: str) -> AbstractContextManager[Path]:
        """Yield the path of a local file, which becomes the file `name` when the block ends without an error."""

    def batch(self) -> AbstractContextManager[Store]:
        """Yield a store for writing, whose files may get their names only when the block ends without an error."""

    def open(self, name: str) -> BinaryIO:
        """Open a regular file for reading; `FileNotFoundError` if it does not exist."""

    def reading(self, name: str) -> AbstractContextManager[Path]:
        """Yield the path of a local file with the content of a regular file; `FileNotFoundError` as in `open`."""

    def sizes(self, folder: str) -> dict[str, int]:
        """Return the sizes of the files in a folder by name, in bytes; empty if it does not exist. "" is the top."""

    def existing(self, names: Collection[str]) -> list[str]:
        """Return the existing top-level names in `names`, ignoring case and empty folders."""

    def remove(self, name: str) -> None:
        """Remove a file if it exists."""

    def tidy(self) -> None:
        """Remove the remains of killed writers."""


def check_path(name: str) -> str:
    """Return the name of a file of a data set after checking it.

    Raises
    ------
    ValueError
        If it is no relative path, leads outside, or has unsafe characters.
    """
    parts = name.split("/")
    if (
        _UNSAFE.search(name)
        or not {"", ".", ".."}.isdisjoint(parts)
        or len(name.encode()) > LONGEST_PATH
        or max(len(part.encode()) for part in parts) > LONGEST_PART
    ):
        raise ValueError(f"expected the relative path of a file of the data set, got {short(ascii(name))}")
    return name


@dataclass(frozen=True)
class Folder:
    """A local folder.

    Files are written in temporary folders at the top, and moved to their places.
    """

    root: Path

    def write(self, name: str, data: bytes) -> None:
        """Write a file; folders are created."""
        with self.writing(name) as path:
            files.write(path, data)

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Yield the path of a local file to write."""
        with self._write_aside(name) as (path, target):
            yield path
            files.sync(path)
            path.replace(target)

    def create(self, name: str, data: bytes) -> bool:
        """Write a file unless it exists.

        Linking to a finished file is atomic, also over NFS. Where there are no links, a killed writer may leave a part
        of the file.
        """
        with self._write_aside(name) as (path, target):
            files.write(path, data)
            files.sync(path)
            try:
                os.link(path, target)
            except FileExistsError:
                return False
            except OSError as error:
                if error.errno not in {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}:
                    raise
                try:
                    with target.open("xb") as file:
                        file.write(data)
                except FileExistsError:
                    return False
            return True

    @contextmanager
    def batch(self) -> Iterator[Store]:
        """Yield a store whose files are flushed to disk and moved to their places when the block ends."""
        with ExitStack() as stack:
            with files.writing(self.root):
                folder = stack.enter_context(self._temporary())
            batch = _Batch(self.root, folder)
            yield batch
            batch.finish()

    @contextmanager
    def _write_aside(self, name: str) -> Iterator[tuple[Path, Path]]:
        """Yield the paths of a temporary file and of the file `name`, whose folder is created."""
        target = self._path(name)
        with files.writing(target), self._temporary() as folder:
            target.parent.mkdir(parents=True, exist_ok=True)
            yield folder / "written", target

    @contextmanager
    def _temporary(self) -> Iterator[Path]:
        """Make a temporary folder for the block, with its lock."""
        self.root.mkdir(parents=True, exist_ok=True)
        with files.temporary_folder(self.root, TEMPORARY) as folder, _lock(folder / LOCK, "xb"):
            try:
                yield folder
            finally:
                _empty(folder)

    def _path(self, name: str) -> Path:
        """Return the path of a file after checking that its folder is in the data set."""
        path = self.root / check_path(name)
        self._inside(path.parent)
        return path

    def _inside(self, path: Path) -> Path:
        """Resolve the links of a path, and check that it is in the data set."""
        real = Path(os.path.realpath(path))
        if not real.is_relative_to(os.path.realpath(self.root)):
            raise LidarsimError(f"{path}: expected it inside of the data set, got a link to {short(ascii(str(real)))}")
        return real

    def open(self, name: str) -> BinaryIO:
        """Open a regular file for reading."""
        path = self.root / check_path(name)
        # O_NONBLOCK: opening a pipe must not wait for a writer.
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        try:
            descriptor = os.open(self._inside(path), flags)
        except NotADirectoryError as error:
            raise FileNotFoundError(error.errno, error.strerror, error.filename) from error
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise FileFormatError(f"{path}: expected a regular file, got a folder, pipe or device")
        return os.fdopen(descriptor, "rb")

    @contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """Yield the path of a file, with its links resolved."""
        self.open(name).close()
        yield self._inside(self.root / name)

    def sizes(self, folder: str) -> dict[str, int]:
        """Return the sizes of the files in a folder; a link counts as its file, unless it leads outside."""
        path = self.root / check_path(folder) if folder else self.root
        found: dict[str, int] = {}
        try:
            with os.scandir(self._inside(path)) as entries:
                for entry in entries:
                    with suppress(LidarsimError, OSError):
                        real = self._inside(path / entry.name) if entry.is_symlink() else None
                        status = entry.stat() if real is None else real.stat()
                        if stat.S_ISREG(status.st_mode):
                            found[entry.name] = status.st_size
        except (FileNotFoundError, NotADirectoryError):
            pass
        return found

    def existing(self, names: Collection[str]) -> list[str]:
        """Return the existing top-level names in `names`."""
        lower = {name.lower() for name in names}
        try:
            there = sorted(self.root.iterdir())
        except FileNotFoundError:
            return []
        return [path.name for path in there if path.name.lower() in lower and not _is_empty_folder(path)]

    def remove(self, name: str) -> None:
        """Remove a file."""
        self._path(name).unlink(missing_ok=True)

    def tidy(self) -> None:
        """Remove the temporary folders whose writers have ended."""
        for path in self.root.iterdir():
            if _TEMPORARY.fullmatch(path.name) and path.is_dir() and not path.is_symlink():
                with suppress(OSError):  # its writer is at work, or it is not lidarsim's
                    if not any(path.iterdir()):
                        path.rmdir()
                    elif stat.S_ISREG((path / LOCK).lstat().st_mode):
                        with _lock(path / LOCK, "r+b"):
                            _empty(path)
                            shutil.rmtree(path, ignore_errors=True)

    def __str__(self) -> str:
        return str(self.root)


@dataclass(frozen=True)
class _Batch(Folder):
    """A folder whose new files stay in a temporary folder until all are written.

    Flushing them together takes a fraction of the time of one after the other, and one temporary folder serves all.
    """

    temporary: Path
    files: list[tuple[Path, Path]] = field(default_factory=list)
    """Path of each file, and the path that it gets."""

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Yield the path of a local file to write."""
        target = self._path(name)
        with files.writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            path = self.temporary / f"{len(self.files)}"
            self.files.append((path, target))
            yield path

    def finish(self) -> None:
        """Flush the files to disk, and then give them their names."""
        try:
            with ThreadPoolExecutor(SYNCS) as pool:
                for _ in pool.map(self._sync, self.files):
                    pass
        except RuntimeError:  # while the interpreter ends, as after Ctrl-C, no thread can be started
            for file in self.files:
                self._sync(file)
        for path, target in self.files:
            with files.writing(target):
                path.replace(target)

    @staticmethod
    def _sync(file: tuple[Path, Path]) -> None:
        path, target = file
        with files.writing(target):
            files.sync(path)


def _empty(folder: Path) -> None:
    """Remove everything from a temporary folder but its lock.

    The lock must go last: a folder with files but no lock is not lidarsim's, so a kill in between would leave it for
    good.
    """
    with suppress(OSError):  # another call removes it, too
        for path in folder.iterdir():
            if path.name != LOCK:
                path.unlink()


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink() and next(path.iterdir(), None) is None


@contextmanager
def _lock(path: Path, mode: str) -> Iterator[None]:
    """Hold the lock of a temporary folder; `OSError` if another process holds it.

    Where files cannot be locked, the writer is assumed to have ended. That is safe: folders are removed only when the
    data set is complete, and a late writer has nothing to add.
    """
    with path.open(mode) as file:
        if fcntl:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno in {errno.EWOULDBLOCK, errno.EACCES}:
                    raise
        yield


@dataclass(frozen=True)
class Remote:
    """A place that fsspec knows, such as ``s3://bucket/folder``; one put makes a file, so it is always complete."""

    url: str

    @property
    def _place(self) -> tuple[Any, str]:
        fsspec = import_extra("fsspec", "cluster", f"writing to {self.url}")
        with self._problems():
            filesystem, root = fsspec.core.url_to_fs(self.url)
        return filesystem, root.rstrip("/")

    def _file(self, name: str) -> tuple[Any, str]:
        """Return the file system, and the path of a file or folder in it."""
        check_path(name)
        filesystem, root = self._place
        return filesystem, f"{root}/{name}"

    @contextmanager
    def _problems(self) -> Iterator[None]:
        """Turn errors of libraries into an `OSError` that names the URL, in one line."""
        try:
            yield
        except ImportError as error:
            raise LidarsimError(f"{self.url}: {format_error(error)}") from error
        except (FileNotFoundError, FileExistsError, LidarsimError):
            raise
        except Exception as error:
            raise OSError(f"{self.url}: {format_error(error)}") from error

    def write(self, name: str, data: bytes) -> None:
        """Write a file."""
        filesystem, path = self._file(name)
        with self._problems():
            filesystem.pipe_file(path, data)

    def create(self, name: str, data: bytes) -> bool:
        """Write a file unless it exists, by a conditional put.

        In a store without conditional puts, two simultaneous calls may both find no file.
        """
        filesystem, path = self._file(name)
        with self._problems():
            filesystem.invalidate_cache()
            if filesystem.exists(path):
                return False
            try:
                filesystem.pipe_file(path, data, mode="create")
            except FileExistsError:
                return False
            except Exception as error:  # the type depends on the library
                if _is_unmet(error):
                    return False
                if not _is_unknown(error):
                    raise
                filesystem.pipe_file(path, data)
        with self.open(name) as file:
            return file.read(len(data) + 1) == data

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Yield the path of a local file to write."""
        filesystem, path = self._file(name)
        with TemporaryDirectory(prefix="lidarsim-") as folder:
            local = Path(folder, Path(name).name)
            yield local
            with self._problems():
                filesystem.put_file(str(local), path)

    @contextmanager
    def batch(self) -> Iterator[Store]:
        """Yield this store: one put makes a file, whatever happens to others."""
        yield self

    def open(self, name: str) -> BinaryIO:
        """Open a file for reading."""
        filesystem, path = self._file(name)
        with self._problems():
            file: Any = filesystem.open(path, "rb")
        return io.BufferedReader(file)

    @contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """Yield the path of a local copy."""
        with TemporaryDirectory(prefix="lidarsim-") as folder, self.open(name) as file:
            local = Path(folder, Path(name).name)
            with local.open("wb") as copy:
                shutil.copyfileobj(file, copy)
            yield local

    def sizes(self, folder: str) -> dict[str, int]:
        """Return the sizes of the files in a folder."""
        listed = self._list(*(self._file(folder) if folder else self._place))
        return {entry["name"].rpartition("/")[2]: entry["size"] for entry in listed if entry["type"] == "file"}

    def _list(self, filesystem: Any, path: str) -> list[dict[str, Any]]:
        with self._problems():
            filesystem.invalidate_cache()
            try:
                found: list[dict[str, Any]] = filesystem.ls(path, detail=True)
            except FileNotFoundError:
                return []
        return found

    def existing(self, names: Collection[str]) -> list[str]:
        """Return the existing top-level names in `names`."""
        lower = {name.lower() for name in names}
        there = {entry["name"].rstrip("/").rpartition("/")[2] for entry in self._list(*self._place)}
        return sorted(name for name in there if name.lower() in lower)

    def remove(self, name: str) -> None:
        """Remove a file."""
        filesystem, path = self._file(name)
        with self._problems(), suppress(FileNotFoundError):
            filesystem.rm_file(path)

    def tidy(self) -> None:
        """Do nothing: an interrupted put leaves nothing behind."""

    def __str__(self) -> str:
        return self.url


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and what caused it, one after the other."""
    while error is not None:
        yield error
        error = error.__cause__


def _code(error: BaseException) -> str | None:
    """Return the code by which S3's clients tell what is wrong."""
    response = getattr(error, "response", None)
    return response.get("Error", {}).get("Code") if isinstance(response, dict) else None


def _is_unmet(error: BaseException) -> bool:
    """Return whether a store reports that the condition of a put is not met."""
    codes = {"PreconditionFailed", "ConditionalRequestConflict"}
    return any(_code(one) in codes or getattr(one, "errno", 0) == errno.EEXIST for one in causes(error))


def _is_unknown(error: BaseException) -> bool:
    """Return whether a store reports that it does not support conditional puts."""
    return any(
        isinstance(one, NotImplementedError | TypeError) or _code(one) == "NotImplemented" for one in causes(error)
    )


def open_store(output: PathLike, argument: str = "output") -> Store:
    """Return the store at a path or URL, the argument of this name.

    Raises
    ------
    TypeError, ValueError
        If `output` is neither text nor a path, or is a URL that is not text.
    """
    text = os.fspath(output) if isinstance(output, str | os.PathLike) else None
    if not isinstance(text, str):
        raise ArgumentTypeError(argument, "a folder or a URL as text, or a path", short(ascii(output)))
    if not text or "\0" in text:
        raise ArgumentValueError(argument, "a folder or a URL", short(ascii(text)))
    scheme = _SCHEME.match(text)
    if scheme and (not text.startswith("://", scheme.end(1)) or not isinstance(output, str)):
        raise ArgumentValueError(
            argument, "a folder, or a URL as text with two slashes, such as 's3://bucket/folder'", short(ascii(output))
        )
    if scheme and scheme[1].lower() != "file":
        return Remote(text)
    if not scheme:
        return Folder(Path(text).absolute())
    path = Path(text[len("file://") :])
    if not path.is_absolute():
        raise ArgumentValueError(argument, "an absolute path after file://", short(ascii(text)))
    return Folder(path)
