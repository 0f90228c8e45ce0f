# SPDX-License-Identifier: Apache-2.0
"""Judges whether a bright spot of a plate is a sun, and says why not.

Every property is a number from 0 to 1, and a spot is as good as the product of them. What is asked of it depends on
what the plate can show:

    unclipped   it stands far above the middle of the map, or outshines the sky while it ends sharply; most light as
                bright lies in it. Any size up to `_WIDEST_SUN_DEG`: haze and thin cloud widen a sun
    clipped     white, not as wide as a sky, most white lies in it, a sharp edge or dark surroundings: nothing is known
                of how bright it was

All of them fall or rise with radius, exposure and contrast, so that no wider or darker spot is a sun where a smaller or
brighter one is none, apart from the limits of size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.ibl.sun.blob import CLIPPED, Blob

_WIDEST_SUN_DEG = (8.0, 15.0)
"""Radius [deg] of an unclipped spot up to which it may be a sun, and from which it is a bright part of the sky."""
_WIDEST_GLARE_DEG = (5.0, 15.0)
"""The same of a clipped spot, which lens, haze and exposure widen."""
_REFRACTED = 1.5
"""Factor of the radius under water, where waves spread the sun."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A candidate for the sun, the confidence in it, 0 to 1, and what speaks against it most ("" for nothing)."""

    blob: Blob
    confidence: float
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Verdict:
    """How surely a spot is a sun, 0 to 1, and what speaks against it most, in words; "" where nothing does."""

    confidence: float
    reason: str


def falling(x: float, one: float, zero: float) -> float:
    """Return 1 for x on the side of `one`, 0 on that of `zero`, a smooth step between."""
    t = float(np.clip((x - zero) / (one - zero), 0.0, 1.0))
    return t * t * (3.0 - 2.0 * t)


def judge(blob: Blob, lone: float, contrast: float, *, underwater: bool = False, clipped: bool) -> Verdict:
    """Return the verdict on a spot.

    lone: its share of all light as bright. contrast: peak over the median value of the map; 0 where that is black.
    clipped: whether the plate ends at display white there.
    """
    if clipped:
        return verdict(
            sized(blob, underwater=underwater),
            whitened(blob),
            (falling(lone, 0.5, 0.15), f"one of many: it holds {100.0 * lone:.0f} % of the light as bright"),
            edged(blob),
        )
    # irradiance over that of a sky that is everywhere as bright as the middle of the map
    beam = contrast * float(np.sin(blob.radius_rad)) ** 2
    outshines = falling(np.log10(max(beam, 1e-9)), 0.0, -1.0) * falling(blob.halo, 0.1, 0.3)
    stands_out = falling(np.log10(max(contrast, 1e-9)), 3.6, 2.6)
    return verdict(
        sized(blob, _WIDEST_SUN_DEG, underwater=underwater),
        (max(stands_out, outshines), f"too dim: {contrast:.3g} times the middle of the map"),
        (falling(lone, 0.9, 0.6), f"one of several: it holds {100.0 * lone:.0f} % of the light as bright"),
    )


def sized(
    blob: Blob, widest_deg: tuple[float, float] = _WIDEST_GLARE_DEG, *, underwater: bool = False
) -> tuple[float, str]:
    """Return whether a spot is small enough, as a property for `verdict`."""
    radius = float(np.degrees(blob.radius_rad)) / (_REFRACTED if underwater else 1.0)
    return falling(radius, *widest_deg), f"as wide as a sky: {radius:.1f} degrees of radius"


def edged(blob: Blob) -> tuple[float, str]:
    """Return whether a clipped spot ends sharply or in the dark, as a property for `verdict`."""
    edge = max(falling(blob.halo, 0.55, 0.8), falling(blob.radius_rad / blob.extent_rad, 0.7, 0.4))
    return edge, f"no edge: the sky about it is {100.0 * blob.halo:.0f} % as bright"


def whitened(blob: Blob) -> tuple[float, str]:
    """Return whether a spot reaches display white, as a property for `verdict`."""
    return falling(blob.peak, CLIPPED, CLIPPED - 0.1), f"not white: {blob.peak:.2f} of display white"


def verdict(*properties: tuple[float, str]) -> Verdict:
    """Return the verdict from properties (value, what is wrong if it is small)."""
    value, reason = min(properties)
    return Verdict(float(np.prod([part for part, _ in properties])), reason if value < 1.0 else "")
