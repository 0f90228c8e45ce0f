# SPDX-License-Identifier: Apache-2.0
"""A card of the sand's own albedo on the sand of a dive, through 8-bit video: python benchmarks/holding.py [WATER ...].

Five waters, four depths, three suns. Each line: the card's light over that of the sand, by channel, 0.95 to 1.05 if all
is well; how far half a code of the video may move it, in per cent; and, for cases that miss, the same light where the
scene gives the sun's direction, which a clip of one second shows with an error of degrees.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.render.holding import held  # noqa: E402

WATERS, DEPTHS_M, SUNS_DEG = ("IA", "IB", "II", "1C", "3C"), (4.0, 8.0, 12.0, 16.0), (25.0, 50.0, 80.0)
TARGET = 0.05


def main() -> None:
    """Run the waters of the command line, or all."""
    found, known = [], []
    print("water  sand    sun       red   green    blue     half a code, %          with the sun given")
    for water in sys.argv[1:] or WATERS:
        for depth_m in DEPTHS_M:
            for sun_deg in SUNS_DEG:
                with TemporaryDirectory() as folder:
                    case = held(Path(folder), water, depth_m, sun_deg)
                found.append(np.abs(case.ratio - 1.0))
                known.append(found[-1])
                cells = "".join(f"{x:8.3f}" for x in case.ratio) + "  "
                cells += "".join(f"{100.0 * x:7.1f}" for x in case.rounding)
                if found[-1].max() > TARGET:
                    with TemporaryDirectory() as folder:
                        ratio = held(Path(folder), water, depth_m, sun_deg, sun_known=True).ratio
                    known[-1] = np.abs(ratio - 1.0)
                    cells += "   missed" + "".join(f"{x:8.3f}" for x in ratio)
                print(f"{water:5s} {depth_m:4.0f} m {sun_deg:4.0f} deg{cells}", flush=True)
    worst, given = (np.array(errors).max(axis=1) for errors in (found, known))
    print(
        f"{np.sum(worst <= TARGET)} of {len(worst)} within {TARGET:.0%} in each channel, "
        f"median {np.median(worst):.3f}, largest {worst.max():.3f}; "
        f"{np.sum(given <= TARGET)} if those that miss are given their sun"
    )


if __name__ == "__main__":
    main()
