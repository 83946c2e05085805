"""Error handling shared by the vendors' readers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lidarsim._base.files import check_regular, format_error
from lidarsim.errors import FileFormatError


@contextmanager
def refusals(path: Path, kind: str) -> Iterator[None]:
    """Turn errors of the checks into one that names the file and its recognised kind."""
    try:
        check_regular(path)
        yield
    except FileFormatError:
        raise
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: {kind}: not UTF-8 at byte {error.start}") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read the file: {error.strerror}") from None
    except RecursionError:
        raise FileFormatError(f"{path}: {kind}: nested too deeply") from None
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise FileFormatError(f"{path}: {kind}: {format_error(error)}") from None
