# SPDX-License-Identifier: Apache-2.0
"""Both renderers against stored pictures, so that they cannot drift together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from mr360uw.composite import render_layer
from mr360uw.composite.shot import Shot
from tests.composite.scenes import codes, plate
from tests.golden import tolerances as tol
from tests.golden.pictures import FOLDER, NAMES, WIDTH, composite_codes, read_golden, shots

if TYPE_CHECKING:
    from mr360uw.composite.gl.layer_renderer import LayerRenderer


@pytest.fixture(scope="module")
def scenes() -> dict[str, Shot]:
    return shots()


@pytest.fixture(scope="module")
def renderer(request: pytest.FixtureRequest) -> LayerRenderer:
    request.getfixturevalue("gl")
    from mr360uw.composite.gl.layer_renderer import LayerRenderer

    return LayerRenderer()


def test_every_scene_has_its_picture_and_shows_in_it(scenes: dict[str, Shot]) -> None:
    assert tuple(scenes) == NAMES
    assert sorted(path.stem for path in FOLDER.glob("*.png")) == sorted(NAMES)
    bare = codes(plate(WIDTH))
    for name in NAMES:
        changed = np.abs(read_golden(name) - bare).max(axis=-1) > tol.SEEN_CODES
        assert changed.mean() > tol.SEEN_FRACTION, name


@pytest.mark.parametrize("name", NAMES)
def test_the_reference_draws_what_it_drew(name: str, scenes: dict[str, Shot]) -> None:
    off = np.abs(composite_codes(render_layer, scenes[name]) - read_golden(name)).max(axis=-1)
    assert np.mean(off <= tol.GOLDEN_CODES) >= tol.RENDERERS_FRACTION
    assert np.sqrt(np.mean(off**2)) <= tol.GOLDEN_RMS_CODES


@pytest.mark.parametrize("name", NAMES)
def test_opengl_draws_the_same(name: str, scenes: dict[str, Shot], renderer: LayerRenderer) -> None:
    off = np.abs(composite_codes(renderer.render, scenes[name]) - read_golden(name))
    assert np.mean(off.max(axis=-1) <= tol.RENDERERS_CODES) >= tol.RENDERERS_FRACTION
    assert 20.0 * np.log10(255.0 / max(np.sqrt(np.mean(off**2)), 1e-9)) >= tol.RENDERERS_PSNR_DB
