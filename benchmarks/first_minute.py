# SPDX-License-Identifier: Apache-2.0
"""The first minute on two cores, split into installing, compiling and work, from a clean clone with empty caches.

    python benchmarks/first_minute.py               # clone, install, make demo, twice
    python benchmarks/first_minute.py wheel FILE    # a wheel in a new environment: which kernels a composite compiles
    python benchmarks/first_minute.py still         # start and first frame of a still with kept kernels and tables
    python benchmarks/first_minute.py kernels       # write mr360uw/jit/kernels.txt, from the demo and a sample dive

The clone has what is committed. Time is wall and CPU, of the two cores this program keeps to; the load of the machine
stands beside it.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCENE = "samples/demo/scene.toml"
COMPILE = "from mr360uw.cli.rendering import compile_first; compile_first()"


def measured(name: str, command: Sequence[object], folder: Path, environment: Mapping[str, str]) -> None:
    """Run a command; print its wall and CPU time, and the load of the machine before it."""
    load, before, start = os.getloadavg()[0], resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [*map(str, command)], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{name}: {done.stdout}{done.stderr}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{name:34s} {wall:7.1f} s wall {cpu:7.1f} s CPU   load {load:.1f}", flush=True)


def alone(folder: Path) -> dict[str, str]:
    """Return an environment whose caches are empty, but for that of downloads."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("MR360UW", "NUMBA", "PYTHON"))}
    downloads = os.environ.get("PIP_CACHE_DIR", str(Path("~/.cache/pip").expanduser()))
    return {**kept, "HOME": str(folder), "XDG_CACHE_HOME": str(folder / "cache"), "PIP_CACHE_DIR": downloads}


def kernels(folder: Path) -> int:
    """Return how many kernels the environment of `alone` holds."""
    return len([path for path in (folder / "cache").rglob("*.nbc") if not path.name.startswith("complete-")])


def demo(folder: Path) -> None:
    """Print the times of `make demo` from a clean clone."""
    clone, environment = folder / "clone", alone(folder)
    measured("clone", ["git", "clone", "--quiet", ROOT, clone], folder, environment)
    measured("install", ["make", ".venv/.installed"], clone, environment)
    measured("compiling", [".venv/bin/python", "-c", COMPILE], clone, environment)
    ahead = kernels(folder)
    measured("work: make demo", ["make", "demo"], clone, environment)
    print(f"{ahead} kernels compiled ahead, {kernels(folder) - ahead} during the work")
    measured("second run: make demo", ["make", "demo"], clone, environment)
    measured("second run: composite alone", [".venv/bin/mr360uw", "composite", SCENE, "again.mp4"], clone, environment)


def wheel(folder: Path, file: Path) -> None:
    """Print how many kernels a composite compiles with an installed wheel."""
    environment, scene = alone(folder), shutil.copytree(ROOT / "samples" / "demo", folder / "demo") / "scene.toml"
    measured("environment", [sys.executable, "-m", "venv", "new"], folder, environment)
    measured("install", ["new/bin/python", "-m", "pip", "install", "--quiet", file.resolve()], folder, environment)
    measured("composite", ["new/bin/mr360uw", "composite", scene, "out.mp4", "--frames", "0:4"], folder, environment)
    print(f"{kernels(folder)} kernels compiled")


def still(folder: Path) -> None:
    """Print what `import`, `--help` and a still of the demo's scene cost, the second time."""
    environment = {**alone(folder), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "mr360uw", "still", ROOT / SCENE, "still.png", "--overwrite"]
    measured("still, everything cold", command, folder, environment)
    for _ in range(3):
        measured("still, again", command, folder, environment)
        measured("import mr360uw", [sys.executable, "-c", "import mr360uw"], folder, environment)
        measured("mr360uw --help", [sys.executable, "-m", "mr360uw", "--help"], folder, environment)


def list_kernels(folder: Path) -> None:
    """Write the list of the kernels that composites of the demo and a sample dive call, the largest modules first."""
    from mr360uw import composite_video, load_scene
    from mr360uw.jit.ahead import LIST, entry, size
    from mr360uw.preview.pages import save_still

    os.environ["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    measured("sample", [sys.executable, "-m", "mr360uw", "sample", "dive", "--frames", "3"], folder, environment)
    scenes = [ROOT / SCENE, folder / "dive" / "scene.toml"]
    for scene in scenes:  # those that others call are compiled here and not seen below
        command = [sys.executable, "-m", "mr360uw", "composite", scene, folder / "out.mp4", "--overwrite"]
        measured(f"compiling for {scene.parent.name}", command, folder, environment)
    for number, scene in enumerate(scenes):
        composite_video(load_scene(scene), folder / f"{number}.mp4", frames=(0, 3))
        save_still(folder / f"{number}.png", load_scene(scene))
    compiled = {
        entry(value, arguments): size(value, arguments)
        for name, module in list(sys.modules.items())
        if name.startswith("mr360uw.")
        for value in vars(module).values()
        if hasattr(value, "overloads") and value.__module__ == name
        for arguments in value.overloads
    }
    whole = Counter[str]()  # of each module
    for line, length in compiled.items():
        whole[line.split()[0]] += length
    lines = sorted(compiled, key=lambda line: (-whole[line.split()[0]], line.split()[0], -compiled[line], line))
    LIST.write_text("".join(f"{line}\n" for line in lines), "utf-8")
    print(f"wrote {len(lines)} kernels")


def main() -> None:
    """Run the part that the arguments name."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    with tempfile.TemporaryDirectory() as name:
        match sys.argv[1:]:
            case []:
                demo(Path(name))
            case ["wheel", file]:
                wheel(Path(name), Path(file))
            case ["still"]:
                still(Path(name))
            case ["kernels"]:
                list_kernels(Path(name))
            case _:
                sys.exit(__doc__)


if __name__ == "__main__":
    main()
