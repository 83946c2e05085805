"""YAML documents in which every value keeps its file and line.

Documents stay YAML nodes until they are complete: presets and changes are merged, and ``--set`` is applied, as nodes,
so an error always names the place where the offending value was written. Scalars follow the core schema of YAML 1.2:
``1e-3`` is a number, ``no`` is text, ``010`` is ten and ``0o10`` eight. Keys are words, and a mapping has each at most
once.

PyYAML scans and parses; ruamel.yaml takes twice as long, and merging, overriding and naming places would stay here.

`parse` checks the entire document, so that the other functions only see values that `plain` can return.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml

from lidarsim._base.files import check_regular, format_error
from lidarsim._base.validation import short, short_repr
from lidarsim.errors import ArgumentError, ArgumentTypeError, ConfigError, FileFormatError, LidarsimError

Node = yaml.Node
T = TypeVar("T")

MOST_BYTES, MOST_VALUES, MOST_DEPTH = 1 << 24, 1_000_000, 100
"""Limits of a document; values and characters of text count again each time an alias repeats them."""

MOST_DIGITS = 400
"""Longest text of an integer that is parsed; float64's range ends at 309 decimal digits."""

Loaded = dict[tuple[Path, Hashable], Any]
"""Objects read from files, by path and by reader or what else sets apart what is read."""

_OVERRIDE = "--set "
_TAG = "tag:yaml.org,2002:"


def _integer(text: str) -> int:
    if len(text) > MOST_DIGITS:  # int takes quadratic time, and refuses thousands of digits
        raise OverflowError
    number = int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
    float(number)
    return number


def _float(text: str) -> float:
    number = float(re.sub(r"\.(inf|nan)$", r"\1", text.lower()))
    if math.isinf(number) and not text.lower().endswith("inf"):
        raise OverflowError
    return number


_SCALARS: dict[str, Callable[[str], object]] = {
    f"{_TAG}null": lambda _: None,
    f"{_TAG}bool": lambda text: {"true": True, "false": False}[text.lower()],
    f"{_TAG}int": _integer,
    f"{_TAG}float": _float,
    f"{_TAG}str": str,
}


class _Core(yaml.resolver.BaseResolver):
    """Resolver of the plain scalars of YAML 1.2."""


for _name, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
):
    _Core.add_implicit_resolver(f"{_TAG}{_name}", re.compile(f"^(?:{_pattern})$"), _first)


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers = _Core.yaml_implicit_resolvers

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.depth = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        self.depth += 1
        if self.depth > MOST_DEPTH + 1:
            raise yaml.composer.ComposerError(None, None, "nested too deeply", self.get_mark())
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Dumper(yaml.SafeDumper):
    def resolve(self, kind: type[Node], value: Any, implicit: Any) -> str:
        # Quotes text that YAML 1.1 or 1.2 would read as something else.
        tag = str(super().resolve(kind, value, implicit))  # type: ignore[no-untyped-call]
        if kind is yaml.ScalarNode and tag == f"{_TAG}str":
            tag = str(_CORE.resolve(kind, value, implicit))  # type: ignore[no-untyped-call]
        return tag


def _represent_text(dumper: _Dumper, text: str) -> Node:
    # PyYAML's other styles lose some line breaks.
    return dumper.represent_scalar(f"{_TAG}str", text, None if text.isprintable() else '"')


_Dumper.add_representer(str, _represent_text)
_CORE = _Core()


def dump(value: Any) -> str:
    """Return YAML from which `parse` and `plain`, and other YAML readers, restore an equal value.

    Parameters
    ----------
    value : dict, list, str, int, float, bool or None
        The value; keys of mappings must be text.
    """
    text: str = yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=math.inf)
    return text


