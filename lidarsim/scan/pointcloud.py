"""Point clouds: named arrays of equal length, with registered file formats and conversions."""

from __future__ import annotations

import inspect
import math
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from lidarsim._base import validation
from lidarsim._base.extras import import_extra
from lidarsim._base.files import (
    PathLike,
    atomic_writer,
    check_path,
    check_regular,
    parsing,
    reading,
)
from lidarsim._base.labels import Labels
from lidarsim._base.names import instead
from lidarsim._base.pickling import Pickled
from lidarsim._base.shown import html_table, quantity, text_table
from lidarsim._base.validation import Transform, as_array, named_labels, short_repr
from lidarsim._base.views import Plotted, view
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.scan.cells import Cells, Statistic, cells_of
from lidarsim.scan.columns import PointColumns, with_columns
from lidarsim.scan.fields import CANONICAL, EXTRA_DTYPES, Fields, first_misfit, with_unit
from lidarsim.scan.formats import FORMATS, HEAD, check_output, format_of, options_of, recognise
from lidarsim.scan.names import Names

if TYPE_CHECKING:
    from datetime import datetime

    import open3d
    import pandas as pd
    import pyproj
    import pyvista

MOST_ROWS = 14  # maximum lines of a repr below its title


@with_columns("n", lacking="Absent")
class PointCloud(PointColumns, Pickled, Plotted):
    """Points with named fields, each an array attribute with one entry per point.

    Only the given fields exist. Fields can be set and added later (``cloud.cluster = ids``), with the same checks;
    ``cloud[index]`` is the cloud of the points selected by a slice, a mask or an array of indices. Arrays that already
    have the right dtype and are C-contiguous are not copied.

    Parameters
    ----------
    fields : mapping of array_like, PointCloud, or array_like of shape (n, 3), optional
        The fields by name, including `xyz`; those of a cloud, with its class names; or `xyz` alone. The fields listed
        below are converted to their dtype: values may be rounded to float32, but integer fields accept only integers
        that fit. Any other field has shape (n,) or (n, m) and keeps its dtype: bool, any integer type, float32 or
        float64.
    class_names : mapping of int to str, optional
        Class names by label, for legends and files.
    **more
        More or all fields, as keywords.

    Attributes
    ----------
    class_names : mapping of int to str
        Names of labels; the mapping is read-only but can be replaced.

    Raises
    ------
    TypeError
        If `xyz` is missing or a field does not hold numbers.
    ValueError
        If a field's shape, length, values or name do not fit.

    Examples
    --------
    >>> cloud = PointCloud(xyz=[[4, 0, 0], [0, 3, 1]], ring=[0, 1])
    >>> cloud.intensity = [0.5, 0.25]
    >>> cloud
    PointCloud: 2 points
      xyz        float64 × 3  (0, 0, 0) … (4, 3, 1)
      intensity  float32      0.25 … 0.5
      ring       uint16       0 … 1
    >>> cloud[cloud.ring == 1].xyz
    array([[0., 3., 1.]])
    """

    __slots__ = ("__dict__", "__weakref__", "_class_names", "_in_sensor_frame")  # the dictionary holds the fields

    _class_names: dict[int, str]
    _in_sensor_frame: bool
    """Whether the points are in a sensor frame that differs from the world."""

    def __init__(
        self,
        fields: Mapping[str, npt.ArrayLike] | PointCloud | npt.ArrayLike | None = None,
        /,
        *,
        class_names: Mapping[int, str] | None = None,
        **more: npt.ArrayLike,
    ) -> None:
        in_sensor_frame = False
        if isinstance(fields, PointCloud):
            class_names = fields.class_names if class_names is None else class_names
            in_sensor_frame = fields._in_sensor_frame
            fields = fields._arrays()
        elif fields is not None and not isinstance(fields, Mapping):
            fields = {"xyz": _positions(fields)}
        given = {**(fields or {}), **more}
        self.class_names = given.pop("class_names", class_names)  # type: ignore[assignment]
        self._place(in_sensor_frame=in_sensor_frame)
        for name in given:
            if not isinstance(name, str):
                raise ArgumentTypeError("fields", "strings as names of fields", validation.short_repr(name))
        if "xyz" not in given:
            raise ArgumentTypeError("PointCloud", "a field 'xyz'", ", ".join(given) or "no fields")
        for name in sorted(given, key=lambda name: name != "xyz"):  # xyz first, which sets the length
            setattr(self, name, given[name])

    @classmethod
    def _of(
        cls, arrays: dict[str, npt.NDArray[Any]], class_names: Mapping[int, str], *, in_sensor_frame: bool
    ) -> PointCloud:
        """Return a cloud of fields of equal length, already in the form that `_field` returns."""
        cloud = cls.__new__(cls)
        cloud.__dict__.update(arrays)
        cloud.class_names = class_names
        return cloud._place(in_sensor_frame=in_sensor_frame)

    def _place(self, *, in_sensor_frame: bool) -> Self:
        """Set whether the points are in a sensor frame, and return the cloud."""
        object.__setattr__(self, "_in_sensor_frame", in_sensor_frame)
        return self

    @property
    def class_names(self) -> Mapping[int, str]:
        """Names of labels: read-only mapping of int to str."""
        return MappingProxyType(self._class_names)

    @class_names.setter
    def class_names(self, names: Mapping[int, str] | None) -> None:
        object.__setattr__(self, "_class_names", named_labels("class_names", names))
        if "label" in self.__dict__:
            self.__dict__["label"] = Labels(self.label, self._class_names)

    def __setattr__(self, name: str, values: npt.ArrayLike) -> None:
        """Set or add a field."""
        if name == "class_names":
            object.__setattr__(self, name, values)
            return
        if name not in NAMES:
            raise ArgumentValueError(
                "PointCloud", "ASCII identifiers, not its attributes, as names of fields", repr(name)
            )
        array = _field(name, values)
        if "xyz" in self.__dict__ and len(array) != len(self):
            raise ArgumentValueError(name, f"one entry for each of the {len(self)} points", len(array))
        self.__dict__[name] = Labels(array, self._class_names) if name == "label" else array

    def __getattr__(self, name: str) -> npt.NDArray[Any]:
        """Raise an error that names the existing fields; called only for a missing one."""
        hint = "" if name.startswith("_") else instead(PointCloud, name, [*self.fields, *dir(PointCloud)])
        problem = f"this point cloud has no {name!r}{hint and f': {hint}'}"
        raise AttributeError(f"{problem}; its fields are {', '.join(self.fields)}", name=name, obj=self)

    def __delattr__(self, name: str) -> None:
        """Remove a field."""
        if name == "xyz":
            raise AttributeError("a point cloud cannot be without 'xyz'")
        super().__delattr__(name)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the existing fields: lidarsim's own in fixed order, then the others by name."""
        own = self.__dict__
        return (*(name for name in CANONICAL if name in own), *sorted(own.keys() - CANONICAL.keys()))

    def __array__(self, dtype: npt.DTypeLike | None = None, *, copy: bool | None = None) -> npt.NDArray[Any]:
        """Return the points, `xyz`, so that ``np.asarray(cloud)`` has shape (n, 3); `to_structured` has all fields."""
        return np.array(self.xyz, dtype=dtype, copy=copy)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.xyz)

    def __getitem__(self, index: int | slice | npt.ArrayLike) -> PointCloud:
        """Return the cloud of the points selected by a slice, a mask, an array of indices or one index."""
        if isinstance(index, str):
            hint = "" if index in self.fields else instead(PointCloud, index, [*self.fields])
            hint = hint or f"a field is cloud.{index}"
            raise ArgumentTypeError("index", "indices, a mask or a slice", repr(index), hint)
        if isinstance(index, tuple):
            raise ArgumentTypeError("index", "one index", len(index), "a field such as cloud.xyz takes two")
        chosen = validation.as_index(index, len(self), "points")
        arrays = {name: array[chosen] for name, array in self._arrays().items()}
        cloud = PointCloud(arrays, class_names=self._class_names)
        return cloud._place(in_sensor_frame=self._in_sensor_frame)

    def __repr__(self) -> str:
        """Return one line per field: dtype, and minimum and maximum of the finite values."""
        rows = self._rows()
        if len(rows) > MOST_ROWS:
            rest = ", ".join(name for name, *_ in rows[MOST_ROWS - 1 :])
            rows[MOST_ROWS - 1 :] = [("and", "", textwrap.shorten(rest, 60, placeholder=" …"))]
        return text_table(self._title(), rows)

    def _repr_html_(self) -> str:
        """Return a small HTML table for notebooks."""
        return html_table(self._title(), self._rows())

    def _title(self) -> str:
        return f"PointCloud: {quantity(len(self), 'point')}"

    def _rows(self) -> list[tuple[str, str, str]]:
        """Return the name, type and extent of each field."""
        return [
            (name, f"{array.dtype}{f' × {array.shape[1]}' if array.ndim == 2 else ''}", _extent(array))
            for name, array in self._arrays().items()
        ]

    def _contents(self) -> dict[str, Any]:
        return {
            "fields": self._arrays(),
            "class_names": self._class_names,
            "in_sensor_frame": self._in_sensor_frame,
        }

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        cloud = cls(contents["fields"], class_names=contents["class_names"])
        return cloud._place(in_sensor_frame=contents["in_sensor_frame"])

    def copy(self) -> PointCloud:
        """Return a cloud with its own arrays.

        Returns
        -------
        PointCloud
            A copy of all fields and class names.
        """
        arrays = {name: array.copy() for name, array in self._arrays().items()}
        return PointCloud(arrays, class_names=self._class_names)._place(in_sensor_frame=self._in_sensor_frame)

    def transformed(self, transform: Transform) -> PointCloud:
        """Return the cloud transformed by an affine map.

        Parameters
        ----------
        transform : RigidTransform or array_like, shape (4, 4)
            Affine map, such as a sensor's pose, which maps points from the sensor frame to the world.

        Returns
        -------
        PointCloud
            The cloud with `xyz` transformed, and `normal` transformed by the inverse transpose of the linear part and
            normalised. All other fields, including `range` and other vectors, are unchanged and share their arrays.

        Raises
        ------
        TypeError, ValueError
            If the transform is not affine or cannot be inverted.

        Examples
        --------
        >>> import numpy as np
        >>> up = np.eye(4)
        >>> up[2, 3] = 1.5
        >>> PointCloud(xyz=[[4, 0, 0]]).transformed(up).xyz
        array([[4. , 0. , 1.5]])
        """
        matrix = validation.affine("transform", transform)
        linear, shift = matrix[:3, :3], matrix[:3, 3]
        arrays = self._arrays()
        # Column by column: NumPy's matrix product need not give the same bits on every processor.
        arrays["xyz"] = _map(linear, self.xyz) + shift
        determinant = float(np.linalg.det(linear))
        if determinant == 0.0 or not math.isfinite(determinant):
            raise ArgumentValueError("transform", "an invertible matrix", f"determinant {determinant:g}")
        if "normal" in arrays:
            # The cofactors are the inverse transpose times the determinant, which is negative for a reflection.
            cofactors = np.stack([np.cross(linear[i - 2], linear[i - 1]) for i in range(3)])
            turned = _map(cofactors, self.normal.astype(np.float64)) * np.sign(determinant)
            length = np.sqrt((turned * turned).sum(axis=-1, keepdims=True))
            arrays["normal"] = np.divide(turned, length, out=np.zeros_like(turned), where=length != 0)
        return PointCloud(arrays, class_names=self._class_names)

    def __add__(self, other: object) -> PointCloud:
        """Return the points of both clouds, as `concatenate` does."""
        return PointCloud.concatenate([self, other]) if isinstance(other, PointCloud) else NotImplemented

    def __radd__(self, other: object) -> PointCloud:
        """Return the cloud itself for 0, with which `sum` begins."""
        return self if isinstance(other, int) and other == 0 else NotImplemented

    @classmethod
    def concatenate(cls, clouds: Iterable[PointCloud]) -> PointCloud:
        """Concatenate clouds.

        Parameters
        ----------
        clouds : iterable of PointCloud
            At least one, all with the same fields.

        Returns
        -------
        PointCloud
            The points of all clouds, in order, with the class names of all. Fields of different types get the common
            type of NumPy, which for int64 and uint64 is float64.

        Raises
        ------
        TypeError, ValueError
            If there are no clouds, an item is not a cloud, their fields differ, or a label has two names.

        Examples
        --------
        >>> front, back = PointCloud(xyz=[[1, 0, 0]]), PointCloud(xyz=[[-1, 0, 0]])
        >>> len(PointCloud.concatenate([front, back]))
        2
        """
        if isinstance(clouds, PointCloud):
            raise ArgumentTypeError("clouds", "a sequence of clouds", "one")
        given = validation.items("clouds", clouds, "clouds")
        if not given:
            raise ArgumentValueError("clouds", "at least one", "none")
        names: dict[int, str] = {}
        for i, cloud in enumerate(given):
            if not isinstance(cloud, PointCloud):
                raise ArgumentTypeError(f"clouds[{i}]", "a PointCloud", type(cloud).__name__)
            odd = sorted(set(cloud.fields) ^ set(given[0].fields))
            if odd:
                has = "has" if odd[0] in cloud.fields else "has no"
                raise ArgumentValueError("clouds", "the same fields in all", f"clouds[{i}], which {has} {odd[0]!r}")
            for name in cloud.fields:
                first, own = (getattr(one, name).shape[1:] for one in (given[0], cloud))
                if own != first:
                    expected = f"entries of {name!r} of one shape in all"
                    raise ArgumentValueError("clouds", expected, f"{first} and, in clouds[{i}], {own}")
            for label, name in cloud.class_names.items():
                if names.setdefault(label, name) != name:
                    raise ArgumentValueError(
                        "clouds", "one name for each label", f"{names[label]!r} and {name!r} for {label}"
                    )
        arrays = {name: np.concatenate([getattr(cloud, name) for cloud in given]) for name in given[0].fields}
        return cls(arrays, class_names=names)._place(in_sensor_frame=any(cloud._in_sensor_frame for cloud in given))

    def to_structured(self) -> npt.NDArray[np.void]:
        """Return the points as a structured array.

        Returns
        -------
        ndarray of a structured dtype, shape (n,)
            A copy, with one entry per field: ``points["ring"]`` has shape (n,), ``points["xyz"]`` has shape (n, 3).

        Examples
        --------
        >>> points = PointCloud(xyz=[[1, 2, 3]], ring=[7]).to_structured()
        >>> points.dtype.names, points[0]["ring"].item()
        (('xyz', 'ring'), 7)
        """
        arrays = self._arrays()
        dtype = np.dtype([(name, array.dtype, array.shape[1:]) for name, array in arrays.items()])
        records = np.empty(len(self), dtype)
        for name, array in arrays.items():
            records[name] = array
        return records

    def to_pandas(self, *, class_names: bool = False) -> pd.DataFrame:
        """Return a pandas data frame with one row per point.

        Parameters
        ----------
        class_names : bool
            Whether to add a column ``class``, with the name of each label as a category; labels without a name have
            none.

        Returns
        -------
        pandas.DataFrame
            A copy. `xyz` becomes the columns x, y and z, `normal` becomes nx, ny and nz, other vector fields become
            ``flow.0``, ``flow.1``, …, as in CSV files; all columns keep their dtypes.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.

        Examples
        --------
        >>> cloud = PointCloud(xyz=[[1, 2, 3], [4, 5, 6]], label=[7, 9], class_names={7: "car"})
        >>> frame = cloud.to_pandas(class_names=True)  # doctest: +SKIP
        >>> frame.groupby("class", observed=True).z.mean()  # doctest: +SKIP
        """
        pandas = import_extra("pandas", "pandas", "to_pandas")
        columns: dict[str, Any] = {}
        for name, array in self._arrays().items():
            if array.ndim == 1:
                columns[name] = np.asarray(array)
            else:
                parts = {"xyz": ["x", "y", "z"], "normal": ["nx", "ny", "nz"]}.get(name)
                columns |= zip(parts or [f"{name}.{i}" for i in range(array.shape[1])], array.T, strict=True)
        if validation.flag("class_names", class_names) and "label" in columns:
            names = list(dict.fromkeys(self._class_names.values()))
            codes = {label: names.index(name) for label, name in self._class_names.items()}
            labels, inverse = np.unique(columns["label"], return_inverse=True)
            of_labels = np.array([codes.get(label, -1) for label in labels.tolist()], dtype=np.intp)
            columns["class"] = pandas.Categorical.from_codes(of_labels[inverse], names)
        frame: pd.DataFrame = pandas.DataFrame(columns, copy=True)
        return frame

    def _arrays(self) -> Fields:
        """Return the fields by name, without copies."""
        return {name: getattr(self, name) for name in self.fields}

    def save(
        self,
        path: PathLike,
        *,
        fields: Sequence[str] | None = None,
        float32: bool | None = None,
        pose: Transform | None = None,
        crs: int | str | pyproj.CRS | None = None,
        start: float | datetime = 0.0,
    ) -> None:
        """Write the points to a file; its suffix determines the format.

        The module of a format in `lidarsim.io` documents which fields it holds, in which types and units. The file gets
        its name once it is complete: a failure leaves the old file, or none.

        Parameters
        ----------
        path : path-like
            The file, in a folder that exists.
        fields : sequence of str, optional
            The fields to write besides `xyz`. Default: all.
        float32 : bool, optional
            Write `xyz` as float32, or as float64 in formats that also allow this. Default: float64, but float32 in PCD
            if that keeps all coordinates to 0.1 mm, because the Point Cloud Library's own point types hold only
            float32. LAS and LAZ, whose coordinates are integers, refuse float32.
        pose : RigidTransform or array_like, shape (4, 4), optional
            Rigid transform from the coordinates of the points to the world: the sensor's pose if they are in the sensor
            frame. PCD files hold it as VIEWPOINT, E57 and PTX files as the pose of the scan; other formats omit it.
        crs : int, str or pyproj.CRS, optional
            Projected coordinate reference system of the points, in m, for LAS and LAZ: an EPSG code, "EPSG:25832", WKT
            or a system of pyproj. The points must be in the world.
        start : float or datetime
            Moment from which `time` counts, for the gps_time of LAS and LAZ: seconds on a clock of one's own, or a
            datetime with a time zone for GPS time.

        Raises
        ------
        FileFormatError
            If the suffix is unknown, or the format cannot hold a field's dtype or values.
        MissingExtraError
            If the format needs a package that is not installed, or `crs` pyproj.
        OSError
            If the file cannot be written.
        TypeError, ValueError
            If `fields` is not a sequence of field names, the pose is not rigid, `crs` is unknown, not projected or not
            in metres, `start` has no time zone or is before the GPS epoch, the format cannot hold `crs` or `start`, or
            a coordinate is beyond the range of float32 that is asked for.

        Warns
        -----
        UserWarning
            If `xyz` becomes float64 in a PCD file by default: the Point Cloud Library does not read that.
        """
        path, arrays = check_path(path), self._arrays()
        if fields is not None:
            arrays = {name: arrays[name] for name in ("xyz", *choose(fields, self.fields))}
        check_output(path)
        save, where = format_of(path).save, None if pose is None else validation.pose("pose", pose)
        known = options_of(format_of(path))
        if float32 is not None and validation.flag("float32", float32):
            if misfit := first_misfit("xyz", arrays["xyz"], np.float32):
                raise ArgumentValueError("xyz", *misfit, "float32=False")
            arrays["xyz"] = arrays["xyz"].astype(np.float32)
        if crs is not None:
            check_in_world(self)
        options = {"pose": where, "class_names": self.class_names, "float32": float32, "crs": crs, "start": start}
        for name, given in {
            "crs": crs is not None,
            "start": not (isinstance(start, int | float) and start == 0),
        }.items():
            if name not in known and given:
                held = " and ".join(suffix for suffix, other in FORMATS.items() if name in options_of(other))
                raise ArgumentValueError(name, f"a file that can hold it ({held})", short_repr(str(path)))
        options = {name: option for name, option in options.items() if name in known}
        with atomic_writer(path) as file:
            save(arrays, file, **options)

    def raster(
        self,
        field: str = "z",
        *,
        cell: float,
        statistic: Statistic = "mean",
        bounds: npt.ArrayLike | None = None,
    ) -> Cells:
        """Return a statistic of a field over the cells of a horizontal grid.

        ``raster("z", cell=1, statistic="min")`` is a simple terrain model, with "max" a surface model; "density" shows
        coverage and overlap.

        Parameters
        ----------
        field : str
            "x", "y", "z" or a field with one number per point. "count" and "density" do not depend on it.
        cell : float
            Length of a side of a cell, m. Edges are multiples of it, so that the grids of several clouds match.
        statistic : {"count", "density", "min", "max", "mean", "std"}
            Number of points, points per m², smallest, largest and mean value, standard deviation from the mean.
        bounds : array_like, shape (4,), optional
            x_min, y_min, x_max, y_max, m, extended to whole cells; points outside are ignored. Default: all points.

        Returns
        -------
        Cells
            Its `values`, shape (rows, columns), begin in the north; `Cells.save` writes a GeoTIFF. Points that are not
            finite are ignored.

        Raises
        ------
        TypeError, ValueError
            If there is no such field or statistic, an argument is out of range, or there are too many cells.

        Examples
        --------
        >>> cloud = PointCloud(xyz=[[0.2, 0.5, 1.0], [0.8, 0.5, 3.0], [1.5, 1.5, 7.0]])
        >>> cloud.raster("z", cell=1.0, statistic="max").values
        array([[nan,  7.],
               [ 3., nan]])
        """
        if not isinstance(field, str):
            raise ArgumentTypeError("field", "the name of a field", short_repr(field))
        if field in ("x", "y", "z"):
            values = self.xyz[:, "xyz".index(field)]
        elif field in self.fields and getattr(self, field).ndim == 1:
            values = getattr(self, field).astype(np.float64)
        else:
            single = ", ".join(["x", "y", "z", *(name for name in self.fields if getattr(self, name).ndim == 1)])
            raise ArgumentValueError("field", f"one of {single}", short_repr(field))
        cells = cells_of(self.xyz, values, cell, statistic, bounds)
        of = {"count": "points", "density": "points per m²"}.get(statistic, f"{statistic} of {with_unit(field)}")
        return replace(cells, quantity=of)

    @classmethod
    def load(cls, path: PathLike, *, columns: Sequence[str] | None = None) -> PointCloud:
        """Read a point cloud file from `save` or another program.

        The format is determined by the first bytes of the file if they are a signature, else by the suffix.

        Parameters
        ----------
        path : path-like
            The file.
        columns : sequence of str, optional
            Names of the columns of a file that does not name them itself: KITTI's ``.bin``, nuScenes' ``.pcd.bin``, and
            text without a line of names. x, y and z must be among them; columns named "_" are skipped. Default: the
            columns of the format.

        Returns
        -------
        PointCloud
            The cloud with all fields of the file. Fields with lidarsim's names get lidarsim's dtypes (float32
            coordinates become float64; units stay as in the file); the others keep their dtypes. Where lidarsim's dtype
            cannot hold a value, such as -1 or NaN in `label`, the field is 0, and the values of the file are in a field
            ``<name>_raw``. Invalid names are changed, and duplicates get a number: ``a b``, ``a-b`` and ``save`` become
            ``a_b``, ``a_b_2`` and ``save_``.

        Raises
        ------
        FileFormatError
            If the format is unknown, or the file is damaged, does not match its suffix, or is not a point cloud.
        MissingExtraError
            If the format needs a package that is not installed.
        OSError
            If the file cannot be read.
        TypeError, ValueError
            If `columns` is not a sequence of column names, or files of the format name their columns.
        """
        path = check_path(path)
        options = {} if columns is None else {"columns": _columns(columns)}
        if path.is_dir():
            raise IsADirectoryError(f"{path}: expected a file, got a folder")
        check_regular(path)
        with reading(path), path.open("rb") as file:
            suffix = recognise(file.read(HEAD), path)
            load = FORMATS[suffix].load
            if not options.keys() <= inspect.signature(load).parameters.keys():
                expected = f"none, since {suffix} files name their columns"
                raise ArgumentValueError("columns", expected, f"some for {path}")
            file.seek(0)
            with parsing(path, f"{suffix} point cloud"):
                return cls(adopt(load(file, **options)))

    def to_open3d(self) -> open3d.t.geometry.PointCloud:
        """Return an Open3D tensor point cloud with all fields as attributes.

        `xyz` becomes ``positions`` and `normal` becomes ``normals``; the others keep their names. As Open3D's own
        algorithms and writers require, fields of shape (n,) get shape (n, 1), and other vector fields are split into
        columns ``flow.0``, ``flow.1``, …. The types are also restricted: normals are widened to float64 like the
        positions, booleans become uint8, and integers other than uint8 and uint16 become int32 or, if they do not fit,
        float64. Class names are omitted.

        Returns
        -------
        open3d.t.geometry.PointCloud
            A copy, on the CPU.

        Raises
        ------
        MissingExtraError
            If Open3D is not installed.
        ValueError
            If the magnitude of an integer exceeds 2⁵³, which none of these types can hold.
        """
        converted: open3d.t.geometry.PointCloud = view(PointCloud, "open3d")(self)
        return converted

    def to_pyvista(self) -> pyvista.PolyData:
        """Return a PyVista data set with one vertex per point and all fields but `xyz` as point data of the same dtype.

        Class names become the field data ``class_label`` and ``class_name``.

        Returns
        -------
        pyvista.PolyData
            It shares its arrays with this cloud. VTK does not distinguish shape (n, 1) from (n,); both convert back to
            (n,).

        Raises
        ------
        MissingExtraError
            If PyVista is not installed.
        """
        converted: pyvista.PolyData = view(PointCloud, "pyvista")(self)
        return converted

    @classmethod
    def from_open3d(cls, points: open3d.t.geometry.PointCloud | open3d.geometry.PointCloud) -> PointCloud:
        """Convert an Open3D point cloud with all its attributes.

        Parameters
        ----------
        points : open3d.t.geometry.PointCloud or open3d.geometry.PointCloud
            Its ``positions`` become `xyz` and its ``normals`` become `normal`; other attributes keep their names, and
            vectors that `to_open3d` split into columns are joined again.

        Returns
        -------
        PointCloud
            A copy. Fields with lidarsim's names get lidarsim's dtypes; others keep the dtypes of Open3D. Names and
            values that do not fit are treated as in `load`.

        Raises
        ------
        TypeError, ValueError
            If `points` is not a point cloud, or an attribute cannot be a field.
        """
        return cls(adopt(view(PointCloud, "from_open3d")(points)))

    @classmethod
    def from_pyvista(cls, mesh: pyvista.DataSet) -> PointCloud:
        """Convert the points of a PyVista data set with all their data.

        Parameters
        ----------
        mesh : pyvista.DataSet
            Its points become `xyz`, and its point data become fields of the same names; VTK's normals become `normal`.
            Cell data and text are omitted, except for the class names from `to_pyvista`.

        Returns
        -------
        PointCloud
            Arrays that already have the right dtype are shared. Names and values that do not fit are treated as in
            `load`.

        Raises
        ------
        TypeError, ValueError
            If `mesh` is not a data set, or an array cannot be a field.
        """
        return cls(adopt(view(PointCloud, "from_pyvista")(mesh)))


