# SPDX-License-Identifier: Apache-2.0
"""The plate of the light stages: a coarse map of the whole sphere, samples in any direction, and its expansion.

Parts of the sphere are looked at in equal-area patches about one direction (Lambert's azimuthal projection), without
seam and poles. A direction at an angle from the centre lies 2 sin(angle/2) from it on the patch, y upwards. Every pixel
has the same solid angle, and discs about the centre stay round.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import DISPLAY_CURVE, LUMINANCE, encode
from mr360uw.base.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import snell_elevation
from mr360uw.base.parameters import checked, is_finite, real
from mr360uw.base.sphere import Array, directions, frame_from_direction, row_solid_angle, unit
from mr360uw.base.texels import smoothstep
from mr360uw.errors import ParameterError
from mr360uw.ibl.lookup import reduce_map, reduce_maximum, resize_map
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.tilt import LEVEL, elevation_sine, frame_sines, upward
from mr360uw.published import enhancement_gain, pointwise_gain
from mr360uw.types import Floats

DISPLAY_WHITE = 1.5
"""A plate with values above this is scene radiance; display-referred white is 1, with some headroom."""
COARSE_SCALE = 4
COARSE_COLUMNS, COARSE_ROWS = ENVIRONMENT_COLUMNS * COARSE_SCALE, ENVIRONMENT_ROWS * COARSE_SCALE
"""Pixels of the coarse map: 1.4 degrees, fine enough for 0.5 % of irradiance, small enough to be free."""


@functools.cache
def coarse_directions() -> Floats:
    """Return the directions of the coarse map's pixels, (128, 256, 3)."""
    return directions(COARSE_COLUMNS, COARSE_ROWS).astype(np.float32)


@functools.cache
def coarse_solid_angle() -> Floats:
    """Return the solid angles [sr] of the coarse map's pixels, (128, 1)."""
    return row_solid_angle(COARSE_COLUMNS, COARSE_ROWS).astype(np.float32)[:, None]


class Plate(Protocol):
    """A plate for the sun detector and the environment, independent of its storage (floats or planes).

    coarse: (128, 256, 3) means of the expanded radiance. brightest: (128, 256) largest luminance of the plate's pixels
    inside each coarse pixel before expansion. up: (3,) direction of the world's up in the axes of the plate.
    refractive_index: of the water, which sets the width of Snell's window; without effect in air.
    """

    coarse: Floats
    brightest: Floats
    up: Array
    refractive_index: float

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance before expansion (h, w, 3) in directions (h, w, 3)."""

    def look_expanded(self, direction: Floats) -> Floats:
        """Return the expanded radiance (h, w, 3) in directions (h, w, 3)."""


def plate_sines(plate: Plate) -> Floats:
    """Return the sine of the elevation of the coarse map's pixels, (128, 256)."""
    return elevation_sine(coarse_directions(), plate.up)


def remap(image: NDArray[Any], x: Floats, y: Floats) -> NDArray[Any]:
    """Return bilinear samples (h, w, ...) of an equirectangular image at continuous coordinates (h, w).

    Periodic across the seam; beyond the centres of the first and last rows the nearest row.
    """
    import cv2

    column, row = (x - 0.5).astype(np.float32), np.clip(y - 0.5, 0, image.shape[0] - 1).astype(np.float32)
    return cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


# Channels clip one by one: of blue water and sky blue first, so that their light seems green, and white last. A clipped
# channel c is filled from one that clips less, k:
#
#     L'_c = L_k exp(mean of log(L_c / L_k))
#
# The mean is over what is near and did not clip, bright places before dark ones: over 4 degrees, and where nothing is
# that near over 12, over 36, or over the whole plate. The channel that clips least stays as it is. Over plates under
# water whose exposure was raised by half a stop to two, the colour of the light is then off by 8 % for 14 %,
# and half of what it loses is found again; of panoramas in air, 8 % for 9 %.

FILL_FROM, _FILL_TO = 0.8, 0.95
"""Radiance of a coarse pixel, a mean of many of the plate's, from which a channel counts as clipped, and wholly."""
_FILL_DEG, _FILL_NEXT = (4.0, 12.0, 36.0), 0.01
"""Standard deviations of the means' Gaussians [deg], and the weight of each over that before it."""
_FILL_MOST = 8.0
"""Factor that a clipped channel may grow by, at most: three stops."""
_FILL_DARK = 0.01
"""Radiance below which codes are too coarse for a ratio."""


