# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sea from below and from above."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw import surface
from mr360uw.base import optics
from mr360uw.base.cache import version
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle, unit
from mr360uw.caustics import CausticSettings, GerstnerSea, caustic_map
from mr360uw.errors import ParameterError
from mr360uw.medium import Medium, Water
from mr360uw.surface.facet_draws import next_key
from mr360uw.surface.intersection import first_hits
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sky import Dome
from mr360uw.surface.water_light import WaterLight, sky_pattern, sun_pattern
from mr360uw.types import Sun, View
from tests.surface import tolerances as tol

N = 1.34
CALM = GerstnerSea.from_waves([[2.0 * np.pi / 8.0, 0.0]], 0.0, 0.0, 0.0, tile_m=8.0)
WAVES = GerstnerSea.from_waves([[np.pi / 2.0, 0.0], [0.0, np.pi]], [0.06, 0.03], 0.8, 0.5, tile_m=8.0)
EVEN = np.ones((32, 64, 3))
DIM = np.where(np.arange(32)[:, None, None] < 3, EVEN, 0.0)
"""A sky with light overhead alone: few patches, so that their maps take no time."""
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
FEW = CausticSettings(size=64, grid=64)


def sun_at(elevation_deg: float, half_angle: float = 0.00465) -> Sun:
    return Sun(direction_from_angles(0.4, np.radians(elevation_deg)), np.array([4.0, 5.0, 6.0]), half_angle, 1.0)


def small(y: float, **more: Any) -> View:
    return View(32, 16, np.array([0.3, y, 0.2]), surface_y_m=0.0, **more)


def test_snells_window() -> None:
    view = View(200, 3, np.array([0.0, -3.0, 0.0]), UP, 0.0, "perspective", fov_rad=np.radians(110.0))
    seen = surface.picture(CALM, EVEN, (-5.0, 0.0), view).radiance[1, :, 1]
    lit = np.flatnonzero(seen > 1e-6)
    edge = np.tan(np.arcsin(1.0 / N)) * 100.0 / np.tan(np.radians(55.0))
    assert abs(0.5 * (lit[-1] - lit[0] + 1) - edge) < tol.WINDOW_EDGE_PIXELS
    np.testing.assert_allclose(seen[99:101], N * N * (1.0 - optics.fresnel_from_below(1.0, N)), rtol=1e-3)


def test_what_is_under_water_looks_nearer() -> None:
    """The edge of a chequer, as Snell's law puts it."""
    depth, high, fov, size = 3.0, 10.0, np.radians(30.0), 512
    chequer = np.zeros((256, 256))
    chequer[:, :128] = 0.8
    view = View(size, 3, np.array([0.0, high, 0.0]), UP.T, 0.0, "perspective", fov_rad=fov)
    row = surface.picture(CALM, EVEN, surface.Floor(-depth, chequer, 2.0), view).radiance[1, :, 1]
    middle = 0.5 * (row.max() + row.min())
    at = np.flatnonzero((row[:-1] - middle) * (row[1:] - middle) < 0.0)
    near = at[:, None] + np.arange(-4, 6)  # the light of the left side, in pixels from there on
    place = at - 4 + np.sum((row[near] - row[at + 6][:, None]) / (row[at - 5] - row[at + 6])[:, None], axis=1)
    tangent = (2.0 * place / size - 1.0) * np.tan(0.5 * fov)
    tangent = tangent[tangent > 0.1]
    assert len(tangent) >= 1
    sine = tangent / np.hypot(1.0, tangent) / N
    wet = sine / np.sqrt(1.0 - sine**2)
    edge = np.round(high * tangent + depth * wet)
    np.testing.assert_allclose((edge - high * tangent) / wet / depth, 1.0, atol=tol.APPARENT_DEPTH)


def test_distances_masks_and_normals() -> None:
    seen = surface.picture(CALM, EVEN, (-4.0, 0.3), small(-1.0), samples=1)
    d = directions(32, 16)
    down = d[..., 1] < 0.0
    np.testing.assert_array_equal(seen.floor, down)
    np.testing.assert_array_equal(seen.surface, ~down)
    np.testing.assert_allclose(seen.distance_m, np.where(down, -3.0, 1.0) / d[..., 1], rtol=1e-9)
    np.testing.assert_allclose(seen.normal[~down], np.broadcast_to([0.0, 1.0, 0.0], (32 * 8, 3)), atol=1e-12)
    assert seen.camera_in_water
    above = surface.picture(CALM, EVEN, (-4.0, 0.3), small(2.0), samples=1)
    assert not above.camera_in_water
    assert np.all(np.isinf(above.distance_m[~down]))
    np.testing.assert_array_equal(above.in_water_m[~down], 0.0)
    sine = np.sqrt(1.0 - d[down][:, 1] ** 2) / N
    np.testing.assert_allclose(above.in_water_m[down], 4.0 / np.sqrt(1.0 - sine**2), rtol=1e-6)  # rays start 1 um on


