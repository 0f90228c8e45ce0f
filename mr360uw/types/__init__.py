# SPDX-License-Identifier: Apache-2.0
"""The types that flow between the stages, and the conventions that hold everywhere.

Units: metres, seconds, radians; wavelength in nm; optical coefficients in 1/m. Bare floats carry the unit in the
name (`time_s`, `depth_m`).

Axes: right-handed, +y up, camera at the origin of the world at t = 0, forward = -z, right = +x. The mean water
surface is the plane y = surface_y_m, the depth of the camera at t = 0; the depth of a point is surface_y_m - y,
positive below the surface.
Equirectangular pixels: see `mr360uw.sphere`.

Directions are unit vectors. View directions point from the camera outwards, light directions *towards* the light;
a direction of travel says `_travel`. Phase functions take the cosine between the directions of travel before and
after a scattering event, forward = +1.

Colour is linear Rec.709 scene radiance, float32, alpha premultiplied; names say `_linear` or `_encoded`. Arrays are
images first: (H, W, 3), row 0 at the top. Random numbers depend on the seed and the frame index alone.
"""

from __future__ import annotations

from mr360uw.types.frames import Floats, Layer, Rectangle, Tile, View, YuvImage
from mr360uw.types.light_and_water import BeamSpread, CausticStack, Environment, Lamp, Light, MediumTable, Sun, Surface

__all__ = [
    "BeamSpread",
    "CausticStack",
    "Environment",
    "Floats",
    "Lamp",
    "Layer",
    "Light",
    "MediumTable",
    "Rectangle",
    "Sun",
    "Surface",
    "Tile",
    "View",
    "YuvImage",
]
