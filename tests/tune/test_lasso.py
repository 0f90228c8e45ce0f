# SPDX-License-Identifier: Apache-2.0
"""A matte from an outline: what stands out inside of it, also across the seam; errors where there is nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.tune.lasso import free_name, matte_of_outline
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


def outline(column: float) -> list[Point]:
    """Return points around the disc, a fifth to a half farther out."""
    found = []
    for k in range(9):
        angle, far = 2.0 * np.pi * k / 9, RADIUS * (1.2 + 0.3 * (k % 2))
        x, y = (column + far * np.cos(angle)) % WIDTH, 150.0 + far * np.sin(angle)
        found.append(Point((x / WIDTH - 0.5) * 2.0 * np.pi, (0.5 - y / HEIGHT) * np.pi))
    return found


@pytest.mark.parametrize("column", [200.0, 5.0, 505.0])
def test_the_matte_is_what_stands_out_inside_of_the_outline(column: float, rng: np.random.Generator) -> None:
    picture, cover = thing(column, rng)
    matte = matte_of_outline(picture, outline(column)) / 255.0
    assert abs(matte.sum() / cover.sum() - 1.0) < COVERED
    assert np.abs(matte - cover).mean() * cover.size / cover.sum() < EDGE


def test_a_matte_is_the_same_each_time(rng: np.random.Generator) -> None:
    picture, _ = thing(200.0, rng)
    np.testing.assert_array_equal(*(matte_of_outline(picture, outline(200.0)) for _ in range(2)))


def test_outlines_of_nothing_are_refused(rng: np.random.Generator) -> None:
    picture, _ = thing(200.0, rng)
    with pytest.raises(ParameterError, match="three points"):
        matte_of_outline(picture, outline(200.0)[:2])
    with pytest.raises(ParameterError, match="nothing stands out"):
        matte_of_outline(np.full_like(picture, 90), outline(200.0))


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "matte-1.png").write_bytes(b"")
    assert free_name(tmp_path) == "matte-2.png"
