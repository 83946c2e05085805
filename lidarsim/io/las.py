"""LAS and LAZ, the formats of surveying (``.las``, ``.laz``): LAS 1.4, point format 6, or 7 with colours.

=================  ==============================================================================================
lidarsim           LAS
=================  ==============================================================================================
xyz                X, Y, Z: multiples of 0.1 mm from an offset in whole metres near the first points, so that UTM
                   coordinates keep 0.05 mm; they reach 214 km from the offset. NaN cannot be stored.
intensity          intensity: 10 000 for a white diffuser at normal incidence; more than 6.5535 times that saturates
                   at 65 535, with a warning
time               gps_time: `start` plus the time since the start of the scan. Adjusted standard GPS time, as the
                   header states, if `start` is a datetime; else seconds on a clock of one's own, those of the run in
                   the files of ``lidarsim scan``
return_number,     return number, number of returns: 0 to 15
return_count
label              classification: 0 to 255; the standard defines 2 as ground and 6 as building
scan_angle         scan angle, in steps of 0.006°. A cloud has no such field, since it depends on the nadir and the
                   line of flight: `flight_fields` returns it in rad, with scan_direction_flag, edge_of_flight_line
                   and point_source_id. The files of ``lidarsim scan`` have them if the sensor moves.
normal             extra dimensions NormalX, NormalY, NormalZ
all others         extra dimensions of the same name and type; shape (n, m) becomes one per component. Fields named
                   like other LAS dimensions (user_data, point_source_id, red, …) are stored there, also gps_time,
                   classification and number_of_returns, which load by lidarsim's names. bool cannot be stored.
=================  ==============================================================================================

All fields load bit for bit except `xyz`, `intensity` and `scan_angle`, which are rounded. Every file has the first six,
0 where the cloud had no such field; LAS's other dimensions are not loaded if they are 0 throughout. A dimension that
another program added under the name of one of these fields, such as ``label``, becomes ``label_2``.

With `crs`, a coordinate reference system in metres, the file has its WKT (version 1, which the standard requires) and
the WKT bit of the header; with `geokeys`, also GeoTIFF keys, for older programs. This needs pyproj. Without `crs`,
there is neither.

COPC files are read as the LAZ files that they are. They are not written: a library that writes COPC, such as copclib,
expects the octree of the points, and building that is the work of tools such as PDAL and untwine, which convert LAZ.

Format: https://github.com/ASPRSorg/LAS, revision R15.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.files import FileWriter, PathLike, Place, atomic_writer, check_regular, check_suffix, parse_each
from lidarsim._base.validation import flag, short, short_repr
from lidarsim.errors import ArgumentValueError, FileFormatError
from lidarsim.io._flight import flight_fields
from lidarsim.io._records import BLOCK, blocks, check_expansion, join, to_columns, to_fields
from lidarsim.io._units import integers, warn_above
from lidarsim.motion.georeference import gps_time, projected_crs
from lidarsim.scan.fields import CANONICAL, Fields
from lidarsim.scan.formats import check_output, register_format
from lidarsim.scan.pointcloud import PointCloud, adopt, check_in_world, choose

if TYPE_CHECKING:
    import pyproj

__all__ = ["Writer", "flight_fields", "read"]

SUFFIXES = (".las", ".laz")
NORMAL = ("NormalX", "NormalY", "NormalZ")
CODES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
NAMES = {"time": "gps_time", "label": "classification", "return_count": "number_of_returns"}
AXES = ("x", "y", "z")
OWN = {"X", "Y", "Z", "bit_fields", "classification_flags", "scales", "offsets"}
"""Names that laspy uses for other parts of a record."""

UNUSED = {
    *("synthetic", "key_point", "withheld", "overlap", "scanner_channel", "scan_direction_flag"),
    *("edge_of_flight_line", "user_data", "scan_angle", "point_source_id"),
}
"""Dimensions that every file has and few writers set, by lidarsim's names."""

SCALE = 1e-4
REACH = (2**31 - 5_000) * SCALE
"""Greatest distance of a coordinate from the middle of the first points, m: half a metre less than 32 bits hold, since
the offset is that middle in whole metres."""

