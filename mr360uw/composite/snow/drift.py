# SPDX-License-Identifier: Apache-2.0
"""Drift of particles, as a closed function of time: current, sinking, and the orbits of the water under waves.

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

from dataclasses import dataclass
from typing import Any

import numpy as np

from mr360uw.caustics.sea.gerstner import GerstnerSea, Waves
from mr360uw.caustics.settings import Sea
from mr360uw.jit import exact
from mr360uw.types import Floats

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
        _add_orbits(
            np.ascontiguousarray(waves.wave_vector, np.float64), length, waves.amplitude_m, turn,
            waves.angular_frequency, self.water_depth_m, np.ascontiguousarray(mean), surface_y_m - mean[:, 1],
            np.ascontiguousarray(carried_m_s), offset, velocity,
        )  # fmt: skip
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
def _add_orbits(
    k: Any, length: Any, amplitude: Any, turn: Any, frequency: Any, bottom: Any, mean: Any, depth: Any, carried: Any,
    offset: Any, velocity: Any,
) -> None:  # fmt: skip
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
