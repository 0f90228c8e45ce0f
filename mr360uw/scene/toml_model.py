# SPDX-License-Identifier: Apache-2.0
"""TOML files as parameter models: every problem of a file at once, paths from its folder, files that must be there.

A command line sets values by names with dots, as in object.0.scale.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from mr360uw.base.input_files import read_text, unreadable
from mr360uw.errors import SceneError, VideoError
from mr360uw.scene.problems import SET, Lines, Location, key_lines, kinds_of, place, problems

_DIGITS = 9
"""Most digits of the number of an entry; Python refuses to read thousands."""


def dotted(name: str) -> list[str]:
    """Return the parts of a parameter's name: object.0.scale, or object[0].scale."""
    return re.sub(r"\[(\d+)\]", r".\1", name.strip()).split(".")


def entry(part: str, count: int) -> int | None:
    """Return the number of one of `count` entries that a part of a name gives, None where there is no such."""
    return int(part) if part.isdecimal() and len(part) <= _DIGITS and int(part) < count else None


def override(data: dict[str, Any], text: str) -> Location:
    """Set one key of nested tables from 'a.b=value', 'a.0.b=value' or 'a[0].b=value'; return where it is."""
    # Read the value as TOML, or as bare text
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise SceneError("--set", [f"{text} - is not key=value (got {text!r}) - write for example camera.depth_m=8"])
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        parsed = value.strip()
    # Walk down to the table that holds the key; make tables that are missing
    *parents, last = dotted(key)
    table: Any = data
    location: Location = ()
    for depth, part in enumerate(parents):
        # Refuse lists of tables and keyed parameters, which hold no single value
        if isinstance(table, list):
            number = entry(part, len(table))
            if number is None:
                where = ".".join(parents[:depth])
                raise SceneError("--set", [f"{key} - no such entry of {where} (got {part:.20}) - it has {len(table)}"])
            table, location = table[number], (*location, number)
        else:
            table, location = table.setdefault(part, {}), (*location, part)
        if not isinstance(table, dict | list):
            raise SceneError("--set", [f"{key} - {part} is not a table (got {table!r}) - set {part} itself"])
    if isinstance(table, list):
        raise SceneError("--set", [f"{key} - names a list of tables - say which one, as in {parents[-1]}.0.{last}"])
    if dotted(key) in _keyed(data):
        raise SceneError(
            "--set", [f"{key} - is keyed: its keys hold at all times - change its [[keys]], or remove them"]
        )
    table[last] = parsed
    return *location, last


def _keyed(data: dict[str, Any]) -> list[list[str]]:
    """Return the names, in parts, of the parameters that a scene's [[keys]] name; what is no such table is left out."""
    tables = data.get("keys")
    names = [one.get("parameter") for one in tables if isinstance(one, dict)] if isinstance(tables, list) else []
    return [dotted(name) for name in names if isinstance(name, str)]


def as_tables(value: Any) -> Any:
    """Return settings, and what holds them, as the nested tables of a file; of models what was set, and their kind."""
    if isinstance(value, BaseModel):
        fields, named = type(value).model_fields, value.model_fields_set | kinds_of(type(value)).keys()
        value = {fields[name].alias or name: getattr(value, name) for name in fields if name in named}
    if isinstance(value, dict):
        return {name: as_tables(one) for name, one in value.items() if one is not None}
    if isinstance(value, list | tuple):
        return [as_tables(one) for one in value]
    return str(value) if isinstance(value, Path) else value


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it in one line, tables too."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(name)} = {toml_value(one)}" for name, one in value.items()) + "}"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, tuple | list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    text = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in text) + '"'


def toml_document(tables: Mapping[str, Any]) -> str:
    """Return the text of a file: single values, then a header for each table and each table of a list."""
    headed: list[str] = []
    lines: list[str] = []
    for name, value in tables.items():
        several = isinstance(value, list | tuple) and bool(value) and all(isinstance(one, Mapping) for one in value)
        if not several and not isinstance(value, Mapping):
            lines.append(f"{_key(name)} = {toml_value(value)}\n")
        for table in value if several else [value] if isinstance(value, Mapping) else []:
            rows = [f"{_key(key)} = {toml_value(one)}\n" for key, one in table.items()]
            headed.append("".join([f"[[{_key(name)}]]\n" if several else f"[{_key(name)}]\n", *rows]))
    return "\n".join(["".join(lines), *headed] if lines else headed)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)


