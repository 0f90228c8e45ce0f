# SPDX-License-Identifier: Apache-2.0
"""The base of all parameter models.

A parameter class lives beside the physics it feeds. It is a frozen pydantic model whose every field is declared
with `parameter(...)`: default, range, unit and one line of help stand in one place. The scene file, the command line,
the JSON schema and the tables of the documentation all read them from there.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from mr360uw.errors import Mr360uwError, ParameterError

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

FULL_TURN_DEG = 360.0
LATEST_S = 1e6
"""Most time [s] from the start of a clip, before and after: eleven days, whose frames doubles still tell apart."""
_PARAMETERS = "\n\nParameters\n----------\n"
"""Heading of the section that `listed` adds to a docstring, as it stands there without indents."""


class _RefusedAsArguments(ModelMetaclass):
    """The class of models whose call raises an error of the project's; tables of files are validated without a call."""

    refusal: Callable[[ValidationError], Mr360uwError]

    def __call__(self, *arguments: Any, **values: Any) -> Any:
        try:
            return super().__call__(*arguments, **values)
        except ValidationError as error:
            raise self.refusal(error) from None


def _told(model: str, problem: Any) -> str:
    """Return a problem of pydantic's in the words of an argument's."""
    name = ".".join([model, *map(str, problem["loc"])])
    what = problem["msg"].removeprefix("Value error, ")
    ours = " (got " in what and " - " in what
    return what if ours else f"{name} - {what} (got {problem['input']!r:.40}) - correct it"


class Parameters(BaseModel, metaclass=_RefusedAsArguments):
    """Frozen, strict about unknown keys, finite numbers only. Raises `ParameterError` where it is called."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    @classmethod
    def refusal(cls, error: ValidationError) -> Mr360uwError:
        """Return what a call of this model raises for an error of pydantic's."""
        return ParameterError("\n".join(_told(cls.__name__, one) for one in error.errors()))

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: Any) -> dict[str, Any]:
        """Return the JSON schema, whose description is the text before the sections: its fields have their own."""
        schema: dict[str, Any] = handler(core_schema)
        own = handler.resolve_ref_schema(schema)
        if "description" in own:
            own["description"] = own["description"].partition(_PARAMETERS)[0]
        return schema

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
    fixed: str = "",
    internal: str = "",
    audience: str = "",
    **extra: Any,
) -> Any:
    """Return a pydantic field with a default, an inclusive range [low, high] (or > above), a unit and a help line.

    fixed: advice to who wants the number to change within a clip, which it cannot; "" where it can. internal: what sets
    it, where users need no control for it. audience: who needs it, where that is not every user.
    """
    notes = {"unit": unit, "fixed": fixed, "internal": internal, "audience": audience}
    shown: dict[str, Any] = {name: text for name, text in notes.items() if text or name == "unit"}
    return Field(default, description=help_text, ge=low, le=high, gt=above, json_schema_extra=shown, **extra)


advanced = partial(parameter, audience="few")
"""As `parameter`, for a field that few users need: the documentation lists it apart."""


Model = TypeVar("Model", bound=BaseModel)


def listed(model: type[Model]) -> type[Model]:
    """Return a model whose docstring lists its fields as a numpydoc section, before the first section it has.

    Each field says its type, default, meaning, unit and range, as `parameter` has them.
    """
    summary, rule, sections = (model.__doc__ or "").partition(_first_section(model.__doc__ or ""))
    lines = ["Parameters", "----------"]
    for name, field in model.model_fields.items():
        value = None if field.is_required() else field.get_default(call_default_factory=True)
        default = ", optional" if isinstance(value, BaseModel) else f", default {value!r}"
        lines += [
            f"{field.alias or name} : {_type_name(field.annotation)}{'' if field.is_required() else default}",
            f"    {_sentence(field)}",
        ]
    table = "\n".join(f"    {line}" for line in lines)
    model.__doc__ = f"{summary.rstrip()}\n\n{table}\n\n{rule}{sections}".rstrip() + "\n    "
    return model


def _first_section(text: str) -> str:
    """Return the heading of the first numpydoc section of a docstring, with its line break; "" where there is none."""
    found = re.search(r"^ *\w[\w ]*\n *-{3,}$", text, re.MULTILINE)
    return found[0] if found else "\0"


def _type_name(annotation: Any) -> str:
    text = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    if "Annotated" in text:
        text = text.partition("[")[0]
    return re.sub(r"\b(?:typing|pathlib|mr360uw(?:\.\w+)*)\.", "", text).replace(" | ", " or ")


def _sentence(field: FieldInfo) -> str:
    """Return a field's meaning with its unit and range, as a sentence."""
    text, unit, (low, high) = field.description or "", stated(field, "unit"), bounds_of(field)
    text += f" [{unit}]" if unit else ""
    text += "" if low is None and high is None else f"; from {low:g}" if high is None else ""
    text += "" if high is None else f"; up to {high:g}" if low is None else f"; {low:g} to {high:g}"
    return f"{text[:1].upper()}{text[1:]}."


def stated(field: FieldInfo, name: Literal["unit", "fixed", "internal", "audience"]) -> str:
    """Return the unit of a field, why it is fixed, what sets it, or who needs it; "" where nothing is stated."""
    shown = field.json_schema_extra
    return str(shown.get(name, "")) if isinstance(shown, dict) else ""


def bounds_of(field: FieldInfo) -> tuple[float | None, float | None]:
    """Return the least and greatest value of a field, None where there is none."""
    low = [getattr(rule, name, None) for rule in field.metadata for name in ("ge", "gt")]
    high = [getattr(rule, "le", None) for rule in field.metadata]
    return next((x for x in low if x is not None), None), next((x for x in high if x is not None), None)


def is_direction(field: FieldInfo) -> bool:
    """Return whether a field is an angle all round, in degrees: without a range, or with a turn to either side of 0."""
    low, high = bounds_of(field)
    if stated(field, "unit") != "deg" or low is None or high is None:
        return stated(field, "unit") == "deg" and low is high is None
    return low < 0.0 and high - low >= FULL_TURN_DEG
