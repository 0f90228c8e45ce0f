# SPDX-License-Identifier: Apache-2.0
"""Inverse tone mapping: gains that turn a clipped plate back into scene radiance.

Every operator is a gain on linear RGB, a function of one number per pixel, so that hue is kept and a video frame
needs one table of 256 or 1024 gains:

    value    luma Y' = sum of weight x code value, in [0, 1]; operators defined on linear luminance take decode(Y')

MR360 (Iorns & Rhee 2016; Thompson et al. 2019 section 3): gain = 10 Y'^10 + 1.8, weights .3 .59 .11 on code values.
Landis 2002: above t, L' = L (1 - w) + L peak w with w = ((L - t)/(1 - t))^alpha. Akyuz et al. 2007:
L' = peak L^gamma. Kovaleski & Oliveira 2009: gain 1 + boost e, e the edge-stopping brightness map of `enhancement`.
Meylan et al. 2006: two slopes, split at diffuse white. "closure" leaves unclipped pixels as they are (see `split`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import LUMINANCE, decode, encode
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.ibl.enhancement import enhancement_gain
from mr360uw.ibl.level.upward import frame_sines, upward
from mr360uw.ibl.reduce import reduce_map, resize_map
from mr360uw.ibl.settings import LightSettings
from mr360uw.optics import critical_cosine
from mr360uw.types import Floats

Array = NDArray[np.float64]

_ENHANCEMENT_COLUMNS = 256
MR360_WEIGHTS = np.array([0.3, 0.59, 0.11])
"""Luma weights of the MR360 operator, as published."""


def mr360_gain(luma: ArrayLike, strength: float, power: float, base: float) -> Array:
    """Return the MR360 gain of luma (...,) in [0, 1]."""
    return strength * np.power(luma, power) + base


def landis_gain(value: ArrayLike, threshold: float, alpha: float, peak: float) -> Array:
    """Return the gain of Landis 2002 for linear luminance in [0, 1]."""
    w = np.power(np.maximum(np.asarray(value) - threshold, 0.0) / (1.0 - threshold), alpha)
    return 1.0 + (peak - 1.0) * w


def akyuz_gain(value: ArrayLike, gamma: float, peak: float) -> Array:
    """Return the gain of Akyuz et al. 2007 for linear luminance in [0, 1], with black at 0 and white at 1."""
    return peak * np.power(np.maximum(value, 1e-6), gamma - 1.0)


def piecewise_gain(value: ArrayLike, split: float, peak: float) -> Array:
    """Return the gain of the two slopes of Meylan et al. 2006 for linear luminance in [0, 1]."""
    excess = np.maximum(np.asarray(value) - split, 0.0)
    return 1.0 + excess * ((peak - split) / (1.0 - split) - 1.0) / np.maximum(value, split)


def gain(luma: ArrayLike, settings: LightSettings) -> Array:
    """Return the gain of the chosen pointwise operator at luma (...,); 1 for those that are not pointwise."""
    luma = np.clip(np.asarray(luma, np.float64), 0.0, 1.0)
    if settings.operator == "mr360":
        return mr360_gain(luma, settings.mr360_strength, settings.mr360_power, settings.mr360_base)
    value = decode(luma, settings.transfer)
    if settings.operator == "landis":
        return landis_gain(value, settings.landis_threshold, settings.landis_alpha, settings.peak)
    if settings.operator == "akyuz":
        return akyuz_gain(value, settings.akyuz_gamma, settings.peak)
    if settings.operator == "piecewise":
        return piecewise_gain(value, settings.piecewise_split, settings.peak)
    return np.ones_like(luma)


def luma_weights(settings: LightSettings) -> Array:
    """Return the weights (3,) of R', G', B' in the luma that the chosen operator reads."""
    return MR360_WEIGHTS if settings.operator == "mr360" else LUMINANCE


