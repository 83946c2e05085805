"""Train a small network on simulated range images and test it on real ones.

Without arguments, three steps are tried. Else each argument is a sequence in SemanticKITTI's layout, such as
dataset/sequences/08: the network is tested on the first, and trained on frames of further ones, too.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import lidarsim as ls
from lidarsim.datasets.loading import LabelledFrame
from lidarsim.io.semantickitti import read_labels

WORLDS, STEPS, BATCH, CROP, SEED = 100, 1200, 4, 256, 1
SIZE, ELEVATIONS = (64, 1024), (float(np.radians(-25.0)), float(np.radians(3.0)))
CLASSES = {
    "car": [10, 252],
    "person": [30, 31, 32, 253, 254, 255],  # and riders
    "ground": [40, 44, 48, 49, 60, 72],
    "building": [50],
    "vegetation": [70, 71],
}
PATCH = (2, 4)
"""Rows and columns of pixels that the network looks at as one."""

OTHER = 255
"""Class of pixels without a point or of other things, which count neither in training nor in tests."""

Images = npt.NDArray[np.float32]
Classes = npt.NDArray[np.uint8]


def image(frame: LabelledFrame) -> tuple[Images, Classes]:
    """Return ranges and heights (m) and intensities as images, 0 where there is no point, and classes of the pixels."""
    fields = "range", "xyz", "intensity", "label"
    distance, xyz, intensity, label = (frame.image(of, size=SIZE, elevations=ELEVATIONS) for of in fields)
    class_of = np.full(2**16, OTHER, np.uint8)
    for number, labels in enumerate(CLASSES.values()):
        class_of[labels] = number
    seen = distance > 0  # not where it is NaN
    channels = np.where(seen, [distance, xyz[..., 2], intensity], 0.0)
    return channels.astype(np.float32), np.where(seen, class_of[label], OTHER).astype(np.uint8)


def real(sequence: Path | str) -> list[LabelledFrame]:
    """Return the frames of a sequence in SemanticKITTI's layout."""
    frames = []
    for number, path in enumerate(sorted(Path(sequence, "velodyne").glob("*.bin"))):
        cloud = ls.PointCloud.load(path)
        cloud.label, cloud.instance = read_labels(Path(sequence, "labels", f"{path.stem}.label"))
        frames.append(LabelledFrame(cloud, None, np.eye(4), np.eye(4), 0.0, 0, number, "", ""))
    return frames


