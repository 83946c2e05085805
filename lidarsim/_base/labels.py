"""Labels that compare with the names of their classes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import instead
from lidarsim._base.validation import UINT32, integer, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError


class Labels(np.ndarray[Any, np.dtype[Any]]):
    """A view of integers for which ``labels == "car"`` is the mask of the class of that name.

    NumPy itself calls a number and a text unequal, so that each such mask would be empty without an error. ``np.isin``
    takes names, too. All else is as of any array; the results of arithmetic and comparisons are plain arrays. Parts,
    copies and pickles keep the names.

    Parameters
    ----------
    labels : ndarray of integers
        Not copied.
    class_names : mapping of int to str
        Names by number.
    field : str
        Name of the array, for errors.
    """

    class_names: Mapping[int, str]
    field: str

    def __new__(cls, labels: npt.NDArray[Any], class_names: Mapping[int, str], field: str = "label") -> Labels:
        made = np.asarray(labels).view(cls)
        made.class_names, made.field = class_names, field
        return made

    def __array_finalize__(self, source: object) -> None:
        self.class_names, self.field = getattr(source, "class_names", {}), getattr(source, "field", "label")

    def __array_wrap__(self, array: Any, context: object = None, return_scalar: bool = False) -> Any:
        return array[()] if return_scalar else array.view(np.ndarray)

    def __getattr__(self, name: str) -> Any:
        hint = instead("Labels", name, [])
        raise AttributeError(f"an array has no {name!r}{hint and f': {hint}'}", name=name, obj=self)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.isin and len(args) > 1 and isinstance(args[0], Labels):
            args = args[0], args[0]._numbers(args[1]), *args[2:]
        return super().__array_function__(function, types, args, kwargs)

    def __reduce__(self) -> tuple[Any, ...]:
        return Labels, (np.asarray(self), self.class_names, self.field)

    def __reduce_ex__(self, protocol: object) -> tuple[Any, ...]:
        return self.__reduce__()

    def __repr__(self) -> str:
        return repr(np.asarray(self))

    def _numbers(self, names: Any) -> Any:
        """Return the numbers of one or more class names; what is no text stays as it is."""
        several = list(names) if isinstance(names, set | frozenset) else names
        found: list[int] = []
        for name in np.ravel(np.asarray(several, dtype=object)).tolist():
            if not isinstance(name, str):
                return several
            numbers = [number for number, text in self.class_names.items() if text == name]
            if not numbers:
                known = ", ".join(dict.fromkeys(self.class_names.values()))
                expected = f"one of the class names {known}" if known else "a number, since there are no class names"
                raise ArgumentValueError(self.field, expected, short_repr(name))
            found += numbers
        return np.array(found, self.dtype)

    def __eq__(self, other: object) -> Any:
        if isinstance(other, str):
            return np.isin(np.asarray(self), self._numbers(other))
        if _is_text(other):
            raise ArgumentTypeError(self.field, "one class name", short_repr(other), f"np.isin({self.field}, names)")
        return super().__eq__(other)

    def __ne__(self, other: object) -> Any:
        return super().__ne__(other) if not _is_text(other) else ~(self == other)

    __hash__ = None  # as of any array


def _is_text(value: object) -> bool:
    """Return whether a value is a text, or holds texts."""
    return isinstance(value, str | bytes) or (isinstance(value, Collection) and np.asarray(value).dtype.kind in "US")


def labels_of(argument: str, classes: object, class_names: Mapping[int, str]) -> frozenset[int]:
    """Return the labels of classes that are given as labels or by name.

    Raises
    ------
    TypeError, ValueError
        If a label is not an integer from 0 to 2³² − 1, or no class has a name.
    """
    known = ", ".join(map(repr, class_names.values())) or "none"
    expected = f"labels, or names among class_names ({known})"
    if isinstance(classes, str | bytes) or not isinstance(classes, Iterable) or getattr(classes, "ndim", 1) == 0:
        raise ArgumentTypeError(argument, expected, short_repr(classes))
    found: set[int] = set()
    for given in classes:
        if isinstance(given, str):
            labels = {label for label, name in class_names.items() if name == given}
            if not labels:
                raise ArgumentValueError(argument, expected, repr(given))
            found |= labels
        else:
            found.add(integer(argument, given, at_least=0, at_most=UINT32))
    return frozenset(found)
