# SPDX-License-Identifier: Apache-2.0
"""How well the sea and the water of a plate are found: python benchmarks/match.py [section] [first] [last] [folder]

Sections: caustics, water; default: both. Synthetic dives of seeds first to last (not included; default 10 to 20;
thresholds were chosen on 0 to 10). folder: keeps the dives. Every dive has its own depths, sun, water, sand, motion,
wind, dominant wave and direction; the scene that is fitted knows the depths, the tile and the water, not the sea.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import cast

import numpy as np

from mr360uw.caustics import GerstnerSea
from mr360uw.match import WaterPatch, match_caustics, match_water
from mr360uw.medium import JERLOV_TYPES, Water
from mr360uw.medium.closed_form import visibility_m
from mr360uw.medium.water import JerlovType
from mr360uw.sample import sample_dive
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.scene import Scene, load_scene

WIDTH, FRAMES = 512, 48
CLOSE, TURN_DEG = 0.15, 20.0
WATERS: tuple[JerlovType, ...] = ("I", "IA", "IB", "II", "1C")
ORDER = [str(name) for name in sorted(JERLOV_TYPES, key=lambda name: -visibility_m(Water.jerlov(name)))]


class MatchedDive(DiveSettings):
    """A dive whose dominant wave and direction can be chosen too."""

    direction_deg: float = 35.0
    dominant_m: float = 4.0

    @property
    def sea(self) -> GerstnerSea:
        """The surface of the dive."""
        known = DiveSettings(seed=self.seed).sea
        return known.model_copy(
            update={
                "wind_speed": self.wind_m_s,
                "wind_direction_deg": self.direction_deg,
                "dominant_wavelength_m": self.dominant_m,
            }
        )


def dive_of(seed: int) -> MatchedDive:
    """Return the dive of a seed."""
    r = np.random.default_rng([seed, 77])
    camera, height = r.uniform(2.5, 6.0), r.uniform(2.0, 4.5)
    return MatchedDive(
        depth_m=camera,
        floor_m=camera + height,
        water=cast("JerlovType", str(r.choice(WATERS))),
        sun_azimuth_deg=r.uniform(0.0, 360.0),
        sun_elevation_deg=r.uniform(40.0, 80.0),
        wind_m_s=float(np.exp(r.uniform(np.log(1.5), np.log(6.0)))),
        speed_m_s=float(r.choice([0.0, 0.0, 0.4])),
        seed=seed + 500,
        sand_contrast=float(r.uniform(0.3, 2.0)),
        direction_deg=float(r.uniform(0.0, 360.0)),
        dominant_m=float(np.exp(r.uniform(np.log(1.6), np.log(7.0)))),
    )


def made(folder: Path, seed: int) -> tuple[MatchedDive, Scene]:
    """Return a dive and its scene, made unless it is there."""
    dive, place = dive_of(seed), folder / f"{seed:02d}"
    if not (place / "truth.json").exists():
        sample_dive(place, dive, width=WIDTH, frames=FRAMES, overwrite=True)
    assert json.loads((place / "truth.json").read_text())["camera_depth_m"] == dive.depth_m
    return dive, load_scene(place / "scene.toml")


def caustics(folder: Path, seeds: range) -> None:
    """Print the errors of wind, dominant wave and direction."""
    print("seed  water  floor    wind  found +-   wave  found +-   turn  conf.  distance before, after    CPU")
    errors = []
    for seed in seeds:
        dive, scene = made(folder, seed)
        sea = GerstnerSea(wind_speed=4.0, wind_direction_deg=0.0, tile_m=16.0, detail_slope=dive.sea.detail_slope)
        start = time.process_time()
        match = match_caustics(scene.model_copy(update={"sea": sea}))
        took = time.process_time() - start
        wind = match.changes.get("sea.wind_speed", np.nan)
        wave = match.changes.get("sea.dominant_wavelength_m", np.nan)
        turn = (match.changes.get("sea.wind_direction_deg", np.nan) - dive.direction_deg + 180.0) % 360.0 - 180.0
        sigma = [match.uncertainty.get(f"sea.{key}", np.nan) for key in ("wind_speed", "dominant_wavelength_m")]
        errors.append((np.log(wind / dive.wind_m_s), np.log(wave / dive.dominant_m), turn))
        print(
            f"{seed:4d}  {dive.water:>5s}  {dive.floor_depth_m:4.1f} m"
            f"  {dive.wind_m_s:5.2f}  {wind:5.2f} {sigma[0]:.2f}"
            f"  {dive.dominant_m:5.2f}  {wave:5.2f} {sigma[1]:.2f}  {turn:5.0f}  {match.confidence:5.2f}"
            f"  {match.distance_before:15.2f}  {match.distance_after:5.2f}  {took:4.0f} s",
            flush=True,
        )
    e = np.abs(np.array(errors))
    for name, column, limit in (("wind", 0, CLOSE), ("dominant wave", 1, CLOSE), ("direction", 2, TURN_DEG)):
        within = int(np.sum(e[:, column] <= (limit if column == 2 else np.log1p(limit))))
        print(f"{name}: median error {np.nanmedian(e[:, column]):.2g}, within {limit:g}: {within} of {len(e)}")


def water(folder: Path, seeds: range) -> None:
    """Print the types found in a patch of open water at a random azimuth."""
    print("seed  true  found  steps  confidence   plate          rms before, after [code values]")
    steps = []
    for seed in seeds:
        dive, scene = made(folder, seed)
        wrong = scene.water.model_copy(update={"type": "3C"})
        yaw = float(np.random.default_rng(seed).uniform(-180.0, 180.0))
        match = match_water(scene.model_copy(update={"water": wrong}), WaterPatch(yaw, 6.0, 14.0))
        found = match.candidates[0][0]
        steps.append(abs(ORDER.index(found) - ORDER.index(dive.water)))
        print(
            f"{seed:4d}  {dive.water:>4s}  {found:>5s}  {steps[-1]:5d}  {match.confidence:10.2f}"
            f"   {[round(c) for c in match.plate_code]!s:14s} {match.rms_before:5.1f} {match.rms_after:5.1f}",
            flush=True,
        )
    print(f"right: {steps.count(0)}, within one step: {sum(s <= 1 for s in steps)} of {len(steps)}")


def main() -> None:
    """Run the sections asked for."""
    words = [w for w in sys.argv[1:] if w in ("caustics", "water")] or ["caustics", "water"]
    rest = [w for w in sys.argv[1:] if w not in ("caustics", "water")]
    seeds = range(*(int(w) for w in rest[:2])) if len(rest) >= 2 else range(10, 20)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(rest[2]) if len(rest) > 2 else Path(temporary)
        for word in words:
            {"caustics": caustics, "water": water}[word](folder, seeds)


if __name__ == "__main__":
    main()
