"""What surfaces are made of, as far as a lidar can tell, and a library of materials.

The library has constants for 905 nm, such as `ASPHALT`, and for 1550 nm, such as `ASPHALT_1550`, where values were
published. From 850 to 950 nm, the spectra behind the former change by less than a tenth. `SOURCES` cites the values and
their ranges. A real surface may well be half or twice as bright.

Of `GLASS`, `MIRROR`, `NET` and `ASPHALT_WET`, light goes on to other surfaces, if the `depth` of the `Measurement` is
more than 1.
"""

from __future__ import annotations

import difflib
import math
from typing import Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from lidarsim import _native as core
from lidarsim._base.pickling import Value
from lidarsim._base.validation import Floats, angle, array, as_array, frozen, in_order, one_of, real, shown
from lidarsim.errors import ArgumentTypeError, ArgumentValueError

__all__ = [
    "ASPHALT",
    "ASPHALT_1550",
    "ASPHALT_LIGHT",
    "ASPHALT_LIGHT_1550",
    "ASPHALT_WET",
    "BARK",
    "BARK_1550",
    "BRICK",
    "BRICK_1550",
    "CAR_PAINT_DARK",
    "CAR_PAINT_DARK_1550",
    "CAR_PAINT_LIGHT",
    "CLOTH",
    "CLOTH_DARK",
    "CLOTH_LIGHT",
    "CONCRETE",
    "CONCRETE_1550",
    "CONIFER",
    "CONIFER_1550",
    "FOLIAGE",
    "FOLIAGE_1550",
    "GLASS",
    "GRASS",
    "GRASS_1550",
    "GRASS_DRY",
    "GRASS_DRY_1550",
    "MIRROR",
    "NET",
    "PAINTED_METAL",
    "PAINTED_METAL_1550",
    "PLASTER",
    "PLASTER_1550",
    "ROAD_PAINT",
    "ROAD_PAINT_WORN",
    "ROOF_TILE",
    "ROOF_TILE_1550",
    "RUBBER",
    "SIGN_SHEETING",
    "SKIN",
    "SNOW",
    "SNOW_1550",
    "SOIL",
    "SOIL_1550",
    "SOURCES",
    "Material",
    "Texture",
    "named",
]

Per = Literal["object", "face", "vertex", "texture"]
PER = get_args(Per)

Wrap = Literal["repeat", "clamp", "mirror"]
WRAP = get_args(Wrap)

Interpolation = Literal["linear", "nearest"]
INTERPOLATION = get_args(Interpolation)

MOST = float(np.finfo(np.float32).max)  # maximum reflectivity of a texel


