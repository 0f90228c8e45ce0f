# SPDX-License-Identifier: Apache-2.0
"""Cost of pictures from above: python benchmarks/aerial.py [section ...], all without any.

fft: spectral seas of 256 to 2048 wave vectors across: first amplitudes, fields of a frame, splines, light on the floor.
picture: a frame of 640 x 360 of the default scene, alone and within a film.
"""

from __future__ import annotations

import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from mr360uw.from_above import AerialScene, LoadedAerial  # noqa: E402
from mr360uw.surface import SampledSea  # noqa: E402
from mr360uw.surface.sampled_sea import points_across  # noqa: E402


def timed(name: str, call: Callable[[int], Any], repeats: int = 3) -> None:
    """Print the medians of wall and processor time of a call, which is given the number of the repeat."""
    wall, cpu = [], []
    for k in range(repeats):
        began, used = time.perf_counter(), time.process_time()
        call(k)
        wall.append(time.perf_counter() - began)
        cpu.append(time.process_time() - used)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"  {name}: {statistics.median(wall):.2f} s, processor {statistics.median(cpu):.2f} s (peak {peak:.2f} GB)")


def scene_of(**tables: dict[str, Any]) -> AerialScene:
    """Return a scene from its tables."""
    return AerialScene.model_validate(tables)


def fft() -> None:
    """Stages of a frame's sea, for four resolutions, down to waves of 0.25 m."""
    for n in (256, 512, 1024, 2048):
        print(f"fft {n} x {n}, tile {n / 10:g} m, waves from 0.25 m")
        scene = scene_of(sea={"resolution": n, "tile_m": n / 10.0, "shortest_wavelength_m": 0.25})
        loaded = LoadedAerial.of(scene)
        sea = loaded.sea.sea
        timed("amplitudes, once", lambda _, sea=sea: sea.spectra(0.0), 1)
        timed("spectra of a frame", lambda k, sea=sea: sea.spectra(0.1 * k))
        timed("fields of a frame", lambda k, sea=sea, n=n: sea.grid_fields(n, 0.1 * k))
        points = points_across(sea)
        timed(f"splines of {points} points", lambda k, sea=sea, points=points: SampledSea.of(sea, 0.1 * k, points))
        sampled = SampledSea.of(sea, 0.0, points)
        timed(
            "light on the floor",
            lambda k, loaded=loaded, sea=sea, sampled=sampled: loaded.sea.light_in_water(4.0).on_floor(
                sea, sampled, loaded.sea.dome, loaded.sea.sun, 4.0, 0.1 * k, loaded.sea.caustics
            ),
        )  # fmt: skip


def picture() -> None:
    """A frame with its sea, and one more."""
    print("picture, 640 x 360, 2 x 2 rays of a pixel")
    loaded: list[LoadedAerial] = []
    timed("scene, once", lambda _: loaded.append(LoadedAerial.of(AerialScene())), 1)
    timed("first frame", lambda _: loaded[0].picture(0.0, (640, 360)), 1)
    timed("next frames", lambda k: loaded[0].picture(0.1 * (k + 1), (640, 360)))


if __name__ == "__main__":
    for section in sys.argv[1:] or ["fft", "picture"]:
        {"fft": fft, "picture": picture}[section]()
