# SPDX-License-Identifier: Apache-2.0
"""Names of parameters with dots, as in object.0.scale, and values that a command line sets by them."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from mr360uw.errors import SceneError
from mr360uw.scene.file_lines import Location

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
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise SceneError("--set", [f"{text} - is not key=value (got {text!r}) - write for example camera.depth_m=8"])
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        parsed = value.strip()
    *parents, last = dotted(key)
    table: Any = data
    location: Location = ()
    for depth, part in enumerate(parents):
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
