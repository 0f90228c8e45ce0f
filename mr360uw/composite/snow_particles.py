# SPDX-License-Identifier: Apache-2.0
"""Particles of snow: sizes, places and drift, from the integers of the world's cells and a seed alone.

Every class of size has cubic cells of its own, which rest in the water. A cell's particles are a Poisson process of
rising density: the gaps between arrivals are exponential, and those that arrive before the water's density are there.
So a denser water has the same particles and more. Nothing depends on other frames, on the camera's path or on the
process.

Hash: the finaliser of SplitMix64 (Steele et al. 2014), chained over seed, class, cell and number.

Particles drift, as a closed function of time: current, sinking, and the orbits of the water under waves.

    carried(t) = (U - w up) t        position = mean + offset        mean = rest + carried(t)

    offset along k = sum A H(d) cos(theta)        offset up = sum A V(d) sin(theta)
    theta = k.(x, z) - omega t + phase

with U the current, w the speed at which a class of size sinks, d the depth of the mean place. H and V are those of
linear waves (Lamb 1932): exp(-k d) both in deep water, cosh and sinh of k (h - d) over sinh(k h) on water of depth h.
The orbits are those of the sea's own waves: amplitude, phase and frequency are shared, so a particle just below the
surface rises with it. A sea's `steepness` or `choppiness` shapes its surface; orbits are circles in deep water. Of a
sea of more waves, those of the largest orbits at the camera are taken.

Their size spectrum, its amount from the water's scattering, and the speed at which they sink:

    symbol  meaning                                     unit
    d       diameter                                    m
    q       exponent
    A       of the spectrum dN/dd = A d^-q              m^(q - 4)
    b_p     scattering by particles                     1/m

One power law holds from 1 um to 1 cm. Measured exponents run from 3 in a bloom off Monterey, where they were 2.96 to
3.00 (Jackson et al. 1997), to 4, where every octave of size has the same volume (Sheldon et al. 1972). The default is
that of the particles whose phase function is Petzold's average (Mobley et al. 2002). Particles are taken to scatter
twice their cross-section, which holds for those much larger than a wavelength (van de Hulst 1980). Then

    b_p = 2 (pi/4) A M        M = int d^(2 - q) dd = (d_1^(3 - q) - d_0^(3 - q))/(3 - q), or ln(d_1/d_0) for q = 3

gives A, and A the number of those that are large enough to be seen. The exponent decides: for b_p = 0.1 1/m there are
170, 1600 or 14000 aggregates of at least 0.5 mm in a cubic metre with q = 4, 3.58 or 3. Aggregates from that size on
are called marine snow; they sink at 50 (d/mm)^0.26 m/day (Alldredge & Gotschalk 1988).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.constants import PI
from mr360uw.base.input_files import PARTICLES
from mr360uw.caustics.gerstner import GerstnerSea, Waves
from mr360uw.caustics.settings import Sea
from mr360uw.composite.settings import NEAREST_M, SnowSettings
from mr360uw.errors import ParameterError
from mr360uw.jit import exact, exact_making
from mr360uw.medium.water import Water
from mr360uw.types import Floats

_CELL_M = 0.25
"""Side of the smallest class's cells. Twice as large: fewer cells, more particles in them that are out of reach."""
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


