# SPDX-License-Identifier: Apache-2.0
"""How far a fit changes with the frames that it is made of: the bootstrap (Efron 1979)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.shapes import whole

Frame = TypeVar("Frame")
Fitted = TypeVar("Fitted")


def resampled(fit: Callable[[list[Frame]], Fitted], frames: Sequence[Frame], draws: int, seed: int) -> list[Fitted]:
    """Return what a fit gives of so many draws of as many frames, with replacement; `ParameterError` without frames."""
    whole("draws", draws, 2, 1_000_000)
    if not len(frames):
        raise ParameterError("frames - must hold one or more (got none) - give the frames of a clip")
    drawn = np.random.default_rng([seed, 0xB007]).integers(0, len(frames), (draws, len(frames)))
    return [fit([frames[k] for k in row]) for row in drawn]
