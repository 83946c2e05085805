"""Fingerprints of functions: hashes that differ if the function may behave differently.

A value is hashed by the contents of its pickle, a function by its bytecode and the values that it takes from outside:
defaults, variables of enclosing functions, and globals that it reads. Functions and classes of installed packages are
identified by their names.
"""

from __future__ import annotations

import copyreg
import dis
import enum
import functools
import hashlib
import inspect
import itertools
import sys
import types
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base import validation
from lidarsim._base.files import format_error
from lidarsim._base.validation import short_repr
from lidarsim.errors import ArgumentTypeError

_LRU = type(functools.lru_cache(lambda: None))
_GLOBAL = {"LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"}


def check_function(argument: str, function: object, takes: str, expected: str = "a function") -> Callable[..., Any]:
    """Return a function of two arguments, which `takes` names, after checking that it is one.

    Raises
    ------
    TypeError
        If it is not.
    """
    kinds: dict[str, Callable[[object], bool]] = {
        "class": inspect.isclass,
        "built-in function": inspect.isbuiltin,
        "coroutine function": inspect.iscoroutinefunction,
    }
    if not callable(function):
        raise ArgumentTypeError(argument, expected, short_repr(function))
    for kind, holds in kinds.items():
        if holds(function):
            raise ArgumentTypeError(argument, expected, f"the {kind} {name_of(function)}")
    validation.function(argument, function, takes, 2)
    return function


def name_of(function: Callable[..., Any], separator: str = ".") -> str:
    """Return the full name of a function or method, of the function in a partial, or of an object's class."""
    named = _name_bearer(function)
    return f"{named.__module__}{separator}{named.__qualname__}"


def _name_bearer(function: Any) -> Any:
    while isinstance(function, functools.partial):
        function = function.func
    return function if hasattr(function, "__qualname__") else type(function)


def fingerprint(function: Callable[..., Any], argument: str = "recipe") -> dict[str, str]:
    """Return the hashes of a function's code and of each value that it takes from outside, by name.

    `argument` is what error messages call the function.

    Raises
    ------
    TypeError
        If a value cannot be hashed, such as a lock, an open file or a generator; the message names it.
    """
    hashes: dict[str, str] = {}
    for name, value in _parts(function):
        try:
            hashes[name] = _Hasher().digest(value).hex()
        except Exception as error:  # a class may raise anything when it is pickled
            raise ArgumentTypeError(
                argument,
                "a function that is made of values that can be pickled",
                f"{name}, a {type(value).__name__}: {format_error(error)}",
            ) from error
    return hashes


def _parts(function: Any) -> Iterator[tuple[str, object]]:
    """Yield the parts of a function, by name."""
    name = _name_bearer(function).__qualname__
    if isinstance(function, functools.partial):
        yield from _parts(function.func)
        yield f"{name}: arguments of its partial", (function.args, function.keywords)
    elif isinstance(function, types.MethodType):
        yield from _parts(function.__func__)
        yield f"{name}: self", function.__self__
    elif isinstance(function, _LRU):
        yield from _parts(function.__wrapped__)
    elif isinstance(function, types.FunctionType) and not _is_installed(function.__globals__.get("__name__")):
        yield name, function.__code__
        yield from ((f"{name}: {variable}", value) for variable, value in _outer_values(function))
    else:
        yield name, function


def _outer_values(function: types.FunctionType) -> Iterator[tuple[str, object]]:
    """Yield the values that a function takes from outside its code, by name."""
    yield from ((f"default of {name}", value) for name, value in _defaults(function))
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:  # it has no value yet
            yield name, ()
    if vars(function):
        yield "attributes", {key: value for key, value in vars(function).items() if key != "__wrapped__"}
    attributes, names = set[str](), set[str]()
    for code in _codes(function.__code__):
        attributes.update(code.co_names)
        names.update(step.argval for step in dis.get_instructions(code) if step.opname in _GLOBAL)
    entered = set[types.ModuleType]()
    for name in sorted(names & function.__globals__.keys()):
        yield from _read_values(name, function.__globals__[name], attributes, entered)


def _read_values(
    name: str, value: object, attributes: set[str], entered: set[types.ModuleType]
) -> Iterator[tuple[str, object]]:
    """Yield a value or, of a module, the values of these attributes; modules may import each other."""
    if not isinstance(value, types.ModuleType) or _is_installed(value.__name__):
        yield name, value
    elif value not in entered:
        entered.add(value)
        for attribute in sorted(attributes & vars(value).keys()):
            yield from _read_values(f"{name}.{attribute}", getattr(value, attribute), attributes, entered)


def _defaults(function: types.FunctionType) -> Iterator[tuple[str, object]]:
    code, positional = function.__code__, function.__defaults__ or ()
    yield from zip(code.co_varnames[code.co_argcount - len(positional) : code.co_argcount], positional, strict=True)
    yield from sorted((function.__kwdefaults__ or {}).items())


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield a code object, and those of the functions nested in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _is_installed(module: object) -> bool:
    """Return whether a module belongs to Python, lidarsim or an installed package, so that its name suffices."""
    name = str(module)
    if name.partition(".")[0] in {*sys.stdlib_module_names, "lidarsim"} - {"__main__"}:
        return True
    file = getattr(sys.modules.get(name), "__file__", None)
    return file is not None and not {"site-packages", "dist-packages"}.isdisjoint(Path(file).parts)


