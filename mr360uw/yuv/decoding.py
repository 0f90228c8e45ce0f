# SPDX-License-Identifier: Apache-2.0
"""Linear light of decoded planes: of a rectangle of the frame, or in directions of a panorama."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import ColorSpec, in_rec709
from mr360uw.types import Floats, Rectangle, YuvImage
from mr360uw.yuv.coefficients import (
    NEAREST_STEPS,
    coefficients,
    decode_table,
    folded_coefficients,
    nearest_table,
    subsampling,
)
from mr360uw.yuv.decode_kernels import read_directions, read_rectangle


def linear_from_planes(image: YuvImage, rectangle: Rectangle | None = None, wrap: bool = True) -> NDArray[np.float32]:
    """Return a rectangle of the planes (by default all of it) as linear Rec.709, (h, w, 3) float32, not clipped.

    Any chroma format, 8 to 16 bits. wrap: the last column is the neighbour of the first, as in a panorama.
    """
    column, row, width, height = rectangle or (0, 0, *image.y.shape[::-1])
    out = np.empty((height, width, 3), np.float32)
    sx, sy = subsampling(image)
    table = decode_table(image.spec)
    read_rectangle(image.y, image.u, image.v, row, column, sx, sy, wrap, coefficients(image.spec), table, out)
    return in_rec709(out, image.spec)


def linear_in_directions(image: YuvImage, direction: Floats) -> NDArray[np.float32]:
    """Return the linear Rec.709 light (..., 3) of a 4:2:0 panorama in unit directions (..., 3), at least 0."""
    out = np.empty((direction.size // 3, 3), np.float32)
    places = np.ascontiguousarray(direction, np.float64).reshape(-1, 3)
    table, folded = nearest_table(image.spec), folded_coefficients(image.spec)
    read_directions(places, image.y, image.u, image.v, folded, table, NEAREST_STEPS, out)
    return lit_rec709(out, image.spec).reshape(direction.shape)


def lit_rec709(linear: NDArray[np.float32], spec: ColorSpec) -> NDArray[np.float32]:
    """Return linear Rec.709 (..., 3) of a plate's linear light (..., 3) >= 0; colours outside the gamut are cut off."""
    return linear if spec.gamut == "bt709" and spec.mapping is None else np.maximum(in_rec709(linear, spec), 0.0)
