"""MJCF and URDF documents, closed over the files that they name.

MuJoCo opens every file that a model names, wherever it lies. So the documents are parsed here, each file that they name
is looked up beside or below the main one, and MuJoCo gets documents written anew, in which every name is that of bytes
in memory. Neither its parser nor its search for files sees a word that was not checked.
"""

from __future__ import annotations

import math
import posixpath
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import NoReturn
from urllib.parse import quote, unquote
from xml.parsers import expat

from lidarsim._base.files import beside
from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError

DEPTH = 256
"""Maximum depth of elements, those of included documents in their place; MuJoCo recurses over them."""

COPIES = 20_000
"""Maximum number of elements that `replicate`, `attach` and the like add to those that are written. The time that
MuJoCo takes grows with their square: half a minute for so many geoms."""

NUMBERS = 20_000_000
"""Maximum number of heights, vertices of built-in meshes and user data that a document may ask for by a count."""

FOLDERS = ("assetdir", "meshdir", "texturedir", "strippath")
"""Attributes of ``compiler`` that say where files are."""

ASSETS = {"mesh", "hfield", "skin", "flexcomp"}
"""Elements of MJCF that name a file of geometry."""

PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(slots=True)
class Element:
    """Start of an element."""

    tag: str
    attributes: dict[str, str]
    line: int
    depth: int


Token = Element | str
"""Start of an element, or the tag of one that ends."""


@dataclass(slots=True)
class Document:
    """A parsed document, its name in memory, and the number of elements that it stands for."""

    path: Path
    name: str
    tokens: list[Token]
    weight: int = 0

    @property
    def elements(self) -> Iterator[Element]:
        """The elements in the order of the document."""
        return (token for token in self.tokens if isinstance(token, Element))

    def written(self) -> str:
        """Return the document in XML, each element on the line that it had, for MuJoCo's messages."""
        parts, line = [], 1
        for token in self.tokens:
            if isinstance(token, str):
                parts.append(f"</{token}>")
                continue
            pairs = "".join(f' {key}="{escape(value)}"' for key, value in token.attributes.items())
            parts.append(f"{chr(10) * (token.line - line)}<{token.tag}{pairs}>")
            line = token.line
        return "".join(parts)

    def wrong(self, element: Element, problem: str) -> FileFormatError:
        """Return the error for an element."""
        return FileFormatError(f"{self.path}:{element.line}: {problem}")


@dataclass(slots=True)
class Closed:
    """A model with everything that it names.

    Parameters
    ----------
    main : Path
        The file; all others must be beside or below it.
    xml : str
        The model.
    assets : dict of str to bytes
        The files that it names.
    names : dict of str to str
        How the original documents call each of them.
    models : dict of Path to Document
        The models that it attaches.
    written : int
        Number of elements in all documents.
    unseen : int
        Number of links of a URDF that have visuals and no collision, of which MuJoCo keeps nothing.
    """

    main: Path
    xml: str = ""
    assets: dict[str, bytes] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    models: dict[Path, Document] = field(default_factory=dict)
    written: int = 0
    unseen: int = 0

    def new_name(self, original: str) -> str:
        """Return a name for a file in memory, with the suffix by which MuJoCo knows the format."""
        suffix = posixpath.splitext(original)[1].lower()
        name = f"lidarsim{len(self.names)}{suffix if re.fullmatch(r'[.][a-z0-9]{1,8}', suffix) else ''}"
        self.names[name] = original
        return name


def closed(path: Path) -> Closed:
    """Return the model of a file, closed over the files that it names.

    Raises
    ------
    FileFormatError
        If a document is no well-formed XML without a document type, has another root element than mujoco or robot,
        names a file that is not beside or below the main one, uses a plugin, or asks for too much.
    OSError
        If a file cannot be read.
    """
    files = Closed(path)
    main = _Model(files, path, "", ()).main
    files.xml = main.written()
    del files.assets[main.name]
    return files


def parsed(path: Path, name: str, depth: int = 0) -> Document:
    """Parse a document that stands below `depth` elements of others."""
    document, open_ = Document(path, name, []), [""] * depth
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        open_.append(tag)
        element = Element(tag, attributes, parser.CurrentLineNumber, len(open_))
        document.tokens.append(element)
        if len(open_) > DEPTH:
            raise document.wrong(element, f"expected at most {DEPTH} levels of elements, got more")

    def end(tag: str) -> None:
        open_.pop()
        document.tokens.append(tag)

    def refuse(*_: object) -> NoReturn:
        raise FileFormatError(f"{path}:{parser.CurrentLineNumber}: expected XML without a document type")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = refuse  # without one, there are no entities but those of characters
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        problem = expat.errors.messages[error.code]
        raise FileFormatError(f"{path}:{error.lineno}: not well-formed XML: {problem}") from error
    except (LookupError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path}: not XML of an encoding that Python knows") from error
    return document


