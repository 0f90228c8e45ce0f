# SPDX-License-Identifier: Apache-2.0
"""Report on a plate's light and water (HTML), and the track of its sun (JSON, CSV)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from mr360uw.errors import ParameterError, VideoError
from mr360uw.files import write_whole
from mr360uw.ibl import SunTrack
from mr360uw.medium.settings import WaterSettings
from mr360uw.output_gate import check_outputs
from mr360uw.progress import Progress
from mr360uw.render.check import sun_lines
from mr360uw.render.first_pass import first_pass
from mr360uw.render.plate_map import plate_map
from mr360uw.render.surroundings import surroundings_over_time
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import PlateSettings, Scene, files_of, load_scene
from mr360uw.types import Floats
from mr360uw.video import VideoFrame

if TYPE_CHECKING:
    from mr360uw.ibl.report import ReportFrame

_PICTURES = 6
"""Frames that the report shows, evenly spaced over the clip."""
_PICTURE_WIDTH = 640


def analyse_video(
    source: str | Path,
    out: str | Path | None = None,
    *,
    eye: Literal["left", "right"] | None = None,
    in_air: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
    tell: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write a self-contained page about a plate's light and water, and the track of its sun; return the paths.

    source: a video or still, or a scene file with a plate and its settings. eye: of a stereo plate, where the
    source is no scene file. in_air: whether it is a plate without water, whatever the scene says. out: the page; the
    track goes beside it as .sun.json and .sun.csv. tell: gets the lines on the sun that a composite tells. Raises
    `VideoError`, `SceneError`, `ParameterError` or `OutputExistsError`.
    """
    from mr360uw.ibl.report import ReportFrame, light_report
    from mr360uw.ibl.sun.track import save_track

    source = Path(source)
    scene = load_scene(source) if source.suffix == ".toml" else Scene(plate=PlateSettings(path=source, eye=eye))
    if in_air:
        scene = scene.model_copy(update={"water": WaterSettings(type="none")})
    page = _page(source, out)
    tracks = [page.with_suffix(suffix) for suffix in (".sun.json", ".sun.csv")]
    check_outputs([page, *tracks], inputs=[source, *files_of(scene)], overwrite=overwrite)
    scene = scene.model_copy(update={"light": scene.light.model_copy(update={"track": None, "sun": "detect"})})
    with open_plate(scene) as video:
        over_time = surroundings_over_time(scene)
        smooth = scene.light.smooth and not video.is_still
        analysis = first_pass(over_time(0.0), video, progress, ["sun"] if smooth else [], keyed=over_time)
        track = analysis.sun if isinstance(analysis.sun, SunTrack) else None
        shown = np.unique(np.linspace(0, (video.frame_count or 1) - 1, _PICTURES).astype(int))
        snapshots, maps = [], []
        for index in shown:
            frame = next(iter(video.frames(int(index), int(index) + 1)))
            reader = over_time(frame.time_s).light
            light = reader.of(frame.pixels, time_s=frame.time_s)
            words = reader.sun_found(frame.pixels, frame.time_s).words
            snapshots.append(ReportFrame(frame.time_s, _small(frame), light, words))
            if tell is not None and index == 0:
                for line in sun_lines(reader, frame, analysis):
                    tell(line)
            maps.append(plate_map(frame.pixels, reader.world_from_camera(frame.time_s)[1]))
    up = reader.world_from_camera(snapshots[0].time_s)[1]
    sections = [] if scene.water.type == "none" else _sections_of_water(scene, snapshots, maps, up)
    written = [page]
    write_whole(page, light_report(source.name, snapshots, track, sections))
    if track is not None:
        for path in tracks:
            save_track(track, path)
        written += tracks
    return written


def _sections_of_water(
    scene: Scene, snapshots: Sequence[ReportFrame], maps: Sequence[Floats], declared_up: Floats
) -> list[tuple[str, str]]:
    """Return the report's sections on how level a plate is, and on the water that its maps (h, w, 3) show.

    declared_up: (3,) the world's up in the camera's axes, from the scene.
    """
    from mr360uw.ibl.horizon import estimate_horizon
    from mr360uw.ibl.report import level_section
    from mr360uw.medium.sensor import named_sensor
    from mr360uw.medium.waterfit import fit_water

    refraction, depth_m = scene.water.refractive_index, scene.camera.depth_m
    tilts = [estimate_horizon(snapshot.environment.residual, refraction) for snapshot in snapshots]
    fit = fit_water(np.median(maps, axis=0), depth_m, named_sensor(str(scene.water.sensor)), refraction)
    return [
        ("Level", level_section(tilts, declared_up)),
        (f"Water, for a camera {depth_m:g} m deep", fit.html()),
    ]


def _page(source: Path, out: str | Path | None) -> Path:
    """Return the name of the page; raise `VideoError` or `ParameterError` where there is none."""
    if not source.name:
        raise VideoError(f"{source} - is a folder - name a video, a picture or a scene file")
    page = Path(out) if out is not None else source.with_suffix(".html")
    if page.suffix.lower() != ".html":
        raise ParameterError(f"{page} - is no name of a page (got {page.suffix!r}) - end it in .html")
    return page


def _small(frame: VideoFrame) -> np.ndarray:
    import cv2

    size = (_PICTURE_WIDTH, _PICTURE_WIDTH // 2)
    return np.asarray(cv2.resize(frame.image_linear, size, interpolation=cv2.INTER_AREA))
