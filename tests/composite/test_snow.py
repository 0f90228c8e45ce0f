# SPDX-License-Identifier: Apache-2.0
"""Marine snow: numbers and sizes, places, drift, light and pictures of particles, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.base.sphere import direction_from_frame, directions, row_solid_angle, unit, yaw_matrix
from mr360uw.caustics.gerstner import GerstnerSea
from mr360uw.caustics.spectral import SpectralSea
from mr360uw.composite.reference import render_aovs
from mr360uw.composite.settings import NEAREST_M, SnowSettings
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.composite.snow import (
    LEAST_RADIUS,
    Snow,
    draw_particles,
    empty_picture,
    merged,
    particle_phase,
    particle_radiance,
    particles_in_view,
    rest_of,
    with_particles,
)
from mr360uw.composite.snow_particles import (
    SizeClass,
    number_between,
    offsets_in_waves,
    orbiting_waves,
    particles_near,
    size_classes,
)
from mr360uw.composite.tiles import empty_tile, over
from mr360uw.medium.lookup import ambient_ratio, transmittance_lookup, veil_lookup
from mr360uw.types import Floats, Lamp, Layer, Rectangle, Sun, View
from tests.composite import scenes
from tests.composite.tolerances import (
    BALL_PHASE,
    FLOAT64,
    PHASE_MAP,
    POISSON_DEVIATIONS,
    ROLLED,
    SNOW_FLOAT32,
    SPECKLED_SUN,
)

CLASS = SizeClass(1e-3, 2e-3, 300.0, 0.0)
SEA = GerstnerSea()


def about(
    centre: Floats, radius: float = 1.5, per_m3: float = CLASS.per_m3, seed: int = 3
) -> tuple[Floats, Floats, Any]:
    kind = replace(CLASS, per_m3=per_m3)
    return particles_near([kind], 3.0, seed, centre, [np.zeros(3)], (0.0, radius, np.inf), [0.0])


# --- numbers and sizes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [2.9, 3.0, 3.58, 4.0])
def test_the_spectrum_scatters_what_the_water_does(exponent: float) -> None:
    d = np.geomspace(1e-6, 1e-2, 40001)
    density = d**-exponent * number_between(1e-6, 1e-2, exponent, 0.1) / np.trapezoid(d**-exponent, d)
    section = float(np.trapezoid(0.25 * np.pi * d**2 * density, d))
    assert 2.0 * section == pytest.approx(0.1, rel=1e-6)  # trapezoids: (2e-4)^2


def test_classes_share_the_particles_and_sink_by_their_size() -> None:
    settings = SnowSettings(sizes_mm=(0.5, 3.0), amount=2.0)
    classes = size_classes(settings, 0.1)
    assert [(c.low_m, c.high_m) for c in classes] == [(5e-4, 1e-3), (1e-3, 2e-3), (2e-3, 3e-3)]
    whole = 2.0 * number_between(5e-4, 3e-3, settings.exponent, 0.1)
    assert sum(c.per_m3 for c in classes) == pytest.approx(whole, rel=FLOAT64)
    one_mm = size_classes(SnowSettings(sizes_mm=(0.8, 1.25)), 0.1)[0]
    assert one_mm.sinking_m_s * 86400.0 == pytest.approx(50.0, rel=FLOAT64)


def test_number_and_sizes_in_a_ball_are_those_of_the_spectrum() -> None:
    position, diameter, _ = about(np.array([40.3, -7.1, 1e4]), radius=2.0)
    expected = CLASS.per_m3 * 4.0 / 3.0 * np.pi * 8.0
    assert abs(len(diameter) - expected) < POISSON_DEVIATIONS * np.sqrt(expected)
    # dN/dd = d^-3 between 1 and 2 mm: mean diameter 4/3 mm, mean square 1.8484 mm2
    error = np.sqrt((1.8484 - 16.0 / 9.0) / expected)
    assert abs(1e3 * diameter.mean() - 4.0 / 3.0) < POISSON_DEVIATIONS * error
    inner = np.sum(np.linalg.norm(position - [40.3, -7.1, 1e4], axis=-1) < 1.0)
    assert abs(inner - expected / 8.0) < POISSON_DEVIATIONS * np.sqrt(expected / 8.0)


def rows(found: tuple[Floats, Floats, Any], keep: Any = slice(None)) -> set[tuple[float, ...]]:
    return {tuple(row) for row in np.column_stack(found[:2])[keep]}


def test_particles_stay_where_the_camera_goes_and_where_the_water_thickens() -> None:
    here, there = about(np.zeros(3)), about(np.array([1.0, 0.3, -0.2]))
    both = np.linalg.norm(here[0] - [1.0, 0.3, -0.2], axis=-1) <= 1.5
    assert rows(here, both) == rows(there, np.linalg.norm(there[0], axis=-1) <= 1.5)
    assert len(rows(here, both)) > 1000
    assert rows(here) < rows(about(np.zeros(3), per_m3=500.0))
    assert not rows(here) & rows(about(np.zeros(3), seed=4))
    moved = particles_near(
        [CLASS], 3.0, 3, np.array([0.3, 7.0, 0.0]), [np.array([0.3, 7.0, 0.0])], (0.0, 1.5, np.inf), [0.0]
    )
    np.testing.assert_allclose(moved[0] - [0.3, 7.0, 0.0], here[0], atol=1e-13)  # roundings of 7 m


# --- drift ---------------------------------------------------------------------------------------------------------


def test_a_wave_turns_particles_in_circles_once_a_period() -> None:
    sea = GerstnerSea.from_waves([2.0 * np.pi / 4.0, 0.0], 0.1, 0.4, 0.7, tile_m=4.0)
    waves = orbiting_waves(sea, 0.0)
    assert waves is not None
    omega = float(sea.waves.angular_frequency[0])
    mean = np.array([[0.3, -1.0, 5.0]])
    still = np.zeros((1, 3))

    def moved(time_s: float, at: Any, carried: Any) -> Any:
        return offsets_in_waves(waves, sea.water_depth_m, time_s, at, -at[:, 1], carried)

    times = np.linspace(0.0, 2.0 * np.pi / omega, 9)
    offset, velocity = (np.concatenate(a) for a in zip(*(moved(t, mean, still) for t in times), strict=True))
    radius = 0.1 * np.exp(-2.0 * np.pi / 4.0)
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), radius, rtol=FLOAT64)
    np.testing.assert_allclose(offset[-1], offset[0], atol=FLOAT64)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=-1), radius * omega, rtol=FLOAT64)
    step = 1e-6
    near = [moved(1.0 + s, mean + s * np.array([0.2, 0.0, 0.0]), still)[0] for s in (-step, step)]
    rate = moved(1.0, mean, np.array([[0.2, 0.0, 0.0]]))[1]
    np.testing.assert_allclose((near[1] - near[0]) / (2.0 * step), rate, atol=1e-9)  # differences over 2e-6 s


@pytest.mark.parametrize("sea", [SEA, SpectralSea(resolution=8, seed=2)], ids=["gerstner", "spectral"])
def test_a_particle_at_the_surface_rises_with_it(sea: Any) -> None:
    waves = orbiting_waves(sea, 0.0)
    assert waves is not None
    place = np.array([[0.4, 0.0, -1.3], [2.0, 0.0, 5.0]])
    offset, _ = offsets_in_waves(waves, sea.water_depth_m, 2.5, place, -place[:, 1], np.zeros((2, 3)))
    left_out = 60 * 2e-5  # waves of smaller orbits
    np.testing.assert_allclose(offset[:, 1], sea.fields_at(place[:, 0], place[:, 2], 2.5).height, atol=left_out)


def test_orbits_end_at_the_bottom() -> None:
    sea = GerstnerSea.from_waves([2.0 * np.pi / 4.0, 0.0], 0.1, 0.4, 0.7, tile_m=4.0, water_depth_m=1.0)
    waves = orbiting_waves(sea, 0.0)
    assert waves is not None
    offset, _ = offsets_in_waves(waves, 1.0, 1.0, np.array([[0.3, -1.0, 5.0]]), np.ones(1), np.zeros((1, 3)))
    assert abs(offset[0, 1]) < FLOAT64
    k = np.pi / 2.0
    assert 1e-3 < abs(offset[0, 0]) <= 0.1 / np.sinh(k)


# --- pictures ------------------------------------------------------------------------------------------------------

SIZE = 48


def picture(start: Floats, end: Floats, radius: float, omega: float) -> tuple[Floats, Floats]:
    view, n = View(2 * SIZE, SIZE), len(start)
    before, behind = empty_picture(view), empty_picture(view)
    far = np.full((SIZE, 2 * SIZE), np.inf, np.float32)
    draw_particles(
        (start, end), np.full(n, radius), np.full(n, omega), np.ones(n), np.ones((n, 3)), far, before, behind,
    )  # fmt: skip
    return before


PLACES = {
    "middle": ([25.3, 20.7], [25.3, 20.7], 0.0), "pole": ([10.0, 0.2], [10.0, 0.2], 0.02),
    "on the pole": ([0.0, 0.0], [0.0, 0.0], 0.0), "seam": ([95.9, 30.0], [95.9, 30.0], 0.08),
    "over the pole": ([5.0, 2.0], [52.0, 3.0], 0.01), "over the seam": ([95.0, 15.0], [3.0, 17.0], 0.0),
    "wide": ([15.0, 25.0], [15.0, 25.0], 0.9), "far turn": ([15.0, 25.0], [35.0, 22.0], 0.02),
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_blur_keeps_a_particle_s_light_and_draws_it_where_it_was(place: str) -> None:
    first, last, radius = PLACES[place]
    start, end = (direction_from_frame([p[0]], [p[1]], 2 * SIZE, SIZE) for p in (first, last))
    radiance, alpha = picture(start, end, radius, 1e-4)
    weight = row_solid_angle(2 * SIZE, SIZE)[:, None]
    assert float(np.sum(alpha * weight)) == pytest.approx(1e-4, rel=SNOW_FLOAT32)
    np.testing.assert_array_equal(radiance, np.repeat(alpha[..., None], 3, axis=-1))
    # the same from all pixels of the frame, and many points of the arc
    t = np.linspace(0.0, 1.0, 501)[:, None]
    arc = unit(start + t * (end - start))
    pixels = directions(2 * SIZE, SIZE)
    nearest = np.sqrt(np.maximum(2.0 - 2.0 * np.max(pixels @ arc.T, axis=-1), 0.0))
    pixel = np.pi / SIZE
    share = np.clip((max(radius, LEAST_RADIUS * pixel) + 0.5 * pixel - nearest) / pixel, 0.0, 1.0)
    expected = 1e-4 * share / np.sum(share * weight)
    np.testing.assert_allclose(alpha, expected, atol=1e-3 * expected.max())  # points of the arc, 3 mrad apart


def test_a_turn_by_columns_rolls_the_picture_and_poles_mirror_each_other() -> None:
    rng = np.random.default_rng(5)
    start = unit(rng.normal(size=(200, 3)))
    start[:40, 1] = 20.0 * np.sign(start[:40, 1])  # near the poles
    start = unit(start)
    end = unit(start + 0.03 * rng.normal(size=(200, 3)))
    found = picture(start, end, 0.02, 1e-4)[1]
    turn = yaw_matrix(2.0 * np.pi * 7.0 / (2 * SIZE)).T
    np.testing.assert_allclose(picture(start @ turn, end @ turn, 0.02, 1e-4)[1], np.roll(found, 7, 1), atol=ROLLED)
    over_end = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(picture(start * over_end, end * over_end, 0.02, 1e-4)[1], found[::-1], atol=ROLLED)


def test_bodies_hide_what_is_behind_them_and_let_through_what_they_do_not_cover() -> None:
    view = View(2 * SIZE, SIZE)
    tile = empty_tile(Rectangle(40, 15, 20, 20))
    tile.alpha[...], tile.radiance[...], tile.distance_m[...] = 0.25, 0.1, 2.0
    layer = Layer(SIZE, 2 * SIZE, (tile,))
    before, behind = empty_picture(view), empty_picture(view)
    at = direction_from_frame(np.array([45.0, 55.0, 10.0]), np.array([25.0, 25.0, 25.0]), 2 * SIZE, SIZE)
    pixel = float(row_solid_angle(2 * SIZE, SIZE)[25])
    draw_particles(
        (at, at), np.full(3, 0.1), np.full(3, 5.0 * pixel), np.array([1.0, 3.0, 3.0]), np.ones((3, 3)),
        layer.distance_m, before, behind,
    )  # fmt: skip
    w = float(before[1][25, 45])
    assert w > 0.1
    shot = Shot(view, (), scenes.environment())
    result = merged(shot, layer, before, behind, Cache())
    alpha, radiance = result.alpha, result.radiance[..., 0]
    close = {"rel": SNOW_FLOAT32}
    assert float(alpha[25, 45]) == pytest.approx(w + (1.0 - w) * 0.25, **close)
    assert float(radiance[25, 45]) == pytest.approx(w + (1.0 - w) * 0.1, **close)
    assert float(alpha[25, 55]) == pytest.approx(0.25 + 0.75 * w, **close)
    assert float(radiance[25, 55]) == pytest.approx(0.1 + 0.75 * w, **close)
    assert float(alpha[25, 10]) == pytest.approx(w, **close)
    assert float(alpha[5, 5]) == 0.0
    hidden = merged(replace(shot, holdout=np.ones((SIZE, 2 * SIZE))), layer, before, behind, Cache())
    np.testing.assert_array_equal(hidden.alpha, layer.alpha)


def test_the_rest_of_a_frame_is_covered_once() -> None:
    parts = [Rectangle(3, 2, 5, 4), Rectangle(8, 2, 2, 9), Rectangle(0, 7, 4, 3), Rectangle(18, 0, 2, 12)]
    count = np.zeros((12, 20), int)
    for column, row, width, height in [*parts, *rest_of(parts, 20, 12)]:
        count[row : row + height, column : column + width] += 1
    np.testing.assert_array_equal(count, 1)
    assert rest_of([Rectangle(0, 0, 20, 12)], 20, 12) == []


# --- light ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", ["grain", "isotropic", "petzold"])
def test_phase_functions_scatter_all_light(phase: Any) -> None:
    theta = np.linspace(0.0, np.pi, 200001)
    whole = np.trapezoid(2.0 * np.pi * np.sin(theta) * particle_phase(phase, np.cos(theta)), theta)
    assert whole == pytest.approx(1.0, rel=2e-3 if phase == "petzold" else BALL_PHASE)  # petzold's peak is narrow


def big_snow(view: View, **changes: Any) -> Snow:
    """Return particles of centimetres, which a small frame resolves; 9000 of them, under a sea without waves."""
    table = {
        "amount": 1.0,
        "sizes_mm": (20.0, 40.0),
        "range_m": 1.5,
        "exponent": 3.0,
    }
    settings = SnowSettings(**(table | {"albedo": 0.7, "phase": "isotropic", "current_m_s": (0.0, 0.4, 0.0)} | changes))
    scattering = 700.0 / number_between(0.02, 0.04, settings.exponent, 1.0)
    return Snow(settings, scattering, GerstnerSea(wind_speed=0.0), 0.0, 0.0, view, view)


def test_the_mean_of_a_cloud_is_the_integral_of_single_scattering() -> None:
    """Of a Poisson cloud each pixel's mean transmittance is exp(-tau), whatever shape the particles are drawn with."""
    view = View(128, 64)
    sun = Sun(unit([0.3, 0.8, -0.4]), np.array([3.0, 2.0, 1.0]), 0.005, 1.0)
    dark = scenes.environment(0.0)
    shot = Shot(view, (), dark, lights=(sun,))
    snow = big_snow(view)
    layer = with_particles(snow, shot, Layer(64, 128, ()), None, Cache())[0]
    d, s = np.linspace(0.02, 0.04, 201), np.linspace(NEAREST_M, 1.5, 1301)
    number = 700.0 * d**-3.0 / np.trapezoid(d**-3.0, d)
    section = 0.25 * np.pi * d**2
    cover = section[:, None] / s**2 / (np.pi / 64) ** 2
    t = [np.clip(x, 0.0, 1.0) for x in ((s / NEAREST_M - 1.0) / 0.25, cover * 40.0 - 1.0, (s / 1.5 - 0.8) / 0.2)]
    near, large, far = (x * x * (3.0 - 2.0 * x) for x in t)
    fade = near * large * (1.0 - far)
    tau = np.trapezoid(np.trapezoid((number * section)[:, None] * fade, d, axis=0), s)
    squared = (number * section**2)[:, None] * fade**2 / (4.0 * np.pi * s**2)
    error = np.sqrt(np.trapezoid(np.trapezoid(squared, d, axis=0), s)) * np.exp(-tau)
    weight = row_solid_angle(128, 64)[:, None] / (4.0 * np.pi)
    expected = -np.expm1(-tau)
    assert 0.2 < expected < 0.9
    assert error < 0.02
    assert abs(float(np.sum(layer.alpha * weight)) - expected) < POISSON_DEVIATIONS * error
    mean = np.sum(layer.radiance * weight[..., None], axis=(0, 1))
    single = 0.7 / (4.0 * np.pi) * sun.irradiance
    np.testing.assert_allclose(mean, single * float(np.sum(layer.alpha * weight)), rtol=SNOW_FLOAT32)


