"""Make the courtyard of configs/scenes/courtyard.glb as a modelling program would export it, and scan it.

The file has y up, as glTF has: a painted yard, a house, trees and cars of several parts, and a marker of no instance.
Rules give the parts labels and instances, and base colours become reflectivities, so that the scan shows the paint.
Usage: python make_courtyard.py [FILE]; also writes make_courtyard.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from trimesh.transformations import rotation_matrix, translation_matrix
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import lidarsim as ls

CLASSES = {10: "car", 40: "ground", 50: "building", 70: "vegetation"}
Y_UP = rotation_matrix(-np.pi / 2, (1, 0, 0))


def painted_yard() -> trimesh.Trimesh:
    """Return a yard of 32 m by 24 m with an image of asphalt, its parking lines and an arrow, 0.1 m a texel."""
    image = np.full((240, 320, 3), 70, np.uint8)
    image[20:70, 40:300:26] = image[20:70, 41:300:26] = image[20:22, 40:301] = 235  # lines
    image[150:154, 60:220] = 235
    for step in range(16):  # the head of the arrow
        image[152 - step : 152 + step, 220 + 16 - step] = 235
    corners = np.array([(-16.0, -12.0, 0.0), (16, -12, 0), (16, 12, 0), (-16, 12, 0)])
    yard = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    paint = PBRMaterial(name="asphalt", baseColorTexture=Image.fromarray(image))
    yard.visual = TextureVisuals(uv=[(0, 0), (1, 0), (1, 1), (0, 1)], material=paint)
    return yard


def paint(mesh: trimesh.Trimesh, name: str, color: tuple[int, int, int]) -> trimesh.Trimesh:
    """Give a mesh a material of one colour."""
    mesh.visual = TextureVisuals(material=PBRMaterial(name=name, baseColorFactor=(*color, 255)))
    return mesh


def add(scene: trimesh.Scene, group: str, place: np.ndarray, parts: dict[str, trimesh.Trimesh]) -> None:
    """Add a group of parts, in metres with z up, to a scene with y up."""
    scene.graph.update(frame_to=group, frame_from="world", matrix=Y_UP @ place)
    for name, part in parts.items():
        scene.add_geometry(part, node_name=f"{group}_{name}", parent_node_name=group)


def courtyard() -> trimesh.Scene:
    """Return the scene."""
    create, scene = trimesh.creation, trimesh.Scene()
    add(scene, "yard", np.eye(4), {"ground": painted_yard()})
    wall = paint(create.box((24, 6, 7)), "plaster", (200, 190, 170))
    add(scene, "house", translation_matrix((0, 15, 3.5)), {"wall": wall})
    for number, (x, y) in enumerate([(-13, -9), (-9, -10), (13, -8)]):
        trunk = paint(create.cylinder(0.2, 2.4), "bark", (90, 70, 50))
        crown = paint(create.icosphere(3, 1.4), "leaves", (60, 120, 50)).apply_translation((0, 0, 2.2))
        add(scene, f"tree_{number}", translation_matrix((x, y, 1.2)), {"trunk": trunk, "crown": crown})
    for number, (x, color) in enumerate([(-10.7, (150, 20, 20)), (-5.5, (220, 220, 225)), (4.9, (25, 25, 30))]):
        parts = {
            "body": paint(create.box((1.8, 4.2, 0.7)), "paint", color).apply_translation((0, 0, 0.65)),
            "cabin": paint(create.box((1.6, 2.2, 0.6)), "glass", (40, 45, 50)).apply_translation((0, -0.2, 1.3)),
        }
        across = rotation_matrix(np.pi / 2, (0, 1, 0))
        for wheel, (dx, dy) in enumerate([(-0.8, 1.3), (0.8, 1.3), (-0.8, -1.3), (0.8, -1.3)]):
            tire = paint(create.cylinder(0.32, 0.2, transform=across), "rubber", (20, 20, 20))
            parts[f"wheel_{wheel}"] = tire.apply_translation((dx, dy, 0.32))
        add(scene, f"car_{number}", translation_matrix((x, 7.5, 0)), parts)
    marker = paint(create.box((1, 1, 1)), "marker", (255, 0, 255))
    add(scene, "helper", translation_matrix((0, 0, 2)), {"pivot": marker})
    return scene


path = Path(sys.argv[1] if len(sys.argv) > 1 else "courtyard.glb")
path.write_bytes(courtyard().export(file_type="glb"))

rules = [
    ls.Rule(node="*helper*", skip=True),
    ls.Rule(node="*car_*", label=10, instance="parent"),
    ls.Rule(node="*tree_*", label=70, instance="parent"),
    ls.Rule(material="asphalt", label=40),
    ls.Rule(material="plaster", label=50, reflectivity=ls.materials.PLASTER),
]
scene = ls.Scene.from_file(path, rules=rules, reflectivity="color")
print(f"{path}: {len(scene.objects)} objects, {path.stat().st_size / 1e3:.0f} kB")

pose = np.eye(4)
pose[:3, 3] = (0, -2, 1.9)
scan = ls.Lidar.preset("ouster-os1-128", noise="measured").scan(scene, pose, seed=3)
boxes = scan.boxes(frame="world", min_points=20)
for box, label in enumerate(boxes.label):
    if label == 10:
        print(
            f"car: {boxes.points[box]} points, {boxes.visibility[box]:.0%} visible, size {boxes.size[box].round(2)} m"
        )
scan.plot(scene=scene, color_by="intensity", camera="orbit", size=(1000, 620), save="make_courtyard.png")
