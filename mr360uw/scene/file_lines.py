# SPDX-License-Identifier: Apache-2.0
"""Lines of keys and tables in a TOML file, for messages about them."""

from __future__ import annotations

import re

Location = tuple[str | int, ...]
Lines = dict[Location, int]
"""Line of each key and table of a file; `SET` of what the command line sets."""
SET = 0


def key_lines(text: str) -> Lines:
    """Return the line of every key and table header of TOML text."""
    lines: Lines = {}
    table: Location = ()
    counts: dict[Location, int] = {}  # of every array of tables, its last index
    for number, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*(\[\[?)([^\[\]]+)\]", line)
        if header:
            *parents, last = (part.strip().strip("\"'") for part in header.group(2).split("."))
            table = ()
            for name in parents:
                table = (*table, name)
                table = (*table, counts[table]) if table in counts else table
            table = (*table, last)
            if header.group(1) == "[[":
                lines.setdefault(table, number)
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
            lines.setdefault(table, number)
            continue
        key = re.match(r"\s*([\w\-\"'.]+)\s*=", line)
        if key:
            names = tuple(part.strip("\"'") for part in key.group(1).split("."))
            lines.setdefault((*table, *names), number)
    return lines


def place(where: str, lines: Lines, location: Location) -> str:
    """Return 'file:line table.key' for a location; the line of the nearest enclosing table where the key has none.

    What the command line sets is at '--set table.key'.
    """
    line = line_of(lines, location)
    name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).lstrip(".")
    if line == SET:
        return f"--set {name}"
    return f"{where} {name}" if line is None else f"{where}:{line} {name}"


def line_of(lines: Lines, location: Location) -> int | None:
    """Return the line of a location, or of the nearest table around it; None where there is neither."""
    return next((lines[location[:k]] for k in range(len(location), 0, -1) if location[:k] in lines), None)
