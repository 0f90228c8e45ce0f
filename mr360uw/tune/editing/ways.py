# SPDX-License-Identifier: Apache-2.0
"""What a control changes beside its own parameter, so that none is dead.

A place or a size that a scene file says in one of two ways is said in the way that is set; a parameter that another one
leaves without effect says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mr360uw.composite.object_settings import POLAR

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
