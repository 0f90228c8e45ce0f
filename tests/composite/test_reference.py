# SPDX-License-Identifier: Apache-2.0
"""What must hold of any right layer, on the reference renderer; test_gl.py holds the other to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mr360uw.base.rays import RayScene
from mr360uw.base.sphere import directions, disc_directions, row_solid_angle, unit, yaw_matrix
from mr360uw.composite.aovs import exr_parts, receiver_difference
from mr360uw.composite.light_sources import light_sources
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.reference import render_aovs, render_layer
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.composite.tiles import over
from mr360uw.types import View
from tests.composite import tolerances as tol
from tests.composite.scenes import SUN, box, changed, codes, environment, medium, placed, plate, quad, shot, sphere


@pytest.mark.parametrize(("metallic", "roughness"), [(0.0, 1.0), (0.0, 0.2), (1.0, 0.4), (0.5, 0.7)])
def test_white_furnace(metallic: float, roughness: float) -> None:
    white = Material(base_color=(1.0, 1.0, 1.0, 1.0), metallic=metallic, roughness=roughness)
    scene = shot(placed(sphere(material=white), (0.2, 0.3, -1.2)), environment=environment(0.5), sun=None)
    image = over(np.full((64, 128, 3), 0.5, np.float32), render_layer(scene))
    np.testing.assert_allclose(image, 0.5, rtol=tol.FURNACE)


def test_a_body_of_the_waters_own_radiance_vanishes() -> None:
    water = medium()
    far = (0.02, 0.12, 0.2)
    glowing = Material(base_color=(0.0, 0.0, 0.0, 1.0), emission=far, refractive_index=1.34)
    scene = shot(placed(box(material=glowing), (0.0, -0.5, -2.0), (20, 30, 0)), sun=None, medium=water)
    image = over(np.broadcast_to(np.float32(far), (64, 128, 3)).copy(), render_layer(scene))
    np.testing.assert_allclose(image, np.broadcast_to(far, image.shape), rtol=tol.FURNACE)


@pytest.mark.parametrize("height", [1.5, -1.5])
def test_a_body_over_a_pole_has_the_right_area(height: float) -> None:
    ball = sphere(64, radius=0.5)
    width = 256
    layer = render_layer(shot(placed(ball, (0.1, height, -0.05)), width=width, sun=None))
    solid_angle = np.sum(layer.alpha.sum(axis=1) * row_solid_angle(width, width // 2))
    distance = np.linalg.norm([0.1, height, 0.05])
    expected = 2.0 * np.pi * (1.0 - np.sqrt(1.0 - (0.5 / distance) ** 2))
    np.testing.assert_allclose(solid_angle, expected, rtol=tol.POLE_AREA)


def test_a_turn_of_the_camera_rolls_the_picture_and_the_seam_is_not_there() -> None:
    width = 128
    objects = placed(box((0.6, 0.5, 0.4)), (0.1, -0.3, -1.2), (25, 10, 0)), placed(sphere(), (0.9, -0.6, -1.1))
    base = shot(*objects, width=width, receiver=Receiver(plane_y=-1.2))
    ground = plate(width)
    still = codes(over(ground, render_layer(base)))
    for columns in (-29, 64):
        turned = changed(base, world_from_camera=yaw_matrix(2.0 * np.pi * columns / width))
        rolled = codes(over(np.roll(ground, -columns, axis=1), render_layer(turned)))
        close = np.abs(rolled - np.roll(still, -columns, axis=1)).max(axis=-1) <= tol.ROLL_CODES
        assert close.mean() >= tol.RENDERERS_FRACTION


def test_the_shadow_is_that_of_the_suns_disc() -> None:
    flat = replace(environment(), ambient=np.full((32, 64, 3), 1e-9))
    scene = shot(
        placed(sphere(), (0.1, -0.3, -1.2)), environment=flat, receiver=Receiver(plane_y=-1.2, occlusion=False)
    )
    layer = render_layer(scene)
    rows, columns = np.nonzero((layer.ratio[..., 0] < 0.99) & (layer.alpha == 0.0))
    rays = RayScene(np.concatenate([placed.triangles for placed in scene.objects]))
    rng = np.random.default_rng(1)
    truth = np.zeros(len(rows))
    for direction in disc_directions(SUN.direction, SUN.half_angle_rad, 2048)[rng.permutation(2048)[:1024]]:
        d = scene.view.directions(columns + rng.uniform(), rows + rng.uniform())
        point = d * (-1.2 / d[:, 1])[:, None]
        truth += ~rays.occluded(point, np.broadcast_to(direction, point.shape)) / 1024
    penumbra = (truth > 0.005) & (truth < 0.995)
    assert penumbra.sum() > 20
    error = (layer.ratio[rows, columns, 0] - truth)[penumbra]
    assert np.sqrt(np.mean(error**2)) < tol.PENUMBRA


def test_haze_under_a_shadow_is_not_darkened() -> None:
    scene = shot(placed(sphere(), (0.1, -0.5, -1.2)), medium=medium(), receiver=Receiver(plane_y=-1.2))
    layer = render_layer(scene)
    veil = np.zeros((64, 128, 3), np.float32)
    for tile in layer.tiles:
        veil[tile.window] = tile.veil
    assert layer.ratio.min() < 0.5
    free = layer.alpha == 0.0
    np.testing.assert_allclose(over(veil, layer)[free], veil[free], atol=tol.FLOAT32)


def test_no_caster_no_receiver_change_and_no_tiles() -> None:
    scene = shot(placed(sphere(), (0.0, -0.5, -1.2), casts_shadow=False), receiver=Receiver(plane_y=-1.2))
    assert np.all(render_layer(scene).ratio == 1.0)
    only_shadow = shot(placed(sphere(), (0.0, -0.5, -1.2), visible=False), receiver=Receiver(plane_y=-1.2))
    layer = render_layer(only_shadow)
    assert layer.alpha.max() == 0.0
    assert layer.ratio.min() < 0.5


def test_receivers_of_every_shape_agree() -> None:
    d = directions(128, 64)
    with np.errstate(divide="ignore"):
        distance = np.where(d[..., 1] < 0.0, -1.2 / d[..., 1], np.inf)
    corners = np.array([[-40, -1.2, -40], [40, -1.2, -40], [40, -1.2, 40], [-40, -1.2, 40]], float)
    shapes = [
        Receiver(plane_y=-1.2, extent_m=8.0),
        Receiver(mesh=corners[[[0, 2, 1], [0, 3, 2]]], extent_m=8.0),
        Receiver(distance_m=distance, extent_m=8.0),
    ]
    body = placed(sphere(), (0.1, -0.5, -1.2))
    plane, mesh, map_ = (render_layer(shot(body, receiver=r)).ratio for r in shapes)
    np.testing.assert_allclose(mesh, plane, atol=tol.FLOAT32_LOOKUP)
    assert np.mean(np.abs(map_ - plane).max(axis=-1) < tol.MAP_RATIO) > tol.RENDERERS_FRACTION


def test_transparency_multiplies_and_masks_cut() -> None:
    glass = Material(base_color=(0.0, 0.0, 0.0, 0.5), alpha_mode="BLEND", double_sided=True, refractive_index=1.0)
    panes = [placed(quad(glass, 3.0), (0.0, 0.0, z)) for z in (-1.0, -1.5, -2.0)]
    layer = render_layer(shot(*panes, sun=None))
    middle = layer.alpha[30:34, 62:66]
    np.testing.assert_allclose(middle, 1.0 - 0.5**3, atol=tol.FLOAT32)
    cut = replace(glass, alpha_mode="MASK", alpha_cutoff=0.6)
    assert render_layer(shot(placed(quad(cut), (0.0, 0.0, -1.0)), sun=None)).alpha.max() == 0.0


def test_one_sided_surfaces_are_seen_from_the_front_only() -> None:
    one = Material(double_sided=False)
    assert render_layer(shot(placed(quad(one), (0, 0, -1)), sun=None)).alpha.max() == 1.0
    assert render_layer(shot(placed(quad(one), (0, 0, -1), (180, 0, 0)), sun=None)).alpha.max() == 0.0


def test_mattes_hide_and_depth_mattes_hide_what_is_behind() -> None:
    near, far = placed(sphere(), (-0.7, 0.0, -1.5)), placed(sphere(), (1.4, 0.0, -3.0))
    base = shot(near, far, sun=None)
    full = render_layer(base)
    half = render_layer(replace(base, holdout=np.full((64, 128), 0.25)))
    np.testing.assert_allclose(half.alpha, 0.75 * full.alpha, atol=tol.FLOAT32)
    cut = render_layer(replace(base, holdout_distance_m=np.full((64, 128), 2.0)))
    assert cut.alpha[:, :64].sum() == pytest.approx(full.alpha[:, :64].sum())
    assert cut.alpha[:, 64:].sum() == 0.0


def test_more_samples_do_not_move_edges() -> None:
    body = placed(box((0.6, 0.5, 0.4)), (0.1, 0.2, -1.2), (25, 35, 10))
    areas = [render_layer(shot(body, sun=None, samples=n)).alpha.sum() for n in (5, 17, 65)]
    np.testing.assert_allclose(areas, areas[-1], rtol=tol.POLE_AREA)


def test_layers_recombine_to_the_composite() -> None:
    scene = shot(placed(sphere(), (0.1, -0.5, -1.2)), medium=medium(), receiver=Receiver(plane_y=-1.2))
    layer, variables = render_aovs(scene)
    ground = plate(128)
    channels = exr_parts(layer, variables, ground)
    parts = {name: np.stack(list(p.values()), axis=-1).astype(np.float32) for name, p in channels.items()}
    parts = {name: image[..., 0] if image.shape[-1] == 1 else image for name, image in parts.items()}
    beauty = sum(parts[name] for name in ("diffuse", "glossy", "sun", "emission", "veil"))
    np.testing.assert_allclose(beauty, parts["rgba"][..., :3], atol=tol.HALF_FLOAT)
    rebuilt = beauty + (1.0 - parts["rgba"][..., 3:]) * (ground + parts["receiver_difference"])
    np.testing.assert_allclose(rebuilt, over(ground, layer), atol=tol.HALF_FLOAT)
    assert np.abs(receiver_difference(ground, layer)).max() > 0.01
    seen = layer.alpha > 0.999
    np.testing.assert_allclose(np.linalg.norm(parts["P"][seen], axis=-1), parts["depth"][seen], rtol=0.1)
    np.testing.assert_allclose(np.linalg.norm(parts["N"][seen], axis=-1), 1.0, atol=tol.HALF_FLOAT)
    assert set(np.unique(parts["id"])) == {0.0, 1.0}


def test_light_falls_with_depth() -> None:
    body = placed(sphere(), (0.0, 0.0, -1.2))
    bright, dim = (render_layer(shot(body, medium=medium(d), surface_y_m=d)).radiance for d in (5.0, 5.0))
    assert np.array_equal(bright, dim)
    scene = shot(body, medium=medium(5.0))
    (sun,) = light_sources(scene)
    down = np.array([[0.0, -1.0, 0.0], [0.0, -4.0, 0.0]])
    beam = sun.arrival(down)[1]
    assert np.all(beam[1] < beam[0])
    path = 3.0 / SUN.direction[1]
    np.testing.assert_allclose(beam[1] / beam[0], np.exp(-np.array([0.35, 0.06, 0.04]) * path), rtol=tol.FLOAT32_LOOKUP)


def test_shots_have_defaults() -> None:
    assert Shot(View(8, 4), (), environment()).lights == ()
    assert unit([0.0, 2.0, 0.0])[1] == 1.0
