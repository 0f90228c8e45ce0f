# SPDX-License-Identifier: Apache-2.0
"""How well the camera of a 360 clip is tracked: clips of a small renderer with known motion, through H.264.

    python benchmarks/camera.py [moving] [turning] [still] [floor] [stereo] [--clips FOLDER]  # clips there are used

A relief of sand with rocks in haze, under moving caustics, with a rig in the lower part of the picture. Prints the
error of rotation (95th percentile, target 0.1 degree), of position over the length of the path (95th percentile after
the scale is fitted, target 0.5 %), and the time of 48 frames of 1280x640 (target 60 s on two cores), with the load.
`floor`: the floor made of the points of the moving clip, against the relief, after the similarity that lays the found
cameras on the true ones (target: 3 % of the camera's height, rms, where the confidence is a half or more).
`stereo` prints what both_eyes.py says of both eyes of a plate.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import both_eyes
import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import mr360uw as uw
from mr360uw.base.sphere import directions
from mr360uw.composite.motion import rotation_matrix
from mr360uw.sample.dive import record

WIDTH, FRAMES, RATE = 1280, 48, Fraction(24)
TARGET_DEG, TARGET_SHARE, TARGET_S = 0.1, 0.005, 60.0
TARGET_HEIGHT = 0.03
HEIGHT_M = 2.0
"""Height of the camera at time 0 above the mean of the floor."""
TILE_M = 8.0
MARCH = 16
"""Steps of a ray through the relief, then bisections."""


def noise(rng: np.random.Generator, size: int, first: int, last: int, falloff: float) -> np.ndarray:
    """Return a periodic sum of octaves of noise (size, size), mean 0, deviation 1."""
    total = np.zeros((size, size), np.float32)
    for octave in range(first, last):
        cells = 2**octave
        field = np.pad(rng.normal(size=(cells, cells)).astype(np.float32), 3, mode="wrap")
        scale = size // cells
        large = cv2.resize(field, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += large[3 * scale : 3 * scale + size, 3 * scale : 3 * scale + size] / falloff**octave
    return (total - total.mean()) / total.std()


class Reef:
    """Relief, albedo and caustics of a floor, and the picture of them."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.relief = 0.22 * noise(rng, 512, 1, 5, 1.9)
        self.albedo = np.clip(0.45 + 0.16 * noise(rng, 2048, 3, 10, 1.25), 0.05, 0.95)
        self.waves = [noise(rng, 512, 3, 6, 1.3) for _ in range(2)]
        self.look = directions(WIDTH, WIDTH // 2)
        self.rig = cv2.resize(rng.uniform(0.02, 0.5, (10, 40)).astype(np.float32), (WIDTH, 60), interpolation=0)
        self.rng = np.random.default_rng(seed + 1)

    def sampled(self, image: np.ndarray, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return a periodic map at places on the floor."""
        size = len(image)
        at = [np.asarray((v / TILE_M % 1.0) * size, np.float32) for v in (x, z)]
        padded = np.pad(image, 1, mode="wrap").astype(np.float32)
        return cv2.remap(padded, at[0] + 1.0, at[1] + 1.0, cv2.INTER_LINEAR)

    def hit(self, position: np.ndarray, look: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance to the floor along rays (H, W, 3), and where there is a floor within 25 m."""
        down = np.minimum(look[..., 1], -1e-3)
        near = np.maximum((-HEIGHT_M + 0.9 - position[1]) / down, 0.0)
        far = (-HEIGHT_M - 0.9 - position[1]) / down
        seen = (look[..., 1] < -0.02) & (near < 25.0)

        def above(t: np.ndarray) -> np.ndarray:
            p = position + t[..., None] * look
            return p[..., 1] + HEIGHT_M - self.sampled(self.relief, p[..., 0], p[..., 2])

        low, high = near.copy(), far.copy()
        open_ = np.ones(near.shape, bool)
        for k in range(1, MARCH + 1):
            t = near + (far - near) * (k / MARCH)
            under = above(t) <= 0.0
            high = np.where(open_ & under, t, high)
            open_ &= ~under
            low = np.where(open_, t, low)
        for _ in range(8):
            middle = 0.5 * (low + high)
            under = above(middle) <= 0.0
            low, high = np.where(under, low, middle), np.where(under, middle, high)
        return 0.5 * (low + high), seen

    def picture(self, position: np.ndarray, rotation: np.ndarray, time_s: float) -> np.ndarray:
        """Return a linear picture (H, W, 3)."""
        look = (self.look @ rotation.T).astype(np.float32)
        water = 0.10 + 0.10 * np.clip(look[..., 1], -1.0, 1.0)
        grey = water.copy()
        lower = np.any(look[..., 1] < -0.02, axis=1)  # rows that may show the floor
        grey[lower] = self.floor(position.astype(np.float32), look[lower], water[lower], time_s)
        shape = np.abs(np.arange(WIDTH) / WIDTH - 0.5) < 0.12
        grey[-100:-40, shape] = self.rig[:, shape] * 0.6
        grey[-40:] = 0.03
        grey = np.maximum(grey + self.rng.normal(0.0, 0.003, grey.shape), 0.0)
        return np.stack([0.5 * grey, grey, 0.95 * grey], axis=-1)

    def floor(self, position: np.ndarray, look: np.ndarray, water: np.ndarray, time_s: float) -> np.ndarray:
        """Return the light of rays (h, W, 3), `water` (h, W) where they meet no floor."""
        distance, seen = self.hit(position, look)
        p = position + distance[..., None] * look
        light = 0.0
        for k, wave in enumerate(self.waves):
            shift = 0.35 * time_s * (1.0 if k else -0.7)
            light = light + np.abs(self.sampled(wave, p[..., 0] + shift, p[..., 2] - 0.5 * shift))
        caustic = 0.65 + 0.9 * np.exp(-3.0 * light)
        grey = self.sampled(self.albedo, p[..., 0], p[..., 2]) * caustic
        haze = np.exp(-distance / 7.0)
        return np.where(seen, 0.6 * grey * haze + water * (1.0 - haze), water)


def path_of(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, positions and rotations of a clip."""
    t = np.arange(FRAMES) / float(RATE)
    swim = 1.0 if kind == "moving" else 0.0
    turn = 0.0 if kind == "still" else 1.0
    position = swim * np.stack([0.25 * np.sin(1.3 * t), 0.15 * np.sin(2.1 * t), -0.9 * t], axis=-1)
    angles = turn * np.stack([9.0 * np.sin(0.9 * t), 4.0 * np.sin(1.7 * t), 3.0 * np.sin(2.3 * t)], axis=-1)
    return t, position, np.stack([rotation_matrix(tuple(a)) for a in angles])


def rotation_errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the angle [deg] of each frame's turn since frame 0 from the true one: the world's axes do not count."""
    a, b = (r[0].T @ r for r in (found, true))
    cosine = 0.5 * (np.trace(np.swapaxes(a, 1, 2) @ b, axis1=1, axis2=2) - 1.0)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def position_errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the distance [m] of each position from the true one after the similarity that fits best (Umeyama 1991)."""
    a, b = found - found.mean(0), true - true.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    scale = np.trace(np.diag(s) @ sign) / np.square(a).sum()
    return np.linalg.norm(scale * a @ (u @ sign @ vt).T - b, axis=1)


def to_truth(track: uw.CameraTrack, kind: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Return scale, rotation and shift that lay the cameras of a track on the true ones."""
    _, position, rotation = path_of(kind)
    turn = Rotation.from_matrix(rotation @ np.swapaxes(track.rotation, 1, 2)).mean().as_matrix()
    found, true = (track.position - track.position.mean(0)) @ turn.T, position - position.mean(0)
    scale = float(np.sum(found * true) / np.sum(found * found))
    return scale, turn, position.mean(0) - scale * turn @ track.position.mean(0)


def measure_floor(folder: Path) -> None:
    """Make the floor of the moving clip's track and print the errors of its height."""
    track = uw.track_camera(clip_of("moving", folder), height_m=HEIGHT_M)
    cpu = time.process_time()
    floor = uw.floor_from_track(track)
    cpu = time.process_time() - cpu
    scale, turn, shift = to_truth(track, "moving")
    x, y, z = (scale * floor.vertices @ turn.T + shift).T
    error = (y + HEIGHT_M - Reef().sampled(Reef().relief, x[None], z[None])[0]) / HEIGHT_M
    away = np.min([np.hypot(x - p[0], z - p[2]) for p in path_of("moving")[1]], axis=0) / HEIGHT_M
    left_out = f"{floor.points} points, {100 * floor.outliers:.0f} % left out"
    print(f"== floor: {left_out}, {floor.known_m2:.1f} m2 known, {cpu:.1f} s CPU")
    known = floor.confidence.ravel() >= 0.5
    rms = float(np.sqrt(np.mean(np.square(error[known]))))
    met = "met" if rms <= TARGET_HEIGHT else "MISSED"
    most = 100 * np.quantile(np.abs(error[known]), 0.95)
    target = f"target {100 * TARGET_HEIGHT:.0f} % rms, {met}"
    print(f"height, known        {100 * rms:.2f} % rms, 95 % {most:.2f} %  ({target})")
    for near, far in ((0, 1), (1, 2), (2, 3)):
        ring = (away >= near) & (away < far)
        print(f"{near} to {far} heights away  {100 * np.sqrt(np.mean(np.square(error[ring]))):.2f} % rms")


def clip_of(kind: str, folder: Path) -> Path:
    """Return a clip, made unless it is there."""
    times, position, rotation = path_of(kind)
    clip = folder / f"{kind}.mp4"
    if not clip.exists():
        reef = Reef()
        record(clip, (reef.picture(*pose) for pose in zip(position, rotation, times, strict=True)), RATE, seed=1)
    return clip


def measure(kind: str, folder: Path) -> None:
    """Make a clip, track it, and print the errors."""
    _, position, rotation = path_of(kind)
    clip = clip_of(kind, folder)
    load, begin, cpu = os.getloadavg()[0], time.perf_counter(), time.process_time()
    track = uw.track_camera(clip, height_m=HEIGHT_M)
    wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
    turn = np.percentile(rotation_errors(track.rotation, rotation), 95)
    print(f"== {kind}: found {track.kind}, {len(track.points)} points, coverage {track.coverage:.2f}")
    print(f"rotation, 95 %       {turn:.4f} deg  (target {TARGET_DEG}, {'met' if turn <= TARGET_DEG else 'MISSED'})")
    length = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    if length > 0.0:
        shift = np.percentile(position_errors(track.position, position), 95) / length
        met = "met" if shift <= TARGET_SHARE else "MISSED"
        print(f"position, 95 %       {100 * shift:.3f} % of {length:.2f} m  (target {100 * TARGET_SHARE} %, {met})")
        walked = float(np.linalg.norm(np.diff(track.position, axis=0), axis=1).sum())
        print(f"scale from height    {walked / length:.4f} of the true one; floor {track.floor}")
    met = "met" if wall <= TARGET_S else "MISSED"
    print(f"time                 {wall:.1f} s wall, {cpu:.1f} s CPU, load {load:.1f}  (target {TARGET_S:.0f} s, {met})")


def main() -> None:
    """Run the clips that are named, or all."""
    given = argparse.ArgumentParser()
    given.add_argument("kinds", nargs="*", default=["moving", "turning", "still", "floor"])
    given.add_argument("--clips", type=Path)
    options = given.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for kind in options.kinds:
            if kind == "stereo":
                both_eyes.measure()
                continue
            clips = options.clips or Path(folder)
            measure_floor(clips) if kind == "floor" else measure(kind, clips)


if __name__ == "__main__":
    main()
