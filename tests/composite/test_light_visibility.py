# SPDX-License-Identifier: Apache-2.0
"""Visible fractions of sun and lamps that are traced through columns, beside the rays of the reference renderer."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.cache import Cache, Scratch
from mr360uw.composite.gl.light_visibility import DISC, HALO, footprints_of, visibility_of
from mr360uw.composite.light_sources import Blockers, light_sources
from mr360uw.composite.mesh.material import Material, make_texture
from mr360uw.composite.sampling import WHOLE_PIXEL
from mr360uw.composite.shot import Shot
from mr360uw.types import Floats, Lamp, Sun
from tests.composite import tolerances as tol
from tests.composite.scenes import box, placed, quad, shot, sphere

OVERHEAD = Sun(np.array([0.0, 1.0, 0.0]), np.ones(3), 0.03, 1.0)
AHEAD = np.array([0.0, 0.0, -1.0])
INTENSITY = np.ones(3)


def footprints(points: Floats, normal: Floats | None = None) -> Floats:
    """Return footprints without extent at points (n, 3), of surfaces of a normal (n, 3)."""
    found = np.zeros((len(points), 12))
    found[:, :3], found[:, 9:] = points, 0.0 if normal is None else normal
    return found


def seen_of_all(scene: Shot, points: Floats) -> tuple[Floats, Floats]:
    """Return the visible fractions (n, k) of all lights from points (n, 3), as the columns and as rays find them."""
    visibility = visibility_of(scene, Cache(), Scratch())
    sources = light_sources(scene, Blockers(scene))
    expected = np.stack([source.visibility(points) for source in sources], axis=-1)
    numbers = [DISC] * (len(sources) - len(visibility.lights) + 2) + list(range(HALO + 1, len(visibility.lights)))
    away = [None if k == DISC else visibility.lights[k, 5:8] - points for k in numbers]
    found = [visibility.seen(footprints(points, to), [k])[:, 0] for k, to in zip(numbers, away, strict=True)]
    return np.stack(found, axis=-1), expected


@pytest.mark.parametrize("bodies", ["solid", "masked", "clear", "many"])
def test_places_see_of_sun_and_lamps_what_rays_see(bodies: str, rng: np.random.Generator) -> None:
    """A mask leaves half, a pane .4; more bodies than slots share the last. One lamp is among the bodies, so triangles
    pass beside and behind it.
    """
    halves = np.repeat(np.array([[0], [255]], np.uint8), 8, axis=0).repeat(16, axis=1)
    mask = make_texture(np.stack([halves] * 4, axis=-1), srgb=True)
    material = {
        "masked": Material(alpha_mode="MASK", double_sided=True, base_map=mask),
        "clear": Material(alpha_mode="BLEND", double_sided=True, base_color=(1.0, 1.0, 1.0, 0.6)),
    }.get(bodies)
    objects = [
        placed(sphere(16, material), (0.3, 0.2, -1.6)),
        placed(box((0.8, 0.3, 0.5), material), (-0.6, -0.1, -1.4), (25, 9, 0)),
        placed(quad(material, size=1.5), (0.1, 0.5, -2.4), (0, 70, 0)),
    ]
    if bodies == "many":
        ball = sphere(8, radius=0.15)
        objects = [placed(ball, (0.4 * (k % 8) - 1.4, 0.2, -1.0 - 0.4 * (k // 8))) for k in range(40)]
    lamps = (
        Lamp(np.array([0.9, 1.2, -1.0]), AHEAD, INTENSITY, radius_m=0.05),
        Lamp(np.array([-0.1, 0.25, -1.9]), AHEAD, INTENSITY),
    )
    scene = shot(*objects, width=1024, lamps=lamps)
    points = np.column_stack([rng.uniform(-1.6, 1.6, 3000), np.full(3000, -0.9), rng.uniform(-3.2, -0.6, 3000)])
    found, expected = seen_of_all(scene, points)
    off = np.abs(found - expected)
    assert np.all((expected < 0.9).mean(axis=0) > 0.05)
    assert off.mean() < (tol.COLUMNS_SHARED if bodies == "many" else tol.COLUMNS_MEAN)
    assert np.mean(off > tol.COLUMNS_OFF) < tol.COLUMNS_PART


def test_the_edge_of_a_shadow_is_the_sun_cut_by_a_straight_line() -> None:
    """A sheet 2 m above leaves of the disc, of radius r = 2 tan(.03), the segment on the far side of its edge."""
    sheet = placed(quad(Material(double_sided=True), size=4.0), (-2.0, 1.0, -3.0), (0, 90, 0))
    scene, radius = shot(sheet, width=1024, sun=OVERHEAD, sun_samples=32), 2.0 * np.tan(0.03)
    x = np.linspace(-2.0, 2.0, 201) * radius
    points = np.column_stack([x, np.full(201, -1.0), np.full(201, -3.0)])
    found = visibility_of(scene, Cache(), Scratch()).seen(footprints(points), [DISC])[:, 0]
    s = np.clip(x / radius, -1.0, 1.0)
    exact = 0.5 + (s * np.sqrt(1.0 - s * s) + np.arcsin(s)) / np.pi
    assert np.abs(found - exact).max() < tol.COLUMNS_EDGE
    assert np.all(np.diff(found) > -1e-6)


def test_footprints_of_pixels_are_where_their_rays_meet_the_ground(rng: np.random.Generator) -> None:
    """Their middles and the derivatives by columns and rows, for a camera that is turned."""
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    view = shot(width=512, world_from_camera=turned * np.linalg.det(turned)).view
    corner = np.stack([rng.uniform(0.0, 500.0, 4000), rng.uniform(20.0, 236.0, 4000)], axis=-1)
    down = view.directions(*(corner + 0.5).T)
    corner, down = corner[down[:, 1] < -0.3], down[down[:, 1] < -0.3]
    found = footprints_of(view, corner, np.array(WHOLE_PIXEL), (1, 1.0), -2.0)
    np.testing.assert_allclose(found[:, :3], down * (-2.0 / down[:, 1:2]), rtol=1e-6, atol=1e-6)
    for side, step in ((found[:, 3:6], (1.0, 0.0)), (found[:, 6:9], (0.0, 1.0))):
        beside = view.directions(*(corner + 0.5 + step).T)
        np.testing.assert_allclose(side, beside * (-2.0 / beside[:, 1:2]) - found[:, :3], rtol=1e-5, atol=1e-6)
