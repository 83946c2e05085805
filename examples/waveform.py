"""Full waveforms of an airborne laser scanner: over a meadow, a roof and a tree, with the echoes that its scan has."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

import lidarsim as ls

HEIGHT = 300.0  # m above ground

# A tree of 6,000 leaves, 4 to 14 m above a meadow, and a roof that slopes by 45 degrees.
random = np.random.default_rng(1)
way, reach = random.normal(size=(6000, 3)), random.uniform(0.3, 1.0, (6000, 1))
leaves = (0.0, 0.0, 9.0) + (3.0, 3.0, 5.0) * reach * way / np.linalg.norm(way, axis=1, keepdims=True)
scene = ls.Scene(class_names={1: "meadow", 2: "tree", 3: "roof"})
scene.add(ls.Plane((0, 0, 1), 0.0), label=1, material=ls.Material(reflectivity=0.3))
scene.add(ls.Disks(leaves, random.normal(size=(6000, 3)), 0.06), label=2, material=ls.Material(reflectivity=0.5))
scene.add(ls.Cylinder((0, 0, 0), (0, 0, 9), 0.2), label=2, material=ls.Material(reflectivity=0.3))
ridge, eaves = [(12, -5, 7), (12, 5, 7)], [(16, 5, 3), (16, -5, 3)]
scene.add(ls.Polygon([*ridge, *eaves]), label=3, material=ls.Material(reflectivity=0.4))

# Pulses straight down, 0.25 m apart. The sensor's x axis points down.
along = np.arange(-10.0, 20.0, 0.25)
directions = np.column_stack([np.full_like(along, HEIGHT), np.zeros_like(along), along])
directions /= np.linalg.norm(directions, axis=1, keepdims=True)
beam = ls.Beam(2e-3, pulse_length=3e-9, rays=91)
lidar = ls.Lidar(ls.patterns.Table(directions, rate=10.0), measurement=ls.Measurement(beam=beam, returns=15))
down = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, HEIGHT], [0, 0, 0, 1]])
scan = lidar.scan(scene, down)
cloud = scan.point_cloud(frame="world")

# Which pulses to record: these take 4 bytes a sample, so a survey records those of interest.
chosen = [int(np.abs(along - x).argmin()) for x in (-6.0, 14.0, -1.0)]
waveforms = scan.waveforms(sample_period=1e-9, pulses=chosen)
print(waveforms)
waveforms.save("waveforms.npz")

figure, axes = plt.subplots(1, 4, figsize=(11, 4), sharey=True, width_ratios=[2.6, 1, 1, 1], layout="constrained")
colors = np.array(["#000000", "#9c755f", "#2e8b57", "#c44e52"])[cloud.label]
axes[0].scatter(cloud.xyz[:, 0], cloud.xyz[:, 2], s=6, c=colors)
axes[0].set(xlabel="x, m", ylabel="height, m", title="points of a line of pulses", xlim=(-10, 18))
for axis, pulse, (ranges, power), name in zip(axes[1:], chosen, waveforms, ("meadow", "roof", "tree"), strict=True):
    steep = -(down[:3, :3] @ directions[pulse])[2]
    axis.fill_betweenx(HEIGHT - ranges * steep, 0.0, power * HEIGHT**2, color="#4c72b0", alpha=0.35)
    axis.plot(power * HEIGHT**2, HEIGHT - ranges * steep, ".-", color="#4c72b0", linewidth=1, markersize=3)
    echoes = scan.range[pulse][: scan.return_count[pulse]]
    for echo in HEIGHT - echoes * steep:
        axis.axhline(echo, color="#c44e52", linewidth=0.8, linestyle="--")
    axes[0].axvline(along[pulse], color="#4c72b0", linewidth=0.8)
    count = len(echoes)
    axis.set(xlabel="received power · R²", title=f"{name}: {count} echo{'es' * (count != 1)}", xlim=(0.0, None))
axes[0].set_ylim(-2.5, 15.5)
figure.savefig("waveform.png", dpi=85)
