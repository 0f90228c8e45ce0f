# SPDX-License-Identifier: Apache-2.0
"""Values of parameters over time, the `[[keys]]` tables of a scene: which can change, and a scene with their values.

Numbers that may be fractions, and vectors of them, can change. Whole numbers (counts, sizes, seeds), words, switches
and files cannot, nor can fields that are declared `fixed` (see `parameters.parameter`).
"""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, Field, ValidationError, ValidationInfo, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import InitErrorDetails, PydanticCustomError

from mr360uw.base.cache import shared
from mr360uw.base.parameters import FULL_TURN_DEG, LATEST_S, Parameters, bounds_of, is_direction, stated
from mr360uw.base.parameters import parameter as declared  # a field has its name
from mr360uw.composite.motion import ValuesOverTime
from mr360uw.errors import ParameterError
from mr360uw.scene.problems import Location, allowed_text, place, problems
from mr360uw.scene.toml_model import as_tables, dotted, entry
from mr360uw.types import Floats

Value = float | tuple[float, ...]
"""A number, or a vector of numbers."""
ClipTime = Annotated[float, Field(ge=-LATEST_S, le=LATEST_S)]
"""A time [s] from the start of a clip."""


class KeyedParameter(Parameters):
    """One parameter that changes over time; before the first and after the last key it stays."""

    parameter: str = declared(..., "its name, as --set has it: sea.wind_speed, object.0.position_m.1")
    time_s: tuple[ClipTime, ...] = declared(..., "times of the keys from the start of the clip, ascending", unit="s")
    value: tuple[Value, ...] = declared(
        ..., "its value at each of these times: a number, or a list of numbers for a vector"
    )
    interpolation: Literal["linear", "smooth", "hold"] = declared(
        "smooth", "between keys: straight, a monotone cubic, or the value of the key before"
    )

    @field_validator("time_s")
    @classmethod
    def _ascending(cls, times: tuple[float, ...]) -> tuple[float, ...]:
        if not times:
            raise ValueError("is empty (got []) - give the time of one key at least")
        for one, after in itertools.pairwise(times):
            if after <= one:
                raise ValueError(f"must ascend (got {one:g}, then {after:g}) - sort the keys, one for each time")
        return times

    @field_validator("value")
    @classmethod
    def _one_for_each_time(cls, values: tuple[Value, ...], info: ValidationInfo) -> tuple[Value, ...]:
        times = info.data.get("time_s", values)
        if len(values) != len(times):
            raise ValueError(
                f"must have an entry for each time (got {len(values)} for {len(times)}) - add or remove entries"
            )
        if () in values:
            raise ValueError("has an empty list for a value (got []) - give a number, or the numbers of a vector")
        if len({np.shape(value) for value in values}) > 1:
            raise ValueError("must be all numbers or all vectors of one length (got both) - write them alike")
        return values

    def at(self, time_s: float, *, turns: bool = False) -> Value:
        """Return the value at a time [s]. turns: it is an angle [deg] that goes the shorter way round."""
        if not self.time_s[0] < time_s < self.time_s[-1]:
            return self.value[0 if time_s <= self.time_s[0] else -1]
        found = _over_time(self, turns and self.interpolation != "hold").at(time_s)
        return tuple(found.tolist()) if np.ndim(found) else float(found)


@shared(keep=256)
def _over_time(key: KeyedParameter, turns: bool) -> ValuesOverTime:
    """Return the values of a parameter; those that turn go the shorter way."""
    values: Floats = np.asarray(key.value, np.float64)
    if turns:
        values = np.unwrap(values, period=FULL_TURN_DEG, axis=0)
    return ValuesOverTime(key.time_s, values, key.interpolation)


M = TypeVar("M", bound=BaseModel)
_ANY_LENGTH = -1


@dataclass(frozen=True, slots=True)
class Target:
    """A parameter of a scene. path: field names and numbers of entries. location: the same as a file has them.

    lengths: allowed numbers of components of its value; 0 for a number.
    """

    path: Location
    location: Location
    field: FieldInfo
    lengths: frozenset[int]

    @property
    def turns(self) -> bool:
        """Whether it is a direction all round, which goes the shorter way."""
        return is_direction(self.field)

    def value(self, key: KeyedParameter, time_s: float) -> Value:
        """Return its value at a time, directions within their range."""
        found = key.at(time_s, turns=self.turns)
        if not self.turns:
            return found
        return tuple(map(self._in_range, found)) if isinstance(found, tuple) else self._in_range(found)

    def _in_range(self, angle_deg: float) -> float:
        low, high = bounds_of(self.field)
        if high is not None and angle_deg > high:
            return angle_deg - FULL_TURN_DEG
        return angle_deg + FULL_TURN_DEG if low is not None and angle_deg < low else angle_deg


