# SPDX-License-Identifier: Apache-2.0
"""Visible fraction of the sun and of lamps behind bodies, traced through columns along their light (shadow_columns.py).

Each ray stands for a part of the light's disc and of a footprint, and is as wide as both: the columns on its way are
taken from the level of its width. A ray that starts within a column that lets light through passes half of it. The
reference casts rays instead (lighting/light_sources.py). The loops are compiled, on the processor: a driver in software
runs every ray as long as the longest beside it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, Scratch, room
from mr360uw.base.constants import LONGEST_FOOTPRINT, MAXIMUM_SUN_SAMPLES
from mr360uw.base.sphere import disc_offsets
from mr360uw.composite.gl.shadow_columns import (
    SMALLEST,
    columns_of,
    lamp_frames,
    sun_frames,
)
from mr360uw.composite.light_sources import lamps_of, sun_of, wide_pixel_offsets, widest_half_angle
from mr360uw.composite.shot import Shot
from mr360uw.jit import exact, fast, inlined, mix_texels
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.types import Floats, View

_MOST_RAYS = 128
"""Most rays towards a light's disc from a footprint."""
_FEWEST_RAYS = 12
"""Rays of which half may speak for all. A third of 24 misses fins in penumbrae: .06 % of a body off by a code."""
_NARROW = 512
"""Width of a frame [pixels] below which a pixel's footprint is so large that more rays are cast from it, in proportion:
with 24, noise at the edges of shadows exceeds two code values in one pixel of five hundred at a width of 128."""
_BIASED_SLOT = 256
"""Columns across a slot in which `PlacedObject.bias_m` is 1.5 columns."""
_RAMP = 1.33
"""Columns over which a filtered one rises from empty to filled at a straight edge."""
_RAY_WIDTH = 1.2
"""Width of a ray over that of the part of footprint and disc that it represents."""
_SHARPEST = 0.2
"""Least width of a sharpened edge, as a fraction of `_RAMP`."""
_MOST_STEPS = 16
"""Most columns along a ray; the last step is as long as it takes."""
_STRIDE = np.float32(2.0)
"""Step of light that waves have bent, in widths of a ray: half as long takes a fifth longer, and changes .05 % of
touched values by more than a code. Of straight light, 1: edges of thin bodies are off by .07 else."""
DISC, HALO = 0, 1
"""Numbers of the sun's disc and halo among the lights of `Visibility`; lamps follow."""
_TOGETHER = 16
"""Footprints whose rays are traced side by side, because compilers make vectors of long loops. Half as many: 4 %
slower; twice as many: as fast."""
_STRAIGHT = np.zeros((0, 3))
"""Slopes of light that waves do not turn."""
ALL_RAYS, HALF_OF_RAYS, ONE_RAY = 0, 1, 2
"""Numbers of the fans of rays: all, each second one of them, and one, for lights that are points."""


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What hides the lights of a shot. Points are from the camera, in the world's axes [m].

    values, clear: of `columns_of`, size: columns across a slot. slots: (m, 19) of each its extents (6), middle
    distance, axes (3, 3) and the camera in them (3); the middle distance is 0 for the sun. lights: (L, 14) the
    sun's disc and halo, then lamps; of each the numbers of its first slot and of the one after its last, for the
    sun the tangent of its radius and its direction across over along (2), and for lamps place (3), radius, axis
    (3), cosine at the edge of the cone, and least distance. rays: (3, 4, n) of fans, slope over a unit disc and
    place in [-0.5, 0.5]^2 of a footprint; fans: (3, 4) how many there are, how many speak for all where they agree,
    and by how much a ray widens, over the footprint and over the radius of the disc a metre away. bias: factor on
    the offset of rays from a body's surface.
    """

    values: NDArray[np.float32]
    size: int
    clear: bool
    slots: Floats
    lights: Floats
    rays: NDArray[np.float32]
    fans: Floats
    bias: float

    @property
    def of_sun(self) -> tuple[object, ...]:
        """All that decides what is seen of the sun from a place in the world."""
        lights, bias = self.lights[: HALO + 1], self.bias
        return self.values, self.slots[: int(lights[DISC, 1]), :16], lights, self.fans, bias

    @property
    def of_lamps(self) -> tuple[object, ...]:
        """All that decides what is seen of lamps from a place."""
        return self.values, self.slots, self.lights[HALO + 1 :], self.fans, self.bias

    @property
    def lamps(self) -> range:
        """Numbers of the lamps among the lights."""
        return range(HALO + 1, len(self.lights))

    def hidden(self, places: Floats, steepest: float = 0.0) -> Floats:
        """Return for balls (n, 4), middle and radius, which of the sun's lights bodies may hide (n, 2): 0 neither, 1
        the halo, 2 part of the disc, 3 all of both; and the distance [m] to the nearest such body.

        steepest: how far waves turn the beam, of `light_sources.steepest_slope`.
        """
        found, lights = np.empty((len(places), 2)), self.lights[: HALO + 1].copy()
        lights[DISC, 2] += steepest
        lights[HALO, 2] = max(lights[DISC, 2], lights[HALO, 2])
        _find_hidden(places, lights, (self.slots, self.values, self.size, self.clear), found)
        return found

    def seen(
        self, footprints: Floats, lights: Sequence[int], fan: int = ALL_RAYS, known: Floats | None = None,
        slopes: Floats = _STRAIGHT,
    ) -> Floats:  # fmt: skip
        """Return the visible fractions (n, k) of lights of these numbers, means over footprints.

        footprints: (n, 12) of each its middle, two sides and, for lamps, the normal of its surface. fan: of the halo.
        known: (n, k) fractions that are known already; negative where they are not. slopes: (n, 3) of `ground_slopes`,
        by which waves turn the sun's disc, which is then the first of the lights; (0, 3) where they do not.
        """
        of_lights = self.lights[list(lights)]
        fans = [fan if k == HALO else ALL_RAYS if k == DISC or self.lights[k, 8] > 0.0 else ONE_RAY for k in lights]
        found = np.full((len(footprints), len(of_lights)), -1.0) if known is None else known.copy()
        turned = _STRAIGHT
        if len(slopes):
            # From metres across for each of depth to those of the slots, along the sun's direction
            axes = self.slots[0, 7:16].reshape(3, 3)
            sun = np.append(self.lights[DISC, 3:5], 1.0) @ axes
            sun /= sun[1]
            across = (sun - np.insert(slopes[:, :2], 1, 0.0, axis=1)) @ axes.T
            turned = np.column_stack([across[:, :2] / across[:, 2:], slopes[:, 2] / np.linalg.norm(sun)])
        columns = self.slots, self.values, self.size, self.clear
        of_fans, work = (of_lights, np.array(fans, np.int64), turned), _see_room(len(self.slots))
        _see(footprints, of_fans, columns, (self.rays, self.fans), work, found)
        return found


def visibility_of(shot: Shot, cache: Cache, scratch: Scratch) -> Visibility:
    """Return what hides the lights of a shot. cache: keeps columns of bodies; scratch: for drawing them."""
    sun, lamps, view = sun_of(shot), lamps_of(shot), shot.view
    of_sun, of_lamps = sun_frames(shot), [lamp_frames(lamp, shot.casters) for lamp in lamps]
    frames = [*of_sun, *(frame for group in of_lamps for frame in group)]
    # Draw the columns, as fine as the narrowest light and the body that is largest in the frame ask for
    radii = [lamp.radius_m / frame.middle_m for lamp, g in zip(lamps, of_lamps, strict=True) for frame in g]
    narrowest = min([*radii, *([] if sun is None else [sun.half_angle_rad])], default=0.0)
    widest_rad = 0.0
    for placed in shot.casters:
        radius = placed.mesh.radius_m * placed.scale
        distance = float(np.linalg.norm(placed.to_world(placed.mesh.center_m) - view.position))
        widest_rad = max(widest_rad, 2.0 * radius / max(distance - radius, 1e-3))
    across = widest_rad * view.height / np.pi
    values, extents, size, clear = columns_of(frames, across, narrowest, cache, scratch)
    # Describe their slots and the lights
    slots, lights = np.zeros((len(frames), 19)), np.zeros((HALO + 1 + len(lamps), 14))
    slots[:, :6] = extents
    for row, frame in zip(slots, frames, strict=True):
        row[6], row[7:16] = frame.middle_m, frame.axes.ravel()
        row[16:] = frame.axes @ (view.position - (0.0 if frame.origin is None else frame.origin))
    if sun is not None and of_sun:
        radius, widest = sun.half_angle_rad, widest_half_angle(shot)
        of_slots = of_sun[0].axes @ sun.direction
        slope = of_slots[:2] / of_slots[2]
        lights[DISC, 1:5] = len(of_sun), np.tan(radius), *slope
        lights[HALO, 1:5] = len(of_sun) if widest > radius else 0, np.tan(widest), *slope
    first = len(of_sun)
    for row, lamp, group in zip(lights[HALO + 1 :], lamps, of_lamps, strict=True):
        row[:2], row[5:8], row[8] = (first, first + len(group)), lamp.position - view.position, lamp.radius_m
        row[9:12], row[12], row[13] = lamp.axis, lamp.cos_edge, nearest_m(lamp)
        first += len(group)
    # Spread rays over their discs, and over footprints
    finer = int(np.clip(round(_NARROW / view.width), 1, _MOST_RAYS // MAXIMUM_SUN_SAMPLES))
    rays, fans = _fans(finer * min(shot.draw.sun_samples, MAXIMUM_SUN_SAMPLES))
    return Visibility(values, size, clear, slots, lights, rays, fans, max(_BIASED_SLOT / size, 1.0))


@functools.cache
def _fans(count: int) -> tuple[NDArray[np.float32], Floats]:
    """Return `Visibility.rays` and `Visibility.fans` of a number of directions, shared by all callers.

    Rays of that width have, with factors on their places and directions, the second moments of footprint and disc
    together: a square's is 1/12 of its squared side, a disc's 1/4 of its squared radius. Of a fan that is asked by
    halves, the first half is one of every two, the first and the second in turn: rays that follow each other lie in
    other columns of the footprint.
    """
    rays, fans = np.zeros((3, 4, _MOST_RAYS), np.float32), np.zeros((3, 4))
    every = np.concatenate([disc_offsets(count), wide_pixel_offsets(count)], axis=1)
    for fan, of_fan, some in zip(rays, fans, (every, every[::2], every[:1]), strict=True):
        number = len(some)
        grain, widening = min(_RAY_WIDTH * number**-0.5, 1.0), _RAY_WIDTH * (np.pi / number) ** 0.5
        factors = np.sqrt(np.maximum(1.0 - np.array([widening * widening / 3.0, grain * grain]), 0.0))
        few, order = number, np.arange(number)
        if number >= _FEWEST_RAYS:
            few = number // 2
            pair = np.arange(few)
            order[: 2 * few] = np.concatenate([2 * pair + (pair + half) % 2 for half in (0, 1)])
        fan[:, :number] = (some[order] * np.repeat(factors, 2)).T
        of_fan[:] = number, few, grain, widening
    return rays, fans


# --- footprints of areas of the frame --------------------------------------------------------------------------------


def footprints_of(
    view: View, corner: Floats, area: Floats, grid: tuple[int, float], surface: Floats | float,
    bias: Floats | float = 0.0, step: float = 1.0,
) -> Floats:  # fmt: skip
    """Return the footprints (n, 12) of `Visibility.seen` of areas of a frame, side x side in each of m blocks, in
    order.

    corner: (m, 2) of the blocks in the frame. area: (m, 5) as of `sampling.frame_areas`. grid: side, and pixels from
    one to the next in a block. surface: (n, 4) unit normal in the world and distance along the ray, or the height [m]
    of a level plane above the camera. bias: (m,) [m] by which footprints are off the surface. step: pixels over which
    they are measured.
    """
    side, spacing = grid
    found, blocks = np.empty((len(corner) * side * side, 12)), np.zeros((len(corner), 8))
    blocks[:, :2], blocks[:, 2:7], blocks[:, 7] = corner, area, bias
    plane_m = surface if isinstance(surface, float) else 0.0
    along = np.zeros((0, 4)) if isinstance(surface, float) else np.asarray(surface, np.float64).reshape(-1, 4)
    frame = np.array([view.width, view.height, view.eye_m, step, spacing], np.float64)
    axes = np.ascontiguousarray(view.world_from_camera, np.float64)
    _make_footprints(blocks, along, plane_m, frame, axes, np.empty((4, side)), found)
    return found


@inlined
def _step(point: Any, normal: Any, direction: Any, pixels: Any) -> Any:
    """Return the derivative (3) of a point on a plane by a frame coordinate, as `pixel_steps` of composite/raycast.py.

    direction: of the ray that lies `pixels` pixels farther.
    """
    (px, py, pz), (nx, ny, nz), (dx, dy, dz) = point, normal, direction
    cosine = nx * dx + ny * dy + nz * dz
    along = (nx * px + ny * py + nz * pz) / cosine if abs(cosine) > 1e-6 else 0.0
    far = math.sqrt(px * px + py * py + pz * pz)
    ux, uy, uz = dx * far - px, dy * far - py, dz * far - pz
    if along > 0.0:
        longest = LONGEST_FOOTPRINT * math.sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = dx * along - px, dy * along - py, dz * along - pz
        pixels /= min(longest / max(math.sqrt(ux * ux + uy * uy + uz * uz), 1e-18), 1.0)
    return ux / pixels, uy / pixels, uz / pixels


@inlined
def _turned(axes: Any, x: Any, y: Any, z: Any) -> Any:
    """Return a vector of the camera's axes in the world's."""
    return (
        axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z,
        axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z,
        axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z,
    )


@fast
def _make_footprints(
    blocks: Any, surface: Any, plane_m: Any, frame: Any, axes: Any, work: Any, footprints: Any
) -> None:
    """Set footprints (n, 12). blocks: (m, 8) of each its corner, area and bias, as of `footprints_of`. frame: its width
    and height, the eye's distance from the middle, step and spacing. work: (4, side).
    """
    width, height, eye, step, spacing = frame[0], frame[1], frame[2], frame[3], frame[4]
    turn, tip = 2.0 * math.pi / width, math.pi / height
    turn_c, turn_s = math.cos(turn * step), math.sin(turn * step)
    tip_c, tip_s = math.cos(tip * step), math.sin(tip * step)
    lon_c, lon_s, lat_c, lat_s, side = work[0], work[1], work[2], work[3], work.shape[1]
    for m in range(len(blocks)):
        block = blocks[m]
        for i in range(side):
            lon = turn * (block[0] + (i + 0.5) * spacing) - math.pi
            lat = 0.5 * math.pi - tip * (block[1] + (i + 0.5) * spacing)
            lon_c[i], lon_s[i], lat_c[i], lat_s[i] = math.cos(lon), math.sin(lon), math.cos(lat), math.sin(lat)
        for within in range(side * side):
            n, r, c = m * side * side + within, within // side, within % side
            # The ray, and those a step to the right and below
            ls, lc, s, o = lon_s[c], lon_c[c], lat_s[r], lat_c[r]
            dx, dy, dz = _turned(axes, o * ls, s, -o * lc)
            right_s, right_c = ls * turn_c + lc * turn_s, lc * turn_c - ls * turn_s
            below_s, below_c = s * tip_c - o * tip_s, o * tip_c + s * tip_s
            right = _turned(axes, o * right_s, s, -o * right_c)
            below = _turned(axes, below_c * ls, below_s, -below_c * lc)
            start_x, start_y, start_z = _turned(axes, eye * o * lc, 0.0, eye * o * ls)
            # The surface that it meets
            nx, ny, nz, far = 0.0, 1.0, 0.0, (plane_m - start_y) / dy
            if len(surface):
                nx, ny, nz, far = surface[n, 0], surface[n, 1], surface[n, 2], surface[n, 3]
            if nx * dx + ny * dy + nz * dz > 0.0:
                nx, ny, nz = -nx, -ny, -nz
            px, py, pz = far * dx, far * dy, far * dz
            # The footprint of the area there
            rx, ry, rz = _step((px, py, pz), (nx, ny, nz), right, step)
            qx, qy, qz = _step((px, py, pz), (nx, ny, nz), below, step)
            off_x, off_y, xx, xy, yy, bias = block[2], block[3], block[4], block[5], block[6], block[7]
            found = footprints[n]
            found[0] = px + start_x + off_x * rx + off_y * qx + bias * nx
            found[1] = py + start_y + off_x * ry + off_y * qy + bias * ny
            found[2] = pz + start_z + off_x * rz + off_y * qz + bias * nz
            found[3], found[4], found[5] = xx * rx + xy * qx, xx * ry + xy * qy, xx * rz + xy * qz
            found[6], found[7], found[8] = xy * rx + yy * qx, xy * ry + yy * qy, xy * rz + yy * qz
            found[9], found[10], found[11] = nx, ny, nz


# --- which bodies may hide a light -----------------------------------------------------------------------------------


@inlined
def _in_slot(slot: Any, x: Any, y: Any, z: Any) -> Any:
    """Return a point in the axes of a slot: across (2) and along the light, which for lamps is negative behind them."""
    m = slot[6]
    p = slot[7] * x + slot[8] * y + slot[9] * z + slot[16]
    q = slot[10] * x + slot[11] * y + slot[12] * z + slot[17]
    along = slot[13] * x + slot[14] * y + slot[15] * z + slot[18]
    if m > 0.0:
        return (p * m / along, q * m / along, m * m / along) if along > 0.0 else (0.0, 0.0, -1.0)
    return p, q, along


@fast
def _across(slot: Any, middle: Any, radius: Any, deep: Any, slope: Any, tilt: Any, spread: Any) -> Any:
    """Return the disc of which a ball sees all parts of a body: its middle (2) from that of the slot, and its radius,
    which is negative where it misses the slot.

    middle: of the ball in the slot's axes; radius, deep: its radius across and along the light. slope: (2) of the
    middle of a disc of light, tilt: half its length, spread: tangent of its radius.
    """
    (x, y, z), (slope_x, slope_y) = middle, slope
    high, low = slot[5] - z + deep, max(slot[4] - z - deep, 0.0)
    wide, along = radius + spread * high + tilt * (high - low), 0.5 * (low + high)
    at_x, at_y = x + along * slope_x - slot[0], y + along * slope_y - slot[1]
    missed = high <= 0.0 or max(abs(at_x) - slot[2], abs(at_y) - slot[3]) > wide
    return at_x, at_y, -1.0 if missed else wide


@exact
def _between(of_body: Any, disc: Any, below: Any) -> Any:
    """Return whether a body may hide part of a disc of light from part of a ball, and whether all of it from all of
    that.

    of_body: its columns (4 n,), slot, size and clear, as `Visibility` has them. disc: of `_across`. below: whether all
    of the ball is below the body.
    """
    (columns, slot, size, clear), (at_x, at_y, wide) = of_body, disc
    # A filtered column is empty, or full, only if everything within a texel of that level is
    asked, level = wide * size / min(slot[2], slot[3]), size
    while level > SMALLEST // 2 and asked * level >= size:
        level //= 2
    known, level = level >= SMALLEST, max(level, SMALLEST)
    u, v = 0.5 * (at_x / slot[2] + 1.0), 0.5 * (at_y / slot[3] + 1.0)
    x, y = min(max(u * level - 0.5, 0.0), level - 1.0), min(max(v * level - 0.5, 0.0), level - 1.0)
    i, j = min(int(x), level - 2), min(int(y), level - 2)
    above, part, opacity = 4 * (size * size - level * level) // 3 + j * level + i, 0.0, 0.0
    for k in range(4):
        weight = (x - i if k % 2 else 1.0 - x + i) * (y - j if k // 2 else 1.0 - y + j)
        column = 4 * (above + k % 2 + level * (k // 2))
        part += weight * columns[column]
        opacity += weight * columns[column + 3]
    inside = known and below and 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0
    return part > 0.0 or not known, inside and (opacity if clear else part) > 0.9999


@fast
def _find_hidden(places: Any, lights: Any, columns: Any, found: Any) -> None:
    """Set what `Visibility.hidden` returns. columns: slots, values, size and clear of `Visibility`."""
    slots, values, size, clear = columns
    widest = HALO if lights[HALO, 1] > 0.0 else DISC
    slope_x, slope_y = lights[DISC, 3], lights[DISC, 4]
    tilt, x, y, z = 0.5 * math.sqrt(slope_x * slope_x + slope_y * slope_y), 0.0, 0.0, 0.0
    for n in range(len(places)):
        hidden, part_of_disc, all_of_disc, gap, radius = 0.0, False, False, 1e9, places[n, 3]
        for body in range(int(lights[widest, 1])):
            slot, part, whole = slots[body], False, False
            if body == 0:
                x, y, z = _in_slot(slot, places[n, 0], places[n, 1], places[n, 2])
            below = slot[4] - z - radius
            disc = _across(slot, (x, y, z), radius, radius, (slope_x, slope_y), tilt, lights[widest, 2])
            if disc[2] >= 0.0:
                part, whole = _between((values[body], slot, size, clear), disc, below >= 0.0)
            if part:
                hidden, gap = max(hidden, 3.0 if whole else 2.0), min(gap, max(below, 0.0))
                disc = _across(slot, (x, y, z), radius, radius, (slope_x, slope_y), tilt, lights[DISC, 2])
                if disc[2] >= 0.0:
                    part, whole = _between((values[body], slot, size, clear), disc, below >= 0.0)
                    part_of_disc, all_of_disc = part_of_disc or part, all_of_disc or whole
        if hidden == 2.0 and (not part_of_disc or all_of_disc):
            hidden = 1.0
        found[n, 0], found[n, 1] = hidden, gap


# --- rays ------------------------------------------------------------------------------------------------------------

_ROOM = _TOGETHER * _MOST_RAYS
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_FIRST: Any = np.int64(0)
"""Where a count begins: kernels that are passed a 0 as it is written are compiled for it, and again for the count."""
_LEAST = np.float32(1e-6)
_FULL = np.float32(1.0 + 4e-6)
"""Factor on filled fractions, such that sums of weights that are rounded down are still whole."""
_LEVEL_ABOVE = np.float32(math.sqrt(2.0))
"""Width of an edge in texels of a level from which on the next one is read: of the two the nearer on a scale of
powers."""


def _see_room(slots: int) -> tuple[Any, ...]:
    """Return room of `_see` for some slots: footprints, each of a number chosen, and their rays."""
    foot, ray = (_TOGETHER,) * 3, (_ROOM,) * 3
    near, numbers = room((slots, _TOGETHER), dtype=np.bool_), room(*foot[:2], dtype=np.int64)
    feet = room(*foot), room(*foot), room(*foot), *room(_TOGETHER), room(*foot)
    rays, at = (room(*ray), room(*ray), room(*ray), *room(_ROOM)), room(*ray[:2], dtype=np.int32)
    of_step = room(*ray), room(*ray), at, room(*ray), room(*ray), *room(4 * _ROOM)
    return (*near, *numbers, *room(*foot[:2], dtype=np.float64)), feet, rays, room(*ray), of_step


@fast
def _see(footprints: Any, of_lights: Any, columns: Any, rays_of: Any, work: Any, seen: Any) -> None:
    """Set the visible fractions (n, k) of lights that are negative.

    of_lights: lights (k, ...), the numbers (k,) of their fans, and (n, 3) slope of the middle of the first of them,
    across over along, and radius by which it is wider; (0, 3) where these are its own. columns: slots, values, size and
    clear of `Visibility`, rays_of: its rays and fans. work: of `_see_room`.
    """
    (lights, of_fans, turned), (slots, values, size, clear), (fans_of, fans) = of_lights, columns, rays_of
    (near, asked, mine, facing, hidden), feet, rays, outcome, of_step = work
    blocked = outcome[2]
    for begin in range(0, len(footprints), _TOGETHER):
        for number in range(len(lights)):
            light, fan, numbers = lights[number], fans_of[of_fans[number]], fans[of_fans[number]]
            first, end = int(light[0]), int(light[1])
            lamp = first < end and slots[first, 6] > 0.0
            bent, low_x, low_y, x, y, z = len(turned) > 0 and number == 0, light[3], light[4], 0.0, 0.0, 0.0
            # Keep the footprints from which bodies may hide part of the light
            count = 0
            for n in range(begin, min(begin + _TOGETHER, len(footprints))):
                if seen[n, number] >= 0.0:
                    continue
                foot, there, umbra = footprints[n], False, False
                facing[count] = _facing(foot, light) if lamp else 1.0
                radius = 0.5 * (math.sqrt(foot[3] * foot[3] + foot[4] * foot[4] + foot[5] * foot[5])
                                + math.sqrt(foot[6] * foot[6] + foot[7] * foot[7] + foot[8] * foot[8]))  # fmt: skip
                wide, deep, spread = radius, radius, light[2]
                if bent:
                    low_x, low_y = turned[n, 0], turned[n, 1]
                    spread = math.sqrt(spread * spread + turned[n, 2] * turned[n, 2])
                tilt = 0.5 * math.sqrt(low_x * low_x + low_y * low_y)
                for body in range(first, end if facing[count] > 0.0 else first):
                    slot, near[body, count] = slots[body], False
                    if lamp or body == first:
                        x, y, z = _in_slot(slot, foot[0], foot[1], foot[2])
                    if lamp:
                        scale = max(z, 0.0) / slot[6]
                        wide, deep, spread = 2.0 * radius * scale, radius * scale * scale, light[8] / slot[6]
                    disc = _across(slot, (x, y, z), wide, deep, (low_x, low_y), tilt, spread)
                    if disc[2] >= 0.0 and (z > 0.0 or not lamp):
                        below = slot[4] - z - deep >= 0.0
                        near[body, count], whole = _between((values[body], slot, size, clear), disc, below)
                        there, umbra = there or near[body, count], umbra or whole
                seen[n, number] = 0.0 if umbra else 1.0
                if there and not umbra:
                    asked[count], hidden[count] = n, 0.0
                    count += 1
            # Where the first rays agree that all of it is seen, or none, the others are not asked
            total, last, done = int(numbers[0]), int(numbers[1]), _FIRST
            while count > 0:
                for k in range((last - done) * count):
                    blocked[k] = _ZERO
                for body in range(first, end):
                    # Start the rays of those that this body may hide it from
                    found, slot = _FIRST, slots[body]
                    spread = light[8] / slot[6] if lamp else light[2]
                    for k in range(count):
                        if near[body, k]:
                            n, disc = asked[k], (spread, light[3], light[4])
                            if bent:
                                wider = math.sqrt(spread * spread + turned[n, 2] * turned[n, 2])
                                disc = wider, turned[n, 0], turned[n, 1]
                            _set_footprint(footprints[n], slot, numbers[2] * facing[k], disc, found, feet)
                            mine[found] = k
                            found += 1
                    if found == 0:
                        continue
                    _start(fan, (done, last, found), slot, numbers[3], feet, rays)
                    stride = _STRIDE if bent else _ONE
                    of_body = values[body], slot, size, clear
                    _walk(of_body, found * (last - done), rays, stride, of_step, outcome)
                    # Of two bodies the larger counts where both are opaque
                    for k in range(last - done):
                        for m in range(found):
                            at, one = k * count + mine[m], outcome[0][k * found + m]
                            blocked[at] = blocked[at] + one - blocked[at] * one if clear else max(blocked[at], one)
                for k in range(last - done):
                    for m in range(count):
                        hidden[m] += blocked[k * count + m]
                left = 0
                for m in range(count):
                    if last == total or hidden[m] <= 0.0 or hidden[m] >= last:
                        seen[asked[m], number] = (last - hidden[m]) / last
                        continue
                    asked[left], hidden[left], facing[left] = asked[m], hidden[m], facing[m]
                    for body in range(first, end):
                        near[body, left] = near[body, m]
                    left += 1
                count, done, last = left, last, total


@inlined
def _facing(foot: Any, lamp: Any) -> Any:
    """Return the square root of the area of a footprint across the direction to a lamp, 0 where the lamp does not light
    it: where it faces away, or is beside the cone.
    """
    x, y, z = lamp[5] - foot[0], lamp[6] - foot[1], lamp[7] - foot[2]
    apart = max(math.sqrt(x * x + y * y + z * z), lamp[13])
    cosine = -(x * lamp[9] + y * lamp[10] + z * lamp[11]) / apart
    across_x, across_y = foot[4] * foot[8] - foot[5] * foot[7], foot[5] * foot[6] - foot[3] * foot[8]
    across_z = foot[3] * foot[7] - foot[4] * foot[6]
    area = abs(across_x * x + across_y * y + across_z * z) / apart
    away = foot[9] * x + foot[10] * y + foot[11] * z <= 0.0 or -1.0 < lamp[12] >= cosine
    return 0.0 if away else max(math.sqrt(area), 1e-12)


@fast
def _set_footprint(foot: Any, slot: Any, facing: Any, disc: Any, k: Any, feet: Any) -> None:
    """Set the k-th of feet: middle and sides of a footprint in the axes of a slot, before any projection, the width of
    rays there, and the disc of light. facing: of a lamp, that width. disc: tangent of its radius, and slope of its
    middle.
    """
    middle, one_side, other_side, grain, of_disc = feet
    for axis in range(3):
        a, b, c = slot[7 + 3 * axis], slot[8 + 3 * axis], slot[9 + 3 * axis]
        middle[axis][k] = a * foot[0] + b * foot[1] + c * foot[2] + slot[16 + axis]
        one_side[axis][k] = a * foot[3] + b * foot[4] + c * foot[5]
        other_side[axis][k] = a * foot[6] + b * foot[7] + c * foot[8]
    area = abs(one_side[0][k] * other_side[1][k] - one_side[1][k] * other_side[0][k]) if slot[6] == 0.0 else 1.0
    grain[k] = facing * math.sqrt(area)
    of_disc[0][k], of_disc[1][k], of_disc[2][k] = disc


@fast
def _start(fan: Any, part: Any, slot: Any, widening: Any, feet: Any, rays: Any) -> None:
    """Start rays of a fan from their places in footprints, those of each ray in turn.

    part: first ray, the one after the last, and number of footprints. widening: of rays over the radius of the disc a
    metre away. feet: of `_set_footprint`. rays: start, slope, spans, growth. start: from the middle of the slot and its
    lowest point. slope: metres across for a metre along the light, and the inverse of their length. spans: height over
    the start at which they enter and leave the slot, and width at the start. growth: of the width for a metre.
    """
    (first, last, count), (middle, one_side, other_side, grain, of_disc), (start, slope, spans, growth) = (
        part, feet, rays
    )  # fmt: skip
    wide, low_x, low_y = of_disc
    wider = np.float32(widening)
    at_x, at_y = np.float32(slot[0]), np.float32(slot[1])
    lowest, reach = np.float32(slot[4]), np.float32(slot[5] - slot[4])
    far = np.float32(slot[6])
    x, y, z = start
    for ray in range(first, last):
        mine = slice((ray - first) * count, (ray - first + 1) * count)
        p, q, widths, growths = fan[2, ray], fan[3, ray], spans[2][mine], growth[mine]
        _place_starts(x[mine], middle[0], one_side[0], other_side[0], p, q)
        _place_starts(y[mine], middle[1], one_side[1], other_side[1], p, q)
        _place_starts(z[mine], middle[2], one_side[2], other_side[2], p, q)
        slope_x, slope_y, across = slope[0][mine], slope[1][mine], slope[2][mine]
        for k in range(count):
            widths[k], growths[k] = grain[k], wide[k] * wider
        for k in range(count):
            slope_x[k] = low_x[k] + wide[k] * fan[0, ray]
        for k in range(count):
            slope_y[k] = low_y[k] + wide[k] * fan[1, ray]
        for k in range(count):
            across[k] = _ONE / max(np.sqrt(slope_x[k] * slope_x[k] + slope_y[k] * slope_y[k]), _LEAST)
    total = (last - first) * count
    if far > _ZERO:
        # The map of shadow_columns.py; behind the lamp nothing hides it
        for k in range(total):
            scale = far / z[k] if z[k] > _ZERO else _ZERO
            x[k], y[k], z[k] = x[k] * scale, y[k] * scale, far * scale if z[k] > _ZERO else -_ONE
            spans[2][k] *= z[k] / far
    low, high = spans[0], spans[1]
    for k in range(total):
        x[k], y[k], z[k] = x[k] - at_x, y[k] - at_y, z[k] - lowest
    for k in range(total):
        low[k], high[k] = max(-z[k], _ZERO), max(reach - z[k], _ZERO)


@inlined
def _place_starts(start: Any, middle: Any, one_side: Any, other_side: Any, p: Any, q: Any) -> None:
    """Set a coordinate of the starts of a ray of each footprint, at p and q of its sides from its middle.

    A loop of one result is compiled for eight numbers at once; of several, whose arrays may overlap, for one.
    """
    for k in range(len(start)):
        start[k] = middle[k] + p * one_side[k] + q * other_side[k]


@fast
def _walk(of_body: Any, rays: Any, of_rays: Any, stride: Any, work: Any, outcome: Any) -> None:
    """Set what a body blocks of a number of rays, most (rays,), the first of outcome; all of them take a step at a
    time. of_body: as `_between` has it. of_rays: of `_start`. stride: length of a step, in widths of a ray.
    """
    columns, slot, size, clear = of_body
    (x, y, z), (slope_x, slope_y, across), (h, until, widths), widening = of_rays
    (filled, top, bottom), (filled_a, top_a, bottom_a), (at, side), (fx, fy, _), of_level, four = work
    (wanted, per_texel, inside), (most, h_a, _) = of_level, outcome
    all_texels, half = np.float32(size), np.float32(0.5 * size)
    texel = np.float32(2.0 * max(slot[2], slot[3]) / size)
    per_x, per_y = np.float32(0.5 * size / slot[2]), np.float32(0.5 * size / slot[3])
    margin, per_ramp = np.float32(0.01) * texel, _ONE / (np.float32(_RAMP) * texel)
    step = 0
    for k in range(rays):
        most[k] = _ZERO
    while True:
        # Find the level of each ray's width
        for k in range(rays):
            wanted[k], per_texel[k] = max((widths[k] + widening[k] * h[k]) * per_ramp, np.float32(_SHARPEST)), _ONE
        finest, up = size, _ONE
        while up > _ZERO and finest > SMALLEST:
            up = _ZERO
            for k in range(rays):
                higher = wanted[k] * per_texel[k] >= _LEVEL_ABOVE
                up += _ONE if higher else _ZERO
                per_texel[k] *= _HALF if higher else _ONE
            finest //= 2
        # Read four columns each, linear between their middles
        for k in range(rays):
            u, v = (x[k] + slope_x[k] * h[k]) * per_x + half, (y[k] + slope_y[k] * h[k]) * per_y + half
            texels = all_texels * per_texel[k]
            inside[k] = _ONE if min(u, v, all_texels - u, all_texels - v) >= _ZERO else _ZERO
            u = min(max(u * per_texel[k] - _HALF, _ZERO), texels - _ONE)
            v = min(max(v * per_texel[k] - _HALF, _ZERO), texels - _ONE)
            i, j = np.int32(min(u, texels - _TWO)), np.int32(min(v, texels - _TWO))
            first = np.float32(4.0 / 3.0) * (all_texels * all_texels - texels * texels)
            fx[k], fy[k], side[k] = u - np.float32(i), v - np.float32(j), np.int32(texels)
            at[k] = np.int32(first + _HALF) + j * np.int32(texels) + i
        for k in range(rays):
            above = np.uint64(4 * at[k])
            below = above + np.uint64(4 * side[k])
            c, d = fx[k] * (_ONE - fy[k]), fx[k] * fy[k]
            a, b = _ONE - fy[k] - c, fy[k] - d
            mix_texels(columns, (above, below), (a, c, b, d), four, np.uint64(4 * k))
        # One that is partly filled is taken as thinner, in proportion; its edges are as wide as the ray
        for k in range(rays):
            part = inside[k] * four[4 * k]
            share = _ONE / max(part, _LEAST)
            ends_t, ends_b = four[4 * k + 1] * share, four[4 * k + 2] * share
            ramp = (part - _HALF) / min(wanted[k], _ONE) + _HALF
            filled[k] = min(max(ramp, _ZERO) * _FULL, _ONE) if part > _ZERO else _ZERO
            middle, thick = _HALF * (ends_t + ends_b), _HALF * (ends_t - ends_b) * part
            top[k], bottom[k] = middle + thick, middle - thick
        if clear:
            for k in range(rays):
                share = _ONE / max(four[4 * k], _LEAST)
                passed = min(max(_ONE - four[4 * k + 3] * share, _ZERO), _ONE)
                within = z[k] < four[4 * k + 1] * share - margin and z[k] > four[4 * k + 2] * share - margin
                filled[k] *= _ONE - (np.sqrt(passed) if within else passed)
        # Between this and the one before the ends are straight lines, which the ray may cross
        if step > 0:
            for k in range(rays):
                # All are read before one is chosen: of an address that is chosen the compiler reads one by one
                fa, fb, ta, ba, tb, bb = filled_a[k], filled[k], top_a[k], bottom_a[k], top[k], bottom[k]
                ta, ba, tb, bb = (
                    ta if fa > _ZERO else tb, ba if fa > _ZERO else bb,
                    tb if fb > _ZERO else ta, bb if fb > _ZERO else ba,
                )  # fmt: skip
                za, zb = z[k] + h_a[k], z[k] + h[k]
                below_a, below_b = za - ba + margin, zb - bb + margin
                above_a, above_b = ta - za + margin, tb - zb + margin
                cut_below = below_a / (below_a - below_b if below_a != below_b else _ONE)
                cut_above = above_a / (above_a - above_b if above_a != above_b else _ONE)
                enter = max(cut_below if below_a < _ZERO else _ZERO, cut_above if above_a < _ZERO else _ZERO)
                leave = min(cut_below if below_b < _ZERO else _ONE, cut_above if above_b < _ZERO else _ONE)
                met = min(max(below_a, below_b), max(above_a, above_b), leave - enter) >= _ZERO
                one = max(fa + enter * (fb - fa), fa + leave * (fb - fa))
                most[k] = max(most[k], one if met and max(fa, fb) > _ZERO else _ZERO)
        left = _ZERO
        for k in range(rays):
            left += _ONE if min(until[k] - h[k], _ONE - most[k]) > _ZERO else _ZERO
        if step > 0 and left == _ZERO:
            break
        step += 1
        for k in range(rays):
            h_a[k], filled_a[k], top_a[k], bottom_a[k] = h[k], filled[k], top[k], bottom[k]
            farther = h[k] + stride * max(widths[k] + widening[k] * h[k], _HALF * texel) * across[k]
            h[k] = min(farther, until[k]) if step < _MOST_STEPS else until[k]
