# SPDX-License-Identifier: Apache-2.0
"""Error messages of a settings file: *file:line key - what is wrong (got ...) - what to do*.

Turns the errors of a pydantic model into one line each, in the order of the file, with unit, range, help and the near
miss of a wrong key; all of it is read from the fields' own declarations. `key_lines` finds the lines of keys in a file.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from mr360uw.base.parameters import bounds_of, stated

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
    line = _line_of(lines, location)
    name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).lstrip(".")
    if line == SET:
        return f"--set {name}"
    return f"{where} {name}" if line is None else f"{where}:{line} {name}"


def _line_of(lines: Lines, location: Location) -> int | None:
    """Return the line of a location, or of the nearest table around it; None where there is neither."""
    return next((lines[location[:k]] for k in range(len(location), 0, -1) if location[:k] in lines), None)


_WORDS: dict[Any, str] = {
    float: "a number", int: "a whole number", bool: "true or false", str: "text in quotes", Path: "text in quotes"
}  # fmt: skip
_TYPES = ("int", "float", "str", "bool", "tuple", "none", "constrained-int", "constrained-float", "constrained-str")
"""Names of types in pydantic's locations."""
_BOUNDS = ("greater_than_equal", "less_than_equal", "greater_than", "less_than")
_LENGTHS = ("missing", "too_long", "too_short")
_SHAPES = ("_type", "_parsing", "_from_float", *_LENGTHS)
"""Ends of pydantic's names of errors about lengths, and about types."""


def models_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the parameter models an annotation may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is not None:
        return [model for part in get_args(annotation) for model in models_of(part)]
    return []


def _locate(root: type[BaseModel], location: Location, kind: str) -> tuple[Location, list[type[BaseModel]], Any]:
    """Return a pydantic location without union tags, the models that could hold its last key, and the key's field."""
    clean: list[str | int] = []
    models: list[type[BaseModel]] = [root]
    field: Any = None
    owners = models
    for k, part in enumerate(location, 1):
        if isinstance(part, int):
            clean.append(part)
            continue
        found = [f for m in models for n, f in m.model_fields.items() if part in (n, f.alias)]
        tagged = [m for m in models if part in _tags(m)]
        is_unknown_key = kind == "extra_forbidden" and k == len(location)
        if not found and not is_unknown_key and (tagged or part in _TYPES or not re.fullmatch(r"[\w\-]+", part)):
            models = tagged or models
            continue
        owners, field = models, (found[0] if found else None)
        clean.append(part)
        models = [model for f in found for model in models_of(f.annotation)] or []
    return tuple(clean), owners, field


def kinds_of(model: type[BaseModel]) -> dict[str, str]:
    """Return the only value of each field of a model that may have but one."""
    literals = {n: f.annotation for n, f in model.model_fields.items() if get_origin(f.annotation) is Literal}
    return {name: str(get_args(kind)[0]) for name, kind in literals.items() if len(get_args(kind)) == 1}


def _tags(model: type[BaseModel]) -> tuple[str, ...]:
    return (model.__name__, *kinds_of(model).values())


def _tag_key(field: Any) -> str:
    """Return the key that selects the kind of a field's table, or "" where its kinds have none in common."""
    keys = [set(kinds_of(model)) for model in models_of(field.annotation)]
    return min(set.intersection(*keys), default="") if keys else ""


def allowed_text(annotation: Any) -> str:
    """Return the allowed values of a type in words, as in "'auto' or a list of 3 numbers"."""
    *others, last = dict.fromkeys(_alternatives(annotation))
    return f"{', '.join(others)} or {last}" if others else last


def _alternatives(annotation: Any) -> list[str]:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _alternatives(parts[0])
    if origin is Literal:
        return [repr(part) for part in parts]
    if origin in (Union, UnionType):
        return [text for part in parts if part is not NoneType for text in _alternatives(part)]
    if origin is tuple:
        count = "" if parts[-1] is Ellipsis else f"{len(parts)} "
        each = [text.removeprefix("a ").partition(" of ") for text in _alternatives(parts[0])]
        return ["a list of " + " or of ".join(f"{count}{head}s{of}{rest}" for head, of, rest in each)]
    return [_WORDS.get(annotation, "a table")]


def _unchecked(annotation: Any) -> Any:
    """Return a type without what checks its values."""
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _element(annotation: Any, depth: int) -> Any:
    """Return the type of the elements `depth` lists deep in a value."""
    for _ in range(depth):
        union = get_origin(annotation) in (Union, UnionType)
        members = [_unchecked(part) for part in (get_args(annotation) if union else [annotation])]
        annotation = next(get_args(member)[0] for member in members if get_origin(member) is tuple)
    return annotation


def _depth(location: Location) -> int:
    """Return how many list indices a location ends with."""
    return next((k for k, part in enumerate(reversed(location)) if not isinstance(part, int)), len(location))


