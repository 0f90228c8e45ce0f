# SPDX-License-Identifier: Apache-2.0
"""The output of a run: its parts, its names, the file that its segments are joined into, and how long that takes."""

from __future__ import annotations

import json
import platform
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mr360uw.base.files import (
    check_outputs,
    check_work_folder,
    is_pattern,
    matching_files,
    numbered,
    without_number,
    work_path,
    write_whole,
)
from mr360uw.base.input_files import InputFile, read_json
from mr360uw.errors import OutputError, OutputExistsError, ParameterError, VideoError
from mr360uw.render.plan import Plan
from mr360uw.runs.work_folder import Part, WorkFolder, segment_bounds
from mr360uw.scene.model import Scene, files_of
from mr360uw.video import VideoReader, create_video
from mr360uw.video.clip import PICTURE_SUFFIXES
from mr360uw.video.writer import Segment


class Output:
    """The output of frames [a, b) = `span` of a plate: a video, a still or numbered pictures, and layers beside it.

    path: of the video or the still, or the pattern; absolute. layers: pattern of layered EXR files, or None. report:
    file of the run's report, or None; one of an earlier run beside the output is replaced. Raises `OutputError` or
    `ParameterError` where it may not be written.
    """

    def __init__(
        self, scene: Scene, video: VideoReader, path: str | Path, layers: str | Path | None, span: Part, *,
        overwrite: bool, report: str | Path | None = None,
    ) -> None:  # fmt: skip
        self.scene, self.video, self.span, self.overwrite = scene, video, span, overwrite
        self.path = Path(path).absolute()
        self.layers, self.report = (None if one is None else Path(one).absolute() for one in (layers, report))
        if self.layers is not None and (not is_pattern(self.layers) or self.layers.suffix.lower() != ".exr"):
            raise ParameterError(f"{layers} - is no pattern of numbered EXR files - write for example layers_%04d.exr")
        self.check(files_of(scene))

    def check(self, inputs: Sequence[Path]) -> None:
        """Raise `OutputError` where the output may not be written. inputs: files that the run reads."""
        outputs = [path for path in (self.path, self.layers, self.report) if path is not None]
        new = [path for path in outputs if path != self.report or not is_report_of(path, self.path)]
        check_outputs(new, inputs=inputs, overwrite=self.overwrite)
        check_work_folder(work_path(self.path), [*inputs, *outputs])

    @property
    def is_pictures(self) -> bool:
        """Whether the frames are pictures."""
        return self.path.suffix.lower() in PICTURE_SUFFIXES

    def picture(self, index: int) -> Path:
        """Return the file of a frame's picture."""
        return numbered(self.path, index + self.video.first_number) if is_pattern(self.path) else self.path

    def parts(self) -> list[Part]:
        """Return the parts that are complete on their own; raise `VideoError` if the output cannot be made."""
        create_video(
            self.path, self.video, self.scene.output, overwrite=self.overwrite or is_pattern(self.path)
        ).abort()
        if not self.is_pictures:
            rate = float(self.video.frame_rate)
            return segment_bounds(*self.span, max(1, round(self.scene.output.segment_s * rate)))
        if not is_pattern(self.path) and self.span[1] - self.span[0] > 1:
            raise VideoError(
                f"{self.path} - one picture cannot hold several frames (got {self.span[0]}:{self.span[1]}) - name a "
                f"pattern such as {self.path.stem}_%04d{self.path.suffix}, or one frame"
            )
        return segment_bounds(*self.span, 1)

    def files(self, index: int) -> list[Path]:
        """Return the files of a frame: its picture and its layers, as far as the output has them."""
        pictures = [self.picture(index)] if self.is_pictures else []
        number = index + self.video.first_number
        return pictures + ([] if self.layers is None else [numbered(self.layers, number)])

    def left(self, work: WorkFolder, parts: list[Part]) -> tuple[Part, ...]:
        """Return the parts that are not complete yet; raise `OutputExistsError` where files of others are in their way.

        A part is complete while its segment and all pictures and layers of its frames are there as they were written.
        """
        files, wrong = work.files(), []
        for pattern in (self.path, self.layers):
            there = matching_files(pattern) if pattern is not None and is_pattern(pattern) else []
            foreign = [path for _, path in there if not files.may_replace(path)]
            more = f" and {len(foreign) - 1} more" * (len(foreign) > 1)
            again = "no file of this run - name another pattern, or give --overwrite"
            wrong += [f"{path}{more} - is there already, {again}" for path in foreign[:1]]
        if wrong:
            raise OutputExistsError("\n".join(wrong))
        return self._lacking(work, parts, files.has)

    def _lacking(self, work: WorkFolder, parts: list[Part], there: Callable[[Path], bool]) -> tuple[Part, ...]:
        """Return the parts that lack a segment or a file. there: whether a file is."""
        segments = parts if self.is_pictures else [(one.start, one.stop) for one in work.segments()]
        done = [part for part in segments if all(there(file) for index in range(*part) for file in self.files(index))]
        return tuple(part for part in parts if part not in done)

    def complete(self, work: WorkFolder, parts: list[Part]) -> tuple[str, ...]:
        """Join the segments of a video under its name; return what there is to know about the output, one line each."""
        files, wanted = work.files(), set(parts)
        if lacking := self._lacking(work, parts, files.is_there):
            raise VideoError(
                f"{self.path} - finished parts were damaged before they could be joined, or removed (got "
                f"{len(wanted) - len(lacking)} of {len(wanted)} whole) - the same command makes the others again"
            )
        others = files.others(file for index in range(*self.span) for file in self.files(index))
        left = [f"{len(others)} files of a run that was stopped are no part of this one: {one}" for one in others[:1]]
        if self.is_pictures:
            return (*create_video(self.path, self.video, overwrite=True).notes, *left)
        segments = [segment for segment in work.segments() if (segment.start, segment.stop) in wanted]
        return (*self._join(segments, self.path, work.path, overwrite=self.overwrite), *left)

    def finished_part(self, work: WorkFolder) -> str:
        """Make what is finished of a run that failed playable; return a line on where it is, or "" for nothing."""
        start, again = self.span[0], "the same command does not make them again"
        if self.is_pictures:
            count = len(self.written(work)[0])
            return f"finished: {counted(count)}, as {self.path} - {again}" if count else ""
        segments = _leading([s for s in work.segments() if s.stop <= self.span[1]], start)
        if not segments:
            return ""
        path = work.path / f"finished{self.path.suffix}"
        count = segments[-1].stop - start
        try:
            self._join(segments, path, work.path, overwrite=True)
        except VideoError as error:
            return f"finished: {counted(count)}, kept in {work.path} - {again} (they cannot be joined yet: {error})"
        return f"finished: frames {start}:{start + count} ({counted(count)}), playable as {path} - {again}"

    def written(self, work: WorkFolder) -> tuple[list[int], int]:
        """Return the frames that are complete, and the bytes of them all."""
        files = work.files()
        segments = [] if self.is_pictures else work.segments()
        done = range(*self.span) if self.is_pictures else (k for one in segments for k in range(one.start, one.stop))
        frames = sorted({index for index in done if all(files.is_there(file) for file in self.files(index))})
        sizes = [files.size(file) or 0 for index in frames for file in self.files(index)]
        return frames, sum(sizes) + sum(int(one.packets[:, 3].sum()) for one in segments)

    def _join(self, segments: list[Segment], path: Path, folder: Path, *, overwrite: bool) -> tuple[str, ...]:
        from mr360uw.video.container_writer import ContainerWriter

        span = segments[0].start, segments[-1].stop
        with ContainerWriter(
            path, self.video, self.scene.output, overwrite=overwrite, folder=folder, frames=span
        ) as writer:
            writer.write_segments(segments)
        return writer.notes


