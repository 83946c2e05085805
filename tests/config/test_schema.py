"""The models of a configuration as a whole: they are documented, and their keys are arguments of what they build."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import pytest

from lidarsim import patterns
from lidarsim.config import factories, objects, poses, schema, sensors, units
from lidarsim.sensor import measurement

GUIDE = (Path(__file__).parents[2] / "configs" / "REFERENCE.md").read_text(encoding="utf-8")
DECLARING = [patterns.Prism, measurement.Detection, measurement.Beam, measurement.Measurement]
MODELS = [
    *{
        value: None
        for module in (poses, objects, sensors, schema)
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, factories.Model)
    },
    *objects.SHAPES.values(),
    *sensors.PATTERNS.values(),
    *map(factories.model_of, DECLARING),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_key_is_in_the_guide(model: type[factories.Model]) -> None:
    words = set(re.findall(r"\w+", GUIDE))
    assert [key for key in model.model_fields if key not in words] == []


def test_every_shape_and_pattern_is_in_the_guide() -> None:
    assert len(objects.SHAPES) >= 8
    assert len(sensors.PATTERNS) >= 8
    assert [name for name in [*objects.SHAPES, *sensors.PATTERNS] if f"\n### {name}\n" not in GUIDE] == []


@pytest.mark.parametrize(
    "constructor",
    [
        *(model.constructor for model in sensors.PATTERNS.values() if model is not sensors.Table),
        *(
            model.constructor
            for model in objects.SHAPES.values()
            if model
            not in {
                objects.Plane,
                objects.Mesh,
                objects.Heightfield,
                objects.Raster,
                objects.SceneFile,
                objects.Surfels,
            }
            and not issubclass(model, objects.GeneratedObject)
        ),
        *DECLARING,
    ],
    ids=lambda value: value.__name__,
)
def test_every_argument_has_a_key(constructor: Any) -> None:
    keys = {re.sub(f"_({'|'.join(units.UNITS)})$", "", key) for key in constructor.configuration}
    # Objects are turned by their placement.
    assert keys == inspect.signature(constructor).parameters.keys() - {"transform", "rotation"}


def test_a_key_is_optional_where_its_argument_is() -> None:
    fields = factories.model_of(patterns.Spinning).model_fields
    assert [key for key, field in fields.items() if field.is_required()] == ["elevations_deg"]
    prism = factories.model_of(patterns.Prism)
    assert prism.alternatives == (("rotation_rate_hz", "rotation_rate_rpm"),)
    assert [key for key, field in prism.model_fields.items() if field.is_required()] == []


def test_a_default_that_a_model_tells_is_not_that_of_its_constructor() -> None:
    """Strips are flown a frame beyond their area, unless a margin is given; `Trajectory.strips` has none by itself."""
    (row,) = [line for line in GUIDE.splitlines() if line.startswith("| `margin_m` |")]
    key, kind, default, meaning = (cell.strip() for cell in row.strip("|").split("|"))
    assert (key, kind, default) == ("`margin_m`", "number, m", "")
    assert "Default: that of a frame." in meaning
