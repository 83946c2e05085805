"""What surfaces are made of, as far as a lidar can tell."""

from __future__ import annotations

import math
from typing import Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from lidarsim._pickling import Value
from lidarsim._validation import angle, array, frozen, one_of, real, shown
from lidarsim.errors import ArgumentTypeError, ArgumentValueError

__all__ = ["Material"]

Per = Literal["object", "face", "vertex"]
PER = get_args(Per)


class Material(Value):
    """How a surface returns light.

    Parameters
    ----------
    reflectivity : float or array_like, shape (n,)
        Lambertian reflectivity at the wavelength of the sensor, >= 0: what the surface returns as a share of what a
        white diffuser does, so that a retro-reflector has more than 1. An array is kept as a read-only copy.
        With `roughness` or `specular`, ρ in the formula below.
    per : {"object", "face", "vertex"}
        What the reflectivity is given for: one number for all of an object, or, of a `TriangleMesh`, one a face or one
        a vertex, between which it is linear over each face.
    roughness : float
        m, the standard deviation of the angles by which the facets of a rough diffuser are tilted, rad, 0 to π/2; 0 is
        Lambert's diffuser. One for all of an object.
    specular : float
        Strength of the highlight, >= 0: what the surface returns at normal incidence beside its diffuse light, as a
        multiple of the reflectivity. One for all of an object.
    specular_width : float
        w, the width of the highlight as a slope, > 0: at tan θ = w its exponential has fallen to 1/e.

    Raises
    ------
    TypeError, ValueError
        If a reflectivity is negative or not finite, or is not one number or one-dimensional array, as `per` says, or if
        another parameter is out of its range.

    Notes
    -----
    At an angle of incidence θ a surface returns ρ·f(θ) of what a white diffuser does at normal incidence:

        f(θ) = A·cos θ + B·sin²θ + `specular`·exp(−tan²θ/w²)/cos⁵θ

    with A = 1 − 0.5·m²/(m² + 0.33) and B = 0.45·m²/(m² + 0.09). The first two terms are the rough diffuser of M. Oren
    and S. K. Nayar (Generalization of Lambert's reflectance model, SIGGRAPH 94) with source and receiver in one place.
    The third is a highlight of microfacets with Beckmann's distribution of slopes (R. L. Cook and K. E. Torrance, A
    reflectance model for computer graphics, ACM Transactions on Graphics 1, 1982), seen from the source and scaled to 1
    at θ = 0. Without roughness and highlight f(θ) is cos θ.

    Examples
    --------
    >>> import lidarsim as ls
    >>> asphalt = ls.Material(reflectivity=0.17, roughness=0.5)
    >>> lacquer = ls.Material(reflectivity=0.1, specular=20.0, specular_width=0.05)
    >>> sign = ls.Material(reflectivity=[0.1, 300.0], per="face")
    """

    __slots__ = ("_per", "_reflectivity", "_roughness", "_specular", "_specular_width")

    def __init__(
        self,
        *,
        reflectivity: float | npt.ArrayLike = 1.0,
        per: Per = "object",
        roughness: float = 0.0,
        specular: float = 0.0,
        specular_width: float = 0.1,
    ) -> None:
        one_of("per", per, PER)
        self._per = per
        self._roughness = angle("roughness", roughness, at_least=0.0, at_most=math.pi / 2)
        self._specular = real("specular", specular, at_least=0.0)
        self._specular_width = real("specular_width", specular_width, above=0.0)
        self._reflectivity: float | npt.NDArray[np.float64]
        if per == "object":
            if isinstance(reflectivity, (np.ndarray, list, tuple)):
                expected = "one number, or an array with per='face' or per='vertex'"
                raise ArgumentTypeError("reflectivity", expected, shown(reflectivity))
            self._reflectivity = real("reflectivity", reflectivity, at_least=0.0)
            return
        values = array("reflectivity", reflectivity, ("n",))
        if (values < 0.0).any():
            index = int(np.argmax(values < 0.0))
            raise ArgumentValueError("reflectivity", "numbers >= 0", f"reflectivity[{index}] = {values[index]}")
        self._reflectivity = frozen(values)

    @property
    def reflectivity(self) -> float | npt.NDArray[np.float64]:
        """Lambertian reflectivity: float, or read-only ndarray of float64, shape (n,)."""
        return self._reflectivity

    @property
    def per(self) -> Per:
        """What the reflectivity is given for: "object", "face" or "vertex"."""
        return self._per

    @property
    def roughness(self) -> float:
        """Standard deviation of the tilt of the facets of a rough diffuser, rad: float."""
        return self._roughness

    @property
    def specular(self) -> float:
        """Strength of the highlight at normal incidence, as a multiple of the reflectivity: float."""
        return self._specular

    @property
    def specular_width(self) -> float:
        """Width of the highlight, as a slope: float."""
        return self._specular_width

    def _contents(self) -> dict[str, Any]:
        names = ("reflectivity", "per", "roughness", "specular", "specular_width")
        return {name: getattr(self, name) for name in names}

    @classmethod
    def _restored(cls, contents: dict[str, Any]) -> Self:
        return cls(**contents)

    @classmethod
    def from_colors(cls, colors: npt.ArrayLike, *, per: Literal["face", "vertex"] = "vertex") -> Material:
        """Return the material of a mesh whose reflectivity is the luminance of its colours.

        The only guess there is where a mesh has colours and nothing is known of the infrared: green leaves, among
        others, are far brighter there.

        Parameters
        ----------
        colors : array_like, shape (n, 3) or (n, 4)
            sRGB colours of the vertices or faces: integers 0 to 255 or numbers 0 to 1. An opacity is ignored.
        per : {"vertex", "face"}
            What the colours are given for.

        Returns
        -------
        Material
            Luminance of linear light, weights of ITU-R BT.709; 1 for white.

        Raises
        ------
        ValueError
            If the shape is wrong or a colour out of range.
        """
        try:
            given = np.asarray(colors)
        except ValueError:
            raise ArgumentValueError("colors", "shape (n, 3) or (n, 4)", "a ragged sequence") from None
        scale = 255.0 if given.dtype.kind in "iu" else 1.0
        if given.ndim != 2 or given.shape[1] not in {3, 4}:
            raise ArgumentValueError("colors", "shape (n, 3) or (n, 4)", given.shape)
        encoded = array("colors", given[:, :3], ("n", 3)) / scale
        if ((encoded < 0.0) | (encoded > 1.0)).any():
            raise ArgumentValueError("colors", f"numbers from 0 to {scale:g}", f"{given.min()} to {given.max()}")
        # IEC 61966-2-1
        linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
        return cls(reflectivity=linear @ (0.2126, 0.7152, 0.0722), per=per)