def _misshapen(kind: str, value: Any, location: Location, annotation: Any) -> tuple[str, str] | None:
    """Return (problem, remedy or "") for a value of the wrong type or length; None for other errors."""
    name = ".".join(str(part) for part in location if not isinstance(part, int))
    is_union = get_origin(annotation) in (Union, UnionType)
    if not (kind.endswith(_SHAPES) or (kind == "literal_error" and is_union)):
        return None
    wanted = _element(annotation, _depth(location))
    allowed = allowed_text(wanted)
    if isinstance(value, dict) and allowed == "a list of tables":
        return "is one table, where there may be several", f"write [[{name}]] with double brackets"
    if isinstance(value, list) and allowed == "a table":
        return "is a list of tables, where there is one", f"write [{name}] with single brackets"
    return f"must be {allowed}", ""


def bounds_text(field: Any) -> str:
    """Return a field's range and unit in words, as in 'in [0, 1] 1/m'; empty where it has neither."""
    if field is None:
        return ""
    low, high = bounds_of(field)
    unit = "" if stated(field, "unit") == "1" else stated(field, "unit")
    above = any(getattr(rule, "gt", None) is not None for rule in field.metadata)
    words = [] if low is None else [f"> {low:g}" if above else f">= {low:g}"]
    words += [] if high is None else [f"<= {high:g}"]
    text = f"in [{low:g}, {high:g}]" if len(words) > 1 and not above else " and ".join(words)
    return f"{text} {unit}".strip()


def problems(error: ValidationError, root: type[BaseModel], where: str, lines: Lines) -> list[str]:
    """Return one line for each problem, in the order of the file."""
    found: dict[Location, tuple[int, str]] = {}
    errors = error.errors(include_url=False)
    unknown = {_locate(root, e["loc"], e["type"])[0] for e in errors if e["type"] == "extra_forbidden"}
    for item in errors:
        location, owners, field = _locate(root, item["loc"], item["type"])
        if item["type"] in _LENGTHS and isinstance(location[-1], int):
            location = location[:-1]  # it is the list that is too short
        help_text = (field.description or "") if field is not None else ""
        context = item.get("ctx", {})
        value = item["input"]
        if item["type"].startswith("union_tag"):
            kind = _tag_key(field) or context["discriminator"].strip("'")
            location = (*location, kind)
            value = value.get(kind) if isinstance(value, dict) else value
        missing = item["type"] == "missing" and isinstance(item["loc"][-1], str)
        got = "" if missing else f" (got {_short(value)})"
        bounds = bounds_text(field)
        advice = f"{help_text} [{bounds}]" if bounds else help_text
        shape = None if field is None else _misshapen(item["type"], value, location, field.annotation)
        if missing:
            siblings = [str(u[-1]) for u in unknown if u[:-1] == location[:-1]]
            if difflib.get_close_matches(str(location[-1]), siblings, 1):
                continue  # the near miss is reported as the unknown key
            what, todo = "is missing", f"give {advice}"
        elif item["type"] == "extra_forbidden":
            what, todo = "unknown key", _near_key(str(location[-1]), owners)
        elif shape is not None:
            what = shape[0]
            todo = shape[1] or _near(value, what) or advice
        elif item["type"] in ("literal_error", "union_tag_invalid"):
            what = f"must be {context.get('expected') or context['expected_tags']}"
            todo = _near(value, what) or help_text
        elif item["type"] in _BOUNDS:
            ranged = bounds.startswith(("in ", ">", "<"))
            what = f"must be {bounds}" if ranged else item["msg"].replace("Input should", "must")
            todo = help_text
        elif item["type"] == "value_error":
            what = str(context["error"])
            got, todo = ("", "") if "(got" in what else (got, help_text)
        else:
            what, todo = item["msg"][0].lower() + item["msg"][1:], advice
        line = _line_of(lines, location) or 0
        text = f"{place(where, lines, location)} - {what}{got}" + (f" - {todo}" if todo else "")
        if item["type"] in _BOUNDS:
            found[location] = line, text  # of a union: its other types do not fit either
        found.setdefault(location, (line, text))
    deeper = {location[:k] for location in found for k in range(len(location)) if isinstance(location[k], int)}
    listed = {loc for loc in deeper & found.keys() if models_of(_locate(root, loc, "")[2].annotation) == []}
    return [text for location, (_, text) in sorted(found.items(), key=lambda item: item[1]) if location not in listed]


def _near_key(key: str, owners: list[type[BaseModel]]) -> str:
    """Return a question after the nearest key of a table's models, or all of their keys that users set."""
    fields = [(f.alias or n, f) for m in owners for n, f in m.model_fields.items()]
    names = dict.fromkeys(name for name, field in fields if not stated(field, "internal"))
    near = difflib.get_close_matches(key, names, 1)
    return f"did you mean '{near[0]}'?" if near else f"known here: {', '.join(names)}"


def _near(value: Any, allowed: str) -> str:
    """Return a question after the nearest of the quoted words that are allowed, or ""."""
    near = difflib.get_close_matches(value if isinstance(value, str) else "", re.findall(r"'([^']+)'", allowed), 1)
    return f"did you mean '{near[0]}'?" if near else ""


def _short(value: Any) -> str:
    return text if len(text := repr(value)) <= 60 else f"{text:.57}..."
