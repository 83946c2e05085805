"""What models are made of, and models made of constructors.

A key is the name of a constructor's argument followed by its unit. Shapes, patterns and effects declare their own keys
as `configuration`, from which `model_of` makes models; the constructor checks everything except types.
"""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Callable, Collection, Iterable
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, create_model, model_validator
from pydantic_core import PydanticCustomError

from lidarsim._base import validation
from lidarsim.config.units import UNITS, argument_of, in_si, unit_of

if TYPE_CHECKING:
    from lidarsim.config.document import Place

T = TypeVar("T")
P = TypeVar("P", bound="Part")


class Model(BaseModel):
    """A mapping with these keys and no others."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @classmethod
    def keys(cls) -> Collection[str]:
        """Return the keys that such a mapping may have in a file."""
        return cls.model_fields

    @classmethod
    def nearest(cls, key: str) -> list[str]:
        """Return the keys that `key` may be a misspelling of."""
        return difflib.get_close_matches(key, cls.keys())

    @model_validator(mode="before")
    @classmethod
    def _suggest(cls, value: object) -> object:
        for key in value if isinstance(value, dict) else ():
            if key not in cls.model_fields:
                near = cls.nearest(key)
                hint = f"did you mean {' or '.join(near)}?" if near else f"expected one of {', '.join(cls.keys())}"
                raise PydanticCustomError("unknown_key", "unknown key; {hint}", {"key": key, "hint": hint})
        return value


def construct(constructor: Callable[..., T], model: Model, keys: Collection[str], place: Place, **more: object) -> T:
    """Call `constructor` with `more` and the given values of `keys`, in SI units and radians.

    Raises
    ------
    ConfigError
        If the constructor raises an error: at the key of the argument that it names, its own or one of a part, else at
        `place`.
    """
    arguments: dict[str, object] = {}
    key_of: dict[str, tuple[str, str]] = {}
    for key in sorted(keys):
        name, unit = argument_of(key), unit_of(key)
        if key in model.model_fields_set:
            value: Any = _build(getattr(model, key), place / key)
            if unit and value is not None:
                value = in_si(value, unit)
            if name in arguments:
                raise (place / key).error(f"given already as {key_of[name][0]}")
            arguments[name] = value
        elif name in key_of:
            continue
        key_of[name] = key, _other_unit(unit)
    for argument in sorted(arguments | more):
        part = getattr(model, argument, None)
        for key in sorted(part.model_fields_set) if isinstance(part, Part) else ():
            key_of.setdefault(argument_of(key), (f"{argument}.{key}", _other_unit(unit_of(key))))
    with place.refusals(key_of):
        return constructor(**{**arguments, **more})


def _other_unit(unit: str | None) -> str:
    """Return the words that give the unit of an argument whose key has another unit, else ""."""
    return f" (in {UNITS[unit][0]})" if unit and UNITS[unit][0] else ""


def _build(value: object, place: Place) -> object:
    if isinstance(value, Part):
        return value.build(place)
    if isinstance(value, list):
        return [_build(entry, place / index) for index, entry in enumerate(value)]
    return value


class Part(Model):
    """A mapping whose keys are the arguments of a constructor."""

    constructor: ClassVar[Callable[..., Any]]
    alternatives: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Groups of keys for one required argument in different units; one key must be given."""

    def build(self, place: Place) -> Any:
        """Return the object that it describes."""
        for keys in self.alternatives:
            if not self.model_fields_set.intersection(keys):
                raise place.error(f"missing key {' or '.join(map(repr, keys))}")
        constructor = type(self).constructor
        return construct(constructor, self, constructor.configuration, place)  # type: ignore[attr-defined]


