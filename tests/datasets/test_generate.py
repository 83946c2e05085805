"""Arguments of `generate`: numbers of NumPy are numbers, and what is wrong is named before anything is made."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hard.children import output
from scipy.spatial.transform import RigidTransform

import lidarsim as ls
from lidarsim.config.document import dump, parse, plain
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.datasets.recipe import load, noise_seed
from lidarsim.errors import ConfigError

SETTINGS: dict[str, Any] = {"layout": "semantickitti", "pictures": 0}


def scenes(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Lidar, None]:  # noqa: ARG001
    scene = ls.Scene(class_names={1: "ball", 2: "pole"})
    scene.add(ls.Sphere((5, 0, 0), 1.0), label=1)
    return scene, ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0)), None


@pytest.mark.parametrize("kind", ["document", "function"])
def test_numbers_of_numpy(kind: str, recipe: Path, tmp_path: Path) -> None:
    source: Any = recipe if kind == "document" else scenes
    numbers = {"sequences": 2, "frames": 3, "seed": 5, "shard_frames": 2, "part": (0, 1)}
    arrays = {
        "sequences": np.uint8(2), "frames": np.array(3), "seed": np.uint64(5), "shard_frames": np.int16(2),
        "part": [np.int64(0), np.int32(1)], "class_names": {np.int64(7): "seven"}, "pictures": np.int8(0),
    }  # fmt: skip
    ls.generate(source, tmp_path / "a", **SETTINGS, **numbers, class_names={7: "seven"})
    ls.generate(source, tmp_path / "b", **{**SETTINGS, **arrays})
    for name in ("recipe.yaml", "manifest.jsonl"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    written = plain(parse((tmp_path / "a" / "recipe.yaml").read_text(encoding="utf-8"), "r"))
    assert (written["sequences"], written["frames"], written["seed"], written["shard_frames"]) == (2, 3, 5, 2)
    assert written["class_names"]["7"] == "seven"


def words() -> Iterator[str]:
    yield "seed=1"


MISTAKES: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"deskew": "begin"}, ValueError, "deskew: expected True, False, 'start'"),
    ({"deskew": [1]}, TypeError, "deskew: expected True, False, 'start'"),
    ({"frame": "body"}, ValueError, "frame: expected 'sensor' or 'world', got 'body'"),
    ({"frame": "world", "layout": "kitti"}, ValueError, "frame: expected sensor "),
    ({"splits": {"train": 0.5}}, ValueError, r"expected shares that sum to 1, got 0\.5"),
    ({"splits": [1]}, TypeError, r"splits: expected a mapping from names to shares or lists of sequences, got \[1\]"),
    ({"part": (0,)}, ValueError, r"part: expected \(i, n\), part i of n, got \(0,\)"),
    ({"part": (0, 1, 2)}, ValueError, r"part: expected \(i, n\)"),
    ({"part": "01"}, TypeError, r"part: expected \(i, n\), part i of n, got '01'"),
    ({"part": 1}, TypeError, r"part: expected \(i, n\)"),
    ({"part": None}, TypeError, r"part: expected \(i, n\)"),
    ({"part": {0: 1, 1: 2}}, TypeError, r"part: expected \(i, n\)"),
    ({"part": (1, 1)}, ValueError, r"part\[0\]: expected an integer from 0 to 0, got 1"),
    ({"part": (-1, 2)}, ValueError, r"part\[0\]: expected an integer from 0 to 1, got -1"),
    ({"part": (0, 0)}, ValueError, r"part\[1\]: expected an integer >= 1, got 0"),
    ({"part": (0.0, 1)}, TypeError, r"part\[0\]: expected an integer"),
    ({"part": ("0", "1")}, TypeError, r"part\[1\]: expected an integer"),
    ({"seed": 5.0}, TypeError, r"seed: expected an integer from 0 to 18446744073709551615, got 5\.0"),
    ({"seed": True}, TypeError, "seed: expected an integer"),
    ({"seed": "5"}, TypeError, "seed: expected an integer"),
    ({"seed": -1}, ValueError, "seed: expected an integer"),
    ({"seed": 2**64}, ValueError, "seed: expected an integer"),
    ({"seed": 10**400}, ValueError, "seed: expected an integer .*, got an integer of 1,329 bits"),
    ({"seed": np.array([5, 6])}, TypeError, r"seed: expected an integer .*, got an array of shape \(2,\)"),
    ({"sequences": 0}, ValueError, "sequences: expected an integer from 1 to 4294967296, got 0"),
    ({"sequences": 2**32 + 1}, ValueError, "sequences: expected an integer from 1 to 4294967296"),
    ({"frames": np.nan}, TypeError, "frames: expected an integer from 1 to 4294967296, got nan"),
    ({"frames": 2.0}, TypeError, "frames: expected an integer"),
    ({"shard_frames": 0}, ValueError, "shard_frames: expected an integer"),
    ({"sequences": 10**7, "shard_frames": 1}, ValueError, "shard_frames.*: expected at most 1,000,000 shards, got "),
    ({"pictures": -1}, ValueError, "pictures: expected an integer >= 0, got -1"),
    ({"pictures": None}, TypeError, "pictures: expected an integer"),
    *(({"layout": layout}, ValueError, "layout: expected one of") for layout in
      (5, b"shards", ["shards"], {}, {"type": []}, "tum", {"type": "shards", "colour": 1}, {5: 6})),
    ({"client": 5}, TypeError, r"client: expected a dask\.distributed\.Client, got 5"),
    ({"client": "tcp://127.0.0.1:8786"}, TypeError, r"client: expected a dask\.distributed\.Client"),
    *(({"class_names": names}, TypeError, message) for names, message in (
        ({"1": "ball"}, "class_names, its keys: expected an integer from 0 to 4294967295, got '1'"),
        ({1.5: "ball"}, "class_names, its keys: expected an integer"),
        ({True: "ball"}, "class_names, its keys: expected an integer"),
        ({None: "ball"}, "class_names, its keys: expected an integer"),
        ({1: 5}, r"class_names\[1\]: expected a string, got 5"),
        ({1: None}, r"class_names\[1\]: expected a string, got None"),
        ({1: b"ball"}, r"class_names\[1\]: expected a string"),
        ([1], "class_names: expected a mapping from labels to their names"),
        ("ball", "class_names: expected a mapping from labels to their names"),
    )),
    ({"class_names": {-1: "x"}}, ValueError, "class_names, its keys: expected an integer"),
    ({"class_names": {2**40: "x"}}, ValueError, "class_names, its keys: expected an integer"),
    ({"class_names": {1: "\ud800"}}, ValueError, r"class_names\[1\]: expected text, got half a character"),
    *(({"overrides": given}, TypeError, "overrides: expected a sequence of strings, got ") for given in
      ("seed=1", b"seed=1", 5, None, [5], ["seed=1", b"x"], words(), {"seed=1": 1}, {"seed=1"})),
]  # fmt: skip


@pytest.mark.parametrize("kind", ["document", "function"])
@pytest.mark.parametrize(("given", "error", "message"), MISTAKES, ids=lambda value: ascii(value)[:40])
def test_mistakes_are_named_before_anything_is_made(
    given: dict[str, Any], error: type[Exception], message: str, kind: str, recipe: Path, tmp_path: Path
) -> None:
    with pytest.raises(error, match=message) as caught:
        ls.generate(recipe if kind == "document" else scenes, tmp_path / "out", **{**SETTINGS, **given})
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert not (tmp_path / "out").exists()


class Class:
    def __init__(self, rng: object, sequence: int) -> None: ...


async def coroutine(rng: object, sequence: int) -> None: ...


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (None, "expected a path or a function, got None"),
        (b"recipe.yaml", "expected a path or a function, got b'recipe.yaml'"),
        (5, "expected a path or a function, got 5"),
        ([], r"expected a path or a function, got \[\]"),
        (Class, r"expected a path or a function, got the class .*Class"),
        (max, r"expected a path or a function, got the built-in function builtins\.max"),
        (coroutine, r"expected a path or a function, got the coroutine function .*coroutine"),
        (lambda: 0, r"expected a function of a generator and a number, got one of \(\)$"),
        (lambda rng, sequence, more: 0, r"expected a function of .*, got one of \(rng, sequence, more\)$"),  # noqa: ARG005
        (functools.partial(scenes, 1, 2), r"expected a function of a generator and a number, got one of \(\)"),
        (lambda rng, sequence: (yield), r"expected it to return \(scene, rig, trajectory\), got generator"),  # noqa: ARG005
        (np.vectorize(scenes), "expected it to return a Scene and a Lidar or a Rig first, got ndarray, ndarray"),
    ],
)  # fmt: skip
def test_what_is_no_recipe(recipe: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=rf"^recipe: {message}"):
        ls.generate(recipe, tmp_path / "out", **SETTINGS)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["gone.yaml", "", "a\0b", "a\ud800"], ids=ascii)
def test_paths_of_no_file(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot read the file: ") as caught:
        ls.generate(str(tmp_path / name), tmp_path / "out", **SETTINGS)
    assert str(caught.value).isprintable()


@functools.wraps(scenes)
def call_scenes(*arguments: Any) -> Any:
    return scenes(*arguments)


@pytest.mark.parametrize(
    "made",
    [
        functools.partial(scenes),
        functools.lru_cache(scenes),
        call_scenes,
        lambda rng, sequence: (*scenes(rng, sequence)[:2], np.eye(4)),
        lambda *arguments, **more: (*scenes(*arguments, **more)[:2], None),
        staticmethod(scenes).__func__,
    ],
    ids=["partial", "cached", "wrapped", "lambda", "any arguments", "static"],
)
def test_functions_of_all_kinds(made: Callable[..., Any], tmp_path: Path) -> None:
    assert ls.generate(made, tmp_path, **SETTINGS).points == 1
    head = json.loads((tmp_path / "manifest.jsonl").read_text().splitlines()[0])
    assert head["sources"]
    assert ls.generate(made, tmp_path, **SETTINGS).frames == 0


def drives(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Rig, ls.Trajectory]:  # noqa: ARG001
    scene = ls.Scene()
    scene.add(ls.Box((40, 40, 40)), label=1)
    rig = ls.Rig({"top": (ls.Lidar.preset("velodyne-vlp16"), None)})
    return scene, rig, ls.Trajectory.from_twist(np.eye(4), linear=(10.0, 0, 0), angular=(0, 0, 1.0))


def test_a_function_deskews(tmp_path: Path) -> None:
    scene, rig, pose = drives(np.random.default_rng(), 0)
    scan = next(rig.frames(scene, pose, count=1, seed=noise_seed(0, 0)))["top"]
    for deskew in (False, "end", 0.03):
        folder = tmp_path / f"{deskew}"
        ls.generate(drives, folder, layout="semantickitti", pictures=0, deskew=deskew)
        (points,) = (np.fromfile(path, np.float32).reshape(-1, 4) for path in folder.rglob("*.bin"))
        expected = scan.point_cloud(deskew=deskew).xyz
        assert len(points) > 20_000
        assert np.array_equal(points[:, :3], expected.astype(np.float32))
    with pytest.raises(ls.errors.LidarsimError, match=r"got another recipe\.yaml"):
        ls.generate(drives, tmp_path / "end", layout="semantickitti", pictures=0)
    for given, layout, message in [
        (1e30, "shards", r"deskew: expected a time from -1e\+09 to 1e\+09 s, got 1e\+30"),
        (
            "middle",
            "bags",
            "deskew: expected False in bags, which has the messages of the sensors' drivers, got 'middle'",
        ),
    ]:
        with pytest.raises(ValueError, match=f"^{message}$"):
            ls.generate(drives, tmp_path / "no", layout=layout, pictures=0, deskew=given)  # type: ignore[arg-type]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_function_may_return_a_rigid_transform(layout: str, tmp_path: Path) -> None:
    stands = RigidTransform.from_translation([0.0, 0.0, 1.5])

    def standing(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Rig, RigidTransform]:
        scene, rig, _ = drives(rng, sequence)
        return scene, rig, stands

    def the_same(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Rig, np.ndarray]:
        scene, rig, _ = drives(rng, sequence)
        return scene, rig, stands.as_matrix()

    done = [
        ls.generate(made, tmp_path / made.__name__, layout=layout, pictures=0, frames=2)
        for made in (standing, the_same)
    ]
    assert done[0].points == done[1].points > 20_000


def test_class_names_are_put_over_those_of_the_scene(recipe: Path, tmp_path: Path) -> None:
    ls.generate(scenes, tmp_path / "a", **SETTINGS, class_names={1: "🚗 1e3", 9: "yes"})
    ls.generate(recipe, tmp_path / "b", **SETTINGS, class_names={40: "🛣", 9: "null"})
    names = [
        plain(parse((tmp_path / name / "recipe.yaml").read_text(encoding="utf-8"), "r"))["class_names"] for name in "ab"
    ]
    assert names == [{"1": "🚗 1e3", "2": "pole", "9": "yes"}, {"9": "null", "40": "🛣"}]


TEXTS = [
    "1e3", "yes", "null", "0x10", "2026-11-25", "~", "=", "010", "", " x ", "a\nb\u2028\x85c", "\x1b[31m", "🚗", "'\"",
    "- a: b #c", "12:30:45", "1_000",
]  # fmt: skip
NAMES = {str(label): name for label, name in enumerate(TEXTS, start=1)}


def test_the_recipe_that_is_written_makes_the_same_data_set(tmp_path: Path) -> None:
    recipe = {
        "layout": {"type": "shards", "fields": ["label"]},
        "class_names": NAMES,
        "frames": 2,
        "vary": {"scene.0.name": {"choice": TEXTS}, "scene.0.radius_m": {"uniform": [1, 1e0]}},
        "scatter": {
            name: {
                "objects": [{"shape": "box", "size_m": [1e-3, 1, 1], "name": name}], "on": ["1e3"], "count": 1,
                "area_m": [[-9, 5], [9, 9.0]],
            }
            for name in ("1e3", "yes", "~")
        },
        "run": {
            "scene": [
                {"shape": "sphere", "center_m": [5, 0, 1e-3], "radius_m": 1, "name": "2e4", "label": 2},
                {"shape": "plane", "normal": [0, 0, 1], "name": "1e3", "label": 1},
            ],
            "sensor": {
                "pattern": {"type": "grid", "azimuths_deg": [0, 60, 90], "elevations_deg": [-5], "rate_hz": 10},
                "model": "0x10",
                "sources": {"on": "http://example.org", "2026": "~"},
            },
            "pose": {"position_m": [0, 0, 1]},
        },
    }  # fmt: skip
    (tmp_path / "recipe.yaml").write_text(dump(recipe), encoding="utf-8")
    ls.generate(tmp_path / "recipe.yaml", tmp_path / "a", pictures=0)
    ls.generate(tmp_path / "a" / "recipe.yaml", tmp_path / "b", pictures=0)
    files = {path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file()}
    assert len(files) >= 4
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    assert load(tmp_path / "b" / "recipe.yaml").class_names == {int(label): name for label, name in NAMES.items()}


def test_no_part_needs_docstrings_or_asserts(recipe: Path, tmp_path: Path, slow: bool) -> None:
    """Under ``python -OO``, which compiles each package anew; `test_cli` shows the help so each time."""
    if not slow:
        pytest.skip("thorough tests alone")
    configs = Path(__file__).parents[2] / "configs"
    code = """
    assert False
    folder, recipe, out = sys.argv[1:]
    from pathlib import Path
    from lidarsim.cli import main
    for path in sorted(Path(folder).glob("*.yaml")):
        ls.config.load(path)
    for layout in ("semantickitti", "nuscenes", "shards", "bags"):
        print(ls.generate(recipe, f"{out}/{layout}", layout=layout, pictures=0).frames)
    try:
        main(["check", f"{folder}/demo.yaml"])
    except SystemExit as end:
        print("ended with", end.code)
    """
    names = str(configs), str(recipe), str(tmp_path / "out")
    printed = output(code, *names, environment={"PYTHONOPTIMIZE": "2"}, timeout=120.0).splitlines()
    assert printed[:4] == ["12"] * 4
    assert printed[-1] in {"ended with 0", "ended with None"} or len(printed) > 5
