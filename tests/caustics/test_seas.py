# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter

from mr360uw.base.constants import GRAVITY_M_S2, SURFACE_TENSION_OVER_DENSITY
from mr360uw.caustics import GerstnerSea, SpectralSea, caustic_map
from mr360uw.caustics.gerstner import GerstnerWave
from mr360uw.caustics.sea import (
    angular_frequency,
    cosine_power_share,
    cosine_spread,
    detail_slope,
    group_speed,
    jonswap,
    lattice_vector,
    looping_frequency,
    make_detail,
    peak_frequency,
    surface_jacobian,
    tma_factor,
)
from mr360uw.caustics.settings import Sea
from mr360uw.errors import ParameterError
from tests.caustics import tolerances as tol
from tests.caustics.seas import SEAS, lattice_sea

STEP_M = 1e-5


@pytest.mark.parametrize("name", [n for n in SEAS if n != "ripples"])
def test_normal_and_jacobian_are_those_of_the_positions(name, rng):
    sea = SEAS[name]
    x, z = rng.uniform(-20.0, 20.0, (2, 50))
    s = sea.surface(x, z, 1.7)
    along_x = sea.surface(x + STEP_M, z, 1.7).position - sea.surface(x - STEP_M, z, 1.7).position
    along_z = sea.surface(x, z + STEP_M, 1.7).position - sea.surface(x, z - STEP_M, 1.7).position
    tx, tz = along_x / (2.0 * STEP_M), along_z / (2.0 * STEP_M)
    normal = np.cross(tz, tx)
    np.testing.assert_allclose(
        s.normal, normal / np.linalg.norm(normal, axis=1, keepdims=True), atol=tol.FINITE_DIFFERENCE
    )
    np.testing.assert_allclose(s.jacobian, tx[:, 0] * tz[:, 2] - tx[:, 2] * tz[:, 0], atol=tol.FINITE_DIFFERENCE)


def test_jacobian_is_positive_inside_the_guard(rng):
    for _ in range(5):
        sea = lattice_sea(rng, folding=0.99)
        assert sea.grid_surface(128, 0.4).jacobian.min() > 0.0
    for steepness in (0.0, 0.5, 1.0):
        sea = GerstnerSea(wind_speed=30.0, steepness=steepness)
        assert sea.waves.folding <= 1.0 + tol.FLOAT64
        assert sea.grid_surface(128, 0.4).jacobian.min() >= -tol.FLOAT64


def test_waves_that_fold_over_are_an_error():
    with pytest.raises(ParameterError, match="fold over"):
        GerstnerSea.from_waves([[2.0 * np.pi, 0.0]], 0.2, 1.0, 0.0, tile_m=1.0)
    wave = GerstnerWave(wave_vector=(2.0 * np.pi, 0.0), amplitude_m=0.2, steepness=1.0, phase_rad=0.0)
    with pytest.raises(ValueError, match="fold over"):
        GerstnerSea(explicit_waves=(wave,), tile_m=1.0)


def test_explicit_waves_are_the_sum_that_the_definition_says(rng):
    k = 2.0 * np.pi / 8.0 * np.array([[1.0, 2.0], [-3.0, 1.0]])
    amplitude, steepness, phase = np.array([0.05, 0.02]), np.array([0.7, 0.9]), np.array([0.3, 2.0])
    sea = GerstnerSea.from_waves(k, amplitude, steepness, phase, tile_m=8.0)
    x, z = rng.uniform(0.0, 8.0, (2, 20))
    theta = x[:, None] * k[:, 0] + z[:, None] * k[:, 1] + phase
    direction = k / np.linalg.norm(k, axis=1, keepdims=True)
    shift = (steepness * amplitude * np.cos(theta)) @ direction
    expected = np.stack([x + shift[:, 0], np.sin(theta) @ amplitude, z + shift[:, 1]], axis=1)
    np.testing.assert_allclose(sea.surface(x, z, 0.0).position, expected, atol=tol.FLOAT64)