def unclipped(coarse: Floats) -> Floats:
    """Return the coarse map (h, w, 3) of a plate that ends at display white with its clipped channels filled."""
    clipped = smoothstep(coarse, FILL_FROM, _FILL_TO).astype(np.float32)
    if not np.any(clipped > 0.0):
        return coarse
    filled, size = coarse.astype(np.float32), row_solid_angle(coarse.shape[1], coarse.shape[0])[:, None]
    last, middle, first = np.argsort(clipped.mean(axis=(0, 1))).tolist()
    for channel, other in ((middle, last), (first, middle)):
        least = np.minimum(coarse[..., channel], coarse[..., other])
        weight = size * (1.0 - clipped[..., channel]) * (1.0 - clipped[..., other]) * least**4
        weight[least < _FILL_DARK] = 0.0
        if not np.any(weight > 0.0):
            continue
        ratio = np.log(np.maximum(coarse[..., channel], _FILL_DARK) / np.maximum(coarse[..., other], _FILL_DARK))
        # The mean near by, and where nothing is, farther away: both sums on a smaller map
        sums = np.stack([weight * ratio, weight, np.zeros_like(weight)], axis=-1)
        sums = reduce_map(sums, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS)
        share, found = 1.0, _FILL_NEXT ** len(_FILL_DEG) * sums.mean(axis=(0, 1)) + np.zeros_like(sums)
        for deviation_deg in _FILL_DEG:
            found += share * _blurred(sums, deviation_deg)
            share *= _FILL_NEXT
        mean = resize_map(found[..., 0] / np.maximum(found[..., 1], 1e-30), coarse.shape[1], coarse.shape[0])
        wanted = np.exp(mean) * filled[..., other]
        wanted = np.clip(wanted, coarse[..., channel], _FILL_MOST * coarse[..., channel])
        filled[..., channel] += clipped[..., channel] * (wanted - coarse[..., channel])
    return filled


def _blurred(image: Floats, deviation_deg: float) -> Floats:
    """Return a panorama (h, w, c) under a Gaussian, closed at the seam, nothing beyond the poles."""
    import cv2

    deviation = deviation_deg * image.shape[0] / 180.0
    margin = min(int(3.0 * deviation) + 1, image.shape[1])
    wide = np.pad(image, ((margin, margin), (0, 0), (0, 0)))
    wide = np.pad(wide, ((0, 0), (margin, margin), (0, 0)), mode="wrap")
    return np.asarray(cv2.GaussianBlur(wide, (0, 0), deviation))[margin:-margin, margin:-margin]


class LinearPlate:
    """A plate of linear floats, (H, W, 3), and its expansion; without settings nothing is expanded."""

    def __init__(
        self,
        image: NDArray[np.float32],
        settings: LightSettings | None = None,
        up: Array = LEVEL,
        refractive_index: float = REFRACTIVE_INDEX_SEA,
    ) -> None:
        self.image = self.expanded = image
        if settings is not None:
            self.expanded = expand(image, settings, up=up, refractive_index=refractive_index)
        self.coarse = reduce_map(self.expanded, COARSE_COLUMNS, COARSE_ROWS)
        if settings is not None and settings.operator == "closure" and float(image.max()) <= DISPLAY_WHITE:
            self.coarse = unclipped(self.coarse)
        self.brightest = reduce_maximum(image @ LUMINANCE.astype(np.float32), COARSE_COLUMNS, COARSE_ROWS)
        self.up, self.refractive_index = up, refractive_index

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (h, w, 3) in directions (h, w, 3)."""
        return self._sample(self.image, direction)

    def look_expanded(self, direction: Floats) -> Floats:
        """Return the expanded radiance (h, w, 3) in directions (h, w, 3)."""
        return self._sample(self.expanded, direction)

    @staticmethod
    def _sample(image: NDArray[np.float32], direction: Floats) -> Floats:
        return remap(image, *frame_from_direction(direction, image.shape[1], image.shape[0]))


def tangent_frame(direction: ArrayLike) -> tuple[Array, Array, Array]:
    """Return (right, up, direction), orthonormal, for a direction (3,)."""
    d = unit(direction)
    x, y, z = map(float, d)
    low = abs(y) < 0.9  # away from the poles +y is the other axis, near them +z
    size = math.hypot(x, z if low else y)
    a, b, c = (-z / size, 0.0, x / size) if low else (y / size, -x / size, 0.0)
    return np.array([a, b, c]), np.array([b * z - c * y, c * x - a * z, a * y - b * x]), d


def patch_step(radius_rad: float, size: int) -> float:
    """Return the side of a pixel of a patch of `size` pixels; its square is the pixel's solid angle [sr]."""
    return 4.0 * math.sin(min(0.5 * radius_rad, 0.5)) / size


