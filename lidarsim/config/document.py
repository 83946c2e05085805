"""YAML whose every value knows the file and line that it was written on.

Documents stay YAML nodes until they are whole: a preset and the differences from it are merged, and ``--set`` is
applied, as nodes, so an error always names the place where the offending value was written. Scalars are read by the
core schema of YAML 1.2: ``1e-3`` is a number, ``no`` is text. Keys are words, each at most once in a mapping.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml

from lidarsim._files import check_regular, told
from lidarsim._validation import DEGREES, short, shown
from lidarsim.errors import ConfigError, FileFormatError, LidarsimError

Node = yaml.Node
T = TypeVar("T")

MOST_BYTES, MOST_VALUES, MOST_DEPTH = 1 << 24, 1_000_000, 100
"""Limits of a document; values count each time that an alias repeats them."""

Loaded = dict[tuple[Path, Callable[[Path], object]], Any]
"""Objects read from files, by path and reader."""

_OVERRIDE = "--set "
_TAG = "tag:yaml.org,2002:"
_SCALARS: dict[str, Callable[[str], object]] = {
    f"{_TAG}null": lambda _: None,
    f"{_TAG}bool": lambda text: {"true": True, "false": False}[text.lower()],
    f"{_TAG}int": lambda text: int(text, 0),
    f"{_TAG}float": lambda text: float(re.sub(r"\.(inf|nan)$", r"\1", text.lower())),
    f"{_TAG}str": str,
}


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers = {}  # noqa: RUF012 - as the parent has it


for _name, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?(0|[1-9][0-9]*)|0x[0-9a-fA-F]+", list("-+0123456789")),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
):
    _Loader.add_implicit_resolver(f"{_TAG}{_name}", re.compile(f"^(?:{_pattern})$"), _first)


def parse(text: str, name: str) -> Node:
    """Return the node of the one YAML document in `text`; `name` is what errors call it.

    Raises
    ------
    ConfigError
        If the text is not one YAML document, or has a key twice.
    """
    try:
        loader = _Loader(text)
        loader.name = name
        node = loader.get_single_node()
        if node is None:
            raise ConfigError(f"{name}: expected YAML, got nothing")
        _extent(node, {})
    except yaml.MarkedYAMLError as error:
        where = _written(error.problem_mark) if error.problem_mark else name
        raise ConfigError(f"{where}: not valid YAML: {short(error.problem or error.context)}") from None
    except yaml.reader.ReaderError as error:
        raise ConfigError(
            f"{name}: not valid YAML: character {error.character!r} at position {error.position}"
        ) from None
    except RecursionError:
        raise ConfigError(f"{name}: not valid YAML: nested too deeply") from None
    return node


def read(path: Path) -> Node:
    """Return the node of the one YAML document in the file `path`, a mapping or a list.

    Raises
    ------
    ConfigError
        If the file cannot be read, and as `parse` does.
    """
    try:
        check_regular(path)
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise ConfigError(f"{path}: expected at most {MOST_BYTES:,} bytes of YAML, got more")
        node = parse(content.decode("utf-8-sig"), str(path))
    except FileFormatError as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the file: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not valid YAML: byte {error.start} is not UTF-8") from None
    if isinstance(node, yaml.ScalarNode):  # its text is not shown: it may be any file
        raise ConfigError(f"{path}: expected a mapping or a list in YAML, got plain text")
    return node


def plain(node: Node) -> Any:
    """Return the Python value of `node`: dicts, lists, text, numbers, booleans, None."""
    if isinstance(node, yaml.MappingNode) and node.tag == f"{_TAG}map":
        return {key: plain(value) for key, (_, value) in entries(node).items()}
    if isinstance(node, yaml.SequenceNode) and node.tag == f"{_TAG}seq":
        return [plain(value) for value in node.value]
    try:
        return _SCALARS[node.tag](node.value)
    except (KeyError, TypeError, ValueError):
        kind = node.tag.removeprefix(_TAG)
        raise ConfigError(
            f"{_written(node.start_mark)}: not valid YAML: {short(kind)} is unknown or does not fit the value"
        ) from None


def entries(node: Node | None) -> dict[str, tuple[Node, Node]]:
    """Return the (key, value) nodes of a mapping by key; none for any other node."""
    return {key.value: (key, value) for key, value in node.value} if isinstance(node, yaml.MappingNode) else {}


def without(node: Node, *keys: str) -> Node:
    """Return a mapping less some of its keys."""
    return _mapping({key: entry for key, entry in entries(node).items() if key not in keys}, node)


def merge(base: Node, difference: Node) -> Node:
    """Return `base` with the values of `difference` put over it, mapping by mapping.

    Anything but a mapping replaces the value there, as does a mapping of another ``type``, whose keys differ.
    """
    if not isinstance(base, yaml.MappingNode) or not isinstance(difference, yaml.MappingNode):
        return difference
    old, new = entries(base), entries(difference)
    if "type" in old and "type" in new and old["type"][1].value != new["type"][1].value:
        return difference
    for key, (key_node, value) in new.items():
        old[key] = (key_node, merge(old[key][1], value) if key in old else value)
    return _mapping(old, difference)


def override(node: Node, assignment: str) -> Node:
    """Return `node` with one value replaced or added, as ``scene.0.radius_m=2`` says.

    Raises
    ------
    ConfigError
        If the assignment cannot be read, or leads into a value that has no keys.
    """
    return replace(node, *assigned(assignment))


def assigned(assignment: str) -> tuple[list[str], Node]:
    """Return path and value of an assignment, ``scene.0.radius_m=2``: keys and list indices, then YAML.

    Raises
    ------
    ConfigError
        If it cannot be read.
    """
    name = f"{_OVERRIDE}{assignment}"
    path, equals, text = assignment.partition("=")
    keys = path.split(".")
    if not equals or not all(keys) or len(keys) > MOST_DEPTH:
        raise ConfigError(f"{name}: expected KEY=VALUE, such as scene.0.radius_m=2")
    return keys, parse(text or "null", name)


def written(value: object, place: Node) -> Node:
    """Return the node of a number, of text or of a list of them, as if it stood where `place` stands.

    Raises
    ------
    TypeError
        If it is something else.
    """
    if isinstance(value, list):
        items = [written(item, place) for item in value]
        return yaml.SequenceNode(f"{_TAG}seq", items, place.start_mark, place.end_mark)
    kinds = {float: "float", int: "int", str: "str"}
    if type(value) not in kinds:
        raise TypeError(f"value: expected numbers or text, got {shown(value)}")
    return yaml.ScalarNode(f"{_TAG}{kinds[type(value)]}", str(value), place.start_mark, place.end_mark)


def replace(node: Node | None, path: list[str], value: Node) -> Node:
    """Return `node` with `value` at `path`; mappings that are missing on the way are made."""
    if not path:
        return value
    head, *rest = path
    if isinstance(node, yaml.SequenceNode):
        if not head.isdecimal() or int(head) >= len(node.value):
            raise ConfigError(f"{_written(value.start_mark)}: expected an index below {len(node.value)}, got {head!r}")
        changed = list(node.value)
        changed[int(head)] = replace(changed[int(head)], rest, value)
        return yaml.SequenceNode(node.tag, changed, node.start_mark, node.end_mark)
    if isinstance(node, yaml.ScalarNode) and node.tag != f"{_TAG}null":
        raise ConfigError(f"{_written(value.start_mark)}: {shown(node.value)} has no key {head!r} to set")
    found = entries(node)
    key, old = found.get(head, (None, None))
    if key is None or not rest:  # keys on the way to the value stay where they were written
        key = yaml.ScalarNode(f"{_TAG}str", head, value.start_mark, value.end_mark)
    found[head] = (key, replace(old, rest, value))
    return _mapping(found, node or value)


def _mapping(found: dict[str, tuple[Node, Node]], place: Node) -> Node:
    return yaml.MappingNode(f"{_TAG}map", list(found.values()), place.start_mark, place.end_mark)


@dataclass(frozen=True)
class Place:
    """A place in a document: ``Place(node) / "scene" / 0 / "radius_m"``."""

    root: Node
    keys: tuple[int | str, ...] = ()
    _loaded: Loaded = field(default_factory=dict, repr=False, compare=False)

    def __truediv__(self, key: int | str) -> Place:
        """Return the place of `key` in the value here."""
        return Place(self.root, (*self.keys, key), self._loaded)

    def _walk(self) -> tuple[yaml.Mark, list[str]]:
        # Keys that are not in the document are passed over: a missing one, or pydantic's tag of a union's member.
        node, mark, keys = self.root, self.root.start_mark, []
        for key in self.keys:
            if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
                node = node.value[key]
                mark = node.start_mark
            elif key in (found := entries(node)):
                key_node, node = found[str(key)]
                mark = key_node.start_mark
            else:
                continue
            keys.append(str(key))
        return mark, keys

    @property
    def order(self) -> tuple[str, int]:
        """Sorts places as they are written."""
        mark, _ = self._walk()
        return mark.name, mark.index

    def error(self, problem: object) -> ConfigError:
        """Return the error that `problem` was met here: ``file:line: key.key: problem``."""
        mark, keys = self._walk()
        key = ".".join(keys)
        told = not key or mark.name.startswith(f"{_OVERRIDE}{key}=")
        return ConfigError(": ".join([_written(mark), *([] if told else [short(key)]), str(problem)]))

    @contextmanager
    def refusals(self, keys: Mapping[str, tuple[str, str]] | None = None) -> Iterator[None]:
        """Turn an error from within the block into one at this place.

        Our errors begin with the argument: if `keys` has it, its key stands there instead, and what to add to numbers.
        """
        try:
            yield
        except ConfigError:
            raise
        except (LidarsimError, OSError, TypeError, ValueError) as error:
            argument, _, problem = told(error).removesuffix(DEGREES).partition(": ")
            if keys and argument in keys:
                key, addition = keys[argument]
                raise (self / key).error(problem + (addition if re.search(r"\d", problem) else "")) from error
            raise self.error(told(error)) from error

    def file(self, name: str) -> Path:
        """Return the path of the file `name`, which is relative to the folder of the file in which this place is.

        Raises
        ------
        ConfigError
            If the file cannot be read.
        """
        mark, _ = self._walk()
        path = (Path() if mark.name.startswith(_OVERRIDE) else Path(mark.name).parent) / name
        try:
            check_regular(path)
            path.open("rb").close()
        except FileFormatError as error:
            raise self.error(error) from None
        except (OSError, ValueError) as error:  # a name with a null character
            raise self.error(f"cannot read {short(path)}: {getattr(error, 'strerror', error)}") from None
        return path

    def load(self, name: str, read: Callable[[Path], T]) -> T:
        """Return what `read` makes of the file `name`: the same object wherever the document names that file.

        Raises
        ------
        ConfigError
            If the file cannot be read.
        """
        path = self.file(name)
        if (path, read) not in self._loaded:
            with self.refusals():
                self._loaded[path, read] = read(path)
        loaded: T = self._loaded[path, read]
        return loaded


def _written(mark: yaml.Mark) -> str:
    return str(mark.name) if mark.name.startswith(_OVERRIDE) else f"{mark.name}:{mark.line + 1}"


def _extent(node: Node, known: dict[Node, tuple[int, int] | None]) -> tuple[int, int]:
    """Return how many values `node` holds, itself included, and how deep they are, after checking that it may be used.

    `known` has the extents of the nodes seen so far, each of which is looked at once, and None while it is looked at.
    """
    if isinstance(node, yaml.ScalarNode):
        return 1, 0
    if node not in known:
        known[node] = None
        children = [value for _, value in node.value] if _has_keys(node) else node.value
        extents = [_extent(child, known) for child in children]
        values, depth = 1 + sum(values for values, _ in extents), 1 + max((depth for _, depth in extents), default=0)
        if values > MOST_VALUES:
            where = _written(node.start_mark)
            raise ConfigError(f"{where}: expected at most {MOST_VALUES:,} values, counting aliases, got {values:,}")
        if depth > MOST_DEPTH:
            raise ConfigError(f"{_written(node.start_mark)}: not valid YAML: nested too deeply")
        known[node] = values, depth
    extent = known[node]
    if extent is None:
        raise ConfigError(f"{_written(node.start_mark)}: not valid YAML: this value contains itself")
    return extent


def _has_keys(node: Node) -> bool:
    """Return whether `node` is a mapping, after checking that its keys are words and differ."""
    if not isinstance(node, yaml.MappingNode):
        return False
    lines: dict[str, int] = {}
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise ConfigError(f"{_written(key.start_mark)}: expected a word as a key")
        if key.value in lines:
            raise ConfigError(
                f"{_written(key.start_mark)}: {short(key.value)}: this key is already on line {lines[key.value]}"
            )
        lines[key.value] = key.start_mark.line + 1
    return True
