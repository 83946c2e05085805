"""Recipes that are wrong in many ways at once: each is used, or refused by one clear error."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidarsim.config.document import dump, parse, plain
from lidarsim.datasets.recipe import load
from lidarsim.errors import ConfigError

RECIPE: dict[str, Any] = {
    "sequences": 3,
    "frames": 4,
    "seed": 3,
    "shard_frames": 5,
    "layout": {"type": "shards", "fields": ["time"]},
    "class_names": {"10": "car", "40": "1e3"},
    "vary": {
        "scene.0.radius_m": {"uniform": [1, 2]},
        "scene.0.center_m.0": {"normal": [5, 0.1], "per": "frame"},
        "scene.0.label": {"choice": [10, 30], "weights": [1, 3]},
        "sensor.max_range_m": {"log_uniform": [10, 100]},
        "scene.1.label": {"integer": [1, 3]},
    },
    "scatter": {
        "cars": {
            "objects": [
                {"shape": "box", "size_m": [2, 1, 1], "scale": [1, 1, 2], "rotation_deg": {"yaw": 20}},
                {"shape": "walker", "label": 2, "height_m": 1.8},
                {
                    "shape": "compound",
                    "wheels": "wheel*",
                    "position_m": [0, 0, 0.1],
                    "parts": [
                        {"shape": "box", "size_m": [2, 1, 1]},
                        {"shape": "sphere", "name": "wheel", "center_m": [1, 0, 0.3], "radius_m": 0.3},
                    ],
                },
            ],
            "on": ["floor"],
            "count": {"integer": [1, 2]},
            "area_m": [[-9, -9], [9, 9]],
            "yaw_deg": {"uniform": [0, 360]},
            "speed_m_per_s": 1,
            "gap_m": 0.5,
            "clear_m": 1,
        },
        "trees": {
            "objects": [{"shape": "cylinder", "start_m": [0, 0, 0], "end_m": [0, 0, 3], "radius_m": 0.2}],
            "on": ["floor"],
            "count": 2,
            "along_m": [[-9, 0], [0, 3], [9, 0]],
            "interpolation": "spline",
            "offset_m": {"normal": [0, 1]},
            "speed_m_per_s": [[0, 2], [0.2, 0], [0.4, 3]],
            "tilt": True,
            "scale": {"choice": [1, 2]},
        },
    },
    "run": {
        "sensor": {
            "pattern": {"type": "grid", "azimuths_deg": [0, 5], "elevations_deg": [0], "rate_hz": 10},
            "measurement": {"range_sigma_m": 0.01},
            "min_range_m": 0.5,
        },
        "cloud": {"deskew": "start"},
        "first_frame": 0,
        "pose": {"position_m": [0, 0, 1], "rotation_deg": {"yaw": 5}, "linear_m_per_s": [1, 0, 0]},
        "scene": [
            {"shape": "sphere", "center_m": [5, 0, 0], "radius_m": 1, "motion": {"angular_deg_per_s": [0, 0, 9]}},
            {"shape": "plane", "normal": [0, 0, 1], "distance_m": -0.25, "name": "floor"},
        ],
    },
}

ODD = float("inf"), -float("inf"), float("nan")
NUMBERS = st.sampled_from(
    [0, 1, -1, 2, 7, 0.5, 1e-9, 1e-320, -1e-3, 1e9, 1e17, 1e154, -1e300, 1.7e308, 2**31, 2**63, 2**64, 10**300, *ODD]
)
TEXTS = st.sampled_from(["", "floor", "box", "shards", "frame", "1e3", "../x", "a\0b", "\x1b[31m", "x" * 300, "$.*"])
VALUES = st.recursive(
    st.one_of(NUMBERS, TEXTS, st.booleans(), st.none()),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(TEXTS, inner, max_size=2)),
    max_leaves=4,
)


def places(value: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The keys that lead to all that is in a value."""
    keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [place for key in keys for place in ((*above, key), *places(value[key], (*above, key)))]


@st.composite
def recipes(draw: st.DrawFn) -> dict[str, Any]:
    """The recipe with some values replaced, removed, added, moved or said twice."""
    recipe = copy.deepcopy(RECIPE)
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(places(recipe)))
        there = recipe
        for key in way:
            there = there[key]
        change = draw(st.sampled_from(["replace", "number", "number", "remove", "add", "move"]))
        if change in {"replace", "number"}:
            there[last] = draw(VALUES if change == "replace" else NUMBERS)
        elif change == "remove":
            del there[last]
        elif change == "move":
            *_, other = draw(st.sampled_from(places(RECIPE)))
            if isinstance(there, dict):
                there[str(other)] = there.pop(last)
        elif isinstance(there, list):
            there.insert(last, draw(VALUES))
        else:
            there[draw(TEXTS)] = draw(VALUES)
    return recipe


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def is_valid(path: Path) -> bool:
    """Whether a recipe is taken; what is taken gives its first run, and is written as it is read."""
    try:
        made = load(path)
        made.source.run(0, 1)
    except MemoryError:
        return False
    except ConfigError as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        assert refusal.startswith(str(path))
        assert refusal.isprintable()
        assert len(refusal) < 2000
        return False
    assert plain(parse(made.text(), "again")) == made.to_dict() or "nan" in made.text()
    assert isinstance(made.source.files(), dict)
    return True


def test_the_recipe_itself_is_used(folder: Path) -> None:
    (folder / "recipe.yaml").write_text(dump(RECIPE), encoding="utf-8")
    assert is_valid(folder / "recipe.yaml")
    assert len(places(RECIPE)) > 100


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(recipes())
def test_changed_recipes(folder: Path, recipe: dict[str, Any]) -> None:
    (folder / "recipe.yaml").write_text(dump(recipe), encoding="utf-8")
    is_valid(folder / "recipe.yaml")


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_changed_texts(folder: Path, data: st.DataObject) -> None:
    content = dump(RECIPE).encode()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(content)))
        cut = data.draw(st.integers(0, 20))
        more = data.draw(
            st.sampled_from([b"", b"\0", b"\xff", b"\t", b"&a ", b"*a", b"- ", b": ", b"{", b"]", b"!!int "])
        )
        content = content[:at] + more + content[at + cut :]
    (folder / "recipe.yaml").write_bytes(content)
    is_valid(folder / "recipe.yaml")
