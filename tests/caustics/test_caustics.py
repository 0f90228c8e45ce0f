# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter

from mr360uw.base.caustic_lookup import caustic_lookup, mip_levels
from mr360uw.base.sphere import direction_from_angles
from mr360uw.caustics import (
    CausticSettings,
    GerstnerSea,
    SpectralSea,
    caustic_map,
    caustic_stack,
    refract_to_water,
    stack_depths,
)
from mr360uw.caustics.irradiance import add_edge, deposit_exact, intensities, opened, pass_indices
from mr360uw.caustics.settings import grid_of
from mr360uw.caustics.summed_stack import summed_stack
from mr360uw.caustics.sun_disc import blur, disc_kernel, footprint
from mr360uw.errors import ParameterError
from tests.caustics import tolerances as tol
from tests.caustics.pixel_coverage import cell_light, edge_coverage
from tests.caustics.seas import SEAS, lattice_sea, photon_sea
from tests.reference import reference_arrays

ZENITH = (0.0, 1.0, 0.0)
SLANTED = direction_from_angles(0.7, np.radians(50.0))
FLAT = GerstnerSea(wind_speed=0.0)


def relative_rmse(got: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(np.mean((got - expected) ** 2)) / np.std(expected))


@pytest.mark.parametrize("sun", [ZENITH, SLANTED])
def test_a_flat_sea_casts_no_caustics(sun):
    ratio = caustic_map(FLAT, sun, 7.3, 0.0, 64, 48)
    np.testing.assert_allclose(ratio, 1.0, atol=tol.CAUSTICS_MEAN_REFERENCE)


@pytest.mark.parametrize("name", SEAS)
def test_energy_at_every_depth_and_sun(name):
    for depth in (0.0, 1.0, 5.0, 30.0):
        for zenith_deg in (0.0, 40.0, 75.0):
            sun = direction_from_angles(1.0, np.radians(90.0 - zenith_deg))
            ratio = caustic_map(SEAS[name], sun, depth, 0.3, 64, 48)
            assert ratio.mean() == pytest.approx(1.0, abs=tol.CAUSTICS_MEAN_REFERENCE)
            assert ratio.min() >= 0.0


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    folding=st.floats(0.0, 1.0),
    count=st.integers(1, 12),
    zenith_deg=st.floats(0.0, 89.0),
    azimuth=st.floats(-7.0, 7.0),
    depth=st.floats(0.0, 60.0),
    tile_m=st.floats(0.1, 1000.0),
    index=st.floats(1.01, 1.6),
)
def test_energy_of_any_sea(seed, folding, count, zenith_deg, azimuth, depth, tile_m, index):
    sea = lattice_sea(np.random.default_rng(seed), count, folding, tile_m)
    sun = direction_from_angles(azimuth, np.radians(90.0 - zenith_deg))
    ratio = caustic_map(sea, sun, depth, 0.0, 32, 16, index)
    assert np.all(np.isfinite(ratio))
    assert ratio.mean() == pytest.approx(1.0, abs=tol.CAUSTICS_MEAN_REFERENCE)


def test_waves_lower_than_numbers_go_are_none():
    """Edges of cells then cross the side of a pixel by less than the square root of the least number."""
    sea = lattice_sea(np.random.default_rng(0), 1, 2.2e-311, 2.0)
    np.testing.assert_allclose(caustic_map(sea, ZENITH, 0.0, 0.0, 32, 16), 1.0, atol=tol.CAUSTICS_MEAN_REFERENCE)


@pytest.mark.parametrize("name", ["calm", "choppy"])
def test_photons(name):
    expected = reference_arrays("photons.npz")[name].astype(float)
    sea = photon_sea(name)
    for grid, limit in ((256, tol.CAUSTICS_TRUTH[name]), (100, tol.CAUSTICS_TRUTH_COARSE)):
        got = caustic_map(sea, ZENITH, 3.0, 0.0, len(expected), grid, sun_half_angle_rad=0.0)
        assert relative_rmse(got, expected) < limit


@pytest.mark.parametrize(
    ("sea", "cells"),
    [
        (photon_sea("choppy"), 256), (photon_sea("choppy").model_copy(update={"detail_slope": 0.1}), 96),
        (SEAS["blurred"], 192), (FLAT, 64),
    ],
)  # fmt: skip
def test_a_sea_gets_the_grid_it_needs(sea, cells):
    """Against a grid of 448, the sun overhead: an error below 0.05."""
    assert grid_of(CausticSettings(grid=40), sea) == 40
    assert grid_of(CausticSettings(), sea) == cells
    got, best = (caustic_map(sea, ZENITH, 3.0, 0.0, 256, g) for g in (cells, 448))
    assert np.sqrt(np.mean((got - best) ** 2)) <= tol.ENOUGH_CELLS * best.std() + tol.CAUSTICS_MEAN_REFERENCE


