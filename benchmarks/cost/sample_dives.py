# SPDX-License-Identifier: Apache-2.0
"""Synthetic dives: python benchmarks/cost/sample_dives.py cost, or sheet FILE for the picture in docs/sample.md.

cost: processor time of set-up and of a frame, 1024 x 512, of every preset; each frame after the first of its dive.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from mr360uw.color import encode  # noqa: E402
from mr360uw.sample import Dive, DiveSettings  # noqa: E402
from mr360uw.sample.dive_settings import PRESETS  # noqa: E402
from mr360uw.sample.recording import with_noise  # noqa: E402

_COLUMNS, _GAP = 2, 6


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


def sheet(file: str) -> None:
    """Write a frame of every preset and of the default dive."""
    import cv2

    tiles = []
    for name in (*PRESETS, None):
        settings = DiveSettings.of(name)
        dive = Dive(settings, 640, 320, samples=2)
        light = with_noise(dive.radiance(1.0), settings.noise, settings.seed, 0)
        tile = np.round(255.0 * encode(np.clip(light, 0.0, 1.0), settings.transfer)).astype(np.uint8)[..., ::-1].copy()
        cv2.putText(
            tile, name or "no preset", (12, 306), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA
        )
        tiles.append(np.pad(tile, ((0, _GAP), (0, _GAP), (0, 0)), constant_values=255))
    rows = [np.hstack(tiles[k : k + _COLUMNS]) for k in range(0, len(tiles), _COLUMNS)]
    cv2.imwrite(file, np.vstack(rows)[:-_GAP, :-_GAP], [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    cost() if sys.argv[1:2] != ["sheet"] else sheet(sys.argv[2])
