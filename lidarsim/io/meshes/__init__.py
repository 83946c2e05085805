"""Formats of single meshes: one module per format, which registers itself."""

from lidarsim.io.meshes import obj, off, ply, stl  # noqa: F401 - each registers itself

SUFFIXES = (".obj", ".off", ".ply", ".stl")
