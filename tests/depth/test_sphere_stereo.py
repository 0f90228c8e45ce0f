# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import cv2
import numpy as np
import pytest

from mr360uw.base.sphere import directions
from mr360uw.depth import Panorama, distances
from mr360uw.depth.sphere_stereo import smoothed
from mr360uw.depth.warping import Warped, carried, normalised
from mr360uw.errors import ParameterError
from mr360uw.types import Floats
from tests.depth import tolerances
from tests.depth.hazy_scene import FISH, WATER, HazyScene, relative_error

WIDTH, SMALL, ASIDE, AT_S, REACH_M = 512, 256, 16, 3.0, 1.2


def panoramas(scene: HazyScene, aside: int = ASIDE, width: int = WIDTH) -> tuple[Panorama, list[Panorama]]:
    times = [AT_S + 3.0 * k / aside for k in range(-aside, aside + 1)]
    seen = [Panorama(scene.grey(width, t, samples=1), *scene.pose(t)) for t in times]
    return seen.pop(aside), seen


def confident(scene: HazyScene) -> tuple[Floats, Floats, Floats]:
    """Return the confidences of a frame, the relative errors, and what is seen; check that enough is confident."""
    reference, neighbours = panoramas(scene)
    found = distances(reference, neighbours)
    _, truth, kind = scene.see(WIDTH, AT_S)
    error = relative_error(found.distance_m, truth)
    sure = found.confidence >= 0.5
    assert np.median(error[sure]) < tolerances.MEDIAN
    baseline = max(np.linalg.norm(one.position - reference.position) for one in neighbours)
    reached = (kind < FISH) & (truth < 7.5 * baseline)
    assert np.mean(sure[reached]) > (tolerances.COVERED if scene.caustics == 1.0 else tolerances.COVERED_THRICE)
    assert np.mean(sure[kind == WATER]) < 0.1
    return found.confidence, error, kind


def test_confident_distances_are_right_and_swimming_fish_get_none() -> None:
    confidence, error, kind = confident(HazyScene(seed=3, caustics=1.0, fish=True))
    assert np.mean(error[confidence >= 0.5] < tolerances.WITHIN) > tolerances.RIGHT
    assert np.count_nonzero(kind == FISH) > 50
    assert np.mean(confidence[kind == FISH] >= 0.5) < tolerances.FISH


def test_confident_distances_are_right_under_strong_caustics() -> None:
    confidence, error, _ = confident(HazyScene(seed=11, caustics=3.0))
    assert np.mean(error[confidence >= 0.5] < tolerances.WITHIN) > tolerances.RIGHT


def test_distances_by_wrong_poses_get_no_confidence() -> None:
    """A path that sways by 3 cm about the true one over 2.4 m."""
    scene = HazyScene(seed=15, caustics=1.0)
    reference, neighbours = panoramas(scene)
    swaying = []
    for k, one in zip((k for k in range(-ASIDE, ASIDE + 1) if k), neighbours, strict=True):
        off = 0.03 * np.array([np.sin(4.0 * k / ASIDE), np.sin(5.0 * k / ASIDE + 1.0) - np.sin(1.0), 0.0])
        swaying.append(Panorama(one.grey, one.position + off, one.rotation))
    found = distances(reference, swaying)
    wrong = relative_error(found.distance_m, scene.see(WIDTH, AT_S)[1]) >= tolerances.WITHIN
    assert np.mean(wrong & (found.confidence >= 0.5)) < tolerances.WRONG_BY_POSES


