# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics go with the sun's light that bears them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw.composite import render_layer
from mr360uw.composite.light_sources import light_sources
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.receiver.ratio import ambient_share
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.composite.tiles import over
from mr360uw.medium.lookup import veil_lookup
from mr360uw.render.first_pass import BackgroundSeries, stands
from mr360uw.types import Floats, Rectangle
from mr360uw.video import VideoFrame
from tests.composite import tolerances as tol
from tests.composite.scenes import SUN, medium, placed, shot, sphere

WIDTH = 256
FLOOR = Receiver(plane_y=-1.2, extent_m=8.0, occlusion=False)


@dataclass(frozen=True)
class Still:
    """A linear picture as a plate."""

    image: Floats

    @property
    def shape(self) -> tuple[int, int]:
        return self.image.shape[0], self.image.shape[1]

    def linear(self, rectangle: Rectangle) -> Floats:
        rows = slice(rectangle.row, rectangle.row + rectangle.height)
        return self.image[rows, rectangle.column : rectangle.column + rectangle.width]

    def halved(self, rectangle: Rectangle) -> Floats:
        size = rectangle.width // 2, rectangle.height // 2
        return np.asarray(cv2.resize(self.linear(rectangle), size, interpolation=cv2.INTER_AREA))


def plate_of(scene: Shot, waves: Floats) -> tuple[Floats, Floats, Floats]:
    """Return a plate lit by sky and sun under waves (H, W), the same without caustics, and in ambient light alone."""
    height, width = waves.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    d = scene.view.directions(x, y)
    below = d[..., 1] < -0.1
    distance = np.where(below, -1.2 / np.minimum(d[..., 1], -0.1), 0.0)
    point = (d * distance[..., None])[below]
    share = np.ones((height, width, 3))
    share[below] = ambient_share(scene, light_sources(scene), point, np.tile([0.0, 1.0, 0.0], (len(point), 1)))
    veil = np.zeros((height, width, 3))
    if scene.medium is not None:
        veil = veil_lookup(scene.medium, distance, d[..., 1])
    sand = 0.3 * below[..., None]
    plates = (veil + sand * (share + (1.0 - share) * factor) for factor in (waves[..., None], 1.0, 0.0))
    shown, background, ambient = (image.astype(np.float32) for image in plates)
    return shown, background, ambient


@pytest.fixture(params=["reference", "gl"])
def render(request: pytest.FixtureRequest) -> Any:
    if request.param == "reference":
        return render_layer
    request.getfixturevalue("gl")
    from mr360uw.composite.gl.layer_renderer import LayerRenderer

    return LayerRenderer().render