def test_waves_travel_along_their_wave_vectors():
    sea = GerstnerSea.from_waves([[2.0 * np.pi, 0.0]], 0.01, 0.0, 0.0, tile_m=1.0)
    speed = float(angular_frequency(2.0 * np.pi, sea.water_depth_m)) / (2.0 * np.pi)
    x = np.linspace(0.0, 1.0, 20)
    later, before = sea.surface(x + 0.1 * speed, 0.0, 0.1), sea.surface(x, 0.0, 0.0)
    np.testing.assert_allclose(later.position[:, 1], before.position[:, 1], atol=tol.FLOAT64)


@pytest.mark.parametrize("name", SEAS)
def test_tile_edges_meet(name):
    sea = SEAS[name]
    at = np.linspace(0.0, sea.tile_m, 17)
    for a, b in (
        (sea.surface(0.0, at, 2.0), sea.surface(sea.tile_m, at, 2.0)),
        (sea.surface(at, 0.0, 2.0), sea.surface(at, sea.tile_m, 2.0)),
    ):
        np.testing.assert_allclose(a.position[:, 1], b.position[:, 1], atol=tol.TILE_EDGE)
        np.testing.assert_allclose(a.normal, b.normal, atol=tol.TILE_EDGE)


@pytest.mark.parametrize("name", SEAS)
def test_the_loop_closes(name):
    sea = type(SEAS[name]).model_validate(SEAS[name].model_dump() | {"loop_s": 4.0})
    first, last = sea.grid_surface(32, 0.0), sea.grid_surface(32, 4.0)
    np.testing.assert_allclose(first.position, last.position, atol=tol.TILE_EDGE)
    np.testing.assert_allclose(first.normal, last.normal, atol=tol.TILE_EDGE)
    assert np.ptp(sea.grid_surface(32, 1.0).position[..., 1] - first.position[..., 1]) > 0.0


@pytest.mark.parametrize("name", SEAS)
@pytest.mark.parametrize("size", [16, 48])
def test_the_grid_is_the_points(name, size):
    sea = SEAS[name]
    at = np.arange(size) * (sea.tile_m / size)
    x, z = np.meshgrid(at, at)
    grid, points = sea.grid_surface(size, 0.9), sea.surface(x, z, 0.9)
    np.testing.assert_allclose(grid.position, points.position, atol=tol.FFT_SUM)
    np.testing.assert_allclose(grid.normal, points.normal, atol=tol.FFT_SUM)


@pytest.mark.parametrize("spectrum", ["phillips", "jonswap", "tma"])
@pytest.mark.parametrize("height", [None, 0.3])
def test_the_stated_height_is_four_standard_deviations(spectrum, height):
    sea = SpectralSea(spectrum=spectrum, significant_wave_height_m=height, water_depth_m=3.0, seed=5)
    stated = sea.significant_height_m if height is None else height
    for time_s in (0.0, 3.3):
        heights = sea.grid_fields(128, time_s).height
        assert 4.0 * np.std(heights) == pytest.approx(stated, rel=tol.STATED_HEIGHT)
        assert heights.mean() == pytest.approx(0.0, abs=tol.FLOAT64)


def test_choppy_shift_sharpens_crests():
    sea = SEAS["jonswap"]
    fields = sea.grid_fields(64, 0.0)
    squeezed = surface_jacobian(fields) - 1.0
    assert np.mean(squeezed * fields.height) < 0.0


def test_spectra():
    w = np.linspace(0.01, 60.0, 200_001)
    s = jonswap(w, 10.0, 100e3)
    assert w[np.argmax(s)] == pytest.approx(peak_frequency(10.0, 100e3), rel=tol.SPECTRUM_PEAK)
    np.testing.assert_array_equal(tma_factor(w, 1e6), 1.0)
    assert tma_factor(np.array([0.1]), 1.0)[0] == pytest.approx(0.5 * 0.01 / GRAVITY_M_S2, rel=tol.FLOAT64)
    angle = np.linspace(-np.pi, np.pi, 20_001)
    for frequency in (0.5, 2.0, 30.0):
        spread = cosine_spread(angle, np.full(angle.shape, frequency), 10.0, 100e3)
        assert np.trapezoid(spread, angle) == pytest.approx(1.0, abs=tol.SPREAD_INTEGRAL)


