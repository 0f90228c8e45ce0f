# SPDX-License-Identifier: Apache-2.0
"""Light of a lamp scattered along many rays: what `ShaftScene.lamp_light` returns, by tables and one map of shadows.

The map holds, for directions from the lamp, the distance of the nearest body. Its plane has the angle from the lamp's
axis as radius (azimuthal equidistant) and reaches to the edge of the cone, so that a narrow cone has fine shadows.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact, inlined
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.medium.shafts.ray_segments import nearest_m
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.sphere import basis
from mr360uw.types import Lamp

Array = NDArray[np.float64]

MAP_PIXELS = 768
"""Pixels across a lamp's map: .05 degrees each in a torch of 20 degrees, .5 degrees in a lamp without a cone."""
STEP_RAD = 0.02
"""Angle seen from a lamp over which its light on a ray is taken from one point; a slice of a ray has one at least."""
_COSINES = 2049
"""Angles at which phase functions are tabulated, uniform in the angle."""


class LampField(NamedTuple):
    """What rays need of one lamp.

    position: (3,). frame: (3, 3) rows (u, v, axis). cos_core, cos_edge: of its cone. nearest_m: of `nearest_m`. hit:
    (size, size) distance [m] of the nearest opaque body, (0, 0) without bodies. clear: (size, size, 2) distance [m] of
    the nearest one that lets light through, and the fraction that all of them do; (0, 0, 2) without such bodies.
    over_path: (paths, 2, 3) of `ShaftScene.path_light`. turned: (angles, 2) phase functions. length_m: of the scene's
    tables.
    """

    position: Array
    frame: Array
    cos_core: float
    cos_edge: float
    nearest_m: float
    hit: NDArray[np.float32]
    clear: NDArray[np.float32]
    over_path: Array
    turned: Array
    length_m: float


def lamp_field(scene: ShaftScene, lamp: Lamp) -> LampField:
    """Return the field of a lamp in a scene."""
    frame = basis(lamp.axis)
    shaded = lamp.casts_shadow and bool(scene.bodies.occluders)
    hit, clear = np.zeros((0, 0), np.float32), np.zeros((0, 0, 2), np.float32)
    if shaded:
        hit, clear = _hits(lamp, frame, scene.bodies)
    turned = scene.water.turned(np.cos(np.linspace(0.0, np.pi, _COSINES)))
    return LampField(
        np.asarray(lamp.position, np.float64), frame, float(lamp.cos_core), float(lamp.cos_edge), nearest_m(lamp), hit,
        clear, np.exp(scene.path_light(lamp)), turned, scene.length_m,
    )  # fmt: skip


def lamp_light(scene: ShaftScene, field: LampField, rays: Array, edge_m: Array) -> Array:
    """Return the light of segments (n, count, 3) of rays (n, 3) with edges (n, count + 1) [m], per unit intensity."""
    within = np.full((2, len(rays)), np.inf)
    if len(field.hit):
        within = np.stack(scene.bodies.inside_m(scene.origin, rays))
    beam = np.zeros((*edge_m[:, 1:].shape, 3))
    _add_lamp(field, scene.origin, rays, edge_m, within, beam)
    return beam


def _widest(cos_edge: float) -> float:
    """Return the angle [rad] that a lamp's map reaches to."""
    return math.acos(max(cos_edge, -1.0))


