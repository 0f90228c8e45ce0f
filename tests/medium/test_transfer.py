# SPDX-License-Identifier: Apache-2.0
"""The light field: reference values, energy, identities."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import expn

from mr360uw.base.optics import fresnel_from_below
from mr360uw.errors import ParameterError
from mr360uw.medium import LightField, Water
from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.models import FieldModel, spectral_model
from mr360uw.medium.phase import henyey_greenstein
from mr360uw.medium.ray_field import LambertFloor, SkyShape, cosine_kernel
from tests.medium.tolerances import (
    ANALYTIC_FIELD,
    AROUND_SUN,
    BEAM_STREAMS,
    FLOAT64,
    GERSHUN,
    H_FUNCTIONS,
    INSCATTER_ISOTROPIC,
    INSCATTER_PEAKED,
    IRRADIANCE,
    MEAN_OF_AZIMUTHS,
    QUADRATURE_OF_STREAMS,
    SCATTERED_ONCE,
    TRACED,
    TRACED_SIGMAS,
)
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
OVERCAST = SkyShape((0.5, 0.7, 1.0, 1.3, 1.5))
SKIES = ["uniform", ("sun", 0.85, 0.7), OVERCAST]
FLOORS = [None, LambertFloor(3.0, (0.4,))]


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
@pytest.mark.parametrize("floor", FLOORS)
def test_energy(phase: str, surface: str, sky: str, floor: LambertFloor | None) -> None:
    field = LightField(A, B, phase, surface, sky, floor=floor)
    np.testing.assert_allclose(field.irradiance(0.0, 1.0), 1.0, rtol=FLOAT64)
    step = 1e-3
    depth = np.array([1.0 - step, 1.0 + step])
    net = field.irradiance(depth, 1.0) - field.irradiance(depth, -1.0)
    np.testing.assert_allclose((net[0] - net[1]) / (2 * step), A * field.scalar_irradiance(1.0), rtol=GERSHUN)
    if floor is not None:
        sent = field.irradiance(floor.depth_m, -1.0) / field.irradiance(floor.depth_m, 1.0)
        np.testing.assert_allclose(sent, floor.albedo[0], rtol=ANALYTIC_FIELD)


@pytest.mark.parametrize("sky", SKIES)
@pytest.mark.parametrize("floor", FLOORS)
def test_radiance_along_a_ray(rng: np.random.Generator, sky: str, floor: LambertFloor | None) -> None:
    field = LightField(A, B, ("hg", 0.9), "snell", sky, floor=floor)
    depth, up = rng.uniform(0.5, 3.0 if floor else 9.0, 60), rng.uniform(-1, 1, 60)
    s = ray_in_water(rng.exponential(4.0, 60), depth, up)
    if floor is not None:
        s = np.where(up < 0.0, np.minimum(s, (floor.depth_m - depth) / np.abs(up)), s)
    start, end = field.radiance(depth, up), field.radiance(np.maximum(depth - s * up, 0.0), up)
    for inscatter, c in (
        (field.inscatter(s, depth, up), A + B),
        (field.rays.inscatter(s, depth, up), field.rays.extinction),
    ):
        whole = inscatter + np.exp(-c * s[:, None]) * end
        np.testing.assert_allclose(whole, start, rtol=ANALYTIC_FIELD)
        assert np.all(inscatter >= 0.0)


def test_a_floor_in_water_that_only_absorbs() -> None:
    """Downwelling 2 E_3(a y), and from a floor of radiance L: 2 pi L E_3(a (D - y)); scalar irradiances with E_2."""
    a, y, bottom, albedo = np.array([0.02, 0.1, 0.5]), np.array([[0.1], [1.0], [2.5], [3.9]]), 4.0, 0.4
    field = LightField(a, 0.0, "isotropic", "none", floor=LambertFloor(bottom, (albedo,)))
    sent = albedo / np.pi * 2.0 * expn(3, a * bottom)
    depth = y[:, 0]
    for normal, expected in (
        (1.0, 2.0 * expn(3, a * y)),
        (-1.0, 2.0 * np.pi * sent * expn(3, a * (bottom - y))),
    ):
        np.testing.assert_allclose(field.irradiance(depth, normal), expected, rtol=QUADRATURE_OF_STREAMS)
    scalar = 2.0 * np.pi * (expn(2, a * y) / np.pi + sent * expn(2, a * (bottom - y)))
    np.testing.assert_allclose(field.scalar_irradiance(depth), scalar, rtol=10.0 * QUADRATURE_OF_STREAMS)  # all slanted
    np.testing.assert_allclose(field.radiance(1.0, -0.5), sent * np.exp(-a * 6.0), rtol=QUADRATURE_OF_STREAMS)


def test_deep_water_is_the_limit_of_a_deep_floor() -> None:
    up, depth = np.linspace(-1.0, 1.0, 9), np.array([[0.5], [4.0]])
    for sky in SKIES:
        deep = LightField(A, B, "petzold", sky=sky)
        field = LightField(A, B, "petzold", sky=sky, floor=LambertFloor(2000.0, (0.7,)))
        for name in ("irradiance", "radiance"):
            np.testing.assert_allclose(getattr(field, name)(depth, up), getattr(deep, name)(depth, up), rtol=1e-9)
    # what a floor reflects adds to the light over a black one
    for sky in SKIES:
        grey, black = (LightField(A, B, ("hg", 0.9), sky=sky, floor=LambertFloor(3.0, (a,))) for a in (0.4, 0.0))
        glow = LightField(A, B, ("hg", 0.9), sky="floor", floor=LambertFloor(3.0, (0.0,)))
        shining = 0.4 / np.pi * grey.irradiance(3.0, 1.0)
        for name in ("irradiance", "radiance"):
            whole, dark, added = (getattr(field, name)(np.minimum(depth, 2.9), up) for field in (grey, black, glow))
            rest = (1.0 - shining * glow.irradiance(0.0, 1.0)) * dark
            np.testing.assert_allclose(whole, rest + shining * added, rtol=ANALYTIC_FIELD)
    # below a floor the light is what it is at the floor, and the veil goes on smoothly
    field = LightField(A, B, "petzold", floor=FLOORS[1])
    np.testing.assert_array_equal(field.irradiance(9.0, up), field.irradiance(3.0, up))
    model = spectral_model(Water.jerlov("IB"), [450.0, 550.0], "table", floor=LambertFloor(3.0, (0.5,)))
    before, at, after = model.inscatter(np.array([3.999, 4.0, 4.001]), 1.0, -0.5)
    np.testing.assert_allclose(after - at, at - before, rtol=5e-3)


def test_light_over_a_floor_is_that_of_path_tracing() -> None:
    rows = [{k: v if k == "kind" else float(v) for k, v in row.items()} for row in reference_rows("floor_field.csv")]
    assert len(rows) == 48
    for row in rows:
        sky = ("sun", row["sun_up"], row["sun_share"]) if row["sun_share"] else "uniform"
        surface, floor = (
            "snell" if row["refractive_index"] > 1.0 else "none",
            LambertFloor(row["floor_m"], (row["albedo"],)),
        )
        field = LightField(row["absorption"], row["scattering"], ("hg", row["g"]), surface, sky, floor=floor)
        light = getattr(field, row["kind"])(row["depth_m"], row["up"]) / field.irradiance(row["depth_m"], 1.0)
        assert abs(light[0] / row["value"] - 1.0) < TRACED + TRACED_SIGMAS * row["noise"], row


@pytest.mark.parametrize("phase", [("hg", 0.924), ("hg", 0.95), "petzold"])
def test_strong_forward_peaks_under_a_beam(phase: str) -> None:
    """Light that the beam scatters directly is exact, so that few streams do for the rest, also straight down."""
    a, b = np.array([0.02, 0.05, 0.3]), np.array([0.05, 0.2, 0.3])
    up, depth = np.linspace(-1.0, 0.6, 17), [[2.0], [10.0]]
    for sun_up in (0.7, 0.99):
        many, few = (LightField(a, b, phase, sky=("sun", sun_up, 1.0), streams=n).radiance(depth, up) for n in (96, 32))
        np.testing.assert_allclose(few, many, rtol=BEAM_STREAMS)


def test_light_around_a_sun_is_that_of_path_tracing() -> None:
    rows = reference_rows("around_sun.csv")
    assert len(rows) == 40
    for row in rows:
        x = {key: float(value) for key, value in row.items() if key != "phase"}
        phase = ("hg", float(row["phase"].split()[1])) if row["phase"].startswith("hg") else row["phase"]
        field = LightField(
            x["absorption"], x["scattering"], phase, "snell" if x["refractive_index"] > 1.0 else "none",
            ("sun", x["sun_up"], 1.0), floor=LambertFloor(x["floor_m"], (x["albedo"],)),
        )  # fmt: skip
        seen = field.at_azimuth(np.radians(x["azimuth_deg"])).radiance(x["depth_m"], x["up"])[0]
        error = seen / field.irradiance(x["depth_m"], 1.0)[0] / x["value"] - 1.0
        assert abs(error) < AROUND_SUN + TRACED_SIGMAS * x["noise"], row


def chandrasekhar_h(characteristic: Callable[[np.ndarray], np.ndarray], mu: np.ndarray) -> np.ndarray:
    """Return the H function of deep media: 1/H = sqrt(1 - 2 psi_0) + int psi(x) x H(x)/(mu + x) dx."""
    x, w = np.polynomial.legendre.leggauss(200)
    x, w = 0.5 * (x + 1.0), 0.5 * w * characteristic(0.5 * (x + 1.0))
    h = np.ones(len(x))

    def inverse(at: np.ndarray) -> np.ndarray:
        return np.sqrt(1.0 - 2.0 * w.sum()) + (w * x * h / (at[:, None] + x)).sum(axis=1)

    for _ in range(300):
        h = 0.5 * (h + 1.0 / inverse(x))
    return 1.0 / inverse(mu)


@pytest.mark.parametrize("sun_up", [0.2, 0.75])
def test_reflection_of_deep_water_is_chandrasekhars(sun_up: float) -> None:
    """Radiative Transfer (1950), sections 45 and 46: exact for p = (1 + x cos)/(4 pi), by order of the azimuth."""
    albedo, x = np.array([0.3, 0.9]), 0.7
    mu = np.array([0.1, 0.4, 0.8, 1.0])
    for of_degree in (0.0, x):
        moments = np.zeros(65)
        moments[:2] = 1.0, of_degree / 3.0
        field = LightField(1.0 - albedo, albedo, moments, "none", ("sun", sun_up, 1.0))
        towards, away = (field.at_azimuth(angle).radiance(0.0, -mu) for angle in (0.0, np.pi))
        for k, w in enumerate(albedo):
            scale = w / (4.0 * np.pi * (mu + sun_up))
            if of_degree == 0.0:
                h, at_sun = (chandrasekhar_h(lambda t, w=w: 0.5 * w + 0.0 * t, at) for at in (mu, np.array([sun_up])))
                np.testing.assert_allclose(towards[:, k], scale * h * at_sun, rtol=H_FUNCTIONS)
                continue
            h, at_sun = (
                chandrasekhar_h(lambda t, w=w: 0.25 * w * x * (1.0 - t * t), at) for at in (mu, np.array([sun_up]))
            )
            level = np.sqrt((1.0 - mu**2) * (1.0 - sun_up**2))
            expected = 2.0 * scale * x * level * h * at_sun
            np.testing.assert_allclose(towards[:, k] - away[:, k], expected, rtol=H_FUNCTIONS, atol=FLOAT64)


@pytest.mark.parametrize("floor", FLOORS)
def test_azimuths_make_up_the_mean(floor: LambertFloor | None) -> None:
    field = LightField(A, B, ("hg", 0.9), sky=("sun", 0.8, 0.7), floor=floor)
    up, azimuth = np.linspace(-1.0, 0.6, 9), (np.arange(64) + 0.5) * np.pi / 64
    whole = np.array([field.at_azimuth(angle).inscatter(1.5, 2.0, up) for angle in azimuth])
    np.testing.assert_allclose(whole.mean(axis=0), field.inscatter(1.5, 2.0, up), rtol=MEAN_OF_AZIMUTHS)
    model = spectral_model(Water.jerlov("IB"), [450.0, 550.0], "table", sky=("sun", 0.8, 0.7), floor=floor)
    seen = [FieldModel(model.field.at_azimuth(angle), model.part) for angle in azimuth[::16]]
    single = np.stack([one.inscatter(np.inf, 2.0, up) for one in seen], axis=1)
    np.testing.assert_allclose(model.around_sun(2.0, up, azimuth[::16]), single, rtol=ANALYTIC_FIELD)


def test_thin_water_scatters_once() -> None:
    """Beside the sun too: b p (1 - exp(-(c - c mu/mu_sun) s))/(c - c mu/mu_sun) times the beam at the camera."""
    a, b, sun_up, depth, s = 0.2, 1e-4, 0.8, 3.0, 6.0
    field, c = LightField(a, b, ("hg", 0.9), "none", ("sun", sun_up, 1.0)), a + b
    for up, azimuth in itertools.product((-0.9, 0.0, 0.3), (0.0, 0.4, 2.0, np.pi)):
        cosine = up * sun_up + np.sqrt((1.0 - up**2) * (1.0 - sun_up**2)) * np.cos(azimuth)
        fall = c * (1.0 - up / sun_up)
        expected = (
            b * henyey_greenstein(cosine, 0.9) / sun_up * np.exp(-c * depth / sun_up) * -np.expm1(-fall * s) / fall
        )
        seen = field.at_azimuth(azimuth).rays.inscatter(s, depth, up)[0]
        assert seen == pytest.approx(expected, rel=SCATTERED_ONCE)


@pytest.mark.parametrize("surface", ["snell", "none"])
@pytest.mark.parametrize("sun_up", [0.02, 0.3, 0.67, 0.9, 1.0])
def test_no_veil_is_negative(surface: str, sun_up: float) -> None:
    distance, up = np.geomspace(0.01, 200.0, 6)[:, None], np.linspace(-1.0, 1.0, 41)
    for name in ("IB", "5C"):
        for floor in (None, LambertFloor(12.0, (0.8,))):
            model = spectral_model(
                Water.jerlov(name), [430.0, 650.0], "table", surface, ("sun", sun_up, 1.0), floor=floor
            )
            assert model.inscatter(distance, 10.0, up).min() >= 0.0
            assert model.radiance(10.0, up).min() >= 0.0


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


def test_a_sky_keeps_its_shape() -> None:
    """In water that hardly scatters, a level plane and a ray get the sky itself, refracted, dimmed by the way."""
    absorption, depth, n = 0.3, 3.0, 1.34
    field = LightField(absorption, 1e-9, "isotropic", "snell", OVERCAST, n)
    x, w = np.polynomial.legendre.leggauss(2000)
    least = np.sqrt(1.0 - 1.0 / n**2)
    up = least + (1.0 - least) * (0.5 + 0.5 * x)
    entering = OVERCAST.seen_through(up, n) * (1.0 - fresnel_from_below(up, n))
    left = np.exp(-absorption * depth / up)
    expected = np.sum(w * up * entering * left) / np.sum(w * up * entering)
    assert field.irradiance(depth, 1.0)[0] == pytest.approx(expected, rel=IRRADIANCE)
    seen = field.radiance(depth, up[::100])[:, 0] / left[::100]
    np.testing.assert_allclose(seen / entering[::100], (seen / entering[::100])[0], rtol=IRRADIANCE)
    assert OVERCAST.seen_through(np.array(1.0), n) == 1.5
    with pytest.raises(ParameterError, match="sky"):
        SkyShape((0.0, 0.0))


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
        (0.1, 0.1, {"floor": LambertFloor(3.0, (0.1, 0.2))}),
    ):
        with pytest.raises(ParameterError, match=" - "):
            LightField(a, b, **keys)
    for depth, albedo in ((0.0, (0.5,)), (np.inf, (0.5,)), (1.0, (1.5,)), (1.0, ())):
        with pytest.raises(ParameterError, match=r"floor - |depth_m - must be a finite number"):
            LambertFloor(depth, albedo)
    with pytest.raises(ParameterError, match="depth_m"):
        LightField(0.1, 0.1).radiance(-1.0, 0.0)
