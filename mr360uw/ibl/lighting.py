# SPDX-License-Identifier: Apache-2.0
"""Environment maps of a plate: radiance, irradiance, glossy levels, and the same without the sun; of pictures and of
decoded frames.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import code_range, decode
from mr360uw.base.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, REFRACTIVE_INDEX_SEA
from mr360uw.base.parameters import checked, exactly
from mr360uw.base.sphere import Array, directions, row_solid_angle, unit
from mr360uw.errors import ParameterError
from mr360uw.ibl.filters import cosine_beam, cosine_filter, glossy_levels
from mr360uw.ibl.lookup import environment_lookup, reduce_map, reduce_maximum
from mr360uw.ibl.plate import (
    COARSE_COLUMNS,
    COARSE_ROWS,
    COARSE_SCALE,
    UNEXPANDED,
    LinearPlate,
    Plate,
    checked_plate,
    unclipped,
)
from mr360uw.ibl.settings import GLOSSY_ROUGHNESS, LightSettings, Operator
from mr360uw.ibl.sun.detect import (
    find_disc,
    is_disc,
    lost_light,
    shows_disc,
    split_disc,
    split_given,
    spot_towards,
)
from mr360uw.ibl.sun.split import UNKNOWN_RATIO, close, taken_in_part, with_sun, without_glare
from mr360uw.ibl.sun.spots import taken_share
from mr360uw.ibl.tilt import LEVEL, level_matrix, roll_pitch, upward
from mr360uw.jit import fast_making, inlined
from mr360uw.types import Environment, Floats, Sun, YuvImage
from mr360uw.yuv.decoding import decode_polynomial, folded_coefficients, polynomial_light

SunChoice = Sun | Literal["detect"] | NDArray[np.floating[Any]] | None


@checked
def environment(
    plate: ArrayLike,
    settings: LightSettings | None = None,
    *,
    expansion: Operator | None = None,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> Environment:
    """Return the light of a linear plate as small maps, its sun apart.

    A clipped sun gets the strength and colour of sunlight in air, without the losses of the water above.

    Parameters
    ----------
    plate : array_like
        Equirectangular picture (H, W, 3) of linear light, of any size; white is 1.
    settings : LightSettings, optional
        How the plate is expanded to scene radiance, and where its sun is.
    expansion : str, optional
        Operator instead of that of the settings; "none" says that the plate is scene radiance already.
    sun : Sun or "detect" or array_like or None
        By default "detect" follows `settings.sun`: the sun is detected, inside Snell's window if `underwater`, and left
        in the sky as far as the confidence is low. A direction (3,) as seen by the camera measures the light there; a
        `Sun` replaces the light there; None leaves all light in the sky.
    underwater : bool
        Whether the camera is under water.
    glossy : bool
        Also filter the residual at the roughnesses of the settings.
    up : array_like, optional
        Direction (3,) of the world's up in the frame's axes; by default the frame is level. The result is in the
        frame's axes for any `up`.
    refractive_index : float
        Index of the water, 1 to 4, which sets the width of Snell's window and of the sun's disc.

    Returns
    -------
    Environment
        Radiance, irradiance and the sun; `residual` and `ambient` lack the sun.

    Raises
    ------
    ParameterError
        If an array is no plate, or no direction.

    See Also
    --------
    uw.ibl.detect_sun : The sun alone, as bright as the plate shows it.
    uw.ibl.environment_from_yuv : The same from the decoded planes of a video frame.
    uw.medium.fit_water : Finds the type of water that fits the light.

    Examples
    --------
    >>> light = uw.ibl.environment(plate, underwater=True)
    >>> light.irradiance.shape
    (32, 64, 3)
    >>> uw.ibl.environment(plate, sun=None).sun is None
    True
    """
    settings = settings or LightSettings()
    if expansion is not None:
        settings = LightSettings(**{**settings.model_dump(), "operator": expansion})
    linear = LinearPlate(checked_plate(plate), settings, upward(up), refractive_index)
    return light_of(linear, settings, sun, underwater, glossy)


def light_of(
    plate: Plate,
    settings: LightSettings,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    clearness: float | None = None,
) -> Environment:
    """Return the light of a plate of any storage; see `environment`.

    clearness: of the water above the camera, from 0 to 1, which is none: how far sun and sky are told apart as in air.
    Without it, under water, they are taken to be equally strong.
    """
    residual, found = _split(plate, settings, sun, underwater, clearness)
    return assemble(residual, found, GLOSSY_ROUGHNESS if glossy else ())


def _split(
    plate: Plate, settings: LightSettings, sun: SunChoice, underwater: bool, clearness: float | None
) -> tuple[Floats, Sun | None]:
    """Return the coarse map without the sun, and the sun; the whole map, and None, where there is none."""
    ratio = settings.direct_to_diffuse
    if ratio is None and underwater and clearness is None:
        ratio = UNKNOWN_RATIO
    glare = 1.0 - (clearness or 0.0) if underwater else 0.0
    if isinstance(sun, str):
        if settings.sun == "none":
            return plate.coarse, None
        if settings.sun == "date" and underwater:
            raise ParameterError(
                'sun - "date" is a place in the air (got a plate under water) - refract it, pass it as sun'
            )
        direction = settings.given_direction
        if direction is None:
            return _detected(plate, settings, underwater, ratio, glare)
        sun = direction @ level_matrix(*map(float, roll_pitch(plate.up)))  # given in level axes of the same heading
    if sun is None:
        return plate.coarse, None
    if isinstance(sun, Sun):
        spot = spot_towards(plate, sun.direction)
        lost = settings.operator == "closure" and lost_light(plate, spot)
        residual, _ = split_given(plate, sun.direction, spot, sun.half_angle_rad)
        residual, _ = without_glare(residual, sun, plate, glare)
        residual, _ = taken_in_part(residual, sun, sun.share, plate.coarse)
        return residual, replace(sun, shown=0.0) if lost else sun
    direction = unit(exactly("sun", sun, (3,)))
    spot = spot_towards(plate, direction)
    residual, found = split_given(plate, direction, spot, underwater=underwater)
    residual, found = without_glare(residual, found, plate, glare)
    if settings.operator == "closure" and lost_light(plate, spot):
        found = close(residual, found, plate, ratio, disc=shows_disc(spot))
    return residual, found


def _detected(
    plate: Plate, settings: LightSettings, underwater: bool, ratio: float | None, glare: float
) -> tuple[Floats, Sun | None]:
    disc = find_disc(plate, underwater=underwater)
    share = 0.0 if disc is None else taken_share(disc.confidence)
    if disc is None or share == 0.0:
        return plate.coarse, None
    residual, sun = without_glare(*split_disc(plate, disc, underwater=underwater), plate, glare)
    if settings.operator == "closure":
        if lost_light(plate, disc, detected=True):
            sun = close(residual, sun, plate, ratio, disc=shows_disc(disc))
        else:  # what is no sharp disc has light of the sky in it, and of the glitter only a part
            sun = replace(sun, shown=float(is_disc(disc)))
    return taken_in_part(residual, sun, share, plate.coarse)


def assemble(coarse: Floats, sun: Sun | None, roughness: tuple[float, ...] = ()) -> Environment:
    """Return the environment of a coarse map (128, 256, 3) without the sun, and of the sun."""
    ambient = cosine_filter(COARSE_SCALE)(coarse)
    residual = reduce_map(coarse, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS)
    return sunlit(
        residual, ambient, glossy_levels(coarse, roughness), np.asarray(roughness, np.float32), sun, detail=coarse
    )


def sunlit(
    residual: Floats, ambient: Floats, glossy: Floats, roughness: Floats, sun: Sun | None,
    *, detail: Floats | None = None,
) -> Environment:  # fmt: skip
    """Return the environment of maps that lack the sun, and of the sun; symbols as of `Environment`."""
    radiance, irradiance = residual, ambient
    if sun is not None:
        radiance, irradiance = with_sun(residual, sun), ambient + cosine_beam(sun.direction, sun.irradiance)
    return Environment(radiance, irradiance, sun, residual, ambient, glossy, roughness, detail)


def light_between(before: Environment, after: Environment, share: float, sun: Sun | None) -> Environment:
    """Return the light of an instant between two, whose maps are interpolated linearly.

    share: 0 at `before`, 1 at `after`. sun: of the instant, in the axes of the maps.
    """

    def mixed(a: Floats, b: Floats) -> Floats:
        return ((1.0 - share) * a + share * b).astype(np.float32)

    residual, ambient, glossy = (
        mixed(getattr(before, name), getattr(after, name)) for name in ("residual", "ambient", "glossy")
    )
    detail = None if before.detail is None or after.detail is None else mixed(before.detail, after.detail)
    return sunlit(residual, ambient, glossy, before.glossy_roughness, sun, detail=detail)


def sun_between(before: Sun, after: Sun, share: float) -> Sun:
    """Return the sun of an instant between two, every value of which is interpolated linearly. share: 0 at `before`."""
    direction, irradiance, half_angle_rad, confidence = (
        (1.0 - share) * np.asarray(getattr(before, name), np.float64)
        + share * np.asarray(getattr(after, name), np.float64)
        for name in ("direction", "irradiance", "half_angle_rad", "confidence")
    )
    return Sun(unit(direction), irradiance.astype(np.float32), float(half_angle_rad), float(confidence))


def turned(light: Environment, world_from_camera: Floats) -> Environment:
    """Return the light that a camera saw, in the axes of the world."""
    if np.array_equal(world_from_camera, np.eye(3)):
        return light
    seen = directions(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS) @ world_from_camera
    maps: dict[str, Any] = {
        name: environment_lookup(getattr(light, name), seen).astype(np.float32)
        for name in ("radiance", "residual", "ambient")
    }
    if len(light.glossy):
        maps["glossy"] = np.array([environment_lookup(level, seen) for level in light.glossy], np.float32)
    if light.detail is not None:
        finer = directions(COARSE_COLUMNS, COARSE_ROWS) @ world_from_camera
        maps["detail"] = environment_lookup(light.detail, finer).astype(np.float32)
    sun = None if light.sun is None else replace(light.sun, direction=world_from_camera @ light.sun.direction)
    lit = maps["ambient"] if sun is None else maps["ambient"] + cosine_beam(sun.direction, sun.irradiance)
    return replace(light, irradiance=lit, sun=sun, **maps)


# --- Of a decoded frame, in one pass over its planes ----------------------------------------------------------------

# Environment of a decoded video frame, in one pass over its planes, without a full frame of floats.
#
# Light is linear Rec.709 for plates of any primaries. Means are converted after summing, since the conversion is
# linear. Colours outside the gamut of Rec.709 are cut off at 0, because no surface can be lit by negative light.
#
# In the compiled pass, each luma sample is turned into R'G'B' with the chroma of its 2 x 2 block, decoded by the
# decoder's polynomial and added to its block with the weight of its row's solid angle. Nothing of the size of the frame
# is written. Loops run along two whole rows, which share their chroma, so that the compiler can use vector
# instructions.


_ZERO = np.float32(0.0)


@inlined
def _chroma_parts(u: Any, v: Any, folded: Any, dr: Any, dg: Any, db: Any) -> None:
    """Write the terms of R', G', B' (W,) that two rows of pixels share: their row of chroma, and the luma offset."""
    shift, neutral = folded[1], folded[2]
    r_v, g_u, g_v, b_u = folded[3], folded[4], folded[5], folded[6]
    for k in range(len(u)):
        du = np.float32(u[k]) - neutral
        dv = np.float32(v[k]) - neutral
        dr[2 * k] = dr[2 * k + 1] = shift + dv * r_v
        dg[2 * k] = dg[2 * k + 1] = shift + du * g_u + dv * g_v
        db[2 * k] = db[2 * k + 1] = shift + du * b_u


