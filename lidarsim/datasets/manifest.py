"""Notes of a data set: its sources, one part per finished shard, and ``manifest.jsonl``, which lists all its files.

``manifest/start.json`` records the sources and versions of the data set. It claims the place: it is created only if
there is none, so if two data sets begin at once, one is refused. ``manifest/000000.json`` records that a shard is done.
``manifest.jsonl`` is written last, and completes the data set. Its first line is the claim with the number and the
SHA-256 of the lines after it; each of these names a file with its SHA-256, size and contents: points, the time of the
frame in its sequence, the seed of its noise. The files of a shard come before its part, and all others, such as tables,
after the last part.

After a kill at any moment, the same call can resume. Parts depend only on the recipe, so concurrent writers replace
files by equal ones and need not wait for each other. The parts stay: if a file of a shard is lost, this shard is made
again, and if a table is lost, all tables are made again from the parts.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import re
import shutil
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from lidarsim._base.files import format_error, parsing
from lidarsim._base.shown import quantity
from lidarsim._base.validation import short
from lidarsim.datasets.samples import RANGES, Record
from lidarsim.datasets.scattered import Scattered
from lidarsim.datasets.store import check_path
from lidarsim.errors import FileFormatError, LidarsimError

if TYPE_CHECKING:
    from typing import BinaryIO

    from lidarsim.datasets.layouts import Layout
    from lidarsim.datasets.recipe import Recipe
    from lidarsim.datasets.store import Store

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


def _entry(name: str, data: bytes) -> Entry:
    return Entry(file=name, sha256=hashlib.sha256(data).hexdigest(), bytes=len(data))


class Part(_Note):
    """Notes of a shard: its files, the records of its samples, and the number of points by label and range.

    `recipe` is the SHA-256 of ``recipe.yaml``, and `scattered` has the counts of the sequences that begin in the shard.
    """

    recipe: Digest
    shard: Count
    files: list[Entry]
    records: list[Record]
    labels: dict[Annotated[str, Field(pattern="^[0-9]{1,10}$")], Count]
    ranges: Annotated[list[Count], Field(min_length=len(RANGES) - 1, max_length=len(RANGES) - 1)]
    scattered: Scattered = Scattered()


@dataclass(frozen=True)
class Plan:
    """Everything that a worker needs: recipe, store, and the data set's head with its sources and versions."""

    recipe: Recipe
    store: Store
    head: Head

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the packages that affect the bits."""
        return self.head.versions


_RECORD = TypeAdapter(Record)


@cache
def versions() -> dict[str, str]:
    """Return the versions of the packages that affect the bits."""
    return {name: importlib.metadata.version(name) for name in ("lidarsim", "numpy", "scipy")}


def part_name(shard: int) -> str:
    """Return the name of the part of a shard."""
    return f"{PARTS}/{shard:06}.json"


def start(plan: Plan, recipe: bytes, names: Collection[str]) -> tuple[bool, list[str]]:
    """Claim the place for a data set.

    Parameters
    ----------
    plan : Plan
        The data set and its store.
    recipe : bytes
        Content of ``recipe.yaml``.
    names : collection of str
        Top-level names of the layout.

    Returns
    -------
    complete : bool
        Whether the data set is complete.
    again : list of str
        Names of its own files that were lost or damaged: they are made again, the manifest when all shards are done.

    Raises
    ------
    FileFormatError
        If the notes of an existing data set are damaged.
    LidarsimError
        If the place has a data set with another recipe, other files or other versions, or files of no data set.
    """
    store, head = plan.store, plan.head
    again: list[str] = []
    for attempt in range(CLAIMS):
        time.sleep(0.05 * 2**attempt if attempt else 0.0)
        # The order matters: no claim and then no manifest means no data set when the files were listed.
        there = store.existing({MANIFEST, PARTS, RECIPE, CARD, PICTURES, *names})
        written = _read(store, RECIPE)
        others = [name for name in there if name != RECIPE or written != recipe]
        cut = False
        try:
            begun = _head(store, _START)
        except FileFormatError:
            cut = _is_cut(store) and {*others} <= {PARTS} and not finished_shards(store)
            if not (cut or is_complete(store)):
                raise
            begun = None
        try:
            whole = complete_head(store)
        except FileFormatError:
            if begun != head:
                raise
            whole = None
            store.remove(MANIFEST)
            again.append(MANIFEST)
        if cut and not whole:
            store.write(_START, head.line())  # a writer was killed before it made anything else
            continue
        found = whole or begun
        _check_claim(store, found, head, others)
        if found is None and not store.create(_START, head.line()):
            continue  # another call was first
        if whole is None and written not in {None, recipe}:
            raise LidarsimError(f"{store}/{RECIPE}: expected the recipe of the data set, got another file: remove it")
        if whole is not None and begun != head:
            store.write(_START, head.line())
            again.append(_START)
        if written != recipe:
            store.write(RECIPE, recipe)
            again += [RECIPE] * (found is not None)
        return whole is not None, again
    raise LidarsimError(f"{store}/{_START}: expected to write it or to read that of another, got neither")


def _check_claim(store: Store, found: Head | None, head: Head, others: Collection[str]) -> None:
    """Raise an error unless a place has the claim of this data set, or none and no `others`."""
    if found == head:
        return
    expected = f"{store}: expected an empty place or one with the same"
    if found is None:
        if others:
            names = short(", ".join(map(ascii, others)))
            raise LidarsimError(f"{expected} recipe, got {names}, which no data set noted as its own")
        return
    if found.recipe != head.recipe:
        raise LidarsimError(f"{expected} recipe, got another {RECIPE} there")
    key = next(key for key in Head.model_fields if getattr(found, key) != getattr(head, key))
    own, theirs = getattr(head, key), getattr(found, key)
    if isinstance(own, dict):
        own, theirs = (dict(sorted(one.items() - two.items())) for one, two in ((own, theirs), (theirs, own)))
    raise LidarsimError(f"{expected} {key} ({short(ascii(own))}), got {short(ascii(theirs))} there")


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


def finished_shards(store: Store) -> set[int]:
    """Return the shards that have a part, without reading it."""
    numbers = (_shard_of(f"{PARTS}/{name}") for name in store.sizes(PARTS))
    return {number for number in numbers if number is not None}


def write_part(store: Store, part: Part) -> None:
    """Record that a shard is done."""
    data = json.dumps(part.model_dump()).encode()
    if len(data) > NOTE:
        raise LidarsimError(f"shard_frames: expected shards of less than {NOTE:,} bytes of notes, got {len(data):,}")
    store.write(part_name(part.shard), data)


def _read_part(plan: Plan, shard: int) -> tuple[Part, bytes]:
    """Return the part of a shard, and the content of its file.

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
            recipe.layout.notes.model_validate(record.extra)
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
    return part, data


