"""Labels of SemanticKITTI, as its scan class reads them: class = label & 0xFFFF, instance = label >> 16."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.io.semantickitti import read_labels
from lidarsim.scan.pointcloud import PointCloud

assert io, "the formats register themselves on import"

COUNT = 40_000
XYZ = np.zeros((2, 3))


def test_layout(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    label, instance = rng.integers(0, 2**16, (2, COUNT))
    PointCloud(xyz=np.zeros((COUNT, 3)), label=label, instance=instance, object_id=instance % 7).save(
        tmp_path / "a.label"
    )
    both = np.fromfile(tmp_path / "a.label", np.uint32)
    np.testing.assert_array_equal(both & 0xFFFF, label)
    np.testing.assert_array_equal(both >> 16, instance)
    got = read_labels(tmp_path / "a.label")
    assert [part.dtype for part in got] == [np.uint32, np.uint32]
    np.testing.assert_array_equal(got, [label, instance])


@pytest.mark.parametrize(
    ("fields", "instances"),
    [({}, [0, 0]), ({"object_id": [-1, 65534]}, [0, 65535]), ({"object_id": [5, 6], "instance": [8, 9]}, [8, 9])],
)
def test_where_the_instance_comes_from(fields: dict[str, Any], instances: list[int], tmp_path: Path) -> None:
    PointCloud(xyz=XYZ, label=[10, 252], **fields).save(tmp_path / "a.label")
    assert np.transpose(read_labels(tmp_path / "a.label")).tolist() == [[10, instances[0]], [252, instances[1]]]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"label": [0, 65536]}, "label: expected 0 to 65535 for a class of SemanticKITTI, got label[1] = 65536"),
        (
            {"label": [0, 0], "instance": [0, 65536]},
            "instance: expected 0 to 65535 for an instance of SemanticKITTI, got instance[1] = 65536",
        ),
        (
            {"label": [0, 0], "object_id": [65535, 0]},
            "instance: expected 0 to 65535 for an instance of SemanticKITTI, got instance[0] = 65536",
        ),
        ({"label": [0, 0], "object_id": [2**31 - 1, 0]}, "instance: expected 0 to 65535 for an instance"),
        ({"ring": [1, 2]}, "label: expected a label for each point, got only xyz, ring"),
    ],
)
def test_what_does_not_fit(fields: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError) as caught:
        PointCloud(xyz=XYZ, **fields).save(tmp_path / "a.label")
    assert str(caught.value).startswith(message)
    assert not list(tmp_path.iterdir())


def test_labels_are_no_cloud(tmp_path: Path) -> None:
    path = tmp_path / "a.label"
    PointCloud(xyz=XYZ, label=[1, 2]).save(path)
    with pytest.raises(FileFormatError, match="it has labels and no points: load the"):
        PointCloud.load(path)
    path.write_bytes(b"12345")
    with pytest.raises(FileFormatError) as caught:
        read_labels(path)
    assert str(caught.value) == f"{path}: not a readable .label file: its 5 bytes are not a multiple of 4"
