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
from contextlib import suppress
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import NoReturn
from urllib.parse import quote, unquote
from xml.parsers import expat

from lidarsim._base.files import beside
from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError
from lidarsim.io._records import EXPANSION
from lidarsim.io.scenes.others import refusal

DEPTH = 256
"""Maximum depth of elements, those of included documents in their place; MuJoCo recurses over them."""

COPIES = 20_000
"""Maximum number of elements that `replicate`, `attach` and the like add to those that are written. The time that
MuJoCo takes grows with their square: half a minute for so many geoms."""

NUMBERS = 20_000_000
"""Maximum number of numbers that a model may ask MuJoCo for by counts, such as those of user data and heights, or by
naming a file again; what the files themselves hold has no limit."""

PER_KEY = 7
"""Numbers of a keyframe for each element: a free body has 13, and is two elements, the body and its joint."""

PER_VERTEX, PER_HEIGHT = 100, 16
"""Numbers that are made of a vertex of a built-in mesh of MuJoCo, with its faces and its hull, and of a height of a
height field."""

RANGE_FIELDS, CONTACT_FIELDS = 14, 17
"""Numbers of a pixel of a range finder and of a contact, if all their data are asked for."""

FOLDERS = ("assetdir", "meshdir", "texturedir", "strippath")
"""Attributes of ``compiler`` that say where files are."""

ASSETS = {"mesh", "hfield", "skin", "flexcomp"}
"""Elements of MJCF that name a file of geometry."""

PNG = b"\x89PNG\r\n\x1a\n"
VERTEX = 12
"""Fewest bytes of a vertex in a file, three float32."""


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
    """A parsed document, its name in memory, and what it stands for: elements, and numbers by count."""

    path: Path
    name: str
    tokens: list[Token]
    weight: int = 0
    numbers: int = 0

    @property
    def elements(self) -> Iterator[Element]:
        """The elements in the order of the document."""
        return (token for token in self.tokens if isinstance(token, Element))

    def to_xml(self) -> str:
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
    """A model with everything that it names."""

    main: Path
    """The file; all others must be beside or below it."""
    xml: str = ""
    assets: dict[str, bytes] = field(default_factory=dict)
    """The files that it names."""
    names: dict[str, str] = field(default_factory=dict)
    """How the original documents call each of them."""
    models: dict[Path, Document] = field(default_factory=dict)
    """The models that it attaches."""
    written: int = 0
    """Number of elements in all documents."""
    unseen: int = 0
    """Number of links of a URDF that have visuals and no collision, of which MuJoCo keeps nothing."""
    contents: dict[Path, bytes] = field(default_factory=dict)
    """What the files of geometry hold, read once."""
    repeated: dict[str, int] = field(default_factory=dict)
    """Numbers of each name of a file that others name as well, and of each image beyond what its bytes allow."""
    pixels: int = 1
    """Most pixels of a camera."""
    vertices: int = 0
    """Most vertices of a mesh."""
    keys: int = 0
    """Number of keyframes."""
    each: int = 0
    """Numbers that each element of a kind may have: user data, and those of defaults."""

    def new_name(self, original: str) -> str:
        """Return a name for a file in memory, with the suffix by which MuJoCo knows the format."""
        suffix = posixpath.splitext(original)[1].lower()
        name = f"lidarsim{len(self.names)}{suffix if re.fullmatch(r'[.][a-z0-9]{1,8}', suffix) else ''}"
        self.names[name] = original
        return name


def collect(path: Path) -> Closed:
    """Return the model of a file, closed over the files that it names, after checking all that it asks for."""
    files = Closed(path)
    main = _Model(files, path, "", ()).main
    if main.numbers + main.weight * (files.each + PER_KEY * files.keys) > NUMBERS:
        raise FileFormatError(f"{path}: expected at most {NUMBERS:,} numbers in user data, defaults and keys, got more")
    files.xml = main.to_xml()
    del files.assets[main.name]
    return files


def root_of(path: Path) -> str:
    """Return the name of the root element of a file; empty if it is no XML."""
    found: list[str] = []
    for encoding in (None, "iso-8859-1"):  # the latter if the file names one that Python does not know
        parser = expat.ParserCreate(encoding)
        parser.StartElementHandler = lambda name, _: found.append(name)
        with path.open("rb") as file, suppress(expat.ExpatError, LookupError, ValueError):
            while not found and (part := file.read(1 << 16)):
                parser.Parse(part)
            parser.Parse(b"", True)  # what it holds back, in case more of the element comes
    return found[0] if found else ""


