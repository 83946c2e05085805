"""Formats that are not read, each with a program that converts it."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

from lidarsim.errors import FileFormatError

CONVERTERS = {
    ".3ds": ("3DS", "GLB with assimp"),
    ".3dxml": ("3DXML", "GLB with trimesh"),
    ".3mf": ("3MF", "OBJ with PrusaSlicer"),
    ".blend": ("Blender", "GLB with Blender"),
    ".cityjson": ("CityJSON", "OBJ or GLB with cjio"),
    ".fbx": ("FBX", "GLB with Blender or FBX2glTF"),
    ".ifc": ("IFC", "GLB with IfcConvert"),
    ".ifczip": ("IFC", "GLB with IfcConvert"),
    ".iges": ("IGES", "OBJ with FreeCAD"),
    ".json": ("JSON", "OBJ or GLB with cjio if it is CityJSON"),
    ".skp": ("SketchUp", "GLB with SketchUp"),
    ".step": ("STEP", "OBJ with FreeCAD"),
    ".stp": ("STEP", "OBJ with FreeCAD"),
    ".usd": ("USD", "GLB with Blender"),
    ".usda": ("USD", "GLB with Blender"),
    ".usdc": ("USD", "GLB with Blender"),
    ".usdz": ("USD", "GLB with Blender"),
    ".wrl": ("VRML", "GLB with Blender"),
    ".x3d": ("X3D", "GLB with Blender"),
    ".x3db": ("X3D", "GLB with Blender"),
    ".x3dv": ("X3D", "GLB with Blender"),
    ".xaml": ("XAML", "GLB with trimesh"),
    ".xodr": ("OpenDRIVE", "OBJ with libOpenDRIVE"),
}
"""Names of formats that are not read, and what to convert them to, with which program."""


def read(path: Path) -> NoReturn:
    """Raise an error that names the format of a file and a program that converts it."""
    name, how = CONVERTERS[path.suffix.lower()]
    raise FileFormatError(f"{name} is not read; convert it to {how}")
