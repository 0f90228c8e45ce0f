# SPDX-License-Identifier: Apache-2.0
"""Parameters as the page edits them: descriptions of controls, keys over time, and what is set along with one."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from pydantic.fields import FieldInfo

from mr360uw.base.parameters import bounds_of, stated
from mr360uw.composite.settings import POLAR
from mr360uw.errors import ParameterError
from mr360uw.scene.key_targets import KeyedParameter, target_of
from mr360uw.scene.model import Scene
from mr360uw.scene.problems import bounds_text, models_of
from mr360uw.scene.toml_model import toml_value
from mr360uw.tune.document import Document
from mr360uw.tune.views import round_length

Kind = Literal["number", "integer", "choice", "switch", "vector", "colour", "path", "text", "toml"]
"""toml: lists, tables, and values of several types, written as in a scene file."""

CONTROLS: dict[str, Any] = tomllib.loads((resources.files("mr360uw.tune") / "controls.toml").read_text("utf-8"))
"""Labels, titles, everyday words, ranges of sliders, what parameters count beside, and presets."""
FIRST: dict[str, str] = CONTROLS["first"]
"""The controls that decide most of the look, with their labels; keys without the number of a list's entry."""

_UNIT_SUFFIXES = ("_mg_m3", "_cd_m2", "_deg", "_rad", "_m", "_s", "_px", "_k")
_BY_UNIT = {"deg": (-180.0, 180.0), "m": (-20.0, 20.0), "s": (0.0, 60.0), "rad": (-math.pi, math.pi)}
_DECADES = 2.0
"""Ratio of a range's ends, as a power of ten, from which on a slider is logarithmic."""


@dataclass(frozen=True, slots=True)
class Field:
    """One parameter as a control shows it.

    key: below its table, as in "depth_m". low, high: the allowed range, None where it is open. span: of the slider;
    step: increment of the number box. default: of the file's value; None: none, or the key must be given (`required`);
    default_text: as TOML writes it. length: of a vector. changes: whether it may change within a clip. everyday: words
    by which it is found beside its own.
    """

    key: str
    label: str
    kind: Kind
    help: str
    unit: str
    default: Any
    default_text: str | None
    bounds: str
    low: float | None
    high: float | None
    span: tuple[float, float] | None
    logarithmic: bool
    step: float
    optional: bool
    required: bool
    choices: tuple[Any, ...]
    length: int
    changes: bool
    everyday: str


@dataclass(frozen=True, slots=True)
class Group:
    """A table of a scene. kinds: the fields that users set, by the names of its kinds, the default first; "" for one.

    tag: key that chooses among them. everyday: words by which all of it is found.
    """

    key: str
    title: str
    help: str
    repeated: bool
    optional: bool
    tag: str
    kinds: dict[str, tuple[Field, ...]]
    everyday: str


def groups() -> tuple[Group, ...]:
    """Return the tables of a scene in the order of the file."""
    found = []
    for name, field in Scene.model_fields.items():
        key, models = field.alias or name, models_of(field.annotation)
        tag = "model" if len(models) > 1 else ""
        tags = tuple(str(model.model_fields[tag].default) for model in models) if tag else ("",)
        changes, kinds = not stated(field, "fixed"), {}
        for kind, model in zip(tags, models, strict=True):
            own = [(n, f.alias or n, f) for n, f in model.model_fields.items() if not stated(f, "internal")]
            kinds[kind] = tuple(_field(key, word, f, tags if n == tag else (), changes) for n, word, f in own)
        optional, repeated = field.default is None, isinstance(field.default, tuple)
        title, everyday = CONTROLS["titles"].get(key, _label(key)), CONTROLS["everyday"].get(key, "")
        found.append(Group(key, title, field.description or "", repeated, optional, tag, kinds, everyday))
    return tuple(found)


def by_key(tables: Iterable[Group]) -> dict[str, Field]:
    """Return the fields of tables by their dotted keys, of the default kind where several kinds have them."""
    every = [(f"{group.key}.{field.key}", field) for group in tables for of in group.kinds.values() for field in of]
    return dict(reversed(every))


def without_numbers(key: str) -> str:
    """Return a dotted key without the numbers of the entries of lists."""
    return ".".join(part for part in key.split(".") if not part.isdecimal())


def _field(table: str, key: str, field: FieldInfo, tags: tuple[str, ...], changes: bool) -> Field:
    """Return a field's description.

    tags: the kinds of the table, where the field chooses one. changes: whether numbers of the table may.
    """
    path = f"{table}.{key}"
    options = [part for part in _parts(field.annotation) if part is not NoneType]
    optional = len(options) < len(_parts(field.annotation))
    choices = tags or _choices(options)
    kind = _kind(key, options, choices)
    unit = stated(field, "unit")
    changes &= kind in ("number", "vector", "colour") and not stated(field, "fixed")
    low, high = bounds_of(field)
    default = None if field.is_required() else field.get_default(call_default_factory=True)
    span, logarithmic = None, False
    if kind in ("number", "integer", "vector", "colour"):
        span, logarithmic = _span(key, unit, low, high, default, options[0])
    return Field(
        key, FIRST.get(path, _label(key)), kind, field.description or "", "" if unit == "1" else unit, default,
        None if default is None else toml_value(default), bounds_text(field), low, high, span, logarithmic,
        1.0 if span is None or kind == "integer" else _step(span, default, logarithmic), optional, field.is_required(),
        choices, len(get_args(options[0])) if kind in ("vector", "colour") else 0, changes,
        " ".join(CONTROLS["everyday"].get(part, "") for part in (key, path)),
    )  # fmt: skip


