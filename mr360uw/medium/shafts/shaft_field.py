# SPDX-License-Identifier: Apache-2.0
"""Deviation of the light in the water from the smooth veil: shafts under waves and behind bodies, light of lamps.

The veil holds the light that an open, flat sea would scatter towards the camera, the first scattering of the sun's beam
included. Bodies and waves change that part. Only the change is added, so nothing counts twice:

    D = int_0^Z b p'(v . l) E' exp(-c' s) [u C V + (1 - u) B V_halo - 1] ds

    E'      E_camera exp(c' s v_y/l_y), the beam; light that turns by small angles is a part of it
    u       exp(-(c - c') p), the fraction of the beam that has not turned at all after its path p
    C, B    caustic ratio, and that of the light that has turned; V, V_halo: visible fractions of the sun's disc and
            of the wider disc that turned light comes from (`shaft_scene.BeamPattern`)
    b p'    scattering by wide angles: the phase function with its forward peak cut off level
    c'      a plus the integral of b p' over the sphere; c = a + b

p' and c' are those of the medium's transmittance and veil and of the beam on objects (share g^4, below 22 degrees in
the ocean, `phase.wide_angle_moments`), and they go together. Where V is 0 everywhere D is exactly minus what the beam's
first wide-angle scattering gave to the veil. Light that turns by a small angle first and by a wide one later is part of
the shaft, blurred, as it is part of the beam on objects. Exact single scattering (p and c, `single_scattering`) lacks
that light and has instead the glow within 22 degrees of the sun, which the veil leaves out inside Snell's window.
docs/medium.md has what the choice amounts to. Shafts are not blurred on their way to the camera, as objects are not.

Lamps do not light the plate: all of their scattered light is added, with the same p' and c'. For the modes that are
closed forms the phase function is isotropic and c' = c, as in their veil.

D is held on a spherical grid about the camera whose pole is the sun: angle from it, angle about it, distance.

All structure of shafts runs towards the sun. Rays at one angle about it lie in a plane with it and meet the same beams,
and what bodies shade ends along such planes; with the angle from it light changes slowly. Only nodes that the pixels
asked for read are computed (`sun_beam`), each with its distances divided into slices of equal transmittance of the
clearest wavelength, up to the surface or to where no light is left. The table holds the light from the camera to every
slice. The light of lamps is added on the same nodes; without sun the pole is up.

A pixel reads the sixteen nodes around it (cubic convolution, Keys 1981), periodic about the pole and continued over it,
up to its own end: an object, the ground or the surface. Nodes do not stop at bodies. Their light up to a pixel's
distance is what the pixel's ray sees, so the edges of bodies do not leak and need no search for nodes of like depth.
Rays of different height reach the surface at different distances: a pixel reads its nodes at that fraction of their
light at which its own ray ends (`single_scattering.fraction_at`), so that all end at the surface together.


The light of a lamp, what `ShaftScene.lamp_light` returns, is summed by tables and one map of shadows. The map holds,
for directions from the lamp, the distance of the nearest body. Its plane has the angle from the lamp's axis as radius
(azimuthal equidistant) and reaches to the edge of the cone, so that a narrow cone has fine shadows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.parameters import checked
from mr360uw.base.sphere import basis, direction_from_frame, frame_from_direction, unit
from mr360uw.errors import ParameterError
from mr360uw.jit import exact, inlined
from mr360uw.medium.medium import Medium
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.medium.shafts.shaft_scene import SPREAD_RAD, SUN_SAMPLES, ShaftScene
from mr360uw.medium.shafts.single_scattering import (
    MOST_POINTS,
    fraction_at,
    nearest_m,
    radius_at,
    ray_ends_m,
    spot_of,
    view_directions,
)
from mr360uw.medium.shafts.sun_beam import SunBeam
from mr360uw.types import Array, CausticStack, Floats, Lamp, Sun, View

_TOGETHER = 1 << 13
"""Nodes computed together, which bounds memory."""


@checked
@dataclass(frozen=True, slots=True)
class FroxelGrid:
    """Size of a grid: rows of the angle from the sun, columns about it, slices of distance."""

    rows: int
    columns: int
    slices: int

    def __post_init__(self) -> None:
        if min(self.rows, self.columns, self.slices) < 2 or self.columns % 2:
            raise ParameterError(
                f"grid - needs two rows, columns and slices or more, even columns (got {self}) - enlarge it"
            )


DEFAULT_GRID = FroxelGrid(384, 1024, 32)
"""Error over the rms of the deviation: see docs/medium.md."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftField:
    """Deviation of the light in the water about a camera.

    table: (n, slices + 1, 3) of n nodes, from the camera up to a slice. node: (rows, columns) index of a node in it, -1
    for those left out. pole: (3, 3) rows right, pole, back of the grid's own axes. scene: its camera and water.
    """

    scene: ShaftScene
    table: NDArray[np.float32]
    node: NDArray[np.int32]
    pole: Array

    def radiance(self, directions: Array, distance_m: Array) -> Array:
        """Return the deviation (m, 3) of rays (m, 3) from the camera up to distances (m,) [m].

        Raises `ParameterError` for rays that the field was not made for.
        """
        rows, columns = self.node.shape
        x, y = frame_from_direction(directions @ self.pole.T, columns, rows)
        rate, reach = self.scene.layout(directions[:, 1])
        t = fraction_at(np.minimum(distance_m, reach), rate, reach) * (reach > 0.0)
        result = np.zeros((len(directions), 3))
        if not read_field(self.table, self.node, x, y, t, result):
            raise ParameterError("directions - the field was made for other rays - give all of them to shaft_field")
        return result


