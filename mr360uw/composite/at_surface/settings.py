# SPDX-License-Identifier: Apache-2.0
"""The `[surface]` table of a scene."""

from __future__ import annotations

from typing import Literal

from mr360uw.composite.settings import Samples
from mr360uw.parameters import Parameters, parameter

FAINTEST = 1e-3
"""Transmittance of the whole way, in its clearest channel, below which a body is not seen in the surface."""


class SurfaceSettings(Parameters):
    """Objects at the water's surface: mirrored in it, seen through it, cut by it."""

    objects: Literal["auto", "all", "none"] = parameter(
        "auto", "objects that the surface mirrors and cuts; auto: those that come near it"
    )
    within_m: float = parameter(
        3.0, "for auto: greatest depth of an object's top; images fade in over the last quarter of it",
        unit="m", above=0.0, high=200.0,
    )  # fmt: skip
    samples: Samples = parameter(17, "rays of a pixel that meet the surface", unit="1")
