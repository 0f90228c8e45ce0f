# SPDX-License-Identifier: Apache-2.0
"""The floor that is made of a track's points."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.composite.receiver.shape import load_receiver
from mr360uw.composite.settings import ReceiverSettings
from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.track.floor_mesh import fit_height_field
from mr360uw.types import Floats

HEIGHT_M = 2.0
TARGET = 0.03
"""Of the camera's height: what a shadow may be too high or too low."""


def relief(x: Floats, z: Floats) -> Floats:
    return -HEIGHT_M + 0.25 * np.sin(1.3 * x + 0.4) * np.cos(1.1 * z) + 0.05 * x


def level(x: Floats, z: Floats) -> Floats:
    return np.full(np.shape(x), -HEIGHT_M) + 0.1 * z


def points(floor, count: int = 900, wrong: float = 0.2, seed: int = 0) -> Floats:
    """Points of a floor with noise of 5 mm, fish above it among them."""
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(-2.5, 2.5, (2, count))
    y = floor(x, z) + rng.normal(0.0, 0.005, count)
    fish = rng.random(count) < wrong
    y[fish] += rng.uniform(0.3, 1.2, np.count_nonzero(fish))
    return np.stack([x, y, z], axis=1)


def write_track(path: Path, point: Floats, **changed: object) -> Path:
    said = {
        "format": "mr360uw camera track 1", "position_m": [[0.0, 0.0, 0.0], [0.0, 0.0, -0.5]],
        "points_m": np.asarray(point).tolist(), "point_error_px": [0.2] * len(point),
    }  # fmt: skip
    path.write_text(json.dumps({k: v for k, v in (said | changed).items() if v is not None}))
    return path


def test_a_relief_is_found_through_fish(tmp_path) -> None:
    track = write_track(tmp_path / "track.json", points(relief))
    floor = uw.floor_from_track(track)
    assert not floor.flat
    assert floor.camera_m == pytest.approx(HEIGHT_M, abs=0.1)  # of the median point
    x, z = np.meshgrid(np.linspace(-2.0, 2.0, 21), np.linspace(-2.0, 2.0, 21))
    error = floor.height_at(x, z) - relief(x, z)
    assert np.sqrt(np.mean(np.square(error))) < TARGET * HEIGHT_M
    assert 0.1 < floor.outliers < 0.3  # a fifth are fish
    near = np.ix_(np.abs(floor.z_m) <= 2.0, np.abs(floor.x_m) <= 2.0)
    assert np.median(floor.confidence[near]) > 0.5
    assert floor.confidence[np.argmin(np.abs(floor.z_m - 5.0)), np.argmin(np.abs(floor.x_m - 5.0))] < 0.05
    np.testing.assert_array_equal(floor.height_m, uw.floor_from_track(track).height_m)
    receiver = load_receiver(ReceiverSettings(kind="mesh", path=floor.save(tmp_path / "floor.glb")))
    assert receiver.mesh is not None
    assert len(receiver.mesh) == len(floor.faces)
    a, b, c = np.moveaxis(receiver.mesh, 1, 0)
    assert np.all(np.cross(b - a, c - a)[:, 1] > 0.0)  # triangles face the camera
    with pytest.raises(OutputExistsError):
        floor.save(tmp_path / "floor.glb")


def test_a_flat_floor_is_a_plane(tmp_path, run) -> None:
    track = write_track(tmp_path / "track.json", points(level, 300))
    floor = uw.floor_from_track(track)
    assert floor.flat
    assert floor.tilt_deg == pytest.approx(np.degrees(np.arctan(0.1)), abs=0.2)  # 5 mm over 5 m
    x, z = np.array([-8.0, 0.0, 3.0]), np.array([9.0, 0.0, -2.0])
    np.testing.assert_allclose(floor.height_at(x, z), level(x, z), atol=0.02)  # the same noise, at three times as far
    code, out, _ = run("floor", track, "-o", tmp_path / "floor.ply")
    assert code == 0
    assert "a plane, tilt 5.7 degrees" in out
    assert 'kind = "mesh", path = "floor.ply"' in out
    assert load_receiver(ReceiverSettings(kind="mesh", path=tmp_path / "floor.ply")).mesh is not None


def test_holes_are_filled_smoothly_and_are_not_trusted() -> None:
    """A hole of a metre, which a camera's rig hides, in a floor sampled every 10 cm."""
    x, z = (v.ravel() for v in np.meshgrid(np.arange(-1.5, 1.5, 0.1), np.arange(-1.5, 1.5, 0.1)))
    seen = np.hypot(x, z) > 0.5
    floor = np.stack([x, relief(x, z) + HEIGHT_M, z], axis=1)[seen]
    field = fit_height_field(floor, np.ones(len(floor)), 0.15, 0.005)
    row, column = np.argmin(np.abs(field.z_m)), np.argmin(np.abs(field.x_m))
    truth = relief(field.x_m[column], field.z_m[row]) + HEIGHT_M
    assert abs(field.height[row, column] - truth) < TARGET * HEIGHT_M
    assert field.confidence[row, column] < 0.2  # the nearest points, of 2.3 a node, are three nodes away
    assert np.median(field.confidence) > 0.5


BAD = [
    ({"points_m": []}, "points, 900 errors"),
    ({"points_m": [], "point_error_px": []}, "has no points .*camera that moves"),
    ({"points_m": (points(level) * [1, -1, 1]).tolist()}, "no point is below the camera .*height_m by hand"),
    ({"points_m": points(level)[:20].tolist(), "point_error_px": [0.1] * 20}, "too few points .*got (1.|20), at least"),
    ({"point_error_px": [9.0] * 900}, "no point is below"),
    ({"format": "another"}, "is no camera track .*no such format"),
    ({"points_m": [[1.0, 2.0]]}, r"points_m of shape \(1, 2\)"),
    ({"points_m": "many"}, "no numbers at 'points_m'"),
    ({"position_m": None}, "no numbers at 'position_m'"),
]


@pytest.mark.parametrize(("changed", "message"), BAD)
def test_tracks_without_a_floor_are_refused(tmp_path, changed, message) -> None:
    path = write_track(tmp_path / "track.json", points(level), **changed)
    with pytest.raises(ParameterError, match=message):
        uw.floor_from_track(path)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("track.csv", "time_s,x\n", "give the .json"),
        ("track.json", "{", "is no camera track"),
        ("none.json", None, "no such file"),
    ],
)
def test_files_that_are_no_track_are_refused(tmp_path, run, name, text, message) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    code, _, err = run("floor", tmp_path / name, "-o", tmp_path / "floor.glb")
    assert code == 2
    assert message in err
    assert not (tmp_path / "floor.glb").exists()
    code, _, err = run("floor", tmp_path / name, "-o", tmp_path / "floor.stl")
    assert code == 2
    assert "end it in .glb or .ply" in err
