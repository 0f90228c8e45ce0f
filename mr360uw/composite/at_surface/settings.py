# SPDX-License-Identifier: Apache-2.0
"""The `[surface]` table of a scene."""

from __future__ import annotations

from typing import Literal

from mr360uw.parameters import Parameters, parameter

WITHIN_M = 3.0
"""Greatest depth of an object's top at which "auto" shows it in the surface; images fade in over its last quarter."""
FAINTEST = 1e-3
"""Transmittance of the whole way, in its clearest channel, below which a body is not seen in the surface."""


class SurfaceSettings(Parameters):
    """Objects at the water's surface: mirrored in it, seen through it, cut by it."""

    objects: Literal["auto", "all", "none"] = parameter(
        "auto", "objects that the surface mirrors and cuts; auto: those that come near it"
    )