WHITE = 10_000  # intensity of a white diffuser
ANGLE = np.radians(0.006)  # step of the scan angle


class Writer(FileWriter):
    """Write clouds, such as the frames of a flight, one by one into one LAS or LAZ file.

    A context manager: the file appears under its name when the block ends without an error.

    Parameters
    ----------
    path : path-like
        The file, ``.las`` or ``.laz``.
    crs : int, str or pyproj.CRS, optional
        Coordinate reference system of the points, as in `lidarsim.PointCloud.save`.
    geokeys : bool
        Also write it as GeoTIFF keys, which older programs read. It must have an EPSG code.
    fields : sequence of str, optional
        The fields to write besides `xyz`. Default: all of the clouds.

    Raises
    ------
    FileFormatError
        If the suffix is not one of these.
    MissingExtraError
        If laspy, or lazrs for LAZ, or pyproj for `crs` is not installed.
    TypeError, ValueError
        If `crs` is not a projected system in metres, or GeoTIFF keys cannot hold it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Writer(f"{folder}/flight.laz") as flight:
    ...         for x in range(3):
    ...             flight.write(PointCloud(xyz=[[500_000 + x, 5_400_000, 300]], label=[2]))
    ...     print(PointCloud.load(f"{folder}/flight.laz").xyz[:, 0])
    [500000. 500001. 500002.]
    """

    def __init__(
        self,
        path: PathLike,
        *,
        crs: int | str | pyproj.CRS | None = None,
        geokeys: bool = False,
        fields: Sequence[str] | None = None,
    ) -> None:
        super().__init__(path)
        self._fields = fields
        self._compress = check_suffix(path, SUFFIXES) == ".laz"
        self._reference = _Reference.of(crs, geokeys=geokeys)
        check_output(path)
        _import(self._compress)

    def _open(self, stack: ExitStack) -> None:
        file = stack.enter_context(atomic_writer(self._place.path))
        self._points = stack.enter_context(_Points(file, self._reference, compress=self._compress))

    def write(self, cloud: PointCloud, *, start: float | datetime = 0.0) -> None:
        """Append the points of a cloud.

        Parameters
        ----------
        cloud : PointCloud
            A cloud with the same fields and dtypes as all clouds before it.
        start : float or datetime
            Moment from which the cloud's `time` counts, as in `lidarsim.PointCloud.save`. Either all clouds of a file
            have a datetime or none.

        Raises
        ------
        FileFormatError
            If a field does not fit.
        TypeError, ValueError
            If the fields are not those of the first cloud, one of `fields` is missing, the points are in a sensor
            frame but the file has a `crs`, or it is not open.
        """
        self._check_open()
        if self._reference.crs is not None:
            check_in_world(cloud)
        names = cloud.fields if self._fields is None else ("xyz", *choose(self._fields, cloud.fields))
        self._points.write({name: getattr(cloud, name) for name in names}, start)


def read(path: PathLike) -> Iterator[PointCloud]:
    """Read a LAS or LAZ file piece by piece, however large it is.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    iterator of PointCloud
        Some thousand points each, in the order of the file, with a field for every dimension that the file has.

    Raises
    ------
    FileFormatError
        If the file is damaged or not LAS.
    OSError
        If it cannot be read.
    """
    check_regular(path)
    place = Place(path)
    return place.each(parse_each(place.path, "LAS file", _clouds(place.path)))


def _clouds(path: Path) -> Iterator[PointCloud]:
    with path.open("rb") as file:
        names = _field_names(file)
        for piece in _pieces(file, _open(file)):
            whole = to_fields(piece, NORMAL)
            fields = adopt(whole)
            fields |= {name: whole[name.removesuffix("_raw")] for name in names - fields.keys()}
            if len(cloud := PointCloud(fields)):
                yield cloud


def _field_names(file: BinaryIO) -> set[str]:
    """Return the names of all fields of a file, including a ``_raw`` field where a value in any piece does not fit.

    The file is read for that only if a type of its dimensions exceeds lidarsim's.
    """
    pieces = _pieces(file, _open(file))
    first = to_fields(next(pieces), NORMAL)
    names = set(adopt(first))
    types = {name: CANONICAL[name][1] for name in first.keys() & CANONICAL.keys()}
    if not all(np.can_cast(first[name].dtype, dtype) for name, dtype in types.items()):
        names.update(*(adopt(to_fields(piece, NORMAL)) for piece in pieces))
    return names


