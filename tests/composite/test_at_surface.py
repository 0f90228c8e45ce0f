# SPDX-License-Identifier: Apache-2.0
"""Bodies at the surface: images against closed forms on a level sea, the cut at the waterline, limits, floating."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.base.optics import fresnel
from mr360uw.base.sphere import direction_from_frame
from mr360uw.caustics.gerstner import GerstnerSea
from mr360uw.composite import surface_layer
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.motion import floating, plane_of_waves
from mr360uw.composite.reference import render_aovs, render_layer
from mr360uw.composite.settings import SurfaceSettings
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.composite.surface_layer import cut_at_surface, with_bodies
from mr360uw.composite.surface_rays import WaterSides, in_air
from mr360uw.composite.tiles import over
from mr360uw.medium.lookup import transmittance_lookup, veil_lookup
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.types import Layer, MediumTable
from tests.composite import scenes
from tests.composite import tolerances as tol

LEVEL = GerstnerSea.from_waves([[1.0, 0.0]], 0.0, 0.0, 0.0, detail_slope=0.0)
WAVES = GerstnerSea(wind_speed=4.0, wave_count=8, shortest_wavelength_m=0.8)
ALL = SurfaceSettings(objects="all")
DEEP_M = 4.0
GLOW = Material(base_color=(0.0, 0.0, 0.0, 1.0), emission=(0.5, 0.7, 0.9), roughness=1.0, refractive_index=1.0)
INDEX = 1.34


def water(depth_m: float = DEEP_M) -> MediumTable:
    return scenes.medium(depth_m, (0.2, 0.06, 0.04))


def shot_of(*objects: PlacedObject, **more: Any) -> Shot:
    table = more.pop("medium", None) or water()
    return scenes.shot(*objects, surface_y_m=DEEP_M, medium=table, sun=None, samples=17, **{"width": 256, **more})


def on(shot: Shot, sea: GerstnerSea = LEVEL, layer: Layer | None = None, **more: Any) -> Layer:
    settings = ALL.model_copy(update=more)
    bare = render_layer(shot) if layer is None else layer
    return with_bodies(shot, sea, 0.0, water(0.01), settings, bare, Cache())[0]


def images_alone(shot: Shot, sea: GerstnerSea = LEVEL) -> Layer:
    """Return the images without the bodies themselves."""
    empty = Layer(shot.view.height, shot.view.width, ())
    return on(shot, sea, empty)


def test_a_level_sea_mirrors_a_body_as_if_it_stood_above() -> None:
    ball = scenes.sphere(material=GLOW, radius=1.0)
    low, high = (scenes.placed(ball, (-2.0, y, -7.0)) for y in (2.8, 2.0 * DEEP_M - 2.8))
    image = images_alone(shot_of(low))
    there = render_layer(shot_of(high))
    np.testing.assert_allclose(image.alpha, there.alpha, atol=tol.SURFACE_EDGE)
    assert np.mean(np.abs(image.alpha - there.alpha)) < tol.SURFACE_MEAN
    rows, columns = np.nonzero(image.alpha > 0.999)
    assert len(rows) > 50
    direction = direction_from_frame(columns + 0.5, rows + 0.5, 256, 128)
    first = DEEP_M / direction[:, 1]
    further = there.distance_m[rows, columns] - first
    down = direction * [1.0, -1.0, 1.0]
    body = transmittance_lookup(water(0.01), further, down[:, 1]) * GLOW.emission
    body += veil_lookup(water(0.01), further, down[:, 1])
    expected = transmittance_lookup(water(), first, direction[:, 1]) * body + veil_lookup(
        water(), first, direction[:, 1]
    )
    np.testing.assert_allclose(image.radiance[rows, columns], expected, rtol=tol.SURFACE_RADIANCE)


def test_inside_the_window_the_mirror_image_is_as_strong_as_fresnel_says() -> None:
    image = images_alone(shot_of(scenes.placed(scenes.sphere(material=GLOW, radius=1.0), (0.0, 2.0, -1.0))))
    rows, columns = np.nonzero(image.alpha > 0.0)
    direction = direction_from_frame(columns + 0.5, rows + 0.5, 256, 128)
    reflected = fresnel(direction[:, 1], 1.0 / INDEX)
    whole = image.alpha[rows, columns] > 0.98 * reflected
    assert np.mean(whole) > 0.8  # the others are of its edge
    np.testing.assert_allclose(image.alpha[rows, columns][whole], reflected[whole], rtol=tol.SURFACE_RADIANCE)


def test_a_body_above_is_seen_where_snell_says_and_brighter_by_the_square_of_the_index() -> None:
    place = np.array([3.0, 2.0])  # across, above the surface
    ball = scenes.placed(scenes.sphere(rows=12, material=GLOW, radius=0.15), (0.0, DEEP_M + place[1], -place[0]))
    shot = shot_of(ball, width=384)
    image = on(shot)
    rows, columns = np.nonzero(image.alpha > 0.0)
    seen = image.alpha[rows, columns]
    row = np.average(rows + 0.5, weights=seen)
    elevation = math.pi * (0.5 - row / 192)
    # Snell's law by bisection of the place at which the ray meets the surface
    low, high = 0.0, place[0]
    for _ in range(60):
        x = 0.5 * (low + high)
        sine = INDEX * x / math.hypot(x, DEEP_M)
        low, high = (x, high) if x + place[1] * sine / math.sqrt(max(1.0 - sine * sine, 1e-12)) < place[0] else (low, x)
    assert abs(math.degrees(elevation - math.atan2(DEEP_M, x))) < tol.SURFACE_DEGREES
    up = math.sin(elevation)
    passed = 1.0 - float(fresnel(up, 1.0 / INDEX))
    middle = np.argmax(seen)
    assert seen[middle] == pytest.approx(passed, rel=tol.SURFACE_RADIANCE)
    far = np.array([DEEP_M / up])
    expected = veil_lookup(water(), far, up) + transmittance_lookup(water(), far, up) * INDEX**2 * np.array(
        GLOW.emission
    )
    np.testing.assert_allclose(
        image.radiance[rows[middle], columns[middle]] / seen[middle], expected[0], rtol=2.0 * tol.SURFACE_RADIANCE
    )


def test_a_body_is_cut_where_the_surface_is() -> None:
    wall = scenes.placed(scenes.box((1.0, 2.0, 0.2), GLOW), (0.0, DEEP_M, -8.0))
    shot = shot_of(wall, width=512)
    bare = render_layer(shot)
    column = 256
    cut = on(shot).alpha[:, column]
    row = 256 * (0.5 - math.atan2(DEEP_M, 7.9) / math.pi)  # of the waterline on the wall's face
    below = np.arange(256) > row
    np.testing.assert_array_equal(cut[below], bare.alpha[below, column])
    assert bare.alpha[: math.floor(row), column].sum() > 5.0
    assert cut[math.floor(row)] == pytest.approx(1.0, abs=tol.SURFACE_EDGE)  # no gap between the wall and its image
    above = images_alone(shot).alpha[: math.floor(row), column]
    np.testing.assert_allclose(cut[: math.floor(row)], above, atol=tol.HALF_FLOAT)


def test_bodies_are_hidden_behind_the_surface_and_seen_through_it_from_above() -> None:
    ball = scenes.placed(scenes.sphere(material=GLOW), (0.0, DEEP_M - 1.0, -3.0))
    shot = scenes.shot(
        ball, surface_y_m=DEEP_M, camera_position=np.array([0.0, DEEP_M + 2.0, 0.0]), sun=None, width=256, samples=17
    )
    wet = replace(shot, medium=water(0.01))
    sides = WaterSides(wet, shot, SampledSea.of(LEVEL, 0.0), water(0.01), False, INDEX)
    bare = render_layer(shot)
    image, _ = cut_at_surface(sides, ALL, bare, Cache())
    rows, columns = np.nonzero(image.alpha > 0.5)
    row = np.average(rows + 0.5, weights=image.alpha[rows, columns])
    # apparent depth: the place at which the ray that meets the ball's middle crosses the surface
    low, high = 0.0, 3.0
    for _ in range(60):
        x = 0.5 * (low + high)
        sine = x / math.hypot(x, 2.0) / INDEX
        low, high = (x, high) if x + sine / math.sqrt(1.0 - sine * sine) < 3.0 else (low, x)
    assert abs(math.degrees(math.pi * (row / 128 - 0.5) - math.atan2(2.0, x))) < 1.0
    cosine = 2.0 / math.hypot(x, 2.0)
    assert image.alpha.max() == pytest.approx(1.0 - float(fresnel(cosine, INDEX)), rel=0.02)


def test_in_a_furnace_nothing_is_seen() -> None:
    """All light 1 in clear water: white bodies, their images and what stands in the air have the plate's radiance."""
    white = Material(base_color=(1.0, 1.0, 1.0, 1.0), roughness=1.0, refractive_index=1.0)
    clear = scenes.medium(DEEP_M, (1e-9, 1e-9, 1e-9))
    clear = replace(clear, veil=np.zeros_like(clear.veil))
    objects = (
        scenes.placed(scenes.sphere(material=white), (-3.0, 3.2, -6.0)),
        scenes.placed(scenes.sphere(material=white), (0.5, DEEP_M + 0.6, -2.0)),
    )
    shot = shot_of(*objects, medium=clear, environment=scenes.environment(1.0), ambient_occlusion=False)
    surface = replace(clear, camera_depth_m=0.01)
    layer, _ = with_bodies(shot, WAVES, 0.0, surface, ALL, render_layer(shot), Cache())
    assert np.count_nonzero(layer.alpha) > np.count_nonzero(render_layer(shot).alpha)
    shown = over(np.ones((128, 256, 3), np.float32), layer)
    np.testing.assert_allclose(shown, 1.0, atol=tol.SURFACE_FURNACE)


