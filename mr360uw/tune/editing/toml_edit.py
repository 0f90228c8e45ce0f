# SPDX-License-Identifier: Apache-2.0
"""Edits of the TOML text of scene files that keep comments, order and layout.

A key is a tuple of names and of indices into lists, as in ("object", 0, "scale"). New scene files hold every default as
a line "# key = value   # help": a key that is set takes the place of its line, one that is removed leaves it behind.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

import tomlkit
from tomlkit.items import AoT, Array, InlineTable, Item

from mr360uw.errors import ParameterError
from mr360uw.scene.problems import key_lines

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
    table = _table_at(document, key[:-1])
    table[key[-1]] = _item(value, inline=isinstance(table, InlineTable))
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
    if isinstance(entries, AoT):
        entries.append(_table(table))
    elif isinstance(entries, Array) or isinstance(parent, InlineTable):
        inline = tomlkit.inline_table()
        inline.update(table)
        if entries is None:
            parent[key[-1]] = [inline]
        else:
            entries.append(inline)
    else:
        parent[key[-1]] = _item([table], inline=False)
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


def _item(value: Any, *, inline: bool) -> Any:
    """Return a value as TOML writes it: lists of tables as [[...]], or in one line inside of a table of one line."""
    if isinstance(value, tuple | list) and value and all(isinstance(entry, dict) for entry in value) and not inline:
        entries = tomlkit.aot()
        for entry in value:
            entries.append(_table(entry))
        return entries
    return tomlkit.item(list(value) if isinstance(value, tuple) else value)


def _table(values: dict[str, Any]) -> Any:
    table = tomlkit.table()
    for name, value in values.items():
        table[name] = _item(value, inline=False)
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
