# SPDX-License-Identifier: Apache-2.0
"""Shot of one instant and eye: view, objects, lights, medium, receiver, mattes, caustics; and surface and snow over it.

What both eyes of a stereo plate see is found once: light, sun, gain and water in the left eye's picture, so that no
difference between the pictures makes their objects differ; caustics, shadow maps and ambient light do not depend on
the view. The plate's own caustics are smoothed in each eye's picture alike: a clip's mean is kept of the left eye
alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.cache import Cache
from mr360uw.caustics import refract_to_air
from mr360uw.caustics.settings import CausticSettings
from mr360uw.color import unseen_change
from mr360uw.composite import Shot
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.at_surface.settings import object_presence
from mr360uw.composite.lighting.light_sources import lamps_of, sun_of
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.settings import DrawSettings
from mr360uw.composite.shot import Receiver
from mr360uw.constants import JUST_BELOW_M
from mr360uw.errors import ParameterError
from mr360uw.ibl.lighting import turned
from mr360uw.medium import Medium
from mr360uw.medium.small_angles import spread_of
from mr360uw.render.backends import Backend
from mr360uw.render.loaded import Loaded
from mr360uw.render.mattes import Mattes
from mr360uw.render.plate_light import FrameLight
from mr360uw.scene.model import Scene
from mr360uw.types import CausticStack, Floats, Layer, Light, MediumTable, Sun, View
from mr360uw.video import VideoFrame

if TYPE_CHECKING:
    from mr360uw.composite.shafts import ShaftLight
    from mr360uw.depth.occlusion import PlateDepth

_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in air below which no caustics are computed: the beam is oblique and weak."""
_DEEPER = 3.0
"""How far below the camera waves are followed for the whole plate, in lengths over which daylight falls to 1/e."""
_NOT_OF_LAYERS = {name: DrawSettings.model_fields[name].default for name in ("grain", "motion_samples", "shutter")}
"""Settings of drawing that the layer of one instant does not depend on."""


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """One eye of a frame.

    plate: what it shows. eye_m: distance to the right of the middle [m]. number: 1 for the right eye of two, else 0.
    kept: results that all instants of the frame share.
    """

    plate: VideoFrame
    eye_m: float = 0.0
    number: int = 0
    kept: Cache = field(default_factory=Cache)


def eyes_of(scene: Scene, plate: VideoFrame) -> tuple[Eye, ...]:
    """Return the eyes of a plate's frame: itself, or left and right where the scene works on both.

    Raises `ParameterError` where the scene works on both and the frame is one panorama.
    """
    if scene.plate.eye != "both":
        return (Eye(plate),)
    if plate.right is None:
        raise ParameterError(
            'plate.eye - is "both", but the frame has one eye - take frames that open_video(..., eye="both") reads, or '
            "leave out plate.eye"
        )
    half_m = 0.5 * scene.camera.ipd_m
    return Eye(plate, -half_m, 0), Eye(plate.right, half_m, 1)


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


def seen_by(
    loaded: Loaded, shot: Shot, eye: Eye, receiver: Receiver | None, pattern: PlatePattern | None, index: int
) -> Shot:
    """Return a shot of frame `index` as one eye sees it, with the receiver and the mattes in its picture."""
    matte, distance, soft, beside = eye.kept.of(
        _mattes, loaded.mattes, loaded.plate_depth, eye.plate, index, eye.number
    )
    return replace(
        shot,
        view=replace(shot.view, eye_m=eye.eye_m),
        receiver=receiver,
        holdout=matte,
        holdout_distance_m=distance,
        holdout_soft=soft,
        holdout_beside=beside,
        pattern=pattern,
        unseen=unseen_change(eye.plate.spec),
    )


Beside = tuple[Floats, Floats]
"""Of the surfaces beside those in front: distances (H, W) [m], and the fractions (H, W) of pixels that they cover."""


def _mattes(
    mattes: Mattes, plate_depth: PlateDepth | None, plate: VideoFrame, index: int, number: int
) -> tuple[Floats | None, Floats | None, bool, Beside | None]:
    """Return the mask and the distances that hide bodies in frame `index`, whether the plate's depth does, and what
    lies beside.
    """
    mask, matte_m = mattes.at(index, number)
    if plate_depth is None:
        return mask, matte_m, False, None
    shown = plate_depth.surfaces(index, plate, number)
    beside = None
    if shown.beside_m is not None and shown.share is not None:
        beside = _nearer(matte_m, shown.beside_m), shown.share
    return mask, _nearer(matte_m, shown.distance_m), True, beside