@checked
def shaft_field(
    scene: ShaftScene,
    grid: FroxelGrid = DEFAULT_GRID,
    directions: Array | None = None,
    cache: Cache | None = None,
) -> ShaftField:
    """Return the shafts about a scene's camera on a grid, for rays (m, 3); None: for all.

    cache: holds what does not change from frame to frame.
    """
    # Mark the nodes that the rays read, and number them
    pole = _pole(scene)
    node = np.full((grid.rows, grid.columns), -1, np.int32)
    if directions is None:
        node[:] = 0
    else:
        mark_nodes(*frame_from_direction(directions @ pole.T, grid.columns, grid.rows), node)
    column, row = np.nonzero(node.T >= 0)
    node[row, column] = np.arange(len(row), dtype=np.int32)
    # Cut the ray of each node into slices, the longer the farther
    rays = direction_from_frame(column + 0.5, row + 0.5, grid.columns, grid.rows) @ pole
    rate, reach = scene.layout(rays[:, 1])
    table = np.zeros((len(rays), grid.slices + 1, 3), np.float32)
    beam = (
        None
        if scene.pattern is None
        else SunBeam(scene, scene.pattern, grid.slices, Cache() if cache is None else cache)
    )
    lamps = [(lamp_field(scene, lamp), lamp.intensity) for lamp in scene.lamps]
    # Add sun and lamps slice by slice, and sum from the camera on
    for start in range(0, len(rays), _TOGETHER):
        part = slice(start, start + _TOGETHER)
        light = np.zeros((len(rays[part]), grid.slices, 3))
        if beam is not None:
            beam.add(rays[part], rate[part], reach[part], column[part], 2.0 * np.pi / grid.columns, light)
        if lamps:
            edge = radius_at(np.arange(grid.slices + 1) / grid.slices, rate[part, None], reach[part, None])
            for field, intensity in lamps:
                light += lamp_light(scene, field, rays[part], edge) * intensity
        table[part, 1:] = np.cumsum(light, axis=1)
    return ShaftField(scene, table, node, pole)


def _pole(scene: ShaftScene) -> Array:
    """Return the grid's axes; the pole is the sun, or up without one."""
    towards = np.array([0.0, 1.0, 0.0]) if scene.pattern is None else unit(scene.pattern.sun.direction)
    right, back, up = basis(towards)
    return np.stack([right, up, back])


@inlined
def _wrapped(row: Any, column: Any, rows: Any, columns: Any) -> Any:
    """Return a node's row and column, continued over the poles and about them."""
    if row < 0 or row >= rows:
        row = -1 - row if row < 0 else 2 * rows - 1 - row
        column += columns // 2
    return min(max(row, 0), rows - 1), column % columns


