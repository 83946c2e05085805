"""Files: written whole or not at all, and what is said of those that cannot be read."""

from __future__ import annotations

import errno
import math
import os
import re
import shutil
import signal
import stat
import threading
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from tempfile import gettempdir
from typing import IO, Any, BinaryIO, NoReturn
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from lidarsim._validation import short
from lidarsim.errors import ArgumentValueError, FileFormatError, LidarsimError

PathLike = str | os.PathLike[str]

TEMPORARY = ".lidarsim-", ".tmp"
"""Beginning and end of the names of folders in which files are written, before they are moved to their places."""

NAME_LENGTH = 64
"""Characters of a name that becomes part of a path: with what stands around it, it fits all file systems and USTAR."""

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_DEVICE = re.compile(r"CON|PRN|AUX|NUL|(?:COM|LPT)[0-9]", re.IGNORECASE)

LONGEST = 1000
"""Characters of what an error says: what a file holds may be quoted in it."""


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


def name_problem(name: str) -> str:
    """Return what is expected of a name that cannot be part of a path on every file system; "" if it can."""
    if not _NAME.fullmatch(name):
        return "a name of letters, digits, _ and -"
    if len(name) > NAME_LENGTH:
        return f"a name of at most {NAME_LENGTH} characters"
    return "another name than that of a Windows device" if _DEVICE.fullmatch(name) else ""


def check_name(argument: str, name: str) -> str:
    """Return a name that can be part of a path; raise `ValueError` if it cannot."""
    if expected := name_problem(name):
        raise ArgumentValueError(argument, expected, short(ascii(name)))
    return name


def check_names(argument: str, names: Iterable[str]) -> None:
    """Raise `ValueError` unless each of the names passes `check_name`, and no two are equal ignoring case."""
    seen: dict[str, str] = {}
    for name in names:
        other = seen.setdefault(check_name(argument, name).lower(), name)
        if other != name:
            raise ArgumentValueError(argument, "names that differ in more than case", f"{other!r} and {name!r}")


def check_regular(path: PathLike) -> None:
    """Raise an error if `path` is a pipe or device: these may have no end, and need not give their bytes twice."""
    if _special(path):
        raise FileFormatError(f"{path}: expected a regular file, got a pipe or device")


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
    if not _special(path) and not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{path}: no permission to write in the folder {folder}")


@contextmanager
def atomic_writer(path: PathLike) -> Iterator[BinaryIO]:
    """Open a binary file that takes the name `path` when the block ends well; else `path` stays as it was.

    Raises
    ------
    OSError
        If the file cannot be written; the message names `path`.
    """
    with replacing(path) as temporary, temporary.open("xb") as file:
        yield file


@contextmanager
def replacing(path: PathLike) -> Iterator[Path]:
    """Give the name of a file that takes the name `path` when the block ends well, in a folder of its own.

    The folder is removed however the block ends, be it by a SIGTERM that has no other handler and comes while the main
    thread is in the block. A file that is replaced hands its permissions on; a link keeps pointing to its file, and a
    pipe or device stays one and gets the content.

    Raises
    ------
    OSError
        If the file cannot be written, and in place of one that the block raises; the message names `path`.
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
    """Let an `OSError` of the block say that the file `path` cannot be written, and why."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        failure = OSError(f"{path}: cannot be written: {reason}")
        failure.strerror = reason  # for whoever makes another file of this one
        raise failure from error


def sync(path: Path) -> None:
    """Have the content of a file on disk before it gets its name."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


@contextmanager
def temporary_folder(parent: Path, naming: tuple[str, str] = TEMPORARY) -> Iterator[Path]:
    """Make a folder for the block, and remove it even if SIGTERM or Ctrl-C comes while it is made or removed.

    `tempfile.TemporaryDirectory` leaves it then. Here its name is known before it is made, and what one Ctrl-C keeps
    the first attempt from removing, the second removes.
    """
    folder = parent / token_hex(8).join(naming)
    with _unwinding_at_sigterm():
        try:
            folder.mkdir(mode=0o700)
            yield folder
        finally:
            try:
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                shutil.rmtree(folder, ignore_errors=True)


def _special(path: PathLike) -> bool:
    """Return whether there is something other than a file or folder at `path`, such as a pipe or a device."""
    try:
        mode = Path(path).stat().st_mode
    except FileNotFoundError:
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


@contextmanager
def _unwinding_at_sigterm() -> Iterator[None]:
    """Let SIGTERM raise `SystemExit`, where it would end the process on the spot and leave what is half written."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _exit(number: int, _: object) -> NoReturn:
    raise SystemExit(128 + number)  # as shells report a process that a signal ended


