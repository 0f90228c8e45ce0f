# SPDX-License-Identifier: Apache-2.0
"""The compositing formula of `over`, pixel by pixel, compiled."""

from __future__ import annotations

from typing import Any

from mr360uw.jit import exact


@exact
def lay_over(plate: Any, radiance: Any, alpha: Any, ratio: Any, veil: Any, shafts: Any, one: Any, image: Any) -> None:
    """Write the composite (h, w, 3) of a tile over the plate's pixels (h, w, 3).

    shafts: (h, w, 3), or (0, 0, 3) for none. one: 1 in the type that is computed in. Where a tile changes nothing the
    plate is copied bit for bit.
    """
    zero, none = one - one, shafts.shape[0] == 0
    for j in range(alpha.shape[0]):
        for i in range(alpha.shape[1]):
            free = one - alpha[j, i]
            for c in range(3):
                below = plate[j, i, c]
                if ratio[j, i, c] != one:
                    haze = min(veil[j, i, c], below)
                    below = haze + (below - haze) * ratio[j, i, c]
                if not none:
                    below = max(below + shafts[j, i, c], min(below, zero))
                image[j, i, c] = radiance[j, i, c] + free * below
