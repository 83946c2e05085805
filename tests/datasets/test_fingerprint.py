"""What functions are made of: other hashes whenever they may do something else, and the same in another process."""

from __future__ import annotations

import dataclasses
import enum
import functools
import logging
import sys
import textwrap
import threading
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hard.children import output

import lidarsim as ls
from lidarsim.datasets.fingerprint import fingerprint

PROGRAM = """
import dataclasses, datetime, enum, functools, logging, re
from pathlib import Path
import numpy as np
import lidarsim as ls
import beside

RADIUS = 1.0
NAMES = {"car": 1, "bus": 2}
WORDS = {"a", "b", "c", ("d", 1), frozenset({"e", "f"})}
PATTERN, LOG = re.compile("a+"), logging.getLogger("x")
MESH = ls.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
TABLE = np.arange(5.0)

class Colour(enum.Enum):
    RED = 1
    def shade(self): return RADIUS * self.value

@dataclasses.dataclass
class Town:
    houses: int = 3
    trees: list = dataclasses.field(default_factory=lambda: [1, 2])
    @property
    def area(self): return self.houses * 2.0
    @staticmethod
    def width(): return 4.0
    def make(self, rng, sequence): return helper(self.area), self.width()

@functools.lru_cache
def helper(x): return x + RADIUS

def decorated(function):
    @functools.wraps(function)
    def wrapper(*args): return function(*args)
    return wrapper

def scenes(rng, sequence, count=3, *, scale=2.0):
    names = [name for name in NAMES if name in {"car", "bus"}], beside.size(), beside.WIDE, beside.inner.depth()
    return helper(count), scale, names, MESH, TABLE, PATTERN, LOG, WORDS, Colour.RED.shade()

def closing(radius):
    def made(rng, sequence): return radius, Town(), (lambda: RADIUS)()
    return made

FUNCTIONS = {
    "function": scenes, "closure": closing(datetime.date(2020, 1, 2)), "method": Town().make,
    "partial": functools.partial(scenes, count=Town(5)), "decorated": decorated(scenes), "cached": helper,
    "instance": functools.partial(Town.make, Town(4)), "lambda": lambda rng, sequence: (RADIUS, NAMES),
    "of a set": closing({"x", "y", "z", Path("p")}), "of a generator": closing(np.random.default_rng(5)),
}
"""
BESIDE = """
import sys, types
WIDE = 5.0
LONG = 6.0
def size(): return 7.0
inner = types.ModuleType("beside.inner")
inner.beside = sys.modules["beside"]
exec("def depth(): return 9.0", vars(inner))
"""

CHANGES = {  # and the functions that may do something else then
    ("RADIUS = 1.0", "RADIUS = 1.5"): {
        "function", "closure", "method", "partial", "decorated", "cached", "instance", "lambda", "of a set",
        "of a generator",
    },
    ('"bus": 2', '"bus": 3'): {"function", "partial", "decorated", "lambda"},
    ('{"a", "b"', '{"a", "B"'): {"function", "partial", "decorated"},
    ('compile("a+")', 'compile("a*")'): {"function", "partial", "decorated"},
    ("[0, 1, 0]], [[0", "[0, 2, 0]], [[0"): {"function", "partial", "decorated"},
    ("arange(5.0)", "arange(5.0, dtype=np.float32)"): {"function", "partial", "decorated"},
    ("self.value", "-self.value"): {"function", "partial", "decorated"},
    ("RED = 1", "RED = 2"): {"function", "partial", "decorated"},
    ("houses: int = 3", "houses: int = 4"): {
        "closure", "method", "instance", "partial", "of a set", "of a generator"
    },
    ("[1, 2])", "[1, 3])"): {"closure", "method", "instance", "partial", "of a set", "of a generator"},
    ("houses * 2.0", "houses * 3.0"): {"closure", "method", "instance", "partial", "of a set", "of a generator"},
    ("return 4.0", "return 5.0"): {"closure", "method", "instance", "partial", "of a set", "of a generator"},
    ("return x + RADIUS", "return x - RADIUS"): {
        "function", "closure", "method", "partial", "decorated", "cached", "instance", "of a set", "of a generator"
    },
    ("count=3", "count=4"): {"function", "partial", "decorated"},
    ("scale=2.0", "scale=3.0"): {"function", "partial", "decorated"},
    ('in {"car", "bus"}', 'in {"car"}'): {"function", "partial", "decorated"},
    ("return function(*args)", "return function(*args, *())"): {"decorated"},
    ("date(2020, 1, 2)", "date(2020, 1, 3)"): {"closure"},
    ("Town(5)", "Town(6)"): {"partial"},
    ("Town(4)", "Town(5)"): {"instance"},
    ("default_rng(5)", "default_rng(6)"): {"of a generator"},
    ('Path("p")', 'Path("q")'): {"of a set"},
    ("return radius, Town(), (lambda: RADIUS)()", "return Town(), radius, (lambda: RADIUS)()"): {
        "closure", "of a set", "of a generator"
    },
    ("import dataclasses", "# Of the same code on another line.\n\nimport dataclasses"): set(),
}  # fmt: skip
BESIDE_CHANGES = {
    ("WIDE = 5.0", "WIDE = 6.0"): True,
    ("return 7.0", "return 8.0"): True,
    ("return 9.0", "return 8.0"): True,
    ("LONG = 6.0", "LONG = 7.0"): False,
}


