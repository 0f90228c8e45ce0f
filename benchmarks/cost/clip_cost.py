# SPDX-License-Identifier: Apache-2.0
"""Processor time and memory of compositing whole clips, each in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.cost.growing_scenes import Dives, one_ball

_TRIANGLES = 1000
_CHILD = """
import sys
from pathlib import Path

sys.path.insert(0, {root!r})
import mr360uw as uw
from benchmarks.cost.growing_scenes import Dives, one_ball
from benchmarks.cost.process_cost import peak_kib, processor_s
dives = Dives(Path({folder!r}))
scene = dives.scene({width}, one_ball(dives.folder, {triangles}), {count})
uw.composite_video(scene, dives.folder / "warm.mp4", frames=(0, 4), overwrite=True)
began = processor_s()
report = uw.composite_video(scene, dives.folder / "clip.mp4", overwrite=True, fresh=True)
print((processor_s() - began) / report.frames, peak_kib())
"""


def clip_costs(dives: Dives, counts: Sequence[int], width: int) -> dict[int, tuple[float, float]]:
    """Return processor time [ms] a frame, first pass and encoding included, and peak memory [MiB] by number of frames.

    counts: lengths of clips. width: their columns.
    """
    found = {}
    for count in counts:
        dives.scene(width, one_ball(dives.folder, _TRIANGLES), count)
        code = _CHILD.format(
            root=str(Path(__file__).resolve().parents[2]), folder=str(dives.folder), width=width,
            triangles=_TRIANGLES, count=count,
        )  # fmt: skip
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        seconds, kilobytes = map(float, done.stdout.split())
        found[count] = 1e3 * seconds, kilobytes / 1024.0
    return found
