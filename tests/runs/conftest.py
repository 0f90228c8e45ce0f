# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from mr360uw.sample import SampleDive, sample_dive

COARSE = """[draw]
samples = 1
sun_samples = 1
ambient_occlusion = false
"""


@pytest.fixture(scope="session")
def dive(tmp_path_factory: pytest.TempPathFactory) -> SampleDive:
    """A sample dive of eight frames, 128x64, drawn coarsely: how runs go on does not depend on the pictures.

    Narrower ones are no test of packets: there x264 reads memory that it has not written, and its choices vary.
    """
    dive = sample_dive(tmp_path_factory.mktemp("dive"), width=128, frames=8)
    text = dive.scene.read_text("utf-8")
    assert "[draw]\n" in text
    dive.scene.write_text(text.replace("[draw]\n", COARSE), "utf-8")
    return dive
