# SPDX-License-Identifier: Apache-2.0
"""What a scene needs, decided before the first frame: a stage that changes nothing does not run.

The plan is made from the scene, its meshes' materials and the water alone, so that it can be printed (`--explain`) and
tested. What only a frame can tell (no sun in it, nothing visible) is decided by the pipeline, frame by frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.medium.lookup import beam_ratio
from mr360uw.scene import Scene
from mr360uw.types import MediumTable

_NEGLIGIBLE_BEAM = 0.002
"""Below this part of the surface's beam, caustics and shadows are less than half an 8-bit code value."""
_DIFFUSE_ROUGHNESS = 0.95
"""From this roughness up the glossy lobe of a dielectric is as wide as the irradiance lobe."""


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
    """What the plan asks of an object. glossy: some material is smoother than diffuse. moves: it has motion keys."""

    depth_m: float
    glossy: bool
    moves: bool


def make_plan(scene: Scene, objects: tuple[ObjectFacts, ...], medium: MediumTable | None) -> Plan:
    """Return the plan of a scene. medium: None where the plate has no water."""
    visible = bool(objects)
    receiver = scene.receiver is not None
    steps: list[Step] = []

    def step(stage: str, runs: bool, yes: str, no: str) -> bool:
        steps.append(Step(stage, runs, yes if runs else no))
        return runs

    step("environment", visible, "objects are lit by the plate", "nothing to light")
    sun = step("sun", visible and scene.light.sun != "none", f"sun: {scene.light.sun}", _no_sun(scene, visible))
    step("medium", medium is not None, f"water {scene.water.type}", 'water is "none"')
    beam = _beam_at_objects(objects, medium)
    deep = visible and beam < _NEGLIGIBLE_BEAM
    caustics = sun and medium is not None and not deep and scene.caustics.enabled
    step("surface", caustics, f"{scene.sea.model} sea", "no caustics, so no waves")
    step(
        "caustics",
        caustics,
        f"{100 * min(beam, 1):.0f} % of the beam reaches the objects",
        "switched off" if not scene.caustics.enabled
        else f"{100 * beam:.2f} % of the beam reaches the objects" if sun and deep
        else "needs a sun and water",
    )  # fmt: skip
    step(
        "glossy",
        visible and any(facts.glossy for facts in objects),
        "a material is smoother than diffuse",
        "every material is diffuse" if visible else "nothing to light",
    )
    step(
        "shadow",
        visible and receiver and sun and not deep,
        "the receiver catches shadows",
        "no receiver" if not receiver else "no sun to cast one" if not sun else "no sun at that depth",
    )
    step(
        "layer",
        visible,
        "objects stand still: geometry is kept between frames" if not any(f.moves for f in objects) else "objects move",
        "no objects: the plate goes through untouched",
    )
    return Plan(tuple(steps))


def _no_sun(scene: Scene, visible: bool) -> str:
    return "nothing to light" if not visible else f'light.sun = "{scene.light.sun}"'


def _beam_at_objects(objects: tuple[ObjectFacts, ...], medium: MediumTable | None) -> float:
    """Return the largest part of the surface's vertical beam that reaches an object, any channel."""
    if medium is None or not objects:
        return 1.0
    depth = np.array([max(facts.depth_m, 0.0) for facts in objects])
    return float(np.max(beam_ratio(medium, depth, 1.0) / beam_ratio(medium, 0.0, 1.0)))
