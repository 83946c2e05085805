"""The columns of scans, batches and point clouds: the one table of their names, types, units and meaning.

Attributes, dtypes and documentation of `Scan`, `ScanBatch` and `PointCloud` follow from it. The core has a table of the
columns that it computes, `measure/columns.rs`; `tests/test_scan.py` checks that it agrees with this one.
"""

import inspect
import math
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, Never, TypeAlias, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

F32: TypeAlias = NDArray[np.float32]
F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
U8: TypeAlias = NDArray[np.uint8]
U16: TypeAlias = NDArray[np.uint16]
U32: TypeAlias = NDArray[np.uint32]

DTYPES: dict[Any, type[np.number[Any]]] = {
    F32: np.float32,
    F64: np.float64,
    I32: np.int32,
    U8: np.uint8,
    U16: np.uint16,
    U32: np.uint32,
}
"""The dtype of each annotation: what an alias of NumPy's is made of differs between its versions."""

Absent = TypeVar("Absent")
"""Type of a column that an object lacks: None, or Never if it then has no such attribute."""

Class = TypeVar("Class", bound="type[HasColumns]")


@dataclass(frozen=True, slots=True)
class Column:
    """Properties of a column besides its name. `meaning`, the unit and `more` make up its documentation."""

    meaning: str
    unit: str = ""
    more: str = ""
    shape: tuple[int, ...] = ()  # of an entry
    unused: float = math.nan  # in the unused entries of scans and batches
    of_returns: bool = True  # an entry for each return, or for each pulse
    condition: str = ""  # when a scan or a cloud has the column, if not always
    dtype: type[np.number[Any]] = np.float64  # as annotated

    def document(self, name: str, axes: str, lacking: str) -> str:
        """Return the lines of the column for the numpydoc docstring of a class; see `with_columns`."""
        shape = ", ".join([axes if self.of_returns else axes.removesuffix(", k"), *map(str, self.shape)])
        kind = f"ndarray of {self.dtype.__name__}, shape ({shape}{'' if ', ' in shape else ','})"
        sentences = [f"{self.meaning}{self.unit and f', {self.unit}'}.", self.more]
        if "k" in axes and not math.isnan(self.unused):
            sentences.append(f"Unused entries are {self.unused}.")
        if self.condition and lacking:
            sentences.append(f"{lacking} unless {self.condition}.")
            kind += ", or None" if lacking == "None" else ""
        text = textwrap.wrap(" ".join(filter(None, sentences)), 112)
        return "".join([f"{name} : {kind}\n", *(f"    {line}\n" for line in text)])


declare: Any = Column
"""A column in a class body, whose annotation is that of the attribute."""


