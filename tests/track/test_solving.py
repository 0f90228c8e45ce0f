# SPDX-License-Identifier: Apache-2.0
"""A clip of known motion, solved from end to end."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

import mr360uw as uw
from mr360uw.sample.recording import record
from mr360uw.sphere import directions, yaw_matrix

WIDTH, FRAMES, FLOOR_M, LID_M = 384, 8, -2.0, 3.0


def between_planes(rng: np.random.Generator) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Return pictures of a camera that swims and turns between a textured floor and a textured lid, and its poses."""
    maps = [
        cv2.resize(rng.random((150, 150)).astype(np.float32), (1200, 1200), interpolation=cv2.INTER_CUBIC) for _ in "ab"
    ]
    position = np.outer(np.arange(FRAMES), [0.03, 0.02, -0.12])
    rotation = np.stack([yaw_matrix(0.03 * k) for k in range(FRAMES)])
    look, pictures = directions(WIDTH, WIDTH // 2), []
    for at, turned in zip(position, rotation, strict=True):
        ray = look @ turned.T
        height = np.where(ray[..., 1] < 0.0, FLOOR_M, LID_M) - at[1]
        distance = np.minimum(height / np.where(np.abs(ray[..., 1]) < 1e-6, 1e-6, ray[..., 1]), 60.0)
        place = ((at + distance[..., None] * ray)[..., [0, 2]] * 40.0 + 600.0).astype(np.float32)
        seen = [cv2.remap(m, place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT) for m in maps]
        grey = np.where(ray[..., 1] < 0.0, *seen)
        grey = 0.3 + (0.9 * np.clip(grey, 0.0, 1.0) - 0.3) * np.exp(-distance / 5.0)
        pictures.append(np.repeat(grey[..., None], 3, axis=-1))
    return pictures, position, rotation


def test_a_path_is_solved(tmp_path: Path, rng: np.random.Generator) -> None:
    pytest.importorskip("pycolmap")
    pictures, position, rotation = between_planes(rng)
    record(tmp_path / "clip.mp4", iter(pictures), Fraction(24), seed=1)
    track = uw.track_camera(tmp_path / "clip.mp4", height_m=-FLOOR_M)
    assert track.kind == "moving"
    assert np.isfinite(track.residual_px).all()
    # a pixel is 0.94 degrees, features are good to a twentieth: 0.05 degrees; 0.2 leave room for drift over the frames
    cosine = 0.5 * (np.einsum("nij,nij->n", track.rotation, rotation) - 1.0)
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 0.2
    # the floor sets the scale; the same tenths of a pixel at 2 m are 7 mm
    assert np.linalg.norm(track.position - position, axis=1).max() < 0.02
    assert track.floor is not None
    assert track.floor.support > 0.9
