# SPDX-License-Identifier: Apache-2.0
"""Which objects of a shot the moving surface shows, by how deep they are."""

from __future__ import annotations

import numpy as np

from mr360uw.composite.at_surface.settings import WITHIN_M, SurfaceSettings
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.types import Floats


def object_presence(shot: Shot, settings: SurfaceSettings) -> Floats:
    """Return for each visible object of a shot the fraction (n,) in which the surface shows it, by its top's depth."""
    depth = shot.view.surface_y_m - tops(shot)
    if settings.objects == "all":
        return np.ones(len(depth))
    return np.clip(4.0 * (1.0 - depth / WITHIN_M), 0.0, 1.0)


def tops(shot: Shot) -> Floats:
    """Return the height (n,) [m] in the world of the highest point of each visible object."""
    return np.array([o.to_world(o.mesh.hull.reshape(-1, 3))[:, 1].max() for o in visible(shot)])


def visible(shot: Shot) -> tuple[PlacedObject, ...]:
    """Return the objects of a shot that are not hidden."""
    return tuple(placed for placed in shot.objects if placed.visible)
