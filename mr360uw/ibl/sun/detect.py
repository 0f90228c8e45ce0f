# SPDX-License-Identifier: Apache-2.0
"""Detects the sun in a plate, clipped or not.

The sun is light that stands out of the map (Iorns 2016). Candidates come from the coarse map; each is measured closely
and judged by evidence that clouds, sand, caustics and lamps lack (`spots`): strength, size, being alone, an
edge, a glow, a lit ground. It stands over the horizon, or inside Snell's window for a camera under water. Where clipped
clouds hide which of them the sun is, the glow of the clear sky tells (`glow`).

Its irradiance is the light above the threshold near it; what stays below remains in the sky, so nothing counts twice.

The bright spot bounds the light that is taken out of the sky, not always the size of the sun: exposure, haze and lens
make a clipped spot up to ten times as wide as the disc that casts the shadows. An unclipped sun has the measured
radius, and so has a clipped one whose rim is that of a disc; any other clipped sun gets the sun's true radius.

Under water waves break a clipped sun into patches that come and go, and the largest of them wanders by degrees. What
hardly moves is the middle of all that is bright near it. It is that of the sun where the waves' slopes are as often up
as down: each direction of the water stands for the slope of a facet that refracts the sun's light into it, and the
middle is taken over these slopes (a mean shift under a Gaussian window, Comaniciu 2002). Over directions it would be up
to 6 degrees too high: towards the edge of Snell's window the same angle takes twice the slope.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.base.optics import refract_clamped, refract_to_air, snell_elevation
from mr360uw.base.parameters import checked
from mr360uw.base.sphere import unit
from mr360uw.ibl.plate import (
    DISPLAY_WHITE,
    LinearPlate,
    Plate,
    checked_plate,
    coarse_directions,
    coarse_solid_angle,
    patch_directions,
    plate_sines,
)
from mr360uw.ibl.sun.split import ground_ratio, sky_irradiance, split_sun
from mr360uw.ibl.sun.spots import CLIPPED, Blob, PlateSurvey, brightness, examine, find_glow, taken_share
from mr360uw.ibl.tilt import level_matrix, roll_pitch, upward
from mr360uw.types import Floats, Sun

_MOST_SEEDS = 600
"""Bright coarse pixels that are compared with each other; time grows with the square."""
_CANDIDATES = 3
"""Spots that are measured closely, at most."""
_SURE = 0.9
"""Confidence from which no other spot is looked at, and no glow, which takes longer than all else."""
_LIKELY = 0.5
"""Confidence from which a spot is taken before the place a glow points to, which is known to a few degrees only."""
_GLOW_RAD = np.radians(1.5)
"""Radius [rad] about the place a glow points to whose brightest pixel is the sun's."""
_LONE_ANGLE_RAD = np.radians(4.0)
"""Radius [rad] within which bright pixels count as one spot."""
_WIDEST_GLARE_RAD = np.radians(15.0)
"""Radius [rad] above which a bright spot is a sky, not the glare of a sun; the detector's confidence is 0 there."""


_WIDE_RAD = np.radians(0.8)
"""Radius [rad] up to which a clipped disc may be the sun itself, widened by lens and pixels: three times its own."""


def find_disc(plate: Plate, *, underwater: bool = False) -> Blob | None:
    """Return the most sun-like spot of a plate, None where nothing stands out at all."""
    # Look over the horizon, or inside Snell's window; nowhere there may be brighter than all else
    floor = float(np.sin(snell_elevation(plate.refractive_index))) if underwater else 0.0
    allowed = plate_sines(plate) > floor
    bright = np.where(allowed, plate.brightest, 0.0)
    value = brightness(plate.coarse)
    peak = float(bright.max())
    middle = float(np.median(value))
    if peak <= 1.05 * float(np.median(plate.brightest[allowed])):
        return None
    # Survey what the plate says of a sun before any spot is looked at
    white = ends_at_white(plate)
    weight = np.where(bright >= (0.9 if white else 0.3) * peak, value, 0.0) * coarse_solid_angle()
    known = middle > 0.0 or peak > DISPLAY_WHITE
    air = white and not underwater
    ground = ground_ratio(plate, sky_irradiance(plate.coarse, plate.up)) if air else None
    scene = PlateSurvey(plate, weight, middle if known else -1.0, floor, underwater, white, ground or 0.0)
    # Examine and judge bright spots, until one is sure
    spots: list[Blob] = []
    best: Blob | None = None
    for seed in _seeds(weight):
        blob = examine(plate, seed, floor, white=1.0 if white else math.inf)
        if blob is None:
            continue
        spots.append(blob)
        best = _surer(best, scene.judge(blob))
        if best.confidence > _SURE:
            break
    # Take the middle of a glitter; let the sky's gradient speak where spots do not settle it
    if underwater and best is not None and best.clipped:
        best = replace(best, direction=glitter_middle(plate, best.direction))
    settled = best is not None and best.confidence > _SURE and scene.lit == 1.0
    return best if settled or not air else _by_glow(scene, spots, best)


