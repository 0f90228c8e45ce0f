# SPDX-License-Identifier: Apache-2.0
"""Shot of one instant: view, placed objects, lights, medium, receiver, mattes and caustics; snow over its layer."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.cache import Cache
from mr360uw.caustics import refract_to_air
from mr360uw.caustics.settings import CausticSettings
from mr360uw.composite import Shot
from mr360uw.composite.lighting.lamps import lamps_of
from mr360uw.composite.lighting.sun import sun_of
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.settings import DrawSettings
from mr360uw.ibl.lighting import turned
from mr360uw.medium.small_angles import spread_of
from mr360uw.render.backends import Backend
from mr360uw.render.loaded import Loaded
from mr360uw.render.plate_light import FrameLight
from mr360uw.render.stages.eye_stage import Eye
from mr360uw.types import CausticStack, Floats, Layer, Light, MediumTable, Sun, View

if TYPE_CHECKING:
    from mr360uw.composite.shafts.shaft_light import ShaftLight

_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in air below which no caustics are computed: the beam is oblique and weak."""
_DEEPER = 3.0
"""How far below the camera waves are followed for the whole plate, in lengths over which daylight falls to 1/e."""
_NOT_OF_LAYERS = {name: DrawSettings.model_fields[name].default for name in ("grain", "motion_samples", "shutter")}
"""Settings of drawing that the layer of one instant does not depend on."""


def instants(loaded: Loaded, now: Loaded, time_s: float, shutter_s: float) -> list[tuple[float, Loaded]]:
    """Return the instants [s] over which a frame is averaged for motion blur, one without it, and the scene at each.

    now: the scene at the frame's time. Its light and water hold for the whole exposure.
    """
    steps = now.scene.draw.motion_samples if shutter_s > 0.0 and loaded.moves else 1
    if steps == 1:
        return [(time_s, now)]
    times = time_s + ((np.arange(steps) + 0.5) / steps - 0.5) * shutter_s
    return [(one, loaded.at(one, now)) for one in times.tolist()]


def shot_at(
    loaded: Loaded, light: FrameLight, medium: MediumTable | None, time_s: float, index: int, cache: Cache
) -> Shot:
    """Return the shot of an instant of frame `index`, without caustics and without what is of one eye (`seen_by`).

    cache: holds the light in the world's axes.
    """
    view = loaded.view(time_s)
    environment = cache.of(turned, light.environment, view.world_from_camera)
    objects = tuple(o.at(time_s, index, view.position, view.world_from_camera) for o in loaded.objects)
    suns: tuple[Sun, ...] = () if environment.sun is None else (environment.sun,)
    lamps: tuple[Light, ...] = tuple(lamp.at(time_s, view, objects) for lamp in loaded.lamps)
    return Shot(
        view=view,
        objects=objects,
        environment=environment,
        lights=(*suns, *lamps),
        medium=medium,
        draw=loaded.scene.draw.model_copy(update=_NOT_OF_LAYERS),
        between=light.between,
    )


def seen_by(loaded: Loaded, shot: Shot, eye: Eye, pattern: PlatePattern | None, index: int) -> Shot:
    """Return a shot of frame `index` as one eye sees it, with the receiver and the mattes in its picture."""
    matte, matte_distance = loaded.mattes.at(index, eye.number)
    return dataclasses.replace(
        shot,
        view=dataclasses.replace(shot.view, eye_m=eye.eye_m),
        receiver=loaded.receiver.at(index, eye.number) if loaded.receiver is not None else None,
        holdout=matte,
        holdout_distance_m=matte_distance,
        pattern=pattern,
    )


def with_caustics(loaded: Loaded, backend: Backend, shot: Shot, time_s: float, cache: Cache) -> Shot:
    """Return the shot with the caustics of its sun on planes around the objects' depths, if the plan has caustics.

    cache: holds caustics of the same backend.
    """
    sun_in_air = _caustic_sun(loaded, shot)
    if sun_in_air is None:
        return shot
    depths = loaded.caustic_depths
    planes, settings = depths.planes(shot), depths.settings
    return dataclasses.replace(shot, caustics=_caustics(loaded, backend, settings, sun_in_air, planes, time_s, cache))


