# SPDX-License-Identifier: Apache-2.0
"""Expands a clipped plate to scene radiance: inverse tone mapping, inside the region that the settings name.

    L' = L (1 + (gain - 1) w)     w = `region_weight`, 0 to 1

The gain is that of the operator (`published`). "none" and the default, "closure", leave every pixel as it is: the
closure solves for the light of the clipped sun alone, once it is split from the sky (`sun.split`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import DISPLAY_CURVE, encode
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.ibl.reduce import reduce_map, resize_map
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.tilt import frame_sines, upward
from mr360uw.optics import critical_cosine
from mr360uw.published import enhancement_gain, pointwise_gain
from mr360uw.shapes import checked, is_finite, real
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

Array = NDArray[np.float64]

UNEXPANDED = ("none", "closure")
"""Operators that leave every pixel as it is."""
_RAMP = math.radians(10.0)
"""Half the width [rad] of the smooth edge of the region that is expanded."""
_ENHANCEMENT_COLUMNS = 256  # of the map that "kovaleski" filters: finer than its filter by a factor of fifteen


def snell_elevation(refractive_index: float = REFRACTIVE_INDEX_SEA) -> float:
    """Return the elevation [rad] of the edge of Snell's window, 41.7 degrees in sea water: the sky lies above it."""
    return math.asin(critical_cosine(refractive_index))


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