class Texture(Value):
    """An image of reflectivity for the surface of a mesh, such as a road with its markings.

    Parameters
    ----------
    values : array_like, shape (height, width)
        Lambertian reflectivities, >= 0, as in `Material`; row 0 is the top of the image. They are kept as a read-only
        copy in float32, which all materials of the texture share.
    wrap : {"repeat", "clamp", "mirror"} or a pair of these
        What the texture is beyond its edges: the image again, the texel at the edge, or the image and its mirror image
        in turn; of a pair, the first is for u and the second for v.
    interpolation : {"linear", "nearest"}
        What the texture is between the centres of its texels: bilinear, or the texel that the point lies in, as for
        palettes, whose neighbouring texels have nothing to do with each other.

    Raises
    ------
    TypeError, ValueError
        If a value is negative or not finite, or overflows float32; if there are no values, or they have another shape
        or the dtype of an image's colours, which `Material.from_texture` takes; or if another argument is something
        else.

    Notes
    -----
    Texture coordinates are those of glTF: u grows to the right and v downwards, (0, 0) is the top left corner of the
    image and (1, 1) its bottom right corner. OBJ, Open3D and PyVista have v upwards; pass them 1 - v. The centre of the
    texel in row j and column i is at u = (i + 0.5) / width, v = (j + 0.5) / height. The reflectivity
    is that of the point that a ray hits; a `Beam` averages over its footprint.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> asphalt, paint = 0.1, 0.6
    >>> stripes = ls.Texture([[asphalt, paint, asphalt, asphalt]], wrap=("repeat", "clamp"))
    >>> road = ls.TriangleMesh([(0, 2, 0), (0, -2, 0), (9, -2, 0), (9, 2, 0)], [(0, 1, 2), (0, 2, 3)])
    >>> marked = ls.Material(reflectivity=stripes, texture_coordinates=[(0, 1), (1, 1), (1, 0), (0, 0)])
    >>> scene = ls.Scene()
    >>> ground = scene.add(road, material=marked)
    >>> down = ls.Lidar(ls.patterns.Table([(5, 0.5, -1), (5, -0.5, -1)], rate=10.0))
    >>> scan = down.scan(scene, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]])
    >>> (scan.intensity / np.cos(scan.incidence)).round(3)
    array([[0.6],
           [0.1]], dtype=float32)
    """

    __slots__ = ("_interpolation", "_native", "_values", "_wrap")

    def __init__(
        self,
        values: npt.ArrayLike,
        *,
        wrap: Wrap | tuple[Wrap, Wrap] = "repeat",
        interpolation: Interpolation = "linear",
    ) -> None:
        given = as_array("values", values, "numbers of shape (height, width)")
        if given.dtype.kind == "u" and given.dtype.itemsize < 4:
            hint = "Material.from_texture takes colours"
            raise ArgumentTypeError("values", "reflectivities", f"dtype {given.dtype}", hint)
        numbers = array("values", given, ("height", "width"))
        if not numbers.size:
            raise ArgumentValueError("values", "at least one", f"shape {numbers.shape}")
        wrong = (numbers < 0.0) | (numbers > MOST)
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            got = f"values[{row}][{column}] = {numbers[row, column]}"
            raise ArgumentValueError("values", f"numbers from 0 to {MOST:.3g}", got)
        self._wrap = _wrap(wrap)
        self._interpolation = interpolation
        one_of("interpolation", interpolation, INTERPOLATION)
        self._native = core.Texture(in_order(numbers, np.float32), *self._wrap, interpolation)
        self._values = self._native.values()

    @property
    def values(self) -> npt.NDArray[np.float32]:
        """Reflectivities: read-only ndarray of float32, shape (height, width)."""
        return self._values

    @property
    def wrap(self) -> tuple[Wrap, Wrap]:
        """What the texture is beyond its edges, for u and v: each "repeat", "clamp" or "mirror"."""
        return self._wrap

    @property
    def interpolation(self) -> Interpolation:
        """What the texture is between the centres of its texels: "linear" or "nearest"."""
        return self._interpolation

    def _contents(self) -> dict[str, Any]:
        return {"values": self.values, "wrap": self.wrap, "interpolation": self.interpolation}

    @classmethod
    def _restored(cls, contents: dict[str, Any]) -> Self:
        return cls(**contents)


def _wrap(value: object) -> tuple[Wrap, Wrap]:
    """Return the checked argument `wrap` of a texture, for u and v."""
    pair = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
    if len(pair) != 2:
        raise ArgumentValueError("wrap", "one for u and one for v", shown(value))
    for item in pair:
        one_of("wrap", item, WRAP)
    return pair


