"""Conversion between point clouds and the point layouts of the ROS drivers of real sensors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim.io._records import check_plausible, set_column, to_fields
from lidarsim.io._times import NAMES, since_stamp
from lidarsim.io._units import integers, reflectivity, vendor_range
from lidarsim.scan.fields import Fields
from lidarsim.scan.pointcloud import PointCloud, adopt
from lidarsim.sensor.sensor import Sensor

_XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
LAYOUTS: dict[str, np.dtype[np.void]] = {
    "velodyne": np.dtype([*_XYZ, ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]),
    "ouster": np.dtype(
        {
            "names": ["x", "y", "z", "intensity", "t", "reflectivity", "ring", "ambient", "range"],
            "formats": ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2", "<u2", "<u2", "<u4"],
            "offsets": [0, 4, 8, 16, 20, 24, 26, 28, 32],  # PCL aligns the struct to 16 bytes
            "itemsize": 48,
        }
    ),
    "hesai": np.dtype([*_XYZ, ("intensity", "<f4"), ("ring", "<u2"), ("timestamp", "<f8")]),
    "autoware": np.dtype(
        [
            *_XYZ,
            *(("intensity", "u1"), ("return_type", "u1"), ("channel", "<u2")),
            *(("azimuth", "<f4"), ("elevation", "<f4"), ("distance", "<f4"), ("time_stamp", "<u4")),
        ]
    ),
    "livox": np.dtype(
        {
            "names": ["offset_time", "x", "y", "z", "reflectivity", "tag", "line"],
            "formats": ["<u4", "<f4", "<f4", "<f4", "u1", "u1", "u1"],
            "offsets": [0, 4, 8, 12, 16, 17, 18],
            "itemsize": 20,  # CDR aligns the next point to 4 bytes; the last one ends after 19
        }
    ),
    "livox_cloud": np.dtype(
        [*_XYZ, ("intensity", "<f4"), ("tag", "u1"), ("line", "u1"), ("timestamp", "<f8")]  # packed, 26 bytes
    ),
}
"""Point layouts by driver."""

VENDORS = {"ouster": "ouster", "hesai": "hesai", "robosense": "hesai", "livox": "livox"}
"""Layouts by the vendor that the sensor's model names; all other sensors get velodyne."""

LAST, FIRST, STRONGEST, SECOND, SECOND_STRONGEST = 1, 2, 3, 7, 8
"""Return types as numbered by Autoware's nebula drivers; 0 is unknown."""


def layout_of(lidar: Sensor | None) -> str:
    """Return the layout that the sensor's driver publishes."""
    model = lidar.model.lower() if lidar else ""
    return next((layout for vendor, layout in VENDORS.items() if vendor in model), "velodyne")


class _Points(NamedTuple):
    fields: Fields
    lidar: Sensor | None
    stamp: int  # ns
    layout: str

    @property
    def nanoseconds(self) -> npt.NDArray[np.float64]:
        rounded: npt.NDArray[np.float64] = np.rint(self.fields["time"] * 1e9)
        return rounded

    @property
    def reflectivity(self) -> npt.NDArray[np.uint8]:
        check_plausible({"intensity": self.fields["intensity"]}, np.inf, 0)
        return reflectivity(self.fields["intensity"], 150 if self.layout.startswith("livox") else 100)

    def integers(self, name: str, values: npt.NDArray[Any], column: str) -> npt.NDArray[Any]:
        """Return integers after checking that they fit in a column of the layout."""
        return integers(name, values, LAYOUTS[self.layout][column], f"{column} in the {self.layout} layout")


def _return_types(points: _Points) -> npt.NDArray[Any]:
    """Return the type of each return, given which returns the sensor reports; see `Measurement.returns`."""
    number, count = points.fields["return_number"], points.fields["return_count"]
    returns = points.lidar.measurement.returns if points.lidar else None
    if returns == "dual":  # the strongest, then the last; if these are one, the second strongest, which is nearer
        nearer = np.diff(points.fields["range"], prepend=np.inf) < 0
        return np.select([number == 1, nearer], [STRONGEST, SECOND_STRONGEST], LAST)
    if isinstance(returns, int):  # nearest first
        return np.select([number == 1, number == count, number == 2], [FIRST, LAST, SECOND], 0)
    return np.full(len(number), {"strongest": STRONGEST, "first": FIRST, "last": LAST}.get(returns or "", 0))


