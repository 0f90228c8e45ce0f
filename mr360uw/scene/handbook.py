# SPDX-License-Identifier: Apache-2.0
"""Generates the reference tables of all scene parameters from the parameters' declarations."""

from __future__ import annotations

from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mr360uw.scene.model import Scene
from mr360uw.scene.problems import bounds_text, models_of
from mr360uw.scene.template import toml_value


def parameters_markdown(
    scene: type[BaseModel] = Scene, title: str = "Parameters of a scene", command: str = "mr360uw schema --markdown"
) -> str:
    """Return the page docs/parameters.md, or that of another kind of scene: one table for each table of its file."""
    lines = [f"# {title}", "", f"Written by `{command}`. A key without a default must be given."]
    for name, field in scene.model_fields.items():
        key = field.alias or name
        repeated = isinstance(field.default, tuple)
        for model in models_of(field.annotation):
            lines += table_of(f"[[{key}]]" if repeated else f"[{key}]", model)
    return "\n".join(lines) + "\n"


def table_of(header: str, model: type[BaseModel]) -> list[str]:
    """Return the lines of a heading and a table of a model's parameters, and those of the models in it."""
    summary = (model.__doc__ or "").strip().splitlines()[0]
    lines = [
        "",
        f"## `{header}` {model.__name__}",
        "",
        summary,
        "",
        "| key | default | values, range, unit | meaning |",
    ]
    nested = []
    for name, field in model.model_fields.items():
        inner = models_of(field.annotation)
        if inner:
            path = f"{header.strip('[]')}.{field.alias or name}"
            single = get_origin(field.annotation) in (Union, UnionType) and inner[0] in get_args(field.annotation)
            nested += [(f"[{path}]" if single else f"[[{path}]]", m) for m in inner]
            continue
        allowed = ", ".join(choices(field.annotation)) or bounds_text(field)
        cells = (f"`{field.alias or name}`", _default(field), allowed, field.description or "")
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    for inner_header, inner_model in nested:
        lines += table_of(inner_header, inner_model)
    return lines


def choices(annotation: Any) -> list[str]:
    """Return the values that an annotation lists, in order."""
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for part in get_args(annotation) for value in choices(part)]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return ""
    return "none" if field.default is None else f"`{toml_value(field.default)}`"