def target_of(scene: BaseModel, name: str) -> Target:
    """Return the parameter of a name such as object.0.scale; raise `ParameterError` where it cannot change."""
    # Walk from the scene down to the parameter
    owner: Any = scene
    path: Location = ()
    location: Location = ()
    field: FieldInfo | None = None
    for part in dotted(name):
        step, found = _step(owner, part, name, location)
        owner = getattr(owner, step) if isinstance(step, str) else owner[step]
        field = found or field
        path, location = (*path, step), (*location, part if isinstance(step, str) else step)
    assert field is not None, "the first part of a name is a field of the scene"
    # Accept numbers and vectors; say what else it is
    lengths = _lengths(field.annotation)
    if isinstance(path[-1], int):
        lengths = frozenset({0}) if lengths - {0} and isinstance(owner, float) else frozenset()
    if not lengths:
        if _holds_models(owner):
            raise ParameterError(f"is a table (got {name!r}) - name a number in it")
        kind = "a word" if (words := allowed_text(field.annotation)).startswith("'") else words
        raise ParameterError(
            f"cannot change within a clip (got {name!r}, {kind}) - numbers that may be fractions can, and vectors"
        )
    return Target(path, location, field, lengths)


def _step(owner: Any, part: str, name: str, location: Location) -> tuple[str | int, FieldInfo | None]:
    """Return the name of a field, and the field, or the number of an entry, that a part of a name leads to."""
    # An entry of a list
    if isinstance(owner, tuple):
        number = entry(part, len(owner))
        if number is None:
            raise ParameterError(f"no such entry (got {name!r}) - there are {len(owner)}, the first is 0")
        return number, None
    # A field of a table: advise where there is none, or where it cannot change
    if not isinstance(owner, BaseModel):
        where = ".".join(map(str, location))
        raise ParameterError(
            f"has no {part!r} (got {name!r}) - {where} is {'not set: set it first' if owner is None else repr(owner)}"
        )
    fields = {field.alias or known: known for known, field in type(owner).model_fields.items()}
    if part not in fields:
        near = difflib.get_close_matches(part, fields, 1)
        begin = "".join(f"{one}." for one in location)
        todo = f"did you mean '{begin}{near[0]}'?" if near else f"known here: {', '.join(fields)}"
        raise ParameterError(f"unknown parameter (got {name!r}) - {todo}")
    field = type(owner).model_fields[fields[part]]
    if advice := stated(field, "fixed"):
        raise ParameterError(f"cannot change within a clip (got {name!r}) - {advice}")
    return fields[part], field


def _holds_models(value: Any) -> bool:
    return isinstance(value, BaseModel) or (isinstance(value, tuple) and any(map(_holds_models, value)))