def _absolute(points: _Points) -> npt.NDArray[np.float64]:
    """Return times since 1970, in s; those of Livox in ns, of which a float64 has steps of 256."""
    since: npt.NDArray[np.float64] = points.stamp % 10**9 + points.nanoseconds
    whole = points.stamp // 10**9
    return float(whole * 10**9) + since if points.layout == "livox_cloud" else whole + since / 1e9


_COLUMNS: dict[str, Callable[[_Points], npt.NDArray[Any]]] = {
    "x": lambda points: points.fields["xyz"][:, 0],
    "y": lambda points: points.fields["xyz"][:, 1],
    "z": lambda points: points.fields["xyz"][:, 2],
    "intensity": lambda points: points.reflectivity,
    "reflectivity": lambda points: points.reflectivity,
    "ring": lambda points: points.integers("ring", points.fields["ring"], "ring"),
    "channel": lambda points: points.integers("ring", points.fields["ring"], "channel"),
    "line": lambda points: points.integers("ring", points.fields["ring"], "line"),
    "time": lambda points: points.fields["time"],
    "t": lambda points: points.integers("time in ns", points.nanoseconds, "t"),
    "time_stamp": lambda points: points.integers("time in ns", points.nanoseconds, "time_stamp"),
    "offset_time": lambda points: points.integers("time in ns", points.nanoseconds, "offset_time"),
    "timestamp": _absolute,
    "range": lambda points: points.integers("range in mm", np.rint(points.fields["range"] * 1e3), "range"),
    "ambient": lambda points: np.zeros(len(points.fields["xyz"]), np.uint16),
    "azimuth": lambda points: np.arctan2(points.fields["xyz"][:, 1], points.fields["xyz"][:, 0]),
    "elevation": lambda points: np.arctan2(points.fields["xyz"][:, 2], np.hypot(*points.fields["xyz"][:, :2].T)),
    "distance": lambda points: np.linalg.norm(points.fields["xyz"], axis=1),
    "return_type": _return_types,
    # Bits 4 and 5 hold the return number, counted from 0.
    "tag": lambda points: np.clip(points.fields["return_number"].astype(np.int64) - 1, 0, 3) << 4,
}


def to_layout(cloud: PointCloud, layout: str, lidar: Sensor | None, stamp: int) -> tuple[npt.NDArray[np.void], int]:
    """Return the finite points in firing order in a layout, and the time of the last since the stamp, ns."""
    n = len(cloud)
    fields: Fields = {"time": np.zeros(n), "intensity": np.zeros(n, np.float32)}
    fields |= {name: np.zeros(n, np.uint16) for name in ("ring", "range", "return_number", "return_count")}
    fields |= {name: getattr(cloud, name) for name in cloud.fields if name in {"xyz", *fields}}
    if hasattr(cloud, "range"):
        fields["range"] = vendor_range(fields, lidar)
    finite = np.isfinite(cloud.xyz).all(axis=1) & np.isfinite(fields["time"])
    if not finite.all() or (np.diff(fields["time"]) < 0).any():
        order = np.flatnonzero(finite)[np.argsort(fields["time"][finite], kind="stable")]
        fields = {name: array[order] for name, array in fields.items()}
    points = _Points(fields, lidar, stamp, layout)
    records = np.zeros(len(fields["xyz"]), LAYOUTS[layout])
    for name in LAYOUTS[layout].names or ():
        set_column(records, name, _COLUMNS[name](points))
    return records, int(max(points.nanoseconds.max(initial=0), 0))


def to_cloud(columns: Fields, stamp: int, recorded: int) -> PointCloud:
    """Return the points of a message, with columns renamed to lidarsim's fields where there is one.

    `stamp` is the time of the message and `recorded` the time of its recording, ns.
    """
    columns = dict(columns)
    for name in NAMES:
        if name in columns:
            columns["time"] = since_stamp(name, columns.pop(name), stamp, recorded)
            break
    for name in ("channel", "line"):
        if name in columns and "ring" not in columns:
            columns["ring"] = columns.pop(name)
    if "range" in columns and columns["range"].dtype.kind == "u":
        columns["range"] = columns["range"] / 1e3
    return PointCloud(adopt(to_fields(columns, ("normal_x", "normal_y", "normal_z"))))
