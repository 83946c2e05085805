"""Data sets, read back: a sequence of frames for training, of any layout.

The notes of a data set in ``manifest/`` have the pose, time and boxes of each frame in full, so only the points are
read from the files of its layout.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, SupportsIndex, overload

import numpy as np
import numpy.typing as npt
import yaml

from lidarsim._base.files import format_error, parsing
from lidarsim._base.shown import quantity
from lidarsim._base.validation import Floats, array, integer, short_repr
from lidarsim.datasets import manifest
from lidarsim.datasets.frames import names_in
from lidarsim.datasets.layouts import Layout, class_name, layout_of
from lidarsim.datasets.sampling import boxes_of
from lidarsim.datasets.store import Store, open_store
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.pointcloud import PointCloud, adopt
from lidarsim.scan.scan import fill_value

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike
    from lidarsim.datasets.samples import Record


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """A frame of one sensor.

    Attributes
    ----------
    cloud : PointCloud
        The points with all fields that the files have: in the frame of the sensor at `time`, or in world coordinates if
        the data set says so. Labels, where the layout has them, are ``cloud.label`` and ``cloud.instance``.
    boxes : Boxes or None
        The boxes that the layout has of the frame, in the coordinates of the points; None for a layout without boxes,
        and for sweeps of nuScenes, which are not annotated. ``boxes.points``, and thus the `min_points` of the layout,
        count the points of this sensor; the tables of nuScenes count those of all sensors of a rig.
    pose, body : ndarray of float64, shape (4, 4)
        Poses of the sensor and of its body at `time`, to world.
    time : float
        Time of the cloud: the start of the frame, or the moment to which the points are deskewed, s.
    sequence, frame : int
        Numbers, counted from 0.
    sensor : str
        Name in the rig; empty for a single sensor.
    split : str
        Split of the sequence; empty without splits.
    """

    cloud: PointCloud
    boxes: Boxes | None
    pose: Floats
    body: Floats
    time: float
    sequence: int
    frame: int
    sensor: str
    split: str

    def image(
        self,
        field: str = "range",
        *,
        size: tuple[int, int] = (64, 1024),
        elevations: tuple[float, float] | None = None,
    ) -> npt.NDArray[Any]:
        """Return a field of the points as an image around the sensor.

        Rows are equal steps of elevation, the highest first, and columns equal steps of azimuth, which decreases from
        left to right, with x ahead in the middle. A pixel shows the nearest point that falls into it.

        Parameters
        ----------
        field : str
            A field of the cloud, or "range", the distance from the sensor, m.
        size : tuple of int
            Rows and columns.
        elevations : tuple of float, optional
            Least and greatest elevation, rad; other points are left out. Default: those of the points of this frame.

        Returns
        -------
        ndarray, shape (rows, columns) or (rows, columns, 3)
            The image, in the dtype of the field; pixels without a point have the values that they have in `Scan.image`.

        Raises
        ------
        TypeError, ValueError
            If there is no such field, `size` is not two integers >= 1, or the elevations do not ascend.

        Notes
        -----
        This is the projection of Milioto et al., RangeNet++: fast and accurate lidar semantic segmentation, 2019.
        """
        fields = {*self.cloud.fields, "range"}
        if field not in fields:
            raise ArgumentValueError("field", f"one of {', '.join(sorted(fields))}", short_repr(field))
        if not isinstance(size, tuple | list) or len(size) != 2:
            raise ArgumentTypeError("size", "(rows, columns)", short_repr(size))
        rows, columns = (integer(f"size[{index}]", count, at_least=1) for index, count in enumerate(size))
        xyz = self.cloud.xyz.astype(np.float64)
        if not self.cloud._in_sensor_frame:
            xyz = (xyz - self.pose[:3, 3]) @ self.pose[:3, :3]
        distance = np.linalg.norm(xyz, axis=1)
        values = distance if field == "range" else getattr(self.cloud, field)
        azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
        elevation = np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1]))
        low, high = _limits(elevations, elevation)
        step = (high - low) / rows or 1.0
        row = np.minimum(np.floor((high - elevation) / step).astype(np.int64), rows - 1)
        column = np.floor((0.5 - azimuth / (2 * np.pi)) * columns).astype(np.int64) % columns
        order = np.argsort(distance, kind="stable")[::-1]  # the last write wins
        order = order[((elevation >= low) & (elevation <= high))[order]]
        image = np.full((rows, columns, *values.shape[1:]), fill_value(field, values.dtype), values.dtype)
        image[row[order], column[order]] = np.asarray(values)[order]
        return image


def _limits(given: tuple[float, float] | None, elevation: Floats) -> tuple[float, float]:
    if given is None:
        return (float(elevation.min()), float(elevation.max())) if len(elevation) else (0.0, 0.0)
    low, high = array("elevations", given, (2,)).tolist()
    if not low < high:
        raise ArgumentValueError("elevations", "(least, greatest), rad", short_repr(given))
    return low, high


@dataclass(frozen=True, eq=False)
class DataSet(Sequence[LabelledFrame]):
    """The frames of a data set, each read when it is asked for.

    It has no open files and keeps no points, so that it can be pickled, and shared by threads and forked processes. As
    it has a length and items, it is a map-style data set of PyTorch, too.

    Attributes
    ----------
    layout : Layout
        Its layout; ``layout.type`` is the name.
    class_names : dict of int to str
        Class names by label.
    split : str or None
        The split that it is restricted to.
    """

    layout: Layout
    class_names: dict[int, str]
    split: str | None
    _store: Store = field(repr=False)
    _places: npt.NDArray[np.int64] = field(repr=False)
    _in_world: bool = field(repr=False)

    def __len__(self) -> int:
        """Return the number of frames; with a rig, those of all sensors."""
        return len(self._places)

    @overload
    def __getitem__(self, index: SupportsIndex) -> LabelledFrame: ...

    @overload
    def __getitem__(self, index: slice) -> DataSet: ...

    def __getitem__(self, index: SupportsIndex | slice) -> LabelledFrame | DataSet:
        """Read a frame, or return the data set of a slice of the frames.

        Raises
        ------
        FileFormatError
            If its files are lost or damaged.
        IndexError
            If there is no such frame.
        OSError
            If they cannot be read.
        """
        if isinstance(index, slice):
            return replace(self, _places=self._places[index])
        try:
            number = operator.index(index)
        except TypeError:
            raise ArgumentTypeError("index", "an integer or a slice", short_repr(index)) from None
        if not -len(self) <= number < len(self):
            raise IndexError(f"index: expected less than {quantity(len(self), 'frame')}, got {number}")
        record = manifest.record(self._store, manifest.Place(*self._places[number].tolist()), self.layout)
        where = f"{self._store}: sequence {record.sequence}, frame {record.frame}"
        with parsing(where, f"frame of {self.layout.type}"):
            try:
                cloud = PointCloud(adopt(self.layout.read(self._store, record)))
            except FileNotFoundError as lost:
                raise FileFormatError(format_error(lost)) from lost
            if len(cloud) != record.points:
                raise FileFormatError(f"expected {record.points:,} points, got {len(cloud):,}")
        cloud.class_names = self.class_names
        cloud._place(in_sensor_frame=not self._in_world)
        return LabelledFrame(
            cloud=cloud,
            boxes=self._boxes(record) if self.layout.has_boxes(record.frame) else None,
            pose=record.matrix,
            body=record.body_matrix,
            time=record.seconds,
            sequence=record.sequence,
            frame=record.frame,
            sensor=record.sensor,
            split=record.split,
        )

    def _boxes(self, record: Record) -> Boxes:
        """Return the boxes that the layout has of a record."""
        boxes = [box for _, box in self.layout.annotations([record])]
        names = self.class_names | {box.label: class_name(box.label, self.class_names) for box in boxes}
        return replace(boxes_of(boxes, names), in_sensor_frame=not self._in_world)


def load(folder: PathLike, split: str | None) -> DataSet:
    """Return the frames of a data set; see `lidarsim.datasets.load`."""
    store = open_store(folder, "folder")
    recipe = _recipe(store)
    splits = recipe.get("splits") or {}
    if split is not None and not (isinstance(split, str) and split in splits):
        known = ", ".join(map(repr, splits))
        raise ArgumentValueError(
            "split", f"None or one of {known}" if splits else "None without splits", short_repr(split)
        )
    chosen = (place for place in manifest.places(store) if split in {None, place.split})
    places = [(place.shard, place.start, place.stop) for place in chosen]
    try:
        layout = layout_of(recipe.get("layout", ""))
        names = names_in(recipe.get("class_names") or {}, f"{store}/{manifest.RECIPE}")
    except ArgumentValueError as error:
        raise FileFormatError(f"{store}/{manifest.RECIPE}: {error}") from None
    if not layout.has_frames:
        raise FileFormatError(f"{store}: expected bags whose messages are frames, got bags with a cut")
    return DataSet(layout, names, split, store, np.array(places, np.int64).reshape(-1, 3), has_world_points(recipe))


def has_world_points(recipe: Mapping[str, Any]) -> bool:
    """Return whether the points of a data set by a recipe are in world coordinates."""
    run = recipe.get("run")
    cloud = (run if isinstance(run, dict) else recipe).get("cloud")
    return isinstance(cloud, dict) and cloud.get("frame") == "world"


def _recipe(store: Store) -> dict[str, Any]:
    """Return the recipe of a complete data set as plain values."""
    data, place = manifest.recipe_of(store), f"{store}/{manifest.RECIPE}"
    with parsing(place, "recipe"):
        recipe = yaml.safe_load(data)
    if not isinstance(recipe, dict) or not isinstance(recipe.get("splits") or {}, dict):
        raise FileFormatError(f"{place}: expected a recipe, got {short_repr(recipe)}")
    return recipe
