"""Short representations of objects for terminals and notebooks."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

FEW = 6  # maximum size of an array whose numbers are all shown
WIDTH = 60  # maximum characters of any other value

_brief = reprlib.Repr()
_brief.maxother = _brief.maxstring = WIDTH
_brief.maxtuple = _brief.maxlist = 3


def short(value: object) -> str:
    """Return a short text for a value; for a long array, its shape, minimum and maximum."""
    if not isinstance(value, np.ndarray):
        return _brief.repr(value)
    if value.ndim == 1 and value.size <= FEW:
        return f"[{', '.join(f'{x:.6g}' for x in value)}]"
    return f"<{' × '.join(map(str, value.shape))}: {extent(value)}>" if value.size else f"<{value.shape}>"


def extent(array: npt.NDArray[Any]) -> str:
    """Return the minimum and maximum of the finite numbers as text, or "" if there are none."""
    finite = array[np.isfinite(array)]
    return f"{finite.min():.6g} … {finite.max():.6g}" if finite.size else ""


def plain(text: object, *, most: int | None = None) -> str:
    r"""Return a text with unprintable characters escaped, as ``\x1b``, so that no name can control a terminal.

    As for `str.isprintable`, these are control and format characters, which can reorder or hide text, line separators
    and surrogates. A result longer than `most` characters is truncated and ends in an ellipsis.
    """
    whole = str(text)
    if not whole.isprintable():
        whole = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in whole)
    return whole if most is None or len(whole) <= most else f"{whole[: most - 1]}…"


def quantity(count: int, noun: str) -> str:
    """Return a count with its noun: "1 frame", "2,000 frames"."""
    return f"{count:,} {noun}{'s' if count != 1 else ''}"


def format_size(lengths: npt.NDArray[Any]) -> str:
    """Return the edges of a box: "4.2 × 1.8 × 1.5"."""
    return " × ".join(f"{round(length, 6):,.6g}" for length in lengths.tolist())


def html_table(title: str, rows: Iterable[Sequence[str]]) -> str:
    """Return an HTML table with a title and no styling."""
    cells = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def text_table(title: str, rows: Sequence[Sequence[str]]) -> str:
    """Return the same table as lines of text."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))] if rows else []
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join((title, *(f"  {line}".rstrip() for line in lines)))