@pytest.mark.parametrize("sea", [GerstnerSea(), SpectralSea(wind_speed=8.0)])
def test_light_in_the_first_metres_is_as_near_to_that_of_a_fine_grid(sea):
    """Of seas of wind at the default settings, by both renderers; with the cells of deeper planes 0.06 and 0.15."""
    settings, rest = CausticSettings(), (1.34, None)
    for depth in (1.0, 2.0):
        best = caustic_stack(sea, ZENITH, [depth], 0.4, CausticSettings(grid=768), *rest).ratio
        for stack in (caustic_stack, summed_stack):
            got = stack(sea, np.array(ZENITH), np.array([depth]), 0.4, settings, *rest).ratio
            assert relative_rmse(got, best) < tol.ENOUGH_CELLS


def test_finer_grids_converge_where_dividing_areas_does_not():
    sea = lattice_sea(np.random.default_rng(8), 8, 0.5)
    arguments = (sea, ZENITH, 4.0, 0.0, 128)
    best = caustic_map(*arguments, 768, sun_half_angle_rad=0.0)
    errors = {
        method: [
            relative_rmse(caustic_map(*arguments, g, sun_half_angle_rad=0.0, method=method), best) for g in (32, 128)
        ]
        for method in ("exact", "ratio")
    }
    assert errors["exact"][1] < 0.5 * errors["exact"][0]
    assert errors["ratio"][1] > 5.0 * errors["exact"][1]


def test_methods_are_one_without_waves():
    for method in ("exact", "ratio", "fan", "jacobian", "scrolling"):
        ratio = caustic_map(FLAT, SLANTED, 3.0, 0.2, 32, 16, method=method)
        assert ratio.mean() == pytest.approx(1.0, abs=tol.CAUSTICS_MEAN_REFERENCE)


def test_light_moves_along_the_sun_not_the_map():
    """A ripple so low that its pattern is a sine, at two depths: its phase moves by the beam's horizontal travel."""
    period = 0.5
    sea = GerstnerSea.from_waves([[2.0 * np.pi / period, 0.0]], 1e-3, 0.0, 0.0, tile_m=8.0)
    sun = direction_from_angles(np.pi / 2, np.radians(60.0))
    wave = np.exp(2j * np.pi * np.arange(256) * 8.0 / 256 / period)
    shallow, deep = (np.angle(caustic_map(sea, sun, d, 0.0, 256, 256).mean(axis=0) @ wave) for d in (4.0, 4.2))
    moved = np.remainder(deep - shallow + np.pi, 2.0 * np.pi) - np.pi
    water = refract_to_water(sun)
    assert moved * period / (2.0 * np.pi) == pytest.approx(-0.2 * water[0] / water[1], abs=tol.BEAM_SHIFT)


def test_a_crest_focuses_at_its_focal_depth():
    amplitude, k = 0.02, 2.0 * np.pi / 2.0
    sea = GerstnerSea.from_waves([[k, 0.0]], amplitude, 0.0, 0.0, tile_m=2.0)
    focus = 1.34 / 0.34 / (amplitude * k * k)
    contrast = [
        caustic_map(sea, ZENITH, d * focus, 0.0, 256, 512, sun_half_angle_rad=0.0).max() for d in (0.5, 1.0, 3.0)
    ]
    assert contrast[1] > contrast[0]
    assert contrast[1] > contrast[2]


def test_at_depth_zero_only_the_facets_tilt_counts():
    ratio = caustic_map(SEAS["gerstner"], ZENITH, 0.0, 0.0, 64, 64)
    assert ratio.std() < tol.TILT_CONTRAST


def test_edge_coverage_of_known_shapes():
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    total = sum(edge_coverage(*square[i], *square[(i + 1) % 4]) for i in range(4))
    assert total == pytest.approx(1.0, abs=tol.FLOAT64)
    large = [(-5.0, -5.0), (9.0, -4.0), (0.5, 12.0)]
    assert sum(edge_coverage(*large[i], *large[(i + 1) % 3]) for i in range(3)) == pytest.approx(1.0, abs=tol.FLOAT64)
    half = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
    assert sum(edge_coverage(*half[i], *half[(i + 1) % 3]) for i in range(3)) == pytest.approx(0.5, abs=tol.FLOAT64)


