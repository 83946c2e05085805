"""Colours of classes by their names: those of SemanticKITTI, nuScenes and QGIS, and words that mean the same.

Sources: ``color_map`` of https://github.com/PRBonn/semantic-kitti-api/blob/master/config/semantic-kitti.yaml;
`get_colormap` of nuScenes' development kit (https://github.com/nutonomy/nuscenes-devkit, utils/color_map.py); the names
of the LAS specification 1.4 (ASPRS, 2019, table 17), which has no colours, with those of QGIS
(QgsPointCloudClassifiedRenderer::defaultCategories).
"""

from __future__ import annotations

import re
from functools import cache

__all__ = ["LAS_CLASSES", "SEMANTIC_KITTI", "class_color"]

SEMANTIC_KITTI = {
    0: ("unlabeled", "#000000"), 1: ("outlier", "#ff0000"), 10: ("car", "#6496f5"), 11: ("bicycle", "#64e6f5"),
    13: ("bus", "#6450fa"), 15: ("motorcycle", "#1e3c96"), 16: ("on-rails", "#0000ff"), 18: ("truck", "#501eb4"),
    20: ("other-vehicle", "#0000ff"), 30: ("person", "#ff1e1e"), 31: ("bicyclist", "#ff28c8"),
    32: ("motorcyclist", "#961e5a"), 40: ("road", "#ff00ff"), 44: ("parking", "#ff96ff"), 48: ("sidewalk", "#4b004b"),
    49: ("other-ground", "#af004b"), 50: ("building", "#ffc800"), 51: ("fence", "#ff7832"),
    52: ("other-structure", "#ff9600"), 60: ("lane-marking", "#96ffaa"), 70: ("vegetation", "#00af00"),
    71: ("trunk", "#873c00"), 72: ("terrain", "#96f050"), 80: ("pole", "#fff096"), 81: ("traffic-sign", "#ff0000"),
    99: ("other-object", "#32ffff"), 252: ("moving-car", "#6496f5"), 253: ("moving-bicyclist", "#ff28c8"),
    254: ("moving-person", "#ff1e1e"), 255: ("moving-motorcyclist", "#961e5a"), 256: ("moving-on-rails", "#0000ff"),
    257: ("moving-bus", "#0000ff"), 258: ("moving-truck", "#501eb4"), 259: ("moving-other-vehicle", "#0000ff"),
}  # fmt: skip
"""Name and colour of each class of SemanticKITTI."""

NUSCENES = {
    "noise": "#000000", "human.pedestrian.adult": "#0000e6", "human.pedestrian.child": "#87ceeb",
    "human.pedestrian.wheelchair": "#8a2be2", "human.pedestrian.stroller": "#f08080",
    "human.pedestrian.personal_mobility": "#db7093", "human.pedestrian.police_officer": "#000080",
    "human.pedestrian.construction_worker": "#6495ed", "animal": "#4682b4", "vehicle.car": "#ff9e00",
    "vehicle.motorcycle": "#ff3d63", "vehicle.bicycle": "#dc143c", "vehicle.bus.bendy": "#ff7f50",
    "vehicle.bus.rigid": "#ff4500", "vehicle.truck": "#ff6347", "vehicle.construction": "#e99646",
    "vehicle.emergency.ambulance": "#ff5300", "vehicle.emergency.police": "#ffd700", "vehicle.trailer": "#ff8c00",
    "movable_object.barrier": "#708090", "movable_object.trafficcone": "#2f4f4f",
    "movable_object.pushable_pullable": "#696969", "movable_object.debris": "#d2691e",
    "static_object.bicycle_rack": "#bc8f8f", "flat.driveable_surface": "#00cfbf", "flat.sidewalk": "#4b004b",
    "flat.terrain": "#70b43c", "flat.other": "#af004b", "static.manmade": "#deb887", "static.vegetation": "#00af00",
    "static.other": "#ffe4c4",
}  # fmt: skip

LAS_CLASSES = {
    0: "never classified", 1: "unclassified", 2: "ground", 3: "low vegetation", 4: "medium vegetation",
    5: "high vegetation", 6: "building", 7: "low noise", 9: "water", 10: "rail", 11: "road surface", 13: "wire guard",
    14: "wire conductor", 15: "transmission tower", 16: "wire connector", 17: "bridge deck", 18: "high noise",
}  # fmt: skip
"""Names of the classes of LAS 1.4."""

LAS = {
    "never classified": "#bababa", "unclassified": "#aaaaaa", "ground": "#aa5500", "low vegetation": "#00aaaa",
    "medium vegetation": "#55ff55", "high vegetation": "#00aa00", "low noise": "#aa0000", "water": "#55ffff",
    "rail": "#aa00aa", "high noise": "#646464",
}  # fmt: skip

MEANINGS = {
    "road": ("asphalt", "street", "lane", "road surface", "roadway"),
    "sidewalk": ("pavement", "curb", "kerb", "footpath"),
    "building": ("house", "facade", "wall", "church", "tower"),
    "vegetation": ("tree", "bush", "hedge", "leaves", "foliage", "forest", "plant"),
    "terrain": ("grass", "lawn", "meadow"),
    "ground": ("floor", "soil", "field", "valley", "courtyard"),
    "person": ("pedestrian", "people", "walker", "human", "man", "woman", "child", "person sitting"),
    "bicyclist": ("cyclist",),
    "car": ("van", "taxi", "vehicle"),
    "truck": ("lorry",),
    "on-rails": ("tram", "train"),
    "pole": ("post", "lamp", "mast", "lamppost", "bollard"),
    "traffic-sign": ("sign",),
    "water": ("lake", "river", "sea", "pond"),
    "trunk": ("bark",),
}
"""Words that mean a class of these sets."""


def _key(name: str) -> str:
    return re.sub(r"[\s_-]+", " ", name.strip().lower())


_COLORS = {
    _key(name): color for name, color in [*LAS.items(), *NUSCENES.items(), *SEMANTIC_KITTI.values()]
}  # of equal names the last counts
_COLORS |= {word: _COLORS[_key(name)] for name, words in MEANINGS.items() for word in words}


@cache
def class_color(name: str) -> str | None:
    """Return the colour of a class by its name or, if that is unknown, by its last word; None if both are.

    A list of names, with commas, has none.
    """
    key = _key(name)
    if "," in key:
        return None
    return _COLORS.get(key) or _COLORS.get(key.rpartition(" ")[2])