def test_light_between_floor_and_surface() -> None:
    """Even sky, level sea, clear water: E = E_0/(1 - A R), as seen on the floor and as the surface mirrors it."""
    albedo = 0.6
    seen = surface.picture(CALM, EVEN, (-4.0, albedo), small(-1.0), samples=1).radiance
    passed = np.pi * (1.0 - optics.diffuse_reflectance_from_below(N)) * N * N
    expected = albedo / np.pi * passed / (1.0 - albedo * optics.diffuse_reflectance_from_below(N))
    np.testing.assert_allclose(seen[12:], expected, rtol=tol.EVEN_SKY)
    np.testing.assert_allclose(seen[6], expected, rtol=tol.EVEN_SKY)  # totally reflected


@pytest.mark.parametrize("samples", [1, 8])
def test_faint_reflections_are_kept_however_many_samples(samples: int) -> None:
    """2 % of the sky over black water."""
    view = View(4, 4, np.array([0.0, 3.0, 0.0]), UP.T, 0.0, "perspective", fov_rad=0.2)
    seen = surface.picture(CALM, EVEN, (-4.0, 0.0), view, samples=samples).radiance
    np.testing.assert_allclose(seen, optics.fresnel(1.0, N), rtol=1e-3)


def test_an_even_world_stays_even() -> None:
    """A white floor in clear water gives back all light: sky and sea have one radiance, whatever the waves."""
    for y in (3.0, -1.0):
        seen = surface.picture(WAVES, EVEN, (-4.0, 1.0), small(y), samples=1, caustics=FEW)
        expected = np.where(seen.camera_in_water, N * N, 1.0)
        np.testing.assert_allclose(seen.radiance, expected, rtol=tol.EVEN_PIXEL)
        assert seen.radiance.mean() == pytest.approx(expected, rel=tol.EVEN_SKY)


def test_the_water_knows_where_its_sky_is_bright() -> None:
    sine = np.abs(np.sin(np.pi * (0.5 - (np.arange(64) + 0.5) / 64)))
    shape = Dome(np.ones((64, 128, 3)) * (1.0 + 2.0 * sine[:, None, None])).shape.radiance
    expected = 0.5 + np.linspace(0.0, 1.0, len(shape))
    np.testing.assert_allclose(shape[1:-1], expected[1:-1], atol=tol.OF_SHAPE)  # half a step at the ends


@pytest.mark.parametrize("elevation", [90.0, 40.0])
def test_the_light_on_the_floor_is_the_caustic_map_of_the_sea(elevation: float) -> None:
    sun, depth = sun_at(elevation), 3.0
    found = sun_pattern(WAVES, sun, depth, 0.7, N, FEW)
    assert found is not None
    at = (np.arange(64) + 0.5) * 8.0 / 64
    x, z = (v.ravel() for v in np.meshgrid(at, at))
    pattern = found[0].at(x, z, np.zeros(len(x)))[:, 0].reshape(64, 64)
    expected = caustic_map(WAVES, sun.direction, depth, 0.7, 64, 64, N)
    if elevation == 90.0:
        np.testing.assert_allclose(pattern, expected, atol=1e-9)
    else:  # maps along the beam are read between their pixels
        assert np.corrcoef(pattern.ravel(), expected.ravel())[0, 1] > 0.97
        assert pattern.mean() == pytest.approx(1.0, abs=1e-6)


def test_the_sky_in_two_parts_brings_its_light() -> None:
    d = directions(64, 32)
    halo = 1.0 + 40.0 * np.maximum(d @ direction_from_angles(0.4, 1.0), 0.0)[..., None] ** 60
    dome = Dome(halo * np.array([0.5, 1.0, 2.0]))
    soft, bright = dome.divided(N)
    total = soft.irradiance_below(N) + sum(irradiance for _, irradiance, _ in bright)
    np.testing.assert_allclose(total, dome.irradiance_below(N), rtol=tol.SKY_SUM)
    assert 0.01 < sum(irradiance[1] for _, irradiance, _ in bright) / total[1] < 0.3
    mean = sky_pattern(CALM, SampledSea.of(CALM, 0.0), Dome(EVEN), 4.0, 0.0, N).levels[-1].ravel()
    np.testing.assert_allclose(mean, np.pi * (1.0 - optics.diffuse_reflectance_from_below(N)) * N**2, rtol=tol.EVEN_SKY)


