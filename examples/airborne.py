"""Fly a strip over a village, and draw its roofs, trees and ground by class; writes airborne.png."""

from __future__ import annotations

import dataclasses

import numpy as np

import lidarsim as ls

village = ls.worlds.street(8, "residential", length=260)
lidar = ls.Lidar.preset("riegl-vq780i", noise="datasheet")
lidar = dataclasses.replace(lidar, pattern=dataclasses.replace(lidar.pattern, rate=0.25))  # 4 s in one frame

# 350 m above the ground at 60 m/s; the scanner's x axis points down, its z axis ahead.
start = np.array([[0, 0, 1, -120.0], [0, 1, 0, 0], [-1, 0, 0, 350], [0, 0, 0, 1]])
flight = ls.Trajectory.from_twist(start, linear=(0, 0, 60), angular=(0, 0, 0))
scan = lidar.scan(village.scene, flight, seed=1)
strip = scan.point_cloud("world")
print(scan.summary())
strip.plot(color_by="label", camera=[(-95, -95, 75), (0, 5, 0), (0, 0, 1)], size=(1100, 620), save="airborne.png")
