"""XML of scene files, read by Python's own parser, which opens no other file and no network."""

from __future__ import annotations

import re
import zipfile
from typing import NoReturn
from xml.etree import ElementTree as ET

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._records import EXPANSION, expansion_limit
from lidarsim.io.scenes._model import Indices

Element = ET.Element


class _Builder(ET.TreeBuilder):
    def doctype(self, *_: object) -> NoReturn:
        raise FileFormatError("expected XML without a document type, whose entities a few bytes can make endless")


def parse(data: bytes, what: str) -> Element:
    """Return the root of a document; `what` names it in errors."""
    parser = ET.XMLParser(target=_Builder())  # noqa: S314 - document types are refused
    try:
        parser.feed(data)
        root: Element = parser.close()
    except ET.ParseError as error:
        raise FileFormatError(f"{what} is damaged XML: line {error.position[0]}") from None
    return root


def unpack(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return a file of an archive after checking its size."""
    try:
        info = archive.getinfo(name)
    except KeyError:
        raise FileFormatError(f"{name!a:.60}: missing in the archive") from None
    if info.file_size > expansion_limit(info.compress_size):
        raise FileFormatError(f"{name!a:.60}: expected at most {EXPANSION} bytes for each that it takes in the archive")
    return archive.read(info)


def local(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def floats(text: str | None, where: str, count: int | None = None) -> Floats:
    """Return the numbers in a text; `count` is how many are expected."""
    try:
        values = np.array((text or "").split(), np.float64)
    except ValueError:
        raise FileFormatError(f"{where}: expected numbers") from None
    if count is not None and len(values) != count:
        raise FileFormatError(f"{where}: expected {count} numbers, got {len(values)}")
    return values


def integers(text: str | None, where: str) -> Indices:
    """Return the integers in a text, which are >= 0."""
    words = (text or "").split()
    if not all(re.fullmatch(r"\+?\d{1,18}", word, re.ASCII) for word in words):
        raise FileFormatError(f"{where}: expected integers >= 0")
    return np.array(words, np.int64) if words else np.empty(0, np.int64)


def integer(text: str | None, where: str) -> int:
    """Return the first of the integers in a text, 0 if it has none."""
    return int(integers(text, where)[:1].sum())
