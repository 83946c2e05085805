"""Formats that are not read, each with a program that converts it."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

from lidarsim.errors import FileFormatError

CONVERTERS = {
    ".3ds": ("3DS", "GLB with assimp"),
    ".3dxml": ("3DXML", "GLB with trimesh"),
    ".3mf": ("3MF", "OBJ with PrusaSlicer"),
    ".abc": ("Alembic", "GLB with Blender"),
    ".ac": ("AC3D", "GLB with assimp"),
    ".amf": ("AMF", "OBJ with PrusaSlicer"),
    ".b3dm": ("3D Tiles", "GLB with 3d-tiles-tools"),
    ".blend": ("Blender", "GLB with Blender"),
    ".brep": ("BREP", "OBJ with FreeCAD"),
    ".c4d": ("Cinema 4D", "GLB with Cinema 4D"),
    ".cityjson": ("CityJSON", "OBJ or GLB with cjio"),
    ".dwg": ("DWG", "OBJ with AutoCAD"),
    ".dxf": ("DXF", "OBJ with FreeCAD"),
    ".fbx": ("FBX", "GLB with Blender or FBX2glTF"),
    ".fcstd": ("FreeCAD", "OBJ with FreeCAD"),
    ".gml": ("CityGML", "OBJ with CityGML2OBJs"),
    ".ifc": ("IFC", "GLB with IfcConvert"),
    ".ifczip": ("IFC", "GLB with IfcConvert"),
    ".iges": ("IGES", "OBJ with FreeCAD"),
    ".igs": ("IGES", "OBJ with FreeCAD"),
    ".json": ("JSON", "OBJ or GLB with cjio if it is CityJSON"),
    ".lwo": ("LightWave", "GLB with assimp"),
    ".lws": ("LightWave", "GLB with assimp"),
    ".ma": ("Maya", "OBJ with Maya"),
    ".max": ("3ds Max", "GLB with 3ds Max"),
    ".mb": ("Maya", "OBJ with Maya"),
    ".rvt": ("Revit", "OBJ with Revit"),
    ".scad": ("OpenSCAD", "OBJ with OpenSCAD"),
    ".sdf": ("SDF of Gazebo", "MJCF with gz-mujoco"),
    ".skp": ("SketchUp", "GLB with SketchUp"),
    ".sldasm": ("SolidWorks", "GLB with SolidWorks"),
    ".sldprt": ("SolidWorks", "GLB with SolidWorks"),
    ".step": ("STEP", "OBJ with FreeCAD"),
    ".stp": ("STEP", "OBJ with FreeCAD"),
    ".usd": ("USD", "GLB with Blender"),
    ".usda": ("USD", "GLB with Blender"),
    ".usdc": ("USD", "GLB with Blender"),
    ".usdz": ("USD", "GLB with Blender"),
    ".vtk": ("VTK", "PLY with PyVista"),
    ".vtp": ("VTK", "PLY with PyVista"),
    ".world": ("SDF of Gazebo", "MJCF with gz-mujoco"),
    ".wrl": ("VRML", "GLB with Blender"),
    ".x": ("DirectX", "GLB with assimp"),
    ".x3d": ("X3D", "GLB with Blender"),
    ".x3db": ("X3D", "GLB with Blender"),
    ".x3dv": ("X3D", "GLB with Blender"),
    ".xacro": ("xacro", "URDF with xacro"),
    ".xaml": ("XAML", "GLB with trimesh"),
    ".xodr": ("OpenDRIVE", "OBJ with libOpenDRIVE"),
}
"""Names of formats that are not read, and what to convert them to, with which program."""


def refusal(suffix: str) -> str:
    """Return the error for files of a suffix: it names the format and a program that converts it."""
    name, how = CONVERTERS[suffix]
    return f"{name} is not read; convert it to {how}"


def read(path: Path) -> NoReturn:
    """Raise an error that names the format of a file and a program that converts it."""
    raise FileFormatError(refusal(path.suffix.lower()))
