# SPDX-License-Identifier: Apache-2.0
"""Plan of a run: which stages a scene needs, with the reason for each, decided before the first frame.

A stage that changes nothing does not run. The plan depends on the scene, its meshes' materials, its water and the kind
of plate alone, so it can be printed (`--explain`) and tested. Conditions of a single frame (no sun in it, nothing
visible) are found frame by frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

from mr360uw.caustics.settings import grid_of
from mr360uw.render.stages.plan_stages import (
    Facts,
    Share,
    Stage,
    beam_at_objects,
    gain_stage,
    match_stage,
    occlusion_stage,
    shadow_stage,
    shafts_stage,
    snow_stage,
    stage,
    sun_stage,
    surface_stage,
    track_sun_stage,
)
from mr360uw.scene.model import Scene
from mr360uw.types import MediumTable


@dataclass(frozen=True, slots=True)
class Plan:
    """The stages of a scene in the order in which they run.

    track_sun, track_gain: measured in a first pass over the clip; if they do not run, measured frame by frame.
    """

    environment: Stage
    sun: Stage
    track_sun: Stage
    medium: Stage
    gain: Stage
    track_gain: Stage
    lamps: Stage
    caustics: Stage
    glossy: Stage
    shafts: Stage
    shadow: Stage
    pattern: Stage
    occlusion: Stage
    layer: Stage
    surface: Stage
    snow: Stage
    match: Stage
    grain: Stage

    @property
    def stages(self) -> dict[str, Stage]:
        """Every stage by its name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __str__(self) -> str:
        width = max(map(len, self.stages))
        rows = ((name, "runs" if stage.runs else "skipped", stage.why) for name, stage in self.stages.items())
        return "\n".join(f"  {name:<{width}}  {runs:<7}  {why}" for name, runs, why in rows)


def make_plan(
    scene: Scene, objects: Facts, medium: MediumTable | None, share: Share = None, *, clip: bool = True
) -> Plan:
    """Return the plan of a scene. medium: None where the plate has no water. clip: the plate is more than one frame.

    share: gives the fraction of the veil that is the beam scattered once (`shaft_water.beam_share`); None: all of it.
    """
    snow = snow_stage(scene, medium)
    visible, light = bool(objects) or snow.runs, scene.light
    beam = beam_at_objects(objects, medium)
    sun = sun_stage(light, visible, beam)
    gain = gain_stage(scene, visible, medium)
    shadow = shadow_stage(scene, lit=sun.runs)
    quality = f"{scene.draw.quality} quality, {scene.draw.samples} samples a pixel"
    waves = f"{sea_in_words(scene)}; {100 * min(beam, 1):.0f} % of the beam reaches the objects"
    focuses, none = scene.caustics.enabled, "switched off" if not scene.caustics.enabled else "needs a sun and water"
    caustics = stage(sun.runs and medium is not None and focuses, waves, none)
    return Plan(
        environment=stage(visible, f"{'objects are' if objects else 'snow is'} lit by the plate", "nothing to light"),
        sun=sun,
        track_sun=track_sun_stage(sun, light, clip),
        medium=stage(medium is not None, scene.water.label, 'water is "none"'),
        gain=gain,
        track_gain=stage(
            gain.runs and clip and light.smooth,
            "in a first pass over the clip",
            "nothing to fit" if not gain.runs else "frame by frame: light.smooth is off" if clip else "one picture",
        ),
        lamps=stage(visible and len(scene.lamps) > 0, f"{len(scene.lamps)} of the scene", "the scene has none"),
        caustics=caustics,
        glossy=stage(
            visible and any(facts.glossy for facts in objects),
            "a material is smoother than diffuse",
            "every material is diffuse" if visible else "nothing to light",
        ),
        shafts=shafts_stage(scene, objects, medium, share, lit=sun.runs, waves=caustics.runs),
        shadow=shadow,
        pattern=stage(
            shadow.runs and medium is not None,
            "shadows take the plate's own caustics away",
            "no shadow" if not shadow.runs else 'water is "none"',
        ),
        occlusion=occlusion_stage(scene, objects),
        layer=stage(
            visible,
            "no objects, but snow" if not objects
            else f"{quality}; objects "
            + ("move" if any(o.moves for o in objects) else "stand still: geometry is kept between frames"),
            "no objects: the plate goes through untouched",
        ),
        surface=surface_stage(scene, objects, medium),
        snow=snow, match=match_stage(scene, visible),
        grain=stage(
            visible and scene.draw.grain > 0.0,
            f"objects get {100 * scene.draw.grain:.0f} % of the plate's grain",
            "draw.grain is 0" if visible else "nothing to cover",
        ),
    )  # fmt: skip


def joined_plan(plans: Sequence[Plan]) -> Plan:
    """Return the plan of a scene over time: a stage runs if it runs in one of the plans, for the reason that has."""
    stages = {
        name: next((plan.stages[name] for plan in plans if plan.stages[name].runs), stage)
        for name, stage in plans[0].stages.items()
    }
    return Plan(**stages)


def sea_in_words(scene: Scene) -> str:
    """Return the kind of a sea, its grid, and the waves that it does not draw, as the plan shows them."""
    sea, slope = scene.sea, scene.sea.detail_rms_slope
    drawn = f"{sea.model} sea, grid {grid_of(scene.caustics, sea)}"
    if slope == 0.0:
        return drawn
    source = "as set" if sea.detail_slope is not None else f"Cox & Munk at {sea.wind_speed:g} m/s"
    effect = "blur" if sea.detail_kind == "blur" else "ripples"
    return f"{drawn}; other waves as {effect}, rms slope {slope:.3f} ({source})"
