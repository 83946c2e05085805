"""Load training data from the files of a data set or scan it on the fly, with PyTorch if it is installed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls

CLOUDS, POINTS, SEED = 16, 2048, 1
LIDAR = ls.Lidar.preset("livox-mid40")


def table(rng: np.random.Generator, number: int) -> tuple[ls.Scene, ls.Lidar, RigidTransform]:
    """Return a scene of a ball and a box on a table, the sensor and its pose."""
    del number
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0), label=1)
    scene.add(ls.Sphere((rng.uniform(1.5, 2.5), rng.uniform(-0.4, 0.0), 0.15), 0.15), label=2)
    scene.add(ls.Box((0.3, 0.2, 0.2), (rng.uniform(1.5, 2.5), rng.uniform(0.2, 0.4), 0.1)), label=3)
    down = Rotation.from_euler("y", 30, degrees=True)
    return scene, LIDAR, RigidTransform.from_components((0, 0, rng.uniform(1.0, 1.4)), down)


def sample(xyz: np.ndarray, label: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a random sample of POINTS points of a cloud, so that clouds form batches."""
    index = np.random.default_rng(number).choice(len(xyz), POINTS)
    return xyz[index].astype(np.float32), label[index].astype(np.int64)


class FromFiles:
    """Clouds of a data set of any layout, each read on request: a map-style dataset of PyTorch."""

    def __init__(self, folder: str) -> None:
        self.frames = ls.datasets.load(folder)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        cloud = self.frames[number].cloud
        return sample(cloud.xyz, cloud.label, number)


class OnTheFly:
    """The same clouds without files: each is scanned on request."""

    def __len__(self) -> int:
        return CLOUDS

    def __getitem__(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        scene, lidar, pose = table(np.random.default_rng([SEED, number]), number)
        cloud = lidar.scan(scene, pose, seed=number).point_cloud()
        return sample(cloud.xyz, cloud.label, number)


def batches(dataset: Any, size: int = 4) -> Iterable[tuple[Any, Any]]:
    """Return batches of clouds: tensors from two workers with PyTorch, else arrays from this process."""
    try:
        from torch.utils.data import DataLoader
    except ImportError:
        return _batches(dataset, size)
    return DataLoader(dataset, batch_size=size, shuffle=True, num_workers=2)


def _batches(dataset: Any, size: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    order = np.random.default_rng(0).permutation(len(dataset))
    for start in range(0, len(order), size):
        xyz, label = zip(*(dataset[number] for number in order[start : start + size].tolist()), strict=True)
        yield np.stack(xyz), np.stack(label)


if __name__ == "__main__":  # workers may import this file
    ls.generate(table, "table", sequences=CLOUDS, seed=SEED, layout="shards", pictures=0)
    for dataset in (FromFiles("table"), OnTheFly()):
        shares = np.zeros(4)
        for xyz, label in batches(dataset):
            shares += np.bincount(np.asarray(label).ravel(), minlength=4)
            print(type(dataset).__name__, type(xyz).__name__, tuple(xyz.shape), tuple(label.shape))
        shares /= shares.sum()
        print(f"table {shares[1]:.0%}, ball {shares[2]:.0%}, box {shares[3]:.0%}")
