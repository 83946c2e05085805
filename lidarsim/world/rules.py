"""Rules that label what a scene file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal, get_args

from lidarsim._base.validation import UINT32, flag, integer, real, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.materials import Material

Grouping = Literal["node", "parent", "file"]
Appearance = float | Material | Literal["color"] | None
"""Reflectivity or material of a part, "color" for its base colours, or None for none given."""


@dataclass(frozen=True, kw_only=True)
class Rule:
    """What becomes of the parts of a scene file that match two patterns.

    Of several rules, the first that matches a part decides all about it. In a pattern, ``*`` stands for any text, also
    with slashes, ``?`` for one character and ``[ab]`` for one of these; case matters.

    Parameters
    ----------
    node : str
        Pattern of the path of a node: the names from the top node to the node, separated by slashes.
    material : str
        Pattern of the name of a material; a part without one has the name "".
    label : int, optional
        Class of the objects, 0 to 2³² − 1.
    reflectivity : float, Material or "color", optional
        Reflectivity >= 0, a material, or "color" for the luminance of the base colours as reflectivity.
    instance : {"node", "parent", "file"} or int, optional
        Which objects are one instance: those of one node, of all nodes with the same parent (a top node is its own),
        or all to which such a rule applies; or the number of the instance, 0 to 2³² − 1, above the number of objects,
        as default numbers are ids + 1. Default: those of one top node.
    name : str, optional
        Name of the objects. Default: the name of their node.
    skip : bool
        Whether the parts are left out.

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type or out of range.

    Examples
    --------
    >>> import lidarsim as ls
    >>> rules = [
    ...     ls.Rule(node="*helper*", skip=True),
    ...     ls.Rule(node="cars/*", label=10, instance="node"),
    ...     ls.Rule(material="asphalt*", label=40, reflectivity=ls.materials.ASPHALT),
    ... ]
    """

    node: str = "*"
    material: str = "*"
    label: int | None = None
    reflectivity: Appearance = None
    instance: Grouping | int | None = None
    name: str | None = None
    skip: bool = False

    def __post_init__(self) -> None:
        for argument in ("node", "material"):
            pattern = getattr(self, argument)
            if not isinstance(pattern, str):
                raise ArgumentTypeError(argument, "a pattern such as 'cars/*'", short_repr(pattern))
        if self.label is not None:
            object.__setattr__(self, "label", integer("label", self.label, at_least=0, at_most=UINT32))
        object.__setattr__(self, "reflectivity", check_appearance(self.reflectivity))
        if isinstance(self.instance, str):
            if self.instance not in get_args(Grouping):
                expected = f"one of {', '.join(map(repr, get_args(Grouping)))}, or an integer"
                raise ArgumentValueError("instance", expected, short_repr(self.instance))
        elif self.instance is not None:
            object.__setattr__(self, "instance", integer("instance", self.instance, at_least=0, at_most=UINT32))
        if self.name is not None and not isinstance(self.name, str):
            raise ArgumentTypeError("name", "a string", short_repr(self.name))
        flag("skip", self.skip)

    def matches(self, node: str, material: str) -> bool:
        """Return whether the rule applies to a part.

        Parameters
        ----------
        node : str
            Path of its node.
        material : str
            Name of its material.

        Returns
        -------
        bool
            Whether both patterns match all of the text.

        Raises
        ------
        TypeError
            If an argument is not a string.
        """
        for what, text in (("node", node), ("material", material)):
            if not isinstance(text, str):
                raise ArgumentTypeError(what, "a string", short_repr(text))
        return fnmatchcase(node, self.node) and fnmatchcase(material, self.material)


def check_appearance(value: object) -> Appearance:
    """Return the checked argument `reflectivity` of a rule or of `Scene.from_file`."""
    if value is None or isinstance(value, Material):
        return value
    if isinstance(value, str):
        if value != "color":
            raise ArgumentValueError("reflectivity", "a number >= 0, a Material or 'color'", short_repr(value))
        return "color"
    return real("reflectivity", value, at_least=0.0)


@dataclass(frozen=True)
class Options:
    """The checked options of `Scene.from_file`."""

    up: Literal["y", "z"] | None = None
    unit: float | None = None
    rules: tuple[Rule, ...] = ()
    reflectivity: Appearance = None

    @classmethod
    def from_arguments(cls, up: object, unit: object, rules: object, reflectivity: object) -> Options:
        """Return the options after checking them."""
        if up is not None and not (isinstance(up, str) and up in {"y", "z"}):
            raise ArgumentValueError("up", "'y', 'z' or None", short_repr(up))
        if isinstance(rules, str | bytes | Rule) or not isinstance(rules, Sequence):
            raise ArgumentTypeError("rules", "a sequence of Rule", short_repr(rules))
        for i, rule in enumerate(rules):
            if not isinstance(rule, Rule):
                raise ArgumentTypeError("rules", "a sequence of Rule", f"rules[{i}] = {short_repr(rule)}")
        scale = None if unit is None else real("unit", unit, above=0.0)
        return cls(up, scale, tuple(rules), check_appearance(reflectivity))  # type: ignore[arg-type]
