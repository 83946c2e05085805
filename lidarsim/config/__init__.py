"""Configurations: YAML files that describe a scene, a sensor and a run; ``configs/REFERENCE.md`` lists their keys.

Importing this package is cheap: the YAML reader and schema are imported with the first file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lidarsim._base.files import PathLike, check_path
from lidarsim.lidar import OWN, Lidar, register_lidar_reader
from lidarsim.world.scene import Scene, register_scene_reader

if TYPE_CHECKING:
    from lidarsim.run import Run

__all__ = ["load", "read_lidar"]


def load(path: PathLike, overrides: Sequence[str] = ()) -> Run:
    """Return the run that a configuration describes.

    Parameters
    ----------
    path : path-like
        A YAML file, or the name of a packaged configuration, such as ``"demo"``. Paths in it are relative to its
        folder.
    overrides : sequence of str
        Values to replace or add, such as ``"scene.0.radius_m=2"``. Paths in them are relative to the working directory.

    Returns
    -------
    Run
        Scene, sensor, pose, seed and frames.

    Raises
    ------
    ConfigError
        If the configuration cannot be used; the message names file, line and key.
    """
    from lidarsim.config import loader

    return loader.load(check_path(path), overrides)


def read_lidar(path: PathLike, *, mode: str | None = None, noise: str | None = None) -> Lidar:
    """Return the sensor that a YAML file describes; called by `Lidar.from_file` and `Lidar.preset`.

    Parameters
    ----------
    path : path-like
        A YAML file with a ``pattern``, or with a ``preset`` or ``file`` and changes to it.
    mode : str, optional
        One of the ``modes`` in the file.
    noise : {"none", "datasheet", "measured"}, optional
        Whether to enable the file's ``datasheet_noise``, or that with the ``measured`` values merged over it.

    Returns
    -------
    Lidar
        The sensor.

    Raises
    ------
    ConfigError
        If the file cannot be used; the message names file, line and key.
    ValueError
        If there is no such mode or noise.
    """
    from lidarsim.config import loader

    return loader.read_lidar(Path(path), mode=mode, noise=noise)


def read_scene(path: Path) -> Scene:
    """Return the scene that a YAML file describes, a list of objects or a configuration; called by `Scene.from_file`.

    Raises
    ------
    ConfigError
        If the file cannot be used; the message names file, line and key.
    """
    from lidarsim.config import loader

    return loader.read_scene(path)


def _recognise(path: Path, _: object) -> bool:
    return path.suffix.lower() in {".yaml", ".yml"}


register_lidar_reader(OWN, _recognise, read_lidar)
register_scene_reader(OWN, _recognise, read_scene)
