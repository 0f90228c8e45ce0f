# SPDX-License-Identifier: Apache-2.0
"""Blur of bodies by the water: light that is kept, photons, poles and seam, limits.

Against path tracing: test_lit_dives.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.base.sphere import direction_from_frame, directions, row_solid_angle
from mr360uw.composite.tiles import empty_tile, over
from mr360uw.composite.water_blur import with_blur
from mr360uw.medium import Medium, Water
from mr360uw.medium.phase import forward_cone
from mr360uw.medium.scattered_light import image_spread
from mr360uw.types import Layer, Rectangle
from tests.composite import tolerances as tol
from tests.composite.scenes import environment, shot

WIDTH, HEIGHT = 480, 240
PLATE = 0.1
"""Radiance of the plate, the same everywhere."""
DISTANCE_M = 3.0


@pytest.fixture(scope="module")
def harbour() -> Medium:
    return Medium(Water.jerlov("5C").with_phase(("hg", 0.9)), camera_depth_m=5.0)


def blurred(medium: Medium, light: float, row: float, column: float, radius_rad: float, metres: float) -> Layer:
    """Return the layer of a round body of a radiance at a place in the frame, as a water blurs it."""
    view, middle = directions(WIDTH, HEIGHT), direction_from_frame(column, row, WIDTH, HEIGHT)
    body = view @ middle > np.cos(radius_rad)
    tile = empty_tile(Rectangle(0, 0, WIDTH, HEIGHT))
    tile.alpha[body], tile.radiance[body], tile.distance_m[body] = 1.0, light, metres
    layer, spread = Layer(HEIGHT, WIDTH, (tile,)), image_spread(medium)
    assert spread is not None
    scene = shot(width=WIDTH, environment=environment(PLATE), medium=medium.unit_table)
    return with_blur(scene, spread, layer, None, Cache())[0]


def change_of(layer: Layer) -> np.ndarray:
    """Return what a layer changes of the plate (H, W, 3), float64."""
    return over(np.full((HEIGHT, WIDTH, 3), PLATE, np.float32), layer).astype(np.float64) - PLATE


@pytest.mark.parametrize(("row", "column"), [(118.5, 240.0), (131.0, 0.5), (20.0, 100.0), (238.0, 300.0)])
def test_light_of_bodies_is_spread_and_not_lost(harbour: Medium, row: float, column: float) -> None:
    """At the horizon, over the seam, and close to either pole. kept: what extinction counts as lost comes back."""
    light = 100.0  # so bright that what is left out for its faintness does not count
    solid = np.broadcast_to(row_solid_angle(WIDTH, HEIGHT)[:, None], (HEIGHT, WIDTH))
    view, middle = directions(WIDTH, HEIGHT), direction_from_frame(column, row, WIDTH, HEIGHT)
    body = np.sum(solid[view @ middle > np.cos(0.1)])
    spread = image_spread(harbour)
    assert spread is not None
    found = np.einsum("hwc,hw->c", change_of(blurred(harbour, light, row, column, 0.1, DISTANCE_M)), solid)
    np.testing.assert_allclose(found, (light - PLATE) * body * np.exp(spread.kept * DISTANCE_M), rtol=tol.BLUR_ENERGY)


def test_light_arrives_where_photons_do(harbour: Medium, rng: np.random.Generator) -> None:
    """Light of a small body within angles of its middle, over all of it: photons turn at random places of the way."""
    radius, count, spread = 0.02, 200_000, image_spread(harbour)
    assert spread is not None
    tau = float(spread.scattering[1]) * DISTANCE_M
    theta, share, _ = forward_cone(harbour.water.phase)
    turns = rng.poisson(tau, count)
    offset = radius * np.sqrt(rng.uniform(size=count)) * np.exp(2j * np.pi * rng.uniform(size=count))
    for turn in range(int(turns.max())):
        angle = rng.choice(theta, count, p=share) * np.exp(2j * np.pi * rng.uniform(size=count))
        offset += np.where(turns > turn, angle * rng.uniform(0.0, 1.0, count), 0.0)
    light = change_of(blurred(harbour, 100.0, 120.0, 240.0, radius, DISTANCE_M))[..., 1]
    light *= row_solid_angle(WIDTH, HEIGHT)[:, None]
    away = np.arccos(np.clip(directions(WIDTH, HEIGHT) @ direction_from_frame(240.0, 120.0, WIDTH, HEIGHT), -1.0, 1.0))
    for angle in (0.05, 0.1, 0.2, 0.4):
        found, photons = light[away < angle].sum() / light.sum(), np.mean(np.abs(offset) < angle)
        assert found == pytest.approx(photons, abs=tol.BLUR_PHOTONS), angle


def test_a_body_like_the_water_does_not_show(harbour: Medium) -> None:
    np.testing.assert_allclose(change_of(blurred(harbour, PLATE, 120.0, 200.0, 0.2, 2.0)), 0.0, atol=tol.FLOAT32)


def test_marks_on_a_body_lose_contrast_with_distance_and_none_is_drawn_out_of_sight(harbour: Medium) -> None:
    contrast = [change_of(blurred(harbour, 0.2, 120.0, 240.0, 0.1, m))[120, 240, 1] for m in (0.1, 1.0, 3.0)]
    assert contrast[0] > contrast[1] > contrast[2] > 0.0
    far = change_of(blurred(harbour, 0.2, 120.0, 240.0, 0.1, 60.0))
    np.testing.assert_array_equal(np.unique(far), np.unique(np.float32([PLATE, 0.2]).astype(np.float64) - PLATE))


def test_a_dark_body_before_bright_water_takes_no_more_than_the_plate_shows(harbour: Medium) -> None:
    layer = blurred(harbour, 0.0, 60.0, 240.0, 0.3, DISTANCE_M)
    assert min(float(tile.radiance.min()) for tile in layer.tiles) >= 0.0
    change, solid = change_of(layer), row_solid_angle(WIDTH, HEIGHT)[:, None]
    assert change.min() >= -PLATE
    body = directions(WIDTH, HEIGHT) @ direction_from_frame(240.0, 60.0, WIDTH, HEIGHT) > np.cos(0.3)
    assert np.all(np.einsum("hwc,hw->c", change, solid * np.ones(WIDTH)) >= -PLATE * np.sum(solid * body))


def test_water_without_light_turned_by_small_angles_does_not_blur() -> None:
    assert image_spread(Medium(Water.pure())) is None
    assert image_spread(Medium(Water.jerlov("IB"), mode="kd")) is None
