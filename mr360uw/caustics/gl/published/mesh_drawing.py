# SPDX-License-Identifier: Apache-2.0
"""Passes of the methods that are kept for comparison: triangles drawn at pixel centres, and scrolling copies."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from mr360uw.caustics.gl.passes import Passes, Textures
from mr360uw.caustics.gl.plane import CausticPlane
from mr360uw.caustics.published.scrolling import scroll_offsets
from mr360uw.caustics.sea.base import SeaParameters


def draw_mesh(passes: Passes, target: moderngl.Framebuffer, rays: Textures, plane: CausticPlane) -> None:
    """Draw every refracted triangle with the intensity that `published.divided_areas` gives it."""
    inputs: dict[str, Any] = dict(rays)
    define: dict[str, Any] = {plane.method.upper(): 1}
    if plane.method != "ratio":
        vertices = passes.texture("vertices", plane.grid, plane.grid, 2)
        passes.fill([vertices], "published/vertices", rays, **plane.uniforms, **define)
        inputs["vertices"] = vertices
    passes.draw(
        target, "published/mesh", inputs, vertex="caustics/gl/published/mesh.vert", vertices=6 * plane.grid**2,
        **plane.uniforms, **define,
    )  # fmt: skip


def scrolled(passes: Passes, light: moderngl.Texture, sea: SeaParameters, time_s: float, name: str) -> moderngl.Texture:
    """Return the darker of two scrolled copies of a map, as `published.scrolling` does, not scaled."""
    size = light.width
    out = passes.texture(name, size, size)
    shift = (np.round(scroll_offsets(sea, time_s) * size) % size).astype(np.int64).ravel()
    passes.fill([out], "published/scroll", {"light": light}, size=size, shift=shift)
    return out
