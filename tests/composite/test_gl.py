# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from mr360uw.composite.aovs import SUMS
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.reference import render_aovs, render_layer
from mr360uw.composite.settings import DrawSettings
from mr360uw.composite.tiles import over
from tests.composite import tolerances as tol
from tests.composite.scenes import box, changed, codes, eight_shots, placed, plate, quad, shot, sphere

pytestmark = pytest.mark.usefixtures("gl")


@pytest.mark.parametrize("name", ["materials", "alpha", "seam", "zenith", "nadir", "deep", "shadow", "holdout"])
def test_agrees_with_the_reference(name: str, renderer: LayerRenderer, rng: np.random.Generator) -> None:
    scene = eight_shots(rng)[name]
    expected, got = render_layer(scene), renderer.render(scene)
    assert expected.alpha.max() > 0.5
    ground = plate(scene.view.width)
    difference = np.abs(codes(over(ground, got)) - codes(over(ground, expected)))
    psnr = 20.0 * np.log10(255.0 / max(np.sqrt(np.mean(difference**2)), 1e-9))
    assert psnr >= tol.RENDERERS_PSNR_DB
    assert np.mean(difference.max(axis=-1) <= tol.RENDERERS_CODES) >= tol.RENDERERS_FRACTION
    assert [(t.column, t.row, t.alpha.shape) for t in got.tiles] == [
        (t.column, t.row, t.alpha.shape) for t in expected.tiles
    ]


def test_output_variables_agree_and_sum_to_the_beauty(renderer: LayerRenderer, rng: np.random.Generator) -> None:
    scene = eight_shots(rng)["shadow"]
    expected_layer, expected = render_aovs(scene)
    layer, got = renderer.layer(scene, variables=True)
    assert got is not None
    for variables, of in ((expected, expected_layer), (got, layer)):
        total = variables.diffuse + variables.glossy + variables.sun + variables.emission + variables.veil
        np.testing.assert_allclose(total, of.radiance, atol=tol.HALF_FLOAT)
    assert np.array_equal(got.object_id, expected.object_id)
    for name in SUMS:
        wrong = np.abs(getattr(got, name) - getattr(expected, name)).max(axis=-1) > tol.AOV_DIFFERENCE
        assert np.mean(wrong) <= 1.0 - tol.RENDERERS_FRACTION, name


def test_nothing_visible_is_an_empty_layer(renderer: LayerRenderer) -> None:
    assert renderer.render(shot()).tiles == ()
    assert render_layer(shot()).tiles == ()


def test_a_still_scene_is_the_same_in_the_next_frame_and_a_moved_one_is_not(renderer: LayerRenderer) -> None:
    cube = box((0.5, 0.5, 0.5))
    first = renderer.render(shot(placed(cube, (0.0, 0.0, -1.5))))
    again = renderer.render(shot(placed(cube, (0.0, 0.0, -1.5))))
    moved = renderer.render(shot(placed(cube, (0.3, 0.0, -1.5))))
    back = renderer.render(shot(placed(cube, (0.0, 0.0, -1.5))))
    assert np.array_equal(first.radiance, again.radiance)
    assert np.array_equal(first.radiance, back.radiance)
    assert not np.array_equal(first.alpha, moved.alpha)


def test_a_body_around_the_camera_covers_everything(renderer: LayerRenderer) -> None:
    layer = renderer.render(shot(placed(sphere(12, quad().materials[0], radius=2.0), (0.2, 0.1, -0.1)), sun=None))
    assert layer.alpha.min() > 1.0 - tol.PIXEL_HOLES


def test_a_frame_larger_than_one_raster(renderer: LayerRenderer, rng: np.random.Generator) -> None:
    scene = eight_shots(rng, 640)["materials"]
    near = shot(*(placed(o.mesh, o.world_from_object[:3, 3] * 0.55) for o in scene.objects), width=640, sun=None)
    expected, got = (r(near) for r in (render_layer, renderer.render))
    assert np.mean(np.abs(got.alpha - expected.alpha) > tol.ALPHA) <= 1.0 - tol.RENDERERS_FRACTION


def test_edges_are_the_mean_of_what_a_pixel_shows(renderer: LayerRenderer) -> None:
    """Against 8 x 8 pixels of a picture eight times as large."""
    bodies = placed(sphere(), (-0.5, 0.1, -1.6)), placed(box((0.6, 0.5, 0.4)), (0.5, 0.0, -1.4), (30, 20, 10))
    scene = shot(*bodies, width=256, samples=DrawSettings().samples)
    fine = render_layer(changed(scene, width=2048, height=1024, samples=1))
    alpha, radiance = (
        image.reshape(128, 8, 256, 8, *image.shape[2:]).mean(axis=(1, 3)) for image in (fine.alpha, fine.radiance)
    )
    partly = (alpha > 0.004) & (alpha < 0.996)
    ground = plate(256)
    wrong = codes(over(ground, renderer.render(scene))) - codes(radiance + (1.0 - alpha[..., None]) * ground)
    assert partly.sum() > 100
    assert np.sqrt(np.mean(wrong[partly] ** 2)) <= tol.EDGE_CODES