@pytest.mark.parametrize("water", [None, medium()], ids=["air", "water"])
def test_no_filament_runs_through_an_umbra(render: Any, water: Any, rng: np.random.Generator) -> None:
    """In the umbra the ground has its ambient light alone, whatever the waves do; elsewhere the plate is untouched."""
    ball = placed(sphere(48, radius=0.4), (0.2, -0.7, -1.2))
    scene = shot(ball, width=WIDTH, medium=water, receiver=FLOOR, sun=replace(SUN, half_angle_rad=0.01))
    waves = rng.uniform(0.3, 2.5, (WIDTH // 2, WIDTH))
    shown, background, ambient = plate_of(scene, waves)
    layer = render(replace(scene, pattern=PlatePattern(Still(shown), background, 1.2, 1.0)))
    left = render(replace(scene, unseen=0.0))
    # footprints that lie in the umbra wholly: a hundredth of the sun's light would carry filaments
    umbra = (left.ratio[..., 1] < 1.002 * left.ratio[..., 1].min()) & (layer.alpha == 0.0)
    assert umbra.sum() > 50
    got = over(shown, layer)
    np.testing.assert_allclose(got[umbra], ambient[umbra], rtol=tol.PATTERN_UMBRA)
    contrast = [np.std(image[umbra][:, 1]) for image in (got, over(shown, left))]
    assert contrast[0] < 0.05 * contrast[1]
    free = (left.ratio == 1.0).all(axis=-1) & (layer.alpha == 0.0)
    assert np.array_equal(got[free], shown[free])


@pytest.mark.parametrize("water", [None, medium()], ids=["air", "water"])
def test_filaments_that_clip_keep_their_colour_in_half_shade(render: Any, water: Any, rng: np.random.Generator) -> None:
    """Blue is clipped where waves focus light, red is not: in the penumbra blue is left as it would be unclipped."""
    ball = placed(sphere(48, radius=0.4), (0.2, -0.4, -1.4))
    scene = shot(ball, width=WIDTH, medium=water, receiver=FLOOR, sun=replace(SUN, half_angle_rad=0.3), sun_samples=16)
    shown, background, _ = plate_of(scene, rng.uniform(0.3, 2.5, (WIDTH // 2, WIDTH)))
    white = float(np.quantile(shown[3 * WIDTH // 8 :, :, 2], 0.6))
    seen = shown.copy()
    seen[..., 2] = np.minimum(shown[..., 2], white)
    whole = over(shown, render(replace(scene, pattern=PlatePattern(Still(shown), background, 1.2, 1.0))))
    layer = render(replace(scene, pattern=PlatePattern(Still(seen), background, 1.2, 1.0, white)))
    got = over(seen, layer)
    lost = (shown[..., 2] > 1.1 * white) & (layer.alpha == 0.0) & (layer.ratio[..., 0] < 0.9)
    assert lost.sum() > 30
    wanted = np.minimum(whole[..., 2], white)[lost]
    off, without = (
        float(np.sqrt(np.mean((image[..., 2][lost] - wanted) ** 2)))
        for image in (got, over(seen, render(replace(scene, pattern=PlatePattern(Still(seen), background, 1.2, 1.0)))))
    )
    assert off < tol.PATTERN_CLIPPED < 0.6 * without
    free = (layer.ratio == 1.0).all(axis=-1) & (layer.alpha == 0.0)
    assert np.array_equal(got[free], seen[free])


def test_without_a_mean_detail_of_the_size_of_caustics_goes() -> None:
    """Filaments of 20 cm on the ground are smoothed, the brightness of the ground is kept; the seam is closed."""
    height, width = 128, 256
    y, x = np.mgrid[0:height, 0:width]
    sky = np.where(y < height / 2, 0.2, 0.4)[..., None] * np.ones(3)
    filaments = 1.0 + 0.5 * np.sin(2.0 * np.pi * x / 8.0)[..., None]
    plate = (sky * filaments).astype(np.float32)
    pattern = PlatePattern(Still(plate), None, 1.5, 1.0)
    part = Rectangle(40, 90, 60, 20)
    _, background = pattern.light(part)
    assert np.std(background) < 0.1 * np.std(plate[90:110])
    np.testing.assert_allclose(background.mean(), 0.4, rtol=0.02)
    rolled = PlatePattern(Still(np.roll(plate, 64, axis=1)), None, 1.5, 1.0)
    over_seam = rolled.light(Rectangle(0, 90, 24, 20))[1]
    np.testing.assert_allclose(over_seam, pattern.light(Rectangle(256 - 64, 90, 24, 20))[1], atol=tol.FLOAT32)
    half = PlatePattern(Still(plate), None, 1.5, 0.5).light(part)[1]
    np.testing.assert_allclose(half, 0.5 * (background + plate[90:110, 40:100]), atol=tol.FLOAT32)


def test_a_mean_is_the_calm_state_whatever_the_strength(rng: np.random.Generator) -> None:
    """The strength is a guess of what smoothing takes; a clip's mean has lost its caustics already."""
    shown, mean = rng.uniform(0.1, 0.9, (2, 32, 64, 3)).astype(np.float32)
    part = Rectangle(8, 16, 24, 8)
    got = PlatePattern(Still(shown), mean, 1.5, 0.3).light(part)
    for image, whole in zip(got, (shown, mean), strict=True):
        assert np.array_equal(image, whole[16:24, 8:32])


def test_the_calm_ground_is_the_mean_of_the_frames_where_the_camera_stands(rng: np.random.Generator) -> None:
    ground = rng.uniform(0.2, 0.6, size=(128, 256, 3)).astype(np.float32)
    waves = rng.uniform(0.8, 1.2, size=(9, 128, 256, 1)).astype(np.float32)
    for step, stands_still in ((0, True), (4, False)):
        series = BackgroundSeries(1.5, 0.1)
        shown = [np.roll(ground, k * step, axis=1) * wave for k, wave in enumerate(waves)]
        for k, image in enumerate(shown):
            series.add(VideoFrame.of_linear(image, 4 * k))
        found = series.result()
        assert (found.mean is not None) == stands_still
        assert 0.0 < found.strength <= 1.0
        if found.mean is not None:
            np.testing.assert_allclose(found.mean, np.mean(shown, axis=0), rtol=tol.HALF_FLOAT)


def test_rows_that_cannot_show_the_ground_are_not_summed(rng: np.random.Generator) -> None:
    """What is left is the same mean; a part that begins above it has none there."""
    shown = rng.uniform(0.2, 0.6, (1, 64, 128, 3)) * rng.uniform(0.8, 1.2, (9, 64, 128, 1))
    means = []
    for sky in (0.0, 0.5):
        series = BackgroundSeries(1.5, 0.1, sky)
        for k, image in enumerate(shown.astype(np.float32)):
            series.add(VideoFrame.of_linear(image, 4 * k))
        means.append(series.result().mean)
    whole, lower = means
    assert whole is not None
    assert lower is not None
    assert np.array_equal(lower, whole[32:])
    one, other = (PlatePattern(Still(shown[0]), mean, 1.5, 1.0) for mean in (whole, lower))
    for part in (Rectangle(8, 40, 24, 8), Rectangle(8, 28, 24, 12), Rectangle(8, 10, 24, 12)):
        above = max(32 - part.row, 0)
        expected = one.mean_of(part)
        expected[:above] = 0.0
        assert np.array_equal(other.mean_of(part), expected)


def test_a_camera_that_stands_is_told_from_one_that_moves(rng: np.random.Generator) -> None:
    ground = rng.normal(size=(64, 256))
    waves = [rng.normal(size=(64, 256)) for _ in range(12)]
    assert stands([ground + 1.5 * wave for wave in waves])
    assert stands([ground + 25.0 * rng.normal(size=ground.shape) for _ in range(60)])  # hidden in each, not in means
    assert not stands([np.roll(ground, 2 * k, axis=1) + 0.5 * wave for k, wave in enumerate(waves)])
    assert not stands([np.roll(ground, k // 2, axis=1) + 0.5 * wave for k, wave in enumerate(waves)])
    assert not stands(waves)


def test_the_calm_state_does_not_depend_on_how_a_frame_is_cut(rng: np.random.Generator) -> None:
    plate = rng.uniform(0.1, 0.9, (128, 256, 3)).astype(np.float32)
    pattern = PlatePattern(Still(plate), None, 1.5, 0.7)
    _, whole = pattern.light(Rectangle(0, 64, 256, 64))
    for part in (Rectangle(40, 70, 60, 58), Rectangle(200, 64, 56, 12), Rectangle(0, 90, 24, 20)):
        window = slice(part.row - 64, part.row - 64 + part.height), slice(part.column, part.column + part.width)
        # the same sums in the same order: rounding of OpenCV's blocks only
        np.testing.assert_allclose(pattern.light(part)[1], whole[window], atol=1e-6)


@pytest.mark.parametrize("height_m", [1.5, 6.0])
def test_a_wave_is_blurred_by_the_transform_of_a_gaussian(height_m: float) -> None:
    """Of 0.3 m on the ground: of each row by its distance, mixed between widths that differ by a factor of two."""
    rows, columns, period = 128, 256, 64.0
    wave = np.cos(2.0 * np.pi * (np.arange(columns) + 0.5) / period)
    image = np.broadcast_to(wave[None, :, None], (rows, columns, 3)).astype(np.float32)
    part = Rectangle(0, 80, columns, 48)
    _, calm = PlatePattern(Still(image), None, height_m, 1.0).light(part)
    down = np.pi * ((np.arange(80, 128) + 0.5) / rows - 0.5)
    level = np.log2(np.clip(0.3 * np.sin(down) / height_m * rows / np.pi, 1.0, columns / 16))
    low = np.floor(level)
    left = [np.exp(-2.0 * (np.pi * 2.0**number / period) ** 2) for number in (low, low + 1.0)]
    expected = (left[0] + (level - low) * (left[1] - left[0]))[:, None, None] * image[80:]
    # means over cells of up to sigma/2 and lines between them take up to (pi/16)^2 (1/6 + 1/3) = 2 % of the wave
    np.testing.assert_allclose(calm, expected, atol=0.02)


def test_the_mean_of_a_clip_is_widened_exactly() -> None:
    mean = np.random.default_rng(6).uniform(0.0, 4.0, (8, 16, 3)).astype(np.float16)
    mean[0, 0] = 0.0, 6e-8, 65504.0  # zero, the least and the largest of them
    _, background = PlatePattern(Still(mean.astype(np.float32)), mean, 1.0, 1.0).light(Rectangle(0, 0, 9, 7))
    np.testing.assert_array_equal(background, mean[:7, :9].astype(np.float32))
