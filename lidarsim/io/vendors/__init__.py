"""Sensors from vendors' own files: one module per vendor, which registers itself."""

from __future__ import annotations

from lidarsim.io.vendors import hesai, livox, ouster, robosense, velodyne

__all__ = ["hesai", "livox", "ouster", "robosense", "velodyne"]
