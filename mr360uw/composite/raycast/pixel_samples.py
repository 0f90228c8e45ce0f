# SPDX-License-Identifier: Apache-2.0
"""Ray casting of the samples of pixels, and grouping of samples that share one shading evaluation.

A group holds the samples of one pixel that hit the same smooth piece of surface near the plane of the first of them. It
is shaded once, at the sample nearest to its mean; `shading = "sample"` makes every sample a group of its own.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.raycast.geometry import Geometry, Hits, base_color, surface, uv_change
from mr360uw.composite.sampling import (
    BLEND_LAYERS,
    GROUPS,
    PIXEL_FILTER,
    PLANE_TOLERANCE,
    Pattern,
    filter_width,
    frame_areas,
    nearest_to_mean,
)
from mr360uw.composite.shot import Shot
from mr360uw.rays import RayScene, barycentric
from mr360uw.types import Floats

MAXIMUM_HITS = 64
"""Surfaces that one ray passes through at most; what lies behind that many is not drawn."""


def trace_samples(
    shot: Shot, geometry: Geometry, scene: RayScene, samples: Pattern, x: NDArray[np.int64], y: NDArray[np.int64]
) -> list[tuple[NDArray[np.int64], Floats]]:
    """Return layers (triangle (n, s), distance (n, s) [m]) hit by the samples of pixels; triangle -1 for no hit.

    x, y: (n,) columns and rows of the pixels. Layers of blended surfaces come first, the nearest first; the last layer
    holds the opaque surfaces, even if there are none. Rays pass through masked-out texels and back faces of one-sided
    materials.
    """
    count, n = len(x), samples.count
    fx = (x[:, None] + samples.positions[None, :, 0]).ravel()
    fy = (y[:, None] + samples.positions[None, :, 1]).ravel()
    direction = shot.view.directions(fx, fy)
    from_middle = shot.view.starts(direction)
    layers = [np.full(count * n, -1, np.int64) for _ in range(BLEND_LAYERS + 1)]
    distances = [np.full(count * n, np.inf) for _ in range(BLEND_LAYERS + 1)]
    filled = np.zeros(count * n, np.int64)
    mode = np.array([m.alpha_mode for m in geometry.materials] or ["OPAQUE"])
    two_sided = np.array([m.double_sided for m in geometry.materials] or [True])
    cutoff = np.array([m.alpha_cutoff for m in geometry.materials] or [0.5])
    active, start = np.arange(count * n), np.zeros(count * n)
    pixel = n**-0.5
    for _ in range(MAXIMUM_HITS):
        if len(active) == 0:
            break
        rays, origin = direction[active], from_middle[active]
        triangle = scene.first_hit(origin + start[active, None] * rays, rays)
        hit = triangle >= 0
        active, triangle, rays, origin = active[hit], triangle[hit], rays[hit], origin[hit]
        if len(active) == 0:
            break
        corners = geometry.positions[triangle] - origin[:, None]
        weights, distance = barycentric(corners, rays)
        start[active] = np.maximum(distance, start[active]) * (1.0 + 4e-6) + 1e-7
        material = geometry.material[triangle]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        solid = two_sided[material] | (np.sum(flat * rays, -1) < 0.0)
        masked = np.flatnonzero(solid & (mode[material] == "MASK"))
        if len(masked):
            at = active[masked]
            around = np.stack(
                [shot.view.directions(fx[at] + pixel, fy[at]), shot.view.directions(fx[at], fy[at] + pixel)], axis=1
            )
            change = uv_change(corners[masked], geometry.uv[triangle[masked]], weights[masked], around)
            alpha = base_color(geometry, triangle[masked], weights[masked], change)[:, 3]
            solid[masked] = alpha >= cutoff[material[masked]]
        blended = solid & (mode[material] == "BLEND")
        for k in range(BLEND_LAYERS):
            to = blended & (filled[active] == k)
            layers[k][active[to]], distances[k][active[to]] = triangle[to], distance[to]
        filled[active[blended]] += 1
        opaque = solid & ~blended
        layers[-1][active[opaque]], distances[-1][active[opaque]] = triangle[opaque], distance[opaque]
        active = active[~opaque]
    found = [(t.reshape(count, n), d.reshape(count, n)) for t, d in zip(layers, distances, strict=True)]
    return [layer for layer in found[:-1] if np.any(layer[0] >= 0)] + found[-1:]


def group_samples(
    shot: Shot,
    geometry: Geometry,
    samples: Pattern,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    triangle: NDArray[np.int64],
    distance: Floats,
) -> Iterator[tuple[NDArray[np.int64], Floats, Hits]]:
    """Yield (pixels (n,), fraction of their samples (n,), surface at the representative sample) until none is left.

    A group starts at the ungrouped sample nearest to the pixel's centre. The last of `GROUPS` takes all that are left.
    The representative is the sample nearest to the mean position of its group.
    """
    left = triangle >= 0
    width = filter_width(samples.count, shot.draw.shading)
    rounds = samples.count if shot.draw.shading == "sample" else GROUPS
    for number in range(rounds):
        pixel = np.flatnonzero(left.any(axis=1))
        if len(pixel) == 0:
            return
        chosen = np.argmax(left[pixel], axis=1)
        member = np.zeros((len(pixel), samples.count), bool)
        if shot.draw.shading == "pixel":
            member = left[pixel] & (
                _near_plane(shot, geometry, samples, x[pixel], y[pixel], triangle[pixel], distance[pixel], chosen)
                if number < rounds - 1
                else True
            )
        member[np.arange(len(pixel)), chosen] = True
        left[pixel] &= ~member
        middle = nearest_to_mean(samples, member)
        at = samples.positions[middle]
        yield (
            pixel,
            member.mean(axis=1),
            surface(
                shot,
                geometry,
                triangle[pixel, middle],
                x[pixel] + at[:, 0],
                y[pixel] + at[:, 1],
                frame_areas(samples, member, middle),
                width,
            ),
        )


def _near_plane(
    shot: Shot,
    geometry: Geometry,
    samples: Pattern,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    triangle: NDArray[np.int64],
    distance: Floats,
    chosen: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Return the mask (n, s) of samples that hit the chosen sample's smooth piece, near its triangle's plane."""
    rows = np.arange(len(chosen))
    first = triangle[rows, chosen]
    corners = geometry.positions[first]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    seen = np.where(triangle >= 0, distance, 0.0)
    fx, fy = x[:, None] + samples.positions[:, 0], y[:, None] + samples.positions[:, 1]
    off = np.einsum("nsk,nk->ns", shot.view.points(shot.view.directions(fx, fy), seen) - corners[:, :1], normal)
    tolerance = PLANE_TOLERANCE * PIXEL_FILTER * np.pi / shot.view.height * distance[rows, chosen]
    same = geometry.patch[triangle] == geometry.patch[first][:, None]
    return same & (np.abs(off) <= tolerance[:, None])
