"""Worlds: vehicles, people, plants, buildings and streets made of shapes, each a pure function of its arguments.

Each generator takes a `numpy.random.Generator`, which draws what its arguments leave open, and returns an `Asset`:
parts with their shapes, classes (the numbers of SemanticKITTI) and materials. The same arguments and the same state of
the generator give the same bits.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lidarsim.worlds._asset import Asset, Part, Walker
    from lidarsim.worlds._labels import CLASS_NAMES
    from lidarsim.worlds.buildings import building
    from lidarsim.worlds.furnishings import furniture
    from lidarsim.worlds.pedestrians import pedestrian
    from lidarsim.worlds.plants import tree
    from lidarsim.worlds.streets import GROUND, Street, Ways, street
    from lidarsim.worlds.vehicles import vehicle

GENERATORS = ("vehicle", "pedestrian", "tree", "building", "furniture")
"""Names of the generators of assets, which are also shapes in YAML."""

__all__ = [
    "CLASS_NAMES",
    "GENERATORS",
    "GROUND",
    "Asset",
    "Part",
    "Street",
    "Walker",
    "Ways",
    "building",
    "furniture",
    "pedestrian",
    "street",
    "tree",
    "vehicle",
]

_MODULES = {
    "CLASS_NAMES": "_labels",
    "Asset": "_asset",
    "Part": "_asset",
    "Walker": "_asset",
    "building": "buildings",
    "furniture": "furnishings",
    "pedestrian": "pedestrians",
    "tree": "plants",
    "GROUND": "streets",
    "Street": "streets",
    "Ways": "streets",
    "street": "streets",
    "vehicle": "vehicles",
}


def __getattr__(name: str) -> object:
    """Import a generator when it is first used, so that `import lidarsim` stays fast."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
