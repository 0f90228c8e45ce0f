# SPDX-License-Identifier: Apache-2.0
"""Channels of a plate that clip one by one: filled by the colour of what is near."""

from __future__ import annotations

import numpy as np

from mr360uw.base.sphere import directions
from mr360uw.ibl import environment
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, unclipped
from mr360uw.types import Floats
from tests.ibl import tolerances as tol

UP = directions(COARSE_COLUMNS, COARSE_ROWS)[..., 1]


def water(brightest: float) -> Floats:
    """Return light (h, w, 3) that gets brighter upwards, from deep blue below to pale blue above, blue most of all."""
    level = 0.5 * (UP + 1.0)
    return (
        brightest * level[..., None] * np.stack([0.1 + 0.1 * level, 0.35 + 0.1 * level, np.ones_like(level)], axis=-1)
    )


def test_what_is_not_clipped_stays_as_it_is() -> None:
    light = water(0.79).astype(np.float32)
    np.testing.assert_array_equal(unclipped(light), light)


def test_a_clipped_channel_gets_the_colour_of_what_is_near() -> None:
    """One colour all over, of which blue is clipped in a third and green nowhere: found again to the last percent."""
    light = (water(1.0)[..., 2:] * np.array([0.2, 0.6, 1.5])).astype(np.float32)
    shown = np.minimum(light, 1.0)
    assert 0.2 < np.mean(shown[..., 2] == 1.0) < 0.5
    np.testing.assert_allclose(unclipped(shown), light, rtol=tol.FILLED_OF_ONE_COLOUR)


def test_light_from_above_is_as_blue_as_it_was() -> None:
    """Blue alone is clipped: light from above seems green."""
    light = water(2.0).astype(np.float32)
    shown = np.minimum(light, 1.0)
    up = (COARSE_ROWS // 8, 0)
    truth, filled = (
        environment(plate, sun=None, expansion=way, underwater=True).irradiance[4, 0]
        for plate, way in ((light, "none"), (shown, "closure"))
    )
    lost = environment(shown, sun=None, expansion="none", underwater=True).irradiance[4, 0]
    assert shown[up][2] == 1.0 > shown[up][1]
    blue, clipped_blue, true_blue = (float(e[2] / e[1]) for e in (filled, lost, truth))
    assert abs(np.log(blue / true_blue)) < tol.FILLED_COLOUR < 0.5 * abs(np.log(clipped_blue / true_blue))


def test_white_stays_white() -> None:
    light = np.repeat(np.minimum(1.4 * 0.5 * (UP + 1.0), 1.0)[..., None], 3, axis=-1).astype(np.float32)
    np.testing.assert_allclose(unclipped(light), light, rtol=tol.FILLED_WHITE)
