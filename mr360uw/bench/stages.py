# SPDX-License-Identifier: Apache-2.0
"""Stages that `mr360uw bench` measures on a sample dive: processor time and error of each setting."""

from __future__ import annotations

import functools
import itertools
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.base.caustic_lookup import caustic_lookup, mip_levels
from mr360uw.base.constants import MAXIMUM_SUN_SAMPLES, REFRACTIVE_INDEX_SEA
from mr360uw.base.disk_cache import nothing_kept
from mr360uw.base.sphere import unit
from mr360uw.caustics import CausticSettings, GerstnerSea, caustic_stack, refract_to_air, stack_depths
from mr360uw.caustics.settings import PlaneLadder
from mr360uw.composite.shafts import grid_of
from mr360uw.composite.shot import load_objects
from mr360uw.composite.tiles import over
from mr360uw.ibl import environment
from mr360uw.medium import Medium, ShaftScene, Water, shaft_field
from mr360uw.medium.lookup import veil_lookup
from mr360uw.medium.scattered_light import spread_of
from mr360uw.medium.settings import ShaftSettings
from mr360uw.medium.shafts.shaft_field import march
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.frame import Backend, Frame, composite_frame
from mr360uw.render.loaded import load
from mr360uw.sample import sample_dive
from mr360uw.scene.model import Scene, load_scene
from mr360uw.scene.resolved import open_plate
from mr360uw.types import CausticStack, Floats, Sun, View
from mr360uw.video import VideoFrame

# Measures stages on a sample dive: processor time and error of each setting, and which lie on the Pareto front.

_RUNS, _QUICK_RUNS = 5, 3
_DIVE_WIDTH, _QUICK_WIDTH = 1024, 512
"""Width [pixels] of the dive's frames: shadows and edges cost and err as in larger ones, in a fraction of the time."""
_SWIMS = "object.0.key=[{time_s=0, position_m=[0.4, -0.6, -3.6]}, {time_s=1, position_m=[1.4, -0.4, -3.2]}]"
"""Motion of the whale: nothing of a frame can be kept for the next because it stands still."""


class Workbench:
    """Bench on which stages are measured. folder: an empty one, for the dive. quick: smaller frames, fewer runs.

    runs: timed runs of each setting. width: of the dive's frames [pixels].
    """

    def __init__(self, folder: Path, backend: Backend, *, quick: bool = False) -> None:
        self.backend, self.quick, self.runs = backend, quick, _QUICK_RUNS if quick else _RUNS
        self.width = _QUICK_WIDTH if quick else _DIVE_WIDTH
        self._folder = folder

    @functools.cached_property
    def scene_file(self) -> Path:
        """The scene of the dive, made when it is first asked for: a plate of a frame for each run, a whale, sand."""
        return sample_dive(self._folder / "dive", width=self.width, frames=self.runs + 1).scene

    def scene(self, knobs: Mapping[str, Any]) -> Scene:
        """Return the scene of the dive with settings."""
        given = [f"{name}={value}" for name, value in knobs.items() if value is not None]
        return load_scene(self.scene_file, [_SWIMS, *given])

    @functools.cached_property
    def plates(self) -> list[VideoFrame]:
        """The frames of the dive's plate."""
        with open_plate(self.scene({})) as video:
            return list(video.frames(0, self.runs + 1))

    def frames(self, knobs: Mapping[str, Any]) -> Callable[[int], Frame]:
        """Return a function that composites frame k of the dive with settings, decoding not included.

        What frames share is kept from one to the next, as in a composite of the clip.
        """
        scene = self.scene(knobs)
        with open_plate(scene) as video:
            loaded = load(scene, video.width, video.height)
            analysis = clip_analysis(loaded, video)
            plates = list(video.frames(0, self.runs + 1))
        cache = Cache()
        return lambda k: composite_frame(loaded, analysis, self.backend, plates[k], 0.0, cache=cache)


def picture_of(frame: Frame) -> Floats:
    """Return a frame's picture (H, W, 3) before it is rounded to codes: linear radiance."""
    return over(frame.plate.image_linear, frame.layer)


Knobs = Mapping[str, Any]
"""Values of settings by their names, those of a scene as in caustics.size."""

