# SPDX-License-Identifier: Apache-2.0
"""Compositing of whole videos and of single frames.

Decoder, renderer and encoder each run on a thread, with short queues between them, so memory does not grow with the
clip. Each thread runs one of the three parts of `render.frame.frame_stages`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.composite.aovs import RECIPE, exr_parts
from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.progress import Progress
from mr360uw.render.backends import Backend, make_backend
from mr360uw.render.first_pass import ClipFacts, first_pass
from mr360uw.render.frame import Stages, finished, frame_stages
from mr360uw.render.loaded import Loaded, load
from mr360uw.render.plan import Plan
from mr360uw.render.plate_pattern import calm_series
from mr360uw.scene.inputs import keep_inputs, open_plate
from mr360uw.scene.model import Scene
from mr360uw.threads import Behind, one_blas_thread, prefetch
from mr360uw.types import CausticStack, Environment, Floats, Layer, MediumTable, Sun
from mr360uw.video import VideoFrame, VideoReader, VideoWriter, create_video, write_exr
from mr360uw.video.read.images import is_pattern, matching_files, numbered


@dataclass(frozen=True, slots=True)
class FrameResult:
    """One composited frame and its intermediate results; stages that the scene does not need are None.

    image_linear: (H, W, 3) float32. layer: objects, shadows and caustics over the plate. environment: the plate's
    light. caustics: on planes around the objects' depths. medium: the water, its veil matched to the plate.
    """

    image_linear: Floats
    layer: Layer
    environment: Environment | None
    caustics: CausticStack | None
    medium: MediumTable | None


@dataclass(frozen=True, slots=True)
class Report:
    """Summary of a run. seconds: wall time. stage_s: seconds of each stage, summed over frames; stages overlap."""

    out: Path
    frames: int
    backend: str
    device: str
    plan: Plan
    seconds: float
    stage_s: dict[str, float]
    notes: tuple[str, ...] = ()
    empty_frames: int = 0
    sunless_frames: int = 0

    def __str__(self) -> str:
        rate = self.frames / self.seconds if self.seconds > 0 else 0.0
        lines = [f"wrote {self.out}: {self.frames} frames in {self.seconds:.1f} s ({rate:.1f} frames/s)"]
        lines.append(f"  renderer {self.backend} ({self.device})")
        lines.append(
            "  " + ", ".join(f"{name} {1e3 * s / max(self.frames, 1):.0f} ms" for name, s in self.stage_s.items())
        )
        if self.empty_frames:
            lines.append(f"  in {self.empty_frames} frames nothing was visible: they went through untouched")
        if self.sunless_frames:
            lines.append(f"  in {self.sunless_frames} frames no sun was found: no caustics, no shadows there")
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)


def render_frame(
    plate: Floats,
    scene: Scene,
    time_s: float = 0.0,
    backend: str = "auto",
    *,
    index: int = 0,
    sun: Sun | Literal["scene"] | None = "scene",
    gain: Floats | None = None,
    facts: ClipFacts | None = None,
    shutter_s: float = 0.0,
) -> FrameResult:
    """Return the composite of one plate (H, W, 3), float32, linear, values up to 1 where it clips.

    time_s: of the sea and of moving objects. index: of the frame, for sequences and grain. backend: "auto", "gl" or
    "reference". sun: "scene" follows the scene's settings in this plate alone; for a frame of a video give
    `facts.sun_at(index)`. gain: (3,) of the veil if the scene's is "auto"; None fits it to this plate alone, for a
    frame of a video give `facts.gain_at(index)`. facts: of a first pass over the plate's clip, in place of both.
    shutter_s: exposure time, for motion blur. The scene is loaded on each call; for many frames use
    `render.loaded.load` and `render.frame.frame_stages`.
    """
    plate = np.asarray(plate)
    if plate.ndim != 3 or plate.shape[2] != 3 or plate.shape[1] != 2 * plate.shape[0] or plate.shape[0] % 2:
        raise ParameterError(
            f"plate - must be an equirectangular image (H, 2 H, 3) of even height (got {plate.shape}) - resize it"
        )
    if not np.issubdtype(plate.dtype, np.floating) or not np.all(np.isfinite(plate)):
        raise ParameterError("plate - must be finite floating point light - decode code values with uw.open_video")
    loaded = load(scene, plate.shape[1], plate.shape[0], clip=False)
    renderer, _ = make_backend(backend)
    facts = ClipFacts.of_frame(sun, gain) if facts is None else facts
    frame = finished(frame_stages(loaded, facts, renderer, VideoFrame.of_linear(plate, index, time_s), shutter_s))
    return FrameResult(
        image_linear=frame.picture.image_linear,
        layer=frame.layer,
        environment=frame.light.environment if frame.light is not None else None,
        caustics=renderer.download(frame.caustics) if frame.caustics is not None else None,
        medium=frame.medium,
    )


@dataclass
class _Clock:
    """Seconds by stage, and counts of frames without visible objects and without a sun."""

    seconds: dict[str, float] = field(default_factory=dict)
    empty: int = 0
    sunless: int = 0

    def add(self, stage: str, since: float) -> float:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now


@dataclass(frozen=True)
class _Run:
    """One run over a plate, with a method for each thread. layers: pattern of layered EXR files, or None."""

    loaded: Loaded
    facts: ClipFacts
    backend: Backend
    video: VideoReader
    writer: VideoWriter
    layers: Path | None
    clock: _Clock

    def read(self, start: int, stop: int) -> Iterator[Stages]:
        """Yield the stages of frames [start, stop), decoded and with their light measured."""
        rate = self.video.frame_rate
        shutter_s = float(self.loaded.scene.draw.shutter / rate) if rate else 0.0
        since = time.perf_counter()
        for plate in self.video.frames(start, stop):
            since = self.clock.add("decode", since)
            stages = frame_stages(
                self.loaded, self.facts, self.backend, plate, shutter_s, variables=self.layers is not None
            )
            next(stages)
            self.clock.add("light", since)
            yield stages
            since = time.perf_counter()

    def draw(self, stages: Stages) -> None:
        """Draw a frame's layer."""
        since = time.perf_counter()
        next(stages)
        self.clock.add("render", since)

    def write(self, stages: Stages) -> None:
        """Composite a frame and write it, and before it the file of its layers."""
        since = time.perf_counter()
        frame = finished(stages)
        since = self.clock.add("blend", since)
        self.clock.empty += not frame.layer.tiles
        self.clock.sunless += frame.light is not None and frame.light.environment.sun is None
        if self.layers is not None and frame.variables is not None:
            parts = exr_parts(frame.layer, frame.variables, frame.plate.image_linear)
            write_exr(numbered(self.layers, frame.plate.index), parts, attributes={"comments": RECIPE})
            since = self.clock.add("layers", since)
        self.writer.write(frame.picture)
        self.clock.add("encode", since)


