"""What surfaces are made of, as far as a lidar can tell."""

from __future__ import annotations

from dataclasses import dataclass

from lidarsim._validation import real


@dataclass(frozen=True, kw_only=True)
class Material:
    """How a surface returns light.

    Parameters
    ----------
    reflectivity : float
        Lambertian reflectivity at the wavelength of the sensor, >= 0; 1 for a perfect diffuser, more for a retro-reflector.

    Raises
    ------
    ValueError
        If the reflectivity is negative or not finite.
    """

    reflectivity: float = 1.0

    def __post_init__(self) -> None:
        real("reflectivity", self.reflectivity, at_least=0.0)
