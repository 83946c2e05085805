"""Coordinate reference systems and GPS time, as the files of surveying hold them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from lidarsim._extras import import_extra
from lidarsim._validation import real, shown
from lidarsim.errors import ArgumentTypeError, ArgumentValueError

if TYPE_CHECKING:
    import pyproj

__all__ = ["ADJUSTMENT", "GPS_EPOCH", "gps_time", "projected"]

GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
"""Zero of GPS time."""

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
        if isinstance(start, str):
            raise ArgumentTypeError("start", "seconds or a datetime with a time zone", shown(start))
        return real("start", start), False
    if start.tzinfo is None or start.utcoffset() is None:
        hint = "datetime.fromisoformat('2026-05-01T10:00:00+00:00') has one"
        raise ArgumentValueError("start", "a datetime with a time zone", start.isoformat(), hint)
    if start < GPS_EPOCH:
        raise ArgumentValueError("start", "a moment since the GPS epoch, 1980-01-06 UTC", start.isoformat())
    leaps = sum(start >= day for day in LEAP_SECONDS)
    microseconds = (start - GPS_EPOCH) // timedelta(microseconds=1)
    return (microseconds + (leaps - ADJUSTMENT) * 1_000_000) / 1e6, True


def projected(crs: object) -> pyproj.CRS:
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
        raise ArgumentTypeError("crs", "an EPSG code, WKT or a pyproj.CRS", shown(crs))
    try:
        found: pyproj.CRS = library.CRS.from_user_input(crs)
    except library.exceptions.CRSError:
        raise ArgumentValueError("crs", "an EPSG code, such as EPSG:25832, or WKT", shown(crs)) from None
    if not found.is_projected:
        kind = f"{found.name}, whose coordinates are degrees" if found.is_geographic else found.name
        raise ArgumentValueError("crs", "a projected system, since coordinates are in m", kind)
    for axis in found.axis_info:
        if axis.unit_conversion_factor != 1.0:
            hint = "convert to a system in metres, and the result with pyproj"
            raise ArgumentValueError("crs", "a system in metres", f"{found.name}, in {axis.unit_name}", hint)
    return found
