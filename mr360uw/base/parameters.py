# SPDX-License-Identifier: Apache-2.0
"""The base of all parameter models, and the checks of the arguments of public functions.

A parameter class lives beside the physics it feeds. It is a frozen pydantic model whose every field is declared
with `parameter(...)`: default, range, unit and one line of help stand in one place. The scene file, the command line,
the JSON schema and the tables of the documentation all read them from there.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import operator
import re
import types
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from mr360uw.base.constants import MOST_LIGHT
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
    **extra: Any,
) -> Any:
    """Return a pydantic field with a default, an inclusive range [low, high] (or > above), a unit and a help line.

    fixed: advice to who wants the number to change within a clip, which it cannot; "" where it can. internal: what sets
    it, where users need no control for it.
    """
    notes = {"fixed": fixed, "internal": internal}
    shown: dict[str, Any] = {"unit": unit} | {name: text for name, text in notes.items() if text}
    return Field(default, description=help_text, ge=low, le=high, gt=above, json_schema_extra=shown, **extra)


def advanced(*given: Any, **named: Any) -> Any:
    """Return a field as `parameter` does that few users need: the documentation lists it apart."""
    field = parameter(*given, **named)
    field.json_schema_extra["audience"] = "few"
    return field


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


# --- Arguments of functions -----------------------------------------------------------------------------------------

# Arguments: checks whose messages name the argument, what it is, and what it should be.
#
# Public functions call them once where an array enters. They refuse what is no number and what is not finite; the test
# for that is one sum over the array. `checked` tests all arguments of a function, or of a class, by their type hints.


_NUMBERS = "fiu"
T = TypeVar("T")
Call = TypeVar("Call", bound=Callable[..., Any])


def real(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return values as an array of their own type; raise `ParameterError` unless they are real numbers, or NaN."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # lists of unequal lengths
        raise ParameterError(f"{name} - must be an array of numbers (got: {error!s:.60}) - give one shape") from None
    if array.dtype.kind not in _NUMBERS:
        raise ParameterError(f"{name} - must be real numbers (got {array.dtype}: {values!r:.40}) - give numbers")
    return array


def is_finite(array: NDArray[Any]) -> bool:
    """Return whether all numbers of an array are finite."""
    if array.dtype.kind != "f":
        return True
    with np.errstate(all="ignore"):  # infinities cancel to NaN, and finite ones may overflow
        return bool(np.isfinite(array.sum(dtype=np.float64)) or np.all(np.isfinite(array)))


def is_light(array: NDArray[Any]) -> bool:
    """Return whether all samples are numbers within `MOST_LIGHT`."""
    return bool(array.size == 0 or (array.max() <= MOST_LIGHT and array.min() >= -MOST_LIGHT))


def numbers(name: str, values: ArrayLike, *, infinite: bool = False) -> NDArray[Any]:
    """Return values as an array of their own type; raise `ParameterError` unless they are real, finite numbers.

    infinite: they may be infinite, not NaN.
    """
    array = real(name, values)
    if not is_finite(array) and not (infinite and not np.any(np.isnan(array))):
        raise ParameterError(f"{name} - must be finite (got {array[~np.isfinite(array)].flat[0]}) - give numbers")
    return array


def number(name: str, value: Any) -> float:
    """Return one number; raise `ParameterError` for other shapes, and as `numbers` does."""
    return float(exactly(name, value, ()))


def whole(name: str, value: Any, least: int, most: int) -> int:
    """Return a whole number of a range; raise `ParameterError` for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value <= most:
        raise ParameterError(f"{name} - must be a whole number (got {value!r:.40}) - choose {least} to {most}")
    return int(value)


def instance(name: str, value: Any, kind: type[T], advice: str) -> T:
    """Return a value of a type; raise `ParameterError` for one of another. advice: what makes one."""
    if not isinstance(value, kind):
        raise ParameterError(f"{name} - must be a {kind.__name__} (got {type(value).__name__}) - {advice}")
    return value


def file_path(name: str, value: Any) -> Path:
    """Return a path; raise `ParameterError` for what is no name of a file."""
    if not isinstance(value, str) and not hasattr(value, "__fspath__"):
        raise ParameterError(f"{name} - must be the name of a file (got {type(value).__name__}) - give text or a Path")
    return Path(value)


def vectors(name: str, values: ArrayLike, size: int = 3) -> NDArray[Any]:
    """Return values as an array (..., size) of their own type; raise `ParameterError` for another last axis."""
    array = numbers(name, values)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ParameterError(f"{name} - must be (..., {size}) (got shape {array.shape}) - give {size} numbers each")
    return array


def exactly(name: str, values: ArrayLike, *shapes: tuple[int, ...]) -> NDArray[Any]:
    """Return values as an array of their own type; raise `ParameterError` unless they have one of the shapes."""
    array = numbers(name, values)
    if array.shape not in shapes:
        wanted = " or ".join(str(shape) for shape in shapes)
        raise ParameterError(f"{name} - must have the shape {wanted} (got {array.shape}) - reshape it")
    return array


def common_shape(may_be_infinite: str = "", **arguments: ArrayLike) -> tuple[int, ...]:
    """Return the shape to which arguments broadcast; raise `ParameterError` where they do not, or are no numbers.

    may_be_infinite: the name of one that may.
    """
    shapes = {n: numbers(n, values, infinite=n == may_be_infinite).shape for n, values in arguments.items()}
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        got = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ParameterError(f"{', '.join(shapes)} - do not fit together (got {got}) - give one shape") from None