def height(spectrum, wind_speed, fetch_m, **knobs):
    sea = SpectralSea(spectrum=spectrum, wind_speed=wind_speed, fetch_m=fetch_m, **knobs)
    return sea.spectrum_height_m


@pytest.mark.parametrize("wind_speed", [1.0, 4.0, 10.0])
def test_a_sea_grows_no_further_than_full_development(wind_speed):
    """Pierson & Moskowitz 1964: S = 8.1e-3 g^2 w^-5 exp(-1.25 (w_p/w)^4), w_p = 0.855 g/u, of variance 8.1e-3 g^2/(5
    w_p^4). A tenth of the fetch of full development has JONSWAP's own variance.
    """
    w = np.linspace(0.02, 60.0, 200_001) * GRAVITY_M_S2 / wind_speed
    peak = 0.855 * GRAVITY_M_S2 / wind_speed
    developed = 8.1e-3 * GRAVITY_M_S2**2 * w**-5 * np.exp(-1.25 * (peak / w) ** 4)
    of_full = 4.0 * np.sqrt(8.1e-3 / 5.0) * GRAVITY_M_S2 / peak**2
    fetch = (22.0 / 0.855) ** 3 * wind_speed**2 / GRAVITY_M_S2
    for times in (1.0, 3.0, 100.0):
        assert peak_frequency(wind_speed, times * fetch) == pytest.approx(peak, rel=tol.FLOAT64)
        np.testing.assert_allclose(jonswap(w, wind_speed, times * fetch), developed, rtol=tol.FLOAT64, atol=1e-200)
        for spectrum in ("jonswap", "tma"):
            assert height(spectrum, wind_speed, times * fetch) == pytest.approx(of_full, rel=tol.SPECTRUM_VARIANCE)
    x = np.geomspace(1e-3, 1.0, 60) * fetch
    heights = np.array([height("jonswap", wind_speed, one) for one in x])
    assert np.all(np.diff(heights) > -tol.GROWING_HEIGHT * of_full)
    assert heights.max() <= of_full * (1.0 + tol.GROWING_HEIGHT)


def test_short_fetches_have_the_spectrum_of_jonswap():
    wind_speed, fetch_m = 10.0, 20e3
    w = np.linspace(0.2, 20.0, 2001)
    peak = 22.0 * (GRAVITY_M_S2**2 / (wind_speed * fetch_m)) ** (1.0 / 3.0)
    alpha = 0.076 * (wind_speed**2 / (fetch_m * GRAVITY_M_S2)) ** 0.22
    r = np.exp(-((w / peak - 1.0) ** 2) / (2.0 * np.where(w <= peak, 0.07, 0.09) ** 2))
    growing = alpha * GRAVITY_M_S2**2 * w**-5 * np.exp(-1.25 * (peak / w) ** 4) * 3.3**r
    np.testing.assert_allclose(jonswap(w, wind_speed, fetch_m), growing, rtol=tol.FLOAT64, atol=1e-200)


@pytest.mark.parametrize("wind_speed", [1.0, 2.0, 4.0])
def test_both_seas_of_a_wind_cast_like_caustics(wind_speed):
    """Both have about the slopes of Cox & Munk 1954 in the same range of waves."""
    seas = [kind(wind_speed=wind_speed, detail_slope=0.0) for kind in (GerstnerSea, SpectralSea)]
    slopes = [sea.own_mean_square_slope for sea in seas]
    assert 1.0 / tol.LIKE_SEAS < slopes[1] / slopes[0] < tol.LIKE_SEAS
    sun, depth_m = np.array([0.3, 0.95, 0.1]) / np.linalg.norm([0.3, 0.95, 0.1]), 1.0
    contrast = [caustic_map(sea, sun, depth_m, 0.0, size=128, grid=128).std() for sea in seas]
    assert 1.0 / tol.LIKE_SEAS < contrast[1] / contrast[0] < tol.LIKE_SEAS


