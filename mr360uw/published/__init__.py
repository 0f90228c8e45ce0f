# SPDX-License-Identifier: Apache-2.0
"""Methods of others, for comparison: benchmarks and a few settings reach them by name; no default uses them.

light_methods   inverse tone mapping (`light.operator`), irradiance by nine harmonics (`ibl.irradiance`, "sh9")
divided_areas   caustics that do not conserve energy (`caustics.method`)
aerial_look     shallow water from the air (`water.mode = "blended"`, `reflection.sun = "thresholded"`)
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import DISPLAY_CURVE, LUMINANCE, decode, encode
from mr360uw.base.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.base.optics import reflect
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.jit import exact, exact_making
from mr360uw.types import Array, Floats, Sun

# Published ways of taking light from a plate: inverse tone mapping, and irradiance by nine spherical harmonics.
#
# Inverse tone mapping gives gains on linear RGB, so that hue is kept.
#
# Four are functions of one number per pixel. Y' is luma, the weighted sum of code values in [0, 1]; L = decode(Y') is
# linear luminance.
#
#     operator    gain                                                source
#     mr360       strength Y'^power + base                            Iorns 2016; Thompson 2019 section 3
#     landis      1 - w + peak w,   w = ((L - t)/(1 - t))^alpha       Landis 2002
#     akyuz       peak L^(gamma - 1),   gamma = 1                     Akyuz 2007
#     piecewise   slope 1 up to diffuse white, steeper above it       Meylan 2006
#
# MR360 is published with the strength 10, the power 10, the base 1.8 and the weights .3 .59 .11; Landis with the
# threshold t = 0.5 and the exponent alpha = 2, Akyuz with gamma = 1. Diffuse white is at 0.85.
#
# The brightness enhancement of Kovaleski 2009 depends on a pixel's surroundings. A mask of pixels near the clip is
# spread by a cross-bilateral filter that stops at edges of the luminance; it is worked out on a small map of the frame,
# whose pixels are finer than the filter's reach by a factor of fifteen:
#
#     gain = 1 + boost e,   e = cross-bilateral(mask; luminance),   sigma 150 pixels of 1920 in space, 25/255 in range
#
# Irradiance maps by nine spherical harmonics (Ramamoorthi 2001, equations 5 to 8):
#
#     E(n) = sum_lm A_l L_lm Y_lm(n),   L_lm = int L(d) Y_lm(d) dd,   A_0, A_1, A_2 = pi, 2 pi/3, pi/4
#
# Smooth, a few percent off under a sun, and negative there on the far side: the exact integral (`ibl.cosine`) is as
# fast.

_SIGMA_SPACE = 150.0 / 1920.0
"""Standard deviation of the filter in space, over the width of the frame, as published."""
_SIGMA_RANGE = 25.0 / 255.0
"""Standard deviation of the filter in code values of luma, as published."""
_THRESHOLD = 0.9
"""Code value of the brightest channel from which on a pixel counts as clipped."""
_BOOST = 3.0
"""Gain that is added where the filter finds nothing but such pixels."""
_DIFFUSE_WHITE = 0.85
"""Linear luminance from which on the slope of piecewise is steeper."""
_MR360_WEIGHTS = np.array([0.3, 0.59, 0.11])
"""Luma weights of the MR360 operator, as published."""


def pointwise_gain(operator: str, encoded: Floats, peak: float) -> Array:
    """Return the gain (...,) of an operator for encoded colours (..., 3). peak: of landis, akyuz and piecewise."""
    luma = np.clip(encoded @ (_MR360_WEIGHTS if operator == "mr360" else LUMINANCE).astype(encoded.dtype), 0.0, 1.0)
    luma = luma.astype(np.float64)
    if operator == "mr360":
        return 10.0 * np.power(luma, 10.0) + 1.8
    value = decode(luma, DISPLAY_CURVE)
    if operator == "landis":
        return 1.0 + (peak - 1.0) * np.square(np.maximum(value - 0.5, 0.0) / 0.5)
    if operator == "akyuz":
        return np.full_like(value, peak)
    slope = (peak - _DIFFUSE_WHITE) / (1.0 - _DIFFUSE_WHITE) - 1.0
    return 1.0 + np.maximum(value - _DIFFUSE_WHITE, 0.0) * slope / np.maximum(value, _DIFFUSE_WHITE)


def enhancement_gain(linear: Floats) -> NDArray[np.float32]:
    """Return the gain (h, w) of Kovaleski 2009 for every pixel of a small linear map (h, w, 3) in [0, 1]."""
    import cv2

    sigma = _SIGMA_SPACE * linear.shape[1]
    code = encode(linear, DISPLAY_CURVE).astype(np.float32)
    mask = (code.max(axis=-1) >= _THRESHOLD).astype(np.float32)
    luma = (code @ LUMINANCE).astype(np.float32)
    pad = int(2.0 * sigma)  # the frame closes at the seam
    guide, source = (np.pad(image, ((0, 0), (pad, pad)), mode="wrap") for image in (luma, mask))
    spread = cv2.ximgproc.jointBilateralFilter(guide, source, d=2 * pad + 1, sigmaColor=_SIGMA_RANGE, sigmaSpace=sigma)
    return (1.0 + _BOOST * spread[:, pad:-pad]).astype(np.float32)


_COSINE_BANDS = np.pi * np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 0.25, 0.25, 0.25, 0.25, 0.25])


@functools.cache
def _harmonics(columns: int, rows: int) -> NDArray[np.float64]:
    """Return the nine real harmonics of order 0 to 2 in the directions of a map, (H, W, 9)."""
    x, y, z = np.moveaxis(directions(columns, rows), -1, 0)
    one = np.ones_like(x)
    basis = [
        0.282095 * one, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
        0.315392 * (3.0 * z * z - 1.0), 1.092548 * x * z, 0.546274 * (x * x - y * y),
    ]  # fmt: skip
    return np.stack(basis, axis=-1)


def harmonic_irradiance(radiance: ArrayLike) -> Floats:
    """Return the irradiance map (32, 64, 3), in radiance x sr, of a radiance map (H, W, 3)."""
    image = np.asarray(radiance, np.float64)
    height, width = image.shape[:2]
    basis = _harmonics(width, height) * row_solid_angle(width, height)[:, None, None]
    harmonics = np.tensordot(basis, image, ([0, 1], [0, 1]))
    return (_harmonics(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS) @ (_COSINE_BANDS[:, None] * harmonics)).astype(np.float32)


# Caustics after published methods, which do not conserve energy.
#
# By division of areas, drawn at pixel centres as a graphics pipeline does:
#
#     ratio      flux of each triangle over the area of its image
#     fan        flux over area of the triangles around each vertex, interpolated      Thompson et al. 2019
#     jacobian   flux density over the Jacobian of the refraction, divided in each pixel
#
# They lose light where a triangle covers no pixel centre and add light where areas shrink to nothing, so their mean is
# not 1 beyond the first fold. `hit`, `flux` and maps: as in `caustics/irradiance.py`.
#
# By scrolling two copies of one still map, the darker of which shows (Stam 1996; Monzon et al. 2022).

_LEAST_JACOBIAN = 1e-6
"""Least area, or Jacobian over area, that flux is divided by, because both vanish at a fold. Twice as large, the
brightest pixels of a fold are half as bright."""


_SCROLL = ((0.37, 0.21), (-0.29, 0.33))
"""Velocity [m/s] of the two copies over (x, z), about that of short waves; twice as large, the pattern moves as fast
as waves four times as long."""


@exact
def _inside(weight: float, ex: float, ey: float) -> bool:
    """Top-left rule: a pixel centre on an edge belongs to one of the two triangles that share it."""
    return weight > 0.0 or (weight == 0.0 and (ey > 0.0 or (ey == 0.0 and ex < 0.0)))


@exact_making
def _rasterise(hit: Floats, flux: Floats, light: Floats, jacobian: Floats, size: int) -> Floats:
    """Return intensities drawn at pixel centres, sheets added up, as a graphics pipeline without coverage does.

    light: (N + 1, N + 1) per vertex, jacobian: the same; a pixel gets interpolated light over interpolated |jacobian|.
    An empty `light` (0, 0) draws each triangle with its own flux over its own area.
    """
    out = np.zeros((size, size))
    at = np.zeros((3, 2))
    flat = light.shape[0] == 0
    for j in range(flux.shape[0]):
        for i in range(flux.shape[1]):
            # Draw both triangles of each cell
            for half in range(2):
                rows = (j, j, j + 1) if half == 0 else (j, j + 1, j + 1)
                columns = (i, i + 1, i + 1) if half == 0 else (i, i + 1, i)
                for k in range(3):
                    at[k] = hit[rows[k], columns[k]]
                area = (at[1, 0] - at[0, 0]) * (at[2, 1] - at[0, 1]) - (at[1, 1] - at[0, 1]) * (at[2, 0] - at[0, 0])
                left, right = at[:, 0].min(), at[:, 0].max()
                top, bottom = at[:, 1].min(), at[:, 1].max()
                if area == 0.0 or right - left > size or bottom - top > size:
                    continue
                # Visit the pixel centres within its bounds, and test them against its three edges
                sign = 1.0 if area > 0.0 else -1.0
                for y in range(int(np.ceil(top - 0.5)), int(np.floor(bottom - 0.5)) + 1):
                    for x in range(int(np.ceil(left - 0.5)), int(np.floor(right - 0.5)) + 1):
                        value, below, hits = 0.0, 0.0, True
                        for k in range(3):
                            p, q = at[(k + 1) % 3], at[(k + 2) % 3]
                            ex, ey = sign * (q[0] - p[0]), sign * (q[1] - p[1])
                            w = ex * (y + 0.5 - p[1]) - ey * (x + 0.5 - p[0])
                            if not _inside(w, ex, ey):
                                hits = False
                                break
                            if not flat:
                                value += w * light[rows[k], columns[k]]
                                below += w * jacobian[rows[k], columns[k]]
                        if hits and flat:
                            out[y % size, x % size] += 2.0 * flux[j, i, half] / abs(area)
                        elif hits:
                            out[y % size, x % size] += value / max(abs(below), _LEAST_JACOBIAN * abs(area))
    return out


def _around_vertices(per_triangle: Floats) -> Floats:
    """Return the sums (N + 1, N + 1) over the six triangles around each vertex of values (N, N, 2)."""
    b, d = per_triangle[..., 0], per_triangle[..., 1]
    both = b + d
    total = both + np.roll(both, (1, 1), (0, 1)) + np.roll(b, 1, 1) + np.roll(d, 1, 0)
    return np.pad(total, ((0, 1), (0, 1)), mode="wrap")


def _deposit_ratio(hit: Floats, flux: Floats, size: int) -> Floats:
    """Return the ratio of areas of each triangle, drawn at pixel centres."""
    return _rasterise(hit, flux, np.zeros((0, 0)), np.zeros((0, 0)), size)


def _deposit_fan(hit: Floats, flux: Floats, size: int) -> Floats:
    """Return the ratio of areas of the triangles around each vertex, interpolated (Thompson et al. 2019)."""
    a, b, c, d = hit[:-1, :-1], hit[:-1, 1:], hit[1:, 1:], hit[1:, :-1]
    area = 0.5 * np.abs(np.stack([_cross(b - a, c - a), _cross(c - a, d - a)], axis=-1))
    light = _around_vertices(flux) / np.maximum(_around_vertices(area), _LEAST_JACOBIAN)
    return _rasterise(hit, flux, light, np.ones_like(light), size)


def _deposit_jacobian(hit: Floats, flux: Floats, size: int) -> Floats:
    """Return flux density over the Jacobian of the refraction, interpolated and divided in every pixel."""
    periodic = hit - np.stack(np.broadcast_arrays(*np.meshgrid(*(np.arange(hit.shape[0]),) * 2)), axis=-1) * (
        size / flux.shape[0]
    )
    core = periodic[:-1, :-1]
    step = size / flux.shape[0]
    du = 0.5 * (np.roll(core, -1, 1) - np.roll(core, 1, 1)) + np.array([step, 0.0])
    dv = 0.5 * (np.roll(core, -1, 0) - np.roll(core, 1, 0)) + np.array([0.0, step])
    jacobian = np.pad(_cross(du, dv), ((0, 1), (0, 1)), mode="wrap")
    return _rasterise(hit, flux, _around_vertices(flux) / 3.0, jacobian, size)


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


DEPOSITS: dict[str, Callable[[Floats, Floats, int], Floats]] = {
    "ratio": _deposit_ratio, "fan": _deposit_fan, "jacobian": _deposit_jacobian
}  # fmt: skip
"""The methods by the name that the settings give them."""


def _scroll_offsets(tile_m: float, loop_s: float | None, time_s: float) -> Floats:
    """Return how far (2, 2) over (x, z), in tiles, the two copies have moved; whole tiles in a loop."""
    rate = np.array(_SCROLL) / tile_m
    if loop_s is not None:
        rate = np.round(rate * loop_s) / loop_s
    return rate * time_s


def scroll(ratio: Floats, tile_m: float, loop_s: float | None, time_s: float) -> Floats:
    """Return the darker of two scrolled copies of a map (size, size), of mean 1; the second has x and z swapped."""
    size = ratio.shape[0]
    first, second = np.round(_scroll_offsets(tile_m, loop_s, time_s) * size).astype(np.int64)
    darker = np.minimum(np.roll(ratio, (first[1], first[0]), (0, 1)), np.roll(ratio.T, (second[1], second[0]), (0, 1)))
    return darker / darker.mean()


# Published ways of drawing shallow water that are not physics: for comparison, and for their look.
#
# Depth-blended albedo: the floor takes on the water's colour with depth, A' = A exp(-k d) + W (1 - exp(-k d)), and the
# water itself is clear. Nothing is lost on the slanted way to the camera, and no light is scattered.
#
# Thresholded reflection: where the mirrored ray is within an angle of the sun, the surface adds gain times the sun's
# irradiance as radiance, all or nothing. No energy is conserved, and Fresnel's reflectance has no part in it.


def blended_albedo(albedo: Floats, depth_m: float, per_m: Floats, color: Floats) -> Array:
    """Return the albedo (..., 3) of a floor at a depth. per_m: k (3,) [1/m]. color: W (3,) in [0, 1]."""
    own = np.exp(-np.asarray(per_m, np.float64) * depth_m)
    return np.asarray(albedo * own + color * (1.0 - own))


def thresholded_reflection(directions: Array, normal: Array, sun: Sun, threshold_rad: float) -> Array:
    """Return the part (H, W) in [0, 1] of pixels whose mirrored rays are within an angle of the sun.

    directions: (H, W, 3) of the rays. normal: (H, W, 3) of the surface that they meet, zero where they meet none. The
    edge is drawn over the pixel that it crosses, by the change of the angle from pixel to pixel.
    """
    met = np.any(normal != 0.0, axis=-1)
    mirrored = reflect(directions, normal)
    angle = np.arccos(np.clip(mirrored @ sun.direction, -1.0, 1.0))
    slopes = [np.gradient(angle, axis=axis) for axis in (0, 1) if angle.shape[axis] > 1]
    change = np.sqrt(sum((slope**2 for slope in slopes), np.zeros(angle.shape)))
    part = np.clip(0.5 + (threshold_rad - angle) / np.maximum(change, 1e-9), 0.0, 1.0)
    return np.where(met, part, 0.0)
