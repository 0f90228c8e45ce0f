# SPDX-License-Identifier: Apache-2.0
"""Starts every benchmark program at its smallest size, so that none is found broken when it is needed.

    python benchmarks/smallest.py [PROGRAM ...]

Each program runs in a process of its own and must leave with 0; a line says its processor time. Programs that cannot be
that small are loaded, with all that they import, and the line says why. Those that need a package which is not
installed are left out by name. Leaves with the number of programs that failed; a program that is not listed here fails.
"""

from __future__ import annotations

import importlib.util
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
_LIMIT_S = 300
"""Time [s] that a start may take on a machine that is busy with other work."""
_LOAD = "import runpy, sys; sys.path.insert(0, {folder!r}); runpy.run_path({path!r}, run_name='loaded')"


@dataclass(frozen=True, slots=True)
class Start:
    """How a program is started. arguments: FOLDER stands for an empty folder. only_loaded: why it does not run.

    needs: packages that it cannot do without.
    """

    arguments: str = ""
    only_loaded: str = ""
    needs: tuple[str, ...] = ()


STARTS = {
    "aerial": Start(only_loaded="draws a frame of 640 x 360 of every kind"),
    "both_eyes": Start(only_loaded="is run by camera.py stereo"),
    "camera": Start(only_loaded="tracks clips of 48 frames, a minute each", needs=("pycolmap",)),
    "caustics": Start("lookup"),
    "closed_loop": Start(only_loaded="gathers light ray by ray, minutes a dive"),
    "composite": Start("edges 64"),
    "depth": Start("501 502 64 4 1"),
    "dive_truth": Start(only_loaded="path-traces dives, or compares with those that it traced"),
    "eye_depth": Start("111 112 128"),
    "first_look": Start(only_loaded="needs footage and meshes"),
    "first_minute": Start(only_loaded="clones and installs the project"),
    "graded": Start(only_loaded="leaves with 1 where a goal is missed, as small pictures do"),
    "grain": Start("--width 128 --runs 1"),
    "grounded": Start(only_loaded="solves light on bodies, twenty seconds for the shortest section"),
    "growth": Start("bands --quick --rounds 2"),
    "holding": Start("2 1"),
    "library": Start("--width 64 --frames 1 --runs 1"),
    "light": Start(only_loaded="needs maps of real places"),
    "live": Start(only_loaded="makes a clip and starts the program several times"),
    "match": Start(only_loaded="fits clips of dives, minutes each"),
    "medium": Start("cost"),
    "mutations": Start(only_loaded="runs the tests once for every fault"),
    "pipeline": Start("rate --runs 1 --width 64 --frames 4"),
    "plates": Start(only_loaded="needs footage and meshes"),
    "random_scenes": Start(only_loaded="makes the scenes of stress.py"),
    "shafts": Start(only_loaded="every section marches rays for a minute"),
    "slabs": Start("table"),
    "smallest": Start(only_loaded="is this program"),
    "stress": Start("--first-seed 5000 --count 1"),
    "suns": Start("discs 64"),
    "surface": Start("flat"),
    "survive": Start("scenes --scenes 1 --backend reference"),
    "textured_dives": Start(only_loaded="path-traces dives, with meshes that are named"),
    "tracks": Start(only_loaded="tracks clips of 48 frames, half a minute each"),
    "tune": Start(only_loaded="drives a browser", needs=("playwright", "nicegui")),
    "water_from_motion": Start(only_loaded="reads 24 frames of a clip for every dive"),
}


def started(name: str, start: Start) -> str:
    """Start a program; print how it went, and return what went wrong, or ""."""
    missing = [one for one in start.needs if importlib.util.find_spec(one) is None]
    if missing:
        print(f"{name:18} left out: needs {', '.join(missing)}")
        return ""
    path = FOLDER / f"{name}.py"
    with tempfile.TemporaryDirectory() as folder:
        words = [word.replace("FOLDER", folder) for word in start.arguments.split()]
        code = ["-c", _LOAD.format(folder=str(FOLDER), path=str(path))] if start.only_loaded else [str(path), *words]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        paths = os.pathsep.join([str(FOLDER.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
        try:
            done = subprocess.run(
                [sys.executable, *code], capture_output=True, text=True, cwd=folder, timeout=_LIMIT_S,
                env=os.environ | {"PYTHONPATH": paths}, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"{name} - took more than {_LIMIT_S} s"
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    how = f"loaded ({start.only_loaded})" if start.only_loaded else " ".join(["ran", start.arguments])
    print(f"{name:18} {spent_s:6.1f} CPU-s  {how if done.returncode == 0 else 'FAILED'}", flush=True)
    return "" if done.returncode == 0 else f"{name} - left with {done.returncode}\n{done.stderr[-2000:]}"


def main(names: list[str]) -> int:
    """Start the programs that are named, or all; return the number of those that failed."""
    found = {path.stem for path in FOLDER.glob("*.py")}
    wrong = [f"{name} - has no start in smallest.py" for name in sorted(found - STARTS.keys())]
    wrong += [f"{name} - is no program" for name in sorted({*STARTS, *names} - found)]
    chosen = [name for name in names or STARTS if name in found & STARTS.keys()]
    wrong += [fault for name in chosen if (fault := started(name, STARTS[name]))]
    for line in wrong:
        print(line)
    return len(wrong)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
