# SPDX-License-Identifier: Apache-2.0
"""What bodies and waves change on the ground: its end, masks, and blocks of pixels against pixels one by one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.base.color import ColorSpec
from mr360uw.base.sphere import directions
from mr360uw.base.tile_blend import BLOCK
from mr360uw.composite.ambient.solver import ambient_light, free_of_bodies
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.light_sources import Blockers, light_sources
from mr360uw.composite.mesh.material import Material, make_texture
from mr360uw.composite.motion import rotation_matrix
from mr360uw.composite.raycast import pixel_footprint
from mr360uw.composite.receiver.blocks import Ground, prepare
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.receiver.ratio import receiver_ratio
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.reference import render_layer
from mr360uw.composite.sampling import WHOLE_PIXEL
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.composite.tiles import over, tile_of
from mr360uw.types import Environment, Floats, Layer, Rectangle, YuvImage
from mr360uw.video import VideoFrame
from tests.composite import tolerances as tol
from tests.composite.scenes import (
    SUN,
    box,
    caustics,
    changed,
    codes,
    environment,
    medium,
    placed,
    plate,
    quad,
    shot,
    sphere,
)

pytestmark = pytest.mark.usefixtures("gl")

STEP = 5
"""Every fifth row and column: all places within blocks of 8."""


@pytest.fixture(scope="module")
def sea() -> Environment:
    return environment()


def pixelwise(scene: Shot) -> tuple[Floats, Floats]:
    """Return the reference's ratio at every fifth row and column, (h, w, 3), and the distance of the ground, (h, w)."""
    assert scene.receiver is not None
    x, y = np.meshgrid(np.arange(0, scene.view.width, STEP) + 0.5, np.arange(0, scene.view.height, STEP) + 0.5)
    distance, normal = ReceiverShape(scene.receiver, scene.view.position).meet(scene.view, x, y)
    ratio, there = np.ones((*x.shape, 3)), np.isfinite(distance)
    sources = light_sources(scene, Blockers(scene))
    point = scene.view.directions(x, y)[there] * distance[there][:, None]
    free = free_of_bodies(scene, ambient_light(scene, Cache()), point, normal[there], Cache())
    whole = np.tile(WHOLE_PIXEL, (len(point), 1))
    sides = pixel_footprint(scene.view, x[there], y[there], point, normal[there], whole)
    ratio[there] = receiver_ratio(scene, sources, free, point, normal[there], distance[there], sides=sides)
    return ratio, distance


def sun_seen(scene: Shot, place: Floats) -> float:
    """Return the visible fraction of the sun's beam at a place (1, 3)."""
    (sun,) = light_sources(scene, Blockers(scene))
    return float(sun.visibility(place)[0])


def wrong_codes(got: Floats, expected: Floats) -> Floats:
    """Return how many codes of a pale ground two ratios (..., 3) differ by."""
    return np.abs(codes(0.4 * got) - codes(0.4 * expected)).max(axis=-1)


def at_steps(layer: Layer, expected: Floats) -> Floats:
    """Return a layer's ratio at every fifth row and column; the expected one where bodies cover part of the pixel.

    There the layer has the ratio in the pixel's gap, not at its centre.
    """
    free = layer.alpha[::STEP, ::STEP, None] == 0.0
    return np.where(free, layer.ratio[::STEP, ::STEP], expected)


def assert_agrees(got: Floats, expected: Floats) -> None:
    """Assert that ratios (..., 3) agree, over all and where there is a change."""
    wrong, change = wrong_codes(got, expected), wrong_codes(np.ones_like(expected), expected)
    assert change.max() > 20.0
    assert np.mean(wrong <= tol.RENDERERS_CODES) >= tol.RENDERERS_FRACTION
    assert wrong.max() <= tol.BLOCK_CODES
    assert wrong.sum() <= tol.BLOCK_ERROR * change.sum()


