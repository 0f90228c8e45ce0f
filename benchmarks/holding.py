# SPDX-License-Identifier: Apache-2.0
"""A card of the sand's own albedo on the sand of random dives, through 8-bit video.

    python benchmarks/holding.py [SEED [NUMBER]]

Dives are drawn at random by the seed: water, depths, sun, sky, wind, albedo, relief. Each line: the dive; the card's
light over that of the sand, by channel, with the sun found in the plate; the same with the sun told. Type of the water,
depths and waves are told in both. A channel holds within 5 %, or within 15 % where the sand's code is below 20.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from mr360uw.sample import DiveSettings  # noqa: E402
from tests.render.holding import DARK, Held, held  # noqa: E402

WATERS = ("IA", "IB", "II", "III", "1C", "3C", "5C")
SKIES = ("clear", "even", "overcast")
TARGET, DARK_TARGET = 0.05, 0.15


def random_dive(rng: np.random.Generator) -> DiveSettings:
    """Return a dive drawn at random: turbid coastal waters to 8 m, others to 18 m, 1.5 to 3.5 m above the sand."""
    water = str(rng.choice(WATERS))
    deepest = 8.0 if water.endswith("C") else 18.0
    depth_m, above_m = rng.uniform(2.0, deepest), rng.uniform(1.5, 3.5)
    relief = float(rng.choice([0.0, 1.0]))
    return DiveSettings(
        depth_m=round(depth_m, 2), floor_m=round(depth_m + above_m, 2), water=water, sky=str(rng.choice(SKIES)),
        sun_elevation_deg=round(rng.uniform(20.0, 80.0), 1), sun_azimuth_deg=round(rng.uniform(-180.0, 180.0), 1),
        wind_m_s=round(rng.uniform(1.0, 8.0), 2), wind_direction_deg=round(rng.uniform(-180.0, 180.0), 1),
        sand_albedo=round(rng.uniform(0.05, 0.5), 3), relief=relief, rocks=0.0, grass=0.0,
        seed=int(rng.integers(1, 2**31)),
    )  # fmt: skip


def told(dive: DiveSettings) -> str:
    """Return a dive in a few words."""
    sun = "" if dive.sky == "overcast" else f"{dive.sun_elevation_deg:.0f} deg"
    ground = "relief" if dive.relief else "flat"
    return (
        f"{dive.water:4s}{dive.depth_m:5.1f} m +{dive.floor_depth_m - dive.depth_m:.1f}  {dive.sky:8s} {sun:6s}  "
        f"{dive.wind_m_s:.1f} m/s  {dive.sand_albedo:.2f} {ground:6s}"
    )


def cells(case: Held) -> str:
    """Return the ratios of a case; dark channels in brackets."""
    text = (f"({x:.3f})" if c < DARK else f"{x:.3f} " for x, c in zip(case.ratio, case.code, strict=True))
    return "".join(f"{word:>9s}" for word in text) + ("  " if case.within(TARGET, DARK_TARGET) else " !")


def main(seed: int = 2, number: int = 60) -> None:
    """Hold a number of dives."""
    rng = np.random.default_rng(seed)
    counts = np.zeros(2, int)
    print(" " * 57 + "sun found" + " " * 22 + "sun told")
    for index in range(number):
        dive = random_dive(rng)
        with TemporaryDirectory() as folder:
            cases = [held(Path(folder), dive, sun_told=known) for known in (False, True)]
        counts += [case.within(TARGET, DARK_TARGET) for case in cases]
        print(f"{index:2d} {told(dive)}" + "".join(cells(case) for case in cases), flush=True)
    print(f"of {number} dives {counts[0]} hold with the sun found, {counts[1]} with the sun told")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:3]))
