# SPDX-License-Identifier: Apache-2.0
"""The light field: reference values, energy, identities."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.medium import LightField, Water
from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.ray_field import cosine_kernel
from mr360uw.optics import fresnel_from_below
from tests.medium.tolerances import ANALYTIC_FIELD, FLOAT64, GERSHUN, INSCATTER_ISOTROPIC, INSCATTER_PEAKED, IRRADIANCE
from tests.reference import reference_rows

SETTINGS = {
    "iso_null": ("isotropic", "none"),
    "iso_snell": ("isotropic", "snell"),
    "hg924_null": (("hg", 0.924), "none"),
    "hg924_snell": (("hg", 0.924), "snell"),
    "petz_snell": ("petzold", "snell"),
}
A = np.array([0.005, 0.05, 0.3, 3.0])
B = np.array([0.4, 0.001, 0.5, 10.0])
SKIES = ["uniform", ("sun", 0.85, 0.7)]


@pytest.mark.parametrize("setting", SETTINGS)
def test_reference_values(setting: str) -> None:
    rows = [row for row in reference_rows("transfer.csv") if row["setting"] == setting]
    assert len(rows) > 20
    value = {key: np.array([float(row[key]) for row in rows]) for key in rows[0] if key != "setting"}
    phase, surface = SETTINGS[setting]
    field = LightField(value["a_per_m"], value["b_per_m"], phase, surface)
    depth, mu = value["depth_m"], value["mu"]
    # each row has its own coefficients: take the diagonal
    inscatter = np.diagonal(field.inscatter(value["distance_m"], depth, mu))
    error = (inscatter - value["inscatter"]) / value["radiance"]
    assert np.sqrt(np.mean(error**2)) < (INSCATTER_ISOTROPIC if phase == "isotropic" else INSCATTER_PEAKED)
    for normal, key in ((1.0, "down"), (-1.0, "up"), (0.0, "vertical")):
        np.testing.assert_allclose(np.diagonal(field.irradiance(depth, normal)), value[key], rtol=IRRADIANCE)
    np.testing.assert_allclose(np.diagonal(field.scalar_irradiance(depth)), value["scalar"], rtol=IRRADIANCE)


@pytest.mark.parametrize("phase", ["isotropic", ("hg", 0.95), "petzold", "water"])
@pytest.mark.parametrize("surface", ["snell", "none"])
@pytest.mark.parametrize("sky", SKIES)
def test_energy(phase: str, surface: str, sky: str) -> None:
    field = LightField(A, B, phase, surface, sky)
    np.testing.assert_allclose(field.irradiance(0.0, 1.0), 1.0, rtol=FLOAT64)
    step = 1e-3
    depth = np.array([1.0 - step, 1.0 + step])
    net = field.irradiance(depth, 1.0) - field.irradiance(depth, -1.0)
    np.testing.assert_allclose((net[0] - net[1]) / (2 * step), A * field.scalar_irradiance(1.0), rtol=GERSHUN)


@pytest.mark.parametrize("sky", SKIES)
def test_radiance_along_a_ray(rng: np.random.Generator, sky: str) -> None:
    field = LightField(A, B, ("hg", 0.9), "snell", sky)
    depth, up = rng.uniform(0.5, 9, 60), rng.uniform(-1, 1, 60)
    s = ray_in_water(rng.exponential(4.0, 60), depth, up)
    start, end = field.radiance(depth, up), field.radiance(np.maximum(depth - s * up, 0.0), up)
    for inscatter, c in (
        (field.inscatter(s, depth, up), A + B),
        (field.rays.inscatter(s, depth, up), field.rays.extinction),
    ):
        whole = inscatter + np.exp(-c * s[:, None]) * end
        np.testing.assert_allclose(whole, start, rtol=ANALYTIC_FIELD)
        assert np.all(inscatter >= 0.0)


def test_far_rays_give_the_whole_field() -> None:
    field = LightField(A, B, "petzold")
    down = np.array([-1.0, -0.3, 0.0])
    np.testing.assert_allclose(field.inscatter(np.inf, 4.0, down), field.radiance(4.0, down), rtol=ANALYTIC_FIELD)
    np.testing.assert_array_equal(field.inscatter(0.0, 4.0, down), 0.0)


def test_without_scattering_only_the_sky_is_seen() -> None:
    field = LightField(np.array([0.1]), np.array([0.0]), "isotropic", "none")
    up = np.array([1.0, 0.5, -0.5])
    expected = np.where(up > 0, np.exp(-0.1 * 3.0 / np.maximum(up, 1e-9)) / np.pi, 0.0)
    np.testing.assert_allclose(field.radiance(3.0, up)[:, 0], expected, atol=FLOAT64)
    assert field.inscatter(5.0, 3.0, 0.2)[0] == 0.0


def test_snells_window() -> None:
    field = LightField(np.array([0.05]), np.array([0.001]), "water")
    inside, outside = field.radiance(0.5, np.array([0.7, 0.6]))[:, 0]
    assert inside > 100.0 * outside
    assert fresnel_from_below(0.6, 1.34) == 1.0
    np.testing.assert_allclose(fresnel_from_below(1.0, 1.34), (0.34 / 2.34) ** 2, rtol=FLOAT64)
    np.testing.assert_array_equal(fresnel_from_below([0.0, 0.5], 1.0), 0.0)


def test_irradiance_lies_between_plane_cases() -> None:
    field = LightField(A, B, "petzold")
    tilted = field.irradiance(3.0, np.linspace(-1.0, 1.0, 21))
    assert np.all(np.diff(tilted, axis=0) > 0.0)
    np.testing.assert_allclose(cosine_kernel([1.0, -1.0, 0.5], 1.0), [2 * np.pi, 0.0, np.pi], atol=FLOAT64)
    np.testing.assert_allclose(cosine_kernel(0.0, 0.0), 2.0, rtol=FLOAT64)


def test_moments_of_a_mixture() -> None:
    water = Water.chlorophyll(0.1, "petzold")
    w = np.array([450.0, 550.0])
    moments = water.moments(w, 65)
    assert np.all(moments[:, 1] < 0.924)
    field = LightField(water.absorption(w), water.scattering(w), moments)
    pure = LightField(water.absorption(w), water.scattering(w), "petzold")
    # molecules send more light back up
    assert np.all(field.irradiance(1.0, -1.0) > pure.irradiance(1.0, -1.0))


def test_bad_input_is_refused() -> None:
    for a, b, keys in (
        (0.0, 0.1, {}),
        (0.1, -0.1, {}),
        (0.1, 0.1, {"surface": "rough"}),
        (0.1, 0.1, {"sky": ("sun", 1.5, 0.5)}),
        (0.1, 0.1, {"phase": np.ones((1, 5))}),
    ):
        with pytest.raises(ParameterError, match=" - "):
            LightField(a, b, **keys)
    with pytest.raises(ParameterError, match="depth_m"):
        LightField(0.1, 0.1).radiance(-1.0, 0.0)
