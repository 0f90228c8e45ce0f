# SPDX-License-Identifier: Apache-2.0
"""Write one tileable, looping caustic texture as PNGs: python caustic_loop.py FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

import mr360uw as uw

LOOP_S, FRAMES, DEPTH_M = 4.0, 16, 3.0


def main(folder: str) -> None:
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    sea = uw.caustics.GerstnerSea(wind_speed=3.0, tile_m=6.0, seed=3, loop_s=LOOP_S)
    sun = uw.caustics.refract_to_air([0.3, 0.95, -0.1])
    for k in range(FRAMES):
        ratio = uw.caustics.caustic_map(sea, sun, DEPTH_M, LOOP_S * k / FRAMES, size=256, grid=128)
        # a mean of 1 lies at a quarter of the range, so that the brightest lines keep their shape
        cv2.imwrite(str(target / f"caustic_{k:03d}.png"), np.uint8(np.clip(64.0 * ratio, 0, 255)))
    print(f"wrote {FRAMES} maps into {target}; the last one leads to the first, every edge to the one across")


if __name__ == "__main__":
    main(sys.argv[1])
