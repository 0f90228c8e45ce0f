# SPDX-License-Identifier: Apache-2.0
"""What goes between the processor and the device."""

from __future__ import annotations

import pytest

from mr360uw.composite.gl.device import Targets

pytestmark = pytest.mark.usefixtures("gl")


def test_a_target_has_the_channels_that_are_asked_for() -> None:
    """Scenes drawn one after the other ask for other outputs; those of the last one must not be read as these."""
    targets = Targets()
    one, four = (targets.target("same name", 8, 4, (channels,)) for channels in (1, 4))
    assert [texture.components for target in (one, four) for texture in target.color_attachments] == [1, 4]
    assert targets.target("same name", 8, 4, (1,)) is one
