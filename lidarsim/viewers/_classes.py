"""Colours of classes by their names: those of SemanticKITTI, nuScenes and QGIS, and our own for words of any scene.

Sources: ``color_map`` of https://github.com/PRBonn/semantic-kitti-api/blob/master/config/semantic-kitti.yaml;
`get_colormap` of nuScenes' development kit (https://github.com/nutonomy/nuscenes-devkit, utils/color_map.py); the names
of the LAS specification 1.4 (ASPRS, 2019, table 17), which has no colours, with those of QGIS
(QgsPointCloudClassifiedRenderer::defaultCategories).
"""

from __future__ import annotations

import re
from functools import cache

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
    "never classified": "#bababa", "unclassified": "#aaaaaa", "low vegetation": "#00aaaa",
    "medium vegetation": "#55ff55", "high vegetation": "#00aa00", "low noise": "#aa0000", "rail": "#aa00aa",
    "wire guard": "#ffff55", "high noise": "#646464",
}  # fmt: skip

MEANINGS = {
    "#6f60a8": ("road", "asphalt", "street", "lane", "road surface", "roadway", "parking"),
    "#c4dcf5": ("sidewalk", "pavement", "curb", "kerb", "footpath"),
    "#cdb98a": ("building", "house", "facade", "wall", "church", "tower"),
    "#149447": ("vegetation", "tree", "bush", "hedge", "leaves", "foliage", "forest", "plant"),
    "#d2e078": ("terrain", "grass", "lawn", "meadow"),
    "#8a4f10": ("ground", "floor", "soil", "field", "valley", "trunk", "bark"),
    "#ff5a9c": ("person", "pedestrian", "people", "walker", "human", "man", "woman", "child", "person sitting"),
    "#fba3ff": ("cyclist", "bicyclist", "motorcyclist", "bicycle", "motorcycle"),
    "#1f9dff": ("car", "van", "taxi", "vehicle"),
    "#6d3cff": ("truck", "lorry", "bus", "tram", "train", "trailer"),
    "#fff7c0": ("pole", "post", "lamp", "mast", "lamppost", "bollard"),
    "#e69500": ("sign",),
    "#e0522a": ("fence", "barrier", "guard rail", "railing"),
    "#19bfd6": ("water", "lake", "river", "sea", "pond"),
}
"""Words that mean a class, by colour on a dark background. The colours are distinct with any kind of colour vision;
those of the sets are not."""

_LIGHT = (
    "#554466", "#7777aa", "#777711", "#338855", "#556622", "#773300", "#cc4488",
    "#8844bb", "#004499", "#7711ff", "#889988", "#dd7700", "#ee4455", "#4499cc",
)  # fmt: skip
ON_LIGHT = dict(zip(MEANINGS, _LIGHT, strict=True))
"""Colours of `MEANINGS` on a light background, where pale ones would look the same: of a similar hue, and as far apart
as possible for each kind of colour vision."""


def _key(name: str) -> str:
    return re.sub(r"[\s_-]+", " ", name.strip().lower())


_SETS = {_key(name): color for name, color in [*LAS.items(), *NUSCENES.items()]}
_WORDS = {word: color for color, words in MEANINGS.items() for word in words}


@cache
def class_color(name: str, label: int | None = None) -> str | None:
    """Return the colour of a class; None if its name means none.

    A class of SemanticKITTI, of its name and its label, or with a name of nuScenes or LAS has the colour of its set.
    Else its name counts or, if that is unknown, the last word of it. A list of names, with commas, has no colour.
    """
    key = _key(name)
    if label in SEMANTIC_KITTI and _key(SEMANTIC_KITTI[label][0]) == key:
        return SEMANTIC_KITTI[label][1]
    if "," in key:
        return None
    return _SETS.get(key) or _WORDS.get(key) or _WORDS.get(key.rpartition(" ")[2])