def _by_glow(scene: PlateSurvey, spots: list[Blob], best: Blob | None) -> Blob | None:
    """Return the most sun-like of spots and of the place the sky's gradient points to, judged by that gradient too."""
    glow = find_glow(scene.plate)
    if glow is None:
        return best
    scene, best = replace(scene, glow=glow), None
    for blob in spots:
        best = _surer(best, scene.judge(blob))
    if best is not None and best.confidence > _LIKELY:
        return best
    direction = glow[0]
    near = brightness(scene.plate.look(patch_directions(direction, _GLOW_RAD, 9)))
    there = examine(scene.plate, direction, scene.lowest_sine, white=min(float(near.max()), 1.0))
    if there is None:
        return best
    pointed = replace(there, direction=direction, clipped=True, sharp=False)
    return _surer(best, scene.judge(pointed, by_glow=True))


def _surer(best: Blob | None, other: Blob) -> Blob:
    return other if best is None or other.confidence > best.confidence else best


def _seeds(weight: Floats) -> Iterator[Floats]:
    """Yield directions (3,) about which most weight lies, within 4 degrees, each 15 degrees from those before."""
    chosen = weight > 0.0
    d, w = coarse_directions()[chosen], weight[chosen]
    step = len(d) // _MOST_SEEDS + 1  # of a sky that is bright all over any few pixels will do
    d, w = d[::step], w[::step]
    gathered = np.exp((d @ d.T - 1.0) / _LONE_ANGLE_RAD**2) @ w
    for _ in range(_CANDIDATES):
        k = int(gathered.argmax())
        if gathered[k] <= 0.0:
            return
        yield d[k]
        gathered = np.where(d @ d[k] > np.cos(np.radians(15.0)), 0.0, gathered)


def ends_at_white(plate: Plate) -> bool:
    """Return whether a plate ends at display white, so that a sun in it is clipped; a darker plate lost nothing."""
    return CLIPPED - 0.1 <= float(plate.brightest.max()) <= DISPLAY_WHITE


def spot_towards(plate: Plate, direction: Floats) -> Blob | None:
    """Return the bright spot that a sun towards `direction` (3,) makes; None where there is none."""
    blob = examine(plate, direction, -1.0, white=1.0 if ends_at_white(plate) else math.inf)
    if blob is None or blob.radius_rad > _WIDEST_GLARE_RAD:
        return None
    return blob if float(blob.direction @ direction) > np.cos(blob.radius_rad) else None


def shown_half_angle(plate: Plate, blob: Blob | None, underwater: bool) -> float:
    """Return the angular radius [rad] of a sun: that of its spot where the plate shows its disc, else the sun's own.

    Refraction divides the angles across its plane by the index of the water. Along it the disc is narrower still, but
    waves tilt by far more: the round disc is the sharpest that shadows get (`draw.sun_spread_deg` widens them).
    """
    if blob is not None and blob.sharp and (blob.radius_rad > _WIDE_RAD or not blob.clipped):
        return blob.radius_rad
    return SUN_HALF_ANGLE_RAD / plate.refractive_index if underwater else SUN_HALF_ANGLE_RAD


def shows_disc(blob: Blob | None) -> bool:
    """Return whether what is clipped about a sun is hardly more than its disc: neither cloud nor glare."""
    return blob is not None and blob.radius_rad <= _WIDE_RAD


