# SPDX-License-Identifier: Apache-2.0
"""Bodies that cast shadows: shadow rays of the reference renderer, through alpha masks too, and bodies in the water."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, Same
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.raycast.geometry import base_color, gather, occluding
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.rays import PlacedScene, RayScene, barycentric
from mr360uw.types import Floats


def casting_bodies(shot: Shot, cache: Cache) -> Bodies:
    """Return the opaque parts of a shot's objects that cast shadows, in the world. cache: holds them."""
    return cache.of(_in_world, shot.casters, cache)


def _in_world(casters: tuple[PlacedObject, ...], cache: Cache) -> Bodies:
    scenes = [cache.of(_opaque, _opaque_part(placed.mesh), keep=2 * len(casters)) for placed in casters]
    solid = [(scene, placed) for scene, placed in zip(scenes, casters, strict=True) if len(scene.triangles)]
    return Bodies(
        tuple(PlacedScene(scene, placed.world_from_object) for scene, placed in solid),
        np.array([placed.to_world(placed.mesh.center_m) for _, placed in solid]).reshape(-1, 3),
        np.array([placed.mesh.radius_m * placed.scale for _, placed in solid]),
    )


def _opaque_part(mesh: Mesh) -> PartOf[Mesh]:
    return PartOf(mesh, Same(mesh.positions), Same(mesh.material), tuple(m.alpha_mode for m in mesh.materials))


def _opaque(part: PartOf[Mesh]) -> RayScene:
    mesh = part.whole
    return RayScene(mesh.positions[np.array([m.alpha_mode == "OPAQUE" for m in mesh.materials])[mesh.material]])


_MAXIMUM_HITS = 64
"""Masked triangles that one ray passes at most; it counts as free after that."""


class MaskedScene:
    """Masked triangles of bodies that cast shadows. Masks are read at their finest level: a ray has no width."""

    def __init__(self, objects: Sequence[PlacedObject], camera_position: Floats) -> None:
        masked = [
            placed
            for placed in objects
            if placed.casts_shadow and any(m.alpha_mode == "MASK" for m in placed.mesh.materials)
        ]
        self._geometry = gather(masked, camera_position)
        of_mask = np.array([m.alpha_mode == "MASK" for m in self._geometry.materials], np.bool_)
        self._cutoff = np.array([m.alpha_cutoff for m in self._geometry.materials])
        self._triangle = np.flatnonzero(of_mask[self._geometry.material])
        self._scene = RayScene(self._geometry.positions[self._triangle])

    @property
    def there(self) -> bool:
        """Whether there are any such triangles."""
        return len(self._triangle) > 0

    def occluded(self, origins: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> NDArray[np.bool_]:
        """Return whether each ray (n,) hits a triangle where its mask is closed, within `reach_m` [m]."""
        blocked = np.zeros(len(origins), np.bool_)
        if not self.there:
            return blocked
        active, start, geometry = np.arange(len(origins)), np.array(origins, np.float64), self._geometry
        left = np.array(np.broadcast_to(reach_m, len(origins)), np.float64)
        for _ in range(_MAXIMUM_HITS):
            met = self._scene.first_hit(start[active], directions[active])
            active, triangle = active[met >= 0], self._triangle[met[met >= 0]]
            if len(active) == 0:
                break
            rays = directions[active]
            weights, distance = barycentric(geometry.positions[triangle] - start[active, None], rays)
            alpha = base_color(geometry, triangle, weights, np.zeros((len(active), 2, 2)))[:, 3]
            within = distance < left[active]
            closed = within & (alpha >= self._cutoff[geometry.material[triangle]])
            blocked[active[closed]] = True
            onwards = np.maximum(distance, 0.0) * (1.0 + 4e-6) + 1e-6
            start[active] += onwards[:, None] * rays
            left[active] -= onwards
            active = active[within & ~closed]
        return blocked


class Blockers:
    """The triangles of a shot that cast shadows: opaque ones, and masked ones where their mask is closed."""

    def __init__(self, shot: Shot) -> None:
        self._opaque = RayScene(occluding(shot.objects, shot.view.position))
        self._masked = MaskedScene(shot.objects, shot.view.position)

    @property
    def there(self) -> bool:
        """Whether there is any such triangle."""
        return len(self._opaque.triangles) > 0 or self._masked.there

    def block(self, start: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> NDArray[np.bool_]:
        """Return whether each ray (n,) is blocked within `reach_m` [m] of its start, (n, 3) from the camera."""
        return self._opaque.occluded(start, directions, reach_m) | self._masked.occluded(start, directions, reach_m)
