"""Make the cars of configs/scenes: car.ply, a mesh from a few curves, and car.glb, whose wheels are parts that turn.

The body is a stack of rounded cross-sections along x, whose top, bottom and half width follow the curves below; the
wheels are cylinders, in the GLB tires with five spokes. Usage: python make_car.py [FILE]; also writes the GLB beside
the file, and make_car.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh

import lidarsim as ls

# Curves of the body, m: x, top, bottom and half width. The car faces +x and stands on z = 0.
X = [-2.15, -2.10, -1.90, -1.45, -0.95, -0.30, 0.25, 0.85, 1.20, 1.85, 2.10, 2.15]
TOP = [0.55, 0.80, 1.00, 1.22, 1.42, 1.46, 1.40, 1.05, 0.96, 0.84, 0.70, 0.50]
BOTTOM = [0.42, 0.34, 0.28, 0.24, 0.24, 0.24, 0.24, 0.24, 0.24, 0.26, 0.32, 0.40]
HALF_WIDTH = [0.60, 0.76, 0.84, 0.87, 0.88, 0.88, 0.88, 0.88, 0.87, 0.84, 0.74, 0.58]


def body(sections: int = 64, corners: int = 40) -> trimesh.Trimesh:
    """Return the body: `sections` cross-sections with `corners` vertices each, closed at both ends."""
    x = np.linspace(X[0], X[-1], sections)
    top, bottom, half = (np.interp(x, X, curve)[:, None] for curve in (TOP, BOTTOM, HALF_WIDTH))
    turn = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    y, z = (np.sign(f) * np.abs(f) ** 0.5 for f in (np.cos(turn), np.sin(turn)))  # superellipse of exponent 4
    height = bottom + (top - bottom) * (z + 1) / 2
    leaning = 1 - 0.28 * np.clip((height - 0.85) / 0.6, 0, 1)  # the windows lean inwards
    rings = np.stack([np.broadcast_to(x[:, None], height.shape), half * leaning * y, height], axis=-1)

    index = np.arange(sections * corners).reshape(sections, corners)
    a, b = index[:-1], index[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    faces = np.concatenate([np.stack([a, d, b], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    middles = sections * corners + np.arange(2)
    for ring, middle, order in ((index[0], middles[0], 1), (index[-1], middles[1], -1)):
        cap = np.stack([np.full(corners, middle), np.roll(ring, -1), ring], axis=-1)
        faces = np.concatenate([faces, cap[:, ::order]])
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)])
    return trimesh.Trimesh(vertices, faces, process=False)


def wheel(x: float, y: float) -> trimesh.Trimesh:
    """Return a wheel that stands on the ground at x, y."""
    across = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    across[:3, 3] = x, y, 0.32
    return trimesh.creation.cylinder(radius=0.32, height=0.2, sections=24, transform=across)


def tire() -> trimesh.Trimesh:
    """Return a wheel about the y axis with five spokes, which show how it turns."""
    spokes = [
        trimesh.creation.box((0.25, 0.04, 0.05), transform=trimesh.transformations.rotation_matrix(turn, (0, 1, 0)))
        for turn in np.arange(5) * 2 * np.pi / 5
    ]
    for spoke, turn in zip(spokes, np.arange(5) * 2 * np.pi / 5, strict=True):
        spoke.apply_translation((0.115 * np.cos(turn), 0, -0.115 * np.sin(turn)))
    across = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    return trimesh.util.concatenate([trimesh.creation.annulus(0.22, 0.32, 0.2, transform=across), *spokes])


def with_wheels() -> trimesh.Scene:
    """Return a scene of a body and four wheels, with y up as in glTF; the wheels share their mesh."""
    scene = trimesh.Scene()
    upright = trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
    scene.graph.update(frame_to="car", frame_from="world", matrix=upright)
    scene.add_geometry(body(sections=40, corners=28), node_name="body", geom_name="body", parent_node_name="car")
    for end, x in (("rear", -1.3), ("front", 1.35)):
        for side, y in (("right", -0.82), ("left", 0.82)):
            place = trimesh.transformations.translation_matrix((x, y, 0.32))
            name = f"wheel {end} {side}"
            if "wheel" in scene.geometry:
                scene.graph.update(name, "car", matrix=place, geometry="wheel")
            else:
                scene.add_geometry(tire(), name, "wheel", parent_node_name="car", transform=place)
    return scene


car = trimesh.util.concatenate([body(), *(wheel(x, y) for x in (-1.3, 1.35) for y in (-0.82, 0.82))])
path = Path(sys.argv[1] if len(sys.argv) > 1 else "car.ply")
car.vertices = car.vertices.astype(np.float32)
path.write_bytes(trimesh.exchange.ply.export_ply(car, vertex_normal=False))
path.with_suffix(".glb").write_bytes(with_wheels().export(file_type="glb"))
closed = all(part.is_volume for part in car.split())  # watertight, normals outward

scene = ls.Scene()
scene.add(ls.TriangleMesh.from_file(path), name="car", label=1)
scene.plot(camera="orbit", color_by="object_id", size=(1000, 620), save="make_car.png")
print(f"{path}: {len(car.faces)} triangles, closed: {closed}, {path.stat().st_size / 1e3:.0f} kB")
