"""Terminal output: the command line prints only through this module, so that no text can control the terminal."""

from __future__ import annotations

import errno
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from io import StringIO
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

from lidarsim._base.shown import plain
from lidarsim.errors import LidarsimError

if TYPE_CHECKING:
    from rich.markdown import Markdown
    from rich.progress import Progress

WIDTH = 200
"""Width of tables in a pipe without the variable COLUMNS, in columns."""
LONGEST_LINE = 2000
"""Maximum characters of a message on stderr."""
ASCII = str.maketrans({"…": "...", "°": "deg"})
"""Replacements for lidarsim's own characters if the terminal lacks them; all others are escaped."""


def print_line(text: object) -> None:
    """Print a line to stdout.

    Raises
    ------
    BrokenPipeError
        If the reader has closed the pipe.
    LidarsimError
        If stdout cannot be written.
    """
    _write(f"{_fitting(text)}\n")


def paragraph(text: object) -> None:
    """Print a text to stdout, wrapped between words if the width of stdout is known.

    Words stay whole, such as paths to copy, and further lines are indented below an indented or bulleted first one.
    Raises the errors of `print_line`.
    """
    line = _fitting(text)
    if not _width_is_known():
        print_line(line)
        return
    mark = re.match(r"\s*(?:- )?", line)
    hang = mark.end() if mark else 0
    width = Console(file=_Page()).width
    first, *words = line[hang:].split(" ")
    lines = [line[:hang] + first]
    for word in words:
        if cell_len(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(" " * hang + word)
    _write("".join(f"{wrapped}\n" for wrapped in lines))


def table(
    columns: Sequence[str], rows: Sequence[Sequence[object]], *, left: Sequence[str] = (), whole: Sequence[str] = ()
) -> None:
    """Print a table to stdout; raises the errors of `print_line`.

    Parameters
    ----------
    columns : sequence of str
        Names of the columns.
    rows : sequence of sequence of object
        One cell per column in each row; `_cell` formats the values.
    left, whole : sequence of str
        Columns that are aligned left, and columns that are never wrapped.
    """
    made = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for column in columns:
        side = "left" if column in left else "right"
        made.add_column(_fitting(column), justify=side, no_wrap=column in whole, overflow="fold")  # type: ignore[arg-type]
    for row in rows:
        made.add_row(*(_fitting(_cell(cell)) for cell in row))
    _render(made)


def facts(lines: dict[str, str]) -> None:
    """Print names and values to stdout, side by side; raises the errors of `print_line`."""
    made = Table(box=None, show_header=False)
    for name, value in lines.items():
        made.add_row(name, _fitting(value))
    _render(made)


def print_markdown(text: str) -> None:
    """Print Markdown to stdout, formatted if that is a terminal; raises the errors of `print_line`."""
    if sys.stdout.isatty():
        from rich.markdown import Markdown

        _render(Markdown(_fitting_lines(text)))
    else:
        _write(_fitting_lines(text))


def progress_bar() -> Progress:
    """Return a progress bar on stderr, hidden unless that is a terminal."""
    from rich.progress import Progress

    return Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())


def say(text: object) -> None:
    """Print a message as one line to stderr, ignoring write errors; the middle of a very long message is cut."""
    whole = " ".join(part.strip() for part in str(text).strip().split("\n"))
    line = _encodable(plain(whole), sys.stderr)
    if len(line) > LONGEST_LINE:
        line = f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
    with suppress(OSError):
        sys.stderr.write(f"lidarsim: {line}\n")
        sys.stderr.flush()


@contextmanager
def standard_streams() -> Iterator[None]:
    """Make the block safe against closed or broken standard streams, and print warnings and logs by `say`.

    A closed stream becomes the null device; otherwise the next opened file would get its descriptor, and the output of
    libraries with it. Unwritten output is dropped at the end, where Python would report an error.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, PTH123 - kept open
    log = _Log(logging.WARNING)
    report, show = sys.unraisablehook, sys.excepthook

    # Rasterio cannot decode a warning of GDAL that quotes a damaged file, and Cython reports that in both ways.
    def report_others(dropped: sys.UnraisableHookArgs) -> None:
        if not isinstance(dropped.exc_value, UnicodeDecodeError):
            report(dropped)

    def show_others(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if not isinstance(error, UnicodeDecodeError):
            show(kind, error, trace)

    try:
        sys.unraisablehook, sys.excepthook = report_others, show_others
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Dataset has no geotransform")  # which an error says
            warnings.showwarning = lambda message, *_, **__: say(f"warning: {message}")
            logging.getLogger().addHandler(log)
            yield
    finally:
        sys.unraisablehook, sys.excepthook = report, show
        logging.getLogger().removeHandler(log)
        for stream in (sys.stdout, sys.stderr):
            _settle(stream)


@contextmanager
def without_native_logs() -> Iterator[None]:
    """Drop what libraries write to standard error past Python in the block, such as Rerun's log; `sys.stderr` stays."""
    stderr = sys.stderr
    with ExitStack() as stack:
        if _is_standard_error(stderr):
            kept = os.dup(2)
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, 2)
            sys.stderr = stack.enter_context(
                open(kept, "w", buffering=1, encoding=stderr.encoding, errors=stderr.errors, closefd=False)
            )
            stack.callback(setattr, sys, "stderr", stderr)
            with open(os.devnull, "wb") as null:  # noqa: PTH123
                os.dup2(null.fileno(), 2)
        yield


def _is_standard_error(stream: TextIO) -> bool:
    try:
        return stream.fileno() == 2
    except (OSError, ValueError):
        return False


class _Log(logging.Handler):
    """Print the log records of libraries as messages."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"warning: {record.getMessage()}")


def _settle(stream: TextIO) -> None:
    """Flush a stream, or drop what it cannot write."""
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)


def _write(text: str) -> None:
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise
        raise LidarsimError(f"standard output: cannot be written: {error.strerror or error}") from None


def _render(what: Table | Markdown) -> None:
    """Print at the width of the terminal or of the variable COLUMNS, else at `WIDTH` columns."""
    page = _Page()
    width = None if _width_is_known() else WIDTH
    Console(file=page, width=width, highlight=False, markup=False, emoji=False).print(what)
    lines = [line.rstrip() for line in page.getvalue().splitlines()]
    _write(_encodable("".join(f"{line}\n" for line in lines), sys.stdout))


def _width_is_known() -> bool:
    return sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdecimal()


class _Page(StringIO):
    """Buffer for stdout that has the encoding of stdout and is a terminal if stdout is one."""

    encoding = property(lambda _: sys.stdout.encoding)

    def isatty(self) -> bool:
        return sys.stdout.isatty()


def _fitting(text: object) -> str:
    """Return a text with all characters escaped that stdout cannot print, before its width is measured."""
    return _encodable(plain(text), sys.stdout)


def _fitting_lines(text: str) -> str:
    return "".join(f"{_fitting(line)}\n" for line in text.splitlines())


def _encodable(text: str, stream: TextIO) -> str:
    encoding = stream.encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return text.translate(ASCII).encode(encoding, "backslashreplace").decode(encoding)
    return text


def _cell(value: object) -> str:
    """Return the text of a cell: empty for None; floats with three significant digits, or as integers from 100 on."""
    if value is None:
        return ""
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return str(value)
