"""Twelve draws of each generator of `lidarsim.worlds`, a row for each; writes worlds.png.

Each is a pure function of its arguments and a random generator. Usage: python worlds.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lidarsim as ls

DRAWS, WIDTH = 12, 60.0  # draws in a row, and its width: each row has a scale of its own
ROWS = [  # of each: a generator, its kinds, and the space for a draw, m
    (ls.worlds.pedestrian, (None,), 1.8),
    (ls.worlds.furniture, ("lamp", "sign", "traffic_light", "bin", "bench", "bollard", "fence", "wall"), 4.4),
    (ls.worlds.vehicle, ("hatchback", "saloon", "estate", "suv", "van", "pickup", "motorcycle", "bicycle"), 5.6),
    (ls.worlds.tree, ("broadleaf", "conifer", "young", "hedge", "bush", "grass"), 7.5),
    (ls.worlds.building, ("house", "terrace", "block", "garage"), 26.0),
]
TURN = -0.9  # their fronts, along x, towards the camera

scene = ls.Scene(class_names=ls.worlds.CLASS_NAMES)
for row, (generator, kinds, space) in enumerate(ROWS):
    scale = WIDTH / DRAWS / space
    for number in range(DRAWS):
        rng = np.random.default_rng(number)
        kind = kinds[number % len(kinds)]
        asset = generator(rng) if kind is None else generator(kind, rng)
        place = np.eye(4)
        place[:2, :2] = (np.cos(TURN), -np.sin(TURN)), (np.sin(TURN), np.cos(TURN))
        place[:3, :3] *= scale
        place[:2, 3] = WIDTH / DRAWS * (number - (DRAWS - 1) / 2), 9.5 * row
        asset.add_to(scene, name=generator.__name__, transform=place)
    print(f"{DRAWS} draws of {generator.__name__}: {len(scene)} objects so far")

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
scene.plot(
    color_by="label",
    camera=[(4, -62, 44), (4, 18, 0), (0, 0, 1)],
    size=(1600, 900),
    save=folder / "worlds.png",
)
