# SPDX-License-Identifier: Apache-2.0
"""Receivers read from files: meshes and height maps; distance maps are filled in frame by frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mr360uw.composite.mesh.mesh import load_mesh
from mr360uw.composite.motion import rigid, rotation_matrix
from mr360uw.composite.settings import ReceiverSettings
from mr360uw.composite.shot import PlacedObject, Receiver
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import read_data
from mr360uw.reading.limits import PICTURE
from mr360uw.reading.picture_size import picture_size
from mr360uw.shapes import checked
from mr360uw.types import Floats

_MOST_HEIGHTS = 256
"""Heights across a map: finer maps are reduced, for its mesh has two triangles a height."""


@checked
def load_receiver(settings: ReceiverSettings) -> Receiver:
    """Return the receiver of a scene's table; for `kind = "distance"` without a shape, to be filled in each frame.

    Raises `MeshError`.
    """
    plain = Receiver(
        shadow=settings.shadow, occlusion=settings.occlusion, caustics=settings.caustics, extent_m=settings.extent_m
    )
    if settings.kind == "plane":
        return replace(plain, plane_y=settings.height_m)
    if settings.path is None:
        raise MeshError(f"receiver - kind {settings.kind!r} needs a file (got no path) - set receiver.path")
    if settings.kind == "mesh":
        transform = rigid(settings.position_m, rotation_matrix(settings.rotation_deg), settings.scale)
        placed = PlacedObject(load_mesh(settings.path, up="y", outside=settings.outside_files), transform)
        return replace(plain, mesh=placed.to_world(placed.mesh.positions))
    if settings.kind == "height_map":
        return replace(plain, mesh=height_map_triangles(_grey(settings.path), settings))
    return plain


def map_range(grey: Floats, range_m: tuple[float, float]) -> Floats:
    """Return the metres of grey values in [0, 1]."""
    return range_m[0] + (range_m[1] - range_m[0]) * np.asarray(grey, np.float64)


def height_map_triangles(grey: Floats, settings: ReceiverSettings) -> Floats:
    """Return the triangles (T, 3, 3) of a height map (h, w) in [0, 1]: right = +x, down = +z, about `position_m`."""
    import cv2

    rows, columns = (min(n, _MOST_HEIGHTS) for n in grey.shape)
    height = map_range(cv2.resize(np.float32(grey), (columns, rows), interpolation=cv2.INTER_AREA), settings.range_m)
    x = (np.linspace(0.0, 1.0, columns) - 0.5) * settings.size_m[0] + settings.position_m[0]
    z = (np.linspace(0.0, 1.0, rows) - 0.5) * settings.size_m[1] + settings.position_m[2]
    x, z = np.meshgrid(x, z)
    points = np.stack([x, height + settings.position_m[1], z], axis=-1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.concatenate([np.stack([a, d, c], axis=2), np.stack([a, c, b], axis=2)]).reshape(-1, 3, 3)


def _grey(path: Path) -> Floats:
    """Return an image as one channel in [0, 1]; float images (TIFF) keep their values."""
    import cv2

    unusable = f"{path} - cannot be read as an image, or it is cut short - give a PNG or TIFF of one channel"
    data = read_data(path, MeshError)
    size = picture_size(data)
    if size is None:
        raise MeshError(unusable)
    PICTURE.check(str(path), size[0] * size[1], MeshError)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise MeshError(unusable) from error
    if image is None:
        raise MeshError(unusable)
    image = image if image.ndim == 2 else image[..., 0]
    whole = float(np.iinfo(image.dtype).max) if np.issubdtype(image.dtype, np.integer) else 1.0
    heights = np.asarray(image, np.float64) / whole
    if not np.all(np.isfinite(heights)):
        raise MeshError(f"{path} - has heights that are not finite (got NaN or infinity) - fill its holes")
    return heights
