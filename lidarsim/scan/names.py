"""Names of fields: which a point cloud can have, and what the names in files and other libraries become."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from lidarsim.scan.fields import CANONICAL, Fields, fit


class Names:
    """Valid names for the fields of a class: ASCII identifiers that are not names of its attributes or methods."""

    def __init__(self, of: type) -> None:
        # A missing attribute takes long: its error looks for similar names.
        self._is_attribute = lru_cache(maxsize=256)(lambda name: hasattr(of, name))

    def __contains__(self, name: str) -> bool:
        """Return whether a field can have this name."""
        return (
            name.isascii() and name.isidentifier() and name not in {"_", "x", "y", "z"} and not self._is_attribute(name)
        )

    def of_columns(self, names: Sequence[str]) -> list[str]:
        """Return a unique field name for each column name of a file.

        A valid field name is kept. In any other name, all characters except letters, digits and underscores become
        underscores. If the result is taken, it gets a number: ``a_b_2``.
        """
        taken = {name for name in names if name in self}
        own, numbers = set(taken), dict[str, int]()
        fields = []
        for name in names:
            if name in own:
                own.discard(name)  # the first of equal names
                fields.append(name)
                continue
            base = re.sub(r"\W|^(?=\d)", "_", name, flags=re.ASCII) or "unnamed"
            field = base = base if base in self else f"{base}_"
            while field in taken:
                numbers[base] = numbers.get(base, 1) + 1
                field = f"{base}_{numbers[base]}"
            taken.add(field)
            fields.append(field)
        return fields

    def adopt(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        """Convert the fields of a file or another library to valid fields of a cloud, without loss.

        Parameters
        ----------
        fields : mapping of str to ndarray
            Arrays of any values, by any names; class names are a mapping under ``"class_names"``.

        Returns
        -------
        dict of str to ndarray
            The fields by the names from `of_columns`. Where the dtype of one of lidarsim's fields cannot hold a value,
            the field is 0, and ``<name>_raw`` is the given array. If the shape does not fit, there is only
            ``<name>_raw``.
        """
        classes = {
            name: value for name, value in fields.items() if name == "class_names" and isinstance(value, Mapping)
        }
        given = {name: np.asarray(value) for name, value in fields.items() if name not in classes}
        kept: Fields = {}
        raw: Fields = {}
        for name, array in zip(self.of_columns(list(given)), given.values(), strict=True):
            shape, dtype = CANONICAL.get(name, ((), None))
            if dtype is None or name == "xyz" or array.dtype.kind not in "biuf" or array.ndim not in {1, 2}:
                kept[name] = array
            elif array.shape[1:] != shape:
                raw[name] = array
            else:
                kept[name], exact = fit(array, dtype)
                if not exact:
                    raw[name] = array
        names = self.of_columns([*kept, *(f"{name}_raw" for name in raw)])
        return dict(zip(names, [*kept.values(), *raw.values()], strict=True)) | classes
