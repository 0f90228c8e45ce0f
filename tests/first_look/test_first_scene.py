# SPDX-License-Identifier: Apache-2.0
"""`mr360uw new` as a user runs it: the scene, the preview, what is said, and the composite as printed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from mr360uw import load_scene
from mr360uw.base.color import encode
from mr360uw.base.sphere import directions
from mr360uw.composite import load_object
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.first_look.place_in_plate import Place, Wish
from mr360uw.first_look.proposal import Proposal, corrected
from mr360uw.render.loaded import load
from mr360uw.sample import SampleDive
from mr360uw.scene.model import Scene
from mr360uw.types import Floats
from tests.depth.own_maps import write_own_maps
from tests.first_look.plates import air, water
from tests.video.other_projections import dual_fisheye, eac_row, write_tracks

Run = Callable[..., tuple[int, str, str]]
LONGEST = 40
"""Lines of a first scene, at most."""


def picture(path: Path, image: Floats) -> Path:
    codes = np.round(255.0 * encode(np.clip(image, 0.0, 1.0), "srgb")).astype(np.uint8)
    assert cv2.imwrite(str(path), codes[..., ::-1])
    return path


def mesh(path: Path, units: float, *, foot: float = -0.5) -> Path:
    """A box that is 0.4 wide, 0.5 high and 1 long, times `units`, from `foot` of its height up."""
    box = trimesh.creation.box((0.4 * units, 0.5 * units, units))
    box.apply_translation((0.0, 0.5 * units * (0.5 + foot), 0.0))
    box.export(path)
    return path


def seen(scene: Scene) -> tuple[float, Floats]:
    """Return the widest angle [deg] of the first object's hull, and its points (n, 3) from the camera."""
    loaded = load(scene, 256, 128)
    view = loaded.view(0.0)
    placed = loaded.objects[0].at(0.0, 0, view.position, view.world_from_camera)
    points = placed.to_world(placed.mesh.hull.reshape(-1, 3)) - view.position
    ray = points / np.linalg.norm(points, axis=-1, keepdims=True)
    assert loaded.notes == ()
    return float(np.degrees(np.arccos(np.clip((ray @ ray.T).min(), -1.0, 1.0)))), points


