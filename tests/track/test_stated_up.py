# SPDX-License-Identifier: Apache-2.0
"""A track is levelled by the pose that the clip's file states."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mr360uw as uw
from mr360uw.ibl.tilt import level_matrix
from mr360uw.track.camera_track import world_of
from mr360uw.track.tracking import stated_up
from tests.video.clips import write_clip
from tests.video.test_round_trips import mark_posed

TIMES = np.array([0.0, 0.04, 0.08])


def test_the_pose_of_a_file_is_up(tmp_path: Path) -> None:
    """It is that of the camera of a scene; a clip that states none is levelled by its pictures."""
    with uw.open_video(write_clip(tmp_path / "level.mp4", 2)) as clip:
        assert stated_up(clip, TIMES) is None
    with uw.open_video(mark_posed(write_clip(tmp_path / "posed.mp4", 2))) as clip:
        _, pitch, roll = clip.pose_deg
        stated = stated_up(clip, TIMES)
    assert stated is not None
    up, by = stated
    np.testing.assert_allclose(up, np.tile(level_matrix(*np.radians([roll, pitch]).tolist())[1], (3, 1)))
    still = np.tile(np.eye(3), (3, 1, 1))
    world = world_of(np.zeros((3, 3)), still, np.zeros((0, 3)), up, time_s=TIMES, by=by)
    assert world.up == "the pose that its file states"
    np.testing.assert_allclose(world.rotation @ up[0], [0.0, 1.0, 0.0], atol=1e-12)
