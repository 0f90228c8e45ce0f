# SPDX-License-Identifier: Apache-2.0
"""Softness of a plate: estimated from the roll-off of its power spectrum, and given to the bodies of a layer.

Power spectra of natural pictures fall as f^-2 in each direction (Field 1987, fig. 8). A blur of standard deviation s
multiplies them by exp(-4 pi^2 s^2 f^2):

    ln P(f) = ln A - n ln f - 4 pi^2 s^2 f^2        f in cycles per pixel; n is held near 2

1. Luma is cut into 32 x 32 blocks between the latitudes +-45 degrees, spread evenly over the frames.
2. The median spectrum of the least detailed fifth is the noise of camera and codec.
3. The geometric mean of the most detailed tenth, less the noise, is fitted where it is four times as strong.
4. Where that is no such curve, it is fitted again well above its least power: encoders add noise to the detail itself.

A plate without detail well above its noise shows nothing, and neither does one whose spectrum is no such curve.
The blur of lens, camera, editor and encoder is found as one, in pixels. Sharpening is not told from the spectrum: an
unsharp mask of amount 1 was found as 0.6 to 1.8, and sharp caustics pass for one.

Bodies are blurred and sharpened by premultiplied radiance and coverage:

    blur      C' = G C, a' = G a                       G: Gaussian, over the panorama's seam
    mask      C" = C' + k (C' - U C') + (a' - a) B     a = a' + k (a' - U a'), U: Gaussian of the mask

C" over a' is the masked composite where the background B, the plate with shadows, caustics and shafts, is smooth beside
the body; only pixels of coverage change. The background has its look already and stays as it is. A layer's light is
not negative: where the mask makes a dark edge darker than what shines through, its coverage grows instead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.grading.settings import PlateGrade, gaussian
from mr360uw.composite.tiles import even_tiles, over_tile, tile_of
from mr360uw.types import Floats, Layer, Rectangle, Tile

Plate = Callable[[Rectangle], Floats]
"""Part of the plate, linear (h, w, 3)."""
_FAINTEST = 1e-4
"""Coverage below which the blur leaves none: a fiftieth of a code on white."""


def matched_layer(layer: Layer, grade: PlateGrade, plate: Plate) -> Layer:
    """Return a layer whose bodies have a look; the layer itself where the look changes nothing or there are no bodies.

    plate: gives the plate that the layer is laid over.
    """
    reach = grade.reach_px
    bodies = [tile for tile in layer.tiles if np.any(tile.alpha > 0.0)]
    if reach == 0 or not bodies:
        return layer
    grown = [_grown(tile.rectangle, reach, layer) for tile in bodies]
    parts = even_tiles([*grown, *(tile.rectangle for tile in layer.tiles)], layer.width, layer.height)
    return replace(layer, tiles=tuple(_matched(layer, part, grade, plate) for part in parts))


def _matched(layer: Layer, part: Rectangle, grade: PlateGrade, plate: Plate) -> Tile:
    """Return one tile of the matched layer."""
    tile, reach = tile_of(layer, part), grade.reach_px
    around = _around(layer, part, reach)
    if not np.any(around[..., 3] > 0.0):
        return tile
    soft = gaussian(around, grade.softness_px)
    inside = slice(reach, reach + part.height), slice(reach, reach + part.width)
    inner = soft[inside]
    alpha = np.where(inner[..., 3] < _FAINTEST, 0.0, np.minimum(inner[..., 3], 1.0)).astype(np.float32)
    radiance = np.where(alpha[..., None] > 0.0, inner[..., :3], 0.0)
    if grade.sharpening > 0.0:
        masked = (soft + grade.sharpening * (soft - gaussian(soft, grade.sharpening_px)))[inside]
        clear = replace(tile, radiance=np.zeros_like(tile.radiance), alpha=np.zeros_like(tile.alpha))
        background = np.maximum(over_tile(plate(part), clear), 0.0)
        shown = masked[..., :3] + (1.0 - masked[..., 3])[..., None] * background
        shown = np.maximum(np.where(alpha[..., None] > 0.0, shown, background), 0.0)
        kept = np.divide(shown, background, out=np.ones(shown.shape, shown.dtype), where=background > 0.0)
        alpha = np.where(alpha > 0.0, np.maximum(alpha, 1.0 - kept.min(axis=-1)), 0.0).astype(np.float32)
        through = (1.0 - alpha)[..., None] * background
        radiance = np.where(alpha[..., None] > 0.0, np.maximum(shown - through, 0.0), 0.0)
    return replace(tile, radiance=radiance.astype(np.float32), alpha=alpha)


def _grown(part: Rectangle, reach: int, layer: Layer) -> Rectangle:
    """Return a rectangle grown on all sides, which may go over the panorama's seam."""
    first, last = max(part.row - reach, 0), min(part.row + part.height + reach, layer.height)
    width = part.width + 2 * reach
    if width >= layer.width:
        return Rectangle(0, first, layer.width, last - first)
    return Rectangle((part.column - reach) % layer.width, first, width, last - first)