@inlined
def _add_light(rows: Any, weights: Any, scale: Any, curve: Any, parts: Any, sums: Any) -> None:
    """Add the weighted light of two rows of pixels to the sums of their columns. parts: of `_chroma_parts`."""
    slope, c1, c2, c3, c4, c5, c6 = curve[0], curve[1], curve[2], curve[3], curve[4], curve[5], curve[6]
    (ya, yb), (weight_a, weight_b), (dr, dg, db), (red, green, blue) = rows, weights, parts, sums
    for i in range(len(ya)):
        a, b = np.float32(ya[i]) * scale, np.float32(yb[i]) * scale
        p = polynomial_light(a + dr[i], slope, c1, c2, c3, c4, c5, c6)
        q = polynomial_light(b + dr[i], slope, c1, c2, c3, c4, c5, c6)
        red[i] += weight_a * p + weight_b * q
        p = polynomial_light(a + dg[i], slope, c1, c2, c3, c4, c5, c6)
        q = polynomial_light(b + dg[i], slope, c1, c2, c3, c4, c5, c6)
        green[i] += weight_a * p + weight_b * q
        p = polynomial_light(a + db[i], slope, c1, c2, c3, c4, c5, c6)
        q = polynomial_light(b + db[i], slope, c1, c2, c3, c4, c5, c6)
        blue[i] += weight_a * p + weight_b * q


