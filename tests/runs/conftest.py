# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from mr360uw.sample import SampleDive, sample_dive


@pytest.fixture(scope="session")
def dive(tmp_path_factory: pytest.TempPathFactory) -> SampleDive:
    """A sample dive of eight frames, 128x64: how runs go on does not depend on the size of the pictures.

    Narrower ones are no test of packets: there x264 reads memory that it has not written, and its choices vary.
    """
    return sample_dive(tmp_path_factory.mktemp("dive"), width=128, frames=8)
