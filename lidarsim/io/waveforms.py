"""Waveforms as NumPy archives (``.npz``): one array for each attribute of `lidarsim.Waveforms`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lidarsim._base.files import PathLike, atomic_writer, check_regular, check_suffix, parsing
from lidarsim._base.validation import real
from lidarsim._base.views import register_view
from lidarsim.errors import FileFormatError
from lidarsim.io import npz
from lidarsim.scan.waveforms import Waveforms

SUFFIXES = (".npz",)
ARRAYS = {"pulse": np.int64, "first": np.int64, "offsets": np.int64, "samples": np.float32}
NUMBERS = ("sample_period", "pulse_length")


def save(waveforms: Waveforms, path: PathLike) -> None:
    """Write waveforms, as documented in `lidarsim.Waveforms.save`."""
    check_suffix(path, SUFFIXES)
    with atomic_writer(path) as file:
        npz.save({name: np.asarray(getattr(waveforms, name)) for name in (*ARRAYS, *NUMBERS)}, file)


def load(path: PathLike) -> Waveforms:
    """Read waveforms, as documented in `lidarsim.Waveforms.load`."""
    check_suffix(path, SUFFIXES)
    check_regular(path)
    with Path(path).open("rb") as file, parsing(path, "file of waveforms"):
        arrays = npz.load(file)
        expected = {*ARRAYS, *NUMBERS}
        if arrays.keys() != expected:
            found = ", ".join(sorted(expected - arrays.keys()))
            raise FileFormatError(f"it has no array {found}" if found else "it has other arrays, too")
        for name, dtype in ARRAYS.items():
            if arrays[name].ndim != 1 or arrays[name].dtype != dtype:
                got = f"{arrays[name].dtype} of shape {arrays[name].shape}"
                raise FileFormatError(f"{name}: expected one row of {np.dtype(dtype)}, got {got}")
        for name in NUMBERS:
            arrays[name] = real(name, arrays[name].item() if arrays[name].ndim == 0 else arrays[name], above=0.0)
        m, offsets = len(arrays["pulse"]), arrays["offsets"]
        if len(arrays["first"]) != m or len(offsets) != m + 1:
            got = f"{m}, {len(arrays['first'])} and {len(offsets)}"
            raise FileFormatError(f"pulse, first, offsets: expected m, m and m + 1 of them, got {got}")
        if offsets[0] != 0 or offsets[-1] != len(arrays["samples"]) or (np.diff(offsets) < 0).any():
            raise FileFormatError("offsets: expected numbers that rise from 0 to the number of samples")
        return Waveforms(**arrays)


register_view(Waveforms, "to_npz", save)
register_view(Waveforms, "from_npz", load)
