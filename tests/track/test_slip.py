# SPDX-License-Identifier: Apache-2.0
"""How far what is placed by a path slips, as predicted from paths by other features."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mr360uw as uw
from benchmarks.tracks import RATE, Clip, slips
from mr360uw.base.sphere import unit
from mr360uw.sample.dive import record
from mr360uw.track.key_poses import Landmarks, resect
from mr360uw.track.slip import predicted_slip, slip_between
from mr360uw.track.tracking import verdict
from tests.track.test_tracking import made

Path3 = tuple[np.ndarray, np.ndarray]


def swim(count: int = 8) -> Path3:
    """Return positions and rotations of a camera that swims ahead and turns."""
    k = np.arange(count)
    return np.outer(k, [0.05, 0.01, -0.2]), Rotation.from_euler("y", 3.0 * k[:, None], degrees=True).as_matrix()


def test_the_same_path_in_other_axes_and_scale_does_not_slip() -> None:
    position, rotation = swim()
    turn = Rotation.from_euler("xyz", [10.0, 70.0, -20.0], degrees=True).as_matrix()
    other = 3.0 * position @ turn.T + 5.0, turn @ rotation
    np.testing.assert_allclose(slip_between((position, rotation), other, 5.0), 0.0, atol=1e-9)


def test_a_turn_between_two_frames_slips_by_its_angle() -> None:
    _, rotation = swim(2)
    turned = np.stack([rotation[0], rotation[1] @ Rotation.from_euler("y", 1.0, degrees=True).as_matrix()])
    still = np.zeros((2, 3))
    # a level circle of 5 m sqrt(1 - 0.4^2), in two of the four pairs of frames
    expected = 5.0 * np.sqrt(0.84) * 2.0 * np.sin(np.radians(0.5)) * np.sqrt(0.5)
    np.testing.assert_allclose(slip_between((still, rotation), (still, turned), 5.0), expected, rtol=1e-9)


def test_paths_with_too_few_common_frames_say_nothing() -> None:
    position, rotation = swim()
    lost = position.copy()
    lost[3:] = np.nan
    assert slip_between((position, rotation), (lost, rotation), 5.0) == 5.0


def resected(rng: np.random.Generator, noise_rad: float, pull_m_s: float, count: int = 200) -> Path3:
    """Return the path by points on a floor that move by a pull, seen with noise."""
    position, rotation = swim()
    floor = np.column_stack([rng.uniform(-4.0, 4.0, count), np.full(count, -2.0), rng.uniform(-5.0, 3.0, count)])
    eyes, turns = [], []
    for k, (eye, turn) in enumerate(zip(position, rotation, strict=True)):
        seen = unit((floor + np.array([pull_m_s * k / 8.0, 0.0, 0.0]) - eye) @ turn)
        seen = unit(seen + rng.normal(0.0, noise_rad, seen.shape))
        pose = resect(Landmarks(np.zeros((count, 2)), floor, False), seen, eye, turn, 0.05)
        assert pose is not None
        eyes.append(pose[0])
        turns.append(pose[1])
    return np.array(eyes), np.array(turns)


@pytest.mark.parametrize(("noise_rad", "pull_m_s"), [(0.004, 0.0), (0.02, 0.0), (0.004, 0.1)])
def test_the_predicted_slip_is_that_of_noise_and_of_light_that_pulls(
    rng: np.random.Generator, noise_rad: float, pull_m_s: float
) -> None:
    """Coarse features, and all as they were mapped, are pulled by twice as much as fine ones."""
    true, ratios = swim(), []
    for _ in range(5):
        path = resected(rng, noise_rad, pull_m_s)
        others = [resected(rng, noise_rad, pull * pull_m_s) for pull in (2.0, 2.0, 1.0, 1.0)]
        ratios.append(predicted_slip(path, others, 5.0) / slip_between(true, path, 5.0))
    assert 0.5 < np.exp(np.mean(np.log(ratios))) < 2.0


def test_halves_differ_by_twice_the_error_of_both_together() -> None:
    """The median of three measures, where the halves' is neither the least nor the largest."""
    position, rotation = swim()

    def turned(degrees: float) -> Path3:
        about = Rotation.from_euler("y", degrees * np.arange(8)[:, None], degrees=True).as_matrix()
        return position, about @ rotation

    mapped, coarse, half, rest = (turned(one) for one in (0.0, 2.0, 0.5, -0.5))
    found = predicted_slip(turned(0.0), (mapped, coarse, half, rest), 5.0)
    assert found == pytest.approx(0.5 * slip_between(half, rest, 5.0), rel=1e-12)


def test_good_is_what_slips_by_little_of_its_path() -> None:
    track = made()  # over 2.01 m
    for slip_m, word in ((0.02, "good: objects stay in place to 2.0 cm"), (0.06, "usable"), (0.2, "doubtful")):
        assert verdict(replace(track, slip_m=slip_m)).startswith(word)
    assert "to 2.0 cm at 5 m, at best;" in verdict(replace(track, slip_m=0.02, agreed=0.4))


def test_the_verdict_holds_under_a_pattern_that_drifts(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    clip = Clip.of(10)
    times = np.arange(24) / float(RATE)
    record(tmp_path / "clip.mp4", (clip.see(512, t, samples=1)[0] for t in times), RATE, seed=1)
    track = uw.track_camera(tmp_path / "clip.mp4", height_m=clip.height_m)
    poses = [clip.pose(t) for t in times]
    true = np.array([p for p, _ in poses]), np.array([r for _, r in poses])
    slip_m = np.sqrt(np.mean(np.square(slips((track.position, track.rotation), true, clip.height_m))))
    assert track.slip_m is not None
    assert 0.5 < track.slip_m / slip_m < 2.0
