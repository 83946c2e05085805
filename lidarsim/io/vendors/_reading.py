"""What the vendors' readers share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lidarsim.errors import FileFormatError


@contextmanager
def refusals(path: Path, kind: str) -> Iterator[None]:
    """Turn what the checks refuse into an error that names the file and what it was recognised as."""
    try:
        yield
    except FileFormatError:
        raise
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: {kind}: not UTF-8 at byte {error.start}") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read the file: {error.strerror}") from None
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"{path}: {kind}: {error}") from None
