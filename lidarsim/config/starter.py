"""Configurations that come with the package: known by name, and copied as a new project."""

from __future__ import annotations

import os
from pathlib import Path

from lidarsim._base.files import PathLike, writing
from lidarsim._base.shown import plain
from lidarsim.errors import ConfigError, LidarsimError

STARTER = Path(__file__).parents[1] / "starter"


def names() -> dict[str, Path]:
    """Return the packaged runs and recipes by name."""
    folders = STARTER, STARTER / "recipes"
    return {path.stem: path for folder in folders for path in sorted(folder.glob("*.yaml"))}


def files() -> list[Path]:
    """Return the files of a new project, relative to its folder."""
    every = (path.relative_to(STARTER) for path in STARTER.rglob("*") if path.is_file())
    return sorted(path for path in every if "__pycache__" not in path.parts)


def configuration(path: Path) -> Path:
    """Return `path`, or the packaged configuration that it names.

    A path is such a name if it is one word without a suffix, and there is no such file. A folder of that name, such as
    the data set of a packaged recipe, is no configuration.

    Raises
    ------
    ConfigError
        If there is no such file, and no packaged configuration of that name.
    """
    known = names()
    if path.suffix or len(path.parts) != 1 or (os.path.lexists(path) and not (path.is_dir() and path.name in known)):
        return path
    if path.name not in known:
        raise ConfigError(f"{plain(path.name, most=60)}: expected a file, or one of the packaged {', '.join(known)}")
    return known[path.name]


def new_project(folder: PathLike) -> list[Path]:
    """Write a project that runs into a new or empty folder.

    Parameters
    ----------
    folder : path-like
        The folder; it is made if it does not exist.

    Returns
    -------
    list of Path
        The files, relative to the folder.

    Raises
    ------
    LidarsimError
        If the folder exists and is not empty; nothing is changed then.
    OSError
        If it is no folder, or cannot be written; what was written is removed then.
    """
    folder = Path(folder)
    if folder.is_dir() and any(folder.iterdir()):
        raise LidarsimError(f"{folder}: expected a new or an empty folder, got one with files")
    made: list[Path] = []
    with writing(folder):
        try:
            if not folder.is_dir():
                folder.mkdir()
                made.append(folder)
            for file in files():
                for parent in reversed(file.parents[:-1]):
                    if not (folder / parent).is_dir():
                        (folder / parent).mkdir()
                        made.append(folder / parent)
                with (folder / file).open("xb") as written:
                    made.append(folder / file)
                    written.write((STARTER / file).read_bytes())
        except BaseException:
            for path in reversed(made):
                path.rmdir() if path.is_dir() else path.unlink()
            raise
    return files()