@pytest.mark.parametrize("eye_m", [0.0, 0.2])
def test_level_ground_is_met_where_rays_meet_it(eye_m: float) -> None:
    """At the corners and the middles of blocks of a turned camera's frame, which ends within a block."""
    still = shot(width=500, receiver=Receiver(plane_y=-1.2, extent_m=8.0))
    turned = rotation_matrix((30.0, 10.0, -5.0))
    view = replace(still.view, world_from_camera=turned, position=np.array([0.3, 0.4, -0.1]), eye_m=eye_m)
    scene = replace(still, view=view)
    assert scene.receiver is not None
    shape = ReceiverShape(scene.receiver, view.position)
    ground = Ground(scene.view, shape)
    ground.load_blocks(np.ones((ground.rows, ground.columns), np.bool_))
    edges = [np.minimum(BLOCK * np.arange(n + 1), size) for n, size in ((63, 504), (32, 250))]
    middles = BLOCK * (np.arange(63) + 0.5), 0.5 * (edges[1][:-1] + edges[1][1:])
    for (x, y), got in ((edges, ground.corner_point), (middles, ground.middle_point)):
        want, _ = ground.meet(*np.meshgrid(x, y))
        assert 0.2 < np.mean(np.any(want != 0.0, axis=-1)) < 0.8
        np.testing.assert_allclose(got, want, atol=1e-5)


def test_what_is_prepared_on_another_thread_gives_the_same_layer(renderer: LayerRenderer, sea: Environment) -> None:
    bodies = placed(sphere(), (0.4, -0.6, -1.8)), placed(box((0.6, 0.5, 0.4)), (-0.6, -0.95, -1.6), (25, 0, 0))
    scene = shot(*bodies, width=512, environment=sea, medium=medium(), receiver=Receiver(plane_y=-1.2))
    with ThreadPoolExecutor(1) as other:
        prepared = other.submit(prepare, scene, Cache()).result()
    got, want = LayerRenderer().layer(scene, prepared)[0], renderer.render(scene)
    assert prepared.reach is not None
    assert len(got.tiles) == len(want.tiles)
    np.testing.assert_array_equal(got.ratio, want.ratio)
    np.testing.assert_array_equal(got.radiance, want.radiance)


