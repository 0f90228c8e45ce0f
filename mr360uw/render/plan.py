# SPDX-License-Identifier: Apache-2.0
"""What a scene needs, decided before the first frame: a stage that changes nothing does not run.

The plan is made from the scene, its meshes' materials and the water alone, so that it can be printed (`--explain`) and
tested. What only a frame can tell (no sun in it, nothing visible) is decided by the pipeline, frame by frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.ibl import LightSettings
from mr360uw.medium.lookup import beam_ratio
from mr360uw.scene.model import Scene
from mr360uw.types import MediumTable

_NEGLIGIBLE_BEAM = 0.002
"""Below this part of the surface's beam, caustics and shadows are less than half an 8-bit code value."""


@dataclass(frozen=True, slots=True)
class Step:
    """One stage of the plan: whether it runs, and the reason."""

    stage: str
    runs: bool
    why: str


@dataclass(frozen=True, slots=True)
class Plan:
    """The stages of a scene in the order in which they run."""

    steps: tuple[Step, ...]

    def runs(self, stage: str) -> bool:
        """Return whether a stage runs; raise KeyError for a name that is not in the plan."""
        return {step.stage: step.runs for step in self.steps}[stage]

    def __str__(self) -> str:
        width = max(len(step.stage) for step in self.steps)
        return "\n".join(
            f"  {step.stage:<{width}}  {'runs   ' if step.runs else 'skipped'}  {step.why}" for step in self.steps
        )


@dataclass(frozen=True, slots=True)
class ObjectFacts:
    """What the plan asks of an object.

    depth_m: of its highest point below the mean surface, the least over the whole clip. glossy: some material is
    smoother than diffuse. moves: it does not rest in the world.
    """

    depth_m: float
    glossy: bool
    moves: bool


def make_plan(scene: Scene, objects: tuple[ObjectFacts, ...], medium: MediumTable | None) -> Plan:
    """Return the plan of a scene. medium: None where the plate has no water."""
    visible = bool(objects)
    steps: list[Step] = []

    def step(stage: str, runs: bool, yes: str, no: str) -> bool:
        steps.append(Step(stage, runs, yes if runs else no))
        return runs

    smooth = "in a first pass over the clip" if scene.light.smooth else "frame by frame"
    step("environment", visible, "objects are lit by the plate", "nothing to light")
    beam = _beam_at_objects(objects, medium)
    deep = visible and beam < _NEGLIGIBLE_BEAM
    sun = step(
        "sun",
        visible and scene.light.sun != "none" and not deep,
        f"sun: {_sun_source(scene.light, smooth)}",
        "nothing to light" if not visible
        else 'light.sun = "none"' if scene.light.sun == "none"
        else f"{100 * beam:.2f} % of the beam reaches the objects",
    )  # fmt: skip
    step("medium", medium is not None, f"water {scene.water.type}", 'water is "none"')
    water = scene.water
    step(
        "gain",
        visible and medium is not None and water.fits_gain,
        f"the veil's gain is fitted to the plate {smooth}",
        "no objects to veil" if not visible
        else 'water is "none"' if medium is None
        else "the veil is each frame's own map" if water.mode == "plate"
        else "water.gain is given",
    )  # fmt: skip
    step(
        "caustics",
        sun and medium is not None and scene.caustics.enabled,
        f"{scene.sea.model} sea; {100 * min(beam, 1):.0f} % of the beam reaches the objects",
        "switched off" if not scene.caustics.enabled else "needs a sun and water",
    )
    step(
        "glossy",
        visible and any(facts.glossy for facts in objects),
        "a material is smoother than diffuse",
        "every material is diffuse" if visible else "nothing to light",
    )
    receiver = scene.receiver
    step(
        "shadow",
        sun and receiver is not None and receiver.shadow,
        "the receiver catches shadows",
        "no receiver" if receiver is None else "switched off" if not receiver.shadow else "no sun to cast one",
    )
    step(
        "layer",
        visible,
        "objects stand still: geometry is kept between frames" if not any(f.moves for f in objects) else "objects move",
        "no objects: the plate goes through untouched",
    )
    step(
        "grain",
        visible and scene.draw.grain > 0.0,
        f"objects get {100 * scene.draw.grain:.0f} % of the plate's grain",
        "draw.grain is 0" if visible else "nothing to cover",
    )
    return Plan(tuple(steps))


def _sun_source(light: LightSettings, smooth: str) -> str:
    """Return where the sun comes from, in words."""
    if light.sun != "detect":
        return light.sun
    return f"light.track, {light.track.name}" if light.track is not None else f"detect, {smooth}"


def _beam_at_objects(objects: tuple[ObjectFacts, ...], medium: MediumTable | None) -> float:
    """Return the largest part of the surface's vertical beam that reaches an object, any channel."""
    if medium is None or not objects:
        return 1.0
    depth = np.array([max(facts.depth_m, 0.0) for facts in objects])
    return float(np.max(beam_ratio(medium, depth, 1.0) / beam_ratio(medium, 0.0, 1.0)))
