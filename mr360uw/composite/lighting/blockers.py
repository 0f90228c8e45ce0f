# SPDX-License-Identifier: Apache-2.0
"""Bodies that cast shadows: what they leave of the light along rays of the reference renderer, and bodies in the water.

A surface of alpha a lets 1 - a of the light through, n of them the product (glTF 2.0, section 3.9.4); a mask all or
nothing. In the water a body's clear triangles let the same fraction through everywhere, the mean over the body.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, Same
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.raycast.geometry import gather, occluding, opacity_key, surfaces_along
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.rays import PlacedScene, RayScene
from mr360uw.types import Floats


def casting_bodies(shot: Shot, cache: Cache) -> Bodies:
    """Return the bodies of a shot's objects that cast shadows, in the world. cache: holds them."""
    return cache.of(_in_world, shot.casters, cache)


def _in_world(casters: tuple[PlacedObject, ...], cache: Cache) -> Bodies:
    keep = 2 * len(casters)
    found: list[tuple[RayScene, PlacedObject, float]] = []
    for placed in casters:
        solid, clear = cache.of(_scenes, _shape(placed.mesh), keep=keep)
        found.append((solid, placed, 0.0))
        if len(clear.triangles):
            found.append((clear, placed, cache.of(_mean_passed, _shape(placed.mesh.still), keep=keep)))
    found = [(scene, placed, passed) for scene, placed, passed in found if len(scene.triangles) and passed < 1.0]
    return Bodies(
        tuple(PlacedScene(scene, placed.world_from_object) for scene, placed, _ in found),
        np.array([placed.to_world(placed.mesh.center_m) for _, placed, _ in found]).reshape(-1, 3),
        np.array([placed.mesh.radius_m * placed.scale for _, placed, _ in found]),
        np.array([passed for *_, passed in found]),
    )


def _shape(mesh: Mesh) -> PartOf[Mesh]:
    return PartOf(mesh, Same(mesh.positions), Same(mesh.material), opacity_key(mesh))


def _scenes(shape: PartOf[Mesh]) -> tuple[RayScene, RayScene]:
    """Return the opaque triangles of a mesh and the others."""
    mesh = shape.whole
    opaque = np.array([m.alpha_mode == "OPAQUE" for m in mesh.materials])[mesh.material]
    return RayScene(mesh.positions[opaque]), RayScene(mesh.positions[~opaque])


_ACROSS = 48
"""Parallel rays along each side of the square around a mesh that find what its clear triangles let through."""


def _mean_passed(shape: PartOf[Mesh]) -> float:
    """Return the mean fraction of light that a mesh's clear triangles let through, of rays along its axes that meet
    them.
    """
    mesh = shape.whole
    clear = ClearScene([PlacedObject(mesh, np.eye(4))], np.zeros(3))
    line = ((np.arange(_ACROSS) + 0.5) / _ACROSS * 2.0 - 1.0) * mesh.radius_m
    u, v = (g.ravel() for g in np.meshgrid(line, line))
    origin = np.concatenate([np.roll(np.stack([u, v, 0 * u - 2.0 * mesh.radius_m], -1), k, -1) for k in range(3)])
    rays = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], len(u), axis=0)
    passed, met = clear.passed(origin + mesh.center_m, rays, np.inf)
    return float(passed[met].mean()) if np.any(met) else 1.0


_SHORTEST_M = 1e-6
"""Shortest step [m] behind a surface that lets light through."""


class ClearScene:
    """Triangles of bodies that cast shadows and let light through: those of MASK and BLEND materials."""

    def __init__(self, objects: Sequence[PlacedObject], camera_position: Floats) -> None:
        partial = [p for p in objects if p.casts_shadow and any(m.alpha_mode != "OPAQUE" for m in p.mesh.materials)]
        every = gather(partial, camera_position)
        clear = np.array([m.alpha_mode != "OPAQUE" for m in every.materials], np.bool_)
        self._geometry = every.some(np.flatnonzero(clear[every.material]))
        self._scene = RayScene(self._geometry.positions)

    @property
    def there(self) -> bool:
        """Whether there are any such triangles."""
        return len(self._scene.triangles) > 0

    def passed(self, origins: Floats, directions: Floats, reach_m: Floats | float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the fraction (n,) of the light of rays that they leave within `reach_m` [m], and which rays (n,) meet
        any.
        """
        met = surfaces_along(self._geometry, self._scene, origins, directions, _SHORTEST_M, reach_m)
        passed = np.maximum(1.0 - np.bincount(met.ray, met.part, len(origins)), 0.0)
        return passed, np.bincount(met.ray, minlength=len(origins)) > 0


class Blockers:
    """The triangles of a shot that cast shadows."""

    def __init__(self, shot: Shot) -> None:
        self._opaque = RayScene(occluding(shot.objects, shot.view.position))
        self._clear = ClearScene(shot.objects, shot.view.position)

    @property
    def there(self) -> bool:
        """Whether there is any such triangle."""
        return len(self._opaque.triangles) > 0 or self._clear.there

    def passed(self, start: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> Floats:
        """Return the fraction (n,) of the light of rays that is left within `reach_m` [m] of their start, (n, 3) from
        the camera.
        """
        passed: Floats = np.asarray(~self._opaque.occluded(start, directions, reach_m), np.float64)
        if self._clear.there:
            free = np.flatnonzero(passed)
            reach = np.broadcast_to(reach_m, len(start))[free]
            passed[free] = self._clear.passed(start[free], directions[free], reach)[0]
        return passed