def test_images_do_not_depend_on_what_is_kept_or_how_many_rays_are_traced_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shot = shot_of(scenes.placed(scenes.sphere(material=GLOW), (-1.0, 3.2, -5.0)), width=128)
    bare, cache = render_layer(shot), Cache()
    first = with_bodies(shot, WAVES, 0.3, water(0.01), ALL, bare, cache)[0]
    with_bodies(shot, WAVES, 0.7, water(0.01), ALL, bare, cache)
    again = with_bodies(shot, WAVES, 0.3, water(0.01), ALL, bare, cache)[0]
    monkeypatch.setattr(surface_layer, "_RAYS_AT_ONCE", 5000)
    other = with_bodies(shot, WAVES, 0.3, water(0.01), ALL, bare, Cache())[0]
    for name in ("radiance", "alpha", "distance_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
        np.testing.assert_array_equal(getattr(other, name), getattr(first, name))


def test_waves_move_the_image_and_blur_keeps_its_light() -> None:
    shot = shot_of(scenes.placed(scenes.sphere(material=GLOW), (-1.0, 3.0, -7.0)), width=128)
    bare = Layer(64, 128, ())
    level, early, late = (
        with_bodies(shot, sea, time_s, water(0.01), ALL, bare, Cache())[0].alpha.sum()
        for sea, time_s in ((LEVEL, 0.0), (WAVES, 0.0), (WAVES, 1.0))
    )
    assert early != late
    assert early == pytest.approx(level, rel=0.5)  # waves fold the image, but neither lose it nor multiply it


def test_bodies_that_are_not_near_leave_the_layer_as_it_is() -> None:
    shot = shot_of(scenes.placed(scenes.sphere(material=GLOW), (0.0, -2.0, -4.0)), width=64)
    bare = render_layer(shot)
    assert with_bodies(shot, WAVES, 0.0, water(0.01), SurfaceSettings(), bare, Cache()) == (bare, None)


def test_variables_are_cut_as_their_bodies_are() -> None:
    shot = shot_of(scenes.placed(scenes.box((1.0, 2.0, 0.2), GLOW), (0.0, DEEP_M, -5.0)), width=64)
    layer, variables = render_aovs(shot)
    _, kept = with_bodies(shot, LEVEL, 0.0, water(0.01), ALL, layer, Cache())
    assert kept is not None
    assert 0.0 < np.mean(kept[layer.alpha > 0.0]) < 1.0
    cut = variables.cut(kept)
    np.testing.assert_array_equal(cut.emission, variables.emission * kept[..., None])
    assert np.all(cut.object_id[kept == 0.0] == 0)
    assert np.all(cut.transmittance[kept == 0.0] == 1.0)
    np.testing.assert_array_equal(cut.position[kept == 1.0], variables.position[kept == 1.0])


def test_the_air_has_the_light_that_the_water_lets_through() -> None:
    """A sky of radiance L gives t n^2 L below; from that it is found again, with the sun's power per level area."""
    shot = shot_of()
    shot = replace(shot, lights=(scenes.SUN,))
    dry = in_air(shot)
    sun = dry.lights[0]
    n = shot.refractive_index
    assert np.linalg.norm(np.cross(sun.direction, [0, 1, 0])) == pytest.approx(
        n * np.linalg.norm(np.cross(scenes.SUN.direction, [0, 1, 0]))
    )
    assert dry.medium is None
    assert dry.caustics is None
    assert np.all(sun.irradiance > scenes.SUN.irradiance)


SMALL = GerstnerSea(wind_speed=5.0, detail_slope=0.0)


def test_a_floating_body_heaves_with_the_mean_of_the_surface_under_it() -> None:
    middle, sides = np.array([0.7, -3.0]), np.array([[1.5, 0.0], [0.0, 0.5]])
    height, slope = plane_of_waves(SMALL, middle, sides, 0.4)
    place = (np.arange(201) + 0.5) / 201 - 0.5
    u, v = np.meshgrid(place, place)
    x, z = middle[0] + 1.5 * u, middle[1] + 0.5 * v
    point = SMALL.surface(x, z, 0.4).position
    mean = np.mean(point[..., 1] - slope[0] * (point[..., 0] - middle[0]) - slope[1] * (point[..., 2] - middle[1]))
    crest = np.ptp(point[..., 1])
    assert abs(height - mean) < tol.FLOATING * crest


def test_a_small_body_leans_as_the_surface_under_it() -> None:
    swell = GerstnerSea.from_waves([[0.4, 0.3]], 0.3, 0.0, 0.0, tile_m=20.0, detail_slope=0.0)
    mesh = scenes.box((0.1, 0.1, 0.1))
    for time_s in (0.0, 0.7):
        pose = floating(swell, 2.0, scenes.placed(mesh, (1.0, 2.0, -4.0)).world_from_object, mesh, time_s)
        normal = swell.surface([1.0], [-4.0], time_s).normal[0]
        assert np.hypot(normal[0], normal[2]) > 100.0 * tol.LEANING
        np.testing.assert_allclose(pose[:3, 1], normal, atol=tol.LEANING)


def test_floating_is_level_on_a_level_sea_and_smooth_on_waves() -> None:
    mesh = scenes.box((0.6, 0.3, 2.0))
    calm = scenes.placed(mesh, (1.0, 2.1, -4.0), (30, 0, 0)).world_from_object
    np.testing.assert_allclose(floating(LEVEL, 2.0, calm, mesh, 3.0), calm, atol=1e-12)
    poses = np.array([floating(SMALL, 2.0, calm, mesh, t) for t in (1.0, 1.01, 1.02)])
    step, bend = np.abs(poses[1] - poses[0]).max(), np.abs(poses[2] - 2.0 * poses[1] + poses[0]).max()
    assert 0.0 < step < 0.02
    assert bend < 0.2 * step
    turn = poses[0][:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