Model = TypeVar("Model", bound=BaseModel)


def load_model(model: type[Model], path: str | Path, overrides: Sequence[str] = (), made: str = "") -> Model:
    """Return the model of a TOML file; relative paths in it start at its folder.

    overrides: 'table.key=value' with a TOML value (a bare word is text). made: see `scene_text`. Raises `SceneError`
    with one line for each problem: *file:line key - what is wrong (got ...) - what to do*.
    """
    path = Path(path)
    text = scene_text(path, made)
    data = tables_of(text, str(path))
    lines = key_lines(text) | {override(data, one): SET for one in overrides}
    return model_from_dict(model, data, path.resolve().parent, where=str(path), lines=lines)


def scene_text(path: Path, made: str = "") -> str:
    """Return the text of a scene file; raise `SceneError` where there is none. made: the command that makes one."""
    if reason := unreadable(path):
        hint = f", or make one: {made}" if made and reason.startswith("no such") else ""
        raise SceneError(str(path), [reason + hint])
    try:
        return read_text(path, VideoError)
    except VideoError as error:
        raise SceneError(str(path), [str(error).removeprefix(f"{path} - ")]) from None


def tables_of(text: str, where: str) -> dict[str, Any]:
    """Return the nested tables of a scene's text; raise `SceneError` where it is not TOML. where: name of its file."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, or a number of more digits than Python reads
        raise SceneError(where, [f"is not TOML (got: {error!s:.120}) - correct the line"]) from None


def model_from_dict(
    model: type[Model], data: dict[str, Any], folder: Path, where: str, lines: Lines | None = None
) -> Model:
    """Return the model of nested dictionaries as a TOML file gives them; raise `SceneError` with every problem."""
    try:
        made = model.model_validate(data)
    except RecursionError:
        raise SceneError(
            where, ["has tables within tables too deep to read - write them as the handbook has them"]
        ) from None
    except ValidationError as error:
        raise SceneError(where, problems(error, model, where, lines or {})) from None
    made = with_absolute_paths(made, folder)
    unusable = [
        f"{place(where, lines or {}, location)} - {problem}"
        for location, file in named_files(made)
        if (problem := _problem(file, folder, location))
    ]
    if unusable:
        raise SceneError(where, unusable)
    return made


def _from_folder(folder: Path, path: Path) -> Path:
    """Return a path that starts at a folder, without "..": messages name files as people do."""
    while not path.is_absolute() and path.parts[:1] == ("..",):
        folder, path = folder.resolve().parent, Path(*path.parts[1:])
    return path if path.is_absolute() else folder / path


def with_absolute_paths(value: Any, folder: Path) -> Any:
    """Return a model, or a value of one, whose relative paths start at a folder."""
    if isinstance(value, Path):
        return _from_folder(folder, value)
    if isinstance(value, tuple):
        moved = tuple(with_absolute_paths(item, folder) for item in value)
        return value if all(new is old for new, old in zip(moved, value, strict=True)) else moved
    if isinstance(value, BaseModel):
        changed = {}
        for name in type(value).model_fields:
            old = getattr(value, name)
            new = with_absolute_paths(old, folder)
            if new is not old:
                changed[name] = new
        return value.model_copy(update=changed) if changed else value
    return value


def named_files(value: Any, location: Location = ()) -> Iterator[tuple[Location, Path]]:
    """Yield every file, and pattern of files, that a model names, with its place in the model."""
    if isinstance(value, Path):
        yield location, value
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from named_files(item, (*location, index))
    elif isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield from named_files(getattr(value, name), (*location, field.alias or name))


_FOLDERS = {("plate", "depth")}
"""Keys that name a folder of files, one for each frame."""


def _problem(path: Path, folder: Path, location: Location) -> str:
    """Return why a file, or a pattern of numbered files, cannot be read, "" if it can; folder: of the scene.

    location: of the path in the model.
    """
    if location in _FOLDERS and path.is_dir():
        return ""
    reason = unreadable(path)
    if not reason or (reason.startswith("no such") and any(c in path.name for c in "%#*") and path.parent.is_dir()):
        return ""
    what, todo = reason.split(" - ", 1)
    return f"{what} (got {path!s:.200}) - {todo}" + (f"; it starts at {folder}" if what == "no such file" else "")
