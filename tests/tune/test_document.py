# SPDX-License-Identifier: Apache-2.0
"""Documents: edits that keep the file's text, steps, saving, changes by other programs."""

from __future__ import annotations

import os
import re
import stat
import tomllib
from pathlib import Path

import pytest

from mr360uw.base.files import rewrite
from mr360uw.errors import OutputError, OutputExistsError, ParameterError, SceneError
from mr360uw.scene.handbook import scene_text
from mr360uw.scene.model import load_scene
from mr360uw.tune.document import Document, key_of, with_entry, with_value, without
from mr360uw.tune.page import PRESETS

TEXT = """\
# my dive
plate = "plate.png"   # the first clip

[camera]
depth_m = 6.0   # by the diver's watch

[[object]]   # the whale
mesh = "whale.glb"
position_m = [
    0.0, -1.0,
    -4.0,  # back
]

[[object]]
mesh = "whale.glb"
scale = 2.0
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    for name in ("plate.png", "whale.glb"):
        (tmp_path / name).touch()
    (tmp_path / "scene.toml").write_text(TEXT, "utf-8")
    return tmp_path / "scene.toml"


@pytest.fixture
def document(path: Path) -> Document:
    return Document(path)


def touched(path: Path, text: str) -> None:
    """Write a text as another program does, with another time stamp than the file had."""
    before = path.stat().st_mtime_ns
    path.write_text(text, "utf-8")
    os.utime(path, ns=(before + 10**9, before + 10**9))


def test_a_value_changes_its_own_characters_alone(document: Document) -> None:
    document.set("camera.depth_m", 7.5)
    assert document.text == TEXT.replace("6.0 ", "7.5 ")
    document.set("object.1.scale", 3.0)
    assert document.text == TEXT.replace("6.0 ", "7.5 ").replace("2.0\n", "3.0\n")
    assert (document.scene.camera.depth_m, document.scene.objects[1].scale) == (7.5, 3.0)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sea.wind_speed", 3.0), ("water.type", "II"), ("plate.frame_rate", 24.0),
        ("object.0.position_m", (1.0, 2.0, -3.0)),
        ("object.0.key", [{"time_s": 0.0, "scale": 2.0}, {"time_s": 1.0}]), ("caustics.enabled", False),
        ("receiver.height_m", -3.0), ("water.gain", "auto"), ("object.1.animation", 'a "quoted" name'),
    ],
)  # fmt: skip
def test_a_set_value_is_read_back_and_no_comment_is_lost(document: Document, key: str, value: object) -> None:
    document.set(key, value)
    assert not document.problems
    assert document.get(key) == (list(value) if isinstance(value, tuple) else value)
    for comment in ("# my dive", "# by the diver's watch", "# the whale"):
        assert comment in document.text
    document.undo()
    assert document.text == TEXT


def test_defaults_of_a_new_scene_are_set_where_they_stand(path: Path) -> None:
    text = scene_text({"plate": {"path": "plate.png"}, "object": [{"mesh": "whale.glb"}]})
    for key, value in {
        "sea.wind_speed": 3.5, "receiver.height_m": -2.5, "water.visibility_m": 12.0, "object.0.scale": 1.5
    }.items():  # fmt: skip
        edited = with_value(text, key_of(key), value)
        changed = [line for line in edited.splitlines() if line not in text.splitlines()]
        assert len(edited.splitlines()) == len(text.splitlines())
        assert any(re.match(rf"{key.rpartition('.')[2]} = {value}   # \S", line) for line in changed)
        assert len(changed) == (2 if key.startswith("receiver") else 1)  # its header too
    lamp = with_entry(text, ("lamp",), {"lumen": 500.0})
    assert tomllib.loads(lamp)["lamp"] == [{"lumen": 500.0}]
    assert len(lamp.splitlines()) == len(text.splitlines())
    path.write_text(lamp, "utf-8")
    assert load_scene(path).lamps[0].lumen == 500.0


def test_a_default_that_is_set_and_reset_leaves_the_file_as_it_was() -> None:
    text = scene_text({"plate": {"path": "plate.png"}, "object": [{"mesh": "whale.glb"}]})
    edited = with_value(text, ("sea", "wind_speed"), 3.5)
    assert without(edited, ("sea", "wind_speed"), "4.0") == text


def test_a_reset_key_goes(document: Document) -> None:
    document.unset("camera.depth_m")
    assert document.get("camera.depth_m") is None
    assert document.scene.camera.depth_m == 5.0
    before = document.text
    document.unset("sea.wind_speed")
    assert document.text == before
    document.unset("object.0.position_m")
    assert document.scene.objects[0].position_m == (0.0, 0.0, -3.0)


def test_entries_are_added_and_removed(document: Document) -> None:
    assert document.append("object", {"mesh": "whale.glb", "scale": 0.5}) == 2
    assert document.append("lamp", {"lumen": 900.0}) == 0
    assert document.append("object.2.key", {"time_s": 1.0}) == 0
    assert document.append("object.2.key", {"time_s": 2.0}) == 1
    assert [o.scale for o in document.scene.objects] == [1.0, 2.0, 0.5]
    assert [key["time_s"] for key in document.get("object.2.key")] == [1.0, 2.0]
    document.unset("object.0")
    assert [o.scale for o in document.scene.objects] == [2.0, 0.5]
    document.unset("lamp.0")
    assert "lamp" not in document.tree
    for _ in range(6):
        document.undo()
    assert document.text == TEXT
    with pytest.raises(ParameterError, match="no such entry"):
        document.set("object.7.scale", 1.0)


def test_lists_of_one_line_stay_lists_of_one_line(path: Path) -> None:
    path.write_text('plate = "plate.png"\nobject = [{mesh = "whale.glb"}] # one\n', "utf-8")
    document = Document(path)
    document.set("object.0.scale", 2.0)
    document.append("object", {"mesh": "whale.glb"})
    assert [o.scale for o in document.scene.objects] == [2.0, 1.0]
    assert "[[" not in document.text


def test_a_drag_is_one_step_and_steps_go_both_ways(document: Document) -> None:
    for depth in (6.5, 7.0, 7.5):
        document.set("camera.depth_m", depth, group="drag 1")
    for depth in (8.0, 9.0):
        document.set("camera.depth_m", depth, group="drag 2")
    seen = []
    while document.undo_label:
        document.undo()
        seen.append(document.scene.camera.depth_m)
    assert seen == [7.5, 6.0]
    document.redo()
    assert document.scene.camera.depth_m == 7.5
    document.set("camera.depth_m", 7.6, group="drag 2")  # a new step, after which nothing is left to redo
    assert document.redo_label is None
    document.undo()
    assert document.scene.camera.depth_m == 7.5


def test_a_value_that_is_set_again_is_no_step(document: Document) -> None:
    document.set("camera.depth_m", 6.0)
    assert document.undo_label is None
    assert not document.dirty


def test_an_invalid_value_keeps_the_last_scene_and_names_its_key(document: Document) -> None:
    document.set("camera.depth_m", -1.0)
    assert document.scene.camera.depth_m == 6.0
    assert document.problems_by_key["camera.depth_m"].startswith("must be > 0")
    assert "camera.roll_deg" not in document.problems_by_key
    document.set("object.1.scale", "large")
    assert document.problems_by_key["object.1.scale"]
    assert "object.0.scale" not in document.problems_by_key
    with pytest.raises(SceneError, match=r"depth_m"):
        document.save()
    document.undo()
    document.undo()
    assert not document.problems


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_are_one_step_and_give_scenes(document: Document, name: str) -> None:
    document.set("water.visibility_m", 10.0)
    before = document.text
    document.apply(name, PRESETS[name])
    assert not document.problems
    assert {key: document.get(key) for key in PRESETS[name]} == dict(PRESETS[name])
    assert document.undo_label == name
    document.undo()
    assert document.text == before


def test_observers_hear_of_a_step_once(document: Document) -> None:
    heard: list[int] = []
    end = document.observe(lambda: heard.append(document.revision))
    with document.together("two"):
        document.set("camera.depth_m", 7.0)
        document.set("sea.wind_speed", 7.0)
    assert len(heard) == 1
    end()
    document.undo()
    assert len(heard) == 1
    assert document.text == TEXT


def test_snapshots_are_kept_and_taken_as_a_step(document: Document) -> None:
    document.set("camera.depth_m", 7.0)
    document.keep("deeper")
    kept = document.snapshots["deeper"]
    document.set("camera.depth_m", 1.0)
    document.replace("snapshot deeper", kept)
    assert document.scene.camera.depth_m == 7.0
    document.undo()
    assert document.scene.camera.depth_m == 1.0
    document.keep("deeper")
    assert document.snapshots == {"deeper": document.text}
    document.forget("deeper")
    assert not document.snapshots
    with pytest.raises(SceneError, match="not TOML"):
        document.replace("bad", "a = ")


def test_saving_writes_the_text_that_gives_the_same_scene(document: Document) -> None:
    document.set("sea.wind_speed", 7.0)
    assert document.dirty
    document.save()
    assert not document.dirty
    assert document.path.read_text("utf-8") == document.text
    assert load_scene(document.path) == document.scene
    assert not list(document.path.parent.glob(".*part*"))


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have owners on POSIX")
def test_saving_keeps_rights_owner_and_links(document: Document, tmp_path: Path) -> None:
    owner = (54321, 54322) if os.geteuid() == 0 else (os.geteuid(), os.getegid())
    real = document.path.rename(tmp_path / "real.toml")
    document.path.symlink_to(real)
    os.chown(real, *owner)
    real.chmod(0o640)
    document.set("sea.wind_speed", 7.0)
    document.save(overwrite=True)
    assert document.path.is_symlink()
    assert real.read_text("utf-8") == document.text
    found = real.stat()
    assert (stat.S_IMODE(found.st_mode), found.st_uid, found.st_gid) == (0o640, *owner)


def test_a_read_only_file_is_not_replaced(document: Document) -> None:
    before = document.path.read_bytes()
    document.path.chmod(0o444)
    document.set("sea.wind_speed", 7.0)
    with pytest.raises(OutputError, match=r"is read-only \(got mode 444\) - make it writable"):
        document.save()
    assert document.path.read_bytes() == before
    assert document.dirty
    assert not list(document.path.parent.glob(".*part*"))
    document.path.chmod(0o644)
    document.save()
    assert not document.dirty


def test_a_file_changed_outside_is_taken_where_nothing_is_unsaved(document: Document) -> None:
    document.poll()
    assert document.revision == 0
    touched(document.path, TEXT.replace("6.0", "3.0"))
    document.poll()
    assert document.scene.camera.depth_m == 3.0
    assert not document.dirty
    document.undo()
    assert document.scene.camera.depth_m == 6.0
    assert document.dirty


def test_a_file_changed_outside_is_offered_and_not_overwritten(document: Document) -> None:
    document.set("camera.depth_m", 7.0)
    touched(document.path, TEXT.replace("6.0", "3.0"))
    with pytest.raises(OutputExistsError, match="another program"):
        document.save()
    assert document.outside is not None
    assert document.scene.camera.depth_m == 7.0
    document.take_outside()
    assert document.scene.camera.depth_m == 3.0
    assert document.outside is None
    document.undo()
    touched(document.path, TEXT)
    document.save(overwrite=True)
    assert load_scene(document.path).camera.depth_m == 7.0


def test_a_file_changed_outside_while_it_is_saved_is_taken(document: Document, monkeypatch: pytest.MonkeyPatch) -> None:
    def written_twice(path: Path, text: str) -> None:
        rewrite(path, text)
        touched(path, TEXT.replace("6.0", "3.0"))

    monkeypatch.setattr("mr360uw.tune.document.rewrite", written_twice)
    document.set("camera.depth_m", 7.0)
    document.save()
    document.poll()
    assert document.scene.camera.depth_m == 3.0


def test_a_file_broken_outside_keeps_the_scene_and_can_be_written_again(document: Document) -> None:
    touched(document.path, "plate = [")
    document.poll()
    assert "not TOML" in document.problems[0]
    assert document.scene.camera.depth_m == 6.0
    with pytest.raises(SceneError, match="not TOML"):
        document.take_outside()
    with pytest.raises(OutputExistsError):
        document.save()
    document.save(overwrite=True)
    assert not document.problems
    touched(document.path, TEXT + "scale = -1.0\n")  # TOML, but no scene: twice a key
    document.poll()
    assert document.problems
    touched(document.path, TEXT.replace("6.0", "-6.0"))
    document.poll()
    assert document.problems_by_key["camera.depth_m"]
    assert document.scene.camera.depth_m == 6.0


def test_a_file_that_is_gone_is_written_again(document: Document) -> None:
    document.path.unlink()
    document.poll()
    assert not document.problems
    document.set("camera.depth_m", 7.0)
    document.save()
    assert load_scene(document.path).camera.depth_m == 7.0


@pytest.mark.parametrize("text", ["plate = [", "[camera]\n", ""])
def test_a_broken_file_is_not_opened(path: Path, text: str) -> None:
    path.write_text(text, "utf-8")
    with pytest.raises(SceneError):
        Document(path)
