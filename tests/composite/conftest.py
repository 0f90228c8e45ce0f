# SPDX-License-Identifier: Apache-2.0
"""A renderer for the tests of a file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from mr360uw.base.cache import Cache
from mr360uw.composite.gl.layer_renderer import LayerRenderer


@pytest.fixture(scope="module")
def _renderer_and_cache(gl: None) -> tuple[LayerRenderer, Cache]:  # noqa: ARG001 - skips without OpenGL
    cache = Cache()
    return LayerRenderer(cache), cache


@pytest.fixture
def renderer(_renderer_and_cache: tuple[LayerRenderer, Cache]) -> Iterator[LayerRenderer]:
    """One for a file, with its shaders; what it keeps between shots is let go after each test."""
    made, cache = _renderer_and_cache
    yield made
    cache.clear()
