# SPDX-License-Identifier: Apache-2.0
"""Synthetic dives over sand with the shadow of a ball, exact, and our composites of the same shadow.

The ball is black and not in the picture: it takes light from the floor and sends none. In the dive the ambient light
that it leaves is the form factor of a sphere, and its shadow that of exact rays; only light that reaches the floor
straight bears the pattern of the waves. Frames have codes of 8 bits. The camera stands.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.base.color import ColorSpec, encode, luminance
from mr360uw.base.sphere import directions, disc_directions, effective_half_angle
from mr360uw.caustics import refract_to_water
from mr360uw.composite import Shot
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.render.first_pass import ClipAnalysis, background_series
from mr360uw.render.frame import Reference, frame_shots
from mr360uw.render.loaded import Loaded, load
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import SENSOR, Dive
from mr360uw.scene.model import scene_from_dict
from mr360uw.types import Environment, Floats, Sun
from mr360uw.video import VideoFrame
from tests.composite.form_factors import sphere_form_factor
from tests.render.holding import on_level_floor

WIDTH = 1024
ABOVE_M = 2.0
"""Height of the camera above the sand."""
RADIUS_M, CENTER = 0.6, np.array([0.5, 0.8 - ABOVE_M, -1.3])
"""Ball, 0.2 m above the sand."""
RATE_HZ = 24.0
FRAMES = range(0, 240, 4)
"""Frames of a clip of ten seconds that it without caustics is taken from."""
CLIPS = {"clip": 60, "cut": 12, "still": 1, "measured": 60}
"""How many of them there are."""
_FLOOR = 0.18
"""Light of the floor, in its brightest channel: filaments of five times the mean do not clip."""
_SUN_HALF_ANGLE = 0.00465
_RAYS = 256
"""Over each disc: the edge of the shadow is known to 0.004."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorShade:
    """Light that a body leaves on the floor, each (H/2, W) for the rows below the horizon, 0 to 1.

    ambient: fraction of the ambient light. disc: visible fraction of the sun's disc. halo: of the wider disc from which
    light arrives that the water has scattered forwards.
    """

    ambient: Floats
    disc: Floats
    halo: Floats


