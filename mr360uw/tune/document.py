# SPDX-License-Identifier: Apache-2.0
"""A scene file that is being edited: its text with comments, its scene, undo and redo, snapshots, safe saving.

Nothing here draws or serves; one thread uses a document at a time.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT, Array, InlineTable, Item

from mr360uw.base.files import rewrite
from mr360uw.base.input_files import stamp
from mr360uw.errors import OutputExistsError, ParameterError, SceneError
from mr360uw.scene.model import Scene, scene_from_dict
from mr360uw.scene.problems import key_lines
from mr360uw.scene.toml_model import scene_text, tables_of

_LONGEST_HISTORY = 1000
"""Steps that can be undone. A text has some 10 kB; ten times as many steps would take 100 MB."""


_Step = tuple[str, str, str | None]
"""A change: its label, the text before it, and its group: changes of one group, one after the other, are one step."""


class Observed:
    """Tells functions of its changes."""

    def __init__(self) -> None:
        self._observers: list[Callable[..., None]] = []

    def observe(self, callback: Callable[..., None]) -> Callable[[], None]:
        """Call a function after every change, with its kind if there are several; return the function that ends it."""
        self._observers.append(callback)

        def end() -> None:
            if callback in self._observers:
                self._observers.remove(callback)

        return end

    def _tell(self, *kind: str) -> None:
        for callback in tuple(self._observers):
            callback(*kind)


class Document(Observed):
    """A scene file as text, and the scene that the text gives.

    scene: of the text, or of the last text that gave one. revision: counts the changes. snapshots: texts by name.
    outside: text of the file if it was changed by another program while there are unsaved changes, or is no TOML any
    more. dragging: whether the last change was one of a group, others of which may follow.
    """

    def __init__(self, path: Path) -> None:
        """Open a scene file; raise `SceneError` where it gives no scene."""
        super().__init__()
        self.path, self._stamp = path, stamp(path)
        self.text = self._saved = scene_text(path)
        self.scene, self.tree = self._scene_of(self.text), self._tree_of(self.text)
        self._wrong: tuple[str, ...] = ()
        self._file_wrong: tuple[str, ...] = ()
        self.revision, self.dragging = 0, False
        self.outside: str | None = None
        self.snapshots: dict[str, str] = {}
        self._past, self._future = list[_Step](), list[_Step]()
        self._together: str | None = None

    def get(self, key: str) -> Any:
        """Return the value that the text sets a dotted key to, as in 'object.0.scale'; None where it does not."""
        return find(self.tree, key_of(key))

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the text, or that of the file since it was changed by another program, gives no scene; a line each."""
        return self._wrong + self._file_wrong

    @property
    def problems_by_key(self) -> dict[str, str]:
        """First problem of each parameter, by its dotted key; of lists and vectors, not of their elements."""
        found: dict[str, str] = {}
        for where, _, what in (line.partition(" - ") for line in self._wrong):  # where: 'file:line key[0].key'
            parts = re.sub(r"\[(\d+)\]", r".\1", where.rpartition(" ")[2]).split(".")
            found.setdefault(".".join(parts[: 3 if len(parts) > 1 and parts[1].isdecimal() else 2]), what)
        return found

    @property
    def dirty(self) -> bool:
        """Whether there are changes that are not saved."""
        return self.text != self._saved

    @property
    def undo_label(self) -> str | None:
        """Name of the change that `undo` takes back; None where there is none."""
        return self._past[-1][0] if self._past else None

    @property
    def redo_label(self) -> str | None:
        """Name of the change that `redo` makes again; None where there is none."""
        return self._future[-1][0] if self._future else None

    def set(self, key: str, value: Any, *, group: str | None = None) -> None:
        """Set a key; changes with the same group that follow each other, as those of one drag, are one step."""
        if self.get(key) != value or type(self.get(key)) is not type(value):
            self._change(f"set {key}", with_value(self.text, key_of(key), value), group)

    def unset(self, key: str, default: str | None = None) -> None:
        """Remove a key, a table or an entry of a list.

        default: in TOML; stays in the file as a comment where the key's line ended in one.
        """
        self._change(f"reset {key}", without(self.text, key_of(key), default), None)

    def append(self, key: str, table: Mapping[str, Any]) -> int:
        """Add a table to a list of tables, as to 'object'; return its number."""
        self._change(f"add {key}", with_entry(self.text, key_of(key), dict(table)), None)
        return len(self.get(key)) - 1

    def apply(self, label: str, changes: Mapping[str, Any], *, group: str | None = None) -> None:
        """Set several keys as one step; None removes a key. group: as `set` has it."""
        with self.together(label, group=group):
            for key, value in changes.items():
                if value is not None:
                    self.set(key, value)
                elif self.get(key) is not None:
                    self.unset(key)

    @contextmanager
    def together(self, label: str, *, group: str | None = None) -> Iterator[None]:
        """Make all changes within one step, told to observers once. group: as `set` has it."""
        if self._together is not None:  # inside of another step
            yield
            return
        before, self._together = self.text, label
        try:
            yield
        finally:
            self._together = None
            if self.text != before:
                self._push((label, before, group))
                self._tell()

    def replace(self, label: str, text: str) -> None:
        """Take another text as one step; raise `SceneError` where it is not TOML."""
        self._tree_of(text)
        self._change(label, text, None)

    def undo(self) -> None:
        """Take the last step back, if there is one."""
        self._travel(self._past, self._future)

    def redo(self) -> None:
        """Make the step again that was taken back last, if there is one."""
        self._travel(self._future, self._past)

    def keep(self, name: str) -> None:
        """Keep the present text under a name, in place of one that had it."""
        self.snapshots = {other: text for other, text in self.snapshots.items() if other != name} | {name: self.text}
        self._tell()

    def forget(self, name: str) -> None:
        """Drop a kept state."""
        self.snapshots = {other: text for other, text in self.snapshots.items() if other != name}
        self._tell()

    def save(self, *, overwrite: bool = False) -> None:
        """Write the text to the file, whole or not at all.

        Raises `SceneError` where the text gives no scene, `OutputExistsError` where the file was changed meanwhile,
        unless `overwrite`, `OutputError` where it is read-only, and `OSError`.
        """
        if self._wrong:
            raise SceneError(str(self.path), self._wrong)
        self.poll()
        if self.outside is not None and not overwrite:
            raise OutputExistsError(f"{self.path} - was changed by another program - take its text, or overwrite it")
        rewrite(self.path, self.text)
        self._stamp = None  # the next poll reads the file, which another program may have written since
        self._saved, self.outside, self._file_wrong = self.text, None, ()
        self._tell()

    def poll(self) -> None:
        """Look whether the file was changed: without unsaved changes its text is taken, else it is in `outside`."""
        before, self._stamp = self._stamp, stamp(self.path)
        if before == self._stamp:
            return
        self.outside, self._file_wrong = None, ()
        try:
            self.outside = scene_text(self.path)
            self._tree_of(self.outside)
        except SceneError as error:  # a file that is gone, `save` writes again
            self._file_wrong = error.problems if self._stamp is not None else ()
        if self.outside == self._saved:
            self.outside = None
        if self.outside is not None and not self.dirty and not self._file_wrong:
            self.take_outside()
        else:
            self._tell()

    def take_outside(self) -> None:
        """Take the text that the file has now, as a step that can be undone; raise `SceneError` if it is not TOML."""
        if self.outside is not None:
            taken = self.outside
            self._tree_of(taken)
            self._saved, self.outside = taken, None
            self._change("changed by another program", taken, None)
            self._tell()

    def _change(self, label: str, text: str, group: str | None) -> None:
        if text == self.text:
            return
        step = label, self.text, group
        self._take(text)
        if self._together is None:
            self._push(step)
            self._tell()

    def _push(self, step: _Step) -> None:
        group = step[2]
        if group is None or self._future or not self._past or self._past[-1][2] != group:
            self._past = [*self._past[-_LONGEST_HISTORY:], step]
        self._future, self.dragging = [], group is not None

    def _travel(self, source: list[_Step], target: list[_Step]) -> None:
        if source:
            (label, before, _), self.dragging = source.pop(), False
            target.append((label, self.text, None))
            self._take(before)
            self._tell()

    def _take(self, text: str) -> None:
        self.text, self.tree = text, self._tree_of(text)
        self.revision += 1
        try:
            self.scene = self._scene_of(text)
            self._wrong = ()
        except SceneError as error:
            self._wrong = error.problems

    def _tree_of(self, text: str) -> dict[str, Any]:
        """Return the tables of a text; raise `SceneError` where it is not TOML."""
        return tables_of(text, str(self.path))

    def _scene_of(self, text: str) -> Scene:
        """Return the scene of a text, whose paths start at the file's folder; raise `SceneError`."""
        folder = self.path.resolve().parent
        return scene_from_dict(self._tree_of(text), folder, where=str(self.path), lines=key_lines(text))