def test_pixels_share_the_whole_cell(rng):
    for shape in (rng.uniform(0.0, 6.0, (200, 8)), np.repeat(rng.uniform(0.0, 6.0, (50, 2)), 4, axis=0).reshape(50, 8)):
        for cell in shape:
            corners = opened(*cell)
            light = intensities(corners, 0.3, 0.7)
            total = sum(
                cell_light(*(np.array(corners) - np.tile((x, y), 4)), *light)
                for x in range(-1, 8)
                for y in range(-1, 8)
            )
            assert total == pytest.approx(1.0, abs=tol.SHARED_CELL)


@pytest.mark.parametrize(("size", "cells", "reach"), [(24, 8, 3.0), (9, 5, 20.0), (16, 4, 0.0)])
def test_edges_share_light_as_pixels_do(rng, size, cells, reach):
    """Cells thrown about the tile and beyond it, against the closed form in every pixel that a cell touches."""
    at = np.stack(np.meshgrid(*(np.arange(cells + 1) * (size / cells),) * 2), axis=-1)
    moved = rng.uniform(-reach, reach, (cells, cells, 2))
    hit = at + np.pad(moved, ((0, 1), (0, 1), (0, 0)), mode="wrap") + 0.37
    hit[1:3, 1:3] = hit[1, 1]  # some cells are points, and their neighbours lines
    flux = rng.uniform(0.1, 1.0, (cells, cells, 2))
    expected, evenly = np.zeros((size, size)), 0.0
    for j, i in np.ndindex(cells, cells):
        corners = np.array(opened(*hit[j, i], *hit[j, i + 1], *hit[j + 1, i + 1], *hit[j + 1, i]))
        low = np.floor(corners.reshape(4, 2).min(axis=0)).astype(int)
        high = np.ceil(corners.reshape(4, 2).max(axis=0)).astype(int)
        if np.any(high - low >= size):
            evenly += flux[j, i].sum()
            continue
        light = intensities(tuple(corners), *flux[j, i])
        for y in range(low[1], high[1]):
            for x in range(low[0], high[0]):
                expected[y % size, x % size] += cell_light(*(corners - np.tile((x, y), 4)), *light)
    np.testing.assert_allclose(deposit_exact(hit, flux, size), expected + evenly / size**2, atol=tol.EDGE_SUM)


def test_the_suns_disc_keeps_energy_and_has_its_width():
    image = np.zeros((64, 64))
    image[0, 0] = 64.0 * 64.0
    disc = footprint(np.array(ZENITH), 1.34, 0.05, 20.0)
    blurred = blur(image, disc, 8.0)
    assert blurred.mean() == pytest.approx(1.0, abs=tol.FLOAT64)
    assert blurred.min() >= 0.0
    radius = 20.0 * 0.05 / 1.34
    at = (np.arange(64) + 32) % 64 - 32
    variance = (blurred.sum(axis=0) * (at * 0.125) ** 2).sum() / blurred.sum()
    assert variance == pytest.approx(radius**2 / 4.0, rel=tol.DISC_SHAPE)


def test_a_slanted_suns_disc_is_an_ellipse():
    sun = direction_from_angles(np.pi / 2, np.radians(30.0))
    step = 1e-5
    moved = [refract_to_water(direction_from_angles(np.pi / 2, np.radians(30.0) + s)) for s in (-step, step)]
    along = abs(np.diff([m[0] / m[1] for m in moved])[0]) / (2.0 * step)
    disc = footprint(sun, 1.34, 1.0, 1.0)
    assert np.linalg.norm(disc[0]) == pytest.approx(along, rel=tol.FINITE_DIFFERENCE)


@pytest.mark.parametrize("radius", [0.3, 0.8, 2.5])
def test_kernels_have_the_discs_variance(radius):
    kernel = disc_kernel(radius * np.eye(2), 32)
    assert kernel.sum() == pytest.approx(1.0, abs=tol.FLOAT64)
    at = (np.arange(32) + 16) % 32 - 16
    for marginal in (kernel.sum(axis=0), kernel.sum(axis=1)):
        assert np.sum(marginal * at**2) == pytest.approx(radius**2 / 4.0, rel=tol.DISC_SHAPE)