class Material(Value):
    """How a surface returns light.

    Parameters
    ----------
    reflectivity : float or array_like, shape (n,), or Texture
        Lambertian reflectivity at the wavelength of the sensor, >= 0: what the surface returns as a share of what a
        white diffuser does, so that a retro-reflector has more than 1. An array is kept as a read-only copy.
        With `roughness` or `specular`, ρ in the formula below.
    per : {"object", "face", "vertex", "texture"}, optional
        What the reflectivity is given for: one number for all of an object, or, of a `TriangleMesh`, one a face or one
        a vertex, between which it is linear over each face, or a texture. Of `Spheres` and `Disks`, "face" is one each.
        Default: "texture" for a `Texture`, otherwise "object".
    texture_coordinates : array_like, shape (n, 2) or (m, 3, 2), optional
        Where a texture lies on the mesh: u, v of each of its n vertices, or of the corners of each of its m faces in
        their order; `Texture` has the convention. Over a face they are linear. Kept as a read-only copy.
    roughness : float
        m, the standard deviation of the angles by which the facets of a rough diffuser are tilted, rad, 0 to π/2; 0 is
        Lambert's diffuser. One for all of an object.
    specular : float
        Strength of the highlight, >= 0: what the surface returns at normal incidence beside its diffuse light, as a
        multiple of the reflectivity. One for all of an object.
    specular_width : float
        w, the width of the highlight as a slope, > 0: at tan θ = w its exponential has fallen to 1/e.
    transmission : float
        Share of the light that goes straight on through the surface, 0 to 1: of a pane of glass without bending, of a
        net or of leaves the open share. One for all of an object, and the same at any angle and from either side.
    mirror : float
        Share of the light that goes on in the mirrored direction, 0 to 1. `transmission` and `mirror` together are at
        most 1. They need a `Measurement` with a `depth` of more than 1.
    variation : float
        Texture: relative standard deviation of the reflectivity from cell to cell, 0 to 10. One for all of an object.
    grain : float
        Edge of a cell of the texture, m, > 0.

    Raises
    ------
    TypeError, ValueError
        If a reflectivity is negative or not finite, or is not one number, one-dimensional array or texture, as `per`
        says, if texture coordinates are not finite, have another shape, lack, or come without a texture, or if another
        parameter is out of its range.

    Notes
    -----
    At an angle of incidence θ a surface returns ρ·f(θ) of what a white diffuser does at normal incidence:

        f(θ) = A·cos θ + B·sin²θ + `specular`·exp(−tan²θ/w²)/cos⁵θ

    with A = 1 − 0.5·m²/(m² + 0.33) and B = 0.45·m²/(m² + 0.09). The first two terms are the rough diffuser of M. Oren
    and S. K. Nayar (Generalization of Lambert's reflectance model, SIGGRAPH 94) with source and receiver in one place.
    The third is a highlight of microfacets with Beckmann's distribution of slopes (R. L. Cook and K. E. Torrance, A
    reflectance model for computer graphics, ACM Transactions on Graphics 1, 1982), seen from the source and scaled to 1
    at θ = 0. Without roughness and highlight f(θ) is cos θ.

    `transmission` and `mirror` weaken what is seen through the surface or in it, each by its square, since light takes
    the same way out and back. They do not change the light that the surface itself returns. Each crossing counts: a
    pane that is modelled as a thin `Box` is crossed twice, and needs the square root of the pane's transmission.

    With `variation`, ρ is multiplied by a log-normal factor of mean 1, one for each cell of a cubic grid in the
    coordinates of the object, before `transform`. It depends on the cell and the id of the object alone, so that every
    scan sees the same texture. Points that are farther apart than a cell differ independently; a `Beam` averages over
    the cells in its footprint.

    Examples
    --------
    >>> import lidarsim as ls
    >>> asphalt = ls.Material(reflectivity=0.17, roughness=0.5, variation=0.15)
    >>> lacquer = ls.Material(reflectivity=0.1, specular=20.0, specular_width=0.05)
    >>> sign = ls.Material(reflectivity=[0.1, 300.0], per="face")
    >>> stripes = ls.Texture([[0.1, 0.6, 0.1, 0.1]])
    >>> road = ls.Material(reflectivity=stripes, texture_coordinates=[(0, 0), (1, 0), (1, 1), (0, 1)])
    >>> tinted = ls.Material(reflectivity=0.01, transmission=0.4, mirror=0.1)
    """

    __slots__ = (
        "_grain",
        "_mirror",
        "_per",
        "_reflectivity",
        "_roughness",
        "_specular",
        "_specular_width",
        "_texture_map",
        "_transmission",
        "_variation",
    )

    def __init__(
        self,
        *,
        reflectivity: float | npt.ArrayLike | Texture = 1.0,
        per: Per | None = None,
        texture_coordinates: npt.ArrayLike | None = None,
        roughness: float = 0.0,
        specular: float = 0.0,
        specular_width: float = 0.1,
        transmission: float = 0.0,
        mirror: float = 0.0,
        variation: float = 0.0,
        grain: float = 0.05,
    ) -> None:
        if per is None:
            per = "texture" if isinstance(reflectivity, Texture) else "object"
        one_of("per", per, PER)
        self._per: Per = per
        self._roughness = angle("roughness", roughness, at_least=0.0, at_most=math.pi / 2)
        self._specular = real("specular", specular, at_least=0.0)
        self._specular_width = real("specular_width", specular_width, above=0.0)
        self._transmission = real("transmission", transmission, at_least=0.0, at_most=1.0)
        self._mirror = real("mirror", mirror, at_least=0.0, at_most=1.0)
        if self._transmission + self._mirror > 1.0:
            most = f"at most {1.0 - self._transmission:g} beside a transmission of {self._transmission:g}"
            raise ArgumentValueError("mirror", most, f"{self._mirror:g}", "more light would go on than comes")
        self._variation = real("variation", variation, at_least=0.0, at_most=10.0)
        self._grain = real("grain", grain, above=0.0)
        self._reflectivity = _reflectivity(reflectivity, per)
        self._texture_map = None
        if isinstance(self._reflectivity, Texture):
            self._texture_map = self._reflectivity._native.mapped(_texture_coordinates(texture_coordinates))
        elif texture_coordinates is not None:
            expected = "None, or a Texture as the reflectivity"
            raise ArgumentTypeError("texture_coordinates", expected, shown(texture_coordinates))

    @property
    def reflectivity(self) -> float | Floats | Texture:
        """Lambertian reflectivity: float, or read-only ndarray of float64, shape (n,), or Texture."""
        return self._reflectivity

    @property
    def per(self) -> Per:
        """What the reflectivity is given for: "object", "face", "vertex" or "texture"."""
        return self._per

    @property
    def texture_coordinates(self) -> Floats | None:
        """Coordinates u, v in the texture: read-only ndarray of float64, shape (n, 2) or (m, 3, 2), or None."""
        return None if self._texture_map is None else self._texture_map.coordinates()

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

    @property
    def transmission(self) -> float:
        """Share of the light that goes straight on through the surface: float."""
        return self._transmission

    @property
    def mirror(self) -> float:
        """Share of the light that goes on in the mirrored direction: float."""
        return self._mirror

    @property
    def variation(self) -> float:
        """Relative standard deviation of the reflectivity from cell to cell: float."""
        return self._variation

    @property
    def grain(self) -> float:
        """Edge of a cell of the texture, m: float."""
        return self._grain

    def _contents(self) -> dict[str, Any]:
        names = ["reflectivity", "per", "roughness", "specular", "specular_width", "transmission", "mirror"]
        if self._variation > 0.0:
            names += ["variation", "grain"]
        if self._texture_map is not None:
            names.append("texture_coordinates")
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
        TypeError, ValueError
            If the shape is wrong or a colour out of range.
        """
        one_of("per", per, ("face", "vertex"))
        return cls(reflectivity=_luminance("colors", colors, ("n",)), per=per)

    @classmethod
    def from_texture(
        cls,
        image: npt.ArrayLike,
        texture_coordinates: npt.ArrayLike,
        *,
        wrap: Wrap | tuple[Wrap, Wrap] = "repeat",
        interpolation: Interpolation = "linear",
    ) -> Material:
        """Return the material of a mesh whose reflectivity is the luminance of an image on it.

        As with `from_colors`, the infrared is guessed from visible light.

        Parameters
        ----------
        image : array_like, shape (height, width, 3) or (height, width, 4)
            sRGB colours: integers 0 to 255 or numbers 0 to 1; row 0 is the top. An opacity is ignored.
        texture_coordinates : array_like, shape (n, 2) or (m, 3, 2)
            Where the image lies on the mesh, as in `Material`.
        wrap : {"repeat", "clamp", "mirror"} or a pair of these
            What the image is beyond its edges, as in `Texture`.
        interpolation : {"linear", "nearest"}
            What the image is between the centres of its pixels, as in `Texture`.

        Returns
        -------
        Material
            A `Texture` of the luminance of linear light, weights of ITU-R BT.709; 1 for white.

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a colour or coordinate out of range, or `wrap` or `interpolation` is something else.

        Examples
        --------
        >>> import lidarsim as ls
        >>> image = [[(64, 64, 64), (255, 255, 255), (64, 64, 64)]]
        >>> corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
        >>> ls.Material.from_texture(image, corners).reflectivity.values.round(3)
        array([[0.051, 1.   , 0.051]], dtype=float32)
        """
        texture = Texture(_luminance("image", image, ("height", "width")), wrap=wrap, interpolation=interpolation)
        return cls(reflectivity=texture, texture_coordinates=texture_coordinates)


def _reflectivity(value: object, per: Per) -> float | Floats | Texture:
    """Return the checked argument `reflectivity` of a material."""
    if per == "texture":
        if not isinstance(value, Texture):
            raise ArgumentTypeError("reflectivity", "a Texture with per='texture'", shown(value))
        return value
    if isinstance(value, Texture):
        raise ArgumentTypeError("reflectivity", f"numbers with per={per!r}", "a Texture")
    if per == "object":
        if isinstance(value, (np.ndarray, list, tuple)):
            expected = "one number, or an array with per='face' or per='vertex'"
            raise ArgumentTypeError("reflectivity", expected, shown(value))
        return real("reflectivity", value, at_least=0.0)
    values = array("reflectivity", value, ("n",))
    if (values < 0.0).any():
        index = int(np.argmax(values < 0.0))
        raise ArgumentValueError("reflectivity", "numbers >= 0", f"reflectivity[{index}] = {values[index]}")
    return frozen(values)


def _texture_coordinates(value: npt.ArrayLike | None) -> Floats:
    """Return the checked coordinates of a texture, shape (n, 2) or (m, 3, 2)."""
    if value is None:
        raise ArgumentTypeError("texture_coordinates", "u, v of the vertices or corners for a Texture", "None")
    given = as_array("texture_coordinates", value, "shape (n, 2) or (m, 3, 2)")
    if given.ndim not in {2, 3}:
        raise ArgumentValueError("texture_coordinates", "shape (n, 2) or (m, 3, 2)", given.shape)
    return array("texture_coordinates", given, ("n", 2) if given.ndim == 2 else ("m", 3, 2))


def _luminance(name: str, colors: npt.ArrayLike, shape: tuple[str, ...]) -> Floats:
    """Return the luminance, of `shape`, of sRGB colours with three or four channels."""
    expected = " or ".join(f"shape ({', '.join(shape)}, {channels})" for channels in (3, 4)).replace("or shape", "or")
    given = as_array(name, colors, expected)
    if given.ndim != len(shape) + 1 or given.shape[-1] not in {3, 4}:
        raise ArgumentValueError(name, expected, given.shape)
    encoded = array(name, given[..., :3], (*shape, 3))
    scale = 255.0 if given.dtype.kind in "iu" else 1.0
    if ((encoded < 0.0) | (encoded > scale)).any():
        raise ArgumentValueError(name, f"numbers from 0 to {scale:g}", f"{given.min()} to {given.max()}")
    luminance = np.zeros(given.shape[:-1])
    for channel, weight in enumerate(LUMINANCE):
        luminance += weight * linear_light(encoded[..., channel] / scale)
    return luminance


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Luminance of linear red, green and blue; ITU-R BT.709."""


