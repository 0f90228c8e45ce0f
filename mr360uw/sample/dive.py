# SPDX-License-Identifier: Apache-2.0
"""A synthetic 360 dive whose sun, sea, water and depth are known.

Above: the sky through Snell's window of a moving surface, with the sun's glitter, and total reflection around it.
Below: sand under caustics. In between: the water. Units: the irradiance just below the surface.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from mr360uw.caustics import GerstnerSea, caustic_stack, fresnel_reflectance, refract_to_water
from mr360uw.caustics.lookup import caustic_lookup, mip_levels, periodic_trilinear
from mr360uw.caustics.settings import CausticSettings
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.files import write_whole
from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup, unscattered_share, veil_lookup
from mr360uw.medium.sensor import named_sensor
from mr360uw.progress import Progress
from mr360uw.sample.whale import write_whale
from mr360uw.sphere import direction_from_angles, directions
from mr360uw.types import Floats

_SUN_SHARE = 0.7
"""Part of the downwelling irradiance that is the sun's beam, a clear sky with the sun high."""
_GLOW_RAD = 0.035
"""Angular radius over which forward scattering spreads the sun's disc in a few metres of water."""
_SENSOR = "CIE 1931"
"""Who looks at the plate: its code values are colours, not a raw picture."""
_LEVEL_BRIGHTNESS = 0.035
"""Luminance the exposure gives the level water."""
_CAUSTICS = CausticSettings(size=512, grid=192)
_SAND_TILE_M = 6.0
_SAND_SIZE = 512


@dataclass(frozen=True, slots=True)
class SampleDive:
    """The files of a sample dive. truth: JSON with the sun's directions, the sea, the water and the depths."""

    plate: Path
    mesh: Path
    scene: Path
    truth: Path


@dataclass(frozen=True, slots=True)
class DiveSettings:
    """What the dive looks like; depths below the mean surface [m], angles of the sun above the surface [rad]."""

    camera_depth_m: float = 4.0
    floor_depth_m: float = 7.5
    water: str = "IB"
    sun_azimuth_rad: float = 0.6
    sun_elevation_rad: float = 1.0
    seed: int = 1

    @property
    def sun_in_air(self) -> Floats:
        """Unit direction towards the sun, above the surface."""
        return direction_from_angles(self.sun_azimuth_rad, self.sun_elevation_rad)

    @property
    def sea(self) -> GerstnerSea:
        """The surface of the dive."""
        return GerstnerSea(wind_speed=3.0, wind_direction_deg=35.0, tile_m=16.0, seed=self.seed)


