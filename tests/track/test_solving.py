# SPDX-License-Identifier: Apache-2.0
"""A clip of known motion, solved from end to end."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.sphere import directions, yaw_matrix
from mr360uw.errors import OutputError, ParameterError
from mr360uw.sample import DiveSettings
from mr360uw.sample.dive import record
from mr360uw.track.camera_track import Measure
from mr360uw.track.tracking import track_shots, verdict

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


def test_shots_are_solved_and_go_on_where_they_stopped(tmp_path: Path, rng: np.random.Generator) -> None:
    pytest.importorskip("pycolmap")
    pictures, position, rotation = between_planes(rng)
    other = [np.broadcast_to(np.linspace(1.0, 0.0, WIDTH)[None, :, None], pictures[0].shape)] * 3
    record(tmp_path / "clip.mp4", iter(pictures + other), Fraction(24), seed=1)
    keep, told = tmp_path / "work", []
    measure = Measure(height_m=-FLOOR_M)

    def tell(done: int, total: int | None) -> None:
        told.append((done, total))

    shots = track_shots(tmp_path / "clip.mp4", measure=measure, keep=keep, progress=tell)
    assert [(shot.start, shot.stop) for shot in shots] == [(0, FRAMES), (FRAMES, FRAMES + 3)]
    assert shots[1].track is None
    assert "frames 8:11 - is too short" in shots[1].problem
    assert all(done <= (total or 0) for done, total in told)
    track = shots[0].track
    assert track is not None
    assert track.kind == "moving"
    assert np.isfinite(track.residual_px).all()
    # a pixel is 0.94 degrees, features are good to a twentieth: 0.05 degrees; 0.2 leave room for drift over the frames
    cosine = 0.5 * (np.einsum("nij,nij->n", track.rotation, rotation) - 1.0)
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 0.2
    # the floor sets the scale; the same tenths of a pixel at 2 m are 7 mm
    assert np.linalg.norm(track.position - position, axis=1).max() < 0.02
    assert track.floor is not None
    assert track.floor.support > 0.9
    # a twentieth of a pixel in both halves of the frames, of a panorama 5.3 times as wide: 0.4; three times that
    assert track.held_out_px is not None
    assert track.slip_px is not None
    assert track.slip_px < track.held_out_px < 1.2

    features = keep / "shot00000000" / "features.db"
    features.unlink()  # would be made again for new matches
    again = track_shots(tmp_path / "clip.mp4", measure=measure, keep=keep)[0].track
    assert again is not None
    assert not features.exists()
    np.testing.assert_array_equal(again.position, track.position)
    np.testing.assert_array_equal(again.rotation, track.rotation)
    with pytest.raises(ParameterError, match="new shots at frames 8"):
        uw.track_camera(tmp_path / "clip.mp4", measure=measure, keep=keep)


def test_light_that_drifts_over_a_camera_at_rest_is_no_path(tmp_path: Path) -> None:
    """Caustics move over the floor of a dive, and boulders do not: taken for a floor that passes by, it swims 1 m."""
    pytest.importorskip("pycolmap")
    track = uw.track_camera(uw.sample_dive(tmp_path, width=768, frames=30).plate)
    assert track.kind == "still"
    np.testing.assert_array_equal(track.position, 0.0)


def test_a_path_that_light_made_is_not_called_good(tmp_path: Path) -> None:
    """Over sand of little texture the caustics are followed; what is seen again half a second later tells."""
    pytest.importorskip("pycolmap")
    track = uw.track_camera(uw.sample_dive(tmp_path, DiveSettings(speed_m_s=0.8), width=768, frames=30).plate)
    assert track.agreed is not None
    assert track.agreed < 0.7
    assert not verdict(track).startswith("good")


def test_a_folder_of_other_files_is_left_alone(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "diary.txt").write_text("mine", "utf-8")
    record(tmp_path / "clip.mp4", iter(np.zeros((4, 64, 128, 3))), Fraction(24), seed=1)
    with pytest.raises(OutputError, match="is no folder that mr360uw made"):
        track_shots(tmp_path / "clip.mp4", keep=tmp_path / "work")
    assert (tmp_path / "work" / "diary.txt").read_text("utf-8") == "mine"
