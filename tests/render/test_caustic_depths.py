# SPDX-License-Identifier: Apache-2.0
"""What a scene's caustics are made for: the depths of all its time, the finest picture of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.caustics import caustic_stack, refract_to_air
from mr360uw.composite import Shot, load_object, load_receiver
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import load
from mr360uw.render.plan import CausticDepths
from mr360uw.render.surroundings import CameraPath
from mr360uw.types import Floats, View
from mr360uw.video import VideoFrame
from tests.caustics import tolerances as tol
from tests.composite.scenes import environment
from tests.scenes import BACKENDS, gradient_plate, scene_with

RISING = {
    "position_m": [0.0, -3.0, -3.0],
    "key": [
        {"time_s": 0.0, "position_m": [0.0, -3.0, -3.0], "rotation_deg": [0.0, 0.0, 0.0]},
        {"time_s": 1.0, "position_m": [0.5, 0.0, -3.0], "rotation_deg": [60.0, 20.0, 0.0]},
        {"time_s": 2.0, "position_m": [0.5, 1.0, -6.0], "rotation_deg": [90.0, 20.0, 30.0]},
    ],
}
CAMERA = {"depth_m": 5.0}


class Moving:
    """A scene's caustic depths, and its shots without light."""

    def __init__(
        self,
        folder: Path,
        mesh: Path,
        objects: list[dict[str, Any]],
        height: int = 960,
        relief: bool = False,
        **tables: Any,
    ):
        objects = [{"mesh": str(mesh)} | table for table in objects]
        scene = scene_with(folder, None, object=objects, **{"camera": CAMERA} | tables)
        self.objects = tuple(load_object(settings) for settings in scene.objects)
        receiver = load_receiver(scene.receiver) if scene.receiver is not None else None
        self.depths = CausticDepths.of(scene, self.objects, receiver, CameraPath.of(scene), height, relief=relief)

    def planes(self, time_s: float) -> tuple[Floats, list[tuple[float, float]]]:
        """Return the planes of a time, and the depths that each object takes up."""
        placed = tuple(o.at(time_s, 0, np.zeros(3), np.eye(3)) for o in self.objects)
        planes = self.depths.planes(Shot(View(64, 32, surface_y_m=5.0), placed, environment()))
        depths = [5.0 - p.to_world(p.mesh.positions)[..., 1] for p in placed]
        return planes, [(float(d.min()), float(d.max())) for d in depths]


def test_a_rising_body_has_planes_about_it_at_all_times(tmp_path: Path, whale: Path) -> None:
    scene = Moving(tmp_path, whale, [RISING, {"position_m": [1.0, -2.0, -3.0]}], caustics={"planes": 6})
    together: set[float] = set()
    for time_s in np.linspace(0.0, 2.0, 21):
        planes, spans = scene.planes(time_s)
        together.update(np.round(planes, 9).tolist())
        assert len(planes) <= 6
        assert planes[0] <= min(least for least, _ in spans) + tol.PLANE_SLACK_M
        assert planes[-1] >= max(greatest for _, greatest in spans) - tol.PLANE_SLACK_M
    assert len(together) < 20  # of one ladder, not some of each frame's own


def test_a_still_scene_keeps_to_what_it_needs(tmp_path: Path, whale: Path) -> None:
    planes, spans = Moving(tmp_path, whale, [{"position_m": [0.0, 0.0, -3.0]}]).planes(0.0)
    assert (planes[0], planes[-1]) == pytest.approx(spans[0], abs=tol.PLANE_SLACK_M)
    assert 2 <= len(planes) <= 4


@pytest.mark.parametrize(("wanted", "there"), [(True, True), (False, False)])
def test_a_flat_receiver_of_caustics_has_its_own_plane(tmp_path: Path, whale: Path, wanted: bool, there: bool) -> None:
    receiver = {"height_m": -4.2, "caustics": wanted}
    planes, _ = Moving(tmp_path, whale, [{"position_m": [0.0, 0.0, -3.0]}], receiver=receiver).planes(0.0)
    assert (np.abs(planes - 9.2).min() < tol.PLANE_SLACK_M) == there


