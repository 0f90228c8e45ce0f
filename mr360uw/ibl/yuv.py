# SPDX-License-Identifier: Apache-2.0
"""Environment of a decoded video frame, in one pass over its planes, without a full frame of floats.

Light is linear Rec.709 for plates of any primaries. Means are converted after summing, since the conversion is linear.
Colours outside the gamut of Rec.709 are cut off at 0, because no surface can be lit by negative light.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.color import code_range, decode
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.ibl.expansion import UNEXPANDED
from mr360uw.ibl.level.upward import LEVEL, upward
from mr360uw.ibl.lighting import SunChoice, light_of
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, LinearPlate, Plate
from mr360uw.ibl.reduce import reduce_map, reduce_maximum
from mr360uw.ibl.settings import LightSettings
from mr360uw.shapes import exactly
from mr360uw.sphere import Array, row_solid_angle
from mr360uw.types import Environment, Floats, YuvImage
from mr360uw.yuv.coefficients import decode_polynomial, folded_coefficients


@dataclass(frozen=True, slots=True)
class YuvPlate:
    """The planes of a 4:2:0 frame, with the maps of one pass over them; nothing is expanded."""

    yuv: YuvImage
    coarse: Floats
    brightest: Floats
    up: Array
    refractive_index: float

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (h, w, 3) in directions (h, w, 3)."""
        from mr360uw.yuv.decoding import linear_in_directions

        return linear_in_directions(self.yuv, direction)

    look_expanded = look


def environment_from_yuv(
    yuv: YuvImage,
    settings: LightSettings | None = None,
    *,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    clearness: float | None = None,
) -> Environment:
    """Return the light of a decoded frame, 8 to 16 bit: that of `environment` of the same frame in linear light.

    4:2:0 frames of even size take one pass over the planes; others, curves that hold light above white, and operators
    that expand are decoded in full first.
    """
    settings = settings or LightSettings()
    plate = plate_of_yuv(yuv, settings, upward(up), refractive_index)
    return light_of(plate, settings, sun, underwater, glossy, clearness)


def plate_of_yuv(
    yuv: YuvImage, settings: LightSettings, up: Array = LEVEL, refractive_index: float = REFRACTIVE_INDEX_SEA
) -> Plate:
    """Return the plate of a decoded frame with its coarse maps worked out."""
    height, width = yuv.y.shape
    half = (height // 2, width // 2), ((height + 1) // 2, (width + 1) // 2)
    exactly("u", yuv.u, *half, *((height, columns) for _, columns in half), (height, width))
    exactly("v", yuv.v, yuv.u.shape)
    block = block_size(width, height)
    if yuv.u.shape != half[0] or block == 0 or yuv.spec.is_wide or settings.operator not in UNEXPANDED:
        return LinearPlate.of(lit_frame(yuv), settings, up, refractive_index)
    return YuvPlate(yuv, *_reduce(yuv, block), up, refractive_index)


def block_size(width: int, height: int) -> int:
    """Return the side of the blocks a frame is first reduced to: even, dividing both sides, near 1/256 of the width.

    0 where there is none. Blocks of 4096 x 2048 or 7680 x 3840 are whole parts of the coarse map's pixels; others
    are taken as even in themselves, where their 1/300 of the width straddles two of them.
    """
    sizes = range(max(2, width // COARSE_COLUMNS // 2 * 2), 0, -2)
    return next((b for b in sizes if width % b == 0 and height % b == 0), 0)


def lit_frame(yuv: YuvImage) -> NDArray[np.float32]:
    """Return a decoded panorama of any chroma format as linear Rec.709 (H, W, 3), at least 0."""
    from mr360uw.yuv.decoding import linear_from_planes

    return np.maximum(linear_from_planes(yuv), 0.0)


@functools.lru_cache(maxsize=8)
def _row_weights(width: int, height: int, block: int) -> Floats:
    weight = row_solid_angle(width, height).reshape(-1, block)
    weight /= weight.sum(axis=1, keepdims=True) * block
    return weight.ravel().astype(np.float32)


def _reduce(yuv: YuvImage, block: int) -> tuple[Floats, Floats]:
    """Return the coarse maps of a frame: mean linear radiance (128, 256, 3), brightest luminance (128, 256)."""
    from mr360uw.ibl.kernel import reduce_planes
    from mr360uw.yuv.decoding import lit_rec709

    height, width = yuv.y.shape
    if yuv.y.dtype not in (np.uint8, np.uint16) or not 8 <= yuv.spec.bits <= 16:
        raise ParameterError(f"planes - must be uint8 or uint16 (got {yuv.y.dtype}) - decode to one of them")
    total = np.empty((height // block, width // block, 3), np.float32)
    peak = np.empty(total.shape[:2], yuv.y.dtype)
    reduce_planes(
        yuv.y, yuv.u, yuv.v, folded_coefficients(yuv.spec), decode_polynomial(yuv.spec.transfer),
        _row_weights(width, height, block), block, total, peak,
    )  # fmt: skip
    low, span, _, _ = code_range(yuv.spec)
    total = lit_rec709(total, yuv.spec)
    coarse = (
        total if total.shape[:2] == (COARSE_ROWS, COARSE_COLUMNS) else reduce_map(total, COARSE_COLUMNS, COARSE_ROWS)
    )
    brightest = np.maximum((peak.astype(np.float32) - low) / span, 0.0)
    if brightest.shape != (COARSE_ROWS, COARSE_COLUMNS):
        brightest = reduce_maximum(brightest, COARSE_COLUMNS, COARSE_ROWS)
    return coarse.astype(np.float32), decode(brightest, yuv.spec.transfer)