def shafts_of(loaded: Loaded, backend: Backend, shot: Shot, time_s: float, cache: Cache) -> ShaftLight | None:
    """Return what the shafts of a shot depend on beside it; None where none show, or the camera is not below.

    cache: holds caustics of the same backend.
    """
    settings, camera_m = loaded.scene.shafts, shot.view.depth_of(np.zeros(3))
    if not (loaded.plan.shafts.runs and not settings.why_off) or camera_m < 0.0:
        return None
    medium = loaded.surroundings.medium_at(time_s)
    if medium is None:
        return None
    from mr360uw.composite.shafts.code_change import bodies_show, waves_show
    from mr360uw.composite.shafts.shaft_light import ShaftLight

    still = ShaftLight(settings, medium)
    sun_in_air, depths = _caustic_sun(loaded, shot), loaded.caustic_depths
    if sun_in_air is None or not waves_show(shot, still):
        return still if lamps_of(shot) or bodies_show(shot, still) else None
    deepest_m = float(camera_m + min(settings.range_m, _DEEPER * medium.length_m)) if settings.on_plate else 0.0
    planes = depths.water_planes(shot, deepest_m)
    return ShaftLight(settings, medium, _caustics(loaded, backend, depths.of_water, sun_in_air, planes, time_s, cache))


def _caustic_sun(loaded: Loaded, shot: Shot) -> Floats | None:
    """Return the direction (3,) towards a shot's sun in air; None where it makes no caustics."""
    sun = sun_of(shot) if loaded.plan.caustics.runs else None
    if sun is None:
        return None
    sun_in_air = refract_to_air(sun.direction, loaded.scene.water.refractive_index)
    return sun_in_air if sun_in_air[1] >= _LOWEST_SUN else None


def _caustics(
    loaded: Loaded,
    backend: Backend,
    settings: CausticSettings,
    sun_in_air: Floats,
    depths_m: Floats,
    time_s: float,
    cache: Cache,
) -> CausticStack:
    """Return a backend's caustics of a scene: for its bodies, or for the water. sun_in_air: (3,). depths_m: (n,)."""
    medium, sea, index = loaded.surroundings.medium, loaded.scene.sea, loaded.scene.water.refractive_index
    spread = spread_of(medium) if medium is not None else None
    return cache.of(backend.caustics, sea, sun_in_air, depths_m, time_s, settings, index, spread, keep=2)


def with_snow(
    loaded: Loaded, backend: Backend, shot: Shot, layer: Layer, time_s: float, exposure_s: float, cache: Cache
) -> Layer:
    """Return the layer of a shot with its snow, the layer itself where the plan has none.

    exposure_s: over which particles are drawn out. cache: holds layers of the same backend; a layer stands for all that
    its shot depends on.
    """
    medium = loaded.surroundings.medium
    if not loaded.plan.snow.runs or medium is None:
        return layer
    from mr360uw.composite.snow.draw import Snow, with_particles
    from mr360uw.composite.snow.size_spectrum import particle_scattering

    half, settings, sea = 0.5 * exposure_s, loaded.scene.snow, loaded.scene.sea
    opens, closes = (_view_at(loaded, shot.view, at_s) for at_s in (time_s - half, time_s + half))
    snow = Snow(settings, particle_scattering(medium.water), sea, time_s, exposure_s, opens, closes)

    return cache.of(with_particles, snow, shot, layer, backend.cache)


def _view_at(loaded: Loaded, view: View, time_s: float) -> View:
    """Return the camera's view at another time, within the same frame."""
    position, rotation = loaded.surroundings.camera.at(time_s)
    return dataclasses.replace(view, position=np.asarray(position), world_from_camera=np.asarray(rotation))
