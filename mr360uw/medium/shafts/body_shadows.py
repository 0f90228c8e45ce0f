# SPDX-License-Identifier: Apache-2.0
"""Maps of bodies from every direction of the sun's disc and of its halo: visible fractions without a ray a point.

A map is a square across the bounding sphere of a body and holds, for parallel light of one direction, how far up along
that direction the body reaches, seen from the sphere's centre. A point is in shadow where it lies below that: exact but
for the width of a pixel, also between the parts of a body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.jit import exact
from mr360uw.medium.shafts.beam_pattern import BeamPattern
from mr360uw.medium.shafts.occluders import GOLDEN, Bodies, Occluder
from mr360uw.sphere import basis, unit

Array = NDArray[np.float64]

DISC_PIXELS, HALO_PIXELS = 256, 64
"""Pixels across a body: of the disc's maps, and of the halo's, whose shadows are blurred by degrees."""
_SMALL_RAD = 0.01
"""Radius of a disc up to which one direction stands for it: 10 m behind a body its shadow's edge is then 20 cm wide at
most, less than half a segment."""
DISC_TAPS, HALO_TAPS = 16, 32
"""Points of a segment at which disc and halo are tested, one direction each, in turn."""


class ShadowMaps:
    """Maps of k bodies with bounding spheres in n directions of a disc about an axis (3,).

    frame: (n, 3, 3) rows (u, v, direction). top: (k, n, size, size) float32 [m]. spread: tangent of the widest angle
    between a direction and the middle of the disc.
    """

    def __init__(self, bodies: Bodies, axis: Array, directions: Array, size: int) -> None:
        self.frame: Array = np.array([basis(d) for d in directions])
        spheres = zip(bodies.occluders, bodies.centre, bodies.radius, strict=True)
        top = [[_top(body, centre, radius, f, size) for f in self.frame] for body, centre, radius in spheres]
        self.top = np.array(top, np.float32)
        cosine = min(float(np.min(directions @ axis)), 1.0)
        self.spread = math.sqrt(1.0 - cosine * cosine) / cosine


@dataclass(frozen=True, slots=True, eq=False)
class Shadows:
    """Maps of k bodies for the sun's disc and for its halo, and their outlines as the sun sees them.

    frame: (3, 3) rows (u, v, towards the sun). apart: (k, size, size) distance [m] of a place across the sun's
    direction from the nearest that a body covers.
    """

    disc: ShadowMaps
    halo: ShadowMaps
    frame: Array
    apart: NDArray[np.float32]


def shadows_of(pattern: BeamPattern, cache: Cache) -> Shadows | None:
    """Return the shadows of a beam's bodies, None without bodies or where one has no bounds. cache: holds them."""
    bodies, towards = pattern.bodies, unit(pattern.sun.direction)
    if not bodies.occluders or not np.all(np.isfinite(bodies.radius)):
        return None
    wide = pattern.sun.half_angle_rad > _SMALL_RAD
    return cache.of(_shadows, bodies, towards, pattern.disc if wide else None, pattern.halo)


def _shadows(bodies: Bodies, towards: Array, disc: Array | None, halo: Array) -> Shadows:
    """Return the shadows of bodies. disc, halo: directions (n, 3) over those; without disc its middle (3,) alone."""
    middle = ShadowMaps(bodies, towards, towards[None], DISC_PIXELS)
    wide = middle if disc is None else ShadowMaps(bodies, towards, disc, DISC_PIXELS)
    covered = np.isfinite(middle.top[:, 0])
    pixel = 2.0 * bodies.radius / covered.shape[1]
    apart = [cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) for mask in covered]
    metres = (np.array(apart) * pixel[:, None, None]).astype(np.float32)
    return Shadows(wide, ShadowMaps(bodies, towards, halo, HALO_PIXELS), middle.frame[0], metres)


def _top(body: Occluder, centre: Array, radius: float, frame: Array, size: int) -> Array:
    at = radius * (2.0 * (np.arange(size) + 0.5) / size - 1.0)
    u, v = np.meshgrid(at, at)
    inside = u * u + v * v <= radius * radius
    start = centre + u[inside, None] * frame[0] + v[inside, None] * frame[1] + radius * frame[2]
    top = np.full((size, size), -np.inf)
    top[inside] = radius - body.distance(start, np.broadcast_to(-frame[2], start.shape))
    return top


@exact
def visible_parts(
    origin: Any, directions: Any, start: Any, end: Any, centre: Any, radius: Any, axes: Any, apart: Any, frame: Any,
    top: Any, spread: Any, taps: Any, seen: Any,
) -> None:  # fmt: skip
    """Write the visible fraction of a disc of light, a mean over each segment of rays, to `seen` (n, count).

    directions: (n, 3). start, end: (n, count) [m] of their segments. centre, radius: (k, 3), (k,) bounding spheres of
    bodies. axes, apart: `frame` and `apart` of `Shadows`. frame to spread: of `ShadowMaps`. taps: points of a segment
    that are tested, with the directions in turn.
    """
    size, last = top.shape[2], apart.shape[1] - 1
    for n in range(len(directions)):
        d0, d1, d2 = directions[n, 0], directions[n, 1], directions[n, 2]
        for k in range(seen.shape[1]):
            length = end[n, k] - start[n, k]
            middle = start[n, k] + 0.5 * length
            blocked = 0
            near = False
            for body in range(len(radius)):
                x = origin[0] + middle * d0 - centre[body, 0]
                y = origin[1] + middle * d1 - centre[body, 1]
                z = origin[2] + middle * d2 - centre[body, 2]
                below = radius[body] - x * axes[2, 0] - y * axes[2, 1] - z * axes[2, 2] + 0.5 * length
                if below <= 0.0:
                    continue
                u = x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]
                v = x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]
                scale, pixel = 0.5 * (last + 1) / radius[body], 2.0 * radius[body] / (last + 1)
                i = min(max(int(u * scale + 0.5 * (last + 1)), 0), last)
                j = min(max(int(v * scale + 0.5 * (last + 1)), 0), last)
                beside = max(apart[body, j, i], math.sqrt(u * u + v * v) - radius[body])
                near |= beside <= below * spread + 0.5 * length + 2.0 * pixel
            if not near:
                seen[n, k] = 1.0
                continue
            for tap in range(taps):
                m = tap % len(frame)
                s = start[n, k] + (tap * GOLDEN + 0.5) % 1.0 * length
                for body in range(len(radius)):
                    x = origin[0] + s * d0 - centre[body, 0]
                    y = origin[1] + s * d1 - centre[body, 1]
                    z = origin[2] + s * d2 - centre[body, 2]
                    f = frame[m]
                    scale = 0.5 * size / radius[body]
                    i = math.floor((x * f[0, 0] + y * f[0, 1] + z * f[0, 2]) * scale + 0.5 * size)
                    j = math.floor((x * f[1, 0] + y * f[1, 1] + z * f[1, 2]) * scale + 0.5 * size)
                    below = x * f[2, 0] + y * f[2, 1] + z * f[2, 2]
                    if 0 <= i < size and 0 <= j < size and below < top[body, m, j, i]:
                        blocked += 1
                        break
            seen[n, k] = 1.0 - blocked / taps
