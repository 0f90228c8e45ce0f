# SPDX-License-Identifier: Apache-2.0
"""Sliders in a notebook: some parameters of a scene file, and the composite of one frame, drawn anew when one moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mr360uw.errors import Mr360uwError, ParameterError, install_command
from mr360uw.preview.live import LivePreview, screen_picture
from mr360uw.scene.model import load_scene
from mr360uw.scene.toml_model import dotted, scene_text, tables_of
from mr360uw.tune.document import find, key_of
from mr360uw.tune.fields import Field, groups


def sliders(scene: str | Path, *keys: str, frame: int = 0, width: int = 768, backend: str = "auto") -> Any:
    """Return a widget (`ipywidgets.VBox`): a slider for each key, below them one frame of the scene file's composite.

    keys: of numbers, with dots, as in "sea.wind_speed" and "object.0.scale". width: of the picture [pixels]. The file
    is not changed: `widget.overrides` are the values as `load_scene` and `--set` take them. A value that makes no scene
    is told below the sliders, and the last picture stays. Raises `ParameterError` for keys that are no numbers with a
    slider and where ipywidgets is missing, `SceneError`.
    """
    try:
        import ipywidgets as widgets
    except ImportError:
        raise ParameterError(f"sliders - need ipywidgets (got none) - {install_command('notebook')}") from None
    # Make a slider for each key, at the value of the file
    path, live = Path(scene), LivePreview(backend)
    load_scene(path)
    tables = tables_of(scene_text(path), str(path))
    rows = [_slider(widgets, key, _field(key), find(tables, key_of(".".join(dotted(key))))) for key in keys]
    picture, message = widgets.Image(format="jpeg", width=width), widgets.Label()
    box = widgets.VBox([*rows, message, picture])

    # Draw the frame anew when a slider moves; an error leaves the last picture
    def draw(_: Any = None) -> None:
        box.overrides = tuple(f"{key}={row.value}" for key, row in zip(keys, rows, strict=True))
        try:
            image = live.frame(load_scene(path, box.overrides), frame, width).picture.image_linear
        except Mr360uwError as error:
            message.value = str(error)
            return
        picture.value, message.value = screen_picture(image, ".jpg"), ""

    for row in rows:
        row.observe(draw, "value")
    draw()
    return box


def _field(key: str) -> Field:
    """Return the description of a number; raise `ParameterError` for other keys."""
    name = ".".join(part for part in dotted(key) if not part.isdecimal())
    every = ((group.key, field) for group in groups() for tag in group.tags for field in group.fields(tag))
    field = next((field for table, field in every if f"{table}.{field.key}" == name), None)
    if field is None or field.span is None or field.kind not in ("number", "integer"):
        raise ParameterError(f"{key} - is no number with a slider (got {key!r}) - take for example sea.wind_speed")
    return field


def _slider(widgets: Any, key: str, field: Field, value: Any) -> Any:
    assert field.span is not None
    low, high = field.span
    value = field.default if value is None else value
    value = (low + high) / 2.0 if value is None else value
    kind = widgets.IntSlider if field.kind == "integer" else widgets.FloatSlider
    step = 1 if field.kind == "integer" else field.step
    unit = f" [{field.unit}]" if field.unit else ""
    look = {"description": key, "tooltip": f"{field.help}{unit}", "continuous_update": False}
    return kind(value=value, min=min(low, value), max=max(high, value), step=step, **look)
