# SPDX-License-Identifier: Apache-2.0
"""Plates with a known sun."""

from __future__ import annotations

import numpy as np

from mr360uw.base.color import ColorSpec, Matrix, decode, encode, rec709_from_plate, ycbcr_from_rgb
from mr360uw.base.sphere import directions, unit
from mr360uw.types import YuvImage


def sky(direction: np.ndarray, *, sun: float = 3000.0, width: int = 512, half_angle_rad: float = 0.012) -> np.ndarray:
    """Return a linear map with a graded sky, a dark floor, a glow and a disc of radiance `sun` towards `direction`."""
    d = directions(width, width // 2)
    towards = d @ unit(direction)
    base = np.where(d[..., 1] > 0.0, 0.25 + 0.2 * d[..., 1], 0.08)
    glow = 0.4 * np.exp((towards - 1.0) * 80.0) + sun * (towards > np.cos(half_angle_rad))
    return ((base + glow)[..., None] * np.array([0.9, 1.0, 1.1])).astype(np.float32)


def clipped(image: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Return a map exposed, clipped to white and quantised to 8 bit sRGB."""
    code = np.round(255.0 * np.clip(encode(np.minimum(image * exposure, 1.0), "srgb"), 0.0, 1.0))
    return np.asarray(decode(code / np.float32(255.0), "srgb"), np.float32)


def planes(linear: np.ndarray, bits: int = 8, matrix: Matrix = "bt709") -> YuvImage:
    """Return a linear Rec.709 plate in [0, 1] as limited range 4:2:0 planes with the primaries of `matrix`."""
    own = linear.astype(np.float64) @ np.linalg.inv(rec709_from_plate(ColorSpec(matrix).gamut)).T
    ycc = encode(own, "srgb") @ ycbcr_from_rgb(matrix).T
    scale, kind = 1 << (bits - 8), np.uint8 if bits == 8 else np.uint16
    height, width = ycc.shape[:2]
    chroma = ycc[..., 1:].reshape(height // 2, 2, width // 2, 2, 2).mean(axis=(1, 3))
    uv = np.round((128.0 + 224.0 * chroma) * scale).astype(kind)
    y = np.round((16.0 + 219.0 * ycc[..., 0]) * scale).astype(kind)
    return YuvImage(y, uv[..., 0].copy(), uv[..., 1].copy(), ColorSpec(matrix, bits=bits))


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle between two unit vectors."""
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b), -1.0, 1.0))))
