"""Argument checks, in one place so that all errors read alike.

Each error states the argument, the expectation and the value; for an array, it names the first wrong entry.
"""

from __future__ import annotations

import inspect
import math
import operator
import reprlib
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim.errors import ArgumentError, ArgumentTypeError, ArgumentValueError

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

Floats = npt.NDArray[np.float64]

Vector = tuple[float, float, float]
"""A point or vector, as the declared type of a value in a configuration."""

Transform: TypeAlias = "RigidTransform | npt.ArrayLike"
"""A pose or placement: a `scipy.spatial.transform.RigidTransform`, or array_like of shape (4, 4)."""

UINT32 = 2**32 - 1
"""Largest label or instance."""

WIDEST_BEAM = 0.1
"""Largest divergence of a beam, rad; lidar beams have milliradians."""


def real(
    name: str,
    value: object,
    *,
    at_least: float = -math.inf,
    above: float = -math.inf,
    at_most: float = math.inf,
    infinite: bool = False,
) -> float:
    """Return `value` as a float within the bounds; NaN never passes, ±inf only with `infinite`."""
    if isinstance(value, float):
        number = float(value)  # numpy.float64 is a float, but compares slowly
        if at_least <= number <= at_most and above < number < math.inf:
            return number
    wrong: type[ArgumentError] = ArgumentTypeError
    got = ""
    if _is_real(value):
        try:
            number = float(value)  # type: ignore[arg-type]
        except OverflowError:
            wrong, got = ArgumentValueError, "a number beyond float64"
        except (TypeError, ValueError):
            pass
        else:
            inside = at_least <= number <= at_most and (number > above or above == -math.inf)
            if inside and (infinite or math.isfinite(number)):
                return number
            wrong, got = ArgumentValueError, repr(number)
    expected = "a real number" if infinite else "a finite number"
    if above > -math.inf:
        expected += f" > {above:g}" if at_most == math.inf else f" > {above:g} and <= {at_most:g}"
    else:
        expected += _between(*(f"{end:g}" if math.isfinite(end) else None for end in (at_least, at_most)))
    raise wrong(name, expected, got or short_repr(value))


def _is_real(value: object) -> bool:
    """Return whether `float` may convert `value`; booleans, texts and complex numbers are not real numbers."""
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "fiu"
    if isinstance(value, np.generic):
        return isinstance(value, np.floating | np.integer)
    return not isinstance(value, bool | str | bytes | bytearray | complex)


def is_several(value: object) -> bool:
    """Return whether `value` has several numbers, as a list, a tuple or an array; one of no dimension is a number."""
    return isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim > 0)


def each_ring(name: str, value: object) -> float | tuple[float, ...]:
    """Return `value` as a float, or as a tuple of one for each ring."""
    return tuple(array(name, value, ("rings",)).tolist()) if is_several(value) else real(name, value)


def integer(name: str, value: object, *, at_least: int | None = None, at_most: int | None = None) -> int:
    """Return `value` as an int within the bounds."""
    if type(value) is int and (at_least is None or value >= at_least) and (at_most is None or value <= at_most):
        return value
    wrong: type[ArgumentError] = ArgumentTypeError
    if not isinstance(value, bool):
        try:  # arrays have `__index__`, which fails unless they hold a single integer
            number = operator.index(value)  # type: ignore[arg-type]
        except TypeError:
            pass
        else:
            if (at_least is None or number >= at_least) and (at_most is None or number <= at_most):
                return number
            wrong, value = ArgumentValueError, number
    expected = "an integer" + _between(*(None if end is None else str(end) for end in (at_least, at_most)))
    raise wrong(name, expected, short_repr(value))


def one_of(name: str, value: object, options: Sequence[str]) -> None:
    """Check that `value` is one of `options`."""
    if not (isinstance(value, str) and value in options):
        *others, last = map(repr, options)
        raise ArgumentValueError(name, f"{', '.join(others)} or {last}", short_repr(value))


def function(name: str, value: object, takes: str, count: int) -> None:
    """Check that `value` can be called with `count` arguments, which `takes` names."""
    if not callable(value):
        raise ArgumentTypeError(name, f"a function of {takes}", short_repr(value))
    try:
        signature = inspect.signature(value)
    except ValueError:  # a C function has none
        return
    try:
        signature.bind(*[None] * count)
    except TypeError:
        raise ArgumentTypeError(name, f"a function of {takes}", f"one of {signature}") from None


