"""A walking person: a GLB with a skin and an animation is made, and scanned at moments of its walk.

The person is one mesh of tubes around bones. A skin bends it at hips, knees, shoulders and elbows, as modelling
programs write it. `Scene.animate` shows it at any time: the mesh is refitted, not built anew, and rays meet the
triangles of that moment exactly. In the street, the person's shape and place are updated before each scan.
"""

import json
import struct
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import lidarsim as ls

# Joints: name, parent and position (x forward, y up, z to the right, as in glTF), m.
JOINTS = {
    "hips": (None, (0.0, 0.94, 0.0)),
    "chest": ("hips", (0.0, 1.25, 0.0)),
    "head": ("chest", (0.0, 1.52, 0.0)),
}
for side, sign in (("left", -1), ("right", 1)):
    JOINTS |= {
        f"{side}_thigh": ("hips", (0.0, 0.90, 0.10 * sign)),
        f"{side}_shin": (f"{side}_thigh", (0.0, 0.49, 0.10 * sign)),
        f"{side}_foot": (f"{side}_shin", (0.0, 0.08, 0.10 * sign)),
        f"{side}_arm": ("chest", (0.0, 1.42, 0.20 * sign)),
        f"{side}_forearm": (f"{side}_arm", (0.0, 1.15, 0.22 * sign)),
        f"{side}_hand": (f"{side}_forearm", (0.0, 0.90, 0.22 * sign)),
    }
NAMES = list(JOINTS)
PLACES = {name: np.array(place) for name, (_, place) in JOINTS.items()}
# Tubes: the joints along it, its end beyond the last one, and the radii at all of these, m.
TUBES = [(("hips", "chest", "head"), (0.0, 1.78, 0.0), (0.15, 0.17, 0.07, 0.10))]
for side, sign in (("left", -1), ("right", 1)):
    leg, arm = (
        [f"{side}_{name}" for name in names] for names in (("thigh", "shin", "foot"), ("arm", "forearm", "hand"))
    )
    TUBES += [
        (leg, (0.22, 0.03, 0.10 * sign), (0.09, 0.06, 0.045, 0.04)),
        (arm, (0.0, 0.74, 0.22 * sign), (0.055, 0.045, 0.035, 0.03)),
    ]
RINGS, SIDES = 10, 12  # of each bone


def tube(names, end, radii):
    """Return vertices, faces, joints and weights of a tube that follows bones; its ends are closed."""
    points = [*(PLACES[name] for name in names), np.array(end)]
    vertices, joints, weights = [], [], []
    for k, (a, b) in enumerate(pairwise(points)):
        for share in np.linspace(0, 1, RINGS, endpoint=k == len(names) - 1):
            angles = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
            radius = radii[k] + share * (radii[k + 1] - radii[k])
            middle, depth = a + share * (b - a), 0.75 if "hips" in names and k < 2 else 1.0
            vertices += [middle + radius * np.array([depth * np.cos(t), 0, np.sin(t)]) for t in angles]
            blend = max(0.0, 0.5 - 1.5 * share) if k else 0.0  # near its joint a bone bends with the one before
            joints += [(NAMES.index(names[k]), NAMES.index(names[max(k - 1, 0)]), 0, 0)] * SIDES
            weights += [(1 - blend, blend, 0, 0)] * SIDES
    rings = len(vertices) // SIDES
    index = np.arange(len(vertices)).reshape(rings, SIDES)
    a, b, c, d = index[:-1], np.roll(index[:-1], -1, 1), np.roll(index[1:], -1, 1), index[1:]
    faces = [np.stack(part, -1).reshape(-1, 3) for part in ((a, c, b), (a, d, c))]
    faces += [[(ring[0], ring[i], ring[i + 1]) for i in range(1, SIDES - 1)] for ring in (index[0], index[-1, ::-1])]
    return np.array(vertices), np.concatenate(faces), np.array(joints), np.array(weights)


def turn(angle):
    """Return the quaternion of a turn about the axis to the right, which swings a limb forward."""
    return Rotation.from_rotvec([0, 0, angle]).as_quat()


def swings(time):
    """Return the angles of a stride of one second."""
    phase = 2 * np.pi * time
    angles = {"chest": -0.04, "hips": 0.0}
    for side, shift in (("left", 0.0), ("right", np.pi)):
        angles[f"{side}_thigh"] = 0.08 + 0.45 * np.sin(phase + shift)
        angles[f"{side}_shin"] = -0.15 - 0.75 * max(0.0, np.cos(phase + shift)) ** 2
        angles[f"{side}_arm"] = -0.4 * np.sin(phase + shift)
        angles[f"{side}_forearm"] = 0.35 + 0.2 * np.sin(phase + shift + np.pi)
    return angles


blob, views, accessors = bytearray(), [], []