def linear_light(encoded: Floats) -> Floats:
    """Return linear light from values encoded as in IEC 61966-2-1, sRGB."""
    linear: Floats = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear


def named(name: str) -> Material:
    """Return a material of the library by its name.

    Parameters
    ----------
    name : str
        Name of a constant of this module, in lower or upper case, such as "asphalt" or "GRASS_1550".

    Returns
    -------
    Material
        The material.

    Raises
    ------
    TypeError, ValueError
        If there is no material of this name; the message lists similar names.
    """
    if not isinstance(name, str):
        raise ArgumentTypeError("name", "the name of a material", shown(name))
    known = {key.lower(): key for key in SOURCES}
    if name.lower() not in known:
        near = difflib.get_close_matches(name.lower(), known)
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(known)}"
        raise ArgumentValueError("name", "the name of a material", shown(name), hint)
    found: Material = globals()[known[name.lower()]]
    return found


SOURCES: dict[str, str] = {}
"""Where the values of each material of the library are from, by name: author, year, title, address, range."""


def _cited(
    name: str,
    source: str,
    *,
    reflectivity: float,
    roughness: float = 0.0,
    transmission: float = 0.0,
    mirror: float = 0.0,
    texture: tuple[float, float] | None = None,
) -> Material:
    """Return a material; `texture`: how much intensities of such surfaces scatter in two captures."""
    variation = 0.0
    if texture is not None:
        source += f". {_TEXTURE}, {texture[0]} and {texture[1]}"
        variation = round(sum(texture) / 2, 2)
    SOURCES[name] = source
    return Material(
        reflectivity=reflectivity,
        roughness=roughness,
        transmission=transmission,
        mirror=mirror,
        variation=variation,
        grain=_GRAIN,
    )


