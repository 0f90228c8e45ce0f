# SPDX-License-Identifier: Apache-2.0
"""The `[[keys]]` of a document: keys of a parameter are set, moved and removed, as steps of the document."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mr360uw.composite.object_settings import POLAR
from mr360uw.errors import ParameterError
from mr360uw.scene.key_targets import KeyedParameter, target_of
from mr360uw.tune.document import Document

Pairs = Sequence[tuple[float, Any]]
"""Keys of a parameter: (time [s], a number or a vector), ascending."""
_SAME_S = 1e-4
"""Keys nearer than this [s] are one: far below a frame."""


def tracks(document: Document) -> dict[str, KeyedParameter]:
    """Return the keyed parameters of the document's scene, by name."""
    return {key.parameter: key for key in document.scene.keys}


def values_at(document: Document, time_s: float) -> dict[str, Any]:
    """Return the values of the keyed parameters at a time, by name."""
    return {name: value_at(document, key, time_s) for name, key in tracks(document).items()}


def value_at(document: Document, key: KeyedParameter, time_s: float) -> Any:
    """Return the value of a keyed parameter at a time, of a key's own where it has one; a vector as a list."""
    at = next((one for one in key.time_s if abs(one - time_s) <= _SAME_S), time_s)
    found = target_of(document.scene, key.parameter).value(key, at)
    return list(found) if isinstance(found, tuple) else found


def set_key(document: Document, parameter: str, time_s: float, value: Any, *, group: str | None = None) -> None:
    """Set the key of a parameter at a time, in place of one that is there. group: as `Document.set` has it."""
    held = tracks(document).get(parameter)
    pairs = [pair for pair in _pairs(held) if abs(pair[0] - time_s) > _SAME_S]
    kind = "smooth" if held is None else held.interpolation
    set_keys(document, parameter, [*pairs, (time_s, value)], kind, group=group)


def has_key(document: Document, parameter: str, time_s: float) -> bool:
    """Return whether a parameter has a key at a time."""
    return any(abs(time - time_s) <= _SAME_S for time, _ in _pairs(tracks(document).get(parameter)))


def remove_key(document: Document, parameter: str, time_s: float) -> None:
    """Remove the key of a parameter at a time; with the last one the parameter takes its value, without keys."""
    held = tracks(document).get(parameter)
    pairs = [pair for pair in _pairs(held) if abs(pair[0] - time_s) > _SAME_S]
    set_keys(document, parameter, pairs, "smooth" if held is None else held.interpolation)


def set_keys(document: Document, parameter: str, pairs: Pairs, interpolation: str, *, group: str | None = None) -> None:
    """Set all keys of a parameter; none of them removes its table."""
    rows = document.get("keys") or []
    number = next((k for k, row in enumerate(rows) if row.get("parameter") == parameter), None)
    ordered = sorted(pairs, key=lambda pair: pair[0])
    times, values = [_rounded(time) for time, _ in ordered], [_rounded(value) for _, value in ordered]
    if not ordered:
        if number is not None:
            document.unset(f"keys.{number}")
        return
    with document.together(f"keys of {parameter}", group=group):
        if number is None:
            table = {"parameter": parameter, "time_s": times, "value": values, "interpolation": interpolation}
            document.append("keys", table)
            return
        document.set(f"keys.{number}.time_s", times)
        document.set(f"keys.{number}.value", values)
        document.set(f"keys.{number}.interpolation", interpolation)


def with_component(
    document: Document, key: KeyedParameter, component: int, pairs: Sequence[tuple[float, float]]
) -> list[tuple[float, Any]]:
    """Return the keys of a vector whose component has new keys; at new times the others keep their course.

    pairs: (time [s], value) of the component.
    """
    same = len(pairs) == len(key.time_s)
    found = []
    for k, (time_s, value) in enumerate(pairs):
        whole = list(key.value[k]) if same else value_at(document, key, time_s)  # type: ignore[arg-type]
        whole[component] = value
        found.append((time_s, whole))
    return found


def samples(document: Document, key: KeyedParameter, end_s: float, component: int | None) -> list[tuple[float, float]]:
    """Return (time [s], value) of a parameter over a clip, dense enough for straight lines, and at its keys."""
    times = np.unique([*np.linspace(0.0, end_s, 160), *key.time_s])
    if key.interpolation == "hold":  # a step is upright
        times = np.unique([*times, *(time - 2.0 * _SAME_S for time in key.time_s)])
    rows = [(float(time), value_at(document, key, float(time))) for time in times if 0.0 <= time <= end_s]
    return [(time, component_of(value, component)) for time, value in rows]


def component_of(value: Any, component: int | None) -> float:
    """Return a component of a vector, or a number for None."""
    return float(value if component is None else value[component])


