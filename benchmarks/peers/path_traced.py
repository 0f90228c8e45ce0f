# SPDX-License-Identifier: Apache-2.0
"""Pictures by the path tracer Mitsuba 3 (Jakob et al. 2022) of the scenes of `scenes.py`: the truth to compare with.

    python benchmarks/peers/path_traced.py [SCENE ...]

Needs `pip install 'mr360uw[peers]'`. Mitsuba has no equirectangular camera, so a scene is drawn through a perspective
window of many more pixels than the frame has there, each the mean of a few paths; the frame's pixels are the means of
the window's pixels whose middles fall into them (some 17 x 17). Nothing is denoised. There are two pictures of
different seeds: their difference is the noise. They are kept in the folder `truth` beside this file.
"""

from __future__ import annotations

import hashlib
import itertools
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.peers.mitsuba_scene import WINDOW, build, mitsuba  # noqa: E402
from benchmarks.peers.scenes import FLOOR_ALBEDO, FLOOR_Y_M, SCENES, SKIES, WIDTH, Scene, Sky  # noqa: E402
from mr360uw.base.sphere import direction_from_frame, frame_from_direction  # noqa: E402
from mr360uw.types import Floats  # noqa: E402

FOLDER = Path(__file__).parent / "truth"
PATHS = 4
"""Paths of a window's pixel in each of the two pictures: some 1200 a pixel of the frame and picture."""
_DEPTH, _ROULETTE = 16, 8
"""Longest path, and from where on paths end at random: 0.8^16 of the light is left after it in the whitest hollow."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What the path tracer found, frames (H, W, ...); NaN or 0 outside of the window.

    halves: (2, H, W, 3) radiance by two independent sets of paths. shape: (S, H, W) fraction of a pixel that each body
    covers. floor: (H, W) fraction that the floor covers. point: (H, W, 3) mean place [m] of the surfaces in a pixel.
    sunlit: (H, W) visible fraction of the sun's disc on the floor, NaN elsewhere; 1 without a sun. seconds: processor
    time of all threads. valid: (H, W) whether the whole pixel lies in the window.
    """

    halves: Floats
    shape: Floats
    floor: Floats
    point: Floats
    sunlit: Floats
    valid: np.ndarray
    seconds: float

    @property
    def mean(self) -> Floats:
        """The picture (H, W, 3)."""
        return self.halves.mean(axis=0)


def truth(scene: Scene, sky: Sky) -> Truth:
    """Return the truth of a scene, from the disk where it is kept there."""
    path = FOLDER / f"{scene.name}-{sky.name}-{_digest(scene, sky)}.npz"
    if path.exists():
        with np.load(path) as kept:
            return Truth(**{name: kept[name] for name in kept.files})
    found = _render(scene, sky)
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(path, **{name: getattr(found, name) for name in Truth.__slots__})
    return found


def _digest(scene: Scene, sky: Sky) -> str:
    """Return a name of everything that the picture depends on."""
    state = hashlib.sha256()
    for body in scene.bodies:
        for array in (body.mesh.positions, body.mesh.normals, body.world_from_object):
            state.update(np.ascontiguousarray(array).tobytes())
        state.update(repr(body.mesh.materials).encode())
    state.update(sky.plate(64).tobytes())
    numbers = (
        scene.look_at,
        scene.fov_deg,
        WIDTH,
        WINDOW,
        PATHS,
        _DEPTH,
        FLOOR_Y_M,
        FLOOR_ALBEDO.tolist(),
        sky.sun,
        scene.paving_m,
    )
    state.update(repr(numbers).encode())
    return state.hexdigest()[:12]


