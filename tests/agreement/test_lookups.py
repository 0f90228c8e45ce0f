# SPDX-License-Identifier: Apache-2.0
"""The lookups of shading, Python against GLSL, on random tables and places."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.caustics.gl.stack import upload
from mr360uw.caustics.lookup import caustic_lookup, mip_levels
from mr360uw.gl.context import gl_device, texture_array_from_array, texture_from_array
from mr360uw.ibl.lookup import environment_lookup, environment_texel, glossy_lookup
from mr360uw.medium.lookup import (
    ambient_ratio,
    beam_ratio,
    transmittance_lookup,
    unscattered_share,
    veil_lookup,
)
from mr360uw.sphere import direction_from_frame, frame_from_direction, unit
from mr360uw.types import CausticStack, MediumTable
from tests.agreement.tolerances import FILTER_WEIGHTS, FLOAT32_LOOKUP, FLOAT32_TWIN
from tests.glsl import glsl_call

COUNT = 4096


def padded(*columns: np.ndarray) -> np.ndarray:
    inputs = np.zeros((COUNT, 4))
    values = np.column_stack(columns)
    inputs[:, : values.shape[1]] = values
    return inputs.astype(np.float32).astype(np.float64)


@pytest.mark.usefixtures("gl")
def test_sphere(rng: np.random.Generator) -> None:
    position = padded(rng.uniform(0, 64, COUNT), rng.uniform(0.1, 31.9, COUNT))[:, :2]
    direction = direction_from_frame(position[:, 0], position[:, 1], 64, 32)
    got = glsl_call("sphere.glsl", "direction_from_frame(p, vec2(64.0, 32.0))", 3, p=position)
    np.testing.assert_allclose(got, direction, atol=FLOAT32_TWIN)
    back = glsl_call("sphere.glsl", "frame_from_direction(d, vec2(64.0, 32.0))", 2, d=direction)
    np.testing.assert_allclose(back, np.column_stack(frame_from_direction(direction, 64, 32)), atol=FLOAT32_LOOKUP)


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
def test_medium(rng: np.random.Generator) -> None:
    table = MediumTable(
        5.0, 8.0, rng.uniform(0, 1, (17, 32, 3)), rng.uniform(0.05, 0.5, (9, 8, 3)),
        rng.uniform(0.02, 0.3, (16, 3)), rng.uniform(0.05, 0.5, (16, 3)), rng.uniform(0.2, 0.8, (16, 3)),
    )  # fmt: skip
    distance, up = rng.exponential(10.0, COUNT), rng.uniform(-1, 1, COUNT)
    depth = rng.exponential(6.0, COUNT)
    inputs = padded(distance, up, depth)
    distance, up, depth = inputs[:, 0], inputs[:, 1], inputs[:, 2]
    textures = {
        "veil": texture_from_array(table.veil),
        "attenuation": texture_from_array(table.attenuation),
        "diffuse": texture_from_array(table.diffuse[None]),
        "beam": texture_from_array(np.stack([table.beam, table.unscattered])),
    }
    declarations = "uniform MediumTable medium; uniform sampler2D veil, attenuation, diffuse, beam;"
    uniforms = {"medium__camera_depth_m": table.camera_depth_m, "medium__length_m": table.length_m}
    cases = {
        "veil_lookup(medium, veil, v.x, v.y)": veil_lookup(table, distance, up),
        "transmittance_lookup(medium, attenuation, v.x, v.y)": transmittance_lookup(table, distance, up),
        "ambient_ratio(medium, diffuse, v.z)": ambient_ratio(table, depth),
        "beam_ratio(medium, beam, v.z, 0.8)": beam_ratio(table, depth, 0.8),
        "unscattered_share(medium, beam, v.z, 0.8)": unscattered_share(table, depth, 0.8),
    }
    for expression, expected in cases.items():
        got = glsl_call("medium/lookup.glsl", expression, 3, declarations, textures, uniforms, v=inputs)
        np.testing.assert_allclose(got, expected, atol=FLOAT32_LOOKUP, rtol=FLOAT32_LOOKUP, err_msg=expression)


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