def test_waves_pattern_the_light_of_a_soft_sky_as_many_exact_rays_find_it() -> None:
    """At random places, by 4000 rays each that are intersected exactly, through waves that are all drawn."""
    depth, rng = 5.0, np.random.default_rng(3)
    place, count = rng.uniform(0.0, 8.0, (96, 2)), 4000
    sine, turn = np.sqrt((np.arange(count) + 0.5) / count), np.arange(count) * (np.pi * (3.0 - np.sqrt(5.0)))
    up = np.stack([sine * np.cos(turn), np.sqrt(1.0 - sine**2), sine * np.sin(turn)], axis=-1)
    rays, sampled = np.tile(up, (len(place), 1)), SampledSea.of(WAVES, 0.7)
    origins = np.repeat(np.insert(place, 1, -depth, axis=1), count, axis=0)
    zero = np.zeros(len(rays))
    hits = first_hits(sampled, origins, rays, True, zero, zero, np.full(len(rays), 1e6))
    passed = 1.0 - optics.fresnel_from_below(np.sum(rays * hits.normal, axis=1), N)
    truth = np.pi * N**2 * passed.reshape(len(place), count).mean(axis=1)
    pattern = sky_pattern(WAVES, sampled, Dome(EVEN), depth, 0.7, N)
    found = pattern.at(place[:, 0], place[:, 1], np.zeros(len(place)))[:, 1]
    np.testing.assert_allclose(found.mean(), truth.mean(), rtol=tol.SKY_RAYS)
    found, truth = found / found.mean() - 1.0, truth / truth.mean() - 1.0
    assert np.sqrt(np.mean((found - truth) ** 2)) < tol.SKY_RAYS
    assert truth.std() > 3.0 * tol.SKY_RAYS
    assert found.std() == pytest.approx(truth.std(), rel=0.1)


def test_the_floor_under_water_has_the_light_of_the_solved_field() -> None:
    """Sky and sun together, mean over the pattern, on a black floor; a white one gets what the surface sends back."""
    sun, dome, depth = sun_at(50.0), Dome(EVEN), 5.0
    lights = [WaterLight.of(Water.jerlov("IB"), dome, sun, N, depth, np.full(3, a)) for a in (0.0, 1.0)]
    sampled = SampledSea.of(WAVES, 0.0)
    floors = [light.on_floor(WAVES, sampled, dome, sun, depth, 0.0, FEW) for light in lights]
    at = (np.arange(64) + 0.5) * 8.0 / 64
    x, z = (v.ravel() for v in np.meshgrid(at, at))
    black, white = (f.irradiance(x, z, np.zeros(len(x))).mean(axis=0) for f in floors)
    parts = [part for part in (lights[0].sky, lights[0].sun) if part is not None]
    expected = sum(p.below * p.medium.light.display(p.medium.model.irradiance(depth, 1.0)) for p in parts)
    assert len(parts) == 2
    np.testing.assert_allclose(black, expected, rtol=tol.SOLVED)
    np.testing.assert_allclose(white, lights[1].down(depth), rtol=tol.SOLVED)
    assert np.all(white > 1.02 * black)


@pytest.mark.parametrize("mode", ["table", "kd"])
def test_a_white_floor_over_a_black_one_has_what_comes_back_through_the_water(mode: Any) -> None:
    """1/(1 - R(tau)): the floor's light crosses the water up and down at all angles; it scatters nothing."""
    depth, absorption = 4.0, 0.1
    clear = Water.from_arrays([380.0, 780.0], [absorption] * 2, [0.0] * 2)
    given = Medium(clear, mode=mode, refractive_index=N)
    black, white = (WaterLight.of(given, Dome(EVEN), None, N, depth, np.full(3, a)).down(depth) for a in (0.0, 1.0))
    x, w = np.polynomial.legendre.leggauss(400)
    cosine, weight = 0.5 + 0.5 * x, 0.5 * w
    mirrored = optics.fresnel_from_below(cosine, N) * np.exp(-2.0 * absorption * depth / cosine)
    back = np.sum(2.0 * cosine * weight * mirrored)
    np.testing.assert_allclose(white / black, 1.0 / (1.0 - back), rtol=tol.TWICE_THROUGH)


