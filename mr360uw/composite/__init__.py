# SPDX-License-Identifier: Apache-2.0
"""Objects that belong there: meshes, shading, shadows, differential rendering.

`reference.render_layer` defines the layer of a `Shot`; `gl.LayerRenderer` draws the same on OpenGL.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mr360uw.composite.mesh import Mesh, load_mesh
    from mr360uw.composite.motion import Motion, read_camera_track
    from mr360uw.composite.objects import SceneObject, load_object, load_objects
    from mr360uw.composite.over import over_tile
    from mr360uw.composite.receiver_file import load_receiver
    from mr360uw.composite.reference import render_layer
    from mr360uw.composite.settings import DrawSettings, HoldoutSettings, ObjectSettings, ReceiverSettings
    from mr360uw.composite.shot import PlacedObject, Receiver, Shot

_MODULES = {
    "DrawSettings": "settings",
    "HoldoutSettings": "settings",
    "Mesh": "mesh",
    "Motion": "motion",
    "ObjectSettings": "settings",
    "PlacedObject": "shot",
    "Receiver": "shot",
    "ReceiverSettings": "settings",
    "SceneObject": "objects",
    "Shot": "shot",
    "load_mesh": "mesh",
    "load_object": "objects",
    "load_objects": "objects",
    "load_receiver": "receiver_file",
    "over_tile": "over",
    "read_camera_track": "motion",
    "render_layer": "reference",
}

__all__ = [
    "DrawSettings",
    "HoldoutSettings",
    "Mesh",
    "Motion",
    "ObjectSettings",
    "PlacedObject",
    "Receiver",
    "ReceiverSettings",
    "SceneObject",
    "Shot",
    "load_mesh",
    "load_object",
    "load_objects",
    "load_receiver",
    "over_tile",
    "read_camera_track",
    "render_layer",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