def test_the_parts_of_a_layer_with_snow_add_up_to_its_light() -> None:
    body = scenes.placed(scenes.sphere(), (0.1, 0.2, -0.9))
    shot = scenes.shot(body, width=64, medium=scenes.medium())
    bare, variables = render_aovs(shot)
    layer, parts = with_particles(big_snow(shot.view), shot, bare, variables, Cache())
    assert parts is not None
    lights = ("diffuse", "glossy", "sun", "lamps", "emission", "veil", "shafts", "snow")
    total = sum(getattr(parts, name) for name in lights)
    np.testing.assert_allclose(total, layer.radiance, atol=1e-6)  # float32 sums of light below 1
    assert np.any(parts.snow[bare.alpha == 1.0] > 0.0)  # before the body
    assert np.any(parts.diffuse < 0.9 * variables.diffuse)  # which the snow hides in part
    np.testing.assert_array_equal(parts.object_id, variables.object_id)


@pytest.mark.parametrize("phase", ["grain", "isotropic", "petzold"])
def test_white_particles_vanish_in_even_light(phase: str) -> None:
    view = View(64, 32)
    shot = Shot(view, (), scenes.environment(0.3))
    layer = with_particles(big_snow(view, albedo=1.0, phase=phase), shot, Layer(32, 64, ()), None, Cache())[0]
    assert layer.alpha.mean() > 0.1
    plate = np.full((32, 64, 3), 0.3, np.float32)
    np.testing.assert_allclose(over(plate, layer), plate, rtol=PHASE_MAP)


