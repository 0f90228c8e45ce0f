# SPDX-License-Identifier: Apache-2.0
"""Files that a scene names are called without detours, and are those that the system finds."""

from __future__ import annotations

from pathlib import Path

from mr360uw.scene.model import load_scene


def test_paths_have_no_way_back_in_them(tmp_path: Path) -> None:
    (tmp_path / "plates").mkdir()
    (tmp_path / "shots" / "one").mkdir(parents=True)
    (tmp_path / "plates" / "a.png").touch()
    scene = tmp_path / "shots" / "one" / "a.toml"
    scene.write_text('plate = "../../plates/a.png"\n', "utf-8")
    assert load_scene(scene).plate.path == tmp_path / "plates" / "a.png"


def test_the_way_back_from_a_linked_folder_is_that_of_the_folder_itself(tmp_path: Path) -> None:
    (tmp_path / "real" / "inner").mkdir(parents=True)
    (tmp_path / "real" / "a.png").touch()
    (tmp_path / "link").symlink_to(tmp_path / "real" / "inner")
    (tmp_path / "real" / "inner" / "a.toml").write_text('plate = "../a.png"\n', "utf-8")
    assert load_scene(tmp_path / "link" / "a.toml").plate.path == tmp_path / "real" / "a.png"
