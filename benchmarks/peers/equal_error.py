# SPDX-License-Identifier: Apache-2.0
"""Processor time to the same error of light: our frame against the path tracers Mitsuba 3 and Cycles.

    python benchmarks/peers/equal_error.py [--cycles PYTHON] [--scene NAME]

Four diffuse balls on a floor under a clear sky with its sun (`scenes.py`, "balls"). The truth is Mitsuba's converged
picture (`path_traced.py`). Ours: the light measured in the plate (its time is part of ours), then the layer. The path
tracers: a window of the frame with one to 16 paths a pixel and known light, Cycles also with its denoiser; the time for
our error is read between these by straight lines in powers of ten. Errors are relative RMSE over the pixels of the
frame that bodies cover, and over those of the floor that bodies change; times are processor time of all threads for the
pixels in the window. `--cycles` names a Python 3.11 that has Blender's bpy (`pip install bpy`); Mitsuba comes with
`pip install 'mr360uw[peers]'`.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.grounded import errors, regions
from benchmarks.peers.mitsuba_scene import build, mitsuba, surroundings
from benchmarks.peers.path_traced import Truth, Window, path_integrator, truth, window_of
from benchmarks.peers.scenes import FLOOR_ALBEDO, FLOOR_Y_M, SCENES, SKIES, WIDTH, Scene, Sky
from mr360uw import ibl
from mr360uw.composite import PlacedObject, Shot, render_layer
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.tiles import over
from mr360uw.types import Floats, Layer

_WINDOW = (450, 338)
"""Columns and rows of the path tracers' pictures: some 19 of their pixels fall into one of the frame."""
_PATHS = (1, 4, 16)
_DENOISED = ("1d", "4d", "16d")
_DEPTH = 16
_RUNS = 7
_STEP_M = 0.02
"""How far the bodies move from frame to frame [m], all by the same way."""
_REGIONS = ("objects", "floor")

Picture = tuple[float, Floats]
"""Processor time [s] and frame (H, W, 3)."""


def ours(scene: Scene, sky: Sky) -> dict[str, Picture]:
    """Return our pictures, light measured in the plate: of a first frame, and of a frame for which all bodies moved."""
    plate, gl = sky.plate(), LayerRenderer()
    renderers: dict[str, Callable[[Shot], Layer]] = {"reference": render_layer, "gl": gl.render}
    pictures = {}
    for name, render in renderers.items():
        began = time.process_time()
        image = _ours(scene, plate, render)
        pictures[f"mr360uw {name}, first frame"] = time.process_time() - began, image
    times = []
    for run in range(_RUNS, -1, -1):
        moved = replace(scene, bodies=tuple(_moved(body, run * _STEP_M) for body in scene.bodies))
        began = time.process_time()
        image = _ours(moved, plate, gl.render)
        times.append(time.process_time() - began)
    pictures["mr360uw gl, next frame"] = statistics.median(times[1:]), image
    return pictures


def _ours(scene: Scene, plate: Floats, render: Callable[[Shot], Layer]) -> Floats:
    light = ibl.environment(plate, expansion="none", glossy=True)
    return over(plate, render(scene.shot(light)))


def _moved(body: PlacedObject, along_m: float) -> PlacedObject:
    matrix = body.world_from_object.copy()
    matrix[0, 3] += along_m
    return replace(body, world_from_object=matrix)


def by_mitsuba(scene: Scene, sky: Sky) -> tuple[Window, dict[str, Picture]]:
    """Return where the window's pixels fall in the frame, and Mitsuba's pictures by paths of a pixel."""
    mi = mitsuba()
    built = build(mi, scene, sky, window=_WINDOW)
    window = window_of(mi, built.sensors()[0])
    integrator = mi.load_dict(path_integrator())
    found = {}
    for paths in (1, *_PATHS):
        began = time.process_time()
        drawn = np.asarray(mi.render(built, integrator=integrator, spp=paths, seed=100 + paths), np.float64)
        took = time.process_time() - began
        found[str(paths)] = took, window.means(drawn.reshape(-1, 3))
    return window, found


