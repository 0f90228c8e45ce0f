# SPDX-License-Identifier: Apache-2.0
"""Keys by which kept work is recognised: hashes of a scene, of the files that it names, and of the sources."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mr360uw.reading.disk_cache import sources_stamp
from mr360uw.reading.input_files import InputFile, input_file
from mr360uw.reading.numbered_files import files_named
from mr360uw.render.loaded import Loaded
from mr360uw.scene.model import Scene, files_of
from mr360uw.scene.toml_model import dotted

_FIRST_PASS = ("plate", "camera", "water", "light", "receiver", "sea", "caustics", "match")
"""Tables of a scene that the first pass depends on."""
_JOINED = ("sound",)
"""Settings of the output that act when segments are joined."""


@dataclass(frozen=True, slots=True)
class WorkKeys:
    """What kept work depends on. first_pass: of the clip's analysis. pictures: of the composited frames, encoded."""

    first_pass: str
    pictures: str


def input_fingerprints(loaded: Loaded) -> tuple[InputFile, ...]:
    """Return the fingerprints of all files that a scene reads, each once: those it names, and those that these name."""
    paths = dict.fromkeys([*_named(loaded.scene), *loaded.object_files, *loaded.other_files])
    return tuple(input_file(path) for path in paths if path.is_file())


def work_keys(loaded: Loaded, inputs: tuple[InputFile, ...], backend: str, measured: tuple[int, int]) -> WorkKeys:
    """Return the keys of a scene's work by a renderer. measured: frames [a, b) that its first pass reads."""
    scene = loaded.scene
    tables = scene.model_dump(mode="json")
    for name in _JOINED:
        del tables["output"][name]
    part = scene.model_copy(update={"objects": (), "lamps": (), "holdouts": ()})
    read = {*_named(part), *loaded.other_files}
    of_first_pass = [_mark(f) for f in inputs if f.path in read]
    keyed = [key for key in tables["keys"] if dotted(key["parameter"])[0] in _FIRST_PASS]
    first = [sources_stamp(), {name: tables[name] for name in _FIRST_PASS}, keyed, of_first_pass, measured]
    pictures = [sources_stamp(), tables, [_mark(f) for f in inputs], measured, backend]
    return WorkKeys(_hash(first), _hash(pictures))


def _named(scene: Scene) -> Iterator[Path]:
    """Yield the files that a scene names."""
    return (file for path in files_of(scene) for file in files_named(path))


def _mark(file: InputFile) -> list[Any]:
    return [str(file.path), file.size, file.digest, file.changed_ns]


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
