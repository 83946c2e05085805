"""The models of a configuration as a whole: they are documented, and their keys are arguments of what they build."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import pytest

from lidarsim import patterns
from lidarsim.config import schema
from lidarsim.sensor import measurement

GUIDE = (Path(__file__).parents[2] / "configs" / "README.md").read_text(encoding="utf-8")
DECLARING = [patterns.Prism, measurement.Detection, measurement.Beam, measurement.Measurement]
MODELS = [
    *(value for value in vars(schema).values() if inspect.isclass(value) and issubclass(value, schema.Model)),
    *schema.SHAPES.values(),
    *schema.PATTERNS.values(),
    *map(schema.model_of, DECLARING),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_key_is_in_the_guide(model: type[schema.Model]) -> None:
    words = set(re.findall(r"\w+", GUIDE))
    assert [key for key in model.model_fields if key not in words] == []


def test_every_shape_and_pattern_is_in_the_guide() -> None:
    assert len(schema.SHAPES) >= 8
    assert len(schema.PATTERNS) >= 8
    assert [name for name in [*schema.SHAPES, *schema.PATTERNS] if f"| `{name}` |" not in GUIDE] == []


@pytest.mark.parametrize(
    "constructor",
    [
        *(model.constructor for model in schema.PATTERNS.values() if model is not schema.Table),
        *(
            model.constructor
            for model in schema.SHAPES.values()
            if model
            not in {schema.Plane, schema.Mesh, schema.Heightfield, schema.Raster, schema.SceneFile, schema.Surfels}
            and not issubclass(model, schema.Generated)
        ),
        *DECLARING,
    ],
    ids=lambda value: value.__name__,
)
def test_every_argument_has_a_key(constructor: Any) -> None:
    keys = {re.sub(f"_({'|'.join(schema.UNITS)})$", "", key) for key in constructor.configuration}
    # Objects are turned by their placement.
    assert keys == inspect.signature(constructor).parameters.keys() - {"transform", "rotation"}


def test_a_key_is_optional_where_its_argument_is() -> None:
    fields = schema.model_of(patterns.Spinning).model_fields
    assert [key for key, field in fields.items() if field.is_required()] == ["elevations_deg"]
    prism = schema.model_of(patterns.Prism)
    assert prism.alternatives == (("rotation_rate_hz", "rotation_rate_rpm"),)
    assert [key for key, field in prism.model_fields.items() if field.is_required()] == []
