# SPDX-License-Identifier: Apache-2.0
"""Trial of blending on a graphics card: a small composite by it against that of the processor, code by code."""

from __future__ import annotations

import functools
import statistics
import time
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec
from mr360uw.composite.gl.plate_pass import plate_pass
from mr360uw.composite.gl.self_test import Trial
from mr360uw.composite.over import over_tile
from mr360uw.errors import GlError
from mr360uw.gl.context import gl_device
from mr360uw.reading.disk_cache import kept_arrays
from mr360uw.types import Layer, Tile, YuvImage
from mr360uw.video import VideoFrame

EQUAL = 0.99
"""Least fraction of the codes that are the same; none may be off by more than one. Single precision moves the dither of
one pixel in a thousand over a code."""
_SPECS = ColorSpec(), ColorSpec("bt2020", False, "hlg", 10)
_SIZE, _SEED, _DRAWN = (256, 128), 360, 5


def random_plate(rng: np.random.Generator, spec: ColorSpec, size: tuple[int, int] = _SIZE) -> VideoFrame:
    """Return a frame of random codes, 4:2:0. size: columns and rows."""
    (width, height), kind = size, np.uint8 if spec.bits == 8 else np.uint16
    half = -(-height // 2), -(-width // 2)
    y, u, v = (rng.integers(0, 1 << spec.bits, shape, kind) for shape in ((height, width), half, half))
    return VideoFrame(5, 5, Fraction(1, 25), 0.2, 1, spec, yuv=YuvImage(y, u, v, spec))


def random_layer(rng: np.random.Generator, size: tuple[int, int] = _SIZE) -> Layer:
    """Return a layer of two tiles, one with shafts, in which half of the pixels change nothing. size: at least 24."""
    (width, height), tiles = size, []
    across = width // 3 // 2 * 2
    for column, columns in ((0, across), (across, width - across)):
        shape = height - 18, columns
        none = rng.random(shape) < 0.5
        alpha = np.where(none | (rng.random(shape) < 0.5), 0.0, rng.random(shape)).astype(np.float32)
        ratio, veil = rng.uniform(0.2, 1.5, (*shape, 3)), rng.uniform(0.0, 0.5, (*shape, 3))
        shafts = np.where(none[..., None], 0.0, rng.normal(0.0, 0.02, (*shape, 3))).astype(np.float32)
        tiles.append(
            Tile(
                column=column,
                row=10,
                radiance=(alpha[..., None] * rng.random((*shape, 3))).astype(np.float32),
                alpha=alpha,
                distance_m=np.full(shape, np.inf, np.float32),
                ratio=np.where(none[..., None], 1.0, ratio).astype(np.float32),
                veil=veil.astype(np.float32),
                shafts=shafts if column else None,
            )
        )
    return Layer(height, width, tuple(tiles))


def blend_trial() -> Trial:
    """Blend small random layers over random plates on the device and on the processor; raise `GlError` without OpenGL.

    Its `reference_s` is the processor's time; what goes wrong is told by its `problem`.
    """
    rng = np.random.default_rng(_SEED)
    frames = [(random_plate(rng, spec), random_layer(rng)) for spec in _SPECS]
    since = time.perf_counter()
    expected = [plate.over(layer, over_tile) for plate, layer in frames]
    reference_s, again_s = time.perf_counter() - since, 0.0
    since = time.perf_counter()
    try:
        found = [plate.over(layer, over_tile, blend_planes=plate_pass().over) for plate, layer in frames]
        first_s = time.perf_counter() - since
        again = []
        for _ in range(_DRAWN):
            since = time.perf_counter()
            for plate, layer in frames:
                plate.over(layer, over_tile, blend_planes=plate_pass().over)
            again.append(time.perf_counter() - since)
        problem, again_s = _difference(found, expected), statistics.median(again)
    except GlError as error:
        problem, first_s = str(error), time.perf_counter() - since
    return Trial("blending", problem, first_s, again_s, reference_s)


def _difference(found: list[VideoFrame], expected: list[VideoFrame]) -> str:
    """Return how composites differ from what they ought to be, "" where they agree."""
    off = np.abs(np.concatenate([*map(_codes, found)]) - np.concatenate([*map(_codes, expected)]))
    worst, equal = int(off.max()), float(np.mean(off == 0))
    if worst <= 1 and equal >= EQUAL:
        return ""
    return f"differs from the processor's: {100 * equal:.2f} % of the codes are the same, others off by up to {worst}"


def _codes(frame: VideoFrame) -> NDArray[np.int64]:
    assert frame.yuv is not None
    return np.concatenate([plane.reshape(-1).astype(np.int64) for plane in (frame.yuv.y, frame.yuv.u, frame.yuv.v)])


def doubt_of_blending() -> str:
    """Return why a graphics card shall not blend here, "" for nothing; tried once for a card and a driver."""
    device = gl_device()
    return _doubt_of(device.renderer, device.version)


@functools.cache  # for users of whom nothing is kept on the disk
def _doubt_of(renderer: str, version: str) -> str:
    return str(kept_arrays("blending", (renderer, version), _trial)["problem"])


def _trial() -> dict[str, NDArray[Any]]:
    return {"problem": np.array(blend_trial().problem)}