def save(
    fields: Fields,
    file: BinaryIO,
    *,
    compress: bool,
    crs: int | str | pyproj.CRS | None = None,
    start: float | datetime = 0.0,
) -> None:
    """Write one cloud."""
    if fields["xyz"].dtype == np.float32:  # which would move points by more than the steps of the file
        raise ArgumentValueError("float32", "a format with float32 coordinates", "LAS, which has integers")
    with _Points(file, _Reference.of(crs), compress=compress) as points:
        points.write(fields, start)


def load(file: BinaryIO) -> Fields:
    """Read all points."""
    reader = _open(file)
    columns = join(_pieces(file, reader))
    unused = UNUSED - set(reader.header.point_format.extra_dimension_names)
    return to_fields({name: column for name, column in columns.items() if name not in unused or column.any()}, NORMAL)


@contextmanager
def _explain_lost_writes() -> Iterator[None]:
    """Turn lazrs's own error into the `OSError` that it hides: only the file can fail during compression."""
    try:
        yield
    except Exception as error:
        if type(error).__name__ != "LazrsError":
            raise
        raise OSError(str(error)) from error


@dataclass(frozen=True)
class _Reference:
    """Coordinate reference system of a file, if it is known."""

    crs: pyproj.CRS | None = None
    wkt: str = ""
    geokeys: bool = False
    """Whether to write it as GeoTIFF keys, too."""

    @classmethod
    def of(cls, crs: int | str | pyproj.CRS | None, *, geokeys: bool = False) -> _Reference:
        """Return the reference of a file, after checking that it can hold the system."""
        if flag("geokeys", geokeys) and crs is None:
            raise ArgumentValueError("crs", "a coordinate reference system for the GeoTIFF keys", "None")
        if crs is None:
            return cls()
        found = projected_crs(crs)
        try:
            wkt = found.to_wkt("WKT1_GDAL")
        except RuntimeError:  # pyproj's
            raise ArgumentValueError(
                "crs", "a system that WKT 1 can describe, which LAS requires", found.name
            ) from None
        if geokeys and (found.is_compound or found.to_epsg() is None or not found.name.isascii()):
            raise ArgumentValueError("crs", "a horizontal system with an EPSG code, for GeoTIFF keys", found.name)
        return cls(found, wkt, geokeys)


