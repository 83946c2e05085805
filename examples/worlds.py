"""Twelve draws of each generator of `lidarsim.worlds`; writes worlds-vehicle.png and so on, by casting rays.

Each is a pure function of its arguments and a random generator or, as streets, a seed. Usage: python worlds.py [FOLDER]
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.image import imsave

import lidarsim as ls

SIZE, COLUMNS = 200, 6  # pixels of a draw, and draws in a row of the picture
KINDS = {
    "vehicle": ("hatchback", "saloon", "estate", "suv", "van", "pickup", "lorry", "bus", "motorcycle", "bicycle"),
    "pedestrian": (None,),
    "tree": ("broadleaf", "conifer", "young", "hedge", "bed", "bush", "grass"),
    "building": ("house", "terrace", "block", "garage"),
    "furniture": ("lamp", "sign", "traffic_light", "bin", "bench", "bollard", "fence", "wall"),
    "street": ("residential", "city", "rural", "car_park"),
}
COLORS = {
    "road": "666a70", "parking": "7c7f86", "sidewalk": "b5aea6", "other-ground": "a39a8c", "terrain": "9dbb6a",
    "vegetation": "4c8f3c", "trunk": "7a5a3c", "building": "dcb98a", "fence": "b0764c", "pole": "8a8f96",
    "traffic-sign": "d8392f", "car": "5c86d6", "truck": "8367c7", "other-vehicle": "d98b3a", "person": "d9634f",
    "motorcyclist": "c0508f", "bicyclist": "c0508f",
}  # fmt: skip
GLASS, REST, SKY = (0.4, 0.55, 0.62), bytes.fromhex("d8d8d4"), (0.93, 0.95, 0.97)
SUN = np.array([0.5, -0.55, 0.67])

Floats = npt.NDArray[np.float64]


@cache
def color(name: str) -> tuple[float, ...]:
    """Return the colour of a class, RGB."""
    code = bytes.fromhex(COLORS[name]) if name in COLORS else REST
    return tuple(part / 255 for part in code)


def view(scene: ls.Scene, low: npt.ArrayLike, high: npt.ArrayLike, down: float) -> Floats:
    """Return a picture (rows, columns, RGB) of what is in a box, seen from x, somewhat from -y, and from above."""
    ahead = np.array([-np.cos(0.65), np.sin(0.65), 0.0]) * np.cos(down) - (0.0, 0.0, np.sin(down))
    right = np.cross(ahead, (0, 0, 1)) / np.cos(down)
    axes = np.stack([right, np.cross(ahead, right), ahead])  # to the right, downwards, ahead
    corners = np.stack(np.meshgrid(*np.transpose([low, high])), axis=-1).reshape(-1, 3) @ axes.T
    span = 1.06 * np.ptp(corners[:, :2], axis=0).max()
    grid = (np.arange(SIZE) + 0.5) / SIZE * span - span / 2
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    across, below = np.meshgrid(middle[0] + grid, middle[1] + grid)
    origins = (
        np.stack([across, below, np.full_like(across, corners[:, 2].min() - 100.0)], axis=-1).reshape(-1, 3) @ axes
    )
    hits = scene.cast(origins, np.broadcast_to(ahead, origins.shape))
    colors = np.full(origins.shape, SKY)
    names = scene.class_names
    for number in np.unique(hits.object_id[hits.hit]):
        item, rays = scene[int(number)], np.flatnonzero(hits.object_id == number)
        labels = np.asarray(item.label)
        labels = labels[hits.primitive_id[rays]] if labels.ndim else np.full(len(rays), labels)
        colors[rays] = (
            GLASS if item.material.transmission else [color(names.get(label, "")) for label in labels.tolist()]
        )
    seen = np.flatnonzero(hits.hit)
    points = origins[seen] + hits.t[seen, None] * ahead
    normals = hits.normal[seen] * -np.sign(hits.normal[seen] @ ahead)[:, None]
    dark = scene.occluded(points + 1e-3 * normals, np.broadcast_to(SUN, points.shape))
    light = np.clip(normals @ SUN, 0.0, 1.0) * ~dark
    sky = np.clip(points[:, 2] / np.max(high), 0.0, 1.0)  # what stands higher sees more of it
    colors[seen] *= (0.45 + 0.45 * light + 0.1 * sky)[:, None]
    return colors.reshape(SIZE, SIZE, 3)


folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
for name, kinds in KINDS.items():
    generator = getattr(ls.worlds, name)
    draws = []
    for number in range(2 * COLUMNS):
        kind = kinds[number % len(kinds)]
        if name == "street":
            scene = generator(number, kind, length=80.0).scene
            draws.append(view(scene, (-30, -26, 0), (30, 26, 6), 0.7))
            continue
        rng = np.random.default_rng(number)
        asset = generator(rng) if kind is None else generator(kind, rng)
        scene = ls.Scene(class_names=ls.worlds.CLASS_NAMES)
        asset.add_to(scene, name=name)
        scene.add(ls.Plane((0, 0, 1), min(0.0, asset.bounds[0, 2])))
        draws.append(view(scene, asset.bounds[0], asset.bounds[1], 0.35))
    print(f"{len(draws)} draws of {name}")
    rows = [np.concatenate(draws[start : start + COLUMNS], axis=1) for start in range(0, len(draws), COLUMNS)]
    imsave(folder / f"worlds-{name}.png", np.concatenate(rows))
