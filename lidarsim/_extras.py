"""Optional packages, imported when they are needed."""

from __future__ import annotations

import importlib
from types import ModuleType

from lidarsim.errors import MissingExtraError


def import_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Return the imported `module`, which ``lidarsim[extra]`` installs and which `purpose` needs.

    Raises
    ------
    MissingExtraError
        If it is not installed, or does not import here.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise MissingExtraError(f"{purpose} needs {module}, which does not import here: {error}") from error
        raise MissingExtraError(f'{purpose} needs {module}: pip install "lidarsim[{extra}]"') from error
    except (ImportError, OSError) as error:
        raise MissingExtraError(f"{purpose} needs {module}, which does not import here: {error}") from error
