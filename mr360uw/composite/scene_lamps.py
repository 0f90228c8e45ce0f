# SPDX-License-Identifier: Apache-2.0
"""Lamps of a scene: intensity from the `[[lamp]]` tables, and placement at a time for a shot.

    I = flux/solid angle        intensity = I color/white

with the flux in lumen, the solid angle that of the cone with its soft edge, and white the luminance [cd/m2] of the
plate's white. A white card under a lamp then has its true brightness relative to the plate.

Its colour, its flux, and how fast water takes it away:

    S(T)   spectrum of a black body of temperature T (Planck 1901)        K = 683 lm/W  V S/S over 400 to 700 nm

A lamp's own spectrum, not the daylight of its depth, decides what water leaves of it. V is the luminosity function of
the CIE 1931 observer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.composite.motion import Motion, lamp_motion, rigid
from mr360uw.composite.settings import LampSettings
from mr360uw.composite.shot import PlacedObject
from mr360uw.medium.lookup import DEPTH_SIZE, lengths
from mr360uw.medium.medium import DEFAULT_BANDS, Medium
from mr360uw.medium.spectra import DEFAULT_ILLUMINANT, illuminant
from mr360uw.medium.wavelengths import Bands, bands
from mr360uw.types import Floats, Lamp, View

_EDGE = 0.3
"""Fraction of a cone's half angle over which its light fades. Twice as much: the beam has hardly a core."""
_DEFAULT_LUMEN = 2000.0
"""Flux of a typical diver's video light [lm], if a scene gives none."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneLamp:
    """A lamp of a scene. intensity: (3,) along its axis, attenuation: (D, 3) or None, as in `types.Lamp`."""

    settings: LampSettings
    motion: Motion
    intensity: Floats
    attenuation: Floats | None

    @property
    def moves(self) -> bool:
        """Whether it moves in the world."""
        return self.motion.moves or self.settings.attach != "world"

    def at(self, time_s: float, view: View, objects: Sequence[PlacedObject]) -> Lamp:
        """Return the lamp at a time. view: of the camera. objects: of the scene, at the same time."""
        place = self.motion.at(time_s)
        if self.settings.attach == "camera":
            place = rigid(view.position, view.world_from_camera) @ place
        elif self.settings.attach != "world":
            place = objects[self.settings.attach].world_from_object @ place
        axis, of_lamp = -place[:3, 2] / np.linalg.norm(place[:3, 2]), self.settings
        return Lamp(
            place[:3, 3], axis, self.intensity, *cone_cosines(of_lamp), of_lamp.radius_m, self.attenuation,
            of_lamp.casts_shadow,
        )  # fmt: skip


def load_lamps(
    all_settings: Sequence[LampSettings], medium: Medium | None, white_cd_m2: float
) -> tuple[SceneLamp, ...]:
    """Return the lamps of a scene. medium: the water they shine in, or None. white_cd_m2: of the plate's white."""
    lamps = []
    for settings in all_settings:
        color = lamp_color(medium, settings.temperature_k) * np.asarray(settings.color)
        cos_core, cos_edge = cone_cosines(settings)
        # the mean of the smooth step over the cosine, and so over solid angle, is 1/2
        angle = 4.0 * np.pi if cos_edge <= -1.0 else 2.0 * np.pi * (1.0 - 0.5 * (cos_core + cos_edge))
        candela = (_DEFAULT_LUMEN if settings.lumen is None else settings.lumen) / float(angle)
        attenuation = None if medium is None else lamp_attenuation(medium, settings.temperature_k)
        lamps.append(SceneLamp(settings, lamp_motion(settings), color * candela / white_cd_m2, attenuation))
    return tuple(lamps)


def cone_cosines(settings: LampSettings) -> tuple[float, float]:
    """Return the cosines of the half angles of a lamp's core and edge; both -1 for a point light."""
    half = np.radians(0.5 * settings.cone_deg)
    if half >= np.pi:
        return -1.0, -1.0
    return float(np.cos(half * (1.0 - _EDGE))), float(np.cos(half))


Array = NDArray[np.float64]

_SECOND_RADIATION_NM_K = 1.438776877e7
"""hc/k (SI 2019)."""


def black_body(wavelength_nm: Array, temperature_k: float) -> Array:
    """Return the spectral radiance (...,) of a black body relative to that at 560 nm."""
    w = np.asarray(wavelength_nm, np.float64)

    def radiance(nm: Array) -> Array:
        return nm**-5.0 / np.expm1(_SECOND_RADIATION_NM_K / (nm * temperature_k))

    return radiance(w) / radiance(np.array(560.0))


def lamp_color(medium: Medium | None, temperature_k: float) -> Array:
    """Return the linear RGB (3,) of a lamp's light before the water, of luminance 1, as the medium's sensor sees it."""
    used, relative = _relative(medium, temperature_k)
    rgb = np.maximum(used.rgb(relative), 0.0)
    return rgb / luminance(rgb)


def lamp_attenuation(medium: Medium, temperature_k: float) -> Array:
    """Return the effective attenuation (T, 3) [1/m] of a lamp's light over paths, as `types.Lamp` says."""
    _, relative = _relative(medium, temperature_k)
    path = np.maximum(lengths(DEPTH_SIZE, medium.length_m), 1e-4 * medium.length_m)[:, None]
    log = np.log(relative)
    start = medium.bands.log_light(log)
    return np.asarray((start - medium.bands.log_light(log - medium.model.extinction * path)) / path)


def _relative(medium: Medium | None, temperature_k: float) -> tuple[Bands, Array]:
    """Return bands, and a lamp's spectrum at them relative to what their white is balanced for."""
    used = bands(DEFAULT_BANDS) if medium is None else medium.bands
    name = DEFAULT_ILLUMINANT if medium is None else medium.illuminant
    return used, black_body(used.wavelength_nm, temperature_k) / illuminant(name)(used.wavelength_nm)