def test_a_spectral_sea_says_what_waves_it_has():
    sea = SpectralSea(wind_speed=4.0, resolution=256, tile_m=120.0, shortest_wavelength_m=1.0)
    assert sea.significant_height_m == pytest.approx(sea.spectrum_height_m * np.sqrt(sea.held_variance), rel=1e-12)
    assert 0.8 < sea.held_variance < 1.0
    small = SpectralSea(wind_speed=12.0, tile_m=4.0)
    assert small.held_variance < 0.01
    assert small.peak_wavelength_m == pytest.approx(
        2.0 * np.pi * GRAVITY_M_S2 / peak_frequency(12.0, 100e3) ** 2, rel=1e-3
    )
    assert f"held_variance={small.held_variance:.3g}" in repr(small)
    assert f"peak_period_s={small.peak_period_s:.3g}" in repr(small)
    assert SpectralSea(wind_speed=0.0).spectrum_height_m == 0.0
    phillips = SpectralSea(spectrum="phillips", wind_speed=2.0, tile_m=30.0, resolution=512, shortest_wavelength_m=0.12)
    assert phillips.held_variance == pytest.approx(1.0, abs=tol.PHILLIPS_HELD)
    w = np.arange(1.0, 20.0, 1e-3)
    density = w**-5 * np.exp(-((GRAVITY_M_S2 / (2.0 * w)) ** 4))
    assert 2.0 * np.pi / phillips.peak_period_s == pytest.approx(w[np.argmax(density)], rel=tol.SPECTRUM_PEAK)
    assert "inf" in repr(SpectralSea(wind_speed=0.0))


def test_alignment_of_the_phillips_spectrum():
    for exponent in (0.0, 0.5, 2.0, 6.0, 20.0):
        angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 20_001)
        spread = np.cos(angle) ** exponent * cosine_power_share(exponent)
        assert np.trapezoid(spread, angle) == pytest.approx(1.0, abs=tol.SPREAD_INTEGRAL)
    aligned = SpectralSea(spectrum="phillips", alignment=20.0, wind_direction_deg=90.0).grid_fields(64, 0.0)
    assert np.mean(aligned.slope_z**2) < 0.1 * np.mean(aligned.slope_x**2)


def test_dispersion():
    k = np.array([1e-3, 1.0, 370.0, 3000.0])
    deep = angular_frequency(k, np.inf)
    np.testing.assert_allclose(deep**2, GRAVITY_M_S2 * k + SURFACE_TENSION_OVER_DENSITY * k**3, rtol=tol.FLOAT64)
    np.testing.assert_allclose(angular_frequency(1e-3, 1.0), 1e-3 * np.sqrt(GRAVITY_M_S2), rtol=tol.SHALLOW_LIMIT)
    for depth in (2.0, np.inf):
        step = 1e-6 * k
        slope = (angular_frequency(k + step, depth) - angular_frequency(k - step, depth)) / (2.0 * step)
        np.testing.assert_allclose(group_speed(k, depth), slope, rtol=tol.FINITE_DIFFERENCE)


def test_lattice_and_loop(rng):
    k = rng.uniform(-30.0, 30.0, (200, 2))
    cycles = lattice_vector(k, 3.0) * 3.0 / (2.0 * np.pi)
    np.testing.assert_allclose(cycles, np.round(cycles), atol=tol.FLOAT64)
    assert np.all(np.any(lattice_vector(np.array([[0.1, -0.2], [0.0, 0.0]]), 3.0) != 0.0, axis=1))
    w = looping_frequency(np.array([0.01, 3.0]), 5.0) * 5.0 / (2.0 * np.pi)
    np.testing.assert_allclose(w, [1.0, 2.0], atol=tol.FLOAT64)


def test_zero_wind_is_flat():
    for sea in (GerstnerSea(wind_speed=0.0), SpectralSea(wind_speed=0.0, resolution=16)):
        s = sea.grid_surface(16, 1.0)
        np.testing.assert_array_equal(s.position[..., 1], 0.0)
        np.testing.assert_array_equal(s.normal, np.broadcast_to([0.0, 1.0, 0.0], s.normal.shape))


