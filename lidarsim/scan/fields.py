"""The fields of point clouds: their types and units, and values that fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim.errors import ArgumentValueError
from lidarsim.scan.columns import PointColumns

Fields = dict[str, npt.NDArray[Any]]

_FIRST = ("xyz", "range", "true_range", "intensity", "time", "ring", "column", "return_number")
_COLUMNS = PointColumns._columns

CANONICAL = {name: (_COLUMNS[name].shape, _COLUMNS[name].dtype) for name in dict.fromkeys([*_FIRST, *_COLUMNS])}
"""Shape per point and dtype of lidarsim's own fields, in order: the first ones, then those of the table."""

UNITS = dict.fromkeys(("x", "y", "z", "height"), "m") | {
    name: column.unit for name, column in _COLUMNS.items() if column.unit
}
"""Units of the fields that have one, of coordinates, and of the height that pictures show."""

EXTRA_DTYPES = tuple(np.dtype(code) for code in ("?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"))
"""Types of all other fields."""


def first_misfit(
    name: str, given: npt.NDArray[Any], dtype: type[np.number[Any]], first: int = 0
) -> tuple[str, str] | None:
    """Return what is expected of numbers of a type, and the first that it cannot hold, for an error; None if all fit.

    `first` is the number of the first point.
    """
    wrong = _misfits(given, dtype)
    if not wrong.any():
        return None
    index = np.argwhere(wrong)[0]
    where = "".join(f"[{i}]" for i in [*(index[:1] + first), *index[1:]])
    if issubclass(dtype, np.integer):
        kind = f"integers from {np.iinfo(dtype).min} to {np.iinfo(dtype).max}"
    else:
        kind = f"numbers that {np.dtype(dtype)} can hold"
    return kind, f"{name}{where} = {given[tuple(index)]}"


def _misfits(given: npt.NDArray[Any], dtype: type[np.number[Any]]) -> npt.NDArray[np.bool_]:
    """Return a mask of the numbers that `dtype` cannot hold; rounding to a float is allowed, overflow is not."""
    if np.can_cast(given.dtype, dtype):
        return np.broadcast_to(np.False_, given.shape)
    if issubclass(dtype, np.integer):
        low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
        fits: npt.NDArray[np.bool_] = (given >= low) & (given <= high) & (given == np.floor(given))
        return ~fits
    with np.errstate(over="ignore"):
        beyond: npt.NDArray[np.bool_] = np.isinf(given.astype(dtype)) & np.isfinite(given)
    return beyond


def fit(array: npt.NDArray[Any], dtype: npt.DTypeLike) -> tuple[npt.NDArray[Any], bool]:
    """Return `array` with 0 for all numbers that `dtype` cannot hold, and whether the conversion is lossless.

    Rounding a float counts as lossless, rounding an integer does not.
    """
    kind: Any = np.dtype(dtype).type
    numbers = array.view(np.uint8) if array.dtype == np.bool_ else array
    wrong = _misfits(numbers, kind)
    exact = array.dtype != np.bool_ and not wrong.any()
    if exact and issubclass(kind, np.floating) and array.dtype.kind in "iu" and array.size:
        most = 2 ** (np.finfo(kind).nmant + 1)
        exact = bool(array.min() >= -most and array.max() <= most)
    return (np.where(wrong, numbers.dtype.type(0), numbers) if wrong.any() else numbers), exact


def narrow(name: str, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a field in one of the types that Open3D reads and writes in every format.

    Parameters
    ----------
    name : str
        Name of the field, for the error.
    array : ndarray
        Values of the field, of any valid type.

    Returns
    -------
    ndarray
        Unchanged if uint8, uint16, int32, float32 or float64. Booleans become uint8; other integers become int32 or, if
        one of them does not fit, float64.

    Raises
    ------
    ValueError
        If the magnitude of an integer exceeds 2⁵³, up to which float64 is exact.
    """
    if array.dtype.str[1:] in {"u1", "u2", "i4", "f4", "f8"}:
        return array
    if array.dtype == np.bool_:
        return array.astype(np.uint8)
    low, high = (int(array.min()), int(array.max())) if array.size else (0, 0)
    if low >= -(2**31) and high < 2**31:
        return array.astype(np.int32)
    if low < -(2**53) or high > 2**53:
        raise ArgumentValueError(
            name, "integers from -2**53 to 2**53, the most that Open3D's types hold", low if low < -(2**53) else high
        )
    return array.astype(np.float64)


def with_unit(name: str) -> str:
    """Return the name of a field with its unit, such as "range [m]", for pictures."""
    return f"{name} [{UNITS[name]}]" if name in UNITS else name