def check_options(kind: str, read: Callable[..., object], options: Mapping[str, object]) -> None:
    """Check that the reader of a kind of file, ``read(path, **options)``, takes these options."""
    signature = inspect.signature(read)
    for name, value in options.items():
        try:
            signature.bind_partial(None, **{name: value})
        except TypeError:
            _, *known = signature.parameters
            expected = f"none, since {kind} has {', '.join(known) or 'nothing'} as options"
            raise ArgumentTypeError(name, expected, short_repr(value)) from None


def items(name: str, value: object, kind: str) -> list[Any]:
    """Return the items of `value`, an iterable but no text, as a list; the error names their `kind`."""
    if not isinstance(value, str | bytes):
        with suppress(TypeError):
            return list(value)  # type: ignore[call-overload, no-any-return]
    raise ArgumentTypeError(name, f"a sequence of {kind}", short_repr(value))


Instances = Iterable[int] | npt.NDArray[np.integer[Any]]
"""Instance numbers of objects, as an argument."""


def instances(name: str, value: Instances) -> npt.NDArray[np.int64] | None:
    """Return instance numbers, of shape (m,), or None if there are none; the core finds those that are unknown."""
    if isinstance(value, tuple) and not value:
        return None
    expected = "a collection of instance numbers"
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise ArgumentTypeError(name, expected, short_repr(value))
    given = as_array(name, value if isinstance(value, np.ndarray) else items(name, value, "instance numbers"), expected)
    if given.ndim != 1 or (given.size and given.dtype.kind not in "iu"):
        raise ArgumentTypeError(name, expected, f"{given.dtype} of shape {given.shape}")
    outside = (given < 0) | (given > UINT32)
    if outside.any():
        raise ArgumentValueError(name, f"instance numbers from 0 to {UINT32}", given[int(np.argmax(outside))])
    return given.astype(np.int64) if given.size else None


def instances_of_rows(
    name: str, value: Instances | Collection[Instances], rows: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.uint64] | None] | None:
    """Return instance numbers, and where those of each row end if rows differ; None if there are none at all."""
    if isinstance(value, np.ndarray):
        each = value.ndim > 1
    elif isinstance(value, Collection) and not isinstance(value, str | bytes):
        each = any(isinstance(item, Collection) and not isinstance(item, np.generic) for item in value)
    else:
        each = False
    if not each:
        alike = instances(name, value)  # type: ignore[arg-type]
        return None if alike is None else (alike, None)
    sets = [item if isinstance(item, Collection) else () for item in value]
    if len(sets) != rows or not all(isinstance(item, Collection) for item in value):
        expected = f"instance numbers, or a collection of them for each of {rows} rows"
        raise ArgumentValueError(name, expected, f"{len(sets)} collections" if len(sets) != rows else short_repr(value))
    found = instances(name, value.reshape(-1) if isinstance(value, np.ndarray) else [*chain.from_iterable(sets)])
    if found is None:
        return None
    return found, np.cumsum([len(item) for item in sets], dtype=np.uint64)


def flag(name: str, value: object) -> bool:
    """Return `value`, True or False, as a bool."""
    if not isinstance(value, bool | np.bool_):
        raise ArgumentTypeError(name, "True or False", short_repr(value))
    return bool(value)


def frames(first: object, count: object, *, at_least: int = 0) -> range:
    """Return the numbers of `count` frames from `first` on, after checking that all fit uint32."""
    number = integer("count", count, at_least=at_least)
    start = integer("first", first, at_least=0, at_most=UINT32)
    if number > 1 << 32:
        raise ArgumentValueError("count", f"at most {1 << 32} frames", short_repr(number))
    integer("frame", start + max(number - 1, 0), at_least=0, at_most=UINT32)
    return range(start, start + number)


SLOWEST, FASTEST = 1e-9, 1e12
"""Bounds of rates, Hz; the periods are 30 years and the time in which light travels 0.3 mm."""


def frequency(name: str, value: object, *, at_most: float = math.inf) -> float:
    """Return a rate, Hz, as a float within `SLOWEST`, `FASTEST` and `at_most`."""
    number = real(name, value, above=0.0, at_most=at_most)
    if not SLOWEST <= number <= FASTEST:
        raise ArgumentValueError(name, f"a rate from {SLOWEST:g} to {FASTEST:g} Hz", number)
    return number


def angle(
    name: str, value: object, *, at_least: float = -math.inf, above: float = -math.inf, at_most: float = math.inf
) -> float:
    """Return an angle, rad, as a float within the bounds; the error for one beyond `at_most` suggests degrees."""
    return _real_in_unit(name, value, "degrees?", at_least=at_least, above=above, at_most=at_most)


