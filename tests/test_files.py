# SPDX-License-Identifier: Apache-2.0
"""Files that a run wrote are known by their content: whole, cut, or somebody's."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mr360uw.base.files import WrittenFiles
from mr360uw.errors import OutputExistsError

CONTENT = bytes(range(1, 201))


def record(folder: Path, **options: bool) -> WrittenFiles:
    return WrittenFiles(folder / "log", folder, logs=[folder / "log"], **options)


def write(files: WrittenFiles, path: Path, content: bytes = CONTENT) -> None:
    with files.file(path) as part:
        part.write_bytes(content)


def test_what_was_written_counts_while_it_is_what_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    files = record(tmp_path)
    assert files.may_replace(path)
    write(files, path)
    for one in (files, record(tmp_path)):  # in this run and in the next
        assert one.has(path)
    for cut in (0, 1, 7, 64, 150, 199):
        path.write_bytes(CONTENT[:cut])
        again = record(tmp_path)
        assert not again.has(path)
        assert again.may_replace(path)
    write(again, path)
    os.utime(path, (0, 0))
    assert record(tmp_path).has(path)
    for theirs in (b"mine", CONTENT[:60] + b"mine", CONTENT + b"more", bytes(200), CONTENT[::-1]):
        path.write_bytes(theirs)
        again = record(tmp_path)
        assert not again.has(path)
        assert not again.may_replace(path)
        with pytest.raises(OutputExistsError, match="meanwhile"):
            write(again, path)
        assert path.read_bytes() == theirs
    write(record(tmp_path, overwrite=True), path)
    assert path.read_bytes() == CONTENT
    assert {one.name for one in tmp_path.iterdir()} == {"a.bin", "log"}


def test_a_name_of_something_else_is_not_ours(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "dangling").symlink_to("nowhere")
    for name in ("folder", "dangling"):
        assert not record(tmp_path).may_replace(tmp_path / name)
        with pytest.raises(OutputExistsError):
            write(record(tmp_path), tmp_path / name)


def test_a_line_that_a_kill_cut_notes_nothing(tmp_path: Path) -> None:
    """Neither is a cut line believed nor is what is noted after it lost."""
    files = record(tmp_path)
    for name in ("a", "b"):
        write(files, tmp_path / name)
    log = tmp_path / "log"
    log.write_text(log.read_text("utf-8")[:-9], "utf-8")
    assert [record(tmp_path).has(tmp_path / name) for name in ("a", "b")] == [True, False]
    write(record(tmp_path, overwrite=True), tmp_path / "c")
    assert [record(tmp_path).has(tmp_path / name) for name in ("a", "b", "c")] == [True, False, True]


def test_a_folder_that_is_moved_or_spelled_otherwise_keeps_its_files(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    write(record(tmp_path / "one"), tmp_path / "one" / "a")
    (tmp_path / "link").symlink_to("one", target_is_directory=True)
    assert record(tmp_path / "link").has(tmp_path / "one" / "a")
    (tmp_path / "one").rename(tmp_path / "two")
    assert record(tmp_path / "two").has(tmp_path / "two" / "a")


def test_a_file_that_was_written_anew_may_be_either(tmp_path: Path) -> None:
    """A kill between the note of a new content and its name leaves the older one, which is the run's own too."""
    path = tmp_path / "a"
    write(record(tmp_path), path)
    with pytest.raises(RuntimeError):
        files = record(tmp_path)
        with files.file(path) as part:
            part.write_bytes(b"new")
            raise RuntimeError
    write(files, path, b"newer")
    path.write_bytes(CONTENT)
    assert not record(tmp_path).has(path)
    assert record(tmp_path).may_replace(path)
