"""In fog, rain and snow, presets see a few points in the air, and surfaces behind it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.config.loader import measured_presets

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "lidarsim" / "presets" / "README.md"
AIRBORNE = {"leica-als50", "riegl-vq780i", "riegl-vq880g"}
AIR = {
    "rain, 5 mm/h": (ls.Atmosphere.rain(5.0), (0.0, 0.01)),
    "rain, 25 mm/h": (ls.Atmosphere.rain(25.0), (0.0, 0.03)),
    "fog, 300 m": (ls.Atmosphere.fog(300.0), (0.0, 0.02)),
    "fog, 60 m": (ls.Atmosphere.fog(60.0), (0.02, 0.4)),
    "snow, 1 mm/h": (ls.Atmosphere.snow(1.0), (0.02, 0.15)),
}
"""Bounds of the share of points in the air."""
SKY = {"snow, 1 mm/h": (0.38, 0.48)}
OTHERS = {
    **dict.fromkeys(("faro-focus-s150", "leica-rtc360", "riegl-vz400"), SKY),
    "hokuyo-utm30lx": {"fog, 60 m": (0.35, 0.6)},
    "rplidar-a1": {"fog, 60 m": (0.75, 1.0), "snow, 1 mm/h": (0.6, 1.0)},
}
"""Other bounds, of those that look into the sky with half of their narrow beams, or have few surfaces within range."""
PULSES = 20_000
"""Most pulses fired per frame. If half of them return, a share of 0.2 has three standard deviations of 0.012."""


@dataclass(frozen=True)
class Thinned:
    """A random subset of the pulses of a pattern."""

    pattern: ls.patterns.Pattern

    @property
    def rate(self) -> float:
        return self.pattern.rate

    @property
    def shape(self) -> tuple[int, ...]:
        return self.pattern.shape

    def pulses(self, frame: int = 0) -> ls.patterns.Pulses:
        made = self.pattern.pulses(frame)
        chosen = np.sort(np.random.default_rng(1).permutation(len(made))[:PULSES])
        arrays = (getattr(made, name)[chosen] for name in ("directions", "origins", "time", "ring", "column"))
        return ls.patterns.Pulses(*arrays)


@pytest.fixture(scope="module")
def street() -> ls.Scene:
    return ls.config.load(ROOT / "configs" / "demo.yaml").scene


@pytest.mark.slow("the air has its share of the points of every preset")
@pytest.mark.parametrize("noise", ["datasheet", "measured"])
@pytest.mark.parametrize("name", sorted({*ls.Lidar.presets()} - AIRBORNE))
def test_the_air_has_its_share_of_points(name: str, noise: str, street: ls.Scene) -> None:
    try:
        lidar = ls.Lidar.preset(name, noise=noise)
    except ValueError:
        pytest.skip("no measured noise")
    lidar = replace(lidar, pattern=Thinned(lidar.pattern))
    pose = np.eye(4)
    pose[:3, 3] = (0.0, -1.8, 1.9)
    off = {}
    for kind, (atmosphere, bounds) in AIR.items():
        least, most = OTHERS.get(name, {}).get(kind, bounds)
        street.atmosphere = atmosphere
        scan = lidar.scan(street, pose, seed=1)
        point = ~np.isnan(scan.range)
        assert scan.source is not None
        share = (scan.source[point] == ls.Source.atmosphere).mean()
        if not least <= share <= most:
            off[kind] = float(share)
    assert off == {}


@pytest.mark.parametrize("name", ls.Lidar.presets())
def test_every_preset_measures_in_fog(name: str) -> None:
    """Also those whose least range lies beyond all patches of fog that are seen."""
    lidar = ls.Lidar.preset(name, noise="datasheet")
    thick, thin = (ls.Atmosphere.fog(visibility).patches_seen(lidar) for visibility in (60.0, 300.0))
    assert 0.0 <= thick < math.inf
    assert 0.0 <= thin < math.inf
    if lidar.min_range >= 100.0:
        assert thick == 0.0


GATE = ("sick-lms111", "leica-rtc360", "velodyne-vlp16", "velodyne-vlp32c", "velodyne-hdl32e")
"""Those that see a white wall up to the end of their range gate."""


def farthest() -> dict[tuple[str, str], float]:
    """Up to where white walls are seen in fog of 60 m, by preset and noise, as the page's table has it."""
    found = dict.fromkeys(((name, "datasheet") for name in GATE), math.inf)
    rows = re.findall(r"^\| (`.+`) \| (\d+) \| (\d*) ?\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    for names, datasheet, measured in rows:
        for name in re.findall(r"`(.+?)`", names):
            found[name, "datasheet"] = float(datasheet)
            if measured:
                found[name, "measured"] = float(measured)
    return found


def test_the_table_has_each_preset() -> None:
    assert {name for name, noise in farthest() if noise == "datasheet"} == {*ls.Lidar.presets()} - AIRBORNE
    assert {name for name, noise in farthest() if noise == "measured"} == {*measured_presets()} - {*GATE}


@pytest.mark.slow("white walls and signs are seen in dense fog as far as the page says")
@pytest.mark.parametrize(("name", "noise"), farthest())
def test_surfaces_are_seen_in_fog_as_far_as_the_page_says(name: str, noise: str) -> None:
    lidar = ls.Lidar.preset(name, noise=noise)
    lidar = replace(lidar, pattern=Thinned(lidar.pattern))

    def share(distance: float, material: ls.Material | None = None) -> float:
        scene = ls.Scene()
        scene.add(ls.Sphere((0, 0, 0), distance), material=material)  # seen from inside, it faces every pulse
        scene.atmosphere = ls.Atmosphere.fog(60.0)
        scan = lidar.scan(scene, seed=1)
        return float((~np.isnan(scan.range) & (scan.source == ls.Source.surface)).any(axis=1).mean())

    at = farthest()[name, noise]
    if at == math.inf:
        assert share(lidar.max_range - 1.0) > 0.5
    else:
        assert share(at - 1.0) > 0.5 > share(at + 1.0)  # rounded to 1 m
    assert share(min(40.0, lidar.max_range - 1.0), ls.materials.SIGN_SHEETING) > 0.99
