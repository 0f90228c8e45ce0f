# SPDX-License-Identifier: Apache-2.0
"""Stages of a plan, one function each: whether a scene needs it, and the reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mr360uw.composite.at_surface.settings import FAINTEST, WITHIN_M
from mr360uw.ibl import LightSettings
from mr360uw.medium.lookup import beam_fraction, transmittance_lookup
from mr360uw.medium.shafts.settings import ShaftSettings
from mr360uw.scene.model import Scene
from mr360uw.types import MediumTable

_LEAST_SHARE = 0.01
"""Fraction of the veil that the beam's first scattering must add: what shafts change is less than that."""


def in_words(
    settings: ShaftSettings, share: Callable[[], float] | None, lit: bool, waves: bool, shading: bool, lamps: int
) -> tuple[bool, str]:
    """Return whether light in the water is drawn, and why.

    share: gives the fraction of the veil that is the beam scattered once (`shaft_water.beam_share`); None: all of it.
    lit: whether there is a sun. waves, shading: whether waves or bodies change its beam. lamps: their number.
    """
    if not lamps and not (lit and (waves or shading)):
        return False, "no sun and no lamps" if not lit else "neither waves nor bodies change the beam"
    of_beam = 1.0 if share is None else share()
    if of_beam == 0.0 and not lamps:
        return False, "the water does not scatter"
    by = [word for word, there in (("waves", lit and waves), ("bodies", lit and shading), ("lamps", lamps)) if there]
    number = f"{100 * of_beam:.2g} % of the veil is light of the beam scattered once"
    if settings.mode == "auto" and of_beam < _LEAST_SHARE and not lamps:
        return False, f"{number}, below {100 * _LEAST_SHARE:g} %"
    least = f"; where codes change by {settings.least_codes:g}" if settings.least_codes else ""
    return True, f"by {', '.join(by)}; {number}{least}"


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
    """Return whether light in the water is drawn. lit, waves: whether there are a sun and its caustics."""
    off = "no objects" if not objects else scene.shafts.why_off or ("" if medium is not None else 'water is "none"')
    if off:
        return Stage(False, off)
    return Stage(
        *in_words(scene.shafts, share, lit, waves, any(o.casts_shadow for o in scene.objects), len(scene.lamps))
    )


def surface_stage(scene: Scene, objects: Facts, medium: MediumTable | None) -> Stage:
    """Return whether the surface shows and cuts objects: those near it whose image the water leaves bright enough."""
    settings = scene.surface
    if settings.objects == "none" or not objects or medium is None:
        return Stage(
            False, "switched off" if settings.objects == "none" else "no objects" if not objects else 'water is "none"'
        )
    depth_m = min(facts.depth_m for facts in objects)
    within = np.inf if settings.objects == "all" else WITHIN_M
    left = float(transmittance_lookup(medium, _shallowest_m(scene) + max(depth_m, 0.0), 0.0).max())
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


def _shallowest_m(scene: Scene) -> float:
    """Return a lower bound [m] of the camera's depth."""
    camera = scene.camera
    if camera.track is not None:
        return 0.0
    return max(min([camera.depth_m, *(depth_m for _, depth_m in camera.depth_keys)]), 0.0)


def snow_stage(scene: Scene, medium: MediumTable | None) -> Stage:
    """Return whether particles are drawn."""
    drawn = scene.snow.amount > 0.0
    water = scene.water.water() if drawn and medium is not None else None
    if water is None:
        return Stage(False, 'water is "none"' if drawn else "snow.amount is 0")
    from mr360uw.composite.snow.size_spectrum import in_words

    return Stage(*in_words(scene.snow, water))


def occlusion_stage(scene: Scene, objects: tuple[ObjectFacts, ...]) -> Stage:
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
        visible and scene.match.changes,
        scene.match.in_words,
        "nothing to cover" if not visible else "switched off",
    )


def beam_at_objects(objects: Facts, medium: MediumTable | None) -> float:
    """Return the largest fraction of the surface's vertical beam that reaches an object, any channel."""
    if medium is None or not objects:
        return 1.0
    depth = np.array([max(facts.depth_m, 0.0) for facts in objects])
    return float(np.max(beam_fraction(medium, depth, 1.0)))
