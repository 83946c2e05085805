"""The core in Rust. Private: use the classes of lidarsim."""

from collections.abc import Sequence
from typing import Any, Self, TypeVar, final

import numpy as np
import numpy.typing as npt
from typing_extensions import disjoint_base

from lidarsim.materials import Material
from lidarsim.motion.trajectory import Trajectory
from lidarsim.world import shapes

__all__ = [
    "Affine",
    "Channels",
    "Path",
    "Receiver",
    "Scene",
    "SceneObject",
    "Shape",
    "Texture",
    "TextureMap",
    "__version__",
    "air_echoes",
    "are_plain_points",
    "coverage",
    "expect_room",
    "fire_mid360",
    "fire_oscillating_mirror",
    "fire_palmer",
    "fire_polar",
    "fire_risley",
    "first_not_rigid",
    "is_plain_pose",
    "isa",
    "normal_quantile",
    "philox",
    "place",
    "plain_matrix",
    "plain_vector",
    "points_of",
    "scan",
    "scan_columns",
    "scan_many",
    "self_crossing",
    "set_threads",
    "threads",
    "waveforms",
]

__version__: str

_Point = Sequence[float]

_Item = TypeVar("_Item", bound="SceneObject")

@final
class Affine:
    def __new__(cls, rows: list[list[float]]) -> Affine: ...
    @staticmethod
    def plain(matrix: object) -> Affine | None: ...

@final
class Shape:
    def __new__(cls, name: str, arguments: dict[str, tuple[float, ...]]) -> Shape: ...
    @staticmethod
    def plain(name: str, vectors: dict[str, npt.ArrayLike], numbers: dict[str, float]) -> Shape | None: ...
    @staticmethod
    def triangle_mesh(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.uint32], whole: bool) -> Shape: ...
    @staticmethod
    def spheres(rows: npt.NDArray[np.float64]) -> Shape: ...
    @staticmethod
    def disks(rows: npt.NDArray[np.float64]) -> Shape: ...
    def deformed(self, vertices: npt.NDArray[np.float64]) -> Shape: ...
    def rows(self) -> npt.NDArray[np.float64]: ...
    def transformed(self, transform: Affine) -> Shape: ...
    def transform(self) -> npt.NDArray[np.float64] | None: ...
    def arguments(self) -> dict[str, tuple[float, ...]]: ...
    def vertices(self) -> npt.NDArray[np.float64]: ...
    def faces(self) -> npt.NDArray[np.uint32]: ...
    def primitives(self) -> int: ...
    def bounds(self) -> npt.NDArray[np.float64]: ...
    def degenerate(self) -> int: ...
    def bytes(self) -> int: ...
    def roots(
        self, origins: npt.NDArray[np.float64], directions: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]: ...

@final
class Texture:
    def __new__(cls, values: npt.NDArray[np.float32], wrap_u: str, wrap_v: str, interpolation: str) -> Texture: ...
    def values(self) -> npt.NDArray[np.float32]: ...
    def map(self, coordinates: npt.NDArray[np.float64]) -> TextureMap: ...

@final
class TextureMap:
    def coordinates(self) -> npt.NDArray[np.float64]: ...

@disjoint_base
class SceneObject:
    def __new__(
        cls,
        id: int,  # noqa: A002 - the name of the field
        shape: shapes.Shape,
        name: str,
        label: int | npt.NDArray[np.uint32],
        instance: int,
        material: Material,
        transform: Affine | None,
        motion: Trajectory | None,
        like: SceneObject | None = None,
    ) -> Self: ...
    @property
    def id(self) -> int: ...
    @property
    def shape(self) -> shapes.Shape: ...
    @property
    def name(self) -> str: ...
    @property
    def label(self) -> int | npt.NDArray[np.uint32]: ...
    @property
    def instance(self) -> int: ...
    @property
    def material(self) -> Material: ...
    @property
    def transform(self) -> npt.NDArray[np.float64] | None: ...
    @property
    def motion(self) -> Trajectory | None: ...
    @property
    def bounds(self) -> npt.NDArray[np.float64]: ...
    def looks_like(self, other: SceneObject) -> bool: ...

@final
class Scene:
    def __new__(cls, items: list[SceneObject], like: Scene | None = None) -> Scene: ...
    @staticmethod
    def of_shape(shape: Shape) -> Scene: ...
    def expect_instances(self, ignored: npt.NDArray[np.int64]) -> None: ...
    def prepare(self) -> None: ...
    def cast(
        self,
        origins: npt.NDArray[np.float64],
        directions: npt.NDArray[np.float64],
        t_min: float,
        t_max: float,
        times: npt.NDArray[np.float64] | None,
        ignored: npt.NDArray[np.int64] | None = None,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.float64]]: ...
    def cast_all(
        self,
        origins: npt.NDArray[np.float64],
        directions: npt.NDArray[np.float64],
        t_min: float,
        t_max: float,
        times: npt.NDArray[np.float64] | None,
        most: int,
        ignored: npt.NDArray[np.int64] | None = None,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.float64]]: ...
    def occluded(
        self,
        origins: npt.NDArray[np.float64],
        directions: npt.NDArray[np.float64],
        t_min: float,
        t_max: float,
        times: npt.NDArray[np.float64] | None,
        ignored: npt.NDArray[np.int64] | None = None,
    ) -> npt.NDArray[np.bool_]: ...