def run(program: str, beside: str = BESIDE, name: str = "program") -> dict[str, dict[str, str]]:
    """The hashes of the functions of a program."""
    modules = {"beside": types.ModuleType("beside"), name: types.ModuleType(name)}
    with pytest.MonkeyPatch.context() as patch:
        for key, module in modules.items():
            patch.setitem(sys.modules, key, module)
            code = compile(beside if key == "beside" else program, key, "exec", dont_inherit=True)
            exec(code, vars(module))  # noqa: S102
        return {key: fingerprint(function) for key, function in vars(modules[name])["FUNCTIONS"].items()}


@pytest.fixture(scope="module")
def whole() -> dict[str, dict[str, str]]:
    return run(PROGRAM)


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change[1][:30])
def test_a_change_is_seen_in_all_that_it_reaches(change: tuple[str, str], whole: dict[str, dict[str, str]]) -> None:
    assert change[0] in PROGRAM
    changed = run(PROGRAM.replace(change[0], change[1], 1))
    assert {name for name in whole if changed[name] != whole[name]} == CHANGES[change]


@pytest.mark.parametrize("change", BESIDE_CHANGES)
def test_a_change_in_a_module_beside_it_is_seen_if_it_is_read(
    change: tuple[str, str], whole: dict[str, dict[str, str]]
) -> None:
    changed = run(PROGRAM, BESIDE.replace(*change))
    assert (changed["function"] != whole["function"]) == BESIDE_CHANGES[change]
    assert changed["lambda"] == whole["lambda"]


def test_the_same_in_processes_that_hash_otherwise(whole: dict[str, dict[str, str]]) -> None:
    code = """
    import sys, types
    sys.modules["beside"] = beside = types.ModuleType("beside")
    exec(BESIDE, vars(beside))
    exec(PROGRAM)
    from lidarsim.datasets.fingerprint import fingerprint
    print({name: fingerprint(function) for name, function in FUNCTIONS.items()})
    """
    setup = f"\nPROGRAM = {PROGRAM!r}\nBESIDE = {BESIDE!r}\n"
    found = {output(code, setup=setup, environment={"PYTHONHASHSEED": seed}) for seed in ("1", "2")}
    assert found == {str(whole)}


def test_calls_leave_the_hashes_of_a_function() -> None:
    def scenes(rng: object, sequence: int) -> float:  # noqa: ARG001
        return sum(k * 0.5 for k in range(sequence))

    before = fingerprint(scenes)
    for _ in range(10_000):  # by then Python has specialised its bytecode
        scenes(None, 3)
    assert fingerprint(scenes) == before


def test_each_value_has_a_name() -> None:
    radius, town = 1.0, {"a": 1}

    def scenes(rng: object, sequence: int, count: int = 3, *, scale: float = 2.0) -> object:
        return rng, sequence, count, scale, radius, town, np.pi, ls.Scene

    parts = {name.partition(": ")[2] for name in fingerprint(scenes)}
    assert parts == {"", "default of count", "default of scale", "radius", "town", "np", "ls"}
    assert len(fingerprint(scenes)) == 7


