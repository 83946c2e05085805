"""Optional packages, imported on demand."""

from __future__ import annotations

import importlib
from types import ModuleType

from lidarsim.errors import MissingExtraError


def import_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Import and return `module`, which `purpose` needs and ``lidarsim[extra]`` installs.

    Raises
    ------
    MissingExtraError
        If the module is not installed or cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise MissingExtraError(f"{purpose} needs {module}, which does not import here: {error}") from error
        raise MissingExtraError(f'{purpose} needs {module}: pip install "lidarsim[{extra}]"') from error
    except (ImportError, OSError) as error:
        raise MissingExtraError(f"{purpose} needs {module}, which does not import here: {error}") from error
