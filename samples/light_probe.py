# SPDX-License-Identifier: Apache-2.0
"""Print the light of one frame of a 360 plate: python light_probe.py dive.mp4 [FRAME]."""

from __future__ import annotations

import sys

import numpy as np

import mr360uw as uw


def main(path: str, index: int = 0) -> None:
    with uw.open_video(path) as video:
        frame = next(iter(video.frames(index, index + 1)))
    light = uw.ibl.environment(frame.image_linear, underwater=True)
    print(f"frame {frame.index} at {frame.time_s:.2f} s, mean radiance {np.round(light.radiance.mean((0, 1)), 3)}")
    print(f"irradiance from above {np.round(light.irradiance[0].mean(0), 3)}")
    if light.sun is None:
        print("no sun inside Snell's window")
        return
    in_air = uw.caustics.refract_to_air(light.sun.direction)
    elevation = np.degrees(np.arcsin([light.sun.direction[1], in_air[1]]))
    print(f"sun at {elevation[0]:.1f} deg in the water, {elevation[1]:.1f} deg above it")
    print(f"confidence {light.sun.confidence:.2f}")


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:3]))
