"""Pickles and copies of public objects: without caches, with the number of their format."""

from __future__ import annotations

import copy
import pickle
from dataclasses import fields
from typing import Any, Self

import numpy as np

from lidarsim._shown import short

FORMAT = 1
"""Format of the pickles, raised whenever the contents of a public class change."""


SHORT = 64  # numbers of an array that take part in a hash


class Pickled:
    """Base of the public classes: a pickle holds what `_contents` gives, which of a dataclass are its fields.

    Arrays are given as they are, so that protocol 5 can take their memory out of band.
    """

    __slots__ = ()

    def _contents(self) -> dict[str, Any]:
        """Return by name what an equal object is made of."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    @classmethod
    def _restored(cls, contents: dict[str, Any]) -> Self:
        """Return the object of these contents, which were checked when the first one was made."""
        made = cls.__new__(cls)
        for name, value in contents.items():
            object.__setattr__(made, name, value)
        return made

    def __repr__(self) -> str:
        """Return the class and its contents, long arrays in short."""
        return (
            f"{type(self).__name__}({', '.join(f'{name}={short(value)}' for name, value in self._contents().items())})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how `copy` and `pickle` make an equal object."""
        return _restore, (FORMAT, type(self), self._contents())

    def __copy__(self) -> Self:
        """Return a copy that shares nothing which can change."""
        return copy.deepcopy(self)


class Immutable(Pickled):
    """Base of the public classes whose objects never change: copies are the object itself."""

    __slots__ = ()

    @classmethod
    def _restored(cls, contents: dict[str, Any]) -> Self:
        for value in contents.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        return super()._restored(contents)

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: object) -> Self:
        return self


class Value(Immutable):
    """Base of the public classes whose objects are equal if all that they are made of is."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        if other is self:
            return True
        mine, others = self._contents(), other._contents()
        return all(np.array_equal(value, others[name]) for name, value in mine.items())

    def __hash__(self) -> int:
        return hash((type(self), *(_hashable(value) for value in self._contents().values())))


def _hashable(value: object) -> object:
    """Return something of which equal values have the same: of a long array no more than its shape."""
    if not isinstance(value, np.ndarray):
        return value
    return tuple(value.ravel().tolist()) if value.size <= SHORT else value.shape


def _restore(number: int, cls: type[Pickled], contents: dict[str, Any]) -> Pickled:
    if number != FORMAT:
        raise pickle.UnpicklingError(
            f"pickle of a {cls.__name__}: expected format {FORMAT} of this version of lidarsim, got format {number};"
            " pickles are for one version, files for more"
        )
    return cls._restored(contents)
