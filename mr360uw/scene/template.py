# SPDX-License-Identifier: Apache-2.0
"""Text of scene files with every key, commented from the parameters' declarations."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mr360uw.scene.model import Scene
from mr360uw.scene.problems import bounds_text, models_of
from mr360uw.scene.toml_model import toml_value


def scene_text(chosen: dict[str, Any]) -> str:
    """Return a TOML scene: `chosen` keys set, every other key commented out with its default, help, range and unit."""
    lines = ["# A scene of mr360uw. Lines that start with # show the defaults; units stand in [brackets].", ""]
    tables: list[str] = []
    for name, field in Scene.model_fields.items():
        key = field.alias or name
        model = _model_of(field)
        if model is None:
            lines += [_help(field), _assignment(key, chosen.get(key), field), ""]
            continue
        repeated = isinstance(field.default, tuple)
        entries = chosen.get(key, []) if repeated else [chosen.get(key, {})]
        unused = (repeated and not entries) or (field.default is None and key not in chosen)
        header = f"[[{key}]]" if repeated else f"[{key}]"
        for entry in entries or [{}]:
            prefix = "# " if unused else ""
            tables += [f"# {_first_line(model)}", f"{prefix}{header}", *_table(model, field.default, entry, unused), ""]
    return "\n".join(lines + tables)


def _table(model: type[BaseModel], default: Any, entry: dict[str, Any], unused: bool) -> list[str]:
    lines = []
    for name, field in model.model_fields.items():
        if models_of(field.annotation):
            continue  # tables inside tables have their own page of the documentation
        key = field.alias or name
        value = getattr(default, name, None) if isinstance(default, BaseModel) else None
        line = _assignment(key, entry.get(key), field, value)
        lines.append(f"{line if not unused or line.startswith('#') else '# ' + line}{_help(field, trailing=True)}")
    return lines


def _assignment(key: str, chosen: Any, field: FieldInfo, default: Any = None) -> str:
    if chosen is not None:
        return f"{key} = {toml_value(chosen)}"
    value = default if default is not None else field.get_default(call_default_factory=True)
    shown = toml_value(value) if value is not None and not field.is_required() else "..."
    return f"# {key} = {shown}"


def _help(field: FieldInfo, *, trailing: bool = False) -> str:
    bounds = bounds_text(field)
    text = (field.description or "") + (f" [{bounds}]" if bounds else "")
    return (f"   # {text}" if text else "") if trailing else f"# {text}"


def _model_of(field: FieldInfo) -> type[BaseModel] | None:
    if isinstance(field.default, BaseModel):
        return type(field.default)
    models = models_of(field.annotation)
    return models[0] if models else None


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or model.__name__).strip().splitlines()[0]