def beam_angle(name: str, value: object) -> float:
    """Return the divergence of a beam, rad, as a float; the error for one beyond `WIDEST_BEAM` suggests mrad."""
    return _real_in_unit(name, value, "mrad?", at_least=0.0, at_most=WIDEST_BEAM)


def share(name: str, value: object) -> float:
    """Return a number > 0 and <= 1 as a float; the error for a greater one suggests percent."""
    return _real_in_unit(name, value, "percent?", above=0.0, at_most=1.0)


def _real_in_unit(
    name: str, value: Any, other: str, *, at_least: float = -math.inf, above: float = -math.inf, at_most: float
) -> float:
    """Return `value` as a float within the bounds; the error for one beyond `at_most` suggests the `other` unit."""
    try:
        return real(name, value, at_least=at_least, above=above, at_most=at_most)
    except ArgumentValueError as error:
        try:
            hint = other if at_most < abs(float(value)) < math.inf else ""
        except OverflowError:
            hint = ""
        raise ArgumentValueError(name, error.expected, error.got, hint) from None


def angles(name: str, values: Floats, *, at_most: float) -> Floats:
    """Return `values`, rad, after checking that each is from -`at_most` to `at_most`."""
    wrong = np.abs(values) > at_most
    if wrong.any():
        i = int(np.argmax(wrong))
        expected = f"numbers from {-at_most:g} to {at_most:g}"
        raise ArgumentValueError(name, expected, f"{name}[{i}] = {values[i]:g}", "degrees?")
    return values


def ask(name: str, got: str, question: str) -> None:
    """Warn, at the caller outside lidarsim, of a legal value that is probably a mistake."""
    level, frame = 1, inspect.currentframe()
    while frame and frame.f_back and frame.f_globals["__name__"].startswith("lidarsim."):
        level, frame = level + 1, frame.f_back
    warnings.warn(f"{name}: {got}; {question}", stacklevel=level)


def ask_above(name: str, values: npt.ArrayLike, most: float, unit: str, question: str) -> None:
    """Ask if the largest magnitude of some values, in `unit`, exceeds what is usual, though not beyond other units."""
    largest = float(np.abs(values).max(initial=0.0))
    if most < largest < 1e4 * most:
        ask(name, f"{largest:g} {unit}", question)


def as_array(name: str, value: object, expected: str) -> npt.NDArray[Any]:
    """Return `value` as an array, in the dtype that NumPy chooses, which has no place for a mask."""
    if np.ma.is_masked(value):
        raise ArgumentValueError(name, expected, "a masked array", "fill it")
    try:
        return np.asarray(value)
    except (TypeError, ValueError):
        raise ArgumentValueError(name, expected, "a ragged sequence") from None


def array(name: str, value: object, shape: Sequence[int | str], *, finite: bool = True) -> Floats:
    """Return `value` as a C-contiguous float64 array of `shape`, where a letter stands for any length."""
    given = as_array(name, value, f"numbers of {_shape(shape)}")
    if given.dtype.kind not in "fiu" and given.size:
        got = f"dtype {given.dtype}" if given.ndim else short_repr(value)
        raise ArgumentTypeError(name, f"real numbers of {_shape(shape)}", got)
    if given.shape != shape and (
        given.ndim != len(shape)
        or any(isinstance(want, int) and want != got for want, got in zip(shape, given.shape, strict=True))
    ):
        raise ArgumentValueError(name, _shape(shape), given.shape, _shape_hint(name, given.shape, shape))
    with np.errstate(over="ignore"):  # wider floats may overflow
        result: Floats = in_order(given, np.float64)
    if finite and np.count_nonzero(np.isfinite(result)) < result.size:
        index = np.argwhere(~np.isfinite(result))[0]
        where = "".join(f"[{i}]" for i in index)
        raise ArgumentValueError(name, "finite numbers", f"{name}{where} = {result[tuple(index)]}")
    return result


def one_or_each(name: str, value: object, count: int | str) -> Floats:
    """Return `value`, a number or an array_like of shape (count,), as a C-contiguous float64 array of its shape."""
    return array(name, value, () if dimensions(value) == 0 else (count,))


def dimensions(value: object) -> int | None:
    """Return the number of dimensions of an array_like; None of a ragged sequence."""
    try:
        return np.ndim(value)  # type: ignore[arg-type]
    except ValueError:
        return None