def test_one_seed_one_sea_and_another_seed_another():
    a, b, c = (GerstnerSea(seed=s).grid_fields(16, 0.3).height for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.std(a - c) > 0.0


def test_a_copy_with_other_knobs_has_other_waves():
    sea = GerstnerSea()
    assert sea.waves.amplitude_m[0] > 0.0
    assert sea.model_copy(update={"wind_speed": 0.0}).waves.amplitude_m[0] == 0.0


def test_detail_slopes_have_the_stated_strength_and_repeat():
    detail = make_detail(8.0, 0.05, 0.12, np.array([0.2, 0.1]), 3.0, 4, 1.2)
    at = (np.arange(800) + 0.5) * 0.01
    x, z = np.meshgrid(at, at)
    slopes = detail_slope(detail, x, z)
    assert np.sqrt(np.mean(np.sum(slopes**2, axis=-1))) == pytest.approx(0.05, rel=tol.DETAIL_STRENGTH)
    np.testing.assert_allclose(detail_slope(detail, x[:9, :9] + 8.0, z[:9, :9]), slopes[:9, :9], atol=tol.TILE_EDGE)
    later = make_detail(8.0, 0.05, 0.12, np.array([0.2, 0.1]), 3.0, 4, 4.2)
    np.testing.assert_allclose(detail_slope(later, x[:9, :9], z[:9, :9]), slopes[:9, :9], atol=tol.TILE_EDGE)


def test_a_scene_chooses_its_sea():
    sea = TypeAdapter(Sea)
    assert isinstance(sea.validate_python({}), GerstnerSea)
    assert isinstance(sea.validate_python({"model": "spectral", "spectrum": "tma"}), SpectralSea)
    assert sea.validate_python(GerstnerSea(seed=3)).seed == 3


@pytest.mark.parametrize(
    "knobs", [{"wind_speed": np.nan}, {"wind_speed": -1.0}, {"tile_m": 0.0}, {"steepness": 1.1}, {"seed": -1}]
)
def test_knobs_out_of_range(knobs):
    with pytest.raises(ParameterError):
        GerstnerSea(**knobs)


@pytest.mark.parametrize("waves", [([[np.nan, 0.0]], 0.1), ([[1.0, 0.0]], -0.1), ([1.0, 0.0, 2.0], 0.1)])
def test_waves_out_of_range(waves):
    with pytest.raises(ParameterError):
        GerstnerSea.from_waves(waves[0], waves[1], 0.5, 0.0)


def test_times_and_places_that_are_none():
    with pytest.raises(ParameterError, match="time_s"):
        GerstnerSea().surface(0.0, 0.0, np.inf)
    with pytest.raises(ParameterError, match="x_m"):
        GerstnerSea().surface(np.nan, 0.0, 0.0)


@pytest.mark.parametrize("kind", [GerstnerSea, SpectralSea])
@pytest.mark.parametrize("wind", [1.0, 2.0, 4.0, 7.0, 11.0, 15.0])
def test_waves_and_detail_have_the_slope_of_cox_and_munk(kind, wind):
    sea = kind(wind_speed=wind)
    surface = sea.grid_surface(96, 7.0)
    slope = np.sum((surface.normal[..., [0, 2]] / surface.normal[..., 1:2]) ** 2, axis=-1)
    drawn = np.average(slope, weights=surface.jacobian)
    assert 0.0 < drawn < 0.9 * (0.003 + 0.00512 * wind)
    assert drawn + sea.detail_rms_slope**2 == pytest.approx(0.003 + 0.00512 * wind, rel=tol.TOTAL_SLOPE)


def test_slopes_that_are_given_or_left_over():
    assert GerstnerSea(detail_slope=0.07).detail_rms_slope == 0.07
    assert GerstnerSea(wind_speed=0.0).detail_rms_slope == 0.0
    steep = SpectralSea(wind_speed=1.0, significant_wave_height_m=0.5)
    assert steep.own_mean_square_slope > 0.02
    assert steep.detail_rms_slope == 0.0
    assert GerstnerSea.from_waves([[3.0, 0.0]], 0.01, 0.5, 0.0).detail_rms_slope == 0.0
    assert GerstnerSea().detail(0.0) is None
    assert GerstnerSea().blur_slope == GerstnerSea().detail_rms_slope > 0.0
    ripples = GerstnerSea(detail_kind="ripples")
    assert ripples.blur_slope == 0.0
    assert ripples.detail(0.0) is not None