@pytest.mark.parametrize("method", ["exact", "scrolling"])
def test_stacks_are_maps_below_an_overhead_sun(method):
    s = CausticSettings(size=64, grid=64, chromatic=3, method=method)
    depths = stack_depths(1.0, 9.0, 3)
    stack = caustic_stack(SEAS["ripples"], ZENITH, depths, 0.5, s)
    for channel, index in enumerate(pass_indices(3, 1.34)):
        direct = caustic_map(SEAS["ripples"], ZENITH, depths[1], 0.5, 64, 64, index, method=method)
        np.testing.assert_allclose(stack.ratio[1, :, :, channel], direct, rtol=tol.FLOAT64)


def test_planes_of_a_stack_lie_along_the_beam():
    """A ripple too low to focus: its pattern stands still in the maps, and moves with the beam in the world."""
    period = 0.5
    sea = GerstnerSea.from_waves([[2.0 * np.pi / period, 0.0]], 1e-3, 0.0, 0.0, tile_m=8.0)
    sun = direction_from_angles(np.pi / 2, np.radians(60.0))
    stack = caustic_stack(sea, sun, [4.0, 4.3], 0.0, CausticSettings(size=256, grid=256))
    wave = np.exp(2j * np.pi * np.arange(256) * 8.0 / 256 / period)
    shallow, deep = (np.angle(ratio[..., 0].mean(axis=0) @ wave) for ratio in stack.ratio)
    assert (deep - shallow) * period / (2.0 * np.pi) == pytest.approx(0.0, abs=tol.BEAM_SHIFT)
    x, levels = (np.arange(256) + 0.5) * 8.0 / 256, mip_levels(stack.ratio)
    seen = [np.angle(caustic_lookup(stack, levels, x, d, 0.0, 0.0)[:, 0] @ wave) for d in (4.0, 4.3)]
    moved = np.remainder(seen[1] - seen[0] + np.pi, 2.0 * np.pi) - np.pi
    travel = -0.3 * stack.sun_direction[0] / stack.sun_direction[1]
    assert moved * period / (2.0 * np.pi) == pytest.approx(travel, abs=tol.BEAM_SHIFT)


@pytest.mark.parametrize("zenith_deg", [0.0, 11.0, 40.0])
@pytest.mark.parametrize("name", ["calm", "choppy"])
def test_between_the_planes_of_a_stack(name, zenith_deg):
    """Eight planes from 4 to 8 m read halfway between planes, against a plane right there read in the same way."""
    sun = direction_from_angles(0.6, np.radians(90.0 - zenith_deg))
    sea = photon_sea(name)
    s = CausticSettings(size=256, grid=256)
    stack = caustic_stack(sea, sun, stack_depths(4.0, 8.0, 8), 0.0, s)
    levels = mip_levels(stack.ratio)
    x, z = np.random.default_rng(5).uniform(0.0, 8.0, (2, 20_000))
    for above, below in zip(stack.depth_m[:-1], stack.depth_m[1:], strict=True):
        depth = 0.5 * (above + below)
        there = caustic_stack(sea, sun, [depth], 0.0, s)
        direct = caustic_lookup(there, mip_levels(there.ratio), x, depth, z, 0.0)
        assert relative_rmse(caustic_lookup(stack, levels, x, depth, z, 0.0), direct) < tol.STACK_BETWEEN[name]


@pytest.mark.parametrize("across", [1.75, 2.5, 4.0])
def test_a_lookup_averages_over_its_footprint(across):
    """Against the mean over a square of a map eight times as fine: as much contrast, and much the same pattern."""
    stack, fine = (
        caustic_stack(SEAS["gerstner"], SLANTED, [4.0], 0.0, CausticSettings(size=n, grid=128)) for n in (128, 1024)
    )
    width = round(8 * across)
    mean = uniform_filter(fine.ratio[0, :, :, 0], width, mode="wrap")  # of an even width: about the pixels' corners
    x, z = np.meshgrid(*(np.arange(1024) * 8.0 / 1024,) * 2)
    up = 4.0 / stack.sun_direction[1]
    x, z = x - stack.sun_direction[0] * up, z - stack.sun_direction[2] * up
    got = caustic_lookup(stack, mip_levels(stack.ratio), x, 4.0, z, across * 8.0 / 128)[..., 0]
    assert got.std() == pytest.approx(mean.std(), rel=tol.FOOTPRINT_CONTRAST)
    assert relative_rmse(got, mean) < tol.FOOTPRINT_PATTERN


def test_stack_depths():
    np.testing.assert_allclose(stack_depths(3.0, 15.0, 3), [3.0, 8.0, 15.0])
    np.testing.assert_allclose(stack_depths(3.0, 15.0, 1), [8.0])
    np.testing.assert_array_equal(stack_depths(2.1, 8.3, 5)[[0, -1]], [2.1, 8.3])
    for bad in ((0.0, 1.0, 2), (3.0, 2.0, 2), (1.0, 2.0, 0), (np.nan, 2.0, 2)):
        with pytest.raises(ParameterError, match=r"stack|near_m"):
            stack_depths(*bad)