# Pulses along a ring are 3 cm apart at 10 m, where most points of the captures lie, and their intensities scatter
# independently.
_GRAIN = 0.03
_TEXTURE = (
    "Variation: robust scatter of intensities along rings, from second differences, of SemanticKITTI 00 and 08 "
    "(samples in ika-rwth-aachen/PCLSegmentation, CC BY-NC-SA 4.0; statistics only), mean of the two"
)


# Collections of spectra
_KLUM = (
    "R. Ilehag, A. Schenk, Y. Huang and S. Hinz, 2019, KLUM: An Urban VNIR and SWIR Spectral Library Consisting of "
    "Building Materials, Remote Sensing 11 (18) 2149, https://doi.org/10.3390/rs11182149"
)
_ECOSTRESS = (
    "S. K. Meerdink, S. J. Hook, D. A. Roberts and E. A. Abbott, 2019, The ECOSTRESS spectral library version 1.0, "
    "Remote Sensing of Environment 230, 111196, https://speclib.jpl.nasa.gov, by the R package photobiologyFilters"
)
_EARTHLIB = (
    "C. Anderson, 2026, earthlib 1.1, a global spectral library, https://pypi.org/project/earthlib, from "
    "https://ecosis.org/package/urban-reflectance-spectra-from-santa-barbara--ca and others"
)
_ASAM = (
    "Persival GmbH, 2025, ASAM OpenX assets, models/materials, https://github.com/Persival-GmbH/asam-openx-assets: "
    "the nearest of its classes of 10, 20, 50, 80 and 95 % at 905 nm, a coarse scale"
)
_COATING = (
    "R. Levinson et al., 2011, Potential benefits of solar reflective car shells: Cooler cabins, fuel savings and "
    "emission reductions, Applied Energy, by https://en.paperblog.com/"
    "solar-reflective-car-shells-simple-as-black-and-white-90166: reflectance of all sunlight"
)

