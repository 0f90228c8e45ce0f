# SPDX-License-Identifier: Apache-2.0
"""Keys that scene files had, and what became of them: the remedy in the message on an unknown key."""

from __future__ import annotations

_PUBLISHED = "is fixed at the published value now"
_PHASE = "is part of water.phase now: a mean cosine, or [index, slope]"
_FILE = "is the mesh file's alone now"

REMOVED = {
    "plate.ocio.file": "is plate.ocio.config now",
    "water.inherent": "is fixed at solonenko2015 now; others by type csv",
    "water.kd": "goes with the type now; others by type csv",
    "water.mean_cosine": _PHASE,
    "water.particle_index": _PHASE,
    "water.junge_slope": _PHASE,
    "water.rule": "is fixed at rectangle now",
    "water.surface": "is fixed at snell now",
    "object.unit": "is object.scale now: 0.01 for cm, 0.001 for mm; or object.size_m",
    "object.vertex_colors": "is fixed at auto now",
    "object.emission_scale": _FILE,
    "object.part": _FILE,
    "object.normal_texture": _FILE,
    "object.orm_texture": _FILE,
    "lamp.object": "is lamp.attach now: the object's number",
    "lamp.kind": "follows from lamp.cone_deg: 360 for a point",
    "lamp.watts": "is lamp.lumen now: about 300 lm a watt of white light",
    "lamp.edge": "is fixed at 0.3 now",
    "receiver.plate_caustics": "is fixed at auto now",
    "holdout.feather_px": "is the matte's own softness now",
    "light.transfer": "is fixed at srgb now",
    "light.ramp_deg": "is fixed at 10 now",
    "light.mr360_strength": _PUBLISHED,
    "light.mr360_power": _PUBLISHED,
    "light.mr360_base": _PUBLISHED,
    "light.landis_threshold": _PUBLISHED,
    "light.landis_alpha": _PUBLISHED,
    "light.akyuz_gamma": _PUBLISHED,
    "light.kovaleski_threshold": _PUBLISHED,
    "light.kovaleski_boost": _PUBLISHED,
    "light.piecewise_split": _PUBLISHED,
    "light.glossy_roughness": "is fixed at [0.1, 0.2, 0.4, 0.7, 1.0] now",
    "light.latitude_deg": "is part of light.place_deg now",
    "light.longitude_deg": "is part of light.place_deg now",
    "light.minimum_confidence": 'is fixed at 0.5 now; light.sun = "none" takes no sun',
    "sea.detail_wavelength_m": "is fixed at 0.12 now",
    "sea.detail_speed": "is fixed at 0.25 now",
    "sea.tiling": "is fixed at lattice now",
    "sea.swell": "is fixed at 0 now; a longer sea.fetch_m makes longer waves",
    "sea.peak_enhancement": "is fixed at 3.3 now",
    "sea.phillips_constant": "is fixed at 0.0081 now; sea.significant_wave_height_m sets the height",
    "sea.small_wave_cutoff_m": "is sea.shortest_wavelength_m now",
    "caustics.refractive_index": "is water.refractive_index now",
    "caustics.water_blur": "is always on now",
    "shafts.phase": "follows from water.phase",
    "shafts.whole": "is always off now",
    "shafts.threshold": 'is fixed at 2 now; shafts.mode = "on" has none',
    "snow.enabled": "is snow.amount = 1 now",
    "snow.smallest_mm": "is part of snow.sizes_mm now",
    "snow.largest_mm": "is part of snow.sizes_mm now",
    "snow.nearest_m": "is fixed at 0.15 now",
    "snow.seed": "follows from sea.seed",
    "snow.settling": "is fixed at 1 now",
    "snow.orbits": "is always on now",
    "snow.aperture_mm": "is fixed at 0.6 now",
    "snow.focus_m": "is fixed at 1 now",
    "surface.within_m": "is fixed at 3 now",
    "surface.samples": "is fixed at 17 now",
    "match.enabled": "follows from the other keys: match.softness = 0 measures nothing",
    "match.sharpening_px": "is fixed at 1 now",
    "output.lossless": 'is output.quality = "lossless" now',
    "output.threads": "is always one for each core now",
    "output.faststart": "is always on now",
}
"""By their names without numbers of entries."""


def removed(location: tuple[str | int, ...]) -> str:
    """Return what became of a key, "" of one that there never was."""
    return REMOVED.get(".".join(part for part in location if isinstance(part, str)), "")