def _parts(annotation: Any) -> list[Any]:
    """Return the types that an annotation unites, those of unions inside of unions too, without what checks them."""
    if get_origin(annotation) is Annotated:
        return _parts(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [part for inner in get_args(annotation) for part in _parts(inner)]
    return [annotation]


def _choices(options: list[Any]) -> tuple[Any, ...]:
    if options == [bool]:
        return (True, False)
    if all(get_origin(part) is Literal for part in options):
        return tuple(dict.fromkeys(value for part in options for value in get_args(part)))
    return ()


def _kind(key: str, options: list[Any], choices: tuple[Any, ...]) -> Kind:
    if choices == (True, False):
        return "switch"
    if choices:
        return "choice"
    simple: dict[Any, Kind] = {float: "number", int: "integer", str: "text", Path: "path"}
    if len(options) == 1 and options[0] in simple:
        return simple[options[0]]
    if set(options) == {str, Path}:
        return "text"
    parts = get_args(options[0]) if get_origin(options[0]) is tuple and len(options) == 1 else ()
    if parts and Ellipsis not in parts and not any(models_of(part) for part in parts):
        return "colour" if key.endswith("color") else "vector"
    return "toml"


def _span(
    key: str, unit: str, low: float | None, high: float | None, default: Any, kind: Any
) -> tuple[tuple[float, float], bool]:
    """Return the range of a slider, and whether it is logarithmic."""
    middle = float(default) if isinstance(default, int | float) and default > 0 else 1.0
    if key in CONTROLS["spans"]:
        start, end = CONTROLS["spans"][key]
        start, end = start if low is None else max(start, low), end if high is None else min(end, high)
    elif low is not None and high is not None:
        start, end = low, high
        if low >= 0.0 and high > 10.0**_DECADES * max(low, middle):  # far wider than what the default stands for
            start, end = max(low, 0.01 * middle), min(high, 10.0**_DECADES * middle)
            if kind is int:
                start = max(1.0, low)
    elif low is not None:
        start, end = low, max(4.0 * middle, low + 1.0)
    else:
        start, end = _BY_UNIT.get(unit, (0.0, 4.0 * middle))
    return (start, end), start > 0.0 and end / start >= 10.0**_DECADES


def _step(span: tuple[float, float], default: Any, logarithmic: bool) -> float:
    """Return the increment of a number box, 1, 2 or 5 of some decimal place: about a 200th of the slider's span."""
    return round_length(max(span[0], 0.01 * abs(default or 0.0)) if logarithmic else (span[1] - span[0]) / 200.0)


def _label(key: str) -> str:
    bare = next((key.removesuffix(suffix) for suffix in _UNIT_SUFFIXES if key.endswith(suffix)), key)
    return bare.replace("_", " ").capitalize()


# The `[[keys]]` of a document: set, moved and removed, as steps of the document.

Pairs = Sequence[tuple[float, Any]]
"""Keys of a parameter: (time [s], a number or a vector), ascending."""
SAME_S = 1e-4
"""Keys nearer than this [s] are one: far below a frame."""


def keyed_parameters(document: Document) -> dict[str, KeyedParameter]:
    """Return the keyed parameters of the document's scene, by name."""
    return {key.parameter: key for key in document.scene.keys}


def values_at(document: Document, time_s: float) -> dict[str, Any]:
    """Return the values of the keyed parameters at a time, by name."""
    return {name: value_at(document, key, time_s) for name, key in keyed_parameters(document).items()}


def value_at(document: Document, key: KeyedParameter, time_s: float) -> Any:
    """Return the value of a keyed parameter at a time, of a key's own where it has one; a vector as a list."""
    at = next((one for one in key.time_s if abs(one - time_s) <= SAME_S), time_s)
    found = target_of(document.scene, key.parameter).value(key, at)
    return list(found) if isinstance(found, tuple) else found


def set_key(document: Document, parameter: str, time_s: float, value: Any, *, group: str | None = None) -> None:
    """Set the key of a parameter at a time, in place of one that is there. group: as `Document.set` has it.

    value: None removes the key; with the last one the parameter takes its value, without keys.
    """
    held = keyed_parameters(document).get(parameter)
    pairs = [pair for pair in _pairs(held) if abs(pair[0] - time_s) > SAME_S]
    pairs += [] if value is None else [(time_s, value)]
    set_keys(document, parameter, pairs, "smooth" if held is None else held.interpolation, group=group)


def has_key(document: Document, parameter: str, time_s: float) -> bool:
    """Return whether a parameter has a key at a time."""
    return any(abs(time - time_s) <= SAME_S for time, _ in _pairs(keyed_parameters(document).get(parameter)))


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
        times = np.unique([*times, *(time - 2.0 * SAME_S for time in key.time_s)])
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
    return [] if key is None else list(zip(key.time_s, key.value, strict=True))


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
    if key not in CONTROLS["effective"]:
        return ""
    other, *effective = CONTROLS["effective"][key]
    now, default = values(other)
    return "" if (now in effective if effective else now != default) else other


def set_along(key: str, values: Values) -> dict[str, Any]:
    """Return what else is set with a parameter of a dotted key so that it has an effect."""
    other = without_effect(key, values) if key in CONTROLS["along"]["keys"] else ""
    return {other: CONTROLS["effective"][key][1]} if other else {}
