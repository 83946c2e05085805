"""nuScenes: the tables of a version, points of key frames, classes of lidarseg and boxes; in world coordinates.

Format: https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from lidarsim._base.files import beside, check_regular, parsing
from lidarsim._base.validation import Floats
from lidarsim._base.vectors import transforms
from lidarsim.datasets.frames import Frame, Frames, Row, boxes_at, folders, name_classes, text_of, validate
from lidarsim.errors import FileFormatError
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.pointcloud import PointCloud, with_common_fields

Three = Annotated[tuple[float, ...], Field(min_length=3, max_length=3)]
Four = Annotated[tuple[float, ...], Field(min_length=4, max_length=4)]


class Token(Row):
    """Row of ``instance``, ``scene``, ….

    Attributes
    ----------
    token : str
        Key of the row.
    """

    token: str


class Scene(Token):
    """Row of ``scene``."""

    first_sample_token: str


class Sample(Token):
    """Row of ``sample``."""

    next: str
    timestamp: int


class Data(Token):
    """Row of ``sample_data``."""

    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    is_key_frame: bool
    filename: str


class Placed(Token):
    """Row of ``ego_pose`` and ``calibrated_sensor``; the quaternion has the scalar first."""

    translation: Three
    rotation: Four


class Mounted(Placed):
    """Row of ``calibrated_sensor``."""

    sensor_token: str


class Sensor(Token):
    """Row of ``sensor``."""

    modality: str


class Category(Token):
    """Row of ``category``; only lidarseg has an index."""

    name: str
    index: Annotated[int, Field(ge=0, le=255)] | None = None


class Instance(Token):
    """Row of ``instance``."""

    category_token: str


class Annotation(Placed):
    """Row of ``sample_annotation``; the size is width, length and height."""

    sample_token: str
    instance_token: str
    size: Three
    num_lidar_pts: Annotated[int, Field(ge=0, lt=2**63)]


class Seg(Row):
    """Row of ``lidarseg``."""

    sample_data_token: str
    filename: str


def recognise(folder: Path) -> bool:
    """Return whether a folder has the tables of a version."""
    return bool(_versions(folder))


def open_frames(folder: Path) -> Frames:
    """Return the samples of all scenes of the first version, in their order, with the points of all lidars."""
    versions = _versions(folder)
    tables = _Tables(folder, versions[0])
    others = ", ".join(path.name for path in versions[1:])
    note = f"{versions[0].name} only; there are also {others}" if others else ""
    return Frames(
        "nuScenes",
        len(tables.samples),
        lambda first: name_classes(tables.read(first), tables.names),
        tables.names,
        note,
    )


def _versions(folder: Path) -> list[Path]:
    return [path for path in folders(folder) if (path / "sample_data.json").is_file()]


class _Tables:
    """The rows that pictures need."""

    def __init__(self, folder: Path, version: Path) -> None:
        self.folder, self.version = folder, version
        categories = self._table("category", Category)
        labels = {row.token: i if row.index is None else row.index for i, row in enumerate(categories)}
        self.names = {labels[row.token]: row.name for row in categories}
        instances = self._table("instance", Instance)
        self.instances = {row.token: number for number, row in enumerate(instances, 1)}
        self.labels = {row.token: self._of(labels, row.category_token, "instance") for row in instances}
        samples = self._key("sample", Sample)
        self.samples: list[Sample] = []
        seen = set[str]()
        for scene in self._table("scene", Scene):
            token = scene.first_sample_token
            while token:
                if token in seen:
                    raise FileFormatError(
                        f"{self._path('sample')}: expected a chain of samples per scene, got one sample twice"
                    )
                seen.add(token)
                self.samples.append(self._of(samples, token, "scene"))
                token = self.samples[-1].next
        lidars = {row.token for row in self._table("sensor", Sensor) if row.modality == "lidar"}
        mounts = self._table("calibrated_sensor", Mounted)
        self.mounts = {row.token: _matrix(row) for row in mounts if row.sensor_token in lidars}
        self.bodies = self._key("ego_pose", Placed)
        self.data: dict[str, list[Data]] = defaultdict(list)
        for row in self._table("sample_data", Data):
            if row.is_key_frame and row.calibrated_sensor_token in self.mounts:
                self.data[row.sample_token].append(row)
        self.annotations: dict[str, list[Annotation]] = defaultdict(list)
        for box in self._table("sample_annotation", Annotation):
            self.annotations[box.sample_token].append(box)
        self.classes: dict[str, str] = {}
        if self._path("lidarseg").is_file():
            self.classes = {row.sample_data_token: row.filename for row in self._table("lidarseg", Seg)}

    def read(self, first: int) -> Iterator[Frame]:
        """Yield the samples from a number on."""
        for sample in self.samples[first:]:
            rows = self.data[sample.token]
            if not rows:
                raise FileFormatError(f"{self._path('sample_data')}: expected points of each sample, got none of one")
            bodies = [_matrix(self._of(self.bodies, row.ego_pose_token, "sample_data")) for row in rows]
            poses = [body @ self.mounts[row.calibrated_sensor_token] for body, row in zip(bodies, rows, strict=True)]
            clouds = [self._cloud(row).transformed(pose) for row, pose in zip(rows, poses, strict=True)]
            time = (sample.timestamp - self.samples[0].timestamp) / 1e6
            cloud = PointCloud.concatenate(with_common_fields(clouds))
            yield Frame(cloud, bodies[0], time, self._boxes(self.annotations[sample.token]))

    def _cloud(self, row: Data) -> PointCloud:
        cloud = PointCloud.load(self._file(row.filename, "sample_data"))
        if row.token in self.classes:
            path = self._file(self.classes[row.token], "lidarseg")
            check_regular(path)
            label = np.frombuffer(path.read_bytes(), np.uint8)
            if len(label) != len(cloud):
                expected = f"a class for each of the {len(cloud):,} points"
                raise FileFormatError(f"{path}: expected {expected}, got {len(label):,}")
            cloud.label = label.astype(np.uint32)
        return cloud

    def _boxes(self, rows: list[Annotation]) -> Boxes:
        places = np.array([_matrix(row) for row in rows]).reshape(-1, 4, 4)
        sizes = np.array([row.size for row in rows]).reshape(-1, 3)[:, [1, 0, 2]]
        instances = [self._of(self.instances, row.instance_token, "sample_annotation") for row in rows]
        labels = [self.labels[row.instance_token] for row in rows]
        points = [row.num_lidar_pts for row in rows]
        return boxes_at(
            places[:, :3, 3], sizes, places[:, :3, :3], labels, self.names, instance=instances, points=points
        )

    def _path(self, table: str) -> Path:
        return self.version / f"{table}.json"

    def _table(self, table: str, kind: type[Row]) -> list[Any]:
        path = self._path(table)
        text = text_of(path)
        with parsing(path, "table of nuScenes"):
            rows = json.loads(text)
        found: list[Any] = validate(list[kind], rows, path)  # type: ignore[valid-type]
        return found

    def _key(self, table: str, kind: type[Token]) -> dict[str, Any]:
        return {row.token: row for row in self._table(table, kind)}

    def _of(self, rows: dict[str, Any], token: str, table: str) -> Any:
        """Return the row with a token that a table names."""
        if token not in rows:
            raise FileFormatError(f"{self._path(table)}: expected tokens of rows that exist, got {token[:40]!a}")
        return rows[token]

    def _file(self, name: str, table: str) -> Path:
        """Return a file that a table names, which must be inside of the data set."""
        path = self._path(table)
        with parsing(path, "table of nuScenes"):
            return beside(self.folder / self.version.name, name)


def _matrix(row: Placed) -> Floats:
    from scipy.spatial.transform import Rotation

    if not any(row.rotation):
        raise FileFormatError(f"{row.token[:40]!a}: expected a rotation, got a quaternion of zeros")
    return transforms(Rotation.from_quat(row.rotation, scalar_first=True).as_matrix(), row.translation)
