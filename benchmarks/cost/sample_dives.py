# SPDX-License-Identifier: Apache-2.0
"""Processor time of synthetic dives: python benchmarks/cost/sample_dives.py.

Of set-up and of a frame, 1024 x 512, of every preset; each frame after the first of its dive.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from mr360uw.sample import Dive, DiveSettings  # noqa: E402
from mr360uw.sample.dive_settings import PRESETS  # noqa: E402


def cost() -> None:
    """Print processor time."""
    print("preset    set-up   frame")
    Dive(DiveSettings(), 64, 32).radiance(0.0)
    for name in PRESETS:
        start = time.process_time()
        dive = Dive(DiveSettings.of(name), 1024, 512)
        made = time.process_time()
        dive.radiance(0.0)
        first = time.process_time()
        for k in (1, 2, 3):
            dive.radiance(k / 24.0)
        print(f"{name:8s} {made - start:5.1f} s {(time.process_time() - first) / 3.0:5.2f} s", flush=True)


if __name__ == "__main__":
    cost()