@inlined
def _cubic(f: Any, k: Any) -> Any:
    """Return the weight of neighbour k = 0 to 3 at a fraction f between the inner two (Keys 1981)."""
    if k == 0:
        return 0.5 * f * (f * (2.0 - f) - 1.0)
    if k == 1:
        return 0.5 * (f * f * (3.0 * f - 5.0) + 2.0)
    if k == 2:
        return 0.5 * f * (f * (4.0 - 3.0 * f) + 1.0)
    return 0.5 * f * f * (f - 1.0)


@exact
def mark_nodes(x: Any, y: Any, node: Any) -> None:
    """Set `node` (rows, columns) to 0 where frame coordinates (n,) of the grid read it."""
    rows, columns = node.shape
    for n in range(len(x)):
        i, j = math.floor(x[n] - 0.5), math.floor(y[n] - 0.5)
        for b in range(4):
            for a in range(4):
                row, column = _wrapped(j + b - 1, i + a - 1, rows, columns)
                node[row, column] = 0


@exact
def read_field(table: Any, node: Any, x: Any, y: Any, t: Any, result: Any) -> bool:
    """Write the light of rays at frame coordinates (n,) of the grid to `result` (n, 3).

    t: (n,) fractions of the rays' light, in [0, 1], up to which it is summed. Return whether every node that is read is
    there.
    """
    rows, columns = node.shape
    slices = table.shape[1] - 1
    for n in range(len(x)):
        if not t[n] > 0.0:
            continue
        k = min(int(t[n] * slices), slices - 1)
        f = t[n] * slices - k
        i, j = math.floor(x[n] - 0.5), math.floor(y[n] - 0.5)
        fx, fy = x[n] - 0.5 - i, y[n] - 0.5 - j
        for b in range(4):
            for a in range(4):
                row, column = _wrapped(j + b - 1, i + a - 1, rows, columns)
                m = node[row, column]
                if m < 0:
                    return False
                weight = _cubic(fx, a) * _cubic(fy, b)
                for c in range(3):
                    result[n, c] += weight * (table[m, k, c] + (table[m, k + 1, c] - table[m, k, c]) * f)
    return True


STEPS = 512
"""Segments of a ray of the exact march."""


@checked
def shaft_deviation(
    view: View,
    medium: Medium,
    sun: Sun | None,
    bodies: Sequence[Any] = (),
    caustics: CausticStack | None = None,
    lamps: Sequence[Lamp] = (),
    *,
    end_m: ArrayLike | None = None,
    grid: FroxelGrid | None = DEFAULT_GRID,
    steps: int = STEPS,
    spread_rad: float = SPREAD_RAD,
    sun_samples: int = SUN_SAMPLES,
) -> Floats:
    """Return the radiance (H, W, 3) by which light in the water deviates from the smooth veil, of either sign.

    sun: direction in the water, irradiance (3,) at the camera. bodies: as in `single_scattering`. caustics: of the same
    sun; its planes should reach from near the surface to where light fades. lamps: in the world. end_m: (H, W) or
    a number, distance [m] at which rays end besides the surface and the bodies. grid: of froxels; None marches every
    pixel in `steps` segments. spread_rad: standard
    deviation of the directions of light that has turned by small angles. sun_samples: directions over the sun's disc.
    Exactly zero without lamps where neither bodies nor caustics are given. Raises `ParameterError`.
    """
    if steps < 1:
        raise ParameterError(f"steps - must be 1 or more (got {steps}) - take more")
    lights = (*lamps, *(() if sun is None else (sun,)))
    scene = ShaftScene.of(view, medium, lights, bodies, caustics, spread_rad, sun_samples)
    directions = view_directions(view)
    ends = ray_ends_m(view, directions, view.surface_y_m, scene.bodies, end_m)
    if scene.dark:
        radiance = np.zeros((len(directions), 3))
    elif grid is None:
        radiance = march(scene, directions, ends, steps)
    else:
        radiance = shaft_field(scene, grid, directions).radiance(directions, ends)
    return radiance.reshape(view.height, view.width, 3)


