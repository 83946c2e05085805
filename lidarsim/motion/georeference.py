"""Where a world is on the Earth: coordinate reference systems, geodetic coordinates and GPS time."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from lidarsim._base.extras import import_extra
from lidarsim._base.pickling import Value
from lidarsim._base.validation import Floats, angle, array, ask, real, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError

if TYPE_CHECKING:
    import pyproj

SEMI_MAJOR_AXIS = 6_378_137.0
"""Semi-major axis of WGS 84, m (NIMA TR8350.2, 3rd ed., table 3.1)."""

FLATTENING = 1.0 / 298.257223563
"""Flattening of WGS 84 (likewise)."""

SQUARED_ECCENTRICITY = FLATTENING * (2.0 - FLATTENING)

GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
"""Zero of GPS time."""

UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
"""Zero of Unix time, which ROS and the sensors use."""

START = datetime(2020, 1, 1, tzinfo=UTC)
"""Moment of time 0 in bags and packets unless another is given. ROS treats a stamp of 0 as unset."""

ADJUSTMENT = 1_000_000_000
"""LAS's adjusted standard GPS time is GPS time less this, s, so that a double keeps more digits."""

LEAP_SECONDS = tuple(
    datetime(year, month, 1, tzinfo=UTC)
    for year, month in (
        *((1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7)),
        *((1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1)),
    )
)
"""Days that follow a leap second since the GPS epoch (IERS Bulletin C; none has been announced after 2017). GPS time
counts these seconds, UTC does not."""


def gps_time(start: object) -> tuple[float, bool]:
    """Return the moment from which the times of points count, s, and whether it is adjusted standard GPS time.

    Parameters
    ----------
    start : float or datetime
        Seconds on a clock of one's own, or a moment with its time zone.

    Raises
    ------
    TypeError, ValueError
        If it is neither, has no time zone or is before the GPS epoch.
    """
    if not isinstance(start, datetime):
        return _seconds(start), False
    _check_zone(start)
    if start < GPS_EPOCH:
        raise ArgumentValueError("start", "a moment since the GPS epoch, 1980-01-06 UTC", start.isoformat())
    leaps = sum(start >= day for day in LEAP_SECONDS)
    microseconds = (start - GPS_EPOCH) // timedelta(microseconds=1)
    return (microseconds + (leaps - ADJUSTMENT) * 1_000_000) / 1e6, True