# No roughness of these surfaces at these wavelengths was found in publications. With a roughness m of 0.3 and a
# reflectivity of 0.17, a road returns as much as the captures show up to 100 m; m of 0.2 and 0.25 do so for others.
_ROAD = 0.3
_ROAD_SOURCE = (
    "Roughness: fitted to captures, the share of returns from a road by range of an Ouster OS1-128 (ouster-sdk "
    "46b7bcee, tests/pcaps and tests/osfs); 0.2 for a Velodyne VLS-128 (tier4/nebula 606ac41f)"
)

ASPHALT = _cited(
    "ASPHALT",
    f"{_KLUM}: 0.13 to 0.30 for four weathered roads, median 0.15. {_ECOSTRESS}: 0.11. {_EARTHLIB}: 0.05 to 0.33 "
    "for 170 roads of Santa Barbara, median 0.11. 0.17 is the reflectivity with which the roughness was fitted. "
    f"{_ROAD_SOURCE}",
    reflectivity=0.17,
    roughness=_ROAD,
    texture=(0.13, 0.18),
)
ASPHALT_1550 = _cited(
    "ASPHALT_1550",
    f"{_KLUM}: 0.16 to 0.34, median 0.18. {_ECOSTRESS}: 0.15. {_EARTHLIB}: 0.05 to 0.39, median 0.14. In each, 1.2 "
    f"to 1.3 times the value at 905 nm, and so here. {_ROAD_SOURCE}",
    reflectivity=0.21,
    roughness=_ROAD,
    texture=(0.13, 0.18),
)
ASPHALT_LIGHT = _cited(
    "ASPHALT_LIGHT",
    f"{_KLUM}: the brightest of four roads, A003, 0.30. {_ROAD_SOURCE}",
    reflectivity=0.3,
    roughness=_ROAD,
    texture=(0.13, 0.18),
)
ASPHALT_LIGHT_1550 = _cited(
    "ASPHALT_LIGHT_1550",
    f"{_KLUM}: the brightest of four roads, A003, 0.34. {_ROAD_SOURCE}",
    reflectivity=0.34,
    roughness=_ROAD,
    texture=(0.13, 0.18),
)
CONCRETE = _cited(
    "CONCRETE",
    f"{_KLUM}: 0.18 to 0.51 for seven grey grounds, median 0.31. {_ECOSTRESS}: 0.36. {_EARTHLIB}: quartiles 0.27 and "
    "0.37 of 60 sidewalks. Roughness: that of ASPHALT is assumed",
    reflectivity=0.32,
    roughness=_ROAD,
    texture=(0.08, 0.10),
)
CONCRETE_1550 = _cited(
    "CONCRETE_1550",
    f"{_KLUM}: 0.21 to 0.52, median 0.35. {_ECOSTRESS}: 0.33. {_EARTHLIB}: quartiles 0.32 and 0.43. Roughness: that of "
    "ASPHALT is assumed",
    reflectivity=0.35,
    roughness=_ROAD,
    texture=(0.08, 0.10),
)

# At grazing incidence, paint with glass beads returns π·R_L of what a white diffuser does at normal incidence. R_L is
# its coefficient of retroreflected luminance. At the greatest roughness, this is 0.43 of the reflectivity.
_BEADS = math.pi / 2
_BEADS_SOURCE = "in visible light at grazing incidence"