def checked(call: Call) -> Call:
    """Return a function, or a class, that raises `ParameterError` for arguments that their type hints do not allow.

    Numbers are finite ones, no truth values; arrays are what `real` takes. `Annotated` hints with `Ge` and the like, as
    `pydantic.NonNegativeFloat`, are ranges. Shapes are checked where they are used.
    """
    if isinstance(call, type):
        call.__init__ = checked(call.__init__)  # type: ignore[misc]  # of this very class
        return call
    signature = inspect.signature(call)

    @functools.cache
    def hints() -> dict[str, Any]:  # at the first call, when all modules are loaded
        found = get_type_hints(call, localns=_Known(vars(builtins) | call.__globals__), include_extras=True)
        return {name: found[name] for name in signature.parameters if name in found}

    @functools.wraps(call)
    def checking(*arguments: Any, **named: Any) -> Any:
        for name, value in signature.bind(*arguments, **named).arguments.items():
            if name in hints() and not _allows(hints()[name], value):
                wanted, where = _in_words(hints()[name]), call.__qualname__.removesuffix(".__init__")
                raise ParameterError(f"{name} - must be {wanted} (got {value!r:.40}) - help({where}) says more")
        return call(*arguments, **named)

    return checking  # type: ignore[return-value]


class _Known(dict[str, Any]):
    """Names of a module; one that it imports for type checkers alone stands for any object."""

    def __missing__(self, name: str) -> type:
        return object


def _allows(hint: Any, value: Any) -> bool:
    """Return whether a type hint allows a value."""
    # Hints that are made of others
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind is Any:
        return True
    if kind is Annotated:
        return _allows(parts[0], value) and all(_in_range(rule, value) for rule in parts[1:])
    # Arrays and containers
    if hint == ArrayLike or kind is np.ndarray:
        return _is_array(value)
    if kind in (Union, types.UnionType):
        return any(_allows(part, value) for part in parts) and not (Path in parts and "\0" in str(value))
    if kind is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if kind is tuple:
        return isinstance(value, tuple | list) and _allow_entries(parts, value)
    if kind is Sequence or kind is list:
        listed = value.ndim > 0 if isinstance(value, np.ndarray) else isinstance(value, Sequence)
        return listed and not isinstance(value, str | bytes) and all(_allows(parts[0], one) for one in value)
    # Numbers, paths, callables, protocols and classes
    if kind in (float, int, Fraction):
        return _is_number(kind, value)
    if kind is Path:
        return hasattr(value, "__fspath__")
    if kind is Callable:
        return callable(value)
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(kind) if not name.startswith("_"))
    return not isinstance(kind, type) or isinstance(value, kind)


_ORDER: dict[str, tuple[Callable[[Any, Any], bool], str]] = {
    "ge": (operator.ge, "at least"), "gt": (operator.gt, "more than"),
    "le": (operator.le, "at most"), "lt": (operator.lt, "less than"),
}  # fmt: skip
"""Limits that the rules of `Annotated` hints may have: the comparison, and its words."""


def _limits(rule: Any) -> dict[str, Any]:
    return {name: limit for name in _ORDER if (limit := getattr(rule, name, None)) is not None}


def _in_range(rule: Any, value: Any) -> bool:
    return all(_ORDER[name][0](value, limit) for name, limit in _limits(rule).items())


def _is_array(value: Any) -> bool:
    try:
        return real("", value).dtype.kind in _NUMBERS
    except ParameterError:
        return False


def _is_number(kind: type, value: Any) -> bool:
    """Return whether a value is a finite number of a kind (float, int, Fraction), and no truth value."""
    if kind is not float:
        return isinstance(value, int | np.integer | kind) and not isinstance(value, bool)
    return _is_array(value) and np.ndim(value) == 0 and is_finite(np.asarray(value))


def _allow_entries(hints: tuple[Any, ...], values: Sequence[Any]) -> bool:
    """Return whether the hints of a tuple allow its entries."""
    if hints[-1] is Ellipsis:
        return all(_allows(hints[0], value) for value in values)
    return len(hints) == len(values) and all(map(_allows, hints, values))


_WORDS: dict[Any, str] = {
    float: "a finite number", int: "a whole number", Fraction: "a fraction", str: "text", Path: "a Path",
    bool: "True or False", Callable: "a function", types.NoneType: "None",
}  # fmt: skip


def _in_words(hint: Any) -> str:
    """Return what a type hint allows, in words."""
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind is Annotated:
        limits = [f"{_ORDER[name][1]} {limit}" for rule in parts[1:] for name, limit in _limits(rule).items()]
        return " of ".join(filter(None, [_in_words(parts[0]), " and ".join(limits)]))
    if hint == ArrayLike or kind is np.ndarray:
        return "an array of numbers"
    if kind in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(_in_words, parts)))
    if kind is Literal:
        return " or ".join(map(repr, parts))
    if kind in (tuple, list, Sequence):
        every = kind is not tuple or parts[-1] is Ellipsis
        return f"a sequence of {_in_words(parts[0])}" if every else f"({', '.join(map(_in_words, parts))})"
    return _WORDS.get(kind) or f"a {getattr(kind, '__name__', kind)}"
