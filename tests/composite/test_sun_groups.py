# SPDX-License-Identifier: Apache-2.0
"""Which fragments of a pixel look for the sun together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from mr360uw.base.cache import Cache, PartOf
from mr360uw.composite.gl.object_pass import SunGroups, sun_groups
from mr360uw.composite.gl.visible_surfaces import find_surfaces
from mr360uw.composite.sampling import frame_areas, pattern
from mr360uw.types import Floats
from tests.composite.scenes import placed, quad, shot


def groups_of(members: list[Any], depths: list[float], sun: Floats, **more: Any) -> SunGroups:
    """Return the groups of fragments of the frame's middle pixel, on walls at some depths that face the camera."""
    objects = [placed(quad(size=20.0), (0.0, 0.0, -depth)) for depth in depths]
    scene, samples = shot(*objects, **more), pattern(65)
    corner = np.array([scene.view.width // 2, scene.view.height // 2])
    nearest = np.array([int(np.flatnonzero(member)[0]) for member in members])
    area = frame_areas(samples.positions, np.array(members), nearest)
    rows = np.column_stack(
        [np.zeros(len(members)), corner + samples.positions[nearest], np.arange(len(members)) % len(depths), area]
    )
    weight = np.array([np.mean(member) for member in members])
    surfaces = find_surfaces(PartOf(scene), objects, Cache())
    part: Any = SimpleNamespace(
        listed=rows, triangle=surfaces.first[rows[:, 3].astype(int)], pixel=np.zeros(len(members), np.int64),
        weight=weight,
    )  # fmt: skip
    return sun_groups(scene, part, surfaces.facets, sun)


def test_fragments_of_one_wall_look_for_the_sun_over_the_area_of_all() -> None:
    position = pattern(65).positions
    members = [position[:, 0] < 0.3, (position[:, 0] >= 0.3) & (position[:, 1] < 0.5)]
    members.append(~(members[0] | members[1]))
    towards_camera = np.array([0.0, 0.0, 1.0])
    together = groups_of(members, [4.0], towards_camera)
    assert together.of.tolist() == [0, 0, 0]
    chosen = int(np.argmax([np.mean(member) for member in members]))
    middle = together.listed[0, 1:3] + together.listed[0, 4:6]
    np.testing.assert_allclose(middle % 1.0, 0.5, atol=1e-9)  # the mean of all samples is the pixel's middle
    whole = frame_areas(pattern(65).positions, np.ones((1, 65), np.bool_), np.zeros(1, np.int64))[0, 2:]
    np.testing.assert_allclose(together.listed[0, 6:], whole, atol=1e-9)
    alone = groups_of(members, [4.0], towards_camera, shading="sample")
    assert alone.of.tolist() == [0, 1, 2]
    np.testing.assert_allclose(
        alone.listed[chosen, 4:], groups_of([members[chosen]], [4.0], towards_camera).listed[0, 4:]
    )


def test_fragments_apart_or_turned_away_look_for_themselves_or_not_at_all() -> None:
    position = pattern(65).positions
    members = [position[:, 0] < 0.5, position[:, 0] >= 0.5]
    behind = np.array([0.0, 0.0, -1.0])
    assert groups_of(members, [4.0, 5.0], -behind).of.tolist() == [0, 1]
    assert groups_of(members, [4.0, 5.0], behind).of.tolist() == [-1, -1]


def test_pixels_between_others_in_full_sun_cast_no_rays_and_those_at_a_shadow_do() -> None:
    wall = placed(quad(size=20.0), (0.0, 0.0, -4.0))
    scene = shot(wall, width=512)
    row, column = (a.ravel() for a in np.mgrid[120:136, 250:266])
    rows = np.zeros((len(row), 9))
    rows[:, 1], rows[:, 2], rows[:, 6], rows[:, 8] = column + 0.5, row + 0.5, 1.0, 1.0
    facets, triangle = find_surfaces(PartOf(scene), [wall], Cache()).facets, np.zeros(len(rows), np.int64)
    part: Any = SimpleNamespace(listed=rows, triangle=triangle, pixel=np.arange(len(rows)), weight=np.ones(len(rows)))
    groups = sun_groups(scene, part, facets, np.array([0.0, 0.0, 1.0]))
    assert np.array_equal(groups.first, (row % 2 == 0) & (column % 2 == 0))
    truth = np.repeat(np.where(column < 256, 1.0, np.where(column == 256, 0.4, 0.0))[:, None], 2, axis=1)
    seen = np.where(groups.first[:, None], truth, -1.0).astype(np.float32)
    left = groups.fill_between(seen)
    at_shadow = np.abs(column - 256) == 1
    outermost = (row == 135) | (column == 265)  # with pixels on one side only
    assert np.array_equal(left, ~groups.first & (at_shadow | (column == 256) | outermost))
    np.testing.assert_array_equal(seen[~left], truth.astype(np.float32)[~left])
