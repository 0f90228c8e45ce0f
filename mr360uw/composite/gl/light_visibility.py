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
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, Scratch
from mr360uw.composite.gl.shadow_columns import (
    SMALLEST,
    axes_and_slope,
    columns_of,
    lamp_frames,
    slot_size,
    sun_frames,
)
from mr360uw.composite.lighting.light_sources import lamps_of, sun_of, widest_half_angle
from mr360uw.composite.lighting.shadow import wide_pixel_offsets
from mr360uw.composite.shot import Shot
from mr360uw.constants import LONGEST_FOOTPRINT, MAXIMUM_SUN_SAMPLES
from mr360uw.jit import borrowing, exact, fast, inlined
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.sphere import disc_offsets
from mr360uw.types import Floats

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
ALL_RAYS, HALF_OF_RAYS, ONE_RAY = 0, 1, 2
"""Numbers of the fans of rays: all, each second one of them, and one, for lights that are points."""


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What hides the lights of a shot. Points are from the camera, in the world's axes [m].

    values, size, clear: of `Columns`. slots: (m, 19) of each its extents (6), and for lamps
    the middle distance, axes (3, 3) and the camera in them (3); those of the sun come first. sun: (3, 4) axes of the sun's
    slots, two across and one along, and the camera in them. slope: (2,) of the sun's direction in these axes, across over
    along. spread: (2,) tangents of the radii of disc and halo, the latter 0 where it is as wide as the disc. lamps:
    (L, 9) of each its place, radius, axis, cosine at the edge of the cone, and least distance; first: (L + 1,) numbers of
    their first slots, the number of all slots last. rays: (3, n, 4) of fans, slope over a unit disc and place in
    [-0.5, 0.5]^2 of a footprint; fans: (3, 4) how many there are, how many speak for all where they agree, and by how much
    a ray widens, over the footprint and over the radius of the disc a metre away. bias: factor on the offset of rays from
    a body's surface.
    """

    values: NDArray[np.float32]
    size: int
    clear: bool
    slots: Floats
    sun: Floats
    slope: Floats
    spread: Floats
    lamps: Floats
    first: NDArray[np.int64]
    rays: Floats
    fans: Floats
    bias: float

    @property
    def of_sun(self) -> tuple[object, ...]:
        """All that decides what is seen of the sun from a place."""
        return self.values, self.slots[: self.first[0]], self.sun[:, :3], self.slope, self.spread, self.fans, self.bias

    @property
    def of_lamps(self) -> tuple[object, ...]:
        """All that decides what is seen of lamps from a place."""
        return self.values, self.slots[self.first[0] :], self.lamps, self.fans, self.bias

    def at_places(self, places: Floats) -> Floats:
        """Return for balls (n, 4), middle and radius, of the sun, (n, 4): visible fractions of disc and halo from the
        middle; which of them bodies may hide within the ball (0 neither, 1 the halo, 2 part of the disc, 3 all of both);
        distance [m] to the nearest such body.
        """
        seen = np.empty((len(places), 4))
        _see_places(places, self.sun, self.slope, self.spread, *self._occluders, seen)
        return seen

    def over_areas(self, areas: Areas, *, sun: bool, lamps: bool, halo_rays: int = ALL_RAYS) -> Floats:
        """Return the visible fractions (n, 2 + L), means over areas: of the sun's disc and halo, and of each lamp."""
        count = len(self.lamps) if lamps else 0
        seen = np.ones((len(areas.entries) * areas.side * areas.side, 2 + count))
        turned = np.column_stack([self.sun[:, :3] @ areas.axes, self.sun[:, 3]])
        slots, of_lamps = self.slots.copy(), self.lamps[:count].copy()
        slots[:, 7:16] = (slots[:, 7:16].reshape(-1, 3, 3) @ areas.axes).reshape(-1, 9)
        for part in (slice(0, 3), slice(4, 7)):
            of_lamps[:, part] = of_lamps[:, part] @ areas.axes
        frame = areas.size[0], areas.size[1], areas.eye_m, areas.step, areas.spacing, areas.side
        of_sun = turned, self.slope, self.spread, sun, halo_rays
        _see_areas(areas.entries, areas.surface, areas.plane, frame, *of_sun, of_lamps, self.first,
                   self.values, slots, self.size, self.clear, self.rays, self.fans, self.bias, seen)  # fmt: skip
        return seen

    @property
    def _occluders(self) -> tuple[Any, ...]:
        return self.first, self.values, self.slots, self.size, self.clear, self.rays, self.fans


