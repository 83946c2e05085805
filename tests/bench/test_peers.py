from __future__ import annotations

import math
import os

import numpy as np
import pytest

from lidarsim import _native
from lidarsim.bench import exact, peers, scenes
from lidarsim.bench.peers import ABSENT, CASTERS, FAILING
from lidarsim.bench.scenes import Rays, World
from lidarsim.bench.speed import judge

INSTALLED, STATES = peers.find_installed()
DOUBLE = {"lidarsim", "MuJoCo", "MuJoCo-LiDAR, mj_multiRay", "textbook NumPy"}


@pytest.fixture(scope="module")
def worlds() -> list[tuple[World, Rays]]:
    rng = np.random.default_rng(0)
    return [
        (world, rays[rng.choice(len(rays), 200, replace=False)])
        for world in (scenes.scans(2000), scenes.analytic(60))
        for rays in (scenes.lidar(world, 128, 32, math.pi / 4), scenes.random_rays(world, 400))
    ]


def test_every_caster_has_a_state() -> None:
    assert list(STATES) == list(CASTERS)
    assert set(INSTALLED) == {name for name, state in STATES.items() if not state.startswith((ABSENT, FAILING))}
    assert {"lidarsim", "textbook NumPy"} <= set(INSTALLED)


@pytest.mark.parametrize("name", INSTALLED)
@pytest.mark.parametrize("threads", [1, 2])
def test_casters_find_what_is_there(name: str, threads: int, worlds: list[tuple[World, Rays]]) -> None:
    kind = CASTERS[name]
    cast = 0
    for world, rays in worlds:
        if not kind.serves(world) or not (rays.one_origin or kind.any_origin):
            continue
        caster = kind(world, threads)
        error = judge(exact.first_hits(world, rays), caster.convert(caster.cast(caster.prepare(rays), threads)))
        assert error.hits >= 50
        assert error.median_mm is not None
        assert error.max_ulp is not None
        if name == "lidarsim":
            assert (error.lost, error.invented, error.other) == (0, 0, 0)
            assert error.max_ulp <= 0.5
        else:
            assert error.lost + error.invented + (error.other or 0) <= 4
            # Half of the ranges are off by at most 32 roundings of a coordinate; all coordinates are below 64 m.
            rounding = np.finfo(np.float64 if name in DOUBLE else np.float32).eps / 2.0
            assert error.median_mm < 1e3 * 32.0 * 64.0 * rounding
        cast += 1
    assert cast >= 1


def test_casters_serve_only_what_they_can_hold(worlds: list[tuple[World, Rays]]) -> None:
    mesh, shapes = worlds[0][0], worlds[-1][0]
    serves = {name: (kind.serves(mesh), kind.serves(shapes)) for name, kind in CASTERS.items()}
    assert serves["lidarsim"] == (True, True)
    assert serves["Open3D"] == serves["embreex"] == (True, False)
    assert {serves[name] for name in CASTERS if name not in {"lidarsim", "Open3D", "embreex"}} == {(False, True)}


def test_missing_casters_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def load() -> None:
        raise ModuleNotFoundError("No module named 'embreex'", name="embreex")

    def fail_to_load() -> None:
        raise OSError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr(peers.Embreex, "load", load)
    monkeypatch.setattr(peers.Open3D, "load", fail_to_load)

    def fail_to_cast(*_: object) -> None:
        raise TypeError("mj_multiRay(): incompatible function arguments")

    monkeypatch.setattr(peers.MuJoCo, "load", lambda: None)
    monkeypatch.setattr(peers.MuJoCo, "__init__", lambda *_: None)
    monkeypatch.setattr(peers.MuJoCo, "prepare", lambda *_: None)
    monkeypatch.setattr(peers.MuJoCo, "cast", fail_to_cast)
    casters, states = peers.find_installed()
    assert states["MuJoCo"] == "fails here (TypeError: mj_multiRay(): incompatible function arguments)"
    assert states["embreex"] == "not installed (embreex)"
    assert states["Open3D"] == "not installed (open3d)"
    assert not {"embreex", "Open3D", "MuJoCo"} & set(casters)


def test_looking_for_casters_leaves_the_threads_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIDARSIM_THREADS", "5")
    peers.find_installed()
    assert (os.environ["LIDARSIM_THREADS"], _native.threads()) == ("5", 5)


def test_the_core_counts_its_bytes() -> None:
    small, large = (peers.Lidarsim(scenes.terrain(n), 1) for n in (1000, 4000))
    for caster in (small, large):
        caster.cast(caster.prepare(scenes.lidar(scenes.terrain(100), 1, 1, 0.0)), 1)
    assert 3 < large.bytes() / small.bytes() < 5
