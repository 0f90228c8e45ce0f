# SPDX-License-Identifier: Apache-2.0
"""Measures stages on a sample dive: processor time and error of each setting, and which lie on the Pareto front."""

from __future__ import annotations

import functools
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.over import over
from mr360uw.reading.disk_cache import nothing_kept
from mr360uw.render.backends import Backend
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.frame import Frame, composite_frame
from mr360uw.render.loaded import load
from mr360uw.sample import sample_dive
from mr360uw.scene.model import Scene, load_scene
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Floats
from mr360uw.video import VideoFrame

_RUNS, _QUICK_RUNS = 5, 3
_WIDTH, _QUICK_WIDTH = 1024, 512
"""Width [pixels] of the dive's frames: shadows and edges cost and err as in larger ones, in a fraction of the time."""
_SWIMS = "object.0.key=[{time_s=0, position_m=[0.4, -0.6, -3.6]}, {time_s=1, position_m=[1.4, -0.4, -3.2]}]"
"""Motion of the whale: nothing of a frame can be kept for the next because it stands still."""


class Workbench:
    """What stages are measured on. folder: an empty one, for the dive. quick: smaller frames, fewer runs.

    runs: timed runs of each setting. width: of the dive's frames [pixels].
    """

    def __init__(self, folder: Path, backend: Backend, *, quick: bool = False) -> None:
        self.backend, self.quick, self.runs = backend, quick, _QUICK_RUNS if quick else _RUNS
        self.width = _QUICK_WIDTH if quick else _WIDTH
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

SLOWER, WORSE = 1.15, 1.10
"""Ratios of time and of error from which on a setting counts as slower or worse than another. Medians of five runs on a
quiet machine repeat within about 5 %; errors repeat exactly but for changes of the code."""
_TINY_ERROR = 1e-6
"""Relative error below which differences are rounding."""
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


def beats(one: Measurement, other: Measurement) -> bool:
    """Return whether a setting is cheaper than another and no less accurate, or more accurate and no dearer.

    Differences within `SLOWER` and `WORSE` count as none.
    """
    cheaper, dearer = one.cpu_ms * SLOWER < other.cpu_ms, one.cpu_ms > other.cpu_ms
    better, worse = larger(other.error, one.error), one.error > other.error + _TINY_ERROR
    return (cheaper and not worse) or (better and not dearer)


def larger(error: float, before: float) -> bool:
    """Return whether an error is larger than another by more than `WORSE` and by more than rounding."""
    return error > WORSE * before and error - before > _TINY_ERROR


def front(found: Sequence[Measurement]) -> list[Measurement]:
    """Return the settings that no other one beats, the cheapest first."""
    return sorted((m for m in found if not any(beats(o, m) for o in found)), key=lambda m: m.cpu_ms)


def better_than_default(found: Sequence[Measurement]) -> list[Measurement]:
    """Return the settings that beat the default, the most accurate first; none where it lies on the front."""
    usual = next((m for m in found if "default" in m.names), None)
    return [] if usual is None else sorted((m for m in found if beats(m, usual)), key=lambda m: (m.error, m.cpu_ms))


def knobs_in_words(knobs: Knobs) -> str:
    """Return settings as text: caustics.size=512 caustics.grid=auto."""
    return " ".join(f"{name}={'auto' if value is None else value}" for name, value in knobs.items())
