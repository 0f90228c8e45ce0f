# SPDX-License-Identifier: Apache-2.0
"""The stage of light shafts: size of the grid that the light in the water is computed on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mr360uw.bench.measuring import Knobs, MeasuredStage, Workload, qualities, relative_rms
from mr360uw.bench.workbench import Workbench
from mr360uw.caustics import CausticSettings, caustic_stack, refract_to_air, stack_depths
from mr360uw.composite.objects import load_objects
from mr360uw.composite.raycast.geometry import occluding
from mr360uw.composite.shafts.shaft_light import grid_of
from mr360uw.medium import Medium, ShaftScene, Water, shaft_field
from mr360uw.medium.shafts.deviation import march
from mr360uw.medium.shafts.settings import ShaftSettings
from mr360uw.medium.small_angles import spread_of
from mr360uw.sphere import unit
from mr360uw.types import Sun, View

_WIDTH = 4096
"""Width [pixels] of the frame that the grid is for: so large that it takes as many nodes as the settings give it."""
_STRIDE = 8
"""Pixels from ray to ray of those that the grid is read for."""
_TRUE_RAYS, _STEPS = 128, 2048
"""Rays that are compared, and their segments."""
_SUN = Sun(unit([0.3, 0.85, -0.4]), np.ones(3), 0.0035, 1.0)


def shaft_stage() -> MeasuredStage:
    """Shafts: nodes and slices of the grid."""

    def of(resolution: int, slices: int) -> Knobs:
        return {"shafts.resolution": resolution, "shafts.slices": slices}

    sizes = (128, 256, 512, 1024, 2048)
    return MeasuredStage(
        "shafts",
        "Shafts: nodes and slices of their grid",
        "the grid's nodes that a view of 90 x 60 degrees reads, and reading 128 rays",
        "2048 segments along each of 128 rays, of the sun under waves and behind a whale: the change of radiance",
        tuple(of(size, slices) for size in sizes for slices in (8, 16, 32, 64)),
        (of(256, 8), of(512, 32)),
        qualities("shafts.resolution", "shafts.slices"),
        _open,
    )


def _open(bench: Workbench) -> Workload:
    scene = bench.scene({})
    depth_m = scene.camera.depth_m
    medium = Medium(Water.jerlov("IB"), camera_depth_m=depth_m)
    view = View(_WIDTH, _WIDTH // 2, surface_y_m=depth_m)
    whale = load_objects(scene.objects)[0].at(0.0, 0, np.zeros(3), np.eye(3))
    waves = caustic_stack(
        scene.sea, refract_to_air(_SUN.direction), stack_depths(0.2, 20.0, 12), 0.0,
        CausticSettings(size=256, grid=128), spread=spread_of(medium),
    )  # fmt: skip
    shafts = ShaftScene.of(view, medium, _SUN, [occluding([whale], np.zeros(3))], waves)
    column = np.arange(3 * _WIDTH // 8, 5 * _WIDTH // 8, _STRIDE) + 0.5
    row = np.arange(_WIDTH // 6, _WIDTH // 3, _STRIDE) + 0.5
    rays = np.asarray(view.directions(*(at.ravel() for at in np.meshgrid(column, row))), np.float64).reshape(-1, 3)
    some = np.random.default_rng(3).choice(len(rays), _TRUE_RAYS, replace=False)
    seen = rays[some]
    surface = np.where(seen[:, 1] > 0.0, depth_m / np.maximum(seen[:, 1], 1e-9), np.inf)
    ends = np.minimum(np.minimum(shafts.bodies.first_hit_m(shafts.origin, seen), surface), scene.shafts.range_m)
    truth = march(shafts, seen, ends, _STEPS)

    def prepare(knobs: Knobs) -> Callable[[int], Any]:
        settings = ShaftSettings(resolution=knobs["shafts.resolution"], slices=knobs["shafts.slices"])
        grid = grid_of(settings, _WIDTH, shafts)
        return lambda _: shaft_field(shafts, grid, rays).radiance(seen, ends)

    return Workload(prepare, lambda got: relative_rms(got, truth))
