# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mr360uw.composite.motion import object_motion, read_camera_track, rotation_matrix
from mr360uw.composite.settings import KeySettings, ObjectSettings
from mr360uw.composite.shot import SceneObject
from mr360uw.errors import ParameterError
from tests.composite import tolerances as tol
from tests.composite.scenes import box

MESH = box((1.0, 1.0, 1.0))
ANGLE = st.floats(-180.0, 180.0)


@settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])  # the physics, not the clock
@given(ANGLE, ANGLE, ANGLE)
def test_rotations_are_rotations(yaw: float, pitch: float, roll: float) -> None:
    matrix = rotation_matrix((yaw, pitch, roll))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=tol.FLOAT64)
    assert np.linalg.det(matrix) > 0.0


def test_what_the_angles_do() -> None:
    forward, right = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(rotation_matrix((90, 0, 0)) @ forward, right, atol=tol.FLOAT64)
    np.testing.assert_allclose(rotation_matrix((0, 90, 0)) @ forward, [0, 1, 0], atol=tol.FLOAT64)
    np.testing.assert_allclose(rotation_matrix((0, 0, 90)) @ right, [0, -1, 0], atol=tol.FLOAT64)


def moving(interpolation: str = "smooth") -> ObjectSettings:
    keys = (
        KeySettings(time_s=0.0, position_m=(0, 0, -2), rotation_deg=(0, 0, 0), scale=1.0),
        KeySettings(time_s=1.0, position_m=(1, 0, -2), rotation_deg=(90, 0, 0), scale=4.0),
        KeySettings(time_s=3.0, position_m=(1, 2, -2), rotation_deg=(180, 0, 0), scale=4.0),
    )
    return ObjectSettings(mesh=Path("a.glb"), key=keys, interpolation=interpolation)


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_keys_are_met_and_nothing_overshoots(interpolation: str) -> None:
    motion = object_motion(moving(interpolation), MESH)
    for key in moving().key:
        at = motion.at(key.time_s)
        np.testing.assert_allclose(at[:3, 3], key.position_m, atol=tol.FLOAT64)
        np.testing.assert_allclose(at[:3, :3] / key.scale, rotation_matrix(key.rotation_deg), atol=tol.FLOAT64)
    path = np.array([motion.at(t)[:3, 3] for t in np.linspace(-1.0, 4.0, 101)])
    assert path.min(axis=0)[0] >= 0.0
    assert np.all(path.max(axis=0) <= np.array([1.0, 2.0, -2.0]) + tol.FLOAT64)
    np.testing.assert_allclose(motion.at(-5.0), motion.at(0.0))
    np.testing.assert_allclose(motion.at(50.0), motion.at(3.0))


def test_rotation_is_even_and_scale_geometric() -> None:
    motion = object_motion(moving("linear"), MESH)
    half = motion.at(0.5)
    np.testing.assert_allclose(half[:3, :3] / 2.0, rotation_matrix((45, 0, 0)), atol=tol.FLOAT64)


def test_keys_must_ascend() -> None:
    keys = (KeySettings(time_s=1.0), KeySettings(time_s=1.0))
    with pytest.raises(ValueError, match="key 1 must be later than key 0"):
        ObjectSettings(mesh=Path("a.glb"), key=keys)


def test_camera_track(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    path.write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n2,4,0,0,0,1,0,0\n")
    track = read_camera_track(path)
    np.testing.assert_allclose(track.at(1.0)[:3, 3], [2.0, 0.0, 0.0], atol=tol.FLOAT64)
    np.testing.assert_allclose(abs(track.at(1.0)[:3, :3] @ [0, 0, -1]), [1, 0, 0], atol=tol.FLOAT64)
    path.write_text("time_s,x,y\n0,1,2\n")
    with pytest.raises(ParameterError, match="columns are missing"):
        read_camera_track(path)
    path.write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n2,4,0,0,0,1,0,1\n")
    with pytest.raises(ParameterError, match=r"length 1 \(got 1.414 in row 2\)"):
        read_camera_track(path)
    with pytest.raises(ParameterError, match="no such file"):
        read_camera_track(tmp_path / "none.csv")


def test_the_top_of_a_body_that_does_not_turn_is_known() -> None:
    """A long one that lies level does not reach the surface; one that turns may."""
    long = box((8.0, 1.0, 1.0))

    def top(*keys: KeySettings, turn: tuple[float, float, float] = (30.0, 0.0, 0.0)) -> float:
        settings = ObjectSettings(mesh="box.glb", position_m=(0, 1, -9), rotation_deg=turn, scale=2.0, key=keys)
        return SceneObject(settings, (long,), object_motion(settings, long)).highest_m(0.0)

    assert top() == pytest.approx(1.0 + 2.0 * 0.5)
    assert top(turn=(0.0, 0.0, 90.0)) == pytest.approx(1.0 + 2.0 * 4.0)
    rises = KeySettings(time_s=0.0, position_m=(0, 1, -9)), KeySettings(time_s=1.0, position_m=(0, 3, -9))
    assert top(*rises) == pytest.approx(3.0 + 2.0 * 0.5)
    turns = rises[0], KeySettings(time_s=1.0, position_m=(0, 3, -9), rotation_deg=(0, 45, 0))
    assert top(*turns) >= 3.0 + 2.0 * np.hypot(4.0, 0.5)
