# SPDX-License-Identifier: Apache-2.0
"""The base of all parameter models.

A parameter class lives beside the physics it feeds. It is a frozen pydantic model whose every field is declared
with `parameter(...)`: default, range, unit and one line of help stand in one place. The scene file, the command line,
the JSON schema and the tables of the documentation all read them from there.
"""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Parameters(BaseModel):
    """Frozen, strict about unknown keys, finite numbers only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _without_foreign_numbers(cls, data: Any) -> Any:
        """Refuse integers of more than 64 bits, and true and false, which Python counts as 1 and 0, as numbers."""
        if not isinstance(data, dict):
            return data
        fields = {key: field for name, field in cls.model_fields.items() for key in (name, field.alias)}
        switches = {key for key, field in fields.items() if _allows_truth(field.annotation)}
        return {key: _marked(value, truth=key in switches or key not in fields) for key, value in data.items()}


class _Foreign:
    """A value that may not be where it stands: of no type that a field takes."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def _marked(value: Any, *, truth: bool) -> Any:
    """Return a value with integers of more than 64 bits, and truth values where there may be none, as `_Foreign`."""
    if type(value) in (list, tuple):
        return type(value)(_marked(entry, truth=truth) for entry in value)
    if type(value) is dict:  # its own fields say where truth values may be
        return {key: _marked(entry, truth=True) for key, entry in value.items()}
    if isinstance(value, bool):
        return value if truth else _Foreign(str(value).lower())
    return _Foreign("an integer of more than 64 bits") if isinstance(value, int) and abs(value) >> 63 else value


def _allows_truth(annotation: Any) -> bool:
    """Return whether a type is bool, or has it among its parts."""
    return annotation in (bool, Any) or any(_allows_truth(part) for part in get_args(annotation))


def parameter(
    default: Any = ...,
    help_text: str = "",
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
    **extra: Any,
) -> Any:
    """Return a pydantic field with a default, an inclusive range [low, high] (or > above), a unit and a help line."""
    return Field(default, description=help_text, ge=low, le=high, gt=above, json_schema_extra={"unit": unit}, **extra)