_LONG_ENOUGH_S = 4.0
"""Time of one setting's runs [s] after which it is not run again: its median is steady by then."""
_NAMES = {"final": "default", "draft": "draft", "reference": "reference"}
"""Words for the points of the qualities of a scene."""


Workload = tuple[Callable[[Knobs], Callable[[int], Any]], Callable[[Any], float]]
"""A stage ready to be measured: two functions. The first takes settings and returns the work, which is timed; it is
called with 0 for the run whose error is taken, and with 1, 2, ... for the runs that are timed. The second takes a
result of run 0 and returns its relative root mean square error."""


@dataclass(frozen=True, slots=True)
class MeasuredStage:
    """A stage and the settings at which it is measured.

    title: what is measured, timed: what the time covers, truth: what the error is against, in words. points: settings
    of a full run; quick: of a quick one. named: those of a scene's qualities, see `qualities`, which both runs have.
    open: prepares it on a workbench.
    """

    name: str
    title: str
    timed: str
    truth: str
    points: tuple[Knobs, ...]
    quick: tuple[Knobs, ...]
    named: Mapping[str, Knobs]
    open: Callable[[Workbench], Workload]

    def settings(self, *, quick: bool) -> list[Knobs]:
        """Return the settings of a run, each once."""
        found: list[Knobs] = []
        for point in (*self.named.values(), *(self.quick if quick else self.points)):
            if point not in found:
                found.append(point)
        return found


@dataclass(frozen=True, slots=True)
class Measurement:
    """Medians of one setting: processor time of all threads and wall time [ms], of `runs` runs; relative error.

    names: "default", "draft" or "reference" where the setting is that of a scene's quality.
    """

    knobs: Knobs
    cpu_ms: float
    wall_ms: float
    error: float
    runs: int
    names: tuple[str, ...] = ()


def qualities(*names: str) -> dict[str, Knobs]:
    """Return the values of a scene's parameters, as caustics.size, by "default", "draft" and "reference"."""
    found: dict[str, Knobs] = {}
    for quality, word in _NAMES.items():
        scene = Scene.model_validate({"plate": "plate.mp4", "draw": {"quality": quality}})
        found[word] = {name: getattr(getattr(scene, name.split(".")[0]), name.split(".")[1]) for name in names}
    return found


def measure(stage: MeasuredStage, bench: Workbench, tick: Callable[[], None] = lambda: None) -> list[Measurement]:
    """Return the measurements of a stage at its settings. tick: called after each of them."""
    (prepare, error_of), found = stage.open(bench), []
    for knobs in stage.settings(quick=bench.quick):
        with nothing_kept():
            run = prepare(knobs)
            error = error_of(run(0))
            cpu, wall = timed(run, bench.runs)
        names = tuple(word for word, point in stage.named.items() if point == knobs)
        found.append(Measurement(dict(knobs), 1e3 * cpu, 1e3 * wall, error, bench.runs, names))
        tick()
    return found


def timed(run: Callable[[int], Any], runs: int) -> tuple[float, float]:
    """Return the medians of processor time, of all threads of the process, and of wall time [s] of runs 1, 2, ...

    After 4 s no more are begun.
    """
    cpu, wall = [], []
    for number in range(1, runs + 1):
        of_cpu, of_wall = time.process_time(), time.perf_counter()
        run(number)
        cpu.append(time.process_time() - of_cpu)
        wall.append(time.perf_counter() - of_wall)
        if sum(wall) > _LONG_ENOUGH_S:
            break
    return statistics.median(cpu), statistics.median(wall)


def relative_rms(got: Any, truth: Any) -> float:
    """Return the root mean square of the difference of two arrays over that of the second; 0 for equal ones."""
    got, truth = np.asarray(got, np.float64), np.asarray(truth, np.float64)
    difference = float(np.sqrt(np.mean((got - truth) ** 2)))
    return difference / float(np.sqrt(np.mean(truth**2))) if difference else 0.0


_FRAME_WIDTH = 4096
"""Width [pixels] of the frame that the grid is for: so large that it takes as many nodes as the settings give it."""
_STRIDE = 8
"""Pixels from ray to ray of those that the grid is read for."""
_TRUE_RAYS, _STEPS = 128, 2048
"""Rays that are compared, and their segments."""
_SUN = Sun(unit([0.3, 0.85, -0.4]), np.ones(3), 0.0035, 1.0)