def particles_near(
    classes: Sequence[SizeClass],
    exponent: float,
    seed: int,
    centre: Floats,
    carried: Sequence[Floats],
    reach: tuple[float, float, float],
    margins_m: Sequence[float],
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the particles about a centre (3,), class by class: position (n, 3) [m] in the world, diameter (n,) [m],
    and number (n,) of the class of size.

    carried: (3,) [m] for each class, how far the water has carried it. reach: distances [m] from the centre between
    which particles are wanted, and their ratio to the diameter up to which. margins_m: for each class, what is added at
    both ends for what moves them besides.
    """
    found = []
    for number, (size, moved, margin_m) in enumerate(zip(classes, carried, margins_m, strict=True)):
        at_rest = np.asarray(centre, np.float64) - moved
        places = (
            (np.uint64(seed), number, _CELL_M * 2.0**number), (size.per_m3, size.low_m, size.high_m, 1.0 - exponent),
            at_rest, (*reach, margin_m),
        )  # fmt: skip
        # Refuse too many of a class, by their mean number within reach
        radius_m = margin_m + min(reach[1], reach[2] * size.high_m)
        expected = size.per_m3 * 4.0 / 3.0 * math.pi * radius_m**3
        PARTICLES.check("snow - its density or its range", round(min(expected, 1e18)), ParameterError)
        count = _fill(*places, np.empty((0, 4)))
        rows = np.empty((count, 4))
        _fill(*places, rows)
        rows[:, :3] += moved
        found.append(rows)
    rows = np.concatenate(found)
    of_class = np.repeat(np.arange(len(found), dtype=np.int64), [len(part) for part in found])
    return rows[:, :3], rows[:, 3], of_class


@exact
def _mixed(h: Any) -> Any:
    """Return 64 bits of which each depends on every bit of h."""
    h = (h ^ (h >> _S30)) * _FIRST
    h = (h ^ (h >> _S27)) * _SECOND
    return h ^ (h >> _S31)


@exact
def _uniform(h: Any, number: Any) -> Any:
    """Return the `number`-th random number of a hash, in (0, 1)."""
    bits = _mixed(h + np.uint64(number + 1) * _GOLDEN)
    return (np.float64(bits >> _S11) + 0.5) / 9007199254740992.0


@exact_making
def _fill(cells: Any, sizes: Any, centre: Any, span: Any, rows: Any) -> Any:
    """Write (x, y, z, diameter) of a class's particles into rows (n, 4), as many as fit; return their number.

    cells: the seed, the number of the class, the side of its cells. sizes: the number per cubic metre, the least and
    the greatest diameter, and 1 - exponent, the power of the number above a size. span: least and greatest distance,
    greatest ratio to the diameter, and margin.
    """
    # Bound the cells that hold particles in reach
    (seed, size_class, side), (per_m3, low, high, power), (nearest, farthest, per_diameter, margin) = cells, sizes, span
    nearest, farthest = nearest - margin, farthest + margin
    reach = min(farthest, per_diameter * high + margin)
    first = np.floor((centre - reach) / side).astype(np.int64)
    last = np.floor((centre + reach) / side).astype(np.int64)
    half_diagonal = 0.5 * np.sqrt(3.0) * side
    expected, a, b = per_m3 * side**3, low**power, high**power
    # Walk these cells; numbers of a cell follow from seed, class and place alone
    begin = _mixed(_mixed(seed + _GOLDEN) ^ np.uint64(size_class))
    count = 0
    for ix in range(first[0], last[0] + 1):
        in_x = _mixed(begin ^ np.uint64(ix))
        dx = (ix + 0.5) * side - centre[0]
        for iy in range(first[1], last[1] + 1):
            in_y = _mixed(in_x ^ np.uint64(iy))
            dy = (iy + 0.5) * side - centre[1]
            for iz in range(first[2], last[2] + 1):
                dz = (iz + 0.5) * side - centre[2]
                if dx * dx + dy * dy + dz * dz > (reach + half_diagonal) ** 2:
                    continue
                # Draw its particles as a Poisson process: waiting times until the expected number
                cell = _mixed(in_y ^ np.uint64(iz))
                arrived, number = -np.log(_uniform(cell, 0)), 0
                while arrived < expected:
                    x = (ix + _uniform(cell, 5 * number + 1)) * side
                    y = (iy + _uniform(cell, 5 * number + 2)) * side
                    z = (iz + _uniform(cell, 5 * number + 3)) * side
                    d = (a + _uniform(cell, 5 * number + 4) * (b - a)) ** (1.0 / power)
                    away = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)
                    if away >= nearest and away <= min(farthest, per_diameter * d + margin):
                        if count < len(rows):
                            rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = x, y, z, d
                        count += 1
                    number += 1
                    arrived -= np.log(_uniform(cell, 5 * number))
    return count


MOST_WAVES = 48
"""Most waves of a sea that move particles: those of the largest orbits at the camera."""
_LEAST_ORBIT_M = 2e-5
"""Radius of orbits that are left out: a twentieth of a pixel of 2048 columns at 15 cm."""


def orbiting_waves(sea: Sea, depth_m: float) -> Waves | None:
    """Return the waves of a sea that move the water at a depth by anything to speak of; None where none does."""
    waves = sea.waves if isinstance(sea, GerstnerSea) else sea.waves()
    along, _ = depth_factors(waves, max(depth_m, 0.0), sea.water_depth_m)
    radius = waves.amplitude_m * along
    largest = np.argsort(-radius, kind="stable")[:MOST_WAVES]
    kept = np.sort(largest[radius[largest] >= _LEAST_ORBIT_M])
    return Waves(*(getattr(waves, field.name)[kept] for field in fields(waves))) if len(kept) else None


def largest_offset_m(waves: Waves | None, depth_m: float, water_depth_m: float) -> float:
    """Return a bound of the offset [m] of particles at a depth or below; 0 without waves."""
    if waves is None:
        return 0.0
    along, _ = depth_factors(waves, max(depth_m, 0.0), water_depth_m)
    return float(np.sum(waves.amplitude_m * along))


def offsets_in_waves(
    waves: Waves, water_depth_m: float, time_s: float, mean: Floats, depth_m: Floats, carried_m_s: Floats
) -> tuple[Floats, Floats]:
    """Return the offsets (n, 3) [m] of particles from their mean places (n, 3), and their velocities [m/s].

    depth_m: (n,) of the mean places. carried_m_s: (n, 3) their velocity.
    """
    vector, length = np.ascontiguousarray(waves.wave_vector, np.float64), np.linalg.norm(waves.wave_vector, axis=1)
    turn = np.remainder(waves.phase_rad - waves.angular_frequency * time_s, 2.0 * np.pi)
    offset, velocity = np.zeros(mean.shape), np.zeros(mean.shape)
    arrays = vector, length, waves.amplitude_m, turn, waves.angular_frequency
    places = np.ascontiguousarray(mean), depth_m, np.ascontiguousarray(carried_m_s)
    _add_orbits(arrays, water_depth_m, places, offset, velocity)
    return offset, velocity


def depth_factors(waves: Waves, depth_m: float, water_depth_m: float) -> tuple[Floats, Floats]:
    """Return H and V (n,) of waves at a depth: semi-axes of the orbits over the amplitude at the surface."""
    k = np.linalg.norm(waves.wave_vector, axis=1)
    near, far = np.exp(-k * depth_m), np.exp(-k * (2.0 * water_depth_m - depth_m))
    both = -np.expm1(-2.0 * k * water_depth_m)
    return (near + far) / both, (near - far) / both


@exact_making
def _add_orbits(waves: Any, bottom: Any, places: Any, offset: Any, velocity: Any) -> None:
    """Add the offsets (n, 3) and velocities (n, 3) of `offsets_in_waves`.

    waves: wave vector (w, 2), its length, amplitude, phase at the instant and frequency (w,). places: mean position
    (n, 3), depth (n,) and velocity (n, 3).
    """
    (k, length, amplitude, turn, frequency), (mean, depth, carried) = waves, places
    both = 1.0 - np.exp(-2.0 * length * bottom)
    deepest = np.log(np.maximum(2.0 * amplitude / (both * _LEAST_ORBIT_M), 1.0)) / length
    for i in range(len(mean)):
        d = min(max(depth[i], 0.0), bottom)
        for w in range(len(length)):
            if d > deepest[w]:
                continue
            near, far = np.exp(-length[w] * d), np.exp(-length[w] * (2.0 * bottom - d))
            along = amplitude[w] * (near + far) / (both[w] * length[w])
            up = amplitude[w] * (near - far) / both[w]
            theta = k[w, 0] * mean[i, 0] + k[w, 1] * mean[i, 2] + turn[w]
            rate = k[w, 0] * carried[i, 0] + k[w, 1] * carried[i, 2] - frequency[w]
            c, s = np.cos(theta), np.sin(theta)
            offset[i, 0] += k[w, 0] * along * c
            offset[i, 1] += up * s
            offset[i, 2] += k[w, 1] * along * c
            velocity[i, 0] -= k[w, 0] * along * s * rate
            velocity[i, 1] += up * c * rate
            velocity[i, 2] -= k[w, 1] * along * s * rate


SMALLEST_M, LARGEST_M = 1e-6, 1e-2
"""Diameters between which the power law is taken to hold (Jackson et al. 1997)."""
EFFICIENCY = 2.0
"""Scattering over geometric cross-section of particles much larger than a wavelength."""
SCATTERING_NM = 550.0
"""Wavelength at which the water's scattering is read."""
LEAST_COVER = 1.0 / 40.0
"""Fraction of a pixel that a particle must cover to be drawn at all, times the transmittance of the water before it; at
twice that it is drawn in full. Particles just above it are hard to tell from the noise of a video. Half as large: two
to three times as many, at as much more time. Those that are too small or too far are a part of the veil."""
_FEWEST, _MOST = 1.0, 5e5
"""Particles of a frame below and above which there is a note."""
_PARTICLE_S = 4e-6
"""Processor time of a particle [s]."""
_SINKING_M_S, _SINKING_POWER = 50.0 / 86400.0, 0.26
"""Speed of an aggregate of 1 mm, and its exponent over the diameter."""


@dataclass(frozen=True, slots=True)
class SizeClass:
    """Particles of about one octave of size. low_m, high_m: diameters. per_m3: number. sinking_m_s: downwards."""

    low_m: float
    high_m: float
    per_m3: float
    sinking_m_s: float


def particle_scattering(water: Water) -> float:
    """Return the scattering [1/m] by the particles of a water at `SCATTERING_NM`, without that by molecules."""
    nm = np.array([SCATTERING_NM])
    molecules = 0.0 if water.molecular is None else float(np.asarray(water.molecular(nm))[0])
    return max(float(np.asarray(water.scattering(nm))[0]) - molecules, 0.0)


def number_between(low_m: float, high_m: float, exponent: float, scattering: float) -> float:
    """Return the number of particles [1/m^3] with diameters between two. scattering: by all particles [1/m]."""
    scale = scattering / (EFFICIENCY * 0.25 * PI * _integral(SMALLEST_M, LARGEST_M, 2.0 - exponent))
    return scale * _integral(low_m, high_m, -exponent)


def size_classes(settings: SnowSettings, scattering: float) -> tuple[SizeClass, ...]:
    """Return the classes of a scene's particles, from the smallest on. scattering: by the water's particles [1/m]."""
    smallest, largest = (1e-3 * size for size in settings.sizes_mm)
    count = max(math.ceil(math.log2(largest / smallest) - 1e-9), 1)
    classes = []
    for number in range(count):
        low, high = smallest * 2.0**number, min(smallest * 2.0 ** (number + 1), largest)
        per_m3 = settings.amount * number_between(low, high, settings.exponent, scattering)
        middle_mm = 1e3 * math.sqrt(low * high)
        classes.append(SizeClass(low, high, per_m3, _SINKING_M_S * middle_mm**_SINKING_POWER))
    return tuple(classes)


def seen_up_to(height: int) -> float:
    """Return the distance over the diameter of a particle that covers `LEAST_COVER` of a pixel of a frame's height."""
    return math.sqrt(0.25 * PI / LEAST_COVER) * height / PI


def number_drawn(settings: SnowSettings, scattering: float, height: int) -> float:
    """Return about how many particles a frame of a height [pixels] shows in clear water.

    Those of a class up to where one of its middle size covers `LEAST_COVER` of a pixel. scattering: see `size_classes`.
    """
    number = 0.0
    for size in size_classes(settings, scattering):
        reach = min(settings.range_m, seen_up_to(height) * math.sqrt(size.low_m * size.high_m))
        number += size.per_m3 * 4.0 / 3.0 * PI * max(reach**3 - NEAREST_M**3, 0.0)
    return number


def note_on(settings: SnowSettings, water: Water, height: int) -> str:
    """Return a line on snow that frames of `height` rows do not show or that takes them seconds, "" for other snow."""
    number = number_drawn(settings, particle_scattering(water), height)
    if 0.0 < number < _FEWEST:
        return f"snow - a frame shows none (got {number:.2g} particles large enough to see) - raise snow.amount"
    if number > _MOST:
        took = f"got {number:.2g} particles, up to {number * _PARTICLE_S:.0f} s a frame"
        return f"snow - is dense ({took}) - lower snow.amount or snow.range_m, or raise the first of snow.sizes_mm"
    return ""


def in_words(settings: SnowSettings, water: Water) -> tuple[bool, str]:
    """Return whether a water has any snow to draw, and its number, or why there is none, as the plan shows it."""
    per_m3 = sum(size.per_m3 for size in size_classes(settings, particle_scattering(water)))
    if per_m3 <= 0.0:
        return False, "the water has no particles that scatter"
    near, far, ball = NEAREST_M, settings.range_m, 4.0 / 3.0 * PI
    within = ball * (far**3 - near**3) * per_m3
    return True, (
        f"{per_m3:.3g} particles of {settings.sizes_mm[0]:g} to {settings.sizes_mm[1]:g} mm in a cubic metre, from the "
        f"water's scattering; {within:.2g} within {far:g} m, of which those that a pixel shows are drawn"
    )


def _integral(low: float, high: float, power: float) -> float:
    """Return the integral of x^power between two positive numbers."""
    if abs(power + 1.0) < 1e-9:
        return math.log(high / low)
    return (high ** (power + 1.0) - low ** (power + 1.0)) / (power + 1.0)
