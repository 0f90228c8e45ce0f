# SPDX-License-Identifier: Apache-2.0
"""Checks all that a run is to write before anything is written: outputs, reports, pages, work folders.

Nothing that a run reads is replaced, nothing of another output, nothing that is there already unless its user says so,
and no folder is emptied but one that this package made, which holds a marker file.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from mr360uw.errors import OutputError, OutputExistsError
from mr360uw.files import files_named, is_ours, is_pattern, matcher, new_file, numbered, real_path, write_whole

MARKER = "made-by-mr360uw.txt"
"""File that makes a folder one of ours."""
SUFFIX = ".mr360uw"
"""Ending of a work folder's name, after the whole name of the output."""
LOCK = "lock"
"""File in a work folder that the run locks which uses it."""
_SIGNATURE = "Finished parts of a run of mr360uw. It removes this folder when it is done.\n"


def check_outputs(
    outputs: Sequence[Path], *, inputs: Iterable[Path] = (), overwrite: bool, folder: Path | None = None
) -> None:
    """Raise `OutputError` with a line for each file that may not be written, `OutputExistsError` where all just exist.

    outputs: all files that a run writes, or patterns of numbered files. inputs: files, patterns and wildcards that it
    reads; they are never replaced. overwrite: whether other files may be; numbered ones, of which a stopped run leaves
    some, are not looked at. folder: that the run makes where it is missing, with the outputs in it.
    """
    read = {identity: file for path in inputs for file in files_named(path) for identity in _identities(file)}
    taken: dict[Hashable, Path] = {}
    exist, wrong = [], []
    for number, path in enumerate(outputs):
        files = {path} if path.is_dir() else {path, *files_named(path)}  # a folder is refused for what it is
        own = {identity for file in files for identity in _identities(file)}
        hit = next((read[identity] for identity in own if identity in read), None)
        other = next((taken[identity] for identity in own if identity in taken), None)
        other = next((one for one in outputs[:number] if _same_pattern(one, path)), other)
        taken |= dict.fromkeys(own, path)
        if hit is not None:
            wrong.append(f"{path} - would replace {hit}, which this run reads - choose another name")
        elif other is not None:
            wrong.append(f"{path} - is the name of another output too (got {other}) - give each one of its own")
        elif problem := _wrong_place(path, folder):
            wrong.append(f"{path} - {problem}")
        elif path.exists() and not overwrite:
            exist.append(f"{path} - is already there - choose another name, or allow overwriting with --overwrite")
    if wrong:
        raise OutputError("\n".join(wrong + exist))
    if exist:
        raise OutputExistsError("\n".join(exist))


def check_folder(folder: Path) -> None:
    """Raise `OutputError` where a folder for outputs, there already or not, cannot be made or written to."""
    if problem := _unusable_folder(folder, makes=True):
        raise OutputError(f"{folder} - {problem}")


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder with those above it; where an exception leaves them empty, those that were made are removed."""
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for one in made:
            if any(one.iterdir()):
                break
            one.rmdir()
        raise


def check_work_folder(folder: Path, keeps: Iterable[Path] = ()) -> None:
    """Raise `OutputError` where the name of a work folder is that of something that this package did not make.

    keeps: files that may not lie in it, as it is removed in the end.
    """
    files = (file for path in keeps for file in files_named(path))
    inside = next((file for file in files if real_path(folder) in real_path(file).parents), None)
    if inside is not None:
        raise OutputError(f"{inside} - lies in a folder that the run removes (got {folder}) - move it elsewhere")
    if folder.is_symlink():
        raise OutputError(f"{folder} - is a link where work is to be kept - remove it, or name another output")
    if folder.exists() and not is_work_folder(folder):
        raise OutputError(
            f"{folder} - is no folder that mr360uw made for the parts of a run - move it, or name another output"
        )


def is_work_folder(folder: Path) -> bool:
    """Return whether a folder, and no link to one, was made by `make_work_folder` for the same user."""
    try:
        marker = folder / MARKER
        real = folder.is_dir() and not folder.is_symlink() and marker.is_file() and not marker.is_symlink()
        return real and is_ours(folder) and marker.read_text("utf-8") == _SIGNATURE
    except (OSError, ValueError):
        return False


def make_work_folder(folder: Path) -> None:
    """Make a work folder unless it is there, with its marker from the first moment; raise as `check_work_folder`."""
    check_work_folder(folder)
    if folder.exists():
        return
    part = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.part")
    part.mkdir(parents=True)
    try:
        write_whole(part / MARKER, _SIGNATURE)
        part.rename(folder)
    except OSError:  # another run made it meanwhile
        shutil.rmtree(part, ignore_errors=True)
        check_work_folder(folder)
        if not folder.exists():
            raise


def work_path(out: Path) -> Path:
    """Return the name of an output's work folder."""
    return out.with_name(out.name + SUFFIX)


