"""What surfaces are made of, as far as a lidar can tell."""

from __future__ import annotations

from typing import Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from lidarsim._pickling import Value
from lidarsim._validation import array, frozen, one_of, real, shown
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
    per : {"object", "face", "vertex"}
        What the reflectivity is given for: one number for all of an object, or, of a `TriangleMesh`, one a face or one
        a vertex, between which it is linear over each face.

    Raises
    ------
    TypeError, ValueError
        If a reflectivity is negative or not finite, or is not one number or one-dimensional array, as `per` says.

    Examples
    --------
    >>> import lidarsim as ls
    >>> asphalt = ls.Material(reflectivity=0.17)
    >>> sign = ls.Material(reflectivity=[0.1, 300.0], per="face")
    """

    __slots__ = ("_per", "_reflectivity")

    def __init__(self, *, reflectivity: float | npt.ArrayLike = 1.0, per: Per = "object") -> None:
        one_of("per", per, PER)
        self._per = per
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

    def _contents(self) -> dict[str, Any]:
        return {"reflectivity": self.reflectivity, "per": self.per}

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
