"""Atomic file writes, checks of paths and names, and errors for unreadable files."""

from __future__ import annotations

import errno
import math
import os
import re
import shutil
import stat
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryDirectory, gettempdir
from types import TracebackType
from typing import IO, Any, BinaryIO, Self, TypeVar
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import short, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError, LidarsimError, MissingExtraError

PathLike = str | os.PathLike[str]
Item = TypeVar("Item")

TEMPORARY = ".lidarsim-", ".tmp"
"""Prefix and suffix of temporary folders, in which files are written before they are moved into place."""

NAME_LENGTH = 64
"""Maximum length of a name within a path; the resulting file names fit all file systems and USTAR."""

_UNWRITTEN = ": cannot be written: "
_NAME = re.compile(r"[A-Za-z0-9_-]+")
_DEVICE = re.compile(r"CON|PRN|AUX|NUL|(?:COM|LPT)[0-9]", re.IGNORECASE)

LONGEST = 1000
"""Maximum length of an error message, which may quote the content of a file."""

_noting: ContextVar[tuple[set[Path], ...]] = ContextVar("_noting", default=())
"""The paths noted by each enclosing `noting_reads`."""


def check_suffix(path: PathLike, known: Collection[str]) -> str:
    """Return the longest of the `known` suffixes that the name of `path` ends with, ignoring case."""
    name = check_path(path).name.lower()
    fitting = [suffix for suffix in known if name.endswith(suffix) and name != suffix]
    if not fitting:
        suffix = Path(path).suffix.lower()
        what = f"unknown extension {suffix!r}" if suffix else "no extension"
        *others, last = sorted(known)
        raise FileFormatError(f"{path}: {what}, expected {', '.join(others)}{' or ' if others else ''}{last}")
    return max(fitting, key=len)


def check_new_suffix(argument: str, suffix: object) -> None:
    """Check a suffix to register: `check_suffix` compares it with the end of a name in lower case."""
    expected = "a suffix with its dot, in lower case, such as .pcd"
    if not isinstance(suffix, str):
        raise ArgumentTypeError(argument, expected, short_repr(suffix))
    if not re.fullmatch(r"(\.[^./\\]+)+", suffix) or suffix != suffix.lower():
        raise ArgumentValueError(argument, expected, short_repr(suffix))


def name_problem(name: str) -> str:
    """Return what is expected of a name that cannot be part of a path on some file system, or "" if it can."""
    if not _NAME.fullmatch(name):
        return "a name of letters, digits, _ and -"
    if len(name) > NAME_LENGTH:
        return f"a name of at most {NAME_LENGTH} characters"
    return "another name than that of a Windows device" if _DEVICE.fullmatch(name) else ""


def natural(text: str) -> list[tuple[int, str]]:
    """Return a key by which names are sorted as people count: 2 before 10."""
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"([0-9]+)", text) if part]


def check_name(argument: str, name: str) -> str:
    """Return `name`; raise `ValueError` if it cannot be part of a path."""
    if expected := name_problem(name):
        raise ArgumentValueError(argument, expected, short(ascii(name)))
    return name


def check_names(argument: str, names: Iterable[str]) -> None:
    """Raise `ValueError` unless each name passes `check_name` and no two names differ only in case."""
    seen: dict[str, str] = {}
    for name in names:
        other = seen.setdefault(check_name(argument, name).lower(), name)
        if other != name:
            raise ArgumentValueError(argument, "names that differ in more than case", f"{other!r} and {name!r}")


@contextmanager
def noting_reads() -> Iterator[set[Path]]:
    """Note the real paths of the files that the block reads: every reader gives them to `check_regular` or `beside`."""
    found: set[Path] = set()
    token = _noting.set((*_noting.get(), found))
    try:
        yield found
    finally:
        _noting.reset(token)


def _note(path: PathLike) -> None:
    for found in _noting.get():
        found.add(Path(os.path.realpath(path)))


def check_regular(path: PathLike) -> None:
    """Raise an error if `path`, a file to read, cannot be opened, or is a folder, a pipe or a device.

    A pipe or device may be endless and not be readable twice.
    """
    with reading(path):
        if _special(path):
            raise FileFormatError(f"{path}: expected a regular file, got a pipe or device")
        Path(path).open("rb").close()
    _note(path)


