# SPDX-License-Identifier: Apache-2.0
"""Irradiance, glossy levels and the split sum against closed forms and brute force."""

from __future__ import annotations

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.sphere import directions, row_solid_angle, unit
from mr360uw.errors import ParameterError
from mr360uw.ibl.filters import cosine_beam, ggx_kernel, split_sum
from mr360uw.ibl.lookup import environment_lookup, lookup_matrix, reduce_map
from tests.ibl.plates import sky
from tests.ibl.split_sum import split_sum_integral
from tests.ibl.tolerances import (
    ENERGY_FLOAT32,
    FLOAT64,
    GLOSSY_PEAK,
    IRRADIANCE_PEAK,
    KERNEL_QUADRATURE,
    SH9_UNIFORM,
    SPLIT_SUM_GRAZING_RMS,
    SPLIT_SUM_RMS,
)


@pytest.mark.parametrize("scale", [1, 2, 4])
def test_a_uniform_sky_gives_pi(scale: int) -> None:
    got = ibl.irradiance(np.ones((32 * scale, 64 * scale, 3), np.float32))
    np.testing.assert_allclose(got, np.pi, rtol=KERNEL_QUADRATURE)


def test_half_a_sky_gives_the_view_factor_of_a_tilted_plane() -> None:
    upper = np.zeros((32, 64, 3), np.float32)
    upper[:16] = 1.0
    up = directions(64, 32)[..., 1:2]
    np.testing.assert_allclose(
        ibl.irradiance(upper), np.broadcast_to(np.pi * (1.0 + up) / 2.0, (32, 64, 3)), atol=np.pi * KERNEL_QUADRATURE
    )


def test_harmonics_hold_a_linear_ramp_exactly() -> None:
    ramp = (1.0 + directions(64, 32)[..., 1:2]) * np.ones(3)
    expected = np.pi + 2.0 * np.pi / 3.0 * directions(64, 32)[..., 1:2]
    got = ibl.irradiance(ramp, method="sh9")
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), rtol=3 * SH9_UNIFORM, atol=3 * SH9_UNIFORM)


def test_turning_the_map_about_the_vertical_turns_the_irradiance(rng: np.random.Generator) -> None:
    image = rng.uniform(0, 1, (128, 256, 3)).astype(np.float32)
    turned = ibl.irradiance(np.roll(image, 4 * 11, axis=1))
    np.testing.assert_allclose(turned, np.roll(ibl.irradiance(image), 11, axis=1), rtol=ENERGY_FLOAT32)


def brute(image: np.ndarray, kernel, normals: np.ndarray, *, mean: bool) -> np.ndarray:
    height, width = image.shape[:2]
    towards, light = directions(width, height).reshape(-1, 3), image.reshape(-1, 3).astype(np.float64)
    area = np.repeat(row_solid_angle(width, height), width)
    found = []
    for normal in normals:  # all at once would take a gigabyte
        weight = kernel(towards @ normal) * area
        found.append(weight @ light / (weight.sum() if mean else 1.0))
    return np.array(found)


@pytest.mark.parametrize("towards", [[0.3, 0.8, -0.5], [0.0, 1.0, 0.0], [0.0, 0.2, 1.0]])
def test_irradiance_of_a_map_with_a_sun(towards: list[float], rng: np.random.Generator) -> None:
    image = sky(np.array(towards))
    pick = rng.choice(2048, 200, replace=False)
    truth = brute(image, lambda c: np.maximum(c, 0.0), directions(64, 32).reshape(-1, 3)[pick], mean=False)
    light = ibl.environment(image, expansion="none")
    assert light.sun is not None
    np.testing.assert_allclose(light.irradiance.reshape(-1, 3)[pick], truth, atol=IRRADIANCE_PEAK * truth.max())
    np.testing.assert_allclose(
        light.irradiance, light.ambient + cosine_beam(light.sun.direction, light.sun.irradiance), rtol=ENERGY_FLOAT32
    )


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.7])
def test_glossy_levels(roughness: float, rng: np.random.Generator) -> None:
    image = sky(np.array([0.5, 0.7, 0.1]), sun=0.0)
    pick = rng.choice(2048, 100, replace=False)
    truth = brute(image, lambda c: ggx_kernel(c, roughness), directions(64, 32).reshape(-1, 3)[pick], mean=True)
    got = ibl.prefilter(reduce_map(image, 256, 128), roughness).reshape(-1, 3)[pick]
    np.testing.assert_allclose(got, truth, atol=GLOSSY_PEAK * truth.max())