class HasColumns:
    """Base of classes with columns: collects what a class body declares into the table `_columns`."""

    __slots__ = ()
    _columns: ClassVar[dict[str, Column]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        own = {name: value for name, value in vars(cls).items() if isinstance(value, Column)}
        tables = [getattr(base, "_columns", {}) for base in reversed(cls.__bases__)]
        cls._columns = {name: known for table in tables for name, known in table.items()}
        for name, known in own.items():
            kind: Any = cls.__annotations__[name]
            array = get_args(kind)[0] if get_origin(kind) is Union else kind
            cls._columns[name] = replace(known, dtype=DTYPES[array])
            delattr(cls, name)


class Positions(HasColumns):
    """The column that only batches and clouds have."""

    __slots__ = ()

    xyz: F64 = declare("Position", "m", "It is nan in a batch where there is no return; it may be in a cloud.", (3,))


class ReturnColumns(HasColumns, Generic[Absent]):
    """The columns that scans, batches and clouds have."""

    __slots__ = ()

    range: F64 = declare("Measured distance from the beam's origin along the pulse", "m")
    true_range: F64 = declare(
        "Distance along the actual direction of the pulse",
        "m",
        "Its relative error is at most 2.3e-16: two roundings, of the ray parameter and of its product with the length "
        "of the direction; each mirror on the way adds up to 1.2e-16. Of echoes of the air, it is the range before "
        "errors; of false returns, nan.",
    )
    intensity: F32 = declare("Received intensity; 1 is a perfect white diffuser at normal incidence")
    return_count: U8 = declare("Number of returns of the pulse", unused=0, of_returns=False)
    object_id: I32 = declare("Id of the object that was hit", unused=-1)
    instance: U32 = declare("Instance of that object, shared by all its parts", unused=0)
    label: U32 = declare(
        "Label of that object, of the face that was hit, or of the `Atmosphere`",
        more='The array compares with class names, too, ``label == "car"``; a single label is a number.',
        unused=0,
    )
    source: U8 | Absent = declare(
        "`Source` of the return",
        more="Returns without a surface have `object_id` -1, `instance` 0, and no `normal`, `incidence` and "
        "`radial_velocity`: these are nan. False returns have `label` 0 and no `true_range` and `range_error`.",
        unused=255,
        condition="the sensor has `false_returns` or the air has echoes",
    )
    path: U8 | Absent = declare(
        "Number of surfaces that the light of the return passed, or was mirrored by, before it came to this one",
        more="It is 0 for the first surface, and 255 for echoes of the air and false returns.",
        unused=255,
        condition="`Measurement.depth` exceeds 1",
    )
    normal: F32 = declare(
        "Unit outward normal of the surface",
        more="A cloud has it in the frame of its points, a scan or batch in world coordinates.",
        shape=(3,),
    )
    incidence: F32 = declare("Angle between pulse and normal", "rad", "It is at most π/2.")
    range_error: F64 = declare("Measured minus true range", "m")
    radial_velocity: F32 | Absent = declare(
        "Rate of change of the true range",
        "m/s",
        "An FMCW lidar measures it: the velocity of the surface point relative to the beam's origin, along the actual "
        "direction of the pulse.",
        condition="the sensor or an object moves",
    )


class ScanColumns(ReturnColumns[Absent]):
    """The columns of scans."""

    __slots__ = ()

    status: U8 = declare("`Status` of the pulse", unused=255, of_returns=False)
    true_direction: F64 | Absent = declare(
        "Direction from the beam's origin to the true point of the return, in the sensor frame",
        more="Without this column, it is the nominal direction of the pulse.",
        shape=(3,),
        condition="the sensor has angular jitter or a beam",
    )
    mirrored_point: F64 | Absent = declare(
        "Where mirrored light comes from, in the sensor frame at the time of the pulse",
        "m",
        "It is nan for all other returns.",
        shape=(3,),
        condition="something in the scene mirrors and `Measurement.depth` exceeds 1",
    )


class PointColumns(ReturnColumns[Never], Positions):
    """The columns of clouds."""

    __slots__ = ()

    time: F64 = declare("Firing time since the start of the scan", "s")
    ring: U16 = declare("Channel that fired")
    column: U32 = declare("Column (firing cycle) of the frame")
    return_number: U8 = declare("Which return of its pulse the point is, counted from 1")


def with_columns(axes: str, *, lacking: str = "") -> Callable[[Class], Class]:
    """Return a decorator that annotates and documents a class with its columns.

    `axes` names the axes of the arrays, such as "n, k" with k returns per pulse. `lacking` says what replaces a column
    whose condition is not met: "None", which becomes the default; "Absent"; or "" if the class says so itself.
    """

    def decorate(cls: Class) -> Class:
        array_of: Any = NDArray
        kinds = {name: array_of[known.dtype] for name, known in cls._columns.items()}
        for name in [name for name in kinds if lacking == "None" and cls._columns[name].condition]:
            kinds[name] |= None
            setattr(cls, name, None)
        cls.__annotations__ = kinds | cls.__annotations__
        head, title, rest = inspect.cleandoc(cls.__doc__ or "").partition("Attributes\n----------\n")
        if title:
            lines = (known.document(name, axes, lacking) for name, known in cls._columns.items())
            cls.__doc__ = "".join([head, title, *lines, rest])
        return cls

    return decorate
