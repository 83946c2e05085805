"""In fog, rain and snow, presets see a few points in the air, and surfaces behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls

ROOT = Path(__file__).parents[2]
STILL = ("faro-", "leica-", "riegl-", "hokuyo-", "rplidar-", "sick-")
"""Terrestrial and airborne scanners, and those of one plane."""
AIR = {
    "rain, 5 mm/h": (ls.Atmosphere.rain(5.0), (0.0, 0.01)),
    "rain, 25 mm/h": (ls.Atmosphere.rain(25.0), (0.0, 0.03)),
    "fog, 300 m": (ls.Atmosphere.fog(300.0), (0.0, 0.02)),
    "fog, 60 m": (ls.Atmosphere.fog(60.0), (0.02, 0.4)),
    "snow, 1 mm/h": (ls.Atmosphere.snow(1.0), (0.02, 0.15)),
}
"""Bounds of the share of points in the air."""
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
@pytest.mark.parametrize("name", [name for name in ls.Lidar.presets() if not name.startswith(STILL)])
def test_the_air_has_its_share_of_points(name: str, noise: str, street: ls.Scene) -> None:
    try:
        lidar = ls.Lidar.preset(name, noise=noise)
    except ValueError:
        pytest.skip("no measured noise")
    lidar = replace(lidar, pattern=Thinned(lidar.pattern))
    pose = np.eye(4)
    pose[:3, 3] = (0.0, -1.8, 1.9)
    off = {}
    for kind, (atmosphere, (least, most)) in AIR.items():
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
