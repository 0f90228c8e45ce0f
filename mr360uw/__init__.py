# SPDX-License-Identifier: Apache-2.0
"""Put virtual objects into 360 degree underwater video, physically right.

    import mr360uw as uw

    scene = uw.load_scene("reef.toml")
    report = uw.composite_video(scene, "out.mp4")

The packages `ibl`, `caustics`, `medium`, `composite` and `video` hold the stages; every name is loaded when it is used.
Conventions (axes, units, colour): `mr360uw.types`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mr360uw import caustics, composite, ibl, medium, video
    from mr360uw.errors import (
        GlError,
        MeshError,
        Mr360uwError,
        OutputExistsError,
        ParameterError,
        SceneError,
        VideoError,
    )
    from mr360uw.pipeline import FrameResult, Report, composite_video, render_frame
    from mr360uw.sample import sample_dive
    from mr360uw.scene import Scene, load_scene
    from mr360uw.types import CausticStack, Environment, Layer, Sun
    from mr360uw.video import open_video

__version__ = "0.1.0"

_HOME = {
    "CausticStack": "types",
    "Environment": "types",
    "FrameResult": "pipeline",
    "GlError": "errors",
    "Layer": "types",
    "MeshError": "errors",
    "Mr360uwError": "errors",
    "OutputExistsError": "errors",
    "ParameterError": "errors",
    "Report": "pipeline",
    "Scene": "scene",
    "SceneError": "errors",
    "Sun": "types",
    "VideoError": "errors",
    "composite_video": "pipeline",
    "load_scene": "scene",
    "open_video": "video",
    "render_frame": "pipeline",
    "sample_dive": "sample",
}
_PACKAGES = ("caustics", "composite", "ibl", "medium", "video")

__all__ = [
    "CausticStack",
    "Environment",
    "FrameResult",
    "GlError",
    "Layer",
    "MeshError",
    "Mr360uwError",
    "OutputExistsError",
    "ParameterError",
    "Report",
    "Scene",
    "SceneError",
    "Sun",
    "VideoError",
    "__version__",
    "caustics",
    "composite",
    "composite_video",
    "ibl",
    "load_scene",
    "medium",
    "open_video",
    "render_frame",
    "sample_dive",
    "video",
]


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return importlib.import_module(f"{__name__}.{name}")
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
