# SPDX-License-Identifier: Apache-2.0
"""Settings of drafts: frames that are shown while a value is being moved."""

from __future__ import annotations

from mr360uw.scene.model import Scene

COARSE_WIDTH = 512
"""Width [pixels] of drafts."""
_SAMPLES, _SUN_SAMPLES = 5, 8
_CAUSTIC_SIZE, _CAUSTIC_GRID, _PLANES = 128, 96, 2
_SHAFT_NODES, _SHAFT_SLICES = 128, 16
"""Settings of drafts, at most. A pixel of theirs is as wide as two of a frame: detail is lost anyhow."""
_BANDS = 21
"""Wavelengths of drafts, at most: veils of Jerlov's waters differ by up to 0.8 % from those of 61 wavelengths. With 16
it is 1.7 %; the time to solve and tabulate a water goes with their number."""


def coarse(scene: Scene) -> Scene:
    """Return a scene with the settings of a draft, for frames `COARSE_WIDTH` wide while a value is being moved.

    Edges, soft shadows, caustics and shafts are drawn with fewer samples, and the water is solved at fewer wavelengths.
    Shafts of waves and bodies alone are left out: at their physical strength a draft would hardly show them.
    """
    draw, caustics, water = scene.draw, scene.caustics, scene.water
    fewer = {"samples": min(draw.samples, _SAMPLES), "sun_samples": min(draw.sun_samples, _SUN_SAMPLES)}
    coarser = {
        "size": min(caustics.size, _CAUSTIC_SIZE),
        "grid": min(caustics.grid or _CAUSTIC_GRID, _CAUSTIC_GRID),
        "planes": min(caustics.planes, _PLANES),
    }
    shafts: dict[str, int | str] = {
        "resolution": min(scene.shafts.resolution, _SHAFT_NODES),
        "slices": min(scene.shafts.slices, _SHAFT_SLICES),
    }
    if not (scene.lamps or scene.shafts.on_plate or scene.shafts.strength > 1.0):
        shafts = {"mode": "off"}
    drafts = {
        "shafts": scene.shafts.model_copy(update=shafts),
        "draw": draw.model_copy(update=fewer),
        "caustics": caustics.model_copy(update=coarser),
        "water": water.model_copy(update={"bands": min(water.bands, _BANDS)}),
    }
    return scene.model_copy(update=drafts)
