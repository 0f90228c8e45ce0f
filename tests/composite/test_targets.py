# SPDX-License-Identifier: Apache-2.0
"""What goes between the processor and the device."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.composite.gl.device import Targets
from mr360uw.gl import program_from_text

pytestmark = pytest.mark.usefixtures("gl")


def test_a_target_has_the_channels_and_the_room_that_are_asked_for() -> None:
    """Scenes drawn one after the other ask for other outputs; those of the last one must not be read as these."""
    targets = Targets()
    for kind, channels, count in (("float", 1, 5), ("vec4", 4, 3), ("float", 1, 3000), ("vec4", 4, 5)):
        text = f"out {kind} value;\nvoid main() {{ value = {kind}(gl_FragCoord.x + 0.25 * {channels}.0); }}\n"
        values = targets.items(program_from_text(fragment=text), "same name", count, (channels,))
        assert values.shape == (count, channels)
        assert np.array_equal(values % 1.0, np.full(values.shape, (0.5 + 0.25 * channels) % 1.0, np.float32))
