"""Geodetic coordinates beside the closed formula of the other direction, and beside PROJ."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pyproj
import pytest

import lidarsim as ls
from lidarsim.motion.georeference import gps_time, unix_time

AXIS, FLATTENING = 6_378_137.0, 1 / 298.257223563
SQUARED = FLATTENING * (2 - FLATTENING)

PLACES = [(48.1, 11.6, 520.0), (-33.9, 151.2, -40.0), (0.0, 0.0, 0.0), (89.99, 170.0, 9000.0), (-90.0, 20.0, 2800.0)]


def on_earth(latitude: Any, longitude: Any, height: Any) -> np.ndarray:
    """Earth-centred, Earth-fixed coordinates: the normal of the ellipsoid, from the axis to the surface, and on."""
    normal = AXIS / np.sqrt(1 - SQUARED * np.sin(latitude) ** 2)
    from_axis = (normal + height) * np.cos(latitude)
    along = ((1 - SQUARED) * normal + height) * np.sin(latitude)
    return np.array([from_axis * np.cos(longitude), from_axis * np.sin(longitude), along]).T


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("size", [1.0, 1e3, 1e6])
def test_positions_come_back_from_their_geodetic_coordinates(place: tuple[float, ...], size: float) -> None:
    latitude, longitude, height = math.radians(place[0]), math.radians(place[1]), place[2]
    positions = np.random.default_rng(3).uniform(-size, size, (300, 3))
    found = on_earth(*ls.Georeference(origin=(latitude, longitude, height)).geodetic(positions))
    up = np.array([math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude),
                   math.sin(latitude)])  # fmt: skip
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    axes = np.array([east, np.cross(up, east), up])
    want = on_earth(latitude, longitude, height) + positions @ axes
    # Coordinates up to 8e6 m have ulps of 0.93 nm: a dozen rounded sums of such numbers on the way there and back.
    np.testing.assert_allclose(found, want, rtol=0, atol=16 * np.spacing(8e6))


@pytest.mark.parametrize("place", PLACES)
def test_proj_agrees_near_the_origin(place: tuple[float, ...]) -> None:
    steps = f"+step +inv +proj=topocentric +lat_0={place[0]} +lon_0={place[1]} +h_0={place[2]} +ellps=WGS84"
    proj = pyproj.Transformer.from_pipeline(f"+proj=pipeline {steps} +step +inv +proj=cart +ellps=WGS84")
    positions = np.random.default_rng(4).uniform(-1000, 1000, (300, 3))
    longitude, latitude, height = (np.array(part) for part in proj.transform(*positions.T, radians=True))
    origin = math.radians(place[0]), math.radians(place[1]), place[2]
    got = ls.Georeference(origin=origin).geodetic(positions)
    # PROJ takes one step of Bowring's iteration, which is off by up to 3e-8" near the surface (Bowring 1976): 1 µm.
    apart = np.linalg.norm(on_earth(*got) - on_earth(latitude, longitude, height), axis=1)
    assert apart.max() < 1e-6


def test_a_projected_system() -> None:
    # Munich's Frauenkirche; EPSG:25832 is ETRS89, which PROJ takes to be WGS 84 within a metre: by nothing at all.
    east, north = pyproj.Proj("EPSG:25832")(11.573611, 48.138611)
    world = ls.Georeference(crs="EPSG:25832")
    latitude, longitude, altitude = world.geodetic([[east, north, 555.0]])
    # An inverse of Krüger's series is good to 1e-12 rad.
    np.testing.assert_allclose(
        np.degrees([longitude[0], latitude[0]]), [11.573611, 48.138611], rtol=0, atol=np.degrees(1e-12)
    )
    assert altitude.tolist() == [555.0]
    expected = r"^positions: expected points in the area of ETRS89 / UTM zone 32N, got positions\[1\] = "
    for far in ([0.0, 1e9, 0.0], [9e7, 0.0, 0.0]):
        with pytest.raises(ValueError, match=expected):
            world.geodetic([[500_000.0, 5e6, 0.0], far])


def test_heights_above_a_geoid_need_its_grid() -> None:
    """Without one, PROJ would take them for heights above the ellipsoid, 47 m off."""
    crs = "EPSG:25832+7837"
    with warnings.catch_warnings(action="ignore"):  # that the grid is missing
        if pyproj.transformer.TransformerGroup(pyproj.CRS(crs).to_3d(), "EPSG:4979").best_available:
            pytest.skip("the grid is installed")
    with pytest.raises(ValueError, match=r"^crs: expected a system whose heights PROJ can refer to .*grid"):
        ls.Georeference(crs=crs).geodetic([[500_000.0, 5_669_000.0, 100.0]])


def test_web_mercator_is_asked_about() -> None:
    for crs in (3857, "EPSG:3857"):
        with pytest.warns(UserWarning, match="^crs: WGS 84 / Pseudo-Mercator, where a metre .*; a UTM zone\\?$"):
            ls.Georeference(crs=crs)
    for crs in (25832, 2154):  # UTM, and Lambert's projection of France: warnings are errors
        ls.Georeference(crs=crs)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({}, "origin, crs: expected one of them, got neither"),
        ({"origin": (0, 0, 0), "crs": 25832}, "origin, crs: expected one of them, got both"),
        ({"origin": (48, 11, 500)}, "origin[0]: expected a finite number from -1.5708 to 1.5708, got 48.0; degrees?"),
        ({"origin": (0.8, 0.2)}, "origin: expected shape (3,), got (2,)"),
        ({"origin": (0.8, 0.2, 1e7)}, "origin[2]: expected a finite number from -1e+06 to 1e+06, got 10000000.0"),
        ({"crs": 2065}, "crs: expected a right-handed system, got S-JTSK (Ferro) / Krovak, of southing and westing"),
        ({"crs": "EPSG:4326"}, "crs: expected a projected system, since coordinates are in m, got WGS 84"),
    ],
)
def test_bad_georeferences(arguments: dict[str, Any], problem: str) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        ls.Georeference(**arguments)
    assert str(caught.value).startswith(problem)


def test_positions_far_away_are_refused() -> None:
    world = ls.Georeference(origin=(0.0, 0.0, 0.0))
    expected = (
        r"^positions: expected coordinates within 1,000,000 m of the origin, got positions\[1\] = \[0\.0, 2000000"
    )
    with pytest.raises(ValueError, match=expected):
        world.geodetic([[0, 0, 0], [0, 2e6, 0]])


def test_fractions_of_a_second_keep_their_nanoseconds() -> None:
    assert unix_time(1_700_000_000.25, limit=2**32) == 1_700_000_000_250_000_000


@pytest.mark.parametrize("moment", [gps_time, partial(unix_time, limit=2**32)])
def test_a_start_is_seconds_or_a_datetime(moment: Callable[[object], object]) -> None:
    with pytest.raises(TypeError, match=r"^start: expected seconds or a datetime with a time zone, got '2026-05-01'$"):
        moment("2026-05-01")
