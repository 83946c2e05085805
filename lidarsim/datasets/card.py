"""The data card: a README.md that says what is in a data set, with histograms and pictures."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from lidarsim.datasets.engine import RANGES
from lidarsim.datasets.samples import samples
from lidarsim.errors import MissingExtraError
from lidarsim.patterns import describe
from lidarsim.rig import Rig
from lidarsim.viewers import show

if TYPE_CHECKING:
    from lidarsim.datasets.engine import Plan
    from lidarsim.sensor import Lidar

__all__ = ["write"]

BAR = 40


def write(plan: Plan, labels: Mapping[int, int], ranges: Sequence[int], pictures: int) -> None:
    """Write the card, and pictures of frames from the first to the last; without PyVista there are none.

    Parameters
    ----------
    plan : Plan
        What was made, and where.
    labels : mapping of int to int
        How many points have each label.
    ranges : sequence of int
        How many points are between each two of `RANGES`.
    pictures : int
        How many there are to be.
    """
    recipe = plan.recipe
    points = sum(ranges)
    classes = [(str(label), recipe.class_names.get(label, ""), count) for label, count in sorted(labels.items())]
    edges = [f"{low:g} – {high:g} m" for low, high in itertools.pairwise(RANGES)]
    used = [index for index, count in enumerate(ranges) if count] or [0]
    spans = [(edges[index], "", ranges[index]) for index in range(used[0], used[-1] + 1)]
    run = recipe.source.run(0, 0)
    sensors = (
        {name: part.lidar for name, part in run.sensor.items()} if isinstance(run.sensor, Rig) else {"": run.lidar}
    )
    told = [f"{name}: {_sensor(lidar)}" if name else _sensor(lidar) for name, lidar in sensors.items()]
    text = f"""# {recipe.sequences:,} sequences of {recipe.frames:,} frames

{points:,} points, made by lidarsim {plan.versions["lidarsim"]} from `recipe.yaml` with the seed {recipe.seed}.
{(type(recipe.layout).__doc__ or "").partition(".")[0]}. `manifest.jsonl` has the SHA-256 of each file, and
`lidarsim generate --verify -o FOLDER` checks them.

Sensors: {"; ".join(told)}.

## Classes

{_table(("label", "name"), classes, points)}
## Ranges

{_table(("range", ""), spans, points)}"""
    if drawn := _pictures(plan, pictures):
        text += "\n## Frames\n" + "".join(f"\n![{about}]({name})\n\n{about}\n" for name, about in drawn)
    plan.store.write("README.md", text.encode())


def _sensor(lidar: Lidar) -> str:
    facts = describe(lidar.pattern)
    return f"{type(lidar.pattern).__name__}, {facts.rings:,} rings, {lidar.pattern.rate:g} frames a second"


def _table(heads: tuple[str, str], rows: Sequence[tuple[str, str, int]], points: int) -> str:
    most = max((count for *_, count in rows), default=1)
    lines = [f"| {heads[0]} | {heads[1]} | points | share | |", "|---|---|---:|---:|---|"]
    for first, second, count in rows:
        bar = "█" * round(BAR * count / most)
        lines.append(f"| {first} | {second} | {count:,} | {count / max(points, 1):.2%} | {bar} |")
    return "\n".join(lines) + "\n"


def _pictures(plan: Plan, count: int) -> list[tuple[str, str]]:
    """Draw frames, which are measured again for it, coloured by label; return name and description of each."""
    recipe = plan.recipe
    total = recipe.sequences * recipe.frames
    drawn = []
    for number in sorted({round(index * (total - 1) / max(count - 1, 1)) for index in range(count)}):
        sequence, frame = divmod(number, recipe.frames)
        scans = {
            sample.record.sensor: sample.scan for sample in samples(recipe.source.run(sequence, frame), sequence, frame)
        }
        name = f"pictures/{sequence:06}_{frame:06}.png"
        with TemporaryDirectory() as folder:
            path = Path(folder) / "frame.png"
            try:
                show(scans, color_by="label", class_names=recipe.class_names, save=path, size=(1200, 750))
            except MissingExtraError:
                return []
            plan.store.write(name, path.read_bytes())
        drawn.append((name, f"Sequence {sequence}, frame {frame}"))
    return drawn