def patch_directions(direction: ArrayLike, radius_rad: float, size: int) -> Array:
    """Return the unit directions (size, size, 3) of a square patch about `direction`.

    Its inscribed circle has `radius_rad`, at most one radian, so that the corners stay on the sphere.
    """
    x = (np.arange(size) - 0.5 * (size - 1)) * patch_step(radius_rad, size)
    square = (x * x)[None, :] + (x * x)[:, None]
    ratio = np.sqrt(1.0 - 0.25 * square)
    place = np.empty((size, size, 3))
    np.multiply(ratio, x[None, :], out=place[..., 0])
    np.multiply(ratio, -x[:, None], out=place[..., 1])
    np.subtract(1.0, 0.5 * square, out=place[..., 2])
    out: Array = place @ np.stack(tangent_frame(direction))
    return out


# Expands a clipped plate to scene radiance: inverse tone mapping, inside the region that the settings name.
#
#     L' = L (1 + (gain - 1) w)     w = `region_weight`, 0 to 1
#
# The gain is that of the operator (`published`). "none" and the default, "closure", leave every pixel as it is: the
# closure solves for the light of the clipped sun alone, once it is split from the sky (`sun.split`).

UNEXPANDED = ("none", "closure")
"""Operators that leave every pixel as it is."""
_RAMP = math.radians(10.0)
"""Half the width [rad] of the smooth edge of the region that is expanded."""
_ENHANCEMENT_COLUMNS = 256  # of the map that "kovaleski" filters: finer than its filter by a factor of fifteen


def region_weight(sine: ArrayLike, settings: LightSettings, refractive_index: float = REFRACTIVE_INDEX_SEA) -> Array:
    """Return the weight of the expansion, 0 to 1, at directions of which `sine` (...,) is the sine of the elevation.

    A smoothstep over +-`_RAMP` about the edge of the region: the horizon, or the cone of Snell's window.
    """
    sine = np.asarray(sine, np.float64)
    if settings.region == "all":
        return np.ones_like(sine)
    edge = 0.0 if settings.region == "upper" else snell_elevation(refractive_index)
    return smoothstep(np.arcsin(np.clip(sine, -1.0, 1.0)), edge - _RAMP, edge + _RAMP)


def checked_plate(plate: ArrayLike) -> NDArray[np.float32]:
    """Return a plate as float32 with negative samples (lossy codecs make them) at 0; raise on anything else."""
    image = real("plate", plate)
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ParameterError(f"plate - must be an RGB image (got shape {image.shape}) - give (H, W, 3)")
    if not np.issubdtype(image.dtype, np.floating):
        raise ParameterError(f"plate - must be linear floats (got {image.dtype}) - decode the code values first")
    if not is_finite(image):
        raise ParameterError("plate - holds NaN or infinite samples - repair the picture")
    return np.maximum(image, 0.0, dtype=np.float32)


@checked
def expand(
    plate_linear: ArrayLike,
    settings: LightSettings | None = None,
    *,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> NDArray[np.float32]:
    """Return the scene radiance of a linear plate: inverse tone mapping.

    Pixels outside the region of the settings keep their radiance. The default operator, "closure", needs the sun and
    the sky together and is applied by `environment`; here it leaves the plate as it is.

    Parameters
    ----------
    plate_linear : array_like
        Equirectangular picture (H, W, 3) of linear light; display white is 1.
    settings : LightSettings, optional
        Operator, peak and region.
    up : array_like, optional
        Direction (3,) of the world's up in the frame's axes; by default the frame is level.
    refractive_index : float
        Index of the water, 1 to 4, for Snell's cone.

    Returns
    -------
    ndarray
        Radiance (H, W, 3), float32.

    Raises
    ------
    ParameterError
        If the array is no plate.

    See Also
    --------
    uw.ibl.environment : Expands a plate and finds its light in one call.
    uw.ibl.LightSettings : The operators and their regions.

    Examples
    --------
    >>> settings = uw.ibl.LightSettings(operator="landis", region="all", peak=12.0)
    >>> float(uw.ibl.expand(np.ones((4, 8, 3)), settings).max())
    11.999994277954102
    """
    settings = settings or LightSettings()
    plate = checked_plate(plate_linear)
    (height, width), up = plate.shape[:2], upward(up)
    if settings.operator in UNEXPANDED:
        return plate
    if settings.operator == "kovaleski":
        small = reduce_map(np.minimum(plate, 1.0), _ENHANCEMENT_COLUMNS, _ENHANCEMENT_COLUMNS // 2)
        gain: Floats = resize_map(enhancement_gain(small), width, height)
    else:
        gain = pointwise_gain(settings.operator, encode(np.minimum(plate, 1.0), DISPLAY_CURVE), settings.peak)
    weight = region_weight(frame_sines(width, height, up), settings, refractive_index)
    return (plate * (1.0 + (gain - 1.0) * weight)[..., None]).astype(np.float32)
