# SPDX-License-Identifier: Apache-2.0
"""How right distances from motion are: python benchmarks/depth.py [first last width neighbours strength poses]

Scenes of seeds first to last (not included; default 501 to 505; the regression and the level of confidence were
chosen on others, below 405, and what wrong poses take off the confidence on even ones to 510) with exact distances and
poses: floor, walls, rocks, thin poles and five fish in haze, with drifting particles, under caustics as they are and
two and three times as strong, or of one strength alone. The first row of a table counts pixels within 7.5 baselines and
more than 20 degrees off the motion; the rows below it count all pixels of a kind. The last column is the fraction of a
row's pixels that are confident and not within 6 %.

poses: exact (default), or solved: those that `track_camera` finds in the same pictures, at the true path's scale.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mr360uw as uw
from mr360uw.base.sphere import directions
from mr360uw.depth import DepthMap, Panorama, distances
from mr360uw.errors import ParameterError
from mr360uw.types import Floats
from tests.depth.hazy_scene import FISH, POLE, WATER, HazyScene, relative_error

AT_S, SPAN_S = 3.0, 3.0
WITHIN, SURE, DENSER = 0.06, 0.5, 3


def panoramas(scene: HazyScene, width: int, count: int) -> tuple[Panorama, list[Panorama]]:
    """Return a frame and its neighbours, half of them before it."""
    times = np.linspace(AT_S - SPAN_S, AT_S + SPAN_S, count + 1)
    seen = [Panorama(np.round(scene.grey(width, t, samples=1)), *scene.pose(t)) for t in times]
    return seen.pop(count // 2), seen


def solved(scene: HazyScene, width: int, count: int) -> tuple[Panorama, list[Panorama]]:
    """Return a frame and its neighbours with the poses that tracking finds; print how far apart the paths are.

    Tracked are `DENSER` times as many pictures. Raises `ParameterError` where no path is found.
    """
    middle, others = panoramas(scene, width, DENSER * count)
    seen = [*others[: len(others) // 2], middle, *others[len(others) // 2 :]]
    with tempfile.TemporaryDirectory() as folder:
        for k, one in enumerate(seen):
            cv2.imwrite(f"{folder}/plate_{k:04d}.png", cv2.merge([one.grey.astype(np.uint8)] * 3))
        track = uw.track_camera(f"{folder}/plate_%04d.png")
    truth = np.array([one.position for one in seen])
    turns, _, turned = np.linalg.svd((truth - truth.mean(axis=0)).T @ (track.position - track.position.mean(axis=0)))
    world = turns @ np.diag([1.0, 1.0, np.linalg.det(turns @ turned)]) @ turned
    place = (track.position - track.position.mean(axis=0)) @ world.T
    scale = np.sum(place * (truth - truth.mean(axis=0))) / np.sum(place * place)
    place = scale * place + truth.mean(axis=0)
    off = np.sqrt(np.mean(np.sum(np.square(place - truth), axis=1)))
    print(f"solved path: {100 * off:.1f} cm from the true one, of {np.linalg.norm(truth[-1] - truth[0]):.1f} m")
    views = [replace(v, position=p, rotation=world @ r) for v, p, r in zip(seen, place, track.rotation, strict=True)]
    views = views[::DENSER]
    return views.pop(count // 2), views


def in_reach(reference: Panorama, neighbours: list[Panorama], distance: Floats, kind: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) of what stands still that are in reach."""
    baseline = max(float(np.linalg.norm(one.position - reference.position)) for one in neighbours)
    motion = neighbours[-1].position - neighbours[0].position
    motion /= np.linalg.norm(motion)
    rays = directions(distance.shape[1], distance.shape[0]) @ reference.rotation.T
    off = np.degrees(np.arccos(np.clip(np.abs(rays @ motion), 0.0, 1.0)))
    return np.asarray((kind < POLE) & (distance < 7.5 * baseline) & (off > 20.0))


def rows_of(found: DepthMap, scene: HazyScene, views: tuple[Panorama, list[Panorama]]) -> dict[str, np.ndarray]:
    """Return the pixels of each row: in reach, and of kinds that are hard."""
    _, distance, kind = scene.see(found.distance_m.shape[1], AT_S)
    finite = np.where(np.isfinite(distance), distance, 1e3).astype(np.float32)
    kernel = np.ones((7, 7), np.uint8)
    edge = cv2.dilate(finite, kernel) > 1.25 * cv2.erode(finite, kernel)
    latitude = np.abs(np.pi * (0.5 - (np.arange(len(kind)) + 0.5) / len(kind)))[:, None]
    return {
        "in reach": in_reach(*views, distance, kind),
        "beside edges": edge & (kind < POLE),
        "thin poles": kind == POLE,
        "fish": kind == FISH,
        "below 60 deg": (latitude > np.radians(60.0)) & (kind < POLE),
        "open water": kind == WATER,
        "everything": np.ones(kind.shape, bool),
    }


def main(
    first: int = 501, last: int = 505, width: int = 1024, count: int = 32, only: int = 0, poses: str = "exact"
) -> None:
    """Print a table for each strength of the caustics."""
    for strength in (1, 2, 3) if only == 0 else (only,):
        sums: dict[str, list[np.ndarray]] = {}
        seconds = []
        for seed in range(first, last):
            scene = HazyScene(seed=seed, caustics=float(strength), poles=True, fish=True)
            try:
                views = (solved if poses == "solved" else panoramas)(scene, width, count)
            except ParameterError as error:
                print(f"seed {seed} is left out:", str(error).partition(" - ")[2])
                continue
            start = time.process_time()
            found = distances(*views)
            seconds.append(time.process_time() - start)
            error = relative_error(found.distance_m, scene.see(width, AT_S)[1])
            sure = found.confidence >= SURE
            for name, pixels in rows_of(found, scene, views).items():
                sums.setdefault(name, []).append(np.stack([error[pixels], sure[pixels]]))
        print(f"caustics x{strength}   {np.median(seconds):.1f} CPU-s a frame of {width}, {count} neighbours")
        print("                coverage   median   within 6 %   all: median   within 6 %   sure and wrong")
        for name, parts in sums.items():
            error, sure = np.concatenate(parts, axis=1)
            if not len(error):
                continue
            right = error[sure > 0.0]
            told = f"{100 * np.median(right):8.2f} {100 * np.mean(right < WITHIN):12.1f}" if len(right) else " " * 21
            print(
                f"  {name:13s} {100 * np.mean(sure):8.1f} {told} {100 * np.median(error):13.2f} "
                f"{100 * np.mean(error < WITHIN):12.1f} {100 * np.mean((sure > 0.0) & (error >= WITHIN)):16.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main(*(int(one) if one.isdigit() else one for one in sys.argv[1:]))  # type: ignore[arg-type]