def _hits(lamp: Lamp, frame: Array, bodies: Bodies) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return `hit` and `clear` of `LampField`."""
    at = _widest(lamp.cos_edge) * (2.0 * (np.arange(MAP_PIXELS) + 0.5) / MAP_PIXELS - 1.0)
    u, v = np.meshgrid(at, at)
    angle = np.hypot(u, v)
    inside = angle <= _widest(lamp.cos_edge)
    angle, u, v = angle[inside], u[inside], v[inside]
    towards = (np.sin(angle) / np.maximum(angle, 1e-12))[:, None] * (u[:, None] * frame[0] + v[:, None] * frame[1])
    towards = towards + np.cos(angle)[:, None] * frame[2]
    start = np.asarray(lamp.position, np.float64)
    least = nearest_m(lamp)
    hit = np.full((MAP_PIXELS, MAP_PIXELS), np.inf, np.float32)
    hit[inside] = least + bodies.first_hit_m(start + least * towards, towards)
    clear = np.zeros((0, 0, 2), np.float32)
    if np.any(bodies.passed > 0.0):
        clear = np.full((MAP_PIXELS, MAP_PIXELS, 2), (np.inf, 1.0), np.float32)
        nearest, passed = bodies.first_clear_m(start + least * towards, towards)
        clear[inside] = np.stack([least + nearest, passed], axis=-1)
    return hit, clear


@inlined
def _pixel(size: Any, frame: Any, widest: Any, axial: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the row and column of a map, `size` wide, that show a point which sees the lamp along (x, y, z)."""
    u = -(x * frame[0, 0] + y * frame[0, 1] + z * frame[0, 2])
    v = -(x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2])
    scale = math.acos(min(max(axial, -1.0), 1.0)) / max(math.sqrt(u * u + v * v), 1e-12) / widest
    i = min(max(int((u * scale + 1.0) * 0.5 * size), 0), size - 1)
    j = min(max(int((v * scale + 1.0) * 0.5 * size), 0), size - 1)
    return j, i


@exact
def _add_lamp(lamp: LampField, origin: Any, rays: Any, edge: Any, within: Any, light: Any) -> None:
    """See `ray_segments.lamp_segments` for the segments, one point each, and `spot_factor` for the cone."""
    place, frame, cos_core, cos_edge, least, hit, clear, over_path, turned, length_m = lamp
    x0, y0, z0 = place[0] - origin[0], place[1] - origin[1], place[2] - origin[2]
    distance2 = x0 * x0 + y0 * y0 + z0 * z0
    widest = math.acos(max(cos_edge, -1.0))
    paths, angles = len(over_path) - 1, len(turned) - 1
    for n in range(len(rays)):
        dx, dy, dz = rays[n, 0], rays[n, 1], rays[n, 2]
        foot = dx * x0 + dy * y0 + dz * z0
        width = math.sqrt(max(distance2 - foot * foot, 0.0) + least * least)
        last = math.atan2(edge[n, 0] - foot, width)
        for k in range(edge.shape[1] - 1):
            first, last = last, math.atan2(edge[n, k + 1] - foot, width)
            count = max(math.ceil((last - first) / STEP_RAD), 1)
            for point in range(count):
                tangent = math.tan(first + (last - first) * (point + 0.5) / count)
                s = max(foot + width * tangent, 0.0)
                if within[0, n] < s < within[1, n]:
                    continue
                x, y, z = x0 - s * dx, y0 - s * dy, z0 - s * dz
                r = max(math.sqrt(x * x + y * y + z * z), least)
                axial = -(x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2]) / r
                spot = 1.0
                if cos_edge > -1.0:
                    t = min((axial - cos_edge) / max(cos_core - cos_edge, 1e-6), 1.0)
                    if t <= 0.0:
                        continue
                    spot = t * t * (3.0 - 2.0 * t)
                if len(hit) and r > least:
                    row, column = _pixel(len(hit), frame, widest, axial, x, y, z)
                    if hit[row, column] < r:
                        continue
                    if len(clear) and clear[row, column, 0] < r:
                        spot *= clear[row, column, 1]
                amount = spot / (r * r) * width * (1.0 + tangent * tangent) * (last - first) / count
                p = (1.0 - length_m / (r + s + length_m)) * paths
                i = min(int(p), paths - 1)
                f = p - i
                q = math.acos(min(max((x * dx + y * dy + z * dz) / r, -1.0), 1.0)) / math.pi * angles
                j = min(int(q), angles - 1)
                g = q - j
                for kind in range(2):
                    phase = amount * (turned[j, kind] + (turned[j + 1, kind] - turned[j, kind]) * g)
                    for c in range(3):
                        lower, upper = over_path[i, kind, c], over_path[i + 1, kind, c]
                        light[n, k, c] += phase * (lower + (upper - lower) * f)
