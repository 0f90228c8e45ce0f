# SPDX-License-Identifier: Apache-2.0
"""What a run did: for people, and as a file for other programs."""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mr360uw.errors import OutputError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_outputs
from mr360uw.reading.input_files import InputFile, read_json
from mr360uw.reading.numbered_files import without_number
from mr360uw.render.plan import Plan


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
        if self.empty_frames:
            lines.append(f"  in {counted(self.empty_frames)} nothing was visible: they went through untouched")
        if self.sunless_frames:
            lines.append(f"  in {counted(self.sunless_frames)} no sun was found: no caustics, no shadows there")
        if self.held_frames:
            lines.append(
                f"  {counted(self.held_frames)} of the plate could not be decoded: the last good one is repeated"
            )
        if self.concealed_frames:
            lines.append(f"  in {counted(self.concealed_frames)} of the plate the decoder guessed what is damaged")
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