def put(values, dtype, kind):
    """Add an accessor, and return its number."""
    data = np.asarray(values, dtype).tobytes()
    blob.extend(bytes(-len(blob) % 4))
    views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
    blob.extend(data)
    code = {"<f4": 5126, "<u2": 5123, "u1": 5121}[dtype]
    accessors.append({"bufferView": len(views) - 1, "componentType": code, "count": len(values), "type": kind})
    return len(accessors) - 1


parts = [tube(*each) for each in TUBES]
starts = np.cumsum([0, *(len(part[0]) for part in parts)])
vertices, joints, weights = (np.concatenate([part[k] for part in parts]) for k in (0, 2, 3))
faces = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=False)])
times = np.linspace(0, 1, 13)
inverse = np.tile(np.eye(4), (len(NAMES), 1, 1))
inverse[:, :3, 3] = [-PLACES[name] for name in NAMES]
nodes = [{"name": "person", "mesh": 0, "skin": 0, "children": [1]}]
for name, (parent, place) in JOINTS.items():
    offset = np.array(place) - (PLACES[parent] if parent else 0.0)
    below = [NAMES.index(other) + 1 for other, (above, _) in JOINTS.items() if above == name]
    nodes.append({"name": name, "translation": offset.tolist(), **({"children": below} if below else {})})
moving = list(swings(0.0))
bob = [PLACES["hips"] + (0, -0.03 * np.cos(4 * np.pi * t) ** 2, 0) for t in times]
samplers = [{"input": put(times[:, None], "<f4", "SCALAR"), "output": put(bob, "<f4", "VEC3")}]
samplers += [{"input": 0, "output": put([turn(swings(t)[name]) for t in times], "<f4", "VEC4")} for name in moving]
channels = [{"sampler": 0, "target": {"node": 1, "path": "translation"}}]
channels += [
    {"sampler": k + 1, "target": {"node": NAMES.index(name) + 1, "path": "rotation"}} for k, name in enumerate(moving)
]
attributes = {
    "POSITION": put(vertices, "<f4", "VEC3"),
    "JOINTS_0": put(joints, "u1", "VEC4"),
    "WEIGHTS_0": put(weights, "<f4", "VEC4"),
}
primitive = {"attributes": attributes, "indices": put(faces.ravel(), "<u2", "SCALAR")}
skin = {"joints": list(range(1, len(nodes))), "inverseBindMatrices": put(inverse.transpose(0, 2, 1), "<f4", "MAT4")}
document = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": nodes,
    "skins": [skin],
    "meshes": [{"primitives": [primitive]}],
    "animations": [{"name": "walk", "channels": channels, "samplers": samplers}],
    "accessors": accessors,
    "bufferViews": views,
    "buffers": [{"byteLength": len(blob)}],
}
text, data = json.dumps(document).encode(), bytes(blob) + bytes(-len(blob) % 4)
text += b" " * (-len(text) % 4)
head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data))
chunks = struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(data), b"BIN\0"), data
Path("walker.glb").write_bytes(b"".join([head, *chunks]))

# The person crosses the street at 1.3 m/s while a lidar watches.
figure = ls.Scene.from_file("walker.glb", rules=[ls.Rule(label=30)])
street = ls.Scene(class_names={30: "person", 40: "road"})
street.add(ls.Plane((0, 0, 1), 0.0), label=40)
(walker,) = figure
person = street.add(walker.shape, label=walker.label, transform=walker.transform)
lidar = ls.Lidar(ls.patterns.Grid(np.radians(np.arange(-32, 32, 0.2)), np.radians(np.arange(-13, 6, 0.3)), rate=10.0))
pose = np.eye(4)
pose[:3, 3] = 0.0, -7.0, 1.2
pose[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()

drawing, axes = plt.subplots(figsize=(9, 3.2), layout="constrained")
colors = plt.get_cmap("viridis")(np.linspace(0, 0.9, 8))
for k, time in enumerate(np.linspace(0, 4.9, 8)):
    figure.animate(time % figure.animations["walk"])
    (walker,) = figure
    place = np.eye(4)
    place[0, 3] = 1.3 * (time - 2.4)
    street.update(person, shape=walker.shape, transform=place @ walker.transform)
    cloud = lidar.scan(street, pose).point_cloud(frame="world")
    seen = cloud[cloud.label == 30].xyz
    axes.plot(seen[:, 0], seen[:, 2], ".", color=colors[k], markersize=2.2)
    print(f"{time:.1f} s: {len(seen)} points on the person")
axes.axhline(0.0, color="0.6")
axes.set(aspect="equal", xlabel="x [m]", ylabel="z [m]", title="A walking person, seen by a lidar at 7 m")
drawing.savefig("make_walker.png", dpi=100)