@dataclass(frozen=True)
class _Check:
    """Check of files: their sizes, from one listing per folder, and their contents if asked to."""

    store: Store
    contents: bool
    folders: dict[str, dict[str, int]] = field(default_factory=dict)

    def passes(self, entry: Entry) -> bool:
        """Return whether a file is there and, as far as checked, as its entry says."""
        folder, _, name = entry.file.rpartition("/")
        if folder not in self.folders:
            self.folders[folder] = self.store.sizes(folder)
        if self.folders[folder].get(name) != entry.bytes:
            return False
        return not self.contents or not _difference(self.store, entry.file, entry.sha256, entry.bytes)


def missing_shards(plan: Plan, shards: Iterable[int], *, contents: bool = False) -> dict[int, list[str]]:
    """Return the shards that must be made, each with the names of its lost or damaged files.

    These shards have no part, a damaged one, or one whose files are not there or of another size; with `contents`, the
    SHA-256 of each file is compared, too.
    """
    present, check = finished_shards(plan.store), _Check(plan.store, contents)
    found: dict[int, list[str]] = {}
    for shard in shards:
        try:
            part = _read_part(plan, shard)[0] if shard in present else None
        except (LidarsimError, FileNotFoundError):
            part = None
        gone = [] if part is None else [entry.file for entry in part.files if not check.passes(entry)]
        if part is None or gone:
            found[shard] = gone
    return found


def lost_files(store: Store, *, contents: bool) -> dict[int | None, list[str]]:
    """Return the files of a complete data set that are lost or damaged, by the shard that makes them; None for tables.

    These are missing or of another size; with `contents`, the SHA-256 of each file is compared, too.
    """
    check = _Check(store, contents)
    found: dict[int | None, list[str]] = {}
    names: list[str] = []
    for entry in _entries(store):
        if not check.passes(entry):
            names.append(entry.file)
        if (shard := _shard_of(entry.file)) is not None:
            if names:
                found[shard] = names
            names = []
    return found | ({None: names} if names else {})


def _shard_of(name: str) -> int | None:
    """Return the shard whose part is the file `name`; None if it is no part."""
    found = re.fullmatch(rf"{PARTS}/([0-9]{{6,18}})\.json", name)
    return int(found[1]) if found and part_name(int(found[1])) == name else None


def pictures(store: Store) -> int | None:
    """Return how many frames the pictures of a complete data set show; None if its manifest does not list its card."""
    names = [entry.file for entry in _entries(store)]
    drawn = {tuple(name.removesuffix(".png").split("_")[:2]) for name in names if name.startswith(f"{PICTURES}/")}
    return len(drawn) if CARD in names else None


def differences(store: Store, names: Collection[str]) -> list[str]:
    """Return how some files of a complete data set differ from their entries, one line each."""
    wanted = {*names}
    entries = (entry for entry in _entries(store) if entry.file in wanted)
    return list(filter(None, (_difference(store, entry.file, entry.sha256, entry.bytes) for entry in entries)))


def parts(plan: Plan) -> Iterator[Part]:
    """Yield the parts of all shards in order."""
    return (_read_part(plan, shard)[0] for shard in range(plan.recipe.shards))


def records(plan: Plan) -> Iterator[Record]:
    """Yield the records of all samples in order."""
    return (record for part in parts(plan) for record in part.records)