def test_water_dims_the_floor_and_hides_it_far_away() -> None:
    far = surface.picture(WAVES, DIM, (-8.0, 0.5), small(-2.0), Water.jerlov("II"), samples=1, caustics=FEW)
    clear = surface.picture(WAVES, DIM, (-8.0, 0.5), small(-2.0), samples=1, caustics=FEW)
    assert np.all(far.radiance[14] < clear.radiance[14])
    red, blue = far.radiance[14].mean(axis=0)[[0, 2]] / clear.radiance[14].mean(axis=0)[[0, 2]]
    assert red < 0.5 * blue
    assert far.radiance.min() > 0.0


def test_glitter_has_the_slopes_of_cox_and_munk() -> None:
    """Variance of p(s) = 4 L cos(view) n_y^4/(F E), over slopes (Cox & Munk 1954)."""
    from mr360uw.caustics.sea import mean_square_slope

    sun = replace(sun_at(90.0), direction=np.array([0.0, 1.0, 0.0]))
    view = View(96, 48, np.array([0.0, 300.0, 0.0]), surface_y_m=0.0)
    light = surface.picture(
        GerstnerSea(wind_speed=6.0), 0.0 * EVEN, (-30.0, 0.0), view, sun=sun, samples=1, caustics=FEW
    ).radiance[..., 1]
    d = directions(96, 48)
    normal = unit(sun.direction - d + 1e-12)
    cosine, slope = -np.sum(d * normal, axis=-1), np.hypot(normal[..., 0], normal[..., 2]) / normal[..., 1]
    p = light * -d[..., 1] * normal[..., 1] ** 4 / optics.fresnel(cosine, N)
    share = np.where(d[..., 1] < -0.26, p * np.cos(np.arcsin(d[..., 1])) / (cosine * normal[..., 1] ** 3), 0.0)
    found = np.sum(share * slope**2) / np.sum(share)
    assert found == pytest.approx(mean_square_slope(6.0), rel=0.05)


