"""SemanticKITTI labels (``.label``): one uint32 per point, class in the low 16 bits, instance in the high 16.

The class is `label`. The instance is `instance` if the cloud has it, else `object_id` + 1, else 0, SemanticKITTI's
value for none. Each must fit in 16 bits. The points are in a ``.bin`` of the same name, written by `lidarsim.io.kitti`.

Format: https://github.com/PRBonn/semantic-kitti-api.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np
import numpy.typing as npt

from lidarsim._base.files import PathLike, check_regular
from lidarsim.errors import FileFormatError
from lidarsim.io._units import integers
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format

__all__ = ["read_labels"]


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the labels one after the other."""
    if "label" not in fields:
        raise FileFormatError(f"label: expected a label for each point, got only {', '.join(fields)}")
    label = integers("label", fields["label"], np.uint16, "a class of SemanticKITTI")
    instance = fields.get("instance", fields.get("object_id", np.array(-1, np.int32)) + 1)
    both = integers("instance", np.atleast_1d(instance), np.uint16, "an instance of SemanticKITTI").astype("<u4")
    file.write((both << 16 | label).astype("<u4").data)


def load(_: BinaryIO) -> NoReturn:
    """Raise an error, since the file has no points."""
    raise FileFormatError(
        "it has labels and no points: load the .bin of the same name, and lidarsim.io.semantickitti.read_labels"
    )


def read_labels(path: PathLike) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
    """Read the classes and instances of the points of a scan.

    Parameters
    ----------
    path : path-like
        A ``.label`` file.

    Returns
    -------
    label, instance : ndarray of uint32, shape (n,)
        Class and instance of each point, 0 to 65535: ``cloud.label, cloud.instance = read_labels(path)``.

    Raises
    ------
    FileFormatError
        If the size of the file is not a multiple of 4 bytes.
    OSError
        If it cannot be read.
    """
    check_regular(path)
    data = Path(path).read_bytes()
    if len(data) % 4:
        raise FileFormatError(f"{path}: not a readable .label file: its {len(data)} bytes are not a multiple of 4")
    halves = np.frombuffer(data, "<u2").reshape(-1, 2).astype(np.uint32)
    return halves[:, 0], halves[:, 1]


register_format(".label", save=save, load=load)
