# SPDX-License-Identifier: Apache-2.0
"""Frames of a synthetic 360 dive: the sea surface from below, water, and a sandy floor under caustics.

Above: the sky through Snell's window of a moving surface, with the sun's glitter, and total reflection around it.
Below: sand. In between: the water of `mr360uw.medium`. Units: the irradiance just below the surface.

Light that the water scatters by small angles is part of the window's image, but some of it leaves the window and is
part of the field outside it as well. The window's sky and veil take the factor that conserves energy:

    2 pi int_0^1 L(up) up dup = E - E_beam      at the camera, without the sun, through a flat surface
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustic_lookup import mip_level, mip_levels
from mr360uw.caustics import caustic_stack
from mr360uw.caustics.settings import CausticSettings
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.medium.models import window_share
from mr360uw.optics import fresnel_from_below, fresnel_transmittance, refract_clamped, refract_to_water
from mr360uw.sample.dive_light import SKY_COLOR, DiveLight
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.sand import SAND_TILE_M, sand_albedo
from mr360uw.sphere import directions
from mr360uw.types import Floats

_GLOW_RAD = 0.035
"""Angular radius [rad] over which forward scattering spreads the sun's disc in a few metres of water. Twice as large,
the glitter is a quarter as bright and clips less."""
_LEVEL_BRIGHTNESS, _SKY_BRIGHTNESS = 0.035, 0.7
"""Most light of the water at the horizon and of the sky overhead after exposure, 1 = white: in clear water a camera
exposes for the sky, and only the sun's glitter clips."""
_CAUSTICS = CausticSettings(size=512, grid=192)
_LEAST_SEA_SIZE = 512
"""Least number of normals across the sea's tile; larger frames use their number of rows, about one normal a pixel."""
_MIRRORED = 512
"""Directions at which the light that the surface mirrors is tabulated, over the lower half of the sphere."""
_FLUX_NODES = 400
"""Directions over which the window's flux is summed: 0.1 % of it."""
_SMALLEST_WAVE_M = 0.25
"""Width [m] of a pixel's footprint on the surface beyond which wave slopes are averaged out, in proportion."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorShade:
    """Light that a body leaves on the floor, each (H/2, W) for the rows below the horizon, 0 to 1.

    ambient: fraction of the ambient light. disc: visible fraction of the sun's disc. halo: of the wider disc from which
    light arrives that the water has scattered forwards.
    """

    ambient: Floats
    disc: Floats
    halo: Floats


class DivePlate:
    """Renders the plate's frames; what does not move is computed once.

    The camera is level, so the water between it and what it sees is the same all along a row. exposure: factor of the
    picture on radiance, per unit irradiance just below the surface. level_radiance: (3,) of
    the water at the horizon, after exposure. floor_irradiance: (3,) mean on the floor over that just below the surface.
    albedo: (H/2, W, 3) of the sand in the lower half of the first frame.
    """

    def __init__(self, settings: DiveSettings, width: int, height: int) -> None:
        self._settings = settings
        camera, floor, sea = settings.camera_depth_m, settings.floor_depth_m, settings.sea
        self._sun_in_water = refract_to_water(settings.sun_in_air)
        self._light = DiveLight(settings.water, camera, float(self._sun_in_water[1]))
        # radiances in air that bring these shares through a flat surface
        cosine, high = (np.arange(64) + 0.5) / 64, settings.sun_in_air[1]
        passed = fresnel_transmittance(cosine, REFRACTIVE_INDEX_SEA)
        self._sky = SKY_COLOR / (2.0 * np.pi * np.mean(_sky_shape(cosine) * cosine * passed))
        passed = fresnel_transmittance(high, REFRACTIVE_INDEX_SEA)
        self._glow = (1.0 - SKY_COLOR) / (2.0 * np.pi * _GLOW_RAD**2 * high * passed)
        window_factor = self._window_factor(camera)
        self._sky = self._sky * window_factor
        view = directions(width, height)
        up = view[:, :1, 1]
        distance = np.where(up > 0.0, camera, camera - floor) / up
        footprint = distance * (np.pi / height) / np.sqrt(np.maximum(np.abs(up), 1e-3))
        level = self._light.veil(np.array(1e6), np.array(0.0))
        straight_up = np.array(camera), np.array(1.0)
        window = REFRACTIVE_INDEX_SEA**2 * (1.0 - fresnel_from_below(1.0, REFRACTIVE_INDEX_SEA)) * self._sky
        zenith = self._light.transmittance(*straight_up) * window * _sky_shape(1.0)
        zenith = zenith + window_factor * self._light.veil(*straight_up)
        self.exposure = min(_LEVEL_BRIGHTNESS / float(np.mean(level)), _SKY_BRIGHTNESS / float(np.max(zenith)))
        self.level_radiance = self.exposure * level
        self.floor_irradiance, self._patterned = self._light.irradiance(floor), self._light.patterned(floor)
        inside = window_share(up, REFRACTIVE_INDEX_SEA)[..., None]
        veil = self._light.veil(distance, up) * (1.0 + (window_factor - 1.0) * inside)
        self._veil = (self.exposure * veil).astype(np.float32)
        self._transmittance = (self.exposure * self._light.transmittance(distance, up)).astype(np.float32)

        above, below = slice(height // 2), slice(height // 2, height)
        x, z = distance * view[..., 0], distance * view[..., 2]
        self._view = view[above].astype(np.float32)
        self._sea_size = max(height, _LEAST_SEA_SIZE)
        self._sea_at = np.stack([x[above], z[above]]) / sea.tile_m
        # far away a pixel holds many waves, whose slopes average out
        self._fade = np.clip(_SMALLEST_WAVE_M / footprint[above, :, None], 0.0, 1.0).astype(np.float32)

        self._floor_footprint = footprint[below, 0]
        along_beam = floor / self._sun_in_water[1] * self._sun_in_water
        self._caustics_at = np.stack([x[below] + along_beam[0], z[below] + along_beam[2]]) / sea.tile_m
        self._sand = [level[0].astype(np.float32) for level in mip_levels(_sand(settings)[None])]
        self._sand_at = np.stack([x[below], z[below]]) / SAND_TILE_M
        self.albedo = _read(self._sand, self._sand_at, self._floor_footprint / SAND_TILE_M)
        self._mirrored_up = np.linspace(-1.0, 0.0, _MIRRORED)
        self._mirrored = self._light.veil(np.full(_MIRRORED, 1e6), self._mirrored_up)

    def radiance(self, time_s: float, shade: FloorShade | None = None) -> NDArray[np.float32]:
        """Return the frame (H, W, 3) in linear light, exposed; values above 1 clip in the recording.

        shade: of a body on the floor, which the frame does not show itself.
        """
        image = np.concatenate([self._surface(time_s), self._floor(time_s, shade)])
        return self._transmittance * image + self._veil

    def irradiance(self, depth_m: float) -> tuple[Floats, Floats]:
        """Return the ambient irradiance (3,) on a level plane at a depth, and the beam's (3,) perpendicular to itself.

        Both are relative to the downwelling irradiance just below the surface.
        """
        beam = self._light.beam(depth_m)
        return self._light.irradiance(depth_m) - beam, beam / self._sun_in_water[1]

    def _window_factor(self, camera_m: float) -> Floats:
        """Return the factor (3,) on sky and veil in Snell's window: see the module's docstring."""
        up = (np.arange(_FLUX_NODES) + 0.5) / _FLUX_NODES
        veil, share = self._light.veil(camera_m / up, up), window_share(up, REFRACTIVE_INDEX_SEA)[:, None]
        passed = 1.0 - fresnel_from_below(up, REFRACTIVE_INDEX_SEA)
        air_up = np.sqrt(np.maximum(1.0 - REFRACTIVE_INDEX_SEA**2 * (1.0 - up**2), 0.0))
        sky = REFRACTIVE_INDEX_SEA**2 * (passed * _sky_shape(air_up))[:, None] * self._sky
        mirrored = (1.0 - passed)[:, None] * self._light.veil(np.full_like(up, 1e6), -up)
        image = self._light.transmittance(camera_m / up, up)
        flux = 2.0 * np.pi / _FLUX_NODES * up[:, None]
        ambient = self._light.irradiance(camera_m) - self._light.beam(camera_m)
        outside = np.sum(flux * ((1.0 - share) * veil + image * mirrored), axis=0)
        return np.asarray((ambient - outside) / np.sum(flux * (share * veil + image * sky), axis=0))

    def _floor(self, time_s: float, shade: FloorShade | None) -> NDArray[np.float32]:
        depth, offset = self._settings.floor_depth_m, self._offset(time_s)
        sea, sun = self._settings.sea, self._settings.sun_in_air
        stack = caustic_stack(sea, sun, np.array([depth]), time_s, _CAUSTICS, spread=self._light.spread)
        at = self._caustics_at + offset / stack.tile_m

        def pattern_of(maps: Floats) -> NDArray[np.float32]:
            levels = [level[0, ..., 0].astype(np.float32) for level in mip_levels(maps)]
            return _read(levels, at, self._floor_footprint / stack.tile_m)[..., None]

        pattern = pattern_of(stack.ratio)
        soft = np.ones_like(pattern) if stack.soft is None else pattern_of(stack.soft)
        albedo = self.albedo
        if np.any(offset):
            albedo = _read(self._sand, self._sand_at + offset / SAND_TILE_M, self._floor_footprint / SAND_TILE_M)
        beam, moving = self._light.beam(depth), self._patterned.astype(np.float32)
        ambient, scattered = (a.astype(np.float32) for a in (self.floor_irradiance - beam, beam - self._patterned))
        if shade is None:
            irradiance = ambient + scattered * soft + moving * pattern
        else:
            free, disc, halo = (a[..., None].astype(np.float32) for a in (shade.ambient, shade.disc, shade.halo))
            irradiance = free * ambient + halo * scattered * soft + disc * moving * pattern
        return albedo / np.float32(np.pi) * irradiance

    def _offset(self, time_s: float) -> Floats:
        """Camera's place (2, 1, 1) [m] over x and z."""
        return self._settings.camera_at(time_s)[[0, 2], None, None]

    def _surface(self, time_s: float) -> NDArray[np.float32]:
        """Radiance that comes down from the surface: refracted sky and sun, or the deep water it mirrors."""
        view, eta = self._view, REFRACTIVE_INDEX_SEA
        waves = self._settings.sea.grid_surface(self._sea_size, time_s).normal.astype(np.float32)
        at = self._sea_at + self._offset(time_s) / self._settings.sea.tile_m
        normal = _wrapped(waves, at * self._sea_size) * self._fade
        normal[..., 1:2] += 1.0 - self._fade
        normal /= np.sqrt(_dot(normal, normal))[..., None]
        cosine = np.maximum(_dot(view, normal), 1e-6)
        air = refract_clamped(view, -normal, eta)
        transmitted = 1.0 - fresnel_from_below(cosine, eta)
        sky = _sky_shape(np.clip(air[..., 1], 0.0, 1.0))
        angle = np.arccos(np.clip(air @ self._settings.sun_in_air.astype(np.float32), -1.0, 1.0))
        glow = np.exp(-angle / _GLOW_RAD)
        mirrored_up = view[..., 1] - 2.0 * cosine * normal[..., 1]
        image = np.empty_like(view)
        for k in range(3):
            mirrored = np.interp(mirrored_up, self._mirrored_up, self._mirrored[:, k])
            image[..., k] = eta**2 * (self._sky[k] * sky + self._glow[k] * glow) * transmitted + mirrored * (
                1.0 - transmitted
            )
        return image


