"""Formats of single meshes: one module per format, which registers itself."""

from lidarsim.io.meshes import obj, off, ply, stl

SUFFIXES = (".obj", ".off", ".ply", ".stl")
