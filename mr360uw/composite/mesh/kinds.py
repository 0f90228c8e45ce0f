# SPDX-License-Identifier: Apache-2.0
"""Kinds of things that meshes show, known by words in the names of their files and parts."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, cast

from mr360uw.reading.input_files import own_table

Habit = Literal["swims", "stands", "flies"]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of thing. low_m, high_m: between which its longest side is. typical_m: where the file's own is not.

    habit: whether it is in open water, on the floor, or in the sky. blunt: whether its front is the thicker end.
    """

    word: str
    low_m: float
    high_m: float
    typical_m: float
    habit: Habit
    blunt: bool


@functools.cache
def kinds() -> tuple[Kind, ...]:
    """Return the kinds in the order in which their words are looked for."""
    rows = (row.values() for row in own_table("composite/mesh/data/kinds.csv"))
    return tuple(
        Kind(word, float(low), float(high), float(typical), cast("Habit", habit), front == "thick")
        for word, low, high, typical, habit, front in rows
    )


_OF_PROGRAMS = {"plane"}
"""Words that modelling programs give to parts by themselves."""


def kind_of(name: str, parts: Iterable[str] = ()) -> Kind | None:
    """Return the kind whose word a file's name holds, or else one of its parts'; short words must stand alone.

    None where there is none.
    """
    found = _kind_in(name)
    named = (_kind_in(part) for part in parts)
    return found or next((kind for kind in named if kind is not None and kind.word not in _OF_PROGRAMS), None)


def _kind_in(name: str) -> Kind | None:
    plain = re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()
    words = re.split(r"[^a-z]+", plain)
    joined = "".join(words)
    for kind in kinds():
        hit = kind.word in words or f"{kind.word}s" in words or (len(kind.word) > 4 and kind.word in joined)
        if hit or (kind.word == "fish" and any(word.endswith("fish") for word in words)):
            return kind
    return None
