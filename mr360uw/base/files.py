# SPDX-License-Identifier: Apache-2.0
"""Output files: whole or not at all, names of numbered files, the record of those that a run writes,
and the gate that checks all of them first.

By the record, which holds names and hashes of the content, a run that goes on knows its files. One counts as there when
it is what was written, and as cut when it is the beginning of that; half of a cut file or more is compared. A cut one
is written again. Anything else under such a name is somebody's, and is not replaced unless that is allowed.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from itertools import chain
from pathlib import Path

from filelock import FileLock, Timeout

from mr360uw.base.input_files import json_of
from mr360uw.errors import OutputError, OutputExistsError, VideoError

NewFile = Callable[[Path], AbstractContextManager[Path]]
"""Opens a context with the name of an empty new file, which is renamed to the given path at its end: `whole_file`."""
_ANYONE = 0o666
"""Rights of a new file before the user's mask takes some away."""
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_DIGITS = 32
"""Hexadecimal digits of a hash that are kept: 128 bits."""
Marks = dict[str, str]
"""Hashes of the first 1, 2, 4, ... bytes of a file and of all, by the number of bytes; of an empty file none."""


def real_path(path: Path) -> Path:
    """Return where links lead; those that lead round in a circle, where `Path.resolve` raises, stay as they are."""
    return Path(os.path.realpath(path))


def unsafe(path: Path) -> str:
    """Return why another user could have put or changed what is at a path, as "/x belongs to user 1001"; "" if none.

    As ssh and sudo judge it: the file or folder, every folder above it, and links on the way belong to the user who
    runs this process or to root, and nobody else may write to them. A folder above may be open to all where its sticky
    bit keeps others from renaming what is not theirs, as in /tmp. What does not exist yet is judged by what is above
    it. On Windows, whose rights differ, nothing is judged, and "" is returned.
    """
    if not hasattr(os, "geteuid"):
        return ""
    trusted, named, real = (0, os.geteuid()), path.absolute(), real_path(path)
    for one in dict.fromkeys(part for end in (named, real) for part in (*reversed(end.parents), end)):
        try:
            found = one.lstat()
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            return f"{one} cannot be looked at ({error.strerror})"
        if found.st_uid not in trusted:
            return f"{one} belongs to user {found.st_uid}"
        above = one not in (named, real) and found.st_mode & stat.S_ISVTX
        if found.st_mode & _OTHERS_WRITE and not stat.S_ISLNK(found.st_mode) and not above:
            return f"{one} may be written to by others (mode {stat.S_IMODE(found.st_mode):o})"
    return ""


@contextmanager
def whole_file(path: Path, *, overwrite: bool = True) -> Iterator[Path]:
    """Yield the name of an empty new file; afterwards it is renamed to `path`, or removed if there was an exception.

    Raises `OSError`, and `OutputExistsError` as `publish`.
    """
    part = new_file(path)
    try:
        yield part
        publish(part, path, overwrite=overwrite)
    finally:
        part.unlink(missing_ok=True)


def new_file(path: Path, folder: Path | None = None) -> Path:
    """Return the name of an empty file that did not exist before, beside `path` or in a folder, with its suffix."""
    while True:
        part = (folder or path.parent) / f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}"
        try:
            # neither an existing file nor a link is opened
            os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, _ANYONE))
        except FileExistsError:
            continue
        return part


def publish(part: Path, path: Path, *, overwrite: bool) -> None:
    """Rename a complete file to `path`; without `overwrite`, `OutputExistsError` where that is there already."""
    if overwrite:
        part.replace(path)
        return
    exists = OutputExistsError(f"{path} - came into being meanwhile - choose another name or allow overwriting")
    try:
        os.link(part, path)
    except FileExistsError:
        raise exists from None
    except OSError:  # a disk without hard links
        if path.exists():
            raise exists from None
        part.replace(path)
        return
    part.unlink()


@contextmanager
def writing(path: Path, *errors: type[Exception]) -> Iterator[None]:
    """A context in which `OSError`, and the errors of a library, become a `VideoError` that names the output."""
    expected: tuple[type[Exception], ...] = (OSError, *errors)
    try:
        yield
    except expected as error:
        reason = getattr(error, "strerror", None) or error
        raise VideoError(
            f"{path} - cannot be written (got {reason}) - check the space and the folder's rights"
        ) from error


def write_whole(path: Path, data: str | bytes) -> None:
    """Write a small file; on failure nothing is left, and `OSError` names the file."""
    with whole_file(path) as part:
        try:
            part.write_bytes(data.encode() if isinstance(data, str) else data)
        except OSError as error:  # of a full disk, which names no file
            raise OSError(error.errno, error.strerror, str(path)) from error