def test_numbers_that_are_equal_but_differ() -> None:
    values: list[Any] = [
        0.0,
        -0.0,
        0,
        False,
        0j,
        "0",
        b"0",
        np.float64(0),
        np.float32(0),
        np.zeros(1),
        np.zeros(()),
        None,
    ]
    values += [
        float("nan"),
        [0],
        (0,),
        {0},
        frozenset({0}),
        {0: 0},
        "",
        b"",
        (),
        [],
        {},
        2**9000,
        range(0),
        ...,
        slice(0),
    ]
    hashes = [fingerprint(functools.partial(max, value))["max: arguments of its partial"] for value in values]
    assert len(set(hashes)) == len(values)


def test_values_that_hold_themselves() -> None:
    first: list[Any] = [1]
    first.append(first)
    second: list[Any] = [1, [1]]
    second[1].append(second)
    third: list[Any] = [2]
    third.append(third)
    hashes = [fingerprint(functools.partial(max, value)) for value in (first, second, third)]
    assert hashes[0] != hashes[2]
    assert hashes[0] == fingerprint(functools.partial(max, first))

    def scenes(rng: object, sequence: int) -> object:
        return scenes if sequence else rng

    assert fingerprint(scenes) == fingerprint(scenes)


def test_a_value_in_many_places_is_hashed_once() -> None:
    value: list[Any] = []
    for _ in range(200):
        value = [value, value]
    assert fingerprint(functools.partial(max, value))


class Bad:
    def __reduce__(self) -> tuple[Any, ...]:
        raise ZeroDivisionError("no\npickle")


LOCK, ANY, STREAM = threading.Lock(), Bad(), sys.__stderr__


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda rng, sequence: LOCK, "LOCK, a lock: cannot pickle '_thread.lock' object"),  # noqa: ARG005
        (lambda rng, sequence: ANY, "ANY, a Bad: no"),  # noqa: ARG005
        (lambda rng, sequence: STREAM, "STREAM, a TextIOWrapper: "),  # noqa: ARG005
        (functools.partial(max, (k for k in range(3))), "max: arguments of its partial, a tuple: cannot pickle"),
    ],
    ids=["lock", "class", "file", "generator"],
)  # fmt: skip
def test_what_cannot_be_hashed_is_named(function: Callable[..., Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(TypeError) as caught:
        ls.generate(function, tmp_path / "out")
    assert str(caught.value).startswith("recipe: expected a function that is made of values that can be pickled, got ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@dataclasses.dataclass
class Maker:
    radius: float

    def __call__(self, rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Lidar, None]:
        scene = ls.Scene()
        scene.add(ls.Sphere((5, 0, 0), self.radius), label=1)
        return scene, ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0)), None


def closure(radius: float) -> Callable[..., Any]:
    def make(rng: np.random.Generator, sequence: int) -> Any:
        return Maker(radius)(rng, sequence)

    return make


def keyword(rng: np.random.Generator, sequence: int, *, radius: float = 1.0) -> Any:
    return Maker(radius)(rng, sequence)


class Kind(enum.Enum):
    SMALL = 1.0
    LARGE = 2.0

    def make(self, rng: np.random.Generator, sequence: int) -> Any:
        return Maker(self.value)(rng, sequence)


@pytest.mark.parametrize(
    "made",
    [
        Maker,
        lambda radius: Maker(radius).__call__,
        closure,
        lambda radius: functools.partial(keyword, radius=radius),
        lambda radius: functools.lru_cache(closure(radius)),
        lambda radius: functools.wraps(keyword)(closure(radius)),
        lambda radius: Kind(radius).make,
    ],
    ids=["instance", "method", "closure", "partial", "cached", "wrapped", "enum"],
)
def test_a_data_set_is_resumed_by_the_same_function_only(made: Callable[[float], Any], tmp_path: Path) -> None:
    settings: dict[str, Any] = {"sequences": 4, "shard_frames": 1, "layout": "semantickitti", "pictures": 0}
    assert ls.generate(made(1.0), tmp_path, part=(0, 2), **settings).shards_left == 2
    with pytest.raises(ls.errors.LidarsimError, match="with the same sources"):
        ls.generate(made(2.0), tmp_path, **settings)
    assert ls.generate(made(1.0), tmp_path, **settings).frames == 2


def test_loggers_and_modules_are_known_by_name() -> None:
    log = logging.getLogger("lidarsim.test")

    def scenes(rng: object, sequence: int) -> object:
        return log, logging, textwrap, rng, sequence

    before = fingerprint(scenes)
    log.addHandler(handler := logging.NullHandler())
    assert fingerprint(scenes) == before
    log.removeHandler(handler)