def _floor_parts(plate: Dive, time_s: float) -> list[Floats]:
    """Return the light of the level floor below the horizon, each (H/2, W, 3), exposed and as the camera sees it: that
    without the waves' pattern, and of the beam those of light that has been turned by small angles, and that has not.
    """
    x, z, footprint, distance, up = on_level_floor(plate, WIDTH, time_s)
    stage = plate.scene.stage(plate.settings.view(WIDTH, WIDTH // 2, time_s), time_s, 1)
    seen = plate.scene.floor.albedo(x, z, footprint) / np.pi * stage.water.along(distance, up, True)[0] * plate.exposure
    patterns = [seen * factor * tiled.at(x, z, footprint) for tiled, factor in stage.floor_light.patterns]
    none = np.zeros_like(seen)
    sharp, soft = (*patterns, none, none)[:2]
    return [part.reshape(-1, WIDTH, 3) for part in (seen * stage.floor_light.even, soft, sharp)]


@dataclass(frozen=True, slots=True, eq=False)
class ShadedDive:
    """A dive and the light that the ball leaves on its floor. loaded: its scene as a user would write it."""

    settings: DiveSettings
    plate: Dive
    exposure: float
    shade: FloorShade
    loaded: Loaded

    @classmethod
    def of(cls, water: str, floor_depth_m: float, elevation_deg: float, sand_contrast: float) -> ShadedDive:
        """Return the dive of a water, a depth, a sun's elevation in air, and a contrast of the sand's albedo."""
        settings = DiveSettings(
            depth_m=floor_depth_m - ABOVE_M, floor_m=floor_depth_m, water=water, sun_elevation_deg=elevation_deg,
            sand_contrast=sand_contrast, relief=0.0, rocks=0.0, grass=0.0,
        )  # fmt: skip
        loaded, plate = _loaded(settings), Dive(settings, WIDTH, WIDTH // 2)
        exposure = _FLOOR / float(plate.radiance(0.0)[-WIDTH // 8 :].mean(axis=(0, 1)).max())
        return cls(settings, plate, exposure, _shade(settings, loaded), loaded)

    def picture(self, index: int, shade: FloorShade | None = None) -> Floats:
        """Return the light (H, W, 3) of a frame, with or without the ball's shade."""
        time_s = index / RATE_HZ
        image = self.plate.radiance(time_s).astype(np.float64)
        if shade is not None:
            lost = image[WIDTH // 4 :]
            for share, part in zip(
                (shade.ambient, shade.halo, shade.disc), _floor_parts(self.plate, time_s), strict=True
            ):
                lost -= (1.0 - share)[..., None] * part
        return self.exposure * image

    def frame(self, index: int) -> VideoFrame:
        """Return a recorded frame without the ball."""
        time_s = index / RATE_HZ
        code = 255.0 * encode(np.clip(self.picture(index), 0.0, 1.0), "srgb")
        dither = np.random.default_rng(index).random(code.shape[:2])[..., None]
        frame = VideoFrame.of_linear(np.zeros((1, 1, 3), np.float32), index, time_s)
        return replace(frame, spec=ColorSpec(), rgb=np.clip(np.floor(code + dither), 0, 255).astype(np.uint8))

    def analysis(self, frames: Sequence[VideoFrame]) -> ClipAnalysis:
        """Return the background of a clip of some frames; of one frame, what that shows alone."""
        series = background_series(self.loaded)
        assert series is not None
        for frame in frames:
            series.add(frame)
        return ClipAnalysis(background=series.result())

    def shot(self, frame: VideoFrame, analysis: ClipAnalysis, *, known: bool) -> Shot:
        """Return the shot of a frame; known: lit by the dive's own ambient light and sun, not as measured in it."""
        cache, reference = Cache(), Reference()
        shots = frame_shots(self.loaded, analysis, reference, frame, 0.0, cache)
        if known:
            light = replace(shots.light, environment=self._light())
            known_shots = frame_shots(self.loaded, analysis, reference, frame, 0.0, cache, light)
            return replace(known_shots.eyes[0][1][0].shot, medium=shots.water)
        return shots.eyes[0][1][0].shot

    def _light(self) -> Environment:
        """Return an even sky and a sun with the dive's irradiance at the camera."""
        ambient, beam = self.plate.irradiance(self.settings.depth_m)
        above = directions(COARSE_COLUMNS, COARSE_ROWS)[..., 1:2] > 0.0
        sun = Sun(refract_to_water(self.settings.sun_in_air), beam, _SUN_HALF_ANGLE, 1.0)
        return assemble(np.where(above, ambient / np.pi, 0.0).astype(np.float32), sun)


def _given(settings: DiveSettings) -> dict[str, float]:
    """Return the sun's direction in the water as a scene gives it."""
    up = refract_to_water(settings.sun_in_air)[1]
    return {"sun_azimuth_deg": settings.sun_azimuth_deg, "sun_elevation_deg": float(np.degrees(np.arcsin(up)))}


def _loaded(settings: DiveSettings) -> Loaded:
    import trimesh

    with tempfile.TemporaryDirectory() as folder:
        trimesh.creation.icosphere(5, RADIUS_M).export(Path(folder) / "ball.glb")
        (Path(folder) / "dive.mp4").touch()
        look = {"base_color": [0.0, 0.0, 0.0], "roughness": 1.0, "refractive_index": 1.0, "visible": False}
        scene = scene_from_dict(
            {
                "plate": "dive.mp4",
                "camera": {"depth_m": settings.depth_m},
                "water": {"type": settings.water, "sensor": SENSOR},
                "sea": settings.sea.model_dump(exclude_unset=True),
                "object": [{"mesh": "ball.glb", "position_m": CENTER.tolist(), **look}],
                "receiver": {"height_m": -ABOVE_M},
                "light": {"sun": "given", **_given(settings)},
            },
            Path(folder),
        )
        return load(scene, WIDTH, WIDTH // 2)


def _shade(settings: DiveSettings, loaded: Loaded) -> FloorShade:
    """Return what the ball leaves of the light on the floor."""
    view = directions(WIDTH, WIDTH // 2)[WIDTH // 4 :]
    floor = view * (-ABOVE_M / view[..., 1:2])
    sun = refract_to_water(settings.sun_in_air)
    wide = float(effective_half_angle(_SUN_HALF_ANGLE, np.radians(loaded.scene.draw.sun_spread_deg)))
    blocked = sphere_form_factor(floor.reshape(-1, 3), np.array([0.0, 1.0, 0.0]), CENTER, RADIUS_M)
    disc, halo = (_seen(floor, disc_directions(sun, angle, _RAYS)) for angle in (_SUN_HALF_ANGLE, wide))
    return FloorShade(1.0 - blocked.reshape(floor.shape[:2]), disc, halo)


def _seen(floor: Floats, rays: Floats) -> Floats:
    """Return the fraction (h, w) of directions (n, 3) in which the ball is not hit from points (h, w, 3)."""
    seen = np.ones(floor.shape[:2])
    middle = rays.mean(axis=0) / np.linalg.norm(rays.mean(axis=0))
    wide = np.arccos(np.min(rays @ middle)) + np.arcsin(RADIUS_M / np.linalg.norm(CENTER - floor, axis=-1))
    to_center = CENTER - floor
    near = to_center @ middle > np.cos(wide) * np.linalg.norm(to_center, axis=-1)
    along = to_center[near] @ rays.T
    off = np.sum(to_center[near] ** 2, axis=-1)[:, None] - along**2
    seen[near] = 1.0 - np.mean((off < RADIUS_M**2) & (along > 0.0), axis=-1)
    return seen


# --- comparison ----------------------------------------------------------------------------------------------------

_FINE_PX = 12.0
"""Standard deviation of the blur above which brightness is not detail: 0.15 m on the sand under the ball."""


@dataclass(frozen=True, slots=True)
class Remains:
    """What a shadow shows of the plate's caustics in its umbra.

    plate: their contrast in the plate, standard deviation over mean. left: that of what is wrong in the umbra, without
    noise, over `plate`. mean: (3,) of the light there over the dive's own. texture: correlation of the sand's albedo
    with that in the composite, 1 if all of it is there and nothing else; nan on an even floor.
    """

    plate: float
    left: float
    mean: Floats
    texture: float


def remains(dive: ShadedDive, frame: VideoFrame, composite: Floats) -> Remains:
    """Return what is left in a composite (H, W, 3) of a frame."""
    ones = np.ones_like(dive.shade.disc)
    umbra = np.zeros(composite.shape[:2], bool)
    umbra[WIDTH // 4 :] = dive.shade.disc == 0.0
    truth, plain = dive.picture(frame.index, dive.shade), dive.picture(frame.index)
    background = dive.picture(frame.index, FloorShade(ones, 0.0 * ones, ones))
    wrong, pattern, noise = (
        luminance(a) / luminance(b) for a, b in ((composite, truth), (plain, background), (frame.image_linear, plain))
    )
    contrasts = [_detail(a, umbra).std() / a[umbra].mean() for a in (wrong, pattern, noise)]
    left = np.sqrt(max(contrasts[0] ** 2 - contrasts[2] ** 2, 0.0)) / contrasts[1]
    albedo = np.ones(composite.shape[:2])
    x, z, footprint, *_ = on_level_floor(dive.plate, WIDTH, 0.0)
    albedo[WIDTH // 4 :] = luminance(dive.plate.scene.floor.albedo(x, z, footprint)).reshape(-1, WIDTH)
    texture = float("nan")
    if dive.settings.sand_contrast:
        texture = float(np.corrcoef(_detail(wrong * albedo, umbra), _detail(albedo, umbra))[0, 1])
    return Remains(contrasts[1], left, composite[umbra].mean(axis=0) / truth[umbra].mean(axis=0), texture)


def _detail(image: Floats, where: np.ndarray) -> Floats:
    """Return an image's pixels (n,) in a mask less their blur over the mask."""
    import cv2

    inside = np.where(where, image, 0.0), where.astype(np.float64)
    light, weight = (cv2.GaussianBlur(a, (0, 0), _FINE_PX) for a in inside)
    return (image - light / np.maximum(weight, 1e-9))[where]