def parse(text: str, name: str) -> Node:
    """Return the node of the only YAML document in `text`; error messages call it `name`.

    Raises
    ------
    ConfigError
        If the text is not one YAML document, has duplicate keys, or has a value other than text, numbers, booleans and
        null.
    """
    loader: _Loader | None = None
    try:
        loader = _Loader(text)
        loader.name = name
        node = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        where = _describe_mark(error.problem_mark) if error.problem_mark else name
        raise ConfigError(f"{where}: not valid YAML: {short(_one_line(error.problem or error.context))}") from None
    except yaml.reader.ReaderError as error:
        where = _place(name, text.count("\n", 0, error.position))
        raise ConfigError(f"{where}: not valid YAML: character U+{ord(text[error.position]):04X}") from None
    except (OverflowError, ValueError):  # PyYAML's from chr and int
        where = _describe_mark(loader.get_mark()) if loader else name
        raise ConfigError(f"{where}: not valid YAML: an escape or a version is out of range") from None
    if node is None:
        raise ConfigError(f"{name}: expected YAML, got nothing")
    _check(node, (), {})
    return node


def read(path: Path) -> Node:
    """Return the node of the only YAML document in the file `path`, a mapping or a list.

    Raises
    ------
    ConfigError
        If the file cannot be read, or for the reasons of `parse`.
    """
    try:
        check_regular(path)
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except FileFormatError as error:
        raise ConfigError(str(error)) from None
    except (OSError, ValueError) as error:  # a name with a null character
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{_one_line(path)}: cannot read the file: {reason}") from None
    try:
        if len(content) > MOST_BYTES:
            raise ConfigError(f"{_one_line(path)}: expected at most {MOST_BYTES:,} bytes of YAML, got more")
        node = parse(content.decode("utf-8-sig"), str(path))
    except UnicodeDecodeError as error:
        where = _place(str(path), content.count(b"\n", 0, error.start))
        raise ConfigError(f"{where}: not valid YAML: byte {error.start} is not UTF-8") from None
    if isinstance(node, yaml.ScalarNode):  # shows no text: it may be any file
        raise ConfigError(f"{_one_line(path)}: expected a mapping or a list in YAML, got plain text")
    return node


def plain(node: Node) -> Any:
    """Return the Python value of `node`: dicts, lists, text, numbers, booleans, None."""
    if isinstance(node, yaml.MappingNode):
        return {key: plain(value) for key, (_, value) in entries(node).items()}
    if isinstance(node, yaml.SequenceNode):
        return [plain(value) for value in node.value]
    return _SCALARS[node.tag](node.value)


def entries(node: Node | None) -> dict[str, tuple[Node, Node]]:
    """Return the (key, value) nodes of a mapping by key; empty for any other node."""
    return {key.value: (key, value) for key, value in node.value} if isinstance(node, yaml.MappingNode) else {}


def without(node: Node, *keys: str) -> Node:
    """Return a mapping without some of its keys."""
    return _mapping({key: entry for key, entry in entries(node).items() if key not in keys}, node)


def merge(base: Node, difference: Node) -> Node:
    """Return `base` overridden by `difference`, with mappings merged recursively.

    Any other value replaces the one in `base`, and so does a mapping of another ``type``, since its keys differ.
    """
    if not isinstance(base, yaml.MappingNode) or not isinstance(difference, yaml.MappingNode):
        return difference
    old, new = entries(base), entries(difference)
    if "type" in old and "type" in new and old["type"][1].value != new["type"][1].value:
        return difference
    for key, (key_node, value) in new.items():
        old[key] = (key_node, merge(old[key][1], value) if key in old else value)
    return _mapping(old, difference)


def parse_assignment(assignment: str) -> tuple[list[str], Node]:
    """Return path and value of an assignment, ``scene.0.radius_m=2``: keys and list indices, then YAML.

    Raises
    ------
    ConfigError
        If it cannot be parsed.
    """
    name = f"{_OVERRIDE}{assignment}"
    path, equals, text = assignment.partition("=")
    keys = path_of(path)
    if not equals or not keys:
        raise ConfigError(f"{_short(name)}: expected KEY=VALUE, such as scene.0.radius_m=2")
    return keys, parse(text or "null", name)


