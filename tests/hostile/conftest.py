# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from tests.hostile.bench import Bench, Material, make_material


@pytest.fixture(scope="session")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    """Good files, which the tests damage."""
    return make_material(tmp_path_factory.mktemp("good"))


@pytest.fixture
def bench(
    material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Bench:
    """A folder with a scene that runs, and the command line on it, in this process."""
    monkeypatch.chdir(tmp_path)
    return Bench(tmp_path, material, monkeypatch, capsys)
