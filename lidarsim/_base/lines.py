"""Text files of numbers, line by line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from lidarsim._base.files import PathLike, check_path, check_regular
from lidarsim._base.shown import quantity
from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError

LONGEST_LINE = 1 << 16
MOST_LINES = 10_000_000
"""Maximum bytes per line and lines per file; a day of poses at 100 Hz has 8.64 million."""


def numbers(texts: Sequence[str], count: int) -> list[float]:
    """Parse `count` texts as finite numbers; raise `ValueError` if their number differs, or one is not finite."""
    if len(texts) != count:
        raise ValueError(f"expected {quantity(count, 'number')}, got {len(texts)}")
    values = []
    for text in texts:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or "_" in text:
            raise ValueError("expected finite numbers, got something else")  # not quoted: it may come from any file
        values.append(value)
    return values


def bare(cell: str) -> str:
    """Return a cell of CSV without blanks and quotation marks."""
    return cell.strip().strip('"').strip()


def cells(line: str) -> list[str]:
    """Return the cells of a line of CSV, without blanks and quotation marks."""
    return list(map(bare, line.split(",")))


class LineReader:
    """Iterator over the lines of a text file, without empty lines and comments, bounded in length and number.

    Parameters
    ----------
    path : path-like
        The file.
    """

    def __init__(self, path: PathLike) -> None:
        self.path = check_path(path)
        self.numbers: list[int] = []
        """Line numbers of the lines yielded so far."""
        self._number = 0
        self._lines = self._read()

    def _read(self) -> Iterator[str]:
        check_regular(self.path)
        with self.path.open("rb") as file:
            while line := file.readline(LONGEST_LINE + 1):
                self._number += 1
                if len(line) > LONGEST_LINE or self._number > MOST_LINES:
                    raise ValueError(f"expected at most {MOST_LINES:,} lines of {LONGEST_LINE:,} bytes, got more")
                text = line.decode("utf-8-sig", errors="replace").strip()
                if text and not text.startswith("#"):
                    self.numbers.append(self._number)
                    yield text

    def __iter__(self) -> Iterator[str]:
        return self._lines

    @contextmanager
    def refusals(self) -> Iterator[None]:
        """Turn an error of the block into one that names the file and the last line read."""
        try:
            yield
        except FileFormatError:
            raise
        except OSError as error:
            raise FileFormatError(f"{self.path}: cannot read the file: {error.strerror}") from None
        except ValueError as error:
            line = f":{self._number}" if self._number else ""
            raise FileFormatError(f"{self.path}{line}: {error}") from None

    def rising(self, times: Floats) -> Floats:
        """Return `times`, read from the last lines, after checking that they increase."""
        late = times[1:] <= times[:-1]
        if late.any():
            i = int(np.argmax(late)) + 1
            line = self.numbers[len(self.numbers) - len(times) + i]
            raise FileFormatError(f"{self.path}:{line}: expected rising times, got {times[i]} after {times[i - 1]}")
        return times
