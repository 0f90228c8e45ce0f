# SPDX-License-Identifier: Apache-2.0
"""Shots of the tests: those on which a device is tried, and changes of them."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from mr360uw.composite.gl.self_test import (
    SUN,
    box,
    caustics,
    checker,
    codes,
    eight_shots,
    environment,
    medium,
    placed,
    plate,
    quad,
    shot,
    sphere,
)
from mr360uw.composite.settings import DrawSettings
from mr360uw.composite.shot import Shot
from mr360uw.types import View

__all__ = ["SUN", "box", "caustics", "changed", "checker", "codes", "eight_shots", "environment", "medium", "placed",
           "plate", "quad", "shot", "sphere"]  # fmt: skip
_DRAW = set(DrawSettings.model_fields)
_VIEW = {field.name for field in fields(View)}


def changed(scene: Shot, **more: Any) -> Shot:
    """Return a shot with other fields of its own, of its view or of how it is drawn; `sun` replaces all lights."""
    view = replace(scene.view, **{name: more.pop(name) for name in _VIEW & set(more)})
    draw = scene.draw.model_copy(update={name: more.pop(name) for name in _DRAW & set(more)})
    if "sun" in more:
        more["lights"] = tuple(filter(None, [more.pop("sun")]))
    return replace(scene, view=view, draw=draw, **more)