class DivePlate:
    """Renders the plate's frames; what does not move is computed once."""

    def __init__(self, settings: DiveSettings, width: int, height: int) -> None:
        self._settings = settings
        sensor = named_sensor(_SENSOR)
        self._table = Medium(Water.jerlov(settings.water), sensor, camera_depth_m=settings.camera_depth_m).table
        self._view = directions(width, height)
        up = self._view[..., 1]
        camera = settings.camera_depth_m
        with np.errstate(divide="ignore"):
            distance = np.where(up > 0.0, camera / up, (camera - settings.floor_depth_m) / up)
        distance = np.where(np.isfinite(distance), distance, 1e6)
        self._distance, self._down = distance, up < 0.0
        self._transmittance = transmittance_lookup(self._table, distance, up)
        self._veil = veil_lookup(self._table, distance, up)
        self._footprint = distance * (np.pi / height) / np.sqrt(np.maximum(np.abs(up), 1e-3))
        level = np.abs(up) < 0.05
        self._exposure = _LEVEL_BRIGHTNESS / float(np.mean(self._veil[level]))
        self._sand = mip_levels(_sand(settings.seed)[None])
        self._sun_in_water = refract_to_water(settings.sun_in_air)

    def radiance(self, time_s: float) -> Floats:
        """Return the frame (H, W, 3) in linear light, exposed; values above 1 clip in the recording."""
        image = np.empty((*self._distance.shape, 3))
        image[self._down] = self._floor(time_s)
        image[~self._down] = self._surface(time_s)
        return self._exposure * (self._transmittance * image + self._veil)

    def _beam(self, depth_m: float) -> Floats:
        """Sun's irradiance (3,) perpendicular to its beam in the water."""
        up = float(self._sun_in_water[1])
        at = beam_ratio(self._table, depth_m, up) / beam_ratio(self._table, 0.0, up)
        return at * (_SUN_SHARE / up)

    def _floor(self, time_s: float) -> Floats:
        here, depth = self._down, self._settings.floor_depth_m
        x, z = (self._distance[here] * self._view[here][:, k] for k in (0, 2))
        footprint = self._footprint[here]
        stack = caustic_stack(self._settings.sea, self._settings.sun_in_air, np.array([depth]), time_s, _CAUSTICS)
        pattern = caustic_lookup(stack, mip_levels(stack.ratio), x, np.full_like(x, depth), z, footprint)
        up = float(self._sun_in_water[1])
        contrast = unscattered_share(self._table, depth, up)
        ambient = (1.0 - _SUN_SHARE) * ambient_ratio(self._table, depth) / ambient_ratio(self._table, 0.0)
        irradiance = ambient + self._beam(depth) * up * (1.0 + (pattern - 1.0) * contrast)
        texel = _SAND_TILE_M / _SAND_SIZE
        level = np.clip(np.log2(np.maximum(footprint / texel, 1.0)), 0.0, len(self._sand) - 1.0)
        plane = np.zeros(x.shape, np.int64)
        albedo = periodic_trilinear(self._sand, plane, x / _SAND_TILE_M, z / _SAND_TILE_M, level)
        return albedo / np.pi * irradiance

    def _surface(self, time_s: float) -> Floats:
        """Radiance that comes down from the surface: refracted sky and sun, or the deep water it mirrors."""
        here = ~self._down
        view = self._view[here]
        x, z = (self._distance[here] * view[:, k] for k in (0, 2))
        normal = self._settings.sea.surface(x, z, time_s).normal
        # far away a pixel holds many waves, whose slopes average out
        fade = np.clip(0.25 / self._footprint[here], 0.0, 1.0)[:, None]
        normal = normal * fade + np.array([0.0, 1.0, 0.0]) * (1.0 - fade)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        cosine = np.maximum(np.sum(view * normal, axis=-1), 1e-6)
        eta = REFRACTIVE_INDEX_SEA
        root = 1.0 - eta**2 * (1.0 - cosine**2)
        air = eta * view + (np.sqrt(np.maximum(root, 0.0)) - eta * cosine)[:, None] * normal
        transmitted = np.where(root > 0.0, 1.0 - fresnel_reflectance(np.sqrt(np.maximum(root, 0.0))), 0.0)
        sky = (1.0 - _SUN_SHARE) / np.pi * (0.6 + 0.8 * np.clip(air[:, 1], 0.0, 1.0))
        blue = np.array([0.80, 1.0, 1.22])
        angle = np.arccos(np.clip(air @ self._settings.sun_in_air, -1.0, 1.0))
        glow = _SUN_SHARE / (2.0 * np.pi * _GLOW_RAD**2) * np.exp(-angle / _GLOW_RAD)
        window = eta**2 * (sky[:, None] * blue + glow[:, None])
        mirrored_up = view[:, 1] - 2.0 * cosine * normal[:, 1]
        mirrored = veil_lookup(self._table, np.full(mirrored_up.shape, 1e6), np.minimum(mirrored_up, 0.0))
        return window * transmitted[:, None] + mirrored * (1.0 - transmitted)[:, None]