@pytest.mark.parametrize(
    ("objects", "height", "expected"),
    [
        ([{"position_m": [0.0, 1.0, -3.0]}], 1920, 512),
        ([{"position_m": [0.0, -3.0, -3.0]}], 1920, 256),  # the sun's image is wide down there
        ([{"position_m": [0.0, 1.0, -25.0]}], 540, 128),
        ([{"position_m": [0.0, 1.0, -25.0]}, {"position_m": [0.0, 1.0, -3.0]}], 540, 512),
        ([{"position_m": [0.0, 1.0, -25.0], "key": [{"time_s": 0.0}, {"time_s": 1.0, "position_m": [0, 1, -3.0]}]}],
         540, 512),
        ([{"position_m": [0.0, 1.0, -3.0], "attach": "camera"}], 1920, 512),
    ],
)  # fmt: skip
def test_maps_are_as_fine_as_the_nearest_picture_of_the_scene(
    tmp_path: Path, whale: Path, objects: list[dict[str, Any]], height: int, expected: int
) -> None:
    assert Moving(tmp_path, whale, objects, height, sea={"detail_slope": 0.0}).depths.settings.size == expected


def test_relief_on_a_floor_has_planes_up_to_the_camera(tmp_path: Path, whale: Path) -> None:
    """Rocks of the plate's depth rise from the floor, no one knows how far."""
    body, floor = [{"position_m": [0.0, -3.5, -3.0]}], {"height_m": -4.2, "caustics": True}
    flat, rough = (
        Moving(tmp_path, whale, body, relief=relief, receiver=floor).planes(0.0)[0] for relief in (False, True)
    )
    assert flat[0] > 6.0
    assert rough[0] <= 5.0 + tol.PLANE_SLACK_M
    assert rough[-1] >= 9.2 - tol.PLANE_SLACK_M


def test_maps_of_a_blurred_sea_are_smaller(tmp_path: Path, whale: Path) -> None:
    assert Moving(tmp_path, whale, [{"position_m": [0.0, -1.0, -3.0]}], 1920).depths.settings.size == 128


def test_a_camera_that_comes_near_sees_fine_maps(tmp_path: Path, whale: Path) -> None:
    track = tmp_path / "track.csv"
    track.write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,-20,0,0,0,1\n")
    far = [{"position_m": [0.0, 1.0, -25.0]}]
    moving = Moving(tmp_path, whale, far, 540, camera=CAMERA | {"track": str(track)})
    assert moving.depths.settings.size > Moving(tmp_path, whale, far, 540).depths.settings.size


@pytest.mark.parametrize("backend", BACKENDS)
def test_light_bends_by_the_index_of_the_scenes_water(
    tmp_path: Path, whale: Path, backend: str, request: pytest.FixtureRequest
) -> None:
    if backend == "gl":
        request.getfixturevalue("gl")
    tables: dict[str, Any] = {
        "light": {"sun": "given", "sun_azimuth_deg": 30.0, "sun_elevation_deg": 60.0},
        "caustics": {"size": 64, "grid": 32, "planes": 2},
    }
    scene = scene_with(tmp_path, whale, water={"refractive_index": 1.5}, **tables)
    loaded, (renderer, _) = load(scene, 64, 32, clip=False), make_backend(backend)
    plate = VideoFrame.of_linear(gradient_plate(64, 32), time_s=0.3)
    frame = composite_frame(loaded, ClipAnalysis(), renderer, plate, 0.0)
    got = frame.caustics
    assert got is not None
    assert frame.light is not None
    sun = frame.light.environment.sun
    assert sun is not None
    np.testing.assert_allclose(got.sun_direction, sun.direction, atol=tol.SNELL_ROUND_TRIP)
    assert frame.medium is not None
    assert frame.medium.refractive_index == 1.5
    assert loaded.surroundings.medium is not None
    assert loaded.surroundings.medium.model.field.refractive_index == 1.5
    settings = scene.caustics.model_copy(update={"size": got.ratio.shape[1]})
    expected = caustic_stack(scene.sea, refract_to_air(sun.direction, 1.5), got.depth_m, 0.3, settings, 1.5)
    error = np.sqrt(np.mean((got.ratio - expected.ratio) ** 2)) / expected.ratio.std()
    assert error < tol.CAUSTICS_AGREEMENT_DISC
