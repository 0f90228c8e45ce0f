# SPDX-License-Identifier: Apache-2.0
"""Shapes of the receiver: read from files, met by camera rays, and as distance maps.

A distance map is an equirectangular map (h, w) of distances [m] along the rays of a camera; 0, inf and NaN: none.

On a plane n.x = c the inverse distance is linear in the direction d, so it is what is differentiated and interpolated:

    1/r = g.d        g = n/c        the normal towards the camera is -g/|g|
    u = 1/r          g = u d + (du/dlon / cos lat) e_lon + (du/dlat) e_lat        at any direction d

Each texel represents the tangent plane of the surface there. Differences over 2 sin of the step, not the step, are
exact on planes; along a row they span more texels towards the poles, where columns lie close together. If the
differences to the two sides of a texel are far apart, there is an edge, and the smaller difference alone counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.input_files import PICTURE, picture_size, read_data
from mr360uw.base.parameters import checked
from mr360uw.base.rays import RayScene, barycentric
from mr360uw.composite.mesh.mesh import load_mesh
from mr360uw.composite.motion import rigid, rotation_matrix
from mr360uw.composite.settings import ReceiverSettings
from mr360uw.composite.shot import PlacedObject, Receiver, Shot
from mr360uw.errors import MeshError
from mr360uw.jit import exact, exact_making
from mr360uw.types import Floats, View

EDGE_ON = 0.003
"""Cosine between ray and normal below which a distance map's surface is taken to stand edge-on."""
_MOST_HEIGHTS = 256
"""Heights across a map: finer maps are reduced, for its mesh has two triangles a height."""
JUMP = 4.0
"""Ratio of the differences to the two sides of a texel above which the larger one is an edge ..."""
LEAST_JUMP = 0.04
"""... if it is at least this fraction of the inverse distance."""
WIDEST = 16
"""A difference along a row spans at most 1/16 of a turn to each side."""
SMOOTHING_DEG = (21.0, 10.5, 10.5, 5.2, 5.2, 5.2, 2.6, 2.6, 2.6, 1.05, 1.05, 1.05)
"""Widths [degrees] of the running means that smooth the steps of a rounded map. More narrow and fewer wide ones leave
terraces; two boxes a pass, or a Gaussian, mix more across edges."""


def plate_distance(shot: Shot, x: Floats, y: Floats, direction: Floats, cache: Cache) -> Floats:
    """Return the distance (n,) [m] of the plate's surfaces along rays, infinity where the scene does not tell it.

    x, y: (n,) frame coordinates. direction: (n, 3) of the view there, world axes. cache: holds the receiver's shape.
    """
    view, matte = shot.view, shot.holdout_distance_m
    nearest = np.full(len(direction), np.inf)
    if shot.receiver is not None:
        nearest, _ = cache.of(ReceiverShape, shot.receiver, view.position).meet(view, x, y, direction)
    if matte is not None:
        found = matte[np.minimum(y.astype(np.int64), view.height - 1), x.astype(np.int64) % view.width]
        nearest = np.minimum(nearest, found)
    return np.asarray(nearest, np.float64)


