# SPDX-License-Identifier: Apache-2.0
"""Reference tables of all scene parameters, and scene files with every key, from the parameters' declarations.

A key that several tables have with the same meaning stands once, and keys that few users need stand in tables of their
own, marked `[advanced]`. Those that users need not set are left out.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mr360uw.base.parameters import stated
from mr360uw.scene.model import Scene
from mr360uw.scene.problems import bounds_text, models_of
from mr360uw.scene.toml_model import toml_value


def scene_text(chosen: dict[str, Any]) -> str:
    """Return a TOML scene: `chosen` keys set, every other key commented out with its default, help, range and unit."""
    lines = ["# A scene of mr360uw. Lines that start with # show the defaults; units stand in [brackets].", ""]
    for name, field in Scene.model_fields.items():
        key = field.alias or name
        model = type(field.default) if isinstance(field.default, BaseModel) else models_of(field.annotation)[0]
        repeated = isinstance(field.default, tuple)
        entries = chosen.get(key, []) if repeated else [chosen.get(key, {})]
        unused = (repeated and not entries) or (field.default is None and key not in chosen)
        header = f"[[{key}]]" if repeated else f"[{key}]"
        for entry in entries or [{}]:
            prefix = "# " if unused else ""
            lines += [
                f"# {(model.__doc__ or model.__name__).strip().splitlines()[0]}",
                f"{prefix}{header}",
                *_scene_table(model, field.default, entry, unused),
                "",
            ]
    return "\n".join(lines)


def _scene_table(model: type[BaseModel], default: Any, entry: dict[str, Any], unused: bool) -> list[str]:
    lines = []
    for name, field in model.model_fields.items():
        if models_of(field.annotation):
            continue  # tables inside tables have their own page of the documentation
        key = field.alias or name
        value = getattr(default, name, None) if isinstance(default, BaseModel) else None
        line = _assignment(key, entry.get(key), field, value)
        lines.append(f"{line if not unused or line.startswith('#') else '# ' + line}{_help(field)}")
    return lines


def _assignment(key: str, chosen: Any, field: FieldInfo, default: Any = None) -> str:
    if chosen is not None:
        return f"{key} = {toml_value(chosen)}"
    value = default if default is not None else field.get_default(call_default_factory=True)
    shown = toml_value(value) if value is not None and not field.is_required() else "..."
    return f"# {key} = {shown}"


def _help(field: FieldInfo) -> str:
    bounds = bounds_text(field)
    text = (field.description or "") + (f" [{bounds}]" if bounds else "")
    return f"   # {text}" if text else ""


_COLUMNS = ("key", "default", "values, range, unit", "meaning")


_Row = tuple[tuple[str, ...], bool]
"""The cells of a parameter in the tables, and whether few users need it."""


@dataclass(frozen=True, slots=True)
class _Table:
    """A table of a scene file. header: as the file has it, in code."""

    header: str
    name: str
    text: str
    rows: tuple[_Row, ...]

    def lines(self, columns: tuple[str, ...] = _COLUMNS, level: str = "##") -> list[str]:
        """Return the lines of its heading, its text and its rows, those that few users need last.

        level: of its heading.
        """
        title = f"{self.header} {self.name}".strip()
        lines = ["", f"{level} {title}", "", self.text]
        for advanced in (False, True):
            cells = [row for row, few in self.rows if few == advanced]
            if cells:
                lines += ["", f"{level}# {title} `[advanced]`"] if advanced else []
                lines += ["", *(f"| {' | '.join(row)} |" for row in (columns, ("---",) * len(columns), *cells))]
        return lines


_TASKS = {
    "The plate and its camera": ("plate", "camera", "match", "holdout"),
    "Water and light": ("water", "light", "sun", "sky", "shafts", "snow", "lamp"),
    "Objects and the floor": ("object", "receiver", "floor", "reflection"),
    "The surface and its caustics": ("sea", "caustics", "surface"),
    "Changes over time": ("keys",),
    "Rendering and output": ("draw", "film", "output"),
}
"""Tables of a scene by what they are for, in the order of the work."""


def parameters_markdown(
    scene: type[BaseModel] = Scene, title: str = "Parameters of a scene", command: str = "mr360uw schema --markdown"
) -> str:
    """Return the page docs/parameters.md, or that of another kind of scene: one table for each table of its file.

    Tables that another kind of scene has as `Scene` has them are named, and stand on the page of that.
    """
    of_tasks = _tables_of(scene)
    tables = [table for of_task in of_tasks.values() for table in of_task]
    known = () if scene is Scene else [table for of_task in _tables_of(Scene).values() for table in of_task]
    headers: dict[_Row, list[str]] = {}
    for table in tables:
        for row in table.rows:
            headers.setdefault(row, []).append(table.header)
    lines = [f"# {title}", "", f"Written by `{command}`. A key without a default must be given."]
    for task, of_task in of_tasks.items():
        lines += ["", f"## {task}"] if of_task else []
        if same := [f"{table.header} {table.name}" for table in of_task if table in known]:
            lines += ["", f"As in [a scene over a plate](parameters.md): {', '.join(same)}."]
        for table in of_task:
            if table in known:
                continue
            own = replace(table, rows=tuple(row for row in table.rows if len(headers[row]) == 1))
            lines += own.lines(level="###")
    several = [((", ".join(of), *cells), few) for (cells, few), of in headers.items() if len(of) > 1]
    if several:
        text = "With the same meaning in each."
        lines += _Table("Keys of several tables", "", text, tuple(several)).lines(("tables", *_COLUMNS))
    return "\n".join(lines) + "\n"


def _tables_of(scene: type[BaseModel]) -> dict[str, list[_Table]]:
    """Return the tables of a kind of scene by what they are for."""
    fields = {field.alias or name: field for name, field in scene.model_fields.items()}
    return {task: [t for n in names if n in fields for t in _tables(n, fields[n])] for task, names in _TASKS.items()}


def table_of(header: str, model: type[BaseModel]) -> list[str]:
    """Return the lines of a heading and a table of a model's parameters."""
    return _table(header, model).lines()