def test_particles_are_seen_through_the_water() -> None:
    medium, view = scenes.medium(), View(64, 32)
    shot = Shot(view, (), scenes.environment(0.3), medium=medium)
    point = np.array([[0.5, 0.7, -1.0], [-2.0, -1.0, 0.3], [0.01, 0.0, 0.2]])
    distance, up = np.linalg.norm(point, axis=-1), point[:, 1] / np.linalg.norm(point, axis=-1)
    expected = transmittance_lookup(medium, distance, up) * 0.6 * 0.3 * ambient_ratio(medium, 5.0 - point[:, 1])
    found = particle_radiance(shot, 0.6, "isotropic", point, Cache())
    np.testing.assert_allclose(found, expected + veil_lookup(medium, distance, up), rtol=SPECKLED_SUN)


def test_particles_in_a_body_s_shadow_get_no_sun_and_lamps_light_them() -> None:
    ball = scenes.placed(scenes.sphere(), (0.0, 1.0, -2.0))
    sun = Sun(np.array([0.0, 1.0, 0.0]), np.ones(3), 0.004, 1.0)
    shot = Shot(View(64, 32), (ball,), scenes.environment(0.0), lights=(sun,))
    point = np.array([[0.0, -0.5, -2.0], [1.5, -0.5, -2.0], [0.0, 2.0, -2.0]])
    found = particle_radiance(shot, 1.0, "isotropic", point, Cache())[:, 0]
    np.testing.assert_allclose(found, np.array([0.0, 1.0, 1.0]) / (4.0 * np.pi), atol=FLOAT64)
    lamp = Lamp(np.array([0.0, 3.0, -2.0]), np.array([0.0, -1.0, 0.0]), np.full(3, 2.0))
    lit = particle_radiance(replace(shot, lights=(lamp,)), 1.0, "isotropic", point, Cache())[:, 0]
    away = np.linalg.norm(point - lamp.position, axis=-1)
    expected = lamp.intensity[0] / away**2 / (4.0 * np.pi) * np.array([0.0, 1.0, 1.0])
    np.testing.assert_allclose(lit, expected, rtol=FLOAT64, atol=FLOAT64)


