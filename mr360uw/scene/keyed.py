# SPDX-License-Identifier: Apache-2.0
"""A scene at a time: its keyed parameters with their values of that time."""

from __future__ import annotations

from mr360uw.parameters import stated
from mr360uw.scene.key_settings import KeyedParameter
from mr360uw.scene.key_targets import target_of, with_values
from mr360uw.scene.model import Scene

_SHOWN = 6
"""Most keys of a parameter that its line shows one by one."""


def scene_at(scene: Scene, time_s: float) -> Scene:
    """Return a scene with the values of its keyed parameters at a time [s], and without keys; itself if it has none.

    The values were checked when the scene was made: between keys they stay between those of the keys.
    """
    if not scene.keys:
        return scene
    return with_values(scene, scene.keys, time_s).model_copy(update={"keys": ()})


def keyed_in_words(scene: Scene) -> list[str]:
    """Return a line for each keyed parameter: its values, their times and how it goes between them."""
    return [_in_words(scene, key) for key in scene.keys]


def _in_words(scene: Scene, key: KeyedParameter) -> str:
    unit = stated(target_of(scene, key.parameter).field, "unit")
    values = [str(list(v)) if isinstance(v, tuple) else f"{v:g}" for v in key.value]
    times = [f"{time:g}" for time in key.time_s]
    if len(times) > _SHOWN:
        values, times = ([*row[:2], "...", *row[-2:]] for row in (values, times))
    unit = "" if unit in ("", "1") else f" {unit}"
    return f"{key.parameter}: {', '.join(values)}{unit} at {', '.join(times)} s, {key.interpolation}"
