"""Making a data set, from its recipe to its manifest."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from lidarsim._base.shown import quantity
from lidarsim.datasets import card, manifest
from lidarsim.datasets.engine import Made, make
from lidarsim.datasets.layouts import Files, Summary, class_name
from lidarsim.datasets.manifest import Plan
from lidarsim.datasets.progress import Progress
from lidarsim.datasets.result import Generated
from lidarsim.datasets.samples import RANGES
from lidarsim.datasets.scattered import Scattered
from lidarsim.datasets.store import open_store
from lidarsim.errors import FileFormatError, LidarsimError

if TYPE_CHECKING:
    from distributed import Client

    from lidarsim._base.files import PathLike
    from lidarsim.datasets.recipe import Recipe
    from lidarsim.run import Run


def run(
    recipe: Recipe, output: PathLike, client: Client | None, part: tuple[int, int], pictures: int, *, verify: bool
) -> tuple[Generated, list[Made]]:
    """Make the missing part of a data set; return what was made, and the shards that failed."""
    mine, count = part
    first = recipe.source.run(0, 0)
    recipe.layout.check(first)
    resolved = recipe.text().encode()
    head = manifest.Head(
        recipe=hashlib.sha256(resolved).hexdigest(),
        seed=recipe.seed,
        versions=manifest.versions(),
        sources=recipe.files(),
    )
    plan = Plan(recipe, open_store(output), head)
    try:
        complete, again = manifest.start(plan, resolved, recipe.layout.names(first, recipe.sequences))
    except FileFormatError as damaged:
        raise FileFormatError(f"{damaged}; choose another place, or remove the damaged data set") from None
    shards = range(recipe.shards)
    if complete:
        return _repair(plan, first, shards[mine::count], client, again, verify=verify)
    todo = manifest.missing_shards(plan, shards[mine::count], contents=verify)
    with Progress(recipe.sequences * recipe.frames, _count_present(plan, todo)) as progress:
        made = _make_until_complete(plan, todo, client, progress)
        failed = [shard for shard in made if shard.problem]
        # Other parts may have left damaged notes.
        if not failed and manifest.finished_shards(plan.store).issuperset(shards):
            rest = manifest.missing_shards(plan, (shard for shard in shards if shard not in todo))
            todo |= rest
            made += _make_until_complete(plan, rest, client, progress)
            failed = [shard for shard in made if shard.problem]
    left = 0
    try:
        if not manifest.is_complete(plan.store):
            left = len(set(shards) - manifest.finished_shards(plan.store)) or len(failed)
            if not left:
                _finish(plan, first, pictures)
    except (LidarsimError, OSError):
        if not manifest.is_complete(plan.store):
            raise
    if whole := manifest.complete_head(plan.store):  # by this call or another
        if whole != head:
            raise LidarsimError(f"{plan.store}: another data set was made here at the same time: choose another place")
        failed, left = [], 0
        plan.store.tidy()
    again += _list_lost_names(todo, failed)
    return _report(progress, left, again, made), failed


def _report(progress: Progress, left: int, again: Sequence[str], made: Sequence[Made]) -> Generated:
    """Return what was made; its time includes the tables and the data card."""
    return Generated(progress.new, progress.points, progress.seconds, left, tuple(again), _list_left_out(made))


def _repair(
    plan: Plan, first: Run, mine: Sequence[int], client: Client | None, again: list[str], *, verify: bool
) -> tuple[Generated, list[Made]]:
    """Make the lost and damaged files of a complete data set again: `mine` of the shards, and then the tables."""
    store = plan.store
    lost = manifest.lost_files(store, contents=verify)
    if not lost:
        store.tidy()
        return Generated(0, 0, 0.0, 0, tuple(again)), []
    tables = lost.pop(None, [])
    todo = {shard: lost[shard] for shard in mine if shard in lost}
    if tables:  # they are made from the parts of all shards
        todo = manifest.missing_shards(plan, mine) | todo
    with Progress(plan.recipe.sequences * plan.recipe.frames, _count_present(plan, todo)) as progress:
        made = list(make(plan, sorted(todo), client, progress.add))
    failed = [shard for shard in made if shard.problem]
    again = [*again, *_list_lost_names(todo, failed)]
    if wrong := manifest.differences(store, again):
        raise LidarsimError(
            f"{store}: {quantity(len(wrong), 'file')} made again, but not as in the manifest: {wrong[0]}"
        )
    left = len(lost.keys() - todo.keys()) or len(failed)
    if tables and not left:
        left = len(manifest.missing_shards(plan, range(plan.recipe.shards)))
        if not left:
            _finish(plan, first, manifest.pictures(store) or 0)
            again += tables
    store.tidy()
    return _report(progress, left, again, made), failed


def _count_present(plan: Plan, todo: Collection[int]) -> int:
    """Return the number of frames in the shards that are done and need not be made again."""
    shards = manifest.finished_shards(plan.store).intersection(range(plan.recipe.shards)).difference(todo)
    return sum(len(frames) for shard in shards for _, frames in plan.recipe.shard(shard))


def _make_until_complete(plan: Plan, shards: Iterable[int], client: Client | None, progress: Progress) -> list[Made]:
    """Make shards until another call has completed the data set, and return their results."""
    pending = itertools.takewhile(lambda _: not manifest.is_complete(plan.store), shards)
    return list(make(plan, pending, client, progress.add))


def _list_lost_names(todo: Mapping[int, list[str]], failed: Iterable[Made]) -> list[str]:
    """Return the names of the lost files of the shards that did not fail."""
    without = {made.shard for made in failed}
    return [name for shard, names in sorted(todo.items()) if shard not in without for name in names]


def _list_left_out(made: Iterable[Made]) -> tuple[str, ...]:
    """Return in words which scattered objects were left out in the sequences that begin in some shards."""
    return tuple(sum((shard.scattered for shard in made if not shard.problem), Scattered()).lines())


def _finish(plan: Plan, first: Run, pictures: int) -> None:
    """Write tables, card and manifest when all shards are done; `first` is the run of the first frame."""
    recipe = plan.recipe
    labels: Counter[int] = Counter()
    ranges = np.zeros(len(RANGES) - 1, np.int64)
    scattered, boxed = Scattered(), set[int]()
    for part in manifest.parts(plan):
        labels.update({int(label): count for label, count in part.labels.items()})
        ranges += part.ranges
        scattered += part.scattered
        boxed.update(box.label for record in part.records for box in record.boxes)
    names = {label: class_name(label, {}) for label in sorted(boxed.union(labels)) if label} | recipe.class_names
    tables = Files(plan.store)
    splits = recipe.splits.sequences(recipe.sequences)
    summary = Summary(
        lambda: manifest.records(plan),
        dict(labels),
        names,
        plan.head.recipe,
        splits,
        lambda: (entry.model_dump() for part in manifest.parts(plan) for entry in part.files),
        scattered,
    )
    recipe.layout.finish(tables, summary)
    card.write(plan, first, tables, summary, ranges.tolist(), pictures=pictures)
    manifest.finish(plan, tables.entries)