def recipe_of(store: Store) -> bytes:
    """Return the recipe of a complete data set.

    Raises
    ------
    FileFormatError
        If the data set is incomplete or there is none, or the manifest or the recipe is damaged.
    """
    head = complete_head(store)
    if head is None:
        raise FileFormatError(f"{store}: expected a complete data set of lidarsim.generate, got no {MANIFEST}")
    data = _read(store, RECIPE)
    if data is None or hashlib.sha256(data).hexdigest() != head.recipe:
        got = "none" if data is None else "another"
        raise FileFormatError(f"{store}/{RECIPE}: expected the recipe of the data set, got {got}")
    return data


@dataclass(frozen=True)
class Place:
    """Where the record of a sample is: the bytes `start` to `stop` of the part of a shard; and its split."""

    shard: int
    start: int
    stop: int
    split: str = ""


def places(store: Store) -> Iterator[Place]:
    """Yield the places of the records of a complete data set in order; each part is read once, and none is kept.

    Raises
    ------
    FileFormatError
        If a part is lost or damaged.
    """
    decoder, key = json.JSONDecoder(), b'"records": ['
    for entry in _entries(store):
        if (shard := _shard_of(entry.file)) is None:
            continue
        data = _read(store, entry.file) or b""
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            raise FileFormatError(f"{store}/{entry.file}: expected the notes of the shard, got another file or none")
        with parsing(f"{store}/{entry.file}", "part of a data set"):
            text = data.decode("ascii")
            start = data.index(key) + len(key)
            while text[start] != "]":
                record, stop = decoder.raw_decode(text, start)
                yield Place(shard, start, stop, record["split"])
                start = stop + len(", ") if text.startswith(", ", stop) else stop


def record(store: Store, place: Place, layout: Layout) -> Record:
    """Return the record at a place, with the notes of a layout.

    Raises
    ------
    FileFormatError
        If it is damaged.
    """
    name = part_name(place.shard)
    with store.open(name) as file:
        file.seek(place.start)
        data = file.read(place.stop - place.start)
    with _parsing(f"{store}/{name}"):
        found: Record = _RECORD.validate_json(data, strict=True)
        layout.notes.model_validate(found.extra)
    return found


def finish(plan: Plan, tables: Collection[dict[str, Any]]) -> None:
    """Write the manifest of the files of all shards and of the tables, which completes the data set.

    Raises
    ------
    LidarsimError
        If another data set was begun in the same place, which can happen in a store without conditional puts.
    """
    store, head = plan.store, plan.head
    if _head(store, _START) not in (None, head) and not complete_head(store):
        raise LidarsimError(f"{store}: another data set was begun here at the same time: choose another place")

    def lines() -> Iterator[bytes]:
        for shard in range(plan.recipe.shards):
            part, data = _read_part(plan, shard)
            entries = *part.files, _entry(part_name(shard), data)
            yield from (json.dumps(entry.model_dump()).encode() + b"\n" for entry in entries)
        yield from (json.dumps(entry).encode() + b"\n" for entry in (*tables, _entry(_START, head.line()).model_dump()))

    with store.writing(MANIFEST) as path, path.with_suffix(".lines").open("w+b") as rest:
        count, digest = 0, hashlib.sha256()
        for line in lines():
            count += 1
            digest.update(line)
            rest.write(line)
        rest.seek(0)
        with path.open("wb") as file:
            file.write(head.model_copy(update={"files": count, "lines": digest.hexdigest()}).line() + b"\n")
            shutil.copyfileobj(rest, file)


def is_complete(store: Store) -> bool:
    """Return whether there is a manifest, without reading it."""
    try:
        store.open(MANIFEST).close()
    except FileNotFoundError:
        return False
    return True


def complete_head(store: Store) -> Head | None:
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
        head = _read_manifest(store, file)
    return head.model_copy(update={"files": None, "lines": None})


def _read_manifest(store: Store, file: BinaryIO) -> Head:
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
        raise FileFormatError(f"{place}: expected {quantity(max(expected, 1), 'file')}, got {count}: it was cut")
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
    head = complete_head(store)
    if head is None:
        raise FileFormatError(f"{store}: no {MANIFEST}: the data set is incomplete")
    yield _difference(store, RECIPE, head.recipe, None)
    yield from (_difference(store, entry.file, entry.sha256, entry.bytes) for entry in _entries(store))


def _entries(store: Store) -> Iterator[Entry]:
    """Yield the entries of a manifest."""
    with store.open(MANIFEST) as file:
        _line(f"{store}/{MANIFEST}", file)
        for line in file:
            with _parsing(f"{store}/{MANIFEST}"):
                entry = Entry.model_validate_json(line)
            yield entry


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
        found = f"a file that cannot be read: {short(ascii(format_error(error))[1:-1])}"
    shown = short(ascii(name)[1:-1])
    if found != expected:
        return f"{shown}: expected SHA-256 {expected}, got {found}"
    return f"{shown}: expected {size:,} bytes, got {count:,}" if size not in {None, count} else ""
