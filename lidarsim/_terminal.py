"""The terminal: all that the command line prints goes through here, and no text from a file controls it."""

from __future__ import annotations

import errno
import logging
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from io import StringIO
from typing import TextIO

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from lidarsim._shown import plain
from lidarsim.errors import LidarsimError

__all__ = ["facts", "paragraph", "print_line", "say", "standard_streams", "table"]

WIDTH = 200
"""Columns of the tables in a pipe."""
LONGEST_LINE = 2000
"""Characters of a message on stderr that are shown."""
ASCII = str.maketrans({"…": "...", "°": "deg"})
"""Our own characters where the terminal lacks them; any others are escaped."""


def print_line(text: object) -> None:
    """Print a line to stdout.

    Raises
    ------
    BrokenPipeError
        If nobody reads it any more.
    LidarsimError
        If it cannot be written.
    """
    _write(f"{_fitting(text)}\n")


def paragraph(text: object) -> None:
    """Print a text to stdout, wrapped between words; errors are those of `print_line`."""
    _render(Text(_fitting(text)))


def table(
    columns: Sequence[str], rows: Sequence[Sequence[object]], *, left: Sequence[str] = (), whole: Sequence[str] = ()
) -> None:
    """Print a table to stdout; errors are those of `print_line`.

    Parameters
    ----------
    columns : sequence of str
        Their names.
    rows : sequence of sequence of object
        As many cells in each; numbers are printed as `_cell` says.
    left, whole : sequence of str
        The columns that are aligned on the left, and those that are never wrapped.
    """
    made = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for column in columns:
        side = "left" if column in left else "right"
        made.add_column(_fitting(column), justify=side, no_wrap=column in whole)  # type: ignore[arg-type]
    for row in rows:
        made.add_row(*(_fitting(_cell(cell)) for cell in row))
    _render(made)


def facts(lines: dict[str, str]) -> None:
    """Print names and values to stdout, side by side; errors are those of `print_line`."""
    made = Table(box=None, show_header=False)
    for name, value in lines.items():
        made.add_row(name, _fitting(value))
    _render(made)


def say(text: object) -> None:
    """Print a message as one line to stderr, if that can be written; of a very long one the middle is left out."""
    whole = " ".join(part.strip() for part in str(text).strip().split("\n"))
    line = _encodable(plain(whole), sys.stderr)
    if len(line) > LONGEST_LINE:
        line = f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
    with suppress(OSError):
        sys.stderr.write(f"lidarsim: {line}\n")
        sys.stderr.flush()


@contextmanager
def standard_streams() -> Iterator[None]:
    """Let the block print whatever becomes of stdin, stdout and stderr, and warnings and logs go through `say`.

    A stream that is closed becomes the null device: else the next file that is opened would have its number, and get
    what libraries print. What a stream could not write is dropped at the end, where Python would complain of it.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, PTH123 - as long as the process
    log = _Log(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: say(f"warning: {message}")
            logging.getLogger().addHandler(log)
            yield
    finally:
        logging.getLogger().removeHandler(log)
        for stream in (sys.stdout, sys.stderr):
            _settle(stream)


class _Log(logging.Handler):
    """What libraries log, as messages."""

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


def _render(what: Table | Text) -> None:
    """Print as wide as the terminal, or as wide as it takes if there is none."""
    page = _Page()
    width = None if page.isatty() else WIDTH
    Console(file=page, width=width, highlight=False, markup=False, emoji=False).print(what)
    _write(_encodable(page.getvalue(), sys.stdout))


class _Page(StringIO):
    """What is to be printed to stdout, as if it were stdout."""

    encoding = property(lambda _: sys.stdout.encoding)

    def isatty(self) -> bool:
        return sys.stdout.isatty()


def _fitting(text: object) -> str:
    """Return a text that stdout can print, in as many columns as it then takes."""
    return _encodable(plain(text), sys.stdout)


def _encodable(text: str, stream: TextIO) -> str:
    encoding = stream.encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return text.translate(ASCII).encode(encoding, "backslashreplace").decode(encoding)
    return text


def _cell(value: object) -> str:
    """Return what a table shows of a value: nothing of None, numbers with three significant digits."""
    if value is None:
        return ""
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return str(value)