class _Model:
    """One model: a document, those that it includes, and the models that it attaches."""

    def __init__(self, files: Closed, path: Path, folder: str, above: tuple[Path, ...]) -> None:
        self._files = files
        self._folder = folder  # of the model, relative to that of the main file
        self._above = (*above, path.resolve())
        self._settings: dict[str, str] = {}
        self._documents: dict[Path, Document] = {}
        self._heaviest = 0  # of the attached models
        self.main = self._read(path, folder, 0)
        root = next(self.main.elements)
        if root.tag.lower() not in {"mujoco", "robot"}:
            raise self.main.wrong(root, f"expected the root element mujoco or robot, got {short(root.tag)}")
        urdf = root.tag.lower() == "robot"
        for document in self._documents.values():
            if urdf:
                self._robot(document)
            else:
                for element in document.elements:
                    self._mujoco(document, element)
        self._weigh(self.main)
        for document in self._documents.values():
            files.assets[document.name] = document.written().encode()

    def _read(self, path: Path, folder: str, depth: int) -> Document:
        """Parse a document and those that it includes, and collect where their files are, as MuJoCo's first pass."""
        document = parsed(path, self._files.new_name(path.name), depth)
        self._documents[path.resolve()] = document
        self._files.written += sum(1 for _ in document.elements)
        for element in document.elements:
            tag, attributes = element.tag.lower(), element.attributes
            if tag == "compiler":
                self._settings |= attributes
                for key in FOLDERS:
                    attributes.pop(key, None)
            elif tag == "include" and "file" in attributes:
                places = [posixpath.join(place, attributes["file"]) for place in (self._folder, folder)]
                found, place = self._find(document, element, attributes["file"], places)
                if found in self._documents:
                    raise document.wrong(element, f"{short(repr(attributes['file']))} is included already")
                attributes["file"] = self._read(found, posixpath.dirname(place), element.depth).name
            elif tag == "model" and "file" in attributes:
                self._attach(document, element)
        return document

    def _attach(self, document: Document, element: Element) -> None:
        name = element.attributes["file"]
        found, place = self._find(document, element, name, [posixpath.join(self._folder, name)])
        if found in self._above:
            raise document.wrong(element, f"model {short(repr(name))} is part of itself")
        models = self._files.models
        if found not in models:
            models[found] = _Model(self._files, found, posixpath.dirname(place), self._above).main
        self._heaviest = max(self._heaviest, models[found].weight)
        element.attributes["file"] = models[found].name
        element.attributes.pop("content_type", None)

    def _mujoco(self, document: Document, element: Element) -> None:
        """Replace the names of the files of an element of MJCF."""
        tag, attributes = element.tag.lower(), element.attributes
        named = [key for key in attributes if key.lower().startswith("file")]
        if tag == "plugin":
            raise document.wrong(element, "plugins of MuJoCo are not loaded from files")
        if tag == "texture":
            # Nothing here looks at textures: one of a single colour in place of each opens no file.
            name = attributes.get("name") or _stem(attributes.get("file", ""))
            element.attributes = {"name": name, "type": attributes.get("type", "cube")}
            element.attributes |= {"builtin": "flat", "width": "1", "height": "1"}
        elif tag in ASSETS and named == ["file"]:
            name = attributes["file"]
            if self._settings.get("strippath") == "true":
                name = posixpath.basename(name)
            folders = [self._settings.get(key, "") for key in ("meshdir", "assetdir")]
            places = [posixpath.join(self._folder, folder, name) for folder in (*filter(None, folders), "")]
            attributes["file"] = self._asset(document, element, name, places)
            if not attributes.get("name"):
                attributes["name"] = _stem(name)  # as MuJoCo calls it
        elif named and tag not in {"include", "model"}:
            raise document.wrong(element, f"{short(element.tag)} names a file, which is not read")

    def _robot(self, document: Document) -> None:
        """Replace the names of the files of a URDF, of which MuJoCo reads meshes alone."""
        discards = self._settings.get("discardvisual", "true") == "true"
        within: list[str] = []
        of_link: set[str] = set()
        for token in document.tokens:
            if isinstance(token, str):
                if within.pop() == "link":
                    self._files.unseen += discards and "visual" in of_link and "collision" not in of_link
                continue
            within.append(token.tag)
            if token.tag == "link":
                of_link.clear()
            of_link.add(token.tag)
            if token.tag != "mesh" or "filename" not in token.attributes:
                continue
            name = token.attributes["filename"]
            if discards and "visual" in within:
                token.attributes["filename"] = ""  # MuJoCo reads its colour, not its mesh
                continue
            path = re.sub(r"^(package|file|model)://", "", name)
            folder = self._settings.get("meshdir", "")
            places = [path, path.partition("/")[2], posixpath.join(folder, posixpath.basename(path))]
            relative = [posixpath.join(self._folder, place) for place in filter(None, places)]
            decoded = [unquote(place) for place in relative]  # a filename is a URI, but few programs quote it
            token.attributes["filename"] = self._asset(document, token, name, [*relative, *decoded])

    def _asset(self, document: Document, element: Element, name: str, places: Iterable[str]) -> str:
        content = self._find(document, element, name, places)[0].read_bytes()
        if content.startswith(PNG) and int.from_bytes(content[16:20]) * int.from_bytes(content[20:24]) > NUMBERS:
            raise document.wrong(element, f"expected at most {NUMBERS:,} pixels, got more")
        new = self._files.new_name(name)
        self._files.assets[new] = content
        return new

    def _find(self, document: Document, element: Element, name: str, places: Iterable[str]) -> tuple[Path, str]:
        """Return the first of several files that exists, and its place relative to the folder of the main one."""
        what = f"{element.tag} {short(repr(name))}"
        for place in places:
            try:
                return beside(self._files.main, quote(place)), place
            except FileNotFoundError:
                continue
            except (FileFormatError, OSError, ValueError) as error:
                problem = f"{what}: only regular files beside or below {self._files.main} are read"
                hint = "to read others, load the model by mujoco and give it to lidarsim.mujoco.World"
                raise document.wrong(element, f"{problem}; {hint}") from error
        raise document.wrong(element, f"{what}: no such file beside or below {self._files.main}")

    def _weigh(self, document: Document) -> int:
        """Return the number of elements that a document stands for, and check it and the counts in it."""
        copies = [1]
        document.weight = 1
        for token in document.tokens:
            if isinstance(token, str):
                copies.pop()
                continue
            tag, times = token.tag.lower(), copies[-1]
            if tag in {"replicate", "composite", "flexcomp"}:
                times *= math.prod(_counts(token.attributes.get("count", "")))
            copies.append(times)
            document.weight += times * self._weight(token)
            if document.weight > COPIES + self._files.written:
                raise document.wrong(token, f"expected at most {COPIES:,} copies of elements, got more")
            if _numbers(token) > NUMBERS:
                raise document.wrong(token, f"expected at most {NUMBERS:,} numbers, got more")
        return document.weight

    def _weight(self, element: Element) -> int:
        """Return the number of elements that one stands for, without those within it."""
        tag, file = element.tag.lower(), element.attributes.get("file")
        if tag == "attach":
            return self._heaviest
        if tag == "include":
            return 1 + sum(self._weigh(other) for other in self._documents.values() if other.name == file)
        if tag == "model":  # which MuJoCo parses again for each
            return 1 + sum(other.weight for other in self._files.models.values() if other.name == file)
        return 1


def _numbers(element: Element) -> int:
    """Return how many numbers an element asks for by a count."""
    tag, attributes = element.tag.lower(), element.attributes
    if tag == "size":  # of memory and stack, MuJoCo touches only what it needs
        return sum(_counts(" ".join(value for key, value in attributes.items() if key not in {"memory", "nstack"})))
    if tag == "hfield":
        return math.prod(_counts(f"{attributes.get('nrow', '')} {attributes.get('ncol', '')}"))
    if tag == "mesh" and "builtin" in attributes:
        return max(_counts(attributes.get("params", "")), default=1) ** 2
    return 0


def _stem(name: str) -> str:
    return posixpath.splitext(posixpath.basename(name))[0]


def _counts(text: str) -> list[int]:
    """Return the numbers in a text that are beyond 1, rounded up."""
    found = []
    for number in re.findall(r"\d+(?:\.\d*)?(?:[eE]\+?\d{1,2})?", text):
        value = float(number)
        if value > 1:
            found.append(math.ceil(min(value, 1e18)))
    return found
