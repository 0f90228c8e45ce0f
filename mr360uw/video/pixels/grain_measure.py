# SPDX-License-Identifier: Apache-2.0
"""Measures the plate's grain in one frame: its strength over brightness, and its spectrum.

Grain is the noise that camera and codec add to code values. It varies with brightness, differs between luma and chroma,
and is correlated after compression. It is measured where the picture is smooth:

    1. rows of three 32 x 32 blocks on a lattice between the latitudes +-60 degrees, none clipped or flat at the sides;
    2. in each quarter of them by brightness, the smoothest eighth. The outer blocks are judged and the middle one is
       measured, since a block chosen for its low roughness underestimates it;
    3. their power spectra (tilt removed, Hann window), the median over the blocks at each frequency, which a few
       textured blocks do not move; the lowest frequencies are taken like the next higher ones;
    4. the shape of the spectrum from the whitest quarter, the strength of the others by the median ratio to it:
       texture fills low frequencies, few of all;
    5. less the noise that rounding with dither adds on writing, step^2/6.

One picture cannot separate grain from texture as fine as grain: where nothing is smooth, it is overestimated.

Codes are in units of full scale, Y' from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import Transfer, code_range, decode, encode, ycbcr_from_rgb
from mr360uw.types import Floats, YuvImage
from mr360uw.video.pixels.grain import NO_GRAIN, RADIUS, TABLE, Grain, survey

Blocks = Callable[[NDArray[np.int64], NDArray[np.int64], int], NDArray[np.float32]]
"""(rows (n,), columns (n,) of pixels, plane) -> the blocks (n, BLOCK, BLOCK) there of Y', Cb or Cr."""

BLOCK = 32
"""Side of a measured block [px], several times the grain's correlation length."""
LATTICE = 16, 24
"""Number of places measured, down and along the picture; time grows with their product."""
LATITUDES = 2.0 / 3.0
"""Fraction of a panorama's rows that is measured: nearer to the poles the picture is stretched."""
GROUPS = 4
"""Groups by brightness: nodes of the strength's curve."""
SMOOTHEST = 8
"""One in so many of each group is measured. A larger share takes in texture, which then counts as grain."""
CONTRAST = 2.5
"""The strongest grain over the weakest, by brightness. Photon noise is nearly even in code values (sRGB: L^-0.08), that
of the electronics shows in the dark; what exceeds this is texture. Half the noise of rounding counts as some grain."""
_FEWEST = 4
"""Least number of blocks in a group: the median of fewer spectra is noise."""
_RING = np.maximum(np.abs(np.fft.fftfreq(BLOCK))[:, None], np.fft.rfftfreq(BLOCK)) * BLOCK
"""Distance (BLOCK, BLOCK/2 + 1) of the frequencies of `rfft2` from zero, along the farther axis."""
_ROUNDING = 1.0 / 6.0
"""Variance that rounding with an even dither adds, in squared steps, on average over all values."""


