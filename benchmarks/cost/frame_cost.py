# SPDX-License-Identifier: Apache-2.0
"""Processor time of a frame and of its parts, for several scenes in turns."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

from mr360uw.render.check import StageGraph
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.frame import Backend, Frame, composite_frame, make_backend
from mr360uw.render.loaded import load
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.video import VideoFrame

PARTS = ("light", "water", "caustics", "layer", "blend")
"""Parts of a frame's time, as `StageGraph` notes them; what is left of the frame is in `layer`."""
_OF_STAGE = {
    "plate_light": "light", "PlatePattern": "light", "exposed_water": "water", "summed_stack": "caustics",
    "caustic_stack": "caustics", "VideoFrame.over": "blend",
}  # fmt: skip
"""Part of a frame by the name of its stage."""
_LONGEST_S = 90.0
"""Time [s] on the wall after which a curve has run long enough."""
_TO_NOISE, _TO_DEVIATION = 1.2533, 1.349
"""Of a normal distribution: standard error of a median over that of a mean, and what lies between its quartiles over
its standard deviation."""


@dataclass(frozen=True, slots=True)
class FrameCost:
    """Medians over the frames that were timed.

    ms: processor time [ms] by part, and of the whole "frame". samples: the times [s] of each round, by the same names.
    touched: fraction of the frame's pixels in tiles. once_s: processor time [s] of loading the scene, of its first pass
    and of its first frame.
    """

    ms: dict[str, float]
    samples: dict[str, list[float]]
    touched: float
    once_s: float


class Subject:
    """A scene loaded with a renderer of its own, ready to draw frames."""

    def __init__(self, scene: Scene, backend: Backend | None = None) -> None:
        began = time.process_time()
        self.backend = make_backend()[0] if backend is None else backend
        with open_plate(scene) as video:
            self._loaded = load(scene, video.width, video.height)
            self._analysis = clip_analysis(self._loaded, video)
            self._plates = list(video.frames(0, video.frame_count))
        self._kept, self._next = StageGraph(), 0
        self.samples: list[dict[str, float]] = []
        self.last = self.frame()
        self.once_s = time.process_time() - began
        self.samples.clear()

    def frame(self) -> Frame:
        """Draw the next frame of the clip, over and over, and note what it costs [s]."""
        plate: VideoFrame = self._plates[self._next % len(self._plates)]
        self._next += 1
        self._kept.forget_times()
        began = time.process_time()
        self.last = composite_frame(self._loaded, self._analysis, self.backend, plate, 0.0, cache=self._kept)
        took = time.process_time() - began
        spent = dict.fromkeys(PARTS, 0.0)
        for name, run in self._kept.runs.items():
            spent[_OF_STAGE.get(name, "layer")] += run.seconds
        spent["layer"] += took - sum(spent.values())
        self.samples.append({**spent, "frame": took})
        return self.last

    def cost(self) -> FrameCost:
        """Return the medians of the frames drawn so far."""
        samples = {name: [sample[name] for sample in self.samples] for name in (*PARTS, "frame")}
        ms = {name: 1e3 * statistics.median(values) for name, values in samples.items()}
        layer = self.last.layer
        touched = sum(tile.alpha.size for tile in layer.tiles) / (layer.width * layer.height)
        return FrameCost(ms, samples, touched, self.once_s)


def take_turns(subjects: Sequence[Subject], rounds: int) -> list[FrameCost]:
    """Return what a frame of each subject costs; in each of the rounds, every one draws a frame.

    Each round begins with another subject, so that none always follows the same one. After 90 s no more are begun.
    """
    for subject in subjects:
        subject.frame()
        subject.samples.clear()
    began = time.perf_counter()
    for turn in range(rounds):
        for k in range(len(subjects)):
            subjects[(turn + k) % len(subjects)].frame()
        if time.perf_counter() - began > _LONGEST_S:
            break
    return [subject.cost() for subject in subjects]


def ratio(one: Sequence[float], other: Sequence[float]) -> tuple[float, float]:
    """Return the median of the ratios of two series, round by round, and the standard error of that median."""
    ratios = [a / b for a, b in zip(one, other, strict=True)]
    low, middle, high = statistics.quantiles(ratios, n=4)
    return middle, _TO_NOISE * (high - low) / _TO_DEVIATION / len(ratios) ** 0.5
