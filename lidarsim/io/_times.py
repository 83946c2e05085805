"""Conversion of point times, whose unit and zero depend on the driver, to seconds since the message's stamp.

========================================  ============================================================================
driver                                    field
========================================  ============================================================================
velodyne                                  ``time`` f4, s since the stamp
ouster                                    ``t`` u4, ns since the stamp
hesai, robosense                          ``timestamp`` f8, s since 1970
livox_ros_driver2                         ``timestamp`` f8, ns since 1970; ``offset_time`` u4, ns since the stamp
autoware                                  ``time_stamp`` u4, ns since the stamp
========================================  ============================================================================

Other drivers mix these. Integers are nanoseconds. Real numbers are classified by size: a frame lasts 10 ms to 1 s, or
up to 10 s in seconds, and times since 1970 are near the stamp.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError

NAMES = ("time", "t", "time_stamp", "offset_time", "timestamp", "timeStamp", "time_offset")
"""Names of time fields; the first that is present counts."""

ABSOLUTE = ("timestamp", "timeStamp")
UNITS = (1, 10**3, 10**6, 10**9)
"""One second in s, ms, µs and ns."""

DAY = 86_400.0


def since_stamp(name: str, values: npt.NDArray[Any], stamp: int, recorded: int) -> Floats:
    """Return the values of a field of times, shape (n,), in s since the stamp of their message.

    `stamp` and `recorded` are the times of the message and of its recording, ns. Among times since 1970, 0, which
    drivers give points without a return, becomes nan.
    """
    if values.ndim != 1 or values.dtype.itemsize < 4:
        raise FileFormatError(f"its field {name} has the type {values.dtype}, expected one number of 32 or 64 bits")
    times = values.astype(np.float64)
    if values.dtype.kind in "iu":
        if len(times) and times.min() >= 1e9 and abs(times.max() - stamp / 1e9) < DAY:
            raise FileFormatError(f"its field {name} has whole seconds since 1970, which tell no points apart")
        return times / 1e9
    given = times[np.isfinite(times) & (times != 0.0)]
    if not len(given):
        return times
    low, high = float(given.min()), float(given.max())
    start, end = stamp / 1e9 - 1.0, max(stamp, recorded) / 1e9 + 10.0
    # Near 0, where simulation clocks begin, only the name tells absolute times from times since the stamp.
    if values.dtype.itemsize == 8 and (stamp > 60 * 10**9 or name in ABSOLUTE):
        for unit in UNITS:
            near = start * unit <= low and high <= end * unit
            if near or (1e9 * unit <= low and high < 1e10 * unit and abs(high / unit - stamp / 1e9) < DAY):
                whole, rest = divmod(stamp, 10**9 // unit)
                return np.where(times == 0.0, np.nan, (times - float(whole) - rest * (unit / 1e9)) / unit)
    longest = max(-low, high)
    if longest <= 10.0 or longest <= (recorded - stamp) / 1e9 + 1.0:  # a message is recorded after its last point
        return times
    for unit in UNITS[1:]:
        if 1e-2 * unit <= longest <= unit:
            return times / unit
    raise FileFormatError(
        f"its field {name} has times from {low:.10g} to {high:.10g}, in no unit that fits the stamp {stamp / 1e9:.9f} s"
    )
