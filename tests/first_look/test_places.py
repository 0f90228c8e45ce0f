# SPDX-License-Identifier: Apache-2.0
"""Where things are put: on even ground near by if they stand, in open water if they swim, as asked if it is asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mr360uw import load_scene
from mr360uw.base.sphere import directions
from mr360uw.first_look.observations import kind_of, look_at_mesh, water_or_air
from mr360uw.first_look.place_in_plate import Place, Wish, ground_place, nearer, shows_ground
from mr360uw.types import Floats
from tests.first_look.plates import SIZE, air, water
from tests.first_look.test_first_scene import mesh, picture

Run = Callable[..., tuple[int, str, str]]
DROP_M = 1.6


def garden(free_deg: float, rng: np.random.Generator) -> Floats:
    """Return a sky over grass (256, 512, 3): slabs lie about, but for one side; behind is a wall from 4 m away on."""
    x, y, z = np.moveaxis(directions(512, 256), -1, 0)
    grass = np.exp(rng.normal(0.0, 0.3, (256, 512)))[..., None] * np.array((0.08, 0.12, 0.03))
    away = np.degrees(np.abs((np.arctan2(x, -z) - np.radians(free_deg) + np.pi) % (2.0 * np.pi) - np.pi))
    with np.errstate(divide="ignore", invalid="ignore"):
        on_ground = [v * DROP_M / np.maximum(-y, 1e-3) for v in (x, z)]
    slabs = (np.sin(4.0 * on_ground[0]) * np.sin(4.0 * on_ground[1]) > 0.2) & (away > 30.0)
    wall = (y > -DROP_M / np.hypot(4.0, DROP_M)) & (y < 0.3) & (away > 70.0)
    seen = np.where(slabs[..., None], 0.5, grass)
    seen = np.where((y > 0.0)[..., None], (0.3, 0.5, 0.9), seen)
    return np.where(wall[..., None], 0.25 * np.exp(rng.normal(0.0, 0.1, (256, 512)))[..., None], seen)


@pytest.mark.parametrize("free_deg", [-140.0, 0.0, 95.0])
def test_things_stand_on_even_ground_before_no_wall(free_deg: float, rng: np.random.Generator) -> None:
    azimuth_deg, _, cost = ground_place(
        garden(free_deg, rng),
        DROP_M,
        (0.8, 0.8, 1.0),
        np.geomspace(1.9, 4.4, 7),
        np.arange(-180.0, 180.0, 5.0),
        2.5,
    )
    off = abs((azimuth_deg - free_deg + 180.0) % 360.0 - 180.0)
    assert off <= 25.0  # the free side is 60 degrees wide, the foot 10 to 24
    assert cost < 0.9


def test_things_stand_where_the_plate_has_room_for_them(rng: np.random.Generator) -> None:
    """Grass all around, but distances say that what looks alike ahead is a wall 1.8 m away."""
    grass = np.exp(rng.normal(0.0, 0.3, (256, 512)))[..., None] * np.array((0.08, 0.12, 0.03))

    def shown_m(d: Floats) -> Floats:
        level = DROP_M / np.maximum(-d[..., 1], 1e-6)
        wall = np.where(d[..., 2] < 0.0, 1.8 / np.maximum(np.hypot(d[..., 0], d[..., 2]), 1e-6), np.inf)
        found = np.minimum(level, wall)
        return np.where(found < 50.0, found, np.inf)

    image = np.where(directions(512, 256)[..., 1:2] > 0.0, (0.3, 0.5, 0.9), grass)
    given = (image, DROP_M, (0.8, 0.8, 1.0), np.geomspace(1.9, 4.4, 7), np.arange(-180.0, 180.0, 5.0), 2.5)
    assert abs(ground_place(*given)[0]) < 60.0  # the middle of the frame, all else being equal
    assert abs(ground_place(*given, shown_m)[0]) >= 95.0


def test_nothing_stands_in_a_wall_that_looks_like_the_ground(rng: np.random.Generator) -> None:
    """Stones all around, and ahead a wall of them from 5 m away on, without an edge where it meets the ground."""
    x, y, z = np.moveaxis(directions(512, 256), -1, 0)
    stones = 0.2 * np.exp(rng.normal(0.0, 0.3, (256, 512)))[..., None] * np.ones(3)
    wall = (y < 0.2) & (np.abs(np.arctan2(x, -z)) < np.radians(60.0))
    image = np.where(((y > 0.0) & ~wall)[..., None], (0.3, 0.5, 0.9), stones)
    given = (DROP_M, (4.5, 2.0, 2.5), np.geomspace(6.7, 14.0, 7), np.arange(-180.0, 180.0, 5.0), 6.7)
    assert 60.0 < abs(ground_place(image, *given)[0]) < 120.0  # beside it, and not farther from ahead than that takes


def test_what_is_brought_nearer_stays_clear_of_the_ground(tmp_path: Path) -> None:
    far = Place(
        stands=False, hangs=False, size_m=5.0, smaller=False, azimuth_deg=30.0, elevation_deg=2.0, distance_m=10.0,
        drop_m=1.3, uneven=0.0, top_m=1.4, face="camera",
    )  # fmt: skip
    box = look_at_mesh(mesh(tmp_path / "whale.ply", 5.0))  # 2.5 m high
    near = nearer(far, 5.0, box, Wish())
    middle = near.distance_m * np.sin(np.radians(near.elevation_deg))
    assert near.distance_m == 5.0
    assert middle - 0.5 * 2.5 >= -1.3 + 0.29
    assert near.top_m == pytest.approx(middle + 0.5 * 2.5, abs=1e-6)
    assert nearer(far, 5.0, box, Wish(at_deg=(30.0, 2.0))).elevation_deg == 2.0


def test_open_water_below_is_no_ground(rng: np.random.Generator) -> None:
    deep = water((0.02, 0.15, 0.3)) * np.exp(rng.normal(0.0, 0.01, (*SIZE, 1)))
    assert not shows_ground(deep)
    assert shows_ground(garden(0.0, rng))


def test_half_under_water_is_told_from_water_and_air() -> None:
    sea = water((0.02, 0.15, 0.3))
    both = np.where(directions(SIZE[1], SIZE[0])[..., 1:2] > 0.0, air(), sea)
    found = [water_or_air(image) for image in (both, sea, air())]
    assert [(one.underwater, one.half) for one in found] == [(True, True), (True, False), (False, False)]


def test_parts_name_a_thing_whose_file_does_not() -> None:
    kind = kind_of("model_final", ["Plane", "salmon_body"])
    assert kind is not None
    assert (kind.word, kind.habit) == ("salmon", "swims")
    assert kind_of("model_final", ["Plane", "Cube.001"]) is None


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("fish.ply", (), "stands"),
        ("gull.ply", (), "off"),
        ("thing.ply", ("--at", "30,-25", "--size", "0.5"), "at"),
        ("thing.ply", ("--at=-60,10", "--swim"), "off"),
    ],
)
def test_in_air_all_but_birds_stand_and_wishes_hold(
    tmp_path: Path, run: Run, name: str, options: tuple[str, ...], expected: str
) -> None:
    plate = picture(tmp_path / "garden.png", air())
    code, said, err = run("new", plate, mesh(tmp_path / name, 0.6), "--backend", "reference", *options)
    assert (code, err) == (0, "")
    body = load_scene(tmp_path / "garden.toml").objects[0]
    assert (body.stand_on is None) == (expected == "off")
    assert ("stands on the floor" in said) == (expected != "off")
    if expected == "at":
        assert (body.azimuth_deg, body.size_m) == (30.0, 0.5)
        assert body.distance_m == pytest.approx(DROP_M / np.tan(np.radians(25.0)), rel=0.01)
    if "--swim" in options:
        assert (body.azimuth_deg, body.elevation_deg) == (-60.0, 10.0)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--stand", "--swim"), "exclude each other"),
        (("--at", "30"), "--at - is no direction"),
        (("--at", "30,10"), "meets no ground"),
        (("--at", "30,100"), "--at - is no direction"),
        (("--size", "0"), "--size - must be above 0"),
    ],
)
def test_wishes_that_cannot_be_are_refused(tmp_path: Path, run: Run, options: tuple[str, ...], says: str) -> None:
    plate = picture(tmp_path / "garden.png", air())
    code, _, err = run("new", plate, mesh(tmp_path / "thing.ply", 1.0), *options)
    assert code == 2
    assert says in err
    assert not (tmp_path / "garden.toml").exists()
