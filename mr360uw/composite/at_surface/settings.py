# SPDX-License-Identifier: Apache-2.0
"""The `[surface]` table of a scene, and which bodies it shows in the surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from mr360uw.parameters import Parameters, parameter
from mr360uw.types import Floats

if TYPE_CHECKING:
    from mr360uw.composite.shot import Shot

WITHIN_M = 3.0
"""Greatest depth of an object's top at which "auto" shows it in the surface; images fade in over its last quarter."""
FAINTEST = 1e-3
"""Transmittance of the whole way, in its clearest channel, below which a body is not seen in the surface."""


class SurfaceSettings(Parameters):
    """Objects at the water's surface: mirrored in it, seen through it, cut by it."""

    objects: Literal["auto", "all", "none"] = parameter(
        "auto", "objects that the surface mirrors and cuts; auto: those that come near it"
    )


def object_presence(shot: Shot, settings: SurfaceSettings) -> Floats:
    """Return for each visible object of a shot the fraction (n,) in which the surface shows it, by its top's depth."""
    depth = shot.view.surface_y_m - tops(shot)
    if settings.objects == "all":
        return np.ones(len(depth))
    return np.clip(4.0 * (1.0 - depth / WITHIN_M), 0.0, 1.0)


def tops(shot: Shot) -> Floats:
    """Return the height (n,) [m] in the world of the highest point of each visible object."""
    return np.array([o.to_world(o.mesh.hull.reshape(-1, 3))[:, 1].max() for o in shot.visible])
