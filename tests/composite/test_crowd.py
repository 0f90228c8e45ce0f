# SPDX-License-Identifier: Apache-2.0
"""Crowds of small bodies: what is folded together or left out, against every pair and every body for itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.base.color import encode
from mr360uw.base.sphere import unit
from mr360uw.composite.ambient import form_factors
from mr360uw.composite.ambient.form_factors import Body
from mr360uw.composite.light_sources import casting_bodies
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shot import PlacedObject, Receiver, Shot
from mr360uw.composite.tiles import over
from mr360uw.medium.shafts import occluders
from mr360uw.medium.shafts.occluders import HALO_TAPS, Bodies, visible_parts
from mr360uw.medium.shafts.single_scattering import BeamPattern
from mr360uw.medium.shafts.sun_beam import shadows_of
from mr360uw.types import Floats, Sun
from tests.composite import tolerances as tol
from tests.composite.scenes import box, environment, placed, shot, sphere

GREY = Material(base_color=(0.7, 0.5, 0.4, 1.0), roughness=1.0)
SUN = Sun(unit([0.3, 0.9, -0.2]), np.ones(3), 0.005, 1.0)


def crowd(count: int, rng: np.random.Generator) -> tuple[PlacedObject, ...]:
    """Return small balls and boxes all round the camera, some of which are close to each other."""
    meshes = sphere(12, GREY, 0.15), box((0.2, 0.15, 0.25), GREY)
    azimuth, away = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(1.2, 3.0, count)
    y = rng.uniform(-1.2, 0.8, count)
    places = np.stack([away * np.sin(azimuth), y, -away * np.cos(azimuth)], axis=-1)
    return tuple(placed(meshes[k % 2], tuple(at)) for k, at in enumerate(places))


def codes(scene: Shot) -> Floats:
    """Return the 8-bit codes of a shot over an even plate."""
    plate = np.full((scene.view.height, scene.view.width, 3), 0.3, np.float32)
    return 255.0 * np.asarray(encode(np.clip(over(plate, render_layer(scene)), 0.0, 1.0), "bt709"))


def test_far_bodies_are_what_rays_between_all_pairs_find(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = shot(*crowd(20, rng), environment=environment(0.3), sun=SUN, receiver=Receiver(plane_y=-1.5))
    found = codes(scene)
    monkeypatch.setattr(form_factors, "near_shares", _all_near)
    change = np.abs(found - codes(scene)).max(axis=-1)
    assert np.mean(change <= 1.0) >= tol.CROWD_WITHIN_ONE_CODE
    assert change.max() <= tol.CROWD_CODES


def _all_near(bodies: Sequence[Body]) -> tuple[Floats, Floats]:
    others = 1.0 - np.eye(len(bodies))
    return others, np.zeros_like(others)


def seen_past(bodies: Bodies, rays: Floats, edge: Floats) -> Floats:
    """Return the visible fraction of the halo in segments of rays from the world's origin."""
    shadows = shadows_of(BeamPattern(SUN, bodies, None, 5.0, 4, 0.1), Cache())
    assert shadows is not None
    seen = np.empty((len(rays), edge.shape[1] - 1))
    _, halo, outlines = shadows
    visible_parts((np.zeros(3), rays), edge[:, :-1], edge[:, 1:], outlines, halo, HALO_TAPS, seen)
    return seen


def test_no_shadow_in_the_water_is_lost_among_many(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one body alone takes light it takes as much among others, and together they take no less than each."""
    bodies = casting_bodies(shot(*crowd(40, rng)), Cache())
    rays = unit(rng.normal(size=(500, 3)))
    edge = np.broadcast_to(np.geomspace(0.2, 20.0, 25), (len(rays), 25)).copy()
    monkeypatch.setattr(occluders, "_WHOLE", 1e9)
    together = seen_past(bodies, rays, edge)
    alone = np.array([
        seen_past(Bodies((body,), *(of[k : k + 1] for of in (bodies.centre, bodies.radius, bodies.passed))), rays, edge)
        for k, body in enumerate(bodies.occluders)
    ])  # fmt: skip
    single = np.count_nonzero(alone < 1.0, axis=0) <= 1
    assert np.any(single & (together < 1.0))
    np.testing.assert_array_equal(together[single], alone.min(axis=0)[single])
    assert np.all(together <= alone.min(axis=0))


def test_smaller_maps_of_many_bodies_show_the_same_shadows(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = casting_bodies(shot(*crowd(40, rng)), Cache())
    rays = unit(rng.normal(size=(2000, 3)))
    edge = np.broadcast_to(np.geomspace(0.2, 20.0, 25), (len(rays), 25)).copy()
    small = seen_past(bodies, rays, edge)
    monkeypatch.setattr(occluders, "_WHOLE", 1e9)
    whole = seen_past(bodies, rays, edge)
    taken = 1.0 - whole.mean()
    assert abs(small.mean() - whole.mean()) < tol.CROWD_SHADOWS * taken
    assert np.sqrt(np.mean((small - whole) ** 2)) < tol.CROWD_SHADOWS_RMS * taken**0.5