def snell_elevation() -> float:
    """Return the elevation [rad] of the edge of Snell's window, 41.7 deg: the whole sky lies above it."""
    return math.asin(critical_cosine(REFRACTIVE_INDEX_SEA))


def region_weight(sine: ArrayLike, settings: LightSettings) -> Array:
    """Return how far the expansion acts, 0 to 1, at directions of which `sine` (...,) is the sine of the elevation.

    A smoothstep over +-`ramp_deg` about the edge of the region: the horizon, or the cone of Snell's window.
    """
    sine = np.asarray(sine, np.float64)
    if settings.region == "all":
        return np.ones_like(sine)
    return region_ramp(np.arcsin(np.clip(sine, -1.0, 1.0)), *region_edge(settings))


def region_edge(settings: LightSettings) -> tuple[float, float]:
    """Return the elevation of the region's edge and half its ramp [rad]; far below for the whole sphere."""
    ramp = float(np.radians(settings.ramp_deg))
    if settings.region == "all":
        return -math.pi, ramp
    return (0.0 if settings.region == "upper" else snell_elevation()), ramp


def region_ramp(elevation: ArrayLike, edge: float, ramp: float) -> Array:
    """Return a smooth step from 0 to 1 over edge - ramp .. edge + ramp; a sharp one where ramp is 0."""
    if ramp == 0.0:
        return (np.asarray(elevation) >= edge).astype(np.float64)
    t = np.clip((np.asarray(elevation) - edge) / (2.0 * ramp) + 0.5, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def checked_plate(plate: ArrayLike, where: str = "plate") -> NDArray[np.float32]:
    """Return a plate as float32 with negative samples (lossy codecs make them) at 0; raise on anything else."""
    image = np.asarray(plate)
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ParameterError(f"{where} - must be an RGB image (got shape {image.shape}) - give (H, W, 3)")
    if not np.issubdtype(image.dtype, np.floating):
        raise ParameterError(f"{where} - must be linear floats (got {image.dtype}) - decode the code values first")
    if not np.isfinite(np.sum(image, dtype=np.float64)):
        raise ParameterError(f"{where} - holds NaN or infinite samples - repair the picture")
    return np.maximum(image, 0.0, dtype=np.float32)


def expand_samples(linear: Floats, sine: Floats, settings: LightSettings, enhancement: Floats | None = None) -> Floats:
    """Return expanded radiance (..., 3) of linear samples (..., 3), `sine` (...,) that of their elevation.

    enhancement: gain (...,) of the operator that is not pointwise.
    """
    if enhancement is not None:
        gains = enhancement
    elif settings.operator in ("none", "closure", "kovaleski"):
        return linear
    else:
        encoded = encode(np.minimum(linear, 1.0), settings.transfer)
        gains = gain(encoded @ luma_weights(settings).astype(linear.dtype), settings)
    return linear * (1.0 + (gains - 1.0) * region_weight(sine, settings))[..., None]


def expand(
    plate_linear: ArrayLike, settings: LightSettings | None = None, *, up: ArrayLike | None = None
) -> NDArray[np.float32]:
    """Return the scene radiance (H, W, 3) of a linear plate of the same shape: inverse tone mapping.

    Display white is 1. Pixels outside the region of the settings keep their radiance. "closure" needs the sun and
    the sky together and is applied by `environment`; here it leaves the plate as it is. up: the direction (3,) of the
    world's up in the frame's axes; by default the frame is level.
    """
    settings = settings or LightSettings()
    plate = checked_plate(plate_linear)
    height, width = plate.shape[:2]
    gains = None
    if settings.operator == "kovaleski":
        small = reduce_map(np.minimum(plate, 1.0), _ENHANCEMENT_COLUMNS, _ENHANCEMENT_COLUMNS // 2)
        gains = resize_map(enhancement_gain(small, settings), width, height)
    sine = frame_sines(width, height, upward(up))
    return expand_samples(plate, sine, settings, gains).astype(np.float32, copy=False)