def sample_dive(
    folder: str | Path,
    *,
    width: int = 1024,
    frames: int = 48,
    frame_rate: Fraction = Fraction(24),
    settings: DiveSettings | None = None,
    seed: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SampleDive:
    """Make `folder` with a synthetic 360 clip (sound, spherical metadata), a whale, a scene file and the truth.

    width: of the frame, a multiple of 4; the height is half of it. Raises `ParameterError`, `OutputExistsError` or
    `VideoError`; each file appears when it is complete.
    """
    from mr360uw.sample.recording import record
    from mr360uw.template import scene_text

    if width < 64 or width % 4:
        raise ParameterError(f"width - must be a multiple of 4 from 64 up (got {width}) - take 1024 or 2048")
    if frames < 1:
        raise ParameterError(f"frames - must be at least 1 (got {frames}) - take 48")
    settings = settings if settings is not None else DiveSettings(seed=seed)
    folder = Path(folder)
    dive = SampleDive(folder / "dive.mp4", folder / "whale.glb", folder / "scene.toml", folder / "truth.json")
    if not overwrite:
        for path in (dive.plate, dive.mesh, dive.scene, dive.truth):
            if path.exists():
                raise OutputExistsError(f"{path} - is there already - name another folder, or give --overwrite")
    folder.mkdir(parents=True, exist_ok=True)
    write_whale(dive.mesh)
    plate = DivePlate(settings, width, width // 2)

    def images() -> Iterator[Floats]:
        for index in range(frames):
            yield plate.radiance(float(index / frame_rate))
            if progress is not None:
                progress(index + 1, frames)

    record(dive.plate, images(), frame_rate, settings.seed)
    write_whole(dive.truth, json.dumps(_truth(settings), indent=2) + "\n")
    write_whole(dive.scene, scene_text(_scene(settings)))
    return dive


def _scene(settings: DiveSettings) -> dict[str, object]:
    """The keys of a scene that belongs to the dive; everything else stays at its default."""
    return {
        "plate": {"path": "dive.mp4"},
        "camera": {"depth_m": settings.camera_depth_m},
        "water": {"type": settings.water, "sensor": _SENSOR},
        "sea": settings.sea.model_dump(exclude_unset=True),
        "object": [{"mesh": "whale.glb", "position_m": [0.4, -0.6, -3.6], "rotation_deg": [-60.0, 4.0, 0.0]}],
        "receiver": {"height_m": settings.camera_depth_m - settings.floor_depth_m},
    }


def _truth(settings: DiveSettings) -> dict[str, object]:
    return {
        "sun_direction_in_air": settings.sun_in_air.tolist(),
        "sun_direction_in_water": refract_to_water(settings.sun_in_air).tolist(),
        "sun_share_of_surface_irradiance": _SUN_SHARE,
        "camera_depth_m": settings.camera_depth_m,
        "floor_depth_m": settings.floor_depth_m,
        "water": settings.water,
        "sea": settings.sea.model_dump(mode="json"),
    }


def _sand(seed: int) -> Floats:
    """Return a periodic albedo map (size, size, 3) of rippled sand: filtered noise and bent crests."""
    rng = np.random.default_rng((seed, 0x5A4D))
    frequency = np.fft.fftfreq(_SAND_SIZE, 1.0 / _SAND_SIZE)
    radius = np.hypot(frequency[:, None], frequency[None, :])

    def noise(exponent: float, cutoff: float) -> Floats:
        spectrum = np.fft.fft2(rng.normal(size=(_SAND_SIZE, _SAND_SIZE)))
        field = np.fft.ifft2(spectrum * np.exp(-((radius / cutoff) ** 2)) / np.maximum(radius, 1.0) ** exponent).real
        return (field - field.mean()) / field.std()

    across = 2.0 * np.pi * 24.0 * np.arange(_SAND_SIZE) / _SAND_SIZE
    ripples = np.sin(across[:, None] + 1.6 * noise(2.0, 40.0))
    grey = 0.34 + 0.035 * ripples + 0.03 * noise(1.0, 120.0) + 0.035 * noise(1.6, 12.0)
    return np.clip(grey, 0.03, 0.9)[..., None] * np.array([1.06, 1.0, 0.86])