def _tables(path: str, field: FieldInfo, outer: Collection[str] = ()) -> list[_Table]:
    """Return the tables of the models that a field holds, and of the models in these.

    What the kinds of a table inherit from one class stands first. outer: keys of the table around it.
    """
    header = f"[[{path}]]" if get_origin(field.annotation) is tuple else f"[{path}]"
    kinds, tables = [] if stated(field, "internal") else models_of(field.annotation), list[_Table]()
    base = kinds[0].__base__ if len(kinds) > 1 else None
    inherited = base.model_fields if base is not None and issubclass(base, BaseModel) else {}
    if base is not None and inherited:
        tables.append(_table(header, base))
    for kind in kinds:
        tables.append(_table(header, kind, outer, inherited))
        for name, inner in kind.model_fields.items():
            key = inner.alias or name
            tables += _tables(f"{path}.{key}", inner, {f.alias or n for n, f in kind.model_fields.items()})
    return tables


def _table(header: str, model: type[BaseModel], outer: Collection[str] = (), inherited: Collection[str] = ()) -> _Table:
    rows, again = [], []
    for name, field in model.model_fields.items():
        key = field.alias or name
        if key in outer:
            again.append(f"`{key}`")
        elif name not in inherited and not stated(field, "internal") and not models_of(field.annotation):
            allowed = ", ".join(choices(field.annotation)) or bounds_text(field)
            cells = f"`{key}`", _default(field), allowed, field.description or ""
            rows.append((tuple(cell.replace("|", "\\|") for cell in cells), stated(field, "audience") == "few"))
    text = (model.__doc__ or "").strip().splitlines()[0]
    text += f" As around it: {', '.join(again)}." if again else ""
    return _Table(f"`{header}`", model.__name__, text, tuple(rows))


def choices(annotation: Any) -> list[str]:
    """Return the values that an annotation lists, in order."""
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for part in get_args(annotation) for value in choices(part)]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return ""
    return "none" if field.default is None else f"`{toml_value(field.default)}`"
