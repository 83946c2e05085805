"""Turn a scan of configs/demo.yaml into an image, a ring a row and a column a column; writes range_image.png."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.image import imsave

import lidarsim as ls

CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"

# Any value of a configuration can be set here as on the command line.
run = ls.config.load(CONFIG, ["sensor.preset=ouster-os1-128", "sensor.noise=none"])
scan = run.scan()
image = scan.range_image()
print(f"{image.shape[0]} rings, {image.shape[1]} columns, {np.isfinite(image).mean():.0%} of the pulses came back")

# Near is bright; four pixels high, since the rings are few.
nearness = np.nan_to_num(1 / np.maximum(image, 2.0))
imsave("range_image.png", np.repeat(nearness, 4, axis=0), cmap="magma")
