# SPDX-License-Identifier: Apache-2.0
"""Ambient light among bodies and the ground: closed forms, furnaces, both renderers, what is kept on the disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.base.rays import RayScene
from mr360uw.base.sphere import directions as pixel_directions
from mr360uw.base.sphere import unit, yaw_matrix
from mr360uw.composite.ambient.form_factors import Layout
from mr360uw.composite.ambient.mesh_transfer import (
    COUNT,
    SOLID_ANGLE,
    directions,
    make_lattice,
    make_transfer,
    points_at,
)
from mr360uw.composite.ambient.solver import AmbientLight, ambient_light, free_of_bodies
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.mesh.material import Material, Part
from mr360uw.composite.mesh.mesh import Mesh, make_mesh
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shading import ggx_distribution, lobe_axis, smith_visibility
from mr360uw.composite.shot import PlacedObject, Receiver, Shot
from mr360uw.ibl.filters import irradiance
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.lookup import environment_lookup, glossy_lookup, reduce_map
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.ibl.settings import GLOSSY_ROUGHNESS
from mr360uw.types import Environment, Floats, Layer
from tests.composite import tolerances as tol
from tests.composite.form_factors import box_form_factor, polygon_form_factor
from tests.composite.scenes import box, changed, codes, environment, medium, placed, plate, quad, shot, sphere
from tests.glsl import gl_available

WHITE = Material(base_color=(1.0, 1.0, 1.0, 1.0), roughness=1.0, refractive_index=1.0)
"""Without a coat: what a closed form says of a diffuse white is then exact."""


def box_of(low: Floats, size: Floats) -> Part:
    """Return a closed box as one part."""
    points = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(8, 3) * size + low
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Part("wall", points, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]))


def crate(material: Material, lid: bool = False) -> Mesh:
    """Return a crate of side 1 with walls of .05, as a modeller makes it: boxes that touch."""
    t = 0.05
    walls = [
        ([0, 0, 0], [1, t, 1]), ([0, t, 0], [t, 1 - t, 1]), ([1 - t, t, 0], [t, 1 - t, 1]),
        ([t, t, 0], [1 - 2 * t, 1 - t, t]), ([t, t, 1 - t], [1 - 2 * t, 1 - t, t]),
    ]  # fmt: skip
    walls += [([0, 1, 0], [1, t, 1])] if lid else []
    return make_mesh([box_of(np.array(a) - [0.5, 0.0, 0.5], np.array(b)) for a, b in walls], [material])


def solved(scene: Shot) -> AmbientLight:
    """Return the ambient light of a shot that has any."""
    light = ambient_light(scene, Cache())
    assert light is not None
    return light


def blocked_share(layout: Layout, points: Floats) -> Floats:
    """Return the fraction (n,) of uniform light that bodies block at level places (n, 3)."""
    up = np.tile([0.0, 1.0, 0.0], (len(points), 1))
    return layout.occluders.blocked(points, up).share.sum(axis=0).astype(float)


def hidden_from(body: PlacedObject, points: Floats) -> Floats:
    """Return the fraction (n,) of uniform light that rays find blocked by a body at level places (n, 3)."""
    rays = RayScene(body.triangles)
    u, angle = (np.arange(4096) + 0.5) / 4096, 2.399963 * np.arange(4096)
    hemisphere = np.stack([np.sqrt(u) * np.cos(angle), np.sqrt(1.0 - u), np.sqrt(u) * np.sin(angle)], axis=-1)
    start = points + np.array([0.0, 1e-6, 0.0])
    return np.array([rays.occluded(np.broadcast_to(p, hemisphere.shape), hemisphere).mean() for p in start])


# --- the ground ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("azimuth", [0.0, 0.4, 1.9])
def test_a_ball_blocks_its_form_factor(gap: float, azimuth: float) -> None:
    radius = 0.5
    height = radius * (1.0 + gap)
    body = placed(sphere(48, WHITE, radius), (0.3, height, -0.2))
    layout = solved(shot(body, receiver=Receiver(plane_y=0.0))).layout
    r = np.linspace(0.0, 6.0 * radius, 301)
    points = np.stack([0.3 + r * np.cos(azimuth), 0.0 * r, -0.2 + r * np.sin(azimuth)], axis=-1)
    share = blocked_share(layout, points)
    squared = r * r + height * height
    want = radius**2 / squared * height / np.sqrt(squared)
    assert np.abs(share - want).max() < tol.BALL_SHARE
    assert np.diff(share).max() < tol.MONOTONE


@pytest.mark.parametrize("size", [(0.6, 0.4, 0.5), (0.6, 0.02, 0.9)])
@pytest.mark.parametrize("gap", [0.0, 0.25])
def test_a_box_blocks_what_rays_and_lambert_find(size: tuple[float, float, float], gap: float) -> None:
    body = placed(box(size, WHITE), (0.0, 0.5 * size[1] + gap, 0.0))
    layout = solved(shot(body, receiver=Receiver(plane_y=0.0))).layout
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-1.0, 1.0, 60), np.zeros(60), rng.uniform(-1.0, 1.0, 60)])
    share = blocked_share(layout, points)
    truth = hidden_from(body, points)
    aside = np.hypot(*(np.maximum(np.abs(points[:, [0, 2]]) - 0.5 * np.array(size)[[0, 2]], 0.0).T))
    within = (aside == 0.0) & (gap == 0.0)  # below what touches the ground nothing is seen
    off = np.where(within, 0.0, np.abs(share - truth))
    assert off[(aside == 0.0) | (aside > 0.02)].max() < tol.BOX_CONTACT
    assert off[aside > 0.05].max() < tol.BOX_SHARE
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5 * np.array([size[0], size[2]])
    lid = np.stack([corner[:, 0], np.full(4, gap), corner[:, 1]], axis=-1)
    if gap > 0.0 and size[1] < 0.05:  # thin: what it blocks straight below is its lower face, by Lambert's formula
        below = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.2]])
        np.testing.assert_allclose(blocked_share(layout, below), lambert(lid, below), atol=tol.BOX_SHARE)


def test_beside_a_hollowed_foot_the_ground_is_not_below_the_body() -> None:
    """A barrel whose foot is a rim of 2 cm: the shade of the rim ends where the rim does, all around."""
    turn, height = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False), np.linspace(0.0, 0.9, 25)
    profile = [(1e-3, 0.02), *((0.33 - 0.06 * (y / 0.45 - 1.0) ** 2, y) for y in height), (1e-3, 0.9)]
    points = np.array([(r * np.cos(t), y, r * np.sin(t)) for r, y in profile for t in turn])
    ring = np.arange(48)
    after, rows = (ring + 1) % 48, 48 * np.arange(len(profile) - 1)[:, None]
    corners = [np.stack([rows + a, rows + b, rows + c], axis=-1).reshape(-1, 3)
               for a, b, c in ((ring, ring + 48, after), (after, ring + 48, after + 48))]  # fmt: skip
    body = placed(make_mesh([Part("barrel", points, np.concatenate(corners))], [WHITE]), (0.0, 0.0, 0.0))
    layout = solved(shot(body, receiver=Receiver(plane_y=0.0))).layout
    azimuth, away = (g.ravel() for g in np.meshgrid(np.linspace(0.0, 6.2, 40), [0.275, 0.28, 0.29, 0.31, 0.35]))
    places = np.stack([away * np.cos(azimuth), 0.0 * away, away * np.sin(azimuth)], axis=-1)
    off = np.abs(blocked_share(layout, places) - hidden_from(body, places))
    assert off.max() < tol.BOX_SHARE


@pytest.mark.parametrize("yaw_deg", [0.0, 33.0])
@pytest.mark.parametrize("height", [0.6, 0.006])
@pytest.mark.parametrize("gap", [0.0, 0.03, 0.15])
def test_a_box_blocks_its_form_factor(gap: float, height: float, yaw_deg: float) -> None:
    """Also where its gap is as narrow as a cell of its plan, and along its corners."""
    body = placed(box((0.6, height, 0.5), WHITE), (0.1, gap + 0.5 * height, -0.2), (yaw_deg, 0.0, 0.0))
    layout = solved(shot(body, receiver=Receiver(plane_y=0.0))).layout
    rng = np.random.default_rng(3)
    local = rng.uniform(-1.0, 1.0, (300, 3)) * [0.9, 0.0, 0.9]
    low, high = np.array([-0.3, max(gap, 1e-6), -0.25]), np.array([0.3, gap + height, 0.25])
    want = np.array([box_form_factor(p, np.array([0.0, 1.0, 0.0]), low, high) for p in local])
    points = local @ body.world_from_object[:3, :3].T + [0.1, 0.0, -0.2]
    off = np.abs(blocked_share(layout, np.ascontiguousarray(points)) - want)
    assert off.max() < tol.EXACT_BOX


def sheets(*corners: list[list[float]]) -> Mesh:
    """Return squares without thickness, each of four corners in turn."""
    quads = np.array([[0, 1, 2], [0, 2, 3]])
    return make_mesh([Part("sheet", np.array(c, float), quads) for c in corners], [replace(WHITE, double_sided=True)])


@pytest.mark.parametrize("yaw_deg", [0.0, 20.0])
def test_walls_without_thickness_block_like_a_box(yaw_deg: float) -> None:
    """Seen from the ground outside an open crate of sheets is a box; a sheet that stands alone is a rectangle."""
    x, y, z = 0.45, 0.4, 0.3
    around = [[-x, -z], [x, -z], [x, z], [-x, z]]
    walls = [[[*a[:1], 0, a[1]], [*b[:1], 0, b[1]], [*b[:1], y, b[1]], [*a[:1], y, a[1]]]
             for a, b in zip(around, around[1:] + around[:1], strict=True)]  # fmt: skip
    floor = [[a, 0.0, b] for a, b in around]
    rng, up = np.random.default_rng(4), np.array([0.0, 1.0, 0.0])
    local = rng.uniform(-1.2, 1.2, (300, 3)) * [1.0, 0.0, 1.0]
    beside = np.maximum(np.abs(local) - [x, 0.0, z], 0.0).max(axis=-1)
    for mesh, near in ((sheets(floor, *walls), beside), (sheets(walls[2]), np.abs(local[:, 2] - z))):
        body = placed(mesh, (0.0, 0.0, 0.0), (yaw_deg, 0.0, 0.0))
        layout = solved(shot(body, receiver=Receiver(plane_y=0.0))).layout
        share = blocked_share(layout, np.ascontiguousarray(local @ body.world_from_object[:3, :3].T))
        if mesh.positions.shape[0] == 2:
            want = np.array([polygon_form_factor(p, up, np.array(walls[2])) for p in local])
        else:
            want = np.array([box_form_factor(p, up, [-x, 1e-6, -z], [x, y, z]) for p in local])
        assert np.abs(share - want)[near > 0.02].max() < tol.SHEETS


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0])
def test_light_falls_through_a_ring(yaw_deg: float) -> None:
    """A level square with a square hole blocks the difference of the two, below it, in the hole and outside."""
    inner, outer, height = 0.2, 0.4, 0.15
    a, b = (half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) for half in (inner, outer))
    level = [[[p[0], height, p[1]] for p in (b[k], b[(k + 1) % 4], a[(k + 1) % 4], a[k])] for k in range(4)]
    body = placed(sheets(*level), (0.0, 0.0, 0.0), (yaw_deg, 0.0, 0.0))
    layout = solved(shot(body, receiver=Receiver(plane_y=0.0))).layout
    local = np.random.default_rng(6).uniform(-0.7, 0.7, (300, 3)) * [1.0, 0.0, 1.0]
    share = blocked_share(layout, np.ascontiguousarray(local @ body.world_from_object[:3, :3].T))
    full, hole = (lambert(np.insert(c, 1, height, axis=1), local) for c in (b, a))
    assert np.abs(share - (full - hole)).max() < tol.RING


def lambert(polygon: Floats, points: Floats) -> Floats:
    """Return the form factor (n,) of a polygon (k, 3) above level places: half the sum of edge angles times normals."""
    factor = []
    for point in points:
        v = polygon - point
        v /= np.linalg.norm(v, axis=-1, keepdims=True)
        after = np.roll(v, -1, axis=0)
        across = np.cross(v, after)
        angle = np.arctan2(np.linalg.norm(across, axis=-1), np.sum(v * after, -1))
        factor.append(abs(np.sum(angle * across[:, 1] / np.linalg.norm(across, axis=-1))) / (2.0 * np.pi))
    return np.array(factor)


def test_a_flush_card_changes_nothing_around_it() -> None:
    card = placed(quad(WHITE), (0.0, -1.0, -1.5), (0.0, -90.0, 0.0))
    scene = shot(card, environment=environment(0.5), sun=None, receiver=Receiver(plane_y=-1.0))
    np.testing.assert_array_equal(render_layer(scene).ratio, 1.0)


def test_a_red_ball_reddens_the_ground() -> None:
    red = replace(WHITE, base_color=(0.9, 0.05, 0.05, 1.0))
    scene = shot(
        placed(sphere(24, red), (0.0, -0.5, -1.5)), environment=environment(0.5), receiver=Receiver(plane_y=-1)
    )
    light, up = solved(scene), np.array([[0.0, 1.0, 0.0]])
    free = free_of_bodies(scene, light, np.array([[0.55, -1.0, -1.5]]), up, Cache())
    assert free[0, 0] > free[0, 1] + tol.REDDENED
    assert free[0, 1] == pytest.approx(free[0, 2], abs=tol.FLOAT32_LOOKUP)


def test_a_base_colour_above_one_reflects_no_more_than_all_light() -> None:
    inside = []
    for white in (1.0, 2.5):
        material = replace(WHITE, base_color=(white, white, white, 1.0))
        scene = shot(placed(crate(material), (0.0, -0.5, -2.0)), environment=environment(0.5), sun=None)
        (values,) = solved(scene).values
        assert values is not None
        inside.append(values)
    np.testing.assert_array_equal(inside[0], inside[1])


def test_a_spotted_sky_leaves_no_negative_light_where_bodies_block_it_all() -> None:
    map_ = np.zeros((32, 64, 3))
    map_[4:12:3, ::5] = 1e3
    light_of = irradiance(map_)
    spotted = replace(environment(0.0), radiance=map_, irradiance=light_of, residual=map_, ambient=light_of)
    black = replace(WHITE, base_color=(0.0, 0.0, 0.0, 1.0))
    body = placed(sphere(24, black, 1.5), (0.0, 0.0, 0.0))
    scene = shot(body, environment=spotted, receiver=Receiver(plane_y=-0.6))
    x, z = np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.8, 0.8, 9))
    points = np.stack([x, np.full_like(x, -0.6), z], axis=-1).reshape(-1, 3)
    free = free_of_bodies(scene, solved(scene), points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), Cache())
    assert np.all(free >= 0.0)


# --- bodies --------------------------------------------------------------------------------------------------------


def test_a_furnace_stays_a_furnace() -> None:
    scene = shot(
        placed(crate(WHITE), (0.0, -1.0, -1.6), (30, 0, 0)), placed(sphere(16, WHITE), (1.0, -0.5, -1.4)),
        environment=environment(0.5), sun=None, receiver=Receiver(plane_y=-1.0), camera_position=np.array([0, 0.8, 0]),
    )  # fmt: skip
    layer = render_layer(scene)
    covered = layer.alpha == 1.0
    np.testing.assert_allclose(layer.radiance[covered], 0.5, atol=tol.FURNACE)
    np.testing.assert_allclose(layer.ratio, 1.0, atol=tol.FURNACE)


def test_the_inside_of_a_closed_white_box_is_a_furnace() -> None:
    light = solved(shot(placed(crate(WHITE, lid=True), (0.0, -1.0, -2.0)), environment=environment(0.5), sun=None))
    lattice = light.layout.bodies[0].transfer.lattice
    values = light.values[0]
    assert values is not None
    np.testing.assert_allclose(values[lattice.places[:, 0], :3], 1.0, atol=tol.CLOSED_BOX)


def test_a_black_crate_is_dark_and_a_mirror_in_it_does_not_glow() -> None:
    black = replace(WHITE, base_color=(0.0, 0.0, 0.0, 1.0))
    mirror = replace(WHITE, metallic=1.0, roughness=0.1)
    inside = placed(sphere(16, mirror, 0.25), (0.0, -0.65, -1.2))
    camera = np.array([0.0, 1.5, 0.0])
    alone = render_layer(shot(inside, environment=environment(0.5), sun=None, camera_position=camera))
    among = render_layer(
        shot(
            inside, placed(crate(black), (0, -1, -1.2)), environment=environment(0.5), sun=None, camera_position=camera
        )
    )
    seen = (alone.alpha == 1.0) & np.isclose(among.distance_m, alone.distance_m, atol=1e-3)
    assert np.any(seen)
    assert among.radiance[seen].mean() < tol.MIRROR_IN_CRATE * alone.radiance[seen].mean()


def test_a_body_alone_in_the_open_is_untouched() -> None:
    scene = shot(placed(sphere(), (0.0, -0.5, -2.0)))
    off = changed(scene, ambient_occlusion=False)
    np.testing.assert_array_equal(render_layer(scene).radiance, render_layer(off).radiance)


def test_touching_balls_shade_each_other() -> None:
    black = replace(WHITE, base_color=(0.0, 0.0, 0.0, 1.0))
    scene = shot(placed(sphere(32, WHITE), (-0.5, 0, -2)), placed(sphere(32, black), (0.5, 0, -2)),
                 environment=environment(0.5), sun=None)  # fmt: skip
    light = solved(scene)
    values = light.values[0]
    assert values is not None
    normal = np.array([[np.cos(a), np.sin(a), 0.0] for a in 2.0 * np.pi / 64.0 * np.array([0, 5, 11, 18])])
    got = [values[_nearest_point(light, n), 0].mean() for n in normal]
    rays = RayScene(np.concatenate([placed.triangles for placed in scene.objects[1:]]))
    u, angle = (np.arange(4096) + 0.5) / 4096, 2.399963 * np.arange(4096)
    for n, share in zip(normal, got, strict=True):
        across = np.array([-n[1], n[0], 0.0])
        d = (np.sqrt(u) * np.cos(angle))[:, None] * across + np.outer(np.sqrt(u) * np.sin(angle), [0, 0, 1])
        d = d + np.sqrt(1.0 - u)[:, None] * n
        start = np.array([-0.5, 0.0, -2.0]) + 0.5 * n
        assert share == pytest.approx(1.0 - rays.occluded(np.broadcast_to(start, d.shape), d).mean(), abs=tol.BALLS)


def _nearest_point(light: AmbientLight, normal: Floats) -> np.ndarray:
    mesh, lattice = light.layout.bodies[0].placed.mesh, light.layout.bodies[0].transfer.lattice
    flat = mesh.normals.reshape(-1, 3) @ normal
    corner = np.flatnonzero(flat > flat.max() - 1e-6)
    points, shares = points_at(lattice.places[corner // 3], np.eye(3)[corner % 3])
    return points[shares > 0.5]


def _bright_patch(foot: Floats, side_m: float) -> Environment:
    """Return the light at the origin over ground at the height of `foot` (3,): a grey sky, and ground that is ten times
    darker but for a disc of radius side_m about it, which is as bright as the sky.
    """
    d = pixel_directions(1024, 512)
    with np.errstate(divide="ignore"):
        reach = foot[1] / np.minimum(d[..., 1], 0.0)
    off = np.hypot(reach * d[..., 0] - foot[0], reach * d[..., 2] - foot[2])
    light = np.where((d[..., 1] > 0.0) | (off < side_m), 1.0, 0.1)
    coarse = reduce_map(np.repeat(light[..., None], 3, axis=-1), COARSE_COLUMNS, COARSE_ROWS)
    return assemble(coarse.astype(np.float32), None, GLOSSY_ROUGHNESS)


_FOOT, _ABOVE = np.array([0.6, -1.2, -1.6]), np.array([0.0, 0.3, 0.0])
_SMALL_M, _PATCH_M = 0.05, 0.3


def test_a_body_is_lit_by_the_ground_below_it_and_not_by_that_below_the_camera() -> None:
    """A ball over the middle of a bright disc of the ground: E = pi (0.1 + 0.9 R^2/(R^2 + h^2)) at its underside."""
    ball = placed(sphere(24, replace(WHITE, base_color=(0.0, 0.0, 0.0, 1.0)), _SMALL_M), tuple(_FOOT + _ABOVE))
    scene = shot(ball, environment=_bright_patch(_FOOT, _PATCH_M), receiver=Receiver(plane_y=_FOOT[1]), sun=None)
    light, down = solved(scene), np.array([0.0, -1.0, 0.0])
    known = light.values[0]
    assert known is not None
    found = known[_nearest_point(light, down), 1] * environment_lookup(scene.environment.ambient, down)[1]
    want = np.pi * (0.1 + 0.9 * _PATCH_M**2 / (_PATCH_M**2 + (_ABOVE[1] - _SMALL_M) ** 2))
    np.testing.assert_allclose(found, want, rtol=tol.LIT_BY_A_PATCH)


def test_metal_reflects_the_ground_below_it_and_not_that_below_the_camera() -> None:
    """The same ball of metal: lobes against integrals over the places that rays meet."""
    metal = Material(base_color=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.3)
    ball = placed(sphere(24, metal, _SMALL_M), tuple(_FOOT + _ABOVE))
    scene = shot(ball, environment=_bright_patch(_FOOT, _PATCH_M), receiver=Receiver(plane_y=_FOOT[1]), sun=None)
    light = solved(scene)
    known, lattice = light.values[0], light.layout.bodies[0].transfer.lattice
    assert known is not None
    place, normal = (lattice.from_samples @ a for a in (ball.to_world(lattice.position), lattice.normal))
    view, d = unit(-place), pixel_directions(256, 128).reshape(-1, 3)
    found, want = [], []
    for point in np.flatnonzero((np.sum(normal * view, axis=-1) > 0.3) & (normal[:, 1] < -0.2))[::5]:
        n_dot_v = normal[[point]] @ view[point]
        axis = lobe_axis(normal[[point]], view[[point]], n_dot_v, np.array([metal.roughness]))
        whole = glossy_lookup(scene.environment.glossy, scene.environment.glossy_roughness, axis, [metal.roughness])
        found.append(whole[0, 1] * known[point, 5] + known[point, 9])
        n_dot_l, n_dot_h = np.maximum(d @ normal[point], 0.0), unit(d + view[point]) @ normal[point]
        alpha = np.full(len(d), metal.roughness**2)
        weight = ggx_distribution(n_dot_h, alpha) * smith_visibility(np.repeat(n_dot_v, len(d)), n_dot_l, alpha)
        weight *= n_dot_l * np.sqrt(1.0 - d[:, 1] ** 2)
        with np.errstate(divide="ignore"):
            reach = (_FOOT[1] - place[point, 1]) / np.minimum(d[:, 1], 0.0)
        met = place[point, [0, 2]] + reach[:, None] * d[:, [0, 2]] - _FOOT[[0, 2]]
        seen = np.where((d[:, 1] > 0.0) | (np.hypot(*met.T) < _PATCH_M), 1.0, 0.1)
        want.append(weight @ seen / weight.sum())
    assert np.max(want) > 0.9
    assert np.sqrt(np.mean(np.subtract(found, want) ** 2)) < tol.REFLECTED_PATCH


def test_turning_everything_changes_nothing() -> None:
    scene = shot(placed(crate(WHITE), (0.2, -1.0, -2.0), (10, 0, 0)), placed(sphere(16, WHITE), (1.2, -0.5, -1.8)),
                 receiver=Receiver(plane_y=-1.0), sun=None)  # fmt: skip
    quarter = np.eye(4)
    quarter[:3, :3] = yaw_matrix(np.pi / 2)
    above = pixel_directions(64, 32)[..., 1:2] > 0.0  # the ground is as bright in all places
    even = replace(scene.environment, residual=np.where(above, scene.environment.residual, 0.1))
    scene = replace(scene, environment=even)
    turned = replace(
        scene,
        objects=tuple(replace(o, world_from_object=quarter @ o.world_from_object) for o in scene.objects),
        environment=replace(
            scene.environment,
            **{name: np.roll(getattr(scene.environment, name), _quarter(quarter), axis=-2)
               for name in ("radiance", "residual", "ambient", "irradiance", "glossy")},
        ),
    )  # fmt: skip
    for one, other in zip(solved(scene).values, solved(turned).values, strict=True):
        assert one is not None
        assert other is not None
        np.testing.assert_allclose(one[:, :4], other[:, :4], atol=tol.TURNED)


def _quarter(turn: Floats) -> int:
    """Return by how many of 64 columns a turn about the vertical moves a panorama."""
    ahead = turn[:3, :3] @ [0.0, 0.0, -1.0]
    return round(np.arctan2(ahead[0], -ahead[2]) / (2.0 * np.pi) * 64)


def test_air_is_the_limit_of_water() -> None:
    scene = shot(placed(crate(WHITE), (0.0, -1.0, -1.6)), receiver=Receiver(plane_y=-1.0))
    thin = replace(medium(absorption=(1e-9, 1e-9, 1e-9)), refractive_index=1.0)
    thin = replace(thin, veil=0.0 * thin.veil)
    air, water = render_layer(scene), render_layer(replace(scene, medium=thin))
    np.testing.assert_allclose(water.radiance, air.radiance, atol=tol.FLOAT32_LOOKUP)
    np.testing.assert_allclose(water.ratio, air.ratio, atol=tol.FLOAT32_LOOKUP)


# --- both renderers ------------------------------------------------------------------------------------------------


def in_crate(width: int = 192) -> Shot:
    """Return a crate with a mirror in it and touching balls on the ground."""
    grey = Material(base_color=(0.7, 0.6, 0.5, 1.0), roughness=0.8)
    mirror = Material(base_color=(0.9, 0.9, 0.9, 1.0), metallic=1.0, roughness=0.2)
    return shot(
        placed(crate(grey), (0.6, -1.0, -1.4), (25, 0, 0)), placed(sphere(16, mirror, 0.15), (0.6, -0.8, -1.4)),
        placed(sphere(24, grey, 0.4), (-0.9, -0.6, -1.6)), placed(sphere(24, grey, 0.4), (-0.1, -0.6, -1.6)),
        placed(quad(Material(base_color=(0.8, 0.1, 0.1, 1.0), double_sided=True)), (-0.5, -0.5, -2.2), (20, 0, 0)),
        receiver=Receiver(plane_y=-1.0), width=width, camera_position=np.array([0.0, 0.4, 0.0]), samples=17,
    )  # fmt: skip


@pytest.mark.skipif(not gl_available(), reason="needs OpenGL 3.3")
def test_the_renderers_agree_on_crate_and_contact() -> None:
    scene = in_crate()
    background = plate(scene.view.width)
    one, other = (
        codes(over_plate(layer, background)) for layer in (render_layer(scene), LayerRenderer().render(scene))
    )
    off = np.abs(one - other)
    assert -10.0 * np.log10(np.mean((off / 255.0) ** 2)) > tol.RENDERERS_PSNR_DB
    assert np.mean(off.max(axis=-1) <= tol.RENDERERS_CODES) > tol.RENDERERS_FRACTION


def over_plate(layer: Layer, background: Floats) -> Floats:
    """Return a layer over a plate without haze."""
    return np.asarray(layer.radiance + (1.0 - layer.alpha[..., None]) * background * layer.ratio)


@pytest.mark.skipif(not gl_available(), reason="needs OpenGL 3.3")
def test_what_is_kept_changes_nothing() -> None:
    scene, renderer = in_crate(96), LayerRenderer()
    moved = replace(
        scene, objects=(*scene.objects[:2], placed(scene.objects[2].mesh, (-0.9, -0.4, -1.9)), *scene.objects[3:])
    )
    first, again = renderer.render(scene), None
    renderer.render(moved)
    again = renderer.render(scene)
    np.testing.assert_array_equal(first.radiance, again.radiance)
    np.testing.assert_array_equal(first.ratio, again.ratio)
    np.testing.assert_array_equal(renderer.render(moved).radiance, LayerRenderer().render(moved).radiance)


# --- samples, directions, disk ---------------------------------------------------------------------------------------


def test_directions_cover_the_sphere_evenly() -> None:
    d = directions()
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1.0, rtol=tol.FLOAT64)
    cosine = np.maximum(d @ d[:40].T, 0.0).sum(axis=0) * SOLID_ANGLE
    np.testing.assert_allclose(cosine, np.pi, rtol=tol.COSINE_SUM)
    assert len(d) == COUNT


def test_points_interpolate_places(rng: np.random.Generator) -> None:
    mesh = box()
    lattice = make_lattice(mesh)
    triangle, weights = rng.integers(0, 12, 500), rng.dirichlet([1.0, 1.0, 1.0], 500)
    points, shares = points_at(lattice.places[triangle], weights)
    place = np.einsum("nk,nkc->nc", shares, (lattice.from_samples @ lattice.position)[points])
    want = np.einsum("nc,nck->nk", weights, mesh.positions[triangle])
    assert shares.min() >= -tol.FLOAT64
    assert np.abs(place - want).max() < tol.POINT_PLACE


def test_a_damaged_file_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MR360UW_CACHE", str(tmp_path))
    mesh = crate(WHITE)
    first = make_transfer(mesh).own
    (path,) = tmp_path.glob("ambient-*.npz")
    whole = path.read_bytes()
    for damage in (b"", whole[: len(whole) // 2], b"not what was written"):
        path.write_bytes(damage)
        again = make_transfer(mesh).own
        np.testing.assert_array_equal(again, first)
        assert path.read_bytes() == whole


def test_nothing_is_made_where_it_is_switched_off() -> None:
    scene = changed(shot(placed(crate(WHITE), (0.0, -1.0, -1.6))), ambient_occlusion=False)
    assert ambient_light(scene, Cache()) is None
    assert ambient_light(shot(), Cache()) is None


def test_bodies_that_do_not_shade_receive_light_alone() -> None:
    ghost = PlacedObject(sphere(16, WHITE), placed(sphere(), (0.0, -0.5, -1.5)).world_from_object, casts_shadow=False)
    layer = render_layer(shot(ghost, receiver=Receiver(plane_y=-1.0)))
    np.testing.assert_array_equal(layer.ratio, 1.0)
