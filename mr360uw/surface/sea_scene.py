# SPDX-License-Identifier: Apache-2.0
"""A sea with its sky, floor and water, of which pictures are taken at any times and from any places.

What does not change with time is made once: the solved water, the dome and its bright patches, the floor. What does is
a function of the time and of the view alone, so a picture of a film is the same as one taken by itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.cache import Cache
from mr360uw.caustics import CausticSettings
from mr360uw.caustics.settings import Sea
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.medium import Medium, Water
from mr360uw.optics import check_refractive_index
from mr360uw.shapes import checked, exactly, number
from mr360uw.sphere import unit
from mr360uw.surface.sampled_sea import SampledSea, points_across
from mr360uw.surface.sea_floor import Floor, FloorLight
from mr360uw.surface.sea_picture import SurfacePicture, rendered
from mr360uw.surface.sky import Dome
from mr360uw.surface.tracing.stage_arrays import RayStage
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import Sun, View

_MOST_SAMPLES = 32
_PLANE_M, _MOST_PLANES = 0.5, 6
"""Greatest distance [m] of planes of light over an uneven floor, while they are no more than so many."""
_SHALLOWEST_M = 0.01
"""Depth [m] of cameras that are nearer to the surface, or over its mean in a crest, in the water's tables."""


class SeaScene:
    """A sea with its sky, floor and water, of which pictures are taken one at a time.

    Solved water, sky and floor are made with the first picture and kept. A picture of a film is the same as one taken
    by itself.

    Parameters
    ----------
    sea : GerstnerSea or SpectralSea
        The surface.
    dome : array_like
        Equirectangular radiance (h, w, 3) of the sky, of which the upper half is read; a sun in it is part of the sky.
    floor : Floor or tuple
        A `Floor`, or its height [m] in the world and its albedo.
    water : Water or Medium, optional
        None for clear water; else its scattered light is that of the solved field over a level floor of the mean depth
        and albedo.
    sun : Sun, optional
        A sun that is not in the dome, as seen in the air; below the horizon it gives no light.
    refractive_index : float
        Index of the water relative to air.
    caustics : CausticSettings, optional
        Resolution of the sun's pattern on the floor.

    Raises
    ------
    ParameterError
        If a floor, a water, a sun or an index cannot be used.

    See Also
    --------
    uw.surface.picture : One picture by one call.
    uw.surface.Floor : A floor with a picture or a relief.
    uw.aerial : A picture from the air, of a scene file.

    Examples
    --------
    >>> sea = uw.caustics.GerstnerSea(wind_speed=2.0, wave_count=4)
    >>> scene = uw.surface.SeaScene(sea, np.ones((16, 32, 3)), (-3.0, 0.3))
    >>> scene.picture(uw.types.View(8, 4, surface_y_m=1.0), samples=1).radiance.shape
    (4, 8, 3)
    """

    @checked
    def __init__(
        self,
        sea: Sea,
        dome: ArrayLike,
        floor: Floor | tuple[float, ArrayLike],
        water: Water | Medium | None = None,
        *,
        sun: Sun | None = None,
        refractive_index: float = REFRACTIVE_INDEX_SEA,
        caustics: CausticSettings | None = None,
    ) -> None:
        check_refractive_index(refractive_index)
        if not isinstance(floor, Floor) and (not isinstance(floor, tuple) or len(floor) != 2):
            raise ParameterError(
                f"floor - must be a Floor, or height and albedo (got {floor!r:.40}) - give (-5.0, 0.3)"
            )
        if water is not None and not isinstance(water, Water | Medium):
            raise ParameterError(f"water - must be a Water, a Medium or None (got {water!r:.40}) - see uw.medium.Water")
        self.sea, self.dome, self.water = sea, Dome(dome), water
        self.sun, self.refractive_index = _checked(sun), refractive_index
        self.floor = floor if isinstance(floor, Floor) else Floor(*floor)
        self.caustics = caustics or CausticSettings()
        self._cache = Cache()

    def picture(self, view: View, time_s: float = 0.0, *, samples: int = 2) -> SurfacePicture:
        """Return what a camera below or above the sea sees.

        Twice the `samples` take about four times as long, and halve the noise that small waves leave near the horizon.

        Parameters
        ----------
        view : View
            The camera; its `surface_y_m` is the height of the mean surface.
        time_s : float
            Time [s] of the sea.
        samples : int
            Rays per pixel and axis, 1 to 32.

        Returns
        -------
        SurfacePicture
            Radiance (H, W, 3), float64, distances and masks.

        Raises
        ------
        ParameterError
            If an argument is out of range, or the camera below the floor.

        See Also
        --------
        uw.surface.SurfacePicture : What is returned.
        uw.surface.picture : The same by one call.

        Examples
        --------
        >>> sea = uw.caustics.GerstnerSea(wind_speed=2.0, wave_count=4)
        >>> scene = uw.surface.SeaScene(sea, np.ones((16, 32, 3)), (-3.0, 0.3))
        >>> scene.picture(uw.types.View(8, 4, surface_y_m=1.0), time_s=0.5, samples=1).camera_in_water
        True
        """
        if not 1 <= samples <= _MOST_SAMPLES:
            raise ParameterError(f"samples - outside 1 to {_MOST_SAMPLES} (got {samples}) - take 2 to 4")
        return rendered(self.stage(view, time_s, samples * samples), view, samples)

    def stage(self, view: View, time_s: float, samples: int) -> RayStage:
        """Return what the rays of a view can meet at a time [s]. samples: rays of one pixel."""
        position = exactly("view.position", view.position, (3,)).astype(np.float64)
        ground = self.floor.height_at(position[0], position[2])
        if not position[1] > ground:
            raise ParameterError(
                f"view - the camera must be above the floor (got y = {position[1]:g} over {ground:g} m) - raise it"
            )
        time = number("time_s", time_s)
        points = self._cache.of(points_across, self.sea)
        sampled = self._cache.of(SampledSea.of, self.sea, time, points)
        over, depth = float(position[1] - view.surface_y_m), view.surface_y_m - self.floor.height_m
        in_water = over < float(sampled.heights(position[[0]], position[[2]])[0])
        water = self.light_in_water(depth)
        if in_water:
            below = max(-over, _SHALLOWEST_M)
            water = self._cache.of(water.seen_from, below)
        index, floor = self.refractive_index, self.floor
        depths = [depth]
        if floor.lowest_m < floor.highest_m:
            depths = _plane_depths(depth - floor.highest_m, depth - floor.lowest_m)
        lights = [self._cache.of(self._floor_light, water, sampled, time, d, keep=len(depths)) for d in depths]
        planes = tuple(zip(depths, lights, strict=True)) if len(depths) > 1 else ()
        return RayStage(
            sampled, self.dome, floor, -depth, lights[0], water, self.sun, index, samples, in_water, planes
        )  # fmt: skip

    def _floor_light(self, water: WaterLight, sampled: SampledSea, time_s: float, depth_m: float) -> FloorLight:
        return water.on_floor(self.sea, sampled, self.dome, self.sun, depth_m, time_s, self.caustics)

    def light_in_water(self, floor_m: float) -> WaterLight:
        """Return the light between the surface and the floor at a mean depth [m], for a camera above the water."""
        albedo = self.floor.mean_albedo
        return self._cache.of(WaterLight.of, self.water, self.dome, self.sun, self.refractive_index, floor_m, albedo)


