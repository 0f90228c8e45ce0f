# SPDX-License-Identifier: Apache-2.0
"""What bodies that move keep, and the loops that replace arrays where little can be kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mr360uw.base.cache import version
from mr360uw.base.rays import RayScene, barycentric
from mr360uw.base.sphere import basis
from mr360uw.composite.ambient.mesh_transfer import find_nearest_points, make_lattice, points_at
from mr360uw.composite.gl.shadow_columns import ShadowFrame
from mr360uw.composite.motion import object_motion
from mr360uw.composite.settings import KeySettings, ObjectSettings
from mr360uw.composite.shot import PlacedObject
from tests.composite import tolerances as tol
from tests.composite.scenes import box, placed, sphere


def moved(body: PlacedObject, way: tuple[float, float, float]) -> PlacedObject:
    step = np.eye(4)
    step[:3, 3] = way
    return replace(body, world_from_object=step @ body.world_from_object)


def test_bodies_that_move_without_turning_keep_their_slot_of_the_sun() -> None:
    """Alone and as a group; the slot's extents move along, and turning or another distance within a group does not."""
    axes = basis(np.array([0.3, 0.9, -0.2]))
    ball, card = placed(sphere(8), (0.4, -0.6, -4.2), (-60, 4, 0)), placed(box(), (-1.6, -1.6, -3.2), (70, -5, 0))
    for bodies in ((ball,), (ball, card)):
        frame, way = ShadowFrame(bodies, axes), (0.7, 0.1, -0.3)
        after = ShadowFrame(tuple(moved(body, way) for body in bodies), axes)
        assert version(after.drawn) == version(frame.drawn)
        shift = after.placed(after.extents()) - frame.placed(frame.extents())
        x, y, z = axes @ np.array(way)
        np.testing.assert_allclose(shift, [x, y, 0.0, 0.0, z, z], atol=tol.FLOAT64)
    corners = card.triangles.reshape(-1, 3) @ axes.T
    alone = ShadowFrame((card,), axes)
    np.testing.assert_allclose(
        alone.placed(alone.extents())[4:], [corners[:, 2].min(), corners[:, 2].max()], atol=tol.FLOAT64
    )
    turned = placed(box(), (-1.6, -1.6, -3.2), (71, -5, 0))
    assert version(ShadowFrame((turned,), axes).drawn) != version(alone.drawn)
    apart = ShadowFrame((ball, moved(card, (0.1, 0, 0))), axes)
    assert version(apart.drawn) != version(ShadowFrame((ball, card), axes).drawn)


def test_between_equal_keys_turn_and_scale_are_theirs_to_the_last_bit() -> None:
    keys = tuple(
        KeySettings(time_s=t, position_m=(t, 0, -2), rotation_deg=(23, 7, -11 if t < 2.5 else 40), scale=0.4)
        for t in (0.0, 1.0, 2.0, 3.0)
    )
    motion = object_motion(ObjectSettings(mesh=Path("a.glb"), key=keys, interpolation="smooth"), box())
    linear = [motion.at(t)[:3, :3] for t in (-1.0, 0.0, 0.3, 1.0, 1.77, 2.0)]
    assert all(np.array_equal(one, linear[0]) for one in linear)
    assert not np.array_equal(motion.at(2.5)[:3, :3], linear[0])
    assert np.array_equal(motion.at(3.5), motion.at(3.0))


def test_rays_find_the_point_with_the_largest_share(rng: np.random.Generator) -> None:
    mesh = box()
    scene, lattice = RayScene(mesh.positions), make_lattice(mesh)
    met = rng.integers(0, len(mesh.positions), 200)
    place = np.einsum("nc,nck->nk", rng.dirichlet([1.0, 1.0, 1.0], 200), mesh.positions[met])
    origin = rng.uniform(-3.0, 3.0, (200, 3))
    ray = (place - origin) / np.linalg.norm(place - origin, axis=-1, keepdims=True)
    point, distance, behind = np.empty(200, np.int64), np.empty(200), np.empty(200, np.bool_)
    find_nearest_points(scene.triangles, met, origin, ray, lattice.places, point, distance, behind)
    weights, want = barycentric(scene.triangles[met] - origin[:, None], ray)
    points, shares = points_at(lattice.places[met], weights)
    np.testing.assert_array_equal(point, points[np.arange(200), shares.argmax(axis=1)])
    np.testing.assert_allclose(distance, want)
    np.testing.assert_array_equal(behind, np.sum(scene.normals[met] * ray, axis=-1) > 0.0)
