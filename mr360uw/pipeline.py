# SPDX-License-Identifier: Apache-2.0
"""Whole frames and whole videos.

The decoder, the renderer and the encoder each have a thread; between them stand short queues, so memory does not grow
with the clip. The light of a frame is found on the decoder's side.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.composite.aovs import RECIPE, exr_parts
from mr360uw.composite.over import over, over_tile
from mr360uw.errors import OutputExistsError, ParameterError, SceneError
from mr360uw.progress import Progress
from mr360uw.render.backends import make_backend
from mr360uw.render.first_pass import ClipTrack, clip_track, picture, scene_light, sun_track
from mr360uw.render.loaded import FrameLight, Rendered, SceneRenderer
from mr360uw.render.plan import Plan
from mr360uw.scene.inputs import keep_inputs, open_plate
from mr360uw.scene.model import Scene
from mr360uw.threads import Behind, one_blas_thread, prefetch
from mr360uw.types import CausticStack, Environment, Floats, Layer, MediumTable, Sun
from mr360uw.video import VideoFrame, create_video, with_grain, write_exr
from mr360uw.video.read.images import is_pattern, matching_files, numbered


@dataclass(frozen=True, slots=True)
class FrameResult:
    """One composited frame and everything it was made from; stages that the scene does not need are None.

    image_linear: (H, W, 3) float32. layer: what was laid over the plate. environment: the plate's light. caustics: on
    the depths of the objects. medium: the water in the plate's exposure.
    """

    image_linear: Floats
    layer: Layer
    environment: Environment | None
    caustics: CausticStack | None
    medium: MediumTable | None


@dataclass(frozen=True, slots=True)
class Report:
    """What a run did. seconds: wall time; stage_s: seconds of each stage, which overlap, summed over the frames."""

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
    shutter_s: float = 0.0,
) -> FrameResult:
    """Return the composite of one plate (H, W, 3), float32, linear, values up to 1 where it clips.

    time_s: of the sea and of moving objects. index: of the frame, for sequences and grain. backend: "auto", "gl" or
    "reference". sun: "scene" looks for it as the scene says in this plate alone; a video takes it from the smoothed
    track of the clip, `track.at(index)`. gain: (3,) of the veil where the scene's is "auto"; None fits it to this plate
    alone, a video takes it from `analysis.clip_track`. shutter_s: how long the shutter is open, for motion blur.
    Everything is loaded anew on each call; for many frames make a `renderer.SceneRenderer`.
    """
    plate = np.asarray(plate)
    if plate.ndim != 3 or plate.shape[2] != 3 or plate.shape[1] != 2 * plate.shape[0] or plate.shape[0] % 2:
        raise ParameterError(
            f"plate - must be an equirectangular image (H, 2 H, 3) of even height (got {plate.shape}) - resize it"
        )
    if not np.issubdtype(plate.dtype, np.floating) or not np.all(np.isfinite(plate)):
        raise ParameterError("plate - must be finite floating point light - decode code values with uw.open_video")
    renderer = SceneRenderer(scene, plate.shape[1], plate.shape[0], backend)
    light = renderer.light(plate, sun, time_s=time_s, gain=gain) if renderer.plan.runs("environment") else None
    done = renderer.render(light, time_s, index, shutter_s)
    image = over(plate, done.layer)
    if renderer.plan.runs("grain"):
        image = with_grain(image, plate, done.layer, scene.draw.grain, index)
    return FrameResult(
        image_linear=image,
        layer=done.layer,
        environment=light.environment if light is not None else None,
        caustics=renderer.backend.download(done.caustics) if done.caustics is not None else None,
        medium=done.medium,
    )


@dataclass
class _Clock:
    """Seconds spent by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    def add(self, stage: str, since: float) -> float:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now


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
    """Composite frames [a, b) of the scene's plate into `out`, and return what ran, what was skipped and the times.

    out: a video, or a pattern of images (out_%04d.png, .exr), or a still; it appears when it is complete. layers: a
    pattern (layers_%04d.exr) of multi-part EXR files with the layer's variables, without motion blur. Raises
    `VideoError`, `OutputExistsError`, `SceneError`, `MeshError`; then no part of a file is left behind, of sequences
    the pictures that were complete. progress: is called over the clip once more where there is a first pass.
    """
    out, began, clock = Path(out), time.perf_counter(), _Clock()
    pattern = None if layers is None else _layers_pattern(Path(layers), out, overwrite=overwrite)
    keep_inputs(scene, out, *([] if pattern is None else [pattern]))
    with open_plate(scene) as video:
        start, stop = video.check_range(*frames)
        renderer = SceneRenderer(scene, video.width, video.height, backend)
        renderer.check(stop)
        needs_light = renderer.plan.runs("environment")
        shutter_s = float(scene.draw.shutter / video.frame_rate) if video.frame_rate else 0.0
        empty = sunless = 0
        track = ClipTrack()

        def lit() -> Iterator[tuple[VideoFrame, FrameLight | None]]:
            since = time.perf_counter()
            for frame in video.frames(start, stop):
                since = clock.add("decode", since)
                light = None
                if needs_light:
                    sun, gain = track.sun_at(frame.index), track.gain_at(frame.index)
                    light = renderer.light(picture(frame), sun, time_s=frame.time_s, gain=gain)
                since = clock.add("light", since)
                yield frame, light
                since = time.perf_counter()

        with one_blas_thread(), create_video(out, video, scene.output, overwrite=overwrite) as writer:
            needs_sun, needs_gain = renderer.plan.runs("sun"), renderer.plan.runs("gain")
            if needs_sun or needs_gain:
                since = time.perf_counter()
                track = clip_track(scene, video, progress, sun=needs_sun, gain=needs_gain)
                clock.add("first pass", since)

            def write(item: tuple[VideoFrame, Rendered]) -> None:
                since = time.perf_counter()
                plate, done = item
                if pattern is not None and done.variables is not None:
                    parts = exr_parts(done.layer, done.variables, plate.image_linear)
                    write_exr(numbered(pattern, plate.index), parts, attributes={"comments": RECIPE})
                    since = clock.add("layers", since)
                frame = plate.over(done.layer, over_tile, scene.draw.grain) if done.layer.tiles else plate
                since = clock.add("blend", since)
                writer.write(frame)
                clock.add("encode", since)

            with Behind(write) as sink:
                for count, (frame, light) in enumerate(prefetch(lit()), 1):
                    since = time.perf_counter()
                    done = renderer.render(light, frame.time_s, frame.index, shutter_s, variables=pattern is not None)
                    clock.add("render", since)
                    empty += not done.layer.tiles
                    sunless += light is not None and light.environment.sun is None
                    sink.put((frame, done))
                    if progress is not None:
                        progress(count, stop - start)
        notes = (*video.notes, *renderer.notes, *writer.notes)
    return Report(
        out=out,
        frames=stop - start,
        backend=renderer.backend.name,
        device=renderer.backend.device,
        plan=renderer.plan,
        seconds=time.perf_counter() - began,
        stage_s=clock.seconds,
        notes=notes,
        empty_frames=empty if renderer.plan.runs("layer") else 0,
        sunless_frames=sunless if renderer.plan.runs("sun") else 0,
    )