def check_folder(path: PathLike) -> None:
    """Raise `OSError` if `path` is a folder, or if its parent folder does not exist or is not writable."""
    path = Path(path)
    folder = path.parent
    if path.is_dir():
        raise IsADirectoryError(f"{path}: expected a file to write, got a folder")
    if not folder.exists():
        raise FileNotFoundError(f"{path}: the folder {folder} does not exist")
    if not folder.is_dir():
        raise NotADirectoryError(f"{path}: {folder} is not a folder")
    if not _special(path) and not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{path}: no permission to write in the folder {folder}")


@contextmanager
def atomic_writer(path: PathLike) -> Iterator[BinaryIO]:
    """Open a binary file that replaces `path` if the block succeeds; otherwise `path` is left unchanged.

    Raises
    ------
    OSError
        If the file cannot be written; the message names `path`.
    """
    with replacing(path) as temporary, temporary.open("xb") as file:
        yield file


@contextmanager
def replacing(path: PathLike) -> Iterator[Path]:
    """Yield the path of a temporary file, in a folder of its own, that replaces `path` if the block succeeds.

    The folder is removed however the block ends; SIGTERM ends the process at once unless it has a handler, as the
    command line sets. A replaced file passes on its permissions; a link keeps pointing to its file, and a pipe or
    device receives the content.

    Raises
    ------
    OSError
        If the file cannot be written, or if the block raises an `OSError`; the message names `path`.
    """
    check_folder(path)
    special, target = _special(path), Path(os.path.realpath(path))
    with writing(path), temporary_folder(Path(gettempdir()) if special else target.parent) as folder:
        temporary = folder / "written"
        yield temporary
        if special:
            with temporary.open("rb") as written, target.open("wb") as file:
                shutil.copyfileobj(written, file)
            return
        sync(temporary)
        if target.exists():
            shutil.copymode(target, temporary)
        temporary.replace(target)


@contextmanager
def writing(path: PathLike) -> Iterator[None]:
    """Turn an `OSError` of the block into one that says that `path` cannot be written, and why.

    An error that already names a file in the same folder passes through. Files elsewhere are temporary, and the user
    does not know their names.
    """
    try:
        yield
    except OSError as error:
        if _is_worded(error) and Path(str(error).partition(_UNWRITTEN)[0]).parent == Path(path).parent:
            raise
        reason = error.strerror or str(error)
        failure = OSError(f"{path}{_UNWRITTEN}{reason}")
        failure.strerror = reason  # for callers that word their own error
        raise failure from error


def _is_worded(error: OSError) -> bool:
    """Return whether `reading` or `writing` raised an error."""
    return error.errno is None and error.strerror is not None


@contextmanager
def reading(path: PathLike) -> Iterator[None]:
    """Turn an `OSError` of the system in the block into one of its kind that says that `path` cannot be read, and why.

    Its message has the words of the system without its number, ``[Errno 2]``.
    """
    try:
        yield
    except OSError as error:
        if error.errno in {None, errno.EINVAL}:  # worded already, or a sign of a damaged file
            raise
        missing = isinstance(error, FileNotFoundError)
        kind = type(error) if type(error).__module__ == "builtins" else OSError
        failure = kind(f"{path}: no such file" if missing else f"{path}: cannot be read: {error.strerror}")
        failure.strerror = error.strerror  # for callers that word their own error
        raise failure from error


PIECE = 2**20
"""Bytes that are written at once.

Linux may allocate one page for a whole write. While memory is fragmented, a page of 2 MiB takes ten times as long as
two of half the size.
"""


def write(path: Path, data: bytes) -> None:
    """Write a file in pieces of at most `PIECE` bytes."""
    view = memoryview(data)
    with path.open("wb") as file:
        for start in range(0, len(view), PIECE):
            file.write(view[start : start + PIECE])


