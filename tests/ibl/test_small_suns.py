# SPDX-License-Identifier: Apache-2.0
"""Small clipped discs inside an aureole: still the sun. An aureole or a cloud alone: not."""

from __future__ import annotations

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.sphere import directions, unit
from tests.ibl.plates import angle_deg, clipped
from tests.ibl.tolerances import SUN_HDR_DEG

TOWARDS = unit([0.3, 0.6, 0.3])
WIDTH = 2048


def hazy(disc_deg: float, aureole: float, wide_deg: float) -> np.ndarray:
    """Return a clipped sky with a disc of this radius in an aureole that falls by 1/e in `wide_deg`."""
    d = directions(WIDTH, WIDTH // 2)
    away = np.degrees(np.arccos(np.clip(d @ TOWARDS, -1.0, 1.0)))
    sky = np.where(d[..., 1] > 0.0, 0.15 + 0.1 * d[..., 1], 0.08) + aureole * np.exp(-away / wide_deg)
    return clipped(np.repeat((sky + 50.0 * (away < disc_deg))[..., None], 3, axis=2).astype(np.float32))


@pytest.mark.parametrize("disc_deg", [0.2, 0.27])
@pytest.mark.parametrize(("aureole", "wide_deg"), [(0.3, 8.0), (0.6, 3.0), (0.6, 8.0), (0.8, 3.0)])
def test_a_small_disc_in_its_aureole_is_the_sun(disc_deg: float, aureole: float, wide_deg: float) -> None:
    sun = ibl.detect_sun(hazy(disc_deg, aureole, wide_deg))
    assert sun is not None
    assert sun.confidence > 0.9
    assert angle_deg(sun.direction, TOWARDS) < SUN_HDR_DEG


@pytest.mark.parametrize("wide_deg", [12.0, 25.0])
def test_a_bright_haze_without_a_disc_is_not(wide_deg: float) -> None:
    sun = ibl.detect_sun(hazy(0.0, 0.8, wide_deg))
    assert sun is None or sun.confidence < 0.5
