# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sea, its floor and its sky by a camera below or above the water.

Camera rays meet the moving surface and part there by Fresnel's equations: in the water they reach the floor, or the
surface again; in the air the sky, or another wave. Waves smaller than a pixel act by the statistics of their slopes.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import check_refractive_index
from mr360uw.base.parameters import checked, exactly, number
from mr360uw.base.sphere import unit
from mr360uw.base.texels import Vector, add
from mr360uw.caustics import CausticSettings
from mr360uw.caustics.settings import Sea
from mr360uw.errors import ParameterError
from mr360uw.jit import exact
from mr360uw.medium import Medium, Water
from mr360uw.plot import Figure, Shown
from mr360uw.surface.facet_draws import next_key
from mr360uw.surface.intersection import NOWHERE, Hit, Ray, bent
from mr360uw.surface.ray_kernel import OFF_M, STACK, RayStage, RayWorld, followed, met, put, ray_world
from mr360uw.surface.sampled_sea import SampledSea, points_across
from mr360uw.surface.sea_floor import Floor, FloorIrradiance
from mr360uw.surface.sky import Dome
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import Array, Sun, View

# A sea with its sky, floor and water, of which pictures are taken at any times and from any places.
#
# What does not change with time is made once: the solved water, the dome and its bright patches, the floor. What does
# is a function of the time and of the view alone, so a picture of a film is the same as one taken by itself.

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
        planes = tuple(zip(depths, lights, strict=True))
        return RayStage(sampled, self.dome, floor, -depth, planes, water, self.sun, index, samples, in_water)

    def _floor_light(self, water: WaterLight, sampled: SampledSea, time_s: float, depth_m: float) -> FloorIrradiance:
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