def path_of(text: str) -> list[str]:
    """Return the keys and indices in ``scene.0.radius_m``; empty if the text is no path."""
    keys = text.split(".", MOST_DEPTH)
    return keys if all(keys) and "." not in keys[-1] else []


def node_of(value: object, place: Node) -> Node:
    """Return the node of a plain value, with the position of `place`.

    Raises
    ------
    TypeError
        If the value is of another type.
    """
    marks = place.start_mark, place.end_mark
    if isinstance(value, dict):
        items = [(node_of(str(key), place), node_of(item, place)) for key, item in value.items()]
        return yaml.MappingNode(f"{_TAG}map", items, *marks)
    if isinstance(value, list | tuple):
        return yaml.SequenceNode(f"{_TAG}seq", [node_of(item, place) for item in value], *marks)
    kinds = {float: "float", int: "int", str: "str", bool: "bool", type(None): "null"}
    if type(value) not in kinds:
        raise ArgumentTypeError("value", "numbers, text, or lists or mappings of them", short_repr(value))
    return yaml.ScalarNode(f"{_TAG}{kinds[type(value)]}", str(value), *marks)


def argument(name: str, value: object) -> Node:
    """Return the node of a plain value that a Python argument gives for a key."""
    mark = yaml.Mark(f"{_OVERRIDE}{name}={short_repr(value)}", 0, 0, 0, None, 0)
    return node_of(value, yaml.ScalarNode("", "", mark, mark))


def replace(node: Node | None, path: list[str], value: Node) -> Node:
    """Return `node` with `value` at `path`; missing mappings on the way are created."""
    if not path:
        return value
    head, *rest = path
    if isinstance(node, yaml.SequenceNode):
        index = int(head) if re.fullmatch(r"[0-9]{1,9}", head) else len(node.value)
        if index >= len(node.value):
            got = short_repr(head)
            raise ConfigError(
                f"{_describe_mark(value.start_mark)}: expected an index below {len(node.value)}, got {got}"
            )
        changed = list(node.value)
        changed[index] = replace(changed[index], rest, value)
        return yaml.SequenceNode(node.tag, changed, node.start_mark, node.end_mark)
    if isinstance(node, yaml.ScalarNode) and node.tag != f"{_TAG}null":
        raise ConfigError(
            f"{_describe_mark(value.start_mark)}: {short_repr(node.value)} has no key {short_repr(head)} to set"
        )
    found = entries(node)
    key, old = found.get(head, (None, None))
    if key is None or not rest:  # keys on the way keep their positions
        key = yaml.ScalarNode(f"{_TAG}str", head, value.start_mark, value.end_mark)
    found[head] = (key, replace(old, rest, value))
    return _mapping(found, node or value)


def _mapping(found: dict[str, tuple[Node, Node]], place: Node) -> Node:
    return yaml.MappingNode(f"{_TAG}map", list(found.values()), place.start_mark, place.end_mark)


class Expanded(yaml.SequenceNode):
    """A list in which several items may stand for one of the document.

    Attributes
    ----------
    written : list of list of str
        For each item the keys by which errors name it: the index of that one, or none if the document has no list.
    """

    written: list[list[str]]


