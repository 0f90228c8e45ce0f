# SPDX-License-Identifier: Apache-2.0
"""Functions and modules that a steady frame calls, and its calls of OpenGL: python benchmarks/cost/calls.py [--width W]

For the four scenes of `pipeline.py rate`: functions of the package that are called at least once in a frame after the
first ones, the modules that they are in, all their calls, and the frame's draws and reads. Comprehensions, generators
and lambdas belong to the function that they stand in: newer Pythons call no function for most of them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import mr360uw
from benchmarks.pipeline import measured_scenes
from mr360uw.base.cache import Cache
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import load
from mr360uw.render.plate_light import LightSamples
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate

_FIRST = 3
"""Frames before the one that is counted."""
_PACKAGE = str(Path(mr360uw.__file__).parent)


def count_calls(scene: Scene) -> tuple[Counter[CodeType], Counter[str]]:
    """Return how often a steady frame calls each function of the package, and moderngl's draws and reads."""
    backend, kept = make_backend("gl")[0], Cache()
    functions, of_gl = Counter[CodeType](), Counter[str]()

    def note(frame: FrameType, event: str, what: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(_PACKAGE) and not code.co_name.startswith("<"):
            functions[code] += 1
        elif event == "c_call" and what.__name__ in ("render", "read_into"):
            of_gl[what.__name__] += 1

    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height)
        analysis = clip_analysis(loaded, video)
        for plate, light in LightSamples(loaded, analysis, video, video.frames).frames(0, _FIRST + 1):
            if plate.index == _FIRST:
                threading.setprofile(note)
                sys.setprofile(note)
            composite_frame(loaded, analysis, backend, plate, 0.0, cache=kept, light=light)
            sys.setprofile(None)
            threading.setprofile(None)
    return functions, of_gl


def main() -> None:
    """Print a row for each scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=1024, help="columns of the plate (1024)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(f"{'scene':24s} {'functions':>9s} {'modules':>8s} {'calls':>7s} {'draws':>6s} {'reads':>6s}")
        for name, scene in measured_scenes(Path(folder), None, given.width, 2 * _FIRST + 4).items():
            functions, of_gl = count_calls(scene)
            modules = len({code.co_filename for code in functions})
            row = f"{name:24s} {len(functions):9d} {modules:8d} {functions.total():7d}"
            print(f"{row} {of_gl['render']:6d} {of_gl['read_into']:6d}", flush=True)


if __name__ == "__main__":
    main()