def _layers_pattern(pattern: Path, out: Path, *, overwrite: bool) -> Path:
    """Return the pattern of layered files, of which none may be there yet, other than the output's."""
    if pattern.absolute() == out.absolute():
        raise ParameterError(f"{pattern} - is the name of the output too - give the layers one of their own")
    if not is_pattern(pattern) or pattern.suffix.lower() != ".exr":
        raise ParameterError(f"{pattern} - is no pattern of numbered EXR files - write for example layers_%04d.exr")
    there = matching_files(pattern)
    if there and not overwrite:
        raise OutputExistsError(f"{there[0][1]} - is there already - name another pattern, or give --overwrite")
    return pattern


def export_caustics(
    scene: Scene,
    folder: str | Path,
    *,
    frames: int = 48,
    loop_s: float = 8.0,
    depth_m: float | None = None,
    image_format: Literal["png", "exr"] = "png",
    backend: str = "auto",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[Path, ...]:
    """Write the scene's sea as tileable, looping caustic, height and normal maps; return their paths.

    The sun is the scene's: given, or found in the plate. depth_m: of the plane the caustics fall on, below the mean
    surface; by default that of a receiver plane, else of the first object, else of the camera. Raises `SceneError`
    where the plate shows no sun.
    """
    from mr360uw.caustics import export_tiles, refract_to_air

    with open_plate(scene) as video:
        track = sun_track(scene, video)
        sun = track.at(0) if track is not None else scene_light(scene).sun(picture(next(iter(video.frames(0, 1)))), 0.0)
    if sun is None or sun.direction[1] <= 0.0:
        problem = 'no sun is found in the plate - set light.sun = "given" and its azimuth and elevation'
        raise SceneError(str(scene.plate.path), [problem])
    if depth_m is None:
        heights = [0.0, *(o.position_m[1] for o in scene.objects[:1])]
        if scene.receiver is not None and scene.receiver.kind == "plane":
            heights.append(scene.receiver.height_m)
        depth_m = max(scene.camera.depth_m - heights[-1], 0.0)
    renderer, _ = make_backend(backend)
    return export_tiles(
        scene.sea,
        refract_to_air(sun.direction, scene.water.refractive_index),
        depth_m,
        folder,
        frames,
        loop_s,
        scene.caustics,
        image_format,
        refractive_index=scene.water.refractive_index,
        overwrite=overwrite,
        backend=renderer.name,
        progress=progress,
    )
