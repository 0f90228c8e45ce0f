# SPDX-License-Identifier: Apache-2.0
"""Light sources of a shot in the reference renderer, over which shading and receivers loop."""

from __future__ import annotations

from mr360uw.composite.lighting.arrival import LightSource
from mr360uw.composite.lighting.blockers import Blockers
from mr360uw.composite.lighting.lamps import LampSource, lamps_of
from mr360uw.composite.lighting.sun import SunSource, sun_of
from mr360uw.composite.shot import Shot


def light_sources(shot: Shot, blockers: Blockers | None = None) -> tuple[LightSource, ...]:
    """Return a source for the sun and every lamp of a shot. blockers: None for no shadows."""
    sun = sun_of(shot)
    suns = [] if sun is None else [SunSource(sun, shot, blockers)]
    return (*suns, *(LampSource(lamp, shot, blockers) for lamp in lamps_of(shot)))
