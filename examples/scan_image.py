"""Render a scan of configs/demo.yaml as images of ranges and surface normals; writes scan_image.png."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.image import imsave

import lidarsim as ls

CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"

# Any value of a configuration can be overridden, as on the command line.
run = ls.config.load(CONFIG, ["sensor.preset=ouster-os1-128", "sensor.noise=none"])
scan = run.scan()
image = scan.image("range")
print(f"{image.shape[0]} rings, {image.shape[1]} columns, {np.isfinite(image).mean():.0%} of the pulses came back")

# Above: near is bright. Below: red faces forward, green left and blue up. Each ring is three pixels high.
nearness = colormaps["magma"](np.nan_to_num(5 / np.maximum(image, 5.0)))[..., :3]
normals = np.nan_to_num(scan.image("normal") / 2 + 0.5)
imsave("scan_image.png", np.repeat(np.concatenate([nearness, normals]), 3, axis=0))
