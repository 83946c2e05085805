"""The data card: a README.md that describes a data set, with histograms and pictures."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from lidarsim._base.shown import plain, quantity
from lidarsim._base.validation import short
from lidarsim.datasets import manifest
from lidarsim.datasets.layouts import class_name
from lidarsim.datasets.samples import RANGES
from lidarsim.datasets.sampling import boxes_of, samples
from lidarsim.datasets.statistics import POINTS, VISIBILITY, BoxStatistics, box_statistics
from lidarsim.errors import MissingExtraError
from lidarsim.patterns import describe
from lidarsim.rig import Rig
from lidarsim.scan.scan import moment_of
from lidarsim.viewers import show

if TYPE_CHECKING:
    from lidarsim._base.views import Camera
    from lidarsim.datasets.layouts import Files, Summary
    from lidarsim.datasets.layouts._layout import BoxFilter
    from lidarsim.datasets.manifest import Plan
    from lidarsim.datasets.recipe import Recipe
    from lidarsim.datasets.samples import Record
    from lidarsim.datasets.scattered import Scattered
    from lidarsim.lidar import Lidar
    from lidarsim.run import Run
    from lidarsim.scan.boxes import Boxes

BAR = 40
CAMERAS: dict[Camera, str] = {"behind": "behind", "birds-eye": "above"}
"""Cameras of the pictures of a frame, and where they are in words."""
LISTED = 20
"""Greatest number of ranges of sequences that are listed for a split, and of objects for a group."""

SPECIAL = re.compile(r"[\\`*\[\]<>&!|~$^{}]|(?<![^\W_])_|_(?![^\W_])|(?<=www)\.|:(?=//)|@", re.IGNORECASE)
"""Characters with a meaning in Markdown, HTML and tables; underscores only at the edge of a word."""


def write(plan: Plan, run: Run, files: Files, summary: Summary, ranges: Sequence[int], *, pictures: int) -> None:
    """Write the card, with `pictures` of evenly spaced frames; without PyVista there are none.

    `run` is that of the first frame, and `ranges` has the number of points in each bin of `RANGES`.
    """
    recipe, labels = plan.recipe, summary.labels
    points = sum(ranges)
    names = recipe.class_names
    classes = [(f"{label} | {escape(names.get(label, ''))}", count) for label, count in sorted(labels.items())]
    spans = [f"{low:g} – {high:g} m" for low, high in itertools.pairwise(RANGES)]
    used = [index for index, count in enumerate(ranges) if count] or [0]
    rig = run.sensor if isinstance(run.sensor, Rig) else None
    parts = rig.items() if rig else ()
    sensors = [f"{escape(name)}: {_sensor(part.lidar)}" for name, part in parts] or [_sensor(run.lidar)]
    air = f"\nAir of the first frame: {escape(str(run.scene.atmosphere))}.\n" if run.scene.atmosphere else ""
    text = f"""# {quantity(recipe.sequences, "sequence")} of {quantity(recipe.frames, "frame")}

{quantity(points, "point")}, made by lidarsim {plan.versions["lidarsim"]} from `recipe.yaml` with the seed
{recipe.seed}. Layout: `{recipe.layout.type}`. `manifest.jsonl` has the SHA-256 of each file, and
`lidarsim generate --verify -o FOLDER` checks them. The command that made the data set makes lost files again, this card
among them.

Sensor{"s" * (len(sensors) != 1)}: {"; ".join(sensors)}. {_coordinates(recipe, run)}
{air}{_change(recipe)}{recipe.layout.reading}
{_splits(recipe, summary)}## Classes

{_table("label | name", classes, points)}
## Ranges