def _lengths(annotation: Any) -> frozenset[int]:
    """Return the numbers of components that values of a type have: 0 for a number, `_ANY_LENGTH` for any."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _lengths(parts[0])
    if origin in (Union, UnionType):
        return frozenset[int]().union(*map(_lengths, parts))
    if origin is tuple and _lengths(parts[0]) == {0}:
        return frozenset({_ANY_LENGTH if parts[-1] is Ellipsis else len(parts)})
    return frozenset({0} if annotation is float else ())


def with_values(scene: M, keys: Iterable[KeyedParameter], time_s: float) -> M:
    """Return a scene with the values that keys give at a time; they are not checked, see `check_keys`.

    A sea whose wind changes gets the settings that keep its waves where they are.
    """
    for key in keys:
        target = target_of(scene, key.parameter)
        scene = _replaced(scene, target.path, target.value(key, time_s))
        for name, value in _kept_waves(scene, target, key).items():
            scene = _replaced(scene, ("sea", name), value)
    return scene


def _kept_waves(scene: BaseModel, target: Target, key: KeyedParameter) -> dict[str, Any]:
    """Return the settings of a sea, unless they are set, that hold for all values of its keyed wind."""
    if target.path == ("sea", "wind_speed"):
        found: dict[str, Any] = {"waves_of_wind_speed": float(np.clip(np.max(key.value), *bounds_of(target.field)))}
    elif target.path == ("sea", "wind_direction_deg"):
        turns = np.unwrap(np.asarray(key.value, np.float64), period=FULL_TURN_DEG)
        found = {"waves_of_wind_deg": (float(turns.min()), float(turns.max()))}
    else:
        return {}
    sea = getattr(scene, "sea", None)
    return {name: value for name, value in found.items() if getattr(sea, name, value) is None}


def _replaced(owner: Any, path: Location, value: Any) -> Any:
    if not path:
        return value
    head, rest = path[0], path[1:]
    if isinstance(head, int):
        return (*owner[:head], _replaced(owner[head], rest, value), *owner[head + 1 :])
    return owner.model_copy(update={head: _replaced(getattr(owner, head), rest, value)})


Problem = tuple[Location, Any, str]
"""Place in the file, the value there, and what is wrong with it and what to do."""
Keyed = tuple[int, KeyedParameter, Target]
"""A table of keys: its number, itself, and the parameter that it is of."""


def check_keys(scene: BaseModel, keys: tuple[KeyedParameter, ...]) -> None:
    """Raise `ValidationError` with every problem of the keys of a scene."""
    sound: list[Keyed] = []
    found: list[Problem] = []
    for number, key in enumerate(keys):
        try:
            sound.append((number, key, target_of(scene, key.parameter)))
        except ParameterError as error:
            found.append((("keys", number, "parameter"), key.parameter, str(error)))
    for check in (_twice, _misshapen, _of_values):
        found += check(scene, sound)
        unsound = {at[1] for at, _, _ in found}
        sound = [one for one in sound if one[0] not in unsound]
    if found:
        lines = [
            InitErrorDetails(type=PydanticCustomError("value_error", "{error}", {"error": text}), loc=at, input=got)
            for at, got, text in found
        ]
        raise ValidationError.from_exception_data(type(scene).__name__, lines)


def key_times(keys: Iterable[KeyedParameter]) -> list[float]:
    """Return the times [s] of all keys, ascending."""
    return sorted({time for key in keys for time in key.time_s})


def _twice(scene: BaseModel, keyed: list[Keyed]) -> Iterator[Problem]:
    """Yield the parameters whose values are given a second time, by other keys or by the keys of an object or lamp."""
    for place_of, (number, key, target) in enumerate(keyed):
        at, name = ("keys", number, "parameter"), key.parameter
        for before, _, other in keyed[:place_of]:
            if all(one == two for one, two in zip(target.path, other.path, strict=False)):
                yield at, name, f"is keyed already (got {name!r}) - keys[{before}] has it: remove one of them"
        owner: Any = scene
        for step in target.path:
            own = getattr(owner, "key", ())
            if own and step in type(own[0]).model_fields:
                table = f"[[{target.location[0]}.key]]"
                yield at, name, f"has keys of its own (got {name!r}) - remove these, or the {table} tables"
            owner = getattr(owner, step) if isinstance(step, str) else owner[step]


def _misshapen(scene: BaseModel, keyed: list[Keyed]) -> Iterator[Problem]:  # noqa: ARG001 - as the others
    """Yield the values that are not numbers or vectors as the parameter is."""
    for number, key, target in keyed:
        for index, value in enumerate(key.value):
            length = len(value) if isinstance(value, tuple) else 0
            if length in target.lengths or (length > 0 and _ANY_LENGTH in target.lengths):
                continue
            wanted = " or ".join("a number" if n == 0 else f"a list of {n} numbers" for n in sorted(target.lengths))
            shown = list(value) if isinstance(value, tuple) else value
            text = f"must be {wanted} (got {shown}) - as {key.parameter} is"
            yield ("keys", number, "value", index), value, text


def _of_values(scene: BaseModel, keyed: list[Keyed]) -> Iterator[Problem]:
    """Yield what the models say against the scene at the times of the keys, of each parameter at its own if it can."""
    keys, found = [key for _, key, _ in keyed], list[Problem]()
    names = [place("", {}, target.location).strip() for _, _, target in keyed]
    for time in key_times(keys):
        try:
            type(scene).model_validate(as_tables(with_values(scene, keys, time)) | {"keys": ()})
        except ValidationError as error:
            for line in problems(error, type(scene), "", {}):
                name, _, text = line.strip().partition(" - ")
                of = next((n for n, one in enumerate(names) if name.startswith(one)), None)
                if of is None:
                    of = next(n for n, key in enumerate(keys) if time in key.time_s)
                    text = f"{name} at {time:g} s: {text}".strip()
                number, key, _ = keyed[of]
                own = ("value", key.time_s.index(time)) if time in key.time_s else ()
                found.append((("keys", number, *own), time, text))
    at_own = {at[1] for at, _, _ in found if len(at) > len(("keys", 0))}
    yield from (one for one in found if len(one[0]) > len(("keys", 0)) or one[0][1] not in at_own)