def as_index(index: object, count: int, kind: str) -> Any:
    """Return what NumPy takes as an index of the first axis: a slice, integers or a mask; `kind` names the entries."""
    chosen: Any = index
    if isinstance(index, bool) or not isinstance(index, slice | int):
        expected = "a slice, an integer, or integers or a mask of shape (m,)"
        chosen = as_array("index", index, expected)
        if chosen.shape == (0,) and chosen.dtype.kind == "f":  # an empty list
            chosen = chosen.astype(np.intp)
        if chosen.ndim > 1 or chosen.dtype.kind not in ("biu" if chosen.ndim else "iu"):
            got = f"{chosen.dtype} of shape {chosen.shape}" if chosen.ndim else short_repr(index)
            raise ArgumentTypeError("index", expected, got)
    if isinstance(chosen, int) or (isinstance(chosen, np.ndarray) and not chosen.ndim):
        if not -count <= chosen < count:
            raise IndexError(f"index: expected one of {count} {kind}, got {short_repr(int(chosen))}")
        return [int(chosen)]
    if not isinstance(chosen, slice) and chosen.dtype == np.bool_ and chosen.shape != (count,):
        raise IndexError(
            f"index: expected a mask of shape ({count},), one entry for each of the {kind}, got {chosen.shape}"
        )
    return chosen


def vector(name: str, value: object) -> tuple[float, float, float]:
    """Return `value`, an array_like of shape (3,), as floats."""
    plain = _native.plain_vector(value)
    if plain is None:
        x, y, z = array(name, value, (3,)).tolist()
        return x, y, z
    return plain


def matrix(name: str, value: object) -> list[list[float]]:
    """Return `value`, an array_like of shape (3, 3), as rows of floats."""
    plain = _native.plain_matrix(value)
    if plain is None:
        rows: list[list[float]] = array(name, value, (3, 3)).tolist()
        return rows
    return plain


def freeze(values: npt.ArrayLike) -> Floats:
    """Return a read-only copy of `values`."""
    copy = np.array(values, order="C")
    copy.setflags(write=False)
    return copy


def in_order(values: npt.NDArray[Any], dtype: type[np.generic]) -> npt.NDArray[Any]:
    """Return `values` C-contiguous and aligned, as the core reads them; a copy only if necessary."""
    result = np.asarray(values, dtype, order="C")
    return result if result.flags.aligned else result.copy()


def nonzero_vectors(name: str, vectors: Floats) -> Floats:
    """Return `vectors`, of shape (3,) or (n, 3), after checking that none is zero."""
    zero = ~vectors.any(axis=-1)
    if zero.any():
        where = f"[{int(np.argmax(zero))}]" if vectors.ndim == 2 else ""
        raise ArgumentValueError(name, "non-zero vectors", f"{name}{where} = (0, 0, 0)")
    return vectors


def positive(name: str, values: Sequence[float]) -> Sequence[float]:
    """Return `values` after checking that each is > 0."""
    if min(values) <= 0:
        i = next(i for i, value in enumerate(values) if value <= 0)
        raise ArgumentValueError(name, "numbers > 0", f"{name}[{i}] = {values[i]}")
    return values


