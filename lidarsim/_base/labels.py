"""Labels that compare with the names of their classes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import UINT32, integer, shown
from lidarsim.errors import ArgumentTypeError, ArgumentValueError


class Labels(np.ndarray[Any, np.dtype[np.uint32]]):
    """A view of labels for which ``labels == "car"`` is the mask of the class of that name.

    NumPy itself calls a number and a text unequal, so that each such mask would be empty without an error. All else is
    as of any array; the results of arithmetic and comparisons are plain arrays. Parts, copies and pickles keep the
    names.

    Parameters
    ----------
    labels : ndarray of uint32
        Not copied.
    class_names : mapping of int to str
        Class names by label.
    """

    class_names: Mapping[int, str]

    def __new__(cls, labels: npt.NDArray[np.uint32], class_names: Mapping[int, str]) -> Labels:
        made = np.asarray(labels).view(cls)
        made.class_names = class_names
        return made

    def __array_finalize__(self, source: object) -> None:
        self.class_names = getattr(source, "class_names", {})

    def __array_wrap__(self, array: Any, context: object = None, return_scalar: bool = False) -> Any:
        return array[()] if return_scalar else array.view(np.ndarray)

    def __reduce__(self) -> tuple[Any, ...]:
        return Labels, (np.asarray(self), self.class_names)

    def __reduce_ex__(self, protocol: object) -> tuple[Any, ...]:
        return self.__reduce__()

    def __repr__(self) -> str:
        return repr(np.asarray(self))

    def __eq__(self, other: object) -> Any:
        if not isinstance(other, str):
            return super().__eq__(other)
        found = [label for label, name in self.class_names.items() if name == other]
        if not found:
            known = ", ".join(dict.fromkeys(self.class_names.values()))
            expected = f"one of the class names {known}" if known else "a number, since there are no class names"
            raise ArgumentValueError("label", expected, shown(other))
        plain = np.asarray(self)
        return np.logical_or.reduce([plain == label for label in found])

    def __ne__(self, other: object) -> Any:
        return ~(self == other) if isinstance(other, str) else super().__ne__(other)

    __hash__ = None  # as of any array


def labels_of(argument: str, classes: object, class_names: Mapping[int, str]) -> frozenset[int]:
    """Return the labels of classes that are given as labels or by name.

    Raises
    ------
    TypeError, ValueError
        If a label is not an integer from 0 to 2³² − 1, or no class has a name.
    """
    known = ", ".join(map(repr, class_names.values())) or "none"
    expected = f"labels, or names among class_names ({known})"
    if isinstance(classes, str | bytes) or not isinstance(classes, Iterable):
        raise ArgumentTypeError(argument, expected, shown(classes))
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
