# SPDX-License-Identifier: Apache-2.0
"""Camera tracks that end before the clip does."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.composite.motion import Motion
from mr360uw.errors import ParameterError
from mr360uw.render.surroundings import CameraPath


def path(rows: int) -> CameraPath:
    """Return the path of a track with rows from 1 s on, 24 a second."""
    times = 1.0 + np.arange(rows) / 24.0
    return CameraPath(5.0, Motion(times, np.zeros((rows, 3)), np.repeat(np.eye(3)[None], rows, axis=0), np.ones(rows)))


def test_a_track_covers_the_frames() -> None:
    path(49).check_times(1.0, 3.0, 24.0)
    path(49).check_times(1.0 - 1.0 / 24.0, 3.0 + 1.0 / 24.0, 24.0)
    path(1).check_times(0.0, 100.0, 24.0)
    CameraPath(5.0).check_times(0.0, 100.0, 24.0)


@pytest.mark.parametrize(("first_s", "last_s"), [(0.0, 2.0), (1.0, 3.2)])
def test_a_track_that_is_shorter_is_refused(first_s: float, last_s: float) -> None:
    with pytest.raises(ParameterError, match=r"known from 1.00 to 3.00 s only .* give --frames 24:73"):
        path(49).check_times(first_s, last_s, 24.0)
