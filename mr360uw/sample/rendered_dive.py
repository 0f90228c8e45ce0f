# SPDX-License-Identifier: Apache-2.0
"""Frames of a synthetic 360 dive, rendered through its waves by `mr360uw.surface`, and the light that made them.

Units: the irradiance just below a level surface, see `dive_sky`. Frames are times the exposure: 1 is white.

Unless it is solid, the floor that rays meet is level; its relief acts on its albedo by the factor of its light over
that on level ground: tilt, cast shadows and the visible fraction of the sky. It shades but has no outline.

    factor = b lit max(n.s, 0)/s_y + (1 - b) mean_a cos^2 e_a

b: fraction of the floor's irradiance that is the sun's beam, s: direction to the sun in the water, n: normal, lit: 0 in
cast shadow, e_a: elevation of the horizon in the azimuth a, for uniform diffuse light on level ground.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import luminance
from mr360uw.base.constants import PI, REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.base.optics import fresnel_from_below, fresnel_transmittance, refract_to_water
from mr360uw.base.parameters import checked
from mr360uw.base.sphere import directions, row_solid_angle, unit
from mr360uw.base.texels import smoothstep
from mr360uw.caustics.settings import CausticSettings
from mr360uw.ibl import environment
from mr360uw.ibl.sun.split import CLEAR_SKY, air_mass, beam_below, clear_air_depth, direct_share
from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import beam_fraction
from mr360uw.medium.spectra import DEFAULT_SENSOR, named_sensor
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.surface.sea_floor import Floor
from mr360uw.surface.sea_picture import SeaScene, SurfacePicture
from mr360uw.surface.sky import CLEAR, LOWEST_SINE, OVERCAST, SKY_ROWS, Dome, standard_sky, sun_below
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import Floats, Sun

_STEPS_M = np.geomspace(0.012, 3.0, 14)
"""Distances [m] at which the horizon is looked for: from one pixel to the shadow of the highest rock at 20 degrees."""
_AZIMUTHS = 8
_PENUMBRA = 0.08
"""Width of a shadow's edge in tangents of elevation: the beam is spread by small angles of 5 degrees."""

Heights = NDArray[np.float32]


def relief_shade(height_m: Floats, tile_m: float, sun: Floats | None, beam: Floats) -> Floats:
    """Return the factor (size, size, 3) of light on a tile of heights (size, size) [m], column = +x, row = +z.

    sun: (3,) direction in the water, None without one. beam: (3,) fraction of the irradiance that is the sun's beam.
    """
    height = height_m.astype(np.float32)
    step = tile_m / len(height)
    open_sky = np.zeros_like(height)
    for k in range(_AZIMUTHS):
        angle = 2.0 * PI * (k + 0.5) / _AZIMUTHS
        open_sky += 1.0 / (1.0 + _horizon(height, (np.cos(angle), np.sin(angle)), step) ** 2) / _AZIMUTHS
    diffuse = open_sky[..., None]
    if sun is None:
        return np.repeat(diffuse, 3, axis=2).astype(np.float64)
    by_x, by_z = (0.5 * (np.roll(height, -1, a) - np.roll(height, 1, a)) / step for a in (1, 0))
    facing = (sun[1] - by_x * sun[0] - by_z * sun[2]) / np.sqrt(1.0 + by_x**2 + by_z**2) / sun[1]
    along = max(float(np.hypot(sun[0], sun[2])), 1e-9)
    horizon = _horizon(height, (float(sun[0]) / along, float(sun[2]) / along), step)
    lit = np.clip(0.5 + (float(sun[1]) / along - horizon) / _PENUMBRA, 0.0, 1.0)
    direct = (lit * np.maximum(facing, 0.0))[..., None]
    return np.asarray(beam * direct + (1.0 - beam) * diffuse, np.float64)


