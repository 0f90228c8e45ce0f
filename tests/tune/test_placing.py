# SPDX-License-Identifier: Apache-2.0
"""Clicks and drags become positions, angles and sizes, by closed forms, and back."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.sphere import yaw_matrix
from mr360uw.composite.motion import rotation_matrix
from mr360uw.composite.shot import Receiver
from mr360uw.errors import ParameterError
from mr360uw.ibl.tilt import level_matrix, roll_pitch
from mr360uw.tune import click_tools as floor
from mr360uw.tune import placing
from mr360uw.tune.placing import Point
from mr360uw.types import View

EXACT = 1e-9
"""Rounding of a dozen operations in double precision at positions of some tens of metres, with room for 1e4 of them."""
CAMERA = View(3840, 1920, np.array([0.4, -1.2, 2.0]), rotation_matrix((35.0, 8.0, -5.0)), 6.0)
LEVEL = View(3840, 1920, np.array([0.0, 0.5, 0.0]), np.eye(3), 6.0)
POINTS = [Point(0.0, 0.0), Point(0.3, -0.6), Point(-3.1, 0.2), Point(2.0, -1.5), Point(-1.0, 1.2)]


def box_hull(low: tuple[float, float, float], high: tuple[float, float, float]) -> np.ndarray:
    """Return triangles whose corners are those of a box; which of them are joined is of no matter for bounds."""
    from mr360uw.composite.mesh.mesh import hull_triangles

    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    return hull_triangles(corners, np.arange(8))


@pytest.mark.parametrize("point", POINTS)
def test_a_point_goes_to_pixels(point: Point) -> None:
    x, y = placing.pixel_of_point(point, 3840, 1920)
    assert (x, y) == pytest.approx(
        (3840 * (point.longitude / (2 * np.pi) + 0.5), 1920 * (0.5 - point.latitude / np.pi))
    )


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("distance", [0.3, 25.0])
def test_click_position_and_where_it_shows_agree(point: Point, distance: float) -> None:
    position = placing.at_distance(CAMERA, point, distance)
    shown, away_m = placing.shown_at(CAMERA, position)
    assert away_m == pytest.approx(distance, abs=EXACT)
    np.testing.assert_allclose(shown.direction, point.direction, atol=EXACT)
    np.testing.assert_allclose(placing.in_camera(CAMERA, position), distance * point.direction, atol=EXACT)


def test_axes_are_right_up_back() -> None:
    np.testing.assert_allclose(placing.at_distance(LEVEL, Point(np.pi / 2, 0.0), 2.0), (2.0, 0.5, 0.0), atol=EXACT)
    np.testing.assert_allclose(placing.at_distance(LEVEL, Point(0.0, 0.0), 2.0), (0.0, 0.5, -2.0), atol=EXACT)
    np.testing.assert_allclose(placing.at_distance(LEVEL, Point(0.0, np.pi / 2), 2.0), (0.0, 2.5, 0.0), atol=EXACT)


@pytest.mark.parametrize("azimuths", [(0.0, 90.0), (-20.0, 40.0, 100.0, 170.0)])
def test_points_of_the_horizon_give_roll_and_pitch(azimuths: tuple[float, ...]) -> None:
    level = level_matrix(np.radians(-7.0), np.radians(12.0))  # world from camera
    clicks = []
    for azimuth in np.radians(azimuths):
        d = level.T @ np.array([np.sin(azimuth), 0.0, -np.cos(azimuth)])
        clicks.append(Point(float(np.arctan2(d[0], -d[2])), float(np.arcsin(d[1]))))
    found = floor.up_of_horizon(clicks, np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(found, level[1], atol=EXACT)
    np.testing.assert_allclose(np.degrees(roll_pitch(found)), (-7.0, 12.0), atol=1e-6)


@pytest.mark.parametrize(
    "points", [POINTS[:1], [Point(0.3, 0.0), Point(0.4, 0.0)], [Point(0.0, 0.0), Point(np.pi, 0.0)]]
)
def test_clicks_that_leave_the_horizon_open_are_refused(points: list[Point]) -> None:
    with pytest.raises(ParameterError, match="two points that are apart"):
        floor.up_of_horizon(points, np.array([0.0, 1.0, 0.0]))


def test_swimming_keeps_the_distance() -> None:
    position = placing.at_distance(CAMERA, POINTS[0], 4.0)
    moved = placing.swim_to(CAMERA, POINTS[2], position)
    assert placing.shown_at(CAMERA, moved)[1] == pytest.approx(4.0, abs=EXACT)


def test_an_object_stands_on_a_plane_with_its_foot_where_it_was_clicked() -> None:
    hull = box_hull((-0.2, -0.5, -0.1), (0.8, 1.0, 0.3))
    rotation, scale = rotation_matrix((40.0, 10.0, 5.0)), 1.7
    receiver = Receiver(plane_y=-3.0)
    point = Point(0.7, -0.8)
    position = placing.stand_at(CAMERA, point, receiver, hull, rotation, scale)
    lowest = np.min((scale * hull.reshape(-1, 3) @ rotation.T + position)[:, 1])
    assert lowest == pytest.approx(-3.0, abs=EXACT)
    shown, _ = placing.shown_at(CAMERA, position + placing.foot(hull, rotation, scale))
    np.testing.assert_allclose(shown.direction, point.direction, atol=EXACT)


def test_a_foot_is_the_middle_of_the_bottom() -> None:
    hull = box_hull((-0.2, -0.5, -0.1), (0.8, 1.0, 0.3))
    np.testing.assert_allclose(placing.foot(hull, np.eye(3), 2.0), (0.6, -1.0, 0.2), atol=EXACT)
    np.testing.assert_allclose(placing.foot(hull, yaw_matrix(np.pi / 2), 1.0), (-0.1, -0.5, 0.3), atol=EXACT)


def test_on_a_slope_the_uphill_edge_touches_and_nothing_sinks() -> None:
    """A slope y = 0.5 x - 3: a cube of half side a touches it with its edge at x + a, 0.5 a above its middle."""
    a = 0.4
    corners = np.array([[x, 0.5 * x - 3.0, z] for x, z in ((-20, -20), (20, -20), (20, 20), (-20, 20))], float)
    receiver = Receiver(mesh=corners[[[0, 1, 2], [0, 2, 3]]])
    hull = box_hull((-a, -a, -a), (a, a, a))
    point = Point(0.4, -0.9)
    clicked = placing.meets(LEVEL, point, receiver)
    assert clicked[1] == pytest.approx(0.5 * clicked[0] - 3.0, abs=EXACT)
    position = placing.stand_at(LEVEL, point, receiver, hull, np.eye(3))
    np.testing.assert_allclose(position - clicked, (0.0, a + 0.5 * a, 0.0), atol=EXACT)


def test_a_ridge_under_a_body_lifts_it_off_its_corners() -> None:
    """A roof with its ridge, of height 0, along z: the cube's bottom rests on the vertices of the ridge."""
    x, z = 3.0, 0.25
    roof = [[(0, 0, -z), (0, 0, z), (s * x, -2.0, z)] for s in (-1, 1)]
    roof += [[(0, 0, -z), (s * x, -2.0, z), (s * x, -2.0, -z)] for s in (-1, 1)]
    down = View(64, 32, np.array([0.1, 3.0, 0.0]))
    hull = box_hull((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    position = placing.stand_at(down, Point(0.0, -np.pi / 2), Receiver(mesh=np.array(roof, float)), hull, np.eye(3))
    np.testing.assert_allclose(position, (0.1, 0.5, 0.0), atol=EXACT)


def test_a_distance_map_gives_the_place() -> None:
    receiver = Receiver(distance_m=np.full((32, 64), 5.0))
    for point in POINTS[:3]:
        away = np.linalg.norm(placing.meets(CAMERA, point, receiver) - CAMERA.position)
        assert away == pytest.approx(5.0, rel=0.01)  # tangent planes of texels 5.6 degrees wide


@pytest.mark.parametrize("point", [Point(0.0, 0.4), Point(0.0, -0.05)])
def test_clicks_beside_the_receiver_are_refused(point: Point) -> None:
    with pytest.raises(ParameterError, match=r"receiver - is not in this direction \(got none within 30 m\)"):
        placing.meets(LEVEL, point, Receiver(plane_y=-3.0))


def test_distances_and_positions_that_make_no_sense_are_refused() -> None:
    for distance in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ParameterError, match="distance"):
            placing.at_distance(LEVEL, POINTS[0], distance)
    with pytest.raises(ParameterError, match="camera's own"):
        placing.shown_at(LEVEL, LEVEL.position)


def test_a_drag_along_the_arm_turns_a_quarter_and_the_near_side_follows() -> None:
    center, arm = Point(0.5, 0.0), 0.2
    start, end = Point(0.5, -arm), Point(0.5 + arm, -arm)
    turned = placing.yaw_by_drag(180.0, center, start, end)
    right = np.arcsin(np.cos(arm) * np.sin(arm))  # from the plane through the centre, up and the camera
    assert turned == pytest.approx(180.0 - 90.0 * right / arm, abs=EXACT)
    assert placing.yaw_by_drag(180.0, center, start, start) == 180.0
    # in front of the camera a nose that points to it goes to the right with the pointer
    nose = yaw_matrix(np.radians(placing.yaw_by_drag(180.0, Point(0.0, 0.0), start, end))) @ (0.0, 0.0, -1.0)
    assert nose[0] > 0.0
    assert placing.yaw_by_drag(180.0, center, start, end, step_deg=15.0) == pytest.approx(90.0)
    assert placing.yaw_by_drag(-170.0, center, start, end) == pytest.approx(190.0 - 90.0 * right / arm, abs=EXACT)


def test_a_drag_of_the_edge_scales_by_tangents() -> None:
    center = Point(1.0, 0.0)
    scaled = placing.scale_by_drag(2.0, center, Point(1.1, 0.0), Point(1.3, 0.0))
    assert scaled == pytest.approx(2.0 * np.tan(0.3) / np.tan(0.1), abs=EXACT)
    assert placing.scale_by_drag(2.0, center, Point(1.1, 0.0), center) > 0.0
    assert np.isfinite(placing.scale_by_drag(2.0, center, center, Point(1.0 + np.pi, 0.0)))


# --- floors ----------------------------------------------------------------------------------------------------------

FLOOR = np.array([(1.0, -4.0, -2.0), (-2.5, -4.0, -1.0), (0.5, -4.0, 6.0)])


def clicks_on(points: np.ndarray, camera: View = CAMERA) -> list[Point]:
    return [placing.shown_at(camera, point)[0] for point in points]


def test_a_known_height_of_the_camera_gives_the_floor() -> None:
    found = floor.floor_from_height(CAMERA, clicks_on(FLOOR), CAMERA.position[1] + 4.0)
    assert found[:2] == pytest.approx((-4.0, 0.0), abs=EXACT)


def test_known_distances_give_the_floor_that_fits_them_best() -> None:
    away = np.linalg.norm(FLOOR - CAMERA.position, axis=-1)
    found = floor.floor_from_distances(CAMERA, clicks_on(FLOOR), away)
    assert found[:2] == pytest.approx((-4.0, 0.0), abs=EXACT)
    wrong = floor.floor_from_distances(CAMERA, clicks_on(FLOOR), away * (1.1, 1.0, 1.0))
    assert wrong[0] == pytest.approx(-4.0 - 0.1 * (CAMERA.position[1] + 4.0) / 3.0, abs=EXACT)
    assert wrong[1] > 0.1


def test_known_lengths_give_the_floor() -> None:
    lengths = np.linalg.norm(np.diff(FLOOR, axis=0), axis=-1)
    found = floor.floor_from_lengths(CAMERA, clicks_on(FLOOR), lengths)
    assert found[:2] == pytest.approx((-4.0, 0.0), abs=EXACT)


def test_floors_without_a_solution_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"point 2 is above the horizon"):
        floor.floor_from_height(LEVEL, [Point(0.0, -0.3), Point(0.0, 0.1)], 2.0)
    with pytest.raises(ParameterError, match="no point is clicked"):
        floor.floor_from_height(LEVEL, [], 2.0)
    with pytest.raises(ParameterError, match="above 0 m"):
        floor.floor_from_height(LEVEL, [Point(0.0, -0.3)], 0.0)
    with pytest.raises(ParameterError, match="need 1 lengths"):
        floor.floor_from_lengths(LEVEL, [Point(0.0, -0.3), Point(0.1, -0.3)], [])
    with pytest.raises(ParameterError, match="are the same"):
        floor.floor_from_lengths(LEVEL, [Point(0.0, -0.3), Point(0.0, -0.3)], [1.0])
