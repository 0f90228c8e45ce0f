# SPDX-License-Identifier: Apache-2.0
"""Frames of a clip by `Compositor` from a script, against the command line: the same bits, and what it costs.

    python benchmarks/library.py [--width W] [--frames N] [--runs N]

A sample dive is composited to EXR pictures, once by `mr360uw composite` and once by a script of ten lines, each in a
process of its own that measures its first pass anew, in turns. Ratios are of the script over the command line.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import mr360uw as uw  # noqa: E402
from benchmarks.cost.process_cost import processor_s  # noqa: E402

SCRIPT = """
import sys
import numpy as np
import mr360uw as uw

with uw.Compositor(uw.load_scene(sys.argv[1])) as compositor:
    for index, result in enumerate(compositor.frames()):
        uw.video.write_exr(sys.argv[2] % index, result.image_linear.astype(np.float16))
"""


def cost(words: list[str]) -> tuple[float, float]:
    """Return the wall and the processor time [s] of a command."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    began, used = time.perf_counter(), processor_s()
    subprocess.run([sys.executable, *words], check=True, env=environment, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began, processor_s() - used


def differing(folder: Path, frames: int) -> int:
    """Return how many frames of the script differ from those of the command line in a bit."""
    different = 0
    for index in range(frames):
        line, script = (uw.video.read_exr(folder / f"{name}_{index:04d}.exr") for name in ("line", "script"))
        pixels = zip(*(next(iter(next(iter(parts.values())).values())) for parts in (line, script)), strict=True)
        different += not all(np.array_equal(a, b) for a, b in pixels)
    return different


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Frames by Compositor against the command line")
    parser.add_argument("--width", type=int, default=1024)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--runs", type=int, default=3)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dive = uw.sample_dive(folder / "dive", width=asked.width, frames=asked.frames)
        line = ["-m", "mr360uw", "composite", str(dive.scene), str(folder / "line_%04d.exr"), "--overwrite", "--fresh"]
        script = ["-c", SCRIPT, str(dive.scene), str(folder / "script_%04d.exr")]
        cost(line)  # kernels and the water's tables are cached from here on
        costs = [(cost(line), cost(script)) for _ in range(asked.runs)]
        print(f"{asked.frames} frames of {asked.width} x {asked.width // 2}, {differing(folder, asked.frames)} differ")
    for what, number in (("wall time", 0), ("CPU", 1)):
        ratios = [by_script[number] / by_line[number] for by_line, by_script in costs]
        seconds = [statistics.median(run[who][number] for run in costs) for who in (0, 1)]
        print(
            f"  {what:<10} command line {seconds[0]:6.2f} s, Compositor {seconds[1]:6.2f} s, ratio "
            f"{statistics.median(ratios):.3f} (runs: {', '.join(f'{r:.3f}' for r in ratios)})"
        )


if __name__ == "__main__":
    main()