def test_a_dive_and_a_fish_in_centimetres(dive: SampleDive, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "my.toml"
    code, said, err = run("new", dive.plate, mesh(tmp_path / "fish.ply", 40.0), "-o", out, "--backend", "reference")
    assert (code, err) == (0, "")
    assert "under water" in said
    assert "camera    taken as at rest" in said
    assert "centimetres: 0.4 m" in said
    assert "guessed" in said
    assert len(out.read_text().splitlines()) <= LONGEST
    scene = load_scene(out)
    assert scene.water.type != "none"
    angle, points = seen(scene)
    assert 10.0 < angle < 32.0
    assert said.splitlines()[0].startswith("fish, 0.4 m long, in the water")
    assert points[:, 1].min() > (scene.receiver.height_m if scene.receiver else -np.inf)
    assert points[:, 1].max() < scene.camera.depth_m
    preview, plate = cv2.imread(str(out.with_suffix(".preview.png"))), cv2.VideoCapture(str(dive.plate)).read()[1]
    assert preview.shape == (plate.shape[0] + 85, plate.shape[1], 3)  # below it, two views of 128 by 85 pixels
    column = round((scene.objects[0].azimuth_deg or 0.0) / 360.0 * 256 + 128)
    row = round(64 - (scene.objects[0].elevation_deg or 0.0) / 180.0 * 128)
    there = np.abs(preview[: len(plate)].astype(int) - plate)[row - 4 : row + 4, column - 6 : column + 6]
    assert there.max(axis=-1).mean() > 4.0  # a body of another colour; codecs and dither change plates by a code or two


def test_a_still_in_air_has_no_water_and_gets_a_still(tmp_path: Path, run: Run) -> None:
    plate = picture(tmp_path / "garden.png", air())
    code, said, err = run("new", plate, mesh(tmp_path / "thing.ply", 2.0, foot=0.0), "--backend", "reference")
    assert (code, err) == (0, "")
    assert "in air" in said
    scene = load_scene(tmp_path / "garden.toml")
    assert (scene.water.type, scene.objects[0].stand_on) == ("none", "receiver")
    angle, points = seen(scene)
    assert 12.0 < angle < 35.0
    assert points[:, 1].min() == pytest.approx(-1.6)
    command = next(line for line in said.splitlines() if line.startswith("next:")).split()[2:]
    assert command[-1] == "garden.composite.png"
    code, _, err = run(*command[:-1], tmp_path / command[-1], "--backend", "reference")
    assert (code, err) == (0, "")
    assert cv2.imread(str(tmp_path / "garden.composite.png")).shape == (128, 256, 3)


def test_dark_water_gets_a_lamp(tmp_path: Path, run: Run) -> None:
    plate = picture(tmp_path / "night.png", water((0.0, 0.003, 0.006)))
    code, said, err = run("new", plate, mesh(tmp_path / "robot.ply", 1.0), "--backend", "reference")
    assert (code, err) == (0, "")
    assert "dark" in said
    scene = load_scene(tmp_path / "night.toml")
    assert len(scene.lamps) == 1
    assert scene.receiver is None


def test_a_lamp_that_the_plate_does_not_show_tells_no_exposure(
    tmp_path: Path, run: Run, rng: np.random.Generator
) -> None:
    y = directions(256, 128)[..., 1:2]
    ground = np.exp(rng.normal(0.0, 0.5, (128, 256, 1))) * np.array((0.001, 0.006, 0.008))
    plate = picture(tmp_path / "night.png", np.where(y < -0.2, ground, water((0.0, 0.003, 0.006))))
    code, said, err = run("new", plate, mesh(tmp_path / "fish.ply", 0.4), "--backend", "reference")
    assert (code, err) == (0, "")
    scene = load_scene(tmp_path / "night.toml")
    assert len(scene.lamps) == 1
    assert scene.receiver is not None
    assert "grey" not in said
    assert scene.objects[0].exposure == 0.0


def test_a_large_thing_is_not_put_where_the_water_hides_it(tmp_path: Path, run: Run) -> None:
    plate = picture(tmp_path / "green.png", water((0.06, 0.16, 0.08)))
    assert run("new", plate, mesh(tmp_path / "whale.ply", 12.0), "--backend", "reference")[0] == 0
    scene = load_scene(tmp_path / "green.toml")
    assert (scene.objects[0].distance_m or np.inf) <= 0.36 * (scene.water.visibility_m or 0.0)
    assert scene.water.gain == "auto"
    assert seen(scene)[0] < 60.0  # 45 for its longest side at its middle; one end is nearer


def test_the_up_axis_is_as_asked_for_and_said(tmp_path: Path, run: Run) -> None:
    plate = picture(tmp_path / "plate.png", air())
    trimesh.creation.box((1.0, 2.0, 3.0)).export(tmp_path / "thing.obj")
    out = run("new", plate, tmp_path / "thing.obj", "-o", tmp_path / "a.toml", "--up", "z")
    assert "up        z, asked for" in str(out)
    scene = load_scene(tmp_path / "a.toml")
    assert scene.objects[0].up == "z"
    np.testing.assert_allclose(load_object(scene.objects[0]).meshes[0].extent_m, [1.0, 3.0, 2.0], rtol=1e-6)


def test_the_floor_is_that_of_a_camera_track(tmp_path: Path, run: Run) -> None:
    track = tmp_path / "track.csv"
    track.write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n")
    track.with_suffix(".json").write_text(json.dumps({"floor": {"height_m": -3.25}}))
    out = tmp_path / "my.toml"
    plate = picture(tmp_path / "reef.png", water((0.02, 0.15, 0.3)))
    given = ("new", plate, mesh(tmp_path / "anchor.ply", 2.0), "-o", out, "--track", track)
    assert run(*given, "--backend", "reference")[0] == 0
    scene = load_scene(out)
    assert scene.receiver is not None
    assert scene.receiver.height_m == -3.25
    assert scene.camera.track is not None
    track.with_suffix(".json").write_text("[]")
    code, _, err = run(*given, "--overwrite")
    assert code == 2
    assert "is no camera track" in err


def test_a_path_is_solved_where_that_is_asked_for(tmp_path: Path, run: Run) -> None:
    """One that is there is kept; a still has none; without any a clip's camera is said to be at rest."""
    plate = picture(tmp_path / "still.png", water((0.02, 0.15, 0.3)))
    out, body = tmp_path / "scene.toml", mesh(tmp_path / "anchor.ply", 2.0)
    assert "camera    taken as at rest" not in run("new", plate, body, "-o", tmp_path / "other.toml")[1]
    code, _, err = run("new", plate, body, "-o", out, "--track", "auto")
    assert code == 2
    assert "auto" not in err
    assert not out.exists()
    (tmp_path / "still.track.csv").write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n")
    code, text, _ = run("new", plate, body, "-o", out, "--track", "auto")
    assert code == 0
    assert "camera    stands or moves as" in text
    assert load_scene(out).camera.track == tmp_path / "still.track.csv"


def test_stereo_plates_are_taken_by_both_eyes_and_others_refused(tmp_path: Path, run: Run) -> None:
    left, right = water((0.02, 0.15, 0.3)), water((0.02, 0.13, 0.28))
    picture(tmp_path / "two.png", np.concatenate([left, right]))
    body = mesh(tmp_path / "fish.ply", 0.4)
    for options, eye in (((), "both"), (("--eye", "left", "--overwrite"), "left")):
        code, said, _ = run("new", tmp_path / "two.png", body, "--backend", "reference", *options)
        assert code == 0
        assert ("both eyes" if eye == "both" else "left eye") in said
        assert load_scene(tmp_path / "two.toml").plate.eye == eye
    assert not (tmp_path / "two.depth").exists()  # open water has no distances
    # Maps of one eye are used with that eye
    far = DepthMap(np.full((128, 256), 5.0, np.float32), np.ones((128, 256), np.float32))
    write_own_maps(tmp_path / "maps", {0: (far,)})
    given = ("new", tmp_path / "two.png", body, "--backend", "reference", "--overwrite", "--depth", tmp_path / "maps")
    assert run(*given)[0] == 0
    assert load_scene(tmp_path / "two.toml").plate.eye == "left"
    picture(tmp_path / "flat.png", left[:, :180])
    code, _, err = run("new", tmp_path / "flat.png", body)
    assert code == 2
    assert "not a 360 degree panorama" in err
    assert not (tmp_path / "flat.toml").exists()


def test_the_eyes_of_a_still_tell_its_floor(tmp_path: Path, run: Run, rng: np.random.Generator) -> None:
    """A mottled floor 0.8 m below eyes 64 mm apart, each on its viewing circle; the maps are kept."""
    d = directions(512, 256)
    with np.errstate(divide="ignore"):
        reach = np.where(d[..., 1] < -0.1, -0.8 / d[..., 1], np.nan)
    mottled = cv2.GaussianBlur(rng.normal(0.0, 1.0, (1024, 1024)).astype(np.float32), (0, 0), 2.0)
    eyes = []
    for side in (-0.032, 0.032):
        # Rays start beside the middle, across their azimuth, less far towards the nadir
        x, z = reach * d[..., 0] - side * d[..., 2], reach * d[..., 2] + side * d[..., 0]
        column, row = (np.nan_to_num(64.0 * v + 512.0, nan=0.0).astype(np.float32) for v in (x, z))
        floor = cv2.remap(mottled, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        ground = np.exp(1.5 * floor)[..., None] * np.array((0.03, 0.08, 0.1))
        sea = cv2.resize(water((0.02, 0.15, 0.3)), (512, 256))
        eyes.append(np.where(np.isfinite(reach)[..., None], ground, sea))
    plate = picture(tmp_path / "reef.png", np.concatenate(eyes))
    given = ("new", plate, mesh(tmp_path / "anchor.ply", 0.3), "--backend", "reference")
    code, said, err = run(*given)
    assert (code, err) == (0, "")
    assert "by the distances of the plate" in said
    scene = load_scene(tmp_path / "reef.toml")
    assert scene.plate.depth == tmp_path / "reef.depth"
    assert scene.receiver is not None
    assert abs(scene.receiver.height_m / -0.8 - 1.0) < 0.1  # half a pixel of 6.5
    maps = (tmp_path / "reef.depth" / "depth_00000.exr").stat().st_mtime_ns
    assert run(*given, "--overwrite")[0] == 0
    assert (tmp_path / "reef.depth" / "depth_00000.exr").stat().st_mtime_ns == maps


def test_the_ground_tells_the_exposure(tmp_path: Path, run: Run, rng: np.random.Generator) -> None:
    """Sixteen times as much light from the same ground under the same water asks for up to four stops more.

    Brighter ground also lights the water, and what is in it: at most a third of them.
    """
    sea = water((0.02, 0.15, 0.3))
    y = directions(256, 128)[..., 1:2]
    rough = np.exp(rng.normal(0.0, 0.3, (128, 256, 1)))
    found = []
    for times in (0.25, 4.0):
        plate = picture(tmp_path / "reef.png", np.where(y < -0.2, times * rough * np.array((0.05, 0.12, 0.15)), sea))
        code, _, err = run("new", plate, mesh(tmp_path / "fish.ply", 0.4), "--overwrite", "--backend", "reference")
        assert (code, err) == (0, "")
        written = re.findall(r"exposure = (\S+)", (tmp_path / "reef.toml").read_text())
        found.append(float(written[0]))
        assert (load_scene(tmp_path / "reef.toml").objects[0].exposure != 0.0) == (abs(found[-1]) >= 1.5)
    assert 4.0 * 2.0 / 3.0 - 0.1 <= found[1] - found[0] <= 4.0  # both are rounded to tenths


@pytest.mark.parametrize(
    ("card_stops", "lamp", "exposure"),
    [
        (-2.04, False, 2.0),
        (1.0, False, -1.0),
        (0.5, False, 0.0),
        (-9.0, False, 3.0),
        (5.0, True, 0.0),
        (None, False, 0.0),
    ],
)
def test_exposure_follows_the_cards_within_limits(card_stops: float | None, lamp: bool, exposure: float) -> None:
    plate: Any = SimpleNamespace(dark=lamp)
    mesh: Any = None
    chosen = Proposal(plate, mesh, Wish(), Place(0.4, False, 1.3), None, 6.0, "")
    assert corrected(chosen, card_stops).exposure == exposure


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_plates_of_one_colour_are_no_trouble(tmp_path: Path, run: Run, value: float) -> None:
    plate = picture(tmp_path / "flat.png", np.full((32, 64, 3), value, np.float32))
    code, _, err = run("new", plate, mesh(tmp_path / "thing.ply", 1.0), "--backend", "reference")
    assert (code, err) == (0, "")


def faces() -> list[Floats]:
    """Return the planes of six cube faces in two rows."""
    return [np.concatenate(rows, axis=0) for rows in zip(eac_row(64, 0), eac_row(64, 1), strict=True)]


@pytest.mark.parametrize(
    ("projection", "planes", "size"),
    [("dual_fisheye", lambda: dual_fisheye(128, 200.0), (256, 128)), ("eac", faces, (256, 128))],
)
def test_a_clip_straight_from_the_camera_gets_its_projection(
    tmp_path: Path, run: Run, projection: str, planes: Callable[[], list[Floats]], size: tuple[int, int]
) -> None:
    clip = write_tracks(tmp_path / "raw.mp4", [[planes()] * 2])
    code, said, err = run("new", clip, mesh(tmp_path / "fish.ply", 0.4), "--backend", "reference")
    assert (code, err) == (0, "")
    assert f"from {projection}" in said
    assert ("200 degrees each, guessed" in said) == (projection == "dual_fisheye")
    assert load_scene(tmp_path / "raw.toml").plate.projection == projection
    assert cv2.imread(str(tmp_path / "raw.preview.png")).shape == (size[1] + 85, size[0], 3)


def test_a_still_straight_from_the_camera_is_refused_with_the_command_that_turns_it(tmp_path: Path, run: Run) -> None:
    cv2.imwrite(str(tmp_path / "raw.png"), dual_fisheye(128, 200.0)[0])
    code, _, err = run("new", tmp_path / "raw.png", mesh(tmp_path / "fish.ply", 0.4), "--backend", "reference")
    assert code == 2
    assert "ffmpeg -i raw.png -vf v360=dfisheye:e:ih_fov=200:iv_fov=200 out.png" in err
    assert not (tmp_path / "raw.toml").exists()


def test_what_has_no_room_is_put_in_open_water_or_refused(tmp_path: Path, run: Run) -> None:
    """Rock 1 m away on all sides of a floor: no anchor of 1 m stands there, under water or in air."""
    d = directions(256, 128)
    with np.errstate(divide="ignore"):
        shown = np.minimum(np.where(d[..., 1] < 0.0, -2.0 / d[..., 1], np.inf), 1.0 / np.hypot(d[..., 0], d[..., 2]))
    known = np.isfinite(shown) & (d[..., 1] < 0.3)
    depth = tmp_path / "depth"
    write_own_maps(depth, {0: (DepthMap(shown.astype(np.float32), known.astype(np.float32)),)})
    plate, out = picture(tmp_path / "reef.png", water((0.02, 0.15, 0.3))), tmp_path / "my.toml"
    given = ("new", plate, mesh(tmp_path / "anchor.ply", 1.0), "-o", out, "--backend", "reference", "--depth", depth)
    code, _, err = run(*given, "--air")
    assert code == 2
    assert "finds no room" in err
    assert not out.exists()
    code, said, err = run(*given, "--water")
    assert (code, err) == (0, "")
    assert "so it hangs in the water" in said
    assert not load_scene(out).objects[0].stand_on


def test_distances_tell_the_floor_and_what_a_foot_stands_on(tmp_path: Path, run: Run) -> None:
    """A wall 3 m ahead over a floor 2 m below: a foot on the wall, 5 degrees over the horizon, which has no ground."""
    d = directions(256, 128)
    with np.errstate(divide="ignore"):
        floor, wall = (
            np.where(d[..., 1] < 0.0, -2.0 / d[..., 1], np.inf),
            np.where(d[..., 2] < 0.0, -3.0 / d[..., 2], np.inf),
        )
    shown = np.minimum(floor, np.where(d[..., 1] < 0.5, wall, np.inf))
    known = np.isfinite(shown) & (shown < 20.0)
    depth = tmp_path / "depth"
    write_own_maps(depth, {0: (DepthMap(shown.astype(np.float32), known.astype(np.float32)),)})
    plate = picture(tmp_path / "reef.png", water((0.02, 0.15, 0.3)))
    out = tmp_path / "my.toml"
    given = ("new", plate, mesh(tmp_path / "anchor.ply", 1.0), "-o", out, "--backend", "reference", "--depth", depth)
    code, said, err = run(*given, "--at", "0,5", "--stand", "--size", "0.5")
    assert (code, err) == (0, "")
    assert "by the distances of the plate" in said
    assert "its foot on what the plate shows there" in said
    scene = load_scene(out)
    assert scene.plate.depth is not None
    assert scene.receiver is not None
    assert abs(scene.receiver.height_m / -2.0 - 1.0) < 0.02  # pixels of 1.4 degrees
    _, points = seen(scene)
    foot = 3.0 * np.tan(np.radians(5.0))
    assert abs(points[:, 1].min() - foot) < 0.02 * 3.0
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    assert np.hypot(middle[0], middle[2] + 3.0) < 0.02 * 3.0
    code, _, err = run(*given[:-1], tmp_path / "none", "--overwrite")
    assert code == 2
    assert "none" in err
