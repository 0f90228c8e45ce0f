# SPDX-License-Identifier: Apache-2.0
"""Media: modes, tables, identities, whole pictures."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.medium import (
    MODES,
    Medium,
    Sensor,
    Water,
    WaterSettings,
    bands,
    compress_gamut,
    multiple_scattering,
    spectral_model,
)
from mr360uw.medium.closed_form import ray_in_water, visibility_m
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup, veil_lookup
from tests.medium.picture import Scene, relative_rms, render
from tests.medium.tolerances import (
    ANALYTIC_FIELD,
    DRAFT_TABLE,
    FLOAT64,
    PICTURE_ISOTROPIC,
    PICTURE_PEAKED,
    TABLE_MEAN,
    TABLE_P95,
)
from tests.reference import reference_arrays

DEPTH = 5.0
SENSORS = {"cie": Sensor.cie1931(), "camera": Sensor.camera("Insta360 X5")}


def rays(rng: np.random.Generator, count: int, length_m: float) -> tuple[np.ndarray, np.ndarray]:
    up = rng.uniform(-1.0, 1.0, count)
    return ray_in_water(0.05 + rng.exponential(length_m, count), DEPTH, up), up


def within_table_accuracy(got: np.ndarray, expected: np.ndarray, scale: np.ndarray, factor: float = 1.0) -> bool:
    error = np.abs(got - expected).max(axis=-1) / scale
    return bool(error.mean() < factor * TABLE_MEAN and np.quantile(error, 0.95) < factor * TABLE_P95)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("name", ["I", "IB", "III", "9C"])
@pytest.mark.parametrize("mode", ["kd", "table"])
def test_tables_agree_with_direct_sums(rng: np.random.Generator, sensor: str, name: str, mode: str) -> None:
    medium = Medium(Water.jerlov(name), SENSORS[sensor], mode, DEPTH)
    assert len(medium.bands.wavelength_nm) == 61
    s, up = rays(rng, 3000, medium.length_m)
    veil = compress_gamut(medium.veil(s, DEPTH, up)) if sensor == "cie" else medium.veil(s, DEPTH, up)
    assert within_table_accuracy(veil_lookup(medium.table, s, up), veil, veil.max(axis=-1))
    direct = medium.transmittance(s, DEPTH, up)
    assert within_table_accuracy(transmittance_lookup(medium.table, s, up), direct, np.ones(len(s)))
    # down to where a thousandth of the light is left
    depth = rng.uniform(0.0, DEPTH + 7.0 * medium.length_m, 500)
    light = np.exp(medium.light.ambient_log(depth) - medium.light.ambient_log(np.array(DEPTH)))
    ratio = ambient_ratio(medium.table, depth)
    assert within_table_accuracy(ratio / light, np.ones_like(light), np.ones(len(depth)))


@pytest.mark.parametrize("name", ["IA", "IB", "9C"])
def test_tables_of_drafts_are_smaller_and_nearly_as_good(rng: np.random.Generator, name: str) -> None:
    medium = Medium(Water.jerlov(name), None, "table", DEPTH, floor_m=DEPTH + 3.0)
    sand = 0.3 / np.pi * medium.model.irradiance(medium.floor_m, 1.0) @ medium.bands.lobes
    medium = medium.lit_by_floor(sand)
    draft = medium.for_drafts()
    assert draft.table.veil.size < 0.4 * medium.table.veil.size
    s, up = rays(rng, 3000, medium.length_m)
    whole, coarse = (veil_lookup(table, s, up) for table in (medium.table, draft.table))
    assert within_table_accuracy(coarse, whole, whole.max(axis=-1), DRAFT_TABLE)
    depth = rng.uniform(0.0, DEPTH + 7.0 * medium.length_m, 500)
    whole, coarse = (ambient_ratio(table, depth) for table in (medium.table, draft.table))
    assert within_table_accuracy(coarse / whole, np.ones_like(whole), np.ones(len(depth)), DRAFT_TABLE)


@pytest.mark.parametrize("mode", [mode for mode in MODES if mode != "plate"])
@pytest.mark.parametrize("name", ["I", "IB", "9C"])
def test_every_mode_is_physical(rng: np.random.Generator, mode: str, name: str) -> None:
    medium = Medium(Water.jerlov(name), None, mode, DEPTH)
    table = medium.table
    for array in (table.veil, table.attenuation, table.diffuse, table.beam):
        assert np.all(np.isfinite(array))
        assert array.dtype == np.float32
    assert np.all(table.veil >= 0.0)
    assert np.all(table.attenuation > 0.0)
    s, up = rays(rng, 500, medium.length_m)
    transmittance = medium.transmittance(s, DEPTH, up)
    assert np.all((transmittance > 0.0) & (transmittance <= 1.0))
    np.testing.assert_array_equal(medium.transmittance(0.0, DEPTH, 0.3), 1.0)
    np.testing.assert_array_equal(medium.veil(0.0, DEPTH, 0.3), 0.0)
    np.testing.assert_array_equal(medium.transmittance(np.inf, DEPTH, -0.3), 0.0)
    assert np.all(np.isfinite(medium.veil(np.inf, DEPTH, [-1.0, 0.0, 1.0])))
    # farther never is clearer
    assert np.all(medium.transmittance(1.5 * s, DEPTH, 0.0) <= medium.transmittance(s, DEPTH, 0.0) + FLOAT64)
    assert np.all(beam_ratio(table, DEPTH + 1.0, 0.9) < 1.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("depth", [0.05, 150.0])
@pytest.mark.parametrize("name", ["I", "9C"])
@pytest.mark.parametrize("bands_and_rule", [(61, "rectangle"), (2, "rectangle"), (8, "fitted")])
def test_extremes_are_finite(depth: float, name: str, bands_and_rule: tuple[int, str]) -> None:
    count, rule = bands_and_rule
    for mode in ("kd", "table"):
        table = Medium(Water.jerlov(name), None, mode, depth, band_count=count, rule=rule).table
        for array in (table.veil, table.attenuation, table.diffuse, table.beam):
            assert np.all(np.isfinite(array))
        assert np.all(table.veil >= 0.0)


def test_kd_mode_is_the_published_form() -> None:
    water, sensor = Water.jerlov("II"), SENSORS["camera"]
    medium = Medium(water, sensor, "kd", DEPTH, band_count=8)
    eight = bands(8, sensor)
    s, up = np.array([0.5, 4.0, 100.0]), np.array([0.9, 0.0, -0.7])
    expected = multiple_scattering(water, eight.wavelength_nm, s, DEPTH, up) @ eight.weight
    np.testing.assert_allclose(medium.veil(s, DEPTH, up), expected, rtol=FLOAT64)
    spectral = np.exp(-water.attenuation(eight.wavelength_nm) * s[:, None])
    np.testing.assert_allclose(medium.spectral_transmittance(s), spectral, rtol=FLOAT64)


def test_radiance_along_a_ray_of_a_medium(rng: np.random.Generator) -> None:
    """A body that shines as the water around it cannot be seen."""
    medium = Medium(Water.jerlov("II"), SENSORS["camera"], "table", DEPTH)
    s, up = rays(rng, 300, medium.length_m)
    end = np.maximum(DEPTH - s * up, 0.0)
    behind = medium.model.radiance(end, up)
    whole = medium.spectral_veil(s, DEPTH, up) + medium.spectral_transmittance(s) * behind
    np.testing.assert_allclose(whole, medium.model.radiance(DEPTH, up), rtol=ANALYTIC_FIELD)
    down = -np.abs(up)
    np.testing.assert_allclose(medium.veil(np.inf, DEPTH, down), medium.radiance(DEPTH, down), rtol=ANALYTIC_FIELD)


def test_grey_objects_are_exact(rng: np.random.Generator) -> None:
    medium = Medium(Water.jerlov("1C"), SENSORS["camera"], "table", DEPTH)
    s, up = rays(rng, 200, medium.length_m)
    depth = np.maximum(DEPTH - s * up, 0.0)
    light = medium.model.irradiance(depth, 1.0)
    seen = medium.bands.rgb(0.3 * light * medium.spectral_transmittance(s))
    np.testing.assert_allclose(
        0.3 * medium.bands.rgb(light) * medium.transmittance(s, DEPTH, up), seen, rtol=ANALYTIC_FIELD
    )


def test_gain_scales_the_veil_only() -> None:
    medium = Medium(Water.jerlov("II"), None, "kd", DEPTH)
    scaled = medium.scaled([2.0, 3.0, 4.0]).scaled(0.5)
    np.testing.assert_allclose(scaled.table.veil, medium.table.veil * np.array([1.0, 1.5, 2.0]), rtol=1e-6)
    np.testing.assert_array_equal(scaled.table.attenuation, medium.table.attenuation)
    assert np.all(medium.gain == 1.0)
    with pytest.raises(ParameterError, match="gain"):
        medium.scaled(-1.0)


def test_water_in_the_shade_lacks_the_veil_of_short_ways(rng: np.random.Generator) -> None:
    bright = Medium(Water.jerlov("IA"), camera_depth_m=6.0, mode="plate").scaled(3.0)
    dark = bright.in_shade(0.8)
    way, up = rng.uniform(0.1, 60.0, 200), rng.uniform(-1.0, 0.05, 200)
    lit = 1.0 - 0.8 * np.exp(-4.8 / visibility_m(bright.water) * way)[:, None]
    np.testing.assert_allclose(dark.veil(way, 6.0, up), lit * bright.veil(way, 6.0, up), rtol=FLOAT64)
    # nodes of the table are interpolated after the shade: what lies between them is less straight
    looked_up = [veil_lookup(m.table, way, up) for m in (dark, bright)]
    np.testing.assert_allclose(looked_up[0], lit * looked_up[1], rtol=TABLE_P95, atol=1e-7)
    far = np.full(3, 20.0 * bright.length_m), np.array([-0.5, -0.1, 0.0])
    np.testing.assert_allclose(*(veil_lookup(m.table, *far) for m in (dark, bright)), rtol=TABLE_P95)
    np.testing.assert_array_equal(dark.transmittance(way, 6.0, up), bright.transmittance(way, 6.0, up))
    for other in (bright.in_shade(0.0), dark.in_shade(0.0)):
        np.testing.assert_array_equal(other.table.veil, bright.table.veil)
    assert np.all(dark.at_depth(9.0).table.veil <= bright.at_depth(9.0).table.veil)


def test_formation_models_follow_their_equation() -> None:
    medium = Medium(Water.jerlov("II"), None, "akkaynak-treibitz", DEPTH)
    solved = Medium(Water.jerlov("II"), None, "table", DEPTH)
    level = solved.unit_veil(np.array(solved.length_m), np.array(0.0))
    np.testing.assert_allclose(medium.veil(solved.length_m, DEPTH, 0.0), level, rtol=ANALYTIC_FIELD)
    one = Medium(Water.jerlov("II"), None, "koschmieder", DEPTH)
    far = one.veil(np.inf, DEPTH, 0.0)
    np.testing.assert_allclose(
        one.veil(3.0, DEPTH, 0.0), far * (1.0 - one.transmittance(3.0, DEPTH, 0.0)), rtol=ANALYTIC_FIELD
    )


def test_bad_media_are_refused() -> None:
    water = Water.jerlov("II")
    for keys in ({"mode": "magic"}, {"camera_depth_m": 0.0}, {"camera_depth_m": -3.0}, {"camera_depth_m": np.nan}):
        with pytest.raises(ParameterError, match=" - "):
            Medium(water, **keys)
    with pytest.raises(ParameterError, match="distance_m"):
        Medium(water).veil(-1.0, 5.0, 0.0)


def test_settings() -> None:
    assert WaterSettings(type="none").medium(DEPTH) is None
    assert WaterSettings().medium(DEPTH).water.name == "Jerlov IB"
    for keys in (
        {"type": "pure"},
        {"type": "chlorophyll", "chlorophyll_mg_m3": 0.5, "phase": (1.1, 3.58)},
        {"type": "5C", "mode": "kd", "bands": 8, "sensor": "Insta360 X5"},
        {"type": "3C", "phase": 0.9, "sun_share": 0.6},
    ):
        assert np.all(np.isfinite(WaterSettings(**keys).medium(DEPTH).table.veil))
    medium = WaterSettings(gain=(0.5, 0.6, 0.7)).medium(DEPTH)
    np.testing.assert_array_equal(medium.gain, [0.5, 0.6, 0.7])
    for named, value in (("type", "IV"), ("gain", (1.0, -1.0, 1.0)), ("bands", 0), ("typ", "II")):
        with pytest.raises(ParameterError, match=rf"WaterSettings\.{named}.* - .* \(got "):
            WaterSettings(**{named: value})
    with pytest.raises(ParameterError, match="csv - type csv needs a file"):
        WaterSettings(type="csv")


@pytest.mark.parametrize(
    ("name", "phase", "limit"),
    [("hg924", ("hg", 0.924), PICTURE_PEAKED), ("isotropic", "isotropic", PICTURE_ISOTROPIC)],
)
def test_path_traced_pictures(name: str, phase: tuple | str, limit: float) -> None:
    data = reference_arrays("path_traced.npz")
    w, truth = data["wavelength_nm"], np.moveaxis(data[f"radiance_{name}"], 0, -1)
    scene = Scene.of(data["spheres"], *truth.shape[:2])
    water = Water.from_arrays(w, data["absorption"], data["scattering"], data["diffuse_attenuation"], phase)
    error = {
        mode: relative_rms(render(scene, spectral_model(water, w, mode, surface="none")), truth, scene)
        for mode in ("table", "kd", "kd+")
    }
    assert error["table"] < limit
    assert error["kd"] > 3.0 * error["table"]
    assert error["kd+"] > 3.0 * error["table"]


def test_the_index_sets_the_edge_of_the_window() -> None:
    """The sky stops at the critical angle of the index that the settings give."""
    for index in (1.2, 1.34, 1.5):
        medium = WaterSettings(refractive_index=index, bands=3, sensor="CIE 1931").medium(0.05)
        edge = np.sqrt(1.0 - 1.0 / index**2)
        inside, outside = medium.model.radiance(0.05, np.array([edge + 0.03, edge - 0.03]))
        assert np.all(inside > 5.0 * outside)


def test_an_index_must_be_one() -> None:
    with pytest.raises(ParameterError, match="refractive_index"):
        _ = Medium(Water.jerlov("IB"), refractive_index=0.9).model


@pytest.mark.parametrize("mode", ["koschmieder", "akkaynak-treibitz"])
def test_a_gain_counts_once_in_the_formation_models(mode: str) -> None:
    plain, scaled = (Medium(Water.jerlov("II"), None, mode, DEPTH) for _ in range(2))
    np.testing.assert_allclose(
        scaled.scaled(3.0).veil(4.0, DEPTH, 0.0), 3.0 * plain.veil(4.0, DEPTH, 0.0), rtol=FLOAT64
    )