def _sand(settings: DiveSettings) -> Floats:
    """Return the albedo (size, size, 3) of a tile of sand."""
    albedo = sand_albedo(settings.seed)
    even = albedo.mean(axis=(0, 1))
    return np.asarray(np.maximum(even + settings.sand_contrast * (albedo - even), 0.02))


def _sky_shape(up: Floats | float) -> Floats:
    """Return the relative radiance of a clear sky at a sine of elevation, brightest overhead."""
    return np.asarray(3.0 + 4.0 * up)


def _dot(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the scalar products (...,) of vectors (..., 3)."""
    return np.einsum("...k,...k", a, b)


def _wrapped(image: NDArray[np.float32], at: Floats) -> NDArray[np.float32]:
    """Return a periodic image (size, size, ...) at (column, row) coordinates (2, H, W), bilinear between its pixels."""
    import cv2

    column, row = np.remainder(at, len(image)).astype(np.float32)
    return cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def _read(levels: list[NDArray[np.float32]], at: Floats, footprint: Floats) -> NDArray[np.float32]:
    """Return mip levels (size, size, ...) of a tile at places (2, H, W) with a footprint of each row (H,), in tiles."""
    level = mip_level(footprint, 1.0 / len(levels[0]), len(levels) - 1.0)
    image = np.zeros((*at.shape[1:], *levels[0].shape[2:]), np.float32)
    for k, texels in enumerate(levels):
        weight = np.maximum(1.0 - np.abs(level - k), 0.0).astype(np.float32)
        rows = np.flatnonzero(weight)
        if len(rows):
            value = _wrapped(texels, at[:, rows] * len(texels) - 0.5)
            image[rows] += value * weight[rows].reshape(-1, *[1] * (value.ndim - 1))
    return image