def split_given(
    plate: Plate, direction: Floats, spot: Blob | None, half_angle_rad: float | None = None, *, underwater: bool = False
) -> tuple[Floats, Sun]:
    """Return the plate's expanded map without the light of the sun towards `direction` (3,), and this sun.

    spot: of `spot_towards` there. half_angle_rad: of its disc, None where it is not known.
    """
    size = shown_half_angle(plate, spot, underwater) if half_angle_rad is None else half_angle_rad
    radius = max(size, 0.0 if spot is None else spot.radius_rad)
    return split_sun(plate, direction, radius, size, 1.0, local=is_disc(spot))


def split_disc(plate: Plate, disc: Blob, *, underwater: bool = False) -> tuple[Floats, Sun]:
    """Return the plate's expanded map without this sun, and the sun; one that is not clipped is centred."""
    size = shown_half_angle(plate, disc, underwater)
    centred, local = not disc.clipped, is_disc(disc)
    return split_sun(plate, disc.direction, disc.radius_rad, size, disc.confidence, centred=centred, local=local)


def lost_light(plate: Plate, spot: Blob | None, *, detected: bool = False) -> bool:
    """Return whether a display-referred plate does not show how bright a sun with this spot is.

    detected: the sun was found by its spot; one that a plate shows unclipped, or that has no flat top, lost nothing.
    """
    if float(plate.brightest.max()) > DISPLAY_WHITE:
        return False
    return spot is None or (spot.flat and spot.peak >= CLIPPED if detected else not is_disc(spot))


def is_disc(blob: Blob | None) -> bool:
    """Return whether a spot is a sharp disc that is not clipped, which the sky around tells from the sky."""
    return blob is not None and not blob.clipped and blob.sharp