def unix_time(start: object, *, limit: int = 2**63 // 10**9) -> int:
    """Return a moment as Unix time, ns: the time since 1970 in UTC, which does not count leap seconds.

    Parameters
    ----------
    start : float or datetime
        Seconds since 1970, or a moment with its time zone.
    limit : int
        Seconds since 1970 by which a format ends. Default: int64 in ns.

    Raises
    ------
    TypeError, ValueError
        If it is neither, has no time zone, is before 1970 or is not before the limit.
    """
    if isinstance(start, datetime):
        _check_zone(start)
        seconds, got = (start - UNIX_EPOCH).total_seconds(), start.isoformat()
    else:
        seconds = _seconds(start)
        got = f"{seconds:.16g} s since 1970"
    if not 0 <= seconds < limit:
        end = UNIX_EPOCH + timedelta(seconds=limit)
        raise ArgumentValueError("start", f"a moment from 1970-01-01 to {end:%Y-%m-%d} UTC", got)
    if isinstance(start, datetime):
        return (start - UNIX_EPOCH) // timedelta(microseconds=1) * 1000
    return round(Fraction(seconds) * 1_000_000_000)


def _seconds(start: object) -> float:
    """Return a start that is no datetime as a float."""
    try:
        return real("start", start)
    except ArgumentTypeError as error:
        raise ArgumentTypeError("start", "seconds or a datetime with a time zone", error.got) from None


def _check_zone(start: datetime) -> None:
    if start.tzinfo is None or start.utcoffset() is None:
        got = start.isoformat()
        raise ArgumentValueError("start", "a datetime with a time zone", got, f"{got}+00:00 is one in UTC")


def projected_crs(crs: object) -> pyproj.CRS:
    """Return a coordinate reference system in which lidarsim's coordinates can be.

    Parameters
    ----------
    crs : int, str or pyproj.CRS
        An EPSG code, "EPSG:25832", WKT or anything else from which pyproj makes one.

    Raises
    ------
    MissingExtraError
        If pyproj is not installed.
    ValueError
        If there is no such system, it is not projected, or not in metres.
    """
    library = import_extra("pyproj", "geo", "coordinate reference systems")
    if isinstance(crs, bool) or not isinstance(crs, int | str | library.CRS):
        raise ArgumentTypeError("crs", "an EPSG code, WKT or a pyproj.CRS", short_repr(crs))
    try:
        found: pyproj.CRS = library.CRS.from_user_input(crs)
    except library.exceptions.CRSError:
        raise ArgumentValueError("crs", "an EPSG code, such as EPSG:25832, or WKT", short_repr(crs)) from None
    if not found.is_projected:
        kind = f"{found.name}, whose coordinates are degrees" if found.is_geographic else found.name
        raise ArgumentValueError("crs", "a projected system, since coordinates are in m", kind)
    for axis in found.axis_info:
        if axis.unit_conversion_factor != 1.0:
            hint = "convert to a system in metres, and the result with pyproj"
            raise ArgumentValueError("crs", "a system in metres", f"{found.name}, in {axis.unit_name}", hint)
    if [axis.direction for axis in found.axis_info[:2]] == ["south", "west"]:  # z would point down
        raise ArgumentValueError("crs", "a right-handed system", f"{found.name}, of southing and westing")
    operation = found.coordinate_operation
    if operation is not None and "Pseudo Mercator" in operation.method_name:
        ask("crs", f"{found.name}, where a metre is shorter on the ground, but at the equator", "a UTM zone?")
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Georeference(Value):
    """Where a world is on the Earth: by its origin, or by a coordinate reference system.

    Parameters
    ----------
    origin : tuple of 3 floats, optional
        Geodetic latitude and longitude, rad, and height above the ellipsoid, m, of the world's origin on WGS 84. The
        world has x to the east, y to the north and z up there.
    crs : int, str or pyproj.CRS, optional
        The projected coordinate reference system of the world, in m, instead of an origin: an EPSG code, "EPSG:25832"
        or WKT. Without a vertical system, z is the height above the ellipsoid; with one, PROJ needs the grid of its
        geoid. Needs ``lidarsim[geo]``.

    Raises
    ------
    MissingExtraError
        If pyproj is not installed.
    TypeError, ValueError
        If neither or both are given, a number is out of its range, or the system is not projected or not in metres.

    Examples
    --------
    >>> world = Georeference(origin=(math.radians(48.0), math.radians(11.0), 500.0))
    >>> latitude, longitude, altitude = world.geodetic([[0.0, 1000.0, 0.0]])
    >>> print(f"{math.degrees(latitude[0]):.6f} {math.degrees(longitude[0]):.6f} {altitude[0]:.3f}")
    48.008993 11.000000 500.078
    """

    _: KW_ONLY
    origin: tuple[float, float, float] | None = None
    crs: int | str | pyproj.CRS | None = None

    def __post_init__(self) -> None:
        """Check the arguments."""
        if (self.origin is None) == (self.crs is None):
            got = "neither" if self.origin is None else "both"
            raise ArgumentValueError("origin, crs", "one of them", got)
        if self.crs is not None:
            projected_crs(self.crs)
            return
        values = array("origin", self.origin, (3,)).tolist()
        latitude = angle("origin[0]", values[0], at_least=-math.pi / 2, at_most=math.pi / 2)
        longitude = angle("origin[1]", values[1], at_least=-2.0 * math.pi, at_most=2.0 * math.pi)
        altitude = real("origin[2]", values[2], at_least=-HEIGHT, at_most=HEIGHT)
        object.__setattr__(self, "origin", (latitude, longitude, altitude))

    def geodetic(self, positions: object) -> tuple[Floats, Floats, Floats]:
        """Return the geodetic coordinates of positions in the world.

        Parameters
        ----------
        positions : array_like, shape (n, 3)
            Positions, m.

        Returns
        -------
        latitude, longitude, altitude : ndarray of float64, shape (n,)
            On WGS 84: rad, rad, and m above the ellipsoid.

        Raises
        ------
        TypeError, ValueError
            If the positions are not finite, too far from the Earth's surface, or outside of the reference system.

        Notes
        -----
        With an origin, positions are rotated and moved into Earth-centred, Earth-fixed axes (P. D. Groves, Principles
        of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., 2013, section 2.4). There, with p
        the distance from the axis, semi-axes a and b, and squared eccentricities e² and e'², latitude follows from
        B. R. Bowring's iteration (Survey Review 23, 1976): tan φ = (z + e'² b sin³β)/(p − e² a cos³β) with
        tan β = (b/a) tan φ, from tan β = (a/b) z/p. Height is p cos φ + z sin φ − a √(1 − e² sin² φ).
        """
        given = array("positions", positions, ("n", 3))
        if self.origin is None:
            return _by_projection(self.crs, given)
        if not np.abs(given).max(initial=0.0) <= HEIGHT:
            i = int(np.argmax(np.abs(given).max(axis=1)))
            far = f"positions[{i}] = {given[i].tolist()}"
            raise ArgumentValueError("positions", f"coordinates within {HEIGHT:,.0f} m of the origin", far)
        return _geodetic(_to_earth(self.origin, given))


HEIGHT = 1e6
"""Largest coordinate in a world with an origin, m. So far from the surface, an iteration of Bowring's formula divides
the error of the latitude by more than 1,000, from 1e-3 rad at the start."""


LARGEST = 1e8
"""Largest coordinate in a projected system, m. Beyond the circumference of the Earth, 4e7 m, and any false easting,
PROJ returns numbers without a meaning."""


def _to_earth(origin: tuple[float, float, float], positions: Floats) -> Floats:
    """Return positions to the east, to the north and up from an origin in Earth-centred, Earth-fixed axes, m."""
    latitude, longitude, altitude = origin
    sin, cos, east, north = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    normal = SEMI_MAJOR_AXIS / math.sqrt(1.0 - SQUARED_ECCENTRICITY * sin * sin)
    x, y, z = positions.T
    outward = cos * z - sin * y + (normal + altitude) * cos
    return np.column_stack(
        [
            north * outward - east * x,
            east * outward + north * x,
            sin * z + cos * y + (normal * (1.0 - SQUARED_ECCENTRICITY) + altitude) * sin,
        ]
    )


def _geodetic(positions: Floats) -> tuple[Floats, Floats, Floats]:
    """Return latitude, longitude, rad, and height, m, of Earth-centred, Earth-fixed positions."""
    x, y, z = positions.T
    p = np.hypot(x, y)
    semi_minor = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
    second = SQUARED_ECCENTRICITY / (1.0 - SQUARED_ECCENTRICITY)
    beta = np.arctan2(z, (1.0 - FLATTENING) * p)
    for _ in range(5):
        latitude = np.arctan2(
            z + second * semi_minor * np.sin(beta) ** 3,
            p - SQUARED_ECCENTRICITY * SEMI_MAJOR_AXIS * np.cos(beta) ** 3,
        )
        beta = np.arctan2((1.0 - FLATTENING) * np.sin(latitude), np.cos(latitude))
    sin, cos = np.sin(latitude), np.cos(latitude)
    height = p * cos + z * sin - SEMI_MAJOR_AXIS * np.sqrt(1.0 - SQUARED_ECCENTRICITY * sin * sin)
    return latitude, np.arctan2(y, x), height


def _by_projection(crs: object, positions: Floats) -> tuple[Floats, Floats, Floats]:
    """Return latitude, longitude, rad, and height, m, of positions in a coordinate reference system."""
    library = import_extra("pyproj", "geo", "coordinate reference systems")
    system = projected_crs(crs).to_3d()
    try:
        transformer = library.Transformer.from_crs(system, "EPSG:4979", always_xy=True, allow_ballpark=False)
    except library.exceptions.ProjError as error:
        expected = f"a system whose heights PROJ can refer to the ellipsoid; {system.name} needs a grid"
        raise ArgumentValueError("crs", expected, "none installed", "pyproj sync, or PROJ_NETWORK=ON") from error
    longitude, latitude, altitude = (np.asarray(values) for values in transformer.transform(*positions.T))
    wrong = ~(np.isfinite(longitude) & np.isfinite(latitude) & np.isfinite(altitude))
    wrong |= np.abs(positions).max(axis=1, initial=0.0) > LARGEST
    if wrong.any():
        i = int(np.argmax(wrong))
        expected = f"points in the area of {system.name}"
        raise ArgumentValueError("positions", expected, f"positions[{i}] = {positions[i].tolist()}")
    return np.radians(latitude), np.radians(longitude), altitude