@dataclass(frozen=True, slots=True, eq=False)
class Areas:
    """Areas of the frame over which visibility is averaged, side x side in each of m blocks, n in all, in order.

    entries: (m, 12) of each block its corner in the frame (2), the area (5) of `sampling.frame_areas`, visible fraction of
    the halo at its corners (4), negative where it is found for each area, and the offset of rays from the surface [m].
    spacing: pixels between the areas of a block. surface: (n, 4) unit normal in the camera's axes and distance along the
    ray, none for a level plane. plane: its height above the camera, and the camera's axes (3,) that are up. axes: (3, 3)
    world from camera. size: of the frame. step: pixels over which footprints are measured.
    """

    entries: Floats
    side: int
    spacing: float
    surface: Floats
    plane: Floats
    axes: Floats
    size: tuple[float, float]
    eye_m: float
    step: float


def visibility_of(shot: Shot, cache: Cache, scratch: Scratch) -> Visibility:
    """Return what hides the lights of a shot. cache: keeps columns of bodies; scratch: for drawing them."""
    sun, lamps, view = sun_of(shot), lamps_of(shot), shot.view
    of_sun, of_lamps = sun_frames(shot), lamp_frames(shot)
    frames = [*of_sun, *(frame for group in of_lamps for frame in group)]
    # Draw the columns, as fine as the narrowest light asks for
    radii = [lamp.radius_m / frame.middle_m for lamp, g in zip(lamps, of_lamps, strict=True) for frame in g]
    narrowest = min([*radii, *([] if sun is None else [sun.half_angle_rad])], default=0.0)
    columns = columns_of(frames, slot_size(len(frames), _pixels_across(shot), narrowest), cache, scratch)
    # Describe their slots and the lights
    slots = np.zeros((len(frames), 19))
    slots[:, :6] = columns.extents
    for row, frame in zip(slots, frames, strict=True):
        if frame.origin is not None:
            row[6], row[7:16] = frame.middle_m, frame.axes.ravel()
            row[16:] = frame.axes @ (view.position - frame.origin)
    axes, slope = (np.eye(3), np.zeros(2)) if sun is None else axes_and_slope(sun)
    widest = widest_half_angle(shot)
    spread = (0.0, 0.0) if sun is None else (sun.half_angle_rad, widest if widest > sun.half_angle_rad else 0.0)
    rows = [
        (*(lamp.position - view.position), lamp.radius_m, *lamp.axis, lamp.cos_edge, nearest_m(lamp)) for lamp in lamps
    ]
    # Spread rays over their discs, and over footprints
    finer = int(np.clip(round(_NARROW / view.width), 1, _MOST_RAYS // MAXIMUM_SUN_SAMPLES))
    count = finer * min(shot.draw.sun_samples, MAXIMUM_SUN_SAMPLES)
    rays, fans = _fans(count)
    return Visibility(
        columns.values, columns.size, columns.clear, slots, np.column_stack([axes, axes @ view.position]), slope, np.tan(spread),
        np.array(rows, np.float64).reshape(-1, 9), np.cumsum([len(of_sun), *map(len, of_lamps)]), rays, fans,
        max(_BIASED_SLOT / columns.size, 1.0),
    )  # fmt: skip


def _pixels_across(shot: Shot) -> float:
    """Return the width [pixels] of the body that is largest in the frame."""
    widest = 0.0
    for placed in shot.casters:
        radius = placed.mesh.radius_m * placed.scale
        distance = float(np.linalg.norm(placed.to_world(placed.mesh.center_m) - shot.view.position))
        widest = max(widest, 2.0 * radius / max(distance - radius, 1e-3))
    return widest * shot.view.height / np.pi


@functools.cache
def _fans(count: int) -> tuple[Floats, Floats]:
    """Return `Visibility.rays` and `Visibility.fans` of a number of directions, shared by all callers.

    Rays of that width have, with factors on their places and directions, the second moments of footprint and disc
    together: a square's is 1/12 of its squared side, a disc's 1/4 of its squared radius. Of a fan that is asked by halves,
    the first half is one of every two, the first and the second in turn: rays that follow each other lie in other columns
    of the footprint.
    """
    rays, fans = np.zeros((3, count, 4)), np.zeros((3, 4))
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
        fan[:number] = some[order] * np.repeat(factors, 2)
        of_fan[:] = number, few, grain, widening
    return rays, fans


@exact
def _make_scratch(bodies: Any) -> Any:
    """Return scratch arrays: numbers of bodies; four numbers of a column; rays (n, 8), of each its start, metres across
    for a metre along the light (2), the inverse of their length, width at the start, and by how much that grows for a
    metre [m]; and what of each ray is blocked (n,).
    """
    return np.empty(max(bodies, 1), np.int64), np.empty(4, np.float32), np.empty((_MOST_RAYS, 8)), np.empty(_MOST_RAYS)


# --- rays through one body -------------------------------------------------------------------------------------------


@inlined
def _read_column(values: Any, begin: Any, across: Any, x: Any, y: Any, column: Any) -> None:
    """Set the four numbers of `column` to those of a level of columns at a place in its texels, linear between their
    middles, clamped to the slot. begin: of the level; across: its texels along a side.
    """
    x, y, one = max(x - 0.5, 0.0), max(y - 0.5, 0.0), np.float32(1.0)
    i, j = min(int(x), across - 2), min(int(y), across - 2)
    fx, fy = np.float32(min(x - i, 1.0)), np.float32(min(y - j, 1.0))
    above = begin + j * across + i
    below = above + across
    a, b, c, d = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
    # Compilers join the four channels because these are stored one beside the other
    for k in range(4):
        column[k] = a * values[above, k] + b * values[above + 1, k] + c * values[below, k] + d * values[below + 1, k]


@fast
def _trace(values: Any, slot: Any, size: Any, clear: Any, first: Any, last: Any, scratch: Any) -> None:
    """Add to what bodies block of the rays of `_make_scratch` what one body blocks of those from `first` to before `last`.

    values, slot: its columns (n, 4) and extents.
    """
    _, column, rays, blocked = scratch
    low, high, half = slot[4], slot[5], 0.5 * size
    texel, per_x, per_y = 2.0 * max(slot[2], slot[3]) / size, half / slot[2], half / slot[3]
    margin, shortest, per_ramp = 0.01 * texel, 0.5 * texel, 1.0 / (_RAMP * texel)
    for ray in range(first, last):
        if blocked[ray] >= 1.0:
            continue
        x, y, z = rays[ray, 0] - slot[0], rays[ray, 1] - slot[1], rays[ray, 2]
        slope_x, slope_y, across, grain, widening = (
            rays[ray, 3],
            rays[ray, 4],
            rays[ray, 5],
            rays[ray, 6],
            rays[ray, 7],
        )
        h, until = max(low - z, 0.0), max(high - z, 0.0)
        per_texel, begin, level, most, k = 1.0, 0, size, 0.0, 0
        top = bottom = before = top_before = bottom_before = h_before = 0.0
        while True:
            # Find the column here, from the level of the ray's width
            width = grain + widening * h
            wanted = max(width * per_ramp, _SHARPEST)
            while level > SMALLEST and wanted * per_texel >= math.sqrt(2.0):
                begin += level * level
                per_texel, level = 0.5 * per_texel, level // 2
            u, v, filled = (x + slope_x * h) * per_x + half, (y + slope_y * h) * per_y + half, 0.0
            if min(u, v) >= 0.0 and max(u, v) <= size:
                _read_column(values, begin, level, u * per_texel, v * per_texel, column)
                part = np.float64(column[0])
                if part > 0.0:
                    share, filled = 1.0 / part, part - 0.5
                    top_here, bottom_here = column[1] * share + low, column[2] * share + low
                    filled = min(max((filled / wanted if wanted < 1.0 else filled) + 0.5, 0.0), 1.0)
                    if clear:
                        passed = min(max(1.0 - column[3] * share, 0.0), 1.0)
                        within = z < top_here - margin and z > bottom_here - margin
                        filled *= 1.0 - (math.sqrt(passed) if within else passed)
                    # One that is partly filled is taken as thinner, in proportion
                    middle, thick = 0.5 * (top_here + bottom_here), 0.5 * (top_here - bottom_here) * part
                    top, bottom = middle + thick, middle - thick
            # Between this and the one before the ends are straight lines, which the ray may cross
            if k > 0 and max(filled, before) > 0.0:
                top_a, bottom_a = (top_before, bottom_before) if before > 0.0 else (top, bottom)
                top_b, bottom_b = (top, bottom) if filled > 0.0 else (top_before, bottom_before)
                at_a, at_b = z + h_before, z + h
                below_a, below_b = at_a - bottom_a + margin, at_b - bottom_b + margin
                above_a, above_b = top_a - at_a + margin, top_b - at_b + margin
                if min(below_a, below_b, above_a, above_b) >= 0.0:
                    most = max(most, before, filled)
                elif max(below_a, below_b) >= 0.0 and max(above_a, above_b) >= 0.0:
                    enter, leave = 0.0, 1.0
                    if min(below_a, below_b) < 0.0:
                        cut = below_a / (below_a - below_b)
                        enter, leave = (cut, leave) if below_a < 0.0 else (enter, cut)
                    if min(above_a, above_b) < 0.0:
                        cut = above_a / (above_a - above_b)
                        enter, leave = (max(enter, cut), leave) if above_a < 0.0 else (enter, min(leave, cut))
                    if enter <= leave:
                        change = filled - before
                        most = max(most, before + enter * change, before + leave * change)
            if k > 0 and (h >= until or most >= 1.0):
                break
            k += 1
            before, top_before, bottom_before, h_before = filled, top, bottom, h
            h = min(h + max(width, shortest) * across, until) if k < _MOST_STEPS else until
        # Of two bodies the larger counts where both are opaque
        blocked[ray] = blocked[ray] + most - blocked[ray] * most if clear else max(blocked[ray], most)


# --- the sun ---------------------------------------------------------------------------------------------------------


@borrowing
def _bodies_between(
    values: Any, slots: Any, count: Any, size: Any, clear: Any, x: Any, y: Any, z: Any, radius: Any, slope: Any, spread: Any,
    scratch: Any,
) -> Any:  # fmt: skip
    """Write those of the first `count` bodies that may hide part of a disc about the sun from part of a ball to the
    scratch.

    Returns how many there are, the distance [m] to the nearest, and whether one of them hides all of the disc from all of
    the ball. x, y, z: its middle in the sun's axes. slope: (2,) of the disc's middle. spread: tangent of its radius.
    """
    near, column, _, _ = scratch
    found, gap, umbra = 0, 1e9, False
    tilt = 0.5 * math.sqrt(slope[0] * slope[0] + slope[1] * slope[1])
    for body in range(count):
        # The disc of which the ball sees all parts of the body
        slot = slots[body]
        high, low = slot[5] - z + radius, max(slot[4] - z - radius, 0.0)
        if high <= 0.0:
            continue
        wide, along = radius + spread * high + tilt * (high - low), 0.5 * (low + high)
        at_x, at_y = x + along * slope[0] - slot[0], y + along * slope[1] - slot[1]
        if max(abs(at_x) - slot[2], abs(at_y) - slot[3]) > wide:
            continue
        # A filtered column is empty, or full, only if everything within a texel of that level is
        asked, level = wide * size / min(slot[2], slot[3]), size
        while level > SMALLEST // 2 and asked * level >= size:
            level //= 2
        known = level >= SMALLEST
        level = max(level, SMALLEST)
        u, v = 0.5 * (at_x / slot[2] + 1.0), 0.5 * (at_y / slot[3] + 1.0)
        _read_column(values[body], 4 * (size * size - level * level) // 3, level, u * level, v * level, column)
        part, opacity = column[0], column[3]
        if part > 0.0 or not known:
            near[found] = body
            found += 1
            below = slot[4] - z - radius
            gap = min(gap, max(below, 0.0))
            inside = 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0
            umbra |= known and below >= 0.0 and inside and (opacity if clear else part) > 0.9999
    return found, gap, umbra


@borrowing
def _disc_seen(
    values: Any, slots: Any, count: Any, size: Any, clear: Any, place: Any, slope: Any, spread: Any, fan: Any,
    numbers: Any, scratch: Any,
) -> Any:  # fmt: skip
    """Return the visible fraction of a disc about the sun, a mean over a footprint.

    place: its middle and two sides in the sun's axes. fan, numbers: a fan of rays and its row of `Visibility.fans`. Where
    the first rays agree that all of it is seen, or none, the others are not asked.
    """
    x, y, z, ax, ay, az, bx, by, bz = place
    near, _, rays, blocked = scratch
    radius = 0.5 * (math.sqrt(ax * ax + ay * ay + az * az) + math.sqrt(bx * bx + by * by + bz * bz))
    found, _, umbra = _bodies_between(values, slots, count, size, clear, x, y, z, radius, slope, spread, scratch)
    if found == 0 or umbra:
        return 0.0 if umbra else 1.0
    grain, widening = numbers[2] * math.sqrt(abs(ax * by - ay * bx)), spread * numbers[3]
    total, last, asked = int(numbers[0]), int(numbers[1]), 0
    for k in range(total):
        p, q = fan[k, 2], fan[k, 3]
        slope_x, slope_y = slope[0] + spread * fan[k, 0], slope[1] + spread * fan[k, 1]
        rays[k, 0], rays[k, 1], rays[k, 2] = x + p * ax + q * bx, y + p * ay + q * by, z + p * az + q * bz
        rays[k, 3], rays[k, 4] = slope_x, slope_y
        rays[k, 5] = 1.0 / max(math.sqrt(slope_x * slope_x + slope_y * slope_y), 1e-6)
        rays[k, 6], rays[k, 7], blocked[k] = grain, widening, 0.0
    while True:
        for n in range(found):
            body = near[n]
            _trace(values[body], slots[body], size, clear, asked, last, scratch)
        hidden = 0.0
        for k in range(last):
            hidden += blocked[k]
        if last == total or hidden <= 0.0 or hidden >= last:
            return 1.0 - hidden / last
        asked, last = last, total


@fast
def _see_places(
    places: Any, axes: Any, slope: Any, spread: Any, first: Any, values: Any, slots: Any, size: Any, clear: Any, rays: Any,
    fans: Any, seen: Any,
) -> None:  # fmt: skip
    """Set what `Visibility.at_places` returns."""
    count = first[0]
    scratch = _make_scratch(count)
    for n in range(len(places)):
        px, py, pz, radius = places[n, 0], places[n, 1], places[n, 2], places[n, 3]
        x = axes[0, 0] * px + axes[0, 1] * py + axes[0, 2] * pz + axes[0, 3]
        y = axes[1, 0] * px + axes[1, 1] * py + axes[1, 2] * pz + axes[1, 3]
        z = axes[2, 0] * px + axes[2, 1] * py + axes[2, 2] * pz + axes[2, 3]
        widest = max(spread[0], spread[1])
        found, gap, umbra = _bodies_between(values, slots, count, size, clear, x, y, z, radius, slope, widest, scratch)
        hidden = 0.0 if found == 0 else (3.0 if umbra else 2.0)
        place = x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        seen[n, 0] = _disc_seen(values, slots, count, size, clear, place, slope, spread[0], rays[0], fans[0], scratch)
        seen[n, 1] = 1.0
        if spread[1] > 0.0:
            if hidden == 2.0:
                of_disc, _, all_of_it = _bodies_between(
                    values, slots, count, size, clear, x, y, z, radius, slope, spread[0], scratch
                )
                hidden = 1.0 if of_disc == 0 or all_of_it else 2.0
            seen[n, 1] = _disc_seen(
                values, slots, count, size, clear, place, slope, spread[1], rays[0], fans[0], scratch
            )
        seen[n, 2], seen[n, 3] = hidden, gap


# --- areas of the frame ----------------------------------------------------------------------------------------------


@inlined
def _step(px: Any, py: Any, pz: Any, nx: Any, ny: Any, nz: Any, dx: Any, dy: Any, dz: Any, pixels: Any) -> Any:
    """Return the derivative (3) of a point p on a plane with the normal n by a frame coordinate, as `pixel_steps` of
    composite/raycast.py. d: direction that lies `pixels` pixels farther.
    """
    cosine = nx * dx + ny * dy + nz * dz
    along = (nx * px + ny * py + nz * pz) / cosine if abs(cosine) > 1e-6 else 0.0
    far = math.sqrt(px * px + py * py + pz * pz)
    ux, uy, uz = dx * far - px, dy * far - py, dz * far - pz
    if along > 0.0:
        longest = LONGEST_FOOTPRINT * math.sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = dx * along - px, dy * along - py, dz * along - pz
        pixels /= min(longest / max(math.sqrt(ux * ux + uy * uy + uz * uz), 1e-18), 1.0)
    return ux / pixels, uy / pixels, uz / pixels


@fast
def _see_areas(
    entries: Any, surface: Any, plane: Any, frame: Any, axes: Any, slope: Any, spread: Any, of_sun: Any, halo_rays: Any,
    lamps: Any, first: Any, values: Any, slots: Any, size: Any, clear: Any, rays: Any, fans: Any, bias: Any, seen: Any,
) -> None:  # fmt: skip
    """Set what `Visibility.over_areas` returns. Everything is in the camera's axes."""
    width, height, eye, step, spacing, side = frame
    turn, tip = 2.0 * math.pi / width, math.pi / height
    turn_c, turn_s, tip_c, tip_s = (
        math.cos(turn * step),
        math.sin(turn * step),
        math.cos(tip * step),
        math.sin(tip * step),
    )
    lon_c, lon_s, lat_c, lat_s = np.empty(side), np.empty(side), np.empty(side), np.empty(side)
    scratch = _make_scratch(len(slots))
    for m in range(len(entries)):
        entry = entries[m]
        for i in range(side):
            lon = turn * (entry[0] + (i + 0.5) * spacing) - math.pi
            lat = 0.5 * math.pi - tip * (entry[1] + (i + 0.5) * spacing)
            lon_c[i], lon_s[i], lat_c[i], lat_s[i] = math.cos(lon), math.sin(lon), math.cos(lat), math.sin(lat)
        for within in range(side * side):
            n, r, c = m * side * side + within, within // side, within % side
            # The ray, and those a step to the right and below
            ls, lc, s, o = lon_s[c], lon_c[c], lat_s[r], lat_c[r]
            dx, dy, dz = o * ls, s, -o * lc
            right_s, right_c = ls * turn_c + lc * turn_s, lc * turn_c - ls * turn_s
            below_s, below_c = s * tip_c - o * tip_s, o * tip_c + s * tip_s
            start_x, start_z = -eye * dz, eye * dx
            # The surface that it meets
            if len(surface):
                nx, ny, nz, far = surface[n, 0], surface[n, 1], surface[n, 2], surface[n, 3]
            else:
                nx, ny, nz = plane[1], plane[2], plane[3]
                far = (plane[0] - nx * start_x - nz * start_z) / (nx * dx + ny * dy + nz * dz)
            if nx * dx + ny * dy + nz * dz > 0.0:
                nx, ny, nz = -nx, -ny, -nz
            px, py, pz = far * dx, far * dy, far * dz
            # The footprint of its area there
            rx, ry, rz = _step(px, py, pz, nx, ny, nz, o * right_s, s, -o * right_c, step)
            qx, qy, qz = _step(px, py, pz, nx, ny, nz, below_c * ls, below_s, -below_c * lc, step)
            off_x, off_y, xx, xy, yy = entry[2], entry[3], entry[4], entry[5], entry[6]
            px += start_x + off_x * rx + off_y * qx + bias * entry[11] * nx
            py += off_x * ry + off_y * qy + bias * entry[11] * ny
            pz += start_z + off_x * rz + off_y * qz + bias * entry[11] * nz
            ax, ay, az = xx * rx + xy * qx, xx * ry + xy * qy, xx * rz + xy * qz
            bx, by, bz = xy * rx + yy * qx, xy * ry + yy * qy, xy * rz + yy * qz
            # What is seen from there of the sun's disc, and of its halo where the block's corners do not tell
            if of_sun:
                a, b, w = axes[0], axes[1], axes[2]
                place = (
                    a[0] * px + a[1] * py + a[2] * pz + a[3], b[0] * px + b[1] * py + b[2] * pz + b[3],
                    w[0] * px + w[1] * py + w[2] * pz + w[3],
                    a[0] * ax + a[1] * ay + a[2] * az, b[0] * ax + b[1] * ay + b[2] * az, w[0] * ax + w[1] * ay + w[2] * az,
                    a[0] * bx + a[1] * by + a[2] * bz, b[0] * bx + b[1] * by + b[2] * bz, w[0] * bx + w[1] * by + w[2] * bz,
                )  # fmt: skip
                seen[n, 0] = _disc_seen(
                    values, slots, first[0], size, clear, place, slope, spread[0], rays[0], fans[0], scratch
                )
                if spread[1] > 0.0 and entry[7] < 0.0:
                    of_fan, fan = rays[halo_rays], fans[halo_rays]
                    seen[n, 1] = _disc_seen(
                        values, slots, first[0], size, clear, place, slope, spread[1], of_fan, fan, scratch
                    )
                elif spread[1] > 0.0:
                    u, v = (c + 0.5) / side, (r + 0.5) / side
                    upper, lower = entry[7] + u * (entry[8] - entry[7]), entry[9] + u * (entry[10] - entry[9])
                    seen[n, 1] = upper + v * (lower - upper)
            # And of the lamps that light it
            middle, normal = (px, py, pz), (nx, ny, nz)
            sides = ax, ay, az, bx, by, bz
            for lamp in range(len(lamps)):
                mine = slots[first[lamp] : first[lamp + 1]], values[first[lamp] : first[lamp + 1]]
                seen[n, 2 + lamp] = _lamp_seen(
                    lamps[lamp], mine, size, clear, middle, normal, sides, rays, fans, scratch
                )


@inlined
def _in_slot(slot: Any, x: Any, y: Any, z: Any) -> Any:
    """Return a point in the projective axes of a lamp's slot; the last number is negative behind the lamp."""
    m = slot[6]
    p = slot[7] * x + slot[8] * y + slot[9] * z + slot[16]
    q = slot[10] * x + slot[11] * y + slot[12] * z + slot[17]
    along = slot[13] * x + slot[14] * y + slot[15] * z + slot[18]
    return (p * m / along, q * m / along, m * m / along) if along > 0.0 else (0.0, 0.0, -1.0)


@borrowing
def _lamp_seen(
    lamp: Any,
    mine: Any,
    size: Any,
    clear: Any,
    middle: Any,
    normal: Any,
    sides: Any,
    fans_of: Any,
    fans: Any,
    scratch: Any,
) -> Any:
    """Return the visible fraction of a lamp, a mean over a footprint; 1 where the lamp does not light it.

    lamp: of `Visibility.lamps`. mine: its slots and their columns. middle, sides: of the footprint.
    """
    slots, values = mine
    near, _, rays, blocked = scratch
    x, y, z = middle
    ax, ay, az, bx, by, bz = sides
    away_x, away_y, away_z = lamp[0] - x, lamp[1] - y, lamp[2] - z
    apart = max(math.sqrt(away_x * away_x + away_y * away_y + away_z * away_z), lamp[8])
    cosine = -(away_x * lamp[4] + away_y * lamp[5] + away_z * lamp[6]) / apart
    if normal[0] * away_x + normal[1] * away_y + normal[2] * away_z <= 0.0 or -1.0 < lamp[7] >= cosine:
        return 1.0
    # Keep the bodies that may hide part of it from part of a ball about the footprint
    radius = 0.5 * (math.sqrt(ax * ax + ay * ay + az * az) + math.sqrt(bx * bx + by * by + bz * bz))
    found = 0
    for body in range(len(slots)):
        slot = slots[body]
        p, q, along = _in_slot(slot, x, y, z)
        scale = along / slot[6]
        above = slot[5] - along + radius * scale * scale
        beside = max(abs(p - slot[0]) - slot[2], abs(q - slot[1]) - slot[3])
        if along > 0.0 and above > 0.0 and beside <= lamp[3] / slot[6] * above + 2.0 * radius * scale:
            near[found] = body
            found += 1
    if found == 0:
        return 1.0
    # Trace the rays of a disc, or one towards a point
    number = ALL_RAYS if lamp[3] > 0.0 else ONE_RAY
    fan, numbers, total = fans_of[number], fans[number], int(fans[number, 0])
    across_x, across_y, across_z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    facing = abs(across_x * away_x + across_y * away_y + across_z * away_z)
    far = max(math.sqrt(away_x * away_x + away_y * away_y + away_z * away_z), 1e-9)
    grain = numbers[2] * math.sqrt(facing / far)
    for k in range(total):
        blocked[k] = 0.0
    for n in range(found):
        slot = slots[near[n]]
        spread = lamp[3] / slot[6]
        for k in range(total):
            p, q = fan[k, 2], fan[k, 3]
            ray = rays[k]
            ray[0], ray[1], ray[2] = _in_slot(slot, x + p * ax + q * bx, y + p * ay + q * by, z + p * az + q * bz)
            ray[3], ray[4] = spread * fan[k, 0], spread * fan[k, 1]
            ray[5] = 1.0 / max(math.sqrt(ray[3] * ray[3] + ray[4] * ray[4]), 1e-6)
            ray[6], ray[7] = grain * ray[2] / slot[6], spread * numbers[3]
        _trace(values[near[n]], slot, size, clear, 0, total, scratch)
    hidden = 0.0
    for k in range(total):
        hidden += blocked[k]
    return 1.0 - hidden / total