def sync(path: Path) -> None:
    """Flush the content of a file to disk, before the file gets its name."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


@contextmanager
def temporary_folder(parent: Path, naming: tuple[str, str] = TEMPORARY) -> Iterator[Path]:
    """Make a folder for the block; remove it even if Ctrl-C arrives during creation or removal.

    `tempfile.TemporaryDirectory` would leave it behind. Here its name is chosen before it is made, and a removal that
    Ctrl-C interrupts is tried again.
    """
    folder = parent / token_hex(8).join(naming)
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        try:
            shutil.rmtree(folder, ignore_errors=True)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def link(path: Path, name: str) -> Iterator[Path]:
    """Yield a symbolic link to a file under a plain name, for libraries that cannot open every path.

    Raises
    ------
    FileFormatError
        If the system allows no links.
    """
    with TemporaryDirectory() as folder:
        link = Path(folder, name)
        try:
            link.symlink_to(path.absolute())
        except OSError as error:
            expected = f"expected a plain path that ends in {link.suffix}, since links cannot be made"
            raise FileFormatError(f"{expected}: {error.strerror}") from error
        yield link


def check_path(path: PathLike) -> Path:
    """Return a path, after checking that it is one and that a file can have it."""
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str):
        raise ArgumentTypeError("path", "a path", short_repr(path))
    if "\0" in text:
        raise ArgumentValueError("path", "a path without null characters", short_repr(str(path)))
    return Path(path)


class Place:
    """A path that keeps its file whatever becomes the folder of the process; errors show it as it was given.

    What reads or writes a file while code of the user runs in between starts with one.

    Parameters
    ----------
    path : path-like
        The path as it was given.

    Attributes
    ----------
    path : Path
        The absolute path.
    """

    def __init__(self, path: PathLike) -> None:
        self._given = os.fspath(check_path(path))
        self._before = "" if Path(path).is_absolute() else f"{Path.cwd()}{os.sep}"
        self.path = Path(path).absolute()

    def __str__(self) -> str:
        return self._given

    def as_given(self, path: Path) -> Path:
        """Return a path that was derived from `path` as if it were derived from the path as it was given."""
        return Path(str(path).removeprefix(self._before))

    @contextmanager
    def errors_as_given(self) -> Iterator[None]:
        """Show paths as they were given in the errors of the block that lidarsim words."""
        try:
            yield
        except (LidarsimError, OSError) as error:
            if self._before and getattr(error, "errno", None) is None:
                error.args = tuple(map(self._as_given, error.args))
                vars(error).update({name: self._as_given(value) for name, value in vars(error).items()})
            raise

    def each(self, items: Iterator[Item]) -> Iterator[Item]:
        """Yield the items of a generator that reads or writes `path`."""
        with self.errors_as_given():
            yield from items

    def _as_given(self, value: Any) -> Any:
        return value.replace(self._before, "") if isinstance(value, str) else value


class FileWriter(ABC):
    """Base of what writes files in a with block, at whose end they get their names unless there was an error."""

    def __init__(self, path: PathLike) -> None:
        self._place = Place(path)
        self._opened: ExitStack | None = None

    @abstractmethod
    def _open(self, stack: ExitStack, /) -> None:
        """Open temporary files, which get their names when `stack` is closed."""

    def __enter__(self) -> Self:
        """Open temporary files beside the final ones."""
        with self._place.errors_as_given(), ExitStack() as stack:
            self._open(stack)
            self._opened = stack.pop_all()
        return self

    def _check_open(self) -> ExitStack:
        if self._opened is None:
            raise ValueError(f"{self._place}: expected to be written in a with block")
        return self._opened

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the files their names, unless there was an error."""
        opened, self._opened = self._check_open(), None
        with self._place.errors_as_given():
            opened.__exit__(kind, error, trace)


def _special(path: PathLike) -> bool:
    """Return whether `path` is something other than a file or folder, such as a pipe or device."""
    try:
        mode = Path(path).stat().st_mode
    except FileNotFoundError:
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


def format_error(error: BaseException) -> str:
    """Return the first line of an error's message, of bounded length, or its type if the message is empty.

    An error of the system, ``[Errno 2] No such file or directory: 'a.pcd'``, reads as ours: ``a.pcd: No such file …``.
    """
    text = str(error).strip().partition("\n")[0] or type(error).__name__
    if isinstance(error, OSError) and error.errno is not None and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def redact(error: BaseException) -> str:
    """Return an error's message without the text that Python or another library quotes, possibly from a file.

    A file whose name comes from a third party may be private: its lines must not be shown.
    """
    return format_error(error) if _is_worded_here(error) else _QUOTED.sub("…", format_error(error))