@checked
def detect_sun(
    plate: ArrayLike,
    underwater: bool = False,
    *,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> Sun | None:
    """Return the sun of a linear plate, HDR or clipped to display white = 1; None where there is none.

    The irradiance is that of the plate as it is: of a clipped one far too low (see `environment`).

    Parameters
    ----------
    plate : array_like
        Equirectangular picture (H, W, 3) of linear light.
    underwater : bool
        Look inside Snell's window only; the direction is that in the water.
    up : array_like, optional
        Direction (3,) of the world's up in the frame's axes; by default the frame is level.
    refractive_index : float
        Index of the water, 1 to 4.

    Returns
    -------
    Sun or None
        Its direction, irradiance, size and a confidence.

    Raises
    ------
    ParameterError
        If the array is no plate.

    See Also
    --------
    uw.ibl.environment : The whole light, with the strength of a clipped sun.
    uw.ibl.track_suns : Follows the sun over a clip.

    Examples
    --------
    >>> sky = np.full((64, 128, 3), 0.2)
    >>> sky[12:14, 64:66] = 400.0
    >>> uw.ibl.detect_sun(sky).direction.round(2)
    array([ 0.03,  0.8 , -0.6 ])
    >>> uw.ibl.detect_sun(np.full((64, 128, 3), 0.2)) is None
    True
    """
    seen = LinearPlate(checked_plate(plate), up=upward(up), refractive_index=refractive_index)
    disc = find_disc(seen, underwater=underwater)
    return None if disc is None or disc.confidence <= 0.0 else split_disc(seen, disc, underwater=underwater)[1]


_WINDOW = 0.35
"""Standard deviation of the window, a slope: half as large, the middle of a wide plateau is hardly found; twice as
large, the window's edge and the sky far from the sun count."""
_REACH, _PIXELS = 2.0, 49
"""Radius of the patch in windows, and its size."""
_FLOOR = 0.7
"""Brightness over the patch's largest that counts as the sun's; the sky of a clipped plate is half as bright."""
_ROUNDS = 16
"""Most rounds; each takes a half to a fifth of the way to the middle."""
_STILL_COSINE = 1.0 - 0.5 * np.radians(0.02) ** 2
"""Cosine of the step at which the search ends."""
_FARTHEST_COSINE = np.cos(np.radians(12.0))
"""Cosine of the largest correction; a middle further off is that of something else."""


def glitter_middle(plate: Plate, direction: Floats) -> Floats:
    """Return the direction (3,) in the water of the sun whose largest patch is seen towards `direction` (3,)."""
    level = level_matrix(*map(float, roll_pitch(plate.up)))
    start = level @ direction
    if start[1] <= 0.0:
        return direction
    index = plate.refractive_index
    place: Floats = start
    slope, normal, window = _patch()
    for _ in range(_ROUNDS):
        in_air = refract_to_air(place, index)
        seen, lit = _through_facets(in_air, normal, index)
        value = np.where(lit, brightness(plate.look(seen @ level)), 0.0)
        weight = np.maximum(value - _FLOOR * float(value.max()), 0.0) * window
        if float(weight.sum()) <= 0.0:
            return direction
        middle = np.tensordot(weight, slope, 2) / weight.sum()
        before, place = place, _through_facets(in_air, _normals(middle), index)[0]
        if place[1] <= 0.0:
            return direction
        if float(before @ place) > _STILL_COSINE:
            break
    return place @ level if float(place @ start) > _FARTHEST_COSINE else direction


@functools.cache
def _patch() -> tuple[Floats, Floats, Floats]:
    """Return the slopes (n, n, 2) of the patch, the normals (n, n, 3) of their facets and their weights (n, n)."""
    axis = np.linspace(-_REACH * _WINDOW, _REACH * _WINDOW, _PIXELS)
    slope = np.stack(np.meshgrid(axis, axis), axis=-1)
    return slope, _normals(slope), np.exp(-0.5 * np.sum(slope**2, axis=-1) / _WINDOW**2)


def _normals(slope: Floats) -> Floats:
    """Return the unit normals (..., 3) of facets of slopes (..., 2) over (x, z)."""
    return unit(np.stack([-slope[..., 0], np.ones(slope.shape[:-1]), -slope[..., 1]], axis=-1))


def _through_facets(sun_in_air: Floats, normal: Floats, index: float) -> tuple[Floats, np.ndarray]:
    """Return the directions (..., 3) in the water towards the sun through facets of normals (..., 3), and which of them
    the sun shines on.
    """
    lit = normal @ sun_in_air > 0.0
    travel = refract_clamped(np.broadcast_to(-sun_in_air, normal.shape), normal, 1.0 / index)
    return unit(-travel), lit


_WHOLE = 0.995
"""Share of a sun's light from which it is all of it in words."""


def sun_found(plate: Plate, world_from_camera: Floats, *, underwater: bool = False) -> tuple[str, str]:
    """Return a line on the most sun-like spot of a plate, and text for the end of a scene file, all comment, that makes
    a spot in doubt its sun; "" without a doubt.

    world_from_camera: rotation (3, 3).
    """
    disc = find_disc(plate, underwater=underwater)
    if disc is None:
        return "no sun: nothing stands out", ""
    azimuth, elevation = _angles_deg(world_from_camera @ disc.direction)
    share = taken_share(disc.confidence)
    place = f"{_place(azimuth, elevation)}, confidence {disc.confidence:.2f}"
    against = f"; {disc.reason}" if disc.reason else ""
    if share > 0.0:
        words = _shared(place, share) + (against if share < 1.0 else "")
    else:
        where = " inside Snell's window" if underwater else ""
        words = f"no sun{where}; best candidate at {place}{against}"
    if share == 1.0 or elevation < 0.0:
        return words, ""
    rows = ("[light]", 'sun = "given"', f"sun_azimuth_deg = {azimuth:.1f}", f"sun_elevation_deg = {elevation:.1f}")
    return words, "\n".join(["", f"# {words}; to make it the sun, uncomment:", *(f"# {row}" for row in rows), ""])


def tracked_in_words(sun: Sun | None) -> str:
    """Return a line on the sun of a clip's track, in the world's axes; None: of a shot without one."""
    return "no sun in this shot" if sun is None else _shared(_place(*_angles_deg(sun.direction)), sun.share)


def _shared(place: str, share: float) -> str:
    if share > _WHOLE:
        return f"sun at {place}"
    return f"perhaps a sun at {place}: {100.0 * share:.0f} % of its light is used"


def _place(azimuth_deg: float, elevation_deg: float) -> str:
    return f"azimuth {azimuth_deg:z.1f}, elevation {elevation_deg:z.1f} degrees"


def _angles_deg(direction: Floats) -> tuple[float, float]:
    x, y, z = map(float, direction)
    return math.degrees(math.atan2(x, -z)), math.degrees(math.atan2(y, math.hypot(x, z)))