def by_cycles(python: Path, scene: Scene, sky: Sky, window: Window, runs: Sequence[str]) -> dict[str, Picture]:
    """Return Cycles' pictures by `runs`: paths of a pixel, 4d for four that are denoised."""
    import OpenEXR

    assert sky.sun is not None
    arrays: dict[str, object] = {
        "bodies": len(scene.bodies), "floor_y": FLOOR_Y_M, "floor_albedo": FLOOR_ALBEDO, "sky": surroundings(sky),
        "sun_direction": sky.sun.direction, "sun_irradiance": sky.sun.irradiance,
        "sun_half_angle": sky.sun.half_angle_rad, "look_at": np.array(scene.look_at), "fov_deg": scene.fov_deg,
        "window": _WINDOW, "depth": _DEPTH,
    }  # fmt: skip
    for k, body in enumerate(scene.bodies):
        arrays[f"corners{k}"] = body.to_world(body.mesh.positions)
        arrays[f"normals{k}"] = body.mesh.normals @ body.world_from_object[:3, :3].T
        arrays[f"color{k}"] = np.array(body.mesh.materials[0].base_color[:3])
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "scene.npz", **arrays)
        program = Path(__file__).parent / "cycles_window.py"
        command = [str(python), str(program), f"{folder}/scene.npz", folder, *runs]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        found = {}
        for line in said.splitlines():
            if line.startswith("TIME"):
                _, paths, took = line.split()
                with OpenEXR.File(f"{folder}/{paths}.exr") as file:
                    channels = file.channels()
                    drawn = np.asarray(next(iter(channels.values())).pixels, np.float64)[..., :3]
                found[paths] = float(took), window.means(drawn.reshape(-1, 3))
    return found


def time_to(error: float, found: list[tuple[float, float]]) -> float | None:
    """Return the time [s] in which an error is reached; None where more paths do not lead there.

    found: (time, error) with more and more paths. Beyond the last, the error falls with the square root of the time if
    it fell by the last step, to four times as many paths, by a third at least.
    """
    times, reached = np.log([t for t, _ in found]), np.log([e for _, e in found])
    wanted = np.log(error)
    if wanted >= np.min(reached):
        return float(np.exp(np.interp(-wanted, -np.minimum.accumulate(reached), times)))
    if reached[-1] - reached[-2] > np.log(2.0 / 3.0):
        return None
    return float(np.exp(times[-1] + 2.0 * (reached[-1] - wanted)))


def _row(what: str, picture: Picture, found: Truth, where: dict[str, np.ndarray]) -> dict[str, float]:
    took, image = picture
    error = {name: errors(image, found, where[name])[0] for name in _REGIONS}
    print(f"{what:32} {1e3 * took:10.0f} " + " ".join(f"{error[name]:9.4f}" for name in _REGIONS), flush=True)
    return error


def main() -> None:
    """Print times and errors, and what the path tracers take for ours."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=Path)
    parser.add_argument("--scene", default="balls")
    given = parser.parse_args()
    scene, sky = SCENES[given.scene], SKIES["clear"]
    found = truth(scene, sky)
    where = regions(scene, found, sky.plate())
    counts = ", ".join(f"{name} {int(where[name].sum())}" for name in _REGIONS)
    print(f"scene {scene.name}, frame {WIDTH} columns, {int(found.valid.sum())} pixels in the window ({counts})")
    print(f"{'':32} {'CPU ms':>10} " + " ".join(f"{name:>9}" for name in _REGIONS))
    pictures = ours(scene, sky)
    reached = {name: _row(name, picture, found, where) for name, picture in pictures.items()}
    window, traced = by_mitsuba(scene, sky)
    peers = {"Mitsuba 3": traced}
    if given.cycles is not None:
        drawn = by_cycles(given.cycles, scene, sky, window, [*map(str, _PATHS), *_DENOISED])
        peers["Cycles"] = {paths: drawn[paths] for paths in map(str, _PATHS)}
        peers["Cycles, denoised"] = {paths: drawn[paths] for paths in _DENOISED}
    for peer, drawn in peers.items():
        rows = {p: _row(f"{peer}, paths a pixel: {p}", picture, found, where) for p, picture in drawn.items()}
        for name, (took, _) in pictures.items():
            for region in _REGIONS:
                points = [(drawn[p][0], rows[p][region]) for p in drawn]
                needed = time_to(reached[name][region], points)
                if needed is None:
                    print(f"  {peer} does not get to the error of {name}, {region}, with more paths")
                    continue
                print(f"  {peer} as {name}, {region}: {1e3 * needed:.0f} ms, {needed / took:.1f} times ours")


if __name__ == "__main__":
    main()
