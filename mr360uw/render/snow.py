# SPDX-License-Identifier: Apache-2.0
"""Marine snow of a frame: its place in the plan, and the layer with it. Nothing is imported for scenes without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite import Shot
from mr360uw.render.backends import Backend
from mr360uw.render.loaded import Loaded
from mr360uw.types import Layer, View


def with_snow(
    loaded: Loaded, backend: Backend, shot: Shot, layer: Layer, time_s: float, exposure_s: float, kept: Cache
) -> Layer:
    """Return the layer of a shot with its snow, the layer itself where the plan has none.

    exposure_s: over which particles are drawn out. kept: holds layers of the same backend; a layer stands for all that
    its shot depends on.
    """
    medium = loaded.surroundings.medium
    if not loaded.plan.snow.runs or medium is None:
        return layer
    from mr360uw.composite.snow.draw import Snow, with_particles
    from mr360uw.composite.snow.size_spectrum import particle_scattering

    half, settings, sea = 0.5 * exposure_s, loaded.scene.snow, loaded.scene.sea
    opens, closes = (_turned_to(loaded, shot.view, at_s) for at_s in (time_s - half, time_s + half))
    snow = Snow(settings, particle_scattering(medium.water), sea, time_s, exposure_s, opens, closes)

    def drawn() -> Layer:
        stack = None if shot.caustics is None else backend.download(shot.caustics)
        return with_particles(snow, replace(shot, caustics=stack), layer, backend.cache)

    key = layer, shot.view.key, opens.key, closes.key, settings, snow.scattering, sea, time_s, exposure_s
    return kept.get("snow", key, drawn)


def _turned_to(loaded: Loaded, view: View, time_s: float) -> View:
    """Return the camera's view at another time, within the same frame."""
    position, rotation = loaded.surroundings.camera.at(time_s)
    return replace(view, position=np.asarray(position), world_from_camera=np.asarray(rotation))