@pytest.mark.parametrize("pattern", ["none", "blurred", "mean"])
@pytest.mark.parametrize("waves", [False, True])
def test_ground_gives_the_same_codes_in_tiles_and_line_by_line(
    renderer: LayerRenderer, sea: Environment, rng: np.random.Generator, waves: bool, pattern: str
) -> None:
    bodies = placed(sphere(), (0.4, -0.6, -1.8)), placed(box((0.6, 0.5, 0.4)), (-0.6, -0.95, -1.6), (25, 0, 0))
    floor, spec = Receiver(plane_y=-1.2, caustics=waves, extent_m=8.0), ColorSpec("bt709", False, "bt709")
    scene = shot(
        *bodies, width=512, environment=sea, medium=medium(), caustics=caustics(rng, softened=True), receiver=floor
    )
    luma, *chroma = (rng.integers(70, 180, (256 // k, 512 // k)).astype(np.uint8) for k in (1, 2, 2))
    frame = VideoFrame(3, 3, Fraction(1, 25), 0.12, 1, spec, yuv=YuvImage(luma, *chroma, spec))
    if pattern != "none":
        mean = frame.linear(Rectangle(0, 100, 512, 156)).astype(np.float16) if pattern == "mean" else None
        scene = replace(scene, pattern=PlatePattern(frame, mean, 1.2, 0.6))
    layer, _ = renderer.layer(scene)
    assert layer.ground is not None
    assert np.mean(np.any(layer.ratio != 1.0, axis=-1)) > 0.05
    got, want = frame.over(layer).yuv, frame.over(layer.laid()).yuv
    assert got is not None
    assert want is not None
    for plane in ("y", "u", "v"):
        np.testing.assert_array_equal(getattr(got, plane), getattr(want, plane))


@pytest.mark.parametrize("waves", [False, True])
@pytest.mark.parametrize("width", [500, 1024])
def test_blocks_tell_their_pixels(
    renderer: LayerRenderer, sea: Environment, rng: np.random.Generator, width: int, waves: bool
) -> None:
    """The box and its shadow lie across the seam; a frame of 500 x 250 ends within a block."""
    bodies = placed(sphere(), (0.4, -0.6, -1.8)), placed(box((0.6, 0.5, 0.4)), (-0.1, -0.95, 1.6), (25, 0, 0))
    floor = Receiver(plane_y=-1.2, caustics=waves, extent_m=8.0)
    scene = shot(
        *bodies, width=width, environment=sea, medium=medium(), caustics=caustics(rng, softened=True), receiver=floor
    )
    expected, _ = pixelwise(scene)
    assert_agrees(at_steps(renderer.render(scene), expected), expected)


def test_light_that_the_water_scatters_forwards_reaches_around_a_body(sea: Environment) -> None:
    """Below a ball whose angular radius r is between those of the disc and of the halo R: (1 - s)(1 - r^2/R^2)."""
    spread, distance, radius = np.radians(5.0), 3.0, 0.3
    ball = placed(sphere(rows=48, radius=radius), tuple(distance * SUN.direction))
    water = medium()
    scene = shot(ball, environment=sea, medium=water, sun=replace(SUN, half_angle_rad=0.00465), sun_samples=32)
    under = np.zeros((1, 3))
    sharp = np.exp(-0.5 * water.beam[0] * water.camera_depth_m / SUN.direction[1]).mean()
    halo = np.tan(np.hypot(0.00465, 2.0 * spread))
    blocked = (radius / np.sqrt(distance**2 - radius**2) / halo) ** 2
    seen = {sigma: sun_seen(changed(scene, sun_spread_deg=np.degrees(sigma)), under) for sigma in (0.0, spread)}
    assert seen[0.0] == 0.0
    assert seen[spread] == pytest.approx((1.0 - sharp) * (1.0 - blocked), abs=tol.PENUMBRA)
    assert sun_seen(changed(scene, sun_spread_deg=np.degrees(spread), medium=None), under) == 0.0


@pytest.mark.parametrize("kind", ["plane", "map"])
def test_blocks_follow_the_halo_of_the_sun(renderer: LayerRenderer, sea: Environment, kind: str) -> None:
    d = directions(512, 256)[..., 1]
    floor = {
        "plane": Receiver(plane_y=-1.2, extent_m=8.0),
        "map": Receiver(distance_m=np.where(d < 0.0, -1.2 / np.minimum(d, -1e-9), 0.0), extent_m=8.0),
    }[kind]
    bodies = placed(sphere(), (0.4, -0.3, -1.8)), placed(box((0.6, 0.5, 0.4)), (-0.6, -0.95, -1.6), (25, 0, 0))
    sun = replace(SUN, half_angle_rad=0.0035)
    scene = shot(*bodies, width=512, environment=sea, medium=medium(), receiver=floor, sun=sun, sun_spread_deg=5.0)
    expected, _ = pixelwise(scene)
    assert_agrees(at_steps(renderer.render(scene), expected), expected)


@pytest.mark.parametrize("waves", [False, True])
@pytest.mark.parametrize("kind", ["mesh", "map"])
def test_other_shapes_of_a_plane_give_its_ratio(
    renderer: LayerRenderer, sea: Environment, rng: np.random.Generator, kind: str, waves: bool
) -> None:
    d = directions(512, 256)[..., 1]
    a, b, c, e = 20.0 * np.array([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)]) + np.array([0.0, -1.2, 0.0])
    shapes = {
        "mesh": Receiver(mesh=np.array([(a, b, c), (a, c, e)]), caustics=waves, extent_m=8.0),
        "map": Receiver(distance_m=np.where(d < 0.0, -1.2 / np.minimum(d, -1e-9), 0.0), caustics=waves, extent_m=8.0),
    }
    bodies = placed(sphere(), (0.4, -0.6, -1.8)), placed(box((0.6, 0.5, 0.4)), (-0.6, -0.95, -1.6), (25, 0, 0))
    plane = Receiver(plane_y=-1.2, caustics=waves, extent_m=8.0)
    scene = shot(*bodies, width=512, environment=sea, caustics=caustics(rng), receiver=plane)
    expected, _ = pixelwise(scene)
    assert_agrees(at_steps(renderer.render(replace(scene, receiver=shapes[kind])), expected), expected)


@pytest.mark.parametrize("width", [512, 1024])
def test_a_small_body_is_not_lost_between_corners(renderer: LayerRenderer, sea: Environment, width: int) -> None:
    balls = [placed(sphere(8, radius=0.03), (x, -1.17, -1.5 - 0.3 * k)) for k, x in enumerate((-0.4, 0.0, 0.3))]
    scene = shot(*balls, width=width, environment=sea, receiver=Receiver(plane_y=-1.2))
    expected, _ = pixelwise(scene)
    assert_agrees(at_steps(renderer.render(scene), expected), expected)


@pytest.mark.parametrize("kind", ["plane", "mesh"])
@pytest.mark.parametrize("name", ["reference", "gl"])
def test_a_flush_card_of_the_grounds_colour_vanishes(renderer: LayerRenderer, name: str, kind: str) -> None:
    """Ambient light and sun: no dark or bright pixels along its outline, and none around it."""
    sand = Material(base_color=(0.4, 0.4, 0.4, 1.0), roughness=1.0, refractive_index=1.0)
    card = placed(box((0.5, 1e-4, 0.4), sand), (0.1, -1.2 + 5e-5, -1.3), (25, 0, 0))
    a, b, c, e = 20.0 * np.array([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)]) + np.array([0.0, -1.2, 0.0])
    floor = {"plane": Receiver(plane_y=-1.2), "mesh": Receiver(mesh=np.array([(a, b, c), (a, c, e)]))}[kind]
    scene = shot(card, environment=environment(0.3), receiver=floor, width=512)
    layer = (renderer.render if name == "gl" else render_layer)(scene)
    assert np.sum((layer.alpha > 0.0) & (layer.alpha < 1.0)) > 50
    lit = np.median(layer.radiance[layer.alpha == 1.0], axis=0)
    image = over(np.broadcast_to(lit, layer.ratio.shape).astype(np.float32), layer)
    assert np.abs(image / lit - 1.0).max() <= tol.FLUSH_CARD


@pytest.mark.parametrize("name", ["reference", "gl"])
def test_pixels_across_a_hard_edge_are_as_bright_as_their_lit_fraction(renderer: LayerRenderer, name: str) -> None:
    """A slanted straight edge under a sun without extent: the fraction of 32 x 32 places of each pixel beside it."""
    height, yaw = 0.6, 20.0
    slab = placed(box((3.0, 0.02, 3.0)), (-0.9, height, -1.5), (yaw, 0, 0))
    floor = Receiver(plane_y=-1.2, occlusion=False)
    bare = replace(SUN, half_angle_rad=1e-4)
    scene = shot(slab, environment=environment(0.2), receiver=floor, width=512, sun=bare, sun_spread_deg=0.0)
    rows, columns = np.arange(168, 200), np.arange(240, 300)
    draw = renderer.render if name == "gl" else render_layer
    ratio = draw(scene).ratio[168:200, 240:300, 1]
    seen = (ratio - ratio.min()) / (1.0 - ratio.min())
    inside = (np.arange(32) + 0.5) / 32
    y, x = np.meshgrid((rows[:, None] + inside).ravel(), (columns[:, None] + inside).ravel(), indexing="ij")
    d = scene.view.directions(x, y)
    ground = d * (-1.2 / d[..., 1:2])
    body, free = np.linalg.inv(slab.world_from_object), np.ones(d.shape[:2], np.bool_)
    for level in (height - 0.01, height + 0.01):
        above = ground + SUN.direction * ((level + 1.2) / SUN.direction[1])
        free &= np.abs(above @ body[[0, 2], :3].T + body[[0, 2], 3]).max(axis=-1) > 1.5
    expected = free.reshape(len(rows), 32, len(columns), 32).mean(axis=(1, 3))
    assert np.sum((expected > 0.1) & (expected < 0.9)) > 30
    wrong = np.abs(seen - expected)
    assert wrong.max() <= tol.HARD_EDGE
    assert np.sqrt(np.mean(wrong[(expected > 0.0) & (expected < 1.0)] ** 2)) <= 0.5 * tol.HARD_EDGE


def test_light_falls_through_a_mask(renderer: LayerRenderer, sea: Environment) -> None:
    """A pane, half of it cut out: the shadow of the other half alone, in both renderers."""
    alpha = np.full((64, 64, 4), 255, np.uint8)
    alpha[:, :32, 3] = 0
    cut = Material(base_map=make_texture(alpha, srgb=True), alpha_mode="MASK", double_sided=True)
    pane, half = quad(cut, 0.8), box((0.4, 0.8, 1e-4))
    floor = Receiver(plane_y=-1.2, occlusion=False)
    masked = shot(placed(pane, (0.0, -0.6, -1.5), (0, 90, 0)), environment=sea, receiver=floor, width=512)
    solid = shot(placed(half, (0.2, -0.6, -1.5), (0, 90, 0)), environment=sea, receiver=floor, width=512)
    expected, _ = pixelwise(solid)
    for got in (pixelwise(masked)[0], renderer.render(masked).ratio[::STEP, ::STEP]):
        assert_agrees(got, expected)


def test_the_receiver_fades_out_at_its_end(renderer: LayerRenderer, sea: Environment, rng: np.random.Generator) -> None:
    floor = Receiver(plane_y=-1.2, caustics=True)
    waves = shot(receiver=floor, environment=sea, caustics=caustics(rng), width=256)
    far, distance = pixelwise(waves)
    last = np.max(distance[distance < 5.0])
    ending = replace(waves, receiver=replace(floor, extent_m=1.01 * last))
    expected, _ = pixelwise(ending)
    change = np.abs(expected - 1.0).max(axis=-1)
    assert np.abs(far - 1.0).max(axis=-1)[distance == last].max() > 0.1
    assert 0.0 < change[distance == last].max() < 0.01
    assert change[distance > last].max() == 0.0
    np.testing.assert_array_equal(expected[distance < 0.8 * last], far[distance < 0.8 * last])
    got = renderer.render(ending).ratio[::STEP, ::STEP]
    assert wrong_codes(got, expected).max() <= tol.RENDERERS_CODES


@pytest.mark.parametrize("waves", [False, True])
def test_pixels_that_are_left_out_change_less_than_the_bound(
    renderer: LayerRenderer, sea: Environment, rng: np.random.Generator, waves: bool
) -> None:
    """And nothing else changes; caustics reach every block, so that single pixels alone are left out."""
    scene = shot(
        placed(sphere(), (0.1, -0.3, -2.5)), width=512, environment=sea, medium=medium(),
        caustics=caustics(rng) if waves else None, receiver=Receiver(plane_y=-1.2, caustics=waves),
    )  # fmt: skip
    fast, window = renderer.render(scene), Rectangle(0, 0, 512, 256)
    slow = LayerRenderer().render(replace(scene, unseen=0.0))
    got, expected = tile_of(fast, window), tile_of(slow, window)
    left_out = np.all(got.ratio == 1.0, axis=-1) & np.any(expected.ratio != 1.0, axis=-1)
    assert np.any(left_out)
    assert (np.mean(left_out) < 0.01) == waves
    assert not np.any((got.ratio != 1.0).any(axis=-1) & (np.abs(got.ratio - 1.0).max(axis=-1) <= scene.unseen))
    assert np.abs(expected.ratio - 1.0)[left_out].max(initial=0.0) <= 0.001
    assert np.array_equal(got.ratio[~left_out], expected.ratio[~left_out])
    assert np.array_equal(got.radiance, expected.radiance)
    assert (
        np.abs(codes(over(plate(512), fast)) - codes(over(plate(512), slow))).max() < 0.125
    )  # a ninth of a code, and rounding
