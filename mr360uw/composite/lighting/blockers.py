# SPDX-License-Identifier: Apache-2.0
"""Shadow rays of the reference renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.raycast.geometry import occluding
from mr360uw.composite.raycast.masked import MaskedScene
from mr360uw.composite.shot import Shot
from mr360uw.rays import RayScene
from mr360uw.types import Floats


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
