# SPDX-License-Identifier: Apache-2.0
"""Shader sources: #include, generated constants, and compiler messages that name the file.

`#include "medium/lookup.glsl"` takes a path below the package folder, or beside the including file, once per program.
`constants.glsl`, generated from `mr360uw.constants`, is prepended to every shader. Line markers encode the file in the
number (`#line 30012` = file 3, line 12), because Mesa always prints source 0.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mr360uw import constants
from mr360uw.errors import GlError

VERSION = "#version 330 core"
_ROOT = Path(__file__).resolve().parent.parent
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*(?://.*)?$')
_LINES_PER_FILE = 10_000


def glsl_number(value: float) -> str:
    """Return a GLSL literal that reads back as exactly float32(value)."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    text = repr(float(np.float32(value)))
    return text if any(c in text for c in ".en") else text + ".0"


@functools.cache
def constants_source() -> str:
    """Return `mr360uw.constants` as GLSL."""
    return "\n".join(
        f"const {'int' if isinstance(value, int) else 'float'} {name} = {glsl_number(value)};"
        for name, value in sorted(vars(constants).items())
        if name.isupper() and isinstance(value, int | float)
    )


@dataclass(frozen=True, slots=True)
class Source:
    """One shader stage ready for the compiler, and the files that its line numbers encode."""

    text: str
    files: tuple[str, ...]

    def explain(self, log: str) -> str:
        """Return a compiler log with its encoded line numbers replaced by file:line."""

        def name(match: re.Match[str]) -> str:
            number = int(match.group(2))
            index, line = divmod(number, _LINES_PER_FILE)
            return f"{self.files[index]}:{line}" if index < len(self.files) else match.group(0)

        # Mesa: 0:30012(5): error ...    NVIDIA: 0(30012) : error ...    Apple and AMD: ERROR: 0:30012: ...
        log = re.sub(r"\b(0):(\d{5,})(?:\(\d+\))?", name, log)
        return re.sub(r"\b(0)\((\d{5,})\)", name, log)


def load_source(name: str, defines: Mapping[str, str | int | float] | None = None) -> Source:
    """Return the shader file `name` (below the package folder) with includes expanded and `defines` set."""
    path = _ROOT / name
    if not path.is_file():
        raise GlError(f"{name} - no such shader - check the name")
    return expand_source(path.read_text("utf-8"), name, defines)


def expand_source(text: str, name: str, defines: Mapping[str, str | int | float] | None = None) -> Source:
    """Return shader text with includes expanded; `name` is its path in messages and for relative includes."""
    files = ["constants.glsl"]
    out = [VERSION]
    for key, value in sorted((defines or {}).items()):  # in a fixed order, for the drivers' caches
        out.append(f"#define {key} {value if isinstance(value, str) else glsl_number(value)}")
    out += ["#line 1", constants_source()]
    seen: set[str] = {"constants.glsl"}

    def expand(text: str, name: str) -> None:
        index = len(files)
        files.append(name)
        out.append(f"#line {index * _LINES_PER_FILE + 1}")
        for number, line in enumerate(text.splitlines(), 1):
            match = _INCLUDE.match(line)
            if not match:
                out.append(line)
                continue
            wanted = match.group(1)
            candidates = [wanted, str(Path(name).parent / wanted)]
            found = next((c for c in candidates if c in seen or (_ROOT / c).is_file()), None)
            if found is None:
                raise GlError(f'{name}:{number} - cannot find include (got "{wanted}") - give a path below mr360uw/')
            if found not in seen:
                seen.add(found)
                expand((_ROOT / found).read_text("utf-8"), found)
            out.append(f"#line {index * _LINES_PER_FILE + number + 1}")

    expand(text, name)
    return Source("\n".join(out) + "\n", tuple(files))