def _plane_depths(least_m: float, greatest_m: float) -> list[float]:
    """Return the depths [m] at which the light on an uneven floor is computed, at most `_MOST_PLANES`, two at least."""
    top = max(least_m, _SHALLOWEST_M)
    bottom = max(greatest_m, top + _SHALLOWEST_M)
    count = min(max(math.ceil((bottom - top) / _PLANE_M) + 1, 2), _MOST_PLANES)
    return [float(depth) for depth in np.linspace(top, bottom, count)]


@checked
def picture(
    sea: Sea,
    dome: ArrayLike,
    floor: Floor | tuple[float, ArrayLike],
    view: View,
    water: Water | Medium | None = None,
    *,
    sun: Sun | None = None,
    time_s: float = 0.0,
    samples: int = 2,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    caustics: CausticSettings | None = None,
) -> SurfacePicture:
    """Return one picture of a sea; for several `SeaScene` keeps what does not change.

    From below it shows Snell's window, from above the floor through the waves and the mirrored sky. Bodies and shafts
    are not in it.

    Parameters
    ----------
    sea : GerstnerSea or SpectralSea
        The surface.
    dome : array_like
        Equirectangular radiance (h, w, 3) of the sky, of which the upper half is read; a sun in it is part of the sky.
    floor : Floor or tuple
        A `Floor`, or its height [m] in the world and its albedo.
    view : View
        The camera, below or above the water: position, rotation, projection, and the mean surface's height
        `surface_y_m`.
    water : Water or Medium, optional
        None for clear water.
    sun : Sun, optional
        A sun that is not in the dome, as seen in the air.
    time_s : float
        Time [s] of the sea.
    samples : int
        Rays per pixel and axis, 1 to 32.
    refractive_index : float
        Index of the water relative to air.
    caustics : CausticSettings, optional
        Resolution of the sun's pattern on the floor.

    Returns
    -------
    SurfacePicture
        Radiance (H, W, 3), float64, in units of the dome's, distances and masks.

    Raises
    ------
    ParameterError
        If an argument cannot be used, or the camera is below the floor.

    See Also
    --------
    uw.surface.SeaScene : Keeps the water and the sky for a film.
    uw.aerial : A picture from the air, of a scene file.
    uw.sample_dive : A clip made by such pictures.

    Examples
    --------
    >>> sea = uw.caustics.GerstnerSea(wind_speed=2.0, wave_count=4)
    >>> view = uw.types.View(16, 8, projection="perspective", fov_rad=1.5, surface_y_m=1.0)
    >>> seen = uw.surface.picture(sea, np.ones((16, 32, 3)), (-3.0, 0.3), view, samples=1)
    >>> seen.radiance.shape, seen.camera_in_water
    ((8, 16, 3), True)
    """
    scene = SeaScene(sea, dome, floor, water, sun=sun, refractive_index=refractive_index, caustics=caustics)
    return scene.picture(view, time_s, samples=samples)


def _checked(sun: Sun | None) -> Sun | None:
    if sun is None:
        return None
    if not 0.0 < number("sun.half_angle_rad", sun.half_angle_rad) <= 0.5:
        raise ParameterError(f"sun.half_angle_rad - outside (0, 0.5] (got {sun.half_angle_rad}) - the sun has 0.00465")
    irradiance = exactly("sun.irradiance", sun.irradiance, (3,)).astype(np.float64)
    direction = unit(exactly("sun.direction", sun.direction, (3,)))
    return Sun(direction, irradiance, float(sun.half_angle_rad), sun.confidence)
