"""The function of a recipe that changes each cloud before it is written."""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from lidarsim._base.files import format_error
from lidarsim._base.validation import short_repr
from lidarsim.datasets.fingerprint import check_function, fingerprint, name_of
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.scan.pointcloud import PointCloud

Change = Callable[[PointCloud, np.random.Generator], PointCloud]

NAME = "after_scan"
REFERENCE = re.compile(r"[^\W\d]\w*(?:\.[^\W\d]\w*)*:[^\W\d]\w*")
EXPECTED = "module:function, with a module beside the recipe or one that Python finds"


@dataclass(frozen=True)
class AfterScan:
    """A function that changes clouds.

    Attributes
    ----------
    function : callable
        Takes the cloud of a sensor's frame and a generator, and returns the cloud to write.
    name : str
        Module and function.
    made_of : dict of str to str
        Its fingerprint.
    folder : str, optional
        Folder of the recipe that names it.
    """

    function: Change
    name: str
    made_of: dict[str, str]
    folder: str | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle a function that a recipe names by this name: other processes cannot import files beside the recipe."""
        if self.folder is not None:
            return load, (self.name, self.folder)
        return AfterScan, (self.function, self.name, self.made_of)

    def apply(self, cloud: PointCloud, rng: np.random.Generator, needed: Collection[str]) -> PointCloud:
        """Return the cloud to write.

        Raises
        ------
        TypeError, ValueError
            If the function fails, or returns anything but a cloud with the fields `needed` and finite coordinates.
        """
        expected = f"{self.name} to return a PointCloud"
        try:
            changed = self.function(cloud, rng)
        except Exception as error:  # a function of others may raise anything
            raise ArgumentValueError(NAME, expected, f"{type(error).__name__}: {format_error(error)}") from error
        if not isinstance(changed, PointCloud):
            raise ArgumentTypeError(NAME, expected, type(changed).__name__)
        if missing := [name for name in needed if name not in changed.fields]:
            expected = f"{self.name} to return a cloud with {', '.join(missing)}"
            raise ArgumentValueError(NAME, expected, f"one with {', '.join(changed.fields)}")
        finite = np.isfinite(changed.xyz).all(axis=1)
        if not finite.all():
            index = int(np.argmin(finite))
            got = f"xyz[{index}] = {changed.xyz[index]}"
            raise ArgumentValueError(NAME, f"{self.name} to return finite points", got)
        return changed


def from_function(function: object) -> AfterScan:
    """Return a function that is given to `lidarsim.generate`.

    Raises
    ------
    TypeError
        If it is no function of a cloud and a generator, or depends on a value that cannot be hashed.
    """
    checked = check_function(NAME, function, "a cloud and a generator")
    return AfterScan(checked, name_of(checked, ":"), fingerprint(checked, NAME))


def load(name: str, folder: str) -> AfterScan:
    """Return the function ``module:function`` of a module that is a file in a folder or that Python finds.

    Raises
    ------
    TypeError, ValueError
        If there is no such module or function, or it cannot be used.
    """
    if not REFERENCE.fullmatch(name):
        raise ArgumentValueError(NAME, EXPECTED, short_repr(name))
    module, _, attribute = name.partition(":")
    try:
        found = _module(module, Path(folder, *module.split(".")).with_suffix(".py"))
    except Exception as error:  # a module may raise anything when it is imported
        raise ArgumentValueError(NAME, EXPECTED, f"{short_repr(name)}: {format_error(error)}") from error
    if not hasattr(found, attribute):
        raise ArgumentValueError(NAME, f"a function of {module}", short_repr(attribute))
    function = check_function(NAME, getattr(found, attribute), "a cloud and a generator")
    return AfterScan(function, name, fingerprint(function, NAME), folder)


def _module(name: str, path: Path) -> ModuleType:
    """Return a module, executed anew if it is a file: it may have changed, and other recipes may have its namesake."""
    spec = importlib.util.spec_from_file_location(f"{NAME}.{name}", path) if path.is_file() else None
    if spec is None or spec.loader is None:
        return importlib.import_module(name)
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # where dataclasses look up the module of a class
    spec.loader.exec_module(module)
    return module
