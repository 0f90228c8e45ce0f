# SPDX-License-Identifier: Apache-2.0
"""Caustics stand in the world: they stay where they are as a body turns below, and on the body as a camera turns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mr360uw.caustics import CausticSettings, GerstnerSea, caustic_stack, refract_to_air
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.motion import rigid, rotation_matrix
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.types import CausticStack, Layer
from tests.caustics import tolerances as tol
from tests.composite.scenes import SUN, placed, shot, sphere

ROWS = 24
BALL = sphere(ROWS, Material(roughness=1.0), radius=0.8)
STEP_DEG = 180.0 / ROWS  # a turn by this maps the ball's corners onto each other


@pytest.fixture(scope="module")
def stack() -> CausticStack:
    settings = CausticSettings(size=128, grid=64)
    sea = GerstnerSea(detail_slope=0.0)
    return caustic_stack(sea, refract_to_air(SUN.direction), [3.0, 3.5, 4.1, 4.7], 0.0, settings)


@pytest.fixture(params=["reference", "gl"])
def render(request) -> Any:
    if request.param == "reference":
        return render_layer
    request.getfixturevalue("gl")
    from mr360uw.composite.gl.layer_renderer import LayerRenderer

    return LayerRenderer().render


def ball(stack: CausticStack | None, yaw_deg: float = 0.0, camera_deg: float = 0.0) -> Shot:
    body = PlacedObject(BALL, rigid((0.1, 0.2, -1.9), rotation_matrix((yaw_deg, 0, 0))))
    turned = rotation_matrix((camera_deg, 0, 0))
    return shot(body, width=144, surface_y_m=4.0, caustics=stack, world_from_camera=turned)


def pattern(layer: Layer) -> np.ndarray:
    return layer.radiance[..., 1]


def test_a_body_turns_under_a_pattern_that_stands_still(render, stack):
    still = pattern(render(ball(stack)))
    plain = pattern(render(ball(None)))
    strength = np.abs(still - plain).max()
    assert strength > 0.1
    for steps in (1, 5, 12):
        turned = pattern(render(ball(stack, yaw_deg=steps * STEP_DEG)))
        assert np.abs(turned - still).max() < tol.TURNED_BALL * strength


def test_a_turning_camera_sees_the_pattern_stay_on_the_body(render, stack):
    columns = 9
    still = pattern(render(ball(stack)))
    turned = pattern(render(ball(stack, camera_deg=360.0 * columns / 144)))
    assert np.abs(np.roll(turned, columns, axis=1) - still).max() < tol.TURNED_BALL * still.max()


def test_a_moving_body_passes_through_the_pattern(stack):
    """Not glued to the body: its light where it was is not its light where it is."""
    here, there = (
        pattern(render_layer(shot(placed(BALL, (x, 0.2, -1.9)), width=144, surface_y_m=4.0, caustics=stack)))
        for x in (0.0, 0.15)
    )
    assert np.abs(here - there).max() > 0.1
