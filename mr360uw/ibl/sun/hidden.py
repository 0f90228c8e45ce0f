# SPDX-License-Identifier: Apache-2.0
"""Suns that no spot gives away: one of many clipped clouds, or somewhere in a sky that is clipped far and wide.

The glow of the clear sky points to the first (`glow`). Of the second only about where it stands is known. It is taken
for one where much of the sphere is clipped and sky and ground both speak for a strong sun (`evidence`): a sun a few
degrees off its place lights a scene better than none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.ibl.plate import Plate, coarse_solid_angle, plate_sines
from mr360uw.ibl.sun.blob import CLIPPED, examine
from mr360uw.ibl.sun.evidence import shown_ratio
from mr360uw.ibl.sun.glow import find_glow
from mr360uw.ibl.sun.judge import Disc, edged, falling, sized, verdict, whitened
from mr360uw.ibl.sun.split import sky_irradiance

_NO_SUN = 0.1
"""Confidence up to which a spot is so little of a sun that the glow names the better candidate."""
_EXPLAINED = (0.45, 0.32)
"""Share of the sky's variation that the sun's glow explains where it surely is one, and where it is none."""
_MUCH = 0.02
"""Share of the sphere that is clipped above the horizon from which suns hide in it."""
_STRONG_RATIO = 0.55
"""Direct over diffuse light from which a sun is taken to be there: thin clouds have less."""
_GUESS = 0.5
"""Confidence in such a sun, of which the place is not known well."""


def by_glow(plate: Plate, best: Disc | None) -> Disc | None:
    """Return the spot to which the glow of the sky points, or the best one so far if that is more of a sun."""
    glow = find_glow(plate)
    blob = None if glow is None else examine(plate, glow.direction, 0.0)
    if glow is None or blob is None:
        return best
    found = verdict(
        sized(blob),
        whitened(blob),
        edged(blob),
        (falling(glow.explained, *_EXPLAINED), f"the sky's glow explains {100.0 * glow.explained:.0f} % of its shades"),
    )
    if best is not None and best.confidence > max(found.confidence, _NO_SUN):
        return best
    return Disc(replace(blob, direction=glow.direction, clipped=True, sharp=False), found.confidence, found.reason)


def by_evidence(plate: Plate, best: Disc | None) -> Disc | None:
    """Return the best spot so far, with some confidence where much is clipped and the plate speaks for a sun."""
    if best is None or best.confidence >= _GUESS or best.blob.peak < CLIPPED:
        return best
    clipped = (plate.brightest >= CLIPPED) & (plate_sines(plate) > 0.0)
    share = float((clipped * coarse_solid_angle()).sum() / (4.0 * np.pi))
    if share < _MUCH:
        return best
    ratio = shown_ratio(plate, best.blob.direction, sky_irradiance(plate.coarse, plate.up))
    return replace(best, confidence=_GUESS) if ratio >= _STRONG_RATIO else best
