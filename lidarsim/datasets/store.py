"""Where a data set goes: a folder, or an object store. A file is there complete, or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Protocol

from lidarsim._extras import import_extra
from lidarsim._files import TEMPORARY, PathLike, atomic_writer, replacing

__all__ = ["Store", "open_store"]


class Store(Protocol):
    """Files by their names, with ``/`` between folders. It can be pickled."""

    def write(self, name: str, data: bytes) -> None:
        """Write a file; folders are made."""

    def writing(self, name: str) -> AbstractContextManager[Path]:
        """Give the path of a local file to write, which becomes the file `name` when the block ends well."""

    def open(self, name: str) -> BinaryIO:
        """Open a file to read; `FileNotFoundError` if there is none."""

    def names(self, folder: str) -> set[str]:
        """Return the names of the files in a folder; none if there is no folder."""

    def remove(self, folder: str) -> None:
        """Remove a folder and all in it, if it is there."""

    def tidy(self) -> None:
        """Remove what killed writers have left behind."""


@dataclass(frozen=True)
class Folder:
    """A folder of this machine."""

    root: Path

    def write(self, name: str, data: bytes) -> None:
        """Write a file; folders are made."""
        with atomic_writer(self._path(name)) as file:
            file.write(data)

    def writing(self, name: str) -> AbstractContextManager[Path]:
        """Give the path of a local file to write."""
        return replacing(self._path(name))

    def _path(self, name: str) -> Path:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def open(self, name: str) -> BinaryIO:
        """Open a file to read."""
        return (self.root / name).open("rb")

    def names(self, folder: str) -> set[str]:
        """Return the names of the files in a folder."""
        path = self.root / folder
        return {entry.name for entry in path.iterdir() if entry.is_file()} if path.is_dir() else set()

    def remove(self, folder: str) -> None:
        """Remove a folder and all in it."""
        if (self.root / folder).is_dir():
            shutil.rmtree(self.root / folder)

    def tidy(self) -> None:
        """Remove the folders that `replacing` makes."""
        for path in self.root.rglob(f"{TEMPORARY[0]}*{TEMPORARY[1]}"):
            shutil.rmtree(path, ignore_errors=True)

    def __str__(self) -> str:
        return str(self.root)


@dataclass(frozen=True)
class Remote:
    """A place that fsspec knows, such as ``s3://bucket/folder``; a file is made by one put, so it is complete."""

    url: str

    @property
    def _place(self) -> tuple[Any, str]:
        fsspec = import_extra("fsspec", "cluster", f"writing to {self.url}")
        filesystem, root = fsspec.core.url_to_fs(self.url)
        return filesystem, root.rstrip("/")

    def write(self, name: str, data: bytes) -> None:
        """Write a file."""
        filesystem, root = self._place
        filesystem.pipe_file(f"{root}/{name}", data)

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Give the path of a local file to write."""
        with TemporaryDirectory(prefix="lidarsim-") as folder:
            path = Path(folder, Path(name).name)
            yield path
            filesystem, root = self._place
            filesystem.put_file(str(path), f"{root}/{name}")

    def open(self, name: str) -> BinaryIO:
        """Open a file to read."""
        filesystem, root = self._place
        file: BinaryIO = filesystem.open(f"{root}/{name}", "rb")
        return file

    def names(self, folder: str) -> set[str]:
        """Return the names of the files in a folder."""
        filesystem, root = self._place
        filesystem.invalidate_cache()
        try:
            found = filesystem.ls(f"{root}/{folder}", detail=True)
        except FileNotFoundError:
            return set()
        return {entry["name"].rpartition("/")[2] for entry in found if entry["type"] == "file"}

    def remove(self, folder: str) -> None:
        """Remove a folder and all in it."""
        filesystem, root = self._place
        if self.names(folder):
            filesystem.rm(f"{root}/{folder}", recursive=True)

    def tidy(self) -> None:
        """Do nothing: an interrupted put leaves nothing behind."""

    def __str__(self) -> str:
        return self.url


def open_store(output: PathLike) -> Store:
    """Return the place that a path or a URL names."""
    text = str(output)
    if "://" in text and not text.startswith("file://"):
        return Remote(text)
    return Folder(Path(text.removeprefix("file://")).absolute())
