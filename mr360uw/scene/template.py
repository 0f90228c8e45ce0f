# SPDX-License-Identifier: Apache-2.0
"""Writes new scene files, ready to run, with comments from the parameters' declarations."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mr360uw.errors import OutputExistsError, SceneError, VideoError
from mr360uw.files import write_whole
from mr360uw.scene.model import Scene
from mr360uw.scene.problems import bounds_text, models_of

_NEAREST_M = 2.5
_SIZES_AWAY = 2.0


def write_scene(
    video: Path,
    mesh: Path,
    out: Path | None = None,
    *,
    eye: Literal["left", "right"] | None = None,
    overwrite: bool = False,
    outside_files: bool = False,
) -> Path:
    """Write a commented scene that puts `mesh` into `video` in front of the camera, and return its path.

    outside_files: the mesh may name files outside of its folder.
    Opens both files first, so that the scene runs; raises their errors, `OutputExistsError` or `SceneError`.
    """
    from mr360uw.composite.mesh.mesh import load_mesh
    from mr360uw.video import open_video

    if not video.name:
        raise VideoError(f"{video} - is a folder - name a video or a picture")
    path = out if out is not None else video.with_suffix(".toml")
    if path.suffix.lower() != ".toml":
        raise SceneError(str(path), [f"is no name of a scene file (got {path.suffix!r}) - end it in .toml"])
    if path.exists() and not overwrite:
        raise OutputExistsError(f"{path} - is there already - name another with --out, or give --overwrite")
    if not path.parent.is_dir():
        raise SceneError(str(path), [f"no such folder (got {path.parent}) - make it first"])
    for name in (str(video), str(mesh)):
        if any("\ud800" <= c <= "\udfff" for c in name):
            raise SceneError(str(path), [f"cannot name a file whose name is no UTF-8 (got {name!r}) - rename the file"])
    with open_video(video, eye=eye):
        pass
    size = float(np.max(load_mesh(mesh, outside=outside_files).extent_m))
    distance = max(_NEAREST_M, _SIZES_AWAY * size)
    trusted = {"outside_files": True} if outside_files else {}
    position = [0.0, -0.25 * size, -round(distance, 2)]
    text = scene_text(
        {
            "plate": {"path": _relative(video, path.parent)} | ({"eye": eye} if eye else {}),
            "camera": {"depth_m": Scene.model_fields["camera"].default.depth_m},
            "water": {"type": Scene.model_fields["water"].default.type},
            "object": [{"mesh": _relative(mesh, path.parent), "position_m": position} | trusted],
        }
    )
    write_whole(path, text)
    return path


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


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, tuple | list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    text = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in text) + '"'


def _model_of(field: FieldInfo) -> type[BaseModel] | None:
    if isinstance(field.default, BaseModel):
        return type(field.default)
    models = models_of(field.annotation)
    return models[0] if models else None


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or model.__name__).strip().splitlines()[0]


def _relative(file: Path, folder: Path) -> str:
    """Return `file` as seen from `folder`, with forward slashes; absolute where they share no root."""
    try:
        return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return file.resolve().as_posix()