class ReceiverShape:
    """Intersection of camera rays with a receiver.

    camera_position: (3,) [m] in the world. level_m: height [m] of a horizontal plane above the camera, None of other
    shapes. extent_m: of `Receiver`.
    """

    def __init__(self, receiver: Receiver, camera_position: Floats) -> None:
        self._scene = RayScene(receiver.mesh - camera_position) if receiver.mesh is not None else None
        self._planes = None if receiver.distance_m is None else touching_planes(receiver.distance_m)
        self.level_m = None if receiver.plane_y is None else float(receiver.plane_y - camera_position[1])
        self.extent_m = receiver.extent_m

    def meet(self, view: View, x: Floats, y: Floats, direction: Floats | None = None) -> tuple[Floats, Floats]:
        """Return (distance (...), infinite where there is no receiver; normal (..., 3) towards the camera).

        direction: (..., 3) of the view at frame coordinates x, y (...), where it is known.
        """
        direction = view.directions(x, y) if direction is None else direction
        start = view.starts(direction)
        if self.level_m is not None:
            with np.errstate(divide="ignore", over="ignore"):
                distance: Floats = (self.level_m - start[..., 1]) / direction[..., 1]
            distance = np.where((distance > 0.0) & np.isfinite(distance), distance, np.inf)
            normal = np.zeros_like(direction)
            normal[..., 1] = -np.sign(self.level_m) if self.level_m else 1.0
        elif self._scene is not None:
            distance, normal = self._meet_mesh(start, direction)
        else:
            distance, normal = self._meet_map(view, x, y, direction)
        return np.where(distance <= self.extent_m, distance, np.inf), normal

    def _meet_mesh(self, start: Floats, direction: Floats) -> tuple[Floats, Floats]:
        assert self._scene is not None
        rays, origin = direction.reshape(-1, 3), start.reshape(-1, 3)
        triangle = self._scene.first_hit(origin, rays)
        hit = triangle >= 0
        distance, normal = np.full(len(rays), np.inf), np.zeros_like(rays)
        corners = self._scene.triangles[triangle[hit]] - origin[hit, None]
        _, distance[hit] = barycentric(corners, rays[hit])
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flat /= np.maximum(np.linalg.norm(flat, axis=-1, keepdims=True), 1e-30)
        normal[hit] = -flat * np.sign(np.sum(flat * rays[hit], -1, keepdims=True))
        return distance.reshape(direction.shape[:-1]), normal.reshape(direction.shape)

    def _meet_map(self, view: View, x: Floats, y: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Return distances and normals of a distance map, from the tangent plane of the nearest texel."""
        assert self._planes is not None
        rows, columns = self._planes.shape[:2]
        i = np.floor(x * columns / view.width).astype(np.int64) % columns
        j = np.clip(np.floor(y * rows / view.height).astype(np.int64), 0, rows - 1)
        plane = np.asarray(self._planes[j, i], np.float64) @ view.world_from_camera.T
        size = np.linalg.norm(plane, axis=-1)
        # a plane nearly along the ray ends within the texel
        inverse = np.maximum(np.sum(plane * direction, -1), EDGE_ON * size)
        seen = size > 0.0
        normal = np.where(seen[..., None], -plane / np.maximum(size, 1e-30)[..., None], -direction)
        return np.where(seen, 1.0 / np.where(seen, inverse, 1.0), np.inf), normal


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


def inverse_distance(distance_m: Floats) -> NDArray[np.float32]:
    """Return 1/distance [1/m] of a map, 0 where it holds no surface."""
    distance = np.asarray(distance_m, np.float32)
    seen = np.isfinite(distance) & (distance > 0.0)
    return np.where(seen, 1.0 / np.where(seen, distance, 1.0), 0.0).astype(np.float32)


@exact
def _difference(before: Any, here: Any, after: Any) -> Any:
    """Return the change from one texel to the next: the mean of both sides, or that of the side without an edge."""
    if before <= 0.0 and after <= 0.0:
        return 0.0
    if before <= 0.0:
        return after - here
    if after <= 0.0:
        return here - before
    left, right = here - before, after - here
    small, large = min(abs(left), abs(right)), max(abs(left), abs(right))
    if large <= max(JUMP * small, LEAST_JUMP * here):
        return 0.5 * (left + right)
    return left if abs(left) < abs(right) else right


@exact_making
def _touching(inverse: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    rows, columns = inverse.shape
    longitude = 2.0 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    right, ahead = np.sin(longitude), np.cos(longitude)
    for j in range(rows):
        latitude = np.pi * (0.5 - (j + 0.5) / rows)
        c, s = np.cos(latitude), np.sin(latitude)
        wide = min(max(int(0.5 / c + 0.5), 1), max(columns // WIDEST, 1))
        across, down = 1.0 / (np.sin(wide * 2.0 * np.pi / columns) * c), 1.0 / np.sin(np.pi / rows)
        for i in range(columns):
            u = inverse[j, i]
            if u > 0.0:
                east = across * _difference(inverse[j, (i - wide) % columns], u, inverse[j, (i + wide) % columns])
                below = inverse[j + 1, i] if j + 1 < rows else np.float32(0.0)
                above = inverse[j - 1, i] if j > 0 else np.float32(0.0)
                north = down * _difference(below, u, above)
                forward = u * c - north * s
                out[j, i, 0] = forward * right[i] + east * ahead[i]
                out[j, i, 1] = u * s + north * c
                out[j, i, 2] = east * right[i] - forward * ahead[i]


def touching_planes(distance_m: Floats) -> NDArray[np.float32]:
    """Return g [1/m] of a map, (h, w, 3) in the camera's axes, 0 where it holds no surface."""
    inverse = inverse_distance(distance_m)
    planes = np.zeros((*inverse.shape, 3), np.float32)
    _touching(inverse, planes)
    return planes


def without_steps(distance_m: Floats, step_m: float) -> Floats:
    """Return a map that was rounded to steps [m], smoothed, everywhere within half a step of its values."""
    inverse = inverse_distance(distance_m)
    seen = inverse > 0.0
    rows = np.flatnonzero(seen.any(axis=1))
    if len(rows) == 0:
        return distance_m
    part = slice(rows[0], rows[-1] + 1)
    inverse, mask, weight = inverse[part], seen[part], seen[part].astype(np.float32)
    distance = np.where(mask, np.asarray(distance_m, np.float32)[part], 1.0)
    low = weight / (distance + 0.5 * step_m)
    high = weight / np.maximum(distance - 0.5 * step_m, 0.1 * step_m)
    smooth = smoothed(inverse, low, high, SMOOTHING_DEG)
    out = np.array(distance_m)
    out[part] = np.where(mask, 1.0 / np.where(mask, smooth, 1.0), out[part])
    return out


def smoothed(
    inverse: NDArray[np.float32], low: Floats, high: Floats, widths_deg: Sequence[float]
) -> NDArray[np.float32]:
    """Return inverse distances (h, w) [1/m], 0 where there is no surface, smoothed within bounds low and high (h, w).

    Running means of these widths [degrees], each clipped to the bounds, which preserves every edge.
    """
    weight = (inverse > 0.0).astype(np.float32)
    widths = [width_px(width_deg, inverse.shape[1]) for width_deg in widths_deg]
    shares = {width: np.maximum(running_mean(weight, width), np.float32(1e-9)) for width in set(widths)}
    for width in widths:
        inverse = np.clip(running_mean(inverse, width) / shares[width], low, high)
    return inverse


def width_px(width_deg: float, columns: int) -> int:
    """Return the odd number of pixels of a panorama with so many columns that is nearest to a width [degrees]."""
    return 2 * round(width_deg / 720.0 * columns) + 1


def running_mean(values: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """Return the means (h, w) over squares of a panorama, periodic over the seam, edge rows repeated."""
    import cv2

    pad = width // 2
    wide = cv2.copyMakeBorder(values, 0, 0, pad, pad, cv2.BORDER_WRAP)
    return np.asarray(cv2.blur(wide, (width, width), borderType=cv2.BORDER_REPLICATE)[:, pad : pad + values.shape[1]])