def work_lock(folder: Path) -> FileLock:
    """Return the lock of a work folder, which a run holds."""
    return FileLock(folder / LOCK)


@contextmanager
def locked_work_folder(path: Path, out: Path, keeps: Callable[[Path], bool] = lambda _: False) -> Iterator[Path]:
    """Yield an output's work folder, made and locked, without incomplete files; it is removed at the end.

    path: of the work folder. keeps: whether it is kept where an exception ends the run. Raises `OutputExistsError` if
    another run holds it, `OutputError` where the name is that of something else, and `OSError`.
    """
    make_work_folder(path)
    lock = work_lock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise OutputExistsError(
            f"{out} - another run is writing it (its work lies in {path.name}) - wait for it, or name another output"
        ) from None
    done = False
    try:
        for part in path.glob(".*.part*"):
            part.unlink()
        yield path
        done = True
    finally:
        kept = not done and keeps(path)
        lock.release()
        if not kept:
            remove_work_folder(path)


def remove_work_folder(folder: Path) -> None:
    """Remove a work folder with all that is in it; anything else of that name stays."""
    if is_work_folder(folder):
        shutil.rmtree(folder)


def _identities(file: Path) -> list[Hashable]:
    """Return what two names of one file have in common: their resolved path, or the numbers of a hard link."""
    try:
        found = file.stat()
    except (OSError, ValueError):  # there is no such file yet, or links lead round in a circle
        return [real_path(file.parent) / file.name]
    return [real_path(file), (found.st_dev, found.st_ino)]


def _same_pattern(one: Path, other: Path) -> bool:
    """Return whether two outputs, one of them a pattern at least, may have a file in common that is not there yet."""
    if real_path(one.parent) != real_path(other.parent):
        return False
    names = [numbered(path, 0).name if is_pattern(path) else path.name for path in (one, other)]
    pairs = zip((one, other), reversed(names), strict=True)
    return any(is_pattern(pattern) and matcher(pattern).fullmatch(name) is not None for pattern, name in pairs)


def _wrong_place(path: Path, folder: Path | None) -> str:
    """Return why no file can be put under a name, *what is wrong - what to do*; "" where one can."""
    try:
        if path.is_symlink() and not path.exists():
            return "is a link that leads to no file - remove it, or choose another name"
        if path.is_dir():
            return "is a folder - name a file in it"
        if path.exists() and not path.is_file():
            return "is a device, a pipe or a socket - name a file"
    except (OSError, ValueError) as error:
        return f"is no name of a file (got: {error!s:.80}) - choose another one"
    return _unusable_folder(path.absolute().parent, makes=folder is not None)


def _unusable_folder(folder: Path, *, makes: bool) -> str:
    """Return why nothing can be written into a folder; "" where it can. makes: a missing one is made."""
    above = next((one for one in (folder, *folder.absolute().parents) if one.exists() or one.is_symlink()), folder)
    if not folder.exists() and not (makes and above != folder):
        if folder.is_symlink():
            return f"its folder is a link that leads nowhere (got {folder}) - remove the link"
        return f"the output folder is missing (got {folder}) - make it first"
    if not above.is_dir():
        return f"its folder is a file (got {above}) - choose another one"
    if not os.access(above, os.W_OK | os.X_OK):
        return f"the output folder may not be written to (got {above}) - choose another one"
    try:
        new_file(above / "gate").unlink()
    except OSError as error:
        return f"the output folder cannot be written to (got {above}: {error.strerror or error}) - choose another one"
    return ""