PHASES: list[Any] = [("hg", 0.7), "petzold", "grain"]  # forwards, forwards, back


@pytest.mark.parametrize("phase", PHASES, ids=str)
def test_the_sun_turns_by_the_angle_between_its_ray_and_the_way_to_the_camera(phase: Any) -> None:
    """Seen towards the sun light goes straight on, away from it it turns round."""
    sun = Sun(unit([0.6, 0.8, 0.0]), np.full(3, 2.0), 0.004, 1.0)
    angles = np.radians([10.0, 60.0, 120.0, 175.0])  # of the particles from the sun, as the camera sees them
    across = np.array([0.8, -0.6, 0.0])
    direction = np.cos(angles)[:, None] * sun.direction + np.sin(angles)[:, None] * across
    shot = Shot(View(64, 32), (), scenes.environment(0.0), lights=(sun,))
    found = particle_radiance(shot, 0.5, phase, 0.7 * direction, Cache())
    after, before = -direction, -sun.direction  # directions of travel
    expected = 0.5 * 2.0 * particle_phase(phase, after @ before)
    np.testing.assert_allclose(found, np.repeat(expected[:, None], 3, axis=1), rtol=FLOAT64)
    assert (found[0, 0] > 3.0 * found[-1, 0]) == (phase != "grain")
    assert (found[-1, 0] > 3.0 * found[0, 0]) == (phase == "grain")


