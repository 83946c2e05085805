"""The files of a ROS 2 bag, written by rosbags: one file, or a folder as ``ros2 bag record`` writes it.

A folder ``drive`` has ``drive_0.mcap``, ``drive_1.mcap`` and so on, one after the other in time, and ``metadata.yaml``,
which lists them with the topics and numbers of messages. Its `custom_data` says that lidarsim wrote it: only such a
folder is replaced.

A recorder may compress each file (``.mcap.zstd``, ``.db3.zstd``) or each message by Zstandard. Both are told from their
first bytes, with which neither a bag nor a message in CDR begins.

Format: https://github.com/ros2/rosbag2 (rosbag2_storage, metadata_io.cpp).
"""

from __future__ import annotations

import os
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from lidarsim import _native
from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, parsing, reading, replacing, sync, temporary_folder, writing
from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError
from lidarsim.io import _mcap
from lidarsim.io._records import check_expansion, expansion_limit, zstd

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, Qos
    from rosbags.typesys.store import Typestore

METADATA = "metadata.yaml"
VERSION = 8
"""Version of the metadata. From version 9 on QoS settings are names, which readers before ROS Jazzy do not know."""

WRITTEN_BY = "lidarsim"
"""Key of `custom_data` by which a folder is known as one of ours."""

ZSTD = ".zstd"
"""Suffix of a compressed file, after that of the bag."""

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_BLOCK = 1 << 20

LONGEST = 1 << 20
"""Maximum bytes of metadata that are read; those of 1,000 files have 300 kB."""

Metadata = dict[str, Any]


class Files:
    """Write messages into the files ``<stem>_0<suffix>`` and so on of an existing folder.

    A new file begins after `max_size` bytes of messages, or `max_duration` ns after the first message of a file.
    """

    def __init__(
        self,
        folder: Path,
        stem: str,
        suffix: str,
        ros: Typestore,
        *,
        max_size: int | None = None,
        max_duration: int | None = None,
    ) -> None:
        self._folder, self._stem, self._suffix, self._ros = folder, stem, suffix, ros
        self._max_size, self._max_duration = max_size, max_duration
        self._bag: Any = None
        self._topics: dict[str, Connection] = {}
        self._latched: dict[str, tuple[str, bytes | memoryview]] = {}
        self._begin = self._size = 0
        self.written: list[Path] = []
        self.metadata: list[Metadata] = []
        self._open()

    def write(self, topic: str, kind: str, stamp: int, data: bytes | memoryview, *, latched: bool = False) -> None:
        """Write a message; a latched one is repeated at the start of each later file."""
        too_large = self._max_size is not None and self._size >= self._max_size
        too_long = self._max_duration is not None and stamp - self._begin >= self._max_duration
        if self._topics and (too_large or too_long):
            self.close()
            self._open()
            for name, (of, message) in self._latched.items():
                self._write(name, of, stamp, message, latched=True)
        if latched:
            self._latched[topic] = kind, data
        self._write(topic, kind, stamp, data, latched=latched)

    def _write(self, topic: str, kind: str, stamp: int, data: bytes | memoryview, *, latched: bool) -> None:
        if not self._topics:
            self._begin = stamp
        if topic not in self._topics:
            qualities = [_quality(latched=latched)]
            self._topics[topic] = self._bag.add_connection(
                topic, kind, typestore=self._ros, offered_qos_profiles=qualities
            )
        self._bag.write(self._topics[topic], stamp, data)
        self._size += len(data)

    def _open(self) -> None:
        rosbag2 = import_extra("rosbags.rosbag2", "formats", "writing ROS bags")
        mcap, sqlite = rosbag2.StoragePlugin.MCAP, rosbag2.StoragePlugin.SQLITE3
        bag = rosbag2.Writer(
            self._folder / f"{self._stem}_{len(self.written)}",
            version=VERSION,
            storage_plugin=mcap if self._suffix == ".mcap" else sqlite,
        )
        bag.STORAGE_PLUGINS = {**bag.STORAGE_PLUGINS, mcap: _mcap.storage()}
        bag.open()
        self._bag, self._topics, self._size = bag, {}, 0

    def close(self) -> None:
        """Complete the current file."""
        self._bag.close()
        folder = self._bag.path
        (written,) = folder.glob(f"*{self._suffix}")
        self.metadata.append(_parse((folder / METADATA).read_bytes()))
        self.written.append(written.replace(self._folder / written.name))
        (folder / METADATA).unlink()
        folder.rmdir()
        self._bag = None

    def abort(self) -> None:
        """Close the current file as it is."""
        if self._bag is not None:
            with suppress(Exception):
                self._bag.abort()


