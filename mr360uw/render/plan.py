# SPDX-License-Identifier: Apache-2.0
"""Plan of a run: which stages a scene needs, with the reason for each, decided before the first frame.

A stage that changes nothing does not run. The plan depends on the scene, its meshes' materials, its water and the kind
of plate alone, so it can be printed (`--explain`) and tested. Conditions of a single frame (no sun in it, nothing
visible) are found frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from mr360uw.caustics.settings import grid_of
from mr360uw.composite.shot import FAINTEST, WITHIN_M
from mr360uw.ibl import LightSettings
from mr360uw.medium.lookup import beam_fraction, transmittance_lookup
from mr360uw.scene.model import Scene
from mr360uw.types import MediumTable

_LEAST_SHARE = 0.01
"""Fraction of the veil that the beam's first scattering must add: what shafts change is less than that."""


_NEGLIGIBLE_BEAM = 0.002
"""Fraction of the surface's beam below which caustics and shadows are less than half an 8-bit code value."""
Share = Callable[[], float] | None


@dataclass(frozen=True, slots=True)
class Stage:
    """Whether a stage runs, and the reason."""

    runs: bool
    why: str


@dataclass(frozen=True, slots=True)
class ObjectFacts:
    """Properties of an object that the plan depends on.

    depth_m: least depth of its highest point below the mean surface over the clip. glossy: whether a material is
    smoother than diffuse. moves: whether it moves in the world.
    """

    depth_m: float
    glossy: bool
    moves: bool


Facts = tuple[ObjectFacts, ...]


def stage(runs: bool, yes: str, no: str) -> Stage:
    """Return a stage with the reason for which it runs, or does not."""
    return Stage(runs, yes if runs else no)


def sun_stage(light: LightSettings, visible: bool, beam: float) -> Stage:
    """Return whether the sun lights a scene. beam: fraction of its beam that reaches an object."""
    deep = beam < _NEGLIGIBLE_BEAM
    return stage(
        visible and light.sun != "none" and not deep,
        f"sun: {light.sun}",
        "nothing to light" if not visible
        else 'light.sun = "none"' if light.sun == "none"
        else f"{100 * beam:.2f} % of the beam reaches the objects",
    )  # fmt: skip


def shadow_stage(scene: Scene, *, lit: bool) -> Stage:
    """Return whether shadows are cast on the receiver."""
    receiver = scene.receiver
    return stage(
        lit and receiver is not None and receiver.shadow,
        "the receiver catches shadows",
        "no receiver" if receiver is None else "switched off" if not receiver.shadow else "no sun to cast one",
    )


def shafts_stage(
    scene: Scene, objects: Facts, medium: MediumTable | None, share: Share, *, lit: bool, waves: bool
) -> Stage:
    """Return whether light in the water is drawn. share: see `make_plan`. lit, waves: whether there are a sun and its
    caustics.
    """
    settings, lamps = scene.shafts, len(scene.lamps)
    off = "no objects" if not objects else settings.why_off or ("" if medium is not None else 'water is "none"')
    if off:
        return Stage(False, off)
    shading = any(placed.casts_shadow for placed in scene.objects)
    if not lamps and not (lit and (waves or shading)):
        return Stage(False, "no sun and no lamps" if not lit else "neither waves nor bodies change the beam")
    of_beam = 1.0 if share is None else share()
    if of_beam == 0.0 and not lamps:
        return Stage(False, "the water does not scatter")
    by = [word for word, there in (("waves", lit and waves), ("bodies", lit and shading), ("lamps", lamps)) if there]
    number = f"{100 * of_beam:.2g} % of the veil is light of the beam scattered once"
    if settings.mode == "auto" and of_beam < _LEAST_SHARE and not lamps:
        return Stage(False, f"{number}, below {100 * _LEAST_SHARE:g} %")
    least = f"; where codes change by {settings.least_codes:g}" if settings.least_codes else ""
    return Stage(True, f"by {', '.join(by)}; {number}{least}")