class _Points:
    """The points of an open file; the first points determine its offset, its dimensions and its clock.

    Until there are points, clouds without any, such as those of a flight before its target, are only remembered.
    """

    def __init__(self, file: BinaryIO, reference: _Reference, *, compress: bool) -> None:
        self._laspy = _import(compress)
        self._file, self._reference, self._compress = file, reference, compress
        self._is_gps_time = False
        self._writer: Any = None
        self._empty: tuple[Fields, float | datetime] = {"xyz": np.empty((0, 3))}, 0.0
        self._dtypes: dict[str, np.dtype[Any]] = {}
        self._targets: dict[str, str] = {}

    def __enter__(self) -> Self:
        return self

    @_explain_lost_writes()
    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            if self._writer is None:
                self._append(*self._empty)
            self._writer.close()
            self._file.seek(90)
            self._file.write(bytes(4))  # no creation date: the same cloud gives the same bytes on any day

    @_explain_lost_writes()
    def write(self, fields: Fields, start: float | datetime) -> None:
        if self._writer is None and not len(fields["xyz"]):
            self._empty = fields, start
        else:
            self._append(fields, start)

    def _append(self, fields: Fields, start: float | datetime) -> None:
        zero, is_gps_time = gps_time(start)
        if zero != 0.0:
            fields = fields | {"time": zero + fields.get("time", np.zeros(len(fields["xyz"])))}
        columns = to_columns(fields, NORMAL, CODES)
        dtypes = {name: column.dtype for name, column in columns.items()}
        if len(fields["xyz"]):
            _check_coordinates(columns, None if self._writer is None else self._writer.header.offsets)
        if self._writer is None:
            self._dtypes, self._targets, self._is_gps_time = dtypes, _targets(columns), is_gps_time
            self._writer = self._open(columns)
        elif dtypes != self._dtypes:
            raise ArgumentValueError("cloud", f"the fields {', '.join(self._dtypes)}", ", ".join(dtypes))
        elif is_gps_time != self._is_gps_time:
            expected = "a datetime" if self._is_gps_time else "seconds"
            raise ArgumentValueError("start", f"{expected}, as for the first cloud of the file", short_repr(start))
        header = self._writer.header
        for number, block in enumerate(blocks(columns)):
            record = self._laspy.ScaleAwarePointRecord.zeros(len(block["x"]), header=header)
            for name, column in block.items():
                _set(record, name, self._targets[name], column, number * BLOCK)
            self._writer.write_points(record)

    def _open(self, columns: Fields) -> Any:
        laspy = self._laspy
        colours = {"red", "green", "blue"} <= columns.keys()
        header = laspy.LasHeader(version="1.4", point_format=7 if colours else 6)
        self._add_reference(header)
        header.generating_software = "lidarsim"
        header.scales = np.full(3, SCALE)
        header.offsets = [np.rint(sum(end / 2 for end in _ends(columns[axis]))) for axis in AXES]
        standard = set(header.point_format.dimension_names)
        header.add_extra_dims(
            [
                laspy.ExtraBytesParams(name, column.dtype)
                for name, column in columns.items()
                if name not in AXES and self._targets[name] not in standard
            ]
        )
        backend = laspy.LazBackend.Lazrs if self._compress else None
        return laspy.LasWriter(self._file, header, self._compress, backend, closefd=False)

    def _add_reference(self, header: Any) -> None:
        """Write the coordinate reference system and the kind of time into a header."""
        laspy, reference = self._laspy, self._reference
        if self._is_gps_time:
            header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
        if reference.crs is not None:
            header.global_encoding.wkt = True
            header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(reference.wkt))
        if reference.geokeys:
            header.vlrs.extend(laspy.vlrs.geotiff.create_geotiff_projection_vlrs(reference.crs))


def _targets(columns: Fields) -> dict[str, str]:
    """Return the dimension of each column, after checking that the names do not collide in LAS."""
    targets = {name: NAMES.get(name, name) for name in columns}
    counts = Counter(targets.values())
    for name, target in targets.items():
        if name in OWN or counts[target] > 1 or len(target) > 32:
            raise FileFormatError(
                f"{short(name)}: LAS cannot hold a field of this name beside the others; save without it"
            )
    return targets


def _ends(column: npt.NDArray[Any]) -> tuple[float, float]:
    """Return the least and the greatest number of a column; 0 if it has none."""
    return (float(column.min()), float(column.max())) if len(column) else (0.0, 0.0)


def _check_coordinates(columns: Fields, offsets: npt.NDArray[np.float64] | None) -> None:
    """Check that all coordinates of a cloud fit, before any is written; `offsets`: those of a file that has points."""
    for i, axis in enumerate(AXES):
        column = columns[axis]
        finite = np.isfinite(column)
        if not finite.all():
            k = int(np.argmin(finite))
            raise FileFormatError(f"{axis}: expected finite coordinates, got {axis}[{k}] = {column[k]:g}")
        low, high = _ends(column)
        if offsets is None and not high - low <= 2.0 * REACH:
            expected = "coordinates over at most 429 km, 32 bits in steps of 0.1 mm"
            raise FileFormatError(f"{axis}: expected {expected}, got {low:g} to {high:g} m")
        if offsets is not None and not offsets[i] - REACH <= low <= high <= offsets[i] + REACH:
            k = int(np.argmax(np.abs(column / 2.0 - offsets[i] / 2.0)))  # halved, it cannot overflow
            near = f"coordinates within 214 km of {offsets[i]:g} m, the middle of the first points"
            raise FileFormatError(f"{axis}: expected {near}, got {axis}[{k}] = {column[k]:g}")


