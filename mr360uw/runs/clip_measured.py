# SPDX-License-Identifier: Apache-2.0
"""Facts of a clip, measured once: they are kept on the disk for later runs over the same plate and settings."""

from __future__ import annotations

from pathlib import Path

from mr360uw.progress import Progress
from mr360uw.reading.disk_cache import cache_file, keep_arrays
from mr360uw.reading.kept_reads import stamp
from mr360uw.reading.numbered_files import files_named
from mr360uw.render.first_pass import ClipAnalysis, clip_facts
from mr360uw.render.loaded import Loaded
from mr360uw.runs.fingerprint import WorkKeys
from mr360uw.runs.stored_facts import arrays_of_facts, load_facts
from mr360uw.video import VideoReader
from mr360uw.video.read.projection import projection_of


def measured_facts(
    loaded: Loaded,
    video: VideoReader,
    frames: tuple[int, int],
    keys: WorkKeys,
    progress: Progress | None = None,
    *,
    fresh: bool = False,
) -> ClipAnalysis:
    """Return the facts of a clip's frames [a, b), of an earlier run if there was one over the same with the same.

    fresh: measure them anyway. Raises as `clip_facts`.
    """
    path = _file_of(loaded, video, keys)
    stored = None if path is None or fresh else load_facts(path)
    if stored is not None:
        return stored
    facts = clip_facts(loaded, video, progress, frames=frames)
    if path is not None:
        keep_arrays(path, arrays_of_facts(facts))
    return facts


def _file_of(loaded: Loaded, video: VideoReader, keys: WorkKeys) -> Path | None:
    """Return the file of the facts, under the key of the first pass, what the plan asks of it, and the plate's files.

    None where nothing is kept: plates of two lenses and configs of OpenColorIO may lie in files that the scene does
    not name.
    """
    plate, plan = loaded.scene.plate, loaded.plan
    if projection_of(plate.path, plate.projection) != "equirectangular" or plate.ocio is not None:
        return None
    wanted = plan.track_sun.runs, plan.track_gain.runs, plan.pattern.runs, plan.match.runs
    files = [(str(file), stamp(file)) for file in files_named(plate.path)]
    return cache_file("first-pass", (keys.first_pass, wanted, video.width, video.height, files))
