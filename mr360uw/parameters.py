# SPDX-License-Identifier: Apache-2.0
"""The base of all parameter models.

A parameter class lives beside the physics it feeds. It is a frozen pydantic model whose every field is declared
with `parameter(...)`: default, range, unit and one line of help stand in one place. The scene file, the command line,
the JSON schema and the tables of the documentation all read them from there.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Parameters(BaseModel):
    """Frozen, strict about unknown keys, finite numbers only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


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