def _open_shafts(bench: Workbench) -> Workload:
    scene = bench.scene({})
    depth_m = scene.camera.depth_m
    medium = Medium(Water.jerlov("IB"), camera_depth_m=depth_m)
    view = View(_FRAME_WIDTH, _FRAME_WIDTH // 2, surface_y_m=depth_m)
    whale = load_objects(scene.objects)[0].at(0.0, 0, np.zeros(3), np.eye(3))
    waves = caustic_stack(
        scene.sea, refract_to_air(_SUN.direction), stack_depths(0.2, 20.0, 12), 0.0,
        CausticSettings(size=256, grid=128), spread=spread_of(medium),
    )  # fmt: skip
    shafts = ShaftScene.of(view, medium, [_SUN], [whale], waves)
    column = np.arange(3 * _FRAME_WIDTH // 8, 5 * _FRAME_WIDTH // 8, _STRIDE) + 0.5
    row = np.arange(_FRAME_WIDTH // 6, _FRAME_WIDTH // 3, _STRIDE) + 0.5
    rays = np.asarray(view.directions(*(at.ravel() for at in np.meshgrid(column, row))), np.float64).reshape(-1, 3)
    some = np.random.default_rng(3).choice(len(rays), _TRUE_RAYS, replace=False)
    seen = rays[some]
    surface = np.where(seen[:, 1] > 0.0, depth_m / np.maximum(seen[:, 1], 1e-9), np.inf)
    ends = np.minimum(np.minimum(shafts.bodies.first_hit_m(shafts.origin, seen), surface), scene.shafts.range_m)
    truth = march(shafts, seen, ends, _STEPS)

    def prepare(knobs: Knobs) -> Callable[[int], Any]:
        settings = ShaftSettings(resolution=knobs["shafts.resolution"], slices=knobs["shafts.slices"])
        grid = grid_of(settings, _FRAME_WIDTH, shafts)
        return lambda _: shaft_field(shafts, grid, rays).radiance(seen, ends)

    return prepare, lambda got: relative_rms(got, truth)


_CAMERA_M = 4.0
"""Depth [m] of the camera."""
SEA = GerstnerSea(wind_speed=4.0, wind_direction_deg=30.0, tile_m=8.0, seed=1)
_SUN_IN_AIR = unit([0.45, 0.85, -0.3])
_REACH_M = (3.0, 6.0)
"""Depths [m] that a body takes up."""
_POINTS = 50_000
"""Points at which maps are compared."""


def product(**values: Sequence[Any]) -> tuple[Knobs, ...]:
    """Return all combinations of values; a double underscore in a name stands for a dot."""
    names = [name.replace("__", ".") for name in values]
    return tuple(dict(zip(names, each, strict=True)) for each in itertools.product(*values.values()))


# --- water ---------------------------------------------------------------------------------------------------------


def _open_medium(bench: Workbench) -> Workload:
    del bench
    water, up = Water.jerlov("IB"), np.linspace(-0.98, 0.98, 64)[:, None]
    distance = np.geomspace(0.3, 30.0, 24)[None, :]
    distance, up = np.broadcast_arrays(np.minimum(distance, np.where(up > 0.0, 0.99 * _CAMERA_M / up, np.inf)), up)
    truth = Medium(water, camera_depth_m=_CAMERA_M, band_count=241).veil(distance, _CAMERA_M, up)
    scale = np.sqrt(np.mean(truth**2, axis=(0, 1)))

    def prepare(knobs: Knobs) -> Callable[[int], Any]:
        mode, bands = knobs["water.mode"], knobs["water.bands"]
        return lambda _: Medium(water, mode=mode, camera_depth_m=_CAMERA_M, band_count=bands).table

    return prepare, lambda table: relative_rms(veil_lookup(table, distance, up) / scale, truth / scale)


# --- caustics ------------------------------------------------------------------------------------------------------


def _open_caustics(bench: Workbench) -> Workload:
    depth_m = float(np.mean(_REACH_M))
    x, z = np.random.default_rng(1).uniform(0.0, SEA.tile_m, (2, _POINTS))
    finest = CausticSettings(size=2048, grid=1024)
    truth = _read(_stack(bench, np.array([depth_m]), finest), x, np.full(_POINTS, depth_m), z)

    def prepare(knobs: Knobs) -> Callable[[int], Any]:
        settings = CausticSettings(size=knobs["caustics.size"], grid=knobs["caustics.grid"])
        return lambda k: _stack(bench, np.array([depth_m]), settings, 0.1 * k)

    return prepare, lambda stack: relative_rms(_read(stack, x, np.full(_POINTS, depth_m), z), truth)


def _open_planes(bench: Workbench) -> Workload:
    rng = np.random.default_rng(2)
    (x, z), depth_m = rng.uniform(0.0, SEA.tile_m, (2, _POINTS)), rng.uniform(*_REACH_M, _POINTS)
    settings = CausticSettings(size=256)
    truth = _read(_stack(bench, np.linspace(*_REACH_M, 49), settings), x, depth_m, z)

    def prepare(knobs: Knobs) -> Callable[[int], Any]:
        ladder = PlaneLadder.of_scene([_REACH_M], [_REACH_M[1] - _REACH_M[0]], [], knobs["caustics.planes"])
        planes = ladder.around([_REACH_M])
        return lambda k: _stack(bench, planes, settings, 0.1 * k)

    return prepare, lambda stack: relative_rms(_read(stack, x, depth_m, z), truth)


def _stack(bench: Workbench, depths_m: Floats, settings: CausticSettings, time_s: float = 0.0) -> CausticStack:
    backend = bench.backend
    return backend.caustics(SEA, _SUN_IN_AIR, depths_m, time_s, settings, REFRACTIVE_INDEX_SEA, None, None)


def _read(stack: CausticStack, x_m: Floats, depth_m: Floats, z_m: Floats) -> Floats:
    """Return the irradiance ratio (n,) of green at points of the water, minus 1."""
    return caustic_lookup(stack, mip_levels(np.asarray(stack.ratio)), x_m, depth_m, z_m, 0.0)[:, 1] - 1.0


# The stages that are measured in frames of a sample dive: light of the plate, shadows, edges, whole frames.


def _open_light(bench: Workbench) -> Workload:
    import cv2

    images = [plate.image_linear for plate in bench.plates]

    def prepare(knobs: Knobs) -> Callable[[int], Any]:
        height, width = (round(side * knobs["plate.scale"]) for side in images[0].shape[:2])
        small = [cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in images]
        return lambda k: environment(small[k], underwater=True)

    truth = environment(images[0], underwater=True).irradiance
    return prepare, lambda light: relative_rms(light.irradiance, truth)


def frames_against(bench: Workbench, finest: Knobs) -> Workload:
    """Return the workload of whole frames; finest: settings of the truth. Its error is taken where that has a layer."""
    best = bench.frames(finest)(0)
    truth = picture_of(best)
    touched = np.any(truth != best.plate.image_linear, axis=-1)

    def error(frame: Any) -> float:
        return relative_rms(_as_large(picture_of(frame), truth)[touched], truth[touched])

    return bench.frames, error


def _as_large(image: Floats, like: Floats) -> Floats:
    """Return a picture (h, w, 3) enlarged linearly to the size of another; itself where it has that size."""
    import cv2

    if image.shape == like.shape:
        return image
    return np.asarray(cv2.resize(image, like.shape[1::-1], interpolation=cv2.INTER_LINEAR))


_FRAME = "a frame of a swimming whale over sand, from the decoded plate to the codes"
_SCALES = product(plate__scale=(1.0, 0.5, 0.25, 0.125, 0.0625))
_SUN_COUNTS = (1, 2, 4, 6, 8, 12, 16, 24, MAXIMUM_SUN_SAMPLES)
_SAMPLE_COUNTS = (1, 5, 13, 17, 29, 41, 65)
_PLANE_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)
_QUALITIES = ("draft", "final", "reference")
_MODELS = product(water__mode=("kd", "kd+", "rgb"), water__bands=(61,))
_EVERY_STAGE = (
    MeasuredStage(
        "light",
        "Light of the plate: size of the frame",
        "environment, irradiance and sun of one frame",
        "the same of the whole frame: irradiance in all directions",
        _SCALES,
        _SCALES[:3],
        {"default": {"plate.scale": 1.0}},
        _open_light,
    ),
    MeasuredStage(
        "medium",
        "Water: wavelengths and model of the veil",
        "solving a water and tabulating it, once a clip",
        "the solved light field at 241 wavelengths, no table: veil over 0.3 to 30 m in 64 directions, without gain",
        (*product(water__mode=("table",), water__bands=(3, 5, 8, 12, 16, 31)), *_MODELS),
        (*product(water__mode=("table",), water__bands=(8, 16)), *_MODELS[:1]),
        qualities("water.mode", "water.bands"),
        _open_medium,
    ),
    MeasuredStage(
        "caustics",
        "One caustic map: its pixels, and the cells of the surface",
        "one map of a plane 4.5 m deep, as arrays",
        "a map of 2048 x 2048 pixels from 1024 x 1024 cells, read at 50000 points: ratio minus 1",
        product(caustics__size=(64, 128, 256, 512, 1024), caustics__grid=(32, 64, 96, 128, 192, 256, 512)),
        product(caustics__size=(128, 256, 512), caustics__grid=(64, 128)),
        qualities("caustics.size", "caustics.grid"),
        _open_caustics,
    ),
    MeasuredStage(
        "planes",
        "Planes between which caustics are interpolated",
        "all maps of a frame for a body 3 to 6 m deep, as arrays",
        "49 planes, read at 50000 points between: ratio minus 1",
        product(caustics__planes=_PLANE_COUNTS),
        product(caustics__planes=_PLANE_COUNTS[::3]),
        qualities("caustics.planes"),
        _open_planes,
    ),
    MeasuredStage(
        "shafts",
        "Shafts: nodes and slices of their grid",
        "the grid's nodes that a view of 90 x 60 degrees reads, and reading 128 rays",
        "2048 segments along each of 128 rays, of the sun under waves and behind a whale: the change of radiance",
        product(shafts__resolution=(128, 256, 512, 1024, 2048), shafts__slices=(8, 16, 32, 64)),
        ({"shafts.resolution": 256, "shafts.slices": 8}, {"shafts.resolution": 512, "shafts.slices": 32}),
        qualities("shafts.resolution", "shafts.slices"),
        _open_shafts,
    ),
    MeasuredStage(
        "sun",
        "Soft shadows: directions over the sun's disc",
        _FRAME,
        f"{MAXIMUM_SUN_SAMPLES} directions: radiance where the whale or its shadow is",
        product(draw__sun_samples=_SUN_COUNTS),
        product(draw__sun_samples=_SUN_COUNTS[::4]),
        qualities("draw.sun_samples"),
        lambda bench: frames_against(bench, {"draw.sun_samples": MAXIMUM_SUN_SAMPLES}),
    ),
    MeasuredStage(
        "pixels",
        "Edges: samples of a pixel, and how they are shaded",
        _FRAME,
        "65 samples shaded one by one: radiance where the whale or its shadow is",
        tuple(k for s in ("pixel", "sample") for k in product(draw__samples=_SAMPLE_COUNTS, draw__shading=(s,))),
        product(draw__samples=(1, 5, 29), draw__shading=("pixel",)),
        qualities("draw.samples", "draw.shading"),
        lambda bench: frames_against(bench, {"draw.samples": 65, "draw.shading": "sample"}),
    ),
    MeasuredStage(
        "frame",
        "The whole frame: quality and size",
        _FRAME,
        "quality reference at the plate's own size: radiance where the whale or its shadow is, enlarged linearly",
        tuple(k for s in (1.0, 0.75, 0.5, 0.25) for k in product(draw__quality=_QUALITIES, plate__scale=(s,))),
        product(draw__quality=_QUALITIES[:2], plate__scale=(0.5,)),
        qualities("draw.quality", "plate.scale"),
        lambda bench: frames_against(bench, {"draw.quality": "reference", "plate.scale": 1.0}),
    ),
)
STAGES = {stage.name: stage for stage in _EVERY_STAGE}
"""The stages by name, in the order in which a frame runs them."""
