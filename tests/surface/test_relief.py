# SPDX-License-Identifier: Apache-2.0
"""Uneven floors against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw import surface
from mr360uw.base.sphere import direction_from_angles, unit
from mr360uw.caustics import CausticSettings, GerstnerSea
from mr360uw.errors import ParameterError
from mr360uw.medium import Water
from mr360uw.surface.sea_floor import Floor, Relief, in_shadow, relief_distance
from mr360uw.types import Sun, View
from tests.surface import tolerances as tol

CALM = GerstnerSea.from_waves([[2.0 * np.pi / 8.0, 0.0]], 0.0, 0.0, 0.0, tile_m=8.0)
SKY = np.ones((16, 32, 3))
FEW = CausticSettings(size=16, grid=16)
SIZE, TILE = 32, 16.0
AT = (np.arange(SIZE) + 0.5) * TILE / SIZE
RIDGE = np.broadcast_to(np.maximum(1.0 - np.abs(AT - 8.25) / 2.0, 0.0), (SIZE, SIZE))
"""A ridge along z, 1 m high at x = 8.25 m, whose sides rise 1 in 2."""
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def relief_of(floor: Floor, y: float = 0.0) -> Relief:
    return Relief(floor.tile_m, y, floor.lowest_m - 1e-6, floor.highest_m, floor.steepest, floor.relief, floor.cells)


@pytest.mark.parametrize("slope", [-0.7, -1.0, -4.0])
def test_rays_meet_the_sides_of_a_ridge(slope: float) -> None:
    """From x = 5 m and y = 3 m towards +x: y = 3 + slope (x - 5) meets y = (x - 6.25)/2 or the foot."""
    floor = Floor(0.0, relief=RIDGE, tile_m=TILE)
    towards = unit([1.0, slope, 0.0])
    found = relief_distance(relief_of(floor), (5.0, 3.0, 5.0), tuple(towards), 1e3)
    x = (3.0 - 5.0 * slope + 3.125) / (0.5 - slope)
    x = x if x >= 6.25 else 5.0 - 3.0 / slope
    assert 5.0 + found * towards[0] == pytest.approx(x, abs=tol.ON_SURFACE_M)
    assert relief_distance(relief_of(floor), (5.0, 3.0, 5.0), (0.6, 0.8, 0.0), 1e3) == np.inf


@pytest.mark.parametrize("size", [33, 64])
def test_rays_meet_the_first_of_many_rocks(size: int, rng: np.random.Generator) -> None:
    """No place before the hit is below the floor, which the hit is on; rays steep to nearly level, also along axes."""
    floor = Floor(0.0, relief=np.maximum(rng.normal(-0.4, 0.5, (size, size)), 0.0), tile_m=TILE)
    relief, eye = relief_of(floor), np.array([3.0, 2.5, 1.0])
    for azimuth, slope in zip(np.linspace(0.0, 2.0 * np.pi, 33), np.tile([-0.03, -0.2, -2.0], 11), strict=True):
        towards = unit([np.cos(azimuth), slope, np.sin(azimuth)])
        found = relief_distance(relief, tuple(eye), tuple(towards), 1e3)
        path = eye + np.append(np.arange(0.0, found - 1e-3, 0.02), found)[:, None] * towards
        over = np.array([y - floor.height_at(x, z) for x, y, z in path])
        assert over[-1] == pytest.approx(0.0, abs=tol.ON_SURFACE_M)
        assert np.all(over[:-1] > 0.0)


@pytest.mark.parametrize("tangent", [3.0, 5.0])
def test_the_shadow_of_a_ridge_is_its_height_times_the_tangent(tangent: float) -> None:
    floor = Floor(0.0, relief=RIDGE, tile_m=TILE)
    to_sun = tuple(unit([-tangent, 1.0, 0.0]).tolist())
    x = np.linspace(8.4, 15.9, 151)
    dark = np.array([in_shadow(relief_of(floor), v, 3.0, to_sun) for v in x])
    end = 8.25 + tangent
    off = np.abs(x - end) > tol.SHADOW_STEP * tangent * TILE / SIZE
    np.testing.assert_array_equal(dark[off], (x < end)[off])
    assert not in_shadow(relief_of(floor), 8.0, 3.0, to_sun)  # the side towards the sun


@pytest.mark.parametrize("water", [None, "IB"])
def test_the_light_on_a_slope(water: str | None) -> None:
    """A sun alone over a black sky: the cosine on either side of the ridge over that of a level floor."""
    sun = Sun(direction_from_angles(np.pi / 2.0, np.radians(60.0)), np.full(3, 5.0), 0.00465, 1.0)
    wet = np.array([np.cos(np.radians(60.0)) / 1.34, 0.0, 0.0])
    wet[1] = np.sqrt(1.0 - wet[0] ** 2)
    view = View(128, 2, np.array([8.25, 3.0, 3.0]), DOWN, 4.0, "orthographic", width_m=15.9)
    x = 8.25 + 15.9 * ((np.arange(128) + 0.5) / 128.0 - 0.5)
    medium = None if water is None else Water.jerlov(water)
    uneven, level = (
        surface.SeaScene(
            CALM, 0.0 * SKY, Floor(0.0, 0.01, TILE, relief=heights), medium, sun=sun, caustics=FEW
        ).picture(view, samples=1)
        for heights in (RIDGE, 1e-6 * RIDGE)
    )  # fmt: skip
    np.testing.assert_allclose(uneven.distance_m[0], 3.0 - np.interp(x, AT, RIDGE[0]), atol=tol.ON_SURFACE_M)
    if medium is not None:
        assert np.all(uneven.radiance > 0.0)
        return
    ratio = uneven.radiance[0, :, 1] / level.radiance[0, :, 1]
    for side, inside in ((1.0, (x > 8.8) & (x < 9.7)), (-1.0, (x > 6.8) & (x < 7.7))):
        expected = (wet[1] + side * 0.5 * wet[0]) / np.hypot(1.0, 0.5) / wet[1]
        np.testing.assert_allclose(ratio[inside], expected, rtol=tol.EVEN_SKY)


def test_floors_that_cannot_be_are_refused() -> None:
    bad = {"relief": [np.zeros((3, 4)), 1.0], "tile_m": [np.zeros((4, 4)), None], "tile_m ": [RIDGE, -1.0]}
    for name, (relief, tile) in bad.items():
        with pytest.raises(ParameterError, match=rf"floor\.{name.strip()} - .*\(got .* - "):
            Floor(-3.0, 0.3, tile, relief=relief)