class _Hasher:
    """Hashes of values; each object is visited once, and a reference cycle is hashed by its length."""

    def __init__(self) -> None:
        self.known: dict[int, tuple[object, bytes]] = {}  # keeps the object alive, so that its id is not reused
        self.open: dict[int, int] = {}

    def digest(self, value: object) -> bytes:
        """Return the hash of a value."""
        plain = _plain(value)
        if plain is not None:
            return _hash(type(value).__name__, plain)
        key = id(value)
        if key in self.known:
            return self.known[key][1]
        if key in self.open:
            return _hash("cycle", str(len(self.open) - self.open[key]))
        self.open[key] = len(self.open)
        result = _hash(type(value).__qualname__, *map(self.digest, _contents(value)))
        del self.open[key]
        self.known[key] = value, result
        return result


def _contents(value: Any) -> Iterable[object]:
    """Return contents that identify an object among others of its type."""
    kind = type(value)
    if kind in _CONTENTS:
        return _CONTENTS[kind](value)
    if isinstance(value, type):
        return _of_class(value)
    return [repr(value)] if kind.__module__ == "typing" else _of_object(value)


def _of_array(array: npt.NDArray[Any]) -> Iterator[object]:
    yield from (repr(array.dtype), array.shape)
    yield array.tolist() if array.dtype.hasobject else array.tobytes()


def _of_code(code: types.CodeType) -> Iterator[object]:
    # File, lines and positions do not affect behaviour.
    yield from (code.co_name, code.co_code, code.co_exceptiontable, code.co_consts, code.co_flags)
    yield from (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
    yield from (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)


def _of_function(function: types.FunctionType) -> Iterator[object]:
    yield function.__qualname__
    if _is_installed(module := function.__globals__.get("__name__")):
        yield module
        yield [cell.cell_contents for cell in function.__closure__ or ()]
    else:
        yield function.__code__
        yield from _outer_values(function)


def _of_builtin(function: types.BuiltinFunctionType) -> Iterator[object]:
    yield from (function.__module__, function.__qualname__)
    yield None if isinstance(function.__self__, types.ModuleType) else function.__self__


def _of_class(value: Any) -> Iterator[object]:
    yield from (value.__module__ if _is_installed(value.__module__) else None, value.__qualname__)
    if _is_installed(value.__module__):
        return
    yield value.__bases__
    members: dict[str, Any] = dict(vars(value))
    if isinstance(value, enum.EnumMeta):
        yield [(name, member.value) for name, member in dict[str, Any](value.__members__).items()]
        members = {name: item for name, item in members.items() if isinstance(item, _METHODS)}
    members.pop("__annotate_func__", None)  # it makes `__annotations__` from Python 3.14 on
    for name, item in sorted(members.items()):
        special = name.startswith("__") and name.endswith("__")
        if isinstance(item, _METHODS) or not (special or name == "_abc_impl" or isinstance(item, _NAMED)):
            yield from (name, item)


def _of_object(value: Any) -> Iterator[object]:
    """Yield the contents of an object's pickle."""
    reduce = copyreg.dispatch_table.get(type(value))
    reduced = reduce(value) if reduce else value.__reduce_ex__(4)
    yield type(value)
    if isinstance(reduced, str):  # the name in its module
        yield from (getattr(value, "__module__", None), reduced)
    else:  # constructor, arguments, state and items
        yield from (list(part) if isinstance(part, Iterator) else part for part in reduced)


def _of_set(values: Collection[Any]) -> Iterable[object]:
    return sorted(_Hasher().digest(value) for value in values)


_METHODS = types.FunctionType, property, staticmethod, classmethod, functools.cached_property
_NAMED = (
    types.WrapperDescriptorType,
    types.MethodDescriptorType,
    types.ClassMethodDescriptorType,
    types.GetSetDescriptorType,
    types.MemberDescriptorType,
)
_CONTENTS: dict[type, Callable[[Any], Iterable[object]]] = {
    tuple: iter,
    list: iter,
    dict: lambda value: itertools.chain.from_iterable(value.items()),
    set: _of_set,
    frozenset: _of_set,
    np.ndarray: _of_array,
    types.CodeType: _of_code,
    types.FunctionType: _of_function,
    types.BuiltinFunctionType: _of_builtin,
    types.MethodType: lambda value: (value.__func__, value.__self__),
    types.MethodWrapperType: lambda value: (value.__name__, value.__self__),
    types.ModuleType: lambda value: (value.__name__,),
    types.GenericAlias: lambda value: (repr(value),),
    types.UnionType: lambda value: (repr(value),),
    _LRU: lambda value: (value.__wrapped__,),
    property: lambda value: (value.fget, value.fset, value.fdel),
    staticmethod: lambda value: (value.__func__,),
    classmethod: lambda value: (value.__func__,),
    functools.cached_property: lambda value: (value.func,),
    **dict.fromkeys(_NAMED, lambda value: (value.__objclass__, value.__name__)),
}
"""Contents of values by type; for all other types, the contents of the pickle count."""


def _plain(value: Any) -> bytes | None:
    """Return bytes that identify a plain value among others of its type; None for other values."""
    kind = type(value)
    if value is None or value is Ellipsis or value is NotImplemented:
        return b""
    if kind is str:
        return bytes(value.encode("utf-8", "surrogatepass"))
    if kind in {bool, int}:
        return f"{value:x}".encode()  # Python limits the digits of decimal integers only
    if kind in {float, complex}:
        return f"{value.real.hex()} {value.imag.hex()}".encode()
    return bytes(value) if kind is bytes else None


def _hash(*pieces: str | bytes) -> bytes:
    """Return the SHA-256 of pieces, each with its length, so that different lists have different hashes."""
    hasher = hashlib.sha256()
    for piece in pieces:
        data = piece.encode("utf-8", "surrogatepass") if isinstance(piece, str) else piece
        hasher.update(len(data).to_bytes(8, "little"))
        hasher.update(data)
    return hasher.digest()