def rays(origins: npt.ArrayLike, directions: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return origins and directions as (n, 3) arrays; the native core checks their values."""
    if _native.are_plain_points(origins, directions):
        return origins, directions  # type: ignore[return-value]
    return (
        array("origins", origins, ("n", 3), finite=False),
        array("directions", directions, ("n", 3), finite=False),
    )


def t_range(t_min: object, t_max: object) -> tuple[float, float]:
    """Return a range of ray parameters, 0 <= t_min <= t_max."""
    if type(t_min) is float and type(t_max) is float and 0.0 <= t_min <= t_max and t_min < math.inf:
        return t_min, t_max
    low = real("t_min", t_min, at_least=0.0)
    return low, real("t_max", t_max, at_least=low, infinite=True)


RIGID = 1e-6
"""Largest |RRᵀ - I| of a rotation R in a pose: the accuracy of float32 files."""

NEARLY_RIGID = 1e-3
"""Largest |RRᵀ - I| for which the error names the repair: a rotation that was rounded, or multiplied up many times."""


def pose(name: str, value: Transform) -> Floats:
    """Return a (4, 4) float64 matrix from a `scipy.spatial.transform.RigidTransform` or a 4×4 rigid matrix.

    Rigid means that the rotation part is orthonormal to within `RIGID`, and not a reflection. The matrix is a copy.
    """
    if _native.is_plain_pose(value, RIGID):
        return np.array(value, order="C")
    matrix = affine(name, value)
    _check_rigid(matrix[None], lambda _: name)
    return matrix.copy()


def optional_pose(name: str, value: Transform | None) -> Floats:
    """Return a pose as `pose` does; None is the identity."""
    return np.eye(4) if value is None else pose(name, value)


def poses(name: str, value: Transform) -> Floats:
    """Return (N, 4, 4) float64 matrices from a `RigidTransform` of N poses or an array_like of rigid matrices."""
    if hasattr(value, "as_matrix"):
        value = value.as_matrix()
    matrices = array(name, value, ("N", 4, 4))
    wrong = (matrices[:, 3] != _LAST).any(axis=1)
    if wrong.any():
        i = int(np.argmax(wrong))
        affine(f"{name}[{i}]", matrices[i])
    _check_rigid(matrices, lambda i: f"{name}[{i}]")
    return matrices


def _check_rigid(matrices: Floats, name: Callable[[int], str]) -> None:
    """Raise an error that names the first of some (N, 4, 4) matrices that is not rigid."""
    wrong = _native.first_not_rigid(matrices.reshape(-1, 16), RIGID)
    if wrong is not None:
        i, error, determinant = wrong
        kind, hint = f"one {error:.3g} away from it", ""
        if error <= RIGID:
            kind = "a reflection"
        elif error <= NEARLY_RIGID and determinant > 0:
            hint = "orthonormalise it: Rotation.from_matrix(T[:3, :3]).as_matrix() of scipy.spatial.transform"
        got = f"{kind}, determinant {determinant:.6g}"
        raise ArgumentValueError(name(i), "a rigid transform (orthonormal rotation)", got, hint)


def affine(name: str, value: Transform) -> Floats:
    """Return a (4, 4) float64 matrix with a last row of (0, 0, 0, 1); the core decides whether it can be inverted."""
    if hasattr(value, "as_matrix"):
        if not hasattr(type(value), "rotation"):  # of the value, SciPy would compute it, slowly
            kind = type(value).__name__
            raise ArgumentTypeError(name, "a RigidTransform or an array of shape (4, 4)", f"a {kind}")
        value = value.as_matrix()
    matrix = array(name, value, (4, 4))
    last = matrix[3].tolist()
    if last != _LAST:
        hint = "transposed?" if matrix[:, 3].tolist() == _LAST else ""
        raise ArgumentValueError(name, "a last row of (0, 0, 0, 1)", tuple(last), hint)
    return matrix


def placement(transform: Transform) -> _native.Affine:
    """Return the argument `transform` of a shape or object in the core's type."""
    return _native.Affine.plain(transform) or _native.Affine(affine("transform", transform).tolist())


_LAST = [0.0, 0.0, 0.0, 1.0]


def _shape(wanted: Sequence[int | str]) -> str:
    return f"shape ({', '.join(map(str, wanted))}{',' if len(wanted) == 1 else ''})"


def _shape_hint(name: str, given: tuple[int, ...], wanted: Sequence[int | str]) -> str:
    """Return a hint at the likely mistake behind an array of the wrong shape."""
    if list(wanted) == [4, 4]:
        return {
            (3,): f"a position is the last column, {name}[:3, 3]",
            (3, 3): f"a rotation is {name}[:3, :3]",
            (3, 4): "its last row is (0, 0, 0, 1)",
        }.get(given, "")
    if len(wanted) == 2 and isinstance(wanted[0], str) and wanted[1] == 3:
        if given == (3,):
            return "of one, [[x, y, z]]"
        if len(given) == 2 and given[0] == 3:
            return "transposed?"
        if name == "directions" and given[1:] == (2,):
            return "of azimuth a and elevation e: [cos e · cos a, cos e · sin a, sin e]"
    return ""


def named_labels(name: str, value: Mapping[int, str] | None) -> dict[int, str]:
    """Return a checked copy of a mapping from labels to names."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ArgumentTypeError(name, "a mapping from labels to their names", short_repr(value))
    for label, text in value.items():
        integer(f"{name}, its keys", label, at_least=0, at_most=UINT32)
        if not isinstance(text, str):
            raise ArgumentTypeError(f"{name}[{label}]", "a string", short_repr(text))
    return {int(label): text for label, text in value.items()}


def _between(low: str | None, high: str | None) -> str:
    """Return the bounds of an expected number as text, such as " from 0 to 1", or "" without bounds."""
    if low and high:
        return f" from {low} to {high}"
    return f" >= {low}" if low else f" <= {high}" if high else ""


def short_repr(value: object) -> str:
    """Return the text of a value in errors: abbreviated if long, and at most 200 characters."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of shape {value.shape}"
    if isinstance(value, int) and value.bit_length() > 256:  # Python refuses to print thousands of digits
        return f"an integer of {value.bit_length():,} bits"
    return short(reprlib.repr(value).replace("\n", " "))


def short(text: object) -> str:
    """Return the part of a text that errors show: at most 200 characters."""
    whole = str(text)
    return whole if len(whole) <= 200 else f"{whole[:199]}…"