def _set(record: Any, name: str, target: str, column: npt.NDArray[Any], first: int) -> None:
    """Set the dimension of a column; `first` is the number of its first point."""
    if target in AXES:
        record[target.upper()] = np.rint((column - record.offsets[AXES.index(target)]) / SCALE)
    elif target == "intensity":
        warn_above(65_535 / WHITE, column, "LAS's intensity")
        steps = np.minimum(column, np.float32(65_535 / WHITE)) * WHITE
        record[target] = _round(name, column, steps, "numbers >= 0", first, low=0, high=65_535)
    elif target == "scan_angle":
        steps = column / ANGLE
        record[target] = _round(name, column, steps, "angles from -π to π", first, low=-30_000, high=30_000)
    else:
        standard = {dimension.name: dimension for dimension in record.point_format.standard_dimensions}
        if target not in standard:
            record.array[target] = column  # on the record itself, names such as scales mean something else
            return
        if target != "gps_time":
            most = 2 ** standard[target].num_bits - 1
            column = integers(name, column, np.uint16, f"LAS's {target}", at_most=most, first=first)
        record[target] = column


def _round(
    name: str, values: npt.NDArray[Any], steps: npt.NDArray[Any], expected: str, first: int, *, low: int, high: int
) -> npt.NDArray[Any]:
    """Return the steps rounded, after checking that each is within `low` to `high`; errors show `values`."""
    rounded: npt.NDArray[Any] = np.rint(steps)
    wrong = ~((rounded >= low) & (rounded <= high))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise FileFormatError(f"{name}: expected {expected}, got {name}[{first + i}] = {values[i]:g}")
    return rounded


def _open(file: BinaryIO) -> Any:
    """Return laspy's reader of a file, after checking the claims of the file that laspy would trust."""
    laspy = _import(compress=False)
    size = os.fstat(file.fileno()).st_size
    file.seek(0)
    _check_head(file.read(104), size)
    file.seek(0)
    reader = laspy.LasReader(file, closefd=False, laz_backend=laspy.LazBackend.Lazrs, read_evlrs=False)
    header = reader.header
    unreadable = {"scales", "offsets"} & set(header.point_format.extra_dimension_names)
    if unreadable:  # laspy puts its own numbers there
        raise FileFormatError(f"it has a dimension named {min(unreadable)!r}, which laspy cannot read")
    if header.are_points_compressed and header.point_count:
        _import(compress=True)
        with _panics():
            _check_chunks(file, size, header)
    elif header.point_count * header.point_format.size > size - header.offset_to_point_data:
        points = (size - header.offset_to_point_data) // header.point_format.size
        raise FileFormatError(f"it is truncated: {points} of {header.point_count} points")
    return reader


def _pieces(file: BinaryIO, reader: Any) -> Iterator[Fields]:
    """Yield the dimensions of the points piece by piece; at least one piece."""
    laspy = _import(compress=False)
    header, size = reader.header, os.fstat(file.fileno()).st_size
    yield _dimensions(laspy.ScaleAwarePointRecord.zeros(0, header=header))
    read = 0
    while read < header.point_count:
        with _panics() if header.are_points_compressed else nullcontext():
            points = reader.read_points(BLOCK)
        if not points:
            raise FileFormatError(f"it is truncated: {read} of {header.point_count} points")
        read += len(points)
        check_expansion(read * header.point_format.size, size)
        yield _dimensions(points)


def _check_head(head: bytes, size: int) -> None:
    """Check the claims of the header that laspy would trust."""
    if len(head) < 104 or not head.startswith(b"LASF"):
        raise FileFormatError("it does not begin as a LAS file does")
    if head[24] != 1 or head[25] > 4:
        raise FileFormatError(f"it is of the unknown version {head[24]}.{head[25]}")
    start, points, records = struct.unpack("<HII", head[94:104])
    if not start <= points <= size or records * 54 > points - start:  # a record takes at least 54 bytes
        raise FileFormatError(f"it is truncated: its header claims points at byte {points} after {records} records")


