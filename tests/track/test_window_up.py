# SPDX-License-Identifier: Apache-2.0
"""Up by Snell's window in the key frames of a tilted camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from mr360uw.base.optics import snell_elevation
from mr360uw.base.sphere import directions, unit
from mr360uw.track.camera_track import window_up, world_of

TILTED = Rotation.from_euler("zx", [12.0, -8.0], degrees=True).as_matrix()
"""From the scene's axes to upright ones."""


def write_frames(folder: Path, window: bool) -> tuple[tuple[Path, ...], np.ndarray]:
    """Write two key frames of a camera that turns, under a window or an even sky; return them and their rotations."""
    turns = np.stack([Rotation.from_euler("y", angle, degrees=True).as_matrix() for angle in (0.0, 50.0)])
    paths = []
    for k, turn in enumerate(turns):
        elevation = np.arcsin(np.clip((directions(256, 128) @ turn.T @ TILTED.T)[..., 1], -1.0, 1.0))
        edge = 0.5 + 0.5 * np.tanh((elevation - snell_elevation()) / np.radians(5.0)) if window else 0.5
        light = 0.05 + 0.05 * np.sin(elevation) + 0.6 * edge
        paths.append(folder / f"{k}.png")
        cv2.imwrite(str(paths[-1]), np.clip(255.0 * light ** (1.0 / 2.2), 0.0, 255.0).astype(np.uint8))
    return tuple(paths), turns


def test_the_window_is_up(tmp_path: Path) -> None:
    paths, turns = write_frames(tmp_path, True)
    up = window_up(paths, turns)
    assert up is not None
    # pixels of the map are 5.6 degrees; the edge of an even window is found to a tenth of one
    assert np.degrees(np.arccos(up @ TILTED[1])) < 0.6
    position = np.outer(np.arange(2.0), [0.0, 0.0, -1.0])
    world = world_of(position, turns, unit(np.ones((3, 3))), None, up)
    np.testing.assert_allclose(world.rotation @ up, [0.0, 1.0, 0.0], atol=1e-12)
    assert "window of light overhead, 14." in world.up  # cos 12 cos 8 degrees
    near = unit(turns[:, :, 1].mean(axis=0) + np.array([0.03, 0.0, 0.0]))
    assert "frames' own up" in world_of(position, turns, np.zeros((0, 3)), None, near).up


def test_an_even_sky_is_no_window(tmp_path: Path) -> None:
    assert window_up(*write_frames(tmp_path, False)) is None


def test_windows_that_disagree_are_none(tmp_path: Path) -> None:
    paths, turns = write_frames(tmp_path, True)
    turns[1] = Rotation.from_euler("x", 20.0, degrees=True).as_matrix() @ turns[1]
    assert window_up(paths, turns) is None
