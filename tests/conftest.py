# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(360)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of reference values and footage beside the checkout; absent for users."""
    if not SHARED.is_dir():
        pytest.skip("the folder of reference values beside the checkout is absent")
    return SHARED


@pytest.fixture(scope="session")
def gl() -> None:
    """Skip where OpenGL 3.3 cannot be had."""
    from mr360uw.errors import GlError
    from mr360uw.gl.context import gl_context

    try:
        gl_context()
    except GlError as error:
        pytest.skip(f"no OpenGL here: {error}")
