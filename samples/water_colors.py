# SPDX-License-Identifier: Apache-2.0
"""Draw the colour of level water by Jerlov type and depth as one PNG: python water_colors.py FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

import mr360uw as uw
from mr360uw.base.color import encode

TYPES, DEPTHS_M = ("I", "II", "III", "1C", "3C", "5C"), (1.0, 2.0, 5.0, 10.0, 20.0)


def main(folder: str) -> None:
    rows = []
    for name in TYPES:
        medium = uw.medium.Medium(uw.medium.Water.jerlov(name), uw.medium.Sensor.cie1931(), mode="table")
        rows.append([medium.radiance(depth, 0.0) for depth in DEPTHS_M])
    colour = uw.medium.compress_gamut(np.array(rows))
    colour = colour / colour.max(axis=-1, keepdims=True)  # hue and saturation; brightness falls by orders of magnitude
    patches = np.kron(encode(colour, "srgb"), np.ones((48, 80, 1)))
    target = Path(folder) / "water_colors.png"
    cv2.imwrite(str(target), np.uint8(np.round(255 * np.clip(patches[..., ::-1], 0, 1))))
    print(f"wrote {target}: rows {', '.join(TYPES)}; columns {', '.join(f'{d:g} m' for d in DEPTHS_M)}")


if __name__ == "__main__":
    main(sys.argv[1])