def test_a_lobe_is_a_mean() -> None:
    for roughness in (0.1, 0.5, 1.0):
        np.testing.assert_allclose(ibl.prefilter(np.full((32, 64, 3), 2.0), roughness), 2.0, rtol=ENERGY_FLOAT32)


def test_the_lobe_of_a_beam_is_what_the_filter_makes_of_a_small_disc() -> None:
    towards = unit([0.4, 0.5, 0.3])
    small = (directions(1024, 512) @ towards > np.cos(0.01)).astype(np.float32)[..., None] * np.ones(3, np.float32)
    energy = np.full(3, (small[..., 0] * row_solid_angle(1024, 512)[:, None]).sum())
    got = ibl.glossy_beam(towards, energy, 0.6)
    filtered = ibl.prefilter(reduce_map(small, 256, 128), 0.6)
    np.testing.assert_allclose(got, filtered, atol=GLOSSY_PEAK * filtered.max())


def test_split_sum_follows_its_integral_and_conserves_energy() -> None:
    grid = [(r, v) for r in np.linspace(0.1, 1.0, 7) for v in np.linspace(0.1, 1.0, 7)]
    exact = np.array([split_sum_integral(r, v, 96) for r, v in grid])
    fit = np.array([split_sum(r, v) for r, v in grid])
    assert np.sqrt(np.mean((fit - exact).sum(axis=1) ** 2)) < SPLIT_SUM_RMS
    assert np.sqrt(np.mean((fit - exact)[:, 1] ** 2)) < SPLIT_SUM_GRAZING_RMS
    assert split_sum(0.6, 1.0)[1] == 0.0
    assert np.all(fit.sum(axis=1) <= 1.0)
    assert np.all(fit >= 0.0)


@pytest.mark.parametrize("size", [(100, 37), (64, 32), (33, 21), (1, 1), (700, 333)])
def test_reduction_keeps_the_light(size: tuple[int, int], rng: np.random.Generator) -> None:
    image = rng.uniform(0, 1, (size[1], size[0], 3))
    small = reduce_map(image, 64, 32)
    light = (image * row_solid_angle(*size)[:, None, None]).sum(axis=(0, 1))
    np.testing.assert_allclose(
        (small * row_solid_angle(64, 32)[:, None, None]).sum(axis=(0, 1)), light, rtol=ENERGY_FLOAT32
    )


def test_the_matrix_of_a_lookup_is_the_lookup(rng: np.random.Generator) -> None:
    """Also over the seam and the poles, and for directions of any length."""
    map_ = rng.uniform(size=(16, 32, 3))
    towards = np.concatenate([rng.normal(size=(200, 3)), np.eye(3), -np.eye(3)])
    expected = environment_lookup(map_, towards)
    found = lookup_matrix(map_.shape, towards) @ map_.reshape(-1, 3)
    np.testing.assert_allclose(found, expected, rtol=FLOAT64)


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(ParameterError, match="radiance"):
        ibl.irradiance(np.zeros((30, 64, 3)))
    with pytest.raises(ParameterError, match="roughness"):
        ibl.prefilter(np.zeros((32, 64, 3)), 0.0)
    with pytest.raises(ParameterError, match="method"):
        ibl.irradiance(np.zeros((32, 64, 3)), method="cosine")  # type: ignore[arg-type]
