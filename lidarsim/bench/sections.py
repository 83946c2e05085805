"""Sections of a Markdown file that a command writes, between two comments."""

from __future__ import annotations

from pathlib import Path

from lidarsim._files import atomic_writer

__all__ = ["around", "write"]


def around(file: Path, begin: str, end: str) -> tuple[str, str]:
    """Return what stands before and after the section between two lines.

    Raises
    ------
    ValueError
        If the file has no such section.
    """
    head, first, rest = file.read_text(encoding="utf-8").partition(begin)
    _, last, tail = rest.partition(end)
    if not first or not last:
        raise ValueError(f"{file}: expected a section between the lines {begin} and {end}")
    return head, tail


def write(file: Path, begin: str, end: str, text: str) -> None:
    """Write the section between two lines anew.

    Raises
    ------
    ValueError
        If the file has no such section.
    """
    head, tail = around(file, begin, end)
    with atomic_writer(file) as target:
        target.write(f"{head}{begin}\n{text}\n{end}{tail}".encode())