ROAD_PAINT = _cited(
    "ROAD_PAINT",
    "ASTM D6359, by NC Data Summary, 2003, http://www.docstoc.com/docs/104744193/NC-Data-Summary: new white markings, "
    f"at least 250 mcd/m²/lx, {_BEADS_SOURCE}. Without beads, {_EARTHLIB}: 0.12 to 0.62 for 76 paints",
    reflectivity=1.8,
    roughness=_BEADS,
)
ROAD_PAINT_WORN = _cited(
    "ROAD_PAINT_WORN",
    "H.-S. Lee and H.-U. Oh, 2005, Minimum retroreflectivity for pavement markings by driver's static test response, "
    "Journal of the Eastern Asia Society for Transportation Studies 6, 1089-1099, https://www.scribd.com/document/"
    f"436168756/road-mar-kind: white markings in service, at least 130 to 140 mcd/m²/lx, {_BEADS_SOURCE}",
    reflectivity=0.94,
    roughness=_BEADS,
)
SIGN_SHEETING = _cited(
    "SIGN_SHEETING",
    "ASTM D4956, 2001, white sheeting of type III, by http://www.angelfire.com/trek/cityton/american.htm: at least "
    "250 cd/lx/m² at 0.2° between source and eye, and 300 at 0.1°, in visible light, times π for a white diffuser's "
    "1/π; type I has 70",
    reflectivity=785.0,
)

GRASS = _cited("GRASS", f"{_ECOSTRESS}: green grass, 0.51", reflectivity=0.51, texture=(0.16, 0.14))
GRASS_1550 = _cited("GRASS_1550", f"{_ECOSTRESS}: green grass, 0.24", reflectivity=0.24, texture=(0.16, 0.14))
GRASS_DRY = _cited("GRASS_DRY", f"{_ECOSTRESS}: dry grass, 0.60", reflectivity=0.6, texture=(0.16, 0.14))
GRASS_DRY_1550 = _cited("GRASS_DRY_1550", f"{_ECOSTRESS}: dry grass, 0.57", reflectivity=0.57, texture=(0.16, 0.14))
FOLIAGE = _cited("FOLIAGE", f"{_ECOSTRESS}: deciduous trees, 0.55", reflectivity=0.55, texture=(0.19, 0.29))
FOLIAGE_1550 = _cited("FOLIAGE_1550", f"{_ECOSTRESS}: deciduous trees, 0.25", reflectivity=0.25, texture=(0.19, 0.29))
CONIFER = _cited("CONIFER", f"{_ECOSTRESS}: conifers, 0.52", reflectivity=0.52, texture=(0.19, 0.29))
CONIFER_1550 = _cited("CONIFER_1550", f"{_ECOSTRESS}: conifers, 0.19", reflectivity=0.19, texture=(0.19, 0.29))
BARK = _cited("BARK", f"{_EARTHLIB}: quartiles 0.32 and 0.46 of 33 barks, median 0.37", reflectivity=0.37)
BARK_1550 = _cited("BARK_1550", f"{_EARTHLIB}: quartiles 0.44 and 0.50 of 33 barks, median 0.46", reflectivity=0.46)
SOIL = _cited(
    "SOIL",
    f"{_EARTHLIB}: ICRAF-ISRIC, quartiles 0.29 and 0.44 of 4168 soils, median 0.37",
    reflectivity=0.37,
    texture=(0.16, 0.14),
)
SOIL_1550 = _cited(
    "SOIL_1550",
    f"{_EARTHLIB}: ICRAF-ISRIC, quartiles 0.39 and 0.55 of 4168 soils, median 0.47",
    reflectivity=0.47,
    texture=(0.16, 0.14),
)
SNOW = _cited("SNOW", f"{_ECOSTRESS}: 0.91 for fine, 0.84 for medium, 0.77 for coarse grains", reflectivity=0.84)
SNOW_1550 = _cited(
    "SNOW_1550", f"{_ECOSTRESS}: 0.11 for fine, 0.02 for medium, 0.01 for coarse grains", reflectivity=0.02
)

