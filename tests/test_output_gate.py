# SPDX-License-Identifier: Apache-2.0
"""The gate before every output: nothing that is read, nothing of another output, no folder of somebody else's."""

from __future__ import annotations

import inspect
import os
from pathlib import Path
from typing import Any

import pytest
import typer

from mr360uw import cli
from mr360uw.base import files
from mr360uw.base.files import (
    MARKER,
    check_folder,
    check_outputs,
    check_work_folder,
    made_folder,
    make_work_folder,
    remove_work_folder,
)
from mr360uw.cli.arguments import Role, options_of, roles_of
from mr360uw.errors import OutputError, OutputExistsError

COMMANDS = {info.callback.__name__: inspect.unwrap(info.callback) for info in cli.app.registered_commands}


def test_every_file_of_the_command_line_is_declared_and_every_written_one_passes_the_gate(
    tmp_path: Path, subtests: pytest.Subtests
) -> None:
    """Each parameter that is a path says what becomes of its file; the gate stops each that would replace an input."""
    for name in sorted(COMMANDS):
        with subtests.test(name):
            command = COMMANDS[name]
            roles = dict(roles_of(command))
            kinds = {one.name: getattr(one.annotation, "__origin__", one.annotation) for one in options_of(command)}
            paths = {one for one, kind in kinds.items() if kind in (Path, Path | None)}
            assert paths <= set(roles), "a path without a role"
            registered = next(info.callback for info in cli.app.registered_commands if info.callback.__name__ == name)
            (tmp_path / "mine").write_text("mine")
            for written in (one for one, role in roles.items() if role is not Role.READ):
                for overwrite in (False, True):
                    values: dict[str, Any] = dict.fromkeys(roles, None) | {"overwrite": overwrite}
                    read = next((one for one, role in roles.items() if role is Role.READ), None)
                    values |= {written: tmp_path / "mine"} | ({} if read is None else {read: tmp_path / "mine"})
                    if roles[written] is Role.WRITTEN and read is None and overwrite:
                        values[written] = tmp_path / "nowhere" / "out"
                    with pytest.raises(OutputError):
                        registered(**values)
            assert (tmp_path / "mine").read_text() == "mine"


def refused(*outputs: Path, **options: Any) -> str:
    """Return what the gate says."""
    with pytest.raises(OutputError) as caught:
        check_outputs(outputs, **({"overwrite": True} | options))
    return str(caught.value)


