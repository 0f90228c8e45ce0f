# SPDX-License-Identifier: Apache-2.0
"""What plates and meshes show by themselves: water or air, open water, size, front."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from mr360uw.base.color import encode
from mr360uw.base.sphere import directions
from mr360uw.composite.mesh.up_axis import kind_of
from mr360uw.composite.settings import Front
from mr360uw.first_look.observations import look_at_mesh, look_at_plate, water_or_air
from mr360uw.first_look.place_in_plate import free_view
from mr360uw.first_look.proposal import Sight, guess_sight
from mr360uw.medium import Medium, Water
from mr360uw.medium.closed_form import water_seen_as_far
from mr360uw.medium.water import JerlovType
from mr360uw.types import Floats
from tests.first_look.plates import SIZE, air, water

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("image", "underwater"),
    [
        (water((0.02, 0.15, 0.3)), True),
        (water((0.05, 0.14, 0.12)), True),
        (water((0.0, 0.002, 0.006)), True),
        (water((0.08, 0.17, 0.11)), True),
        (water((0.18, 0.18, 0.03)), True),
        (air(), False),
        (air(ground=(0.2, 0.18, 0.1)), False),
        (np.zeros((*SIZE, 3), np.float32), False),
        (np.ones((*SIZE, 3), np.float32), False),
        (np.full((*SIZE, 3), 0.3, np.float32), False),
        (air(sky=(0.6, 0.6, 0.6)), False),
        (air(ground=(0.08, 0.12, 0.04)), False),
    ],
)
def test_water_has_no_red_in_the_distance(image: Floats, underwater: bool) -> None:
    assert water_or_air(image).underwater == underwater


def white_balanced(image: Floats) -> Floats:
    """Return a picture whose mean is grey, as cameras and programs balance it."""
    means = image.mean(axis=(0, 1))
    return (image * means.mean() / means).astype(np.float32)


def sky_lit_dive() -> Floats:
    """Return open water whose light has more red where it came a shorter way from above, over a rough floor."""
    y = directions(SIZE[1], SIZE[0])[..., 1:2]
    sea = np.exp(1.2 * y) * np.array((0.05, 0.16, 0.2)) * np.where(y > 0.0, np.exp(y * np.array((1.2, 0.2, 0.0))), 1.0)
    rough = np.random.default_rng(2).uniform(0.7, 1.3, (*SIZE, 1))
    return np.where(y < -0.1, rough * np.array((0.06, 0.16, 0.2)), sea).astype(np.float32)


def dusk() -> Floats:
    """Return a plate in air in blue light: less red than in water, least of it overhead."""
    return (air() * np.array((0.06, 0.15, 0.3))).astype(np.float32)


def test_no_answer_is_sure_and_where_red_is_hidden_its_rise_decides() -> None:
    """By the red in the distance alone the last two are wrong."""
    found = [water_or_air(image) for image in (sky_lit_dive(), air(), white_balanced(sky_lit_dive()), dusk())]
    assert [one.underwater for one in found] == [True, False, True, False]
    assert min(one.confidence for one in found[:2]) > 0.5
    assert max(one.confidence for one in found[:2]) <= 0.9
    assert max(one.confidence for one in found[2:]) < 0.5


def test_the_user_decides_about_water(tmp_path: Path, run: Run) -> None:
    plate, thing = tmp_path / "plate.png", tmp_path / "thing.ply"
    code = encode(np.clip(white_balanced(sky_lit_dive()), 0.0, 1.0), "srgb")
    assert cv2.imwrite(str(plate), np.round(255.0 * code).astype(np.uint8)[..., ::-1])
    trimesh.creation.box((0.3, 0.3, 0.3)).export(thing)

    def said(*options: str) -> tuple[str, str]:
        status, out, err = run("new", plate, thing, "--backend", "reference", "--overwrite", *options)
        assert (status, err) == (0, "")
        return out, (tmp_path / "plate.toml").read_text("utf-8")

    text, scene = said()
    assert "where     a guess: under water" in text
    assert text.count("say it by --water or --air") == 1
    assert 'type = "none"' not in scene
    text, scene = said("--water")
    assert "where     under water, as you say:" in text
    assert "--water or --air" not in text
    assert 'type = "none"' not in scene
    text, scene = said("--air")
    assert "where     in air, as you say, though it looks under water" in text
    assert 'type = "none"' in scene
    status, _, err = run("new", plate, thing, "--water", "--air")
    assert (status, "exclude each other" in err) == (2, True)


def test_a_strobe_on_the_ground_does_not_make_it_air() -> None:
    image = water((0.02, 0.15, 0.3))
    image[SIZE[0] * 5 // 8 :] = (0.3, 0.2, 0.15)
    assert water_or_air(image).underwater


@pytest.mark.parametrize(("contrast", "floor"), [(0.0, False), (0.1, True)])
def test_a_faint_floor_is_told_from_grain(
    tmp_path: Path, contrast: float, floor: bool, rng: np.random.Generator
) -> None:
    wide = water((0.03, 0.06, 0.05)).repeat(4, axis=0).repeat(4, axis=1)
    x, y, z = np.moveaxis(directions(wide.shape[1], wide.shape[0]), -1, 0)
    rocks = np.where((y < -0.3) & (np.sin(9.0 * x / np.minimum(y, -0.3)) * np.sin(9.0 * z / y) > 0.3), contrast, 0.0)
    code = encode(wide * (1.0 - rocks[..., None]), "srgb") + rng.normal(0.0, 0.012, wide.shape)  # 3 codes of grain
    assert cv2.imwrite(
        str(tmp_path / "plate.png"), np.round(255.0 * np.clip(code, 0.0, 1.0)).astype(np.uint8)[..., ::-1]
    )
    assert look_at_plate(tmp_path / "plate.png").floor == floor


@pytest.mark.parametrize("azimuth", [-150.0, -60.0, 0.0, 100.0, 175.0])
def test_the_part_without_texture_is_found(azimuth: float, rng: np.random.Generator) -> None:
    image = water((0.02, 0.15, 0.3))
    image *= np.exp(rng.normal(0.0, 0.5, SIZE))[..., None].astype(np.float32)
    x, y, z = np.moveaxis(directions(SIZE[1], SIZE[0]), -1, 0)
    about = np.degrees(np.arctan2(x, -z)) - azimuth
    free = (np.abs((about + 180.0) % 360.0 - 180.0) < 25.0) & (np.abs(np.degrees(np.arcsin(y)) - 5.0) < 18.0)
    image[free] = (0.02, 0.15, 0.3)
    found = free_view(image, (-8.0, 18.0), underwater=True)
    off = (found[0] - azimuth + 180.0) % 360.0 - 180.0
    assert abs(off) <= 15.0  # anywhere inside of a part that is wider than what is looked for by 24 degrees


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("greySnapper_vertColor", "snapper"), ("Humpback-Whale", "whale"), ("whale_shark", "whaleshark"),
        ("clownFish2", "clownfish"), ("parrotfish", "fish"), ("fish_0001", "fish"), ("old shipwreck", "shipwreck"),
        ("Duck", "duck"), ("scuba_diver", "scuba"), ("CesiumMilkTruck", "truck"), ("robot-arm", "robot"),
        ("sphere", None), ("carpet", None), ("tray", None), ("", None),
    ],
)  # fmt: skip
def test_things_are_known_by_their_name(name: str, word: str | None) -> None:
    kind = kind_of(name)
    assert (kind.word if kind else None) == word


@pytest.mark.parametrize(
    ("name", "units", "size_m"),
    [
        ("snapper", 40.0, 0.4), ("snapper", 0.4, 0.4), ("snapper", 400.0, 0.4), ("whale", 9.0, 9.0),
        ("whale", 900.0, 9.0), ("diver", 1800.0, 1.8), ("duck", 1.65, 0.4), ("thing", 3.0, 3.0),
        ("thing", 120.0, 1.2), ("thing", 9000.0, 9.0), ("thing", 1e6, 1.0), ("thing", 1e-5, 1.0),
    ],
)  # fmt: skip
def test_the_size_is_one_that_a_thing_can_have(tmp_path: Path, name: str, units: float, size_m: float) -> None:
    path = tmp_path / f"{name}.ply"
    trimesh.creation.box((0.2 * units, 0.3 * units, units)).export(path)
    assert look_at_mesh(path).size_m == pytest.approx(size_m)


def test_machines_are_in_millimetres_before_centimetres_and_stand(tmp_path: Path) -> None:
    hull, tower = trimesh.creation.box((15000, 3000, 2000)), trimesh.creation.box((2000, 2000, 4000))
    tower.apply_translation((-4000, 0, 2000))
    ship = trimesh.util.concatenate([hull, tower])
    for suffix in ("stl", "obj", "ply"):
        ship.export(tmp_path / f"ship.{suffix}")
        look = look_at_mesh(tmp_path / f"ship.{suffix}")
        assert (look.size_m, look.up) == (15.0, "z")
        assert look.extent[1] == pytest.approx(5000 / 15000)
        kept = look_at_mesh(tmp_path / f"ship.{suffix}", up="y")
        assert (kept.up, kept.extent[1]) == ("y", pytest.approx(3000 / 15000))


@pytest.mark.parametrize("turned", [0, 1, 2, 3])
def test_the_front_is_the_thick_end_of_a_long_body(tmp_path: Path, turned: int) -> None:
    fish = trimesh.creation.cone(0.25, 1.0, sections=24)  # along +z, thick at z = 0: its tail is +z
    fish.apply_scale((0.6, 1.0, 1.0))
    fish.apply_transform(trimesh.transformations.rotation_matrix(np.radians(90.0 * turned), (0.0, 1.0, 0.0)))
    fish.export(tmp_path / "fish.ply")
    fronts: list[Front] = ["-z", "-x", "+z", "+x"]
    look = look_at_mesh(tmp_path / "fish.ply")
    assert (look.front, look.long, look.habit) == (fronts[turned], True, "swims")


def test_a_wide_thing_has_its_front_at_z_and_one_with_its_foot_at_the_origin_stands(tmp_path: Path) -> None:
    mask = trimesh.creation.cone(0.5, 0.4, sections=24)
    mask.apply_scale((2.0, 1.0, 1.0))
    mask.apply_translation((0.0, 0.5, 0.0))
    mask.export(tmp_path / "mask.ply")
    look = look_at_mesh(tmp_path / "mask.ply")
    assert (look.front, look.long, look.habit) == ("+z", False, "stands")


def floor_seen(height_m: float, sight_m: float) -> Floats:
    """Return a panorama (512, 1024, 3) of patches of sand under water of a visibility, each pixel a mean of 16."""
    ray, patch_m = directions(4096, 2048), 0.15 * height_m
    down = np.maximum(-ray[..., 1], 1e-3)
    cells = np.random.default_rng(7).uniform(0.3, 1.0, (512, 512))
    j, i = (np.floor(ray[..., k] / down * height_m / patch_m).astype(int) % 512 for k in (0, 2))
    left = np.where(ray[..., 1] < 0.0, np.exp(-4.8 * height_m / down / sight_m), 0.0)
    fine = left * cells[j, i] + (1.0 - left) * 0.6
    light = fine.reshape(512, 4, 1024, 4).mean(axis=(1, 3))[..., None] * np.array([0.05, 0.3, 0.35])
    return (light + np.random.default_rng(8).normal(0.0, 1e-4, light.shape)).astype(np.float32)


def sight_in(image: Floats, height_m: float | None, water_type: JerlovType = "II", *, known: bool = False) -> Sight:
    """Return the visibility that is found in a panorama, from a camera 6 m deep."""
    open_water = free_view(image, (-8.0, 18.0), underwater=True)
    return guess_sight(image, height_m, Water.jerlov(water_type), open_water, 6.0, known=known)


@pytest.mark.parametrize(("height_m", "sight_m"), [(2.0, 10.0), (2.0, 25.0), (4.0, 40.0)])
def test_the_floor_tells_the_visibility(height_m: float, sight_m: float) -> None:
    image = floor_seen(height_m, sight_m)
    found = sight_in(image, height_m, known=True)
    assert found.by
    assert found.low_m < sight_m < found.high_m
    assert found.visibility_m == pytest.approx(sight_m, rel=0.1)  # each row of the floor has some tens of patches
    unsure = sight_in(image, height_m)
    assert unsure.high_m / unsure.low_m > found.high_m / found.low_m


def test_the_floor_tells_the_visibility_below_water_that_glows_on_one_side() -> None:
    image = floor_seen(2.0, 25.0)
    image[:256] *= (1.0 + 0.5 * np.sin(np.linspace(-np.pi, np.pi, 1024)))[:, None]
    found = sight_in(image, 2.0, known=True)
    assert found.by.startswith("contrast")
    assert found.visibility_m == pytest.approx(25.0, rel=0.1)


@pytest.mark.parametrize("albedo", [0.0, 0.02])
def test_dark_places_of_the_floor_tell_the_least_visibility(albedo: float) -> None:
    """Half of the floor is black rock and half is white sand, both smooth: no contrast of the floor tells anything."""
    height_m, sight_m, gain = 1.5, 45.0, 0.8
    ray = directions(1024, 512)
    up = ray[:, 0, 1]
    medium = Medium(water_seen_as_far(Water.jerlov("II"), sight_m), camera_depth_m=6.0)
    way, below = height_m / np.maximum(-up, 1e-3), up < -0.02
    veil, left = medium.unit_veil(way[below], up[below]), medium.transmittance(way[below], 6.0, up[below])
    light = np.repeat(medium.level_radiance(up)[:, None], 1024, axis=1)
    irradiance = medium.irradiance(6.0 + height_m)
    for half, factor in ((slice(0, 512), albedo), (slice(512, 1024), 0.5)):
        light[below, half] = (veil + left * factor / np.pi * irradiance)[:, None]
    image = (gain * light + np.random.default_rng(3).normal(0.0, 1e-3, light.shape)).astype(np.float32)
    found = sight_in(image, height_m, known=True)
    assert found.by.startswith("dark")
    # light of rock may be veil as well: then less is told; the colour of open water is a mean over 18 degrees
    assert 0.7 * sight_m * (1.0 if albedo == 0.0 else 0.5) < found.visibility_m < 1.15 * sight_m
    assert found.low_m < found.visibility_m < found.high_m


def test_blacks_without_veil_are_in_the_shade() -> None:
    """An edit has crushed the blacks of the floor; its white half has no texture that could tell anything."""
    open_water = Medium(Water.jerlov("IA"), camera_depth_m=6.0).level_radiance(directions(1024, 512)[:, 0, 1])
    image = np.repeat(80.0 * open_water[:, None], 1024, axis=1)
    image[264:, :512], image[264:, 512:] = 0.002, 0.4
    found = sight_in(image.astype(np.float32), 1.5, "IA", known=True)
    assert found.by.startswith("dark")
    assert found.visibility_m == pytest.approx(60.0)
    assert 0.9 < found.shade <= 1.0


def test_open_water_tells_no_visibility() -> None:
    found = sight_in(water((0.02, 0.15, 0.3)), 2.0)
    assert (found.visibility_m, found.low_m, found.high_m, found.by) == (20.0, 10.0, 40.0, "")
    assert sight_in(water((0.06, 0.16, 0.08)), None, "5C").visibility_m == pytest.approx(9.5, abs=0.05)