BRICK = _cited(
    "BRICK",
    f"{_KLUM}: 0.33 to 0.62 for six new red facades, median 0.45; 0.22 weathered",
    reflectivity=0.45,
    texture=(0.06, 0.17),
)
BRICK_1550 = _cited(
    "BRICK_1550",
    f"{_KLUM}: 0.50 to 0.89 for seven new red facades, median 0.69; 0.50 weathered",
    reflectivity=0.69,
    texture=(0.06, 0.17),
)
PLASTER = _cited(
    "PLASTER", f"{_KLUM}: 0.50 to 0.76 for five bright facades, median 0.68", reflectivity=0.68, texture=(0.06, 0.17)
)
PLASTER_1550 = _cited(
    "PLASTER_1550",
    f"{_KLUM}: 0.57 to 0.83 for five bright facades, median 0.68",
    reflectivity=0.68,
    texture=(0.06, 0.17),
)
ROOF_TILE = _cited("ROOF_TILE", f"{_KLUM}: 0.24 to 0.43 for eight red matte tiles, median 0.38", reflectivity=0.38)
ROOF_TILE_1550 = _cited(
    "ROOF_TILE_1550", f"{_KLUM}: 0.50 to 0.71 for eight red matte tiles, median 0.66", reflectivity=0.66
)
PAINTED_METAL = _cited(
    "PAINTED_METAL", f"{_KLUM}: 0.10 to 0.29 for eight grey, red, blue and green samples, median 0.20", reflectivity=0.2
)
PAINTED_METAL_1550 = _cited(
    "PAINTED_METAL_1550", f"{_KLUM}: 0.12 to 0.41 for nine such samples, median 0.15", reflectivity=0.15
)
CAR_PAINT_DARK = _cited(
    "CAR_PAINT_DARK",
    f"{_COATING}, 0.05 for a black car; the highlight of its lacquer is left out",
    reflectivity=0.05,
    texture=(0.33, 0.35),
)
CAR_PAINT_DARK_1550 = _cited(
    "CAR_PAINT_DARK_1550",
    f"{_KLUM}: 0.02 for black paint sprayed on metal, H001",
    reflectivity=0.02,
    texture=(0.33, 0.35),
)
CAR_PAINT_LIGHT = _cited(
    "CAR_PAINT_LIGHT",
    f"{_COATING}, 0.57 to 0.60 for silver and white cars; the highlight of their lacquer is left out. {_ASAM}: 0.5 for "
    "grey, red and yellow, 0.8 for white",
    reflectivity=0.6,
    texture=(0.33, 0.35),
)
RUBBER = _cited("RUBBER", f"{_ASAM}: black rubber, 0.1", reflectivity=0.1)
SKIN = _cited("SKIN", f"{_ASAM}: 0.5", reflectivity=0.5)
CLOTH = _cited("CLOTH", f"{_ASAM}: blue denim, 0.2", reflectivity=0.2)
CLOTH_DARK = _cited("CLOTH_DARK", f"{_ASAM}: dark cotton, dark synthetics and leather, 0.1", reflectivity=0.1)
CLOTH_LIGHT = _cited("CLOTH_LIGHT", f"{_ASAM}: green and orange cotton, 0.8", reflectivity=0.8)

# Surfaces that light goes on from

_PANE = (
    "ASHRAE Handbook, Fundamentals, 2017, chapter 15: clear glass of 3 mm transmits 0.77 to 0.78 and mirrors 0.07 of "
    "sunlight at normal incidence. M. Rubin, 1985, Optical properties of soda lime silica glasses, Solar Energy "
    "Materials 12, 275-288, by https://refractiveindex.info/?shelf=3d&book=glass&page=soda-lime-clear: index 1.515 at "
    "905 nm, by which each face mirrors 0.042"
)

GLASS = _cited(
    "GLASS",
    f"{_PANE}. Reflectivity: 0.01 is assumed, for dust; the glint of a pane that faces the sensor is left out",
    reflectivity=0.01,
    transmission=0.77,
    mirror=0.07,
)
MIRROR = _cited(
    "MIRROR",
    f"{_PANE}. So a pane absorbs 0.16 on each way; with 0.97 for silver, a silvered pane mirrors 0.042 + "
    "0.918·0.84²·0.97 = 0.68. Reflectivity: 0.01 is assumed, for dust",
    reflectivity=0.01,
    mirror=0.68,
)
NET = _cited(
    "NET",
    "J. W. Bartok, 2019, Selecting shade material, Greenhouse Management, "
    "https://www.greenhousemag.com/article/tech-solutions-selecting-shade-material/: shade nets cover 0.1 to 0.9 of "
    "the area; here half is open. Reflectivity: half of 0.5 is assumed, for fabric",
    reflectivity=0.25,
    transmission=0.5,
)
ASPHALT_WET = _cited(
    "ASPHALT_WET",
    "Diffuse light: J. Lekner and M. C. Dorf, 1988, Why some things are darker when wet, Applied Optics 27, 1278-1280, "
    "citing A. Ångström, 1925: a/(n²·(1 - a) + a) for a film of index n = 1.33 on a ground of reflectivity a; 0.17, "
    "that of ASPHALT, becomes 0.10. Mirrored light: Fresnel's equations for such a film at an incidence of 70°, 0.13; "
    "it is 0.02 at 0° and 0.35 at 80°. The film follows M. Hahner et al., 2022, LiDAR snowfall simulation for robust "
    f"3D object detection, https://github.com/SysCV/LiDAR_snow_sim. {_ROAD_SOURCE}, of dry roads",
    reflectivity=0.1,
    roughness=_ROAD,
    mirror=0.13,
)