@contextmanager
def new_file(path: PathLike, suffix: str, ros: Typestore) -> Iterator[Files]:
    """Yield the writer of one file, which is renamed to `path` when the block ends without an error."""
    with replacing(path) as temporary, lost_writes():
        files = Files(temporary.parent, "bag", suffix, ros)
        try:
            yield files
            files.close()
            files.written[0].replace(temporary)
        finally:
            files.abort()


@contextmanager
def new_folder(path: PathLike, ros: Typestore, **limits: int | None) -> Iterator[Files]:
    """Yield the writer of a folder, which gets its name when the block ends without an error; see `Files`."""
    check_folder(path)
    target = Path(os.path.realpath(path))
    with writing(path), temporary_folder(target.parent) as temporary, lost_writes():
        made, old = temporary / "written", temporary / "replaced"
        made.mkdir()
        files = Files(made, target.name, ".mcap", ros, **limits)
        try:
            yield files
            files.close()
        finally:
            files.abort()
        (made / METADATA).write_bytes(metadata_of(files.metadata))
        for file in made.iterdir():
            sync(file)
        if target.exists():
            target.replace(old)
        try:
            if old.exists():
                _check_ours(old, path)  # nobody can put a file into it any more
            made.replace(target)
        except BaseException:
            if old.exists():
                old.replace(target)
            raise


def is_folder(path: PathLike) -> bool:
    """Return whether a bag of this path is a folder: it has no suffix, or ends in /."""
    return os.fspath(path).endswith(("/", os.sep)) or not Path(path).suffix


def check_folder(path: PathLike) -> None:
    """Raise an error, before any work, unless a bag can become the folder `path`."""
    place = Path(path)
    if not place.name or place.suffix:
        raise FileFormatError(f"{path}: expected the name of a folder for a bag, without a dot")
    if not place.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {place.parent} does not exist")
    if not os.access(place.parent, os.W_OK | os.X_OK):
        raise PermissionError(f"{path}: no permission to write in the folder {place.parent}")
    if place.exists():
        if not place.is_dir():
            raise FileExistsError(f"{path}: expected the name of a folder for a bag, got a file")
        _check_ours(place, path)


def _check_ours(folder: Path, path: PathLike) -> None:
    """Raise `OSError`, naming `path`, if a folder has something that lidarsim did not write."""
    names = sorted(entry.name for entry in folder.iterdir())
    known: set[str] = set()
    with suppress(FileFormatError, OSError):
        metadata = _read(folder / METADATA)
        if WRITTEN_BY in (metadata.get("custom_data") or {}):
            known = {METADATA, *_names(metadata)}
    for name in names:
        if name not in known or (folder / name).is_symlink() or not (folder / name).is_file():
            expected = "expected a new folder, or one with a bag that lidarsim wrote"
            raise FileExistsError(f"{path}: {expected}, got one with {name!a}; remove it or choose another name")


def list_files(folder: Path) -> list[Path]:
    """Return the files of a bag in the order of its metadata, after checking that they are files in its folder."""
    with parsing(folder, "ROS 2 bag"):
        metadata = _read(folder / METADATA)
        compression = metadata.get("compression_format") or "zstd"
        if str(metadata.get("compression_mode", "none")).lower() not in {"", "none"} and compression != "zstd":
            raise FileFormatError(f"it is compressed by {short(ascii(compression))}, expected zstd or no compression")
        paths = [folder / name for name in _names(metadata)]
        for path in paths:
            if not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
                raise FileFormatError(f"its {METADATA} lists {path.name!a}, which is no file in it")
    return paths


@contextmanager
def plain_file(path: Path) -> Iterator[Path]:
    """Yield the path of a file or, if it is compressed as a whole, of its content in a temporary one."""
    with reading(path), path.open("rb") as file:
        is_compressed = file.read(len(_ZSTD_MAGIC)) == _ZSTD_MAGIC
        size = os.fstat(file.fileno()).st_size
    if not is_compressed:
        yield path
        return
    with TemporaryDirectory() as folder:
        plain = Path(folder, "bag.db3")
        with zstd().open(path) as source, plain.open("wb") as target:
            while block := source.read(_BLOCK):
                check_expansion(target.tell() + len(block), size)
                target.write(block)
        yield plain


def decompress(message: memoryview) -> memoryview:
    """Return the bytes of a message, which may be compressed."""
    if message[: len(_ZSTD_MAGIC)] != _ZSTD_MAGIC:
        return message
    decompressor = zstd().ZstdDecompressor()
    data: bytes = decompressor.decompress(message, max_length=expansion_limit(len(message)) + 1)
    check_expansion(len(data), len(message))
    if not decompressor.eof:
        raise FileFormatError("a compressed message is truncated")
    return memoryview(data)


