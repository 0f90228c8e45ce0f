# SPDX-License-Identifier: Apache-2.0
"""The tables of layered water, as scenes name it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.medium import LambertFloor, LayeredField, Medium, Water, WaterSettings
from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.lookup import ambient_ratio, beam_fraction, transmittance_lookup, unscattered_share, veil_lookup
from mr360uw.medium.models import LayeredModel, LayeredWater, layered_water, spectral_model
from mr360uw.medium.phase import legendre_polynomials
from mr360uw.medium.scattered_light import ambient_parts, around_sun, image_spread, irradiance_from_level
from mr360uw.medium.shafts.shaft_scene import shaft_water
from tests.medium.layered import PROFILES, write_profile
from tests.medium.tolerances import EQUAL_LAYERS, LAYERED, LAYERED_MEAN, MARCHED, TABLE_BEAM

BANDS = 13


def medium_of(folder: Path, name: str, camera_m: float, **keys: object) -> Medium:
    settings = {"bands": BANDS, "mode": "table"} | keys
    medium = WaterSettings(layers=write_profile(folder / "profile.csv", *PROFILES[name]), **settings).medium(camera_m)  # type: ignore[arg-type]
    assert medium is not None
    return medium


@pytest.mark.parametrize("camera_m", [3.0, 5.7, 9.5])
@pytest.mark.parametrize("name", PROFILES)
def test_tables_are_the_exact_light_of_layers(
    rng: np.random.Generator, tmp_path: Path, name: str, camera_m: float
) -> None:
    """By wavelength: the radiance at the camera less that of the path's end, both of the solved layers, as the wide
    angles' extinction leaves it; summed to the bands of the sensor.
    """
    medium = medium_of(tmp_path, name, camera_m)
    model, up = medium.model, rng.uniform(-1.0, 0.6, 1500)
    assert isinstance(model, LayeredModel)
    s = ray_in_water(0.05 + rng.exponential(medium.length_m, len(up)), camera_m, up)
    end = np.maximum(camera_m - s * up, 0.0)
    # Sum the extinction of each layer over the path in it
    tops, e = model.field.top_m, model.wide.extinction
    low, high = np.minimum(end, camera_m)[:, None], np.maximum(end, camera_m)[:, None]
    inside = np.clip(np.minimum(high, np.append(tops[1:], np.inf)) - np.maximum(low, tops), 0.0, None)
    left = np.exp(-(inside @ e) / np.abs(up)[:, None])
    veil = medium.bands.rgb(model.field.radiance(camera_m, up) - left * model.field.radiance(end, up))
    light = model.field.irradiance(end, 1.0)
    passed = medium.bands.rgb(light * left) / medium.bands.rgb(light)
    for got, expected, scale in (
        (veil_lookup(medium.table, s, up), veil, veil.max(axis=-1)),
        (transmittance_lookup(medium.table, s, up), passed, np.ones(len(s))),
    ):
        error = np.abs(got - expected).max(axis=-1) / scale
        assert error.mean() < LAYERED_MEAN
        assert np.quantile(error, 0.95) < LAYERED
    at = np.linspace(0.5, camera_m + 3.0 * medium.length_m, 100)
    ratio = medium.bands.rgb(model.field.irradiance(at, 1.0)) / medium.bands.rgb(model.field.irradiance(camera_m, 1.0))
    np.testing.assert_allclose(ambient_ratio(medium.table, at), ratio, rtol=LAYERED)


def test_a_ray_marched_through_layers_gains_the_veil(tmp_path: Path) -> None:
    """With c = a + b and the extinction e of absorption and wide angles, towards the camera dL/ds = -c L + J, so what a
    path adds to exp(-int e) L(end) is the integral of exp(-int e) (J - (c - e) L). J: b times the mean of L over the
    phase function, here by its Legendre moments.
    """
    g, w = 0.7, np.array([450.0, 550.0, 650.0])
    like = Water.jerlov("IB").with_phase(("hg", g))
    like = Water("no molecules", like.a, like.b, None, like.phase)
    model = spectral_model(
        layered_water(write_profile(tmp_path / "p.csv", *PROFILES["clear over murky"]), like, 4.0), w, "table"
    )
    assert isinstance(model, LayeredModel)
    field, edge = model.field, np.sqrt(1.0 - 1.0 / model.field.refractive_index**2)
    x, weight = np.polynomial.legendre.leggauss(48)
    limits = np.array([-1.0, 0.0, edge, 1.0])
    half, middle = 0.5 * np.diff(limits)[:, None], 0.5 * (limits[1:] + limits[:-1])[:, None]
    toward, weight = (middle + half * x).ravel(), (half * weight).ravel()
    degree = np.arange(60)
    for up, length in ((-0.6, 12.0), (-0.25, 15.0), (0.3, 9.0)):
        # Gauss nodes on either side of the interface, which the path may cross
        cross = np.clip((4.0 - field.top_m[1:]) / up, 0.0, length)
        parts = np.unique(np.concatenate([[0.0, length], cross, np.linspace(0.0, length, 5)]))
        nodes, gauss = np.polynomial.legendre.leggauss(12)
        t = (0.5 * (parts[1:] + parts[:-1])[:, None] + 0.5 * np.diff(parts)[:, None] * nodes).ravel()
        of_t = (0.5 * np.diff(parts)[:, None] * gauss).ravel()
        y = 4.0 - t * up
        layer = field.layer_of(y)
        a_b, b, e = (field.absorption + field.scattering)[layer], field.scattering[layer], model.wide.extinction[layer]
        moments = np.einsum(
            "k,lk,ykn->yln", weight, legendre_polynomials(toward, 60).T, field.radiance(y[:, None], toward)
        )
        source = (
            0.5
            * b
            * np.einsum("l,yln->yn", (2 * degree + 1) * g**degree * legendre_polynomials(np.array(up), 60), moments)
        )
        depth = np.concatenate([np.linspace(4.0, one, 2000)[None] for one in y])
        passed = np.exp(-np.mean(model.wide.extinction[field.layer_of(depth)], axis=1) * t[:, None])
        marched = of_t @ (passed * (source - (a_b - e) * field.radiance(y, up)))
        np.testing.assert_allclose(model.inscatter(length, 4.0, up), marched, rtol=MARCHED)


def test_equal_layers_are_water_that_is_the_same_everywhere(tmp_path: Path) -> None:
    water = Water.jerlov("IB")
    top_m = 0.0, 1.0, 2.0, 4.0, 8.0, 11.0
    five = LayeredWater("five", water.a, water.b, None, water.phase, water.molecular, "", top_m, (water,) * 6, 3)
    plain, layered = (Medium(one, None, "table", 5.0, band_count=BANDS, floor_m=9.0) for one in (water, five))
    # A profile that is the same at all depths is one layer
    path = write_profile(tmp_path / "equal.csv", [0.0, 5.0, 12.0], [0.0, 0.0, 0.0], water.b.wavelength_nm)
    read = WaterSettings(layers=path, bands=BANDS, mode="table").medium(5.0, floor_m=9.0)
    assert read is not None
    assert isinstance(read.model, LayeredModel)
    assert len(read.model.field.top_m) == 1
    np.testing.assert_allclose(read.table.veil, layered.table.veil, rtol=EQUAL_LAYERS, atol=1e-12)
    rng = np.random.default_rng(3)
    up, s = rng.uniform(-1.0, 1.0, 300), rng.uniform(0.1, 40.0, 300)
    for sky in ("uniform", ("sun", 0.8, 0.7), "floor"):
        one, other = (medium.under(sky) for medium in (plain, layered))
        np.testing.assert_allclose(other.veil(s, 5.0, up), one.veil(s, 5.0, up), rtol=EQUAL_LAYERS, atol=1e-12)
        np.testing.assert_allclose(
            other.irradiance([1.0, 8.0], 0.3), one.irradiance([1.0, 8.0], 0.3), rtol=EQUAL_LAYERS
        )
    light = np.array([0.2, 0.4, 0.5]), np.array([0.05, 0.1, 0.2]), np.array([0.3, 0.4, 0.5]), 0.83
    for wanted, found in (
        (plain.transmittance(s, 5.0, up), layered.transmittance(s, 5.0, up)),
        (beam_fraction(plain.table, 7.0, 0.8), beam_fraction(layered.table, 7.0, 0.8)),
        (unscattered_share(plain.table, 7.0, 0.8), unscattered_share(layered.table, 7.0, 0.8)),
        (ambient_parts(plain, *light)[0], ambient_parts(layered, *light)[0]),
        (image_spread(plain).scattering, image_spread(layered).scattering),  # type: ignore[union-attr]
        (shaft_water(plain).extinction, shaft_water(layered).extinction),
        (around_sun(plain.under(("sun", 0.8, 0.7))), around_sun(layered.under(("sun", 0.8, 0.7)))),
        (irradiance_from_level(plain, 0.8, 0.7, light[1]), irradiance_from_level(layered, 0.8, 0.7, light[1])),
    ):
        np.testing.assert_allclose(found, wanted, rtol=EQUAL_LAYERS)


@pytest.mark.parametrize("sun_up", [0.7, 0.95])
def test_the_beam_crosses_the_layers_above(tmp_path: Path, sun_up: float) -> None:
    medium = medium_of(tmp_path, "clear over murky", 4.0)
    depth = np.array([2.0, 5.0, 8.0, 12.0])
    assert isinstance(medium.model, LayeredModel)
    e, top = medium.model.wide.extinction, medium.model.field.top_m
    lost = np.clip(depth[:, None] - top, 0.0, np.append(np.diff(top), np.inf)) @ e / sun_up
    table = medium.along_sun(medium.table, sun_up)
    np.testing.assert_allclose(beam_fraction(table, depth, sun_up), medium.bands.rgb(np.exp(-lost)), atol=TABLE_BEAM)


def test_a_floor_shines_through_layers() -> None:
    """A floor of radiance 1 alone, and below the surface what comes back of it; with a floor that is lit besides, light
    adds up.
    """
    top, a, b, floor = [0.0, 3.0, 7.0], [0.1, 0.3, 0.1], [0.2, 0.5, 0.2], LambertFloor(10.0, (0.0,))
    shining = LayeredField(top, a, b, sky="floor", floor=floor)
    dark, bright = (LayeredField(top, a, b, floor=LambertFloor(10.0, (albedo,))) for albedo in (0.0, 0.5))
    np.testing.assert_allclose(shining.radiance(10.0, -0.5), 1.0)
    # per unit of light that enters: what comes down again by the surface counts in `bright`
    glow = bright.radiance(10.0, -0.5)[0]
    entering = 1.0 - glow * shining.irradiance(0.0, 1.0)[0]
    for depth, up in ((4.0, -0.7), (8.0, 0.2), (1.0, 0.3)):
        sum_of = entering * dark.radiance(depth, up) + glow * shining.radiance(depth, up)
        np.testing.assert_allclose(bright.radiance(depth, up), sum_of, rtol=1e-9)
    with pytest.raises(ParameterError, match="floor - must lie below"):
        LayeredField(top, a, b, sky="floor")