def _horizon(height: Heights, towards: tuple[float, float], step_m: float) -> Heights:
    """Return the tangent (size, size) of the horizon's elevation, 0 or more, in a direction over (x, z)."""
    highest = np.zeros_like(height)
    for distance in _STEPS_M:
        columns, rows = (round(distance * part / step_m) for part in towards)
        if columns or rows:
            away = np.float32(step_m * np.hypot(columns, rows))
            there = np.roll(height, (-rows, -columns), axis=(0, 1))
            np.maximum(highest, (there - height) / away, out=highest)
    return highest


SENSOR = DEFAULT_SENSOR
"""Sensor of the clip. A camera's responses are nowhere negative, so light adds up in each channel."""
_LEVEL_BRIGHTNESS, _SKY_BRIGHTNESS, _FLOOR_BRIGHTNESS = 0.035, 0.7, 0.18
"""Most light of the water at the horizon, of the sky overhead, and of the floor under the camera after automatic
exposure, 1 = white: in clear water a camera exposes for the sky, over sand in the sun for that, so that lines of light
five times as bright as the mean do not clip, and the sun's glitter does."""
_CAUSTICS = CausticSettings(size=512, grid=192)
_FAR_M = 1e6
"""Length [m] of a ray through open water: nothing passes."""


class Dive:
    """Renders a dive's frames; what does not move is made once.

    sun: as seen in the air, or None. sky_below, sun_below: irradiance (3,) just below a level surface that sky and sun
    bring. scene: of all of it, for other cameras. exposure: factor of a frame on radiance. level_radiance: (3,) of the
    water at the horizon at the start, after exposure.
    """

    @checked
    def __init__(self, settings: DiveSettings, width: int, height: int, *, samples: int = 1) -> None:
        """Take the size of frames and the number of rays for each pixel and axis."""
        self.settings, self._size, self._samples = settings, (width, height), samples
        self._dome, self.sun = dive_sky(settings)
        self.sky_below, self.sun_below = _below(self._dome, self.sun)
        medium = Medium(Water.jerlov(settings.water), named_sensor(SENSOR))
        height_m, albedo = sea_bed(settings)
        if np.ptp(height_m) > 0.0 and not settings.solid:
            level, depth_m = self._scene(albedo, medium).light_in_water(settings.floor_depth_m), settings.floor_depth_m
            share = _beam(level, depth_m) / level.down(depth_m)
            shade = relief_shade(height_m, BED_TILE_M, self.sun_in_water, share)
            albedo = np.clip(albedo * shade, 0.0, 1.0)
        self.scene = self._scene(albedo, medium, height_m if settings.solid else 0.0)
        water = self.water.seen_from(settings.depth_m)
        level_light = water.along(np.array([_FAR_M]), np.zeros(1), True)[1][0]
        self.exposure = 2.0**settings.stops * min(
            _LEVEL_BRIGHTNESS / float(np.mean(level_light)),
            _SKY_BRIGHTNESS / float(np.max(self._overhead(water))),
            _FLOOR_BRIGHTNESS / float(np.max(self._underneath(water))),
        )
        self.level_radiance: Floats = self.exposure * level_light

    @property
    def sun_in_water(self) -> Floats | None:
        """Direction (3,) to the sun below a level surface, or None."""
        return None if self.sun is None else refract_to_water(self.sun.direction, REFRACTIVE_INDEX_SEA)

    @property
    def sun_share(self) -> float:
        """Fraction of the luminance just below the surface that is the sun's."""
        sun = float(luminance(self.sun_below))
        return sun / (sun + float(luminance(self.sky_below)))

    def picture(self, time_s: float) -> SurfacePicture:
        """Return a frame's radiance, not exposed, with distances and masks."""
        return self.scene.picture(self.settings.view(*self._size, time_s), time_s, samples=self._samples)

    def radiance(self, time_s: float) -> NDArray[np.float32]:
        """Return a frame (H, W, 3) in linear light, exposed; values above 1 clip in the recording."""
        return (self.exposure * self.picture(time_s).radiance).astype(np.float32)

    def irradiance(self, depth_m: float) -> tuple[Floats, Floats]:
        """Return the ambient irradiance (3,) on a level plane at a depth, and the beam's (3,) perpendicular to itself.

        Both are means over the waves. Ambient is all light but the beam and what the water has turned by small angles.
        """
        beam = _beam(self.water, depth_m)
        return self.water.down(depth_m) - beam, np.asarray(beam / self.water.sun_up)

    @functools.cached_property
    def floor_irradiance(self) -> Floats:
        """Downwelling irradiance (3,) at the floor's mean depth, with what it sends up and gets back."""
        return self.water.down(self.settings.floor_depth_m)

    @property
    def water(self) -> WaterLight:
        """Light between the surface and the floor."""
        return self.scene.light_in_water(self.settings.floor_depth_m)

    def _scene(self, albedo: Floats, medium: Medium, relief_m: ArrayLike = 0.0) -> SeaScene:
        """Return the sea over a floor of an albedo (size, size, 3) and heights (size, size) [m]; 0: level."""
        height_m = self.settings.depth_m - self.settings.floor_depth_m
        floor = Floor(height_m, albedo, BED_TILE_M, relief=relief_m)
        return SeaScene(self.settings.sea, self._dome, floor, medium, sun=self.sun, caustics=_CAUSTICS)

    def _overhead(self, water: WaterLight) -> Floats:
        """Return the radiance (3,) of the sky straight overhead through a level surface."""
        up, depth = np.array([1.0]), np.array([self.settings.depth_m])
        passed, veil = water.along(depth, up, True)
        window = REFRACTIVE_INDEX_SEA**2 * (1.0 - fresnel_from_below(1.0, REFRACTIVE_INDEX_SEA))
        zenith = self.scene.dome.look(np.array([[0.0, 1.0, 0.0]]), np.zeros(1))
        return np.asarray((passed * window * zenith + veil)[0])

    def _underneath(self, water: WaterLight) -> Floats:
        """Return the mean radiance (3,) of the floor straight below the camera."""
        way = np.array([self.settings.floor_depth_m - self.settings.depth_m])
        passed, veil = water.along(way, np.array([-1.0]), True)
        return np.asarray((passed * self.scene.floor.mean_albedo / PI * self.floor_irradiance + veil)[0])


