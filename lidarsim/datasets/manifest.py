"""Notes of a data set: its sources, one part per finished shard, and ``manifest.jsonl``, which lists all its files.

``manifest/start.json`` records the sources and versions of the data set. It claims the place: it is created only if
there is none, so if two data sets begin at once, one is refused. ``manifest/000000.json`` records that a shard is done.
``manifest.jsonl`` is written last. Its first line is the claim with the number and the SHA-256 of the lines after it;
each of these names a file with its SHA-256, size and contents: points, the time of the frame in its sequence, the seed
of its noise. Once it exists, the data set is complete, and any call that sees it removes the other notes.

After a kill at any moment, the same call can resume. Parts depend only on the recipe, so concurrent writers replace
files by equal ones and need not wait for each other.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import re
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from lidarsim._base.files import told
from lidarsim._base.shown import counted
from lidarsim._base.validation import short
from lidarsim.datasets.samples import RANGES, Record
from lidarsim.datasets.store import check_path
from lidarsim.errors import FileFormatError, LidarsimError

if TYPE_CHECKING:
    from typing import BinaryIO

    from lidarsim.datasets.engine import Plan
    from lidarsim.datasets.store import Store

__all__ = [
    "MANIFEST", "PARTS", "Head", "Part", "complete", "done", "finish", "is_complete", "missing",
    "part_name", "parts", "records", "start", "tidy", "verify", "versions", "write_part",
]  # fmt: skip

MANIFEST, PARTS, RECIPE, CARD, PICTURES = "manifest.jsonl", "manifest", "recipe.yaml", "README.md", "pictures"
_START = f"{PARTS}/start.json"

NOTE, LINE = 1 << 30, 1 << 24
"""Greatest size of a note, and of a line of the manifest, bytes."""

CLAIMS = 10
"""Attempts to claim a place if a claim exists but cannot be read: network file systems show new files late."""

Count = Annotated[int, Field(ge=0, lt=2**63)]
Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _Note(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Head(_Note):
    """Recipe, versions and sources of a data set.

    Attributes
    ----------
    recipe : str
        SHA-256 of ``recipe.yaml``.
    seed : int
        Seed of the recipe.
    versions : dict of str to str
        Versions of the packages that affect the bits.
    sources : dict of str to str
        SHA-256 of each file that the recipe names.
    files : int, optional
        Number of lines that follow in the manifest; absent in manifests of lidarsim 0.1.
    lines : str, optional
        SHA-256 of these lines.
    """

    recipe: Digest
    seed: Annotated[int, Field(ge=0, lt=2**64)]
    versions: dict[str, str]
    sources: dict[str, str]
    files: Count | None = None
    lines: Digest | None = None

    def line(self) -> bytes:
        """Return it as JSON."""
        return json.dumps(self.model_dump(exclude_none=True)).encode()


class Entry(_Note):
    """A file of a data set, with its layout's notes."""

    model_config = ConfigDict(extra="allow")

    file: Annotated[str, AfterValidator(check_path)]
    sha256: Digest
    bytes: Count


class Part(_Note):
    """Notes of a shard: its files, the records of its samples, and the number of points by label and range.

    `recipe` is the SHA-256 of ``recipe.yaml``.
    """

    recipe: Digest
    shard: Count
    files: list[Entry]
    records: list[Record]
    labels: dict[Annotated[str, Field(pattern="^[0-9]{1,10}$")], Count]
    ranges: Annotated[list[Count], Field(min_length=len(RANGES) - 1, max_length=len(RANGES) - 1)]


def versions() -> dict[str, str]:
    """Return the versions of the packages that affect the bits."""
    return {name: importlib.metadata.version(name) for name in ("lidarsim", "numpy", "scipy")}


def part_name(shard: int) -> str:
    """Return the name of the part of a shard."""
    return f"{PARTS}/{shard:06}.json"


def start(plan: Plan, recipe: bytes, names: Collection[str]) -> bool:
    """Claim the place for a data set, and return whether it is already complete.

    Parameters
    ----------
    plan : Plan
        The data set and its store.
    recipe : bytes
        Content of ``recipe.yaml``.
    names : collection of str
        Top-level names of the layout.

    Raises
    ------
    FileFormatError
        If the notes of an existing data set are damaged.
    LidarsimError
        If the place has a data set with another recipe, other files or other versions, or files of no data set.
    """
    store, head = plan.store, plan.head
    for attempt in range(CLAIMS):
        time.sleep(0.05 * 2**attempt if attempt else 0.0)
        # The order matters: no claim and then no manifest means no data set when the files were listed.
        there = store.taken({MANIFEST, PARTS, RECIPE, CARD, PICTURES, *names})
        written = _read(store, RECIPE)
        others = [name for name in there if name != RECIPE or written != recipe]
        cut = False
        try:
            begun = _head(store, _START)
        except FileFormatError:
            cut = _is_cut(store) and {*others} <= {PARTS} and not done(store)
            if not (cut or is_complete(store)):
                raise
            begun = None
        whole = complete(store)
        if cut and not whole:
            store.write(_START, head.line())  # a writer was killed before it made anything else
            continue
        found = whole or begun
        if found is None:
            if others:
                raise LidarsimError(
                    f"{store}: expected an empty place or one with the same recipe, got "
                    f"{short(', '.join(map(ascii, others)))}, which no data set noted as its own"
                )
            if not store.create(_START, head.line()):
                continue  # another call was first
        elif found.recipe != head.recipe:
            raise LidarsimError(
                f"{store}: expected an empty place or one with the same recipe, got another {RECIPE} there"
            )
        elif found != head:
            key = next(key for key in Head.model_fields if getattr(found, key) != getattr(head, key))
            raise LidarsimError(
                f"{store}: expected an empty place or one with the same {key} ({getattr(head, key)}), got "
                f"{short(ascii(getattr(found, key)))} there"
            )
        if whole is None and written is None:
            store.write(RECIPE, recipe)
        elif whole is None and written != recipe:
            raise LidarsimError(f"{store}/{RECIPE}: expected the recipe of the data set, got another file: remove it")
        return whole is not None
    raise LidarsimError(f"{store}/{_START}: expected to write it or to read that of another, got neither")