_AT_ONCE = 1 << 14
"""Rays that are traced on one thread at a time."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurfacePicture(Shown):
    """A picture of the sea; all but the radiance is of the ray through each pixel's centre.

    Masks and distances have hard edges, the radiance is the mean of all rays of a pixel. Light is linear: encode it for
    a screen.

    Parameters
    ----------
    radiance : ndarray
        Linear radiance (H, W, 3), in units of the dome's.
    distance_m : ndarray
        Distance (H, W) [m] to the first of surface and floor, infinity for the sky and for level rays.
    in_water_m : ndarray
        Length (H, W) [m] in the water: that distance, or for a camera above the waves that of the refracted ray, 0
        where there is none.
    normal : ndarray
        Normal (H, W, 3) of the surface, up, zero where it is not met.
    surface, floor : ndarray
        Masks (H, W) of what is met first.
    camera_in_water : bool
        On which side of the waves the camera is.

    See Also
    --------
    uw.surface.picture : Makes one.
    uw.plot.show : Draws the radiance.

    Examples
    --------
    >>> sea, view = uw.caustics.GerstnerSea(wave_count=4), uw.types.View(8, 4, surface_y_m=1.0)
    >>> seen = uw.surface.picture(sea, np.ones((16, 32, 3)), (-3.0, 0.3), view, samples=1)
    >>> bool(np.isfinite(seen.distance_m[seen.floor]).all())
    True
    """

    radiance: Array
    distance_m: Array
    in_water_m: Array
    normal: Array
    surface: NDArray[np.bool_]
    floor: NDArray[np.bool_]
    camera_in_water: bool

    def __repr__(self) -> str:
        height, width = self.distance_m.shape
        side = "below" if self.camera_in_water else "above"
        return f"<SurfacePicture {height} x {width}, from {side} the surface, mean {np.mean(self.radiance):.3g}>"

    def _figure(self) -> Figure:
        white = max(float(np.quantile(self.radiance, 0.99)), 1e-12)
        return Figure("radiance, white at its 99 % quantile", image=self.radiance / white)


def rendered(stage: RayStage, view: View, samples: int) -> SurfacePicture:
    """Return the picture, made in bands of rows on all cores. samples: per pixel and axis."""
    height, width, side = view.height, view.width, -1.0 if stage.camera_in_water else 1.0
    radiance, distance, wet = np.zeros((height, width, 3)), np.zeros((height, width)), np.zeros((height, width))
    normal, kind = np.zeros((height, width, 3)), np.zeros((height, width), np.uint8)
    world = ray_world(stage)
    rows = max(_AT_ONCE // (width * samples * samples), 1)

    def draw(first: int) -> None:
        band = slice(first, min(first + rows, height))
        out = radiance[band], distance[band], wet[band], normal[band], kind[band]
        origins, directions = _camera_rays(view, band, 1)
        footprint = side, view.pixel_m / samples, view.pixel_rad / samples
        middle = np.zeros((band.stop - band.start, width, 8))
        _centres(world, origins, directions, (side, view.pixel_m, view.pixel_rad), out[1:], middle)
        if samples > 1:
            origins, directions = _camera_rays(view, band, samples)
        key = (first * width * samples * samples) % 2**32
        _samples(world, origins, directions, footprint, key, middle, np.zeros(STACK), out[0])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(draw, range(0, height, rows)))  # to see their errors
    return SurfacePicture(radiance, distance, wet, normal, kind == 1, kind == 2, stage.camera_in_water)


def _camera_rays(view: View, rows: slice, samples: int) -> tuple[Array, Array]:
    """Return origins, y over the mean surface, and directions (h, w, n, 3) of the rays of a band of rows, `samples`
    squared in each pixel, evenly placed."""
    place = (np.arange(samples) + 0.5) / samples
    row = np.arange(rows.start, rows.stop)[:, None] + place
    column = np.arange(view.width)[:, None] + place
    shape = (len(row), view.width, samples, samples)
    y, x = (a.reshape(len(row), view.width, -1) for a in np.broadcast_arrays(
        np.broadcast_to(row[:, None, :, None], shape), np.broadcast_to(column[None, :, None, :], shape)
    ))  # fmt: skip
    origins = view.origins(x, y) - np.array([0.0, view.surface_y_m, 0.0])
    return np.ascontiguousarray(origins), np.ascontiguousarray(view.directions(x, y))


@exact
def _centres(w: RayWorld, origins: Any, directions: Any, of: Vector, seen: Any, hits: Any) -> None:
    """Write what the rays of pixels' centres meet: `SurfacePicture`, kind 1 for the surface, 2 for the floor, and where
    they meet the surface, hits (h, w, 8). of: side, width and spread of the rays. seen: distance, length in the water,
    normal and kind, (h, w) each, normals (h, w, 3).
    """
    (side, width, spread), (distance, wet, normal, kind) = of, seen
    rows, columns = distance.shape
    for row in range(rows):
        for column in range(columns):
            p, q = origins[row, column, 0], directions[row, column, 0]
            o, v = (p[0], p[1], p[2]), (q[0], q[1], q[2])
            # Follow the ray to the surface, else to the floor
            hit, floor = met(w, Ray(o, v, side, width, spread), NOWHERE, False)
            t, length = hit.distance, 0.0
            if t < math.inf:
                kind[row, column] = 1
                nx, ny, nz = hit.normal
                normal[row, column, 0], normal[row, column, 1], normal[row, column, 2] = nx, ny, nz
                # From the air go on into the water, for the length that is seen through
                if side > 0.0:
                    d = bent(v[0], v[1], v[2], nx, ny, nz, 1.0 / w.refractive_index)
                    at = o[0] + t * v[0] + OFF_M * d[0], o[1] + t * v[1] + OFF_M * d[1], o[2] + t * v[2] + OFF_M * d[2]
                    on, below = met(w, Ray(at, d, -1.0, width, spread), NOWHERE, False)
                    length = min(on.distance, below)
            elif floor < math.inf:
                t, kind[row, column] = floor, 2
            # Keep the hit: rays through the same pixel begin from it
            distance[row, column] = t
            wet[row, column] = t if side < 0.0 else length
            out = hits[row, column]
            out[0], out[4], out[5], out[6], out[7] = hit.distance, hit.a, hit.b, hit.sigma_m, hit.level
            out[1], out[2], out[3] = hit.normal


@exact
def _samples(
    w: RayWorld, origins: Any, directions: Any, of: Vector, key: int, hits: Any, stack: Any, radiance: Any
) -> None:
    """Write the radiance of pixels, the mean of their rays. of: side, width and spread of the rays. key: number of the
    first ray of all. hits: where the rays meet the surface, if each pixel has but one. stack: zeros of shape `STACK`.
    """
    side, width, spread = of
    rows, columns, count = origins.shape[:3]
    known = count == 1
    share = 1.0 / count
    for row in range(rows):
        for column in range(columns):
            k = hits[row, column]
            start = Hit(k[0], (k[1], k[2], k[3]), k[4], k[5], k[6], k[7])
            light = (0.0, 0.0, 0.0)
            for sample in range(count):
                p, q = origins[row, column, sample], directions[row, column, sample]
                ray = Ray((p[0], p[1], p[2]), (q[0], q[1], q[2]), side, width, spread)
                number = (key + (row * columns + column) * count + sample) & 0xFFFFFFFF
                put(stack, 0, ray, (share, share, share), 0.0, next_key(number, 0), 0)
                light = add(light, followed(w, stack, start, known), 1.0)
            radiance[row, column, 0], radiance[row, column, 1], radiance[row, column, 2] = light
