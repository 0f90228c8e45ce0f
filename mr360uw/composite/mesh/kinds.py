# SPDX-License-Identifier: Apache-2.0
"""Kinds of things that meshes show, known by words in the names of their files and parts."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

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
    blunt: bool = True


def _kinds(rows: str, habit: Habit, *, blunt: bool = True) -> list[Kind]:
    found = []
    for row in rows.split(";"):
        word, low, high, typical = row.split()
        found.append(Kind(word, float(low), float(high), float(typical), habit, blunt))
    return found


KINDS: tuple[Kind, ...] = (
    *_kinds(
        "whaleshark 3 14 7; whale 3 30 8; orca 3 9 6; dolphin 1 4 2.5; porpoise 1 2.5 1.6; shark 0.5 7 2.5; "
        "hammerhead 0.9 6 3; seahorse 0.02 0.4 0.12; cuttlefish 0.1 1.2 0.4; clownfish 0.05 0.18 0.1; "
        "goldfish 0.05 0.4 0.15; jellyfish 0.05 2.5 0.4; starfish 0.05 0.6 0.2; crayfish 0.1 0.6 0.25; "
        "fish 0.05 2.5 0.4; barramundi 0.2 1.8 0.8; snapper 0.1 1.2 0.4; grouper 0.2 2.5 0.8; tuna 0.4 4 1.5; "
        "salmon 0.3 1.5 0.8; barracuda 0.3 2 1; manta 1 8 4; ray 0.3 8 1.5; eel 0.3 3 1; turtle 0.2 2.5 1; "
        "seal 0.8 4 1.8; squid 0.1 13 0.5; octopus 0.1 4 0.8; penguin 0.3 1.2 0.7; duck 0.05 0.7 0.4",
        "swims",
    ),
    *_kinds(
        "jelly 0.05 2.5 0.4; scuba 1.2 2.6 1.9; diver 1.2 2.6 1.9; swimmer 1.2 2.5 1.8; mermaid 1.2 2.8 1.9; "
        "submarine 2 180 12; rov 0.3 3 0.9; auv 0.8 7 2; drone 0.1 2 0.4; robot 0.2 3 1; torpedo 1 8 5",
        "swims",
        blunt=False,
    ),
    *_kinds(
        "bird 0.1 3 0.6; gull 0.3 1.7 1.2; pelican 1 3.4 2.5; parrot 0.15 1 0.4; eagle 0.6 2.5 2; balloon 0.2 30 0.4; "
        "kite 0.3 5 1; butterfly 0.02 0.3 0.08; airship 10 250 60",
        "flies",
        blunt=False,
    ),
    *_kinds(
        "crab 0.05 0.6 0.25; lobster 0.15 0.9 0.4; bunny 0.1 0.6 0.3; rabbit 0.1 0.7 0.4; cow 1.2 3 2.2; "
        "horse 1.2 3 2.3; dog 0.3 1.5 0.9",
        "stands",
    ),
    *_kinds(
        "shipwreck 3 150 15; wreck 3 150 12; ship 4 300 20; boat 1.5 20 5; anchor 0.3 4 1.2; propeller 0.2 9 1.5; "
        "cannon 0.8 4 2.2; amphora 0.3 1.5 0.8; chest 0.3 1.5 0.9; barrel 0.5 1.5 0.9; coral 0.05 4 0.6; "
        "sponge 0.05 2 0.6; rock 0.1 10 1.2; boulder 0.4 10 1.5; statue 0.3 6 1.8; column 0.5 12 3; temple 3 60 12; "
        "car 2.5 6 4.3; truck 3 18 5; bus 5 19 11; plane 5 75 10; bottle 0.08 0.5 0.25; person 1.2 2.2 1.75; "
        "human 1.2 2.2 1.75; "
        "mannequin 1.2 2.2 1.8; dummy 0.5 2.2 1.8; man 1.4 2.2 1.8; woman 1.3 2.1 1.7; soldier 1.2 2.2 1.8; "
        "crate 0.3 2.5 0.8; chair 0.4 1.6 0.9; table 0.4 3 1.4",
        "stands",
        blunt=False,
    ),
)
"""Kinds in the order in which their words are looked for. Lengths of grown animals and common things, with margins for
young and large ones; the limits only decide which unit a file is in."""


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
    for kind in KINDS:
        hit = kind.word in words or f"{kind.word}s" in words or (len(kind.word) > 4 and kind.word in joined)
        if hit or (kind.word == "fish" and any(word.endswith("fish") for word in words)):
            return kind
    return None