@dataclass(frozen=True)
class Place:
    """A place in a document: ``Place(node) / "scene" / 0 / "radius_m"``."""

    root: Node
    keys: tuple[int | str, ...] = ()
    _loaded: Loaded = field(default_factory=dict, repr=False, compare=False)
    _entries: dict[Node, dict[str, tuple[Node, Node]]] = field(default_factory=dict, repr=False, compare=False)

    def __truediv__(self, key: int | str) -> Place:
        """Return the place of `key` in the value at this place."""
        return self.at((key,))

    def at(self, keys: tuple[int | str, ...]) -> Place:
        """Return the place at the end of a path of keys from here."""
        return Place(self.root, (*self.keys, *keys), self._loaded, self._entries)

    def _walk(self) -> tuple[yaml.Mark, list[str]]:
        # Keys that are not in the document are skipped: missing ones, and pydantic's tags of union members.
        node, mark, keys = self.root, self.root.start_mark, []
        for key in self.keys:
            if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
                keys += node.written[key] if isinstance(node, Expanded) else [str(key)]
                node = node.value[key]
                mark = node.start_mark
            elif isinstance(node, yaml.MappingNode) and key in (found := self._find(node)):
                keys.append(str(key))
                key_node, node = found[str(key)]
                mark = key_node.start_mark
        return mark, keys

    def _find(self, node: Node) -> dict[str, tuple[Node, Node]]:
        """Return the entries of a mapping, cached for documents with many errors."""
        if node not in self._entries:
            self._entries[node] = entries(node)
        return self._entries[node]

    @property
    def order(self) -> tuple[str, int]:
        """Sort key that orders places by their positions in the document."""
        mark, _ = self._walk()
        return mark.name, mark.index

    def error(self, problem: object) -> ConfigError:
        """Return the error for a `problem` at this place: ``file:line: key.key: problem``."""
        mark, keys = self._walk()
        key = ".".join(keys)
        told = not key or mark.name.startswith(f"{_OVERRIDE}{key}=")
        return ConfigError(": ".join([_describe_mark(mark), *([] if told else [_short(key)]), _one_line(problem)]))

    @contextmanager
    def refusals(self, keys: Mapping[str, tuple[str, str]] | None = None) -> Iterator[None]:
        """Turn an error in the block into one at this place.

        `keys` maps an argument that cannot be used to the path of its key, and to the unit to append to numbers if
        the key has another unit: a hint about units does not apply then. A key that is not in the document is named.
        """
        try:
            yield
        except ConfigError:
            raise
        except ArgumentError as error:
            if not keys or error.argument not in keys:
                raise self.error(format_error(error)) from error
            key, unit = keys[error.argument]
            after = unit if re.search(r"\d", error.problem) else ""
            hint = f"; {error.hint}" if error.hint and not unit else ""
            path = path_of(key)
            where = self.at(tuple(path))
            missing = ".".join(path[len(where._walk()[1]) - len(self._walk()[1]) :])
            raise where.error(f"{missing}{': ' * bool(missing)}{error.problem}{after}{hint}") from error
        except (LidarsimError, OSError, TypeError, ValueError) as error:
            raise self.error(format_error(error)) from error

    def file(self, name: str) -> Path:
        """Return the path of the file `name`, relative to the folder of the document that contains this place.

        Raises
        ------
        ConfigError
            If the file cannot be read.
        """
        mark, _ = self._walk()
        path = folder_of(mark) / name
        try:
            check_regular(path)
        except FileFormatError as error:
            raise self.error(error) from None
        except (OSError, ValueError) as error:  # a name with a null character
            raise self.error(f"cannot read {short(path)}: {getattr(error, 'strerror', error)}") from None
        return path

    def load(self, name: str, read: Callable[[Path], T], key: Hashable = None) -> T:
        """Return the object that `read` makes of the file `name`, shared by all places that name the file.

        A reader with settings is not the same function in another place: `key` then stands for it and its settings.

        Raises
        ------
        ConfigError
            If the file cannot be read.
        """
        path = self.file(name)
        entry = path, read if key is None else key
        if entry not in self._loaded:
            with self.refusals():
                self._loaded[entry] = read(path)
        loaded: T = self._loaded[entry]
        return loaded

    def find_loaded(self, kind: type[T]) -> tuple[T, ...]:
        """Return the objects of a type that `load` has read so far, each once."""
        return tuple(item for item in self._loaded.values() if isinstance(item, kind))


def folder_of(mark: yaml.Mark) -> Path:
    """Return the base folder of relative paths that are written at `mark`."""
    return Path() if mark.name.startswith(_OVERRIDE) else Path(mark.name).parent


def _describe_mark(mark: yaml.Mark) -> str:
    return _short(mark.name) if mark.name.startswith(_OVERRIDE) else _place(mark.name, mark.line)


def _place(name: str, line: int) -> str:
    return _one_line(name if name.startswith(_OVERRIDE) else f"{name}:{line + 1}")


