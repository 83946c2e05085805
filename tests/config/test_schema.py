"""The models of a configuration as a whole: they are documented, and their keys are arguments of what they build."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from lidarsim import measurement
from lidarsim.config import schema

GUIDE = (Path(__file__).parents[2] / "configs" / "README.md").read_text(encoding="utf-8")
MODELS = [value for value in vars(schema).values() if inspect.isclass(value) and issubclass(value, schema.Model)]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_key_is_in_the_guide(model: type[schema.Model]) -> None:
    words = set(re.findall(r"\w+", GUIDE))
    assert [key for key in model.model_fields if key not in words] == []


def test_every_shape_and_pattern_is_in_the_guide() -> None:
    assert len(schema.SHAPES) >= 8
    assert len(schema.PATTERNS) >= 8
    assert [name for name in [*schema.SHAPES, *schema.PATTERNS] if f"| `{name}` |" not in GUIDE] == []


@pytest.mark.parametrize(
    ("model", "constructor"),
    [
        *((model, model.constructor) for model in schema.PATTERNS.values() if model is not schema.Table),
        *(
            (model, model.constructor)
            for model in schema.SHAPES.values()
            if model not in {schema.Plane, schema.Mesh, schema.Heightfield, schema.SceneFile}
        ),
        (schema.Effects, measurement.Measurement),
        (schema.DetectionLimit, measurement.Detection),
        (schema.WideBeam, measurement.Beam),
    ],
    ids=lambda value: value.__name__,
)
def test_every_argument_has_a_key(model: type[schema.Model], constructor: type) -> None:
    common = {"shape", "type", *(schema.Object.model_fields if issubclass(model, schema.Object) else ())}
    keys = {re.sub(f"_({'|'.join(schema.UNITS)})$", "", key) for key in model.model_fields if key not in common}
    # Objects are turned by their placement.
    assert keys == inspect.signature(constructor).parameters.keys() - {"transform", "rotation"}
