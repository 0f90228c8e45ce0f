# SPDX-License-Identifier: Apache-2.0
"""Grain of a plate: what is found against what is there after an encoder, and what it costs.

    python benchmarks/grain.py [--width W] [--runs N]

The plate stands still, so the standard deviation over time of each pixel is its true grain: median over the pixels of a
brightness, in 8-bit codes. Costs are processor time of laying an ellipse over a frame, in turns without and with grain.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from mr360uw.base.color import encode
from mr360uw.composite.tiles import empty_tile
from mr360uw.types import Floats, Layer, Rectangle
from mr360uw.video import VideoFrame, open_video

_FRAMES = 12


def picture(width: int) -> Floats:
    """Return a linear plate (H, W, 3): water, and below it a rough floor in patches."""
    rng = np.random.default_rng(1)
    height = width // 2
    up = np.linspace(1.0, 0.0, height)[:, None, None]
    rough = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), 2.0)
    patches = np.clip(cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), width / 30) * width / 10, 0.0, 1.0)
    floor = np.clip(1.0 + 4.0 * patches * rough, 0.2, 3.0)[..., None] * np.array([0.16, 0.2, 0.18])
    water = np.array([0.03, 0.16, 0.25]) + up**3 * np.array([0.2, 0.4, 0.45])
    return np.where(np.arange(height)[:, None, None] > 0.62 * height, floor, water)


def write(path: Path, linear: Floats, rate_factor: int) -> None:
    """Write a clip with photon and read noise, blurred as by demosaicing, at a constant rate factor of x264."""
    rng = np.random.default_rng(2)
    deviation = np.sqrt(2e-5 + 6e-4 * linear)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(30))
        stream.width, stream.height, stream.pix_fmt = linear.shape[1], linear.shape[0], "yuv420p"
        stream.options = {"crf": str(rate_factor), "preset": "veryfast"}
        for _ in range(_FRAMES):
            noise = cv2.GaussianBlur(rng.standard_normal(linear.shape), (0, 0), 0.6)
            light = np.clip(linear + deviation * noise / noise.std(), 0.0, 1.0)
            codes = np.floor(255.0 * encode(light, "srgb") + 0.5).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(codes, format="rgb24")))
        container.mux(stream.encode())


def accuracy(path: Path, rate_factor: int) -> None:
    """Print true and found grain of luma by brightness."""
    frames = list(open_video(path, equirectangular=False).frames())
    luma = np.array([f.yuv.y for f in frames if f.yuv is not None], np.float32)
    mean, true = luma.mean(axis=0), luma.std(axis=0, ddof=1)
    cells = []
    for low, high in ((60, 90), (90, 130), (130, 180)):
        here = (mean > low) & (mean < high)
        at = np.array((0.5 * (low + high) - 16.0) / 219.0)
        found = [219.0 * float(f.grain.at(0, at)) for f in frames]
        cells.append(f"{np.median(true[here]):5.2f} {np.mean(found):5.2f} +- {np.std(found):.2f}")
    print(f"  crf {rate_factor:2d}   " + "   |  ".join(cells))


def cost(frame: VideoFrame, size: tuple[int, int], runs: int) -> None:
    """Print milliseconds of laying an ellipse (width, height) over a frame without and with grain."""
    height, width = frame.shape
    size = min(size[0], width), min(size[1], height)
    tile = empty_tile(Rectangle((width - size[0]) // 2, (height - size[1]) // 2, *size))
    y, x = np.mgrid[-1.0 : 1.0 : size[1] * 1j, -1.0 : 1.0 : size[0] * 1j]
    tile.alpha[:] = x**2 + y**2 < 1.0
    tile.radiance[:] = 0.2 * tile.alpha[..., None]
    spent: dict[float, list[float]] = {0.0: [], 1.0: []}
    for _ in range(runs):
        for amount in spent:
            fresh = replace(frame)  # what was measured is kept with a frame
            since = time.process_time()
            fresh.over(Layer(height, width, (tile,)), amount)
            spent[amount].append(1e3 * (time.process_time() - since))
    off, on = (statistics.median(times) for times in spent.values())
    print(f"  {width}x{height}, object {size[0]}x{size[1]}: {off:.1f} ms without grain, {on:.1f} ms with it")


def main() -> None:
    """Run the benchmark that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--runs", type=int, default=15)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        print("grain of luma [codes]: true, found, by brightness 60..90 | 90..130 | 130..180")
        linear = picture(options.width)
        for rate_factor in (4, 14, 20, 26):
            path = Path(folder) / f"{rate_factor}.mp4"
            write(path, linear, rate_factor)
            accuracy(path, rate_factor)
        print("processor time of a frame")
        frame = next(iter(open_video(path).frames()))
        for size in ((300, 200), (800, 450)):
            cost(replace(frame, native=None), size, options.runs)


if __name__ == "__main__":
    main()