# Edits of the TOML text of scene files that keep comments, order and layout.
#
# A key is a tuple of names and of indices into lists, as in ("object", 0, "scale"). New scene files hold every default
# as a line "# key = value   # help": a key that is set takes the place of its line, one that is removed leaves it
# behind.

Key = tuple[str | int, ...]


def key_of(text: str) -> Key:
    """Return the key of dotted text, as in 'object.0.scale'."""
    return tuple(int(part) if part.isdecimal() else part for part in text.split("."))


def find(tree: Any, key: Key) -> Any:
    """Return the value at a key of nested tables and lists; None where there is none."""
    for part in key:
        held = part in tree if isinstance(tree, dict) else isinstance(tree, list) and part in range(len(tree))
        if not held:
            return None
        tree = tree[part]
    return tree


def with_value(text: str, key: Key, value: Any) -> str:
    """Return the text with a key set; tables that are missing are added. Raises `ParameterError` for a bad index."""
    text = _with_table(text, key[:-1])
    text = _with_line_of(text, key)
    document = tomlkit.parse(text)
    _table_at(document, key[:-1])[key[-1]] = value
    return tomlkit.dumps(document)


def without(text: str, key: Key, default: str | None = None) -> str:
    """Return the text without a key, which may be a table or an entry of a list.

    default: where the key's line ends in a comment, the line stays as "# key = default   # comment".
    """
    lines = text.splitlines(keepends=True)
    number = key_lines(text).get(key)
    if number is not None and default is not None and isinstance(key[-1], str):
        line = lines[number - 1]
        comment = re.search(r"(\s+#[^\"']*)$", line.rstrip("\r\n"))
        if comment is not None and _is_whole(line, key[-1]):
            ending = line[len(line.rstrip("\r\n")) :]
            lines[number - 1] = f"# {key[-1]} = {default}{comment[1]}{ending}"
            return "".join(lines)
    document = tomlkit.parse(text)
    parent = _table_at(document, key[:-1])
    if find(parent.unwrap() if isinstance(parent, Item) else dict(parent), key[-1:]) is None:
        return text
    del parent[key[-1]]
    if isinstance(parent, AoT) and not len(parent):
        return without(tomlkit.dumps(document), key[:-1])
    return tomlkit.dumps(document)


