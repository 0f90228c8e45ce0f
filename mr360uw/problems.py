# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a file of settings, in words: *file:line key - what is wrong (got ...) - what to do*.

Turns the errors of a pydantic model into one line each, in the order of the file, with unit, range, help and the near
miss of a wrong key; all of it is read from the fields' own declarations.
"""

from __future__ import annotations

import difflib
import re
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

Location = tuple[str | int, ...]
Lines = dict[Location, int]


def key_lines(text: str) -> Lines:
    """Return the line of every key and table header of TOML text."""
    lines: Lines = {}
    table: Location = ()
    counts: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]", line)
        if header:
            names = tuple(part.strip().strip("\"'") for part in header.group(2).split("."))
            if header.group(1) == "[[":
                name = ".".join(names)
                counts[name] = counts.get(name, -1) + 1
                table = (*names, counts[name])
            else:
                head = names[0]
                table = (head, counts[head], *names[1:]) if head in counts else names
            lines.setdefault(table, number)
            continue
        key = re.match(r"\s*([\w\-\"'.]+)\s*=", line)
        if key:
            names = tuple(part.strip("\"'") for part in key.group(1).split("."))
            lines.setdefault((*table, *names), number)
    return lines


def place(where: str, lines: Lines, location: Location) -> str:
    """Return 'file:line table.key' for a location; the line of the nearest enclosing table where the key has none."""
    line = next((lines[location[:k]] for k in range(len(location), 0, -1) if location[:k] in lines), None)
    name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).lstrip(".")
    return f"{where}:{line} {name}" if line else f"{where} {name}"


def models_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the parameter models an annotation may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is not None:
        return [model for part in get_args(annotation) for model in models_of(part)]
    return []


def _locate(root: type[BaseModel], location: Location) -> tuple[Location, list[type[BaseModel]], Any]:
    """Return a pydantic location without union tags, the models that could hold its last key, and the key's field."""
    clean: list[str | int] = []
    models: list[type[BaseModel]] = [root]
    field: Any = None
    owners = models
    for part in location:
        if isinstance(part, int):
            clean.append(part)
            continue
        found = [f for m in models for n, f in m.model_fields.items() if part in (n, f.alias)]
        tagged = [m for m in models if part in _tags(m)]
        if not found and tagged:
            models = tagged
            continue
        if not found and not _is_key(part):
            continue
        owners, field = models, (found[0] if found else None)
        clean.append(part)
        models = [model for f in found for model in models_of(f.annotation)] or []
    return tuple(clean), owners, field


def _is_key(part: str) -> bool:
    """Return whether a part of a pydantic location is a key of a file rather than the name of a type."""
    return re.fullmatch(r"[\w\-]+", part) is not None and part not in ("int", "float", "str", "bool", "tuple", "none")


def _tags(model: type[BaseModel]) -> tuple[str, ...]:
    literals = [get_args(f.annotation) for f in model.model_fields.values() if get_origin(f.annotation) is Literal]
    return (model.__name__, *(str(values[0]) for values in literals if len(values) == 1))


def bounds_text(field: Any) -> str:
    """Return a field's range and unit in words, as in 'in [0, 1] 1/m'; empty where it has neither."""
    low = high = None
    for rule in getattr(field, "metadata", ()):
        low = getattr(rule, "ge", None) if getattr(rule, "ge", None) is not None else low
        low = f"> {rule.gt:g}" if getattr(rule, "gt", None) is not None else low
        high = getattr(rule, "le", None) if getattr(rule, "le", None) is not None else high
    unit = ((field.json_schema_extra or {}).get("unit") or "") if field is not None else ""
    unit = "" if unit == "1" else unit
    if isinstance(low, str):
        text = f"{low}" + (f" and <= {high:g}" if high is not None else "")
    elif low is not None and high is not None:
        text = f"in [{low:g}, {high:g}]"
    elif low is not None:
        text = f">= {low:g}"
    elif high is not None:
        text = f"<= {high:g}"
    else:
        return unit
    return f"{text} {unit}".strip()


def problems(error: ValidationError, root: type[BaseModel], where: str, lines: Lines) -> list[str]:
    """Return one line for each problem, in the order of the file."""
    found: dict[Location, tuple[int, str]] = {}
    errors = error.errors(include_url=False)
    unknown = {_locate(root, e["loc"])[0] for e in errors if e["type"] == "extra_forbidden"}
    for item in errors:
        location, owners, field = _locate(root, item["loc"])
        help_text = (field.description or "") if field is not None else ""
        context = item.get("ctx", {})
        value = item["input"]
        if item["type"].startswith("union_tag"):
            kind = context["discriminator"].strip("'")
            location = (*location, kind)
            value = value.get(kind) if isinstance(value, dict) else value
        got = "" if item["type"] == "missing" else f" (got {_short(value)})"
        bounds = bounds_text(field)
        if item["type"] == "missing":
            siblings = [str(u[-1]) for u in unknown if u[:-1] == location[:-1]]
            if difflib.get_close_matches(str(location[-1]), siblings, 1):
                continue  # the near miss is reported as the unknown key
            what, todo = "is missing", f"give {help_text}" + (f" [{bounds}]" if bounds else "")
        elif item["type"] == "extra_forbidden":
            names = [f.alias or n for m in owners for n, f in m.model_fields.items()]
            near = difflib.get_close_matches(str(location[-1]), names, 1)
            what = "unknown key"
            todo = f"did you mean '{near[0]}'?" if near else f"known here: {', '.join(dict.fromkeys(names))}"
        elif item["type"] in ("literal_error", "union_tag_invalid"):
            what = f"must be {context.get('expected') or context['expected_tags']}"
            near = difflib.get_close_matches(str(value), re.findall(r"'([^']+)'", what), 1)
            todo = f"did you mean '{near[0]}'?" if near else help_text
        elif item["type"] in ("greater_than_equal", "less_than_equal", "greater_than", "less_than"):
            what, todo = f"must be {bounds}", help_text
        elif item["type"] == "value_error":
            what, todo = str(context["error"]), help_text
        else:
            what = item["msg"][0].lower() + item["msg"][1:]
            todo = f"{help_text} [{bounds}]" if bounds else help_text
        line = next((lines[location[:k]] for k in range(len(location), 0, -1) if location[:k] in lines), 0)
        text = f"{place(where, lines, location)} - {what}{got}" + (f" - {todo}" if todo else "")
        found.setdefault(location, (line, text))
    return [text for _, text in sorted(found.values())]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