NAMES = Names(PointCloud)
adopt, field_names = NAMES.adopt, NAMES.of_columns


def _positions(value: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return an array given in place of `fields`, after checking that it can be `xyz`."""
    expected = "an array of shape (n, 3), or fields by name"
    given = as_array("fields", value, expected)
    if given.dtype.kind in "fiu" and given.ndim == 2 and given.shape[1] == 3:
        return given
    if given.dtype.kind == "V" or given.dtype == object:
        example = "such as PointCloud(xyz=…, intensity=…)"
        raise ArgumentTypeError("PointCloud", f"{expected}, {example}", type(value).__name__)
    if given.dtype.kind not in "fiu":
        raise ArgumentTypeError("PointCloud", expected, f"{given.dtype} of shape {given.shape}")
    hint = ""
    if given.ndim == 2 and given.shape[0] == 3:
        hint = "transposed?"
    elif given.ndim == 2 and given.shape[1] > 3:
        hint = "PointCloud(xyz=a[:, :3], intensity=a[:, 3]) takes its columns apart"
    raise ArgumentValueError("PointCloud", expected, f"shape {given.shape}", hint)


def _map(linear: npt.NDArray[np.float64], points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return points, shape (n, 3), transformed by a linear map."""
    x, y, z = points.T
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in linear], axis=-1)