def _beam(light: WaterLight, depth_m: float) -> Floats:
    """Return the irradiance (3,) of a level plane at a depth by the sun's beam."""
    if light.sun is None:
        return np.zeros(3)
    return np.asarray(light.sun.below * beam_fraction(light.table(from_camera=False), depth_m, light.sun_up))


# The sky over a synthetic dive: sun and dome, clear or overcast, or of a picture of the sky.
#
# The unit is the irradiance just below a level surface: of a clear sky with the sun at 45 degrees or more, and of an
# overcast one, it is 1 in each channel, since a camera's white balance makes daylight white. Under a lower sun the beam
# is redder and the rest is not, so the sum is warm.
#
# The dome is a standard sky (`surface.sky`). Its colour in each direction is that of light scattered once along
# the way, 1 - exp(-depth m), m: air mass.

_GLARE_RAD = 0.05
"""Radius [rad] about the sun of a map within which light above the ring around it counts as the sun's."""


def _below(dome: Floats, sun: Sun | None) -> tuple[Floats, Floats]:
    """Return the irradiance (3,) just below a level surface that the sky brings, and that the sun brings."""
    return Dome(dome).irradiance_below(REFRACTIVE_INDEX_SEA), sun_below(sun, REFRACTIVE_INDEX_SEA)