def _check_chunks(file: BinaryIO, size: int, header: Any) -> None:
    """Check the sizes that a LAZ file claims and lazrs would allocate; a failed allocation ends the process.

    The point data begin with the offset of the chunk table. From point format 6 on, a chunk holds one point, the number
    of its points, the sizes of its layers and the layers: 9 for the point, those of colours and wave packets, and one
    per extra byte. Format: LASzip, https://github.com/LASzip/LASzip.
    """
    lazrs = import_extra("lazrs", "formats", "LAZ files")
    records = header.vlrs.get("LasZipVlr")
    each, start, here = header.point_format.size, header.offset_to_point_data, file.tell()
    if not records or lazrs.LazVlr(records[0].record_data).item_size() != each:
        raise FileFormatError("its description of the compression does not fit its points")
    if records[0].record_data[:2] == b"\x01\0":  # written before 2011: one stream, without chunks
        data = records[0].record_data  # lazrs obeys the chunk size even here: set one that no file reaches
        records[0].record_data = data[:12] + b"\xfe\xff\xff\xff" + data[16:]
        return
    file.seek(start)
    table = int.from_bytes(file.read(8), "little", signed=True)
    if table == -1:  # written as a stream: the offset is at the end of the file
        file.seek(-8, os.SEEK_END)
        table = int.from_bytes(file.read(8), "little", signed=True)
    if not start + 8 <= table <= size - 8:
        raise FileFormatError("it is truncated: its chunk table is missing")
    file.seek(table + 4)
    if int.from_bytes(file.read(4), "little") * each > size:
        raise FileFormatError("its table claims more chunks than the file has bytes for")
    file.seek(start)
    chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(records[0].record_data))
    points, place = sum(count for count, _ in chunks), start + 8
    if points < header.point_count or place + sum(length for _, length in chunks) > table:
        raise FileFormatError(f"it is truncated: {points} of {header.point_count} points")
    if header.point_format.id >= 6:
        layers = 9 + {7: 1, 8: 2, 9: 1, 10: 3}.get(header.point_format.id, 0) + header.point_format.num_extra_bytes
        for _, length in chunks:
            file.seek(place + each + 4)
            sizes = np.frombuffer(file.read(4 * layers), "<u4")
            if len(sizes) < layers or each + 4 + 4 * layers + int(sizes.sum(dtype=np.uint64)) != length:
                raise FileFormatError("it is truncated inside a chunk")
            place += length
    file.seek(here)


def _dimensions(points: Any) -> Fields:
    """Return the dimensions of a piece in lidarsim's names and units, extra dimensions last."""
    ours = {theirs: name for name, theirs in NAMES.items()}
    columns: Fields = {axis: np.array(points[axis], np.float64) for axis in "xyz"}
    for dimension in points.point_format.standard_dimensions:
        name, values = dimension.name, np.array(points[dimension.name])
        if name == "intensity":
            values = (values / WHITE).astype(np.float32)
        elif name == "scan_angle":
            values = values * ANGLE
        elif name == "scan_angle_rank":
            name, values = "scan_angle", np.radians(values.astype(np.float64))
        if name not in {"X", "Y", "Z"}:
            columns[ours.get(name, name)] = values
    for dimension in points.point_format.extra_dimensions:
        name = dimension.name
        values = np.array(points[name] if dimension.is_scaled else points.array[name])
        while name in columns or f"{name}.0" in columns:
            name += " 2"
        if values.ndim == 2:
            columns |= {f"{name}.{i}": values[:, i] for i in range(values.shape[1])}
        else:
            columns[name] = values
    return columns


def _import(compress: bool) -> ModuleType:
    if compress:
        import_extra("lazrs", "formats", "LAZ files")
    return import_extra("laspy", "formats", "LAS files")


@contextmanager
def _panics() -> Iterator[None]:
    """Turn a panic of lazrs, which is no `Exception`, into an error.

    Rust reports it on standard error, too, which is that of all threads: only the owner of the process may redirect it.
    """
    try:
        yield
    except BaseException as error:
        if type(error).__name__ != "PanicException":
            raise
        raise FileFormatError(f"its compressed data is damaged: {error}") from None


for suffix in SUFFIXES:
    register_format(suffix, save=partial(save, compress=suffix == ".laz"), load=load, signature=b"LASF")