@pytest.mark.parametrize("rows", [16, 256])
def test_the_sun_in_the_air_brings_its_irradiance_whatever_the_pixels(rows: int) -> None:
    sun = sun_at(50.0, half_angle=0.03)
    view = View(2 * rows, rows, np.array([0.0, 9.0, 0.0]), surface_y_m=0.0)
    seen = surface.picture(CALM, 0.0 * EVEN, (-4.0, 0.0), view, sun=sun, samples=1, caustics=FEW).radiance
    light = np.sum(seen[: rows // 2] * row_solid_angle(2 * rows, rows)[: rows // 2, None, None], axis=(0, 1))
    np.testing.assert_allclose(light, sun.irradiance, rtol=tol.COARSE_SUN[rows])


def test_the_sun_through_a_level_sea_is_a_disc_of_its_own_radiance() -> None:
    sun = sun_at(50.0, half_angle=0.1)
    view = View(64, 64, np.array([0.0, -3.0, 0.0]), UP, 0.0, "perspective", fov_rad=np.radians(90.0))
    seen = surface.picture(CALM, 0.0 * EVEN, (-5.0, 0.0), view, sun=sun, samples=2, caustics=FEW).radiance
    radiance = sun.irradiance / (2.0 * np.pi * (1.0 - np.cos(0.1)))
    factor = optics.radiance_factor(sun.direction[1], N)
    np.testing.assert_allclose(seen.max(axis=(0, 1)), radiance * factor, rtol=0.02)
    row, column = np.unravel_index(np.argmax(seen[..., 1]), (64, 64))
    lit = np.argwhere(seen[..., 1] > 0.5 * seen[..., 1].max())
    middle = view.directions(lit[:, 1].mean() + 0.5, lit[:, 0].mean() + 0.5)
    np.testing.assert_allclose(middle, optics.refract_to_water(sun.direction, N), atol=0.02)
    assert seen[row, column, 1] > 0.0


CASES: dict[str, tuple[GerstnerSea, float, float, Sun | None, np.ndarray]] = {
    "camera in the surface": (WAVES, -4.0, 0.0, sun_at(40.0), DIM),
    "waves taller than the depth": (
        GerstnerSea.from_waves([[np.pi / 4.0, 0.0]], 1.0, 0.9, 0.3, tile_m=8.0), -0.4, 5.0, sun_at(40.0), DIM,
    ),
    "sun at the horizon": (WAVES, -4.0, -1.0, sun_at(0.2), DIM),
    "sun below the horizon": (WAVES, -4.0, 2.0, sun_at(-5.0), DIM),
    "no wind": (GerstnerSea(wind_speed=0.0), -4.0, -1.0, sun_at(60.0), EVEN),
    "dry floor": (CALM, 1.0, 3.0, None, EVEN),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_unusual_scenes_give_light_that_is_finite(name: str) -> None:
    sea, floor, y, sun, dome = CASES[name]
    seen = surface.picture(sea, dome, (floor, 0.3), small(y), sun=sun, samples=1, caustics=FEW).radiance
    assert np.all(np.isfinite(seen))
    assert seen.min() >= 0.0
    assert seen.mean() > 0.0


def test_night_is_dark() -> None:
    assert surface.picture(WAVES, 0.0 * EVEN, (-4.0, 0.3), small(-1.0), samples=1).radiance.max() == 0.0


def test_a_picture_is_the_same_again_and_in_any_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    sea = GerstnerSea(wind_speed=6.0, wave_count=6)
    first = surface.picture(sea, DIM, (-4.0, 0.3), small(3.0), samples=1).radiance
    monkeypatch.setattr("mr360uw.surface.sea_picture._AT_ONCE", 64)
    np.testing.assert_array_equal(surface.picture(sea, DIM, (-4.0, 0.3), small(3.0), samples=1).radiance, first)


def test_projections_of_views() -> None:
    view = small(0.0, projection="perspective", fov_rad=np.pi / 2.0)
    np.testing.assert_allclose(view.directions(16.0, 8.0), [0.0, 0.0, -1.0], atol=1e-15)
    np.testing.assert_allclose(view.directions(32.0, 8.0), unit([1.0, 0.0, -1.0]), atol=1e-15)
    np.testing.assert_array_equal(view.origins(3.0, 2.0), view.position)
    level = small(0.0, projection="orthographic", width_m=4.0)
    np.testing.assert_allclose(level.origins(32.0, 0.0) - level.position, [2.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(level.directions([1.0, 30.0], 2.0), [[0.0, 0.0, -1.0]] * 2, atol=1e-15)
    assert version(view) != version(level)
    assert version(view) == version(small(0.0, projection="perspective", fov_rad=np.pi / 2.0))
    assert small(0.0).pixel_rad == pytest.approx(np.pi / 16)


def test_rays_keep_their_numbers() -> None:
    def pcg(k: int) -> int:
        s = (k * 747796405 + 2891336453) % 2**32
        w = ((s >> ((s >> 28) + 4)) ^ s) * 277803737 % 2**32
        return (w >> 22) ^ w

    for k in (7, 2**32 - 1):
        assert next_key(k, 11) == pcg(k ^ pcg(11))
    keys = [next_key(k, 0) for k in range(4)]
    assert len(set(keys) | {next_key(k, 1) for k in keys} | {next_key(k, 2) for k in keys}) == 12


REFUSED: dict[str, tuple[Any, ...]] = {
    "dome": (CALM, np.ones((4, 3)), (-4.0, 0.3), small(0.5)),
    "dome, dark light": (CALM, -EVEN, (-4.0, 0.3), small(0.5)),
    "floor.albedo": (CALM, EVEN, (-4.0, 2.0), small(0.5)),
    "floor.tile_m": (CALM, EVEN, (-4.0, np.ones((4, 4))), small(0.5)),
    "floor.albedo, its shape": (CALM, EVEN, (-4.0, np.ones((3, 4))), small(0.5)),
    "floor": (CALM, EVEN, -4.0, small(0.5)),
    "water": (CALM, EVEN, (-4.0, 0.3), small(0.5), "IB"),
    "view": (CALM, EVEN, (-4.0, 0.3), small(-5.0)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_drawn_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match=rf"{name.split(',')[0]} - .*\(got .* - "):
        uw.surface.picture(*REFUSED[name])


def test_samples_and_suns_are_checked() -> None:
    for more in ({"samples": 0}, {"refractive_index": 1.0}, {"sun": sun_at(40.0, half_angle=0.0)}):
        with pytest.raises(ParameterError, match=r" - .*\(got .* - "):
            surface.picture(CALM, EVEN, (-4.0, 0.3), small(0.5), **more)


def test_a_frame_of_a_film_is_a_picture_by_itself() -> None:
    """Whatever was drawn before: other times, depths, sides of the surface."""
    sun, water = sun_at(50.0), Water.jerlov("IB")
    scene = surface.SeaScene(WAVES, DIM, (-4.0, 0.3), water, sun=sun, caustics=FEW)
    for y, time_s in ((-1.0, 0.0), (2.0, 0.3), (-1.03, 0.3)):
        scene.picture(small(y), time_s, samples=1)
    later = scene.picture(small(-1.05), 0.6, samples=1)
    alone = surface.picture(WAVES, DIM, (-4.0, 0.3), small(-1.05), water, sun=sun, time_s=0.6, samples=1, caustics=FEW)
    np.testing.assert_array_equal(later.radiance, alone.radiance)
    np.testing.assert_array_equal(later.distance_m, alone.distance_m)
