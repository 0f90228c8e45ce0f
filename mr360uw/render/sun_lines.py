# SPDX-License-Identifier: Apache-2.0
"""Lines on the sun of a plate, the same wherever they are printed: as a frame shows it, and as its clip has it."""

from __future__ import annotations

from mr360uw.errors import DamagedFrameError
from mr360uw.ibl import SunTrack
from mr360uw.ibl.sun.words import tracked_in_words
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.lights import LightReader
from mr360uw.render.loaded import Loaded
from mr360uw.render.stages.match_stage import clip_colour
from mr360uw.video import VideoFrame, VideoReader


def scene_sun_lines(loaded: Loaded, video: VideoReader, analysis: ClipAnalysis, index: int = 0) -> list[str]:
    """Return the lines on a scene's sun in a frame of its plate; none where the scene says itself where it is, nothing
    is lit by it, or the frame cannot be decoded.
    """
    if not loaded.plan.sun.runs or loaded.scene.light.sun != "detect":
        return []
    try:
        frame = next(iter(video.frames(index, index + 1)))
    except DamagedFrameError:
        return []
    light = loaded.at(frame.time_s).surroundings.light
    return sun_lines(light, frame.graded_by(clip_colour(loaded, analysis.grade)), analysis)


def sun_lines(light: LightReader, frame: VideoFrame, analysis: ClipAnalysis) -> list[str]:
    """Return a line on the sun in a frame, and one on that of the clip's track there, if the clip was measured."""
    place = f"frame {frame.index}" if frame.index else "first frame"
    lines = [f"light     {place}: {light.sun_found(frame.pixels, frame.time_s).words}"]
    if isinstance(analysis.sun, SunTrack):
        lines.append(f"light     clip: {tracked_in_words(analysis.sun.at(frame.index - analysis.first))}")
    return lines