def _around(layer: Layer, part: Rectangle, reach: int) -> Floats:
    """Return radiance and coverage (h + 2 reach, w + 2 reach, 4) about a rectangle; the edge rows are repeated."""
    first, last = max(part.row - reach, 0), min(part.row + part.height + reach, layer.height)
    pieces, column, left = [], part.column - reach, part.width + 2 * reach
    while left > 0:
        start = column % layer.width
        size = min(left, layer.width - start)
        tile = tile_of(layer, Rectangle(start, first, size, last - first))
        pieces.append(np.concatenate([tile.radiance, tile.alpha[..., None]], axis=-1))
        column, left = column + size, left - size
    found = np.concatenate(pieces, axis=1)
    lacks = first - (part.row - reach), part.row + part.height + reach - last
    return np.pad(found, (lacks, (0, 0), (0, 0)), mode="edge")


BLOCK = 32
"""Side of a block [px]: 14 octave-free rings of frequencies. Twice as large, few blocks are detail alone."""
LATTICE = 24, 64
"""Most blocks down and along a frame; time grows with their product."""
LATITUDES = 0.25
"""Fraction of the rows left out at either pole: beyond 45 degrees rows are stretched more than 1.4 times."""
OWN_VARIANCE = 0.15
"""Variance [px^2] of the blur that a picture drawn by this package shows: 1/12 of a pixel's area, and its edges."""
LEAST_VARIANCE = 0.4
"""Variance [px^2] below which a plate counts as sharp. Synthetic dives of sharp pictures show up to 0.25."""
LEAST_DETAIL = 100.0
"""Least ratio of detail to noise. Below it, an encoder at work on a dim floor passes for a blur."""
LEAST_RINGS = 5
"""Fewest frequencies for a fit of two numbers and a slope that is nearly known."""
MOST_RESIDUAL = 0.1
"""Standard deviation of ln P about the curve, over what the blur takes off it, above which none is evident: the
variance would be known to no better than a tenth."""
_SLOPE, _SLOPE_WEIGHT = 2.0, 3.0
"""Slope of the power of natural pictures, and the weight of its being so: as much as that of nine frequencies."""
_TWICE = 4.0
"""Ratio of a frequency's power to the noise from which on it is fitted."""

_FLOORS = 8.0
"""The same over the least power of the detail, which is not known to be noise: an eighth of it is an error of 12 %."""


