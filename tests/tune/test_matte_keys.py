# SPDX-License-Identifier: Apache-2.0
"""Mattes that are drawn at some frames of a clip are carried to the others, also across the seam."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw.base.sphere import direction_from_angles, directions
from mr360uw.composite.settings import HoldoutSettings
from mr360uw.errors import OutputError, ParameterError
from mr360uw.render.mattes import Mattes
from mr360uw.tune.lasso import CarriedMatte, Matte, check_own, key_file, named_path, png, write_frames
from mr360uw.types import Floats

WIDTH, HEIGHT, COUNT = 512, 256, 9
EDGE = 0.05
"""Sum of differences from a disc's true coverage over that of the disc: a third of a pixel along its edge."""


def disc(middle: Floats, radius: float) -> Matte:
    """Return the matte of a disc about a direction, with an edge of two pixels. radius: [rad]."""
    away = np.arccos(np.clip(directions(WIDTH, HEIGHT) @ middle, -1.0, 1.0))
    return np.rint(255.0 * np.clip(0.5 + (radius - away) / (4.0 * np.pi / WIDTH), 0.0, 1.0)).astype(np.uint8)


def write(folder: Path, keys: dict[int, Matte], last: int) -> list[tuple[int, int]]:
    """Write keys, the one of a frame last, and the frames that they change; return the progress that was told."""
    folder.mkdir(exist_ok=True)
    for index, matte in keys.items():
        key_file(folder, index).write_bytes(png(matte))
    told: list[tuple[int, int]] = []
    write_frames(folder, COUNT, last, lambda done, total: told.append((done, total)))
    return told


@pytest.mark.parametrize(("start_deg", "end_deg"), [((-20.0, -10.0), (30.0, 40.0)), ((165.0, 5.0), (-150.0, 20.0))])
def test_a_disc_moves_along_a_great_circle_and_grows(
    start_deg: tuple[float, float], end_deg: tuple[float, float]
) -> None:
    one, other = (direction_from_angles(*np.radians(place)) for place in (start_deg, end_deg))
    radii = np.radians([8.0, 14.0])
    matte = CarriedMatte({2: disc(one, radii[0]), 6: disc(other, radii[1])})
    angle = np.arccos(one @ other)
    for index in (3, 4, 5):
        share = (index - 2) / 4.0
        middle = (np.sin((1.0 - share) * angle) * one + np.sin(share * angle) * other) / np.sin(angle)
        expected = disc(middle, (1.0 - share) * radii[0] + share * radii[1]) / 255.0
        got = matte.at(index) / 255.0
        assert abs(got.sum() / expected.sum() - 1.0) < EDGE
        assert np.abs(got - expected).sum() / expected.sum() < EDGE


def test_it_stays_before_the_first_and_after_the_last_key() -> None:
    first, last = (disc(direction_from_angles(angle, 0.2), 0.2) for angle in (0.0, 0.5))
    matte = CarriedMatte({2: first, 6: last})
    for index, expected in ((0, first), (2, first), (6, last), (8, last)):
        assert matte.at(index) is expected


def test_frames_are_a_sequence_as_holdouts_take_it(tmp_path: Path) -> None:
    discs = {index: disc(direction_from_angles(0.1 * index, 0.2), 0.2) for index in (1, 4, 6)}
    folder = tmp_path / "matte-1"
    assert write(folder, {1: discs[1]}, 1) == []
    assert named_path(folder) == key_file(folder, 1)
    still = Mattes([HoldoutSettings(path=named_path(folder))], WIDTH, HEIGHT)
    write(folder, {6: discs[6]}, 6)
    path = named_path(folder)
    assert path.name == "%04d.png"
    mattes = Mattes([HoldoutSettings(path=path)], WIDTH, HEIGHT)
    mattes.check(COUNT)
    for clip, index, key in ((still, 5, 1), (mattes, 0, 1), (mattes, 1, 1), (mattes, 8, 6)):
        found, _ = clip.at(index)
        assert found is not None
        np.testing.assert_allclose(found, discs[key] / 255.0, atol=1e-6)
    between, _ = mattes.at(4)
    assert between is not None
    assert not np.array_equal(between, discs[4] / 255.0)
    before = {index: (folder / f"{index:04d}.png").stat().st_mtime_ns for index in range(COUNT)}
    told = write(folder, {4: discs[4]}, 4)
    assert told[-1] == (4, 4)  # frames 2 to 5
    changed = [k for k in range(COUNT) if (folder / f"{k:04d}.png").stat().st_mtime_ns != before[k]]
    assert changed == [2, 3, 4, 5]
    found, _ = mattes.at(4)
    assert found is not None
    np.testing.assert_allclose(found, discs[4] / 255.0, atol=1e-6)


def test_keys_of_a_matte_that_cannot_be_carried_are_refused(tmp_path: Path) -> None:
    whole = disc(direction_from_angles(0.0, 0.0), 0.2)
    with pytest.raises(ParameterError, match="differ in size"):
        CarriedMatte({0: whole, 4: whole[::2, ::2]})
    with pytest.raises(ParameterError, match="is empty"):
        CarriedMatte({0: whole, 4: np.zeros_like(whole)}).at(2)
    folder = tmp_path / "matte-1"
    write(folder, {0: whole}, 0)
    key_file(folder, 3).write_bytes(b"no picture")
    with pytest.raises(ParameterError, match="no picture"):
        write_frames(folder, COUNT, 3, lambda done, total: None)  # noqa: ARG005 - the signature of progress


def test_only_pictures_that_were_drawn_here_are_replaced(tmp_path: Path) -> None:
    """A picture of another program, one that was painted over, and anything else of that name is refused."""
    matte, file = disc(direction_from_angles(0.0, 0.0), 0.2), tmp_path / "key-0003.png"
    check_own([file])
    file.write_bytes(png(matte))
    check_own([file])
    read = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, matte)
    assert cv2.imwrite(str(file), read)
    for data in (file.read_bytes(), png(matte)[:-20], png(matte) + b"0", b""):
        file.write_bytes(data)
        with pytest.raises(OutputError, match="no matte that was drawn here"):
            check_own([tmp_path / "none.png", file])
