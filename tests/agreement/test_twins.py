# SPDX-License-Identifier: Apache-2.0
"""Every function of every shader outside the folders `gl`, against its Python partner on random input.

The functions are found in the shaders: one without a partner of its name or without a case here fails.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw
from mr360uw.base import sphere
from mr360uw.base.caustic_lookup import caustic_lookup, mip_levels, soft_caustic_lookup
from mr360uw.base.sphere import unit
from mr360uw.composite import shading
from mr360uw.ibl import lookup as ibl_lookup
from mr360uw.ibl.filters import split_sum
from mr360uw.medium import lookup as medium
from mr360uw.types import CausticStack, MediumTable
from tests.agreement import tolerances as tol
from tests.glsl import glsl_call

ROOT = Path(mr360uw.__file__).parent
COUNT = 2000
Columns = dict[str, np.ndarray]


def shader_files() -> list[Path]:
    return sorted(f for f in ROOT.rglob("*.glsl") if "gl" not in f.relative_to(ROOT).parts)


def functions_of(shader: Path) -> list[str]:
    code = re.sub(r"//.*", "", shader.read_text("utf-8"))
    return re.findall(r"^\w+ (\w+)\([^;{]*\)\s*\{", code, re.MULTILINE)


FUNCTIONS = [(str(f.relative_to(ROOT)), name) for f in shader_files() for name in functions_of(f)]


def rounded(values: np.ndarray) -> np.ndarray:
    """Return values as single precision holds them, so that both sides start from the same numbers."""
    return np.asarray(values, np.float32).astype(np.float64)


def row_by_row(function: Callable[..., Any], *columns: np.ndarray) -> np.ndarray:
    """Return a function of numbers or vectors, called for every row of its columns."""
    return np.array([function(*row) for row in zip(*columns, strict=True)])


@dataclass(frozen=True)
class Case:
    """An expression in GLSL and the numbers that its Python partner gives."""

    expression: str
    columns: Columns
    expected: np.ndarray
    tolerance: float = tol.FLOAT32_TWIN
    declarations: str = ""
    textures: Callable[[], dict[str, Any]] = dict
    uniforms: dict[str, Any] = field(default_factory=dict)


def upward(rng: np.random.Generator) -> np.ndarray:
    v = rng.standard_normal((COUNT, 3))
    v[:, 1] = np.abs(v[:, 1]) + 1e-3
    return rounded(unit(v))


def sphere_case(name: str, rng: np.random.Generator) -> Case:
    p = rounded(np.column_stack([rng.uniform(0.0, 64.0, COUNT), rng.uniform(0.1, 31.9, COUNT)]))
    d = sphere.direction_from_frame(p[:, 0], p[:, 1], 64, 32)
    if name == "direction_from_frame":
        return Case(f"{name}(p, vec2(64.0, 32.0))", {"p": p}, d)
    back = np.column_stack(sphere.frame_from_direction(rounded(d), 64, 32))
    return Case(f"{name}(d, vec2(64.0, 32.0))", {"d": d}, back, tol.FLOAT32_LOOKUP)


def caustic_case(name: str, rng: np.random.Generator) -> Case:
    soft = rng.uniform(0.5, 2.0, (4, 16, 16, 1)) if name == "soft_caustic_lookup" else None
    ratio, depths = rng.uniform(0.5, 2.0, (4, 16, 16, 3)), np.geomspace(1.0, 16.0, 4)
    stack = CausticStack(ratio, depths, 8.0, unit([0.3, 0.9, -0.2]), soft)
    at = rounded(rng.uniform((-20.0, 0.0, -20.0, 0.0), 20.0, (COUNT, 4)))
    columns, more = {"v": at}, ""
    if soft is None:
        expected = caustic_lookup(stack, mip_levels(stack.ratio), *at.T)
    else:
        columns["unturned"], more = rounded(rng.uniform(0.0, 1.0, (COUNT, 3))), ", unturned"
        expected = soft_caustic_lookup(stack, mip_levels(stack.ratio), mip_levels(soft), *at.T, columns["unturned"])

    def textures() -> dict[str, Any]:
        from mr360uw.composite.gl.device import StackTextures

        return {name.removeprefix("caustic_"): texture for name, texture in StackTextures().of(stack).items()}

    return Case(
        f"{name}(stack, ratio, plane_depth, v.xyz, v.w{more})", columns, expected, tol.FILTER_WEIGHTS,
        "uniform CausticStack stack; uniform sampler2DArray ratio; uniform sampler2D plane_depth;", textures,
        {"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction},
    )  # fmt: skip


def medium_case(name: str, rng: np.random.Generator) -> Case:
    table = MediumTable(
        5.0, 8.0, rng.uniform(0, 1, (17, 32, 3)), rng.uniform(0.05, 0.5, (9, 8, 3)),
        rng.uniform(0.02, 0.3, (5, 16, 3)), rng.uniform(0.05, 0.5, (16, 3)), rng.uniform(0.2, 0.8, (16, 3)),
    )  # fmt: skip
    v = rounded(np.column_stack([rng.exponential(10.0, COUNT), rng.uniform(-1, 1, COUNT), rng.exponential(6.0, COUNT)]))
    s, up, depth = v.T
    t = (0.5 + 0.5 * up, medium.table_coordinate(s, 8.0))
    cases = {
        "table_coordinate": ("table_coordinate(v.x, 8.0)", medium.table_coordinate(s, 8.0)),
        "bilinear": ("bilinear(veil, 0.5 + 0.5 * v.y, 1.0 - 8.0 / (v.x + 8.0))", medium.bilinear(table.veil, *t)),
        "linear": (
            "linear(beam, 1, table_coordinate(v.x, 8.0))",
            medium.linear(table.unscattered, medium.table_coordinate(s, 8.0)),
        ),
        "in_water_distance": ("in_water_distance(v.x, 5.0, v.y)", medium.in_water_distance(s, 5.0, up)),
        "veil_lookup": ("veil_lookup(medium, veil, v.x, v.y)", medium.veil_lookup(table, s, up)),
        "transmittance_lookup": (
            "transmittance_lookup(medium, attenuation, v.x, v.y)", medium.transmittance_lookup(table, s, up)
        ),
        "optical_length": ("optical_length(medium, attenuation, v.x, v.y)", medium.optical_length(table, s, up)),
        "ambient_ratio": ("ambient_ratio(medium, diffuse, v.z, v.y)", medium.ambient_ratio(table, depth, up)),
        "path_attenuation": (
            "path_attenuation(medium, beam, 1, v.z, 0.8)",
            medium.path_attenuation(table, table.unscattered, depth, 0.8),
        ),
        "beam_ratio": ("beam_ratio(medium, beam, v.z, 0.8)", medium.beam_ratio(table, depth, 0.8)),
        "unscattered_share": ("unscattered_share(medium, beam, v.z, 0.8)", medium.unscattered_share(table, depth, 0.8)),
    }  # fmt: skip
    expression, expected = cases[name]

    def textures() -> dict[str, Any]:
        return {
            "veil": texture(table.veil),
            "attenuation": texture(table.attenuation),
            "diffuse": texture(table.diffuse),
            "beam": texture(np.stack([table.beam, table.unscattered])),
        }

    return Case(
        expression, {"v": v}, expected, tol.FLOAT32_LOOKUP,
        "uniform MediumTable medium; uniform sampler2D veil, attenuation, diffuse, beam;", textures,
        {"medium__camera_depth_m": table.camera_depth_m, "medium__length_m": table.length_m},
    )  # fmt: skip


def environment_case(name: str, rng: np.random.Generator) -> Case:
    levels, roughness = rng.uniform(0.0, 2.0, (4, 32, 64, 3)), np.array([0.1, 0.3, 0.6, 1.0])
    d, r = rounded(unit(rng.standard_normal((COUNT, 3)))), rng.uniform(0.0, 1.2, COUNT)
    column, row = rng.integers(-1, 65, COUNT), rng.integers(-1, 33, COUNT)
    columns = {"d": d, "k": np.interp(r, roughness, np.arange(4)), "p": np.stack([column, row], axis=-1) + 0.5}
    cases = {
        "environment_texel": (
            "environment_texel(levels, 1, ivec2(floor(p)))", ibl_lookup.environment_texel(levels[1], column, row)
        ),
        "environment_lookup": ("environment_lookup(levels, 2, d)", ibl_lookup.environment_lookup(levels[2], d)),
        "glossy_lookup": ("glossy_lookup(levels, k, d)", ibl_lookup.glossy_lookup(levels, roughness, d, r)),
    }  # fmt: skip
    expression, expected = cases[name]

    def textures() -> dict[str, Any]:
        from mr360uw.gl import texture_array_from_array

        return {"levels": texture_array_from_array(levels)}

    return Case(expression, columns, expected, tol.FLOAT32_LOOKUP, "uniform sampler2DArray levels;", textures)


def split_sum_case(name: str, rng: np.random.Generator) -> Case:
    r, v = rounded(rng.uniform(0.05, 1.0, (2, COUNT)))
    return Case(f"{name}(r, v)", {"r": r, "v": v}, np.stack(split_sum(r, v), axis=-1))


def shading_case(name: str, rng: np.random.Generator) -> Case:
    a, b, c, d, e = rounded(rng.uniform(0.05, 1.0, (5, COUNT)))
    half_angle = rounded(rng.uniform(0.0, 0.1, COUNT))
    f0, split = rounded(rng.uniform(0.0, 1.0, (COUNT, 3))), rounded(rng.uniform(0.05, 0.5, (COUNT, 2)))
    normal, view = (rounded(unit(rng.standard_normal((COUNT, 3)))) for _ in range(2))
    view = np.where(np.sum(normal * view, axis=-1, keepdims=True) < 0.0, -view, view)
    cosine = rounded(np.sum(normal * view, axis=-1))
    columns = {"a": a, "b": b, "c": c, "f": f0, "s": split, "n": normal, "v": view, "k": cosine}
    more = {"q": np.stack([a, b, c, d], axis=-1), "r": np.stack([e, half_angle], axis=-1), "f": f0}
    cases = {
        "ggx_distribution": ("ggx_distribution(a, b)", columns, shading.ggx_distribution(a, b)),
        "smith_visibility": ("smith_visibility(a, b, c)", columns, shading.smith_visibility(a, b, c)),
        "grazing_reflectance": ("grazing_reflectance(f)", columns, shading.grazing_reflectance(f0)),
        "lobe_axis": ("lobe_axis(n, v, k, a)", columns, shading.lobe_axis(normal, view, cosine, a)),
        "reflectance": ("reflectance(f, s)", columns, shading.reflectance(f0, split)),
        "resolved_alpha": (
            "resolved_alpha(a, f, v)", columns, shading.resolved_alpha(a, np.stack([f0, view], axis=1))
        ),
        "highlight": (
            "highlight(f, q.x, q.y, q.z, q.w, r.x, r.y)", more, shading.highlight(f0, a, b, c, d, e, half_angle)
        ),
    }  # fmt: skip
    return Case(*cases[name], tol.GGX_LOBE)


CASES: dict[str, Callable[[str, np.random.Generator], Case]] = {
    "base/sphere.glsl": sphere_case,
    "base/caustic_lookup.glsl": caustic_case,
    "composite/shading.glsl": shading_case,
    "ibl/lookup.glsl": environment_case,
    "ibl/filters.glsl": split_sum_case,
    "medium/lookup.glsl": medium_case,
}


def texture(image: np.ndarray) -> Any:
    from mr360uw.gl import texture_from_array

    return texture_from_array(image)


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(("shader", "function"), FUNCTIONS)
def test_a_shader_function_is_its_python_partner(shader: str, function: str, rng: np.random.Generator) -> None:
    case = CASES[shader](function, rng)
    assert re.search(rf"\b{function}\(", case.expression + case.declarations), "the case calls another function"
    size = 1 if case.expected.ndim == 1 else case.expected.shape[1]
    got = glsl_call(shader, case.expression, size, case.declarations, case.textures(), case.uniforms, **case.columns)
    np.testing.assert_allclose(got, case.expected, rtol=case.tolerance, atol=case.tolerance)


def test_every_shader_function_has_a_partner_of_its_name(subtests: pytest.Subtests) -> None:
    for shader in shader_files():
        with subtests.test(str(shader.relative_to(ROOT))):
            tree = ast.parse(shader.with_suffix(".py").read_text("utf-8"))
            python = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
            assert functions_of(shader)
            assert set(functions_of(shader)) <= python


def test_a_constant_of_a_shader_is_its_partners(subtests: pytest.Subtests) -> None:
    for shader in shader_files():
        with subtests.test(str(shader.relative_to(ROOT))):
            name = ".".join(shader.relative_to(ROOT.parent).with_suffix("").parts)
            constants = re.findall(r"^const (?:float|int) (\w+) = ([^;]+);", shader.read_text("utf-8"), re.MULTILINE)
            for constant, value in constants:
                assert float(value) == getattr(importlib.import_module(name), constant), constant
