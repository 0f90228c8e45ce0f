# SPDX-License-Identifier: Apache-2.0
"""How right the water is that clips tell: python benchmarks/water_from_motion.py [first] [last] [KIND]

Dives of seeds first to last (not included; default 201 to 221) in five Jerlov types: floor, walls and rocks
(`tests/depth/wet_dive.py`) through the solved light of the water, under moving caustics of half to twice their usual
strength, with drifting particles, sensor noise and codes of 8 bits, at an unknown exposure and white balance. 24 frames
of 512 columns, over ten seconds of a camera that swims 4 m.

maps: distances are the true ones, off by 1.5 % over patches of 6 degrees (default). stereo: those of
`mr360uw.depth.distances`, from 24 neighbours, sure ones alone. clip: all of it as a user has it, a video of five frames
a second and the camera's path, `depth_of_clip` and `water_of_clip`. haze: maps of dives in plain haze of any colour,
whose veil is the same all around in each second one, and brighter above in the others. traced: path-traced worlds,
whose veil varies about the sun and before reefs, and whose water blurs (`closed/traced_world.py`, half a minute each).

Intervals are those of all dives, told or not. Attenuation: of the transmittance between the distances between which
eight of ten places are seen. Veil: of the horizon in the exposure of the clip. The last rows are of clips that are
hard: of a camera that hardly moves, and of a floor alone under caustics of three times their strength.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import av
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mr360uw as uw
from benchmarks.closed.traced_world import TracedWorld
from mr360uw.depth.clip_water import seen_places
from mr360uw.medium.water import JerlovType
from mr360uw.medium.water_by_distance import WaterByDistance, water_by_distance
from mr360uw.types import Floats
from tests.depth.test_clip_depth import write_track
from tests.depth.wet_dive import HazyDive, WetDive

TYPES: tuple[JerlovType, ...] = ("IB", "II", "1C", "3C", "5C")
STRENGTHS = (1.0, 0.5, 2.0, 1.0)
SECONDS, FRAMES, RATE = 10.0, 24, 5
C_WITHIN, V_WITHIN = 0.15, 0.08


def main(first: int = 201, last: int = 221, maps: str = "maps") -> None:
    """Print a row for each dive, and how many are right."""
    errors, inside, named, said = [], [], 0, 0
    print("            attenuation over truth    veil over truth           visibility          nearest")
    for seed in range(first, last):
        strength = STRENGTHS[seed // 5 % 4]
        dive = WetDive(seed, TYPES[seed % 5], strength)
        if maps == "haze":
            dive = HazyDive(seed, strength, tilted=seed % 2 > 0)
        if maps == "traced":
            dive = TracedWorld(seed, TYPES[seed % 5])
        still = isinstance(dive, TracedWorld)
        seen = dive.seen() if still else seen_places(dive.frames(SECONDS, FRAMES, stereo=maps == "stereo"))
        found = of_clip(dive) if maps == "clip" else water_by_distance(seen)
        c, v = dive.truth(seen)
        if np.all(np.isfinite(found.attenuation)):
            inside.append((_within(found, "attenuation", c), _within(found, "veil", v)))
        if found.problem:
            said += 1
            print(f"{seed} {dive.kind:3s}   {found.problem}", flush=True)
            continue
        errors.append((found.attenuation / c - 1.0, found.veil / v - 1.0))
        named += maps != "haze" and found.water_type == dive.kind
        told = "  ".join(" ".join(f"{x:6.3f}" for x in 1.0 + e) for e in errors[-1])
        low, high = found.visibility_range_m
        print(
            f"{seed} {dive.kind:3s}  {told}  {found.visibility_m:5.1f} ({low:.1f} to {high:.1f})  {found.water_type}",
            flush=True,
        )
    off, held = np.abs(np.array(errors)), np.array(inside)
    print(f"{len(errors)} of {last - first} dives are told, {named} by their own type")
    for name, k, most in (("attenuation", 0, C_WITHIN), ("veil", 1, V_WITHIN)):
        shares = " ".join(f"{100 * x:3.0f}" for x in (off[:, k] <= most).mean(axis=0))
        held_by = " ".join(f"{100 * x:3.0f}" for x in held[:, k].mean(axis=0))
        medians = " ".join(f"{100 * x:4.1f}" for x in np.median(off[:, k], axis=0))
        print(
            f"{name}: within {100 * most:.0f} % in {shares} % of them (R G B), median {medians} %, "
            f"interval holds {held_by} %"
        )
    if maps in ("maps", "stereo"):
        hard(first)


def of_clip(dive: WetDive) -> WaterByDistance:
    """Return the water of a dive by way of a video, its track and its maps, all of them files."""
    times = np.arange(0.0, SECONDS, 1.0 / RATE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with av.open(str(folder / "dive.mp4"), "w") as file:
            stream = file.add_stream("libx264", rate=RATE, options={"crf": "12"})
            stream.width, stream.height, stream.pix_fmt = dive.width, dive.width // 2, "yuv420p"
            for t in times:
                picture = av.VideoFrame.from_ndarray(dive.codes(t)[0].astype(np.uint8), format="rgb24")
                file.mux(stream.encode(picture))
            file.mux(stream.encode())
        write_track(folder / "track.csv", [dive.scene.pose(t) for t in times], RATE)
        clip, maps, track = folder / "dive.mp4", folder / "depth", folder / "track.csv"
        print(uw.depth_of_clip(clip, maps, track=track, width=dive.width))
        return uw.depth.water_of_clip(clip, maps, track)


def hard(seed: int) -> None:
    """Print what is said of clips that are hard."""
    still = WetDive(seed, "1C", 1.0, speed_m_s=0.02)
    print("hardly moves:", water_by_distance(seen_places(still.frames(SECONDS, FRAMES))).problem or "TOLD")
    floor = WetDive(seed, "1C", 3.0)
    flat = np.array([[0.0, 1.0, 0.0, 1.6, 1e9]])
    object.__setattr__(floor.scene, "planes", flat)
    object.__setattr__(floor.scene, "balls", np.zeros((0, 4)))
    seen = seen_places(floor.frames(SECONDS, FRAMES))
    found = water_by_distance(seen)
    ratio = " ".join(f"{x:.2f}" for x in found.attenuation / floor.truth(seen)[0])
    print("floor alone:", found.problem or f"told, attenuation over truth {ratio}")


def _within(found: WaterByDistance, name: str, truth: Floats) -> Floats:
    return np.asarray((truth >= getattr(found, f"{name}_low")) & (truth <= getattr(found, f"{name}_high")))


if __name__ == "__main__":
    main(*(int(one) if one.isdigit() else one for one in sys.argv[1:]))  # type: ignore[arg-type]
