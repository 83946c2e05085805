"""A shape has a Python and a Rust file, a key in configurations, documentation, a sample, an oracle and hard cases."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest
from conformance.samples import SAMPLES
from exact import adversarial, cases, oracle
from numpydoc.docscrape import NumpyDocString

import lidarsim as ls
from lidarsim.world import shapes

SHAPES = [
    shape for name in shapes.__all__ if issubclass(shape := getattr(shapes, name), ls.Shape) and shape is not ls.Shape
]
CORE = Path(__file__).parents[2] / "lidarsim" / "native" / "core" / "src"

every_shape = pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)


def snake(shape):
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", shape.__name__).lower()


def leaves(kind):
    """Classes below a class that have none below them."""
    return [leaf for below in kind.__subclasses__() for leaf in leaves(below)] or [kind]


def test_no_shape_is_hidden():
    assert {shape.__name__ for shape in SHAPES} == {shape.__name__ for shape in leaves(ls.Shape)}
    assert len(SHAPES) >= 8


@every_shape
def test_is_public(shape):
    assert getattr(ls, shape.__name__) is shape
    assert shape.__name__ in ls.__all__


@every_shape
def test_has_its_python_file(shape):
    assert shape.__module__ == f"lidarsim.world.shapes.{snake(shape)}"


@every_shape
def test_has_its_rust_file(shape):
    if not CORE.is_dir():
        pytest.skip("the tests run without the sources")
    (source,) = [*CORE.glob(f"*/{snake(shape)}.rs"), *CORE.glob(f"*/{snake(shape)}/mod.rs")]
    assert len(source.read_text(encoding="utf-8").splitlines()) > 20
    layer = source.relative_to(CORE).parts[0]
    assert layer in {"shapes", "scene"}
    declared = re.findall(
        r"^(?:pub(?:\(crate\))? )?mod (?:r#)?(\w+);", (CORE / layer / "mod.rs").read_text("utf-8"), re.MULTILINE
    )
    assert snake(shape) in declared


@every_shape
def test_has_its_key_in_configurations(shape):
    from lidarsim.config.objects import SHAPES as CONFIGURED

    assert any(getattr(model, "constructor", None) is shape for model in CONFIGURED.values())


@every_shape
def test_is_documented(shape):
    doc = NumpyDocString(inspect.getdoc(shape))
    for section in ("Parameters", "Raises", "Notes", "Examples"):
        assert doc[section], section
    documented = [name.strip() for parameter in doc["Parameters"] for name in parameter.name.split(",")]
    assert documented == list(inspect.signature(shape).parameters)
    assert ">>> import lidarsim as ls" in doc["Examples"]


@every_shape
def test_takes_a_transform_everywhere(shape):
    makers = [
        shape,
        *(member for name, member in inspect.getmembers(shape, inspect.ismethod) if name.startswith("from_")),
    ]
    for maker in makers:
        parameter = inspect.signature(maker).parameters["transform"]
        assert parameter.kind is inspect.Parameter.KEYWORD_ONLY
        assert parameter.default is None


@every_shape
def test_has_a_sample_an_oracle_and_hard_cases(shape):
    assert shape.__name__ in {sample.shape for sample in SAMPLES}
    assert issubclass(getattr(oracle, shape.__name__), oracle.Shape)
    assert shape.__name__ in adversarial.KINDS
    assert sum(case.spec.kind.partition(".")[0] == shape.__name__ for case in cases.hard_cases()) >= 5


def test_samples_are_of_shapes_and_built_as_they_say():
    assert len({sample.name for sample in SAMPLES}) == len(SAMPLES)
    for sample in SAMPLES:
        assert type(sample.build()).__name__ == sample.shape
