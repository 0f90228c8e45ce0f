# SPDX-License-Identifier: Apache-2.0
"""The lookups of shading, Python against GLSL, on random tables and places."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.caustics.gl.stack import upload
from mr360uw.caustics.lookup import caustic_lookup, mip_levels
from mr360uw.gl.context import gl_device, texture_array_from_array
from mr360uw.ibl.lookup import environment_lookup, environment_texel, glossy_lookup
from mr360uw.sphere import unit
from mr360uw.types import CausticStack
from tests.agreement.tolerances import FILTER_WEIGHTS, FLOAT32_LOOKUP, FLOAT32_TWIN
from tests.glsl import glsl_call

COUNT = 4096


def padded(*columns: np.ndarray) -> np.ndarray:
    inputs = np.zeros((COUNT, 4))
    values = np.column_stack(columns)
    inputs[:, : values.shape[1]] = values
    return inputs.astype(np.float32).astype(np.float64)


@pytest.mark.usefixtures("gl")
def test_environment(rng: np.random.Generator) -> None:
    levels = rng.uniform(0, 2, (4, 32, 64, 3))
    roughness = np.array([0.1, 0.3, 0.6, 1.0])
    inputs = padded(unit(rng.normal(size=(COUNT, 3))), rng.uniform(0, 1.2, COUNT))
    textures = {"levels": texture_array_from_array(levels)}
    declared = "uniform sampler2DArray levels;"
    got = glsl_call("ibl/lookup.glsl", "environment_lookup(levels, 2, v.xyz)", 3, declared, textures, v=inputs)
    np.testing.assert_allclose(got, environment_lookup(levels[2], inputs[:, :3]), atol=FLOAT32_LOOKUP)
    column, row = rng.integers(-1, 65, COUNT), rng.integers(-1, 33, COUNT)
    got = glsl_call(
        "ibl/lookup.glsl", "environment_texel(levels, 1, ivec2(floor(v.xy)))", 3, declared, textures,
        v=padded(column + 0.5, row + 0.5),
    )  # fmt: skip
    np.testing.assert_allclose(got, environment_texel(levels[1], column, row), rtol=FLOAT32_TWIN)
    position = inputs.copy()
    position[:, 3] = np.interp(inputs[:, 3], roughness, np.arange(4))
    got = glsl_call("ibl/lookup.glsl", "glossy_lookup(levels, v.w, v.xyz)", 3, declared, textures, v=position)
    np.testing.assert_allclose(got, glossy_lookup(levels, roughness, inputs[:, :3], inputs[:, 3]), atol=FLOAT32_LOOKUP)


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("planes", [1, 2, 3, 4, 5, 7, 9])
@pytest.mark.parametrize("colours", [1, 3])
def test_caustics(rng: np.random.Generator, planes: int, colours: int) -> None:
    ratio = np.broadcast_to(rng.uniform(0.5, 2.0, (planes, 16, 16, colours)), (planes, 16, 16, 3))
    stack = CausticStack(ratio, np.geomspace(1.0, 16.0, planes), 8.0, unit([0.3, 0.9, -0.2]))
    inputs = padded(
        rng.uniform(-20, 20, COUNT), rng.uniform(0, 20, COUNT), rng.uniform(-20, 20, COUNT), rng.uniform(0, 20, COUNT)
    )
    on_device = upload(stack)
    got = glsl_call(
        "caustics/lookup.glsl",
        "caustic_lookup(stack, ratio, plane_depth, v.xyz, v.w)",
        3,
        "uniform CausticStack stack; uniform sampler2DArray ratio; uniform sampler2D plane_depth;",
        {"ratio": on_device.texture, "plane_depth": on_device.plane_depth},
        {"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction},
        v=inputs,
    )
    expected = caustic_lookup(stack, mip_levels(stack.ratio), inputs[:, 0], inputs[:, 1], inputs[:, 2], inputs[:, 3])
    limit = FLOAT32_LOOKUP if gl_device().software else FILTER_WEIGHTS
    np.testing.assert_allclose(got, expected, atol=limit)
    np.testing.assert_allclose(on_device.download().ratio, stack.ratio, rtol=FLOAT32_TWIN)