def dive_sky(settings: DiveSettings) -> tuple[Floats, Sun | None]:
    """Return the radiance (h, w, 3) of the sky of a dive without the sun, and the sun as seen in the air, or None.

    Raises `VideoError` or `ParameterError` for a picture that is none of the sky.
    """
    if settings.sky_map is not None:
        return _sky_of_map(settings.sky_map)
    if settings.sky == "overcast":
        return _scaled(standard_sky(OVERCAST, np.array([0.0, 1.0, 0.0]))[..., None], np.ones(3)), None
    toward = settings.sun_in_air
    sine = float(toward[1])
    share = direct_share(sine) if settings.sun_share is None else settings.sun_share
    beam = beam_below(share, sine)
    passed = fresnel_transmittance(sine, REFRACTIVE_INDEX_SEA)
    sun = Sun(toward, beam / (sine * passed), SUN_HALF_ANGLE_RAD, 1.0)
    shape = (
        np.ones((SKY_ROWS, 2 * SKY_ROWS, 1))
        if settings.sky == "even"
        else standard_sky(CLEAR, toward)[..., None] * _scattered()
    )
    return _scaled(shape, (1.0 - share) * CLEAR_SKY), sun


def _sky_of_map(path: Path) -> tuple[Floats, Sun | None]:
    """Return the sky of an equirectangular HDR picture, its sun apart, in units of its light just below the surface."""
    from mr360uw.video import open_video

    with open_video(path) as video:
        radiance = np.maximum(next(iter(video.frames())).image_linear, 0.0).astype(np.float64)
    found = environment(radiance.astype(np.float32), underwater=False).sun
    dome: Floats = radiance
    sun: Sun | None = None
    if found is not None and found.direction[1] > LOWEST_SINE:
        dome, sun = _without_sun(radiance, unit(found.direction))
    sky_below, lit_below = _below(dome, sun)
    light = float(luminance(sky_below + lit_below))
    return dome / light, None if sun is None else replace(sun, irradiance=sun.irradiance / light)


def _without_sun(radiance: Floats, toward: Floats) -> tuple[Floats, Sun]:
    """Return a map with what is brighter about the sun than the ring around it as a sun of true size."""
    height, width = radiance.shape[:2]
    apart = np.arccos(np.clip(directions(width, height) @ toward, -1.0, 1.0))
    reach = max(_GLARE_RAD, 3.0 * np.pi / height)
    near, ring = apart < reach, (apart >= reach) & (apart < 1.5 * reach)
    even = np.median(radiance[ring], axis=0)
    weight = np.broadcast_to(row_solid_angle(width, height)[:, None], apart.shape)[near]
    excess = np.maximum(radiance[near] - even, 0.0)
    dome = radiance.copy()
    dome[near] -= excess
    return dome, Sun(toward, weight @ excess, SUN_HALF_ANGLE_RAD, 1.0)


def _scattered() -> Floats:
    """Return the colour (SKY_ROWS, 1, 3), of luminance 1, of light scattered once in clear air, row by row."""
    sine = np.maximum(np.abs(directions(2, SKY_ROWS)[:, 0, 1]), LOWEST_SINE)
    mass = np.array([air_mass(float(s)) for s in sine])[:, None]
    colour = 1.0 - np.exp(-clear_air_depth() * mass)
    return np.asarray(colour / luminance(colour)[:, None])[:, None]


def _scaled(radiance: Floats, below: Floats) -> Floats:
    """Return a map whose light just below the surface is `below` (3,)."""
    shape = np.broadcast_to(radiance, (*radiance.shape[:2], 3)).copy()
    return np.asarray(shape * (below / Dome(shape).irradiance_below(REFRACTIVE_INDEX_SEA)))


# The floor of a synthetic dive: heights and albedo of sand ripples, rocks and patches of sea grass, in a tile that
# repeats.

