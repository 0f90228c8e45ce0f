# SPDX-License-Identifier: Apache-2.0
"""Holds a run in another process where a test wants it, so that no test depends on which of the two is faster."""

from __future__ import annotations

import os
import time
from pathlib import Path

FIRST_PASS = "mr360uw.composite.grading.softness"
"""Module that a run imports when it begins its first pass: its work folder is there, with nothing finished in it."""
FIRST_FRAME = "mr360uw.composite.reference"
"""Module that a run of the reference imports when it begins its first frame."""
HANG_S = 120.0
"""Seconds after which a test gives up: only a hang takes as long."""
_SITE = """
import pathlib, sys, threading, time

class Gate:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r} and threading.current_thread() is threading.main_thread():
            pathlib.Path({reached!r}).touch()
            while True:
                time.sleep(0.01)

sys.meta_path.insert(0, Gate())
"""


class Gate:
    """Processes with its environment stop for good at the import of a module, until a signal ends them."""

    def __init__(self, folder: Path, module: str) -> None:
        self._reached = folder / "reached"
        folder.mkdir()
        (folder / "sitecustomize.py").write_text(_SITE.format(module=module, reached=str(self._reached)), "utf-8")
        self.path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
        """What PYTHONPATH is for them."""

    def wait(self) -> None:
        """Return when a process is held."""
        end = time.monotonic() + HANG_S
        while not self._reached.exists():
            assert time.monotonic() < end, "no process came to the gate"
            time.sleep(0.01)
