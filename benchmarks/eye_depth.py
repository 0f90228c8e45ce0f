# SPDX-License-Identifier: Apache-2.0
"""How right distances by two eyes are: python benchmarks/eye_depth.py [first] [last] [width]

Stereo stills of the scenes of seeds first to last (not included; default 111 to 114) of `tests/depth/hazy_scene.py`:
floor, walls, rocks and thin poles in haze under caustics, each ray from its own point of the viewing circle, eyes
6.4 cm apart, noise of its own in each eye. Rendering takes a minute for a still of 2048 columns.
"""

from __future__ import annotations

import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mr360uw.base.sphere import directions
from mr360uw.depth import eye_distances
from mr360uw.types import Floats, ray_starts
from tests.depth.hazy_scene import HazyScene, _trace, relative_error

HALF_M, WITHIN, SURE = 0.032, 0.06, 0.5
BANDS_M = (1.0, 1.5, 2.2, 3.3, 5.0, 7.5)


def seen(scene: HazyScene, width: int, eye_m: float) -> tuple[Floats, Floats]:
    """Return the grey codes (H, W) of an eye, and its distances (H, W) [m]."""
    origin, rotation = scene.pose(0.0)
    rays = directions(width, width // 2).reshape(-1, 3)
    starts = origin + ray_starts(rays, np.array([0.0, 1.0, 0.0]), eye_m) @ rotation.T
    rays = np.ascontiguousarray(rays @ rotation.T)
    image, far, kind = np.empty((len(rays), 3)), np.empty(len(rays)), np.empty(len(rays), np.uint8)
    of_scene = (scene.planes, scene.balls, scene.posts, np.zeros((0, 4)), scene.lattice, scene.light(0.0))
    look = (scene.sun, scene.look, scene.haze, scene.veil)
    for p in range(len(rays)):
        one = slice(p, p + 1)
        _trace(starts[p], rays[one], *of_scene, *look, image[one], far[one], kind[one])
    r = np.random.default_rng([scene.seed, round(1000.0 * (eye_m + 1.0))])
    green = np.clip(image[:, 1] + r.normal(0.0, scene.noise, len(image)), 0.0, 1.0)
    shape = width // 2, width
    return np.round(255.0 * green ** (1 / 2.2)).astype(np.float32).reshape(shape), far.reshape(shape)


def main(first: int = 111, last: int = 114, width: int = 2048) -> None:
    """Print a row for each band of distances."""
    parts = []
    for seed in range(first, last):
        scene = HazyScene(seed=seed, poles=True)
        (left, far_left), (right, far_right) = (seen(scene, width, eye_m) for eye_m in (-HALF_M, HALF_M))
        start = time.process_time()
        found = eye_distances(left, right, 2.0 * HALF_M)
        print(f"seed {seed}: {time.process_time() - start:.1f} CPU-s for both eyes of {width}", flush=True)
        for one, far in zip(found, (far_left, far_right), strict=True):
            parts.append(np.stack([one.confidence >= SURE, relative_error(one.distance_m, far), far]).reshape(3, -1))
    sure, error, far = np.concatenate(parts, axis=1)
    print("  distance      sure   median   within 6 %")
    rows = [(f"{a:.1f} to {b:.1f} m", (far >= a) & (far < b)) for a, b in pairwise(BANDS_M)]
    for name, inside in [*rows, ("all of it", np.isfinite(far))]:
        right = error[inside & (sure > 0.0)]
        print(
            f"  {name:12s} {100 * sure[inside].mean():5.1f} {100 * np.median(right):8.2f} "
            f"{100 * np.mean(right < WITHIN):12.1f}"
        )
    print(f"  open water   {100 * sure[np.isinf(far)].mean():5.1f}")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