def augment(rng: np.random.Generator, channels: Images, classes: Classes) -> tuple[Images, Classes]:
    """Return part of a frame turned, mirrored, scaled and tilted at random, with more noise and more gaps."""
    rows, columns = classes.shape
    turn, mirror = rng.integers(columns), rng.choice([-1, 1])
    distance, height, intensity = np.roll(channels, turn, axis=2)[..., ::mirror][..., :CROP]
    classes = np.roll(classes, turn, axis=1)[:, ::mirror][:, :CROP]
    azimuth = np.linspace(0.0, 2 * np.pi, columns)[:CROP]
    height = height + distance * (rng.normal(0, 0.01, 2) @ [np.cos(azimuth), np.sin(azimuth)]) + rng.normal(0, 0.1)
    scale = rng.lognormal(0, 0.06) * (1 + rng.normal(0, 0.02, classes.shape) / np.maximum(distance, 1.0))
    gaps = rng.random(classes.shape) < rng.uniform(0.0, 0.3)
    v, u = np.ogrid[:rows, :CROP]
    for _ in range(rng.integers(2, 8)):  # what stands on the roof hides parts of the ground nearby
        across = (u - rng.integers(columns)) % columns - columns / 2
        gaps |= (across / rng.uniform(15, 145)) ** 2 + ((v - rows + rng.uniform(0, 12)) / rng.uniform(4, 18)) ** 2 < 1
    patches = np.kron(rng.random((rows // 4, CROP // 8)), np.ones((4, 8))) < rng.uniform(0.0, 0.4)
    gaps |= (classes == list(CLASSES).index("car")) & patches  # dark or smooth paint returns little
    intensity = intensity ** rng.lognormal(0, 0.25) * rng.lognormal(0, 0.2)  # sensors differ most in their intensities
    intensity = intensity + rng.uniform(0.0, 0.06) * rng.normal(size=classes.shape)
    intensity = np.where(intensity < rng.uniform(0.0, 0.15), 0.0, intensity).clip(0.0, 1.0)
    seen = (distance > 0) & ~gaps
    channels = np.where(seen, [distance * scale, height * scale, intensity], 0.0)
    return channels.astype(np.float32), np.where(seen, classes, OTHER).astype(np.uint8)


def features(channels: Images) -> Images:
    """Return the input of the network for images (n, 3, rows, columns): the three, steps and gaps, scaled."""
    distance, height, intensity = channels.swapaxes(0, 1)
    seen = distance > 0
    step = np.arcsinh(distance - np.roll(distance, 1, axis=-1)) * (seen & np.roll(seen, 1, axis=-1))
    scaled = (np.log1p(distance) - 2.5) * seen, height / 2, step, 4 * (intensity - 0.3) * seen, seen
    return np.stack(scaled, axis=1).astype(np.float32)


def network() -> Any:
    """Return a U-Net of 270,000 weights whose images close around the sensor."""
    import torch
    from torch import nn

    class Skip(nn.Sequential):
        """The input beside what coarser layers make of it."""

        def forward(self, images: Any) -> Any:
            coarse = nn.functional.interpolate(super().forward(images), size=images.shape[2:])
            return torch.cat([images, coarse], dim=1)

    def layer(inputs: int, outputs: int, stride: int = 1) -> nn.Module:
        closed = nn.CircularPad2d((1, 1, 0, 0))
        convolution = nn.Conv2d(inputs, outputs, 3, stride, padding=(1, 0), bias=False)
        return nn.Sequential(closed, convolution, nn.BatchNorm2d(outputs), nn.LeakyReLU(0.1))

    inner = Skip(layer(48, 64, 2), layer(64, 64), Skip(layer(64, 64, 2), layer(64, 64)), layer(128, 48))
    inner = Skip(layer(32, 48, 2), inner, layer(96, 32))
    patches = nn.Sequential(nn.Conv2d(5, 32, PATCH, PATCH, bias=False), nn.BatchNorm2d(32), nn.LeakyReLU(0.1))
    return nn.Sequential(
        patches, layer(32, 32), inner, layer(64, 32), nn.ConvTranspose2d(32, len(CLASSES), PATCH, PATCH)
    )


def loss_of(scores: Any, classes: Any) -> Any:
    """Return cross entropy and what is missing to an intersection over union of 1, so that rare classes count, too."""
    from torch.nn.functional import cross_entropy, one_hot

    known = classes != OTHER
    true = one_hot(classes[known], len(CLASSES))
    found = scores.softmax(1).movedim(1, -1)[known]
    both, union = (true * found).sum(0), (true + found - true * found).sum(0)
    missing = (1 - both / union)[true.any(dim=0)].mean()
    return cross_entropy(scores, classes, ignore_index=OTHER) + missing


def train(groups: list[list[LabelledFrame]], steps: int, seed: int) -> Any:
    """Return a network trained on groups of frames, each of which gives as many as the others."""
    import torch

    torch.manual_seed(seed)
    rng, net = np.random.default_rng(seed), network()
    optimizer = torch.optim.AdamW(net.parameters(), weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=steps)
    images = [[image(frame) for frame in frames] for frames in groups]
    for step in range(steps):
        frames = [of[rng.integers(len(of))] for of in (images[k % len(images)] for k in range(BATCH))]
        channels, classes = map(np.stack, zip(*(augment(rng, *frame) for frame in frames), strict=True))
        loss = loss_of(net(torch.from_numpy(features(channels))), torch.from_numpy(classes).long())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % 50 == 0 or step == steps - 1:
            print(f"step {step + 1} of {steps}: loss {loss.item():.3f}", flush=True)
    return net


def classify(net: Any, channels: Images) -> npt.NDArray[np.int64]:
    """Return the class of each pixel by the mean of four views: also mirrored, and moved by half a patch."""
    import torch

    total = np.zeros((len(CLASSES), *channels.shape[1:]), np.float32)
    for mirror in (1, -1):
        for shift in (np.zeros(2, int), np.array(PATCH) // 2):
            view = np.roll(channels, shift, axis=(1, 2))[..., ::mirror]
            with torch.no_grad():
                shares = net(torch.from_numpy(features(view[None])))[0].softmax(0).numpy()
            total += np.roll(shares[..., ::mirror], -shift, axis=(1, 2))
    return total.argmax(axis=0)


def confusion(net: Any, frames: list[LabelledFrame]) -> npt.NDArray[np.int64]:
    """Return how many pixels of each class (rows) are taken for each class (columns)."""
    count = np.zeros((len(CLASSES), len(CLASSES)), np.int64)
    net.eval()
    for channels, classes in map(image, frames):
        known = classes != OTHER
        np.add.at(count, (classes[known], classify(net, channels)[known]), 1)
    return count


def report(count: npt.NDArray[np.int64]) -> str:
    """Return intersection over union by class, and which share of each class is taken for which."""
    both = np.diag(count)
    union = count.sum(0) + count.sum(1) - both
    iou = np.divide(both, union, out=np.full(len(both), np.nan), where=union > 0)
    lines = [f"mean IoU {np.nanmean(iou):.3f}", " " * 16 + "".join(f"{name:>11}" for name in ("IoU", *CLASSES))]
    for name, value, row in zip(CLASSES, iou, count / np.maximum(count.sum(1, keepdims=True), 1), strict=True):
        lines.append(f"{name:>16}" + "".join(f"{share:11.3f}" for share in (value, *row)))
    return "\n".join(lines)


def main(sequences: list[str], worlds: int = WORLDS, steps: int = STEPS, seed: int = SEED) -> None:
    """Generate, train and test."""
    ls.generate("segmentation", "simulated", sequences=worlds, frames=1, seed=1, pictures=0)
    simulated = list(ls.datasets.load("simulated"))
    shares = np.bincount(np.stack([image(frame)[1] for frame in simulated]).ravel(), minlength=256) / worlds
    print("pixels per simulated frame:", ", ".join(f"{n:.0f} {name}" for n, name in zip(shares, CLASSES, strict=False)))
    try:
        import torch
    except ImportError:
        print("to train: pip install torch")
        return
    torch.set_num_threads(2)
    tested, *more = [real(sequence) for sequence in sequences] or [simulated]
    net = train([simulated, *more], steps, seed)
    print(report(confusion(net, tested)))


if __name__ == "__main__":
    given = sys.argv[1:]
    main(given) if given else main([], worlds=2, steps=3)
