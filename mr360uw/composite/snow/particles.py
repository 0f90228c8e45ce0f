# SPDX-License-Identifier: Apache-2.0
"""Places, sizes and drift of particles, from the integers of the world's cells and a seed alone.

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
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustics.sea.gerstner import GerstnerSea, Waves
from mr360uw.caustics.settings import Sea
from mr360uw.composite.snow.size_spectrum import SizeClass
from mr360uw.errors import ParameterError
from mr360uw.jit import exact
from mr360uw.reading.limits import PARTICLES
from mr360uw.types import Floats

_CELL_M = 0.25
"""Side of the smallest class's cells. Twice as large: fewer cells, more particles in them that are out of reach."""
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Distances [m] from a centre between which particles are wanted; those of diameter d up to `per_diameter` d.

    margin_m: that is added at both ends, for what moves them besides.
    """

    nearest_m: float
    farthest_m: float
    per_diameter: float
    margin_m: float = 0.0


def particles_near(
    classes: Sequence[SizeClass],
    exponent: float,
    seed: int,
    centre: Floats,
    carried: Sequence[Floats],
    reaches: Sequence[Reach],
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the particles about a centre (3,), class by class: position (n, 3) [m] in the world, diameter (n,) [m],
    and number (n,) of the class of size.

    carried: (3,) [m] for each class, how far the water has carried it. reaches: for each class.
    """
    found = []
    for number, (size, moved, reach) in enumerate(zip(classes, carried, reaches, strict=True)):
        at_rest = np.asarray(centre, np.float64) - moved
        places = (
            (np.uint64(seed), number, _CELL_M * 2.0**number), (size.per_m3, size.low_m, size.high_m, 1.0 - exponent),
            at_rest, (reach.nearest_m, reach.farthest_m, reach.per_diameter, reach.margin_m),
        )  # fmt: skip
        _check_number(size, reach)
        count = _fill(*places, np.empty((0, 4)))
        rows = np.empty((count, 4))
        _fill(*places, rows)
        rows[:, :3] += moved
        found.append(rows)
    rows = np.concatenate(found)
    of_class = np.repeat(np.arange(len(found), dtype=np.int64), [len(part) for part in found])
    return rows[:, :3], rows[:, 3], of_class


def _check_number(size: SizeClass, reach: Reach) -> None:
    """Raise `ParameterError` where there are too many particles of a class, by their mean number within reach."""
    radius_m = min(reach.farthest_m + reach.margin_m, reach.per_diameter * size.high_m + reach.margin_m)
    expected = size.per_m3 * 4.0 / 3.0 * math.pi * radius_m**3
    PARTICLES.check("snow - its density or its range", round(min(expected, 1e18)), ParameterError)


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


@exact
def _fill(cells: Any, sizes: Any, centre: Any, span: Any, rows: Any) -> Any:
    """Write (x, y, z, diameter) of a class's particles into rows (n, 4), as many as fit; return their number.

    cells: the seed, the number of the class, the side of its cells. sizes: the number per cubic metre, the least and
    the greatest diameter, and 1 - exponent, the power of the number above a size. span: as `Reach`.
    """
    (seed, size_class, side), (per_m3, low, high, power), (nearest, farthest, per_diameter, margin) = cells, sizes, span
    nearest, farthest = nearest - margin, farthest + margin
    reach = min(farthest, per_diameter * high + margin)
    first = np.floor((centre - reach) / side).astype(np.int64)
    last = np.floor((centre + reach) / side).astype(np.int64)
    half_diagonal = 0.5 * np.sqrt(3.0) * side
    expected, a, b = per_m3 * side**3, low**power, high**power
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


@dataclass(frozen=True, slots=True, eq=False)
class Orbits:
    """Waves that move particles. waves: see `Waves`. water_depth_m: of the bottom."""

    waves: Waves
    water_depth_m: float

    def reach_m(self, depth_m: float) -> float:
        """Return a bound of the offset [m] of particles at a depth or below."""
        along, _ = depth_factors(self.waves, max(depth_m, 0.0), self.water_depth_m)
        return float(np.sum(self.waves.amplitude_m * along))

    def at(self, mean: Floats, surface_y_m: float, time_s: float, carried_m_s: Floats) -> tuple[Floats, Floats]:
        """Return the offsets (n, 3) [m] of particles from their mean places (n, 3), and their velocities [m/s].

        carried_m_s: (n, 3) velocity of the mean places.
        """
        waves = self.waves
        length = np.linalg.norm(waves.wave_vector, axis=1)
        turn = np.remainder(waves.phase_rad - waves.angular_frequency * time_s, 2.0 * np.pi)
        offset, velocity = np.zeros(mean.shape), np.zeros(mean.shape)
        arrays = (
            np.ascontiguousarray(waves.wave_vector, np.float64),
            length,
            waves.amplitude_m,
            turn,
            waves.angular_frequency,
        )
        places = np.ascontiguousarray(mean), surface_y_m - mean[:, 1], np.ascontiguousarray(carried_m_s)
        _add_orbits(arrays, self.water_depth_m, places, offset, velocity)
        return offset, velocity


def orbits_of(sea: Sea, depth_m: float) -> Orbits | None:
    """Return the waves of a sea that move the water at a depth by anything to speak of; None where none does."""
    waves = sea.waves if isinstance(sea, GerstnerSea) else sea.waves()
    along, _ = depth_factors(waves, max(depth_m, 0.0), sea.water_depth_m)
    radius = waves.amplitude_m * along
    largest = np.argsort(-radius, kind="stable")[:MOST_WAVES]
    kept = np.sort(largest[radius[largest] >= _LEAST_ORBIT_M])
    if len(kept) == 0:
        return None
    return Orbits(
        Waves(
            waves.wave_vector[kept], waves.amplitude_m[kept], waves.steepness[kept], waves.phase_rad[kept],
            waves.angular_frequency[kept],
        ),
        sea.water_depth_m,
    )  # fmt: skip


def depth_factors(waves: Waves, depth_m: float, water_depth_m: float) -> tuple[Floats, Floats]:
    """Return H and V (n,) of waves at a depth: semi-axes of the orbits over the amplitude at the surface."""
    k = np.linalg.norm(waves.wave_vector, axis=1)
    near, far = np.exp(-k * depth_m), np.exp(-k * (2.0 * water_depth_m - depth_m))
    both = -np.expm1(-2.0 * k * water_depth_m)
    return (near + far) / both, (near - far) / both


@exact
def _add_orbits(waves: Any, bottom: Any, places: Any, offset: Any, velocity: Any) -> None:
    """Add the offsets (n, 3) and velocities (n, 3) of `Orbits.at`.

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