def rewrite(path: Path, text: str) -> None:
    """Write the text of a user's own file anew, whole or not at all; a link to it stays one.

    A file that is there keeps its rights, and its owner where that may be set. Raises `OutputError` where it is
    read-only, and `OSError`.
    """
    path = real_path(path)
    try:
        before = path.stat()
    except FileNotFoundError:
        write_whole(path, text)
        return
    rights = stat.S_IMODE(before.st_mode)
    if not (rights & (stat.S_IWUSR | _OTHERS_WRITE) and os.access(path, os.W_OK)):
        raise OutputError(f"{path} - is read-only (got mode {rights:o}) - make it writable, then save again")
    with whole_file(path) as part:
        part.chmod(stat.S_IRUSR | stat.S_IWUSR)  # nobody reads what only the file's own readers may
        part.write_text(text, "utf-8", newline="")
        for owner in ((-1, before.st_gid), (before.st_uid, -1)):
            with suppress(AttributeError, PermissionError):  # on Windows; where only root may give a file away
                os.chown(part, *owner)
        part.chmod(rights)


def _marks_of(path: Path) -> Marks:
    """Return the marks of a file; raise `OSError`."""
    found, size, marks = hashlib.sha256(), 0, Marks()
    with path.open("rb") as file:
        while data := file.read(max(size, 1)):
            found.update(data)
            size += len(data)
            marks[str(size)] = found.hexdigest()[:_DIGITS]
    return marks


class WrittenFiles:
    """Files that were written, and those that are being written; for all threads of a process.

    log: gets a line for each file. base: folder to which names are relative, so that all may be moved together. logs:
    the lines that are known, of this run and of earlier ones with the same result. earlier: lines of runs with another
    result, whose files may be replaced. scratch: folder of files that are not complete yet, on the disk of `base`; None
    for beside each. overwrite: whether files of others may be replaced.
    """

    def __init__(
        self, log: Path, base: Path, *, logs: Iterable[Path] = (), earlier: Iterable[Path] = (),
        scratch: Path | None = None, overwrite: bool = False,
    ) -> None:  # fmt: skip
        self._log, self._base, self._scratch, self._overwrite = log, real_path(base), scratch, overwrite
        self._known, self._ours = dict[str, Marks](), dict[str, list[Marks]]()
        self._read: dict[tuple[object, ...], Marks] = {}
        for name, marks in chain.from_iterable(map(_lines, logs)):
            self._add(name, marks)
        for name, marks in chain.from_iterable(map(_lines, earlier)):
            self._ours.setdefault(name, []).append(marks)

    def others(self, paths: Iterable[Path]) -> list[Path]:
        """Return the files of this run and of earlier ones that are there as written or cut, but for those named."""
        named = {self._name(path) for path in paths}
        files = [self._base / name for name in self._ours if name not in named]
        return sorted(file for file in files if self._is_of_a_run(file))

    def size(self, path: Path) -> int | None:
        """Return the bytes that were written to a file; None where it was not."""
        marks = self._known.get(self._name(path))
        return None if marks is None else _size(marks)

    def is_there(self, path: Path) -> bool:
        """Return whether a file that was written is there at its full length."""
        try:
            return path.stat().st_size == self.size(path)
        except OSError:
            return False

    def has(self, path: Path) -> bool:
        """Return whether a file is there as it was written."""
        return self.is_there(path) and self._found(path) == self._known[self._name(path)]

    def may_replace(self, path: Path) -> bool:
        """Return whether a file may be written: none is there, it is a run's, whole or cut, or any may be replaced."""
        return self._overwrite or not os.path.lexists(path) or self._is_of_a_run(path)

    @contextmanager
    def file(self, path: Path) -> Iterator[Path]:
        """Yield the name of an empty new file; afterwards it is noted and renamed to `path`.

        Raises `OutputExistsError` where a file of others is there by then, and `OSError`.
        """
        part = new_file(path, self._scratch if real_path(path.parent) == self._base else None)
        try:
            yield part
            self._note(path, part)
            replaces = self._overwrite or (os.path.lexists(path) and self._is_of_a_run(path))
            publish(part, path, overwrite=replaces)
        finally:
            part.unlink(missing_ok=True)

    def _note(self, path: Path, part: Path) -> None:
        """Note what is about to appear under a name: a kill between both leaves a line of a file that is not there."""
        name, marks = self._name(path), _marks_of(part)
        with part.open("rb") as file:
            os.fsync(file.fileno())  # after a power cut no empty file stands under the name
        with self._log.open("a", encoding="utf-8") as log:
            log.write(f"\n{json.dumps([name, marks])}\n")
        self._add(name, marks)

    def _add(self, name: str, marks: Marks) -> None:
        self._known[name] = marks
        self._ours.setdefault(name, []).append(marks)

    def _is_of_a_run(self, path: Path) -> bool:
        """Return whether a file that is there was written, now or before: all of it or the beginning."""
        found = self._found(path)
        return found is not None and any(_begins(found, marks) for marks in self._ours.get(self._name(path), ()))

    def _found(self, path: Path) -> Marks | None:
        """Return the marks of a file, read once while it stays as it is; None where it cannot be read."""
        try:
            stat = path.stat()
            key = (path, stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)
            if key not in self._read:
                self._read[key] = _marks_of(path)
            return self._read[key]
        except OSError:
            return None

    def _name(self, path: Path) -> str:
        real = real_path(path.parent) / path.name
        return real.relative_to(self._base).as_posix() if real.is_relative_to(self._base) else str(real)