def _nearer(matte_m: Floats | None, shown_m: Floats) -> Floats:
    """Return the lesser of distances (H, W) [m], the second as it is where there is no matte."""
    return shown_m if matte_m is None else np.minimum(matte_m, shown_m)


def with_caustics(loaded: Loaded, backend: Backend, shot: Shot, time_s: float, cache: Cache) -> Shot:
    """Return the shot with the caustics of its sun on planes around the objects' depths, if the plan has caustics.

    cache: holds caustics of the same backend.
    """
    sun_in_air = _caustic_sun(loaded, shot)
    if sun_in_air is None:
        return shot
    depths = loaded.caustic_depths
    planes, settings = depths.planes(shot), depths.settings
    return replace(shot, caustics=_caustics(loaded, backend, settings, sun_in_air, planes, time_s, cache))


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
    from mr360uw.composite.shafts import ShaftLight, bodies_show, waves_show

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
    loaded: Loaded,
    backend: Backend,
    shot: Shot,
    layer: Layer,
    variables: Aovs | None,
    time_s: float,
    exposure_s: float,
    cache: Cache,
) -> tuple[Layer, Aovs | None]:
    """Return the layer of a shot and its variables with its snow; as they are where the plan has none.

    exposure_s: over which particles are drawn out. cache: holds layers of the same backend; a layer stands for all that
    its shot depends on.
    """
    medium = loaded.surroundings.medium
    if not loaded.plan.snow.runs or medium is None:
        return layer, variables
    from mr360uw.composite.snow.draw import Snow, with_particles
    from mr360uw.composite.snow.particles import particle_scattering

    half, settings, sea = 0.5 * exposure_s, loaded.scene.snow, loaded.scene.sea
    opens, closes = (_view_at(loaded, shot.view, at_s) for at_s in (time_s - half, time_s + half))
    snow = Snow(settings, particle_scattering(medium.water), sea, time_s, exposure_s, opens, closes)
    return cache.of(with_particles, snow, shot, layer, variables, backend.cache)


def _view_at(loaded: Loaded, view: View, time_s: float) -> View:
    """Return the camera's view at another time, within the same frame."""
    position, rotation = loaded.surroundings.camera.at(time_s)
    return replace(view, position=np.asarray(position), world_from_camera=np.asarray(rotation))


def with_surface(
    loaded: Loaded, backend: Backend, shot: Shot, layer: Layer, variables: Aovs | None, time_s: float, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return the layer of a shot and its variables with the moving surface; as they are where the plan has none.

    Images of bodies in the surface are in the layer alone, the cut through bodies is in both. cache: holds layers of
    the same backend; a layer stands for all that its shot depends on.
    """
    settings = loaded.scene.surface
    if not loaded.plan.surface.runs or shot.medium is None or shot.view.depth_of(np.zeros(3)) <= 0.0:
        return layer, variables
    if not np.any(object_presence(shot, settings) > 0.0):
        return layer, variables
    sea, at_surface = loaded.scene.sea, _table_at_surface(loaded, shot.medium, time_s, cache)
    if at_surface is None:
        return layer, variables
    from mr360uw.composite.at_surface.surface_layer import with_bodies

    layer, before = cache.of(with_bodies, shot, sea, time_s, at_surface, settings, layer, backend.cache)
    return layer, variables if variables is None or before is None else variables.cut(before)


def _table_at_surface(loaded: Loaded, table: MediumTable, time_s: float, cache: Cache) -> MediumTable | None:
    """Return the table of a frame's water for rays that start at the surface; None without water."""
    medium, still = loaded.surroundings.medium_at(time_s), loaded.surroundings.medium
    if medium is None or still is None:
        return None
    from mr360uw.composite.at_surface.water_sides import table_at_surface

    return cache.of(table_at_surface, table, medium.unit_table, cache.of(_unit_table_below_surface, still))


def _unit_table_below_surface(medium: Medium) -> MediumTable:
    """Return the table without gain of a water for rays from just below its surface."""
    return medium.at_depth(JUST_BELOW_M).unit_table