def test_the_cameras_own_rig_gets_no_confidence() -> None:
    """A mottled disc and a stick at the nadir, lit anew in every frame, of a camera that does not turn."""
    scene = HazyScene(seed=302, caustics=1.0)
    object.__setattr__(scene, "turn", 0.0)
    rays, r = directions(WIDTH, WIDTH // 2), np.random.default_rng(5)
    rig = rays[..., 1] < -np.cos(np.radians(22.0))
    rig |= (np.abs(rays[..., 0]) < 0.04) & (rays[..., 2] < 0.0) & (rays[..., 1] < -0.5)
    size, cells = (WIDTH, WIDTH // 2), ((16, 25.0), (4, 12.0), (2, 8.0))
    mottle = 70.0 + sum(a * cv2.resize(r.uniform(-1.0, 1.0, (256 // n, 512 // n)), size) for n, a in cells)
    bare, views = panoramas(scene, aside=8), []
    for k, one in enumerate((bare[0], *bare[1])):
        lit = mottle * (1.0 + 0.1 * np.sin(k)) + np.random.default_rng(k).normal(0.0, 1.5, mottle.shape)
        views.append(Panorama(np.where(rig, lit, one.grey).astype(np.float32), one.position, one.rotation))
    sure = distances(views[0], views[1:]).confidence >= 0.5
    near = cv2.dilate(rig.astype(np.uint8), np.ones((31, 31), np.uint8)) > 0
    _, truth, kind = scene.see(WIDTH, AT_S)
    assert np.mean(sure[rig]) < tolerances.RIG
    assert np.mean(sure[(kind < FISH) & (truth < 7.5 * REACH_M) & ~near]) > tolerances.COVERED_THRICE


def test_distances_are_carried_to_another_place_and_what_comes_into_view_is_behind() -> None:
    scene = HazyScene(seed=14, caustics=0.0, particles=0, noise=0.0)
    views = [Panorama(np.zeros((SMALL // 2, SMALL), np.float32), *scene.pose(t)) for t in (2.0, 2.3)]
    inverse = [(1.0 / scene.see(SMALL, t, samples=1)[1]).astype(np.float32) for t in (2.0, 2.3)]
    seen = carried(inverse[0], views[0], views[1], SMALL)
    near = inverse[1] > 0.0
    assert np.all(seen >= 0.0)
    assert np.mean(np.abs(seen[near] / inverse[1][near] - 1.0) < tolerances.WITHIN) > tolerances.RIGHT


def test_the_unit_of_the_poses_is_that_of_the_distances() -> None:
    reference, neighbours = panoramas(HazyScene(seed=12, caustics=0.0), 2, SMALL)
    metres = distances(reference, neighbours)
    halved = [Panorama(one.grey, 0.5 * one.position, one.rotation) for one in (reference, *neighbours)]
    half = distances(halved[0], halved[1:])
    assert np.allclose(half.distance_m, 0.5 * metres.distance_m, rtol=1e-3)


def test_warped_by_its_own_distances_a_picture_agrees_also_when_the_camera_turns() -> None:
    scene = HazyScene(seed=13, caustics=0.0, particles=0, noise=0.0)
    _, truth, _ = scene.see(SMALL, 2.0)
    inverse = np.where(np.isfinite(truth), 1.0 / truth, 0.0).astype(np.float32)
    views = [Panorama(scene.grey(SMALL, t), *scene.pose(t)) for t in (2.0, 2.6)]
    warped = Warped(views[0], views[1:], SMALL)
    near = np.isfinite(truth)
    right = warped.cost(inverse, 7)[near]
    wrong = warped.cost(inverse + np.float32(0.15), 7)[near]
    assert np.median(right) < 0.3 < 0.8 < np.median(wrong)


def test_windows_close_the_seam_and_smoothing_does_too(rng: np.random.Generator) -> None:
    grey = rng.uniform(0.0, 255.0, (32, 64)).astype(np.float32)
    assert np.allclose(np.roll(normalised(grey), 9, axis=1), normalised(np.roll(grey, 9, axis=1)), atol=1e-3)
    cost = np.ones((8, 16, 12), np.float32)
    cost[:, 3:13, 5] = 0.0  # the surface is seen on both sides of a gap that lies across the seam
    assert np.all(smoothed(cost, 0.05, 0.4).argmin(axis=-1) == 5)


def test_pictures_that_show_no_distances_are_refused() -> None:
    one = Panorama(np.zeros((64, 128), np.float32), np.zeros(3), np.eye(3))
    with pytest.raises(ParameterError, match="stand where the frame does"):
        distances(one, [one])
    with pytest.raises(ParameterError, match="must be of the frame's size"):
        distances(one, [])
    odd = Panorama(np.zeros((64, 64), np.float32), np.ones(3), np.eye(3))
    with pytest.raises(ParameterError, match="twice as wide as high"):
        distances(odd, [odd])
