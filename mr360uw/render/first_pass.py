# SPDX-License-Identifier: Apache-2.0
"""A first pass over a clip: the track of its sun, the gain of its water, and a page about both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.errors import OutputExistsError, ParameterError, SceneError
from mr360uw.files import write_whole
from mr360uw.ibl import SunMeasurement, SunTrack, load_track, measure_sun, track_suns
from mr360uw.medium import Medium, exposure_change, fit_gain, picture_change, steady_gain
from mr360uw.progress import Progress
from mr360uw.render.camera import CameraPath
from mr360uw.render.lights import SceneLight
from mr360uw.render.plate_map import plate_map
from mr360uw.scene.inputs import keep_inputs, open_plate
from mr360uw.scene.model import PlateSettings, Scene, load_scene
from mr360uw.threads import one_blas_thread, prefetch
from mr360uw.types import Floats, Sun, YuvImage
from mr360uw.video import VideoFrame, VideoReader

_PICTURES = 6
_PICTURE_WIDTH = 640


def scene_light(scene: Scene) -> SceneLight:
    """Return the reader of a scene's light."""
    medium = scene.water.medium(scene.camera.depth_m)
    return SceneLight(scene, medium.unit_table if medium is not None else None, CameraPath.of(scene))


def picture(frame: VideoFrame) -> Floats | YuvImage:
    """Return a frame's planes, or its linear picture where it has none."""
    return frame.yuv if frame.yuv is not None else frame.image_linear


@dataclass(frozen=True, slots=True, eq=False)
class ClipTrack:
    """What is known of a whole clip, so that a frame looks the same in every run.

    sun: or None where each frame says its own. gain: (N, 3) of the veil, or None where each frame is fitted alone.
    """

    sun: SunTrack | None = None
    gain: Floats | None = None

    def sun_at(self, index: int) -> Sun | Literal["scene"] | None:
        """Return the sun of frame `index`, None where its shot has none; "scene" where there is no track."""
        return "scene" if self.sun is None else self.sun.at(index)

    def gain_at(self, index: int) -> Floats | None:
        """Return the veil's gain (3,) of frame `index`, or None; frames after the last take the last."""
        return None if self.gain is None else self.gain[min(index, len(self.gain) - 1)]


def clip_track(
    scene: Scene, video: VideoReader, progress: Progress | None = None, *, sun: bool = True, gain: bool = True
) -> ClipTrack:
    """Return the sun and the veil's gain of every frame of a clip, as far as they are wanted and the scene needs them.

    The sun is the scene's own track, or found in a first pass, in which the gain is fitted too. The whole clip is read
    whatever range is rendered. With nothing to find there is no pass. Raises `SceneError` where the scene's track
    belongs to another clip.
    """
    light = scene.light
    sun = sun and light.sun == "detect" and not video.is_still
    track = _stored_track(light.track, video) if sun and light.track is not None else None
    smooth = light.smooth and not video.is_still
    reader = scene_light(scene) if sun and track is None and smooth else None
    medium = scene.water.medium(scene.camera.depth_m) if gain and scene.water.fits_gain and smooth else None
    if reader is None and medium is None:
        return ClipTrack(track)
    camera = CameraPath.of(scene)
    suns: list[SunMeasurement] = []
    maps = _MapSeries()
    with one_blas_thread():
        for frame in prefetch(video.frames()):
            world_from_camera = camera.at(frame.time_s)[1]
            if reader is not None:
                suns.append(
                    measure_sun(reader.of(picture(frame), time_s=frame.time_s), frame.time_s, world_from_camera)
                )
            if medium is not None:
                here = medium.at_depth(camera.depth_at(frame.time_s)) if camera.sinks else medium
                maps.add(here, plate_map(picture(frame), world_from_camera[1]))
            if progress is not None:
                progress(frame.index + 1, video.frame_count)
    return ClipTrack(
        track_suns(suns, minimum_confidence=light.minimum_confidence) if suns else track,
        maps.gain(float(video.frame_rate)) if medium is not None else None,
    )


def sun_track(scene: Scene, video: VideoReader, progress: Progress | None = None) -> SunTrack | None:
    """Return the sun of every frame of a clip, or None where none is needed: `clip_track` for the sun alone."""
    return clip_track(scene, video, progress, gain=False).sun