@pytest.mark.parametrize(
    "sea",
    [
        GerstnerSea(wave_count=1),
        GerstnerSea(steepness=1.0, wind_speed=40.0),
        GerstnerSea(tile_m=0.1),
        GerstnerSea(tile_m=1000.0),
        SpectralSea(wind_speed=40.0, choppiness=2.0, resolution=16),
    ],
)
def test_extreme_seas_and_depths(sea):
    for depth in (0.0, 1e-6, 200.0):
        for sun in (ZENITH, direction_from_angles(0.0, 1e-3)):
            ratio = caustic_map(sea, sun, depth, 0.0, 16, 16)
            assert np.all(np.isfinite(ratio))
            assert ratio.mean() == pytest.approx(1.0, abs=tol.CAUSTICS_MEAN_REFERENCE)


def test_one_fully_steep_wave():
    k = 2.0 * np.pi
    sea = GerstnerSea.from_waves([[k, 0.0]], 1.0 / k, 1.0, 0.0, tile_m=1.0)
    ratio = caustic_map(sea, SLANTED, 0.5, 0.0, 32, 32)
    assert np.all(np.isfinite(ratio))
    assert ratio.mean() == pytest.approx(1.0, abs=tol.CAUSTICS_MEAN_REFERENCE)


@pytest.mark.parametrize(
    "changes",
    [
        {"sun_direction_in_air": (1.0, 0.0, 0.0)},
        {"sun_direction_in_air": (0.0, -1.0, 0.0)},
        {"sun_direction_in_air": (np.nan, 1.0, 0.0)},
        {"depth_m": -1.0},
        {"depth_m": np.nan},
        {"time_s": np.nan},
        {"size": 0},
        {"grid": 1},
        {"refractive_index": np.nan},
        {"refractive_index": 1.0},
        {"sun_half_angle_rad": np.inf},
        {"method": "magic"},
    ],
)
def test_arguments_outside_their_domain(changes):
    arguments = {"sun_direction_in_air": ZENITH, "depth_m": 3.0, "time_s": 0.0, "size": 16, "grid": 8} | changes
    with pytest.raises(ParameterError):
        caustic_map(GerstnerSea(), **arguments)


def test_settings_that_cannot_be():
    for bad in ({"size": 100}, {"size": 8}, {"chromatic": 2}, {"method": "magic"}, {"sun_half_angle_rad": np.nan}):
        with pytest.raises(ParameterError):
            CausticSettings(**bad)
    with pytest.raises(ParameterError, match="ascend"):
        caustic_stack(FLAT, ZENITH, [3.0, 2.0], 0.0, CausticSettings(size=16, grid=8))


@pytest.mark.parametrize("chromatic", [1, 3])
def test_the_index_of_the_water_bends_every_pass(chromatic):
    s = CausticSettings(size=64, grid=64, chromatic=chromatic)
    stack = caustic_stack(SEAS["ripples"], SLANTED, [4.0], 0.5, s, 1.2)
    np.testing.assert_allclose(stack.sun_direction, refract_to_water(SLANTED, 1.2), rtol=tol.FLOAT64)
    assert pass_indices(chromatic, 1.2)[chromatic // 2] == pytest.approx(1.2, abs=tol.FLOAT64)
    overhead = caustic_stack(SEAS["ripples"], ZENITH, [4.0], 0.5, s, 1.2).ratio
    for channel, index in enumerate(pass_indices(chromatic, 1.2)):
        direct = caustic_map(SEAS["ripples"], ZENITH, 4.0, 0.5, 64, 64, index)
        np.testing.assert_allclose(overhead[0, :, :, channel], direct, rtol=tol.FLOAT64)
    assert np.all(np.diff(pass_indices(3, 1.2)) > 0.0)  # shorter waves bend more


def test_an_edge_whose_slope_overflows_carries_no_light() -> None:
    """It runs over two pixels and falls by two subnormal numbers, across the border of two rows."""
    change, start = np.zeros((4, 5)), np.zeros(4)
    add_edge(change, start, 0.5, -5e-324, 2.5, 5e-324, 1.0)
    np.testing.assert_allclose(change, 0.0, atol=1e-300)
    np.testing.assert_allclose(start, 0.0, atol=1e-300)