_QUOTED = re.compile(r"""(?<!\w)b?(['"`])(?:\\.|(?!\1).)*(\1|$)""")
_CONVERSION = re.compile("could not convert|invalid literal")
"""Messages of `float` and `int`, which quote the text and are raised in the frame of the caller."""


def _is_worded_here(error: BaseException) -> bool:
    """Return whether lidarsim worded an error, or its message quotes nothing from a file."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    ours = place is not None and str(place.tb_frame.f_globals.get("__name__")).startswith("lidarsim.")
    own = ours and isinstance(error, TypeError | ValueError) and not _CONVERSION.match(str(error))
    return own or isinstance(error, LidarsimError | UnicodeError)


@contextmanager
def reading_as(path: PathLike, what: str) -> Iterator[None]:
    """Turn any exception of the block but a missing package into a one-line `FileFormatError` that names the file."""
    try:
        yield
    except MissingExtraError:
        raise
    except Exception as error:
        raise FileFormatError(f"{path}: cannot be read as {what}: {redact(error)}") from error


@contextmanager
def parsing(path: PathLike, kind: str) -> Iterator[None]:
    """Turn exceptions of a parser into one-line `FileFormatError` exceptions that name the file.

    Errors for missing packages and, as `reading` words them, of unreadable disks pass through. Out-of-range seeks
    (EINVAL) and the `OSError` of a decompressor, which has no reason of the system, are signs of a damaged file and are
    converted.
    """
    try:
        with reading(path):
            yield
    except Exception as error:
        if isinstance(error, ImportError) or (isinstance(error, OSError) and _is_worded(error)):
            raise
        raise FileFormatError(f"{path}: not a readable {kind}: {redact(error)}") from error


def parse_each(path: PathLike, kind: str, items: Iterator[Item]) -> Iterator[Item]:
    """Yield the items of a parser, each of whose steps is `parsing`."""
    while True:
        with parsing(path, kind):
            try:
                item = next(items)
            except StopIteration:
                return
        yield item
        del item  # free it before the next is read


def read_array(file: IO[bytes], size: int) -> npt.NDArray[Any]:
    """Read an array in NumPy's format from a file of `size` bytes, after checking that its header claims no more.

    Raises
    ------
    Exception
        Any exception that NumPy raises for a damaged header; call this within `parsing`.
    """
    version = np.lib.format.read_magic(file)
    if version not in {(1, 0), (2, 0)}:
        raise FileFormatError(f"its array is of the unknown version {version}")
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    claimed = math.prod(shape) * max(dtype.itemsize, 1)  # texts of no characters have no bytes
    if not dtype.hasobject and claimed > size:
        raise FileFormatError(f"its array claims {claimed:,} bytes of {size:,}")
    file.seek(0)
    array: npt.NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def load_array(path: PathLike) -> npt.NDArray[Any]:
    """Return the array in a NumPy file (``.npy``).

    Raises
    ------
    FileFormatError
        If the file is not a NumPy file or is damaged.
    OSError
        If the file cannot be read.
    """
    check_regular(path)
    with Path(path).open("rb") as file, parsing(path, ".npy file"):
        return read_array(file, os.fstat(file.fileno()).st_size)


def beside(path: Path, name: str) -> Path:
    """Return the file that the file `path` refers to by a relative path or URI; it must be beside or below `path`.

    Raises
    ------
    FileFormatError
        If `name` is an absolute path or has a URI scheme, or if it leads, after links are followed, to a pipe or device
        or out of the folder of `path`.
    OSError
        If the file does not exist.
    """
    place = unquote(name)
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|[/\\]", place) or "\\" in place or "\0" in place:
        raise FileFormatError("it names a file by other than a relative path; only files beside or below it are read")
    folders = [path.parent.resolve(), path.resolve().parent]  # of the path itself, and of its target if it is a link
    for folder in folders:
        file = (folder / place).resolve()
        if file.is_file() and any(file.is_relative_to(folder) for folder in folders):
            _note(file)
            return file
    if any((folder / place).exists() for folder in folders):
        raise FileFormatError("it names something that is no regular file beside or below it")
    raise FileNotFoundError("it names a file that is not there")
