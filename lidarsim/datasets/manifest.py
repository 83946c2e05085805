"""What is done: one part per shard while a data set is made, and ``manifest.jsonl`` of all its files in the end.

The first line of the manifest says what the data set was made from and with which versions; each further line names a
file, its SHA-256 and size, and what is in it: points, the time of the frame in its sequence, the seed of its noise.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from lidarsim.datasets.samples import Record
from lidarsim.errors import FileFormatError, LidarsimError

if TYPE_CHECKING:
    from lidarsim.datasets.store import Store

__all__ = ["MANIFEST", "PARTS", "done", "part_name", "parts", "records", "start", "verify", "versions"]

MANIFEST, PARTS, RECIPE = "manifest.jsonl", "manifest", "recipe.yaml"
_HEAD = f"{PARTS}/start.json"


def versions() -> dict[str, str]:
    """Return the versions of the packages that the bits depend on."""
    return {name: importlib.metadata.version(name) for name in ("lidarsim", "numpy", "scipy")}


def part_name(shard: int) -> str:
    """Return the name of the part that says that a shard is done."""
    return f"{PARTS}/{shard:06}.json"


def start(store: Store, recipe: bytes, head: dict[str, Any]) -> bool:
    """Note what the data set is made from, and return whether it is complete already.

    Raises
    ------
    LidarsimError
        If there is a data set of another recipe, of other files, or of other versions.
    """
    present = _read(store, RECIPE)
    if present is not None and present != recipe:
        raise LidarsimError(f"{store}: expected an empty place or one with the same recipe, got another {RECIPE} there")
    whole = _read(store, MANIFEST)
    begun = _read(store, _HEAD) if whole is None else whole.partition(b"\n")[0]
    if begun is not None and (found := json.loads(begun)) != head:
        key = next(key for key in {**head, **found} if head.get(key) != found.get(key))
        raise LidarsimError(
            f"{store}: expected an empty place or one with the same {key} ({head.get(key)}), got {found.get(key)} there"
        )
    if whole is None:
        store.write(RECIPE, recipe)
        store.write(_HEAD, json.dumps(head).encode())
    return whole is not None


def _read(store: Store, name: str) -> bytes | None:
    try:
        with store.open(name) as file:
            return file.read()
    except FileNotFoundError:
        return None


def done(store: Store) -> set[int]:
    """Return the shards that are done."""
    names = (name.removesuffix(".json") for name in store.names(PARTS))
    return {int(name) for name in names if name.isdecimal()}


def parts(store: Store, count: int) -> Iterator[dict[str, Any]]:
    """Yield the parts of all shards in their order."""
    for shard in range(count):
        with store.open(part_name(shard)) as file:
            yield json.load(file)


def records(store: Store, count: int) -> Iterator[Record]:
    """Yield the records of all samples in their order."""
    for part in parts(store, count):
        yield from map(Record.of, part["records"])


def verify(store: Store) -> Iterator[str]:
    """Check each file of a data set; yield the name of each, with what is wrong with it, or nothing, after it.

    Raises
    ------
    FileFormatError
        If there is no manifest.
    """
    try:
        with store.open(MANIFEST) as file:
            lines = file.read().splitlines()
    except FileNotFoundError:
        raise FileFormatError(f"{store}: no {MANIFEST}: the data set is incomplete") from None
    for line in lines[1:]:
        entry = json.loads(line)
        try:
            with store.open(entry["file"]) as file:
                digest = hashlib.sha256()
                while block := file.read(1 << 20):
                    digest.update(block)
            found = digest.hexdigest()
        except FileNotFoundError:
            found = "no file"
        yield "" if found == entry["sha256"] else f"{entry['file']}: expected SHA-256 {entry['sha256']}, got {found}"
