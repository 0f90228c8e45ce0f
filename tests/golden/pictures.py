# SPDX-License-Identifier: Apache-2.0
"""The golden pictures: how a layer becomes one, and where it is kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import over
from mr360uw.types import Layer
from tests.composite.scenes import codes, eight_shots, plate

WIDTH = 128
FOLDER = Path(__file__).parent
NAMES = ("materials", "alpha", "seam", "zenith", "nadir", "deep", "shadow", "holdout")
_STEPS = 257.0
"""16-bit steps of one 8-bit code."""


def shots() -> dict[str, Shot]:
    """Return the scenes by name, the same at every call."""
    return eight_shots(np.random.default_rng(360), WIDTH)


def composite_codes(render: Callable[[Shot], Layer], shot: Shot) -> np.ndarray:
    """Return the composite (64, 128, 3) over the plate in 8-bit codes, not rounded."""
    return codes(over(plate(WIDTH), render(shot)))


def write_golden(name: str, picture: np.ndarray) -> None:
    """Write codes as a PNG of 16 bits."""
    steps = np.round(picture * _STEPS).astype(np.uint16)
    cv2.imwrite(str(FOLDER / f"{name}.png"), steps[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def read_golden(name: str) -> np.ndarray:
    """Return the codes (64, 128, 3) of a golden picture."""
    return cv2.imread(str(FOLDER / f"{name}.png"), cv2.IMREAD_UNCHANGED)[..., ::-1] / _STEPS