def _field(name: str, values: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return `values` as a C-contiguous array of the field's shape and dtype."""
    shape, dtype = CANONICAL.get(name, (None, None))
    expected = "shape (n,) or (n, m)" if shape is None else "shape (n, 3)" if shape else "shape (n,)"
    if np.ma.is_masked(values):
        raise ArgumentValueError(name, "a number for each point", "a masked array", "fill it")
    try:
        given = np.asarray(values)
    except (TypeError, ValueError):
        raise ArgumentValueError(name, f"numbers of {expected}", "a ragged sequence") from None
    fits = (
        given.ndim in {1, 2} and 0 not in given.shape[1:]
        if shape is None
        else given.shape == (*given.shape[:1], *shape)
    )
    if not fits:
        raise ArgumentValueError(name, expected, given.shape)
    given = given.astype(given.dtype.newbyteorder("="), copy=False)
    if dtype is None:
        if given.dtype not in EXTRA_DTYPES:
            raise ArgumentTypeError(name, "bool, integers, float32 or float64", f"dtype {given.dtype}")
        return np.ascontiguousarray(given)
    if given.dtype.kind not in "fiu":
        raise ArgumentTypeError(name, "real numbers", f"dtype {given.dtype}")
    if misfit := first_misfit(name, given, dtype):
        raise ArgumentValueError(name, *misfit)
    return np.ascontiguousarray(given, dtype)


def with_common_fields(clouds: Sequence[PointCloud]) -> list[PointCloud]:
    """Return clouds with the fields that all have, and their class names."""
    names = [name for name in clouds[0].fields if all(name in cloud.fields for cloud in clouds)]
    return [
        PointCloud({name: getattr(cloud, name) for name in names}, class_names=cloud.class_names) for cloud in clouds
    ]


def _columns(names: Sequence[str]) -> list[str]:
    """Return column names after checking that x, y and z are among them, none but "_" is repeated and none is empty."""
    if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise ArgumentTypeError("columns", "a sequence of names", validation.short_repr(names))
    if "" in names:
        expected = "names, and '_' for each column to skip"
        raise ArgumentValueError("columns", expected, validation.short_repr(list(names)))
    for name in (*"xyz", *names):
        if name != "_" and list(names).count(name) != 1:
            raise ArgumentValueError("columns", f"{name!r} once", validation.short_repr(list(names)))
    return list(names)


def _extent(array: npt.NDArray[Any]) -> str:
    """Return the minimum and maximum of the finite values, per column of a vector field."""
    finite = array[np.isfinite(array).all(axis=tuple(range(1, array.ndim)))]
    if not len(finite):
        return ""
    ends = ([f"{value:g}" for value in np.atleast_1d(end)] for end in (finite.min(axis=0), finite.max(axis=0)))
    return " … ".join(f"({', '.join(end)})" if array.ndim == 2 else end[0] for end in ends)


def check_in_world(cloud: PointCloud) -> None:
    """Raise an error if a cloud that is to get a coordinate reference system is in a sensor frame."""
    if cloud._in_sensor_frame:
        expected = "points in the world, with a coordinate reference system"
        raise ArgumentValueError("crs", expected, "points in a sensor frame", 'point_cloud(frame="world")')


def choose(names: Collection[str], known: Sequence[str]) -> list[str]:
    """Return some fields besides `xyz`, in order, after checking that they exist."""
    names = validation.items("fields", names, "names")
    for name in names:
        if not (isinstance(name, str) and name in known):
            expected = f"fields of this point cloud ({', '.join(known)})"
            raise ArgumentValueError("fields", expected, validation.short_repr(name))
    return [name for name in known if name in names and name != "xyz"]