def model_of(constructor: Any, base: type[Part] = Part, **more: Any) -> Any:
    """Return the model for `constructor`, with the keys that it declares as its `configuration`.

    A key is optional if its argument has a default, and may be null if the default is None.

    Parameters
    ----------
    constructor : type
        A type with a `configuration` that maps keys to types.
    base : type of Part
        Base class of the model.
    **more : Any
        Further fields, as (type, default).

    Returns
    -------
    type of Part
        The model.
    """
    parameters = inspect.signature(constructor).parameters
    keys_of: dict[str, list[str]] = {}
    for key in constructor.configuration:
        keys_of.setdefault(argument_of(key), []).append(key)
    fields: dict[str, Any] = dict(more)
    for argument, keys in keys_of.items():
        default = parameters[argument].default
        for key in keys:
            kind = _kind(constructor.configuration[key])
            if default is inspect.Parameter.empty and len(keys) == 1:
                fields[key] = (kind, ...)
            else:
                fields[key] = (kind | None if default is None else kind, None)
    model = create_model(constructor.__name__, __base__=base, **fields)
    model.constructor = constructor
    model.alternatives = tuple(
        tuple(keys)
        for argument, keys in keys_of.items()
        if len(keys) > 1 and parameters[argument].default is inspect.Parameter.empty
    )
    return model


def _kind(declared: Any) -> Any:
    """Return the type in a model of a value declared as `declared`."""
    if hasattr(declared, "configuration"):
        return model_of(declared)
    (entry,) = getattr(declared, "__args__", (None,)) if getattr(declared, "__origin__", None) is list else (None,)
    if hasattr(entry, "configuration"):
        return list[model_of(entry)]  # type: ignore[misc]
    return _KINDS[declared]


def either(first: Any, second: Any, is_second: Callable[[object], bool]) -> Any:
    """Return a union of two types that only reports errors of the type chosen by `is_second`."""
    tag = Discriminator(lambda value: "second" if is_second(value) else "first")
    return Annotated[Annotated[first, Tag("first")] | Annotated[second, Tag("second")], tag]


def has(key: str) -> Callable[[object], bool]:
    """Return a function that tells whether a value is a mapping with a key."""
    return lambda value: isinstance(value, dict) and key in value


def is_list(value: object) -> bool:
    """Return whether a value is a list."""
    return isinstance(value, list)


def is_text(value: object) -> bool:
    """Return whether a value is a text."""
    return isinstance(value, str)


def is_table(value: object) -> bool:
    """Return whether a value is a list of lists."""
    return isinstance(value, list) and any(isinstance(row, list) for row in value)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Row = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Field(min_length=4, max_length=4)]


if TYPE_CHECKING:
    Numbers = float | list[float]
    Vectors = Vector | list[Vector]
    Scale = float | list[float]
    Grouping = str | int | None
    FloatOrText = float | str
    NumbersOrColor = float | list[float] | str
    SigmaTable = float | list[Pair]
    Area = list[float] | list[Pair]
    Returns = str | int
else:
    Numbers = either(float, list[float], is_list)
    Vectors = either(Vector, list[Vector], is_table)
    Scale = either(Finite, Vector, is_list)
    SigmaTable = either(float, list[Pair], is_list)
    Area = either(list[float], list[Pair], is_table)
    Returns = either(int, str, is_text)
    Grouping = either(int, Literal["node", "parent", "file"], is_text) | None
    NumbersOrColor = either(Numbers, Literal["color"], is_text)
    FloatOrText = either(float, str, is_text)


_KINDS: dict[Any, Any] = {
    bool: bool,
    float: float,
    int: int,
    int | str: Returns,
    list[float]: list[float],
    tuple[float, float]: Pair,
    float | list[float]: Numbers,
    float | list[tuple[float, float]]: SigmaTable,
    list[tuple[float, float]]: list[Pair],
    validation.Vector: Vector,
    list[validation.Vector]: list[Vector],
    validation.Vector | list[validation.Vector]: Vectors,
}
"""Type in a model for each type that a `configuration` may declare."""


def public(package: ModuleType) -> list[type]:
    """Return the public types of a package."""
    return [getattr(package, name) for name in package.__all__]


def models_of(constructors: Iterable[type], tag: str, base: type[P]) -> dict[str, type[P]]:
    """Return the models of the `constructors` that declare a `configuration`, by name; the key `tag` has the name."""
    declaring = [constructor for constructor in constructors if getattr(constructor, "configuration", None)]
    names = [re.sub(r"(?<=[a-z])(?=[A-Z])", "_", constructor.__name__).lower() for constructor in declaring]
    return {
        name: model_of(made, base, **{tag: (Literal[name], ...)}) for name, made in zip(names, declaring, strict=True)
    }
