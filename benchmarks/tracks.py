# SPDX-License-Identifier: Apache-2.0
"""Whether the verdict on a track holds:
python benchmarks/tracks.py [--quick] [--seeds A:B:STEP] [--clips FOLDER] [--texture FACTOR]

Clips of known paths by seed: a floor of noise in haze, walls and boulders or none, under caustics of four strengths
(times their deviation from the mean), which evolve with the sea or drift as a rigid pattern. What the prediction does
was chosen on seeds 0 to 39, the share that has to agree on those below 100, what is light on even ones up to 62; the
default are 41 to 79. Of each clip: the true slip, the predicted one, and their ratio. --texture 0.5: half the texture,
over which paths follow a rigid pattern.

The true slip is that of a point on the floor 5 m away, within 45 degrees of ahead, placed by the found path at one
frame and looked at from another: the distance [cm] between it and the true point in the camera's axes there, rms over
all pairs of frames and seven points. Scale is by the true height of the camera. --quick: four clips.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mr360uw as uw
from mr360uw.caustics import caustic_map
from mr360uw.errors import ParameterError
from mr360uw.sample.dive import record
from mr360uw.track.tracking import verdict
from mr360uw.types import Floats
from tests.depth.hazy_scene import HazyScene

WIDTH, FRAMES, RATE = 768, 48, Fraction(24)
STRENGTHS = (0.5, 1.0, 1.7, 2.5)
DISTANCE_M = 5.0
_TILE_M, _MAP = 8.0, 256


@dataclass(frozen=True)
class Clip(HazyScene):
    """A scene with a swimming camera under caustics that evolve, or drift with `drift_m_s` (2,) over x and z."""

    rigid: bool = False
    walls: bool = True
    texture: float = 1.0

    @classmethod
    def of(cls, seed: int, texture: float = 1.0) -> Clip:
        """Return the clip of a seed: of even and of odd ones, sixteen in turn have all kinds of light and scene."""
        kind, r = seed // 2, np.random.default_rng([seed, 77])
        murk = r.uniform(1.0, 2.5)
        return cls(
            seed, caustics=STRENGTHS[kind % 4], rigid=bool(kind // 4 % 2), walls=bool(kind // 8 % 2), particles=60,
            haze=murk * np.array([0.25, 0.10, 0.08]), speed_m_s=r.uniform(0.4, 1.1), texture=texture,
        )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        r = np.random.default_rng([self.seed, 78])
        way = r.uniform(0.0, 2.0 * np.pi)
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        put("drift_m_s", r.uniform(0.15, 0.6) * np.array([np.cos(way), np.sin(way)]))
        put("sway", np.column_stack([r.uniform(0.5, 2.5, 3), r.uniform(0.0, 6.0, 3), [0.1, 0.04, 0.03]]))
        put("look", (self.look[0], 1.8 * self.texture * self.look[1], self.look[2]))
        if not self.walls:
            put("planes", self.planes[:1])
            put("balls", self.balls[:0])

    def pose(self, time_s: float) -> tuple[Floats, Floats]:
        """Return position and rotation of the camera, which also yaws, pitches and rolls; upright at time 0."""
        place, turn = super().pose(time_s)
        rate, phase, size = self.sway.T
        angles = size * (np.sin(rate * time_s + phase) - np.sin(phase))
        return place, turn @ Rotation.from_euler("yxz", angles).as_matrix()

    def light(self, time_s: float) -> Floats:
        """Return the irradiance of the sun (n, n) over its mean on the level below the waves."""
        if not self.rigid:
            return super().light(time_s)
        ratio = caustic_map(self.sea, self.sun, self.depth_m, 0.0, size=_MAP, grid=_MAP)
        for axis, metres in zip((1, 0), self.drift_m_s * time_s, strict=True):
            whole, part = divmod(metres / _TILE_M * _MAP, 1.0)
            ratio = (1.0 - part) * np.roll(ratio, int(whole), axis) + part * np.roll(ratio, int(whole) + 1, axis)
        return np.maximum(1.0 + self.caustics * (ratio - 1.0), 0.0).astype(np.float32)


def poses(clip: Clip) -> tuple[Floats, Floats]:
    """Return the true positions and rotations of all frames."""
    found = [clip.pose(k / float(RATE)) for k in range(FRAMES)]
    return np.array([p for p, _ in found]), np.array([r for _, r in found])


def slips(found: tuple[Floats, Floats], true: tuple[Floats, Floats], height_m: float) -> Floats:
    """Return how far points on the floor slip [m], (n, n, 7): frame where they are placed, frame that looks at them."""
    (p, r), (q, s) = found, true
    ahead = np.radians(np.linspace(-45.0, 45.0, 7))
    result = np.empty((len(p), len(p), 7))
    for i in range(len(p)):
        yaw = np.arctan2(-s[i][0, 2], -s[i][2, 2]) + ahead
        level = np.sqrt(DISTANCE_M**2 - (height_m + q[i][1]) ** 2)
        away = np.stack([level * np.sin(yaw), np.full(7, -height_m - q[i][1]), -level * np.cos(yaw)], axis=1)
        placed = p[i] + (away @ s[i]) @ r[i].T
        there = np.einsum("jab,jna->jnb", r, placed[None] - p[:, None])
        truly = np.einsum("jab,jna->jnb", s, (q[i] + away)[None] - q[:, None])
        result[i] = np.linalg.norm(there - truly, axis=-1)
    return result


def clip_file(clip: Clip, folder: Path) -> Path:
    """Return a clip, made unless it is there."""
    path = folder / f"{clip.seed}_{clip.texture:g}.mp4"
    if not path.exists():
        record(path, (clip.see(WIDTH, k / float(RATE))[0] for k in range(FRAMES)), RATE, seed=clip.seed)
    return path


def measure(clip: Clip, folder: Path, keep: Path | None = None) -> str:
    """Track a clip; return its row of the table."""
    path, drift = clip_file(clip, folder), "rigid" if clip.rigid else "free"
    kind = f"{clip.seed:4d} {clip.caustics:8.1f}  {drift:5s} {'yes' if clip.walls else 'no':5s}"
    true, begin = poses(clip), time.process_time()
    length = float(np.linalg.norm(np.diff(true[0], axis=0), axis=1).sum())
    try:
        track = uw.track_camera(path, height_m=clip.height_m, keep=keep)
    except ParameterError as error:
        return f"{kind} {error!s:.80}"
    spent = time.process_time() - begin
    slip = 100.0 * float(np.sqrt(np.mean(slips((track.position, track.rotation), true, clip.height_m) ** 2)))
    said = verdict(track)
    predicted = float(said.split("place to ")[1].split()[0])
    false = said.startswith("good") and slip > 3.0 * length
    return (
        f"{kind} {length:6.2f} m {slip:7.1f} {predicted:9.1f} {predicted / slip:6.2f}  {said.split(':')[0]:8s} "
        f"{track.agreed or np.nan:6.2f} {track.kind:7s} {spent:5.1f} s{'  FALSE' if false else ''}"
    )


def main() -> None:
    """Print the table."""
    given = argparse.ArgumentParser()
    given.add_argument("--quick", action="store_true")
    given.add_argument("--seeds", default="41:81:2")
    given.add_argument("--clips", type=Path)
    given.add_argument("--texture", type=float, default=1.0)
    options = given.parse_args()
    seeds = range(*map(int, options.seeds.split(":")))
    print("seed strength  drift walls   path  true cm predicted  ratio  verdict  agreed kind")
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds[::5] if options.quick else seeds:
            print(measure(Clip.of(seed, options.texture), options.clips or Path(folder)), flush=True)


if __name__ == "__main__":
    main()
