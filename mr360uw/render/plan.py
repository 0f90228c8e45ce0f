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

from mr360uw.caustics.flux.resolution import grid_of
from mr360uw.ibl import LightSettings
from mr360uw.medium.lookup import beam_fraction
from mr360uw.scene.model import Scene
from mr360uw.types import MediumTable

_NEGLIGIBLE_BEAM = 0.002
"""Fraction of the surface's beam below which caustics and shadows are less than half an 8-bit code value."""
Share = Callable[[], float] | None


@dataclass(frozen=True, slots=True)
class Stage:
    """Whether a stage runs, and the reason."""

    runs: bool
    why: str


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
    snow: Stage
    grain: Stage

    @property
    def stages(self) -> dict[str, Stage]:
        """Every stage by its name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __str__(self) -> str:
        width = max(map(len, self.stages))
        rows = ((name, "runs" if stage.runs else "skipped", stage.why) for name, stage in self.stages.items())
        return "\n".join(f"  {name:<{width}}  {runs:<7}  {why}" for name, runs, why in rows)


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


def make_plan(
    scene: Scene, objects: Facts, medium: MediumTable | None, share: Share = None, *, clip: bool = True
) -> Plan:
    """Return the plan of a scene. medium: None where the plate has no water. clip: the plate is more than one frame.

    share: gives the fraction of the veil that is the beam scattered once (`medium.shafts.beam_share`); None: all of it.
    """
    snow = _snow(scene, medium)
    visible, light, beam = bool(objects) or snow.runs, scene.light, _beam_at_objects(objects, medium)
    sun = _sun(light, visible, beam)
    gain = _gain(scene, visible, medium)
    receiver, shadow = scene.receiver, _shadow(scene, lit=sun.runs)
    quality = f"{scene.draw.quality} quality, {scene.draw.samples} samples a pixel"
    waves = f"{sea_in_words(scene)}; {100 * min(beam, 1):.0f} % of the beam reaches the objects"
    none = "needs a sun and water" if scene.caustics.enabled else "switched off"
    caustics = _stage(sun.runs and medium is not None and scene.caustics.enabled, waves, none)
    return Plan(
        environment=_stage(visible, f"{'objects are' if objects else 'snow is'} lit by the plate", "nothing to light"),
        sun=sun,
        track_sun=_track_sun(sun, light, clip),
        medium=_stage(medium is not None, scene.water.label, 'water is "none"'),
        gain=gain,
        track_gain=_stage(
            gain.runs and clip and light.smooth,
            "in a first pass over the clip",
            "nothing to fit" if not gain.runs else "frame by frame: light.smooth is off" if clip else "one picture",
        ),
        lamps=_stage(visible and len(scene.lamps) > 0, f"{len(scene.lamps)} of the scene", "the scene has none"),
        caustics=caustics,
        glossy=_stage(
            visible and any(facts.glossy for facts in objects),
            "a material is smoother than diffuse",
            "every material is diffuse" if visible else "nothing to light",
        ),
        shafts=_shafts(scene, objects, medium, share, lit=sun.runs, waves=caustics.runs),
        shadow=shadow,
        pattern=_stage(
            shadow.runs and medium is not None and receiver is not None and receiver.plate_caustics == "auto",
            "shadows take the plate's own caustics away",
            "no shadow" if not shadow.runs
            else 'water is "none"' if medium is None
            else "receiver.plate_caustics keeps them",
        ),
        occlusion=_occlusion(scene, objects),
        layer=_stage(
            visible,
            "no objects, but snow" if not objects
            else f"{quality}; objects "
            + ("move" if any(o.moves for o in objects) else "stand still: geometry is kept between frames"),
            "no objects: the plate goes through untouched",
        ),
        snow=snow,
        grain=_stage(
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


def _stage(runs: bool, yes: str, no: str) -> Stage:
    return Stage(runs, yes if runs else no)


def _sun(light: LightSettings, visible: bool, beam: float) -> Stage:
    deep = beam < _NEGLIGIBLE_BEAM
    return _stage(
        visible and light.sun != "none" and not deep,
        f"sun: {light.sun}",
        "nothing to light" if not visible
        else 'light.sun = "none"' if light.sun == "none"
        else f"{100 * beam:.2f} % of the beam reaches the objects",
    )  # fmt: skip


def _shadow(scene: Scene, *, lit: bool) -> Stage:
    receiver = scene.receiver
    return _stage(
        lit and receiver is not None and receiver.shadow,
        "the receiver catches shadows",
        "no receiver" if receiver is None else "switched off" if not receiver.shadow else "no sun to cast one",
    )


def _shafts(scene: Scene, objects: Facts, medium: MediumTable | None, share: Share, *, lit: bool, waves: bool) -> Stage:
    off = "no objects" if not objects else scene.shafts.why_off or ("" if medium is not None else 'water is "none"')
    if off:
        return Stage(False, off)
    from mr360uw.composite.shafts.shaft_words import in_words

    return Stage(
        *in_words(scene.shafts, share, lit, waves, any(o.casts_shadow for o in scene.objects), len(scene.lamps))
    )


def _snow(scene: Scene, medium: MediumTable | None) -> Stage:
    water = scene.water.water() if scene.snow.enabled and medium is not None else None
    if water is None:
        return Stage(False, 'water is "none"' if scene.snow.enabled else "switched off")
    from mr360uw.composite.snow.size_spectrum import in_words

    return Stage(*in_words(scene.snow, water))


def _occlusion(scene: Scene, objects: tuple[ObjectFacts, ...]) -> Stage:
    receiver = scene.receiver
    on_ground = receiver is not None and receiver.occlusion
    moving = any(facts.moves for facts in objects)
    return _stage(
        bool(objects) and (scene.draw.ambient_occlusion or on_ground),
        f"ambient light among {'objects' if scene.draw.ambient_occlusion else 'none of the objects'}"
        f"{' and on the receiver' if on_ground else ''}; "
        f"{'rays between bodies in every frame that moves them' if moving else 'rays once: objects stand still'}",
        "switched off" if objects else "nothing to light",
    )


def _track_sun(sun: Stage, light: LightSettings, clip: bool) -> Stage:
    if not sun.runs or light.sun != "detect":
        return Stage(False, "no sun" if not sun.runs else f"light.sun is {light.sun!r}")
    if not clip:
        return Stage(False, "one picture")
    if light.track is not None:
        return Stage(True, f"light.track, {light.track.name}")
    return _stage(light.smooth, "in a first pass over the clip", "frame by frame: light.smooth is off")


def _gain(scene: Scene, visible: bool, medium: MediumTable | None) -> Stage:
    water = scene.water
    return _stage(
        visible and medium is not None and water.fits_gain,
        "the veil's gain is fitted to the plate",
        "no objects to veil" if not visible
        else 'water is "none"' if medium is None
        else "the veil is each frame's own map" if water.mode == "plate"
        else "water.gain is given",
    )  # fmt: skip


def _beam_at_objects(objects: Facts, medium: MediumTable | None) -> float:
    """Return the largest fraction of the surface's vertical beam that reaches an object, any channel."""
    if medium is None or not objects:
        return 1.0
    depth = np.array([max(facts.depth_m, 0.0) for facts in objects])
    return float(np.max(beam_fraction(medium, depth, 1.0)))
