"""Vendors' own files as sensors: one module per vendor, each with its registration."""

from __future__ import annotations

from lidarsim.io.vendors import hesai, livox, ouster, robosense, velodyne

__all__ = ["hesai", "livox", "ouster", "robosense", "velodyne"]
