# SPDX-License-Identifier: Apache-2.0
"""Pictures of the sea on OpenGL against the reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from mr360uw.caustics import CausticSettings, GerstnerSea
from mr360uw.errors import GlError, ParameterError
from mr360uw.medium import Water
from mr360uw.sphere import direction_from_angles, directions
from mr360uw.surface.gl.facet_table import QUANTILES, seen_slopes
from mr360uw.surface.gl.ray_tiles import split_frame
from mr360uw.surface.gl.stage_textures import light_patterns, sky_atlas
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import Floor, FloorLight, Tiled
from mr360uw.surface.sea_picture import SurfacePicture
from mr360uw.surface.sea_scene import SeaScene
from mr360uw.surface.sky import Dome
from mr360uw.surface.slopes import FARTHEST
from mr360uw.surface.tracing.facet_draws import seen_below
from mr360uw.types import Sun, View
from tests.surface import tolerances as tol

SKY = (1.0 + np.maximum(directions(32, 16)[..., 1:2], 0.0)) * np.array([0.8, 1.0, 1.3])
SUN = Sun(direction_from_angles(0.4, np.radians(50.0)), np.array([4.0, 5.0, 6.0]), 0.00465, 1.0)
WAVES = GerstnerSea(wind_speed=6.0)
RIPPLED = GerstnerSea.from_waves(
    [[np.pi / 2.0, 0.0], [0.0, np.pi]], [0.06, 0.03], 0.8, 0.5, tile_m=8.0, detail_slope=0.1, detail_kind="ripples"
)
FEW = CausticSettings(size=64, grid=64)


def sand() -> Floor:
    return Floor(-5.0, np.random.default_rng(1).uniform(0.1, 0.6, (16, 16, 3)), 4.0)


def at(y: float, **more: Any) -> View:
    return View(48, 24, np.array([0.3, y, 0.2]), surface_y_m=0.0, **more)


def decibels(picture: SurfacePicture, truth: SurfacePicture) -> float:
    """Return the peak signal to noise ratio; the peak is the 99.5th percentile of the truth."""
    off = np.sqrt(np.mean((picture.radiance - truth.radiance) ** 2))
    return float(20.0 * np.log10(np.percentile(truth.radiance, 99.5) / off))


@pytest.fixture(scope="module")
def murky() -> SeaScene:
    return SeaScene(WAVES, SKY, sand(), Water.jerlov("IB"), sun=SUN, caustics=FEW)


@pytest.fixture(scope="module")
def clear() -> SeaScene:
    return SeaScene(RIPPLED, SKY, (-5.0, 0.3), sun=SUN, caustics=FEW)


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(("scene", "y", "samples"), [("murky", -2.0, 2), ("clear", 2.5, 1)])
def test_it_is_the_picture_of_the_reference(scene: str, y: float, samples: int, request: pytest.FixtureRequest) -> None:
    sea: SeaScene = request.getfixturevalue(scene)
    got = sea.picture(at(y), 0.3, samples=samples, backend="gl")
    truth = sea.picture(at(y), 0.3, samples=samples)
    assert got.camera_in_water == truth.camera_in_water == (y < 0.0)
    assert decibels(got, truth) > tol.GL_DECIBELS
    assert np.mean((got.surface != truth.surface) | (got.floor != truth.floor)) <= tol.GL_OTHER_HIT
    for length in ("distance_m", "in_water_m"):
        a, b = getattr(got, length), getattr(truth, length)
        far = ~np.isclose(a, b, rtol=tol.GL_LENGTH, atol=tol.GL_LENGTH)
        assert np.mean(far) <= tol.GL_OTHER_HIT, length
    off = np.linalg.norm(got.normal - truth.normal, axis=-1)
    assert np.quantile(off, 0.99) < tol.GL_NORMAL


@pytest.mark.usefixtures("gl")
def test_a_frame_of_a_film_is_the_frame_alone(murky: SeaScene) -> None:
    from mr360uw.surface.gl.picture_renderer import PictureRenderer

    film, alone = PictureRenderer(), PictureRenderer()
    frames = [film.render(murky.stage(at(-2.0), time, 4), at(-2.0), 2) for time in (0.0, 0.3)]
    again = alone.render(murky.stage(at(-2.0), 0.3, 4), at(-2.0), 2)
    np.testing.assert_array_equal(frames[1].radiance, again.radiance)
    assert not np.array_equal(frames[0].radiance, again.radiance)


@pytest.mark.usefixtures("gl")
def test_heights_over_places() -> None:
    from mr360uw.surface.gl.height_atlas import HeightAtlas

    sea = SampledSea.of(WAVES, 0.3)
    texture = HeightAtlas().of(sea)["heights"]
    image = np.frombuffer(texture.read(), np.float32).reshape(texture.height, texture.width, 4)
    row, column = np.random.default_rng(2).integers(0, sea.size[0], (2, 200))
    x, z = column * sea.step_m, row * sea.step_m
    np.testing.assert_allclose(image[row + 1, column + 1, 0], sea.heights(x, z), atol=tol.GL_HEIGHT_M)
    e = 0.01 * sea.step_m
    slope = (sea.heights(x + e, z) - sea.heights(x - e, z)) / (2.0 * e)
    np.testing.assert_allclose(image[row + 1, column + 1, 1], slope, atol=tol.GL_SLOPE)
    n = int(sea.size[0])
    np.testing.assert_allclose(image[1 : n + 1, 0], image[1 : n + 1, n], atol=tol.GL_HEIGHT_M)  # the other side


@pytest.mark.usefixtures("gl")
def test_a_floor_with_relief_is_the_reference_s() -> None:
    floor = Floor(-5.0, 0.3, 8.0, relief=np.random.default_rng(3).uniform(0.0, 0.5, (8, 8)))
    sea = SeaScene(WAVES, SKY, floor, Water.jerlov("IB"), caustics=FEW)
    view = View(8, 4, np.array([0.3, -2.0, 0.2]), surface_y_m=0.0)
    with pytest.raises(GlError, match="level floors alone"):
        sea.picture(view, samples=1, backend="gl")
    auto, truth = (sea.picture(view, samples=1, backend=name) for name in ("auto", "reference"))
    np.testing.assert_array_equal(auto.radiance, truth.radiance)


def test_unknown_backends(murky: SeaScene) -> None:
    with pytest.raises(ParameterError, match="backend - is not known"):
        murky.picture(at(-2.0), backend="vulkan")


def test_the_table_of_facets_inverts_their_shares(rng: np.random.Generator) -> None:
    """Up to a ray at 5.5 standard deviations behind the surface, where differences of areas still have six digits."""
    table = seen_slopes()
    rows, columns = table.shape[:2]
    row, k = rng.integers(1, rows - 4, 50), rng.integers(0, columns, 50)
    w = row / (rows - 1) * (1.0 + FARTHEST / (1.0 + FARTHEST)) - 1.0
    c, z = w / (1.0 - np.abs(w)), QUANTILES * (2.0 * k / (columns - 1) - 1.0)
    reached = [seen_below(z + t, -c, 1.0) for t, z, c in zip(table[row, k, 0], z, c, strict=True)]
    whole = [seen_below(FARTHEST, -c, 1.0) for c in c]
    np.testing.assert_allclose(np.divide(reached, whole), ndtr(z), atol=1e-5)
    assert np.all(np.isfinite(table))


def test_the_sky_closes_at_its_seam_and_over_its_poles(rng: np.random.Generator) -> None:
    dome = Dome(rng.uniform(0.0, 1.0, (16, 32, 3)))
    atlas = sky_atlas(dome.levels)
    level = dome.levels[0].astype(np.float32)
    np.testing.assert_array_equal(atlas[1:17, 0, :], level[:, -1])
    np.testing.assert_array_equal(atlas[1:17, 33, :], level[:, 0])
    np.testing.assert_array_equal(atlas[0, 1:33], np.roll(level[0], 16, axis=0))
    np.testing.assert_array_equal(atlas[19:27, 1:17], dome.levels[1].astype(np.float32))


def test_patterns_in_one_place_are_summed(rng: np.random.Generator) -> None:
    a, b, c = (Tiled.of(rng.uniform(0.0, 2.0, (8, 8, 3)), 8.0, place) for place in ((0.1, 0.2), (0.1, 0.2), (0.0, 0.0)))
    light = FloorLight(np.ones(3), ((a, np.full(3, 2.0)), (b, np.ones(3)), (c, np.ones(3))), np.ones(3), np.zeros(3))
    sums = light_patterns(light)
    assert [s.origin for s in sums] == [(0.1, 0.2), (0.0, 0.0)]
    x, z, wide = rng.uniform(-20.0, 20.0, (3, 40))
    total = light.even + sum(s.at(x, z, np.abs(wide)) for s in sums)
    np.testing.assert_allclose(total, light.irradiance(x, z, np.abs(wide)), rtol=1e-5)


@pytest.mark.parametrize("y", [-2.0, 2.5, 0.0])
@pytest.mark.parametrize("turned", [0.0, 0.6])
def test_the_parts_of_a_frame_cover_it_once(murky: SeaScene, y: float, turned: float) -> None:
    c, s = np.cos(turned), np.sin(turned)
    view = View(200, 100, np.array([0.3, y, 0.2]), np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), 0.0)
    stage = murky.stage(view, 0.3, 1)
    free, others = split_frame(stage, view)
    count = np.zeros((100, 200), int)
    for part in free + others:
        count[part.row : part.row + part.height, part.column : part.column + part.width] += 1
    assert np.all(count == 1)
    up = view.directions(*np.meshgrid(np.arange(200) + 0.5, np.arange(100) + 0.5))[..., 1]
    for part in free:
        seen = up[part.row : part.row + part.height, part.column : part.column + part.width]
        assert np.all(seen < 0.0) if stage.camera_in_water else np.all(seen > 0.0)
    assert bool(free) == (y != 0.0)
