# SPDX-License-Identifier: Apache-2.0
"""The lights of a shot as shading and receivers walk over them (reference renderer): one entry for each kind."""

from __future__ import annotations

from mr360uw.composite.lighting.arrival import LightSource
from mr360uw.composite.lighting.blockers import Blockers
from mr360uw.composite.lighting.lamps import LampSource, lamps_of
from mr360uw.composite.lighting.sun import SunSource, sun_of
from mr360uw.composite.shot import Shot


def light_sources(shot: Shot, blockers: Blockers | None = None) -> tuple[LightSource, ...]:
    """Return a source for every light of a shot that shines. blockers: what shades; None for nothing."""
    sun = sun_of(shot)
    suns = [] if sun is None else [SunSource(sun, shot, blockers)]
    return (*suns, *(LampSource(lamp, shot, blockers) for lamp in lamps_of(shot)))