def test_inputs_are_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By another spelling, a link, a hard link, or as one of numbered files."""
    plate = tmp_path / "plate.mp4"
    plate.write_text("plate")
    (tmp_path / "soft.mp4").symlink_to(plate)
    os.link(plate, tmp_path / "hard.mp4")
    (tmp_path / "elsewhere").symlink_to(tmp_path, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    names = ("plate.mp4", "./plate.mp4", "soft.mp4", "hard.mp4", "elsewhere/plate.mp4")
    for name in (*map(Path, names), plate):
        assert "would replace" in refused(name, inputs=[plate])
    matte = tmp_path / "matte_0007.png"
    matte.write_text("matte")
    assert "would replace" in refused(tmp_path / "matte_%04d.png", inputs=[matte])
    assert "would replace" in refused(matte, inputs=[tmp_path / "matte_####.png"])
    check_outputs([tmp_path / "new.mp4"], inputs=[plate, tmp_path / "none_*.png"], overwrite=False)


def test_two_outputs_have_two_names(tmp_path: Path) -> None:
    for one, other in (("a.html", "a.html"), ("l_%04d.exr", "l_0003.exr"), ("l_%04d.exr", "l_####.exr")):
        for pair in ((one, other), (other, one)):
            assert "another output" in refused(*(tmp_path / name for name in pair))
    (tmp_path / "there").write_text("")
    (tmp_path / "link").symlink_to("there")
    assert "another output" in refused(tmp_path / "there", tmp_path / "link")
    check_outputs([tmp_path / "o_%04d.exr", tmp_path / "layers_%04d.exr"], overwrite=False)


def test_every_problem_is_said_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").write_text("")
    (tmp_path / "folder").mkdir()
    (tmp_path / "dangling").symlink_to("nothing")
    (tmp_path / "round").symlink_to("round")
    os.mkfifo(tmp_path / "pipe")
    names = ("folder", "dangling", "round", "pipe", "nowhere/out", "there/out", "there")
    said = refused(*(tmp_path / name for name in names), overwrite=False).splitlines()
    wanted = ("is a folder", "is a link", "is a link", "a pipe", "is missing", "is a file", "already there")
    for line, name, what in zip(said, names, wanted, strict=True):
        assert line.startswith(f"{tmp_path / name} - ")
        assert what in line
    with pytest.raises(OutputExistsError, match="already there"):
        check_outputs([tmp_path / "there"], overwrite=False)
    check_outputs([tmp_path / "there"], overwrite=True)
    monkeypatch.setattr("os.access", lambda *_: False)  # the tests may run as root, who may write anywhere
    assert "may not be written to" in refused(tmp_path / "new")
    monkeypatch.undo()

    def full(*_: Any) -> Path:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(files, "new_file", full)
    assert "Read-only file system" in refused(tmp_path / "new")
    with pytest.raises(OutputError, match="Read-only"):
        check_folder(tmp_path / "new" / "deep")


def test_nothing_is_left_by_looking(tmp_path: Path) -> None:
    check_outputs([tmp_path / "a", tmp_path / "deep" / "er" / "b"], overwrite=False, folder=tmp_path / "deep" / "er")
    check_folder(tmp_path / "deep" / "er")
    assert not list(tmp_path.iterdir())


def test_folders_that_a_failed_run_made_are_removed(tmp_path: Path) -> None:
    def fails(folder: Path, name: str | None) -> None:
        with pytest.raises(RuntimeError), made_folder(folder):
            if name is not None:
                (folder / name).write_text("")
            raise RuntimeError

    fails(tmp_path / "a" / "b", None)
    assert not list(tmp_path.iterdir())
    (tmp_path / "mine").mkdir()
    fails(tmp_path / "mine" / "b", None)
    fails(tmp_path / "mine", None)
    assert [one.name for one in tmp_path.iterdir()] == ["mine"]
    fails(tmp_path / "c" / "d", "finished")
    assert (tmp_path / "c" / "d" / "finished").exists()


def test_only_folders_with_our_marker_are_work_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = tmp_path / "out.mp4.mr360uw"
    make_work_folder(work)
    make_work_folder(work)
    assert [one.name for one in work.iterdir()] == [MARKER]
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "photo").write_text("mine")
    (tmp_path / "link").symlink_to(mine, target_is_directory=True)
    (tmp_path / "linked work").symlink_to(work, target_is_directory=True)
    (tmp_path / "dangling").symlink_to("nothing")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "empty").mkdir()
    other = tmp_path / "other"
    other.mkdir()
    (other / MARKER).write_text("not ours")
    for foreign in (mine, tmp_path / "link", tmp_path / "linked work", tmp_path / "dangling", tmp_path / "file",
                    tmp_path / "empty", other):  # fmt: skip
        for action in (check_work_folder, make_work_folder):
            with pytest.raises(OutputError):
                action(foreign)
        remove_work_folder(foreign)
        assert foreign.exists() or foreign.is_symlink()
    assert (mine / "photo").read_text() == "mine"
    if hasattr(os, "geteuid"):
        user = os.geteuid() + 1
        monkeypatch.setattr(os, "geteuid", lambda: user)
        with pytest.raises(OutputError):
            check_work_folder(work)  # of another user
        monkeypatch.undo()
    remove_work_folder(work)
    assert not work.exists()
    assert not [one for one in tmp_path.iterdir() if ".part" in one.name]


def test_the_test_of_declarations_sees_commands() -> None:
    assert len(COMMANDS) >= 18
    assert typer.main.get_command(cli.app).name