def _size(marks: Marks) -> int:
    return max(map(int, marks), default=0)


def _begins(found: Marks, marks: Marks) -> bool:
    """Return whether a file is the beginning of another one, or all of it, as far as lengths that both have tell."""
    return _size(found) <= _size(marks) and all(marks.get(size, mark) == mark for size, mark in found.items())


def _lines(log: Path) -> Iterator[tuple[str, Marks]]:
    """Yield what a log notes; a line that a kill cut is no note, and the next one begins anew."""
    for line in log.read_text("utf-8", "replace").splitlines() if log.is_file() else ():
        try:
            found = json_of(line)
        except ValueError:
            continue
        if isinstance(found, list) and len(found) == 2 and isinstance(found[0], str) and _are_marks(found[1]):
            yield found[0], found[1]


def _are_marks(found: object) -> bool:
    return isinstance(found, dict) and all(size.isdecimal() and isinstance(one, str) for size, one in found.items())


_NUMBER = re.compile(r"%(?:0(\d+))?d|(#+|@@+)|\$F(\d*)")


def is_pattern(path: Path) -> bool:
    """Return whether a name is the pattern of a sequence, with %04d, ####, @@@@ or $F4 in it."""
    return _NUMBER.search(path.name) is not None


def without_number(path: Path) -> Path:
    """Return a name without the number of a pattern and what parts it from the rest: out.exr for out_%04d.exr."""
    found = _NUMBER.search(path.name)
    if found is None:
        return path
    return path.with_name((path.name[: found.start()].rstrip("_-. ") or "frames") + path.name[found.end() :])


def numbered(path: Path, number: int) -> Path:
    """Return the file of a pattern with this number."""
    found = _NUMBER.search(path.name)
    assert found is not None
    digits = len(found[2]) if found[2] else int(found[1] or found[3] or 0)
    return path.with_name(path.name[: found.start()] + f"{number:0{digits}d}" + path.name[found.end() :])


def matching_files(path: Path) -> list[tuple[int, Path]]:
    """Return the existing files of a pattern with their numbers, ascending."""
    name = matcher(path)
    folder = path.parent.iterdir() if path.parent.is_dir() else ()
    hits = ((name.fullmatch(file.name), file) for file in folder)
    return sorted((int(hit[1]), file) for hit, file in hits if hit)


def matcher(path: Path) -> re.Pattern[str]:
    """Return an expression for the names of a pattern's files; its first group is their number."""
    found = _NUMBER.search(path.name)
    assert found is not None
    before, after = re.escape(path.name[: found.start()]), re.escape(path.name[found.end() :])
    return re.compile(f"{before}(\\d+){after}")


def files_named(path: Path) -> Iterator[Path]:
    """Yield the files that a path, a folder, a numbered pattern or a wildcard stands for."""
    if is_pattern(path):
        yield from (file for _, file in matching_files(path))
    elif "*" in path.name:
        yield from path.parent.glob(path.name)
    elif path.is_dir():
        yield from sorted(file for file in path.iterdir() if file.is_file())
    else:
        yield path


# --- The gate that all output passes first --------------------------------------------------------------------------

# Checks all that a run is to write before anything is written: outputs, reports, pages, work folders.
#
# Nothing that a run reads is replaced, nothing of another output, nothing that is there already unless its user says
# so, and no folder is emptied but one that this package made, which holds a marker file.


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
    """Return whether a folder, and no link to one, was made by `make_work_folder` for the same user.

    On Windows, whose rights differ, all users count as the same.
    """
    try:
        marker = folder / MARKER
        real = folder.is_dir() and not folder.is_symlink() and marker.is_file() and not marker.is_symlink()
        ours = not hasattr(os, "geteuid") or folder.stat().st_uid == os.geteuid()
        return real and ours and marker.read_text("utf-8") == _SIGNATURE
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