def grain_of_planes(image: YuvImage, panorama: bool = True) -> Grain:
    """Return the grain of decoded planes; none where they are smaller than two blocks.

    panorama: the rows are latitudes, and those near the poles are left out.
    """
    y_offset, y_span, c_offset, c_span = code_range(image.spec)
    offset, span = (y_offset, c_offset, c_offset), (y_span, c_span, c_span)
    planes = image.y, image.u, image.v

    def blocks(rows: NDArray[np.int64], columns: NDArray[np.int64], plane: int) -> NDArray[np.float32]:
        codes = planes[plane]
        j, i = (n * small // large for n, small, large in zip((rows, columns), codes.shape, image.y.shape, strict=True))
        j, i = np.minimum(j, codes.shape[0] - BLOCK), np.minimum(i, codes.shape[1] - BLOCK)
        windows = np.lib.stride_tricks.sliding_window_view(codes, (BLOCK, BLOCK))
        return (windows[j, i].astype(np.float32) - np.float32(offset[plane])) * np.float32(1.0 / span[plane])

    if min(image.u.shape) < BLOCK:
        return NO_GRAIN
    steps = np.array([1.0 / y_span, 1.0 / c_span, 1.0 / c_span])
    return _measure(blocks, image.y.shape, panorama, _ROUNDING * steps**2)


def grain_of_rgb(codes: NDArray[Any], transfer: Transfer, panorama: bool = True) -> Grain:
    """Return the grain of an RGB picture (H, W, 3) in Y'CbCr of BT.709.

    transfer: the curve of its values. Floating point pictures are measured as sRGB would code them, and were never
    rounded.
    """
    matrix = ycbcr_from_rgb("bt709")
    step = 1.0 / np.iinfo(codes.dtype).max if codes.dtype.kind == "u" else 0.0

    def blocks(rows: NDArray[np.int64], columns: NDArray[np.int64], plane: int) -> NDArray[np.float32]:
        windows = np.lib.stride_tricks.sliding_window_view(codes, (BLOCK, BLOCK), axis=(0, 1))
        found = np.asarray(windows[rows, columns], np.float32)  # (n, 3, BLOCK, BLOCK)
        rgb = found * np.float32(step) if step else encode(decode(found, transfer), "srgb")
        return np.einsum("nchw,c->nhw", rgb, matrix[plane].astype(np.float32))

    found = _measure(blocks, codes.shape[:2], panorama, _ROUNDING * step**2 * np.sum(matrix**2, axis=1))
    return replace(found, transfer=transfer) if step else found


def _measure(blocks: Blocks, shape: tuple[int, int], panorama: bool, rounding: Floats) -> Grain:
    rows, columns = shape
    if rows < 2 * BLOCK or columns < 3 * BLOCK:
        return NO_GRAIN
    border = int(0.5 * (1.0 - LATITUDES) * rows) if panorama else 0
    first, last = min(border, (rows - BLOCK) // 2), max(rows - border - BLOCK, (rows - BLOCK) // 2)
    j = np.linspace(first, last, LATTICE[0]).astype(np.int64).repeat(LATTICE[1])
    i = np.tile(np.linspace(0, columns - 3 * BLOCK, LATTICE[1]).astype(np.int64), LATTICE[0])
    found = np.empty((2, len(j), 4), np.float32)
    for side in range(2):
        survey(blocks(j, i + 2 * side * BLOCK, 0), found[side])
    low, high, mean, rough = found[..., 0].min(0), found[..., 1].max(0), found[..., 2].mean(0), found[..., 3]
    # flat to the last bit is no picture of a camera: a cap, a title
    usable = (low > 0.0) & (high < 1.0) & np.all(rough > 0.0, axis=0)
    groups = _smooth_groups(mean, rough.max(0), usable)
    if not groups:
        return NO_GRAIN
    brightness = [float(mean[group].mean()) for group in groups]
    deviation, filters = np.zeros((3, TABLE), np.float32), np.zeros_like(NO_GRAIN.filters)
    chosen, ends = np.concatenate(groups), np.cumsum([len(group) for group in groups])[:-1]
    for plane in range(3):
        power = _power(blocks(j[chosen], i[chosen] + BLOCK, plane))
        spectra = np.array([_median(part) for part in np.split(power, ends)])
        strength, filters[plane] = _fit(spectra, float(rounding[plane]))
        deviation[plane] = np.interp(np.linspace(0.0, 1.0, TABLE), brightness, strength)
    return Grain(deviation, filters)


def _smooth_groups(brightness: Floats, rough: Floats, usable: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Return the numbers of the smoothest blocks in each group by brightness, darkest first."""
    order = np.flatnonzero(usable)
    order = order[np.argsort(brightness[order], kind="stable")]
    groups = [g for g in np.array_split(order, GROUPS) if len(g) >= SMOOTHEST * _FEWEST]
    return [g[np.argsort(rough[g], kind="stable")[: len(g) // SMOOTHEST]] for g in groups]


def _power(blocks: Floats) -> Floats:
    """Return the power of blocks (n, BLOCK, BLOCK) at each frequency of `rfft2`, (n, BLOCK, BLOCK/2 + 1)."""
    import scipy.fft

    ramp = ((np.arange(BLOCK) - 0.5 * (BLOCK - 1)) / np.sqrt((BLOCK**2 - 1) / 12.0)).astype(np.float32)
    flat = blocks - blocks.mean((1, 2), keepdims=True)
    flat -= (flat.mean(1) @ ramp / BLOCK)[:, None, None] * ramp
    flat -= (flat.mean(2) @ ramp / BLOCK)[:, None, None] * ramp[:, None]
    window = np.hanning(BLOCK + 2)[1:-1].astype(np.float32)
    window = np.outer(window, window)
    waves = scipy.fft.rfft2(flat * window, overwrite_x=True)
    return (waves.real**2 + waves.imag**2) / (np.sum(window**2) * BLOCK**2)


def _median(power: Floats) -> Floats:
    """Return the mean of spectra (n, BLOCK, BLOCK/2 + 1) by their median: that of n exponentially distributed numbers
    of mean 1 is about ln 2 + 1/(2 n).
    """
    ordered = np.sort(power, axis=0)
    middle = (ordered[(len(power) - 1) // 2] + ordered[len(power) // 2]) / (2.0 * np.log(2.0) + 1.0 / len(power))
    middle = 0.5 * (middle + np.roll(middle[::-1], 1, axis=0))  # grain has no handedness
    return np.where(_RING < 2, middle[_RING == 2].mean(), middle)


def _total(power: Floats) -> Floats:
    """Return the variance (...) of spectra (..., BLOCK, BLOCK/2 + 1)."""
    return 2.0 * power.sum((-2, -1)) - power[..., 0].sum(-1) - power[..., -1].sum(-1)


def _fit(spectra: Floats, rounding: float) -> tuple[Floats, Floats]:
    """Return standard deviations (g,) and the filter of groups' spectra (g, BLOCK, BLOCK/2 + 1), rounding taken off."""
    share = spectra[:, _RING < BLOCK // 4].sum(-1) / np.maximum(spectra.sum((1, 2)), 1e-30)
    whitest = np.maximum(spectra[int(np.argmin(share))], 1e-30)
    scale = np.median((spectra / whitest).reshape(len(spectra), -1), axis=-1)
    strength = np.sqrt(np.maximum(scale * _total(whitest) - rounding, 0.0))
    strength = np.minimum(strength, CONTRAST * max(float(strength.min()), 0.5 * rounding**0.5))
    power = np.maximum(scale.mean() * whitest - rounding / BLOCK**2, 0.0)
    kernel = np.fft.fftshift(np.fft.irfft2(np.sqrt(power)))
    middle = slice(BLOCK // 2 - RADIUS, BLOCK // 2 + RADIUS + 1)
    return strength, kernel[middle, middle] / max(float(np.linalg.norm(kernel[middle, middle])), 1e-30)