def surface_stage(scene: Scene, objects: Facts, medium: MediumTable | None) -> Stage:
    """Return whether the surface shows and cuts objects: those near it whose image the water leaves bright enough."""
    settings = scene.surface
    if settings.objects == "none" or not objects or medium is None:
        return Stage(
            False, "switched off" if settings.objects == "none" else "no objects" if not objects else 'water is "none"'
        )
    depth_m, camera = min(facts.depth_m for facts in objects), scene.camera
    shallowest_m = 0.0  # a lower bound of the camera's depth
    if camera.track is None:
        shallowest_m = max(min([camera.depth_m, *(keyed_m for _, keyed_m in camera.depth_keys)]), 0.0)
    within = np.inf if settings.objects == "all" else WITHIN_M
    left = float(transmittance_lookup(medium, shallowest_m + max(depth_m, 0.0), 0.0).max())
    near = f"an object comes within {max(depth_m, 0.0):.1f} m of the surface"
    if depth_m >= within:
        return Stage(False, f"no object comes within {within:g} m of the surface (least depth {depth_m:.1f} m)")
    if scene.plate.eyes == 2 and settings.objects == "auto" and depth_m > 0.0:
        return Stage(False, f"{near}; its mirror image is not drawn for both eyes")
    return stage(
        left > FAINTEST,
        f"{near}; the water leaves up to {100 * left:.0f} % of its mirror image",
        f"{near}; the water leaves {100 * left:.2g} % of its mirror image",
    )


def snow_stage(scene: Scene, medium: MediumTable | None) -> Stage:
    """Return whether particles are drawn."""
    drawn = scene.snow.amount > 0.0
    water = scene.water.water() if drawn and medium is not None else None
    if water is None:
        return Stage(False, 'water is "none"' if drawn else "snow.amount is 0")
    from mr360uw.composite.snow.particles import in_words

    return Stage(*in_words(scene.snow, water))


def occlusion_stage(scene: Scene, objects: Facts) -> Stage:
    """Return whether ambient light among bodies is solved."""
    receiver = scene.receiver
    on_ground = receiver is not None and receiver.occlusion
    moving = any(facts.moves for facts in objects)
    return stage(
        bool(objects) and (scene.draw.ambient_occlusion or on_ground),
        f"ambient light among {'objects' if scene.draw.ambient_occlusion else 'none of the objects'}"
        f"{' and on the receiver' if on_ground else ''}; "
        f"{'rays between bodies in every frame that moves them' if moving else 'rays once: objects stand still'}",
        "switched off" if objects else "nothing to light",
    )


def track_sun_stage(sun: Stage, light: LightSettings, clip: bool) -> Stage:
    """Return whether the sun is followed over the clip."""
    if not sun.runs or light.sun != "detect":
        return Stage(False, "no sun" if not sun.runs else f"light.sun is {light.sun!r}")
    if not clip:
        return Stage(False, "one picture")
    if light.track is not None:
        return Stage(True, f"light.track, {light.track.name}")
    return stage(light.smooth, "in a first pass over the clip", "frame by frame: light.smooth is off")


def gain_stage(scene: Scene, visible: bool, medium: MediumTable | None) -> Stage:
    """Return whether the veil's gain is fitted."""
    water = scene.water
    return stage(
        visible and medium is not None and water.fits_gain,
        "the veil's gain is fitted to the plate" + (", and its far end to open water" if water.fits_ratio else ""),
        "no objects to veil" if not visible
        else 'water is "none"' if medium is None
        else "water.gain is given",
    )  # fmt: skip


def match_stage(scene: Scene, visible: bool) -> Stage:
    """Return whether the plate's light is read without its grade, and bodies are given its look."""
    return stage(
        visible and scene.match.changes, scene.match.in_words, "nothing to cover" if not visible else "switched off"
    )


def beam_at_objects(objects: Facts, medium: MediumTable | None) -> float:
    """Return the largest fraction of the surface's vertical beam that reaches an object, any channel."""
    if medium is None or not objects:
        return 1.0
    depth = np.array([max(facts.depth_m, 0.0) for facts in objects])
    return float(np.max(beam_fraction(medium, depth, 1.0)))


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

    share: gives the fraction of the veil that is the beam scattered once (`shaft_scene.beam_share`); None: all of it.
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