def with_encoder(scene: Scene, video: VideoReader, path: Path) -> tuple[Scene, str]:
    """Return a scene whose output names the encoder that all parts of a run take, and a line on what "auto" took."""
    if path.suffix.lower() in PICTURE_SUFFIXES:
        return scene, ""
    from mr360uw.video.encoder import chosen_encoder

    settings, taken = chosen_encoder(scene.output, video, path)
    return (scene.model_copy(update={"output": settings}), taken) if taken else (scene, "")


def _leading(segments: list[Segment], start: int) -> list[Segment]:
    """Return the segments that follow each other from frame `start` on, the longest where several begin together."""
    longest = {segment.start: segment for segment in sorted(segments, key=lambda segment: segment.stop)}
    found: list[Segment] = []
    while (segment := longest.get(found[-1].stop if found else start)) is not None:
        found.append(segment)
    return found


_MEASURED_S = 5.0
"""Time [s] over which the rate is measured at least."""
_LONG_S = 60.0
"""Time left [s] from which on a run gets a forecast; shorter ones are over before it is read."""


def forecaster(tell: Callable[[str], None], output: Output, work: WorkFolder, left: int) -> Callable[[], None]:
    """Return a function that counts a frame, and tells once, after a few seconds, how long the run will take.

    It tells when a part is complete, if the run is a long one. tell: gets the line. left: frames to render.
    """
    done, began, told = 0, 0.0, False

    def frame_done() -> None:
        nonlocal done, began, told
        done += 1
        if done == 1:  # the first frame compiles and uploads: it says nothing about the others
            began = time.perf_counter()
        seconds = time.perf_counter() - began
        if told or seconds < _MEASURED_S:
            return
        frames, written = output.written(work)
        if not frames:
            return
        told, rate = True, (done - 1) / seconds
        if (left - done) / rate >= _LONG_S:
            total = output.span[1] - output.span[0]
            # segments and the file that they are joined into lie side by side at the end
            copies = 1 if output.is_pictures else 2
            size = written / len(frames) * total
            free = shutil.disk_usage(work.path).free
            tell(forecast_line(left - done, rate, size, copies * size - written, free))

    return frame_done


