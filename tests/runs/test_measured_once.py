# SPDX-License-Identifier: Apache-2.0
"""What is measured of a clip is used by later runs over the same plate and settings, and by no other."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.disk_cache import FOLDER
from mr360uw.runs import pipeline
from mr360uw.sample import SampleDive
from mr360uw.scene import Scene
from mr360uw.scene.model import load_scene

PASSES: list[int] = []


@pytest.fixture(scope="module")
def solved(dive: SampleDive, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """What a run keeps beside what it measures of the clip: its water, and more that no test here is about."""
    folder = tmp_path_factory.mktemp("solved")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER, str(folder))
        composited(load_scene(dive.scene), tmp_path_factory.mktemp("first") / "out.png")
    return [path for path in folder.iterdir() if path.is_file() and not path.name.startswith("first-pass-")]


@pytest.fixture(autouse=True)
def _counted(tmp_path: Path, solved: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """First passes that are run, and a folder in which none is kept."""
    monkeypatch.setenv(FOLDER, str(tmp_path / "kept"))
    (tmp_path / "kept").mkdir(mode=0o700)
    for path in solved:
        shutil.copy2(path, tmp_path / "kept")
    PASSES.clear()
    run = pipeline.clip_analysis

    def counted(*arguments: object, **options: object) -> object:
        PASSES.append(1)
        return run(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(pipeline, "clip_analysis", counted)


@pytest.fixture
def plate(dive: SampleDive, tmp_path: Path) -> Path:
    """The scene of a dive of its own."""
    shutil.copytree(dive.scene.parent, tmp_path / "dive")
    return tmp_path / "dive" / dive.scene.name


def composited(scene: Scene, out: Path, *, fresh: bool = False) -> bytes:
    uw.composite_video(scene, out, backend="reference", frames=(2, 3), overwrite=True, fresh=fresh)
    return out.read_bytes()


def test_a_second_run_measures_nothing_and_is_the_same(plate: Path, tmp_path: Path) -> None:
    scene = load_scene(plate)
    first = composited(scene, tmp_path / "out.png")
    assert len(PASSES) == 1
    assert composited(scene, tmp_path / "again.png") == first
    # objects are no part of what is measured
    composited(load_scene(plate, ["object.0.scale=0.5"]), tmp_path / "small.png")
    assert len(PASSES) == 1
    assert composited(scene, tmp_path / "again.png", fresh=True) == first
    assert len(PASSES) == 2


def test_an_analysis_of_another_kind_is_measured_anew(plate: Path, tmp_path: Path) -> None:
    first = composited(load_scene(plate), tmp_path / "out.png")
    (kept,) = (tmp_path / "kept").glob("first-pass-*.npz")
    np.savez(kept, other=np.zeros(1))
    assert composited(load_scene(plate), tmp_path / "again.png") == first
    assert len(PASSES) == 2


@pytest.mark.parametrize("change", ["camera.depth_m=5", "light.peak=20", "object=[]", "the file"])
def test_other_settings_and_other_files_are_measured(plate: Path, tmp_path: Path, change: str) -> None:
    composited(load_scene(plate), tmp_path / "out.png")
    if change == "the file":
        clip = load_scene(plate).plate.path
        os.utime(clip, ns=(0, clip.stat().st_mtime_ns + 1))
    composited(load_scene(plate, [] if change == "the file" else [change]), tmp_path / "out.png")
    assert len(PASSES) == 2
