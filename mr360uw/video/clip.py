# SPDX-License-Identifier: Apache-2.0
"""Clip metadata: size, frame rate, time base, colour tags, sound, spherical metadata."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from mr360uw.color import ColorSpec
from mr360uw.errors import VideoError
from mr360uw.video.metadata.picture_tags import PictureTags
from mr360uw.video.metadata.spherical import SphericalMetadata, Stereo
from mr360uw.video.metadata.tags import BT709_TAGS, ColorTags, HdrMetadata

_FASTEST = 1000  # frames per second, as in a scene


_KEEPING = {
    "data": "write .mp4 or .mov, which hold what FFmpeg has a name for, with output.data",
    "subtitle": "write a container like the plate's own, with output.data, or add it to the output by a muxer",
    "video": "one track of pictures is worked on: copy another one into a file of its own to work on that",
}
"""How tracks of each kind are had in an output."""


def not_copied(path: Path, kind: str, index: int, tags: Mapping[str, str]) -> str:
    """Return the note on a track of a plate that no output holds, unless its container can. tags: of the track."""
    language = tags.get("language", "und").replace("und", "")
    named = ", ".join(filter(None, [language, (tags.get("title") or tags.get("handler_name") or "").strip()]))
    about = f" ({named})" if named else ""
    return f"{path} - its {kind} track {index}{about} is not copied - {_KEEPING.get(kind, 'add it by a muxer')}"


def checked_rate(frame_rate: Fraction | float, path: Path) -> Fraction:
    """Return frames per second as a fraction of denominator 1001 or less; VideoError unless above 0, at most 1000."""
    if not 0 < frame_rate <= _FASTEST or (rate := Fraction(frame_rate).limit_denominator(1001)) <= 0:
        raise VideoError(
            f"{path} - frame rate must be above 0 and at most {_FASTEST} (got {frame_rate}) - give frames per second"
        )
    return rate


@dataclass(kw_only=True, eq=False)
class Clip:
    """Metadata of a clip.

    path: the file, or the pattern of a sequence. width, height: of the panorama, after the choice of an eye.
    frame_rate: mean frames per second. time_base: unit of the time stamps. start_pts: time stamp of frame 0.
    spec: how the codes are read. tags: the file's colour tags. codec_name, pixel_format: FFmpeg's names; pixel_format
    is "" for pictures. sound: the file whose sound belongs to the clip, if any. spherical: metadata found, or None.
    is_still: one picture, that `frames` repeats as often as asked. notes: parts of the file that are not copied, one
    line each. words: text tags of the container, such as title and date. track_words: language, title and handler's
    name of the track of pictures. pixel_aspect: width of a pixel over its height as the file says, 0 where it does not.
    panorama: whether outputs are marked as full spheres. hdr: metadata of high dynamic range, where the file has some.
    stereo: arrangement of both eyes in outputs, whose frames have a right one; "mono" if they have not.
    first_number: of frame 0 in the names of a sequence's files, 0 of all else. picture_tags: metadata of the first
    picture of stills and sequences.
    """

    path: Path
    width: int
    height: int
    frame_rate: Fraction
    time_base: Fraction
    start_pts: int = 0
    spec: ColorSpec = field(default_factory=ColorSpec)
    tags: ColorTags = BT709_TAGS
    codec_name: str = ""
    pixel_format: str = ""
    sound: Path | None = None
    spherical: SphericalMetadata | None = None
    is_still: bool = False
    notes: tuple[str, ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)
    track_words: Mapping[str, str] = field(default_factory=dict)
    pixel_aspect: Fraction = Fraction(0)
    panorama: bool = True
    hdr: HdrMetadata | None = None
    stereo: Stereo = "mono"
    first_number: int = 0
    picture_tags: PictureTags | None = None

    @property
    def pose_deg(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll [deg] of the panorama that the file states; zeros without."""
        said = self.spherical or self.picture_tags
        return (0.0, 0.0, 0.0) if said is None else said.pose_deg

    @property
    def frame_size(self) -> tuple[int, int]:
        """Width and height [pixels] of the whole picture, of both eyes where there are two."""
        if self.stereo == "mono":
            return self.width, self.height
        return (self.width, 2 * self.height) if self.stereo == "top-bottom" else (2 * self.width, self.height)

    @property
    def frame_count(self) -> int | None:
        """Number of frames; None where it is unknown or unlimited (a still)."""
        return None