def _one_line(text: object) -> str:
    """Return `text` with line breaks and control characters escaped."""
    whole = str(text)
    return whole if whole.isprintable() else repr(whole)[1:-1]


def _short(text: str) -> str:
    return short(_one_line(text))


@dataclass(frozen=True)
class _Extent:
    """Number of values within a value, including itself, their characters of text and their depth."""

    values: int
    characters: int
    depth: int


def _check(node: Node, keys: tuple[str, ...], known: dict[Node, _Extent | None]) -> _Extent:
    """Return the extent of `node`, found at `keys`, after checking it.

    `known` has the extents of the nodes visited so far, and None for nodes that are being visited.
    """
    if isinstance(node, yaml.ScalarNode):
        _check_scalar(node, keys)
        return _Extent(1, len(node.value), 0)
    if node not in known:
        known[node] = None
        children = _children(node)
        extents = [_check(child, (*keys, key), known) for key, child in children]
        extent = _Extent(
            1 + sum(part.values for part in extents),
            sum(part.characters for part in extents),
            1 + max((part.depth for part in extents), default=0),
        )
        where = _describe_mark(node.start_mark)
        if extent.values > MOST_VALUES:
            raise ConfigError(
                f"{where}: expected at most {MOST_VALUES:,} values, counting aliases, got {extent.values:,}"
            )
        if extent.characters > MOST_BYTES:
            raise ConfigError(
                f"{where}: expected at most {MOST_BYTES:,} characters, counting aliases, got {extent.characters:,}"
            )
        if extent.depth > MOST_DEPTH:  # through aliases
            raise ConfigError(f"{where}: not valid YAML: nested too deeply")
        known[node] = extent
    found = known[node]
    if found is None:
        raise ConfigError(f"{_describe_mark(node.start_mark)}: not valid YAML: this value contains itself")
    return found


def _check_scalar(node: Node, keys: tuple[str, ...]) -> None:
    """Check that a scalar has a type in `_SCALARS` and is within its range."""
    where = _describe_mark(node.start_mark)
    try:
        _SCALARS[node.tag](node.value)
    except OverflowError:
        key = [] if where.startswith(_OVERRIDE) or not keys else [_short(".".join(keys))]
        problem = f"expected a number from -1.8e308 to 1.8e308, got {short_repr(node.value)[1:-1]}"
        raise ConfigError(": ".join([where, *key, problem])) from None
    except (KeyError, ValueError):
        kind = _short(node.tag.removeprefix(_TAG))
        raise ConfigError(f"{where}: not valid YAML: {kind} is unknown or does not fit the value") from None
    _check_text(node)


def _check_text(node: Node) -> None:
    if re.search("[\ud800-\udfff]", node.value):
        raise ConfigError(
            f"{_describe_mark(node.start_mark)}: expected text, got half a character in {short_repr(node.value)}"
        )


def _children(node: Node) -> list[tuple[str, Node]]:
    """Return the values in `node` by key or index, after checking that its keys are distinct words."""
    kind = "map" if isinstance(node, yaml.MappingNode) else "seq"
    if node.tag != f"{_TAG}{kind}":
        tag = _short(node.tag.removeprefix(_TAG))
        raise ConfigError(
            f"{_describe_mark(node.start_mark)}: not valid YAML: {tag} is unknown or does not fit the value"
        )
    if kind == "seq":
        return [(str(index), value) for index, value in enumerate(node.value)]
    lines: dict[str, int] = {}
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise ConfigError(f"{_describe_mark(key.start_mark)}: expected a word as a key")
        _check_text(key)
        if key.value == "<<" and key.style is None:
            where = _describe_mark(key.start_mark)
            raise ConfigError(f"{where}: expected no merge key <<, which YAML 1.2 lacks; write out what it adds")
        if key.value in lines:
            raise ConfigError(
                f"{_describe_mark(key.start_mark)}: {_short(key.value)}: this key is already on line {lines[key.value]}"
            )
        lines[key.value] = key.start_mark.line + 1
    return [(key.value, value) for key, value in node.value]
