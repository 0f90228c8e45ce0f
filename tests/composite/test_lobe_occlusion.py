# SPDX-License-Identifier: Apache-2.0
"""Glossy light among bodies: lobes against integrals over rays, furnaces, highlights as means over pixels, shaders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.base.sphere import directions, unit
from mr360uw.composite.ambient.mesh_transfer import make_lattice, points_at
from mr360uw.composite.ambient.solver import _weigh, ambient_light
from mr360uw.composite.gl.device import list_texture
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.reference import render_aovs
from mr360uw.composite.shading import ggx_distribution, resolved_alpha, smith_visibility
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lighting import environment as sky_light
from mr360uw.types import Environment, Floats
from tests.composite import tolerances as tol
from tests.composite.scenes import SUN, box, placed, shot, sphere
from tests.glsl import gl_available, glsl_call

METAL = Material(base_color=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.4)
BLACK = Material(base_color=(0.0, 0.0, 0.0, 1.0), roughness=1.0, refractive_index=1.0)
needs_gl = pytest.mark.skipif(not gl_available(), reason="needs OpenGL 3.3")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MR360UW_CACHE", str(tmp_path))


def white_sky() -> Environment:
    """Return an environment of radiance 1 with glossy levels."""
    return sky_light(np.ones((32, 64, 3), np.float32), expansion="none", sun=None, glossy=True)


def point_values(scene: Shot) -> Floats:
    """Return the values of the first body's points, of those that face the camera, their places and normals."""
    light = ambient_light(scene, Cache())
    assert light is not None
    values = light.values[0]
    assert values is not None
    return values.astype(float)


def test_a_lobe_loses_what_rays_meet() -> None:
    """A metal ball beside a black one: 1 - int w V / int w over directions far finer than the samples'."""
    center, radius = np.array([0.7, 0.0, -2.0]), 0.4
    body, other = placed(sphere(24, METAL, 0.4), (-0.2, 0.0, -2.0)), placed(sphere(48, BLACK, radius), tuple(center))
    scene = shot(body, other, environment=white_sky(), sun=None)
    kept = point_values(scene)[:, 4]
    light = ambient_light(scene, Cache())
    assert light is not None
    lattice = light.layout.bodies[0].transfer.lattice
    place, normal = (lattice.from_samples @ a for a in (body.to_world(lattice.position), lattice.normal))
    view = unit(-place)
    d = directions(192, 96).reshape(-1, 3)
    solid_angle = np.sqrt(1.0 - d[:, 1] ** 2)
    found, want = [], []
    for point in np.flatnonzero(np.sum(normal * view, axis=-1) > 0.2)[::7]:
        n_dot_v, n_dot_l = normal[point] @ view[point], np.maximum(d @ normal[point], 0.0)
        n_dot_h, alpha = unit(d + view[point]) @ normal[point], np.full(len(d), METAL.roughness**2)
        weight = ggx_distribution(n_dot_h, alpha) * smith_visibility(np.full(len(d), n_dot_v), n_dot_l, alpha)
        weight *= n_dot_l * solid_angle
        to = center - place[point]
        along = d @ to
        meets = (along > 0.0) & (to @ to - along**2 < radius**2)
        found.append(kept[point])
        want.append(1.0 - weight[meets].sum() / weight.sum())
    error = np.array(found) - want
    assert np.min(want) < 0.2
    assert np.sqrt(np.mean(error**2)) < tol.LOBE_RMSE


def test_white_metal_in_a_furnace_reflects_it() -> None:
    balls = [placed(sphere(24, METAL, 0.4), (x, 0.0, -2.0)) for x in (-0.45, 0.45)]
    values = point_values(shot(*balls, environment=white_sky(), sun=None))
    assert values[:, 4].min() < 0.5
    np.testing.assert_allclose(values[:, 4:7] + values[:, 8:11], 1.0, atol=tol.FURNACE)


def test_a_highlight_is_its_mean_over_the_pixel() -> None:
    ball = placed(sphere(96, replace(METAL, roughness=0.35), 0.5), (0.0, 0.0, -2.0))
    sun = replace(SUN, direction=unit(np.array([0.4, 0.6, 0.7])))
    coarse, fine = (
        render_aovs(shot(ball, environment=white_sky(), sun=sun, width=width, samples=17))[1].sun[..., 1]
        for width in (128, 1024)
    )
    mean = fine.reshape(64, 8, 128, 8).mean(axis=(1, 3))
    assert np.abs(coarse - mean).max() < tol.HIGHLIGHT * mean.max()


@needs_gl
def test_the_shader_interpolates_points_as_python_does(rng: np.random.Generator) -> None:
    mesh = box()
    lattice = make_lattice(mesh)
    triangle, weights = rng.integers(0, 12, 500), rng.dirichlet([1.0, 1.0, 1.0], 500)
    table = rng.uniform(size=(lattice.points, 3, 4)).astype(np.float32)
    points, shares = points_at(lattice.places[triangle], weights)
    want = np.einsum("nk,nkc->nc", shares, table[points, 0, :3].astype(float))
    got = glsl_call(
        "composite/gl/shaders/light.glsl", "among_bodies(list, 0, 3, places, weights).ratio", 3,
        "uniform sampler2D list;", {"list": list_texture(table.reshape(-1))},
        places=lattice.places[triangle].astype(float), weights=weights,
    )  # fmt: skip
    np.testing.assert_allclose(got, want, atol=tol.FLOAT32_LOOKUP)


@needs_gl
def test_the_shader_widens_lobes_as_python_does(rng: np.random.Generator) -> None:
    roughness, change = rng.uniform(size=200), rng.normal(scale=0.3, size=(200, 2, 3))
    got = glsl_call(
        "composite/gl/shaders/light.glsl", "resolved_alpha(roughness, columns, rows)",
        roughness=roughness, columns=change[:, 0], rows=change[:, 1],
    )  # fmt: skip
    np.testing.assert_allclose(got, resolved_alpha(roughness, change), rtol=tol.QUADRATURE)


def test_light_from_below_the_horizon_weighs_nothing() -> None:
    """Also where the density's denominator is 0 there: numbers for which it is so exactly."""
    normal, towards = np.array([0.0, 1.0, 0.0], np.float32), np.array([0.0, 0.75, 0.5], np.float32)
    ways = np.array([[0.0, 0.0], [-0.5, 0.8], [-0.828125, 0.6]], np.float32)
    weight = np.full(2, np.nan, np.float32)
    _weigh(normal, towards, np.float32(0.5), ways, weight)
    assert weight[0] == 0.0
    assert 0.0 < weight[1] < np.inf