{_table("range", list(zip(spans, ranges, strict=True))[used[0] : used[-1] + 1], points)}"""
    if (box_filter := recipe.layout.box_filter) is not None:
        text += "\n" + _boxes(recipe, run, summary, box_filter)
    text += _describe_scattered(recipe, summary.scattered)
    if drawn := _pictures(plan, files, pictures):
        text += "\n## Frames\n" + "".join(f"\n![{about}]({name})\n\n{about}\n" for name, about in drawn)
    files.write(manifest.CARD, text.encode())


def escape(text: str) -> str:
    """Return Markdown that shows `text` literally, on one line."""
    return SPECIAL.sub(r"\\\g<0>", short(plain(text)))


def _coordinates(recipe: Recipe, run: Run) -> str:
    """Return in words what the coordinates of the points are."""
    frame, deskew = run.cloud["frame"], run.cloud["deskew"]
    moment = moment_of(deskew, 1.0)
    when = deskew if isinstance(deskew, str) else f"{moment:g} s after the start" if moment else "start"
    if frame == "world":
        text, to = "Points are in world coordinates", f"the {when} of the scan"
    elif moment is None:
        text = "Points are in the sensor frame at the moment of their pulse, not deskewed"
    else:
        text, to = f"Points are deskewed to the sensor frame at the {when} of the scan", "that moment"
        if isinstance(run.sensor, Rig) and recipe.layout.shares_stamp(0):
            text += " (in key frames, of that of the first sensor)"
    if recipe.layout.box_filter is None:
        return f"{text}."
    if moment is None:
        return f"{text}. Each box is where its points are on average, and points of fast instances may lie outside."
    return f"{text}, and points of moving instances are moved along to {to}, which is also that of the boxes."


def _change(recipe: Recipe) -> str:
    """Return in words which function changed the clouds."""
    name = recipe.after_scan and recipe.after_scan.name
    return f"\nAfter the scan, {escape(name)} changed each cloud.\n" if name else ""


def _splits(recipe: Recipe, summary: Summary) -> str:
    """Return the section on splits; empty without splits."""
    if not summary.splits:
        return ""
    rows = [
        (escape(name), f"{len(numbers):,}", f"{len(numbers) * recipe.frames:,}", _list_ranges(numbers))
        for name, numbers in summary.splits.items()
    ]
    return "## Splits\n\n" + _rows("split | sequences | frames | which", "lrrl", rows) + "\n"


def _list_ranges(numbers: Sequence[int]) -> str:
    """Return numbers as text, with ranges; abbreviated if long."""
    runs = [list(group) for _, group in itertools.groupby(enumerate(numbers), lambda pair: pair[1] - pair[0])]
    texts = [f"{run[0][1]}" + (f" – {run[-1][1]}" if len(run) > 1 else "") for run in runs]
    return ", ".join(texts[:LISTED]) + (", …" if len(texts) > LISTED else "")


def _boxes(recipe: Recipe, run: Run, summary: Summary, box_filter: BoxFilter) -> str:
    """Return the section on boxes."""
    frames = {name: len(numbers) * recipe.frames for name, numbers in summary.splits.items()}
    frames[""] = recipe.sequences * recipe.frames
    found = box_statistics(recipe.layout, summary.records(), in_world=run.cloud["frame"] == "world")
    count = sum(part.count for part in found.values())
    split = " | split" if summary.splits else ""
    names = {
        (label, part): escape(class_name(label, recipe.class_names)) + (f" | {escape(part)}" if split else "")
        for label, part in found
    }
    mean = [
        (names[key], f"{part.count:,}", f"{part.count / count:.2%}", f"{part.count / frames[key[1]]:.3g}",
         *(f"{value / part.count:.2f}" for value in part.size), f"{part.distance / part.count:.1f}",
         f"{part.points / part.count:.1f}")
        for key, part in found.items()
    ]  # fmt: skip
    head = "boxes", "share", "a frame", "length", "width", "height", "distance", "points"
    text = f"## Boxes\n\n{count:,} box{'es' * (count != 1)}, {_describe(box_filter)}."
    text += " Means: length, width, height and distance from the sensor in m, and points on an instance.\n\n"
    left = "ll" if split else "l"
    text += _rows(" | ".join([f"class{split}", *head]), left + "r" * len(head), mean)
    *few, (most, _) = itertools.pairwise(POINTS)
    whole = [*(f"{low:g}" if high - low == 1 else f"{low:g} – {high - 1:g}" for low, high in few), f"{most:g} or more"]
    spans = [f"{low:g} – {high:g} m" for low, high in itertools.pairwise(RANGES)]
    shares = [f"{low:.0%} – {high:.0%}" for low, high in itertools.pairwise(VISIBILITY)]
    histograms: dict[str, tuple[list[str], Callable[[BoxStatistics], Iterable[int]]]] = {
        "distance": (spans, lambda part: part.distances.tolist()),
        "points on an instance": (whole, lambda part: part.numbers.tolist()),
        "visibility": (shares, lambda part: part.visibilities.tolist()),
    }
    for title, (bins, counts) in histograms.items():
        table = {key: [*counts(part)] for key, part in found.items()}
        used = [index for index in range(len(bins)) if any(row[index] for row in table.values())] or [0]
        kept = range(used[0], used[-1] + 1)
        rows = [(names[key], *(f"{row[index]:,}" for index in kept)) for key, row in table.items()]
        text += f"\nBoxes by {title}:\n\n" + _rows(
            " | ".join([f"class{split}", *(bins[index] for index in kept)]), left + "r" * len(kept), rows
        )
    return text


def _describe(box_filter: BoxFilter) -> str:
    """Return a filter of boxes in words."""
    parts = [f"of instances with at least {quantity(box_filter.min_points, 'point')}"]
    if box_filter.max_range_m is not None:
        parts.append(f"within {box_filter.max_range_m:g} m")
    if box_filter.classes is not None:
        parts.append(f"of the classes {', '.join(escape(str(name)) for name in box_filter.classes)}")
    return ", ".join(parts)


def _describe_scattered(recipe: Recipe, scattered: Scattered) -> str:
    """Return the section on scattered objects; empty without groups."""
    if not scattered.groups:
        return ""
    given = recipe.to_dict()["scatter"]
    rows = [
        (escape(name), _members(**given[name]), str(tally.asked), str(tally.placed), escape(tally.rules))
        for name, tally in scattered.groups.items()
    ]
    text = "\n## Scattered objects\n\nObjects without room are left out; shares are of the places tried for these.\n"
    text += "\n" + _rows("group | objects, with their weights | asked | placed | places refused by", "llrrl", rows)
    return text + "".join(f"\nWarning: {escape(line)}.\n" for line in scattered.warnings())


def _members(objects: list[dict[str, Any]], weights: list[float] | None = None, **_: object) -> str:
    """Return what kinds of objects the members of a group are, each with its weight unless all are alike."""
    kinds = [escape(str(item.get("kind", item.get("file", item["shape"])))) for item in objects]
    texts = kinds if weights is None else [f"{kind} {weight:g}" for kind, weight in zip(kinds, weights, strict=True)]
    return ", ".join(texts[:LISTED]) + (", …" if len(texts) > LISTED else "")


def _rows(head: str, sides: str, rows: Iterable[Sequence[str]]) -> str:
    """Return a table, whose columns are aligned left (l) or right (r); a string may have several cells, ``a | b``."""
    line = "".join({"l": "|---", "r": "|---:"}[side] for side in sides)
    return "".join(f"{text}\n" for text in (f"| {head} |", f"{line}|", *(f"| {' | '.join(row)} |" for row in rows)))


def _sensor(lidar: Lidar) -> str:
    facts = describe(lidar.pattern)
    name, rings = escape(type(lidar.pattern).__name__), quantity(facts.rings, "ring")
    pattern = f"{name}, {rings}, {lidar.pattern.rate:g} Hz"
    return f"{escape(lidar.model)} ({pattern})" if lidar.model else pattern


def _table(head: str, rows: Sequence[tuple[str, int]], points: int) -> str:
    """Return a table of points; `head` and the first item of a row may have several cells, ``a | b``."""
    most = max((count for _, count in rows), default=1)
    cells = (
        (what, f"{count:,}", f"{count / max(points, 1):.2%}", "█" * round(BAR * count / max(most, 1)))
        for what, count in rows
    )
    return _rows(f"{head} | points | share |", "l" * (head.count("|") + 1) + "rrl", cells)


def _pictures(plan: Plan, files: Files, count: int) -> list[tuple[str, str]]:
    """Measure frames again and draw them from `CAMERAS`, by label and with the boxes of the data set.

    Returns the name and description of each picture.
    """
    recipe = plan.recipe
    total = recipe.sequences * recipe.frames
    drawn = []
    for index in sorted({round(k * (total - 1) / max(count - 1, 1)) for k in range(count)}):
        sequence, frame = divmod(index, recipe.frames)
        run = recipe.source.run(sequence, frame)
        number = run.frames.start + frame
        (scans,) = dataclasses.replace(run, frames=range(number, number + 1)).scans()
        changed = recipe.after_scan or recipe.layout.box_filter
        measured = list(samples(recipe, run, sequence, frame, scans)) if changed else []
        boxes = _boxes_of_frame(recipe, run, [sample.record for sample in measured])
        shown: dict[str, Any] = {**scans}
        view: dict[str, Any] = {}
        if recipe.after_scan:
            placed = run.cloud["frame"] == "world"
            for sample in measured:
                cloud, pose = sample.cloud, sample.record.matrix
                shown[sample.record.sensor] = cloud if placed else cloud.transformed(pose)
            view = {"pose": measured[0].record.matrix, "time": measured[0].record.seconds}
        for camera, place in CAMERAS.items():
            name = f"{manifest.PICTURES}/{sequence:06}_{frame:06}_{camera}.png"
            with TemporaryDirectory() as folder:
                path = Path(folder) / "frame.png"
                try:
                    show(
                        shown,
                        scene=run.scene,
                        boxes=boxes,
                        color_by="label",
                        class_names=recipe.class_names,
                        camera=camera,
                        save=path,
                        size=(1200, 750),
                        **view,
                    )
                except MissingExtraError:
                    return []
                files.write(name, path.read_bytes())
            drawn.append((name, f"Sequence {sequence}, frame {frame}, from {place}"))
    return drawn


def _boxes_of_frame(recipe: Recipe, run: Run, records: list[Record]) -> Boxes | None:
    """Return the boxes that the data set has of a frame, one of each instance, in world coordinates."""
    if recipe.layout.box_filter is None:
        return None
    instances = {box.instance: (record, box) for record, box in recipe.layout.annotations(records)}
    boxes = boxes_of([box for _, box in instances.values()], recipe.class_names)
    if run.cloud["frame"] == "world":
        return boxes
    poses = np.array([record.matrix for record, _ in instances.values()]).reshape(-1, 4, 4)
    center = (poses[:, :3, :3] @ boxes.center[:, :, None])[:, :, 0] + poses[:, :3, 3]
    return dataclasses.replace(boxes, center=center, rotation=poses[:, :3, :3] @ boxes.rotation)
