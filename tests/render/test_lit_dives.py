# SPDX-License-Identifier: Apache-2.0
"""Bodies near a bright floor against path tracing; see tests/lit_dives.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.lit_dives import DIVES, compared, composed, regions_of
from tests.tolerances import LIT, LIT_AWAY, LIT_FLOOR, LIT_SIGMAS, LIT_TURBID, RENDERERS_ON_DIVES


def allowed(name: str, region: str) -> float:
    """Return the relative error that a region of a dive may have."""
    if name == "turbid":
        return LIT_TURBID
    return LIT_FLOOR if region == "floor" else LIT_AWAY if "away" in region or region == "umbra" else LIT


@pytest.mark.parametrize("name", DIVES)
def test_bodies_near_a_floor_have_the_light_of_path_tracing(name: str, tmp_path: Path) -> None:
    for region, ratio, noise in compared(name, "reference" if name == "sand" else "gl", tmp_path):
        assert np.all(np.abs(ratio - 1.0) < allowed(name, region) + LIT_SIGMAS * noise), (region, ratio)


def test_renderers_agree_on_a_dive_over_a_floor(tmp_path: Path) -> None:
    pictures = [composed("near", backend, tmp_path).image_linear for backend in ("reference", "gl")]
    for mask in regions_of(DIVES["near"]).values():
        one, other = (picture[mask].mean(axis=0) for picture in pictures)
        np.testing.assert_allclose(one, other, rtol=RENDERERS_ON_DIVES)
