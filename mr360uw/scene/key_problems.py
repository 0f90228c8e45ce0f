# SPDX-License-Identifier: Apache-2.0
"""Checks of the keys of a scene: every problem of their parameters, and of the scene at the times of the keys."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from mr360uw.errors import ParameterError
from mr360uw.scene.key_targets import ANY_LENGTH, KeyedParameter, Target, target_of, with_values
from mr360uw.scene.problems import Location, place, problems

Problem = tuple[Location, Any, str]
"""Where in the file, what stands there, and what is wrong with it and what to do."""
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
            if length in target.lengths or (length > 0 and ANY_LENGTH in target.lengths):
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
            type(scene).model_validate(_as_given(with_values(scene, keys, time)) | {"keys": ()})
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


def _as_given(value: Any) -> Any:
    """Return a model as the tables of its file that are set, with the words that tell its kind."""
    if isinstance(value, tuple):
        return tuple(map(_as_given, value))
    if not isinstance(value, BaseModel):
        return value
    fields = type(value).model_fields
    kinds = {n for n, f in fields.items() if get_origin(f.annotation) is Literal and len(get_args(f.annotation)) == 1}
    names = value.model_fields_set | kinds
    return {fields[name].alias or name: _as_given(getattr(value, name)) for name in names}