@final
class Path:
    @staticmethod
    def still(matrix: npt.NDArray[np.float64] | Sequence[_Point]) -> Path: ...
    @staticmethod
    def twist(matrix: Sequence[_Point], linear: _Point, angular: _Point) -> Path: ...
    @staticmethod
    def knots(
        times: npt.NDArray[np.float64], matrices: npt.NDArray[np.float64], steps: npt.NDArray[np.float64]
    ) -> Path: ...
    def mounted(self, matrix: Sequence[_Point]) -> Path: ...
    def hold(self, until: float) -> Path: ...
    def span(self) -> tuple[float, float]: ...
    def at(self, times: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
    def velocity(self, times: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...

def scan(
    scene: Scene,
    path: Path,
    pulses: object,
    indices: npt.NDArray[np.uint64] | None,
    lidar: object,
    start: float,
    draws: tuple[int, int, int],
    atmosphere: object = None,
    ignored: npt.NDArray[np.int64] | None = None,
) -> dict[str, npt.NDArray[Any]]: ...
def waveforms(
    scene: Scene,
    path: Path,
    pulses: object,
    indices: npt.NDArray[np.uint64] | None,
    lidar: object,
    start: float,
    draws: tuple[int, int, int],
    period: float,
    max_range: float,
    atmosphere: object = None,
    ignored: npt.NDArray[np.int64] | None = None,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.float32]]: ...
def scan_many(
    scenes: list[Scene],
    atmospheres: list[Any],
    shots: list[tuple[object, object, int]],
    poses: npt.NDArray[np.float64] | list[Path],
    rows: object,
    pulses: int,
    most: int,
    columns: dict[str, npt.NDArray[Any]],
) -> None: ...
def scan_columns() -> dict[str, tuple[np.dtype[Any], tuple[int, ...], bool, npt.NDArray[Any]]]: ...
def expect_room(pulses: int, lidar: object, atmosphere: object = None) -> None: ...
def coverage(
    scene: Scene,
    path: Path,
    pulses: object,
    start: float,
    instances: tuple[npt.NDArray[np.uint32], int],
    asked: tuple[Scene, npt.NDArray[np.uint32]],
    max_range: float,
    returns: tuple[npt.NDArray[np.int32], npt.NDArray[np.uint8]],
    first: npt.NDArray[np.int32] | None,
) -> tuple[npt.NDArray[np.uint64], npt.NDArray[np.uint64], npt.NDArray[np.uint64], npt.NDArray[np.float64]]: ...
def air_echoes(lidar: object, atmosphere: object) -> tuple[tuple[float, float] | None, tuple[float, float]]: ...

@final
class Receiver:
    def __new__(cls, lidar: object) -> Receiver: ...

@final
class Channels:
    def __new__(
        cls,
        beams: npt.NDArray[np.float64],
        firing_times: npt.NDArray[np.float64],
        origins: npt.NDArray[np.float64] | None = None,
    ) -> Channels: ...
    def fire(
        self,
        runs: Sequence[tuple[int, float, float, float]],
        clock: Sequence[float],
        azimuth: Sequence[float],
        directions: npt.NDArray[np.float64],
        times: npt.NDArray[np.float64],
        origins: npt.NDArray[np.float64] | None = None,
    ) -> None: ...

def fire_mid360(fast: tuple[int, int], tick: int, directions: npt.NDArray[np.float64]) -> None: ...
def fire_oscillating_mirror(
    field_of_view: float, turn: float, turns: tuple[int, int], directions: npt.NDArray[np.float64]
) -> None: ...
def fire_palmer(half_angle: float, turns: tuple[int, int], directions: npt.NDArray[np.float64]) -> None: ...
def fire_polar(
    azimuths: npt.NDArray[np.float64], elevations: npt.NDArray[np.float64], directions: npt.NDArray[np.float64]
) -> None: ...
def fire_risley(
    beams: npt.NDArray[np.float64],
    prisms: Sequence[tuple[Sequence[float], tuple[int, int], float]],
    refractive_index: float,
    directions: npt.NDArray[np.float64],
) -> bool: ...
def first_not_rigid(matrices: npt.NDArray[np.float64], tolerance: float) -> tuple[int, float, float] | None: ...
def is_plain_pose(value: object, tolerance: float) -> bool: ...
def are_plain_points(origins: object, directions: object) -> bool: ...
def points_of(
    scan: object,
    path: Path,
    frame: str,
    moment: float | None,
    fields: list[str] | None,
    movers: tuple[Scene, npt.NDArray[np.int32], float] | None,
) -> dict[str, npt.NDArray[Any]]: ...
def philox(counters: npt.NDArray[np.uint32], key: Sequence[int]) -> npt.NDArray[np.uint32]: ...
def normal_quantile(p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def place(items: list[_Item], transforms: npt.NDArray[np.float64]) -> list[_Item]: ...
def self_crossing(outline: npt.NDArray[np.float64]) -> tuple[int, int] | None: ...
def plain_matrix(value: object) -> list[list[float]] | None: ...
def plain_vector(value: object) -> tuple[float, float, float] | None: ...
def threads() -> int: ...
def set_threads(count: int | None) -> None: ...
def isa() -> str: ...