BED_TILE_M = 12.0
"""Side [m] of the square after which the floor repeats."""
_SIZE = 1024
"""Pixels across that square, 12 mm each: finer than a frame 1024 pixels wide shows on the floor."""
_RIPPLES, _RIPPLE_M = 36, 0.026
"""Crests across the tile, 0.33 m apart, and their amplitude [m]: steepness 0.16, as of ripples of waves on sand."""
_DUNE_M = 0.05
"""Standard deviation [m] of the sand's slow undulations."""
_SAND_COLOR, _ROCK, _GRASS = np.array([1.06, 1.0, 0.86]), np.array([0.15, 0.125, 0.10]), np.array([0.035, 0.05, 0.025])
"""Albedo of sand over that in green; mean albedo of rock under algae, and of sea grass."""
_BOULDER_M, _GROUPS, _TO_A_GROUP = 0.9, 70, 7
"""Radius [m] of large boulders, groups of them in a tile that they cover, and boulders in each."""
_REACH_M = 2.0
"""Distance [m] within which a boulder counts."""
_FLATNESS, _FOOT_M, _ROCK_EDGE = 0.75, 0.12, 0.06
"""Height of boulders over that of spheres; rounding [m] of their feet, which bounds their slope; width of their edge in
R^2 - r^2 [m2]: 3 cm of a boulder of 1 m."""
_GRASS_HEIGHT_M = 0.16
"""Mean height [m] of grass."""


def sea_bed(settings: DiveSettings) -> tuple[Floats, Floats]:
    """Return the tile of a dive's floor, a function of its seed and its parameters of the floor.

    Heights (size, size) [m] over the floor's mean, and albedo (size, size, 3); column = +x, row = +z.
    """
    sand, dunes = _sand(_Noise(settings.seed, 0), settings.sand_albedo, settings.sand_contrast)
    rocks, boulders, crust = _rocks(_Noise(settings.seed, 1), settings.rocks)
    grass, tufts, blades = _grass(_Noise(settings.seed, 2), settings.grass)
    grass = grass * (1.0 - rocks)
    bare = (1.0 - rocks) * (1.0 - grass)
    height = settings.relief * (dunes * (1.0 - rocks) + boulders + grass * tufts)
    albedo = bare[..., None] * sand + rocks[..., None] * crust + grass[..., None] * blades
    return height - height.mean(), np.clip(albedo, 0.0, 0.9)


class _Noise:
    """Periodic random fields of mean 0 and deviation 1, in the order in which they are asked for."""

    def __init__(self, seed: int, kind: int) -> None:
        self.rng = np.random.default_rng((seed, kind, 0x5A4D))
        along = np.fft.rfftfreq(_SIZE, 1.0 / _SIZE)
        self._radius = np.hypot(np.fft.fftfreq(_SIZE, 1.0 / _SIZE)[:, None], along)

    def smooth(self, exponent: float, cutoff: float) -> Floats:
        """Return a field (size, size) whose amplitudes fall with a power of the frequency, and fast beyond `cutoff`
        periods to the tile.
        """
        spectrum = np.fft.rfft2(self.rng.standard_normal((_SIZE, _SIZE)))
        shape = np.exp(-((self._radius / cutoff) ** 2)) / np.maximum(self._radius, 1.0) ** exponent
        field = np.fft.irfft2(spectrum * shape, (_SIZE, _SIZE))
        return np.asarray((field - field.mean()) / field.std())


def _sand(noise: _Noise, albedo: float, contrast: float) -> tuple[Floats, Floats]:
    """Return albedo (size, size, 3) and height (size, size) [m] of rippled sand."""
    across = 2.0 * np.pi * _RIPPLES * np.arange(_SIZE) / _SIZE
    phase = across[:, None] + 1.8 * noise.smooth(2.0, 40.0)
    crests = np.sin(phase + 0.35 * np.sin(phase))  # steeper on the lee side
    strength = np.clip(0.75 + 0.35 * noise.smooth(1.5, 6.0), 0.0, 1.5)
    height = _DUNE_M * noise.smooth(2.0, 6.0) + _RIPPLE_M * strength * crests
    # troughs collect darker grains and debris
    grey = 0.07 * strength * crests + 0.08 * noise.smooth(1.0, 120.0) + 0.09 * noise.smooth(1.6, 12.0)
    return albedo * _SAND_COLOR * np.maximum(1.0 + contrast * grey[..., None], 0.05), height