def told(error: BaseException) -> str:
    """Return what an error says, on one line and of bounded length, or its kind if it says nothing."""
    text = str(error).strip().partition("\n")[0] or type(error).__name__
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def unquoted(error: BaseException) -> str:
    """Return what an error says, without what Python or another library quotes in it: that may be of any file.

    Whoever lets us read a file by a name from somebody else need not want its lines shown.
    """
    return told(error) if _worded_here(error) else _QUOTED.sub("…", told(error))


_QUOTED = re.compile(r"""(?<!\w)b?(['"`])(?:\\.|(?!\1).)*(\1|$)""")
_CONVERSION = re.compile("could not convert|invalid literal")
"""What float and int raise, with the text, from within whoever calls them."""


def _worded_here(error: BaseException) -> bool:
    """Return whether lidarsim's own code raised an error, or one that quotes nothing of a file."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    ours = place is not None and str(place.tb_frame.f_globals.get("__name__")).startswith("lidarsim.")
    own = ours and isinstance(error, TypeError | ValueError) and not _CONVERSION.match(str(error))
    return own or isinstance(error, LidarsimError | UnicodeError)


@contextmanager
def reading_as(path: PathLike, what: str) -> Iterator[None]:
    """Raise a `FileFormatError` of one line that names the file, whatever its readers raise."""
    try:
        yield
    except Exception as error:
        raise FileFormatError(f"{path}: cannot be read as {what}: {unquoted(error)}") from error


@contextmanager
def parsing(path: PathLike, kind: str) -> Iterator[None]:
    """Let parsers of a file fail as they will, and raise a `FileFormatError` of one line that names the file.

    A missing package, and a disk that cannot be read, pass as they are; not so a seek to where no file has bytes, which
    is what a damaged file claims, and the `OSError` of a decompressor, which has no number.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, ImportError) or (isinstance(error, OSError) and error.errno not in {None, errno.EINVAL}):
            raise
        raise FileFormatError(f"{path}: not a readable {kind}: {unquoted(error)}") from error


def read_array(file: IO[bytes], size: int) -> npt.NDArray[Any]:
    """Read an array in NumPy's format from a file of `size` bytes, after checking that it claims no more.

    Raises
    ------
    Exception
        What NumPy raises for a damaged header, of any kind: to be read within `parsing`.
    """
    version = np.lib.format.read_magic(file)
    if version not in {(1, 0), (2, 0)}:
        raise FileFormatError(f"its array is of the unknown version {version}")
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    claimed = math.prod(shape) * dtype.itemsize
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
        If it is not one, or damaged.
    OSError
        If it cannot be read.
    """
    check_regular(path)
    with Path(path).open("rb") as file, parsing(path, ".npy file"):
        return read_array(file, os.fstat(file.fileno()).st_size)


def beside(path: Path, name: str) -> Path:
    """Return the file that the file `path` names, by a relative path or URI: one beside or below it.

    Raises
    ------
    FileFormatError
        If the name is an absolute path or that of another place, or leads, links followed, out of the folder of `path`,
        or to a pipe or device.
    OSError
        If there is no such file.
    """
    place = unquote(name)
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|[/\\]", place) or "\\" in place or "\0" in place:
        raise FileFormatError("it names a file by other than a relative path; only files beside or below it are read")
    folders = [path.parent.resolve(), path.resolve().parent]  # of its own name, and of what that may be a link to
    for folder in folders:
        file = (folder / place).resolve()
        if file.is_file() and any(file.is_relative_to(folder) for folder in folders):
            return file
    if any((folder / place).exists() for folder in folders):
        raise FileFormatError("it names something that is no regular file beside or below it")
    raise FileNotFoundError("it names a file that is not there")
