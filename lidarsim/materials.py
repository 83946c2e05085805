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
import tomllib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from lidarsim import _native as core
from lidarsim._base import names
from lidarsim._base.pickling import Value
from lidarsim._base.validation import Floats, angle, array, as_array, freeze, in_order, one_of, real, short_repr
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
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        return cls(**contents)


def _wrap(value: object) -> tuple[Wrap, Wrap]:
    """Return the checked argument `wrap` of a texture, for u and v."""
    pair = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
    if len(pair) != 2:
        raise ArgumentValueError("wrap", "one for u and one for v", short_repr(value))
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
        says, if texture coordinates are not finite, have another shape, are missing, or come without a texture, or if
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

    @names.explain_arguments
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
            self._texture_map = self._reflectivity._native.map(_texture_coordinates(texture_coordinates))
        elif texture_coordinates is not None:
            expected = "None, or a Texture as the reflectivity"
            raise ArgumentTypeError("texture_coordinates", expected, short_repr(texture_coordinates))

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
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
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
            raise ArgumentTypeError("reflectivity", "a Texture with per='texture'", short_repr(value))
        return value
    if isinstance(value, Texture):
        raise ArgumentTypeError("reflectivity", f"numbers with per={per!r}", "a Texture")
    if per == "object":
        if isinstance(value, (np.ndarray, list, tuple)):
            expected = "one number, or an array with per='face' or per='vertex'"
            raise ArgumentTypeError("reflectivity", expected, short_repr(value))
        return real("reflectivity", value, at_least=0.0)
    values = array("reflectivity", value, ("n",))
    if (values < 0.0).any():
        index = int(np.argmax(values < 0.0))
        raise ArgumentValueError("reflectivity", "numbers >= 0", f"reflectivity[{index}] = {values[index]}")
    return freeze(values)


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
        raise ArgumentTypeError("name", "the name of a material", short_repr(name))
    library, _ = _library()
    known = {key.lower(): key for key in library}
    if name.lower() not in known:
        near = difflib.get_close_matches(name.lower(), known)
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(known)}"
        raise ArgumentValueError("name", "the name of a material", short_repr(name), hint)
    return library[known[name.lower()]]


@cache
def _library() -> tuple[dict[str, Material], dict[str, str]]:
    """Return the materials of materials.toml and their sources, by name."""
    with Path(__file__).with_suffix(".toml").open("rb") as file:
        entries = tomllib.load(file)
    texts, grain = entries.pop("sources"), entries.pop("grain")
    library, sources = {}, {}
    for name, values in entries.items():
        source = values.pop("source")
        if scatter := values.pop("scatter", None):
            source += f". {{scatter}}, {scatter[0]} and {scatter[1]}"
            values["variation"] = round(sum(scatter) / 2, 2)
        sources[name] = source.format_map(texts)
        library[name] = Material(**values, grain=grain)
    return library, sources


if TYPE_CHECKING:
    SOURCES: dict[str, str]
    """Where the values of each material of the library are from, by name: author, year, title, address, range."""
    ASPHALT: Material
    ASPHALT_1550: Material
    ASPHALT_LIGHT: Material
    ASPHALT_LIGHT_1550: Material
    CONCRETE: Material
    CONCRETE_1550: Material
    ROAD_PAINT: Material
    ROAD_PAINT_WORN: Material
    SIGN_SHEETING: Material
    GRASS: Material
    GRASS_1550: Material
    GRASS_DRY: Material
    GRASS_DRY_1550: Material
    FOLIAGE: Material
    FOLIAGE_1550: Material
    CONIFER: Material
    CONIFER_1550: Material
    BARK: Material
    BARK_1550: Material
    SOIL: Material
    SOIL_1550: Material
    SNOW: Material
    SNOW_1550: Material
    BRICK: Material
    BRICK_1550: Material
    PLASTER: Material
    PLASTER_1550: Material
    ROOF_TILE: Material
    ROOF_TILE_1550: Material
    PAINTED_METAL: Material
    PAINTED_METAL_1550: Material
    CAR_PAINT_DARK: Material
    CAR_PAINT_DARK_1550: Material
    CAR_PAINT_LIGHT: Material
    RUBBER: Material
    SKIN: Material
    CLOTH: Material
    CLOTH_DARK: Material
    CLOTH_LIGHT: Material
    GLASS: Material
    MIRROR: Material
    NET: Material
    ASPHALT_WET: Material
else:

    def __getattr__(name: str) -> object:
        """Read the library when its first name is used, so that `import lidarsim` stays fast."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        library, sources = _library()
        globals().update(library, SOURCES=sources)
        return globals()[name]

    def __dir__() -> list[str]:
        return __all__
