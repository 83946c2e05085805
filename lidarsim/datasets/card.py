"""The data card: a README.md that describes a data set, with histograms and pictures."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from lidarsim._shown import counted
from lidarsim._validation import short
from lidarsim.datasets.engine import RANGES
from lidarsim.errors import MissingExtraError
from lidarsim.patterns import describe
from lidarsim.rig import Rig
from lidarsim.viewers import show

if TYPE_CHECKING:
    from lidarsim.datasets.engine import Plan
    from lidarsim.sensor import Lidar

__all__ = ["write"]

BAR = 40
SPECIAL = re.compile(r"[\\`*\[\]<>&!|~$^{}]|(?<![^\W_])_|_(?![^\W_])|(?<=www)\.|:(?=//)|@", re.IGNORECASE)
"""Characters with a meaning in Markdown, HTML and tables; underscores only at the edge of a word."""


def write(plan: Plan, labels: Mapping[int, int], ranges: Sequence[int], pictures: int) -> None:
    """Write the card, with pictures of evenly spaced frames; without PyVista there are none.

    Parameters
    ----------
    plan : Plan
        The data set and its store.
    labels : mapping of int to int
        Number of points by label.
    ranges : sequence of int
        Number of points in each bin of `RANGES`.
    pictures : int
        Number of pictures.
    """
    recipe = plan.recipe
    points = sum(ranges)
    names = recipe.class_names
    classes = [(f"{label} | {escaped(names.get(label, ''))}", count) for label, count in sorted(labels.items())]
    spans = [f"{low:g} – {high:g} m" for low, high in itertools.pairwise(RANGES)]
    used = [index for index, count in enumerate(ranges) if count] or [0]
    run = recipe.source.run(0, 0)
    rig = run.sensor if isinstance(run.sensor, Rig) else None
    parts = rig.items() if rig else ()
    sensors = [f"{escaped(name)}: {_sensor(part.lidar)}" for name, part in parts] or [_sensor(run.lidar)]
    air = f"\nAir of the first frame: {escaped(str(run.scene.atmosphere))}.\n" if run.scene.atmosphere else ""
    text = f"""# {counted(recipe.sequences, "sequence")} of {counted(recipe.frames, "frame")}

{points:,} points, made by lidarsim {plan.versions["lidarsim"]} from `recipe.yaml` with the seed {recipe.seed}.
Layout: `{recipe.layout.type}`. `manifest.jsonl` has the SHA-256 of each file, and
`lidarsim generate --verify -o FOLDER` checks them.

Sensor{"s" * (len(sensors) != 1)}: {"; ".join(sensors)}.
{air}{recipe.layout.reading}
## Classes

{_table("label | name", classes, points)}
## Ranges

{_table("range", list(zip(spans, ranges, strict=True))[used[0] : used[-1] + 1], points)}"""
    if drawn := _pictures(plan, pictures):
        text += "\n## Frames\n" + "".join(f"\n![{about}]({name})\n\n{about}\n" for name, about in drawn)
    plan.store.write("README.md", text.encode())


def escaped(text: str) -> str:
    """Return Markdown that shows `text` literally, on one line."""
    shown = short("".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text))
    return SPECIAL.sub(r"\\\g<0>", shown)


def _sensor(lidar: Lidar) -> str:
    facts = describe(lidar.pattern)
    name, rings = escaped(type(lidar.pattern).__name__), counted(facts.rings, "ring")
    pattern = f"{name}, {rings}, {lidar.pattern.rate:g} Hz"
    return f"{escaped(lidar.model)} ({pattern})" if lidar.model else pattern


def _table(head: str, rows: Sequence[tuple[str, int]], points: int) -> str:
    """Return a table of points; `head` and the first item of a row may have several cells, ``a | b``."""
    most = max((count for _, count in rows), default=1)
    lines = [f"| {head} | points | share | |", "|---" * (head.count("|") + 1) + "|---:|---:|---|"]
    for what, count in rows:
        bar = "█" * round(BAR * count / max(most, 1))
        lines.append(f"| {what} | {count:,} | {count / max(points, 1):.2%} | {bar} |")
    return "\n".join(lines) + "\n"


def _pictures(plan: Plan, count: int) -> list[tuple[str, str]]:
    """Measure frames again and draw them, coloured by label; return the name and description of each picture."""
    recipe = plan.recipe
    total = recipe.sequences * recipe.frames
    drawn = []
    for index in sorted({round(k * (total - 1) / max(count - 1, 1)) for k in range(count)}):
        sequence, frame = divmod(index, recipe.frames)
        run = recipe.source.run(sequence, frame)
        number = run.frames.start + frame
        (scans,) = dataclasses.replace(run, frames=range(number, number + 1)).scans()
        name = f"pictures/{sequence:06}_{frame:06}.png"
        with TemporaryDirectory() as folder:
            path = Path(folder) / "frame.png"
            try:
                show(
                    scans,
                    scene=run.scene,
                    color_by="label",
                    class_names=recipe.class_names,
                    save=path,
                    size=(1200, 750),
                )
            except MissingExtraError:
                return []
            plan.store.write(name, path.read_bytes())
        drawn.append((name, f"Sequence {sequence}, frame {frame}"))
    return drawn
