"""Units of keys: ``radius_m`` is the ``radius`` of `Sphere`, in m."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats

# Small units are divided: 55.296 / 1e6 is the float64 nearest to 55.296e-6, because 1e6 is a float64 and 1e-6 is not.
UNITS: dict[str, tuple[str, Callable[[Floats], Floats]]] = {
    "deg_per_s_per_sqrt_hz": ("rad/s/√Hz", np.radians),
    "deg_per_s2_per_sqrt_hz": ("rad/s²/√Hz", np.radians),
    "m_per_s2_per_sqrt_hz": ("", np.positive),
    "m_per_s3_per_sqrt_hz": ("", np.positive),
    "m_per_s2": ("", np.positive),
    "deg_per_s": ("rad/s", np.radians),
    "deg_per_h": ("rad/s", lambda value: np.radians(value) / 3600.0),
    "m_per_s": ("", np.positive),
    "per_m": ("", np.positive),
    "per_m_sr": ("", np.positive),
    "mm_per_h": ("", np.positive),
    "deg": ("rad", np.radians),
    "mrad": ("rad", lambda value: value / 1e3),
    "mm": ("m", lambda value: value / 1e3),
    "m": ("", np.positive),
    "us": ("s", lambda value: value / 1e6),
    "ns": ("s", lambda value: value / 1e9),
    "s": ("", np.positive),
    "khz": ("Hz", lambda value: value * 1e3),
    "hz": ("", np.positive),
    "rpm": ("Hz", lambda value: value / 60.0),
}


def in_si(value: float | list[float] | list[list[float]], unit: str) -> float | Floats:
    """Return a value of a unit in SI units or radians."""
    with np.errstate(over="ignore"):  # the constructor refuses infinite values
        converted = UNITS[unit][1](np.asarray(value, dtype=np.float64))
    return converted if isinstance(value, list) else float(converted)


@cache
def unit_of(key: str) -> str | None:
    """Return the unit of a key, if it has one."""
    return next((unit for unit in UNITS if key.endswith(f"_{unit}")), None)


def argument_of(key: str) -> str:
    """Return the argument of a key."""
    unit = unit_of(key)
    return key.removesuffix(f"_{unit}") if unit else key