def detail_spectrum(frames: Sequence[NDArray[Any]]) -> tuple[Floats, Floats, float]:
    """Return the spectrum of the detail of pictures of luma (H, W) on any scale, equirectangular.

    Frequencies (n,) [cycles/px] at which it exceeds the noise, its mean power (n,) there, and detail over noise.
    """
    rings = np.concatenate([_rings(luma) for luma in frames]) if frames else np.empty((0, BLOCK // 2 - 1))
    frequency = np.arange(1, BLOCK // 2) / BLOCK
    # flat to the last bit is no picture of a camera: a cap, a title
    rings = rings[rings[:, -1] > 0.0]
    if len(rings) < 40:
        return frequency[:0], frequency[:0], 0.0
    energy = rings[:, 3:8].sum(axis=1)
    order = np.argsort(energy, kind="stable")
    noise = np.median(rings[order[: len(order) // 5]], axis=0)
    top = rings[order[-max(8, len(order) // 10) :]]
    power = np.exp(np.log(top).mean(axis=0))
    used = (power > _TWICE * noise) & (frequency >= 2.0 / BLOCK) & (frequency < 0.45)
    return frequency[used], (power - noise)[used], float(energy[order[-len(top) :]].mean() / np.median(noise))


def point_spread(frames: Sequence[NDArray[Any]]) -> PlateGrade:
    """Return the blur of pictures of luma (H, W), on any scale; none where it is not evident."""
    frequency, power, detail = detail_spectrum(frames)
    floor = power.min(initial=np.inf)
    above = power > _FLOORS * floor  # less an encoder's noise in the detail itself
    for f, of in ((frequency, power), (frequency[above], power[above] - floor)):
        if len(of) < LEAST_RINGS or detail < LEAST_DETAIL:
            return PlateGrade()
        variance, residual = _fit_blur(f, of)
        if variance <= LEAST_VARIANCE:
            return PlateGrade()
        if residual <= MOST_RESIDUAL * float(4.0 * np.pi**2 * variance * f[-1] ** 2):
            return PlateGrade(softness_px=float(np.sqrt(variance - OWN_VARIANCE)))
    return PlateGrade()


def _rings(luma: NDArray[Any]) -> Floats:
    """Return the power (n, BLOCK/2 - 1) of a picture's blocks at 1, 2 ... cycles per block, over all directions."""
    rows, columns = luma.shape
    first, last = int(LATITUDES * rows), rows - int(LATITUDES * rows) - BLOCK
    if last <= first or columns < 2 * BLOCK:
        return np.empty((0, BLOCK // 2 - 1))
    down = min(LATTICE[0], 2 * (last - first) // BLOCK + 1)
    along = min(LATTICE[1], 2 * columns // BLOCK)
    j = np.linspace(first, last, down).astype(int).repeat(along)
    i = np.tile(np.linspace(0, columns - BLOCK, along).astype(int), down)
    blocks = np.lib.stride_tricks.sliding_window_view(luma, (BLOCK, BLOCK))[j, i].astype(np.float64)
    window = np.outer(*[np.hanning(BLOCK + 2)[1:-1]] * 2)
    waves = np.fft.rfft2((blocks - blocks.mean((1, 2), keepdims=True)) * window)
    power = (waves.real**2 + waves.imag**2).reshape(len(blocks), -1) / np.sum(window**2)
    x, y = np.fft.rfftfreq(BLOCK) * BLOCK, np.fft.fftfreq(BLOCK) * BLOCK
    ring = np.rint(np.hypot(y[:, None], x)).astype(int)
    twice = np.where((x > 0) & (x < BLOCK // 2), 2.0, 1.0)  # with the conjugate wave, which is left out
    members = np.array([((ring == n) * twice).ravel() for n in range(1, BLOCK // 2)])
    return power @ (members / members.sum(axis=1, keepdims=True)).T


def _fit_blur(frequency: Floats, power: Floats) -> tuple[float, float]:
    """Return the variance [px^2] of the blur, and the standard deviation of ln P about the fit with n near `_SLOPE`."""
    terms = np.stack([np.ones_like(frequency), -np.log(frequency), -4.0 * np.pi**2 * frequency**2], axis=1)
    rows, values = np.vstack([terms, [0.0, _SLOPE_WEIGHT, 0.0]]), np.append(np.log(power), _SLOPE_WEIGHT * _SLOPE)
    found = np.linalg.lstsq(rows, values, rcond=None)[0]
    return float(found[2]), float(np.std(terms @ found - np.log(power)))