def forecast_line(left: int, rate: float, size: float, needed: float, free: float) -> str:
    """Return a forecast in words. left: frames. rate: frames/s. size: of the output, needed, free: bytes on disk."""
    space = f"needs {_bytes(needed)} more while it is made"
    space += f", and only {_bytes(free)} are free" if needed > free else f" ({_bytes(free)} are free)"
    return f"about {_duration(left / rate)} for {left} frames at {rate:.2g} frames/s; writes {_bytes(size)}, {space}"


def _bytes(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{max(size, 0.0) / 1e6:.0f} MB"


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


# What a run did: for people, and as a file for other programs.


@dataclass(frozen=True, slots=True)
class Report:
    """Summary of a run. seconds: wall time. stage_s: seconds of each stage, summed over frames; stages overlap.

    frames: of the output, of which `kept_frames` were there from a run that was stopped; the other counts are of the
    frames made by this run. held_frames: the plate's could not be decoded, and the last good one stands for it;
    concealed_frames: the decoder guessed a part of it. renderers: frames by renderer and device. inputs: the files that
    the scene reads. scene: all of its settings, defaults too. packages: versions of those that results depend on.
    """

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
    held_frames: int = 0
    concealed_frames: int = 0
    kept_frames: int = 0
    workers: int = 1
    renderers: dict[str, int] = field(default_factory=dict)
    inputs: tuple[InputFile, ...] = ()
    scene: dict[str, Any] = field(default_factory=dict)
    packages: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        made = self.frames - self.kept_frames
        rate = made / self.seconds if self.seconds > 0 else 0.0
        lines = [f"wrote {self.out}: {counted(self.frames)} in {self.seconds:.1f} s ({rate:.1f} frames/s)"]
        if self.kept_frames:
            lines.append(f"  {self.kept_frames} of them were there already, from the run that was stopped")
        lines.append(f"  renderer {self.backend} ({self.device})" + f", {self.workers} workers" * (self.workers > 1))
        lines.append("  " + ", ".join(f"{name} {1e3 * s / max(made, 1):.0f} ms" for name, s in self.stage_s.items()))
        kinds = (
            (self.empty_frames, "in {} nothing was visible: they went through untouched"),
            (self.sunless_frames, "in {} no sun was found: no caustics, no shadows there"),
            (self.held_frames, "{} of the plate could not be decoded: the last good one is repeated"),
            (self.concealed_frames, "in {} of the plate the decoder guessed what is damaged"),
        )
        lines += ["  " + words.format(counted(count)) for count, words in kinds if count]
        if len(self.renderers) > 1:
            lines += [f"  {counted(frames)} by {name}" for name, frames in sorted(self.renderers.items())]
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write the report as JSON; `OutputError` where it may not be written, `OSError` where it cannot."""
        from mr360uw import __version__

        check_outputs([path], overwrite=overwrite)
        write_whole(path, json.dumps(self._table() | {"mr360uw": __version__}, indent=2) + "\n")

    def _table(self) -> dict[str, object]:
        return {
            "out": str(self.out),
            "frames": {
                "written": self.frames,
                "kept_from_a_stopped_run": self.kept_frames,
                "nothing_visible": self.empty_frames,
                "no_sun_found": self.sunless_frames,
                "repeated_for_lost_ones": self.held_frames,
                "guessed_in_part_by_the_decoder": self.concealed_frames,
            },
            "renderer": {"name": self.backend, "device": self.device, "workers": self.workers},
            "frames_by_renderer": self.renderers,
            "seconds": round(self.seconds, 3),
            "seconds_by_stage": {name: round(s, 3) for name, s in self.stage_s.items()},
            "plan": {name: {"runs": stage.runs, "why": stage.why} for name, stage in self.plan.stages.items()},
            "inputs": [{"path": str(f.path), "bytes": f.size, "sha256_of_blocks": f.digest} for f in self.inputs],
            "notes": list(self.notes),
            "seeds": {"sea": self.scene["sea"]["seed"]} if self.scene else {},
            "scene": self.scene,
            "packages": self.packages,
            "python": platform.python_version(),
            "system": platform.platform(),
        }


def report_beside(out: Path) -> Path:
    """Return the file beside an output in which its report is looked for: dive.mp4.json, out.exr.json of numbered EXR
    files.
    """
    name = without_number(out)
    return name.with_name(name.name + ".json")


def is_report_of(path: Path, out: Path) -> bool:
    """Return whether a file beside an output is the report of an earlier run that wrote it."""
    if path != report_beside(out):
        return False
    try:
        told = read_json(path, OutputError)
    except OutputError:
        return False
    return isinstance(told, dict) and "mr360uw" in told and Path(str(told.get("out", ""))).name == out.name


def counted(frames: int) -> str:
    """Return a number of frames in words."""
    return f"{frames} frame{'' if frames == 1 else 's'}"