def with_entry(text: str, key: Key, table: dict[str, Any]) -> str:
    """Return the text with a table added to the end of the list of tables at a key."""
    text = _with_table(text, key[:-1])
    opened = _with_table(text, key, repeated=True)
    if opened != text:  # a list that was commented out
        for name, value in table.items():
            opened = with_value(opened, (*key, 0, name), value)
        return opened
    document = tomlkit.parse(text)
    parent = _table_at(document, key[:-1])
    entries = parent.get(key[-1])
    if isinstance(entries, AoT | Array):
        entries.append(table)
    else:
        parent[key[-1]] = [table]
    return tomlkit.dumps(document)


def _table_at(document: Any, key: Key) -> Any:
    """Return the table or list at a key; tables that are missing are made."""
    table = document
    for depth, part in enumerate(key):
        if isinstance(part, int):
            if not isinstance(table, list) or part >= len(table):
                where = ".".join(map(str, key[:depth]))
                raise ParameterError(f"{where} - has no such entry (got {part}) - add one first")
        elif part not in table:
            table[part] = tomlkit.inline_table() if isinstance(table, InlineTable) else tomlkit.table()
        elif isinstance(table[part], str) and key[: depth + 1] == ("plate",):  # plate = "file" is short for its table
            short = tomlkit.inline_table()
            short["path"] = table[part]
            table[part] = short
        table = table[part]
    return table


def _is_whole(line: str, name: str | int) -> bool:
    """Return whether a line is a whole assignment to a name."""
    try:
        return set(tomllib.loads(line.strip())) == {name}
    except ValueError:
        return False


def _with_table(text: str, key: Key, *, repeated: bool = False) -> str:
    """Return the text with the header of a top table that is commented out as '# [sea]', if it has no such table."""
    if len(key) != 1 or find(tomllib.loads(text), key) is not None:
        return text
    name = rf"\[\[{key[0]}\]\]" if repeated else rf"\[{key[0]}\]"
    return re.sub(rf"(?m)^#\s*({name})[ \t]*$", r"\1", text, count=1)


def _with_line_of(text: str, key: Key) -> str:
    """Return the text with the line '# key = default' of a key that is not set made to set it."""
    lines, known = text.splitlines(keepends=True), key_lines(text)
    start = known.get(key[:-1])
    if key in known or start is None or not isinstance(key[-1], str):
        return text
    for number in range(start, len(lines)):
        if re.match(r"\s*\[", lines[number]):
            break
        found = re.match(rf"#\s*{re.escape(key[-1])}\s*=\s*(.*?)(\s+# .*)?(\r?\n)?$", lines[number])
        if found:
            lines[number] = f"{key[-1]} = 0{found[2] or ''}{found[3] or ''}"
            return "".join(lines)
    return text
