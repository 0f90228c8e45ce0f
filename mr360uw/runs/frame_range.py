# SPDX-License-Identifier: Apache-2.0
"""Renders a range of frames: decoder, renderer and encoder each on a thread, with short queues between them.

Memory does not grow with the clip. Each thread runs one of the three stages of `render.frame`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mr360uw.cache import Cache
from mr360uw.composite.aovs import RECIPE, Part, exr_parts, stereo_parts
from mr360uw.reading.numbered_files import numbered
from mr360uw.render.backends import Backend
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import DrawnFrame, Frame, MeasuredPlate, blend_frame, draw_frame, measure_plate
from mr360uw.render.loaded import Loaded
from mr360uw.render.stages.light_stage import LightSamples
from mr360uw.threads import Behind, one_blas_thread, prefetch
from mr360uw.video import VideoFrame, VideoReader, write_exr
from mr360uw.video.write.writer import VideoWriter


@dataclass
class RunTimes:
    """Seconds by stage, and counts of frames: all, those without visible objects, those without a sun.

    held, concealed: frames whose plate was damaged (`VideoFrame.damage`). renderers: frames by renderer and device.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    frames: int = 0
    empty: int = 0
    sunless: int = 0
    held: int = 0
    concealed: int = 0
    renderers: dict[str, int] = field(default_factory=dict)

    def add(self, stage: str, since: float) -> float:
        """Add the time since `since` to a stage; return the present time."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now

    def merge(self, other: RunTimes) -> None:
        """Add what another part of the run took."""
        for stage, seconds in other.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        for name, frames in other.renderers.items():
            self.renderers[name] = self.renderers.get(name, 0) + frames
        self.frames += other.frames
        self.empty += other.empty
        self.sunless += other.sunless
        self.held += other.held
        self.concealed += other.concealed


@dataclass(frozen=True)
class RangeRenderer:
    """Renders ranges of a clip, each frame from what is loaded, the clip's analysis and the plate about it alone.

    layers: pattern of layered EXR files that are written beside the frames, or None; scratch: folder of incomplete
    ones, None for their own. times: are added to.
    """

    loaded: Loaded
    analysis: ClipAnalysis
    backend: Backend
    video: VideoReader
    layers: Path | None
    scratch: Path | None
    times: RunTimes

    def render(self, start: int, stop: int, sink: VideoWriter, done: Callable[[], None] = lambda: None) -> None:
        """Render frames [start, stop) into a sink; done: is called after each."""
        drawing, blending = self._cache(), self._cache()
        behind: Behind[DrawnFrame] = Behind(lambda drawn: self._write(drawn, sink, blending))
        renderer = f"{self.backend.name} ({self.backend.device})"
        exposure_s, variables = self.loaded.scene.draw.exposure_s(self.video.frame_rate), self.layers is not None
        with one_blas_thread(), sink, behind:
            for measured in prefetch(self._read(start, stop)):
                since = time.perf_counter()
                drawn = draw_frame(self.loaded, self.backend, measured, exposure_s, drawing, variables=variables)
                self.times.add("render", since)
                behind.put(drawn)
                self.times.renderers[renderer] = self.times.renderers.get(renderer, 0) + 1
                done()

    def _cache(self) -> Cache:
        """Return a cache of one stage of all frames, which is of its thread alone."""
        return Cache(self.loaded.scene.plate.eyes)

    def _read(self, start: int, stop: int) -> Iterator[MeasuredPlate]:
        """Yield frames, decoded and with their light measured."""
        times, measuring = self.times, self._cache()
        samples = LightSamples(self.loaded, self.analysis, self.video, self._decoded)
        since, decoding_s = time.perf_counter(), times.seconds.get("decode", 0.0)
        for plate, light in samples.frames(start, stop):
            measured = measure_plate(self.loaded, self.analysis, plate, measuring, light)
            times.add("light", since + times.seconds["decode"] - decoding_s)
            yield measured
            since, decoding_s = time.perf_counter(), times.seconds["decode"]

    def _decoded(self, start: int, stop: int) -> Iterator[VideoFrame]:
        since = time.perf_counter()
        for plate in self.video.frames(start, stop):
            self.times.add("decode", since)
            yield plate
            since = time.perf_counter()

    def _write(self, drawn: DrawnFrame, sink: VideoWriter, cache: Cache) -> None:
        """Composite a frame and write it, and before it the file of its layers. cache: results of earlier frames."""
        times, since = self.times, time.perf_counter()
        frame = blend_frame(self.loaded, self.analysis, drawn, cache)
        since = times.add("blend", since)
        times.frames += 1
        times.empty += not frame.layer.tiles
        times.held += frame.plate.damage == "held"
        times.concealed += frame.plate.damage == "concealed"
        times.sunless += frame.light is not None and frame.light.environment.sun is None
        if self.layers is not None and frame.variables is not None:
            parts, views = _layers(frame)
            file = numbered(self.layers, frame.plate.index)
            write_exr(file, parts, attributes={"comments": RECIPE}, views=views, folder=self.scratch)
            since = times.add("layers", since)
        sink.write(frame.picture)
        times.add("encode", since)


def _layers(frame: Frame) -> tuple[dict[str, Part], dict[str, str]]:
    """Return the parts of a frame's layered EXR, and the view of each where there are two eyes."""
    eyes = {"left": frame} if frame.right is None else {"left": frame, "right": frame.right}
    parts = {
        name: exr_parts(eye.layer, eye.variables, eye.plate.image_linear)
        for name, eye in eyes.items()
        if eye.variables is not None
    }
    return (parts["left"], {}) if len(parts) == 1 else stereo_parts(parts)
