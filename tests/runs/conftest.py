# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from mr360uw.sample import SampleDive, sample_dive
from tests.conftest import MadeOnce

COARSE = {
    "draw": "samples = 1\nsun_samples = 1\nambient_occlusion = false\n",
    "water": "bands = 8\nrough = true\n",
    "receiver": "occlusion = false\n",
    "caustics": "size = 64\ngrid = 32\nplanes = 2\n",
    "[object]": "casts_shadow = false\n",
}


@pytest.fixture(scope="session")
def dive(made_once: MadeOnce) -> SampleDive:
    """A sample dive of eight frames, 128x64, drawn coarsely: how runs go on does not depend on the pictures.

    Narrower ones are no test of packets: there x264 reads memory that it has not written, and its choices vary.
    """
    dive = made_once("small dive", lambda folder: sample_dive(folder, width=128, frames=8))
    text = dive.scene.read_text("utf-8")
    for table, settings in COARSE.items():
        assert f"[{table}]\n" in text
        text = text.replace(f"[{table}]\n", f"[{table}]\n{settings}")
    dive.scene.write_text(text, "utf-8")
    return dive
