"""Materials: values, colours and invalid arguments."""

from __future__ import annotations

import copy
import math
import pickle
import re
from typing import Any

import numpy as np
import pytest

import lidarsim as ls


def test_a_material_is_a_value() -> None:
    assert ls.Material() == ls.Material(reflectivity=1)
    assert ls.Material(reflectivity=[0.5, 1.0], per="face") == ls.Material(reflectivity=np.array([0.5, 1]), per="face")
    assert ls.Material(reflectivity=[0.5, 1.0], per="face") != ls.Material(reflectivity=[0.5, 1.0], per="vertex")
    assert ls.Material(reflectivity=[0.5], per="face") != ls.Material(reflectivity=0.5)
    assert ls.Material() != 1.0
    assert len({ls.Material(), ls.Material(reflectivity=1.0), ls.Material(reflectivity=2.0)}) == 2


def test_roughness_and_highlight_are_part_of_the_value() -> None:
    rough = ls.Material(reflectivity=0.2, roughness=0.3, specular=4, specular_width=0.05)
    assert (rough.roughness, rough.specular, rough.specular_width) == (0.3, 4.0, 0.05)
    assert rough == pickle.loads(pickle.dumps(rough)) == copy.deepcopy(rough)  # noqa: S301 - our own
    assert hash(rough) == hash(pickle.loads(pickle.dumps(rough)))  # noqa: S301
    for other in ({"roughness": 0.2}, {"specular": 3}, {"specular_width": 0.06}):
        changed = {"roughness": 0.3, "specular": 4, "specular_width": 0.05, **other}
        assert ls.Material(reflectivity=0.2, **changed) != rough  # type: ignore[arg-type]
    assert repr(rough) == ("Material(reflectivity=0.2, per='object', roughness=0.3, specular=4.0, specular_width=0.05)")
    each = ls.Material(reflectivity=[0.1, 0.2], per="face", roughness=0.1)
    assert each.roughness == 0.1


def test_arrays_are_kept_as_read_only_copies() -> None:
    values = np.array([0.5, 1.0])
    material = ls.Material(reflectivity=values, per="vertex")
    values[0] = 9.0
    assert isinstance(material.reflectivity, np.ndarray)
    assert material.reflectivity.tolist() == [0.5, 1.0]
    assert not material.reflectivity.flags.writeable


def test_colours_become_luminance() -> None:
    colors = np.array([[0, 0, 0], [255, 255, 255], [255, 0, 0], [0, 255, 0], [0, 0, 255], [128, 128, 128]], np.uint8)
    expected = [0.0, 1.0, 0.2126, 0.7152, 0.0722, 0.2158605]
    by_integers, by_floats = ls.Material.from_colors(colors), ls.Material.from_colors(colors / 255.0)
    assert by_integers.per == "vertex"
    assert np.allclose(by_integers.reflectivity, expected, rtol=0, atol=1e-7)
    assert by_integers == by_floats
    opaque = np.column_stack([colors, np.full(6, 128, np.uint8)])
    assert ls.Material.from_colors(opaque, per="face") == ls.Material(reflectivity=by_integers.reflectivity, per="face")


@pytest.mark.parametrize(
    ("parameters", "error", "message"),
    [
        ({"reflectivity": -0.5}, ValueError, "reflectivity: expected a finite number >= 0, got -0.5"),
        ({"reflectivity": math.nan}, ValueError, "reflectivity: expected a finite number >= 0, got nan"),
        (
            {"reflectivity": [0.1, 0.2]},
            TypeError,
            "reflectivity: expected one number, or an array with per='face' or per='vertex', got [0.1, 0.2]",
        ),
        ({"reflectivity": 0.5, "per": "face"}, ValueError, "reflectivity: expected shape (n,), got ()"),
        (
            {"reflectivity": [0.1, -0.2], "per": "face"},
            ValueError,
            "reflectivity: expected numbers >= 0, got reflectivity[1] = -0.2",
        ),
        (
            {"reflectivity": [0.1, math.inf], "per": "vertex"},
            ValueError,
            "reflectivity: expected finite numbers, got reflectivity[1] = inf",
        ),
        ({"roughness": -0.1}, ValueError, "roughness: expected a finite number from 0 to 1.5708, got -0.1"),
        ({"roughness": 20}, ValueError, "roughness: expected a finite number from 0 to 1.5708, got 20.0; degrees?"),
        ({"roughness": "high"}, TypeError, "roughness: expected a finite number from 0 to 1.5708, got 'high'"),
        ({"specular": -1.0}, ValueError, "specular: expected a finite number >= 0, got -1.0"),
        ({"specular": math.inf}, ValueError, "specular: expected a finite number >= 0, got inf"),
        ({"specular_width": 0.0}, ValueError, "specular_width: expected a finite number > 0, got 0.0"),
        ({"specular_width": math.nan}, ValueError, "specular_width: expected a finite number > 0, got nan"),
        ({"per": "side"}, ValueError, "per: expected 'object', 'face' or 'vertex', got 'side'"),
    ],
)
def test_materials_that_cannot_be_are_refused(parameters: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        ls.Material(**parameters)


@pytest.mark.parametrize(
    ("colors", "message"),
    [
        ([0.1, 0.2, 0.3], "colors: expected shape (n, 3) or (n, 4), got (3,)"),
        ([[0.1, 0.2, 1.3]], "colors: expected numbers from 0 to 1, got 0.1 to 1.3"),
        ([[0, 20, 256]], "colors: expected numbers from 0 to 255, got 0 to 256"),
    ],
)
def test_colours_that_cannot_be_are_refused(colors: list[Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Material.from_colors(colors)
