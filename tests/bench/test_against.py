"""The comparison of builds tells which differ, and measures what it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim import _native
from lidarsim.bench import against, main

HERE = Path(ls.__file__).parents[1]

OTHER = """
import numpy as np
from types import SimpleNamespace as Hits

def shape(*arguments):
    return None

Plane = Box = TriangleMesh = shape

class Scene:
    def add(self, shape, transform=None):
        pass

    def cast(self, origins, directions):
        n = len(origins)
        return Hits(t=np.full(n, np.inf), object_id=np.full(n, -1), primitive_id=np.zeros(n), normal=np.zeros((n, 3)))
"""


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a build that misses everything."""
    folder = tmp_path_factory.mktemp("build")
    (folder / "lidarsim").mkdir()
    (folder / "lidarsim" / "__init__.py").write_text(OTHER, encoding="utf-8")
    (folder / "lidarsim" / "_native.py").touch()
    return folder


@pytest.fixture(scope="module")
def room() -> against.Cast:
    """Return the cheapest cast with hits."""
    these = against.casts(quick=True)
    return next(cast for cast in these if cast.name == "room of 12 triangles")


def test_each_build_is_measured_by_its_own_package(other: Path, room: against.Cast) -> None:
    level = _native.isa()
    (row,) = against.compare(HERE, HERE, [room], [level], 2)
    assert (row.name, row.level, row.same) == (room.name, level, True)
    assert min(row.before, row.now, row.ratio) > 0
    (row,) = against.compare(other, HERE, [room], [level], 2)
    assert not row.same


def test_the_fixed_costs_are_what_they_are_called() -> None:
    found = {}
    for cast in against.casts(quick=True):
        if len(found) == 4:
            break
        scene = ls.Scene()
        for spec in cast.shapes:
            scene.add(spec.build())
        found[cast.name] = scene.cast(cast.rays.origins, cast.rays.directions).hit.mean()
    assert list(found) == ["all miss", "room of 12 triangles", "plane", "box"]
    assert found["all miss"] == 0.0
    assert found["room of 12 triangles"] == found["box"] == 1.0
    assert 0.4 < found["plane"] < 0.6


def test_instances_share_a_mesh_and_overlap() -> None:
    (cast,) = (cast for cast in against.casts(quick=True) if "instances" in cast.name)
    assert len({id(spec.args[0]) for spec in cast.shapes}) == 1
    centers = np.array([spec.transform[:3, 3] for spec in cast.shapes if spec.transform is not None])
    distances = np.linalg.norm(centers[:, None] - centers, axis=-1)[np.triu_indices(len(centers), 1)]
    assert len(centers) == 50
    assert (distances < 2 * 1.2).sum() > 20


def test_what_is_no_build_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text.whl").write_text("no wheel", encoding="utf-8")
    for path, message in [
        (tmp_path / "text.whl", "expected a wheel or a folder"),
        (tmp_path, "expected a build of lidarsim with its native module"),
    ]:
        assert main(["--against", str(path)]) == 2
        assert message in capsys.readouterr().err