def _is_cut(store: Store) -> bool:
    """Return whether the claim is truncated, which a kill can cause where there are no links."""
    begun, beginning = _read(store, _START) or b"", b'{"recipe":'
    return begun.startswith(beginning[: len(begun)])


def _read(store: Store, name: str) -> bytes | None:
    """Return the content of a note, or None if there is none."""
    try:
        with store.open(name) as file:
            size = file.seek(0, os.SEEK_END)
            if size > NOTE:
                raise FileFormatError(f"{store}/{name}: expected at most {NOTE:,} bytes, got {size:,}")
            file.seek(0)
            return file.read(size)
    except FileNotFoundError:
        return None


@contextmanager
def _parsing(place: str) -> Iterator[None]:
    """Turn a validation error in a note into one line that names the place."""
    try:
        yield
    except ValidationError as invalid:
        error = invalid.errors(include_url=False, include_context=False, include_input=False)[0]
        keys, problem = ".".join(map(str, error["loc"])), error["msg"].removeprefix("Value error, ")
        where = f"{short(ascii(keys)[1:-1])}: " if keys else ""
        raise FileFormatError(f"{place}: damaged: {where}{short(problem)}") from None


def _head(store: Store, name: str) -> Head | None:
    data = _read(store, name)
    if data is None:
        return None
    with _parsing(f"{store}/{name}"):
        return Head.model_validate_json(data)


def done(store: Store) -> set[int]:
    """Return the shards that have a part, without reading it."""
    numbers = (re.fullmatch(r"([0-9]{6,18})\.json", name) for name in store.names(PARTS))
    return {int(found[1]) for found in numbers if found and part_name(int(found[1])) == f"{PARTS}/{found[0]}"}


def write_part(store: Store, part: Part) -> None:
    """Record that a shard is done."""
    data = json.dumps(part.model_dump()).encode()
    if len(data) > NOTE:
        raise LidarsimError(f"shard_frames: expected shards of less than {NOTE:,} bytes of notes, got {len(data):,}")
    store.write(part_name(part.shard), data)


def _part(plan: Plan, shard: int) -> Part:
    """Return the part of a shard.

    Raises
    ------
    FileFormatError
        If the part is damaged, or belongs to another shard or recipe.
    FileNotFoundError
        If the shard has no part.
    """
    store, recipe, name = plan.store, plan.recipe, part_name(shard)
    data = _read(store, name)
    if data is None:
        raise FileNotFoundError(f"{store}/{name}: no such file")
    with _parsing(f"{store}/{name}"):
        part = Part.model_validate_json(data)
        for record in part.records:
            recipe.layout.noted.model_validate(record.extra)
    frames = [(sequence, frame) for sequence, frames in recipe.shard(shard) for frame in frames]
    recorded = dict.fromkeys((record.sequence, record.frame) for record in part.records)
    if part.recipe != plan.head.recipe or part.shard != shard or [*recorded] != frames:
        raise FileFormatError(f"{store}/{name}: expected the part of shard {shard}, got that of another or its like")
    if any(int(label) > recipe.layout.greatest_label for label in part.labels):
        raise FileFormatError(f"{store}/{name}: expected labels up to {recipe.layout.greatest_label}")
    turns = np.array([(record.pose, record.body) for record in part.records]).reshape(-1, 3, 4)[:, :, :3]
    # `_validation.pose` accepts rotations that are orthonormal to 1e-6 in each entry. The product of body and mount is
    # orthonormal to 1e-6 + 3 * 1e-6 * (1 + 3e-6), where 3e-6 bounds the norm of a matrix of such entries.
    with np.errstate(over="ignore", invalid="ignore"):
        rigid = (np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)) <= 5e-6).all() and (np.linalg.det(turns) > 0).all()
    if not rigid:
        raise FileFormatError(f"{store}/{name}: expected rigid poses")
    return part


def missing(plan: Plan, shards: Iterable[int]) -> list[int]:
    """Return the shards that have no part or a damaged one, and must be made."""
    present = done(plan.store)

    def is_made(shard: int) -> bool:
        try:
            return shard in present and _part(plan, shard) is not None
        except (LidarsimError, FileNotFoundError):
            return False

    return [shard for shard in shards if not is_made(shard)]


