# SPDX-License-Identifier: Apache-2.0
"""Clips of a smooth world in other projections, each by its own formula."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from mr360uw.types import Floats
from tests.video.clips import fill

_X, _Y, _Z = np.eye(3)
# forward, right and down of each cube face, in rows from left to right
EAC_FACES = (
    ((-_X, -_Z, -_Y), (-_Z, _X, -_Y), (_X, _Z, -_Y)),
    ((-_Y, _Z, -_X), (_Z, _Y, -_X), (_Y, -_Z, -_X)),
)


def world(direction: Floats, index: int = 0) -> list[Floats]:
    """Codes of luma and chroma (...) along directions (..., 3): no two directions and frames look the same."""
    x, y, z = np.moveaxis(direction, -1, 0)
    luma = 120.0 + 40.0 * np.sin(3.0 * x + 0.3 * index) + 30.0 * np.cos(2.0 * y + z) + 20.0 * y
    return [luma, 128.0 + 50.0 * x + 10.0 * y, 128.0 + 50.0 * z]


def _centres(count: int) -> Floats:
    return (np.arange(count) + 0.5) * 2.0 / count - 1.0


def equirectangular(width: int) -> Floats:
    lon, lat = np.meshgrid(np.pi * _centres(width), -0.5 * np.pi * _centres(width // 2))
    return np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), -np.cos(lat) * np.cos(lon)], axis=-1)


def fisheye(size: int, fov_deg: float, ahead: bool) -> tuple[Floats, Floats]:
    """Directions (size, size, 3) of an equidistant lens, and whether they are inside of its circle."""
    u, v = np.meshgrid(_centres(size), _centres(size))
    radius = np.hypot(u, v)
    theta = radius * np.radians(0.5 * fov_deg)
    across, along = np.sin(theta) / np.maximum(radius, 1e-9), np.cos(theta)
    sign = 1.0 if ahead else -1.0
    return np.stack([sign * u * across, -v * across, -sign * along], axis=-1), radius <= 1.0


def eac_face(size: int, forward: Floats, right: Floats, down: Floats) -> Floats:
    u, v = np.meshgrid(*(np.tan(0.25 * np.pi * _centres(size)),) * 2)
    look = forward + u[..., None] * right + v[..., None] * down
    return look / np.linalg.norm(look, axis=-1, keepdims=True)


def dual_fisheye(size: int, fov_deg: float, index: int = 0) -> list[Floats]:
    """Planes of both circles, black outside of them; the right one looks ahead."""
    planes: list[list[Floats]] = [[], [], []]
    for ahead in (False, True):
        for k, scale in enumerate((1, 2, 2)):
            look, inside = fisheye(size // scale, fov_deg, ahead)
            planes[k].append(np.where(inside, world(look, index)[k], 128.0 if k else 16.0))
    return [np.concatenate(halves, axis=1) for halves in planes]


def eac_row(size: int, row: int, overlap: int = 0, index: int = 0) -> list[Floats]:
    """Planes of three faces; outer ones store `overlap` columns about their middle twice."""
    planes: list[list[Floats]] = [[], [], []]
    for number, face in enumerate(EAC_FACES[row]):
        for k, scale in enumerate((1, 2, 2)):
            one = world(eac_face(size // scale, *face), index)[k]
            half, more = size // scale // 2, overlap // scale // 2
            twice = np.concatenate([one[:, : half + more], one[:, half - more :]], axis=1)
            planes[k].append(one if number == 1 else twice)
    return [np.concatenate(faces, axis=1) for faces in planes]


def write_tracks(path: Path, tracks: Sequence[Sequence[Sequence[Floats]]], kind: str = "mp4") -> Path:
    """Write tracks of frames of planes without loss."""
    with av.open(str(path), "w", format=kind) as container:
        streams = []
        for frames in tracks:
            stream = container.add_stream("libx264", rate=Fraction(25), options={"qp": "0", "preset": "ultrafast"})
            stream.height, stream.width = frames[0][0].shape
            stream.pix_fmt = "yuv420p"
            streams.append(stream)
        for stream, frames in zip(streams, tracks, strict=True):
            for index, planes in enumerate(frames):
                native = av.VideoFrame(stream.width, stream.height, "yuv420p")
                fill(native, [np.rint(plane).astype(np.uint8) for plane in planes])
                native.pts, native.time_base = index, Fraction(1, 25)
                container.mux(stream.encode(native))
            container.mux(stream.encode(None))
    return path
