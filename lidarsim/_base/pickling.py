"""Pickles and copies of public objects, without caches and with a format number."""

from __future__ import annotations

import copy
import pickle
from dataclasses import MISSING, FrozenInstanceError, fields
from typing import TYPE_CHECKING, Any, NoReturn, Self

import numpy as np

from lidarsim._base.names import Answering, instead
from lidarsim._base.shown import short

FORMAT = 4
"""Format number of pickles, incremented if contents of the same name change their meaning.

A pickle has the defaults of what its class gained since. One with contents that the class does not know is refused.
"""

_COMPLETE: set[tuple[object, ...]] = set()
"""Classes, each with the names in a pickle that lacked none: such pickles need no further checks."""

SHORT = 64  # maximum size of an array whose numbers are hashed


class Pickled(metaclass=Answering):
    """Base of the public classes: a pickle holds the result of `_contents`, by default the fields of a dataclass.

    Arrays are not copied, so that protocol 5 can transfer their buffers out of band.
    """

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # A frozen dataclass is made twice if it has slots; for a name that is no field, its method fails in `super`.
        if {"__dataclass_params__", "__setattr__"} <= vars(cls).keys():
            cls.__setattr__ = _refuse_change  # type: ignore[method-assign]

    def _contents(self) -> dict[str, Any]:
        """Return the values that an equal object is made from, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    @classmethod
    def _upgrade(cls, contents: dict[str, Any]) -> dict[str, Any]:
        """Return contents of any version, with the default of each value that they lack."""
        if not hasattr(cls, "__dataclass_fields__"):
            return contents
        known = fields(cls)  # type: ignore[arg-type]
        defaults = {x.name: x.default if x.default_factory is MISSING else x.default_factory() for x in known}
        complete = defaults | contents
        if len(complete) > len(known) or any(value is MISSING for value in complete.values()):
            raise TypeError(f"{cls.__name__}: expected {', '.join(defaults)}, got {', '.join(contents)}")
        return complete

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        """Return an object with these contents, which were checked when the original was made."""
        made = cls.__new__(cls)
        for name, value in contents.items():
            object.__setattr__(made, name, value)
        return made

    if not TYPE_CHECKING:  # type checkers know all attributes

        def __getattr__(self, name: str) -> NoReturn:
            """Raise an error that names the attribute that is probably meant; called only for a missing one."""
            try:
                object.__getattribute__(self, name)  # the error of Python, or that of a property
            except AttributeError as error:
                known = [] if name.startswith("_") else [other for other in dir(type(self)) if other[0] != "_"]
                hint = instead(type(self), name, known) if known and name not in known else ""
                raise AttributeError(f"{error}; {hint}" if hint else str(error), name=name, obj=self) from None

    def __repr__(self) -> str:
        """Return the class and its contents, with long arrays abbreviated."""
        return (
            f"{type(self).__name__}({', '.join(f'{name}={short(value)}' for name, value in self._contents().items())})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how `copy` and `pickle` make an equal object."""
        return _restore, (FORMAT, type(self), self._contents())

    def __copy__(self) -> Self:
        """Return a copy that shares no mutable state."""
        return copy.deepcopy(self)


def _refuse_change(_: object, name: str, __: object) -> NoReturn:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")


class Immutable(Pickled):
    """Base of the immutable public classes; copying returns the object itself."""

    __slots__ = ()

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        for value in contents.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        return super()._from_contents(contents)

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: object) -> Self:
        return self


class Value(Immutable):
    """Base of the immutable public classes whose objects are equal if their contents are."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        if other is self:
            return True
        mine, others = self._contents(), other._contents()
        return mine.keys() == others.keys() and all(np.array_equal(mine[name], others[name]) for name in mine)

    def __hash__(self) -> int:
        return hash((type(self), *(_hashable(value) for value in self._contents().values())))


def _hashable(value: object) -> object:
    """Return a hash key of a value; for a long array, only its shape."""
    if not isinstance(value, np.ndarray):
        return value
    return tuple(value.ravel().tolist()) if value.size <= SHORT else value.shape


def _restore(number: int, cls: type[Pickled], contents: dict[str, Any]) -> Pickled:
    if number == FORMAT and (cls, *contents) in _COMPLETE:
        return cls._from_contents(contents)
    if number > FORMAT:
        raise _refusal(number, cls)
    try:
        made = cls._from_contents(cls._upgrade(contents))
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise _refusal(number, cls) from error
    known = made._contents().keys()
    if not contents.keys() <= known:
        raise _refusal(number, cls)
    if contents.keys() == known:
        _COMPLETE.add((cls, *contents))
    return made


def _refusal(number: int, cls: type[Pickled]) -> pickle.UnpicklingError:
    return pickle.UnpicklingError(
        f"pickle of a {cls.__name__}: expected format {FORMAT} of this version of lidarsim, got format {number}"
        " of another version; pickles are for one version, files for more"
    )
