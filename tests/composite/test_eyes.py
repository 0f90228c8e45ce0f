# SPDX-License-Identifier: Apache-2.0
"""Eyes on the viewing circle: the geometry of their rays, bounds of bodies, and pictures of both renderers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.composite.tiles import nearest_m, over, rectangles_of_bodies, seen_rectangle
from mr360uw.types import Layer, View, ray_starts, seen_direction
from tests.composite import tolerances as tol
from tests.composite.scenes import box, changed, codes, placed, plate, quad, shot, sphere

HALF_M = 0.032
DISPARITY_PX = 0.1
EQUAL_DB = 45.0
"""Of an eye's column and that of a camera at the column's own point: sampling patterns see edges a little apart."""


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10.0 * np.log10(255.0**2 / max(np.mean((a - b) ** 2), 1e-12)))


def picture(layer: Layer) -> np.ndarray:
    return codes(over(plate(layer.width), layer))


@pytest.mark.parametrize("eye_m", [-HALF_M, 0.1])
def test_an_eye_sees_a_point_where_the_ray_to_it_starts(rng: np.random.Generator, eye_m: float) -> None:
    direction = rng.normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    starts = ray_starts(direction, (0.0, 1.0, 0.0), eye_m)
    np.testing.assert_allclose(np.sum(starts * direction, axis=-1), 0.0, atol=tol.FLOAT64)
    point = starts + direction * rng.uniform(0.05, 5.0, (200, 1))
    np.testing.assert_allclose(seen_direction(point, eye_m), direction, atol=tol.FLOAT64)


def test_the_left_eye_is_on_the_left_in_every_direction() -> None:
    view = View(8, 4, eye_m=-HALF_M, world_from_camera=np.eye(3))
    ahead = view.starts(np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(ahead, [[-HALF_M, 0.0, 0.0], [0.0, 0.0, -HALF_M], [0.0, 0.0, 0.0]], atol=tol.FLOAT64)


def test_rectangles_hold_what_an_eye_sees(rng: np.random.Generator) -> None:
    for eye_m in (-HALF_M, HALF_M):
        for _ in range(60):
            triangle = rng.normal(size=3) * rng.uniform(0.1, 2.0) + rng.normal(size=(3, 3)) * rng.uniform(0.02, 0.5)
            (whole,) = rectangles_of_bodies([triangle[None]], 720, 360, margin=0)
            column, row, columns, rows = seen_rectangle(whole, nearest_m(triangle[None]), eye_m, 720, 360)
            view = View(720, 360, eye_m=eye_m)
            x, y = view.places(rng.dirichlet(np.ones(3), 300) @ triangle)
            assert np.all((np.floor(x).astype(int) - column) % 720 <= columns)
            assert np.all((y >= row) & (y <= row + rows))


def test_a_sphere_has_the_disparity_of_the_closed_form() -> None:
    """Its edges lie asin((e + r)/D) and asin((e - r)/D) beside its bearing from the middle."""
    width, radius, distance = 512, 0.25, 2.0
    scene = shot(placed(sphere(48, radius=radius), (0.0, 0.0, -distance)), width=width, samples=13)
    middle = []
    for eye_m in (-HALF_M, HALF_M):
        alpha = render_layer(changed(scene, eye_m=eye_m)).alpha[width // 4]
        middle.append(np.sum(alpha * (np.arange(width) + 0.5)) / np.sum(alpha))
        edges = (np.arcsin((eye_m - radius) / distance), np.arcsin((eye_m + radius) / distance))
        assert np.sum(alpha) == pytest.approx((edges[1] - edges[0]) * width / (2 * np.pi), abs=DISPARITY_PX)
    expected = np.arcsin((HALF_M + radius) / distance) + np.arcsin((HALF_M - radius) / distance)
    assert middle[0] - middle[1] == pytest.approx(expected * width / (2 * np.pi), abs=DISPARITY_PX)


def bodies(width: int, **more: int) -> Shot:
    """Return a ball and a box whose flat sides turn from one eye, over a floor that catches their shadows."""
    crate = placed(box((0.5, 0.5, 0.5)), (-0.25, -0.3, -0.9), (0.0, 0.0, 0.0))
    floor = Receiver(plane_y=-1.2, extent_m=8.0)
    return shot(placed(sphere(16), (0.5, -0.5, -1.5)), crate, width=width, receiver=floor, **more)


@pytest.mark.parametrize(("column", "row"), [(29, 25), (31, 20)])
def test_pixels_are_those_of_cameras_at_their_own_points(column: int, row: int) -> None:
    """On the bodies and on the shadow that they cast: another pixel is seen from another point."""
    scene, cache = bodies(64, samples=5, sun_samples=16), Cache(4)
    for eye_m in (-HALF_M, HALF_M):
        seen = changed(scene, eye_m=eye_m)
        own = seen.view.starts(seen.view.directions(column + 0.5, row + 0.5))
        here = (row, slice(column - 1, column + 2))
        whole, alone = (picture(render_layer(one, cache))[here] for one in (seen, changed(scene, position=own)))
        assert psnr(whole, alone) > EQUAL_DB
        assert psnr(whole, picture(render_layer(scene, cache))[here]) < EQUAL_DB


@pytest.mark.usefixtures("gl")
def test_both_renderers_see_the_same() -> None:
    from mr360uw.composite.gl.layer_renderer import LayerRenderer

    renderer, scene = LayerRenderer(Cache(2)), bodies(128)
    turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    for eye_m, world_from_camera in ((-HALF_M, np.eye(3)), (HALF_M, turn)):
        seen = changed(scene, eye_m=eye_m, world_from_camera=world_from_camera)
        a, b = picture(render_layer(seen)), picture(renderer.render(seen))
        assert psnr(a, b) >= tol.RENDERERS_PSNR_DB
        assert np.mean(np.abs(a - b).max(axis=-1) <= tol.RENDERERS_CODES) >= tol.RENDERERS_FRACTION


def test_a_wall_that_shows_one_eye_its_back_hides_nothing_from_it() -> None:
    """A one-sided wall between both eyes, seen edge-on from the middle: only the eye before its front sees it."""
    wall = quad(replace(quad().materials[0], double_sided=False), size=0.8)
    scene = shot(placed(wall, (0.0, 0.0, -1.0), (90.0, 0.0, 0.0)), width=256, samples=17)
    seen = [render_layer(changed(scene, eye_m=eye_m)).alpha.max() for eye_m in (-HALF_M, HALF_M)]
    assert sorted(np.asarray(seen) > 0.5) == [False, True]
