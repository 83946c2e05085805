"""A street with traffic: one frame of a labelled drive, with a box around each car and person; writes street.png.

The recipe configs/recipes/detection.yaml makes a street for each drive, and sends cars, cyclists and people along it.
`lidarsim generate` makes a data set of it; this scans and draws one frame. Usage: python street.py [FOLDER]
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

from lidarsim.datasets.recipe import load

RECIPE = Path(__file__).parents[1] / "configs" / "recipes" / "detection.yaml"
SEQUENCE, FRAME = 5, 25

run = load(RECIPE).source.run(SEQUENCE)
((scan,),) = (scans.values() for scans in dataclasses.replace(run, frames=range(FRAME, FRAME + 1)).scans())
boxes = scan.boxes(frame="world", min_points=5)
for label, name in ((10, "car"), (30, "person")):
    of = boxes[boxes.label == label]
    print(f"{len(of)} boxes of class {name}, with {of.points.min():,} to {of.points.max():,} points each")

x, y, _ = run.pose.at(scan.time).translation
scan.plot(
    scene=run.scene,
    boxes=boxes[np.isin(boxes.label, [10, 18, 30, 31])],
    color_by="label",
    camera=[(x - 25, y - 6.5, 12), (x + 10, y + 1, 0), (0, 0, 1)],
    size=(1600, 900),
    save=Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "street.png",
)