@pytest.mark.parametrize("phase", PHASES, ids=str)
def test_a_lamp_behind_particles_is_scattered_forwards_and_one_beside_the_camera_back(phase: Any) -> None:
    point = np.array([[0.0, 0.0, -2.0]])
    shot = Shot(View(64, 32), (), scenes.environment(0.0))

    def lit_from(z: float) -> float:
        lamp = Lamp(np.array([0.0, 0.0, z]), np.array([0.0, 0.0, -1.0 if z > -2.0 else 1.0]), np.full(3, 4.0))
        return float(particle_radiance(replace(shot, lights=(lamp,)), 0.5, phase, point, Cache())[0, 0])

    forwards, back = lit_from(-4.0), lit_from(0.0)  # both 2 m away from it
    straight_on, round_about = particle_phase(phase, np.array([1.0, -1.0]))
    assert forwards == pytest.approx(0.5 * straight_on, rel=FLOAT64)
    assert back == pytest.approx(0.5 * round_about, rel=FLOAT64)
    assert (forwards > 3.0 * back, back > 3.0 * forwards) == (phase != "grain", phase == "grain")


def test_nothing_is_drawn_behind_the_plate_s_surfaces_or_above_the_water() -> None:
    view = View(64, 32, surface_y_m=0.4)
    shot = Shot(view, (), scenes.environment(0.3), receiver=Receiver(plane_y=-0.3))
    alpha = with_particles(big_snow(view), shot, Layer(32, 64, ()), None, Cache())[0].alpha
    free = with_particles(big_snow(view), replace(shot, receiver=None), Layer(32, 64, ()), None, Cache())[0].alpha
    assert 0.0 < alpha[28:].mean() < free[28:].mean()
    np.testing.assert_array_equal(alpha[:16], free[:16])
    position = particles_in_view(big_snow(view), shot)[0]
    assert position[:, 1].max() < 0.4
    near = replace(shot, receiver=None, holdout_distance_m=np.full((32, 64), NEAREST_M))
    assert with_particles(big_snow(view), near, Layer(32, 64, ()), None, Cache())[0].tiles == ()
