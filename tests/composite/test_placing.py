# SPDX-License-Identifier: Apache-2.0
"""Objects placed in words: by angles and distance, on the floor, facing a side, of a size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw import SceneError, load_scene
from mr360uw.composite import Receiver, SceneObject
from mr360uw.composite.mesh.material import Part
from mr360uw.composite.mesh.mesh import make_mesh
from mr360uw.composite.motion import object_motion
from mr360uw.composite.settings import ObjectSettings
from mr360uw.composite.shot import on_the_floor, receiver_height
from mr360uw.errors import MeshError
from mr360uw.scene.resolved import scene_at
from mr360uw.types import Floats

CORNERS = np.array([[0.0, 1.0, 0.0], [2.0, 1.0, 0.0], [0.0, 4.0, 0.0], [0.0, 1.0, 8.0]])
"""A tetrahedron 2 x 3 x 8, away from the origin of its file; its middle is at (1, 2.5, 4)."""
MESH = make_mesh([Part("one", CORNERS, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))], [])
ROUNDING = 1e-12


def placed(**given: Any) -> SceneObject:
    settings = ObjectSettings(mesh=Path("body.glb"), **given)
    return SceneObject(settings, (MESH,), object_motion(settings, MESH))


def points(body: SceneObject, time_s: float = 0.0) -> Floats:
    return body.at(time_s, 0, np.zeros(3), np.eye(3)).to_world(CORNERS)


def middle(body: SceneObject, time_s: float = 0.0) -> Floats:
    return body.at(time_s, 0, np.zeros(3), np.eye(3)).to_world(MESH.center_m)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"azimuth_deg": 90.0}, (3.0, 0.0, 0.0)),
        ({"azimuth_deg": 0.0, "distance_m": 5.0}, (0.0, 0.0, -5.0)),
        ({"elevation_deg": 30.0, "distance_m": 2.0}, (0.0, 1.0, -np.sqrt(3.0))),
        ({"azimuth_deg": -90.0, "distance_m": 4.0, "rotation_deg": (20.0, 50.0, 10.0), "scale": 3.0}, (-4.0, 0.0, 0.0)),
    ],
)
def test_the_middle_is_where_the_angles_say(given: dict[str, Any], expected: tuple[float, ...]) -> None:
    np.testing.assert_allclose(middle(placed(**given)), expected, atol=ROUNDING)


def test_a_size_is_that_of_the_longest_side() -> None:
    body = placed(size_m=0.4)
    np.testing.assert_allclose(np.ptp(points(body), axis=0).max(), 0.4, rtol=ROUNDING)


@pytest.mark.parametrize(
    ("front", "axis"), [("+z", (0, 0, 1)), ("-z", (0, 0, -1)), ("+x", (1, 0, 0)), ("-x", (-1, 0, 0))]
)
def test_the_front_faces_the_camera_or_a_side(front: Any, axis: tuple[int, int, int]) -> None:
    def ahead(body: SceneObject) -> Floats:
        turned = body.at(0.0, 0, np.zeros(3), np.eye(3)).world_from_object[:3, :3]
        return turned @ np.array(axis) / np.linalg.norm(turned @ axis)

    to_camera = placed(front=front, face="camera", azimuth_deg=40.0, distance_m=6.0)
    np.testing.assert_allclose(ahead(to_camera), -middle(to_camera) / 6.0, atol=ROUNDING)
    np.testing.assert_allclose(ahead(placed(front=front, face=90.0)), (1.0, 0.0, 0.0), atol=ROUNDING)
    turned = placed(front=front, face=0.0, rotation_deg=(90.0, 0.0, 0.0))
    np.testing.assert_allclose(ahead(turned), (1.0, 0.0, 0.0), atol=ROUNDING)
    up = placed(front=front, face=0.0, rotation_deg=(0.0, 90.0, 0.0))
    np.testing.assert_allclose(ahead(up), (0.0, 1.0, 0.0), atol=ROUNDING)


def test_keys_give_places_in_words_too() -> None:
    body = placed(
        azimuth_deg=10.0,
        distance_m=6.0,
        face="camera",
        key=[{"time_s": 0.0, "azimuth_deg": 90.0}, {"time_s": 2.0, "position_m": (0.0, 0.0, -5.0), "face": 0.0}],
    )
    np.testing.assert_allclose(middle(body, 0.0), (6.0, 0.0, 0.0), atol=ROUNDING)
    np.testing.assert_allclose(body.motion.position[1], (0.0, 0.0, -5.0))
    np.testing.assert_allclose(body.motion.rotation[1] @ (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), atol=ROUNDING)


def test_the_lowest_point_stands_on_a_plane_at_every_key() -> None:
    keys = [{"time_s": float(t), "rotation_deg": (0.0, 40.0 * t, 25.0), "scale": 1.0 + t} for t in range(3)]
    body = on_the_floor(placed(stand_on="receiver", azimuth_deg=30.0, key=keys), Receiver(plane_y=-2.0))
    for time_s in range(3):
        np.testing.assert_allclose(points(body, float(time_s))[:, 1].min(), -2.0, atol=ROUNDING)


def test_a_body_stands_on_a_slope_under_its_middle() -> None:
    slope = np.array(
        [
            [[-9.0, -3.0, -9.0], [-9.0, -3.0, 9.0], [9.0, 0.0, -9.0]],
            [[9.0, 0.0, 9.0], [9.0, 0.0, -9.0], [-9.0, -3.0, 9.0]],
        ]
    )
    assert receiver_height(Receiver(mesh=slope), 0.0, 0.5) == pytest.approx(-1.5)
    assert receiver_height(Receiver(mesh=slope), 20.0, 0.0) is None
    body = on_the_floor(placed(stand_on="receiver", azimuth_deg=90.0, distance_m=6.0), Receiver(mesh=slope))
    assert points(body)[:, 1].min() == pytest.approx(-0.5)
    with pytest.raises(MeshError, match="stands on nothing"):
        on_the_floor(placed(stand_on="receiver", position_m=(30.0, 0.0, 0.0)), Receiver(mesh=slope))


FLOOR = "[receiver]\nheight_m = -2.0\n"


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ("azimuth_deg = 10.0\nposition_m = [0.0, 0.0, -3.0]", "azimuth_deg - position_m is given too"),
        ("distance_m = 3.0\nposition_m = [1.0, 0.0, -3.0]", "distance_m - position_m is given too"),
        ("size_m = 2.0\nscale = 1.0", "size_m - scale is given too"),
        ("size_m = 2.0\n[[object.key]]\ntime_s = 0.0\nscale = 2.0", "size_m - key.scale is given too"),
        ("[[object.key]]\ntime_s = 0.0\nazimuth_deg = 1.0\nposition_m = [0.0, 0.0, 1.0]", "azimuth_deg - position_m"),
        ('stand_on = "receiver"', "stand_on - needs a floor of known shape (got receiver none)"),
        ('stand_on = "receiver"\nelevation_deg = 5.0\n' + FLOOR, "elevation_deg - the floor decides its height"),
        ('stand_on = "receiver"\nattach = "camera"\n' + FLOOR, "stand_on - needs an object of the world"),
        ('attach = "surface"\nazimuth_deg = 5.0', "azimuth_deg - is from the camera"),
        ('stand_on = "receiver"\n[receiver]\nkind = "distance"\npath = "p.png"', "(got receiver distance)"),
        ("face = 500.0", "face"),
        (
            'azimuth_deg = 5.0\n[[keys]]\nparameter = "object.0.position_m"\ntime_s = [0.0]\nvalue = [[0.0, 0.0, 1.0]]',
            "azimuth_deg - position_m is given too",
        ),
    ],
)
def test_what_cannot_be_together_is_a_problem(tmp_path: Path, lines: str, problem: str) -> None:
    path = tmp_path / "scene.toml"
    (tmp_path / "p.png").touch()
    path.write_text(f'plate = "p.png"\n[[object]]\nmesh = "body.glb"\n{lines}\n')
    (tmp_path / "body.glb").touch()
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert problem in "\n".join(caught.value.problems)


def test_an_azimuth_can_be_keyed(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    for name in ("p.png", "body.glb"):
        (tmp_path / name).touch()
    keys = '[[keys]]\nparameter = "object.0.azimuth_deg"\ntime_s = [0.0, 2.0]\nvalue = [-20.0, 40.0]\n'
    path.write_text(f'plate = "p.png"\n[[object]]\nmesh = "body.glb"\nazimuth_deg = 0.0\n{keys}')
    scene = scene_at(load_scene(path), 0.0)
    assert scene.objects[0].place_m == pytest.approx(
        (-3.0 * np.sin(np.radians(20.0)), 0.0, -3.0 * np.cos(np.radians(20.0)))
    )