def parts(plan: Plan) -> Iterator[Part]:
    """Yield the parts of all shards in order."""
    return (_part(plan, shard) for shard in range(plan.recipe.shards))


def records(plan: Plan) -> Iterator[Record]:
    """Yield the records of all samples in order."""
    return (record for part in parts(plan) for record in part.records)


def finish(plan: Plan, tables: Collection[dict[str, Any]]) -> None:
    """Write the manifest of the files of all shards and of the tables, which completes the data set.

    Raises
    ------
    LidarsimError
        If another data set was begun in the same place, which can happen in a store without conditional puts.
    """
    store, head = plan.store, plan.head
    if _head(store, _START) not in (None, head) and not complete(store):
        raise LidarsimError(f"{store}: another data set was begun here at the same time: choose another place")

    def lines() -> Iterator[bytes]:
        for part in parts(plan):
            yield from (json.dumps(entry.model_dump()).encode() + b"\n" for entry in part.files)
        yield from (json.dumps(entry).encode() + b"\n" for entry in tables)

    count, digest = 0, hashlib.sha256()
    for line in lines():
        count += 1
        digest.update(line)
    whole = head.model_copy(update={"files": count, "lines": digest.hexdigest()})
    with store.writing(MANIFEST) as path, path.open("wb") as file:
        file.write(whole.line() + b"\n")
        file.writelines(lines())


def tidy(plan: Plan) -> None:
    """Remove the notes that a complete data set does not need, and the remains of killed writers."""
    made = done(plan.store).intersection(range(plan.recipe.shards))
    names = *map(part_name, sorted(made)), _START
    plan.store.remove(PARTS, [name.removeprefix(f"{PARTS}/") for name in names])
    plan.store.tidy()


def is_complete(store: Store) -> bool:
    """Return whether there is a manifest, without reading it."""
    try:
        store.open(MANIFEST).close()
    except FileNotFoundError:
        return False
    return True


def complete(store: Store) -> Head | None:
    """Return the head of the data set if it is complete, that is, if its manifest exists; else None.

    Raises
    ------
    FileFormatError
        If the manifest is damaged.
    """
    try:
        file = store.open(MANIFEST)
    except FileNotFoundError:
        return None
    with file:
        head = _whole(store, file)
    return head.model_copy(update={"files": None, "lines": None})


def _whole(store: Store, file: BinaryIO) -> Head:
    """Read and check an entire manifest, and return its head."""
    place = f"{store}/{MANIFEST}"
    with _parsing(f"{place}: line 1"):
        head = Head.model_validate_json(_line(place, file))
    count, digest = 0, hashlib.sha256()
    while line := _line(place, file):
        count += 1
        digest.update(line)
        with _parsing(f"{place}: line {count + 1}"):
            Entry.model_validate_json(line)
    expected = count if head.files is None else head.files
    if count != expected or not count:
        raise FileFormatError(f"{place}: expected {counted(max(expected, 1), 'file')}, got {count}: it was cut")
    if head.lines not in {None, digest.hexdigest()}:
        raise FileFormatError(
            f"{place}: expected lines of SHA-256 {head.lines}, got {digest.hexdigest()}: they changed"
        )
    return head


def _line(place: str, file: BinaryIO) -> bytes:
    line = file.readline(LINE + 1)
    if len(line) > LINE:
        raise FileFormatError(f"{place}: expected lines of at most {LINE:,} bytes, got a longer one")
    return line


def verify(store: Store) -> Iterator[str]:
    """Check each file of a data set, and yield its problem, or an empty string if it is intact.

    Raises
    ------
    FileFormatError
        If the manifest is missing or damaged.
    """
    try:
        file = store.open(MANIFEST)
    except FileNotFoundError:
        raise FileFormatError(f"{store}: no {MANIFEST}: the data set is incomplete") from None
    with file:
        head = _whole(store, file)
        yield _difference(store, RECIPE, head.recipe, None)
        file.seek(0)
        next(file)
        for line in file:
            with _parsing(f"{store}/{MANIFEST}"):
                entry = Entry.model_validate_json(line)
            yield _difference(store, entry.file, entry.sha256, entry.bytes)


def _difference(store: Store, name: str, expected: str, size: int | None) -> str:
    """Return in one line how a file differs from its manifest entry; empty if it does not."""
    digest, count = hashlib.sha256(), 0
    most = NOTE if size is None else size
    try:
        with store.open(name) as file:
            while count <= most and (block := file.read(1 << 20)):
                digest.update(block)
                count += len(block)
        found = digest.hexdigest()
    except FileNotFoundError:
        found = "no file"
    except (LidarsimError, OSError) as error:
        found = f"a file that cannot be read: {short(ascii(told(error))[1:-1])}"
    shown = short(ascii(name)[1:-1])
    if found != expected:
        return f"{shown}: expected SHA-256 {expected}, got {found}"
    return f"{shown}: expected {size:,} bytes, got {count:,}" if size not in {None, count} else ""
