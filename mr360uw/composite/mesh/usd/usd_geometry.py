# SPDX-License-Identifier: Apache-2.0
"""Meshes of a USD stage, at every place where they are shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from mr360uw.types import Floats


class UsdWalk:
    """Walks the prims of a stage at a UsdTimeCode. note: takes what is not drawn as in the file."""

    def __init__(self, stage: Any, time: Any, note: Callable[[str], None]) -> None:
        from pxr import UsdGeom

        self.stage = stage
        self.time = time
        self.cache = UsdGeom.XformCache(time)
        self._note = note
        self._within: list[Any] = []

    def meshes(self, places: list[Floats]) -> Iterator[tuple[Any, list[Floats]]]:
        """Yield every mesh and where it is shown: transforms (4, 4), for columns, from its own axes.

        places: transforms from the axes of the stage's world.
        """
        from pxr import Usd

        yield from self._meshes(self.stage.GetPseudoRoot(), places, Usd.TraverseInstanceProxies())

    def _meshes(self, root: Any, places: list[Floats], which: Any) -> Iterator[tuple[Any, list[Floats]]]:
        """Yield every mesh below a prim and where it is shown: transforms (4, 4) from its own axes.

        places: transforms from the axes of the stage's world, one for each repetition. which: predicate of the prims.
        """
        from pxr import Usd, UsdGeom

        walk = iter(Usd.PrimRange(root, which))
        for prim in walk:
            if not self._shown(prim):
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.PointInstancer):
                walk.PruneChildren()
                yield from self._instances(UsdGeom.PointInstancer(prim), places)
            elif prim.IsA(UsdGeom.Mesh):
                own = self._world(prim)
                yield prim, [place @ own for place in places]
            elif prim.IsA(UsdGeom.Gprim):
                self._note(f"has a {prim.GetTypeName()}, which is not drawn - convert it to a mesh")

    def _shown(self, prim: Any) -> bool:
        """Return whether a prim is visible, as far as it tells by itself, and meant for the final picture."""
        from pxr import UsdGeom

        imageable = UsdGeom.Imageable(prim)
        if not imageable:
            return True
        hidden = imageable.GetVisibilityAttr().Get(self.time) == UsdGeom.Tokens.invisible
        return not hidden and imageable.GetPurposeAttr().Get() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render, None)

    def _world(self, prim: Any) -> Floats:
        """Return the transform (4, 4), for columns, from a prim's axes to the stage's."""
        from pxr import UsdGeom

        if UsdGeom.Xformable(prim).TransformMightBeTimeVarying():
            self._note("moves - it is drawn as it is first; glTF and the scene's own keys can move it")
        return np.asarray(self.cache.GetLocalToWorldTransform(prim), np.float64).T

    def _instances(self, instancer: Any, places: list[Floats]) -> Iterator[tuple[Any, list[Floats]]]:
        """Yield the meshes of a UsdGeomPointInstancer's prototypes, each with all its places."""
        from pxr import Usd, UsdGeom

        if instancer.GetPath() in self._within:
            raise ValueError(f"{instancer.GetPath()} repeats itself")
        ignored = UsdGeom.PointInstancer.IgnoreMask
        found = instancer.ComputeInstanceTransformsAtTime(
            self.time, self.time, UsdGeom.PointInstancer.IncludeProtoXform, ignored
        )
        transforms = np.asarray(found, np.float64).reshape(-1, 4, 4).swapaxes(1, 2)
        which = np.asarray(instancer.GetProtoIndicesAttr().Get(self.time), np.int64)
        mask = np.asarray(instancer.ComputeMaskAtTime(self.time) or [True] * len(which), bool)
        if len(transforms) != len(which):
            raise ValueError(f"{len(which)} instances with {len(transforms)} transforms")
        own = self._world(instancer.GetPrim())
        any_prim = Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded)
        for number, target in enumerate(instancer.GetPrototypesRel().GetForwardedTargets()):
            root = self.stage.GetPrimAtPath(target)
            if not root:
                raise ValueError(f"no prototype {target}")
            back = np.linalg.inv(self._world(root))
            shown = np.flatnonzero((which == number) & mask)
            moved = [place @ own @ transforms[k] @ back for k in shown for place in places]
            if moved:
                self._within.append(instancer.GetPath())
                yield from self._meshes(root, moved, any_prim)
                self._within.pop()
