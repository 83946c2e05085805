"""A data set from its recipe to its manifest."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from lidarsim._validation import integer
from lidarsim.datasets import Generated, card, manifest
from lidarsim.datasets.engine import RANGES, Made, Plan, make
from lidarsim.datasets.layouts import Files, Summary
from lidarsim.datasets.progress import Progress
from lidarsim.datasets.store import open_store

if TYPE_CHECKING:
    from distributed import Client

    from lidarsim._files import PathLike
    from lidarsim.datasets.recipe import Recipe

__all__ = ["run"]


def run(
    recipe: Recipe, output: PathLike, client: Client | None, part: tuple[int, int], pictures: int
) -> tuple[Generated, list[Made]]:
    """Make what is missing of a data set; return how much that was, and the shards that failed."""
    count = integer("part", part[1], at_least=1)
    mine = integer("part", part[0], at_least=0, at_most=count - 1)
    pictures = integer("pictures", pictures, at_least=0)
    plan = Plan(recipe, open_store(output), manifest.versions())
    resolved = yaml.safe_dump(recipe.resolved(), sort_keys=False, allow_unicode=True).encode()
    head = {
        "recipe": hashlib.sha256(resolved).hexdigest(), "seed": recipe.seed, "versions": plan.versions,
        "sources": recipe.source.files(),
    }  # fmt: skip
    if manifest.start(plan.store, resolved, head):
        _tidy(plan)
        return Generated(0, 0, 0.0, 0), []
    present = manifest.done(plan.store)
    there = sum(len(frames) for shard in present for _, frames in recipe.shard(shard))
    pending = [shard for shard in range(mine, recipe.shards, count) if shard not in present]
    with Progress(recipe.sequences * recipe.frames, there) as progress:
        failed = [made for made in make(plan, pending, client, progress.add) if made.problem]
        seconds = progress.seconds
    left = recipe.shards - len(manifest.done(plan.store))
    if not left:
        _finish(plan, head, pictures)
    return Generated(progress.new, progress.points, seconds, left), failed


def _finish(plan: Plan, head: dict[str, Any], pictures: int) -> None:
    """Write tables, card and manifest: all shards are there."""
    store, recipe = plan.store, plan.recipe
    labels: Counter[int] = Counter()
    ranges = np.zeros(len(RANGES) - 1, np.int64)
    for part in manifest.parts(store, recipe.shards):
        labels.update({int(label): count for label, count in part["labels"].items()})
        ranges += part["ranges"]
    names = {label: f"class_{label}" for label in sorted(labels) if label} | recipe.class_names
    tables = Files(store)
    summary = Summary(lambda: manifest.records(store, recipe.shards), dict(labels), names, head["recipe"])
    recipe.layout.finish(tables, summary)
    card.write(plan, labels, ranges.tolist(), pictures)
    whole = Files(store)
    with whole.local(manifest.MANIFEST) as path, path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps(head) + "\n")
        for part in manifest.parts(store, recipe.shards):
            file.writelines(json.dumps(entry) + "\n" for entry in part["files"])
        file.writelines(json.dumps(entry) + "\n" for entry in tables.entries)
    _tidy(plan)


def _tidy(plan: Plan) -> None:
    plan.store.remove(manifest.PARTS)
    plan.store.tidy()
