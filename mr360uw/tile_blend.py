# SPDX-License-Identifier: Apache-2.0
"""The compositing formula of a tile over the plate: differential rendering below water, then `over`.

The plate's radiance is T L_surface + veil. A shadow or a caustic changes L_surface alone, so the receiver's ratio
E_with/E_without multiplies (plate - veil) and leaves the veil (Debevec 1998, with the veil that water adds):

    background = veil + (plate - veil) ratio + shafts        composite = radiance + (1 - alpha) background

Shafts are the change of the smooth veil by bodies and waves, of either sign; they never make the plate negative.

Alpha is premultiplied (Porter & Duff 1984). A veil brighter than the plate is clipped to it, so that haze is never
darkened and no pixel turns negative.

A plate of a wider gamut than Rec.709 has channels below zero. They are multiplied by s, the least factor of the
channels above zero, 1 at most: the background is then s plate plus light that is nowhere negative, and a colour that
the plate's primaries can show stays one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact, inlined
from mr360uw.types import Floats, Tile


def blended(plate_linear: Floats, tile: Tile) -> Floats:
    """Return the composite (h, w, 3) of the plate's linear pixels below one tile, in their type."""
    image = np.empty_like(plate_linear)
    shafts = np.zeros((0, 0, 3), tile.radiance.dtype) if tile.shafts is None else tile.shafts
    lay_over(plate_linear, tile.radiance, tile.alpha, tile.ratio, tile.veil, shafts, plate_linear.dtype.type(1), image)
    return image


def light_sum(image: Floats) -> float:
    """Return the sum of an image's light; it is not finite where any number is not."""
    with np.errstate(all="ignore"):
        return float(image.sum())


def changed_pixels(tile: Tile) -> NDArray[np.bool_]:
    """Return where a tile changes the plate, (h, w): coverage, light, shafts, or a ratio other than 1."""
    changed = (tile.alpha != 0.0) | np.any((tile.ratio != 1.0) | (tile.radiance != 0.0), axis=-1)
    return changed if tile.shafts is None else changed | np.any(tile.shafts != 0.0, axis=-1)


@exact
def find_changes(alpha: Any, radiance: Any, ratio: Any, shafts: Any, changed: Any) -> None:
    """Write `changed_pixels` of a row of a tile, float32, into `changed` (w,). shafts: (w, 3), or (0, 3) for none."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(len(changed)):
        same = alpha[i] == zero
        for c in range(3):
            same &= (ratio[i, c] == one) & (radiance[i, c] == zero)
        changed[i] = not same
    if len(shafts):
        for i in range(len(changed)):
            for c in range(3):
                changed[i] |= shafts[i, c] != zero


@inlined
def _background(below: Any, ratio: Any, veil: Any, one: Any) -> Any:
    """Return a channel of the plate that is not below zero with the light on its surface changed."""
    haze = min(veil, below)
    return haze + (below - haze) * ratio if ratio != one else below


@exact
def blend_row(plate: Any, radiance: Any, alpha: Any, ratio: Any, veil: Any, shafts: Any, one: Any, image: Any) -> None:
    """Write the composite (w, 3) of a row of a tile over the plate's pixels (w, 3).

    shafts: (w, 3), or (0, 3) for none. one: 1 in the type that is computed in. Where a tile changes nothing the plate
    is copied bit for bit.
    """
    zero = one - one
    if len(shafts):
        for i in range(len(alpha)):
            for c in range(3):
                below = max(_background(plate[i, c], ratio[i, c], veil[i, c], one) + shafts[i, c], zero)
                image[i, c] = radiance[i, c] + (one - alpha[i]) * below
    else:
        for i in range(len(alpha)):
            for c in range(3):
                below = _background(plate[i, c], ratio[i, c], veil[i, c], one)
                image[i, c] = radiance[i, c] + (one - alpha[i]) * below
    for i in range(len(alpha)):
        if min(plate[i, 0], plate[i, 1], plate[i, 2]) >= zero:
            continue
        # Beyond the gamut: find by what factor the channel with light that loses most is multiplied
        least = one
        for c in range(3):
            if plate[i, c] > zero:
                below = _background(plate[i, c], ratio[i, c], veil[i, c], one)
                if len(shafts):
                    below = max(below + shafts[i, c], zero)
                least = min(least, below / plate[i, c])
        # Multiply those below zero by it
        for c in range(3):
            if plate[i, c] < zero:
                below = plate[i, c] * least
                if len(shafts):
                    below += max(shafts[i, c], zero)
                image[i, c] = radiance[i, c] + (one - alpha[i]) * below


@exact
def lay_over(plate: Any, radiance: Any, alpha: Any, ratio: Any, veil: Any, shafts: Any, one: Any, image: Any) -> None:
    """Write the composite (h, w, 3) of a tile over the plate's pixels (h, w, 3); see `blend_row`."""
    for j in range(alpha.shape[0]):
        more = shafts[min(j, len(shafts) - 1)] if len(shafts) else shafts.reshape(0, 3)
        blend_row(plate[j], radiance[j], alpha[j], ratio[j], veil[j], more, one, image[j])