def march(scene: ShaftScene, directions: Array, end_m: Array, steps: int) -> Array:
    """Return the deviation (m, 3) along rays (m, 3) of lengths (m,), from segments of equal light."""
    result = np.zeros((len(directions), 3))
    t = np.arange(steps + 1) / steps
    for part in np.array_split(np.arange(len(directions)), -(-len(directions) * steps // MOST_POINTS)):
        rate, reach = (x[:, None] for x in scene.layout(directions[part, 1]))
        reach = np.minimum(reach, end_m[part, None])
        result[part] = scene.segments(directions[part], radius_at(t, rate, reach)).sum(axis=1)
    return result


MAP_PIXELS = 768
"""Pixels across a lamp's map: .05 degrees each in a torch of 20 degrees, .5 degrees in a lamp without a cone."""
STEP_RAD = 0.02
"""Angle seen from a lamp over which its light on a ray is taken from one point; a slice of a ray has one at least."""


class LampField(NamedTuple):
    """What rays need of one lamp.

    position: (3,). frame: (3, 3) rows (u, v, axis). beam: of `types.Lamp`. nearest_m: of `nearest_m`. hit:
    (size, size) distance [m] of the nearest opaque body, (0, 0) without bodies. clear: (size, size, 2) distance [m] of
    the nearest one that lets light through, and the fraction that all of them do; (0, 0, 2) without such bodies.
    over_path: (paths, 2, 3) of `ShaftScene.path_light`. turned: `table` of `ShaftWater`. length_m: of the scene's
    tables.
    """

    position: Array
    frame: Array
    beam: Array
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
    return LampField(
        np.asarray(lamp.position, np.float64), frame, lamp.beam, nearest_m(lamp), hit,
        clear, np.exp(scene.path_light(lamp)), scene.water.table, scene.length_m,
    )  # fmt: skip


def lamp_light(scene: ShaftScene, field: LampField, rays: Array, edge_m: Array) -> Array:
    """Return the light of segments (n, count, 3) of rays (n, 3) with edges (n, count + 1) [m], per unit intensity."""
    within = np.full((2, len(rays)), np.inf)
    if len(field.hit):
        within = np.stack(scene.bodies.inside_m(scene.origin, rays))
    beam = np.zeros((*edge_m[:, 1:].shape, 3))
    _add_lamp(field, scene.origin, rays, edge_m, within, beam)
    return beam


def _hits(lamp: Lamp, frame: Array, bodies: Bodies) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return `hit` and `clear` of `LampField`."""
    widest = math.acos(max(lamp.cos_edge, -1.0))
    at = widest * (2.0 * (np.arange(MAP_PIXELS) + 0.5) / MAP_PIXELS - 1.0)
    u, v = np.meshgrid(at, at)
    angle = np.hypot(u, v)
    inside = angle <= widest
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


_spot = inlined(spot_of)


@exact
def _add_lamp(lamp: LampField, origin: Any, rays: Any, edge: Any, within: Any, light: Any) -> None:
    """See `single_scattering.lamp_segments` for the segments, one point each, and `spot_factor` for the cone."""
    # Take the lamp's parts apart, seen from the camera
    place, frame, beam, least, hit, clear, over_path, turned, length_m = lamp
    x0, y0, z0 = place[0] - origin[0], place[1] - origin[1], place[2] - origin[2]
    distance2 = x0 * x0 + y0 * y0 + z0 * z0
    widest = math.acos(max(beam[0, 1], -1.0))
    paths, angles = len(over_path) - 1, len(turned) - 1
    for n in range(len(rays)):
        dx, dy, dz = rays[n, 0], rays[n, 1], rays[n, 2]
        # Go along each ray by the angle at the lamp, in which its light is even
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
                # Leave out what is outside of the cone, or behind what the lamp meets
                axial = -(x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2]) / r
                spot = _spot(beam, -x / r, -y / r, -z / r)
                if spot <= 0.0:
                    continue
                if len(hit) and r > least:
                    row, column = _pixel(len(hit), frame, widest, axial, x, y, z)
                    if hit[row, column] < r:
                        continue
                    if len(clear) and clear[row, column, 0] < r:
                        spot *= clear[row, column, 1]
                # Scatter it once to the camera, by the tables over path and angle
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
