"""Making a data set, from its recipe to its manifest."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from lidarsim._base.validation import integer
from lidarsim.datasets import Generated, card, manifest
from lidarsim.datasets.engine import RANGES, Made, Plan, make
from lidarsim.datasets.layouts import Files, Summary, class_name
from lidarsim.datasets.progress import Progress
from lidarsim.datasets.store import open_store
from lidarsim.errors import FileFormatError, LidarsimError

if TYPE_CHECKING:
    from distributed import Client

    from lidarsim._base.files import PathLike
    from lidarsim.datasets.recipe import Recipe

__all__ = ["run"]


def run(
    recipe: Recipe, output: PathLike, client: Client | None, part: tuple[int, int], pictures: int
) -> tuple[Generated, list[Made]]:
    """Make the missing part of a data set; return what was made, and the shards that failed."""
    count = integer("part", part[1], at_least=1)
    mine = integer("part", part[0], at_least=0, at_most=count - 1)
    pictures = integer("pictures", pictures, at_least=0)
    first = recipe.source.run(0, 0)
    recipe.layout.check(first)
    recipe.layout.check_labels(recipe.class_names, first.scene)
    resolved = recipe.text().encode()
    head = manifest.Head(
        recipe=hashlib.sha256(resolved).hexdigest(),
        seed=recipe.seed,
        versions=manifest.versions(),
        sources=recipe.source.files(),
    )
    plan = Plan(recipe, open_store(output), head)
    try:
        complete = manifest.start(plan, resolved, recipe.layout.names(first, recipe.sequences))
    except FileFormatError as damaged:
        raise FileFormatError(f"{damaged}; choose another place, or remove the damaged data set") from None
    if complete:
        manifest.tidy(plan)
        return Generated(0, 0, 0.0, 0), []
    shards = range(recipe.shards)
    present = manifest.done(plan.store).intersection(shards)
    there = sum(len(frames) for shard in present for _, frames in recipe.shard(shard))
    with Progress(recipe.sequences * recipe.frames, there) as progress:
        failed = _make(plan, manifest.missing(plan, shards[mine::count]), client, progress)
        if not failed and manifest.done(plan.store).issuperset(shards):  # other parts may have left damaged notes
            failed = _make(plan, manifest.missing(plan, shards), client, progress)
        seconds = progress.seconds
    left = 0
    try:
        if not manifest.is_complete(plan.store):
            left = len(set(shards) - manifest.done(plan.store)) or len(failed)
            if not left:
                _finish(plan, pictures)
    except (LidarsimError, OSError):
        if not manifest.is_complete(plan.store):
            raise
    if whole := manifest.complete(plan.store):  # by this call or another, which may have removed this one's notes
        if whole != head:
            raise LidarsimError(f"{plan.store}: another data set was made here at the same time: choose another place")
        failed, left = [], 0
        manifest.tidy(plan)
    return Generated(progress.new, progress.points, seconds, left), failed


def _make(plan: Plan, shards: list[int], client: Client | None, progress: Progress) -> list[Made]:
    """Make shards until another call has completed the data set, and return those that failed."""
    pending = itertools.takewhile(lambda _: not manifest.is_complete(plan.store), shards)
    return [made for made in make(plan, pending, client, progress.add) if made.problem]


def _finish(plan: Plan, pictures: int) -> None:
    """Write tables, card and manifest when all shards are done."""
    recipe = plan.recipe
    labels: Counter[int] = Counter()
    ranges = np.zeros(len(RANGES) - 1, np.int64)
    for part in manifest.parts(plan):
        labels.update({int(label): count for label, count in part.labels.items()})
        ranges += part.ranges
    boxed = {box.label for record in manifest.records(plan) for box in record.boxes}
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
    )
    recipe.layout.finish(tables, summary)
    card.write(plan, summary, ranges.tolist(), pictures)
    manifest.finish(plan, tables.entries)
