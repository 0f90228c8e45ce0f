# SPDX-License-Identifier: Apache-2.0
"""A matte from an outline or strokes: what stands out there, also across the seam; errors where there is nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.tune.lasso import Line, free_name, is_whole, matte_of_lines, outlines_of_matte
from mr360uw.tune.placing import Point
from mr360uw.types import Floats

WIDTH, HEIGHT, RADIUS = 512, 256, 40.0
COVERED, EDGE = 0.02, 6.0 / 255.0
"""Part of the thing's pixels by which its matte may be larger or smaller: a third of a pixel along its edge. Sum of
differences from the true coverage over the thing's pixels: half a pixel along its edge."""


def thing(column: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return a panorama with a mottled orange disc on mottled blue, and the disc's coverage (h, w)."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    across = (x - column + WIDTH / 2) % WIDTH - WIDTH / 2
    cover = np.clip(RADIUS + 0.5 - np.hypot(across, y - 150.0), 0.0, 1.0)
    colours = cover[..., None] * np.array([40.0, 120.0, 200.0]) + (1.0 - cover[..., None]) * np.array(
        [150.0, 90.0, 40.0]
    )
    return np.clip(colours + rng.normal(0.0, 8.0, colours.shape), 0, 255).astype(np.uint8), cover


def point(x: float, y: float) -> Point:
    """Return the point at a column, modulo the width, and a row."""
    return Point((x % WIDTH / WIDTH - 0.5) * 2.0 * np.pi, (0.5 - y / HEIGHT) * np.pi)


def around(column: float, far: float, count: int = 9) -> tuple[Point, ...]:
    """Return points on a circle about the disc's middle."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return tuple(point(column + far * np.cos(one), 150.0 + far * np.sin(one)) for one in angles)


def outline(column: float) -> list[Line]:
    """Return points around the disc, a fifth to a half farther out, each clicked on."""
    wide, narrow = around(column, 1.5 * RADIUS), around(column, 1.2 * RADIUS)
    return [("outline", ((wide if k % 2 else narrow)[k],)) for k in range(9)]


def strokes(column: float) -> list[Line]:
    """Return a line through the disc, and one at its side from above to below."""
    over = tuple(point(column + 0.6 * RADIUS * k, 150.0) for k in (-1, 0, 1))
    beside = tuple(point(column + 1.4 * RADIUS, 150.0 + RADIUS * k) for k in (-1, 0, 1))
    return [("inside", over), ("outside", beside)]


@pytest.mark.parametrize("column", [200.0, 5.0, 505.0])
def test_the_matte_is_what_stands_out_inside_of_the_outline(column: float, rng: np.random.Generator) -> None:
    picture, cover = thing(column, rng)
    for lines in (outline(column), strokes(column)):
        matte = matte_of_lines(picture, lines) / 255.0
        assert abs(matte.sum() / cover.sum() - 1.0) < COVERED
        assert np.abs(matte - cover).mean() * cover.size / cover.sum() < EDGE


def test_strokes_correct_what_an_outline_finds(rng: np.random.Generator) -> None:
    """A patch of the thing's colour beside it is taken for it, until a stroke says that it is not; and a hole in it."""
    picture, cover = thing(200.0, rng)
    picture[145:155, 250:262] = picture[145:155, 200:212]
    hole = np.zeros_like(cover, bool)
    hole[140:160, 195:205] = True
    picture[hole] = picture[20:40, 20:30].reshape(-1, 3)
    wide: Line = ("outline", around(200.0, 1.8 * RADIUS))
    wrong = matte_of_lines(picture, [wide]) / 255.0
    assert wrong[148:152, 253:259].mean() > 0.9
    assert wrong[hole].mean() < 0.5
    lines: list[Line] = [
        wide,
        ("outside", (point(251.0, 150.0), point(261.0, 150.0))),
        ("inside", (point(200.0, 142.0), point(200.0, 158.0))),
    ]
    right = matte_of_lines(picture, lines) / 255.0
    assert right[148:152, 253:259].mean() < 0.1
    assert right[150, 198:202].mean() > 0.9


def test_the_outline_of_a_matte_goes_around_it(rng: np.random.Generator) -> None:
    for column in (200.0, 2.0):
        _, cover = thing(column, rng)
        (line,) = outlines_of_matte(np.rint(255.0 * cover).astype(np.uint8))
        assert line[0] == line[-1]
        x = np.array([(one.longitude / (2.0 * np.pi) + 0.5) * WIDTH for one in line])
        y = np.array([(0.5 - one.latitude / np.pi) * HEIGHT for one in line])
        across = (x - column + WIDTH / 2) % WIDTH - WIDTH / 2
        np.testing.assert_allclose(np.hypot(across, y - 150.0), RADIUS, atol=1.0)


def test_a_matte_is_the_same_each_time(rng: np.random.Generator) -> None:
    picture, _ = thing(200.0, rng)
    np.testing.assert_array_equal(*(matte_of_lines(picture, outline(200.0)) for _ in range(2)))


def test_outlines_of_nothing_are_refused(rng: np.random.Generator) -> None:
    picture, _ = thing(200.0, rng)
    for few in (outline(200.0)[:2], strokes(200.0)[:1]):
        assert not is_whole(few)
        with pytest.raises(ParameterError, match="three points, or a stroke"):
            matte_of_lines(picture, few)
    with pytest.raises(ParameterError, match="nothing stands out"):
        matte_of_lines(np.full_like(picture, 90), outline(200.0))


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "matte-1.png").write_bytes(b"")
    (tmp_path / "matte-2").mkdir()
    assert free_name(tmp_path) == "matte-3"
