# SPDX-License-Identifier: Apache-2.0
"""Values and tables as TOML writes them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any


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