def present_value(document: Document, parameter: str, default: Any) -> Any:
    """Return the value that the first key of a parameter takes; raise `ParameterError` where it has none."""
    found = document.get(parameter)
    value = default if found is None else found
    if value is None:
        raise ParameterError(f"{parameter} - has no value to key (got none) - set one first")
    return [float(part) for part in value] if isinstance(value, list | tuple) else float(value)


def _pairs(key: KeyedParameter | None) -> list[tuple[float, Any]]:
    if key is None:
        return []
    return [
        (time, list(value) if isinstance(value, tuple) else value)
        for time, value in zip(key.time_s, key.value, strict=True)
    ]


def _rounded(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_rounded(one) for one in value]
    return round(float(value), 6)


# What a control changes beside its own parameter, so that none is dead.
#
# A place or a size that a scene file says in one of two ways is said in the way that is set; a parameter that another
# one leaves without effect says so.

_SAID = {"position_m": POLAR, "scale": ("size_m",)}
"""Words of an object that are used where none of others, which say the same, is in the file."""

_EFFECTIVE: dict[str, tuple[str, tuple[Any, ...]]] = {
    **dict.fromkeys(("light.sun_azimuth_deg", "light.sun_elevation_deg"), ("light.sun", ("given",))),
    **dict.fromkeys(("light.sun_time", "light.place_deg", "light.heading_deg"), ("light.sun", ("date",))),
    "light.direct_to_diffuse": ("light.operator", ("closure",)),
    "water.chlorophyll_mg_m3": ("water.type", ("chlorophyll",)),
    "water.csv": ("water.type", ("csv",)),
    "camera.ipd_m": ("plate.eye", ("both",)),
    "plate.lut_to": ("plate.lut", ()),
    "receiver.height_m": ("receiver.kind", ("plane",)),
    **dict.fromkeys(("caustics.size", "caustics.grid", "caustics.chromatic"), ("caustics.enabled", (True,))),
    "caustics.sun_half_angle_rad": ("caustics.enabled", (True,)),
    "shafts.strength": ("shafts.mode", ("auto", "on")),
    "shafts.on_plate": ("shafts.mode", ("auto", "on")),
    **dict.fromkeys(("snow.exponent", "snow.sizes_mm", "snow.range_m", "snow.current_m_s"), ("snow.amount", ())),
    "draw.shutter": ("draw.motion_samples", ()),
    "object.front": ("object.face", ()),
}
"""For parameters that count only beside another one: that, and its values at which they do; () for any that is set and
is not its default."""
_FOLLOWS = (
    "light.sun_azimuth_deg",
    "light.sun_elevation_deg",
    "water.chlorophyll_mg_m3",
    "caustics.sun_half_angle_rad",
)
"""Those of them that take the first such value along when they are set: a file or a date would have to be asked for."""


def unsaid(table: Mapping[str, Any]) -> list[str]:
    """Return the words of an object's table that the other way of saying the same stands for."""
    hidden: list[str] = []
    for word, others in _SAID.items():
        used = any(table.get(name) is not None for name in others)
        hidden += [word] if used else list(others)
    return hidden


def in_words(
    table: Mapping[str, Any], name: str, value: Any, now: Callable[[bool], Mapping[str, Any]]
) -> dict[str, Any] | None:
    """Return the words of an object to set, None for those to remove, when one is set; None where it stands alone.

    now: returns the words as they are, whichever the file has; of one that stands on the floor, whether `distance_m` is
    level.
    """
    stands = table.get("stand_on") is not None
    changes: dict[str, Any] = {name: value}
    if name in POLAR:
        if table.get("position_m") is not None or (name == "elevation_deg" and stands):
            stays = stands and name != "elevation_deg"
            words = now(stays)
            changes = {word: words[word] for word in POLAR if not (stays and word == "elevation_deg")}
            changes |= {name: value, "position_m": None}
            changes |= {} if stays else {"stand_on": None}
    elif name == "position_m":
        changes |= {word: None for word in POLAR if table.get(word) is not None}
        raised = stands and list(value)[1:2] != list(now(stands)["position_m"])[1:2]
        changes |= {"stand_on": None} if raised else {}
    elif name in ("scale", "size_m"):
        other = "size_m" if name == "scale" else "scale"
        changes |= {other: None} if table.get(other) is not None else {}
    return changes if len(changes) > 1 else None


Values = Callable[[str], tuple[Any, Any]]
"""Returns the present value of a parameter of a dotted key and its default."""


def without_effect(key: str, values: Values) -> str:
    """Return what leaves a parameter of a dotted key, without numbers, without effect; "" where it counts."""
    if key not in _EFFECTIVE:
        return ""
    other, effective = _EFFECTIVE[key]
    now, default = values(other)
    return "" if (now in effective if effective else now != default) else other


def set_along(key: str, values: Values) -> dict[str, Any]:
    """Return what else is set with a parameter of a dotted key so that it has an effect."""
    other = without_effect(key, values) if key in _FOLLOWS else ""
    return {other: _EFFECTIVE[key][1][0]} if other else {}