def _rocks(noise: _Noise, fraction: float) -> tuple[Floats, Floats, Floats]:
    """Return cover (size, size), height (size, size) [m] and albedo (..., 3) of boulders under growth, in colours."""
    if fraction <= 0.0:
        return np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 3))
    over = _boulders(noise, fraction)
    cover = smoothstep(over / _ROCK_EDGE + 0.5, 0.0, 1.0)
    rough = 1.0 + 0.10 * noise.smooth(0.8, 60.0) + 0.05 * noise.smooth(0.4, 200.0)
    height = _FLATNESS * (np.sqrt(np.maximum(over, 0.0) + _FOOT_M**2) - _FOOT_M) * rough
    # Growth by patches of colours, darker in the clefts
    red, blue = noise.smooth(0.8, 40.0), noise.smooth(0.8, 40.0)
    tint = 1.0 + 0.12 * np.stack([red, -0.5 * (red + blue), blue], axis=-1)
    crust = np.exp(0.35 * noise.smooth(0.8, 60.0) + 0.3 * noise.smooth(0.3, 250.0))[..., None] * tint
    return cover, np.maximum(height, 0.0), _ROCK * crust


def _boulders(noise: _Noise, fraction: float) -> Floats:
    """Return the largest R^2 - r^2 (size, size) [m2] of boulders of radius R that cover a fraction of the tile, r:
    distance to the centre of one, along axes that are warped.
    """
    step, rng = BED_TILE_M / _SIZE, noise.rng
    warp_x, warp_z = (0.22 * noise.smooth(1.8, 30.0) + 0.035 * noise.smooth(0.8, 60.0) for _ in range(2))
    nearest, boulders = np.full((_SIZE, _SIZE), np.inf), []
    for center in rng.uniform(0.0, BED_TILE_M, (1 + round(_GROUPS * fraction), 2)):
        largest = _BOULDER_M * rng.uniform(0.6, 1.0)
        for k in range(_TO_A_GROUP):
            radius = largest * rng.uniform(0.15, 0.6) if k else largest
            x, z = center + (rng.normal(0.0, 1.1 * largest, 2) if k else 0.0)
            # Squared distances of the pixels about it, which may lie over the edge of the tile
            columns, rows = (np.arange(int((c - _REACH_M) / step), int((c + _REACH_M) / step)) for c in (x, z))
            here = np.ix_(rows % _SIZE, columns % _SIZE)
            aside, along = columns * step - x + warp_x[here], rows[:, None] * step - z + warp_z[here]
            stretch = rng.uniform(0.6, 1.6)
            squared = stretch * aside**2 + along**2 / stretch
            nearest[here] = np.minimum(nearest[here], squared / radius**2)
            boulders.append((here, radius, squared))
    # Let all of them grow until they cover the fraction
    growth, over = np.quantile(nearest, fraction), np.full((_SIZE, _SIZE), -np.inf)
    for here, radius, squared in boulders:
        over[here] = np.maximum(over[here], growth * radius**2 - squared)
    return over


def _grass(noise: _Noise, fraction: float) -> tuple[Floats, Floats, Floats]:
    """Return cover (size, size), height (size, size) [m] and albedo (..., 3) of sea grass."""
    if fraction <= 0.0:
        return np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 3))
    blades = noise.smooth(0.0, 250.0)
    field = noise.smooth(1.4, 7.0) + 0.2 * noise.smooth(0.5, 90.0)
    over = field - np.quantile(field, 1.0 - fraction)
    cover = smoothstep(over / 0.4 + 0.5, 0.0, 1.0)
    tufts = _GRASS_HEIGHT_M * (0.85 + 0.25 * noise.smooth(0.6, 60.0) + 0.08 * blades)
    return cover, np.maximum(tufts, 0.0) * smoothstep(over, 0.0, 1.0), _GRASS * np.exp(0.45 * blades)[..., None]