@inlined
def _store_blocks(red: Any, green: Any, blue: Any, peak: Any, block: Any, total: Any, brightest: Any) -> None:
    """Write the sums of the columns of each block (W/block, 3), and the largest luma code (W/block,)."""
    for k in range(len(total)):
        r, g, b = _ZERO, _ZERO, _ZERO
        high = peak[k * block]
        for i in range(k * block, (k + 1) * block):
            r += red[i]
            g += green[i]
            b += blue[i]
            high = max(high, peak[i])
        total[k, 0], total[k, 1], total[k, 2] = r, g, b
        brightest[k] = high


@fast_making
def reduce_planes(
    planes: Any, folded: Any, curve: Any, row_weight: Any, block: int, total: Any, brightest: Any
) -> None:
    """Reduce the planes (y, u, v) of a 4:2:0 frame whose sides are multiples of an even `block`.

    folded, curve: `folded_coefficients` and `decode_polynomial`. row_weight: (H,) solid angle over that of the block.
    total: (H/block, W/block, 3), gets the mean linear radiance; brightest: (H/block, W/block), the largest luma code.
    """
    y, u, v = planes
    height, width = y.shape
    dr, dg, db = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    red, green, blue = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    peak = np.empty(width, y.dtype)
    for band in range(height // block):
        red[:] = _ZERO
        green[:] = _ZERO
        blue[:] = _ZERO
        peak[:] = 0
        for row in range(band * block, (band + 1) * block, 2):
            ya, yb, chroma_u, chroma_v = y[row], y[row + 1], u[row // 2], v[row // 2]
            _chroma_parts(chroma_u, chroma_v, folded, dr, dg, db)
            for i in range(width):
                peak[i] = max(peak[i], ya[i], yb[i])
            weights = row_weight[row], row_weight[row + 1]
            _add_light((ya, yb), weights, folded[0], curve, (dr, dg, db), (red, green, blue))
        _store_blocks(red, green, blue, peak, block, total[band], brightest[band])


class YuvPlate:
    """The planes of a 4:2:0 frame, with the maps of one pass over them in blocks. clipped: whether it ends at display
    white, which channels reach one by one.
    """

    def __init__(self, yuv: YuvImage, block: int, up: Array, refractive_index: float, *, clipped: bool) -> None:
        self.yuv, self.up, self.refractive_index = yuv, up, refractive_index
        coarse, self.brightest = _reduce(yuv, block)
        self.coarse = unclipped(coarse) if clipped else coarse

    def look(self, direction: Floats) -> Floats:
        """Return the plate's linear radiance (h, w, 3) in directions (h, w, 3)."""
        from mr360uw.yuv.decoding import linear_in_directions

        return linear_in_directions(self.yuv, direction)

    look_expanded = look


@checked
def environment_from_yuv(
    yuv: YuvImage,
    settings: LightSettings | None = None,
    *,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> Environment:
    """Return the light of a decoded frame, 8 to 16 bit: that of `environment` of the same frame in linear light.

    4:2:0 frames of even size take one pass over the planes; others, curves that hold light above white, and operators
    that expand are decoded in full first.
    """
    settings = settings or LightSettings()
    return light_of(plate_of_yuv(yuv, settings, upward(up), refractive_index), settings, sun, underwater, glossy)


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
        return LinearPlate(lit_frame(yuv), settings, up, refractive_index)
    return YuvPlate(yuv, block, up, refractive_index, clipped=settings.operator == "closure")


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


@shared(keep=8)
def _row_weights(width: int, height: int, block: int) -> Floats:
    weight = row_solid_angle(width, height).reshape(-1, block)
    weight /= weight.sum(axis=1, keepdims=True) * block
    return weight.ravel().astype(np.float32)


def _reduce(yuv: YuvImage, block: int) -> tuple[Floats, Floats]:
    """Return the coarse maps of a frame: mean linear radiance (128, 256, 3), brightest luminance (128, 256)."""
    from mr360uw.yuv.decoding import lit_rec709

    height, width = yuv.y.shape
    if yuv.y.dtype not in (np.uint8, np.uint16) or not 8 <= yuv.spec.bits <= 16:
        raise ParameterError(f"planes - must be uint8 or uint16 (got {yuv.y.dtype}) - decode to one of them")
    total = np.empty((height // block, width // block, 3), np.float32)
    peak = np.empty(total.shape[:2], yuv.y.dtype)
    folded, curve = folded_coefficients(yuv.spec), decode_polynomial(yuv.spec.transfer)
    weights = _row_weights(width, height, block)
    reduce_planes((yuv.y, yuv.u, yuv.v), folded, curve, weights, block, total, peak)
    low, span, _, _ = code_range(yuv.spec)
    total = lit_rec709(total, yuv.spec)
    coarse = (
        total if total.shape[:2] == (COARSE_ROWS, COARSE_COLUMNS) else reduce_map(total, COARSE_COLUMNS, COARSE_ROWS)
    )
    brightest = np.maximum((peak.astype(np.float32) - low) / span, 0.0)
    if brightest.shape != (COARSE_ROWS, COARSE_COLUMNS):
        brightest = reduce_maximum(brightest, COARSE_COLUMNS, COARSE_ROWS)
    return coarse.astype(np.float32), decode(brightest, yuv.spec.transfer)