# --- the pictures --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """How the window's pixels lie in the frame: index of the frame's pixel of each; which of the frame's are whole."""

    index: np.ndarray
    count: np.ndarray
    valid: np.ndarray

    def means(self, image: Floats) -> Floats:
        """Return the frame (H, W, C) of an image of the window; NaN outside."""
        flat = image.reshape(len(self.index), -1)
        sums = [np.bincount(self.index, column, WIDTH * WIDTH // 2) for column in flat.T]
        with np.errstate(invalid="ignore", divide="ignore"):
            frame = np.stack(sums, axis=-1) / self.count[:, None]
        return frame.reshape(WIDTH // 2, WIDTH, -1).astype(np.float32)


def window_of(mi: Any, sensor: Any) -> Window:
    """Return where the pixels of a camera's picture fall; the camera itself says where it looks."""

    def ray(u: float, v: float) -> Floats:
        return np.array(sensor.sample_ray(0.0, 0.0, mi.Point2f(u, v), mi.Point2f(0.5, 0.5))[0].d, np.float64)

    middle = ray(0.5, 0.5)
    edges = [ray(u, v) for u, v in ((0.0, 0.5), (1.0, 0.5), (0.5, 0.0), (0.5, 1.0))]
    left, right, top, bottom = (edge / (edge @ middle) for edge in edges)
    axes = np.stack([right - left, bottom - top, middle])
    width, height = (int(side) for side in sensor.film().size())
    u, v = np.meshgrid((np.arange(width) + 0.5) / width - 0.5, (np.arange(height) + 0.5) / height - 0.5)
    x, y = frame_from_direction(np.stack([u, v, np.ones_like(u)], axis=-1) @ axes, WIDTH, WIDTH // 2)
    index = (np.minimum(y.astype(int), WIDTH // 2 - 1) * WIDTH + x.astype(int) % WIDTH).ravel()
    corner = direction_from_frame(np.arange(WIDTH + 1), np.arange(WIDTH // 2 + 1)[:, None], WIDTH, WIDTH // 2)
    place = corner @ np.linalg.inv(axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = (place[..., 2] > 0.0) & (np.abs(place[..., :2] / place[..., 2:]) < 0.5).all(axis=-1)
    valid = seen[:-1, :-1] & seen[1:, :-1] & seen[:-1, 1:] & seen[1:, 1:]
    return Window(index, np.bincount(index, minlength=WIDTH * WIDTH // 2), valid)


def path_integrator() -> dict[str, Any]:
    """Return Mitsuba's path tracer as it is used here, as a dictionary."""
    return {"type": "path", "max_depth": _DEPTH, "rr_depth": _ROULETTE}


def _render(scene: Scene, sky: Sky) -> Truth:
    mi = mitsuba()
    began = time.process_time()
    whole = build(mi, scene, sky)
    window = window_of(mi, whole.sensors()[0])

    def picture(of: Any, integrator: dict[str, Any], paths: int, seed: int) -> Floats:
        drawn = mi.render(of, integrator=mi.load_dict(integrator), spp=paths, seed=seed)
        return np.asarray(drawn, np.float64).reshape(-1, np.shape(drawn)[-1])

    halves = np.stack([window.means(picture(whole, path_integrator(), PATHS, seed)) for seed in (1, 2)])
    found = picture(whole, {"type": "aov", "aovs": "number:shape_index,place:position"}, 1, 3)[:, -4:]
    # shapes are counted from 1, the sky is 0
    number = {shape.id(): k + 1 for k, shape in enumerate(whole.shapes())}
    covered = {name: window.means((found[:, 0] == k).astype(float))[..., 0] for name, k in number.items()}
    sunlit = np.ones_like(covered["floor"])
    if sky.sun is not None:
        beam = FLOOR_ALBEDO / np.pi * sky.sun.irradiance * sky.sun.direction[1]
        even = replace(scene, paving_m=0.0)
        direct = picture(build(mi, even, sky, ambient=False), {"type": "path", "max_depth": 2}, 1, 4)
        sunlit = window.means(direct / beam).mean(axis=-1)
    return Truth(
        halves=halves,
        shape=np.stack([covered[f"body{k}"] for k in range(len(scene.bodies))]),
        floor=covered["floor"],
        point=window.means(found[:, 1:]),
        sunlit=np.where(covered["floor"] > 1.0 - 1e-6, sunlit, np.nan).astype(np.float32),
        valid=window.valid,
        seconds=time.process_time() - began,
    )


def check() -> None:
    """Print how far the path-traced picture without bodies is from the plate, which is known in closed form."""
    mi = mitsuba()
    for scene, sky in itertools.product((SCENES["balls"], SCENES["paved"]), SKIES.values()):
        bare = build(mi, scene, sky, bodies=False)
        window = window_of(mi, bare.sensors()[0])
        drawn = np.asarray(mi.render(bare, integrator=mi.load_dict(path_integrator()), spp=1, seed=5), np.float64)
        error = (window.means(drawn.reshape(-1, 3)) / scene.plate(sky) - 1.0)[window.valid]
        print(
            f"plate, {scene.name}, {sky.name:8} mean error {error.mean():+.5f}, RMSE {np.sqrt(np.mean(error**2)):.5f}"
        )


if __name__ == "__main__":
    check()
    for chosen in sys.argv[1:] or SCENES:
        for light in SKIES.values():
            result = truth(SCENES[chosen], light)
            noise = (result.halves[0] - result.halves[1])[result.valid] / 2.0
            level = float(result.mean[result.valid].mean())
            deviation = float(np.sqrt(np.mean(noise**2))) / level
            print(f"{chosen:9} {light.name:8} {result.seconds:6.1f} s of processor time, noise {deviation:.4f}")
