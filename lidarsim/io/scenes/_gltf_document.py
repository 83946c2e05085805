"""The document of a glTF file: what lidarsim reads of it, checked by pydantic.

pygltflib parses a document of 2,000 nodes in six times the time of a whole import, and its errors name no place in it.

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 5.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

import pydantic
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic.alias_generators import to_camel

from lidarsim.errors import FileFormatError
from lidarsim.io.scenes._model import MOST_LETTERS

LARGEST = 2**53
"""Largest integer that all JSON parsers read exactly."""


def _integral(value: object) -> object:
    """Return 24.0 as 24: JSON Schema takes it for an integer."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


Integer = Annotated[int, BeforeValidator(_integral), Field(ge=0, le=LARGEST)]
Positive = Annotated[int, BeforeValidator(_integral), Field(ge=1, le=LARGEST)]
Name = Annotated[str, Field(max_length=MOST_LETTERS)]
Vec2 = Annotated[list[float], Field(min_length=2, max_length=2)]
Vec3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vec4 = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[float], Field(min_length=16, max_length=16)]
Attributes = dict[str, Integer]
Extensions = dict[str, Any]


class Model(BaseModel):
    """An object of the document; keys that lidarsim does not read are ignored."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False, alias_generator=to_camel)


class Asset(Model):
    """What the document says about itself."""

    version: str
    min_version: str | None = None


class Buffer(Model):
    """Bytes in a file, in the document itself or in the binary chunk of a GLB."""

    uri: str | None = None
    byte_length: Positive
    extensions: Extensions = {}


class BufferView(Model):
    """A part of a buffer."""

    buffer: Integer
    byte_offset: Integer = 0
    byte_length: Positive
    byte_stride: Annotated[int, BeforeValidator(_integral), Field(ge=4, le=252)] | None = None
    extensions: Extensions = {}


ComponentType = Literal[5120, 5121, 5122, 5123, 5125, 5126]


class SparseIndices(Model):
    """Which elements differ."""

    buffer_view: Integer
    byte_offset: Integer = 0
    component_type: Literal[5121, 5123, 5125]


class SparseValues(Model):
    """The elements that differ."""

    buffer_view: Integer
    byte_offset: Integer = 0


class Sparse(Model):
    """Elements of an accessor that differ from its buffer view, or from zero."""

    count: Positive
    indices: SparseIndices
    values: SparseValues


class Accessor(Model):
    """Numbers in a buffer view."""

    buffer_view: Integer | None = None
    byte_offset: Integer = 0
    component_type: ComponentType
    normalized: bool = False
    count: Positive
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    sparse: Sparse | None = None


class Draco(Model):
    """A primitive compressed by Draco: `attributes` are the unique ids in its buffer view."""

    buffer_view: Integer
    attributes: Attributes


class PrimitiveExtensions(Model):
    """Extensions of a primitive."""

    draco: Annotated[Draco | None, Field(alias="KHR_draco_mesh_compression")] = None


class Primitive(Model):
    """Faces of one material."""

    attributes: Attributes
    indices: Integer | None = None
    material: Integer | None = None
    mode: Annotated[int, BeforeValidator(_integral), Field(ge=0, le=6)] = 4
    targets: list[Attributes] = []
    extensions: PrimitiveExtensions = PrimitiveExtensions()


class Mesh(Model):
    """Primitives, and the default weights of their morph targets."""

    name: Name = ""
    primitives: Annotated[list[Primitive], Field(min_length=1)]
    weights: list[float] | None = None


class Instancing(Model):
    """Attributes of the copies of a mesh."""

    attributes: Attributes


class Visibility(Model):
    """Whether a node and those below it are shown."""

    visible: bool = True


class NodeExtensions(Model):
    """Extensions of a node."""

    instancing: Annotated[Instancing | None, Field(alias="EXT_mesh_gpu_instancing")] = None
    visibility: Annotated[Visibility, Field(alias="KHR_node_visibility")] = Visibility()


class Node(Model):
    """A place below its parent, of a mesh and of further nodes."""

    name: Name = ""
    children: list[Integer] = []
    mesh: Integer | None = None
    skin: Integer | None = None
    matrix: Matrix | None = None
    translation: Vec3 | None = None
    rotation: Vec4 | None = None
    scale: Vec3 | None = None
    weights: list[float] | None = None
    extensions: NodeExtensions = NodeExtensions()


class Skin(Model):
    """Nodes that move the vertices of a mesh."""

    joints: Annotated[list[Integer], Field(min_length=1)]
    inverse_bind_matrices: Integer | None = None


class Scene(Model):
    """Top nodes."""

    nodes: list[Integer] = []


class Target(Model):
    """A property of a node."""

    node: Integer | None = None
    path: str


class Channel(Model):
    """What moves a property of a node."""

    sampler: Integer
    target: Target


class AnimationSampler(Model):
    """Values at times."""

    input: Integer
    output: Integer
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"] = "LINEAR"


class Animation(Model):
    """Channels that belong together."""

    name: Name = ""
    channels: Annotated[list[Channel], Field(min_length=1)]
    samplers: Annotated[list[AnimationSampler], Field(min_length=1)]


class TextureTransform(Model):
    """Offset, rotation and scale of texture coordinates."""

    offset: Vec2 = [0.0, 0.0]
    rotation: float = 0.0
    scale: Vec2 = [1.0, 1.0]
    tex_coord: Integer | None = None


class TextureInfoExtensions(Model):
    """Extensions of a reference to a texture."""

    transform: Annotated[TextureTransform | None, Field(alias="KHR_texture_transform")] = None


class TextureInfo(Model):
    """A reference to a texture."""

    index: Integer
    tex_coord: Integer = 0
    extensions: TextureInfoExtensions = TextureInfoExtensions()


class MetallicRoughness(Model):
    """The base colour."""

    base_color_factor: Vec4 = [1.0, 1.0, 1.0, 1.0]
    base_color_texture: TextureInfo | None = None


class SpecularGlossiness(Model):
    """The base colour of an older model of materials."""

    diffuse_factor: Vec4 = [1.0, 1.0, 1.0, 1.0]
    diffuse_texture: TextureInfo | None = None


class MaterialExtensions(Model):
    """Extensions of a material."""

    specular: Annotated[SpecularGlossiness | None, Field(alias="KHR_materials_pbrSpecularGlossiness")] = None


class Material(Model):
    """A material."""

    name: Name = ""
    pbr_metallic_roughness: MetallicRoughness = MetallicRoughness()
    extensions: MaterialExtensions = MaterialExtensions()


class OtherImage(Model):
    """An image of another kind."""

    source: Integer | None = None


class TextureExtensions(Model):
    """Extensions of a texture."""

    webp: Annotated[OtherImage | None, Field(alias="EXT_texture_webp")] = None


class Texture(Model):
    """An image, and how it goes on beyond its edges."""

    source: Integer | None = None
    sampler: Integer | None = None
    extensions: TextureExtensions = TextureExtensions()


Wrap = Literal[10497, 33071, 33648]


class Sampler(Model):
    """How a texture goes on beyond its edges along u (S) and v (T), and between its pixels."""

    wrap_s: Wrap = 10497
    wrap_t: Wrap = 10497
    mag_filter: Integer | None = None
    min_filter: Integer | None = None


class Image(Model):
    """An image in a file or in a buffer view."""

    uri: str | None = None
    buffer_view: Integer | None = None


class Document(Model):
    """A document."""

    asset: Asset
    extensions_required: list[str] = []
    scene: Integer | None = None
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    skins: list[Skin] = []
    animations: list[Animation] = []
    materials: list[Material] = []
    textures: list[Texture] = []
    samplers: list[Sampler] = []
    images: list[Image] = []
    accessors: list[Accessor] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []


def parse(data: bytes) -> Document:
    """Return the document in JSON; errors name the path of the first offender."""
    try:
        return Document.model_validate_json(data.removeprefix(b"\xef\xbb\xbf"))
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        if first["type"] == "json_invalid":
            raise FileFormatError(f"its JSON is damaged: {first['ctx']['error']}") from None
        if first["type"] == "missing":
            raise FileFormatError(f"{_path(first['loc'])}: missing") from None
        problem = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
        raise FileFormatError(f"{_path(first['loc'])}: expected {problem}") from None


def _path(location: tuple[int | str, ...]) -> str:
    """Return a path such as ``nodes[3].mesh``; names that only the file has are shown if they are short words."""
    words = (key if isinstance(key, int) or re.fullmatch(r"\w{1,40}", key) else "…" for key in location)
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in words).removeprefix(".") or "document"
