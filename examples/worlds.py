"""Twelve draws of each generator of `lidarsim.worlds`, four of streets; writes worlds-vehicle.png and so on.

Rays draw them: classes have hues, surfaces are as light as their reflectivity at 905 nm says, glass is blue, and what
returns more than a white diffuser is yellow. Each generator is a pure function of its arguments and a random generator
or, as streets, a seed. Usage: python worlds.py [FOLDER]
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.image import imsave

import lidarsim as ls

ROWS, COLUMNS, SIZE = 2, 6, 200  # draws of a picture, and pixels of each
STREETS = 2, 2, 500
SAMPLES = 2  # rays of a pixel, across and down
KINDS = {
    "vehicle": ("hatchback", "saloon", "estate", "suv", "van", "pickup", "lorry", "bus", "motorcycle", "bicycle"),
    "pedestrian": (None,),
    "tree": ("broadleaf", "conifer", "young", "hedge", "bed", "bush", "grass"),
    "building": ("house", "terrace", "block", "garage"),
    "furniture": ("lamp", "sign", "traffic_light", "bin", "bench", "bollard", "fence", "wall"),
    "street": ("residential", "city", "rural", "car_park"),
}
HUES = {
    "road": "c8ccd8", "parking": "b8c4f0", "sidewalk": "f0dcc8", "other-ground": "e8c8a0", "terrain": "c8f080",
    "vegetation": "70e050", "trunk": "d8a070", "building": "ffd8a8", "fence": "f0a070", "pole": "d0d8e8",
    "traffic-sign": "f0f0f0", "car": "88b0ff", "truck": "c0a0ff", "bus": "ffb060", "person": "ff9080",
    "motorcyclist": "ff80d0", "bicyclist": "ff80d0",
}  # fmt: skip
REST, GLASS, RETRO, SKY = "e8e8e4", (0.3, 0.5, 0.62), (1.0, 0.85, 0.0), (0.93, 0.95, 0.97)
SUN = np.array([0.5, -0.55, 0.67])

Floats = npt.NDArray[np.float64]


@cache
def hue(name: str) -> tuple[float, ...]:
    """Return the colour of a class where it is white, RGB."""
    return tuple(part / 255 for part in bytes.fromhex(HUES.get(name, REST)))


def colors(scene: ls.Scene, hits: ls.Hits) -> Floats:
    """Return the colours (n, RGB) of what rays hit, by class and reflectivity."""
    found = np.full((len(hits.t), 3), SKY)
    for number in np.unique(hits.object_id[hits.hit]):
        item, rays = scene[int(number)], np.flatnonzero(hits.object_id == number)
        if item.material.transmission:
            found[rays] = GLASS
            continue
        labels, bright = (
            values[hits.primitive_id[rays]] if values.ndim else np.full(len(rays), values)
            for values in (np.asarray(item.label), np.asarray(item.material.reflectivity))
        )
        hues = np.array([hue(scene.class_names.get(label, "")) for label in labels.tolist()])
        found[rays] = np.where(bright[:, None] > 1, RETRO, hues * bright[:, None] ** (1 / 2.2))  # the gamma of screens
    return found


def view(scene: ls.Scene, low: npt.ArrayLike, high: npt.ArrayLike, down: float, size: int) -> Floats:
    """Return a picture (rows, columns, RGB) of what is in a box, seen from x, somewhat from -y, and from above."""
    ahead = np.array([-np.cos(0.65), np.sin(0.65), 0.0]) * np.cos(down) - (0.0, 0.0, np.sin(down))
    right = np.cross(ahead, (0, 0, 1)) / np.cos(down)
    axes = np.stack([right, np.cross(ahead, right), ahead])  # to the right, downwards, ahead
    corners = np.stack(np.meshgrid(*np.transpose([low, high])), axis=-1).reshape(-1, 3) @ axes.T
    span = 1.06 * np.ptp(corners[:, :2], axis=0).max()
    grid = ((np.arange(size * SAMPLES) + 0.5) / (size * SAMPLES) - 0.5) * span
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    across, below = np.meshgrid(middle[0] + grid, middle[1] + grid)
    origins = (
        np.stack([across, below, np.full_like(across, corners[:, 2].min() - 100.0)], axis=-1).reshape(-1, 3) @ axes
    )
    hits = scene.cast(origins, np.broadcast_to(ahead, origins.shape))
    picture = colors(scene, hits)
    seen = np.flatnonzero(hits.hit)
    points = origins[seen] + hits.t[seen, None] * ahead
    normals = hits.normal[seen] * -np.sign(hits.normal[seen] @ ahead)[:, None]
    dark = scene.occluded(points + 1e-3 * normals, np.broadcast_to(SUN, points.shape))
    light = np.clip(normals @ SUN, 0.0, 1.0) * ~dark
    sky = np.clip(points[:, 2] / np.max(high), 0.0, 1.0)  # what stands higher sees more of it
    picture[seen] *= (0.6 + 0.6 * light + 0.1 * sky)[:, None]
    return np.minimum(picture, 1.0).reshape(size, SAMPLES, size, SAMPLES, 3).mean(axis=(1, 3))


folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
for name, kinds in KINDS.items():
    generator = getattr(ls.worlds, name)
    rows, columns, size = STREETS if name == "street" else (ROWS, COLUMNS, SIZE)
    draws = []
    for number in range(rows * columns):
        kind = kinds[number % len(kinds)]
        if name == "street":
            scene = generator(number, kind, length=80.0).scene
            draws.append(view(scene, (-16, -14, 0), (16, 14, 6), 0.9, size))
            continue
        rng = np.random.default_rng(number)
        asset = generator(rng) if kind is None else generator(kind, rng)
        scene = ls.Scene(class_names=ls.worlds.CLASS_NAMES)
        asset.add_to(scene, name=name)
        scene.add(ls.Plane((0, 0, 1), min(0.0, asset.bounds[0, 2])))
        draws.append(view(scene, asset.bounds[0], asset.bounds[1], 0.35, size))
    print(f"{len(draws)} draws of {name}")
    lines = [np.concatenate(draws[row * columns :][:columns], axis=1) for row in range(rows)]
    imsave(folder / f"worlds-{name}.png", np.concatenate(lines))