def _stored_track(path: Path, video: VideoReader) -> SunTrack:
    track = load_track(path)
    if len(track) != video.frame_count:
        problem = f"belongs to another clip (got {len(track)} frames for {video.frame_count}) - run mr360uw analyse"
        raise SceneError(str(path), [f"light.track - {problem}"])
    return track


class _MapSeries:
    """What the small maps of a clip's frames, in order, say about the gain; the maps themselves are not kept."""

    def __init__(self) -> None:
        self._gains: list[Floats] = []
        self._exposure: list[float] = []
        self._picture: list[float] = []
        self._last: Floats | None = None

    def add(self, medium: Medium, shown: Floats) -> None:
        before = shown if self._last is None else self._last
        self._gains.append(fit_gain(medium, shown)[0])
        self._exposure.append(exposure_change(before, shown))
        self._picture.append(picture_change(before, shown))
        self._last = shown

    def gain(self, frame_rate: float) -> Floats:
        """Return the gain (N, 3) of every frame."""
        return steady_gain(self._gains, self._exposure, self._picture, frame_rate)


def analyse_video(
    source: str | Path,
    out: str | Path | None = None,
    *,
    eye: Literal["left", "right"] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[Path]:
    """Write a self-contained page about a plate's light and water, and the track of its sun; return what was written.

    source: a video or still, or a scene file that names one and says how to read it. eye: of a stereo plate, where the
    source is no scene file. out: the page; the track goes beside it as .sun.json and .sun.csv. Raises `VideoError`,
    `SceneError`, `ParameterError` or `OutputExistsError`.
    """
    from mr360uw.ibl.level.horizon import estimate_horizon
    from mr360uw.ibl.report import Snapshot, level_section, light_report
    from mr360uw.ibl.sun.trackfile import save_track
    from mr360uw.medium.spectral.sensor import named_sensor
    from mr360uw.medium.waterfit import fit_water

    source = Path(source)
    scene = load_scene(source) if source.suffix == ".toml" else Scene(plate=PlateSettings(path=source, eye=eye))
    page = Path(out) if out is not None else source.with_suffix(".html")
    if page.suffix.lower() != ".html":
        raise ParameterError(f"{page} - is no name of a page (got {page.suffix!r}) - end it in .html")
    tracks = [page.with_suffix(suffix) for suffix in (".sun.json", ".sun.csv")]
    for path in (page, *tracks):
        if path.exists() and not overwrite:
            raise OutputExistsError(f"{path} - is there already - name another page with --out, or give --overwrite")
    keep_inputs(scene, page, *tracks)
    scene = scene.model_copy(update={"light": scene.light.model_copy(update={"track": None, "sun": "detect"})})
    with open_plate(scene) as video:
        track = sun_track(scene, video, progress)
        shown = np.unique(np.linspace(0, (video.frame_count or 1) - 1, _PICTURES).astype(int))
        reader, snapshots, maps = scene_light(scene), [], []
        for index in shown:
            frame = next(iter(video.frames(int(index), int(index) + 1)))
            light = reader.of(picture(frame), time_s=frame.time_s)
            snapshots.append(Snapshot(frame.time_s, _small(frame), light))
            maps.append(plate_map(picture(frame), reader.world_from_camera(frame.time_s)[1]))
    sections = []
    if scene.water.type != "none":
        tilts = [estimate_horizon(snapshot.environment.residual) for snapshot in snapshots]
        sections.append(("Level", level_section(tilts, reader.world_from_camera(snapshots[0].time_s)[1])))
        fit = fit_water(np.median(maps, axis=0), scene.camera.depth_m, named_sensor(str(scene.water.sensor)))
        sections.append((f"Water, for a camera {scene.camera.depth_m:g} m deep", fit.html()))
    written = [page]
    write_whole(page, light_report(source.name, snapshots, track, sections))
    if track is not None:
        for path in tracks:
            save_track(track, path)
        written += tracks
    return written


def _small(frame: VideoFrame) -> np.ndarray:
    import cv2

    size = (_PICTURE_WIDTH, _PICTURE_WIDTH // 2)
    return np.asarray(cv2.resize(frame.image_linear, size, interpolation=cv2.INTER_AREA))
