# SPDX-License-Identifier: Apache-2.0
"""Cost of pictures from above: python benchmarks/aerial.py [section ...], all without any.

fft: spectral seas of 256 to 2048 wave vectors across: first amplitudes, fields of a frame, splines, light on the floor.
picture: a frame of 640 x 360 of the default scene, alone and within a film. pictures FOLDER: those of docs/aerial.md.
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

from mr360uw.from_above import AerialScene, LoadedAerial, aerial_film  # noqa: E402
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


CALM: dict[str, Any] = {"tile_m": 12.0, "shortest_wavelength_m": 0.14, "wind_speed": 2.0, "detail_slope": 0.03}
VIEWS: dict[str, dict[str, Any]] = {
    "calm, sun high": {"sea": CALM, "floor": {"depth_m": 2.5}, "camera": {"position_m": (0.0, 5.0, 0.0)}},
    "wind 8 m/s, sun low ahead": {
        "sea": {"wind_speed": 8.0, "tile_m": 60.0, "resolution": 512, "shortest_wavelength_m": 0.6},
        "sun": {"elevation_deg": 25.0, "azimuth_deg": 10.0}, "floor": {"depth_m": 6.0},
        "camera": {"position_m": (0.0, 20.0, 0.0), "pitch_deg": -25.0, "exposure": 0.7},
    },
    "straight down, parallel": {
        "sea": CALM, "floor": {"depth_m": 2.0},
        "camera": {"projection": "orthographic", "pitch_deg": -90.0, "width_m": 12.0},
    },
    "a whale under the waves": {
        "sea": CALM, "floor": {"depth_m": 4.0}, "camera": {"position_m": (0.0, 8.0, 0.0), "pitch_deg": -60.0},
        "object": [{"mesh": "whale.glb", "position_m": (0.0, -1.5, -4.5), "face": 60.0}],
    },
    "wind 5 m/s, from 60 m": {
        "sea": {"wind_speed": 5.0, "tile_m": 100.0, "resolution": 512, "shortest_wavelength_m": 0.6},
        "floor": {"depth_m": 5.0, "tile_m": 24.0}, "sun": {"elevation_deg": 45.0},
        "camera": {"position_m": (0.0, 60.0, 0.0), "pitch_deg": -70.0},
    },
    "published look": {
        "sea": CALM, "floor": {"depth_m": 2.5}, "camera": {"position_m": (0.0, 5.0, 0.0)},
        "water": {"mode": "blended"}, "reflection": {"sun": "thresholded"},
        "sun": {"azimuth_deg": 0.0, "elevation_deg": 50.0},
    },
}  # fmt: skip


def pictures(folder: Path, width: int = 448) -> None:
    """Write the pictures of the page, one file each, and all of them as one."""
    import cv2
    import numpy as np

    from mr360uw.sample.whale import write_whale

    write_whale(folder / "whale.glb", 4.0)
    written = []
    for number, (name, tables) in enumerate(VIEWS.items()):
        camera = tables.get("camera", {}) | {"width": width, "height": width * 9 // 16}
        bodies = [one | {"mesh": folder / one["mesh"]} for one in tables.get("object", [])]
        scene = scene_of(**(tables | {"camera": camera, "object": bodies, "film": {"samples": 3}}))
        written.append(folder / f"aerial-{number}.png")
        print(f"{name}: {aerial_film(scene, written[-1], overwrite=True)}")
    cells = [cv2.imread(str(path)) for path in written]
    rows = [np.hstack(cells[first : first + 2]) for first in range(0, len(cells), 2)]
    cv2.imwrite(str(folder / "aerial.jpg"), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    asked = sys.argv[1:]
    if asked[:1] == ["pictures"]:
        pictures(Path(asked[1]), *map(int, asked[2:]))
    else:
        for section in asked or ["fft", "picture"]:
            {"fft": fft, "picture": picture}[section]()
