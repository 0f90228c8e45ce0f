# SPDX-License-Identifier: Apache-2.0
"""A scene file: reading its text, the scene of a text, writing it whole, noticing that it has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mr360uw.files import write_whole
from mr360uw.reading.kept_reads import stamp
from mr360uw.scene.file_lines import key_lines
from mr360uw.scene.model import Scene, scene_from_dict
from mr360uw.scene.toml_model import scene_text, tables_of


class SceneFile:
    """A scene file at a path."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stamp = stamp(self.path)

    def read(self) -> str:
        """Return the text; raise `SceneError` where there is none."""
        return scene_text(self.path)

    def tree_of(self, text: str) -> dict[str, Any]:
        """Return the tables of a text; raise `SceneError` where it is not TOML."""
        return tables_of(text, str(self.path))

    def scene_of(self, text: str) -> Scene:
        """Return the scene of a text, whose paths start at the file's folder; raise `SceneError`."""
        folder = self.path.resolve().parent
        return scene_from_dict(self.tree_of(text), folder, where=str(self.path), lines=key_lines(text))

    def write(self, text: str) -> None:
        """Write the text, whole or not at all; raise `OSError`."""
        write_whole(self.path.resolve(), text)
        self._stamp = stamp(self.path)

    def changed(self) -> bool:
        """Whether the file was touched since the last look, or since it was written here."""
        before, self._stamp = self._stamp, stamp(self.path)
        return before != self._stamp

    def exists(self) -> bool:
        """Whether there is a file at the last look."""
        return self._stamp is not None
