# SPDX-License-Identifier: Apache-2.0
"""Checks a clipped spot by the rest of the plate: suns that no spot gives away, and spots that are no sun.

A sun may be one of many clipped clouds: the glow of the clear sky points to it (`glow`). Or it stands somewhere in a
sky that is clipped far and wide, and only about where is known. It is taken for one where much of the sphere is clipped
and sky and ground both speak for a strong sun (`evidence`): a sun a few degrees off its place lights a scene better
than none. A bright gap in the clouds of a dusk looks like a sun, but sky and ground speak for hardly any light from it,
and the glow points elsewhere; where both do so it is none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.ibl.plate import Plate, coarse_solid_angle, plate_sines
from mr360uw.ibl.sun.blob import CLIPPED, examine
from mr360uw.ibl.sun.evidence import shown_ratio
from mr360uw.ibl.sun.glow import find_glow, rough_glow
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
_WEAK_RATIO = (0.4, 0.28)
"""Direct over diffuse light from which a spot needs no glow, and up to which it must lie where the glow points: thin
cloud leaves 0.2 to 0.4, a gap in the clouds of a dusk speaks for 0.1 to 0.26."""
_BESIDE_DEG = (6.0, 9.0)
"""Degrees from a spot's rim to where the glow roughly points, up to which it is that spot's, and from which it is not:
a pixel of the map in which it is looked for, and half of another."""


def doubted(plate: Plate, disc: Disc) -> Disc:
    """Return a clipped spot in air, of less confidence where it speaks for little light and the glow points elsewhere.

    The glow takes longer than all else and is looked for only where there is little light.
    """
    blob = disc.blob
    ratio = shown_ratio(plate, blob.direction, sky_irradiance(plate.coarse, plate.up))
    strong = falling(ratio, *_WEAK_RATIO)
    glow = None if strong == 1.0 else rough_glow(plate)
    if glow is None:
        return disc
    angle = float(np.degrees(np.arccos(np.clip(glow.direction @ blob.direction, -1.0, 1.0))))
    trust = max(strong, falling(angle - float(np.degrees(blob.radius_rad)), *_BESIDE_DEG))
    if trust == 1.0:
        return disc
    reason = f"a gap in clouds: {ratio:.2f} times the sky's light, and the glow points {angle:.0f} degrees beside it"
    return Disc(blob, disc.confidence * trust, reason)


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
