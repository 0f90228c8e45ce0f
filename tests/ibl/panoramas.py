# SPDX-License-Identifier: Apache-2.0
"""Drawn panoramas above the water, as a camera stores them: exposed, clipped, with sensor noise, 8 bits, JPEG."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from mr360uw.base.color import decode, encode
from mr360uw.base.sphere import direction_from_angles, directions

WIDTH = 1024
SUN = direction_from_angles(-0.74, np.radians(5.2))
"""Where the low sun stands."""
SKIES = ("broken clouds", "overcast", "clear", "mountains")
"""Panoramas without a sun."""


def texture(direction: np.ndarray, seed: int, scale: float, octaves: int = 4) -> np.ndarray:
    """Return noise (H, W) without a seam, of standard deviation 1: plane waves from `scale` per radian upwards."""
    rng = np.random.default_rng(seed)
    direction = direction.astype(np.float32)
    total = np.zeros(direction.shape[:2], np.float32)
    for octave in range(octaves):
        wave = (rng.normal(size=(8, 3)) * scale * 2.0**octave).astype(np.float32)
        phase = rng.uniform(0.0, 2.0 * np.pi, 8).astype(np.float32)
        total += np.sin(direction @ wave.T + phase).sum(axis=-1) * np.float32(0.6**octave)
    return (total - total.mean()) / total.std()


@functools.cache
def panorama(name: str) -> np.ndarray:
    """Return the linear plate (512, 1024, 3) in [0, 1] of "low sun" or one of `SKIES`."""
    d = directions(WIDTH, WIDTH // 2)
    elevation = np.degrees(np.arcsin(d[..., 1]))
    flat = d * [1.0, 0.0, 1.0] / np.maximum(np.hypot(d[..., 0], d[..., 2]), 1e-6)[..., None]
    blue, white = np.array([0.25, 0.45, 0.9]), np.array([1.0, 1.0, 1.05])
    rise = np.exp(-np.maximum(elevation, 0.0) / 14.0)[..., None]
    sky = 0.45 * blue * (1.0 - rise) + 0.75 * white * rise
    ridge = {"low sun": 1.0, "mountains": 9.0}.get(name, 4.0) * (1.0 + 0.5 * texture(flat, 3, 3.0))
    ground = np.exp(-2.0 + 0.5 * texture(d, 4, 12.0))[..., None] * np.array([0.9, 1.0, 0.6])
    if name == "low sun":
        apart = np.degrees(np.arccos(np.clip(d @ SUN, -1.0, 1.0)))[..., None]
        warm = np.array([1.0, 0.85, 0.6])
        sky = 0.8 * sky + warm * (0.5 * np.exp(-apart / 9.0) + 4.0 * np.exp(-apart / 2.5) + 5000.0 * (apart < 0.3))
        cloud = np.clip(texture(d, 8, 5.0) - 1.6, 0.0, 1.0) * (elevation > 20.0)
        sky = sky + 0.5 * cloud[..., None]
    elif name == "broken clouds":
        cloud = np.clip(1.5 * texture(d, 5, 4.0), 0.0, 1.0)[..., None]
        sky = sky + cloud * (1.3 + 0.3 * texture(d, 6, 9.0))[..., None] * white
    elif name == "overcast":
        sky = np.clip(1.05 + 0.25 * texture(d, 7, 2.5), 0.3, None)[..., None] * white
        ridge = 12.0 + 8.0 * texture(flat, 9, 6.0)
    elif name == "clear":
        water = (elevation < -8.0) & (np.abs(texture(d, 10, 2.0)) < 0.8)
        ground = np.where(water[..., None], 0.5 * sky[::-1], 3.0 * ground)
    else:
        sky = 0.3 * blue + 0.25 * rise
        ground = np.where(elevation[..., None] > 0.0, 1.5 * ground, ground)
    scene = np.where((elevation > ridge)[..., None], sky, ground).astype(np.float32)
    scene = cv2.GaussianBlur(scene, (0, 0), 1.0)  # the lens
    noise = np.random.default_rng(11).normal(0.0, 0.006, scene.shape)
    code = np.round(255.0 * np.clip(encode(np.clip(scene, 0.0, 1.0), "srgb") + noise, 0.0, 1.0)).astype(np.uint8)
    stored = cv2.imdecode(cv2.imencode(".jpg", code[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1], cv2.IMREAD_COLOR)
    return np.asarray(decode(stored[..., ::-1] / np.float32(255.0), "srgb"))
