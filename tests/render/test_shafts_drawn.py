# SPDX-License-Identifier: Apache-2.0
"""Light in the water of composited frames: what it adds before objects and over the plate, and what goes without it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.cache import Cache
from mr360uw.base.constants import SUN_HALF_ANGLE_RAD
from mr360uw.base.sphere import directions, unit
from mr360uw.composite.shafts import ShaftInput, code_change, grid_of, shaft_pixels, with_shafts
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import over
from mr360uw.medium import Medium, Water
from mr360uw.medium.closed_form import ray_in_water
from mr360uw.medium.settings import ShaftSettings
from mr360uw.medium.shafts.shaft_field import DEFAULT_GRID, shaft_field
from mr360uw.medium.shafts.shaft_scene import beam_share, unoccluded
from mr360uw.render.loaded import load
from mr360uw.types import CausticStack, Floats, Lamp, Layer, Sun
from tests.composite.scenes import placed, shot, sphere
from tests.scenes import gradient_plate, scene_with
from tests.tolerances import FLOAT32

SIZE = 64
HIGH = Sun(unit([0.2, 0.95, -0.1]), np.array([1.0, 1.2, 1.3]), SUN_HALF_ANGLE_RAD, 1.0)
BALL = (0.3, 0.8, -3.0)
DISTANCE = 1e-3
"""Light before a body by both renderers over the largest: their distances differ by single precision, and graphics
hardware rounds in its own way."""


def water(kind: str = "II", depth_m: float = 5.0, mode: Any = "table") -> Medium:
    return Medium(Water.jerlov(kind), mode=mode, camera_depth_m=depth_m, band_count=8)


def waves(rng: np.random.Generator) -> CausticStack:
    ratio = rng.uniform(0.3, 1.7, (4, 16, 16, 1))
    ratio /= ratio.mean(axis=(1, 2), keepdims=True)
    return CausticStack(np.broadcast_to(ratio, (4, 16, 16, 3)), np.array([0.2, 2.0, 5.0, 9.0]), 4.0, HIGH.direction)


def taken(medium: Medium, *bodies: Any, lights: tuple[Any, ...] = (HIGH,), width: int = SIZE) -> Shot:
    return replace(shot(*bodies, width=width, medium=medium.table), lights=lights)


def drawn(shot: Shot, settings: ShaftSettings, medium: Medium, caustics: CausticStack | None = None) -> Layer:
    """Return the layer of light in the water alone, over a layer of nothing."""
    empty = Layer(shot.view.height, shot.view.width, ())
    return with_shafts(shot, ShaftInput(settings, medium, caustics), empty, None, Cache())[0]


def test_a_body_darkens_the_water_below_it_and_nothing_turns_negative() -> None:
    medium = water()
    taken_shot = taken(medium, placed(sphere(rows=8), BALL))
    layer = drawn(taken_shot, ShaftSettings(), medium)
    dark = layer.shafts.min(axis=-1)
    j, i = np.unravel_index(np.argmin(dark), dark.shape)
    darkest = directions(SIZE, SIZE // 2)[j, i]
    # in the plane of the ball and the sun, on the far side of the ball from the sun
    ball, sun = unit(BALL), HIGH.direction
    assert abs(darkest @ unit(np.cross(ball, sun))) < np.sin(0.25)
    assert darkest @ sun < ball @ sun
    assert layer.shafts.max() == 0.0
    picture = over(np.full((SIZE // 2, SIZE, 3), 1e-4, np.float32), layer)
    assert picture.min() >= 0.0
    assert picture[j, i].max() == 0.0
    np.testing.assert_array_equal(layer.alpha, 0.0)


def test_a_matte_with_distances_ends_shafts_before_the_plate() -> None:
    """A wall before the body's shadow leaves nothing of it, one behind it leaves a part."""
    medium = water()
    open_water = taken(medium, placed(sphere(rows=8), BALL))
    changes = []
    for wall_m in (0.5, 4.0, np.inf):
        walled = replace(open_water, holdout_distance_m=np.full((SIZE // 2, SIZE), wall_m))
        changes.append(-drawn(walled, ShaftSettings(mode="on"), medium).shafts.sum())
    assert changes[0] == 0.0
    assert 0.0 < changes[1] < 0.9 * changes[2]


def test_pixels_that_may_change_hold_all_that_do() -> None:
    size = 128
    medium, codes = water("IB", 8.0), 0.5
    for place, sun in ((BALL, HIGH), ((0.0, -2.0, 0.5), HIGH), (BALL, replace(HIGH, direction=unit([0.9, 0.44, 0.1])))):
        taken_shot = taken(medium, placed(sphere(rows=8), place), lights=(sun,), width=size)
        light = ShaftInput(ShaftSettings(), medium)
        _, scene = light.scenes(taken_shot, Cache())
        marked = shaft_pixels(taken_shot, scene, 100.0, codes, Cache())
        rays = directions(size, size // 2).reshape(-1, 3)
        found = shaft_field(scene, DEFAULT_GRID, rays).radiance(rays, np.full(len(rays), 100.0))
        veil = medium.veil(100.0, 8.0, rays[:, 1])
        seen = code_change(veil, found).reshape(-1, size) > codes
        assert 0 < seen.sum() <= (seen & marked).sum() + 0.02 * seen.sum()  # slack: of cells that are partly above it
        assert marked.sum() < 0.7 * marked.size


def test_light_before_an_object_ends_at_it(rng: np.random.Generator) -> None:
    """With a wall at a distance, what is added to it is the deviation up to there, times its alpha."""
    medium, light = water(), ShaftInput(ShaftSettings(), water(), waves(rng))
    taken_shot = taken(medium)
    wall = drawn_wall(2.5)
    layer, _ = with_shafts(taken_shot, light, wall, None, Cache())
    before, _ = light.scenes(taken_shot, Cache())
    rays = directions(SIZE, SIZE // 2)[10:20, 8:24].reshape(-1, 3)
    field = shaft_field(before, grid_of(light.settings, SIZE, before), rays)
    expected = 0.5 + 0.5 * field.radiance(rays, np.full(len(rays), 2.5))
    np.testing.assert_allclose(layer.tiles[0].radiance.reshape(-1, 3), expected, rtol=FLOAT32)
    assert np.any(layer.tiles[0].radiance > 0.5)
    assert np.any(layer.tiles[0].radiance < 0.5)
    assert not np.any(layer.shafts)  # the plate has the shafts of its own waves


def drawn_wall(distance_m: float, radiance: float = 0.5) -> Layer:
    from mr360uw.composite.tiles import empty_tile
    from mr360uw.types import Rectangle

    tile = empty_tile(Rectangle(8, 10, 16, 10))
    tile = replace(tile, radiance=tile.radiance + np.float32(radiance), alpha=tile.alpha + np.float32(0.5))
    return Layer(SIZE // 2, SIZE, (replace(tile, distance_m=np.full_like(tile.alpha, distance_m)),))


def test_shafts_of_waves_reach_the_plate_where_they_are_asked_for(rng: np.random.Generator) -> None:
    medium, stack = water(), waves(rng)
    whole = drawn(taken(medium), ShaftSettings(on_plate=True), medium, stack).shafts
    assert np.mean(whole != 0.0) > 0.95
    assert whole.min() < 0.0 < whole.max()
    twice = drawn(taken(medium), ShaftSettings(on_plate=True, strength=2.0), medium, stack).shafts
    np.testing.assert_allclose(twice, 2.0 * whole, rtol=FLOAT32)
    assert not np.any(drawn(taken(medium), ShaftSettings(), medium, stack).shafts)


def test_over_the_places_of_a_wave_nothing_is_added() -> None:
    """The mean over a period of waves is at most 1 % of the beam's light (three places of a cosine cancel exactly)."""
    medium, rays = water(), directions(32, 16).reshape(-1, 3)
    total, beam = np.zeros((len(rays), 3)), None
    for phase in range(6):
        x = 2.0 * np.pi * (np.arange(48) / 48.0 + phase / 6.0)
        ratio = np.broadcast_to((1.0 + 0.6 * np.cos(x))[None, None, :, None], (3, 48, 48, 3))
        light = ShaftInput(
            ShaftSettings(on_plate=True), medium, CausticStack(ratio, np.array([0.2, 4.0, 20.0]), 6.0, HIGH.direction)
        )
        scene, _ = light.scenes(taken(medium), Cache())
        total += shaft_field(scene, grid_of(light.settings, SIZE, scene), rays).radiance(rays, np.full(len(rays), 50.0))
        beam = HIGH.irradiance * unoccluded(
            scene.water,
            rays @ HIGH.direction,
            rays[:, 1],
            np.zeros(len(rays)),
            ray_in_water(50.0, scene.depth_m, rays[:, 1]),
            scene.depth_m,
            scene.sun_up,
        )
    assert beam is not None
    assert np.abs(total / 6).mean() < 0.01 * beam.mean()


def test_without_waves_bodies_and_lamps_nothing_is_touched() -> None:
    medium = water()
    wall = drawn_wall(3.0)
    layer, _ = with_shafts(taken(medium), ShaftInput(ShaftSettings(), medium), wall, None, Cache())
    np.testing.assert_array_equal(layer.tiles[0].radiance, wall.tiles[0].radiance)
    assert not np.any(layer.shafts)
    assert len(layer.tiles) == 1


def lamp(position: tuple[float, float, float]) -> Lamp:
    return Lamp(np.array(position), np.array([0.0, 0.0, -1.0]), np.full(3, 0.5), 0.9, 0.8, 0.02, None)


STRESS: dict[str, tuple[Any, ...]] = {
    "at the surface": ("IB", 0.02, HIGH, (), BALL),
    "sun at the edge of Snell's window": ("IB", 5.0, replace(HIGH, direction=unit([0.7463, 0.6656, 0.0])), (), BALL),
    "9C": ("9C", 3.0, HIGH, (), BALL),
    "body around the camera": ("II", 5.0, HIGH, (), (0.0, 0.0, 0.0)),
    "lamp inside a body": ("II", 5.0, HIGH, (lamp(BALL),), BALL),
    "lamp at the camera": ("II", 5.0, HIGH, (lamp((0.0, 0.0, 0.0)),), BALL),
    "sun below": ("II", 5.0, replace(HIGH, direction=unit([0.3, -0.2, 0.1])), (), BALL),
    "body above the water": ("II", 2.0, HIGH, (), (0.0, 3.0, -2.0)),
}


@pytest.mark.parametrize("range_m", [0.5, 500.0])
@pytest.mark.parametrize("name", STRESS)
def test_stress(name: str, range_m: float, rng: np.random.Generator) -> None:
    kind, depth, sun, lamps, place = STRESS[name]
    medium = water(kind, depth)
    surface = replace(taken(medium).view, surface_y_m=depth)
    taken_shot = replace(taken(medium, placed(sphere(rows=6), place), lights=(sun, *lamps)), view=surface)
    settings = ShaftSettings(range_m=range_m, on_plate=True, resolution=16, slices=16)
    light = ShaftInput(settings, medium, waves(rng))
    layer, _ = with_shafts(taken_shot, light, drawn_wall(1.0), None, Cache())
    assert np.all(np.isfinite(layer.shafts))
    assert layer.radiance.min() >= 0.0
    if range_m == 500.0 and name != "sun below":
        assert np.any(layer.shafts)


def test_water_that_does_not_scatter_has_none() -> None:
    nm = np.linspace(380.0, 740.0, 8)
    clear = Medium(Water.from_arrays(nm, np.full(8, 0.1), np.zeros(8)), camera_depth_m=5.0, band_count=8)
    assert beam_share(clear, 5.0) == 0.0
    light = ShaftInput(ShaftSettings(), clear)
    assert all(scene.dark for scene in light.scenes(taken(clear, placed(sphere(rows=6), BALL)), Cache()))


def test_the_beams_share_of_the_veil_falls_with_depth_and_murk() -> None:
    shares = [beam_share(water(kind), depth) for kind, depth in (("IB", 1.0), ("IB", 20.0), ("3C", 20.0))]
    assert 1.0 > shares[0] > shares[1] > 0.1
    assert shares[2] < 0.005


@pytest.mark.parametrize(
    ("tables", "runs", "why"),
    [
        ({}, True, "by waves, bodies"),
        ({"shafts": {"mode": "off"}}, False, "switched off"),
        ({"shafts": {"strength": 0.0}}, False, "strength is 0"),
        ({"shafts": {"range_m": 0.0}}, False, "range_m is 0"),
        (
            {"water": {"type": "9C"}},
            False,
            " % of the veil is light of the beam scattered once, below 1 %",
        ),
        ({"water": {"type": "9C"}, "shafts": {"mode": "on"}}, True, "by waves, bodies; 0."),
        ({"water": {"type": "9C"}, "lamp": [{}]}, True, "lamps"),
        ({"light": {"sun": "none"}}, False, "no sun and no lamps"),
        ({"light": {"sun": "none"}, "lamp": [{}]}, True, "by lamps"),
        ({"water": {"type": "none"}}, False, 'water is "none"'),
    ],
)
def test_the_plan_says_why(tables: dict[str, Any], runs: bool, why: str, tmp_path: Path, whale: Path) -> None:
    few = {"water": {"bands": 8, **tables.get("water", {})}}
    stage = load(scene_with(tmp_path, whale, **{**tables, **few}), SIZE, SIZE // 2).plan.shafts
    assert stage.runs == runs
    assert why in stage.why


def test_a_body_that_casts_no_shadow_shades_no_water(tmp_path: Path, whale: Path) -> None:
    ghost = [{"mesh": str(whale), "casts_shadow": False}]
    plan = load(
        scene_with(tmp_path, None, object=ghost, caustics={"enabled": False}, water={"bands": 8}), SIZE, SIZE // 2
    ).plan
    assert plan.shafts.why == "neither waves nor bodies change the beam"


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"shafts": {"mode": "some"}}, "shafts.mode"),
        ({"shafts": {"resolution": 8}}, "shafts.resolution"),
        ({"shafts": {"strength": -1.0}}, "shafts.strength"),
        ({"shafts": {"phase": 0.8}}, "shafts.phase - unknown key"),
        ({"keys": [{"parameter": "shafts.phase", "time_s": [0.0], "value": [0.1]}]}, "unknown parameter"),
    ],
)
def test_settings_that_make_no_sense_are_refused(tables: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(uw.SceneError, match=message):
        scene_with(tmp_path, None, **tables)


@pytest.fixture(scope="module")
def wedge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tetrahedron about 2 m wide."""
    path = tmp_path_factory.mktemp("wedge") / "wedge.obj"
    path.write_text("v -1 0 1\nv 1 0 1\nv 0 0 -1\nv 0 1 0\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    return path


DRAW = {"samples": 1, "ambient_occlusion": False, "sun_samples": 4}


def frame(folder: Path, mesh: Path, backend: str, plate: Floats, **shafts: Any) -> Floats:
    given = {"sun": "given", "sun_azimuth_deg": 20.0, "sun_elevation_deg": 70.0}
    scene = scene_with(
        folder, mesh, light=given, caustics={"size": 32, "grid": 32}, draw=DRAW, water={"bands": 8, "blur": False},
        shafts={"resolution": 32, "slices": 16, **shafts},
    )  # fmt: skip
    return uw.render_frame(plate, scene, 0.4, backend).image_linear


@pytest.mark.usefixtures("gl")
def test_both_renderers_draw_the_same_shafts(tmp_path: Path, wedge: Path) -> None:
    plate = gradient_plate(SIZE, SIZE // 2)
    change = {}
    for backend in ("reference", "gl"):
        bare = frame(tmp_path, wedge, backend, plate, mode="off")
        change[backend] = frame(tmp_path, wedge, backend, plate, strength=3.0) - bare
    scale = np.abs(change["reference"]).max()
    np.testing.assert_array_equal(frame(tmp_path, wedge, "gl", plate, strength=0.0), bare)
    assert scale > 1e-3
    np.testing.assert_allclose(change["gl"], change["reference"], atol=DISTANCE * scale)


def test_scenes_that_skip_them_import_nothing_of_them() -> None:
    program = (
        "import sys; from pathlib import Path; import mr360uw.render.frame, mr360uw.render.loaded; "
        "assert not any('composite.shafts' in m or m.endswith(('froxels', 'shaft_scene')) for m in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_a_frame_is_the_same_whatever_came_before(tmp_path: Path, wedge: Path) -> None:
    """Frame 7 with a cache of frame 3, and without."""
    from mr360uw.render.first_pass import ClipAnalysis
    from mr360uw.render.frame import Reference, composite_frame
    from mr360uw.video import VideoFrame

    given = {"sun": "given", "sun_azimuth_deg": 20.0, "sun_elevation_deg": 70.0}
    loaded = load(
        scene_with(tmp_path, wedge, light=given, caustics={"size": 32, "grid": 32}, draw=DRAW, water={"bands": 8},
                   shafts={"resolution": 32, "slices": 16}), SIZE, SIZE // 2,
    )  # fmt: skip
    plate = gradient_plate(SIZE, SIZE // 2)
    cache = Cache()

    def at(index: int, cache: Cache | None) -> Floats:
        shown = VideoFrame.of_linear(plate, index, index / 30.0)
        return composite_frame(loaded, ClipAnalysis(), Reference(), shown, 0.0, cache=cache).layer.radiance

    at(3, cache)
    again = at(7, cache)
    np.testing.assert_array_equal(again, at(7, None))
    assert np.any(again != at(3, None))
