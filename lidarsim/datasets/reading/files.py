"""Point cloud files: one, or those of a folder; ``.label`` files beside them are SemanticKITTI's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from lidarsim.datasets.frames import Frame, Frames, load_labelled, point_files
from lidarsim.errors import LidarsimError
from lidarsim.viewers._classes import LAS_CLASSES, SEMANTIC_KITTI


def open_frames(path: Path) -> Frames:
    """Return the clouds of a folder, sorted by name, or a single one."""
    files = point_files(path) if path.is_dir() else [path]
    if not files:
        raise LidarsimError(f"{path}: expected a data set or a folder of point clouds, got neither")

    def read(first: int) -> Iterator[Frame]:
        for file in files[first:]:
            labels = file.with_suffix(".label")
            cloud = load_labelled(file, labels)
            if "label" in cloud.fields:
                known: Mapping[int, str] = {}
                if file.suffix.lower() in {".las", ".laz"}:
                    known = LAS_CLASSES
                elif labels.exists():
                    known = {label: name for label, (name, _) in SEMANTIC_KITTI.items()}
                found = np.unique(cloud.label).tolist()
                cloud.class_names = {label: known[label] for label in found if label in known} | dict(cloud.class_names)
            yield Frame(cloud)

    return Frames("point clouds", len(files), read)
