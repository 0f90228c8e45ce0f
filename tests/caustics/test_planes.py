# SPDX-License-Identifier: Apache-2.0
"""The depths of a scene's planes: fixed, enclosing, and without a jump whatever moves."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mr360uw.base.caustic_lookup import caustic_lookup, mip_levels
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.base.sphere import direction_from_angles
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.settings import PlaneLadder, map_size
from mr360uw.caustics.sun_disc import detail_footprint
from tests.caustics import tolerances as tol
from tests.caustics.seas import SEAS

SUN = direction_from_angles(0.7, np.radians(60.0))
depths = st.floats(-1.0, 60.0)
spans = st.tuples(depths, st.floats(0.0, 10.0)).map(lambda s: (s[0], s[0] + s[1]))


@given(st.lists(spans, min_size=1, max_size=4), st.lists(st.floats(0.0, 60.0), max_size=2), st.integers(2, 12))
def test_planes_ascend_and_enclose(now, flat, most):
    ladder = PlaneLadder.of_scene(now, [b - a for a, b in now], flat, most)
    planes = ladder.around(now)
    assert np.all(np.diff(planes) > 0.0)
    assert planes[0] >= 0.0
    assert planes[0] <= max(min(a for a, _ in now), 0.0) + tol.PLANE_SLACK_M
    assert planes[-1] >= max(b for _, b in now) - tol.PLANE_SLACK_M
    assert set(flat) <= set(planes.tolist())
    assert len(planes) <= max(most, len(set(flat)) + 2)


@given(spans, st.floats(0.0, 20.0), st.integers(2, 8))
def test_no_pose_needs_more_planes_than_were_asked_for(at_first, rise, most):
    low, high = at_first
    ladder = PlaneLadder.of_scene([(low, high + rise)], [high - low], [], most)
    for moved in np.linspace(0.0, rise, 9):
        assert len(ladder.around([(low + moved, high + moved)])) <= most


def test_one_plane_stays_where_it_is():
    assert PlaneLadder.of_scene([(2.0, 6.0)], [1.0], [], 1).around([(2.0, 3.0)]) == [4.0]
    assert PlaneLadder.of_scene([(2.0, 6.0)], [1.0], [7.0], 1).around([(2.0, 3.0)]) == [7.0]


def test_intervals_grow_with_depth():
    planes = PlaneLadder().around([(0.0, 30.0)])
    steps = np.diff(planes)
    assert np.all(np.diff(steps) > 0.0)
    assert 0.2 < steps[0] < 0.5
    assert 1.0 < steps[-1] < 2.0


def light(planes, depth_m, x, z):
    stack = caustic_stack(SEAS["gerstner"], SUN, planes, 0.0, CausticSettings(size=64, grid=48))
    return caustic_lookup(stack, mip_levels(stack.ratio), x, depth_m, z, 0.0)


def test_light_at_a_place_does_not_depend_on_the_pose_of_what_it_falls_on(rng):
    """A body rises past a place and tumbles; another one comes near and leaves."""
    x, z = rng.uniform(-4.0, 4.0, (2, 300))
    ladder = PlaneLadder.of_scene([(2.0, 8.0), (6.0, 9.0)], [2.0, 1.0], [8.2], 6)
    expected = light(ladder.around([(4.0, 5.0)]), 4.6, x, z)
    for span in ((3.1, 4.7), (4.6, 6.6), (4.5, 4.7), (2.0, 8.0)):
        for others in ([], [(7.0, 8.0)], [(4.0, 9.0)]):
            got = light(ladder.around([span, *others]), 4.6, x, z)
            np.testing.assert_allclose(got, expected, rtol=tol.FLOAT64, atol=tol.FLOAT64)


def test_light_on_a_rising_body_changes_evenly(rng):
    """Planes come and go as it rises: in no step does its light change by much more than in the others."""
    x, z = rng.uniform(-4.0, 4.0, (2, 300))
    ladder = PlaneLadder.of_scene([(3.0, 7.0)], [1.0], [], 4)
    middles = np.linspace(6.0, 4.0, 81)
    seen = [light(ladder.around([(m - 0.5, m + 0.5)]), m, x, z) for m in middles]
    counts = {len(ladder.around([(m - 0.5, m + 0.5)])) for m in middles}
    steps = np.array([np.sqrt(np.mean((b - a) ** 2)) for a, b in itertools.pairwise(seen)])
    assert len(counts) > 1
    assert steps.max() < tol.EVEN_STEPS * np.median(steps)


@pytest.mark.parametrize(
    ("footprint_m", "sun_radius_m", "expected"),
    [(0.0, 0.0, 512), (0.04, 0.0, 512), (0.06, 0.0, 256), (0.12, 0.0, 128), (0.0, 0.02, 256), (9.0, 0.0, 16)],
)
def test_maps_are_as_fine_as_pictures_show(footprint_m, sun_radius_m, expected):
    assert map_size(512, 8.0, footprint_m, sun_radius_m) == expected


@pytest.mark.parametrize(("depth_m", "expected"), [(0.3, 512), (3.0, 256), (8.0, 128)])
def test_blurred_maps_are_as_fine_as_their_blur(depth_m, expected):
    sea, overhead = SEAS["blurred"], np.array([0.0, 1.0, 0.0])
    blur_m = float(detail_footprint(overhead, 1.34, sea.blur_slope, depth_m)[0, 0])
    size = map_size(512, 8.0, 0.0, depth_m * SUN_HALF_ANGLE_RAD / 1.34, blur_m)
    assert size == expected
    fine, small = (caustic_stack(sea, overhead, [depth_m], 0.0, CausticSettings(size=n, grid=128)) for n in (512, size))
    x, z = np.random.default_rng(3).uniform(-4.0, 4.0, (2, 4000))
    seen = [caustic_lookup(s, mip_levels(s.ratio), x, depth_m, z, 0.0) for s in (fine, small)]
    assert np.sqrt(np.mean((seen[1] - seen[0]) ** 2)) < tol.SMALLER_MAP_CONTRAST * seen[0].std()


@pytest.mark.parametrize(("footprint_m", "depth_m", "smaller"), [(0.06, 4.0, 256), (0.11, 3.0, 128), (0.02, 6.0, 256)])
def test_a_smaller_map_shows_a_picture_the_same_light(rng, footprint_m, depth_m, smaller):
    x, z = rng.uniform(-4.0, 4.0, (2, 4000))
    size = map_size(512, 8.0, footprint_m, depth_m * SUN_HALF_ANGLE_RAD / REFRACTIVE_INDEX_SEA)
    assert size == smaller
    seen = []
    for n in (512, size):
        stack = caustic_stack(SEAS["gerstner"], SUN, [depth_m], 0.0, CausticSettings(size=n, grid=128))
        seen.append(caustic_lookup(stack, mip_levels(stack.ratio), x, depth_m, z, footprint_m))
    assert seen[1].std() == pytest.approx(seen[0].std(), rel=tol.SMALLER_MAP_CONTRAST)
