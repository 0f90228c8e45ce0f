# SPDX-License-Identifier: Apache-2.0
"""The folder beside an output in which finished work is kept until the output is complete: segments of a
video or numbered pictures.
"""

from __future__ import annotations

import itertools
import json
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from filelock import Timeout

from mr360uw.errors import OutputError, VideoError
from mr360uw.files import WrittenFiles, write_whole
from mr360uw.output_gate import (
    LOCK,
    MARKER,
    SUFFIX,
    is_work_folder,
    locked_work_folder,
    remove_work_folder,
    work_lock,
    work_path,
)
from mr360uw.reading.input_files import read_json
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.runs.stored_analysis import WorkKeys, load_analysis, save_analysis
from mr360uw.video import Clip, EncodeSettings, VideoFrame
from mr360uw.video.writer import Segment, SegmentWriter, VideoWriter, stored_segments

Part = tuple[int, int]
"""Frames [start, stop) of a clip."""


def segment_bounds(start: int, stop: int, length: int) -> list[Part]:
    """Return the parts [a, b) of a range: cut at multiples of `length`, so that ranges share the parts inside them."""
    cuts = [start, *range((start // length + 1) * length, stop, length), stop]
    return list(itertools.pairwise(cuts))


def joined_bounds(parts: list[Part]) -> list[Part]:
    """Return ascending parts with those that follow each other made one."""
    found: list[Part] = []
    for start, stop in parts:
        follows = bool(found) and found[-1][1] == start
        found.append((found.pop()[0] if follows else start, stop))
    return found


class SegmentSink(VideoWriter):
    """Frames of a range as segments in a work folder, each complete as soon as its last frame is encoded."""

    def __init__(self, work: WorkFolder, parts: list[Part], like: Clip, settings: EncodeSettings) -> None:
        self.path = work.path
        self._stops, self._clip, self._settings = dict(parts), like, settings
        self._writer: SegmentWriter | None = None
        self._stop = 0

    def write(self, frame: VideoFrame) -> None:
        """Encode a frame into its segment."""
        if self._writer is None:
            self._stop = self._stops[frame.index]
            self._writer = SegmentWriter(self.path, frame.index, self._stop, self._clip, self._settings)
        self._writer.write(frame)
        if frame.index + 1 == self._stop:
            self._writer.finish()
            self._writer = None

    def finish(self) -> None:
        """Complete the last segment; the frames of it have all been written."""
        if self._writer is not None:
            self._writer.finish()

    def abort(self) -> None:
        """End the segment that is not complete with the frames that it has, or remove it where that fails."""
        if self._writer is not None:
            with suppress(VideoError):  # of a disk that is full; the error that ends the run says so
                self._writer.cut()
            self._writer.abort()


_KEYS, _ANALYSIS, _WRITTEN, _EARLIER = "run.json", "analysis.npz", "written-", "earlier-"


@dataclass(frozen=True, slots=True)
class WorkFolder:
    """Work of one run, or of a killed one that it continues.

    keys: what it depends on. notes: what of it was kept or is done again. overwrite: whether files of others may be
    replaced.
    """

    path: Path
    keys: WorkKeys
    notes: tuple[str, ...] = ()
    overwrite: bool = False

    def analysis(self) -> ClipAnalysis | None:
        """Return the stored analysis of the clip, or None."""
        return load_analysis(self.path / _ANALYSIS)

    def keep_analysis(self, analysis: ClipAnalysis) -> None:
        """Store the analysis of the clip."""
        save_analysis(analysis, self.path / _ANALYSIS)

    def segments(self) -> list[Segment]:
        """Return the complete segments by their first frame."""
        return stored_segments(self.path)

    def files(self, start: int = 0) -> WrittenFiles:
        """Return the record of pictures and layers. start: first frame of the range that writes, which has a log."""
        logs, earlier = (sorted(self.path.glob(f"{kind}*")) for kind in (_WRITTEN, _EARLIER))
        return WrittenFiles(
            self.path / f"{_WRITTEN}{start}", self.path.parent, logs=logs, earlier=earlier, scratch=self.path,
            overwrite=self.overwrite,
        )  # fmt: skip


@contextmanager
def work_folder(out: Path, keys: WorkKeys, *, fresh: bool = False, overwrite: bool = False) -> Iterator[WorkFolder]:
    """Yield an output's work folder, locked; it is removed at the end, or kept where an exception leaves work to reuse.

    fresh: nothing of an earlier run is used. overwrite: files of others may be replaced. Raises `OutputExistsError` if
    another run holds it, `OutputError` where the name is that of something else, and `OSError`.
    """
    with locked_work_folder(work_path(out), out, _has_work) as path:
        yield WorkFolder(path, keys, _continued(path, keys, fresh=fresh), overwrite)


def _continued(path: Path, keys: WorkKeys, *, fresh: bool) -> tuple[str, ...]:
    """Remove what does not fit the keys, but for the names of files that were written; return notes about it."""
    before = _stored_keys(path)
    notes = []
    same_pass = not fresh and before.get("first_pass") == keys.first_pass
    same_pictures = not fresh and before.get("pictures") == keys.pictures
    if before and not fresh and not same_pictures:
        kept = "the first pass is kept" if same_pass else "the first pass too"
        notes.append(f"the scene changed since the run that was stopped: its frames are made again, {kept}")
    for file in path.iterdir():
        keeps = file.name in (LOCK, MARKER) or (same_pass if file.name == _ANALYSIS else same_pictures)
        if file.name.startswith(_WRITTEN) and not keeps:
            file.rename(path / f"{_EARLIER}{secrets.token_hex(4)}")
        elif not (keeps or file.name.startswith(_EARLIER)):
            file.unlink()
    write_whole(path / _KEYS, json.dumps(asdict(keys), indent=2) + "\n")
    return tuple(notes)


def _has_work(path: Path) -> bool:
    """Return whether a folder holds segments, notes of files that were written, or a measured analysis."""
    analysis = load_analysis(path / _ANALYSIS)
    measured = analysis is not None and any(
        one is not None for one in (analysis.sun, analysis.gain, analysis.background)
    )
    return measured or bool(stored_segments(path)) or any(path.glob(f"{_WRITTEN}*")) or any(path.glob(f"{_EARLIER}*"))


def _stored_keys(path: Path) -> dict[str, Any]:
    try:
        found = read_json(path / _KEYS, OutputError)
    except OutputError:
        return {}
    return found if isinstance(found, dict) else {}


def remove_stale(where: Path, *, dry_run: bool) -> list[str]:
    """Remove the work folders in a folder that no run holds, or only list them; return a line for each."""
    lines = []
    for path in stale_work(where):
        size = sum(file.stat().st_size for file in path.iterdir())
        if not dry_run:
            remove_work_folder(path)
        lines.append(f"{'found' if dry_run else 'removed'} {path} ({size / 1e6:.1f} MB)")
    return lines


def stale_notes(where: Path) -> list[str]:
    """Return a line for each folder of finished parts that a stopped run left in a folder."""
    advice = "the same command goes on, mr360uw clean removes them"
    return [
        f"note      {path} - holds finished parts of a run that was stopped - {advice}" for path in stale_work(where)
    ]


def stale_work(where: Path) -> list[Path]:
    """Return the work folders in a folder that no run holds."""
    found = []
    for path in sorted(where.glob(f"*{SUFFIX}")):
        if is_work_folder(path):
            try:
                with work_lock(path).acquire(timeout=0):
                    found.append(path)
            except Timeout:
                continue
    return found
