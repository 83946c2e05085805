"""Models in folders: one object of a group for each file."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import yaml

from lidarsim._base.validation import short_repr
from lidarsim.config.document import Expanded, Node, Place, entries, folder_of, node_of, plain, replace, without
from lidarsim.worlds import CLASS_NAMES

__all__ = ["expand_files"]

MOST_FILES = 1000
"""Greatest number of files that a pattern may match: each is read where it is first drawn."""


def expand_files(root: Node) -> Node:
    """Return a recipe in which members of groups with ``files``, a pattern, are a scene file for each match.

    Their ``label`` may be the name of a class: of the recipe's class names, or of SemanticKITTI.

    Raises
    ------
    ConfigError
        If a pattern matches no file, or too many, or there is no such class.
    """
    found = entries(root)
    if "scatter" not in found:
        return root
    names: dict[str, str | int] = {name: label for label, name in CLASS_NAMES.items()}
    if "class_names" in found:
        names |= {str(plain(value)): label for label, (_, value) in entries(found["class_names"][1]).items()}
    for group, (_, node) in entries(found["scatter"][1]).items():
        if "objects" not in entries(node):
            continue
        objects = entries(node)["objects"][1]
        place = Place(root) / "scatter" / group / "objects"
        given = objects.value if isinstance(objects, yaml.SequenceNode) else [objects]
        if any("files" in entries(item) for item in given):
            value = Expanded("tag:yaml.org,2002:seq", [], objects.start_mark, objects.end_mark)
            value.written = []
            for index, item in enumerate(given):
                there = place if item is objects else place / index
                value.value += _members(item, there, names) if "files" in entries(item) else [item]
                value.written += [[] if item is objects else [str(index)]] * (len(value.value) - len(value.written))
            root = replace(root, ["scatter", group, "objects"], value)
    return root


def _members(item: Node, place: Place, names: dict[str, str | int]) -> Iterator[Node]:
    """Yield a scene file for each file that a member names by its pattern, in the order of their names."""
    own = entries(item)
    if "file" in own:
        raise (place / "file").error("expected either file or files, got both")
    if "shape" in own and (shape := plain(own["shape"][1])) != "scene_file":
        raise (place / "shape").error(f"expected none or scene_file beside files, got {short_repr(shape)}")
    node = own["files"][1]
    pattern, folder = plain(node), folder_of(node.start_mark)
    try:
        found = list(islice(folder.glob(pattern), MOST_FILES + 1))
    except (NotImplementedError, TypeError, ValueError):
        expected = "expected a pattern relative to this file, such as models/*.glb"
        raise (place / "files").error(f"{expected}, got {short_repr(pattern)}") from None
    files = sorted(path.relative_to(folder).as_posix() for path in found if path.is_file())
    if not 1 <= len(files) <= MOST_FILES:
        count = f"more than {MOST_FILES}" if files else "none"
        raise (place / "files").error(f"expected 1 to {MOST_FILES} files that match {short_repr(pattern)}, got {count}")
    changed = {"shape": node_of("scene_file", node)}
    if "label" in own and isinstance(label := plain(own["label"][1]), str):
        if label not in names:
            raise (place / "label").error(f"expected a number, or one of {', '.join(names)}, got {short_repr(label)}")
        changed["label"] = node_of(int(names[label]), own["label"][1])
    for file in files:
        member = without(item, "files")
        for key, value in {**changed, "file": node_of(file, node)}.items():
            member = replace(member, [key], value)
        yield member