def parse(path: Path, name: str, depth: int = 0) -> Document:
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
        self._heaviest = self._most_numbers = 0  # of the attached models
        self.main = self._read(path, folder, 0)
        root = next(self.main.elements)
        if root.tag.lower() == "sdf":
            raise self.main.wrong(root, refusal(".sdf"))
        if root.tag.lower() not in {"mujoco", "robot"}:
            raise self.main.wrong(root, f"expected the root element mujoco or robot, got {short(root.tag)}")
        urdf = root.tag.lower() == "robot"
        for document in self._documents.values():
            if urdf:
                self._robot(document)
            else:
                for element in document.elements:
                    self._mujoco(document, element)
        for document in self._documents.values():
            self._survey(document)
        self._weigh(self.main)
        for document in self._documents.values():
            files.assets[document.name] = document.to_xml().encode()

    def _read(self, path: Path, folder: str, depth: int) -> Document:
        """Parse a document and those that it includes, and collect where their files are, as MuJoCo's first pass."""
        document = parse(path, self._files.new_name(path.name), depth)
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
        self._most_numbers = max(self._most_numbers, models[found].numbers)
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
            if token.tag.startswith("xacro:") or any(
                "${" in value or "$(" in value for value in token.attributes.values()
            ):
                raise document.wrong(token, refusal(".xacro"))
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
        files = self._files
        path = self._find(document, element, name, places)[0]
        new = files.new_name(name)
        again = path in files.contents
        content = files.assets[new] = files.contents.setdefault(path, path.read_bytes())
        if content.startswith(PNG):
            heights = int.from_bytes(content[16:20]) * int.from_bytes(content[20:24])
            files.repeated[new] = max(0, PER_HEIGHT * heights - (0 if again else EXPANSION * len(content)))
        elif again:
            files.repeated[new] = len(content) // VERTEX
        files.vertices = max(files.vertices, len(content) // VERTEX)
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

    def _weigh(self, document: Document) -> None:
        """Count the elements and the numbers that a document stands for, and check them."""
        copies = [1]
        document.weight, document.numbers = 1, 0
        for token in document.tokens:
            if isinstance(token, str):
                copies.pop()
                continue
            tag, times = token.tag.lower(), copies[-1]
            if tag in {"replicate", "composite", "flexcomp"}:
                times *= math.prod(_counts(token.attributes.get("count", "")))
            copies.append(times)
            weight, numbers = self._asks(token)
            document.weight += times * weight
            document.numbers += times * numbers
            if document.weight > COPIES + self._files.written:
                raise document.wrong(token, f"expected at most {COPIES:,} copies of elements, got more")
            if document.numbers > NUMBERS:
                raise document.wrong(token, f"expected at most {NUMBERS:,} numbers, got more")

    def _asks(self, element: Element) -> tuple[int, int]:
        """Return the numbers of elements that one stands for, and of numbers, without those of elements within it."""
        tag, file = element.tag.lower(), element.attributes.get("file")
        if tag == "attach":
            return self._heaviest, self._most_numbers
        if tag == "include":
            included = [other for other in self._documents.values() if other.name == file]
            for other in included:
                self._weigh(other)
        elif tag == "model":  # which MuJoCo parses again for each
            included = [other for other in self._files.models.values() if other.name == file]
        else:
            elements = 2 if tag == "flexcomp" else 1  # a point is a body with joints
            return elements, self._numbers(element) + self._files.repeated.get(file or "", 0)
        return 1 + sum(other.weight for other in included), sum(other.numbers for other in included)

    def _survey(self, document: Document) -> None:
        """Note what elements of others refer to: the largest camera and mesh, keyframes, user data and defaults."""
        files, defaults = self._files, 0
        for token in document.tokens:
            if isinstance(token, str):
                defaults -= token.lower() == "default"
                continue
            tag, attributes = token.tag.lower(), token.attributes
            defaults += tag == "default"
            if tag == "size":
                users = [value for key, value in attributes.items() if key.startswith("nuser_")]
                files.each += sum(_counts(" ".join(users)))
                files.keys += sum(_counts(attributes.get("nkey", "")))
            files.keys += tag == "key"
            files.each = max(files.each, len(attributes.get("user", "")) // 2)  # a digit and a blank for each number
            if defaults and "nsample" in attributes:
                files.each += math.prod(_counts(attributes["nsample"]))
            if "resolution" in attributes:
                files.pixels = max(files.pixels, math.prod(_counts(attributes["resolution"])))
            if tag == "mesh":
                given = len(attributes.get("vertex", "")) // 6  # three digits and as many blanks
                files.vertices = max(files.vertices, given, _find_built_in(attributes))

    def _numbers(self, element: Element) -> int:
        """Return how many numbers an element asks for by counts."""
        tag, attributes = element.tag.lower(), element.attributes

        def product(*names: str) -> int:
            return math.prod(_counts(" ".join(attributes.get(name, "") for name in names)))

        match tag:
            case "size":  # of memory and stack, MuJoCo touches only what it needs
                counts = (value for key, value in attributes.items() if key not in {"memory", "nstack"})
                numbers = sum(_counts(" ".join(counts)))
            case "hfield":
                numbers = PER_HEIGHT * product("nrow", "ncol")
            case "mesh":
                numbers = PER_VERTEX * _find_built_in(attributes)
            case "numeric":
                numbers = product("size")
            case "flexcomp" | "flex":
                numbers = product("cellcount")
            case "user":
                numbers = product("dim")
            case "contact" if "num" in attributes:
                numbers = CONTACT_FIELDS * product("num")
            case "rangefinder" if "camera" in attributes:
                numbers = RANGE_FIELDS * self._files.pixels
            case "tactile":
                numbers = 3 * self._files.vertices
            case _:  # an actuator may have activations, others have a few numbers at most
                numbers = product("actdim") if "actdim" in attributes else 0
        if "nsample" in attributes:  # a history of what a sensor or an actuator had
            numbers = max(numbers, 1) * (1 + product("nsample"))
        return numbers


def _find_built_in(attributes: dict[str, str]) -> int:
    """Return the most vertices that a mesh of MuJoCo's own may have, 0 for others."""
    return max(_counts(attributes.get("params", "")), default=1) ** 2 if "builtin" in attributes else 0


def _stem(name: str) -> str:
    return posixpath.splitext(posixpath.basename(name))[0]


def _counts(text: str) -> list[int]:
    """Return the numbers in a text that are beyond 1, rounded up."""
    numbers = map(float, re.findall(r"\d+(?:\.\d*)?(?:[eE]\+?\d{1,2})?", text))
    return [math.ceil(min(number, 1e18)) for number in numbers if number > 1]