def check_tables(path: Path) -> None:
    """Raise an error if a database computes what it seems to hold, of any size, by a view or a generated column."""
    computed = """
        SELECT name FROM sqlite_master AS made WHERE type = 'view' OR sql LIKE 'create virtual%'
        OR EXISTS (SELECT 1 FROM pragma_table_xinfo(made.name) WHERE hidden > 0)
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        found = database.execute(computed).fetchone()
    if found:
        raise FileFormatError(f"its table {short(repr(found[0]))} computes rows; expected tables that hold them")


def _read(path: Path) -> Metadata:
    with reading(path), path.open("rb") as file:
        data = file.read(LONGEST + 1)
    if len(data) > LONGEST:
        raise FileFormatError(f"its {METADATA} is longer than {LONGEST:,} bytes")
    return _parse(data)


def _parse(data: bytes) -> Metadata:
    """Return the information in the bytes of metadata."""
    import yaml

    try:
        found = yaml.safe_load(data)["rosbag2_bagfile_information"]
    except (yaml.YAMLError, TypeError, KeyError, RecursionError, ValueError):
        found = None
    if not isinstance(found, dict):
        raise FileFormatError(f"its {METADATA} has no rosbag2_bagfile_information")
    return found


def _names(metadata: Metadata) -> list[str]:
    """Return the names of the files of a bag."""
    names = metadata.get("relative_file_paths")
    if not isinstance(names, list) or not names:
        raise FileFormatError(f"its {METADATA} lists no files")
    for name in names:
        if not isinstance(name, str) or Path(name).name != name or "\\" in name or "\0" in name:
            raise FileFormatError(
                f"its {METADATA} lists {ascii(name)[:100]}, expected the name of a file in the folder"
            )
    return names


def rename(metadata: Metadata, name: str) -> Metadata:
    """Return the metadata of a bag of one file under another name of the file."""
    return {**metadata, "relative_file_paths": [name], "files": [{**metadata["files"][0], "path": name}]}


def metadata_of(parts: list[Metadata]) -> bytes:
    """Return the bytes of ``metadata.yaml`` from the metadata that were noted of each file of a bag, in order."""
    import yaml

    try:
        whole = {**_merge(parts), "custom_data": {WRITTEN_BY: _native.__version__}}
    except (KeyError, TypeError, IndexError, AttributeError):
        raise FileFormatError("the notes on the files of a bag are damaged") from None
    return yaml.safe_dump({"rosbag2_bagfile_information": whole}, sort_keys=False).encode()


def _merge(parts: list[Metadata]) -> Metadata:
    """Return the metadata of a bag of several files from those of each; files without messages have no time."""
    topics: dict[str, Any] = {}
    counts: Counter[str] = Counter()
    for topic in (topic for part in parts for topic in part["topics_with_message_count"]):
        topics.setdefault(topic["topic_metadata"]["name"], topic["topic_metadata"])
        counts[topic["topic_metadata"]["name"]] += topic["message_count"]
    files = [file for part in parts for file in part["files"]]
    spans = [
        (file["starting_time"]["nanoseconds_since_epoch"], file["duration"]["nanoseconds"])
        for file in files
        if file["message_count"]
    ]
    start = min((begin for begin, _ in spans), default=0)
    return {
        **parts[0],
        "relative_file_paths": [file["path"] for file in files],
        "duration": {"nanoseconds": max(map(sum, spans), default=start) - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file["message_count"] for file in files),
        "topics_with_message_count": [
            {"topic_metadata": topic, "message_count": counts[name]} for name, topic in topics.items()
        ],
        "files": files,
    }


@contextmanager
def lost_writes() -> Iterator[None]:
    """Turn SQLite's own error into the `OSError` that it hides."""
    try:
        yield
    except sqlite3.Error as error:
        raise OSError(str(error)) from error


def _quality(*, latched: bool) -> Qos:
    """Return the QoS of a topic: reliable; a latched topic also reaches late subscribers."""
    ros = import_extra("rosbags.interfaces", "formats", "writing ROS bags")
    never = ros.QosTime(0, 0)
    quality: Qos = ros.Qos(
        ros.QosHistory.KEEP_LAST,
        1 if latched else 10,
        ros.QosReliability.RELIABLE,
        ros.QosDurability.TRANSIENT_LOCAL if latched else ros.QosDurability.VOLATILE,
        never,
        never,
        ros.QosLiveliness.AUTOMATIC,
        never,
        False,
    )
    return quality