def composite_video(
    scene: Scene,
    out: str | Path,
    *,
    frames: tuple[int, int | None] = (0, None),
    backend: str = "auto",
    overwrite: bool = False,
    layers: str | Path | None = None,
    progress: Progress | None = None,
) -> Report:
    """Composite frames [a, b) of the scene's plate into `out`; return a report of stages and times.

    out: a video, or a pattern of images (out_%04d.png, .exr), or a still; it appears when it is complete. layers: a
    pattern (layers_%04d.exr) of multi-part EXR files with the layer's variables, without motion blur. Raises
    `VideoError`, `OutputExistsError`, `SceneError`, `MeshError`; then no incomplete file is left behind, of sequences
    the pictures that were complete. progress: is called over the clip an extra time if there is a first pass.
    """
    out, began, clock = Path(out), time.perf_counter(), _Clock()
    pattern = None if layers is None else _layers_pattern(Path(layers), out, overwrite=overwrite)
    keep_inputs(scene, out, *([] if pattern is None else [pattern]))
    with open_plate(scene) as video:
        start, stop = video.check_range(*frames)
        loaded = load(scene, video.width, video.height, clip=not video.is_still)
        loaded.check(stop)
        renderer, fallback = make_backend(backend)
        plan = loaded.plan
        with one_blas_thread(), create_video(out, video, scene.output, overwrite=overwrite) as writer:
            since = time.perf_counter()
            wanted = {"sun": plan.track_sun.runs, "gain": plan.track_gain.runs}
            calm = calm_series(loaded) if not video.is_still else None
            facts = first_pass(loaded.surroundings, video, progress, calm=calm, **wanted)
            clock.add("first pass", since)
            run = _Run(loaded, facts, renderer, video, writer, pattern, clock)
            with Behind(run.write) as sink:
                for count, stages in enumerate(prefetch(run.read(start, stop)), 1):
                    run.draw(stages)
                    sink.put(stages)
                    if progress is not None:
                        progress(count, stop - start)
        notes = (*video.notes, *loaded.notes, *facts.notes, *filter(None, [fallback]), *writer.notes)
    return Report(
        out=out,
        frames=stop - start,
        backend=renderer.name,
        device=renderer.device,
        plan=plan,
        seconds=time.perf_counter() - began,
        stage_s=clock.seconds,
        notes=notes,
        empty_frames=clock.empty if plan.layer.runs else 0,
        sunless_frames=clock.sunless if plan.sun.runs else 0,
    )


def _layers_pattern(pattern: Path, out: Path, *, overwrite: bool) -> Path:
    """Return the pattern of layered files; raise if it is the output's, no EXR pattern, or matches existing files."""
    if pattern.absolute() == out.absolute():
        raise ParameterError(f"{pattern} - is the name of the output too - give the layers one of their own")
    if not is_pattern(pattern) or pattern.suffix.lower() != ".exr":
        raise ParameterError(f"{pattern} - is no pattern of numbered EXR files - write for example layers_%04d.exr")
    there = matching_files(pattern)
    if there and not overwrite:
        raise OutputExistsError(f"{there[0][1]} - is there already - name another pattern, or give --overwrite")
    return pattern
