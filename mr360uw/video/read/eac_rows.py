# SPDX-License-Identifier: Apache-2.0
"""Rows of cube faces as GoPro's 360 cameras store them: the outer faces hold a strip twice, once by each lens.

A track is a row of three faces. The middle face is seen by one lens. The seam between the lenses runs through the
middle of each outer face, which stores the strip about it twice, side by side; they are blended into one.
Widths of the strip: Bourke 2020.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

DOUBLED_STRIP = {(4096, 1344): 64, (2272, 736): 32}
"""Columns of the strip that an outer face stores twice, for the (columns, rows) of a track. Others: what is left of
three square faces."""


def joined_row(plane: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return three square faces (h, 3 h) of a plane (h, w) of a track whose luma has `size`, (columns, rows).

    Faces of exactly 3:1 have no doubled strip, and are returned as they are.
    """
    import cv2

    height, columns = plane.shape
    across = columns / size[0]
    overlap = round(across * DOUBLED_STRIP.get(size, (size[0] - 3 * size[1]) // 2))
    middle = round(across * size[1])
    outer = (columns - middle) // 2
    if overlap <= 0:
        return plane
    weight = ((np.arange(overlap) + 0.5) / overlap).astype(np.float32)
    faces = [plane[:, outer : outer + middle]]
    for side in (plane[:, :outer], plane[:, outer + middle :]):
        seam = outer // 2
        left, right = side[:, seam - overlap : seam], side[:, seam : seam + overlap]
        blend = np.rint(left * (1.0 - weight) + right * weight).astype(plane.dtype)
        face = np.concatenate([side[:, : seam - overlap], blend, side[:, seam + overlap :]], axis=1)
        faces.append(np.asarray(cv2.resize(face, (middle, height), interpolation=cv2.INTER_LINEAR)))
    return np.concatenate([faces[1], faces[0], faces[2]], axis=1)
