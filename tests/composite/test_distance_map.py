# SPDX-License-Identifier: Apache-2.0
"""Receivers given as distances: planes, edges, holes and rounded maps, against shapes whose normals are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mr360uw.base.sphere import directions, unit
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.receiver.shape import ReceiverShape, touching_planes, without_steps
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shot import Receiver
from mr360uw.composite.tiles import over
from mr360uw.types import Floats
from tests.composite import tolerances as tol
from tests.composite.scenes import codes, placed, plate, shot, sphere

SIZE = (512, 256)


def plane(normal: Floats, offset: float, d: Floats) -> Floats:
    """Return distances along directions to the plane n.x = offset, infinite where it is not met."""
    with np.errstate(divide="ignore"):
        distance = offset / (d @ normal)
    return np.where((distance > 0.0) & np.isfinite(distance), distance, np.inf)


def room(width: int, height: int) -> tuple[Floats, Floats, Floats]:
    """Return directions, distances and normals of a floor with a slope, a box and a ball on it."""
    d = directions(width, height)
    distance, normal = np.full((height, width), np.inf), np.zeros((height, width, 3))

    def put(found: Floats, towards: Floats) -> None:
        nearer = found < distance
        distance[nearer] = found[nearer]
        normal[nearer] = np.broadcast_to(towards, normal.shape)[nearer]

    floor, slope = np.array([0.0, 1.0, 0.0]), unit([0.3, 1.0, 0.1])
    put(plane(floor, -1.5, d), floor)
    put(plane(slope, -1.9, d), slope)
    low, high = np.array([1.0, -1.5, -4.0]), np.array([2.2, -0.3, -2.8])
    for axis in range(3):
        for corner in (low, high):
            side = np.eye(3)[axis]
            met = plane(side, corner[axis], d)
            point = d * np.where(np.isfinite(met), met, 0.0)[..., None]
            inside = np.all((point > low - 1e-9) & (point < high + 1e-9), axis=-1)
            put(np.where(inside, met, np.inf), -side * np.sign(corner[axis]))
    centre = np.array([-1.5, -1.0, -3.0])
    along = d @ centre
    under = along**2 - centre @ centre + 0.49
    ball = np.where((under > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(under, 0.0)), np.inf)
    put(ball, (d * np.where(np.isfinite(ball), ball, 0.0)[..., None] - centre) / 0.7)
    return d, np.where(distance < 20.0, distance, np.inf), normal


def errors_deg(planes: Floats, normal: Floats, where: Floats) -> Floats:
    """Return the angles between the normals of a map and the true ones."""
    found = -planes[where] / np.linalg.norm(planes[where], axis=-1, keepdims=True)
    return np.degrees(np.arccos(np.clip(np.sum(found * normal[where], -1), -1.0, 1.0)))


@pytest.mark.parametrize("normal", [(0.0, 1.0, 0.0), (0.5, 1.0, -0.3), (1.0, 0.2, 0.4)])
def test_planes_are_exact_up_to_the_poles_and_between_texels(normal: tuple[float, ...]) -> None:
    n = unit(normal)
    map_ = plane(n, -1.5, directions(*SIZE))
    shape = ReceiverShape(Receiver(distance_m=map_, extent_m=1e6), np.zeros(3))
    scene = shot(width=4 * SIZE[0])
    x, y = np.meshgrid(np.arange(0.3, 2048.0, 7.7), np.arange(0.3, 1024.0, 7.7))
    distance, got = shape.meet(scene.view, x, y)
    at = (y * SIZE[1] / 1024).astype(int), (x * SIZE[0] / 2048).astype(int)
    near = map_[at] < 60.0
    truth = plane(n, -1.5, directions(2048, 1024))[y.astype(int), x.astype(int)]
    cosine = -1.5 / distance[near]
    d = np.linalg.norm(got[near], axis=-1)
    np.testing.assert_allclose(d, 1.0, atol=tol.FLOAT32)
    np.testing.assert_allclose(got[near] @ n, 1.0, atol=tol.DISTANCE_NORMAL)
    assert np.all(cosine < 0.0)
    assert np.median(np.abs(distance[near] / truth[near] - 1.0)) < 0.01  # a pixel's corner against its centre
    assert np.array_equal(np.isfinite(distance), np.isfinite(map_[at]))


def test_edges_do_not_bend_normals() -> None:
    """Only texels with an edge on both sides, or in a corner of three surfaces, are wrong."""
    _, distance, normal = room(*SIZE)
    wrong = errors_deg(touching_planes(distance), normal, np.isfinite(distance))
    assert np.mean(wrong < 2.0) > tol.DISTANCE_EDGES


def test_holes_are_holes_and_leave_their_neighbours_alone() -> None:
    d, distance, normal = room(*SIZE)
    holes = distance.copy()
    holes[150:160, 40:60], holes[200, ::7], holes[180:182, 300:310] = 0.0, np.nan, -np.inf
    planes = touching_planes(holes)
    empty = ~(np.isfinite(holes) & (holes > 0.0))
    assert np.array_equal(~np.any(planes, axis=-1), empty)
    beside = np.zeros_like(empty)
    beside[149:161, 39:61] = beside[198:203, :] = True
    wrong = errors_deg(planes, normal, beside & ~empty)
    assert np.mean(wrong < 2.0) > tol.DISTANCE_EDGES
    meet, towards = ReceiverShape(Receiver(distance_m=holes), np.zeros(3)).meet(
        shot(width=SIZE[0]).view, np.arange(SIZE[0]) + 0.5, (np.arange(SIZE[1]) + 0.5)[:, None]
    )
    assert np.array_equal(np.isinf(meet), empty)
    assert np.all(np.sum(towards * d, -1)[~empty] <= 0.0)


@pytest.mark.parametrize(("bits", "far_m"), [(8, 20.0), (8, 8.0), (10, 20.0)])
def test_rounded_maps_are_smoothed_within_half_a_step(bits: int, far_m: float) -> None:
    _, distance, normal = room(2 * SIZE[0], 2 * SIZE[1])
    step = far_m / ((1 << bits) - 1)
    seen = distance < far_m
    rounded = np.where(seen, step * np.round(np.where(seen, distance, 0.0) / step), 0.0)
    smooth = without_steps(rounded, step)
    assert np.array_equal(smooth[~seen], rounded[~seen])
    assert np.abs(smooth - rounded)[seen].max() <= 0.5 * step * (1.0 + tol.FLOAT32_LOOKUP)
    before, after = (errors_deg(touching_planes(m), normal, seen) for m in (rounded, smooth))
    assert after.mean() < tol.ROUNDED_NORMAL_DEG
    assert after.mean() < 0.25 * before.mean()
    moved = np.sqrt(np.mean((smooth - distance)[seen] ** 2))
    assert moved < np.sqrt(np.mean((rounded - distance)[seen] ** 2)) * 1.1


def test_smoothing_closes_over_the_seam() -> None:
    _, distance, _ = room(*SIZE)
    rounded = np.where(np.isfinite(distance), np.round(distance * 12.0) / 12.0, 0.0)
    turned = np.roll(without_steps(np.roll(rounded, 200, axis=1), 1.0 / 12.0), -200, axis=1)
    np.testing.assert_allclose(turned, without_steps(rounded, 1.0 / 12.0), rtol=tol.FLOAT32_LOOKUP)


def floor_map(height_m: float, size: tuple[int, int] = SIZE) -> Floats:
    return plane(np.array([0.0, 1.0, 0.0]), height_m, directions(*size))


def test_a_map_of_a_plane_gives_the_planes_ratio() -> None:
    body = placed(sphere(), (0.1, -0.5, -1.2))
    expected = render_layer(shot(body, receiver=Receiver(plane_y=-1.2, extent_m=8.0))).ratio
    for size in ((512, 256), (128, 64), (96, 48)):
        got = render_layer(shot(body, receiver=Receiver(distance_m=floor_map(-1.2, size), extent_m=8.0))).ratio
        np.testing.assert_allclose(got, expected, atol=tol.MAP_RATIO)
    assert expected.min() < 0.6


@pytest.mark.usefixtures("gl")
def test_renderers_agree_and_follow_a_map_that_changes() -> None:
    """A new receiver each time, as of a video; the first again at the end gives the first again."""
    body = placed(sphere(), (0.1, -0.5, -1.2))
    base = shot(body, receiver=Receiver(distance_m=room(*SIZE)[1]), samples=5)
    renderer = LayerRenderer()
    shots = [replace(base, receiver=Receiver(distance_m=floor_map(h))) for h in (-1.2, -1.0, -0.8)]
    ground = plate(base.view.width)
    images = []
    for scene in (base, *shots, replace(base, receiver=Receiver(distance_m=floor_map(-1.2)))):
        images.append(over(ground, renderer.render(scene)))
        difference = np.abs(codes(images[-1]) - codes(over(ground, render_layer(scene))))
        assert np.mean(difference.max(axis=-1) <= tol.RENDERERS_CODES) >= tol.SHADOW_RIM_FRACTION
    assert np.array_equal(images[1], images[-1])
    assert np.abs(images[1] - images[3]).max() > 0.05
