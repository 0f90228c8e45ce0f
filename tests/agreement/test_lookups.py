# SPDX-License-Identifier: Apache-2.0
"""The lookup of caustic stacks, Python against GLSL, for every way in which planes and colours are packed."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.caustic_lookup import caustic_lookup, mip_levels
from mr360uw.base.sphere import unit
from mr360uw.composite.gl.device import StackTextures, mip_atlas
from mr360uw.gl import gl_device
from mr360uw.types import CausticStack
from tests.agreement.tolerances import FILTER_WEIGHTS, FLOAT32_LOOKUP
from tests.glsl import glsl_call

COUNT = 4096


def padded(*columns: np.ndarray) -> np.ndarray:
    inputs = np.zeros((COUNT, 4))
    values = np.column_stack(columns)
    inputs[:, : values.shape[1]] = values
    return inputs.astype(np.float32).astype(np.float64)


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("planes", [1, 2, 3, 4, 5, 7, 9])
@pytest.mark.parametrize("colours", [1, 3])
def test_caustics(rng: np.random.Generator, planes: int, colours: int) -> None:
    ratio = np.broadcast_to(rng.uniform(0.5, 2.0, (planes, 16, 16, colours)), (planes, 16, 16, 3))
    stack = CausticStack(ratio, np.geomspace(1.0, 16.0, planes), 8.0, unit([0.3, 0.9, -0.2]))
    inputs = padded(
        rng.uniform(-20, 20, COUNT), rng.uniform(0, 20, COUNT), rng.uniform(-20, 20, COUNT), rng.uniform(0, 20, COUNT)
    )
    got = glsl_call(
        "base/caustic_lookup.glsl",
        "caustic_lookup(stack, ratio, plane_depth, v.xyz, v.w)",
        3,
        "uniform CausticStack stack; uniform sampler2DArray ratio; uniform sampler2D plane_depth;",
        {name.removeprefix("caustic_"): texture for name, texture in StackTextures().of(stack).items()},
        {"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction},
        v=inputs,
    )
    expected = caustic_lookup(stack, mip_levels(stack.ratio), inputs[:, 0], inputs[:, 1], inputs[:, 2], inputs[:, 3])
    limit = FLOAT32_LOOKUP if gl_device().software else FILTER_WEIGHTS
    np.testing.assert_allclose(got, expected, atol=limit)


@pytest.mark.usefixtures("gl")
def test_a_stack_of_the_same_size_is_written_over_the_last_one(rng: np.random.Generator) -> None:
    def stack(planes: int) -> CausticStack:
        ratio = rng.uniform(0.5, 2.0, (planes, 8, 8, 1))
        return CausticStack(
            np.broadcast_to(ratio, (planes, 8, 8, 3)), np.arange(1.0, planes + 1.0), 8.0, unit([0.3, 0.9, -0.2])
        )

    textures, first = StackTextures(), stack(4)

    def holds(stack: CausticStack) -> bytes:
        return mip_atlas(mip_levels(stack.ratio[..., :1].astype(np.float32))).tobytes()

    kept = textures.of(first)["caustic_ratio"]
    assert kept.read(alignment=1) == holds(first)
    assert textures.of(first)["caustic_ratio"] is kept
    second, larger = stack(4), stack(7)
    assert textures.of(second)["caustic_ratio"] is kept
    assert kept.read(alignment=1) == holds(second)
    assert textures.of(larger)["caustic_ratio"].read(alignment=1) == holds(larger)
